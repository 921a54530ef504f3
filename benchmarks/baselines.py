"""How far simpler methods come on the same cases: their answers, scored as those of any tool.

Two of them rank the fits that rotorjax makes of every effect by another measure; two look at the force that is missing
along the measured motion and fit nothing in the response. None knows mistakes in what was written down, ties, or
answers that are open.

    python benchmarks/baselines.py --first 1160 --seeds 40 --rows benchmarks/results/campaign_1160/rows.jsonl \
        --output output/baselines
"""

import argparse
import csv
import math
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tabulate
from jaxtyping import Float
from scipy.special import chdtrc

from rotorjax import Measurement, Model, read_measurement, read_rig
from rotorjax.compilation import spare_memory, use_double_precision
from rotorjax.discovery.common_noise import settle
from rotorjax.discovery.contest import Contender, Contest, Effects, Known, make_contest
from rotorjax.discovery.force_shapes import Shape, shapes
from rotorjax.discovery.missing_force import Balance, missing_force
from rotorjax.effects import CATALOG
from rotorjax.inference.budget import Budget
from rotorjax.inference.force_balance import ForceBalance
from rotorjax.inference.noise import Noise

from detailed.case import Case, draw
from detailed.files import write, write_case
from scoring import Row, judged, read_answers, read_rows

MOST = 3
"""Effects, at most, as for `explain`."""
REJECTED = 0.01
"""P-value of chi-square up to which a fit does not hold, as for `explain`."""
THRESHOLD = 0.1
"""Share of the force below which sequential thresholding leaves a term out: the default of PySINDy, in columns of unit
length.
"""
NOTHING: Effects = frozenset()
RIGHT = (
    "right",
    "not called explained",
    "too small to see",
    "by a relative that does the same",
)
"""As `scoring.judged` says it: of a confident answer, or of a force that the catalogue does not have."""
AMONG = ("among what ties", "in other words")


class Answer(NamedTuple):
    """What a method says."""

    verdict: str
    named: Effects


def ranked_by(contest: Contest, cost: Callable[[Contender], float], *, until_it_holds: bool) -> Answer:
    """Forward selection: the effect with the least cost, one after the other, until the fit holds or the cost rises."""
    chosen, known = NOTHING, Known()
    while True:
        further = [chosen | {name} for name in contest.candidates if name not in chosen] if len(chosen) < MOST else []
        raced = settle(contest, [chosen, *further], known, Noise(0.1 * contest.measurement.rms)).contenders
        known |= raced
        holds = _holds(contest, raced[chosen])
        best = min(raced, key=lambda effects: (not raced[effects].best.exact, cost(raced[effects])))
        if best == chosen or not further or (until_it_holds and holds):
            verdict = "unexplained" if not holds else "explained" if chosen else "nothing missing"
            return Answer(verdict, chosen)
        chosen = best


def chi_square(contest: Contest) -> Answer:
    """As few effects as make the fit hold, each the one that lowers chi-square most."""
    return ranked_by(contest, lambda c: c.best.data_cost, until_it_holds=True)


def schwarz(contest: Contest) -> Answer:
    """Effects one after the other as long as the criterion falls (Schwarz 1978, Ann. Statist. 6:461-464)."""
    numbers = np.count_nonzero(contest.measurement.weights(contest.measurement.rms))

    def cost(contender: Contender) -> float:
        return 2.0 * contender.best.data_cost + math.log(numbers) * len(contender.best.free)

    return ranked_by(contest, cost, until_it_holds=False)


def _holds(contest: Contest, contender: Contender) -> bool:
    """By chi-square; where the noise is unknown, if no more than a tenth of what was measured is left."""
    m = contest.measurement
    if m.sigma is None:
        return contest.misfit_left(contender) < 0.1 * m.rms
    freedom = max(1, np.count_nonzero(m.weights(0.0)) - len(contender.best.free))
    return bool(chdtrc(freedom, 2.0 * contender.best.data_cost) > REJECTED and contender.noise.allowance == 0.0)


class Columns(NamedTuple):
    """Least squares for the force that is missing: what every shape would bring, and what there is."""

    shapes: list[Shape]
    each: list[Float[np.ndarray, "number factor"]]
    wanted: Float[np.ndarray, "number"]

    def left(self, chosen: list[int]) -> float:
        """Share of the squares that the best factors of some shapes leave."""
        design = np.concatenate([self.each[k] for k in chosen], axis=1)
        rest = self.wanted - design @ np.linalg.lstsq(design, self.wanted)[0]
        return float(rest @ rest / (self.wanted @ self.wanted))


def columns_of(model: Model, measurement: Measurement, *, as_vibration: bool) -> Columns | None:
    """The force and what each effect of the catalogue would do along the measured motion, [N] or as the vibration [m]
    that the declared rotor makes of it; none where the motion was not measured in two directions.
    """
    found = missing_force(model, measurement)
    balance = found.balance
    if balance is None:
        return None
    tried = list(shapes(CATALOG, model.rotor, found.reach))
    forces = ForceBalance(found.model.plus([CATALOG[name]() for name in sorted({shape.term for shape in tried})]))
    points = [forces.values]
    for shape, factor in ((one, factor) for one in tried for factor in one.factors):
        points.append(forces.values.copy())
        for key, value in (shape.held | factor).items():
            points[-1][forces.index[shape.term, key]] += value
    force = forces.at(np.stack(points), measurement.conditions, balance.motion, balance.measured).force
    wanted, brought = force[0], force[1:] - force[0]
    parts = iter([_numbers(balance, part, as_vibration=as_vibration) for part in brought])
    each = [np.stack([next(parts) for _ in shape.factors], axis=1) for shape in tried]
    felt = [k for k, columns in enumerate(each) if np.all(np.linalg.norm(columns, axis=0) > 0.0)]
    return Columns(
        [tried[k] for k in felt], [each[k] for k in felt], -_numbers(balance, wanted, as_vibration=as_vibration)
    )


def _numbers(
    balance: Balance, force: Float[np.ndarray, "case equation"], *, as_vibration: bool
) -> Float[np.ndarray, "number"]:
    used = np.any(balance.whitening != 0.0, axis=2)
    there = np.where(used, force, 0.0)
    return np.ravel(np.linalg.solve(balance.slopes, there[..., None])[..., 0] if as_vibration else there)


def equivalent_loads(model: Model, measurement: Measurement) -> Answer:
    """The one fault whose forces, with factors by least squares, leave least of the vibration that the declared rotor
    does not explain (Markert, Platz, Seidler 2001, Int. J. Rotating Mach. 7:311-321; Bachschmid, Pennacchi, Vania 2002,
    J. Sound Vib. 254:327-366).
    """
    columns = columns_of(model, measurement, as_vibration=True)
    if columns is None:
        return Answer("unexplained", NOTHING)
    left = [columns.left([k]) for k in range(len(columns.shapes))]
    return Answer("explained", frozenset([columns.shapes[int(np.argmin(left))].term]))


def sparse_regression(model: Model, measurement: Measurement) -> Answer:
    """Sequentially thresholded least squares on the force (Brunton, Proctor, Kutz 2016, Proc. Natl. Acad. Sci.
    113:3932-3937), of every effect the shape that does best by itself; columns of unit length.
    """
    columns = columns_of(model, measurement, as_vibration=False)
    if columns is None:
        return Answer("unexplained", NOTHING)
    best: dict[str, int] = {}
    for k in sorted(range(len(columns.shapes)), key=lambda k: columns.left([k])):
        best.setdefault(columns.shapes[k].term, k)
    kept = list(best.values())
    size = float(np.linalg.norm(columns.wanted))
    while kept:
        each = [columns.each[k] / np.linalg.norm(columns.each[k], axis=0) for k in kept]
        factors = iter(np.linalg.lstsq(np.concatenate(each, axis=1), columns.wanted)[0] / size)
        large = [max(abs(next(factors)) for _ in range(part.shape[1])) > THRESHOLD for part in each]
        if all(large):
            break
        kept = [k for k, stays in zip(kept, large, strict=True) if stays]
    return Answer("explained" if kept else "unexplained", frozenset(columns.shapes[k].term for k in kept))


METHODS = {
    "chi-square": chi_square,
    "BIC": schwarz,
    "equivalent loads": equivalent_loads,
    "sparse regression": sparse_regression,
}


def answered(case: Case) -> dict[str, Answer]:
    """Every method on one case; nothing is missing where the model as declared holds."""
    with tempfile.TemporaryDirectory() as folder:
        rig_file, table = write_case(case, Path(folder))
        rig = read_rig(rig_file)
        measurement = read_measurement(table, rig)
    contest = make_contest(rig.model, measurement, list(CATALOG), CATALOG, Budget(None))
    fitted = {name: method(contest) for name, method in METHODS.items() if method in (chi_square, schwarz)}
    holds = fitted["chi-square"].verdict == "nothing missing"
    looked = {
        name: Answer("nothing missing", NOTHING) if holds else method(rig.model, measurement)
        for name, method in METHODS.items()
        if name not in fitted
    }
    spare_memory()
    return fitted | looked


def counted(rows: Sequence[Row]) -> list[str]:
    """Right, among what is said to do as well, open otherwise, confident and wrong."""
    said = [judged(row) for row in rows]
    right = sum(one in RIGHT for one in said)
    among = sum(one in AMONG or one.startswith("right, ") for one in said)
    wrong = sum(one == "WRONG" for one in said)
    return [str(right), str(among), str(len(said) - right - among - wrong), str(wrong)]


def file_of(folder: Path, method: str) -> Path:
    """The answers of a method."""
    return folder / f"baseline_{method.replace(' ', '_')}.csv"


def write_answers(cases: Sequence[Case], folder: Path) -> None:
    """The answers of every method, a line for each case."""
    found = {}
    for case in cases:
        found[case.seed] = answered(case)
        told = (f"{name}: {a.verdict} {' + '.join(sorted(a.named))}" for name, a in found[case.seed].items())
        print(case.seed, *told, sep=" | ", flush=True)
    for name in METHODS:
        with file_of(folder, name).open("w", encoding="utf-8", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(["seed", "verdict", "effects"])
            lines.writerows([k, a[name].verdict, " + ".join(sorted(a[name].named))] for k, a in found.items())


def write_table(cases: Sequence[Case], folder: Path, rows: Path | None) -> str:
    """How often each method is right. **Arguments:** ``rows`` of `explain`."""
    with tempfile.TemporaryDirectory() as truth:
        write(cases, Path(truth) / "cases")
        told = Path(truth) / "cases-answers.jsonl"
        table = [[name, *counted(read_answers(file_of(folder, name), told))] for name in METHODS]
    seeds = {case.seed for case in cases}
    if rows:
        table.append(["rotorjax", *counted([row for row in read_rows(rows) if row["seed"] in seeds])])
    heads = ["method", "right", "among what is said to do as well", "otherwise open", "confident and wrong"]
    listed = tabulate.tabulate(table, heads, tablefmt="pipe", disable_numparse=True)
    text = f"""# Simpler methods on the same cases

{len(cases)} cases of [the benchmark](../../docs/benchmark.md), seeds {min(seeds)} to {max(seeds)}. What each method
does stands in `benchmarks/baselines.py`. Right is also what is not called explained where the force is outside the
catalogue; what is too small to matter by a wrong name stands with what is open.

{listed}
"""
    (folder / "baselines.md").write_text(text, encoding="utf-8")
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1160, help="seed to begin with (%(default)s)")
    parser.add_argument("--seeds", type=int, default=40, help="number of cases (%(default)s)")
    parser.add_argument("--rows", type=Path, help="rows of `explain` on the same cases, as a campaign keeps them")
    parser.add_argument("--output", type=Path, required=True, help="folder for answers and the table")
    parser.add_argument("--count", action="store_true", help="only count the answers that are there")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    cases = [draw(seed) for seed in range(options.first, options.first + options.seeds)]
    if not options.count:
        use_double_precision()
        write_answers(cases, options.output)
    print(write_table(cases, options.output, options.rows))


if __name__ == "__main__":
    main()

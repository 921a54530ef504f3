"""How far fits from declared starts end above the cost of a descent begun at the truth, on cases that were once hard.

Each case is fitted with what is hidden in it as the hypothesis, under the noise of its table, from the starts that its
effects declare and with nothing else known. The difference to a descent begun at what was drawn is the regret: nought
where as good an optimum is found. The last cases are measured on a vertical rotor and explained with a model that
states gravity: no values are true there, so that only the cost reached counts. Motion is integrated in time by code
that shares nothing with rotorjax. Each fit has a process of its own and is ended where it takes longer than allowed;
prints a line for each, writes a table and the same as JSON. The figures under "before" in the JSON that lies in the
output folder are kept, and stand beside the new ones.

    python benchmarks/regret.py --output benchmarks/results
"""

import argparse
import ast
import dataclasses
import importlib
import inspect
import json
import math
import multiprocessing
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import jax
import numpy as np
import tabulate

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import rotorjax
from rotorjax import Measurement, Model, RestoringEffect, effects
from rotorjax.data.files import write_whole
from rotorjax.discovery.contest import Contest, Effects, make_contest
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference.budget import Budget
from rotorjax.inference.data import declared_starts
from rotorjax.inference.descent import End, Start, best_of, descend, starts_at
from rotorjax.inference.descent_settings import QUICK, THOROUGH, DescentSettings
from rotorjax.inference.linearised import Linearisation
from rotorjax.inference.motions import first_motions
from rotorjax.inference.noise import Noise
from rotorjax.inference.prediction import predict
from rotorjax.inference.space import Space
from rotorjax.physics.steady_state import coupled_vectors

import drawn_effects
import drawn_forces
import hidden_forces
import nonlinear_oracle as in_time
from hidden import Plan

Truth = Mapping[str, Mapping[str, float]]
"""Effect -> label -> value in SI."""

OPTIMISER = ("descent_settings", "motions", "levenberg_marquardt", "descent", "scan")
"""Modules of `rotorjax.inference` that say how a fit goes on."""
EFFECT_SEEDS, FORCE_SEEDS = (126, 300, 313, 513, 563, 584, 682, 781, 1356), (205, 425)
RESTORING = tuple(name for name, cls in CATALOG.items() if issubclass(cls, RestoringEffect))
WEIGHTS = {"baseline": 4e-6, "trial-a": 30e-6, "trial-b": 30e-6 * np.exp(2.1j), "trial-c": 20e-6 * np.exp(-1.5j)}
"""Unbalance installed in each run [kg m]."""
SPEEDS_RPM = np.linspace(800.0, 3000.0, 15)
NOISE = 0.01
"""In the median amplitude at 1X."""
CUBIC, STOP, GAP, FRICTION = 1e12, 0.3, 150e-6, 0.15
"""Cubic stiffness [N/m³]; stiffness of the stop in that of the shaft, its gap [m] and coefficient of friction."""
FIGURES = (
    "cost, declared starts", "cost, from the truth", "regret", "linearisations", "CPU s", "of the first call",
    "reduced χ²", "χ² at the truth",
)  # fmt: skip
ABOUT = """What is hidden is fitted from the starts that its effects declare, and from its true values.

*Cost*: half the squared residual in standard errors, and minus the logarithm of the prior. *Regret*: the cost that is
reached from the declared starts, less that of a descent begun at the truth. *Linearisations*: residual and slopes of
one case at one point, counted over all descents from the declared starts. *CPU s*: of the second call in one process;
*of the first call*: with tracing, and with compilation where JAX keeps no cache. *χ² at the truth*: of the response
there, before any descent, near the measured motions where others are steady too. A cost with an asterisk is of first
order only, of motions that do not balance.
The rows "weight stated" are of a vertical rotor and a model that states gravity: no values are true there."""


class Reached(NamedTuple):
    """Where some descents ended, and what they took."""

    ends: list[End]
    linearisations: int
    """Single cases at single points."""


def from_declared(contest: Contest, noise: Noise, hypothesis: Effects) -> Reached:
    """From the starts that the effects declare, with nothing known."""
    free = contest.free(hypothesis)
    starts = starts_at(declared_starts(contest.space, free, contest.measurement))
    return _descended(contest, noise, free, starts, contest.space.given_unknowns(), QUICK)


def from_truth(
    contest: Contest, noise: Noise, hypothesis: Effects, point: np.ndarray
) -> tuple[Reached, list[np.ndarray]]:
    """From the truth, motions near the measured ones or those that balance there; and what the truth itself shows."""
    lin = Linearisation(contest.space, contest.data(noise, point), Budget())
    near = first_motions(lin, [point])[0]
    begin = [searched(contest.space.model_at(point), contest.measurement, lin.kernels.wide), near]
    starts = [Start(point), Start(point, begin[0])]
    reached = _descended(contest, noise, contest.free(hypothesis), starts, point, THOROUGH)
    conditions = contest.measurement.conditions
    shown = [
        predict(contest.space, conditions, point, budget=Budget(), near=(conditions, motions)).shown
        for motions in begin
    ]
    return reached, [vectors for vectors in shown if np.all(np.isfinite(vectors))]


def _descended(
    contest: Contest, noise: Noise, free: np.ndarray, starts: list[Start], kept: np.ndarray, settings: DescentSettings
) -> Reached:
    """Descents on all cases; unknowns that are not free are kept at a point."""
    space, data, budget = contest.space, contest.data(noise, kept), Budget()
    training = np.tile(contest.training, (len(starts), 1))
    return Reached(
        descend(space, data, starts, free, training, budget=budget, kept=kept, settings=settings), budget.spent
    )


@dataclasses.dataclass(frozen=True)
class Problem:
    """One hypothesis about one measurement."""

    case: str
    model: Model
    measurement: Measurement
    hypothesis: tuple[str, ...]
    noise: Noise
    truth: Truth | None
    """Of the hypothesis, and of what is declared uncertain; none where the model is wrong."""

    @property
    def words(self) -> str:
        """The hypothesis."""
        return " + ".join(self.hypothesis)

    def contest(self) -> Contest:
        """As `explain` has it, with the term of the hypothesis if it is one."""
        terms = {name: TERMS[name] for name in self.hypothesis if name in TERMS}
        catalog = {**CATALOG, **terms}
        return make_contest(self.model, self.measurement, catalog, catalog)


def unknowns_of(space: Space, truth: Truth) -> np.ndarray:
    """Values in SI in units of the space's unknowns."""
    unknowns, centre = space.given_unknowns(), np.asarray(space.centre)
    for k, entry in enumerate(space.entries):
        if entry.label in truth.get(entry.effect, {}):
            value, middle = truth[entry.effect][entry.label], centre[k]
            moved = math.log((1.0 + value) / (1.0 + middle)) if entry.logarithmic else value - middle
            unknowns[entry.unknown] = moved / entry.scale
    return unknowns


def reduced_chi2(measurement: Measurement, noise: Noise, shown: np.ndarray, unknowns: int) -> float:
    """Squared residual in standard errors per degree of freedom."""
    weight = measurement.weights(noise.allowance)
    left = (np.where(measurement.present, shown, 0.0) - measurement.vectors)[..., None]
    pairs = np.concatenate([left.real, left.imag], axis=-1) * weight
    return float(np.sum(pairs**2)) / max(1, int(np.count_nonzero(weight)) - unknowns)


def searched(model: Model, measurement: Measurement, wide: int) -> np.ndarray:
    """Motions that balance, each found with nothing known: case x direction x coefficient, the last filled up with
    zeros.
    """
    one = jax.jit(lambda condition: coupled_vectors(model, condition)[1].coefficients)
    conditions = measurement.conditions
    found = np.stack([one(jax.tree.map(lambda leaf, k=k: leaf[k], conditions)) for k in range(len(measurement.run))])
    return np.pad(found, [(0, 0), (0, 0), (0, wide - found.shape[-1])])


def drawn_effect(seed: int) -> list[Problem]:
    """Effects of the catalogue."""
    hidden = drawn_effects.draw(seed)
    noise = Noise(hidden.sigma if hidden.measurement.sigma is None else 0.0)
    return [Problem(f"effects {seed}", hidden.model, hidden.measurement, hidden.effects, noise, hidden.truth)]


def drawn_force(seed: int) -> list[Problem]:
    """A force outside the catalogue; its term's values are read off the force that was drawn."""
    forces: list[tuple[object, ...]] = []
    make = drawn_forces._force

    def kept(*arguments: object) -> in_time.Force:
        forces.append((*arguments, make(*arguments)))  # pyright: ignore
        return forces[-1][-1]  # pyright: ignore

    with mock.patch.object(drawn_forces, "_force", kept):
        drawn = drawn_forces.draw(seed)
    if drawn.term is None:
        raise ValueError(f"no term is the force of seed {seed}")
    model, measurement = drawn_forces.measured(drawn)
    truth = {drawn.term: _read_off(drawn.shape, "xy".index(drawn.axis), forces[-1][-1])}  # pyright: ignore
    return [Problem(f"forces {seed}", model, measurement, (drawn.term,), Noise(), truth)]


def _read_off(shape: str, axis: int, force: in_time.Force) -> dict[str, float]:
    """The values of a dead band, far beyond its gap, or of dry friction, at a high speed."""
    along, none = np.zeros(2), np.zeros(2)
    along[axis] = 1.0
    if shape == "dry friction":
        return {"force_n": float(force(0.0, none, 1e6 * along, none)[axis])}
    if shape == "dead band":
        near, far = (float(force(0.0, place * along, none, none)[axis]) for place in (1.0, 2.0))
        return {"stiffness_n_per_m": far - near, "inverse_gap_per_m": 1.0 / (1.0 - near / (far - near))}
    raise ValueError(f"no values of {shape} are read off")


def tenfold_friction() -> list[Problem]:
    """Dry friction ten times as strong as usual, which nearly holds the rotor."""
    model, measurement, (force,) = hidden_forces.sufficient(effects.CoulombFriction, seed=8, factor=10.0)
    truth = {"coulomb_friction": {"force_n": force}}
    return [Problem("tenfold friction", model, measurement, tuple(truth), Noise(), truth)]


def strong_cubic() -> list[Problem]:
    """A cubic spring as stiff as the shaft."""
    return _sixty("cubic spring", in_time.duffing(CUBIC), {"duffing": {"cubic_n_per_m3": CUBIC}})


def rub_with_friction() -> list[Problem]:
    """Contact with a stator whose friction drives the rotor backward."""
    stiffness = STOP * float(np.mean(hidden_forces.MACHINE.stiffness))
    truth = {"stiffness_n_per_m": stiffness, "inverse_gap_per_m": 1.0 / GAP, "friction": FRICTION}
    return _sixty("rub", in_time.rub(stiffness, GAP, FRICTION, 1), {"rub": truth})


def beside_an_unbalance() -> list[Problem]:
    """A weak cubic spring, one twenty times as strong, and a rub, each beside an unbalance that nobody knows: five runs
    at twelve speeds.
    """
    hidden, machine = 15e-6 * np.exp(0.7j), hidden_forces.MACHINE
    known = {**WEIGHTS, "trial-d": 28e-6 * np.exp(0.8j)}
    speeds = tuple(float(speed) for speed in np.linspace(0.5, 1.6, 12) * machine.frequency)
    plan = Plan({run: [complex(weight) + hidden] for run, weight in known.items()}, speeds, (1, 2, 3), sigma=0.5e-6)
    rub = in_time.rub(0.5 * float(np.mean(machine.stiffness)), 60e-6, 0.1, 1)
    forces = {"duffing": (in_time.duffing(0.01 * CUBIC), in_time.duffing(0.2 * CUBIC)), "rub": (rub,)}
    problems = []
    for name, force in ((name, force) for name, several in forces.items() for force in several):
        model, measured = hidden_forces.measured((force,), plan, np.random.default_rng(3), (0.0, 0.0))
        installed = np.asarray(measured.conditions.unbalance) - np.array([hidden.real, hidden.imag])
        conditions = dataclasses.replace(measured.conditions, unbalance=jax.numpy.asarray(installed))
        told = dataclasses.replace(measured, conditions=conditions)
        problems.append(Problem(f"{name} and unbalance", model, told, (name, "residual_unbalance"), Noise(), None))
    return problems


def hard_to_explain() -> list[Problem]:
    """A crack that opens and closes at once, which no law of the catalogue has; a probe that saturates; a spring of the
    fifth power, which is outside the catalogue: sixty cases each.
    """
    stiffness = float(np.mean(hidden_forces.MACHINE.stiffness))

    def switching(angle: np.ndarray, q: np.ndarray, v: np.ndarray, d: np.ndarray) -> np.ndarray:
        open_below = np.sin(angle) < 0.0
        along = np.cos(angle) * d[0] + np.sin(angle) * d[1]
        return -0.1 * stiffness * open_below * np.stack([np.cos(angle) * along, np.sin(angle) * along])

    def fifth(angle: np.ndarray, q: np.ndarray, v: np.ndarray, d: np.ndarray) -> np.ndarray:
        return stiffness * (np.hypot(q[0], q[1]) / GAP) ** 4 * 0.01 * q

    return [
        Problem("crack that switches", *_sixty_cases(switching, gravity=in_time.DOWN), ("crack",), Noise(), None),
        Problem("saturating probe", *_sixty_cases(bend=in_time.saturation(2.0 * GAP)), (), Noise(), None),
        Problem("spring of the fifth power", *_sixty_cases(fifth), (), Noise(), None),
    ]


def _sixty(name: str, force: in_time.Force, truth: Truth) -> list[Problem]:
    """Sixty cases of a vertical rotor, explained as such, and with gravity stated."""
    model, measurement = _sixty_cases(force)
    heavy = dataclasses.replace(model, rotor=dataclasses.replace(model.rotor, gravity=jax.numpy.array(in_time.DOWN)))
    right = Problem(name, model, measurement, tuple(truth), Noise(), truth)
    wrong = [Problem(f"{name}, weight stated", heavy, measurement, (one,), Noise(), None) for one in RESTORING]
    return [right, *wrong]


def _sixty_cases(
    *forces: in_time.Force,
    gravity: tuple[float, float] = (0.0, 0.0),
    bend: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[Model, Measurement]:
    """Four runs at fifteen speeds through resonance, with noise."""
    speeds = tuple(float(speed) for speed in SPEEDS_RPM * np.pi / 30.0)
    plan = Plan({run: [complex(weight)] for run, weight in WEIGHTS.items()}, speeds, (1, 2), sigma=0.0)
    model, clean = hidden_forces.measured(forces, plan, np.random.default_rng(0), gravity, bend)
    sigma = NOISE * float(np.median(np.abs(clean.vectors[..., 0])))
    rng, shape = np.random.default_rng(1), clean.vectors.shape
    noisy = clean.vectors + sigma * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    return model, dataclasses.replace(clean, vectors=noisy, sigma=np.full(shape, sigma))


CASES: dict[str, Callable[[], list[Problem]]] = {
    **{f"effects-{seed}": lambda seed=seed: drawn_effect(seed) for seed in EFFECT_SEEDS},
    **{f"forces-{seed}": lambda seed=seed: drawn_force(seed) for seed in FORCE_SEEDS},
    "tenfold-friction": tenfold_friction,
    "cubic-spring": strong_cubic,
    "rub": rub_with_friction,
}
"""Name -> its problems."""
DECLARED, AGAIN, TRUTH = "declared", "again", "truth"


def answer(problem: Problem, asked: Iterable[str], pipe: Connection) -> None:
    """In a process of its own: send what each of some questions gives."""
    jax.config.update("jax_enable_x64", True)
    contest, hypothesis = problem.contest(), frozenset(problem.hypothesis)
    for question in asked:
        begin, at_truth = time.process_time(), None
        if question == TRUTH and problem.truth is not None:
            point = unknowns_of(contest.space, problem.truth)
            reached, shown = from_truth(contest, problem.noise, hypothesis, point)
            chi2_there = [reduced_chi2(problem.measurement, problem.noise, one, 0) for one in shown]
            at_truth = min(chi2_there, default=None)
        else:
            reached = from_declared(contest, problem.noise, hypothesis)
        best = best_of(reached.ends)
        chi2 = reduced_chi2(problem.measurement, problem.noise, best.shown, len(best.free))
        seconds = time.process_time() - begin
        found = {"cost": best.cost, "steady": best.exact, "linearisations": reached.linearisations}
        pipe.send({**found, "chi2": chi2, "at_truth": at_truth, "seconds": seconds})


def ask(problem: Problem, asked: tuple[str, ...], limit: float) -> dict[str, dict]:
    """Question -> what its process sent; those that took longer than the limit [s], and all after them, are missing."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=answer, args=(problem, asked, sender))
    process.start()
    sender.close()
    found: dict[str, dict] = {}
    try:
        for question in asked:
            if not receiver.poll(limit):
                break
            found[question] = receiver.recv()
    except EOFError:
        raise RuntimeError(f"{problem.case}, {problem.words}: its process failed") from None
    finally:
        process.kill()
        process.join()
    return found


def row_of(problem: Problem, limit: float) -> dict:
    """One row, as JSON has it."""
    known = problem.truth is not None
    found = ask(problem, (DECLARED, AGAIN, TRUTH) if known else (DECLARED, AGAIN), limit)
    if known and TRUTH not in found:
        found |= ask(problem, (TRUTH,), limit)
    first, again, truth = (found.get(question, {}) for question in (DECLARED, AGAIN, TRUTH))
    cost, least = first.get("cost"), truth.get("cost")
    return {
        "case": problem.case,
        "hypothesis": problem.words,
        "cases": len(problem.measurement.run),
        "truth_known": known,
        "cost": cost,
        "steady": first.get("steady"),
        "cost_from_truth": least,
        "steady_from_truth": truth.get("steady"),
        "regret": None if cost is None or least is None else cost - least,
        "linearisations": first.get("linearisations"),
        "linearisations_from_truth": truth.get("linearisations"),
        "cpu_s": again.get("seconds"),
        "first_call_cpu_s": first.get("seconds"),
        "reduced_chi2": first.get("chi2"),
        "reduced_chi2_from_truth": truth.get("chi2"),
        "reduced_chi2_at_truth": truth.get("at_truth"),
        "limit_s": limit,
    }


def cells(row: dict | None) -> list[str]:
    """The figures of one row, as the table has them."""
    if row is None:
        return ["-"] * len(FIGURES)

    def said(key: str, form: str, missing: str = "-") -> str:
        return missing if row[key] is None else format(row[key], form)

    late = f"> {row['limit_s']:.0f} s"
    cost = said("cost", ".2f", late) + ("*" if row["steady"] is False else "")
    from_truth = said("cost_from_truth", ".2f", late if row["truth_known"] else "-")
    from_truth += "*" if row["steady_from_truth"] is False else ""
    effort = [said("linearisations", "d"), said("cpu_s", ".1f", late), said("first_call_cpu_s", ".1f", late)]
    chi2 = [said("reduced_chi2", ".3g"), said("reduced_chi2_at_truth", ".3g")]
    return [cost, from_truth, said("regret", ".2f"), *effort, *chi2]


def total(rows: list[dict | None]) -> list[str]:
    """What some rows come to; what took too long is left out."""

    def added(key: str, form: str) -> str:
        values = [row[key] for row in rows if row is not None and row[key] is not None]
        return format(sum(values), form) if values else "-"

    costs = [added(key, ".2f") for key in ("cost", "cost_from_truth", "regret")]
    return [*costs, added("linearisations", "d"), added("cpu_s", ".1f"), added("first_call_cpu_s", ".1f"), "", ""]


def steering() -> list[str]:
    """The numbers that steer a fit: constants of the optimiser's modules, and what its two settings are made of."""
    found = []
    for module in OPTIMISER:
        imported = importlib.import_module(f"rotorjax.inference.{module}")
        for node in ast.walk(ast.parse(inspect.getsource(imported))):
            if (
                module == "descent_settings"
                and isinstance(node, ast.AnnAssign)
                and isinstance(node.value, ast.Constant)
            ):
                found += [ast.unparse(node.target)] if type(node.value.value) in (int, float) else []
            elif isinstance(node, ast.Assign) and (name := ast.unparse(node.targets[0])).isupper():
                found += [name] if isinstance(vars(imported).get(name), int | float | np.ndarray) else []
    return found


def code() -> str:
    """The commit of the rotorjax that is measured."""

    def said(*words: str) -> str:
        folder = str(Path(rotorjax.__file__).parent)
        return subprocess.run(["git", "-C", folder, *words], check=False, capture_output=True, text=True).stdout.strip()

    return said("rev-parse", "--short", "HEAD") + (" with changes" if said("status", "--porcelain", ".") else "")


def write(folder: Path, rows: list[dict]) -> None:
    """The table, beside the figures kept from before, and the same as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "regret.json"
    before = json.loads(path.read_text()).get("before") if path.exists() else None
    known = {(row["case"], row["hypothesis"]): row for row in before["rows"]} if before else {}
    pairs = [(known.get((row["case"], row["hypothesis"])), row) for row in rows]
    lines = [[row["case"], row["hypothesis"], str(row["cases"]), *cells(old), *cells(row)] for old, row in pairs]
    for name, right in (("right rig", True), ("weight stated", False)):
        if group := [(old, row) for old, row in pairs if row["truth_known"] == right]:
            count = str(sum(row["cases"] for _, row in group))
            sums = [figure for column in zip(*group, strict=True) for figure in total(list(column))]
            lines.append([f"**{name}**", f"{len(group)} fits", count, *sums])
    heads = ["case", "hypothesis", "cases", *(f"before: {head}" for head in FIGURES), *FIGURES]
    table = tabulate.tabulate(lines, heads, tablefmt="pipe", disable_numparse=True)
    title = f"# Fits from declared starts beside fits from the truth, commit {code()}"
    told = "Written by `python benchmarks/regret.py --output benchmarks/results`."
    told += f"\n*Before*: commit {before['commit']}; {before['about']}" if before else ""
    steers = steering()
    counted = f"Numbers that steer such a fit: {len(steers)} ({', '.join(steers)})."
    write_whole(folder / "regret.md", "\n\n".join([title, ABOUT, told, table, counted]) + "\n")
    write_whole(path, json.dumps({"commit": code(), "rows": rows, "before": before}, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, help="folder for regret.md and regret.json")
    names = f"of {', '.join(CASES)}"
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="NAME", help=names)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds that one fit may take (%(default)s)")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    print(f"{rotorjax.__file__}, commit {code()}", flush=True)
    rows = []
    for name in arguments.only:
        for problem in CASES[name]():
            rows.append(row_of(problem, arguments.limit))
            print(" | ".join([problem.case, problem.words, *cells(rows[-1])]), flush=True)
    # Only the whole of it: an interrupted run leaves the table as it is.
    if arguments.output:
        write(arguments.output, rows)


if __name__ == "__main__":
    main()

"""One case drawn by seed: a rotor, what is hidden in it, what is measured, and the rig file and table of it."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from detailed import hidden as hide
from detailed.hidden import DOWN, EFFECTS, OUTSIDE, TWICE, WEIGHED, Hidden, Plant, Scale
from detailed.in_time import Condition, NoSteadyStateError, waveforms
from detailed.machines import Machine, finite_element_rotor, shaft_share, stiffness_at_disk, two_element_rotor
from detailed.mistakes import Mistake, mistakes
from detailed.relatives import left_by_relative
from detailed.rotor import Rotor
from detailed.stated import Limits, Plan, Stated, deviation, fitted, misfit

KINDS = (
    "one", "two", "outside", "one", "none", "one", "two", "mistake", "one", "outside",
    "one", "two", "one", "none", "mistake beside", "one", "two", "one", "outside", "one",
)  # fmt: skip
"""What is hidden takes turns, and so do the effects, as many as are prime to it."""
NOISES = (0.01, 0.05, 0.01, 0.1)
"""Standard error of real and imaginary part over the median amplitude at 1X of runs with unbalance, in turns."""
POORER = ("one probe", "one run", "few speeds", "one trial weight", "noise unknown")
IMPROVEMENT = (10.0, 1e4)
STEPS = 192
FINER = (384, 768, 1536)
"""Steps of a turn: those of the search for a size, then so many until the vectors hold still."""
HOLDS = 0.03
"""Change with half the steps, in standard errors, that is none."""
SIZES = (1e-3, 8.0)
MOST_SEARCHED = 7
ALLOWED = (0.3, 1.8)
"""Speeds that the rig file permits, over the natural frequency; 0.5 to 1.5 are measured."""
NEAR = 1.15
"""Factor within which an improvement is the one that was drawn."""
RUNS = ("baseline", "trial-a", "trial-b", "trial-c", "trial-d", "trial-e")
MORE_RUNS = 2478
"""Seed from which on plans have three to six runs; before it three."""
FINITE_ELEMENTS = 4900
"""Seed from which on rotors have a shaft of finite elements; before it two beam elements."""


@dataclasses.dataclass(frozen=True)
class Present:
    """Something hidden, with its size and what it brings."""

    hidden: Hidden
    size: float
    improvement: float
    """In chi-square, beside all else that is hidden."""


@dataclasses.dataclass(frozen=True)
class Readings:
    """Further readings in one run, which may be another one than those there are."""

    run: str
    speeds: np.ndarray
    """[rad/s]."""
    new_probes: tuple[str, ...] = ()
    """Probes without a reading so far."""
    weight: float = 0.0
    """Installed in the first plane at 0° in another run [kg m]."""


@dataclasses.dataclass(frozen=True)
class Case:
    """Rig file, table, and what is true."""

    seed: int
    kind: str
    poorer: str
    """What is poor about the measurement; ``none`` for the standard plan."""
    noise: float
    stated: Stated
    plan: Plan
    vectors: np.ndarray
    """As the table has them, condition x probe x order [m]."""
    present: np.ndarray
    sigma: float
    effects: tuple[Present, ...]
    outside: Present | None
    beyond: float | None
    """Chi-square of the force outside the catalogue that its nearest relative in it leaves."""
    detail: Mapping[str, float]
    """Effects of the catalogue that the healthy rotor has by its detail, and their improvement in chi-square: naming
    them is no mistake.
    """
    mistake: str | None
    mistake_improvement: float | None
    bench: "_Bench"
    plant: Plant
    """What is measured."""

    @property
    def error(self) -> float:
        """Root mean square of the vectors' errors, by noise and the tolerance of the model's form [m]."""
        spread = deviation(self.vectors, self.sigma, self.stated.tolerance)[self.present]
        return float(np.sqrt(2.0 * np.mean(spread**2)))

    def with_readings(self, further: Readings, rng: np.random.Generator) -> "Case":
        """The same rotor with more readings in the table.

        **Errors.** `NoSteadyStateError` where it does not come to a steady motion.
        """
        plan, weights = self.plan, dict(self.bench.weights)
        names = plan.runs if further.run in plan.runs else (*plan.runs, further.run)
        weights.setdefault(further.run, ((complex(further.weight), next(iter(self.stated.planes))),))
        run = np.full(len(further.speeds), names.index(further.run))
        bench = dataclasses.replace(self.bench, plan=Plan(further.speeds, run, names, plan.orders), weights=weights)
        z = _noisy(bench.settled(self.plant), self.sigma, plan.orders, rng)
        read = self.present.any(axis=(0, 2)) | np.isin(list(self.stated.angles), further.new_probes)
        whole = Plan(np.append(plan.speeds, further.speeds), np.append(plan.run, run), names, plan.orders)
        present = np.broadcast_to(read[None, :, None], z.shape)
        return dataclasses.replace(
            self, plan=whole, stated=dataclasses.replace(self.stated, installed={**weights, **self.stated.installed}),
            vectors=np.concatenate([self.vectors, z]), present=np.concatenate([self.present, present]),
        )  # fmt: skip

    def healthy(self) -> "Case":
        """The same readings of the healthy rotor, in runs of their own beside those of the case."""
        names = tuple(f"healthy-{run}" for run in self.plan.runs)
        weights = dict(zip(names, (self.bench.weights[run] for run in self.plan.runs), strict=True))
        rng = np.random.default_rng([4711, self.seed, 2])
        z = _noisy(self.bench.vectors(Plant(self.bench.rotor)), self.sigma, self.plan.orders, rng)
        stated = dataclasses.replace(self.stated, installed={**self.stated.installed, **weights})
        return dataclasses.replace(
            self, plan=dataclasses.replace(self.plan, runs=names), stated=stated, vectors=z, effects=(), outside=None
        )

    def table(self) -> str:
        """The measurement as CSV."""
        known = self.poorer != "noise unknown"
        lines = ["run,speed_rpm,probe,order,amplitude_um,phase_deg" + (",sigma_um" if known else "")]
        names = list(self.stated.angles)
        for c, p, o in np.argwhere(self.present):
            z = self.vectors[c, p, o] * 1e6
            rpm = self.plan.speeds[c] * 30.0 / np.pi
            phase = np.degrees(np.angle(z)) if self.plan.orders[o] else (0.0 if z.real >= 0.0 else 180.0)
            line = f"{self.plan.runs[self.plan.run[c]]},{rpm:.7g},{names[p]},{self.plan.orders[o]},{abs(z):.9g},"
            lines.append(f"{line}{phase:.7g}" + (f",{1e6 * self.sigma:.6g}" if known else ""))
        return "\n".join(lines) + "\n"


@dataclasses.dataclass
class _Bench:
    """A healthy rotor with its plan, and what is measured on it when something is hidden."""

    rotor: Rotor
    stated: Stated
    plan: Plan
    weights: Mapping[str, tuple[tuple[complex, str], ...]]
    sigma: float = 0.0

    def __post_init__(self) -> None:
        self.healthy = self.stated.values()
        """Of the plain rotor that comes nearest without anything hidden: the rig file may be off them."""

    def vectors(self, plant: Plant, steps: int = STEPS) -> np.ndarray:
        """Without noise, condition x probe x order [m]."""
        share = {name: p for name, p in self.stated.planes.items()}
        if hide.SECOND_PLANE in share:
            share[hide.SECOND_PLANE] *= plant.second_plane
        total = [sum(u * share[plane] for u, plane in self.weights[run]) for run in self.plan.runs]
        speeds = self.plan.speeds * plant.speed_ratio
        conditions = [Condition(float(s), total[r]) for s, r in zip(speeds, self.plan.run, strict=True)]
        waves, _ = waveforms(plant.rotor, plant.forces, conditions, steps=steps)
        return plant.chain.read(waves, speeds, self.plan.orders)

    def settled(self, plant: Plant) -> np.ndarray:
        """The same with so many steps to a turn that twice as many change nothing that could be measured.

        **Errors.** `NoSteadyStateError` where that is too many.
        """
        coarse = self.vectors(plant, STEPS)
        if not plant.forces:
            return coarse
        for steps in FINER:
            fine = self.vectors(plant, steps)
            if np.max(np.abs(fine - coarse)) < HOLDS * self.sigma:
                return fine
            coarse = fine
        raise NoSteadyStateError("the steps are too long for this motion")


def draw(seed: int) -> Case:
    """The case of a seed; drawn anew until the rotor settles into a stable motion that repeats itself every turn."""
    rng = np.random.default_rng([4711, seed])
    for _ in range(50):
        try:
            return _drawn(seed, rng)
        except (NoSteadyStateError, np.linalg.LinAlgError):
            continue
    raise NoSteadyStateError(f"seed {seed}: no steady motion in 50 draws")


def _drawn(seed: int, rng: np.random.Generator) -> Case:
    kind, noise = KINDS[seed % len(KINDS)], NOISES[(seed // len(KINDS) + seed) % len(NOISES)]
    poorer = str(rng.choice(POORER)) if rng.random() < 0.3 else "none"
    names, other = _names(seed, kind, rng)
    weighed = any(name in WEIGHED for name in (*names, other)) or rng.random() < 0.4
    gravity = DOWN if weighed else (0.0, 0.0)
    machine = (finite_element_rotor if seed >= FINITE_ELEMENTS else two_element_rotor)(rng, gravity)
    bench = _bench(rng, names, other, _runs(seed, poorer), poorer == "few speeds", machine)
    healthy = bench.vectors(Plant(bench.rotor))
    scale = _scale(bench, healthy)
    once = np.abs(healthy[:, :, bench.plan.orders.index(1)])
    bench.sigma = noise * float(np.median(once[once > 0.0]))
    present = _present(bench, poorer, rng)
    bench.stated = _declared(bench.stated, names, rng)
    found = [hide.effect(name, rng, scale, gravity) for name in names]
    found += [hide.outside(other, rng, scale)] if other else []
    placed = _sized(bench, found, present, rng)
    plant = _plant(bench, [(p.hidden, p.size) for p in placed])
    clean = bench.settled(plant)
    beyond = _beyond(bench, other, scale, clean, present) if other else None
    z = _noisy(clean, bench.sigma, bench.plan.orders, rng)
    case = Case(
        seed, kind, poorer, noise, bench.stated, bench.plan, z, present, bench.sigma,
        tuple(p for p in placed if p.hidden.name in EFFECTS),
        next((p for p in placed if p.hidden.name in OUTSIDE), None), beyond,
        _detail(bench, healthy, present), None, None, bench, plant,
    )  # fmt: skip
    return _mistaken(case, rng) if kind.startswith("mistake") else case


def _noisy(clean: np.ndarray, sigma: float, orders: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    z = clean + sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    return np.where(np.array(orders) == 0, z.real, z)


def _names(seed: int, kind: str, rng: np.random.Generator) -> tuple[list[str], str | None]:
    """Effects of the catalogue and the force outside it that a case hides."""
    main = EFFECTS[seed % len(EFFECTS)]
    if kind == "outside":
        return [], OUTSIDE[(seed // 3) % len(OUTSIDE)]
    if kind in ("none", "mistake"):
        return [], None
    names = [main]
    if kind == "two":
        others = [name for name in EFFECTS if name not in (main, "plane_participation")]
        names.append(str(rng.choice(others)))
    return names, None


def _runs(seed: int, poorer: str) -> int:
    """How many; by a generator of its own, so that cases before ``MORE_RUNS`` stay as they were."""
    fewer = {"one run": 1, "one trial weight": 2}.get(poorer)
    if fewer is not None or seed < MORE_RUNS:
        return fewer or 3
    return int(np.random.default_rng([4711, seed, 1]).integers(3, len(RUNS) + 1))


def _bench(
    rng: np.random.Generator, names: list[str], other: str | None, runs: int, few_speeds: bool, machine: Machine
) -> _Bench:
    """Rotor, plan, and the rig file that its healthy baseline gives."""
    rotor, mass, frequency = machine.rotor, machine.mass, machine.frequency
    orders = _orders(rng, [*names, other or ""])
    count = 5 if few_speeds else int(rng.integers(8, 21))
    speeds = np.linspace(0.5, 1.5, count) + rng.uniform(-0.2, 0.2, count) / count
    usual = mass * np.exp(rng.uniform(np.log(1e-5), np.log(8e-5)))
    two_planes = "plane_participation" in names
    planes = {"disk1": 1.0, hide.SECOND_PLANE: float(rng.uniform(0.4, 0.9))} if two_planes else {"disk1": 1.0}
    left = usual * rng.uniform(0.2, 0.6) if runs == 1 or rng.random() < 0.5 else 0.0
    weights: dict[str, tuple[tuple[complex, str], ...]] = {}
    baseline = complex(left * np.exp(2j * np.pi * rng.random()))
    for k, run in enumerate(RUNS[:runs]):
        weight = complex(usual * rng.uniform(0.5, 1.0) * np.exp(2j * np.pi * rng.random()))
        plane = hide.SECOND_PLANE if two_planes and k == runs - 1 else "disk1"
        weights[run] = ((baseline, "disk1"), *(((weight, plane),) if k else ()))
        weights[run] = tuple(w for w in weights[run] if w[0] != 0.0) or ((0j, "disk1"),)
    plan = Plan(np.tile(speeds * frequency, runs), np.repeat(np.arange(runs), count), tuple(weights), orders)
    k, gravity = stiffness_at_disk(rotor), "-y" if any(rotor.gravity) else "none"
    first = Stated(mass, k, (0.02, 0.02), gravity, weights, planes, {"X": 0.0, "Y": 0.5 * np.pi}, {})
    bench = _Bench(rotor, first, plan, weights)
    measured = fitted(first, plan, bench.vectors(Plant(rotor)))
    allowed = (ALLOWED[0] * frequency, ALLOWED[1] * frequency)
    bench.stated = dataclasses.replace(measured, limits=Limits(allowed, usual))
    bench.healthy = bench.stated.values()
    bench.rotor = dataclasses.replace(rotor, reference_speed=bench.stated.frequency)
    return bench


def _scale(bench: _Bench, healthy: np.ndarray) -> Scale:
    stated, rotor = bench.stated, bench.rotor
    k = stiffness_at_disk(rotor)
    total = [abs(sum(u for u, _ in w)) for w in bench.weights.values()]
    orders = bench.plan.orders
    return Scale(
        float(np.max(np.abs(healthy[:, :, orders.index(1)]))), stated.mass, k, float(np.mean(stated.ratio)),
        stated.frequency, max(total), stated.mass * 9.80665 / float(np.mean(k)), shaft_share(rotor), orders,
    )  # fmt: skip


def _orders(rng: np.random.Generator, names: list[str]) -> tuple[int, ...]:
    choices = ((1,), (1, 2), (1, 2, 3), (0, 1, 2, 3))
    return choices[rng.integers(1 if any(name in TWICE for name in names) else 0, 4)]


def _present(bench: _Bench, poorer: str, rng: np.random.Generator) -> np.ndarray:
    """Which cells of the table there are."""
    present = np.ones(bench.plan.shape, bool)
    if poorer == "one probe":
        present[:, int(rng.integers(2))] = False
    return present


def _declared(stated: Stated, names: list[str], rng: np.random.Generator) -> Stated:
    """The rig file with what it calls uncertain, off by as much as that lets expect; never what is hidden."""
    if rng.random() < 0.5:
        return stated
    uncertain = {"stiffness": 0.01, "damping_ratio": 0.15}
    uncertain = {k: u for k, u in uncertain.items() if f"{k.removesuffix('_ratio')}_error" not in names}
    off = np.exp(rng.standard_normal(4) * np.repeat([uncertain.get(k, 0.0) for k in ("stiffness", "damping_ratio")], 2))
    stiffness = tuple(float(k * f) for k, f in zip(stated.stiffness, off[:2], strict=True))
    ratio = tuple(float(z * f) for z, f in zip(stated.ratio, off[2:], strict=True))
    return dataclasses.replace(stated, stiffness=stiffness, ratio=ratio, uncertain=uncertain)


def _plant(bench: _Bench, parts: list[tuple[Hidden, float]]) -> Plant:
    plant = Plant(bench.rotor)
    for hidden, size in parts:
        plant = hidden.applied(plant, size)
    return plant


def _brings(
    bench: _Bench, parts: list[tuple[Hidden, float]], which: int, whole: np.ndarray, present: np.ndarray
) -> float:
    """Improvement in chi-square by one of the parts, beside the others."""
    others = [part for k, part in enumerate(parts) if k != which]
    without = bench.vectors(_plant(bench, others))
    spread = deviation(whole, bench.sigma, bench.stated.tolerance)
    return misfit(bench.stated, bench.plan, whole - without, spread, present, bench.healthy)


def _detail(bench: _Bench, healthy: np.ndarray, present: np.ndarray) -> dict[str, float]:
    """What the gyroscopic moments of the tilting disk and of the shaft bring."""
    without = bench.vectors(Plant(dataclasses.replace(bench.rotor, turning=0.0)))
    spread = deviation(healthy, bench.sigma, bench.stated.tolerance)
    return {"gyroscopic": misfit(bench.stated, bench.plan, healthy - without, spread, present, bench.healthy)}


def _beyond(bench: _Bench, other: str, scale: Scale, whole: np.ndarray, present: np.ndarray) -> float:
    """Of a force outside the catalogue, in chi-square: stiffness and damping are free in it."""
    free = dataclasses.replace(
        bench.stated, uncertain={**bench.stated.uncertain, "stiffness": 0.1, "damping_ratio": 1.0}
    )
    spread = deviation(whole, bench.sigma, bench.stated.tolerance)
    return left_by_relative(
        other,
        scale,
        Plant(bench.rotor),
        bench.vectors,
        lambda z: misfit(free, bench.plan, whole - z, spread, present, bench.healthy),
    )


def _sized(bench: _Bench, found: list[Hidden], present: np.ndarray, rng: np.random.Generator) -> list[Present]:
    """Everything hidden at a size that brings an improvement drawn, as far as sizes go; what it brings beside all
    else.
    """
    parts: list[tuple[Hidden, float]] = []
    for hidden in found:
        wanted = float(np.exp(rng.uniform(*np.log(IMPROVEMENT))))
        parts.append((hidden, _size(bench, parts, hidden, wanted, present)))
    whole = bench.vectors(_plant(bench, parts))
    return [Present(h, size, _brings(bench, parts, k, whole, present)) for k, (h, size) in enumerate(parts)]


def _size(
    bench: _Bench, parts: list[tuple[Hidden, float]], hidden: Hidden, wanted: float, present: np.ndarray
) -> float:
    """The size at which something brings an improvement: that of a small thing grows with its square."""
    low, high = SIZES
    size, ceiling, best = 0.1, high, None
    for _ in range(MOST_SEARCHED):
        tried = [*parts, (hidden, size)]
        try:
            whole = bench.vectors(_plant(bench, tried))
        except NoSteadyStateError:
            ceiling = size
            size = 0.5 * size if best is None or best >= size else float(np.sqrt(best * size))
            continue
        now = _brings(bench, tried, len(parts), whole, present)
        best = size
        if max(now / wanted, wanted / max(now, 1e-30)) < NEAR:
            return size
        ahead = float(size * np.clip(np.sqrt(wanted / max(now, 1e-30)), 0.1, 10.0))
        ahead = min(max(ahead, low), 0.97 * ceiling)
        if abs(ahead / size - 1.0) < 0.01:
            return size
        size = ahead
    if best is None:
        raise NoSteadyStateError("no size has a steady motion")
    return best


def _mistaken(case: Case, rng: np.random.Generator) -> Case:
    """The case with one mistake that the measurement permits, in rig file or table."""
    possible = mistakes(case.stated, case.plan, case.present)
    kinds = sorted({name.split(".")[0] for name in possible})
    kind = kinds[(case.seed // len(KINDS)) % len(kinds)]
    name = str(rng.choice(sorted(name for name in possible if name.split(".")[0] == kind)))
    change: Mistake = possible[name]
    stated, vectors, factor = change(case.stated, case.vectors)
    before = _misfit(case, case.stated, case.vectors, case.sigma)
    after = _misfit(case, stated, vectors, factor * case.sigma)
    return dataclasses.replace(
        case, stated=stated, vectors=vectors, sigma=factor * case.sigma, mistake=name,
        mistake_improvement=after - before,
    )  # fmt: skip


def _misfit(case: Case, stated: Stated, vectors: np.ndarray, sigma: float) -> float:
    """Chi-square of a table against its rig file."""
    spread = deviation(vectors, sigma, stated.tolerance)
    return misfit(stated, case.plan, vectors - stated.predicted(case.plan), spread, case.present)

"""Which orbits, centrelines and natural frequencies of a comparison to draw."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from rotorjax.data.names import one_of
from rotorjax.diagnosis.natural_frequencies import NaturalFrequencies, natural_frequencies
from rotorjax.diagnosis.orbits import Centreline, Orbit, Pair, mean_position, probe_pairs
from rotorjax.discovery.compare import Comparison
from rotorjax.discovery.story import Story
from rotorjax.model.model import Model
from rotorjax.reporting import plots
from rotorjax.reporting.pictures.views import has_before, runs_by_size

MOST_ORBITS = 3
"""Orbits in a row."""
BEYOND = 1.15
"""Times the highest speed of interest to which a Campbell diagram goes."""
SPEEDS = 241
"""Speeds of a Campbell diagram."""


class OrbitView(NamedTuple):
    """One reading of two probes in a plane: as measured, and what the model puts there."""

    run: str
    speed_rpm: float
    measured: Orbit
    model: Orbit
    probes: dict[str, float]
    """Angle of each from +x towards +y [rad]."""

    @property
    def title(self) -> str:
        """Run and speed."""
        return f"{plots.plain(self.run)}, {self.speed_rpm:.0f} rpm"


def pairs_read(story: Story) -> list[Pair]:
    """Pairs of probes that show orbits."""
    return probe_pairs(story.final_model, story.last.measurement.probes_read)


def the_pair(story: Story, probes: tuple[str, str] | None) -> Pair:
    """The pair of these names, or the first. **Errors.** ``ValueError`` where there is none."""
    m, found = story.last.measurement, pairs_read(story)
    if probes is not None:
        if len({*probes}) != 2 or len(probes) != 2:
            raise ValueError(f"an orbit needs two probes, not {', '.join(probes) or 'none'}")
        one, other = (m.probes.index(one_of(probe, m.probes, "probe")) for probe in probes)
        return one, other
    if not found:
        raise ValueError("no two probes were read that see the shaft in one plane, at least 30° apart")
    return found[0]


def orbit_view(view: Comparison, model: Model, case: int, pair: Pair) -> OrbitView:
    """One reading, at the orders read by both probes."""
    m, both = view.measurement, list(pair)
    there = np.logical_and.reduce(view.present[case, both])
    orders = tuple(order for order, read in zip(m.orders, there.tolist(), strict=True) if read)
    angle, spin = np.asarray(model.probes.angle)[both], int(model.rotor.spin)
    sigma = None if m.sigma is None else m.sigma[case, both][:, there]
    measured = Orbit.of(view.measured[case, both][:, there], orders, angle, spin=spin, sigma=sigma)
    predicted = Orbit.of(view.predicted[case, both][:, there], orders, angle, spin=spin)
    probes = {m.probes[k]: float(a) for k, a in zip(both, angle, strict=True)}
    return OrbitView(m.runs[m.run[case]], float(m.speed_rpm[case]), measured, predicted, probes)


def orbit_cases(view: Comparison, pair: Pair, critical_rpm: Sequence[float], most: int = MOST_ORBITS) -> list[int]:
    """Readings to show, by speed: of the run with the largest vibration those nearest to critical speeds within its
    speeds, then the largest at other speeds; then the largest of other runs, one of each.
    """
    m, both = view.measurement, list(pair)
    turning = np.array(m.orders) > 0.0
    seen = np.any(view.present[:, both].all(axis=1) & turning, axis=1)
    if not seen.any():
        return []
    largest = next(k for run in runs_by_size(view.measurement) if seen[m.run == (k := m.runs.index(run))].any())
    own, cluster = np.flatnonzero(seen & (m.run == largest)), m.speed_cluster()[0]
    speed = m.speed_rpm[own]
    near = [int(own[np.argmin(np.abs(speed - c))]) for c in critical_rpm if speed.min() <= c <= speed.max()]
    size = np.linalg.norm((np.abs(view.measured[:, both]) * turning).reshape(len(seen), -1), axis=1)
    by_size = sorted(np.flatnonzero(seen).tolist(), key=lambda case: (m.run[case] != largest, -size[case]))
    picked: dict[tuple[bool, int], int] = {}
    for case in [*near, *by_size]:
        mine = bool(m.run[case] == largest)
        if len(picked) < most:
            picked.setdefault((mine, int(cluster[case] if mine else m.run[case])), case)
    return sorted(picked.values(), key=lambda case: m.speed_rpm[case])


def the_case(story: Story, pair: Pair, run: str | None, speed_rpm: float | None) -> int:
    """The reading of a run nearest to a speed; by default that with the largest vibration. **Errors.** ``ValueError``
    where the two probes were not read.
    """
    view, both = story.last, list(pair)
    m = view.measurement
    seen = np.any(view.present[:, both].all(axis=1) & (np.array(m.orders) > 0.0), axis=1)
    if run is not None:
        seen = seen & (m.run == m.runs.index(one_of(run, m.runs, "run")))
    if not seen.any():
        raise ValueError("no reading of both probes at one order: choose another run or other probes")
    cases = np.flatnonzero(seen)
    if speed_rpm is not None:
        return int(cases[np.argmin(np.abs(m.speed_rpm[cases] - speed_rpm))])
    return int(cases[np.argmax(np.abs(view.measured[cases][:, both]).sum(axis=(1, 2)))])


def centrelines(view: Comparison, model: Model, pair: Pair, runs: Sequence[str]) -> dict[str, Centreline]:
    """0X by run, where both probes were read at it; empty where they never were."""
    m, both, found = view.measurement, list(pair), {}
    if 0.0 not in m.orders:
        return found
    k, angle = m.orders.index(0.0), np.asarray(model.probes.angle)[both]
    for run in runs:
        same = m.run == m.runs.index(one_of(run, m.runs, "run"))
        cases = np.flatnonzero(same & view.present[:, both, k].all(axis=1))
        if len(cases):
            measured, predicted = (mean_position(z[cases][:, both, k], angle) for z in (view.measured, view.predicted))
            found[run] = Centreline(m.speed_rpm[cases], measured, predicted)
    return found


def natural_frequencies_of(story: Story) -> tuple[NaturalFrequencies, NaturalFrequencies | None] | None:
    """With what was added, and as declared where it is another model; none where they are not known."""
    after = natural_frequencies(story.final_model, _speeds(story))
    if after is None:
        return None
    before = natural_frequencies(story.model, _speeds(story)) if has_before(story) else None
    same = before is not None and before.frequency_hz.shape == after.frequency_hz.shape
    if before is not None and same and np.allclose(before.frequency_hz, after.frequency_hz, rtol=1e-6, equal_nan=True):
        before = None
    return after, before


def _speeds(story: Story) -> np.ndarray:
    critical = [one.speed_rpm for one in story.lateral.critical_speeds or ()]
    highest = BEYOND * max([*critical, float(story.measurement.speed_rpm.max()), story.lateral.speeds.high_rpm])
    return np.linspace(0.01 * highest, highest, SPEEDS)


def draw_campbell(axes: Axes, story: Story, found: tuple[NaturalFrequencies, NaturalFrequencies | None]) -> Axes:
    """Natural frequencies with the critical speeds, and the speeds measured."""
    speeds = story.measurement.speed_rpm
    critical = [one.speed_rpm for one in story.lateral.critical_speeds or ()]
    orders = sorted({1.0, *(order for order in story.measurement.orders if order > 0.0)})
    return plots.campbell(
        axes,
        found[0],
        before=found[1],
        measured_rpm=(float(speeds.min()), float(speeds.max())),
        critical_rpm=critical,
        orders=orders,
    )

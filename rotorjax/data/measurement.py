"""Measured vibration vectors: a flat table as it is written down, and the dense arrays that models are compared to."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.special import chdtrc

from rotorjax.arrays import Numbers
from rotorjax.data.given_arrays import (
    as_numbers,
    checked_names,
    checked_orders,
    checked_repeat,
    checked_runs,
    checked_sigma,
    measured_cells,
)
from rotorjax.data.knowledge import Knowledge
from rotorjax.model.conditions import Conditions, Layout
from rotorjax.shown import Shown
from rotorjax.units import DEGREE, MICROMETRE, RPM

COLUMN = {"amplitude_um_0pk": "amplitude_um", "phase_lead_deg": "phase_deg"}
"""Columns of a data frame that state their convention -> those of a table, which a rig file states."""
STATED = {"amplitude_um_0pk": ("amplitude", "peak"), "phase_lead_deg": ("phase", "lead")}
"""What they state."""

if TYPE_CHECKING:
    from rotorjax.data.rig import Rig
    from rotorjax.inference.space import Space
    from rotorjax.model.model import Model

NOISE_ALONE = 0.01
"""Probability of noise alone from which on nothing was measured."""
CLUSTER_WIDTH = 0.02
"""Dwells within 2 % of one another count as one speed: real dwells never repeat to the digit."""


REPEAT_WIDTH = 0.002
"""Repeated readings count as of the same speed within 0.2 %: near a resonance more would pass for noise."""


class Row(NamedTuple):
    """One vibration vector: amplitude zero-to-peak [µm], phase leading [degrees], standard error of Re and Im [µm]."""

    run: str
    speed_rpm: float
    probe: str
    order: float
    amplitude_um: float
    phase_deg: float
    sigma_um: float | None = None
    repeat: str = ""
    sweep_rpm_per_s: float = 0.0
    """Rate at which the speed changed."""


@runtime_checkable
class Calibration(Protocol):
    """What a measurement of the healthy rotor says of vectors measured later."""

    tolerance_of_changes: float
    """Of the model's form, relative to what has changed in a vector."""

    def healthy(self, conditions: Conditions, orders: tuple[float, ...]) -> Complex[np.ndarray, "case probe order"]:
        """What the healthy rotor would show [m]."""
        ...

    def columns(
        self, model: "Model", conditions: Conditions, orders: tuple[float, ...]
    ) -> Float[np.ndarray, "case cell common"]:
        """What one unit of each error that all vectors share does to them where a model is right [m]."""
        ...

    def columns_at(
        self, space: "Space", conditions: Conditions, points: Sequence[Float[np.ndarray, "param"]]
    ) -> list[Float[np.ndarray, "case cell common"]]:
        """The same at several points of a space."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement(Shown):
    """Vibration vectors of a set of runs, dense over case x probe x order, with what was installed in each case."""

    runs: tuple[str, ...]
    probes: tuple[str, ...]
    orders: tuple[float, ...]
    run: Int[np.ndarray, "case"]
    """Index into ``runs``."""
    repeat: tuple[str, ...]
    conditions: Conditions
    vectors: Complex[np.ndarray, "case probe order"]
    """Measured vectors [m]; zero where absent."""
    present: Bool[np.ndarray, "case probe order"]
    sigma: Float[np.ndarray, "case probe order"] | None
    """Standard error of real and of imaginary part [m], where the noise is known."""
    noise: Literal["given", "repeats", "unknown"] = "unknown"
    knowledge: Knowledge = Knowledge()
    notes: tuple[str, ...] = ()
    """What in the rig file or in the table looks like a mistake, one line each."""
    odd_run: int | None = None
    """Index of the run in which something may be other than stated: see `rotorjax.effects.of_one_run`."""
    doubted: Float[np.ndarray, "case probe order"] | None = None
    """Standard error of single readings that may be wrong, beside that of the table [m]; zero of all others."""
    calibration: "Calibration | None" = None

    @classmethod
    def from_arrays(  # noqa: PLR0913
        cls,
        vectors: Numbers,
        conditions: Conditions,
        *,
        run: Numbers | None = None,
        runs: Sequence[str] = ("run",),
        probes: Sequence[str] = ("X", "Y"),
        orders: Numbers = (1.0,),
        sigma: Numbers | None = None,
        repeat: Sequence[str] | None = None,
        knowledge: Knowledge = Knowledge(),
    ) -> "Measurement":
        """A measurement from arrays, or from lists of the same shapes.

        **Arguments:** ``vectors`` [m], zero-to-peak, phase leading; not a number where nothing was measured.
        ``conditions``: speed and what was installed, case by case, the same in all cases of a run; ``run``: index into
        ``runs`` of every case, by default the first; ``sigma`` [m]: standard error of real and of imaginary part, one
        for all or cell by cell, none where the noise is unknown; ``repeat``: labels of repeated readings.
        **Errors.** ``ValueError`` for shapes that do not match, for names and orders that are given twice, for a speed
        that is not positive, for a run with different weights or without a case, for nothing measured, and for a
        ``sigma`` that is not positive where something was measured.
        """
        names = checked_names(runs, "runs"), checked_names(probes, "probes")
        listed = checked_orders(orders)
        z = as_numbers(vectors, "vectors", complex)
        present = measured_cells(z, conditions, len(names[1]), len(listed))
        index = checked_runs(run, names[0], conditions)
        deviation = None if sigma is None else checked_sigma(sigma, present)
        return cls(
            *names, listed, index, checked_repeat(repeat, len(z)), conditions, np.where(present, z, 0.0), present,
            deviation, "unknown" if sigma is None else "given", knowledge,
        )  # fmt: skip

    @classmethod
    def from_pandas(cls, frame: Any, rig: "Rig") -> "Measurement":
        """A measurement from a data frame with the columns of a table, in the conventions of a ``rig``, or with those
        of `to_pandas`, whose names state theirs: ``amplitude_um_0pk``, ``sigma_um`` likewise, and ``phase_lead_deg``.

        **Errors.** `InputError` as for a table; line 2 is the first row of the frame.
        """
        named = {name: stated for name, stated in STATED.items() if name in frame.columns}
        rig = dataclasses.replace(rig, convention=dataclasses.replace(rig.convention, **dict(named.values())))
        text = frame.rename(columns={name: COLUMN[name] for name in named}).to_csv(index=False)
        return rig.measurement_of_text(text, "the data frame")

    def require_layout(self, layout: Layout) -> None:
        """``ValueError`` unless the probes of the measurement are the model's, in the same order, and the weights are
        given for its planes.
        """
        if layout.probes != self.probes:
            raise ValueError(
                f"the model has probes {layout.probes}, the measurement {self.probes}: build both from one rig file"
            )
        layout.require_planes(self.conditions.unbalance.shape[-2])

    @property
    def probes_read(self) -> tuple[str, ...]:
        """Probes with a reading, in the order of the rig file."""
        return tuple(probe for k, probe in enumerate(self.probes) if self.present[:, k].any())

    @property
    def certain(self) -> Bool[np.ndarray, "case probe order"]:
        """Vectors that were measured and are not doubted."""
        return self.present if self.doubted is None else self.present & (self.doubted == 0.0)

    def __repr__(self) -> str:
        orders = ", ".join(f"{order:g}X" for order in self.orders)
        size = f"{int(self.present.sum())} vectors of {self.rms / MICROMETRE:.3g} µm rms"
        return (
            f"Measurement(runs {', '.join(self.runs)}; {len(self.run)} cases; probes {', '.join(self.probes)}; "
            f"{orders}; {size}; noise {self.noise})"
        )

    @property
    def speed_rpm(self) -> Float[np.ndarray, "case"]:
        """Speed of every case."""
        return np.asarray(self.conditions.speed) / RPM

    def steady_rpm(self, cases: Bool[np.ndarray, "case"] | None = None) -> Float[np.ndarray, "speed"]:
        """Speeds that were held while they were measured [rpm]. **Arguments:** ``cases`` that count, by default all."""
        return np.unique(self.speed_rpm[(self.conditions.sweeps == 0.0) & (True if cases is None else cases)])

    @property
    def noise_rms(self) -> float | None:
        """What the rms over all vectors is of noise alone, sqrt(2 mean sigma²) [m]; none where it is unknown."""
        return None if self.sigma is None else float(np.sqrt(2.0 * np.mean(self.sigma[self.present] ** 2)))

    @property
    def rms(self) -> float:
        """Root mean square of |z| over the cells present [m]."""
        return float(np.sqrt(np.mean(np.abs(self.vectors[self.present]) ** 2)))

    @property
    def shows_nothing(self) -> bool:
        """Whether all that was read is zero, or may be noise: more than one in a hundred such tables of noise alone
        have larger vectors.
        """
        if self.rms == 0.0 or self.sigma is None:
            return self.rms == 0.0
        size = np.abs(self.vectors[self.present]) / self.sigma[self.present]
        numbers = 2 * len(size) - np.count_nonzero(self.present[..., np.array(self.orders) == 0.0])
        return bool(chdtrc(numbers, np.sum(size**2)) > NOISE_ALONE)

    def rms_of(self, predicted: Complex[np.ndarray, "case probe order"]) -> float:
        """Root mean square of |measured - predicted| over the cells present, half orders at the sign nearer to the
        prediction [m].
        """
        left = self.vectors * self.half_order_sign(predicted) - predicted
        return float(np.sqrt(np.mean(np.abs(left[self.present]) ** 2)))

    def half_order_sign(self, predicted: Complex[np.ndarray, "case probe order"]) -> Float[np.ndarray, "case 1 order"]:
        """The sign, one per case for all probes, that brings a measured half order nearer to the prediction: a
        once-per-turn reference leaves it open.
        """
        weight = self.present if self.sigma is None else self.weights(0.0)[..., 0] ** 2
        along = np.sum(np.real(self.vectors * np.conj(predicted)) * weight, axis=1, keepdims=True)
        half = np.array([is_half_order(order) for order in self.orders])
        return np.where(half & (along < 0.0), -1.0, 1.0)

    def speed_cluster(self) -> tuple[Int[np.ndarray, "case"], Float[np.ndarray, "speed"]]:
        """Cluster index of every case, and the mean speed of each cluster [rpm]."""
        return cluster_speeds(self.speed_rpm)

    @cached_property
    def form(self) -> Complex[np.ndarray, "case part order"]:
        """`form_of` what was measured."""
        return self.form_of(self.vectors, self.conditions)

    def form_of(
        self, vectors: Complex[np.ndarray, "case probe order"], conditions: Conditions
    ) -> Complex[np.ndarray, "case part order"]:
        """What relative errors of the model's form multiply [m]: the tolerance times the vectors of the probes, and
        beside them, if the healthy rotor is known, the tolerance of changes times what has changed since.
        """
        parts = [self.knowledge.tolerance * vectors]
        if self.calibration is not None:
            change = np.where(vectors != 0.0, vectors - self.calibration.healthy(conditions, self.orders), 0.0)
            parts.append(self.calibration.tolerance_of_changes * change)
        return np.concatenate(parts, axis=1)

    def weights(self, allowance: float) -> Float[np.ndarray, "case probe order 2"]:
        """One over the standard error of real and imaginary part [1/m], zero where nothing was measured.

        The variance is sigma² of the table, the size of `form`, all probes together, squared, and ``allowance``² [m],
        and of readings that may be wrong ``doubted``². At order 0 there is no imaginary part.
        """
        size = np.sqrt(np.sum(np.abs(self.form) ** 2, axis=1, keepdims=True))
        given = np.zeros(self.vectors.shape) if self.sigma is None else self.sigma
        variance = given**2 + size**2 + allowance**2
        variance += 0.0 if self.doubted is None else self.doubted**2
        weight = np.where(self.present, 1.0 / np.sqrt(np.where(variance > 0.0, variance, np.inf)), 0.0)
        both = np.stack([weight, weight], axis=-1)
        both[:, :, np.array(self.orders) == 0.0, 1] = 0.0
        return both


def cluster_speeds(
    speed_rpm: Float[np.ndarray, "case"], *, width: float = CLUSTER_WIDTH
) -> tuple[Int[np.ndarray, "case"], Float[np.ndarray, "speed"]]:
    """Group speeds within a relative ``width`` of the group's lowest.

    **Returns** the index of each one's group, and the groups' mean speeds, rising.
    """
    index = np.zeros(len(speed_rpm), dtype=int)
    groups: list[list[int]] = []
    for case in np.argsort(speed_rpm):
        if not groups or speed_rpm[case] > speed_rpm[groups[-1][0]] * (1.0 + width):
            groups.append([])
        groups[-1].append(int(case))
        index[case] = len(groups) - 1
    return index, np.array([np.mean(speed_rpm[group]) for group in groups])


class Installed(NamedTuple):
    """What was deliberately put on the rotor in one run: unbalance per plane [kg m] and bow [m], as (x, y) pairs."""

    unbalance: Float[np.ndarray, "plane dof"]
    bow: Float[np.ndarray, "dof"]


def arrange(
    rows: list[Row], *, runs: Mapping[str, Installed], probes: tuple[str, ...], knowledge: Knowledge
) -> Measurement:
    """Dense arrays from the rows of a table.

    **Arguments:** ``rows`` without duplicates, runs and probes all known; ``runs`` what is installed in each run;
    ``probes`` in the order of the model. **Returns** the measurement; its cases stand in the order of the rows.
    If no row has a sigma, repeated readings give the pure error; failing those, the noise is unknown.
    """
    used = tuple(dict.fromkeys(row.run for row in rows))
    orders = tuple(sorted({row.order for row in rows}))
    cases: dict[tuple[str, float, str], int] = {}
    for row in rows:
        cases.setdefault((row.run, row.speed_rpm, row.repeat), len(cases))
    shape = (len(cases), len(probes), len(orders))
    vectors, present, sigma = np.zeros(shape, complex), np.zeros(shape, bool), np.full(shape, np.nan)
    sweep = np.zeros(len(cases))
    for row in rows:
        cell = cases[row.run, row.speed_rpm, row.repeat], probes.index(row.probe), orders.index(row.order)
        vectors[cell] = MICROMETRE * row.amplitude_um * np.exp(1j * DEGREE * row.phase_deg)
        present[cell] = True
        sigma[cell] = np.nan if row.sigma_um is None else MICROMETRE * row.sigma_um
        sweep[cell[0]] = row.sweep_rpm_per_s
    conditions = Conditions.at_rpm(
        [speed for _, speed, _ in cases],
        unbalance=np.stack([runs[run].unbalance for run, _, _ in cases]),
        bow=np.stack([runs[run].bow for run, _, _ in cases]),
        sweep_rpm_per_s=sweep if np.any(sweep) else None,
    )
    given = not np.isnan(sigma[present]).any()
    index = np.array([used.index(run) for run, _, _ in cases])
    measurement = Measurement(
        used, probes, orders, index, tuple(repeat for _, _, repeat in cases), conditions, vectors, present,
        np.where(present, sigma, 1.0) if given else None, "given" if given else "unknown", knowledge,
    )  # fmt: skip
    return measurement if given else _with_pure_error(measurement)


def _with_pure_error(measurement: Measurement) -> Measurement:
    """The standard error from repeated readings of the same run, speed, probe and order, pooled over all cells."""
    squares, freedoms = 0.0, 0
    for run in range(len(measurement.runs)):
        cases = np.flatnonzero(measurement.run == run)
        same, _ = cluster_speeds(measurement.speed_rpm[cases], width=REPEAT_WIDTH)
        for group in (cases[same == k] for k in range(same.max() + 1)):
            labels = [measurement.repeat[i] for i in group]
            if len(set(labels)) < len(labels):
                continue
            for cell in np.ndindex(measurement.vectors.shape[1:]):
                values = measurement.vectors[(group, *cell)][measurement.present[(group, *cell)]]
                if len(values) > 1:
                    order = measurement.orders[cell[1]]
                    aligned = values * np.where(
                        is_half_order(order) & (np.real(values * np.conj(values[0])) < 0.0), -1.0, 1.0
                    )
                    squares += float(np.sum(np.abs(aligned - aligned.mean()) ** 2))
                    freedoms += (1 if order == 0.0 else 2) * (len(values) - 1)
    if freedoms == 0 or squares == 0.0:
        return measurement
    sigma = np.full(measurement.vectors.shape, np.sqrt(squares / freedoms))
    return dataclasses.replace(measurement, sigma=sigma, noise="repeats")


def aligned_half_orders(measurement: Measurement) -> Measurement:
    """The same with the signs of half orders, which a once-per-turn reference leaves open, brought into line from case
    to case.

    A fit compares up to that sign anyway; but where signs alternate, a start at zero sees no slope.
    """
    vectors = measurement.vectors.copy()
    for order in (k for k, n in enumerate(measurement.orders) if is_half_order(n)):
        pattern = vectors[:, :, order] @ np.linalg.svd(vectors[:, :, order])[2][0].conj()
        turned = pattern * np.exp(-0.5j * np.angle(np.sum(pattern**2)))
        vectors[:, :, order] *= np.where(turned.real < 0.0, -1.0, 1.0)[:, None]
    return dataclasses.replace(measurement, vectors=vectors)


def is_half_order(order: float) -> bool:
    """Whether a once-per-turn reference leaves the sign of this order open."""
    return abs(order % 1.0 - 0.5) < 1e-6

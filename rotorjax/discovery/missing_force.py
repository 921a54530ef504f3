"""The force that a model lacks, from the measured motion.

Order by order the measured motion is put into the equation of motion: R = D q + N(q) - F is what acts on the rotor
beside the model. `rotorjax.discovery.force_terms` looks for simple terms in it.
"""

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.arrays import require_float64
from rotorjax.data.measurement import Measurement
from rotorjax.discovery.force_shapes import Reach
from rotorjax.inference.force_balance import ForceBalance
from rotorjax.inference.linear_rotor import LinearRotor, ProbeMap
from rotorjax.model.contract import WaveformEffect
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import Grid, grid_of
from rotorjax.physics.steady_state import positions
from rotorjax.units import MICROMETRE

LEAST_SIGHT = 1e-2
"""Least over largest sensitivity of the probes of a case from which on both directions count as seen."""
HELD, STILL = 5.0, 3.0
"""An axis is held if the model moves at least so many times as far along it as measured, and what was measured is at
most so many times the noise.
"""


@dataclasses.dataclass(frozen=True)
class MissingForce:
    """The force R on the rotor beside the model, D q + N(q) = F + R, along the motion that was measured.

    Waveforms hold the measured orders only; what an order without probes does is taken from the linear model.
    """

    model: Model
    """What the force is missing from, at the measured orders."""
    measurement: Measurement
    reason: str | None
    """Why nothing can be said, or none."""
    usable: Bool[np.ndarray, "case"]
    """Cases in which the probes see both directions."""
    angle: Float[np.ndarray, "instant"]
    """Shaft angle over one period [rad]."""
    force: Float[np.ndarray, "case dof instant"]
    """[N], zero in cases that are not usable."""
    force_error: Float[np.ndarray, "case dof instant"]
    """Its standard error [N]; of an assumed 1 µm where the noise is unknown."""
    displacement: Float[np.ndarray, "case dof instant"]
    """[m]; ``velocity`` [m/s]."""
    velocity: Float[np.ndarray, "case dof instant"]
    amplitude: Complex[np.ndarray, "case dof order"]
    """R_n of every order of the measurement: force(φ) = Σ Re[R_n e^{inφ}] [N]."""
    amplitude_error: Float[np.ndarray, "case dof order"]
    """Standard error of its real and imaginary parts [N]."""
    balance: "Balance | None"
    """What a regression works on."""
    held: tuple[int, ...] = ()
    """Axes (0: x, 1: y) along which the rotor hardly moves, though without the force it would: any restraint does that,
    so that the shape is doubtful.
    """

    def __repr__(self) -> str:
        return f"MissingForce({self.reason or f'{float(np.sqrt(np.mean(self.rms[self.usable] ** 2))):.3g} N rms'})"

    @property
    def rms(self) -> Float[np.ndarray, "case"]:
        """Root mean square of the force over a period, x and y together, less what noise adds to it, per case [N]."""
        return np.sqrt(np.maximum(np.mean(np.sum(self.force**2 - self.force_error**2, axis=1), axis=1), 0.0))

    @property
    def reach(self) -> Reach:
        """Largest displacement in the cases that are usable."""
        moves = self.displacement[self.usable]
        x, y, radius = np.abs(moves[:, 0]), np.abs(moves[:, 1]), np.hypot(moves[:, 0], moves[:, 1])
        return Reach(float(np.max(x)), float(np.max(y)), float(np.max(radius)))


class Balance(NamedTuple):
    """The equations of motion at the measured motion, as real numbers: (x, then y) times (mean, then
    Re, Im per order).
    """

    motion: Float[np.ndarray, "case dof coefficient"]
    """At all orders of the grid [m]."""
    measured: Int[np.ndarray, "_"]
    """Coefficients that were measured."""
    error: Float[np.ndarray, "case equation"]
    """R [N]; zero where not usable."""
    slopes: Float[np.ndarray, "case equation equation"]
    """Its derivative by the motion [N/m]; one where not usable."""
    whitening: Float[np.ndarray, "case equation equation"]
    """From the motion [m] to standard errors; zero where not usable."""
    known: bool
    """Whether the standard errors are."""

    @property
    def numbers(self) -> int:
        """Real numbers that were measured."""
        return int(np.count_nonzero(np.any(self.whitening != 0.0, axis=2)))


def missing_force(model: Model, measurement: Measurement, noise_allowance: float = 0.0) -> MissingForce:
    """The force that acts on the rotor beside the model, R = D q + N(q) - F, per case and measured order.

    q is the motion that the measuring chain of the model shows as the vectors measured, exactly where two probes see
    both directions, by least squares where more do; N the model's own restoring force. Its standard error follows from
    that of the vectors through D + dN/dq. Where slow roll was subtracted, that of the linear model is added back.

    **Arguments:** ``model``: the best explanation so far; ``measurement``; ``noise_allowance``: added to the standard
    errors of the table [m]. **Returns** a `MissingForce`, with the reason if nothing can be said.
    **Errors.** ``ValueError`` in single precision, or for a measurement with other probes or planes.
    Source: Mottershead, Friswell 1993, J. Sound Vib. 167:347-375, section 4 (equation error).
    """
    require_float64("missing_force")
    measurement.require_layout(model.layout)
    full = model.with_orders(measurement.orders)
    grid = grid_of(full)
    rotor = LinearRotor(full)
    sight = rotor.sight(measurement.conditions)
    both, usable = _seen(sight, measurement)
    if any(isinstance(e, WaveformEffect) for e in full.effects):
        return _nothing(full, measurement, grid, "a probe that bends the waveform cannot be undone from a few orders")
    if not usable.any():
        return _nothing(
            full,
            measurement,
            grid,
            "only one direction was measured: the force needs the motion along x and along y in the same case",
        )
    motion, whitening, covariance, measured = _motion(
        rotor, measurement, sight, both & usable[:, None], noise_allowance, grid
    )
    forces = ForceBalance(full)
    errors, slopes = (part[0] for part in forces.at(forces.values[None], measurement.conditions, motion, measured))
    used = np.any(whitening != 0.0, axis=2)
    balance = Balance(
        motion, measured, np.where(used, errors, 0.0),
        np.where(used[:, :, None] & used[:, None], slopes, np.eye(used.shape[1])[None]), whitening,
        measurement.sigma is not None or measurement.knowledge.tolerance > 0.0 or noise_allowance > 0.0,
    )  # fmt: skip
    shown = _shown(full, measurement, grid, balance, covariance, sight.speed)
    return dataclasses.replace(shown, held=_held(balance, covariance, sight.free))


def _seen(sight: ProbeMap, measurement: Measurement) -> tuple[Bool[np.ndarray, "case order"], Bool[np.ndarray, "case"]]:
    """Which orders the probes see in both directions, and the cases with such orders and none seen in one direction
    only.
    """
    present = np.swapaxes(measurement.present, 1, 2)
    size = np.linalg.svd(sight.along * present[..., None], compute_uv=False)
    both = np.asarray(size[..., -1] > LEAST_SIGHT * np.maximum(size[..., 0], 1e-12)) & (size.shape[-1] == 2)
    partly = present.any(axis=2) & ~both
    return both, both.any(axis=1) & ~partly.any(axis=1)


def _motion(
    rotor: LinearRotor,
    measurement: Measurement,
    sight: ProbeMap,
    seen: Bool[np.ndarray, "case order"],
    allowance: float,
    grid: Grid,
) -> tuple[
    Float[np.ndarray, "case dof coefficient"],
    Float[np.ndarray, "case equation equation"],
    Float[np.ndarray, "case equation equation"],
    np.ndarray,
]:
    """The measured motion [m], the whitening and the covariance of its measured coefficients, and which these are."""
    at = measurement.conditions
    shown = measurement.vectors + rotor.at_slow_roll(at) - rotor.added_by_sweep(at)
    weight = measurement.weights(allowance)[..., 0]
    weight = np.swapaxes(np.where(measurement.present, np.where(weight > 0.0, weight, 1.0 / MICROMETRE), 0.0), 1, 2)
    weight = weight * np.abs(sight.turn)[..., None]
    miss = np.swapaxes(shown, 1, 2) / sight.turn[..., None] - sight.rest
    sees = sight.along
    real = np.array(measurement.orders) == 0.0
    along = np.where(real[None, :, None, None], np.real(sees), sees)
    inverse = np.linalg.pinv(along * weight[..., None])
    disk = np.einsum("cnip,cnp->cni", inverse, weight * np.where(real[None, :, None], miss.real, miss))
    positions = _positions(grid, measurement.orders)
    measured = np.concatenate(positions)
    motion = sight.free.copy()
    covariance = np.zeros((len(motion), 2, len(measured), 2, len(measured)))
    used = np.zeros((len(motion), 2, len(measured)), bool)
    start = 0
    for order, place in enumerate(positions):
        here = seen[:, order]
        parts = np.stack([disk[:, order].real, disk[:, order].imag], axis=-1)[..., : len(place)]
        motion[:, :, place] = np.where(here[:, None, None], parts, motion[:, :, place])
        p = inverse[:, order]
        whole = np.stack([np.stack([p.real, -p.imag], axis=-1), np.stack([p.imag, p.real], axis=-1)], axis=2)[
            :, :, : len(place), :, : len(place)
        ]
        block = slice(start, start + len(place))
        covariance[:, :, block, :, block] = (
            np.einsum("cikpl,cjmpl->cikjm", whole, whole) * here[:, None, None, None, None]
        )
        used[:, :, block] = here[:, None, None]
        start += len(place)
    flat, used = covariance.reshape(len(motion), 2 * len(measured), -1), used.reshape(len(motion), -1)
    filled = flat + np.where(used, 0.0, 1.0)[:, :, None] * np.eye(flat.shape[1])[None]
    whitening = np.linalg.inv(np.linalg.cholesky(filled)) * used[:, :, None] * used[:, None]
    return motion, whitening, flat, measured


def _positions(grid: Grid, orders: tuple[float, ...]) -> list[np.ndarray]:
    """Coefficients of each order: the mean has one, the others two."""
    return [np.array([0]) if k == 0 else np.array([2 * k - 1, 2 * k]) for k in positions(orders, grid)]


def _shown(
    model: Model,
    measurement: Measurement,
    grid: Grid,
    balance: Balance,
    covariance: np.ndarray,
    speed: Float[np.ndarray, "case"],
) -> MissingForce:
    """Waveforms and amplitudes, with their standard errors."""
    cases, width = len(balance.motion), len(balance.measured)
    spread = (balance.slopes @ covariance @ np.swapaxes(balance.slopes, 1, 2)).reshape(cases, 2, width, 2, width)
    own = np.stack([spread[:, k, :, k] for k in range(2)], axis=1)
    error = balance.error.reshape(cases, 2, width)
    synthesis, rate = grid.synthesis(grid.angle), grid.slope(grid.angle)
    waves = synthesis[balance.measured]
    variance = np.einsum("cdij,is,js->cds", own, waves, waves)
    ends = itertools.pairwise(np.cumsum([0, *(len(place) for place in _positions(grid, measurement.orders))]))
    blocks = [range(a, b) for a, b in ends]
    amplitudes = np.stack(
        [error[..., block[0]] + (1j * error[..., block[1]] if len(block) > 1 else 0j) for block in blocks], axis=-1
    )
    deviations = np.stack([np.sqrt(np.mean([own[..., k, k] for k in block], axis=0)) for block in blocks], axis=-1)
    force, moves = error @ waves, balance.motion @ synthesis
    velocity = speed[:, None, None] * (balance.motion @ rate)
    usable = np.any(balance.whitening != 0.0, axis=(1, 2))
    band = np.sqrt(np.maximum(variance, 0.0))
    return MissingForce(
        model, measurement, None, usable, grid.angle, force, band, moves, velocity, amplitudes, deviations, balance
    )


def _held(balance: Balance, covariance: np.ndarray, free: Float[np.ndarray, "case dof coefficient"]) -> tuple[int, ...]:
    """See `MissingForce.held`; the mean does not count."""
    if not balance.known:
        return ()
    vibrates = balance.measured != 0
    used = np.any(balance.whitening != 0.0, axis=2).reshape(len(free), 2, -1)[..., vibrates]
    squares = [
        (part[..., balance.measured][..., vibrates] ** 2 * used).sum(axis=(0, 2)) for part in (balance.motion, free)
    ]
    noise = (np.diagonal(covariance, axis1=1, axis2=2).reshape(len(free), 2, -1)[..., vibrates] * used).sum(axis=(0, 2))
    return tuple(
        k for k in (0, 1) if squares[0][k] <= STILL**2 * noise[k] and squares[1][k] >= HELD**2 * squares[0][k] > 0.0
    )


def _nothing(model: Model, measurement: Measurement, grid: Grid, reason: str) -> MissingForce:
    cases = len(measurement.run)
    wave, part = np.zeros((cases, 2, len(grid.angle))), np.zeros((cases, 2, len(measurement.orders)))
    return MissingForce(
        model,
        measurement,
        reason,
        np.zeros(cases, bool),
        grid.angle,
        wave,
        wave,
        wave,
        wave,
        part.astype(complex),
        part,
        None,
    )

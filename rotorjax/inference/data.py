"""A measurement in units of its noise, what to leave out of it, and where descents begin."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from rotorjax.arrays import numpy_pair
from rotorjax.data.measurement import Measurement, is_half_order
from rotorjax.inference.covariance import Noise, common_errors
from rotorjax.inference.space import Space
from rotorjax.model.model import Model

MOST_STARTS = 8
"""Of one fit."""
MAX_FOLDS, LEAST_RUN_FOLDS = 5, 4


class Data(NamedTuple):
    """A measurement in units of its noise."""

    speed: Float[np.ndarray, "case"]
    """[rad/s], with what is installed: see `rotorjax.model.Conditions`."""
    unbalance: Float[np.ndarray, "case plane dof"]
    bow: Float[np.ndarray, "case dof"]
    sweep: Float[np.ndarray, "case"]
    pairs: Float[np.ndarray, "case probe order 2"]
    weight: Float[np.ndarray, "case probe order 2"]
    half_order: Bool[np.ndarray, "order"]
    run: Int[np.ndarray, "case"]
    common: Float[np.ndarray, "case cell common"]
    """What the errors of several vectors have in common: see `rotorjax.inference.covariance`."""
    odd: Bool[np.ndarray, "case"]
    """Whether a case is of the run in which something may be other than stated."""

    felt_otherwise: bool = False
    """Whether every hypothesis feels the errors in common otherwise, as it does what a calibration leaves open."""

    @property
    def half_log_determinant(self) -> float:
        """Half the logarithm of the determinant of the covariance of all errors, in standard errors."""
        common = self.common.reshape(self.pairs.size, self.common.shape[-1])
        return 0.5 * float(np.linalg.slogdet(np.eye(common.shape[1]) + common.T @ common)[1])

    @property
    def spread(self) -> float:
        """The same where it differs between hypotheses, as every one feels the errors otherwise; else zero."""
        return self.half_log_determinant if self.felt_otherwise else 0.0


def make_data(
    measurement: Measurement,
    model: Model,
    noise: Noise,
    calibrated: Float[np.ndarray, "case cell common"] | None = None,
) -> Data:
    """A measurement in units of its noise.

    **Arguments:** ``model``: where the sensitivity to what is random in a run is taken; ``noise``: what to
    add to the table's; ``calibrated``: as in `rotorjax.inference.covariance.OfRuns.of`.
    """
    weight = measurement.weights(noise.allowance)
    at = measurement.conditions
    return Data(
        np.asarray(at.speed), np.asarray(at.unbalance), np.asarray(at.bow), at.sweeps,
        numpy_pair(measurement.vectors), weight,
        np.array([is_half_order(order) for order in measurement.orders]), measurement.run,
        common_errors(measurement, model, noise, calibrated=calibrated),
        np.zeros(len(measurement.run), bool) if measurement.odd_run is None else measurement.run == measurement.odd_run,
        measurement.calibration is not None,
    )  # fmt: skip


def largest_displacement(model: Model, measurement: Measurement) -> float:
    """Of the disk, all orders of a case and both directions added up, at least 1e-9 [m]: what a probe shows over its
    participation and the scale of the table.
    """
    per_displacement = np.abs(float(model.probes.scale) * np.asarray(model.probes.participation))
    seen = per_displacement > 0.0
    of_disk = np.sum(np.abs(measurement.vectors), axis=2)[:, seen] / per_displacement[seen]
    return max(float(np.max(np.linalg.norm(of_disk, axis=1), initial=0.0)), 1e-9)


def declared_starts(
    space: Space, free: Bool[np.ndarray, "param"], measurement: Measurement
) -> Float[np.ndarray, "start param"]:
    """Where to begin: the values given, every start that a free effect declares, then combinations, at most
    `MOST_STARTS`.

    Some are relative to the largest displacement of the disk; the sag under the weight comes on top where order 0 was
    not measured.
    """
    reach = largest_displacement(space.model, measurement)
    names = {e.effect for e in space.entries if free[e.unknown]}
    if 0.0 not in space.model.layout.orders:
        rotor = space.model.rotor
        reach += float(rotor.mass) * float(np.hypot(*np.asarray(rotor.gravity)) / np.mean(np.asarray(rotor.stiffness)))
    options = []
    for effect in space.model.effects:
        if effect.name in names:
            entries = {e.parameter: e for e in space.entries if e.effect == effect.name}
            unit = {name: 1.0 / (reach * entries[name].scale) for name in type(effect).over_amplitude}
            options.append(
                [
                    {entries[name].unknown: value * unit.get(name, 1.0) for name, value in start.items()}
                    for start in type(effect).starts
                ]
            )
    first = [chosen[0] for chosen in options]
    singly = [[*first[:k], other, *first[k + 1 :]] for k, chosen in enumerate(options) for other in chosen[1:]]
    given = np.where(free, space.given_unknowns(), 0.0)
    starts = [given] if np.any(given) else []
    for combination in itertools.chain([first], singly, itertools.product(*options)):
        start = np.zeros(len(space.entries))
        for unknown, value in ((u, v) for chosen in combination for u, v in chosen.items()):
            start[unknown] = value
        if not any(np.array_equal(start, other) for other in starts):
            starts.append(start)
        if len(starts) == MOST_STARTS:
            break
    return np.stack(starts)


def make_folds(
    measurement: Measurement, information: Float[np.ndarray, "case param param"]
) -> tuple[Bool[np.ndarray, "fold case"], str]:
    """Cases to leave out together: whole runs if there are enough of them, else groups of speeds.

    A split is honest only if every training fold determines all that the whole data determine: leaving out the one run
    with a weight in a plane would condemn what only that run shows. **Arguments:** ``information``: of every case on
    the free unknowns. **Returns** one mask per fold, none with the reason where no honest split exists.
    """
    cluster, speeds = measurement.speed_cluster()
    whole = _rank(np.sum(information, axis=0))
    taken, run = np.unique(measurement.run, return_inverse=True)
    for label, count, least in ((run, len(taken), LEAST_RUN_FOLDS), (cluster, len(speeds), 3)):
        if count >= least:
            fold = label % min(MAX_FOLDS, count)
            folds = np.stack([fold == k for k in range(min(MAX_FOLDS, count))])
            if all(_rank(np.sum(information[~left_out], axis=0)) == whole for left_out in folds):
                return folds, ""
    runs = "1 run" if len(taken) == 1 else f"{len(taken)} runs"
    at = "1 speed" if len(speeds) == 1 else f"{len(speeds)} speeds"
    reason = (
        f"{runs} at {at} leave no part of the data out of which the rest could be predicted: take four runs or three "
        "speeds that each show all"
    )
    return np.zeros((0, len(measurement.run)), bool), reason


def _rank(information: Float[np.ndarray, "param param"]) -> int:
    """Number of directions in which the curvature of the data is more than a hundredth of the prior's."""
    return int(np.count_nonzero(np.linalg.eigvalsh(information) > 1e-2)) if len(information) else 0


def half_order_sign(
    model: Float[np.ndarray, "case probe order 2"],
    measured: Float[np.ndarray, "case probe order 2"],
    weight: Float[np.ndarray, "case probe order 2"],
    half_order: Bool[np.ndarray, "order"],
) -> Float[np.ndarray, "case 1 order 1"]:
    """The sign, one per case, that brings a measured half order nearer to the model; one for whole orders."""
    along = np.sum(weight**2 * model * measured, axis=(1, 3), keepdims=True)
    return np.where(half_order[None, None, :, None] & (along < 0.0), -1.0, 1.0)


def residual_vectors(error: Float[np.ndarray, "case cell"], data: Data) -> Complex[np.ndarray, "case probe order"]:
    """Model minus measured [m] from the residual in standard errors, zero where nothing was measured."""
    weight = data.weight
    pairs = np.divide(error.reshape(weight.shape), weight, out=np.zeros(weight.shape), where=weight > 0.0)
    return pairs[..., 0] + 1j * pairs[..., 1]

"""Training data: fault cases drawn from a prior, the features they cause at one speed.

A case is f = J(Ω) m with the fault m = (U_x, U_y, s_x, s_y) and the map J of `rotorjax.diagnosis.features`; U and s are
uniform up to the prior's largest, both angles uniform over the circle. Source: Huang et al. 2026, Sensors 26:2565,
section 2.2.
"""

import dataclasses
import functools
import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

from rotorjax.arrays import AnyArray, require_float64
from rotorjax.diagnosis.features import feature_map
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import GRAM_MILLIMETRE

LARGEST_AMPLIFICATION = 1e10
"""Of bow into features. 1/(1 - τ²) loses a digit for each power of ten: beyond this it is a pole met but for rounding.
"""
SUM_TOLERANCE = 1e-9
"""What the sum of a split's fractions may miss one by: they are decimal numbers rounded to binary."""


@dataclasses.dataclass(frozen=True)
class FaultPrior:
    """Faults uniform in magnitude up to a largest one, and over all angles; the paper's by default.

    **Fields:** ``largest_unbalance_kg_m`` [kg m], 1000 g mm by default; ``largest_bow_m`` [m], 50 mm by default.
    **Errors.** ``ValueError`` for one that is negative or not finite, or both zero.
    Source: Huang et al. 2026, Sensors 26:2565, section 2.2.
    """

    largest_unbalance_kg_m: float = 1000 * GRAM_MILLIMETRE
    largest_bow_m: float = 0.05

    def __post_init__(self) -> None:
        sizes = (self.largest_unbalance_kg_m, self.largest_bow_m)
        if not (all(math.isfinite(size) and size >= 0.0 for size in sizes) and max(sizes) > 0.0):
            raise ValueError(
                "the largest unbalance [kg m] and bow [m] must be finite and not negative, and one of them positive, "
                f"but are {sizes[0]:g} and {sizes[1]:g}; "
                "give zero for the one that is absent"
            )


class Dataset(NamedTuple):
    """Cases: ``features`` (f1, f2, f3, f4) [m], and ``faults`` (U_x, U_y [kg m], s_x, s_y [m]) that cause them."""

    features: Float[AnyArray, "sample 4"]
    faults: Float[AnyArray, "sample 4"]


class Split(NamedTuple):
    """Disjoint parts of a dataset that together are all of it."""

    train: Dataset
    validation: Dataset
    test: Dataset


def check_wanted(speed_rpm: float, count: int) -> None:
    """``ValueError`` for a count of cases below one, or a speed that is not positive."""
    if count < 1:
        raise ValueError(f"count is {count}: a dataset has at least one case; give a positive count")
    if not (math.isfinite(speed_rpm) and speed_rpm > 0.0):
        raise ValueError(
            f"speed_rpm is {speed_rpm:g}: it must be positive and finite; for the other sense of rotation build the "
            "rotor with rotation='y-to-x'"
        )


def _fault(draw: Float[Array, "4"], largest: Float[Array, "2"]) -> Float[Array, "4"]:
    """One case: four numbers uniform over [0, 1) -> (U_x, U_y, s_x, s_y)."""
    size, angle = largest * draw[:2], 2.0 * jnp.pi * draw[2:]
    return jnp.stack([size * jnp.cos(angle), size * jnp.sin(angle)], axis=1).reshape(4)


@functools.partial(jax.jit, static_argnames="count")
def _faults(key: Key[Array, ""], largest: Float[Array, "2"], count: int) -> Float[Array, "sample 4"]:
    return jax.vmap(lambda draw: _fault(draw, largest))(jax.random.uniform(key, (count, 4)))


@functools.partial(jax.jit, static_argnames="count")
def _cases(key: Key[Array, ""], largest: Float[Array, "2"], linear: Float[Array, "4 4"], count: int) -> Dataset:
    def case(draw: Float[Array, "4"]) -> Dataset:
        fault = _fault(draw, largest)
        return Dataset(linear @ fault, fault)

    return jax.vmap(case)(jax.random.uniform(key, (count, 4)))


def _largest(prior: FaultPrior) -> Float[Array, "2"]:
    return jnp.array([prior.largest_unbalance_kg_m, prior.largest_bow_m])


class CaseSampler(NamedTuple):
    """Draws cases of one rotor at one speed."""

    largest: Float[Array, "2"]
    """Unbalance [kg m] and bow [m]."""
    linear: Float[Array, "4 4"]
    """J: finite here, the features of every case are."""

    @classmethod
    def of(cls, rotor: Jeffcott, speed_rpm: float, prior: FaultPrior) -> "CaseSampler":
        """**Errors.** ``ValueError`` for an undamped rotor at a critical speed."""
        linear = feature_map(rotor, speed_rpm)[0]
        if not (np.all(np.isfinite(linear)) and np.max(np.abs(linear[:, 2:])) < LARGEST_AMPLIFICATION):
            raise ValueError(
                f"the features at {speed_rpm:g} rpm are not finite: an undamped rotor has no steady state at its "
                f"critical speeds ({', '.join(f'{float(speed):g}' for speed in rotor.critical_speeds_rpm())} rpm); "
                "give a damping ratio above zero or another speed"
            )
        return cls(_largest(prior), jnp.asarray(linear))

    def draw(self, key: Key[Array, ""], count: int) -> Dataset:
        """So many cases."""
        return _cases(key, self.largest, self.linear, count)


def sample_faults(key: Key[Array, ""], count: int, prior: FaultPrior = FaultPrior()) -> Float[Array, "sample 4"]:
    """Faults drawn from the prior.

    U = U_max a, s = s_max b, α = 2πc, θ = 2πd with a, b, c, d uniform over [0, 1).

    **Arguments:** ``key`` of JAX; ``count`` of faults; ``prior``. **Returns** (U cos α, U sin α) [kg m] and
    (s cos θ, s sin θ) [m], shape (sample, 4).
    **Errors.** ``ValueError`` for a count below one, or in single precision.
    Source: Huang et al. 2026, Sensors 26:2565, section 2.2.
    """
    require_float64("a dataset")
    check_wanted(1.0, count)
    return _faults(key, _largest(prior), count)


def make_dataset(
    rotor: Jeffcott, speed_rpm: float, count: int, *, key: Key[Array, ""], prior: FaultPrior = FaultPrior()
) -> Dataset:
    """Fault cases drawn from the prior, with their features at one speed.

    f = J(Ω) m for every m of ``sample_faults(key, count, prior)``. J is the response to four unit faults: the features
    are linear in the fault, so that a case costs a 4x4 product and not a response.

    **Arguments:** ``rotor``; ``speed_rpm`` [rpm]; ``count`` of cases; ``key`` of JAX; ``prior`` of the faults.
    **Returns** a `Dataset`.
    **Errors.** ``ValueError`` for a count below one, a speed that is not positive, an undamped rotor at a critical
    speed, or in single precision. A map that cannot be inverted (equal axes) is no error: the features are right, the
    faults behind them ambiguous. Source: Huang et al. 2026, Sensors 26:2565, equations 1-14 and section 2.2.
    """
    require_float64("a dataset")
    check_wanted(speed_rpm, count)
    return CaseSampler.of(rotor, speed_rpm, prior).draw(key, count)


def with_noise(dataset: Dataset, key: Key[Array, ""], level: float) -> Dataset:
    """The same cases with Gaussian noise on their features.

    f_i + level h_i ε, ε ~ N(0, 1) independent, h_i = (max f_i - min f_i) / 2 over the dataset's cases.

    **Arguments:** ``dataset``; ``key`` of JAX; ``level`` [1] of each feature's half range. **Returns** a `Dataset` with
    the same faults.
    **Errors.** ``ValueError`` for a level that is negative or not finite, or in single precision.
    """
    require_float64("a dataset")
    if not (math.isfinite(level) and level >= 0.0):
        raise ValueError(
            f"the level of noise is {level:g}: it must be finite and not negative; give a fraction of the half range, "
            "like 0.01"
        )
    features = jnp.asarray(dataset.features)
    half_range = 0.5 * (jnp.max(features, axis=0) - jnp.min(features, axis=0))
    return Dataset(features + level * half_range[None, :] * jax.random.normal(key, features.shape), dataset.faults)


def split(
    dataset: Dataset, *, key: Key[Array, ""], fractions: tuple[float, float, float] = (0.70, 0.15, 0.15)
) -> Split:
    """A dataset in random order, cut into training, validation and test cases.

    **Arguments:** ``dataset``; ``key`` of JAX; ``fractions`` of the cases, to the nearest whole case. **Returns** a
    `Split`.
    **Errors.** ``ValueError`` for fractions that are negative or do not add up to one, or a part that would be left
    without a case.
    """
    if not (all(fraction >= 0.0 for fraction in fractions) and abs(sum(fractions) - 1.0) < SUM_TOLERANCE):
        raise ValueError(
            f"the fractions of a split must not be negative and must add up to one, but are {fractions}; the paper's "
            "are (0.70, 0.15, 0.15)"
        )
    count = len(dataset.features)
    ends = [0, round(count * fractions[0]), round(count * (fractions[0] + fractions[1])), count]
    if any(
        fraction > 0.0 and end == start
        for fraction, (start, end) in zip(fractions, itertools.pairwise(ends), strict=True)
    ):
        raise ValueError(
            f"a part of the split {fractions} of {count} cases is empty; make more cases, or give its fraction as zero"
        )
    order = np.asarray(jax.random.permutation(key, count))
    parts = [order[start:end] for start, end in itertools.pairwise(ends)]
    return Split(*(Dataset(dataset.features[part], dataset.faults[part]) for part in parts))

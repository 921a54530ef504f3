"""Inherent faults and what to do about them: self-compensation as root finding, IFbC, IFC, and a complex gain.

The rotor is not healthy before anything is installed. Of a case with known (induced) faults m and measured features f,
the inherent fault Δ is what makes inverse(f - J Δ) = m; other cases are then diagnosed from f less the inherent
features (IFbC), or their diagnosis less the inherent faults (IFC). Source: Huang et al. 2026, Sensors 26:2565,
section 3. An error of gain and phase in the chain is compensated by dividing by a complex ratio instead.

``inverse`` is any function of one case's features that JAX can trace: a `FaultNetwork`, the `LinearInverse`, one's own.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array
from jaxtyping import Bool, Float

from rotorjax.arrays import AnyArray, Numbers, as_float, require_float64
from rotorjax.diagnosis.features import checked_features, fault_table, inverse_map
from rotorjax.model.rotor import Jeffcott

Inverse = Callable[[Float[Array, "feature"]], Float[Array, "target"]]

RELATIVE = 1e-10
"""Change of the correction, relative to the fault's size, at which root finding ends."""
MOST_STEPS = 30


class LinearInverse(eqx.Module):
    """The least-squares inverse of one speed as a function of features: m = inverse @ f."""

    matrix: Float[Array, "target feature"] = eqx.field(converter=as_float)

    def diagnose(self, features: Float[AnyArray, "*case cell"]) -> Float[np.ndarray, "*case 4"]:
        """Faults [kg m, kg m, m, m] of many cases, from the features of each speed in turn [m].

        **Errors.** ``ValueError`` for features that are not finite, or not as many to a case as the inverse takes.
        """
        return checked_features(features, self.matrix.shape[1]) @ np.asarray(self.matrix).T

    @classmethod
    def at(cls, rotor: Jeffcott, speed_rpm: Numbers) -> "LinearInverse":
        """Of a rotor at a speed, or at several jointly. **Errors.** ``ValueError`` where the map is singular (equal
        axes).
        """
        return cls(inverse_map(rotor, speed_rpm))

    def __call__(self, features: Float[Array, "feature"]) -> Float[Array, "target"]:
        """Faults of one case."""
        return self.matrix @ features


class Compensation(NamedTuple):
    """Inherent faults of one case, and the way there."""

    faults: Float[np.ndarray, "4"]
    """Δ [kg m, kg m, m, m]."""
    features: Float[np.ndarray, "4"]
    """J Δ [m]."""
    steps: int
    converged: bool
    errors: Float[np.ndarray, "step target"]
    """Relative error of each fault value (U, α, s, θ) at the start and after every step: magnitudes in themselves,
    angles in 90°.
    """


def sizes(faults: Float[AnyArray, "4"]) -> Float[np.ndarray, "4"]:
    """What a fault's components are measured in: the magnitude of its unbalance twice, and of its bow twice."""
    m = np.asarray(faults)
    return np.repeat([np.hypot(m[0], m[1]), np.hypot(m[2], m[3])], 2)


def value_errors(
    found: Float[AnyArray, "*case 4"], induced: Float[AnyArray, "*case 4"]
) -> Float[np.ndarray, "*case 4"]:
    """(U %, α °, s %, θ °): magnitudes relative to the induced ones, angles by the shorter way round; not negative.

    **Arguments:** faults (..., 4) [kg m, kg m, m, m]. **Errors.** ``ValueError`` where nothing was induced.
    """
    if not np.all(np.abs(_rotating(induced)) > 0.0):
        raise ValueError(
            "a case has no induced unbalance or no induced bow: an error relative to nothing says nothing; leave that "
            "case out"
        )
    got, true = fault_table(found), fault_table(induced)
    turned = np.abs((got - true + 180.0) % 360.0 - 180.0)
    share = 100.0 * np.abs(got[..., ::2] / true[..., ::2] - 1.0)
    return np.stack([share[..., 0], turned[..., 1], share[..., 1], turned[..., 3]], axis=-1)


def _checked(features: AnyArray, induced: AnyArray, jacobian: AnyArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    require_float64("compensation")
    f, m, j = checked_features(features), np.asarray(induced, float), np.asarray(jacobian, float)
    if f.shape != (4,) or m.shape != (4,) or j.shape != (4, 4):
        raise ValueError(
            f"features {f.shape}, induced faults {m.shape} and map {j.shape}: give one case at one speed, shapes (4,), "
            "(4,) and (4, 4)"
        )
    if not np.all(np.isfinite(m)) or not np.all(np.isfinite(j)):
        raise ValueError("the induced faults and the map must be finite numbers")
    if not np.all(sizes(m) > 0.0):
        raise ValueError(
            "the induced unbalance and bow must not be zero: without them nothing says how large an error is"
        )
    return f, m, j


def inherent_fault(inverse: Inverse, features: AnyArray, induced: AnyArray, jacobian: AnyArray) -> Compensation:
    """Δ with inverse(f - J Δ) = m, by Newton's method (`optimistix.Newton`).

    **Arguments:** ``inverse``: features [m] -> faults, differentiable; ``features`` [m] and ``induced`` faults
    [kg m, m] of one case, both (4,); ``jacobian`` J (4, 4), from `features.feature_map`. **Returns** a `Compensation`
    with the error after every step. **Errors.** ``ValueError`` for other shapes or numbers that are not finite.
    """
    f, m, j = _checked(features, induced, jacobian)
    _apply(inverse, f[None])
    scale, shift = sizes(m), np.zeros(4)
    shifts, converged = [shift], False
    while not converged and len(shifts) <= MOST_STEPS:
        moved, converged = _newton_step(inverse, f, m, j, scale, shift)
        shift, converged = np.asarray(moved), bool(converged)
        if not np.all(np.isfinite(shift)):
            raise ValueError(
                "the inverse does not answer to the features (its slope is singular): there is no inherent fault to "
                "find through it"
            )
        shifts.append(shift)
    found = scale * shift
    return Compensation(
        found, j @ found, len(shifts) - 1, converged, _errors_along(inverse, f, m, j, [scale * s for s in shifts])
    )


@eqx.filter_jit
def _newton_step(
    inverse: Inverse, f: AnyArray, m: AnyArray, j: AnyArray, scale: AnyArray, shift: AnyArray
) -> tuple[Float[Array, "target"], Bool[Array, ""]]:
    """One step of Newton's method, which remembers nothing from step to step; and whether it was the
    last one needed.
    """

    def residual(now: Array, _: None) -> Array:
        return (inverse(jnp.asarray(f - j @ (scale * now))) - m) / scale

    found = optx.root_find(
        residual, optx.Newton(rtol=RELATIVE, atol=RELATIVE), jnp.asarray(shift), max_steps=1, throw=False
    )
    return found.value, found.result == optx.RESULTS.successful


def incremental(
    inverse: Inverse,
    features: AnyArray,
    induced: AnyArray,
    jacobian: AnyArray,
    *,
    fraction: float,
    tolerance: float = 1e-3,
    most_steps: int = 1000,
) -> Compensation:
    """The paper's loop (figure 8): at every iteration a fraction of the feature correction still missing is added to
    the inherent features.

    **Arguments:** as for `inherent_fault`; ``fraction`` of the correction, above 0 and at most 1; ``tolerance``:
    relative error of all four values at which it ends (0.1 % in the paper); ``most_steps``. **Returns** a
    `Compensation`. **Errors.** ``ValueError`` as there.
    """
    f, m, j = _checked(features, induced, jacobian)
    if not 0.0 < fraction <= 1.0:
        raise ValueError(f"fraction is {fraction:g}: it must be above 0, and at most 1")
    shift, shifts = np.zeros(4), [np.zeros(4)]
    converged = False
    for _ in range(most_steps):
        now = _apply(inverse, (f - j @ shift)[None])[0]
        if converged := bool(np.all(_relative(now, m) < tolerance)):
            break
        shift = shift + fraction * (now - m)
        shifts.append(shift)
    return Compensation(shift, j @ shift, len(shifts) - 1, converged, _errors_along(inverse, f, m, j, shifts))


def _relative(found: np.ndarray, induced: np.ndarray) -> np.ndarray:
    """Errors of (U, α, s, θ) as shares: of the magnitude, and of a right angle."""
    return value_errors(found, np.broadcast_to(induced, found.shape)) / np.array([100.0, 90.0, 100.0, 90.0])


def _errors_along(
    inverse: Inverse, f: np.ndarray, m: np.ndarray, j: np.ndarray, shifts: list[np.ndarray]
) -> np.ndarray:
    return _relative(_apply(inverse, f - np.stack(shifts) @ j.T), m)


def _apply(inverse: Inverse, features: AnyArray) -> Float[np.ndarray, "case 4"]:
    require_float64("compensation")
    try:
        found = np.asarray(_many(inverse, jnp.asarray(features)))
    except jax.errors.TracerArrayConversionError as error:
        raise ValueError(
            "the inverse computes with NumPy: write it with jax.numpy, or hand over the LinearInverse or FaultNetwork "
            "itself, not its diagnose"
        ) from error
    if found.shape != (len(features), 4):
        raise ValueError(f"the inverse gives {found.shape[1:]} numbers a case: it must give (U_x, U_y, s_x, s_y)")
    return found


@eqx.filter_jit
def _many(inverse: Inverse, features: Float[Array, "case feature"]) -> Float[Array, "case target"]:
    return jax.vmap(inverse)(features)


class Inherent(NamedTuple):
    """Inherent faults of several cases at one speed, to be averaged; of one case: ``Inherent(found.faults[None],
    found.features[None])``.
    """

    faults: Float[np.ndarray, "case 4"]
    features: Float[np.ndarray, "case 4"]

    def without(self, case: int) -> "Inherent":
        """All cases but one."""
        return Inherent(np.delete(self.faults, case, axis=0), np.delete(self.features, case, axis=0))


Average = Literal["components", "circular", "arithmetic"]
"""How to average faults: their components; magnitudes and angles apart, angles on the circle; or angles as the paper
does, as numbers.
"""


def average_fault(faults: Float[AnyArray, "case 4"], how: Average = "components") -> Float[np.ndarray, "4"]:
    """Mean of faults (case, 4) [kg m, kg m, m, m].

    "components" averages those, and is the only one that is linear; "circular" and "arithmetic" average magnitude and
    angle apart, the latter as numbers, so that it depends on where the circle is cut (at 0° here).
    """
    if how not in get_args(Average):
        raise ValueError(f"cannot average {how!r}: choose {', '.join(get_args(Average))}")
    m = np.asarray(faults)
    if how == "components":
        return np.mean(m, axis=0)
    found = []
    for pair in (m[:, :2], m[:, 2:]):
        z = pair[:, 0] + 1j * pair[:, 1]
        angles = np.angle(z) % (2.0 * np.pi)
        angle = np.mean(angles) if how == "arithmetic" else np.angle(np.mean(np.exp(1j * angles)))
        found += [np.mean(np.abs(z)) * np.cos(angle), np.mean(np.abs(z)) * np.sin(angle)]
    return np.array(found)


def ifbc(inverse: Inverse, features: Float[AnyArray, "case 4"], inherent: Inherent) -> Float[np.ndarray, "case 4"]:
    """Inherent feature-based compensation: inverse(f - mean inherent features).

    **Arguments:** ``features`` (case, 4) [m]. **Returns** faults (case, 4) [kg m, kg m, m, m]. **Errors.**
    ``ValueError`` in single precision, or for features that are not finite. Source: Huang et al. 2026, Sensors 26:2565,
    section 3.
    """
    return _apply(inverse, _cases(features, inherent) - np.mean(inherent.features, axis=0))


def ifc(
    inverse: Inverse, features: Float[AnyArray, "case 4"], inherent: Inherent, how: Average = "components"
) -> Float[np.ndarray, "case 4"]:
    """Inherent fault compensation: inverse(f) - mean inherent fault, averaged ``how``. Arguments, returns and errors as
    for `ifbc`.
    """
    return _apply(inverse, _cases(features, inherent)) - average_fault(inherent.faults, how)


def _cases(features: AnyArray, inherent: Inherent) -> Float[np.ndarray, "case 4"]:
    """Features of many cases, checked together with what is to be averaged."""
    f = checked_features(features)
    if f.ndim != 2 or np.ndim(inherent.faults) != 2 or np.ndim(inherent.features) != 2:
        raise ValueError(
            f"features have shape {f.shape} and inherent faults {np.shape(inherent.faults)}: give one row per case in "
            "both, also for one case"
        )
    return f


def complex_gain(found: Float[AnyArray, "case 4"], induced: Float[AnyArray, "case 4"]) -> np.ndarray:
    """Mean complex ratio found / induced of unbalance and of bow, shape (2,): what gain and phase would account for.

    **Arguments:** faults (case, 4) [kg m, kg m, m, m]. **Errors.** ``ValueError`` where nothing was induced.
    """
    if not np.all(np.abs(_rotating(induced)) > 0.0):
        raise ValueError(
            "a case has no induced unbalance or no induced bow: a ratio to nothing says nothing; leave that case out"
        )
    return np.mean(_rotating(found) / _rotating(induced), axis=0)


def divide_gain(found: Float[AnyArray, "*case 4"], gain: np.ndarray) -> Float[np.ndarray, "*case 4"]:
    """Faults (..., 4) [kg m, kg m, m, m] divided by the complex ratios of unbalance and of bow that `complex_gain`
    gives.
    """
    z = _rotating(found) / gain
    return np.stack([z[..., 0].real, z[..., 0].imag, z[..., 1].real, z[..., 1].imag], axis=-1)


def _rotating(faults: AnyArray) -> np.ndarray:
    m = np.asarray(faults)
    return np.stack([m[..., 0] + 1j * m[..., 1], m[..., 2] + 1j * m[..., 3]], axis=-1)

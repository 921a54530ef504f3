"""One network for any speed and any rig of a range: it learns how the inverse map varies, and is linear in the features by construction.

With w_x = (1 - τ_x² + 2iζ_xτ_x) z_x and w_y = i (1 - τ_y² + 2iζ_yτ_y) z_y both equal to U τ²/M + s of their axis,

    U τ_x²/M = (w_x - w_y) / (1 - r),   s = (w_y - r w_x) / (1 - r),   r = (τ_y/τ_x)² = (ω_x/ω_y)²

the inverse has four complex entries times 1/(1 - r), smooth in speed through both resonances. Physics gives the linearity,
M, τ_x² and 1/(1 - r), which grows without bound as the axes become equal; learned from the forward model are the four
entries as functions of τ_x, ω_y/ω_x, ζ_x and ζ_y. Source of the map: Huang et al. 2026, Sensors 26:2565, equations 3-9.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax._core import RPM, AnyArray, require_float64
from rotorjax.compensation import LinearInverse
from rotorjax.features import checked_features, fault_features
from rotorjax.network import Perceptron, Range
from rotorjax.rotor import Jeffcott
from rotorjax.training import Scaled, output_by_least_squares

FIRST_LAYER = 0.05
"""Size of the first layer's weights: neurons that bend little, at places spread by their biases."""


class Rigs(NamedTuple):
    """What may vary: lowest and highest of speed over ω_x, ω_y/ω_x, ζ_x and ζ_y."""

    low: tuple[float, float, float, float] = (0.2, 0.85, 0.0005, 0.0005)
    high: tuple[float, float, float, float] = (1.7, 0.985, 0.05, 0.05)


ANY_RIG = Rigs()
NAMES = ("speed over the critical speed along x", "ratio ω_y/ω_x of the natural frequencies", "damping ratio along x", "damping ratio along y")


class ConditionedNetwork(eqx.Module):
    """Faults from features at any speed of a range, for any rotor of a range, without training anew."""

    perceptron: Perceptron
    inputs: Range
    outputs: Range

    def matrix(self, rotor: Jeffcott, speed: Float[AnyArray, ""]) -> Float[Array, "target feature"]:
        """The inverse map at a speed [rad/s], differentiable: faults [kg m, m] = matrix @ features [m]."""
        place = _place(rotor, jnp.asarray(speed))
        entries = self.outputs.unscaled(self.perceptron(self.inputs.scaled(place)))
        return _real(entries, rotor, place)

    def at(self, rotor: Jeffcott, speed_rpm: float) -> LinearInverse:
        """The inverse at one speed, as `compensation` takes it.

        **Errors.** ``ValueError`` outside the range that was trained: it does not extrapolate.
        """
        self._check(rotor, speed_rpm)
        return LinearInverse(self.matrix(rotor, jnp.asarray(speed_rpm * RPM)))

    def diagnose(self, rotor: Jeffcott, speed_rpm: float, features: Float[AnyArray, "*case 4"]) -> Float[np.ndarray, "*case 4"]:
        """Faults of many cases at one speed. Errors as for `at`, and for features that are not finite."""
        return checked_features(features) @ np.asarray(self.at(rotor, speed_rpm).matrix).T

    def _check(self, rotor: Jeffcott, speed_rpm: float) -> None:
        if rotor.rotation != "x-to-y" or rotor.bow_through_damping:
            raise ValueError(
                "the conditioned network serves rotors that turn from x to y and bows that act through the stiffness: exchange the axes, or use inverse_map"
            )
        place = np.asarray(_place(rotor, jnp.asarray(speed_rpm * RPM)))
        low, high = np.asarray(self.inputs.low), np.asarray(self.inputs.high)
        for name, value, least, most in zip(NAMES, place, low, high, strict=True):
            if not least <= value <= most:
                equal = "; with equal axes one speed cannot tell an unbalance from a bow" if name is NAMES[1] else ""
                raise ValueError(
                    f"{name} is {value:.4g}; the network was trained from {least:.4g} to {most:.4g}: train one for that range, or use inverse_map{equal}"
                )


def train_conditioned(key: Array, *, rigs: Rigs = ANY_RIG, count: int = 4000, hidden: int = 200) -> ConditionedNetwork:
    """Learn the inverse's entries from the forward model at random speeds and rigs, the output layer by least squares.

    **Arguments:** ``key``; ``rigs``: the range; ``count`` of cases; ``hidden`` neurons. **Errors.** ``ValueError`` in
    single precision, or for a range that is empty or reaches equal axes.
    """
    require_float64("training")
    low, high = np.array(rigs.low), np.array(rigs.high)
    if not np.all(low < high) or not np.all(low > 0.0) or not high[1] < 1.0:
        raise ValueError(
            "each range must run from above 0 upwards, that of ω_y/ω_x must end below 1: with equal axes one speed cannot tell an unbalance from a bow"
        )
    places, weights, biases = jax.random.split(key, 3)
    inputs = Range(low, high)
    drawn = _uniform(places, count, low, high)
    entries = _entries(drawn)
    outputs = Range.of(entries, "entries of the inverse")
    inner = FIRST_LAYER * jax.random.normal(weights, (hidden, 4))
    start = Perceptron(inner, jax.random.normal(biases, (hidden,)), jnp.zeros((entries.shape[1], hidden)), jnp.zeros(entries.shape[1]))
    data = Scaled(jax.vmap(inputs.scaled)(drawn), jax.vmap(outputs.scaled)(entries))
    return ConditionedNetwork(output_by_least_squares(start, data), inputs, outputs)


def _uniform(key: Array, count: int, low: np.ndarray, high: np.ndarray) -> Float[Array, "sample 4"]:
    return jax.vmap(lambda u: jnp.asarray(low) + u * jnp.asarray(high - low))(jax.random.uniform(key, (count, 4)))


def _place(rotor: Jeffcott, speed: Float[Array, ""]) -> Float[Array, "4"]:
    """(Ω/ω_x, ω_y/ω_x, ζ_x, ζ_y)."""
    natural = jnp.sqrt(rotor.stiffness / rotor.mass)
    return jnp.stack([speed / natural[0], natural[1] / natural[0], rotor.damping_ratio[0], rotor.damping_ratio[1]])


@jax.jit
def _entries(places: Float[Array, "sample 4"]) -> Float[Array, "sample target"]:
    """(1 - r) times the complex entries of the inverse of the forward model, of a rotor with M = 1 and ω_x = 1."""

    def one(place: Float[Array, "4"]) -> Float[Array, "target"]:
        tau, ratio = place[0], place[1]
        rotor = Jeffcott(jnp.ones(()), jnp.stack([jnp.ones(()), ratio**2]), place[2:])  # pyright: ignore
        forward = jax.vmap(lambda fault: fault_features(rotor, tau, fault), out_axes=1)(jnp.eye(4))
        inverse = jnp.linalg.inv(forward) * (1.0 - ratio**-2)
        unbalance = tau**2 * inverse[:2]
        # Columns f1 and f4 alone hold the complex entries: the others follow from f1 - i f2 and f4 + i f3.
        return jnp.concatenate([unbalance[:, 0], unbalance[:, 3], inverse[2:, 0], inverse[2:, 3]])

    return jax.vmap(one)(places)


def _real(entries: Float[Array, "target"], rotor: Jeffcott, place: Float[Array, "4"]) -> Float[Array, "4 4"]:
    """The four by four inverse of the complex entries, in SI."""
    factor = 1.0 / (1.0 - place[1] ** -2)
    rows = []
    for (a, b, c, d), size in ((entries[:4], rotor.mass / place[0] ** 2), (entries[4:], jnp.ones(()))):
        # (a + ib)(f1 - i f2) + (c + id)(f4 + i f3)
        rows += [size * jnp.stack([a, b, -d, c]), size * jnp.stack([b, -a, c, d])]
    return factor * jnp.stack(rows)

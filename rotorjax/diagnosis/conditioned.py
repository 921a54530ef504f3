"""One network for any speed and any rig of a range: it learns one axis, is applied to both, and is linear in the
features.

With h(τ, ζ) the dimensionless dynamic stiffness of one axis, τ = Ω/ω its speed ratio, the vibration vectors obey

    h(τ_x, ζ_x) z_x = U τ_x²/M + s,   i h(τ_y, ζ_y) z_y = U τ_y²/M + s

two equations for U and s. **Learned** from the forward model is h, a complex function of two ratios and the same for
both axes: smooth in speed through every resonance. **Physics** is the rest: that the map is linear and turns with the
fault, that an unbalance pulls with U Ω², what M is, and the solution for U and s, whose factor 1/(τ_x² - τ_y²) grows
without bound as the axes become equal. Source of the map: Huang et al. 2026, Sensors 26:2565, equations 3-9.
"""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float, Key

from rotorjax.arrays import AnyArray, Numbers, require_float64
from rotorjax.diagnosis.compensation import LinearInverse
from rotorjax.diagnosis.evidence_steps import Scaled
from rotorjax.diagnosis.features import checked_features, fault_features, inverse_map
from rotorjax.diagnosis.network import Format, Parts, Perceptron, Range, read_parts, write_parts
from rotorjax.diagnosis.training import output_by_least_squares
from rotorjax.model.rotor import Jeffcott
from rotorjax.units import RPM

FORMAT = Format("conditioned network", 1, (2, 2))
FIRST_LAYER, BIAS = 0.1, 2.0
"""Size of the first layer's weights, and largest bias: neurons that bend little, each at another place of the tanh.
Without biases a network of small weights is odd in its inputs and holds no square.
"""
LEAST_GAP = 1e-3
"""Of (ω_y/ω_x)² from 1: nearer axes magnify the network's error, and the noise, more than a thousandfold."""


@dataclasses.dataclass(frozen=True)
class Ratios:
    """What the network is trained for, the same for both axes, lowest and highest.

    **Fields:** ``speed``: Ω/ω; by default 600 to 3500 rpm for undamped critical speeds from 1750 to 3000 rpm.
    ``damping``: ζ.
    **Errors.** ``ValueError`` for a range that is empty, not finite or negative.
    """

    speed: tuple[float, float] = (0.2, 2.0)
    damping: tuple[float, float] = (0.0, 0.05)

    def __post_init__(self) -> None:
        for name, (low, high) in dataclasses.asdict(self).items():
            if not (0.0 <= low < high < np.inf):
                raise ValueError(
                    f"{name} ratio from {low:g} to {high:g}: a range runs upwards from a number that is not negative; "
                    "exchange or change its ends"
                )
        if not self.speed[0] > 0.0:
            raise ValueError("the lowest speed ratio is 0: a rotor at rest shows no unbalance; begin above 0")


class ConditionedNetwork(eqx.Module):
    """Faults (U_x, U_y, s_x, s_y) [kg m, m] from features (f1, f2, f3, f4) [m], speed and rotor, by one trained
    perceptron.

    Called with the features of one case, the speed [rad/s] and the rotor; differentiable in all three; NaN outside the
    range it was trained for, where `at` and `diagnose` raise.

    **Fields:** ``perceptron``: (τ, ζ) -> (Re h, Im h), scaled; ``inputs``: the range trained; ``outputs``: that of h.
    """

    perceptron: Perceptron
    inputs: Range
    outputs: Range

    def __call__(
        self, features: Float[Array, "feature"], speed: Float[AnyArray, ""], rotor: Jeffcott
    ) -> Float[Array, "target"]:
        """Faults of one case."""
        return self.matrix(rotor, speed) @ features

    def axis(self, ratios: Float[Array, "2"]) -> Complex[Array, ""]:
        """h of one axis from (Ω/ω, ζ): what the network has learned."""
        pair = self.outputs.unscaled(self.perceptron(jnp.asarray(self.inputs.scaled(ratios))))
        return jax.lax.complex(pair[0], pair[1])  # pyright: ignore

    def matrix(self, rotor: Jeffcott, speed: Float[AnyArray, ""]) -> Float[Array, "target feature"]:
        """The inverse map at a speed [rad/s], faults = matrix @ features [m]; NaN outside the trained range.

        With w_x = h_x z_x and w_y = i h_y z_y: U = M (w_x - w_y) / (τ_x² - τ_y²), s = (τ_x² w_y - τ_y² w_x) / (τ_x² -
        τ_y²).
        """
        ratios = _ratios(rotor, jnp.asarray(speed))
        drive = jax.vmap(self.axis)(ratios) * jnp.array([1.0, 1j * rotor.spin])
        square = ratios[:, 0] ** 2
        served = jnp.all(jax.vmap(self.inputs.holds)(ratios)) & (_gap(ratios) >= LEAST_GAP)
        # The inner choice keeps equal axes from dividing by zero, also in the derivative.
        gap = jnp.where(served, square[0] - square[1], 1.0)
        entries = (
            jnp.stack([rotor.mass * drive * jnp.array([1.0, -1.0]), drive * jnp.array([-1.0, 1.0]) * square[::-1]])
            / gap
        )
        # (a + ib)(f1 - i f2) has the parts a f1 + b f2 and b f1 - a f2.
        real = jnp.stack([jnp.stack([entries.real, entries.imag], -1), jnp.stack([entries.imag, -entries.real], -1)], 1)
        return jnp.where(served, real.reshape(4, 4), jnp.nan)

    def at(self, rotor: Jeffcott, speed_rpm: float) -> LinearInverse:
        """The inverse at one speed [rpm], as `compensation` takes it. **Errors.** ``ValueError`` as for `diagnose`."""
        self._check(rotor, np.asarray([speed_rpm], float))
        return LinearInverse(_matrices(self, rotor, jnp.asarray([speed_rpm], float) * RPM)[0])

    def diagnose(
        self, rotor: Jeffcott, speed_rpm: Numbers, features: Float[AnyArray, "*case 4"]
    ) -> Float[np.ndarray, "*case 4"]:
        """Faults of many cases [kg m, m] from features [m], at one speed or at one for each case [rpm].

        It knows nothing beyond the range it was trained in, and refuses there: ask `within` which speeds it serves.

        **Errors.** ``ValueError`` for features that are not four finite numbers to a case; a speed or a rotor outside
        the trained range; equal axes; a bow that acts through the dampers; or as many speeds as there are no cases.
        """
        f, speeds = checked_features(features), np.asarray(speed_rpm, float)
        if speeds.shape not in ((), f.shape[:-1]):
            raise ValueError(f"{speeds.shape} speeds for features {f.shape}: give one speed, or one for each case")
        self._check(rotor, np.atleast_1d(speeds).ravel())
        matrices = np.asarray(_matrices(self, rotor, jnp.asarray(np.atleast_1d(speeds).ravel()) * RPM)).reshape(
            *speeds.shape, 4, 4
        )
        return np.einsum("...ij,...j->...i", matrices, f)

    def speeds_rpm(self, rotor: Jeffcott) -> tuple[float, float]:
        """Lowest and highest speed served for a rotor: both axes' ratios lie in the trained range [rpm]."""
        critical = np.asarray(rotor.critical_speeds_rpm())
        return float(self.inputs.low[0]) * float(critical.max()), float(self.inputs.high[0]) * float(critical.min())

    def within(self, rotor: Jeffcott, speed_rpm: Numbers) -> Bool[np.ndarray, "*case"]:
        """At which speeds [rpm] both axes' speed and damping ratios lie in the range trained, with a margin of 1e-9 of
        half that range.

        Nearly equal axes, which `diagnose` refuses too, are no matter of that range.
        """
        speeds = np.asarray(speed_rpm, float)
        held = _held(self, rotor, jnp.asarray(speeds.ravel()) * RPM)
        return np.asarray(np.all(np.asarray(held), axis=-1)).reshape(speeds.shape)

    def _check(self, rotor: Jeffcott, speeds_rpm: Float[np.ndarray, "speed"]) -> None:
        if rotor.bow_through_damping:
            raise ValueError(
                "the network was trained with bows that act through the stiffness alone: give a rotor without "
                "bow_through_damping, or use inverse_map"
            )
        gap = float(_gap(_ratios(rotor, jnp.asarray(1.0))))
        if gap < LEAST_GAP:
            inverse_map(rotor, speeds_rpm[0])  # equal axes are refused there, in the same words for everyone
            raise ValueError(
                f"the axes' stiffnesses differ by {100 * gap:.2g} %, less than the {100 * LEAST_GAP:g} % served: "
                "measure at a second speed, or use inverse_map"
            )
        speed_held, damping_held = np.asarray(_held(self, rotor, jnp.asarray(speeds_rpm) * RPM)).T
        if not damping_held.all():
            zeta, (low, high) = np.asarray(rotor.damping_ratio), np.stack([self.inputs.low, self.inputs.high])[:, 1]
            raise ValueError(
                f"damping ratios are {zeta[0]:.4g} and {zeta[1]:.4g}; the network was trained from {low:.4g} to "
                f"{high:.4g}: train one for that range"
            )
        if not speed_held.all():
            slowest, fastest = self.speeds_rpm(rotor)
            raise ValueError(
                f"speed is {speeds_rpm[~speed_held][0]:g} rpm; for this rotor the network serves {slowest:.0f} to "
                f"{fastest:.0f} rpm (speed ratios from "
                f"{float(self.inputs.low[0]):g} to {float(self.inputs.high[0]):g} on both axes): train one for a wider "
                "range of speed ratios"
            )

    def save(self, path: Path | str) -> None:
        """Write all numbers as JSON, to the last digit. **Errors.** `InputError` where the path cannot be
        written to.
        """
        write_parts(path, FORMAT, Parts(self.perceptron, self.inputs, self.outputs))

    @classmethod
    def load(cls, path: Path | str) -> "ConditionedNetwork":
        """Read what `save` wrote. **Errors.** ``ValueError`` for another file."""
        return cls(*read_parts(path, FORMAT))


def _ratios(rotor: Jeffcott, speed: Float[Array, ""]) -> Float[Array, "dof 2"]:
    """(Ω/ω, ζ) of either axis."""
    return jnp.stack([speed / jnp.sqrt(rotor.stiffness / rotor.mass), rotor.damping_ratio], axis=-1)


def _gap(ratios: Float[Array, "dof 2"]) -> Float[Array, ""]:
    """How far (ω_y/ω_x)², or its reciprocal where that is smaller, is from 1."""
    square = ratios[:, 0] ** 2
    return 1.0 - jnp.min(square) / jnp.max(square)


@eqx.filter_jit
def _held(network: ConditionedNetwork, rotor: Jeffcott, speeds: Float[Array, "speed"]) -> Bool[Array, "speed 2"]:
    """Whether (Ω/ω, ζ) lie in the range trained on both axes."""
    return jax.vmap(lambda speed: jnp.all(jax.vmap(network.inputs.holds)(_ratios(rotor, speed)), axis=0))(speeds)


@eqx.filter_jit
def _matrices(
    network: ConditionedNetwork, rotor: Jeffcott, speeds: Float[Array, "speed"]
) -> Float[Array, "speed target feature"]:
    return jax.vmap(lambda speed: network.matrix(rotor, speed))(speeds)


def train_conditioned(
    key: Key[Array, ""], *, ratios: Ratios = Ratios(), count: int = 500, hidden: int = 40
) -> ConditionedNetwork:
    """Learn an axis' dynamic stiffness from faults and features of the forward model, the output layer by least
    squares.

    The first layer is drawn and stays; evidence steps from there do not lower the error (measured): normal equations
    cannot resolve it.

    **Arguments:** ``key``: for cases and weights; ``ratios``: the range; ``count`` of cases, each a rotor, a speed and
    a fault, which teach about two axes; ``hidden`` neurons. **Errors.** ``ValueError`` in single precision, or for
    fewer numbers than weights of the output layer.
    """
    require_float64("training")
    if 2 * count < 2 * (hidden + 1):
        raise ValueError(
            f"{count} cases are too few for {hidden} neurons: draw at least {2 * (hidden + 1)}, or take fewer neurons"
        )
    cases, weights, biases = jax.random.split(key, 3)
    inputs = Range([ratios.speed[0], ratios.damping[0]], [ratios.speed[1], ratios.damping[1]])
    places, stiffness = axis_cases(cases, count, inputs)
    outputs = Range.of(stiffness, "dynamic stiffness")
    inner = FIRST_LAYER * jax.random.normal(weights, (hidden, 2))
    start = Perceptron(
        inner, jax.random.uniform(biases, (hidden,), minval=-BIAS, maxval=BIAS), jnp.zeros((2, hidden)), jnp.zeros(2)
    )
    data = Scaled(jax.vmap(inputs.scaled)(places), jax.vmap(outputs.scaled)(stiffness))  # pyright: ignore
    return ConditionedNetwork(output_by_least_squares(start, data), inputs, outputs)


@eqx.filter_jit
def axis_cases(
    key: Key[Array, ""], count: int, inputs: Range
) -> tuple[Float[Array, "sample 2"], Float[Array, "sample 2"]]:
    """(τ, ζ) and (Re h, Im h) of both axes of ``count`` rotors: h is what drives an axis, over how it vibrates.

    Ratios are dense towards the ends of their range as -cos πu, u uniform: a fit of smooth functions is then as good
    there as inside (Rauhut, Ward 2012, J. Approx. Theory 164:517-533). Rotors have M = 1 kg and ω_x = 1 rad/s. Both
    shares of a fault, of one angle, drive along the same direction, so that no axis stands still.
    """
    where, share, angle = jax.random.split(key, 3)
    places = jax.vmap(jax.vmap(inputs.unscaled))(-jnp.cos(jnp.pi * jax.random.uniform(where, (count, 2, 2))))

    def one(place: Float[Array, "dof 2"], share: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, "dof 2"]:
        square = place[:, 0] ** 2
        rotor = Jeffcott(1.0, jnp.stack([jnp.ones(()), square[0] / square[1]]), place[:, 1])  # pyright: ignore
        towards = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        unbalance, bow = share / square[0], 1.0 - share
        f = fault_features(rotor, place[0, 0], jnp.concatenate([unbalance * towards, bow * towards]))
        z = jax.lax.complex(f[::2], -f[1::2]) * jnp.array([1.0, 1j])
        h = (unbalance * square + bow) * jnp.exp(1j * angle) / z
        return jnp.stack([h.real, h.imag], axis=-1)

    found = jax.vmap(one)(
        places, jax.random.uniform(share, (count,)), 2.0 * jnp.pi * jax.random.uniform(angle, (count,))
    )
    return places.reshape(-1, 2), found.reshape(-1, 2)

"""The contract of an effect: one class with a few hooks, each of which changes nothing by default.

Motion q = (x, y) of one case at one speed and one order n: displacement(t) = Re[q e^{inΩt}], t = 0 at the phase
reference. ``f = (1, -i)`` is the forward circular motion of a shaft that turns from x towards y.
"""

import abc
import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax.arrays import as_float, is_known

if TYPE_CHECKING:
    # A type checker takes equinox's own for instance variables.
    from typing import ClassVar as AbstractClassVar

    from rotorjax.model.model import Model
else:
    from equinox import AbstractClassVar


from rotorjax.model.conditions import Layout
from rotorjax.model.parameters import Form, Parameter

Family = Literal["excitation", "structure", "restoring", "reading"]


BALANCE_GRADE = 6.3e-3
"""Balance quality grade G6.3, e·Ω in m/s: machinery in general (ISO 21940-11:2016, table 1)."""


LEAST_DAMPING_RATIO = 1e-3
"""Damping ratio that sets the scale of damping effects where the rig file has less."""


API_670_RUNOUT = 6.35e-6
"""Allowed combined mechanical and electrical runout, 0.25 mil (API 670, 5th edition, 2014) [m]."""
RUNOUT_SHARE = 0.25
"""The same as a share of the vibration that is allowed, where that is more."""
WITH_AMPLITUDE = {
    "cubic": -2.0,
    "curvature": -1.0,
    "drag": -1.0,
    "slowness": -1.0,
    "force": 1.0,
    "eccentricity": 1.0,
    "unbalance": 1.0,
}
"""Power of the amplitude of vibration with which quantities of a rig go (`AbstractRotor.quantities`): where all moves
twice as far, forces of twice the size, and gaps of twice the width, do the same.
"""


class AbstractRotor(eqx.Module):
    """A rotor as one station with two lateral degrees of freedom: nominal, before any effect."""

    mass: eqx.AbstractVar[Float[Array, ""]]
    stiffness: eqx.AbstractVar[Float[Array, "dof"]]
    damping: eqx.AbstractVar[Float[Array, "dof"]]
    gravity: eqx.AbstractVar[Float[Array, "dof"]]
    spin: eqx.AbstractVar[int]
    bow_through_damping: eqx.AbstractVar[bool]

    def natural_frequency(self) -> Float[Array, ""]:
        """Mean undamped natural frequency sqrt(mean K / M) [rad/s]."""
        return jnp.sqrt(jnp.mean(self.stiffness) / self.mass)

    def quantities(self) -> dict[str, float]:
        """The rig's own scales, in SI, that prior scales refer to.

        Eccentricity e = G / ω_n and unbalance M e are those of balance grade G6.3 at the natural frequency; a sweep at
        the square of the rate of decay moves and widens a resonance by about its own width. Runout is 6.35 µm, or a
        quarter of e where that is more: API 670, 5th edition, 2014, section 6.1, of the vibration that is allowed.
        """
        mass, stiffness = float(self.mass), float(np.mean(np.asarray(self.stiffness)))
        frequency = math.sqrt(stiffness / mass)
        eccentricity = BALANCE_GRADE / frequency
        damping = max(float(np.mean(np.asarray(self.damping))), LEAST_DAMPING_RATIO * 2.0 * math.sqrt(stiffness * mass))
        return {
            "one": 1.0,
            "mass": mass,
            "stiffness": stiffness,
            "damping": damping,
            "compliance": 1.0 / stiffness,
            "period": 1.0 / frequency,
            "eccentricity": eccentricity,
            "runout": max(API_670_RUNOUT, RUNOUT_SHARE * eccentricity),
            "unbalance": mass * eccentricity,
            "force": stiffness * eccentricity,
            "cubic": stiffness / eccentricity**2,
            "curvature": 1.0 / eccentricity,
            "drag": damping / (eccentricity * frequency),
            "slowness": 1.0 / (eccentricity * frequency),
            "sweep": (damping / (2.0 * mass)) ** 2,
        }

    def __add__(self, effect: "Effect") -> "Model":
        # A model is made of rotors and effects: only here does a rotor know of it.
        from rotorjax.model.model import Model  # noqa: PLC0415

        return Model(self) + effect


class OperatingPoint(NamedTuple):
    """All that an effect may know: one case, one speed, one order."""

    rotor: AbstractRotor
    speed: Float[Array, ""]
    """Ω, rad/s: the true one, after speed effects."""
    order: Float[Array, ""]
    order_index: Int[Array, ""]
    unbalance: Float[Array, "plane dof"]
    """Installed unbalance per plane times the plane's participation, kg m."""
    bow: Float[Array, "dof"]
    """Installed bow, m."""

    @property
    def frequency(self) -> Float[Array, ""]:
        """ω = nΩ, rad/s."""
        return self.order * self.speed

    @property
    def whirl(self) -> Float[Array, "dof dof"]:
        """J = [[0, 1], [-1, 0]] for a shaft turning from x to y; the other sign for the other way."""
        return self.rotor.spin * jnp.array([[0.0, 1.0], [-1.0, 0.0]])

    def forward(self, pair: Float[Array, "dof"]) -> Complex[Array, "dof"]:
        """The vector (p_x + i p_y) f that turns with the shaft; f = (1, -i), (1, +i) for a shaft from y to x."""
        across = self.rotor.spin * pair
        return jax.lax.complex(jnp.stack([pair[0], across[1]]), jnp.stack([pair[1], -across[0]]))

    def at_order(self, order: float) -> Float[Array, ""]:
        """One at this order, else zero."""
        return jnp.where(jnp.abs(self.order - order) < 1e-9, 1.0, 0.0)


class Plan(NamedTuple):
    """A measurement that is enough to find an effect of one prior scale."""

    runs: int = 2
    """A baseline, then trial weights of five times the balance grade's unbalance, each in another direction (and in the
    next plane).
    """
    speeds: tuple[float, ...] = (0.7, 0.9, 1.1, 1.4)
    """Times the mean natural frequency."""
    orders: tuple[float, ...] = (1.0,)
    planes: int = 1

    def __str__(self) -> str:
        runs = (
            "a baseline"
            if self.runs == 1
            else f"a baseline and {'a trial weight' if self.runs == 2 else f'{self.runs - 1} trial weights'}"
        )
        where = ", weights in two planes" if self.planes > 1 else ""
        speeds = ", ".join(f"{speed:g}" for speed in self.speeds)
        return (
            f"{runs}{where}; two probes; {', '.join(f'{n:g}X' for n in self.orders)} at {speeds} times the natural "
            "frequency"
        )


class Effect(eqx.Module):
    """One physical effect, local to a station, written for one case at one speed; ``vmap`` is the caller's business.

    A final subclass sets the class data, declares its parameters as fields by `parameter`, and inherits from one
    or more of the hooks `SpeedEffect`, `SweepEffect`, `SupportEffect`, `MatrixEffect`, `ExcitationEffect`,
    `RestoringEffect`, `ReadingEffect`, `WaveformEffect`.
    """

    name: AbstractClassVar[str]
    family: AbstractClassVar[Family]
    meaning: AbstractClassVar[str]
    """One line: what this is on a real machine."""
    source: AbstractClassVar[str]
    """Where the equation is from."""
    starts: ClassVar[tuple[dict[str, float], ...]] = ({},)
    """Starting points of a fit, in prior scales; a parameter that is not named starts at its null."""
    over_amplitude: ClassVar[tuple[str, ...]] = ()
    """Parameters whose starts are in one over the largest displacement of the disk, instead of prior scales."""
    sufficient: ClassVar[Plan] = Plan()
    """A measurement that is enough to find it, or what it ties with."""
    relatives: ClassVar[tuple[str, ...]] = ()
    """Effects whose signature is known to resemble this one's: a fit checks whether they would have done as well."""

    @classmethod
    def forms(cls, layout: Layout, angles: Float[np.ndarray, "probe"]) -> tuple[Form, ...]:
        """Simpler forms that the effect often has, each as likely as that all its parameters are independent: errors
        that are the same along x and y, one probe off and not the other.

        **Arguments:** ``angles``: directions of the probes, in the sense of rotation [rad]. **Returns** directions for
        each form, in units of the prior scales: the parameters are a sum of these.
        """
        return ()

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The declared parameters, in the order of the fields."""
        fields = [f for f in dataclasses.fields(cls) if "parameter" in f.metadata]
        return tuple(Parameter(f.name, *f.metadata["parameter"]) for f in fields)

    def values(self) -> tuple[Array, ...]:
        """The parameters' values in SI, in the order of `parameters`."""
        return tuple(getattr(self, p.name) for p in self.parameters())

    def objection(self, rotor: AbstractRotor) -> str | None:
        """Why these values can hardly be on this rotor, in a few words after the effect's name; none where nothing
        speaks against them.

        An answer that needs such values is never "explained".
        """
        return None

    def remark(self, rotor: AbstractRotor) -> str | None:
        """What a user should know about these values on this rotor, though they may be, in a few words after the
        effect's name.
        """
        return None

    def sized(self, layout: Layout) -> "Effect":
        """The same effect with every parameter at the shape that the layout gives it.

        **Errors.** ``ValueError`` if a parameter has neither that shape nor none.
        """
        values = []
        for declared, value in zip(self.parameters(), self.values(), strict=True):
            shape = declared.shape(layout)
            if value.shape not in ((), shape):
                named = ", ".join(declared.labels(layout))
                raise ValueError(
                    f"{self.name}: {declared.name} has shape {value.shape}; give one number, or one each for {named}"
                )
            values.append(
                value
                if value.shape == shape
                else as_float(np.broadcast_to(value, shape))
                if is_known(value)
                else jnp.broadcast_to(value, shape)
            )
        return self.replaced(values)

    def replaced(self, values: list[Array]) -> "Effect":
        """A copy with other values, in the order of `parameters`."""
        names = [p.name for p in self.parameters()]
        return eqx.tree_at(lambda e: [getattr(e, n) for n in names], self, values)


class Matrices(NamedTuple):
    """What an effect adds to M, C and K; ``path_*`` belong to the support path, the others to the disk."""

    mass: Float[Array, "dof dof"] | float = 0.0
    damping: Float[Array, "dof dof"] | float = 0.0
    stiffness: Float[Array, "dof dof"] | float = 0.0
    path_stiffness: Float[Array, "dof dof"] | float = 0.0
    path_damping: Float[Array, "dof dof"] | float = 0.0


class Support(NamedTuple):
    """Turn of the axes of the support's stiffness [rad], the compliance in series with it per axis [m/N], and the turn
    of the axes of its damping [rad].
    """

    turn: Float[Array, ""] | float = 0.0
    compliance: Complex[Array, "dof"] | float = 0.0
    damping_turn: Float[Array, ""] | float = 0.0


class Excitation(NamedTuple):
    """Force on the disk [N] and offset of the support path [m] at one order."""

    force: Complex[Array, "dof"] | float = 0.0
    offset: Complex[Array, "dof"] | float = 0.0


class Reading(NamedTuple):
    """What the measuring chain does, per probe: gains multiply, everything else adds."""

    direction: Float[Array, "probe"] | float = 0.0
    runout: Complex[Array, "probe"] | float = 0.0
    gain: Complex[Array, "*probe"] | Float[Array, "*probe"] | float = 1.0
    delay: Float[Array, ""] | float = 0.0
    phase: Float[Array, ""] | float = 0.0


class Instant(NamedTuple):
    """One moment of the motion of one case: what a force may depend on."""

    rotor: AbstractRotor
    speed: Float[Array, ""]
    """Ω, rad/s: the true one, after speed effects."""
    angle: Float[Array, ""]
    """Shaft angle φ = Ωt since the phase reference, rad, counted in the sense of rotation."""
    position: Float[Array, "dof"]
    """Disk in space, from where it would be without weight and bow, m."""
    velocity: Float[Array, "dof"]
    """Its velocity, m/s."""
    deflection: Float[Array, "dof"]
    """Of the shaft: the position less the bow, m."""

    @property
    def down(self) -> Float[Array, "dof"]:
        """Unit vector of gravity, zero for a vertical shaft."""
        return self.rotor.gravity / jnp.maximum(jnp.hypot(self.rotor.gravity[0], self.rotor.gravity[1]), 1e-12)

    def turning(self, pair: Float[Array, "dof"], *, times: float = 1.0) -> Float[Array, "dof"]:
        """A vector (p_x, p_y) fixed in the shaft, in space at this moment; ``times``: per turn of the shaft."""
        cosine, sine = jnp.cos(times * self.angle), jnp.sin(times * self.angle)
        return jnp.stack([pair[0] * cosine - pair[1] * sine, self.rotor.spin * (pair[0] * sine + pair[1] * cosine)])


class RestoringEffect(Effect):
    """A nonlinear force, or a stiffness that turns with the shaft: the response then comes from harmonic balance."""

    in_proportion: ClassVar[bool] = False
    """Whether the force is in proportion to the motion, as that of a stiffness that turns with the shaft: it does not
    grow with the motion so as to hold a rotor that is unstable.
    """

    @abc.abstractmethod
    def force(self, instant: Instant) -> Float[Array, "dof"]:
        """Force that resists [N]: it stands beside K q on the left-hand side of the equation of motion."""


class WaveformEffect(Effect):
    """Changes the waveform that a probe delivers."""

    @abc.abstractmethod
    def distorted(self, waveform: Float[Array, "probe"]) -> Float[Array, "probe"]:
        """What comes out [m] of what goes in [m], at one moment."""


class SpeedEffect(Effect):
    """Says what the true speed is."""

    @abc.abstractmethod
    def added_speed(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Speed to add to the tabulated one [rad/s]."""


class SweepEffect(Effect):
    """Says that the speed changes while it is read."""

    @abc.abstractmethod
    def added_sweep(self) -> Float[Array, ""]:
        """Rate to add to that which is stated [rad/s²]."""


class SupportEffect(Effect):
    """Turns the support path or puts something in series with it."""

    @abc.abstractmethod
    def support(self, point: OperatingPoint) -> Support:
        """Turn and series compliance at the point's frequency."""


class MatrixEffect(Effect):
    """Adds to mass, damping or stiffness."""

    @abc.abstractmethod
    def matrices(self, point: OperatingPoint) -> Matrices:
        """Real matrices at the point's speed: the same for every order, so that they hold in time too."""


class ExcitationEffect(Effect):
    """Adds a force or a bow."""

    @abc.abstractmethod
    def excitation(self, point: OperatingPoint) -> Excitation:
        """Complex force and offset at the point's order."""


class ReadingEffect(Effect):
    """Changes what the probes read."""

    @abc.abstractmethod
    def reading(self, point: OperatingPoint) -> Reading:
        """What the measuring chain does at the point's order."""

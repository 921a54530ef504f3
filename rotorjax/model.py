"""The contract of an effect, and the model that carries effects: a rotor, its probes and planes, and what `+` means.

Motion q = (x, y) of one case at one speed and one order n: displacement(t) = Re[q e^{inΩt}], t = 0 at the phase
reference. ``f = (1, -i)`` is the forward circular motion of a shaft that turns from x towards y.
"""

import abc
import dataclasses
import functools
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax._core import RPM, Numbers, Unit, as_float, is_known, unit_of

if TYPE_CHECKING:
    # A type checker takes equinox's own for instance variables.
    from typing import ClassVar as AbstractClassVar
else:
    from equinox import AbstractClassVar

Family = Literal["excitation", "structure", "restoring", "reading"]
Axis = Literal["probe", "order", "plane"]

BALANCE_GRADE = 6.3e-3
"""Balance quality grade G6.3, e·Ω in m/s: machinery in general (ISO 21940-11:2016, table 1)."""


LEAST_DAMPING_RATIO = 1e-3
"""Damping ratio that sets the scale of damping effects where the rig file has less."""


class Layout(NamedTuple):
    """The names along the axes of a model's arrays."""

    probes: tuple[str, ...] = ("X", "Y")
    planes: tuple[str, ...] = ("disk",)
    orders: tuple[float, ...] = (1.0,)

    def names(self, axis: Axis) -> tuple[str, ...]:
        """Labels along an axis. A parameter per ``plane`` has none for the first: that one defines the scale."""
        if axis == "probe":
            return self.probes
        if axis == "plane":
            return self.planes[1:]
        return tuple(f"{order:g}X" for order in self.orders)


class Parameter(NamedTuple):
    """What a field of an effect declares: see `parameter`."""

    name: str
    meaning: str
    scale: float
    of: str
    axes: tuple[Axis, ...]

    @property
    def unit(self) -> Unit:
        """Declared by the ending of the name."""
        return unit_of(self.name)

    def prior_scale(self, rotor: "AbstractRotor") -> float:
        """Prior scale in SI (`rotorjax.inference.prior`): ``scale`` times the rig's quantity ``of``."""
        quantities = rotor.quantities()
        if self.of not in quantities:
            raise ValueError(f"parameter {self.name}: of={self.of!r} is no quantity of the rig; it has {', '.join(quantities)}")
        return self.scale * quantities[self.of]

    def shape(self, layout: Layout) -> tuple[int, ...]:
        """One length per axis."""
        return tuple(len(layout.names(axis)) for axis in self.axes)

    def labels(self, layout: Layout) -> list[str]:
        """Full names of the entries: ``angle_rad.X``, ``real_m.X.1X``."""
        labels = [self.name]
        for axis in self.axes:
            labels = [f"{label}.{name}" for label in labels for name in layout.names(axis)]
        return labels


def parameter(meaning: str, *, scale: float, of: str = "one", axes: tuple[Axis, ...] = ()) -> Any:
    """Declare a field of an effect as one of its parameters. Zero means that the effect is absent.

    **Arguments:** ``meaning`` in a few words; ``scale`` and ``of``: the prior scale is ``scale``
    times that quantity of the rig (`AbstractRotor.quantities`, "one" for a number in SI); ``axes``: one value per
    probe, order or plane after the first. The unit is the ending of the field's name (``_n_per_m``, ``_rad``).
    """
    return eqx.field(default=0.0, converter=as_float, metadata={"parameter": (meaning, scale, of, axes)})


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

        Eccentricity e = G / ω_n and unbalance M e are those of balance grade G6.3 at the natural frequency.
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
            "unbalance": mass * eccentricity,
            "force": stiffness * eccentricity,
            "cubic": stiffness / eccentricity**2,
            "curvature": 1.0 / eccentricity,
            "drag": damping / (eccentricity * frequency),
        }

    def __add__(self, effect: "Effect") -> "Model":
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
        return jax.lax.complex(pair[0], pair[1]) * jnp.array([1.0, -1j * self.rotor.spin])

    def at_order(self, order: float) -> Float[Array, ""]:
        """One at this order, else zero."""
        return jnp.where(jnp.abs(self.order - order) < 1e-9, 1.0, 0.0)


class Plan(NamedTuple):
    """A measurement that is enough to find an effect of one prior scale."""

    runs: int = 2
    """A baseline, then trial weights of five times the balance grade's unbalance, each in another direction (and in the next plane)."""
    speeds: tuple[float, ...] = (0.7, 0.9, 1.1, 1.4)
    """Times the mean natural frequency."""
    orders: tuple[float, ...] = (1.0,)
    planes: int = 1

    def __str__(self) -> str:
        runs = "a baseline" if self.runs == 1 else f"a baseline and {'a trial weight' if self.runs == 2 else f'{self.runs - 1} trial weights'}"
        where = ", weights in two planes" if self.planes > 1 else ""
        speeds = ", ".join(f"{speed:g}" for speed in self.speeds)
        return f"{runs}{where}; two probes; {', '.join(f'{n:g}X' for n in self.orders)} at {speeds} times the natural frequency"


class Effect(eqx.Module):
    """One physical effect, local to a station, written for one case at one speed; ``vmap`` is the caller's business.

    A final subclass sets the class data, declares its parameters as fields by `parameter`, and inherits from one
    or more of the hooks `SpeedEffect`, `SupportEffect`, `MatrixEffect`, `ExcitationEffect`, `RestoringEffect`, `ReadingEffect`,
    `WaveformEffect`.
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
    """Parameters whose starts are in units of one over the largest displacement measured, instead of prior scales."""
    even: ClassVar[tuple[str, ...]] = ()
    """Parameters of which only the square counts."""
    sufficient: ClassVar[Plan] = Plan()
    """A measurement that is enough to find it, or what it ties with."""
    relatives: ClassVar[tuple[str, ...]] = ()
    """Effects whose signature is known to resemble this one's: a fit checks whether they would have done as well."""

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The declared parameters, in the order of the fields."""
        fields = [f for f in dataclasses.fields(cls) if "parameter" in f.metadata]
        return tuple(Parameter(f.name, *f.metadata["parameter"]) for f in fields)

    def values(self) -> tuple[Array, ...]:
        """The parameters' values in SI, in the order of `parameters`."""
        return tuple(getattr(self, p.name) for p in self.parameters())

    def objection(self, rotor: AbstractRotor) -> str | None:
        """Why these values can hardly be on this rotor, in a few words after the effect's name; none where nothing speaks against them.

        An answer that needs such values is never "explained".
        """
        return None

    def remark(self, rotor: AbstractRotor) -> str | None:
        """What a user should know about these values on this rotor, though they may be, in a few words after the effect's name."""
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
                raise ValueError(f"{self.name}: {declared.name} has shape {value.shape}; give one number, or one each for {named}")
            values.append(value if value.shape == shape else as_float(np.broadcast_to(value, shape)) if is_known(value) else jnp.broadcast_to(value, shape))
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
    """Turn of the support's axes [rad] and the compliance in series with it per axis [m/N]."""

    turn: Float[Array, ""] | float = 0.0
    compliance: Complex[Array, "dof"] | float = 0.0


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
    """A force that depends on motion and shaft angle: the response then comes from harmonic balance."""

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


class Conditions(eqx.Module):
    """Operating conditions: how fast, and what is deliberately installed. Make one with `Conditions.at`."""

    speed: Float[Array, "*case"]
    """Ω, rad/s."""
    unbalance: Float[Array, "*case plane dof"]
    """Installed unbalance, kg m: along x and 90° on in the sense of rotation, at t = 0."""
    bow: Float[Array, "*case dof"]
    """Installed bow, m, likewise."""

    @classmethod
    def at(cls, speed: Numbers, *, unbalance: Numbers = 0.0, bow: Numbers = 0.0) -> "Conditions":
        """Conditions at these speeds.

        **Arguments:** ``speed`` [rad/s], a number or an array; ``unbalance`` [kg m], last axes (plane, dof), or
        (dof,) for a single plane; ``bow`` [m], last axis (dof,). Both are repeated over the speeds where needed.
        """
        # For numbers nothing need be compiled.
        numbers, array = (np, np.asarray) if is_known(speed, unbalance, bow) else (jnp, as_float)
        omega, mass_distance, offset = numbers.atleast_1d(array(speed)), array(unbalance), array(bow)
        if mass_distance.ndim < 2:
            mass_distance = numbers.broadcast_to(mass_distance, (1, 2))
        planes = mass_distance.shape[-2:]
        spread = numbers.broadcast_to(mass_distance, (*omega.shape, *planes)), numbers.broadcast_to(offset, (*omega.shape, 2))
        return cls(*map(as_float, (omega, *spread)))

    @classmethod
    def at_rpm(cls, speed_rpm: Numbers, *, unbalance: Numbers = 0.0, bow: Numbers = 0.0) -> "Conditions":
        """The same with speeds in revolutions per minute."""
        return cls.at((np.asarray if is_known(speed_rpm) else as_float)(speed_rpm) * RPM, unbalance=unbalance, bow=bow)


class Probes(eqx.Module):
    """Displacement probes: direction from +x towards +y [rad], mode shape there relative to the disk, reference."""

    angle: Float[Array, "probe"] = eqx.field(converter=as_float)
    participation: Float[Array, "probe"] = eqx.field(converter=as_float)
    on_foundation: Float[Array, "probe"] = eqx.field(converter=as_float)
    """One where the probe reads against the foundation, zero where against the ground."""


def _two_probes() -> Probes:
    return Probes(jnp.array([0.0, jnp.pi / 2.0]), jnp.ones(2), jnp.zeros(2))


def _float_or_none(value: Numbers | None) -> Array | None:
    return None if value is None else as_float(value)


class Model(eqx.Module):
    """A rotor, how it is read, where weights sit on it, and the effects added to it.

    ``model + effect`` adds an effect. Effects are kept by name, so that every order of adding gives the same
    model; adding an effect that is there already adds its parameters.
    """

    rotor: AbstractRotor
    probes: Probes = eqx.field(default_factory=_two_probes)
    participation: Float[Array, "plane"] = eqx.field(converter=as_float, default_factory=lambda: jnp.ones(1))
    """Mode shape at each balancing plane, relative to the disk."""
    slow_roll: Float[Array, ""] | None = eqx.field(converter=_float_or_none, default=None)
    """Speed [rad/s] of the slow roll that was subtracted from every vector, if one was."""
    effects: tuple[Effect, ...] = ()
    layout: Layout = eqx.field(static=True, default=Layout())

    def __check_init__(self) -> None:
        if self.probes.angle.shape != (len(self.layout.probes),) or self.participation.shape != (len(self.layout.planes),):
            raise ValueError(f"the layout names probes {self.layout.probes} and planes {self.layout.planes}: give each an angle and a participation")

    def __add__(self, effect: Effect) -> "Model":
        sized = effect.sized(self.layout)
        present = self.find(effect.name)
        if present is not None:
            sized = jax.tree.map(jnp.add, present, sized)
        others = [e for e in self.effects if e.name != effect.name]
        return self._with_effects([*others, sized])

    def plus(self, effects: Iterable[Effect]) -> "Model":
        """The model with several effects added."""
        return functools.reduce(Model.__add__, effects, self)

    def __contains__(self, name: str) -> bool:
        return self.find(name) is not None

    def find(self, name: str) -> Effect | None:
        """The effect of that name, if the model has it."""
        return next((e for e in self.effects if e.name == name), None)

    def without(self, *names: str) -> "Model":
        """The model less these effects."""
        return self._with_effects([e for e in self.effects if e.name not in names])

    def with_orders(self, orders: tuple[float, ...]) -> "Model":
        """The model for other orders; parameters per order keep their values where the order stays."""
        if orders == self.layout.orders:
            return self
        layout = self.layout._replace(orders=orders)
        bare = Model(self.rotor, self.probes, self.participation, self.slow_roll, (), layout)
        for effect in self.effects:
            bare = bare + effect.replaced(list(self._reordered(effect, orders)))
        return bare

    def _reordered(self, effect: Effect, orders: tuple[float, ...]) -> Iterator[Array]:
        old = self.layout.orders
        for declared, value in zip(effect.parameters(), effect.values(), strict=True):
            if "order" not in declared.axes:
                yield value
                continue
            axis = declared.axes.index("order")
            kept = [jnp.take(value, old.index(n), axis) if n in old else jnp.zeros_like(jnp.take(value, 0, axis)) for n in orders]
            yield jnp.stack(kept, axis)

    def _with_effects(self, effects: list[Effect]) -> "Model":
        ordered = tuple(sorted(effects, key=lambda e: e.name))
        return Model(self.rotor, self.probes, self.participation, self.slow_roll, ordered, self.layout)

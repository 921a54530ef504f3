"""Effects that a user wrote: whether they are what the search takes them for, before anything is fitted.

One that breaks a rule, in a catalogue of fifty, would otherwise spoil the fits of all.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rotorjax.data.synonyms import nearest_effect
from rotorjax.effects.terms import NAMED
from rotorjax.model.conditions import Layout
from rotorjax.model.contract import (
    AbstractRotor,
    Effect,
    Excitation,
    ExcitationEffect,
    Family,
    Instant,
    Matrices,
    MatrixEffect,
    OperatingPoint,
    Reading,
    ReadingEffect,
    RestoringEffect,
    SpeedEffect,
    Support,
    SupportEffect,
    SweepEffect,
    WaveformEffect,
)
from rotorjax.model.model import Model

ABSENT: dict[type[Effect], tuple[str, Any]] = {
    SupportEffect: ("support", Support()),
    MatrixEffect: ("matrices", Matrices()),
    ExcitationEffect: ("excitation", Excitation()),
    ReadingEffect: ("reading", Reading()),
}
"""Hooks that are asked at an operating point, and what they return where the effect is absent."""
PER_PROBE = {"direction", "runout", "gain"}
COMPLEX = {"compliance", "force", "offset", "runout", "gain"}
"""What may be complex of that which hooks return at an operating point."""
SINGLE = {"delay", "phase", "turn", "damping_turn"}
SHARE = 1e-9
"""Of what an effect does at its prior scales, what may be left at zero by rounding."""


def check_catalog(catalog: Mapping[str, type[Effect]], model: Model | AbstractRotor) -> None:
    """Refuse a catalogue that would lose an effect on the way, or one that breaks a rule of effects.

    **Errors.** ``ValueError`` for a key that is not the effect's name, for an effect instead of its class, for a family
    or a relative that there is not, for a form of parameters that it does not have; for an effect of one's own whose
    prior scale is not positive, whose hooks return something else than they should or cannot be differentiated, which
    is not absent where its parameters are zero or has no finite slope there; and for a force that is not two finite
    numbers at rest.
    """
    full = model if isinstance(model, Model) else Model(model)
    for key, cls in catalog.items():
        if not isinstance(cls, type):
            raise ValueError(f"catalog[{key!r}] is an effect: hand over its class, without parentheses")
        if cls.name != key:
            raise ValueError(
                f"catalog[{key!r}] is the effect {cls.name!r}: use its name as the key, {{{cls.__name__}.name: "
                f"{cls.__name__}}}"
            )
        _check_class(cls, full)
        if unknown := [name for name in cls.relatives if name not in catalog and name not in NAMED]:
            raise ValueError(f"{key}: relatives names {unknown[0]!r}; {nearest_effect(unknown[0], NAMED | catalog)}")


def check_own_effects(model: Model) -> None:
    """Refuse a model with an effect of one's own that breaks a rule: ``ValueError`` as for a catalogue."""
    for effect in model.effects:
        _check_class(type(effect), model)


def _check_class(cls: type[Effect], model: Model) -> None:
    if NAMED.get(cls.name) is cls:
        return
    if cls.family not in get_args(Family):
        raise ValueError(f"{cls.name}: family {cls.family!r}; there are {', '.join(get_args(Family))}")
    _check_forms(cls)
    try:
        check_effect(cls, model)
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError) as error:
        raise ValueError(
            f"{cls.name}: its equations hold what needs a plain number, such as an `if` on a value, float(), math or "
            "NumPy functions: write jnp.where(condition, this, that), and functions of jax.numpy"
        ) from error


def _check_forms(cls: type[Effect]) -> None:
    layout = Layout()
    labels = [label for p in cls.parameters() for label in p.labels(layout)]
    for form in cls.forms(layout, np.array([0.0, 0.5 * math.pi])):
        for label in (label for direction in form for label in direction if label not in labels):
            raise ValueError(f"{cls.name}: forms() names {label!r}; its parameters are {', '.join(labels)}")


def _check_force(cls: type[RestoringEffect], rotor: AbstractRotor) -> None:
    none = jnp.zeros(2)
    at_rest = Instant(rotor, jnp.asarray(100.0), jnp.asarray(0.0), none, none, none)
    scales = [p.prior_scale(rotor) for p in cls.parameters()]
    for effect in (cls(), cls(*scales) if not any(p.axes for p in cls.parameters()) else cls()):
        force = jnp.asarray(effect.force(at_rest))
        if force.shape != (2,):
            raise ValueError(
                f"{cls.name}: its force has shape {force.shape}; return (f_x, f_y) in N, like jnp.stack([f_x, f_y])"
            )
        if not bool(jnp.all(jnp.isfinite(force))):
            raise ValueError(
                f"{cls.name}: its force on a rotor at rest is {force}; keep it finite there, zero over zero included"
            )


def check_effect(cls: type[Effect], model: Model) -> None:
    """Refuse an effect that breaks a rule on this model."""
    for p in cls.parameters():
        if not (math.isfinite(scale := p.prior_scale(model.rotor)) and scale > 0.0):
            raise ValueError(
                f"{cls.name}: the prior scale of {p.name} is {scale:g}: give a scale above zero, of the size that the "
                "parameter usually has"
            )
    if issubclass(cls, RestoringEffect):
        _check_force(cls, model.rotor)
    null = cls().sized(model.layout)
    usual = cls(*(p.prior_scale(model.rotor) for p in cls.parameters())).sized(model.layout)
    for index in range(len(model.layout.orders)):
        there = {name: returned for name, returned, _ in _hooks(usual, model, index)}
        for name, returned, absent in _hooks(null, model, index):
            _check_returned(f"{cls.name}: {name}()", returned, absent, len(model.layout.probes))
            _check_absent(f"{cls.name}: {name}()", returned, absent, there[name])
        _check_slopes(null, model, index)


def _hooks(effect: Effect, model: Model, index: int) -> Iterator[tuple[str, Any, Any]]:
    """Name of every hook of an effect, what it returns at one order, and what it would were the effect absent."""
    # What is computed here is traced where the caller is, as in a fit: an `if` on it then fails.
    rotor, one = model.rotor, jnp.ones(())
    with jax.ensure_compile_time_eval():
        size = rotor.quantities()["eccentricity"]
    speed, motion = 0.9 * rotor.natural_frequency(), size * jnp.array([1.0, -0.7])
    weights, order = jnp.ones((len(model.layout.planes), 2)), jnp.asarray(model.layout.orders[index])
    point = OperatingPoint(rotor, speed, order, jnp.asarray(index), size * rotor.mass * weights, motion)
    instant = Instant(rotor, speed, 0.6 * one, motion, speed * motion[::-1], motion)
    for kind, (name, absent) in ABSENT.items():
        if isinstance(effect, kind):
            yield name, getattr(effect, name)(point), absent
    if isinstance(effect, SpeedEffect):
        yield "added_speed", effect.added_speed(speed), jnp.zeros(())
    if isinstance(effect, SweepEffect):
        yield "added_sweep", effect.added_sweep(), jnp.zeros(())
    if isinstance(effect, RestoringEffect):
        yield "force", effect.force(instant), jnp.zeros(2)
    if isinstance(effect, WaveformEffect):
        waveform = size * jnp.ones(len(model.layout.probes))
        yield "distorted", effect.distorted(waveform), waveform


def _check_returned(hook: str, returned: Any, absent: Any, probes: int) -> None:
    if not isinstance(absent, tuple):
        if jnp.shape(returned) != jnp.shape(absent):
            raise ValueError(f"{hook} returns shape {jnp.shape(returned)}; its shape must be {jnp.shape(absent)}")
        _check_real(hook, returned)
        return
    kind: Any = type(absent)
    if not isinstance(returned, kind):
        raise ValueError(
            f"{hook} returns {type(returned).__name__}: return a {kind.__name__}({kind._fields[0]}=...) of rotorjax; "
            f"it has {', '.join(kind._fields)}"
        )
    for field, value in zip(kind._fields, returned, strict=True):
        whole = (2, 2) if kind is Matrices else (probes,) if field in PER_PROBE else () if field in SINGLE else (2,)
        if jnp.shape(value) != whole and not _one_for_all(value, field, kind):
            raise ValueError(f"{hook} returns {field} of shape {jnp.shape(value)}; its shape must be {whole}")
        if field not in COMPLEX:
            _check_real(f"{hook}: {field}", value)


def _check_real(what: str, value: Any) -> None:
    if jnp.iscomplexobj(value):
        raise ValueError(f"{what} is complex; it must be real: phase comes from damping and from complex forces")


def _one_for_all(value: Any, field: str, kind: type) -> bool:
    """Whether one number is enough: of matrices only zero is one."""
    if field in PER_PROBE:
        return jnp.shape(value) == ()
    return isinstance(value, float | int) and (kind is not Matrices or value == 0)


def _check_absent(hook: str, returned: Any, absent: Any, usual: Any) -> None:
    leaves = (jax.tree.leaves(tree) for tree in (returned, absent, usual))
    for value, none, most in zip(*leaves, strict=True):
        allowed = SHARE * np.abs(np.nan_to_num(np.asarray(most) - none, posinf=0.0, neginf=0.0)).max(initial=0.0)
        if not np.all(np.abs(np.asarray(value) - none) <= allowed):
            raise ValueError(
                f"{hook} is {np.asarray(value).tolist()} where all parameters are zero: zero must mean that the effect "
                f"is absent, {np.asarray(none).tolist()} there"
            )


def _check_slopes(null: Effect, model: Model, index: int) -> None:
    def returned(values: tuple[Array, ...]) -> dict[str, Any]:
        asked = _hooks(null.replaced(list(values)), model, index)
        return {name: jax.tree.map(lambda leaf: 1.0 * jnp.asarray(leaf), tree) for name, tree, _ in asked}

    declared = null.parameters()
    jax.eval_shape(returned, null.values())
    for name, tree in jax.jacfwd(returned)(null.values()).items():
        for k, slope in enumerate(jax.tree.leaves(tree)):
            if not bool(jnp.all(jnp.isfinite(slope))):
                raise ValueError(
                    f"{null.name}: {name}() has no finite slope by {declared[k % len(declared)].name} at zero, where "
                    "fits start: make it smooth there, without a root or a quotient of the parameter"
                )

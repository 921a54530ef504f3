"""The model that carries effects: a rotor, its probes and planes, and what `+` means."""

import dataclasses
import functools
from collections.abc import Iterable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from rotorjax.arrays import Numbers, as_array, as_float, is_known
from rotorjax.model.conditions import HarmonicBalance, Layout, Probes, two_probes
from rotorjax.model.contract import AbstractRotor, Effect
from rotorjax.shown import Shown


@functools.lru_cache(maxsize=512)
def _at_null(cls: type[Effect], layout: Layout, dtype: np.dtype) -> Effect:
    """An effect that does nothing, its parameters at the shapes that the layout gives them."""
    del dtype  # JAX's default precision: what was made in another is not the same
    return cls().sized(layout)


def with_null_effects(
    effects: tuple[Effect, ...], classes: Iterable[type[Effect]], layout: Layout
) -> tuple[Effect, ...]:
    """Effects with those of these classes, at their null where they are not among them, in the order of a model."""
    own, dtype = {e.name for e in effects}, jnp.result_type(float)
    return _in_order([*effects, *(_at_null(cls, layout, dtype) for cls in classes if cls.name not in own)])


def _in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    return tuple(sorted(effects, key=lambda e: e.name))


def _float_or_none(value: Numbers | None) -> Array | None:
    return None if value is None else as_float(value)


class Model(eqx.Module, Shown):
    """A rotor, how it is read, where weights sit on it, and the effects added to it.

    ``model + effect`` adds an effect. Effects are kept by name, so that every order of adding gives the same
    model; adding an effect that is there already adds its parameters.
    """

    rotor: AbstractRotor
    probes: Probes = eqx.field(default_factory=two_probes)
    participation: Float[Array, "plane"] = eqx.field(converter=as_float, default_factory=lambda: jnp.ones(1))
    """Mode shape at each balancing plane, relative to the disk."""
    slow_roll: Float[Array, ""] | None = eqx.field(converter=_float_or_none, default=None)
    """Speed [rad/s] of the slow roll that was subtracted from every vector, if one was."""
    effects: tuple[Effect, ...] = ()
    layout: Layout = eqx.field(static=True, default=Layout())
    harmonic_balance: HarmonicBalance = eqx.field(static=True, default=HarmonicBalance())

    def __check_init__(self) -> None:
        if not isinstance(self.rotor, AbstractRotor):
            raise TypeError(
                f"a {type(self.rotor).__name__} is no rotor: write Jeffcott(...), or hand over the .model of a rig file"
            )
        if min(self.harmonic_balance) <= 0:
            raise ValueError(f"every setting of harmonic balance must be above zero; they are {self.harmonic_balance}")
        if self.probes.angle.shape != (len(self.layout.probes),) or self.participation.shape != (
            len(self.layout.planes),
        ):
            raise ValueError(
                f"the layout names probes {self.layout.probes} and planes {self.layout.planes}: give each an angle and "
                "a participation"
            )

    def __add__(self, effect: Effect) -> "Model":
        return self.plus([effect])

    def plus(self, effects: Iterable[Effect]) -> "Model":
        """The model with several effects added."""
        every = {e.name: e for e in self.effects}
        for effect in effects:
            if isinstance(effect, type):
                raise TypeError(f"{effect.__name__} is a class; add an effect of it: {effect.__name__}()")
            if not isinstance(effect, Effect):
                raise TypeError(f"{effect!r} is no effect: add one such as effects.ResidualUnbalance()")
            sized, present = effect.sized(self.layout), every.get(effect.name)
            every[effect.name] = sized if present is None else jax.tree.map(jnp.add, present, sized)
        return self._with_effects(every.values())

    def with_null_effects(self, classes: Iterable[type[Effect]]) -> "Model":
        """The model with the effects of these classes, at their null where it does not have them."""
        return dataclasses.replace(self, effects=with_null_effects(self.effects, classes, self.layout))

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
        bare = dataclasses.replace(self, effects=(), layout=layout)
        return bare.plus([effect.replaced(list(self._reordered(effect, orders))) for effect in self.effects])

    def _reordered(self, effect: Effect, orders: tuple[float, ...]) -> Iterator[Array]:
        old = self.layout.orders
        for declared, value in zip(effect.parameters(), effect.values(), strict=True):
            if "order" not in declared.axes:
                yield value
                continue
            axis = declared.axes.index("order")
            # In NumPy where nothing is traced: single operations of JAX's are compiled one by one.
            known = is_known(value)
            arrays, own = (np, np.asarray(value)) if known else (jnp, value)
            blank = arrays.zeros_like(arrays.take(own, 0, axis))
            kept = [arrays.take(own, old.index(n), axis) if n in old else blank for n in orders]
            yield as_array(np.stack(kept, axis)) if known else jnp.stack(kept, axis)

    def _with_effects(self, effects: Iterable[Effect]) -> "Model":
        return dataclasses.replace(self, effects=_in_order(effects))

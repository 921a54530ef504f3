"""What the parameters of an effect declare of themselves, and the forms that they often have together."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx

from rotorjax.arrays import as_float
from rotorjax.model.conditions import Axis, Layout
from rotorjax.units import Unit, unit_of

if TYPE_CHECKING:
    from rotorjax.model.contract import AbstractRotor

Form = tuple[Mapping[str, float], ...]
"""Directions in the space of an effect's parameters: label -> share."""


def only(labels: Iterable[str]) -> Form:
    """These parameters, each by itself, and no others."""
    return tuple({label: 1.0} for label in labels)


def one_of(labels: Iterable[str]) -> tuple[Form, ...]:
    """A form for each of these parameters: it alone."""
    return tuple(only([label]) for label in labels)


class Parameter(NamedTuple):
    """What a field of an effect declares: see `parameter`."""

    name: str
    meaning: str
    scale: float
    of: str
    axes: tuple[Axis, ...]
    shape_only: bool = False

    @property
    def unit(self) -> Unit:
        """Declared by the ending of the name."""
        return unit_of(self.name)

    def prior_scale(self, rotor: "AbstractRotor") -> float:
        """Prior scale in SI (`rotorjax.inference.prior`): ``scale`` times the rig's quantity ``of``."""
        quantities = rotor.quantities()
        if self.of not in quantities:
            raise ValueError(
                f"parameter {self.name}: of={self.of!r} is no quantity of the rig; it has {', '.join(quantities)}"
            )
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


def parameter(
    meaning: str, *, scale: float, of: str = "one", axes: tuple[Axis, ...] = (), shape_only: bool = False
) -> Any:
    """Declare a field of an effect as one of its parameters. Zero means that the effect is absent.

    **Arguments:** ``meaning`` in a few words; ``scale`` and ``of``: the prior scale is ``scale``
    times that quantity of the rig (`AbstractRotor.quantities`, "one" for a number in SI); ``axes``: one value per
    probe, order or plane after the first; ``shape_only``: it says how the effect acts and not how strongly, like a gap
    or a coefficient of friction, so that its prior scale is what is declared and not left open over decades
    (`rotorjax.inference.evidence`). The unit is the ending of the field's name (``_n_per_m``, ``_rad``).
    """
    declared = (meaning, scale, of, axes, shape_only)
    return eqx.field(default=0.0, converter=as_float, metadata={"parameter": declared})

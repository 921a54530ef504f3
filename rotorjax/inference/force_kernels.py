"""Nonlinear forces along motions, compiled for the effects of one source: the catalogue, the terms of a missing force,
or classes of somebody else.

Forces add up, and none depends on what else acts: programs are made once for each source, the same for every machine
and whatever other effects are there, and are called only where one of their effects acts.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax.arrays import AnyArray
from rotorjax.effects.terms import TERMS
from rotorjax.inference.parts import Part
from rotorjax.inference.programs import Compiled, compiled
from rotorjax.inference.space import Space
from rotorjax.model.conditions import Probes
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import Grid, grid_of
from rotorjax.physics.planar import DOF, Vector
from rotorjax.physics.restoring_forces import Inputs, force_slopes, forces_of_rows, parameters_of
from rotorjax.physics.steady_state import Ready

BALANCED_CHUNK = 32
"""Rows evaluated together: few, as they are costly and the last chunk is filled up."""


class ForceInputs(NamedTuple):
    """What nonlinear forces depend on beside the motion and their own parameters, in every row; or its changes, with a
    further axis that counts columns.
    """

    speed: Float[AnyArray, "row"]
    """True speed [rad/s]."""
    bow_x: Complex[AnyArray, "row order"]
    """Complex amplitude of the bow [m]."""
    bow_y: Complex[AnyArray, "row order"]

    @classmethod
    def of(cls, ready: Ready) -> "ForceInputs":
        """In one row, in compiled code."""
        bow = ready.bow
        return cls(ready.condition.speed, bow.x, bow.y)


class Forces(NamedTuple):
    """The nonlinear forces of some effects of a space."""

    part: Part
    slopes: Compiled
    fine: Compiled

    @classmethod
    def of(cls, space: Space, names: frozenset[str], orders: tuple[float, ...]) -> "Forces":
        """Of the effects of these names."""
        part = Part.of(space, names, orders)
        model = part.space.model
        # Forces act on the disk: probes and planes do not count.
        layout = model.layout._replace(probes=(), planes=())
        nothing = np.zeros(0)
        bare = dataclasses.replace(
            model, layout=layout, probes=Probes(nothing, nothing, nothing), participation=nothing
        )
        often = not names & TERMS.keys()
        slopes, fine = (compiled(kernel, bare, bare, BALANCED_CHUNK, often=often) for kernel in (_forces, _fine_forces))
        return cls(part, slopes, fine)

    @property
    def warm(self) -> bool:
        """Whether the program was called before."""
        return self.slopes.program.warm

    def make(self, columns: int, grid: Grid) -> None:
        """Make the program for forces and their slopes."""
        own, order = np.zeros((1, len(self.part.source))), np.zeros((1, len(grid.orders)), complex)
        motion = np.zeros((1, DOF, 2 * len(grid.orders) - 1))
        moved = [np.repeat(part[:, None], columns, axis=1) for part in (np.zeros(1), order, order)]
        self.slopes.make(own, np.repeat(own[:, None], columns, axis=1), np.zeros(1), order, order, *moved, motion)

    def make_fine(self, grid: Grid) -> None:
        """Make that for forces along motions of more orders."""
        order = np.zeros((1, len(grid.orders)), complex)
        motion = np.zeros((1, DOF, 2 * len(grid.orders) - 1))
        self.fine.make(np.zeros((1, len(self.part.source))), np.zeros(1), order, order, motion)

    def own(
        self, unknowns: Float[np.ndarray, "row param"], columns: Int[np.ndarray, "row column"]
    ) -> tuple[Float[np.ndarray, "row own"], Float[np.ndarray, "row column own"]]:
        """Parameters of the effects, and their slopes by the wanted unknowns."""
        own, wanted = self.part.unknowns(unknowns), self.part.columns(columns)
        changes = (
            self.part.changes(own, wanted) if np.any(wanted >= 0) else np.zeros((*wanted.shape, len(self.part.source)))
        )
        return self.part.space.values(own), changes


def _own_of(model: Model, values: Array) -> tuple[Array, ...]:
    """Parameters of every effect, of those of all in a row."""
    ends = np.cumsum([len(own) for own in parameters_of(model)[0]])[:-1]
    return tuple(jnp.split(values, ends, axis=-1))


def _forces(model: Model, values: Array, changes: Array, *along: Array) -> tuple[Array, ...]:
    speed, bow_x, bow_y, speed_moved, x_moved, y_moved, motions = along
    inputs = Inputs(_own_of(model, values), speed, motions, Vector(bow_x, bow_y))
    # The motion by itself: slopes by it are apart.
    moved = Inputs(_own_of(model, changes), speed_moved, motions, Vector(x_moved, y_moved))
    found = force_slopes(parameters_of(model)[1], model.rotor, grid_of(model), inputs, moved)
    return found.force, found.change, found.by_motion


def _fine_forces(
    model: Model, values: Array, speed: Array, bow_x: Array, bow_y: Array, motions: Array
) -> tuple[Array, ...]:
    inputs = Inputs(_own_of(model, values), speed, motions, Vector(bow_x, bow_y))
    return (forces_of_rows(parameters_of(model)[1], model.rotor, grid_of(model).finer, inputs),)

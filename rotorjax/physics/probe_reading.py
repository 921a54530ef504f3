"""What probes show of a motion: the amplitudes of every order, through what bends the waveform, where anything does."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float

from rotorjax.model.contract import WaveformEffect
from rotorjax.model.model import Model
from rotorjax.physics.harmonic_balance import Grid
from rotorjax.physics.restoring_forces import waveform

BendOf = Callable[[Float[Array, "param"]], WaveformEffect]
"""From parameters in a row to the effect."""


class Sensed(NamedTuple):
    """What the probes deliver, and what is made of it."""

    amplitudes: Complex[Array, "probe order"]
    """At every order of the grid, before anything bends the waveform [m]."""
    turn: Complex[Array, "order"]
    """By which the phase reference turns each."""
    own: tuple[Float[Array, "param"], ...]
    """Parameters of every effect that bends the waveform."""


class Read(NamedTuple):
    """What the probes show [m] at some orders, and its slopes."""

    shown: Complex[Array, "row probe order"]
    slopes: Complex[Array, "row column probe order"]
    by_motion: Float[Array, "row probe order 2 dof coefficient"]
    """Of real and imaginary parts by the coefficients of the motion."""


def bends_of(model: Model) -> tuple[tuple[Float[Array, "param"], ...], tuple[BendOf, ...]]:
    """Parameters of every effect that bends the waveform, and the effects made of them."""
    flat = [ravel_pytree(effect) for effect in model.effects if isinstance(effect, WaveformEffect)]
    return tuple(values for values, _ in flat), tuple(effect_of for _, effect_of in flat)


def read(bends: Sequence[BendOf], grid: Grid, index: Sequence[int], sensed: Sensed) -> Complex[Array, "probe order"]:
    """What the probes show at some orders of the grid; that of order 0 is real."""
    amplitudes = sensed.amplitudes
    if bends:
        waves = jax.vmap(functools.partial(_bent, bends, sensed.own), in_axes=1, out_axes=1)(
            waveform(amplitudes, grid, grid.angle)
        )
        analysis = grid.analysis()
        # Of order 0 there is no imaginary part.
        imaginary = np.concatenate([np.zeros((len(analysis), 1)), analysis[:, 2::2]], axis=1)
        real = np.concatenate([analysis[:, :1], analysis[:, 1::2]], axis=1)
        amplitudes = jax.lax.complex(waves @ jnp.asarray(real), waves @ jnp.asarray(imaginary))
    shown = (amplitudes * sensed.turn[None])[:, jnp.array(index)]
    return jax.lax.complex(shown.real, shown.imag * jnp.asarray(_complete(index))[None])


def read_rows(
    bends: Sequence[BendOf],
    grid: Grid,
    index: Sequence[int],
    sensed: Sensed,
    moved: Sensed,
    by_motion: Float[Array, "row dof probe coefficient coefficient"],
) -> Read:
    """Readings of many rows; where nothing bends the waveform in any of them, and nothing begins to, every order stays
    by itself.

    **Arguments:** ``sensed`` with a leading axis that counts rows; ``moved``: changes of it with a further one that
    counts columns; ``by_motion``: how the amplitudes change with the motion, as coefficients by coefficients.
    """

    def rows(bends: Sequence[BendOf], sensed: Sensed, moved: Sensed, by_motion: Array) -> Read:
        return jax.vmap(functools.partial(_row, bends, grid, index))(sensed, moved, by_motion)

    if not bends:
        return rows((), sensed, moved, by_motion)
    present = jnp.any(jnp.stack([jnp.any(part != 0.0) for part in (*sensed.own, *moved.own)]))
    return jax.lax.cond(present, functools.partial(rows, bends), functools.partial(rows, ()), sensed, moved, by_motion)


def _row(
    bends: Sequence[BendOf], grid: Grid, index: Sequence[int], sensed: Sensed, moved: Sensed, by_motion: Array
) -> Read:
    shown, push = jax.linearize(functools.partial(read, bends, grid, index), sensed)
    analysis, complete = grid.analysis(), _complete(index)
    parts = np.stack(
        [analysis[:, [max(2 * k - 1, 0) for k in index]], analysis[:, [2 * k for k in index]] * complete], axis=-1
    )
    synthesis = grid.synthesis(grid.angle)
    if bends:
        waves = waveform(sensed.amplitudes, grid, grid.angle)
        by_wave = jax.vmap(jax.jacfwd(functools.partial(_bent, bends, sensed.own)), in_axes=1, out_axes=-1)(waves)
        analysed = jnp.einsum("pqs,sonc->pqonc", by_wave, jnp.asarray(np.einsum("son,cs->sonc", parts, synthesis)))
        by = jnp.einsum("pqonc,dqkc->pondk", analysed, by_motion)
    else:
        by = jnp.einsum("onc,dpkc->pondk", jnp.asarray(np.einsum("son,cs->onc", parts, synthesis)), by_motion)
    turn = sensed.turn[jnp.array(index)][None, :, None, None]
    real, imaginary = by[:, :, 0], by[:, :, 1]
    turned = jnp.stack([turn.real * real - turn.imag * imaginary, turn.imag * real + turn.real * imaginary], axis=2)
    there = jnp.asarray(np.stack([np.ones(len(index)), complete], axis=1))
    return Read(shown, jax.vmap(push)(moved), turned * there[None, :, :, None, None])


def _complete(index: Sequence[int]) -> Float[np.ndarray, "order"]:
    """One for every order that has an imaginary part, zero for order 0."""
    return (np.array(index) > 0).astype(float)


def _bent(bends: Sequence[BendOf], own: Sequence[Array], wave: Float[Array, "probe"]) -> Float[Array, "probe"]:
    """What the probes make of it at one instant."""
    for bend_of, values in zip(bends, own, strict=True):
        wave = bend_of(values).distorted(wave)
    return wave

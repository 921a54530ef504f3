"""Finding a steady state of which nothing is known: Newton's method, and paths that lead to where it does not.

A path of steady states begins where one is at hand, without the restoring force, at rest or under a strong brake, and
ends where all is as it is.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rotorjax.physics.harmonic_balance import (
    Coefficients,
    System,
    columns_of,
    inverse,
    moved_columns,
    size_of,
)

FIRST_PART, SMALLEST_PART = 0.25, 1.0 / 64.0
"""Of what is let in where Newton's method does not converge at once."""
FIRST_ARC, LONGEST_ARC, SHORTEST_ARC, MOST_ARCS = 0.1, 0.5, 1e-4, 300
"""Steps along a path that turns back, in its share and in the motion over the free one, and their number."""
LARGER_PART, SMALLER_PART, LONGER_ARC, SHORTER_ARC = 2.0, 0.25, 1.6, 0.4
"""How a step that was made changes the next, and one that was not."""
FAR = 2.0
"""Length of such a step as made, over that as planned, beyond which the path was lost."""
BEGINNINGS = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
"""Shares where each path begins; all end with the whole, as which the first begins already."""
FROM_FREE = 2
"""Paths that begin with the free motion; the others begin at rest."""


class Shares(NamedTuple):
    """How much of the restoring force, of the excitation and of the brake is let in."""

    force: Array | float
    drive: Array | float
    brake: Array | float


WHOLE = Shares(1.0, 1.0, 0.0)


class _Path(NamedTuple):
    """A point of a path of steady states, from share 0 to 1 of what is let in, and the step to the next."""

    number: Array
    motion: Coefficients
    """Over the size of the free motion."""
    share: Array
    along: Coefficients
    """Change of the motion along the path, per length of arc."""
    rise: Array
    """Of the share."""
    arc: Array
    """Whether steps are of arc, rather than of share."""
    length: Array
    """Of the next step; zero while only the direction is wanted."""
    tried: Array
    """Steps."""
    ended: Array

    def kept(self, one: Array, other: "_Path") -> "_Path":
        """This if so, else the other."""
        return _Path(*(jnp.where(one, mine, theirs) for mine, theirs in zip(self, other, strict=True)))


def search(system: System) -> Coefficients:
    """A steady state from nothing known, or not a number. Not to be differentiated.

    Newton's method from the free motion. Where that does not converge, the restoring force is let in by parts from the
    free motion; where that leads nowhere, the excitation from rest; where that does neither, a strong brake is taken
    off. Where no part is small enough, the path of steady states turns back, as it does where resonance curves lean
    over and where a stop is met: it is followed by its arc length (Keller 1977, in Applications of Bifurcation Theory,
    Academic Press, 359-384).
    """
    begin = _begun(system, jnp.zeros((), int))._replace(share=jnp.ones(()))
    found = jax.lax.while_loop(
        lambda path: ~path.ended & (path.number < len(BEGINNINGS)), lambda path: _advanced(system, path), begin
    )
    return jnp.where(found.ended, found.motion * size_of(system), jnp.nan)


def _begun(system: System, number: Array) -> _Path:
    """The beginning of a path."""
    start = system.free / size_of(system) * jnp.where(number < FROM_FREE, 1.0, 0.0)
    zero, no = jnp.zeros(()), jnp.zeros((), bool)
    return _Path(number, start, zero, jnp.zeros_like(start), zero + 1.0, no, zero, jnp.zeros((), int), no)


def _across(system: System, path: _Path) -> tuple[_Path, Array]:
    """The steady state on the plane through a point across its direction, with the direction of the path there; and
    whether there is one.
    """
    size, settings, least = size_of(system), system.settings, Shares(*jnp.asarray(BEGINNINGS)[path.number])
    more = Shares(*(whole - part for whole, part in zip(WHOLE, least, strict=True)))

    braking = jax.vmap(system.brake)(jnp.eye(path.motion.size).reshape(-1, *path.motion.shape))

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        motion, share, _, count, _ = state
        shares = Shares(*(part + share * change for part, change in zip(least, more, strict=True)))
        force, brake = system.force(motion * size), system.brake(motion * size)
        resisting = jnp.stack([shares.force * force + shares.brake * brake, more.force * force + more.brake * brake])
        miss = jax.vmap(system.moved)(resisting) - jnp.stack([shares.drive * system.free, more.drive * system.free])
        columns = shares.force * columns_of(system, motion * size) + shares.brake * braking
        by_miss = inverse(moved_columns(system, columns))
        change, slope = ((miss.at[0].add(motion * size) / size).reshape(2, -1) @ by_miss.T).reshape(2, *motion.shape)
        off = jnp.sum(path.along * (motion - path.motion)) + path.rise * (share - path.share)
        let_in = (jnp.sum(path.along * change) - off) / (path.rise - jnp.sum(path.along * slope))
        moved = -change - slope * let_in
        return motion + moved, share + let_in, jnp.maximum(jnp.max(jnp.abs(moved)), jnp.abs(let_in)), count + 1, slope

    begin = (path.motion, path.share, jnp.asarray(jnp.inf), jnp.asarray(0), path.motion)
    motion, share, change, _, slope = jax.lax.while_loop(
        lambda s: (s[3] < settings.newton_steps) & (s[2] > settings.tolerance), step, begin
    )
    onward = jnp.where(path.rise < jnp.sum(path.along * slope), -1.0, 1.0) / jnp.sqrt(jnp.sum(slope**2) + 1.0)
    return path._replace(motion=motion, share=share, along=-onward * slope, rise=onward), change <= settings.tolerance


def _advanced(system: System, path: _Path) -> _Path:
    """One step further, or the same with a smaller step, or the beginning of the next path."""
    along, rise = jnp.where(path.arc, path.along, 0.0), jnp.where(path.arc, path.rise, 1.0)
    length = jnp.where(rise * path.length > 1.0 - path.share, (1.0 - path.share) / rise, path.length)
    last = path.share + rise * length >= 1.0
    ahead = path._replace(motion=path.motion + length * along, share=path.share + rise * length)
    there, good = _across(system, ahead._replace(along=jnp.where(last, 0.0, along), rise=jnp.where(last, 1.0, rise)))
    far = jnp.sqrt(jnp.sum((there.motion - path.motion) ** 2) + (there.share - path.share) ** 2)
    good &= last | ~path.arc | (far <= FAR * length)
    more = jnp.where(path.length > 0.0, LARGER_PART * path.length, FIRST_PART)
    longer = jnp.where(path.arc, jnp.minimum(LONGER_ARC * path.length, LONGEST_ARC), more)
    shorter = jnp.where(path.arc, SHORTER_ARC, SMALLER_PART) * path.length
    after = (
        there._replace(length=longer, ended=last)
        .kept(good, path._replace(length=shorter))
        ._replace(tried=path.tried + 1)
    )
    turns = ~path.arc & (after.length < SMALLEST_PART)
    after = after._replace(arc=path.arc | turns, length=jnp.where(turns, FIRST_ARC, after.length))
    lost = ~after.ended & (
        (after.length < SHORTEST_ARC)
        | (after.tried >= MOST_ARCS)
        | (after.share < -FIRST_ARC)
        | (~good & (path.length == 0.0))
    )
    return _begun(system, path.number + 1).kept(lost, after)

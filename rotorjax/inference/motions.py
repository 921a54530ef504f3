"""Motions of the cases: to begin a fit with, and moved towards balance under parameters that stay."""

import numpy as np
from jaxtyping import Float, Int

from rotorjax.inference.descent_settings import STEP_LIMIT
from rotorjax.inference.kernels import BALANCED_CHUNK
from rotorjax.inference.linearised import Imbalance, Linearisation, Linearised, MotionResponse, Point

BALANCED = 0.1
"""Standard errors by which the reading of a motion may be off what balance would make of it."""
FIRST_MOTION = 10.0
"""Freedom of the motions, in their size or the noise, that lets them show just what was measured; of a change along the
motion of its order, in that of any other.
"""
SHORTER = 0.3
"""What is left of a step that leads to more force that is lacking, and of each length to the next."""
LENGTHS = 4
"""Lengths of a step of Newton's method that are tried, at once where few states are left, as a chunk of rows is
evaluated all the same.
"""


def first_motions(
    lin: Linearisation, points: list[Float[np.ndarray, "param"]]
) -> list[Float[np.ndarray, "state dof wide"]]:
    """Motions that show what was measured: those of the rotor without nonlinear forces, changed as little
    as possible.

    A change that goes along with the motion of its order, in both directions alike, counts least: where one direction
    is not seen, a force that makes the other larger or smaller does the same to it.
    """
    plain = [np.where(lin.space.coupled(), 0.0, point) for point in points]
    distinct = list({point.tobytes(): point for point in plain}.values())
    if not distinct:
        return []
    known = {}
    at_rest = [Point(point, lin.at_rest, slack=True) for point in distinct]
    for one in lin.at(at_rest, [np.zeros(0, int)] * len(distinct)):
        assert one.response is not None
        assert one.response.own is not None
        free, size = (
            -one.response.newton,
            FIRST_MOTION * max(float(np.abs(lin.data.pairs).max()), 1.0 / float(np.max(lin.data.weight))),
        )
        likely = size**2 * _alike(free[: lin.cases].reshape(lin.cases, lin.kernels.dof, lin.kernels.coefficients))
        along = likely @ np.swapaxes(one.response.own.seen, 1, 2)
        shown = one.response.own.seen @ along + np.eye(one.error.shape[1])
        # What was subtracted as slow roll is left as it is.
        free[: lin.cases] -= (along @ np.linalg.solve(shown, one.error[..., None]))[..., 0]
        known[one.point.unknowns.tobytes()] = lin.moved(one, free)
    return [known[point.tobytes()] for point in plain]


def _alike(motion: Float[np.ndarray, "case dof coefficient"]) -> Float[np.ndarray, "case motion motion"]:
    """Covariance of changes of a motion: 1 + (f² - 1) uuᴴ, order by order, f = `FIRST_MOTION`, u the motion's own
    direction there.
    """
    cases, dof, count = motion.shape
    covariance = np.tile(np.eye(dof * count), (cases, 1, 1)).reshape(cases, dof, count, dof, count)
    for parts in ([0], *([k, k + 1] for k in range(1, count, 2))):
        pair = motion[:, :, parts]
        turned = np.stack([-pair[..., -1], pair[..., 0]], axis=-1) if len(parts) == 2 else np.zeros_like(pair)
        both = np.einsum("cip,cjq->cipjq", pair, pair) + np.einsum("cip,cjq->cipjq", turned, turned)
        size = np.maximum(np.sum(pair**2, axis=(1, 2)), 1e-300)
        covariance[np.ix_(range(cases), range(dof), parts, range(dof), parts)] += (
            (FIRST_MOTION**2 - 1.0) * both / size[:, None, None, None, None]
        )
    return covariance.reshape(cases, dof * count, dof * count)


def balanced(
    lin: Linearisation, astray: list[Linearised], tight: float
) -> tuple[list[Point], list[Int[np.ndarray, "near"]]]:
    """Motions moved towards balance under parameters that stay: Newton's method, its steps shortened until the force
    that is lacking falls.

    The states have nothing to do with one another. **Arguments:** ``tight``: standard errors by which the reading may
    be off balance.
    **Returns** the points, and of each the cases that read of what was moved.
    """
    responses = [one.response for one in astray if one.response is not None]
    motions, moved = (
        [np.array(one.point.motions) for one in astray],
        [np.flatnonzero(response.off > tight) for response in responses],
    )
    for refined in (False, True):
        rows = [(k, state) for k, one in enumerate(astray) if one.point.refined == refined for state in moved[k]]
        if not rows:
            continue
        which, states = np.array(rows).T
        found = _towards_balance(
            lin,
            np.stack([astray[k].point.unknowns for k in which]),
            states,
            np.stack([motions[k][state] for k, state in rows]),
            _imbalances([responses[k] for k in which], states),
            tight,
            refined=refined,
        )
        for row, (k, state) in enumerate(rows):
            motions[k][state] = found[row]
    cases = [
        np.flatnonzero(~lin.states.everywhere(~np.isin(np.arange(len(lin.states.speed)), states))) for states in moved
    ]
    return [one.point._replace(motions=found) for one, found in zip(astray, motions, strict=True)], cases


def _towards_balance(
    lin: Linearisation,
    unknowns: Float[np.ndarray, "row param"],
    states: Int[np.ndarray, "row"],
    motions: Float[np.ndarray, "row dof wide"],
    here: Imbalance,
    tight: float,
    *,
    refined: bool,
) -> Float[np.ndarray, "row dof wide"]:
    """Of each state the motion on its way that read nearest to balance. **Arguments:** ``here``: the balance of the
    ``motions``.
    """
    found, nearest, share = motions.copy(), here.off.copy(), np.ones(len(states))
    for _ in range(STEP_LIMIT):
        alive = np.flatnonzero((here.off > tight) & (share > SHORTER**LENGTHS) & np.isfinite(here.size))
        if not len(alive):
            break
        lengths = share[alive, None] * SHORTER ** np.arange(np.clip(BALANCED_CHUNK // len(alive), 1, LENGTHS))
        each = np.repeat(alive, lengths.shape[1])
        trial = here.followed[each]
        trial[..., : lin.kernels.coefficients] += lengths.ravel()[:, None, None] * here.step[each]
        there = lin.imbalance(unknowns[each], states[each], trial, refined=refined)
        least = np.nan_to_num(there.size, nan=np.inf).reshape(lengths.shape).argmin(axis=1)
        best = least + np.arange(0, len(each), lengths.shape[1])
        better = there.size[best] < here.size[alive]
        share[alive] = np.where(better, np.minimum(1.0, 2.0 * lengths.ravel()[best]), SHORTER * lengths[:, -1])
        for old, new in zip(here, there, strict=True):
            old[alive[better]] = new[best[better]]
        # Less force that is lacking need not read better: nothing is given up for it.
        nearer = there.off[best] < nearest[alive]
        found[alive[nearer]], nearest[alive[nearer]] = trial[best[nearer]], there.off[best[nearer]]
    return found


def _imbalances(responses: list[MotionResponse], states: Int[np.ndarray, "row"]) -> Imbalance:
    """Of states that are linearised already, one of each."""
    size, off, newton, followed = (
        np.stack([getattr(response, part)[state] for response, state in zip(responses, states, strict=True)])
        for part in ("size", "off", "newton", "followed")
    )
    return Imbalance(size, off, -newton.reshape(*followed.shape[:-1], -1), followed)

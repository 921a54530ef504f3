"""Mistakes in what rig file and table state, drawn by seed beside the effects of `drawn_effects`, made longhand."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from rotorjax import Conditions

from drawn_effects import Hidden, draw
from nonlinear_oracle import DOWN

MIL = 25.4
MORE_KINDS = 31600
"""Seed from which on rms amplitudes, and weights stated of a run without any, are among the mistakes."""

OF_ONE_RUN, PROBES_OF_ONE_RUN = 32100, 32174
"""The same for what is other in one of three runs or more, and for probes exchanged there."""

WRONG_READING = 32300
"""The same for one reading that is wrong."""

Mistake = Callable[[Hidden], Hidden]


def draw_with_mistake(seed: int, beginning: str = "") -> tuple[Hidden, str | None]:
    """Effects as `draw` has them; in every second case beside one mistake that the measurement permits, by its name, if
    any ``beginning`` so does.
    """
    hidden = draw(seed)
    if seed % 2:
        return hidden, None
    possible = _possible(hidden) | (_more(hidden) if seed >= MORE_KINDS else {})
    rng = np.random.default_rng([2611, seed])
    if seed >= OF_ONE_RUN and len(hidden.measurement.runs) >= 3:
        possible |= _of_one_run(hidden, rng, probes=seed >= PROBES_OF_ONE_RUN)
    if seed >= WRONG_READING:
        possible |= _of_one_reading(hidden, rng)
    possible = {name: mistake for name, mistake in possible.items() if name.startswith(beginning)}
    if not possible:
        return hidden, None
    kinds = sorted({name.split(".")[0] for name in possible})
    kind = str(rng.choice(kinds))
    name = str(rng.choice(sorted(name for name in possible if name.split(".")[0] == kind)))
    return possible[name](hidden), name


def _possible(hidden: Hidden) -> dict[str, Mistake]:
    m = hidden.measurement
    unbalance = np.asarray(m.conditions.unbalance)
    first = [int(np.argmax(m.run == k)) for k in range(len(m.runs))]
    seen = [name for k, name in enumerate(m.probes) if m.present[:, k].any()]
    found: dict[str, Mistake] = {
        "phase_sign_reversed": lambda h: _vectors(h, np.conj),
        "amplitude_doubled": lambda h: _scaled(h, 2.0),
        "amplitude_halved": lambda h: _said(_scaled(h, 0.5), "peak-to-peak"),
        "amplitude_unit": lambda h: _scaled(h, 1.0 / MIL),
        "amplitude_unit.mil": lambda h: _scaled(h, MIL),
        "weight_angles_reversed": lambda h: _installed(h, unbalance * np.array([1.0, -1.0])),
    }
    for name in seen:
        sign = np.where(np.array(m.probes) == name, -1.0, 1.0)[:, None]
        found[f"probe_reversed.{name}"] = lambda h, sign=sign: _vectors(h, lambda v: sign * v)
    if len(seen) == 2:
        found["probes_exchanged"] = lambda h: _vectors(h, lambda v: v[:, ::-1])
        found["rotation_reversed"] = _mirrored
    for k, run in enumerate(m.runs):
        there = np.where((m.run == k)[:, None, None], -1.0, 1.0)
        found[f"trial_weight_opposite.{run}"] = lambda h, there=there: _installed(h, unbalance * there)
        for other in range(k + 1, len(m.runs)):
            of = m.run.copy()
            of[m.run == k], of[m.run == other] = other, k
            declared = unbalance[np.array(first)[of]]
            found[f"runs_exchanged.{run}.{m.runs[other]}"] = lambda h, declared=declared: _installed(h, declared)
    if hidden.weight:
        found["weight_direction"] = lambda h: _weighing(h, [0.0, -DOWN[1]])
    elif 0.0 in m.orders:
        found["weight_absent"] = lambda h: _weighing(h, list(DOWN))
    return found


def _more(hidden: Hidden) -> dict[str, Mistake]:
    """Rms amplitudes where peak is stated, and the reverse; and in a run without any weight the one of another run."""
    m = hidden.measurement
    found: dict[str, Mistake] = {
        "amplitude_rms": lambda h: _scaled(h, 0.5**0.5, of_mean=1.0),
        "amplitude_peak": lambda h: _said(_scaled(h, 2.0**0.5, of_mean=1.0), "rms"),
        "amplitude_peak_to_peak": lambda h: _said(_scaled(h, 2.0 * 2.0**0.5, of_mean=2.0), "rms"),
    }
    of_run = np.asarray(m.conditions.unbalance)[[int(np.argmax(m.run == k)) for k in range(len(m.runs))]]
    loaded = [k for k, weight in enumerate(of_run) if np.any(weight)]
    for k, run in enumerate(m.runs):
        if k not in loaded and loaded:
            declared = of_run[np.where(m.run == k, loaded[0], m.run)]
            found[f"trial_weight_absent.{run}"] = lambda h, declared=declared: _installed(h, declared)
    return found


def _of_one_run(hidden: Hidden, rng: np.random.Generator, *, probes: bool) -> dict[str, Mistake]:
    """In one run a weight of another size at another angle, another phase reference, amplitudes of another kind, speeds
    that are off, or its two ``probes`` exchanged.
    """
    m, found = hidden.measurement, dict[str, Mistake]()
    unbalance, orders = np.asarray(m.conditions.unbalance), np.array(m.orders)
    size, turn = np.exp(rng.uniform(-0.7, 0.7)), rng.uniform(0.3, 2.5)
    turned = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    phase, factor, ratio = rng.uniform(0.2, 2.0), float(rng.choice([0.5, 2.0])), 1.0 + rng.uniform(0.01, 0.05)
    for k, run in enumerate(m.runs):
        own = m.run == k
        if np.any(unbalance[own]):
            declared = np.where(own[:, None, None], unbalance @ turned.T, unbalance)
            found[f"run_unbalance.{run}"] = lambda h, declared=declared: _installed(h, declared)
        later = np.where(own[:, None], np.exp(1j * phase * orders), 1.0)[:, None, :]
        found[f"run_phase.{run}"] = lambda h, later=later: _vectors(h, lambda v: v * later)
        larger = np.where(own, factor, 1.0)[:, None, None]
        found[f"run_amplitude.{run}"] = lambda h, larger=larger: _scaled(h, larger)
        speed = np.asarray(m.conditions.speed) * np.where(own, ratio, 1.0)
        found[f"run_speed.{run}"] = lambda h, speed=speed: _at_speeds(h, speed)
        if probes and m.present[:, 0].any() and m.present[:, 1].any():
            exchanged = own[:, None, None]
            found[f"run_probes_exchanged.{run}"] = lambda h, exchanged=exchanged: _vectors(
                h, lambda v: np.where(exchanged, v[:, ::-1], v)
            )
    return found


def _of_one_reading(hidden: Hidden, rng: np.random.Generator) -> dict[str, Mistake]:
    """One reading that shows well ten times as large or as small, turned by half a turn or with the other sign of its
    phase, with another digit, or that of another line.
    """
    m = hidden.measurement
    deviation = np.full(m.vectors.shape, 0.03 * m.rms) if m.sigma is None else m.sigma
    clear = np.argwhere(m.present & (np.abs(m.vectors) > 10.0 * deviation))
    if not len(clear):
        return {}
    cell, other = (tuple(int(k) for k in clear[rng.integers(len(clear))]) for _ in range(2))
    z = complex(m.vectors[cell])
    typed = [10.0 * z, 0.1 * z, -z, z.conjugate(), float(rng.choice([0.6, 1.5])) * z, complex(m.vectors[other])]
    typed = [one for one in typed if abs(one - z) > 10.0 * deviation[cell]]
    if not typed:
        return {}
    vectors = m.vectors.copy()
    vectors[cell] = typed[rng.integers(len(typed))]
    case, probe, order = cell
    parts = [m.runs[m.run[case]], f"{m.speed_rpm[case]:.0f}rpm", m.probes[probe]]
    parts += [f"{m.orders[order]:g}X"] if len(m.orders) > 1 else []
    return {".".join(["wrong_reading", *parts]): lambda h: _vectors(h, lambda _: vectors)}


def _vectors(hidden: Hidden, change: Callable[[np.ndarray], np.ndarray]) -> Hidden:
    m = hidden.measurement
    return dataclasses.replace(hidden, measurement=dataclasses.replace(m, vectors=change(m.vectors)))


def _scaled(hidden: Hidden, factor: float | np.ndarray, *, of_mean: float | None = None) -> Hidden:
    """Numbers of the table times a factor, by case if need be, at order 0 times another: the rms value of a constant is
    the constant.
    """
    m = hidden.measurement
    factors = np.where(np.array(m.orders) == 0.0, factor if of_mean is None else of_mean, factor)
    sigma = None if m.sigma is None else m.sigma * factors
    return dataclasses.replace(hidden, measurement=dataclasses.replace(m, vectors=factors * m.vectors, sigma=sigma))


def _said(hidden: Hidden, amplitude: str) -> Hidden:
    m = hidden.measurement
    knowledge = dataclasses.replace(m.knowledge, amplitude=amplitude)
    return dataclasses.replace(hidden, measurement=dataclasses.replace(m, knowledge=knowledge))


def _installed(hidden: Hidden, unbalance: np.ndarray) -> Hidden:
    m = hidden.measurement
    conditions = Conditions.at(np.asarray(m.conditions.speed), unbalance=unbalance)
    return dataclasses.replace(hidden, measurement=dataclasses.replace(m, conditions=conditions))


def _at_speeds(hidden: Hidden, speed: np.ndarray) -> Hidden:
    m = hidden.measurement
    conditions = Conditions.at(speed, unbalance=np.asarray(m.conditions.unbalance), bow=np.asarray(m.conditions.bow))
    return dataclasses.replace(hidden, measurement=dataclasses.replace(m, conditions=conditions))


def _mirrored(hidden: Hidden) -> Hidden:
    """What a shaft does that turns the other way than the rig file says: probe Y looks from the other side, and weight
    acts from there.
    """
    probes = dataclasses.replace(hidden.model.probes, angle=jnp.asarray(-np.asarray(hidden.model.probes.angle)))
    mirrored = dataclasses.replace(hidden, model=dataclasses.replace(hidden.model, probes=probes))
    return _weighing(mirrored, [0.0, -DOWN[1]]) if hidden.weight else mirrored


def _weighing(hidden: Hidden, gravity: list[float]) -> Hidden:
    model = eqx.tree_at(lambda m: m.rotor.gravity, hidden.model, jnp.asarray(gravity))
    return dataclasses.replace(hidden, model=model)

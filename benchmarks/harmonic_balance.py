"""Steady states under nonlinear forces: harmonic balance beside integration in time until the transient is
gone.

A stiffening shaft, and a stop at the end of a gap, on 60 conditions. Peers: SciPy's DOP853, one condition after the
other (ten of them, times six), and diffrax' Dopri8, all conditions at once, compiled. Both integrate until e^-9 of the
transient is left, where their vectors agree with ours to a thousandth, which is checked first. Called by
`benchmarks/run.py`; as a program it prints its rows.

    python benchmarks/harmonic_balance.py
"""

from collections.abc import Callable

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from timing import best, timed

from rotorjax import Conditions, Effect, Jeffcott, Model, effects, response
from rotorjax.reporting.tables import Table

ROTOR = Jeffcott(0.9686, [56538.0, 51282.0], [0.03, 0.05])
SPEEDS = np.linspace(90.0, 400.0, 20)
UNBALANCE = np.array([5e-6, 8e-6, 12e-6])
CUBIC, CONTACT, GAP = 3e10, 1.5e4, 6e-5
LEFT, SAMPLES = 9.0, 32
SOME = np.arange(3, 60, 6)
FORCES: dict[str, tuple[Effect, Callable[..., jax.Array | np.ndarray]]] = {
    "duffing": (effects.Duffing(CUBIC), lambda q, np_: CUBIC * np_.sum(q**2) * q),
    "clearance": (
        effects.Clearance(CONTACT, 1.0 / GAP),
        lambda q, np_: CONTACT * np_.maximum(1.0 - GAP / np_.sqrt(np_.sum(q**2) + 1e-30), 0.0) * q,
    ),
}


def conditions() -> Conditions:
    """Twenty speeds with three unbalances, rad/s and kg m."""
    return Conditions.at(
        np.tile(SPEEDS, 3), unbalance=np.stack([np.repeat(UNBALANCE, 20), np.zeros(60)], axis=1)[:, None]
    )


def times_of(speed: float, period: Callable[[float], float]) -> tuple[float, np.ndarray]:
    """End of the transient on a whole turn, and the instants of one turn after it [s]."""
    slowest = float(np.min(np.asarray(ROTOR.damping)) / (2.0 * float(ROTOR.mass)))
    turns = np.ceil(LEFT / slowest / period(speed))
    return turns * period(speed), (turns + np.arange(SAMPLES) / SAMPLES) * period(speed)


def turn_of(speed: float) -> float:
    return 2.0 * np.pi / speed


def first_order(waves: np.ndarray) -> np.ndarray:
    """1X of one turn; last axis: instant."""
    return 2.0 * np.mean(waves * np.exp(-2j * np.pi * np.arange(SAMPLES) / SAMPLES), axis=-1)


def scipy_vectors(force: Callable[..., np.ndarray], speed: float, unbalance: float) -> np.ndarray:
    stiffness, damping, mass = np.asarray(ROTOR.stiffness), np.asarray(ROTOR.damping), float(ROTOR.mass)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = state[:2], state[2:]
        pull = unbalance * speed**2 * np.array([np.cos(speed * t), np.sin(speed * t)])
        return np.concatenate([v, (pull - stiffness * q - damping * v - force(q, np)) / mass])

    _, instants = times_of(speed, turn_of)
    found = solve_ivp(rate, (0.0, instants[-1]), np.zeros(4), "DOP853", instants, rtol=1e-8, atol=1e-13)
    return first_order(found.y[:2])


def scipy_some(force: Callable[..., np.ndarray], at: Conditions) -> np.ndarray:
    return np.stack([scipy_vectors(force, float(at.speed[k]), float(at.unbalance[k, 0, 0])) for k in SOME])


def diffrax_vectors(force: Callable[..., jax.Array]) -> Callable[[], np.ndarray]:
    """All conditions at once; time in turns, so that all end together."""
    stiffness, damping, mass = ROTOR.stiffness, ROTOR.damping, ROTOR.mass
    slowest = times_of(float(SPEEDS[-1]), turn_of)[1][0] / turn_of(float(SPEEDS[-1]))
    instants = jnp.asarray(slowest + np.arange(SAMPLES) / SAMPLES)
    micro = 1e-6

    @jax.jit
    @jax.vmap
    def integrate(speed: jax.Array, unbalance: jax.Array) -> jax.Array:
        def rate(turns: jax.Array, state: jax.Array, _: None) -> jax.Array:
            q, v, angle = state[:2] * micro, state[2:] * micro * speed, 2.0 * jnp.pi * turns
            pull = unbalance * speed**2 * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
            change = jnp.concatenate([v, (pull - stiffness * q - damping * v - force(q, jnp)) / mass / speed])
            return change / micro * 2.0 * jnp.pi / speed

        controller, save = diffrax.PIDController(rtol=1e-7, atol=1e-7), diffrax.SaveAt(ts=instants)
        term, solver = diffrax.ODETerm(rate), diffrax.Dopri8()
        found = diffrax.diffeqsolve(
            term,
            solver,
            0.0,
            instants[-1],
            None,
            jnp.zeros(4),
            saveat=save,
            stepsize_controller=controller,
            max_steps=100_000,
        )
        assert found.ys is not None
        return found.ys[:, :2].T * micro

    at = conditions()
    return lambda: first_order(np.asarray(integrate(at.speed, at.unbalance[:, 0, 0])))


def rows() -> list[list[str]]:
    """What, our seconds, peer, its seconds, ratio."""
    table = []
    for name, (effect, force) in FORCES.items():
        model, at = Model(ROTOR) + effect, conditions()
        ours = np.asarray(response(model, at))[:, :, 0]
        by_diffrax = diffrax_vectors(force)
        by_scipy, alone = timed(lambda force=force, at=at: scipy_some(force, at))
        largest = np.max(np.abs(ours), axis=1, keepdims=True)
        for what, theirs, mine in (("SciPy", by_scipy, SOME), ("diffrax", by_diffrax(), slice(None))):
            apart = np.max(np.abs(theirs - ours[mine]) / largest[mine])
            assert apart < 2e-3, f"{name}: {what} is {apart:.1e} apart"
        mine = best(lambda model=model, at=at: response(model, at).block_until_ready(), 5)
        seconds = {
            "SciPy DOP853": 6.0 * alone,
            "diffrax Dopri8, all at once": best(by_diffrax, 2),
        }
        table += [
            [f"{name}: 60 steady states", f"{mine:.4f}", peer, f"{spent:.2f}", f"{spent / mine:.0f}"]
            for peer, spent in seconds.items()
        ]
    return table


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print(Table("", ["what", "rotorjax s", "peer", "peer s", "peer / ours"], rows()).text())


if __name__ == "__main__":
    main()

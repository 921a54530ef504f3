"""Whirl modes of the linear rotor: eigenvalues of its equation of motion at a speed, without forces that depend on
motion.

One program serves every model and number of speeds, as in `rotorjax.inference.linear_rotor`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex, Float

from rotorjax.effects import CATALOG
from rotorjax.inference.programs import LINEAR_CHUNK, compiled, nameless
from rotorjax.model.conditions import Conditions
from rotorjax.model.contract import MatrixEffect, SpeedEffect, SupportEffect
from rotorjax.model.model import Model
from rotorjax.physics.assembly import true_speed
from rotorjax.physics.harmonic_balance import make_grid
from rotorjax.physics.steady_state import by_order, without_coupling
from rotorjax.physics.time_integration import linear_in_time
from rotorjax.units import RPM

STRUCTURE = MatrixEffect | SupportEffect | SpeedEffect
"""Effects that change the equation of motion, or the speed at which it holds; all others act on it, or are read."""
ROUNDING = 1e-9
"""Part of an eigenvalue that is rounding: smaller real or imaginary parts count as none."""


class WhirlModes(NamedTuple):
    """Motions q(t) = shape e^{st} of the rotor at each of some speeds, state (disk x, y, foundation x, y)."""

    speed: Float[np.ndarray, "speed"]
    """Ω, rad/s: the true one, where the speed read is off."""
    eigenvalue: Complex[np.ndarray, "speed state"]
    """s [1/s], both of every conjugate pair."""
    unbalance_share: Complex[np.ndarray, "speed state dof"]
    """What each mode contributes to the motion of the disk under a unit unbalance, over Ω² [1/kg]."""
    spin: int
    """+1 for a shaft turning from x to y, else -1."""
    shape: Complex[np.ndarray, "speed state dof"]
    """Motion of the disk in each mode, of any size."""

    @property
    def whirls(self) -> Bool[np.ndarray, "speed state"]:
        """Whether a mode oscillates; one of every conjugate pair, that with e^{+iωt}."""
        return np.imag(self.eigenvalue) > ROUNDING * np.abs(self.eigenvalue)

    @property
    def frequency(self) -> Float[np.ndarray, "speed state"]:
        """Undamped natural frequency |s| [rad/s]."""
        return np.abs(self.eigenvalue)

    @property
    def damping_ratio(self) -> Float[np.ndarray, "speed state"]:
        """ζ = -Re(s) / |s|, negative where a mode grows."""
        return _damping_ratio(self.eigenvalue)


def _damping_ratio(eigenvalue: Complex[np.ndarray, "speed state"]) -> Float[np.ndarray, "speed state"]:
    ratio = -np.real(eigenvalue) / np.maximum(np.abs(eigenvalue), 1e-300)
    return np.where(np.abs(ratio) > ROUNDING, ratio, 0.0)


class _InTime(NamedTuple):
    """M⁻¹, C, K of every speed, and whether they say all of the rotor."""

    inverse_mass: Float[np.ndarray, "speed state state"]
    damping: Float[np.ndarray, "speed state state"]
    stiffness: Float[np.ndarray, "speed state state"]
    exists: Bool[np.ndarray, "speed"]
    speed: Float[np.ndarray, "speed"]

    @property
    def state_matrix(self) -> Float[np.ndarray, "speed entry entry"]:
        """Of (q, q̇ / Ω), whose entries are of one size."""
        size, turning = self.stiffness.shape[-1], self.speed[:, None, None]
        matrix = np.zeros((len(self.speed), 2 * size, 2 * size))
        matrix[:, :size, size:] = turning * np.eye(size)
        matrix[:, size:, :size] = -(self.inverse_mass @ self.stiffness) / turning
        matrix[:, size:, size:] = -(self.inverse_mass @ self.damping)
        return matrix


class RotorInTime:
    """M q̈ + C q̇ + K q = 0 at any speeds, of a model in company of all effects of the catalogue that change it."""

    def __init__(self, model: Model) -> None:
        linear = without_coupling(model)
        own = linear.without(*(e.name for e in linear.effects if not isinstance(e, STRUCTURE)))
        full = own.with_null_effects(cls for cls in CATALOG.values() if issubclass(cls, STRUCTURE))
        self._spin = int(model.rotor.spin)
        self._at = compiled(_matrices, nameless(full), full, LINEAR_CHUNK)

    def make(self) -> None:
        """Make its program."""
        self._at.make(np.ones(1))

    def matrices(self, speed_rpm: Float[np.ndarray, "speed"]) -> _InTime | None:
        """Of every speed; none where an effect depends on frequency as no spring, damper or mass does, or leaves no
        mass or no speed.
        """
        found = _InTime(*self._at(np.asarray(speed_rpm, float) * RPM))
        known = np.all(found.exists) and np.all(found.speed > 0.0)
        if not known or not all(np.all(np.isfinite(part)) for part in found):
            return None
        # What the disk does not move is no foundation, but the place of one.
        moved = np.any(found.stiffness[:, :, :2] != 0.0, axis=(0, 2))
        inner = np.ix_(np.ones(len(speed_rpm), bool), moved, moved)
        mass, damping, stiffness = (part[inner] for part in (found.inverse_mass, found.damping, found.stiffness))
        return _InTime(mass, damping, stiffness, found.exists, found.speed)

    def modes(self, speed_rpm: Float[np.ndarray, "speed"]) -> WhirlModes | None:
        """Whirl modes at every speed; none as above.

        With the state (q, q̇) the motion under the force f e^{iΩt} is Σ v_i (V⁻¹ b)_i / (iΩ - s_i), b = (0, M⁻¹ f),
        f = (1, -i) for a shaft that turns from x to y.
        """
        found = self.matrices(speed_rpm)
        if found is None:
            return None
        inverse_mass, speed, size = found.inverse_mass, found.speed, found.stiffness.shape[-1]
        eigenvalue, shape = np.linalg.eig(found.state_matrix)
        force = np.zeros((len(speed), 2 * size, 1), complex)
        force[:, size:, 0] = inverse_mass[:, :, :2] @ np.array([1.0, -1j * self._spin]) / speed[:, None]
        detuned = 1j * speed[:, None] - eigenvalue
        # Without damping the response at the critical speed has no end.
        detuned = np.where(np.abs(detuned) < ROUNDING * speed[:, None], ROUNDING * speed[:, None], detuned)
        # At critical damping two modes are one, and their shapes cannot be told apart.
        part = (np.linalg.pinv(shape) @ force)[:, :, 0] / detuned
        shares = part[:, :, None] * np.swapaxes(shape[:, :2], 1, 2)
        return WhirlModes(speed, eigenvalue + 0j, shares, self._spin, np.swapaxes(shape[:, :2], 1, 2) + 0j)

    def least_damping_ratio(self, speed_rpm: Float[np.ndarray, "speed"]) -> Float[np.ndarray, "speed"] | None:
        """Of all modes at every speed, negative where one grows; none as above."""
        found = self.matrices(speed_rpm)
        if found is None:
            return None
        return np.min(_damping_ratio(np.linalg.eigvals(found.state_matrix)), axis=1)

    def unbalance_response(self, speed_rpm: Float[np.ndarray, "speed"]) -> Complex[np.ndarray, "speed dof"] | None:
        """Motion of the disk under a unit unbalance, over Ω² [1/kg]; none as above."""
        found = self.matrices(speed_rpm)
        if found is None:
            return None
        speed = found.speed[:, None, None]
        dynamic = found.stiffness + 1j * speed * found.damping - speed**2 * np.linalg.inv(found.inverse_mass)
        force = np.zeros((*dynamic.shape[:2], 1), complex)
        force[:, :2, 0] = 1.0, -1j * self._spin
        return np.linalg.solve(dynamic, force)[:, :2, 0]


def _matrices(model: Model, speed: Array) -> tuple[Array, ...]:
    grid = make_grid((1.0,), model.harmonic_balance)
    whole = model.with_orders(grid.orders)
    nothing = Conditions(jnp.zeros(()), jnp.zeros((len(model.layout.planes), 2)), jnp.zeros(2))

    def row(speed: Array) -> tuple[Array, ...]:
        turning = true_speed(model, speed)
        assembled, _ = by_order(whole, Conditions(turning, nothing.unbalance, nothing.bow), grid)
        found = linear_in_time(whole, assembled, turning * jnp.asarray(grid.orders))
        return found.inverse_mass, found.damping, found.stiffness, found.exists, turning

    return jax.vmap(row)(speed)

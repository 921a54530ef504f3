"""Harmonic balance by alternating frequency and time: the steady state under nonlinear forces.

Motion over one period of the base order: q(φ) = a_0 + Σ Re[q_n e^{inφ}], φ = Ωt. Its coefficients y, per direction
(a_0, Re q_n, Im q_n, ...), solve y = L(F - N(y)): L the linear rotor, order by order, N(y) the same coefficients of the
restoring force along the motion (Cameron, Griffin 1989, J. Appl. Mech. 56(1):149-154).
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float, Int

from rotorjax.errors import InputError
from rotorjax.model.conditions import HarmonicBalance
from rotorjax.model.model import Model

PARTS = (1, 2, 3, 4)
"""A period may be this many turns, for orders 1/2, 1/3, 1/4."""
SMALLEST_MOTION = 1e-9
"""Size [m] below which a motion counts as rest when tolerances are set."""
BALANCED, NOT_BALANCED, UNSTABLE = 0, 1, 2
"""A steady state was found; none was; one was found in which the machine does not stay."""


class Grid(NamedTuple):
    """The orders that are balanced, and the instants of one period."""

    orders: tuple[float, ...]
    """Multiples of the base order, zero first."""
    turns: int
    """Turns of the shaft in one period."""
    samples: int
    """Instants per turn."""
    settings: HarmonicBalance

    @property
    def order_array(self) -> Float[np.ndarray, "order"]:
        """The orders as numbers."""
        return np.array(self.orders)

    @property
    def angle(self) -> Float[np.ndarray, "instant"]:
        """Shaft angle at every instant."""
        return 2.0 * math.pi * np.arange(self.samples * self.turns) / self.samples

    @property
    def finer(self) -> "Grid":
        """More orders, and more instants."""
        highest = max(self.settings.fine_order * self.turns, len(self.orders) - 1)
        orders = tuple(k / self.turns for k in range(highest + 1))
        return self._replace(orders=orders, samples=_enough(self.settings.fine_samples, orders[-1]))

    def synthesis(self, angle: Float[np.ndarray, "instant"]) -> Float[np.ndarray, "coefficient instant"]:
        """Waveform of each coefficient."""
        phase = np.outer(self.order_array[1:], angle)
        pairs = np.stack([np.cos(phase), -np.sin(phase)], axis=1).reshape(-1, len(angle))
        return np.concatenate([np.ones((1, len(angle))), pairs])

    def slope(self, angle: Float[np.ndarray, "instant"]) -> Float[np.ndarray, "coefficient instant"]:
        """Its derivative by the shaft angle."""
        orders = self.order_array[1:, None]
        phase = orders * angle
        pairs = np.stack([-orders * np.sin(phase), -orders * np.cos(phase)], axis=1).reshape(-1, len(angle))
        return np.concatenate([np.zeros((1, len(angle))), pairs])

    def analysis(self) -> Float[np.ndarray, "instant coefficient"]:
        """From the instants to the coefficients."""
        weight = np.where(np.arange(2 * len(self.orders) - 1) == 0, 1.0, 2.0) / (self.samples * self.turns)
        return (self.synthesis(self.angle) * weight[:, None]).T

    def products(
        self,
    ) -> tuple[Float[np.ndarray, "instant mode"], Float[np.ndarray, "kind mode coefficient coefficient"]]:
        """From slopes at instants to a Jacobian: analysis of the b-th coefficient times synthesis of the c-th, for
        position and for velocity.

        As products of two waveforms of orders up to n have orders up to 2n only, in two factors: instants to
        orthonormal waveforms of those orders, if they are fewer, and these to coefficients.
        """
        angle, orders = self.angle, range(2 * len(self.orders) - 1)
        modes = np.eye(len(angle))
        if 2 * len(orders) - 1 < len(angle):
            whole = self._replace(orders=tuple(k / self.turns for k in orders)).synthesis(angle)
            modes = (whole / np.linalg.norm(whole, axis=1, keepdims=True)).T
        both = np.stack([self.synthesis(angle), self.slope(angle)])
        return modes, np.einsum("sm,sb,kcs->kmbc", modes, self.analysis(), both, optimize=True)


@functools.lru_cache
def make_grid(orders: tuple[float, ...], settings: HarmonicBalance) -> Grid:
    """The grid that holds these orders.

    **Errors.** `InputError` for an order that is no multiple of 1, 1/2, 1/3 or 1/4.
    """
    turns = next((k for k in PARTS if all(abs(order * k - round(order * k)) < 1e-9 for order in orders)), None)
    if turns is None:
        shown = ", ".join(f"{order:g}" for order in orders)
        raise InputError(
            f"orders {shown}: with a nonlinear force they must be multiples of 1, 1/2, 1/3 or 1/4; leave the others out"
        )
    highest = max(settings.least_order, math.ceil(max(orders)) + settings.margin)
    orders = tuple(k / turns for k in range(highest * turns + 1))
    return Grid(orders, turns, _enough(settings.samples, orders[-1]), settings)


def _enough(samples: int, highest: float) -> int:
    """Instants per turn that tell the highest order from every lower one."""
    return max(samples, 2 ** math.ceil(math.log2(2.0 * highest + 1.0)))


def grid_of(model: Model) -> Grid:
    """The grid of a model."""
    return make_grid(model.layout.orders, model.harmonic_balance)


def to_complex(coefficients: Float[Array, "*dof coefficient"]) -> Complex[Array, "*dof order"]:
    """Complex amplitude of every order; that of order 0 is real."""
    real = jnp.concatenate([coefficients[..., :1], coefficients[..., 1::2]], axis=-1)
    imaginary = jnp.concatenate([jnp.zeros_like(coefficients[..., :1]), coefficients[..., 2::2]], axis=-1)
    return jax.lax.complex(real, imaginary)


def to_real(amplitudes: Complex[Array, "*dof order"]) -> Float[Array, "*dof coefficient"]:
    """Coefficients of complex amplitudes."""
    pairs = jnp.stack([amplitudes[..., 1:].real, amplitudes[..., 1:].imag], axis=-1)
    return jnp.concatenate([amplitudes[..., :1].real, pairs.reshape(*pairs.shape[:-2], 2 * pairs.shape[-2])], axis=-1)


class Balance(NamedTuple):
    """The steady state that was found."""

    coefficients: Float[Array, "dof coefficient"]
    """Not finite where none was found."""
    result: Int[Array, ""]
    """BALANCED or NOT_BALANCED."""


Coefficients = Float[Array, "dof coefficient"]
Along = Callable[[Coefficients], Coefficients]


class System(NamedTuple):
    """A linear rotor, and what restores it beyond."""

    moved: Along
    """Motion of the linear rotor under forces of these coefficients alone."""
    lacking: Along
    """D y - F: the force that the linear rotor and its own excitation lack along a motion."""
    force: Along
    """Coefficients of the restoring force along a motion."""
    slopes: Callable[[Coefficients], Float[Array, "dof coefficient dof coefficient"]]
    """Its derivatives by those of the motion."""
    free: Coefficients
    """Motion of the linear rotor under its own excitation."""
    brake: Along
    """Coefficients of the force of a strong viscous brake along a motion."""
    settings: HarmonicBalance


def _miss(system: System, motion: Coefficients) -> Coefficients:
    """y - L(F - N(y))."""
    return motion + system.moved(system.force(motion)) - system.free


def _jacobian(system: System, motion: Coefficients) -> Float[Array, "unknown unknown"]:
    """Derivative of the miss: 1 + L N'."""
    return moved_columns(system, columns_of(system, motion))


def columns_of(system: System, motion: Coefficients) -> Float[Array, "unknown dof coefficient"]:
    """N': change of the restoring force by each unknown."""
    return jnp.moveaxis(system.slopes(motion), (2, 3), (0, 1)).reshape(motion.size, *motion.shape)


def moved_columns(system: System, columns: Float[Array, "unknown dof coefficient"]) -> Float[Array, "unknown unknown"]:
    """1 + L times the changes of a force by each unknown."""
    return jnp.eye(len(columns)) + jax.vmap(system.moved)(columns).reshape(len(columns), -1).T


class Root(NamedTuple):
    """Where Newton's method ended."""

    point: Coefficients
    good: Array
    """Whether at a root."""
    inverse: Float[Array, "unknown unknown"]
    """Of the last Jacobian."""


def _newton(system: System, start: Coefficients, tolerance: Array) -> Root:
    """Newton's method."""

    def step(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        point, _, count, _ = state
        by_miss = inverse(_jacobian(system, point))
        change = (by_miss @ _miss(system, point).ravel()).reshape(point.shape)
        return point - change, jnp.max(jnp.abs(change)), count + 1, by_miss

    def going(state: tuple[Array, Array, Array, Array]) -> Array:
        # A change that is not a number ends it too.
        return (state[2] < system.settings.newton_steps) & (state[1] > tolerance)

    begin = (start, jnp.asarray(jnp.inf), jnp.asarray(0), jnp.zeros((start.size, start.size)))
    point, change, _, by_miss = jax.lax.while_loop(going, step, begin)
    return Root(point, change <= tolerance, by_miss)


def inverse(matrix: Float[Array, "unknown unknown"]) -> Float[Array, "unknown unknown"]:
    """Inverse by Gauss-Jordan elimination in place, without pivoting: 1 + L N' has its weight on the diagonal.

    LAPACK's, called for a batch from within nested loops, was seen to wait for threads that never come (jax 0.10.2, two
    cores).
    """
    index = jnp.arange(len(matrix))

    def eliminate(k: Array, table: Array) -> Array:
        row = jax.lax.dynamic_index_in_dim(table, k, 0, keepdims=False)
        column = jax.lax.dynamic_index_in_dim(table, k, 1, keepdims=False)
        pivot = jax.lax.dynamic_index_in_dim(row, k, 0, keepdims=False)
        row = jnp.where(index == k, 1.0, row) / pivot
        rest = jnp.where((index == k)[None], 0.0, table) - column[:, None] * row[None]
        return jnp.where((index == k)[:, None], row[None], rest)

    return jax.lax.fori_loop(0, len(matrix), eliminate, matrix)


def size_of(system: System) -> Array:
    """Of the free motion [m]."""
    return jnp.maximum(jnp.max(jnp.abs(system.free)), SMALLEST_MOTION)


def _tolerance(system: System) -> Array:
    return system.settings.tolerance * size_of(system)


def balance(system: System, frozen: System, finer: System, start: Coefficients) -> Balance:
    """Solve y = L(F - N(y)) by Newton's method from a start near by; differentiable once, by the implicit function
    theorem.

    One more step, with the last Jacobian, has the derivative -J⁻¹ L ∂(D y + N - F)/∂p; it and a few more see what few
    instants and orders miss of a corner. **Arguments:** ``frozen``: the same equations without derivatives by
    parameters; ``finer``: these with more orders and instants.
    """
    root = _newton(frozen, start, _tolerance(frozen))
    point = jnp.where(root.good, root.point, 0.0)

    def step(force: Coefficients) -> Coefficients:
        return (root.inverse @ frozen.moved(force).ravel()).reshape(point.shape)

    unseen = finer.force(_widened(point, finer))[:, : point.shape[1]] - frozen.force(point)
    after = point - step(system.lacking(point) + system.force(point) + unseen)
    there = jax.lax.stop_gradient(after)
    best = _corrected(finer, root.inverse, there, _tolerance(frozen))
    return Balance(jnp.where(root.good, after + (best - there), jnp.nan), jnp.where(root.good, BALANCED, NOT_BALANCED))


def _widened(motion: Coefficients, finer: System) -> Float[Array, "dof wide"]:
    """A motion among more orders."""
    return jnp.pad(motion, ((0, 0), (0, finer.free.shape[1] - motion.shape[1])))


def in_full(finer: System, motion: Coefficients) -> Float[Array, "dof wide"]:
    """A motion with the higher orders, too, which follow the force along it."""
    wide = _widened(motion, finer)
    return jnp.concatenate([motion, (wide - _miss(finer, wide))[:, motion.shape[1] :]], axis=1)


def _corrected(finer: System, by_miss: Array, motion: Coefficients, tolerance: Array) -> Coefficients:
    """A motion made to balance at the orders and instants of ``finer``, as long as that leads on; of it the orders that
    it had.

    By the inverse of a Jacobian of these orders; those above follow the force, which their inertia withstands.
    """
    count, settings = motion.shape[1], finer.settings

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        point, best, smallest, _, made = state
        miss = _miss(finer, point)
        change = jnp.concatenate([(by_miss @ miss[:, :count].ravel()).reshape(motion.shape), miss[:, count:]], axis=1)
        size = jnp.max(jnp.abs(change))
        point = point - change
        return (
            point,
            jnp.where(size < smallest, point, best),
            jnp.minimum(size, smallest),
            size < settings.diverges * smallest,
            made + 1,
        )

    wide = _widened(motion, finer)
    begin = (wide, wide, jnp.asarray(jnp.inf), jnp.asarray(True), jnp.asarray(0))

    def going(state: tuple[Array, ...]) -> Array:
        return state[3] & (state[2] > tolerance) & (state[4] < settings.corrections)

    return jax.lax.while_loop(going, step, begin)[1][:, :count]


def settled(system: System, start: Coefficients, finer: System | None = None) -> Coefficients:
    """The steady state to which Newton's method leads from a start, or not a number. Not to be differentiated.

    **Arguments:** ``finer``: as in `balance`, to end with.
    """
    root = _newton(system, start, _tolerance(system))
    point = root.point if finer is None else _corrected(finer, root.inverse, root.point, _tolerance(system))
    return jnp.where(root.good, point, jnp.nan)

"""The force that a model lacks, from the measured motion, and the simple term that it looks like.

Order by order the measured motion is put into the equation of motion: R = D q + N(q) - F is what acts on the rotor
beside the model. A sparse regression of R on force terms along that motion is linear and names terms that can be added
as effects (Brunton, Proctor, Kutz 2016, Proc. Natl. Acad. Sci. 113:3932-3937). Plain equation error would trust most
what the dynamic stiffness amplifies; the squares counted here are those of the change of the measured vectors, in
standard errors, that brings the equation into balance.
"""

import dataclasses
import itertools
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Complex, Float, Int

from rotorjax._core import MICROMETRE, AnyArray, require_float64
from rotorjax._planar import Vector
from rotorjax.assembly import true_speed
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import STEP, TERMS, Reach, Shape, beyond, shapes
from rotorjax.harmonic import Grid, make_grid, to_complex, to_real
from rotorjax.measurement import Measurement
from rotorjax.model import Conditions, Effect, Model, ReadingEffect, SpeedEffect, WaveformEffect
from rotorjax.response import vectors
from rotorjax.steady import by_order, in_space, restoring, restoring_system, without_timed

LEAST_SIGHT = 1e-2
"""Least over largest sensitivity of the probes of a case from which on both directions count as seen."""
FINER = (-0.05, -0.035, -0.02, -0.01, 0.01, 0.02, 0.035, 0.05)
"""Gaps tried around the best one, in the largest displacement."""
BATCH = 16
"""Terms per call of the compiled function."""
PASSES = 5
"""Of the weights, which the term itself changes where the rotor is near resonance."""
LEAST_GAIN, LEAST_SHARE = 10.0, 1e-3
"""A term counts if chi-square falls by so much beyond the Bayesian information criterion (very strong: Kass, Raftery 1995, J. Am. Stat. Assoc. 90:773-795),
and by this share of what all is about: 3 % in amplitude."""
NO_SHARE, TINY = 1e-9, 1e-30
"""Of the measured motion: a force that moves it less is nothing."""
TOUCHED, LEAST_TOUCHED = 1e-2, 3
"""A gap is reached in a case where its force is this share of the largest one; cases in which it must be."""


@dataclasses.dataclass(frozen=True)
class MissingForce:
    """The force R on the rotor beside the model, D q + N(q) = F + R, along the motion that was measured.

    Waveforms hold the measured orders only; what an order without probes does is taken from the linear model.
    """

    model: Model
    """What the force is missing from, at the measured orders."""
    measurement: Measurement
    reason: str | None
    """Why nothing can be said, or none."""
    usable: Bool[np.ndarray, "case"]
    """Cases in which the probes see both directions."""
    angle: Float[np.ndarray, "instant"]
    """Shaft angle over one period [rad]."""
    force: Float[np.ndarray, "case dof instant"]
    """[N], zero in cases that are not usable."""
    force_error: Float[np.ndarray, "case dof instant"]
    """Its standard error [N]; of an assumed 1 µm where the noise is unknown."""
    displacement: Float[np.ndarray, "case dof instant"]
    """[m]; ``velocity`` [m/s]."""
    velocity: Float[np.ndarray, "case dof instant"]
    amplitude: Complex[np.ndarray, "case dof order"]
    """R_n of every order of the measurement: force(φ) = Σ Re[R_n e^{inφ}] [N]."""
    amplitude_error: Float[np.ndarray, "case dof order"]
    """Standard error of its real and imaginary parts [N]."""
    balance: "Balance | None"
    """What a regression works on."""

    @property
    def rms(self) -> Float[np.ndarray, "case"]:
        """Root mean square of the force over a period, x and y together, less what noise adds to it, per case [N]."""
        return np.sqrt(np.maximum(np.mean(np.sum(self.force**2 - self.force_error**2, axis=1), axis=1), 0.0))

    @property
    def reach(self) -> Reach:
        """Largest displacement in the cases that are usable."""
        moves = self.displacement[self.usable]
        x, y, radius = np.abs(moves[:, 0]), np.abs(moves[:, 1]), np.hypot(moves[:, 0], moves[:, 1])
        return Reach(float(np.max(x)), float(np.max(y)), float(np.max(radius)))


class Balance(NamedTuple):
    """The equations of motion at the measured motion, as real numbers: (x, then y) times (mean, then Re, Im per order)."""

    motion: Float[np.ndarray, "case dof coefficient"]
    """At all orders of the grid [m]."""
    measured: Int[np.ndarray, "_"]
    """Coefficients that were measured."""
    error: Float[np.ndarray, "case equation"]
    """R [N]; zero where not usable."""
    slopes: Float[np.ndarray, "case equation equation"]
    """Its derivative by the motion [N/m]; one where not usable."""
    whitening: Float[np.ndarray, "case equation equation"]
    """From the motion [m] to standard errors; zero where not usable."""
    known: bool
    """Whether the standard errors are."""

    @property
    def numbers(self) -> int:
        """Real numbers that were measured."""
        return int(np.count_nonzero(np.any(self.whitening != 0.0, axis=2)))


class _Sight(NamedTuple):
    """How the probes see the disk: z / turn = along q + rest."""

    along: Complex[AnyArray, "case order probe dof"]
    rest: Complex[AnyArray, "case order probe"]
    turn: Complex[AnyArray, "case order"]
    free: Float[AnyArray, "case dof coefficient"]
    """Motion of the linear rotor."""
    speed: Float[AnyArray, "case"]


@eqx.filter_jit
def _sight(model: Model, conditions: Conditions) -> _Sight:
    grid = make_grid(model.layout.orders)
    whole = without_timed(model).with_orders(grid.orders)
    index = jnp.array([grid.orders.index(min(grid.orders, key=lambda known: abs(known - order))) for order in model.layout.orders])

    def one(condition: Conditions) -> _Sight:
        condition = dataclasses.replace(condition, speed=true_speed(model, condition.speed))
        assembled, chain = by_order(whole, condition, grid)
        sensed = jax.vmap(lambda part, link, disk: link.sensed(whole.probes, part.motion_of(disk)))
        zero, unit = jnp.zeros(len(grid.orders), complex), jnp.ones(len(grid.orders), complex)
        rest = sensed(assembled, chain, Vector(zero, zero))
        along = jnp.stack([sensed(assembled, chain, disk) - rest for disk in (Vector(unit, zero), Vector(zero, unit))], axis=-1)
        turn = chain.turn + jnp.zeros(len(grid.orders), complex)
        return _Sight(along[index], rest[index], turn[index], to_real(in_space(assembled.motion().disk)), condition.speed)

    return jax.vmap(one)(conditions)


@eqx.filter_jit
def _equations(
    model: Model, values: Float[AnyArray, "term param"], conditions: Conditions, motion: Float[AnyArray, "case dof coefficient"], measured: Int[AnyArray, "_"]
) -> tuple[Float[Array, "term case equation"], Float[Array, "term case equation equation"]]:
    """D q + N(q) - F [N] at a motion, and its derivative by what was measured of it, for several values of the parameters of all effects."""
    grid = make_grid(model.layout.orders)
    _, unravel = ravel_pytree(model.effects)

    def left(at: Model, condition: Conditions, coefficients: Array) -> Array:
        condition = dataclasses.replace(condition, speed=true_speed(at, condition.speed))
        assembled, _ = by_order(at.with_orders(grid.orders), condition, grid)
        pair = to_complex(coefficients)
        linear = assembled.dynamic.times(Vector(pair[0], pair[1])) - assembled.drive
        total = to_real(in_space(linear))
        if restoring(at):
            total += restoring_system(at.with_orders(grid.orders), condition, grid, assembled).force(coefficients)
        return total[:, measured].ravel()

    def one(point: Array) -> tuple[Array, Array]:
        at = eqx.tree_at(lambda m: m.effects, model, unravel(point)) if model.effects else model

        def case(condition: Conditions, coefficients: AnyArray) -> tuple[Array, Array]:
            def moved(part: Array) -> Array:
                return left(at, condition, jnp.asarray(coefficients).at[:, measured].set(part.reshape(2, -1)))

            here = jnp.asarray(coefficients[:, measured]).ravel()
            return moved(here), jax.jacfwd(moved)(here)

        return jax.vmap(case)(conditions, motion)

    return jax.lax.map(one, jnp.asarray(values))


def missing_force(model: Model, measurement: Measurement, noise_allowance: float = 0.0) -> MissingForce:
    """The force that acts on the rotor beside the model, R = D q + N(q) - F, per case and measured order.

    q is the motion that the measuring chain of the model shows as the vectors measured, exactly where two probes see
    both directions, by least squares where more do; N the model's own restoring force. Its standard error follows from
    that of the vectors through D + dN/dq. Where slow roll was subtracted, that of the linear model is added back.

    **Arguments:** ``model``: the best explanation so far; ``measurement``; ``noise_allowance``: added to the standard
    errors of the table [m]. **Returns** a `MissingForce`, with the reason if nothing can be said.
    **Errors.** ``ValueError`` in single precision, or for a measurement with other probes.
    Source: Mottershead, Friswell 1993, J. Sound Vib. 167:347-375, section 4 (equation error).
    """
    require_float64("missing_force")
    if model.layout.probes != measurement.probes:
        raise ValueError(f"the model has probes {model.layout.probes}, the measurement {measurement.probes}: build both from one rig file")
    full = model.with_orders(measurement.orders)
    grid = make_grid(measurement.orders)
    sight = _Sight(*(np.asarray(leaf) for leaf in _sight(full, measurement.conditions)))
    both, usable = _seen(sight, measurement)
    if any(isinstance(e, WaveformEffect) for e in full.effects):
        return _nothing(full, measurement, grid, "a probe that bends the waveform cannot be undone from a few orders")
    if not usable.any():
        return _nothing(full, measurement, grid, "only one direction was measured: the force needs the motion along x and along y in the same case")
    motion, whitening, covariance, measured = _motion(full, measurement, sight, both & usable[:, None], noise_allowance)
    base = np.asarray(ravel_pytree(full.effects)[0], dtype=float)[None]
    errors, slopes = (np.asarray(a)[0] for a in _equations(full, base, measurement.conditions, motion, measured))
    used = np.any(whitening != 0.0, axis=2)
    balance = Balance(
        motion, measured, np.where(used, errors, 0.0), np.where(used[:, :, None] & used[:, None], slopes, np.eye(used.shape[1])[None]), whitening,
        measurement.sigma is not None or measurement.knowledge.tolerance > 0.0 or noise_allowance > 0.0,
    )  # fmt: skip
    return _shown(full, measurement, grid, balance, covariance, np.asarray(sight.speed))


def _seen(sight: _Sight, measurement: Measurement) -> tuple[Bool[np.ndarray, "case order"], Bool[np.ndarray, "case"]]:
    """Which orders the probes see in both directions, and the cases with such orders and none seen in one direction only."""
    present = np.swapaxes(measurement.present, 1, 2)
    size = np.linalg.svd(np.asarray(sight.along) * present[..., None], compute_uv=False)
    both = np.asarray(size[..., -1] > LEAST_SIGHT * np.maximum(size[..., 0], 1e-12)) & (size.shape[-1] == 2)
    partly = present.any(axis=2) & ~both
    return both, both.any(axis=1) & ~partly.any(axis=1)


def _motion(
    model: Model, measurement: Measurement, sight: _Sight, seen: Bool[np.ndarray, "case order"], allowance: float
) -> tuple[Float[np.ndarray, "case dof coefficient"], Float[np.ndarray, "case equation equation"], Float[np.ndarray, "case equation equation"], np.ndarray]:
    """The measured motion [m], the whitening and the covariance of its measured coefficients, and which these are."""
    shown = measurement.vectors
    if model.slow_roll is not None:
        still = dataclasses.replace(measurement.conditions, speed=jnp.full_like(measurement.conditions.speed, model.slow_roll))
        shown = shown + np.asarray(vectors(dataclasses.replace(without_timed(model), slow_roll=None), still))
    weight = measurement.weights(allowance)[..., 0]
    weight = np.swapaxes(np.where(measurement.present, np.where(weight > 0.0, weight, 1.0 / MICROMETRE), 0.0), 1, 2)
    miss = np.swapaxes(shown, 1, 2) / np.asarray(sight.turn)[..., None] - np.asarray(sight.rest)
    sees: np.ndarray = np.asarray(sight.along)
    real = np.array(measurement.orders) == 0.0
    along = np.where(real[None, :, None, None], np.real(sees), sees)
    inverse = np.linalg.pinv(along * weight[..., None])
    disk = np.einsum("cnip,cnp->cni", inverse, weight * np.where(real[None, :, None], miss.real, miss))
    positions = _positions(make_grid(measurement.orders), measurement.orders)
    measured = np.concatenate(positions)
    motion = np.array(sight.free)
    covariance = np.zeros((len(motion), 2, len(measured), 2, len(measured)))
    used = np.zeros((len(motion), 2, len(measured)), bool)
    start = 0
    for order, place in enumerate(positions):
        here = seen[:, order]
        parts = np.stack([disk[:, order].real, disk[:, order].imag], axis=-1)[..., : len(place)]
        motion[:, :, place] = np.where(here[:, None, None], parts, motion[:, :, place])
        p = inverse[:, order]
        whole = np.stack([np.stack([p.real, -p.imag], axis=-1), np.stack([p.imag, p.real], axis=-1)], axis=2)[:, :, : len(place), :, : len(place)]
        block = slice(start, start + len(place))
        covariance[:, :, block, :, block] = np.einsum("cikpl,cjmpl->cikjm", whole, whole) * here[:, None, None, None, None]
        used[:, :, block] = here[:, None, None]
        start += len(place)
    flat, used = covariance.reshape(len(motion), 2 * len(measured), -1), used.reshape(len(motion), -1)
    filled = flat + np.where(used, 0.0, 1.0)[:, :, None] * np.eye(flat.shape[1])[None]
    whitening = np.linalg.inv(np.linalg.cholesky(filled)) * used[:, :, None] * used[:, None]
    return motion, whitening, flat, measured


def _positions(grid: Grid, orders: tuple[float, ...]) -> list[np.ndarray]:
    """Coefficients of each order: the mean has one, the others two."""
    index = [grid.orders.index(min(grid.orders, key=lambda known: abs(known - order))) for order in orders]
    return [np.array([0]) if k == 0 else np.array([2 * k - 1, 2 * k]) for k in index]


def _shown(model: Model, measurement: Measurement, grid: Grid, balance: Balance, covariance: np.ndarray, speed: Float[np.ndarray, "case"]) -> MissingForce:
    """Waveforms and amplitudes, with their standard errors."""
    cases, width = len(balance.motion), len(balance.measured)
    spread = (balance.slopes @ covariance @ np.swapaxes(balance.slopes, 1, 2)).reshape(cases, 2, width, 2, width)
    own = np.stack([spread[:, k, :, k] for k in range(2)], axis=1)
    error = balance.error.reshape(cases, 2, width)
    synthesis, rate = grid.synthesis(grid.angle), grid.slope(grid.angle)
    waves = synthesis[balance.measured]
    variance = np.einsum("cdij,is,js->cds", own, waves, waves)
    ends = itertools.pairwise(np.cumsum([0, *(len(place) for place in _positions(grid, measurement.orders))]))
    blocks = [range(a, b) for a, b in ends]
    amplitudes = np.stack([error[..., block[0]] + (1j * error[..., block[1]] if len(block) > 1 else 0j) for block in blocks], axis=-1)
    deviations = np.stack([np.sqrt(np.mean([own[..., k, k] for k in block], axis=0)) for block in blocks], axis=-1)
    force, moves = error @ waves, balance.motion @ synthesis
    velocity = speed[:, None, None] * (balance.motion @ rate)
    usable = np.any(balance.whitening != 0.0, axis=(1, 2))
    band = np.sqrt(np.maximum(variance, 0.0))
    return MissingForce(model, measurement, None, usable, grid.angle, force, band, moves, velocity, amplitudes, deviations, balance)


def _nothing(model: Model, measurement: Measurement, grid: Grid, reason: str) -> MissingForce:
    cases = len(measurement.run)
    wave, part = np.zeros((cases, 2, len(grid.angle))), np.zeros((cases, 2, len(measurement.orders)))
    return MissingForce(model, measurement, reason, np.zeros(cases, bool), grid.angle, wave, wave, wave, wave, part.astype(complex), part, None)


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A term that the missing force looks like."""

    term: str
    """Key of the catalogue handed over, by default ``CATALOG | TERMS``."""
    words: str
    coefficients: dict[str, float]
    """By parameter, in SI: ``catalog[term](**coefficients)`` is the effect; beside the other terms found."""
    standard_errors: dict[str, float]
    """Of those that enter linearly, in the scale of what is left over where that is more than noise."""
    share: float
    """Of the squared change of the vectors, in standard errors, that the force missing asks for: how much this term takes away."""
    gain: float
    """Fall of chi-square beyond k ln n."""
    rivals: tuple[str, ...]
    """Words for other terms that do nearly as well in its place."""


class _Column(NamedTuple):
    """What one factor of a shape adds to R, and to its slopes, per unit; to be taken off."""

    error: Float[np.ndarray, "case equation"]
    slopes: Float[np.ndarray, "case equation equation"]


Entry = tuple[Shape, tuple[_Column, ...]]


class _Fitted(NamedTuple):
    """Terms fitted together, beside what gives way: their factors in units of the columns."""

    own: list[Entry]
    factors: Float[np.ndarray, "_"]
    deviation: Float[np.ndarray, "_"]
    chi2: float

    @property
    def unknowns(self) -> int:
        """Of all terms."""
        return sum(shape.unknowns for shape, _ in self.own)

    def factors_of(self, which: int) -> slice:
        """Those of one term."""
        start = sum(len(shape.factors) for shape, _ in self.own[:which])
        return slice(start, start + len(self.own[which][0].factors))

    def allowed(self) -> bool:
        """A stop pushes back, a crack takes stiffness away."""
        pushes = [bool(np.all(self.factors[self.factors_of(k)] > 0.0)) for k, (shape, _) in enumerate(self.own) if shape.positive]
        return math.isfinite(self.chi2) and all(pushes)


def _fit(balance: Balance, yielding: list[Entry], own: list[Entry]) -> _Fitted:
    """Least change of the measured vectors, in standard errors, that balances R + Σ θ column = 0: Gauss-Newton in θ.

    The change is (slopes + Σ θ column slopes)⁻¹ times what is left: the terms too move with the vectors.
    """
    columns = [c for _, several in [*own, *yielding] for c in several]
    error = np.stack([balance.error, *(c.error for c in columns)], axis=-1)
    slopes = np.stack([c.slopes for c in columns], axis=-1) if columns else np.zeros((*balance.slopes.shape, 0))
    factors, best = np.zeros(len(columns)), _Fitted(own, np.zeros(len(columns)), np.zeros(len(columns)), math.inf)
    for _ in range(PASSES):
        changed = (balance.whitening @ np.linalg.solve(balance.slopes + slopes @ factors, error)).reshape(-1, error.shape[-1])
        left = changed[:, 0] + changed[:, 1:] @ factors
        chi2 = float(left @ left)
        if not math.isfinite(chi2):
            break
        size = np.maximum(np.linalg.norm(changed[:, 1:], axis=0), TINY)
        scaled = changed[:, 1:] / size
        inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
        if chi2 < best.chi2:
            best = _Fitted(own, factors, np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size, chi2)
        factors = -(inverse @ (scaled.T @ changed[:, 0])) / size
    return best


def regress(found: MissingForce, catalog: Mapping[str, type[Effect]] = CATALOG | TERMS, *, fitted: Collection[str] = ()) -> tuple[Candidate, ...]:
    """The terms that the missing force looks like, at most two, the larger first; none where noise will do.

    Every term, then every pair of terms, by the Bayesian information criterion (Schwarz 1978, Ann. Stat. 6:461-464), chi-square
    taken in units of what the best of them leaves where that is more than noise.

    **Arguments:** ``found``: by `missing_force`; ``catalog``: effects by name; those that only change a reading or the
    support do not enter, nor those that the model has; ``fitted``: effects of the model whose values were fitted without
    the missing force, and give way beside it. **Returns** `Candidate`s, empty where ``found`` has a reason.
    """
    if found.balance is None:
        return ()
    search = _Search(found, found.balance, catalog, fitted)
    if not (singles := search.fits([[entry] for entry in search.pool])):
        return ()
    singles += search.finer(min(singles, key=search.cost), [])
    best_of: dict[str, _Fitted] = {}
    for single in sorted(singles, key=search.cost):
        best_of.setdefault(single.own[0][0].plain, single)
    kept = [single.own[0] for single in best_of.values()]
    pairs = search.fits([[one, other] for one, other in itertools.combinations(kept, 2)])
    pairs += search.fits([[kept[0], entry] for entry in search.pool if entry[0].plain != kept[0][0].plain])
    if leader := min(pairs, key=search.cost, default=None):
        pairs += [f for which in range(2) for f in search.finer(leader, [leader.own[1 - which]], which)]
    return search.answer(singles, pairs)


class _Search:
    """The terms to try, and what fits of them cost."""

    def __init__(self, found: MissingForce, balance: Balance, catalog: Mapping[str, type[Effect]], fitted: Collection[str]):
        self._found, self._balance, self._catalog = found, balance, catalog
        self._used = np.any(balance.whitening != 0.0, axis=2)
        tried = list(shapes({name: cls for name, cls in catalog.items() if name not in found.model}, found.model.rotor, found.reach))
        self._model = found.model.plus([catalog[name]() for name in sorted({shape.term for shape in tried})])
        labels = [(e.name, label) for e in self._model.effects for p in e.parameters() for label in p.labels(self._model.layout)]
        self._index = {label: k for k, label in enumerate(labels)}
        self._yielding = self._entries(_yielding(found, fitted))
        self.pool = [entry for entry in self._entries(tried) if self._matters(entry)]
        self.none = _fit(balance, self._yielding, [])
        self.unit = math.inf
        """Chi-square per number left over, by the best of all."""

    def _entries(self, wanted: list[Shape]) -> list[Entry]:
        """Shapes with their columns."""
        points = [np.asarray(ravel_pytree(self._model.effects)[0], dtype=float)]
        for shape in wanted:
            for factor in shape.factors:
                points.append(points[0].copy())
                for key, value in (shape.held | factor).items():
                    points[-1][self._index[shape.term, key]] += value
        errors, slopes = self._evaluate(np.stack(points))
        columns = iter(_Column(errors[k] - errors[0], slopes[k] - slopes[0]) for k in range(1, len(points)))
        return [(shape, tuple(next(columns) for _ in shape.factors)) for shape in wanted]

    def _evaluate(self, points: Float[np.ndarray, "term param"]) -> tuple[np.ndarray, np.ndarray]:
        padded = np.concatenate([points, np.repeat(points[-1:], -len(points) % BATCH, axis=0)])
        at = self._found.measurement.conditions, self._balance.motion, self._balance.measured
        parts = [_equations(self._model, padded[k : k + BATCH], *at) for k in range(0, len(padded), BATCH)]
        errors, slopes = (np.concatenate([np.asarray(p[i]) for p in parts])[: len(points)] for i in range(2))
        return errors * self._used[None], slopes * (self._used[:, :, None] & self._used[:, None])[None]

    def _matters(self, entry: Entry) -> bool:
        """Whether a term moves anything that was measured; beyond a gap in several cases, as anything explains a single one."""
        shape, columns = entry
        motion = self._balance.motion[:, :, self._balance.measured].reshape(len(self._balance.motion), -1, 1)
        least = NO_SHARE * STEP * float(np.linalg.norm(self._balance.slopes @ motion))
        sizes = [np.linalg.norm(c.error, axis=1) for c in columns]
        touched = sum(np.count_nonzero(size > TOUCHED * np.max(size)) for size in sizes)
        return any(float(np.max(size)) > least for size in sizes) and (shape.gap is None or bool(touched >= LEAST_TOUCHED))

    def cost(self, fitted: _Fitted) -> float:
        """Chi-square in units, and the price of the parameters."""
        return fitted.chi2 / self.unit + fitted.unknowns * math.log(self._balance.numbers)

    def fits(self, sets: list[list[Entry]]) -> list[_Fitted]:
        """Those that are allowed; the unit becomes what the best one leaves."""
        done = [fitted for several in sets if (fitted := _fit(self._balance, self._yielding, several)).allowed()]
        if done:
            left = min(f.chi2 / max(1, self._balance.numbers - f.unknowns) for f in done)
            self.unit = min(self.unit, max(left, 1.0 if self._balance.known else TINY))
        return done

    def finer(self, leader: _Fitted, others: list[Entry], which: int = 0) -> list[_Fitted]:
        """The same with gaps around the leader's, where it has one."""
        shape = leader.own[which][0]
        if shape.gap is None:
            return []
        cls, rotor, reach = self._catalog[shape.term], self._found.model.rotor, self._found.reach
        share = beyond(cls, rotor, reach, 1.0).held[shape.gap] / shape.held[shape.gap]
        near = [beyond(cls, rotor, reach, share + step) for step in FINER if 0.0 < abs(share + step) < 1.0]
        return self.fits([[*others, entry] for entry in self._entries(near) if self._matters(entry)])

    def answer(self, singles: list[_Fitted], pairs: list[_Fitted]) -> tuple[Candidate, ...]:
        """None, one or two terms, each with what does nearly as well in its place."""
        one = min(singles, key=self.cost)
        two = min(pairs, key=self.cost, default=None)
        path = [self.none]
        if two is not None and self._counts(one, two):
            alone = {id(f.own[0][0]): f for f in singles}
            first, second = sorted(two.own, key=lambda entry: self.cost(alone[id(entry[0])]) if id(entry[0]) in alone else math.inf)
            path += [_fit(self._balance, self._yielding, own) for own in ([first], [first, second])]
        elif self._counts(self.none, one):
            path += [one]
        count = len(path) - 1
        return tuple(self._candidate(path, k, singles if count == 1 else pairs) for k in range(count))

    def _counts(self, before: _Fitted, after: _Fitted) -> bool:
        return self.cost(before) > self.cost(after) + LEAST_GAIN and before.chi2 > after.chi2 + LEAST_SHARE * self.none.chi2

    def _candidate(self, path: list[_Fitted], which: int, others: list[_Fitted]) -> Candidate:
        """One term, its factors beside those of the others."""
        last, shape, at = path[-1], path[-1].own[which][0], path[-1].factors_of(which)
        coefficients, errors = dict(shape.held), {}
        for factor, value, deviation in zip(shape.factors, last.factors[at], last.deviation[at], strict=True):
            for key, part in factor.items():
                coefficients[key] = float(value) * part
                errors[key] = float(deviation) * abs(part) * math.sqrt(self.unit)
        company = {id(s) for s, _ in last.own} - {id(shape)}
        near = [f for f in others if company <= {id(s) for s, _ in f.own} and self.cost(f) < self.cost(last) + LEAST_GAIN]
        names = (s.words for f in sorted(near, key=self.cost) for s, _ in f.own if id(s) not in company and s.term != shape.term)
        fall = path[which].chi2 - path[which + 1].chi2
        gain = self.cost(path[which]) - self.cost(path[which + 1])
        return Candidate(shape.term, shape.words, coefficients, errors, fall / max(self.none.chi2, TINY), gain, tuple(dict.fromkeys(names)))


def _yielding(found: MissingForce, fitted: Collection[str]) -> list[Shape]:
    """Every parameter of these effects of the model by itself."""
    layout, rotor = found.model.layout, found.model.rotor
    effects = [e for e in found.model.effects if e.name in fitted and not isinstance(e, ReadingEffect | SpeedEffect | WaveformEffect)]
    return [Shape(e.name, {}, ({label: STEP * p.prior_scale(rotor)},)) for e in effects for p in e.parameters() for label in p.labels(layout)]

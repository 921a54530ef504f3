"""Simple terms that a missing force looks like: a sparse regression of the force on terms along the measured motion.

It is linear, and names terms that can be added as effects (Brunton, Proctor, Kutz 2016, Proc. Natl. Acad. Sci.
113:3932-3937). Plain equation error would trust most what the dynamic stiffness amplifies; the squares counted here are
those of the change of the measured vectors, in standard errors, that brings the equation into balance.
"""

import dataclasses
import itertools
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.discovery.force_shapes import GAP, SCANNED, STEP, Shape, beyond, shapes
from rotorjax.discovery.missing_force import Balance, MissingForce
from rotorjax.effects import CATALOG
from rotorjax.effects.power_terms import POWERS
from rotorjax.effects.terms import TERMS
from rotorjax.inference.force_balance import ForceBalance
from rotorjax.model.contract import Effect, ReadingEffect, SpeedEffect, WaveformEffect

FINER = (-0.05, -0.035, -0.02, -0.01, 0.01, 0.02, 0.035, 0.05)
"""Gaps tried around the best one, in the largest displacement."""
PASSES = 5
"""Of the weights, which the term itself changes where the rotor is near resonance."""
LEAST_GAIN, LEAST_SHARE = 10.0, 1e-3
"""A term counts if chi-square falls by so much beyond the Bayesian information criterion (very strong: Kass, Raftery
1995, J. Am. Stat. Assoc. 90:773-795), and by this share of what all is about: 3 % in amplitude.
"""
NO_SHARE, TINY = 1e-9, 1e-30
"""Of the measured motion: a force that moves it less is nothing."""
TOUCHED, LEAST_TOUCHED, SELDOM_TOUCHED = 1e-2, 3, 2
"""A gap is reached in a case where its force is this share of the largest one; cases in which it must be, and for a
term that the response is to judge.
"""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A term that the missing force looks like."""

    term: str
    """Key of the catalogue handed over, by default ``CATALOG | TERMS``."""
    words: str
    plain: str
    """Words without the size of the gap, the power, or the delay."""
    scanned: str | None
    """The parameter that is one over a gap, a power, or a delay, if there is one."""
    coefficients: dict[str, float]
    """By parameter, in SI: ``catalog[term](**coefficients)`` is the effect; beside the other terms found."""
    seen: bool
    """Whether the regression could tell its coefficients."""
    share: float
    """Of the squared change of the vectors, in standard errors, that the force missing asks for: how much this term
    takes away.
    """
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
        pushes = [
            bool(np.all(self.factors[self.factors_of(k)] > 0.0))
            for k, (shape, _) in enumerate(self.own)
            if shape.positive
        ]
        return math.isfinite(self.chi2) and all(pushes)


def _fit(balance: Balance, nuisance: list[Entry], own: list[Entry]) -> _Fitted:
    """Least change of the measured vectors, in standard errors, that balances R + Σ θ column = 0: Gauss-Newton in θ.

    The change is (slopes + Σ θ column slopes)⁻¹ times what is left: the terms too move with the vectors.
    """
    columns = [c for _, several in [*own, *nuisance] for c in several]
    error = np.stack([balance.error, *(c.error for c in columns)], axis=-1)
    slopes = np.stack([c.slopes for c in columns], axis=-1) if columns else np.zeros((*balance.slopes.shape, 0))
    factors, best = np.zeros(len(columns)), _Fitted(own, np.zeros(len(columns)), math.inf)
    for _ in range(PASSES):
        changed = (balance.whitening @ np.linalg.solve(balance.slopes + slopes @ factors, error)).reshape(
            -1, error.shape[-1]
        )
        left = changed[:, 0] + changed[:, 1:] @ factors
        chi2 = float(left @ left)
        if not math.isfinite(chi2):
            break
        size = np.maximum(np.linalg.norm(changed[:, 1:], axis=0), TINY)
        scaled = changed[:, 1:] / size
        inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
        if chi2 < best.chi2:
            best = _Fitted(own, factors, chi2)
        factors = -(inverse @ (scaled.T @ changed[:, 0])) / size
    return best


def regress(
    found: MissingForce, catalog: Mapping[str, type[Effect]] = CATALOG | TERMS, *, fitted: Collection[str] = ()
) -> tuple[Candidate, ...]:
    """The terms that the missing force looks like, at most two, the larger first; none where noise will do.

    Every term, then every pair of terms, by the Bayesian information criterion (Schwarz 1978, Ann. Stat. 6:461-464),
    chi-square taken in units of what the best of them leaves where that is more than noise.

    **Arguments:** ``found``: by `missing_force`; ``catalog``: effects by name; those that only change a reading or the
    support do not enter, nor those that the model has; ``fitted``: effects of the model whose values were fitted
    without the missing force, and give way beside it. **Returns** `Candidate`s, empty where ``found`` has a reason.
    """
    return next(iter(answers(found, catalog, fitted=fitted, most=1)), ())


def answers(
    found: MissingForce,
    catalog: Mapping[str, type[Effect]] = CATALOG | TERMS,
    *,
    fitted: Collection[str] = (),
    most: int,
) -> list[tuple[Candidate, ...]]:
    """The answer of `regress`, and single terms that do worse in the equation of motion but may do better in the
    response: what is alike, and the next best.

    There the motion need not be known at orders that were not measured. **Arguments:** as for `regress`; ``most``
    answers.
    **Returns** the answer of `regress` first, then its terms by themselves, then others outside the catalogue of named
    effects.
    """
    if found.balance is None:
        return []
    search = _Search(found, found.balance, catalog, fitted)
    if not (singles := search.fits([[entry] for entry in search.pool])):
        return []
    singles += search.finer(min(singles, key=search.cost), [])
    best_of: dict[str, _Fitted] = {}
    for single in sorted(singles, key=search.cost):
        best_of.setdefault(single.own[0][0].plain, single)
    kept = [single.own[0] for single in best_of.values()]
    pairs = search.fits([[one, other] for one, other in itertools.combinations(kept, 2)])
    pairs += search.fits([[kept[0], entry] for entry in search.pool if entry[0].plain != kept[0][0].plain])
    if leader := min(pairs, key=search.cost, default=None):
        pairs += [f for which in range(2) for f in search.finer(leader, [leader.own[1 - which]], which)]
    if not (answer := search.answer(singles, pairs)):
        return []
    held = [(one,) for axis in found.held if (one := _holding(found, axis)).term in catalog]
    held = held if len(answer) < most else []
    return [answer, *held, *search.others(answer, singles, most - 1 - len(held))]


def other_powers(found: MissingForce, fitted: Collection[str]) -> frozenset[str]:
    """Forces in proportion to a power that would take away more than their price beside what was ``fitted``."""
    if found.balance is None:
        return frozenset()
    search = _Search(found, found.balance, POWERS, fitted)
    singles = search.fits([[entry] for entry in search.pool])
    return frozenset(one.own[0][0].term for one in singles if search.cost(one) < search.cost(search.none))


class _Search:
    """The terms to try, and what fits of them cost."""

    def __init__(
        self, found: MissingForce, balance: Balance, catalog: Mapping[str, type[Effect]], fitted: Collection[str]
    ):
        self._found, self._balance, self._catalog = found, balance, catalog
        self._used = np.any(balance.whitening != 0.0, axis=2)
        tried = list(
            shapes(
                {name: cls for name, cls in catalog.items() if name not in found.model}, found.model.rotor, found.reach
            )
        )
        self._forces = ForceBalance(
            found.model.plus([catalog[name]() for name in sorted({shape.term for shape in tried})])
        )
        self._nuisance = self._entries(_nuisance(found, fitted))
        every = self._entries(tried)
        self.pool = [entry for entry in every if self._matters(entry, LEAST_TOUCHED)]
        self._seldom = [
            entry for entry in every if not self._matters(entry, LEAST_TOUCHED) and self._matters(entry, SELDOM_TOUCHED)
        ]
        self.none = _fit(balance, self._nuisance, [])
        self.unit = math.inf
        """Chi-square per number left over, by the best of all."""

    def _entries(self, wanted: list[Shape]) -> list[Entry]:
        """Shapes with their columns."""
        points = [self._forces.values]
        for shape in wanted:
            for factor in shape.factors:
                points.append(points[0].copy())
                for key, value in (shape.held | factor).items():
                    points[-1][self._forces.index[shape.term, key]] += value
        errors, slopes = self._forces.at(
            np.stack(points), self._found.measurement.conditions, self._balance.motion, self._balance.measured
        )
        errors, slopes = errors * self._used, slopes * (self._used[:, :, None] & self._used[:, None])
        columns = iter(_Column(errors[k] - errors[0], slopes[k] - slopes[0]) for k in range(1, len(points)))
        return [(shape, tuple(next(columns) for _ in shape.factors)) for shape in wanted]

    def _matters(self, entry: Entry, cases: int) -> bool:
        """Whether a term moves anything that was measured; beyond a gap in so many cases, as anything explains a single
        one.
        """
        shape, columns = entry
        motion = self._balance.motion[:, :, self._balance.measured].reshape(len(self._balance.motion), -1, 1)
        least = NO_SHARE * STEP * float(np.linalg.norm(self._balance.slopes @ motion))
        sizes = [np.linalg.norm(c.error, axis=1) for c in columns]
        touched = sum(np.count_nonzero(size > TOUCHED * np.max(size)) for size in sizes)
        return any(float(np.max(size)) > least for size in sizes) and (not shape.has_gap or bool(touched >= cases))

    def cost(self, fitted: _Fitted) -> float:
        """Chi-square in units, and the price of the parameters."""
        return fitted.chi2 / self.unit + fitted.unknowns * math.log(self._balance.numbers)

    def fits(self, sets: list[list[Entry]]) -> list[_Fitted]:
        """Those that are allowed; the unit becomes what the best one leaves."""
        done = [fitted for several in sets if (fitted := _fit(self._balance, self._nuisance, several)).allowed()]
        if done:
            left = min(f.chi2 / max(1, self._balance.numbers - f.unknowns) for f in done)
            self.unit = min(self.unit, max(left, 1.0 if self._balance.known else TINY))
        return done

    def finer(self, leader: _Fitted, others: list[Entry], which: int = 0) -> list[_Fitted]:
        """The same with gaps around the leader's, where it has one."""
        shape = leader.own[which][0]
        if not shape.has_gap:
            return []
        cls, rotor, reach = self._catalog[shape.term], self._found.model.rotor, self._found.reach
        share = beyond(cls, rotor, reach, 1.0).held[GAP] / shape.held[GAP]
        near = [beyond(cls, rotor, reach, share + step) for step in FINER if 0.0 < abs(share + step) < 1.0]
        return self.fits([[*others, entry] for entry in self._entries(near) if self._matters(entry, LEAST_TOUCHED)])

    def answer(self, singles: list[_Fitted], pairs: list[_Fitted]) -> tuple[Candidate, ...]:
        """None, one or two terms, each with what does nearly as well in its place."""
        one = min(singles, key=self.cost)
        two = min(pairs, key=self.cost, default=None)
        path = [self.none]
        if two is not None and self._counts(one, two):
            alone = {id(f.own[0][0]): f for f in singles}
            first, second = sorted(
                two.own, key=lambda entry: self.cost(alone[id(entry[0])]) if id(entry[0]) in alone else math.inf
            )
            path += [_fit(self._balance, self._nuisance, own) for own in ([first], [first, second])]
        elif self._counts(self.none, one):
            path += [one]
        count = len(path) - 1
        return tuple(self._candidate(path, k, singles if count == 1 else pairs) for k in range(count))

    def others(self, answer: tuple[Candidate, ...], singles: list[_Fitted], most: int) -> list[tuple[Candidate, ...]]:
        """Single terms: those of an answer of two, the best other, what is alike, further others. They may reach their
        gap in few cases.
        """
        if most < 1:
            return []
        every = sorted([*singles, *self.fits([[entry] for entry in self._seldom])], key=self.cost)
        best_of: dict[str, _Fitted] = {}
        for single in every:
            best_of.setdefault(single.own[0][0].term, single)
        own = [c.term for c in answer]
        parts = [term for term in own if len(own) > 1 and term in best_of]
        others = [
            term
            for term, single in best_of.items()
            if term in TERMS and term not in own and self._counts(self.none, single)
        ]
        usable = {term for term in self._catalog if term not in self._found.model and term not in own}
        alike = [term for one in [*own, *others[:1]] if one in TERMS for term in TERMS[one].alike if term in usable]
        terms = [*parts, *others[:1], *alike, *others[1:]]
        chosen = list(dict.fromkeys(terms))[:most]
        return [
            (self._candidate([self.none, best_of[term]], 0, every) if term in best_of else unseen(term),)
            for term in chosen
        ]

    def _counts(self, before: _Fitted, after: _Fitted) -> bool:
        return (
            self.cost(before) > self.cost(after) + LEAST_GAIN
            and before.chi2 > after.chi2 + LEAST_SHARE * self.none.chi2
        )

    def _candidate(self, path: list[_Fitted], which: int, others: list[_Fitted]) -> Candidate:
        """One term, its factors beside those of the others."""
        last, shape, at = path[-1], path[-1].own[which][0], path[-1].factors_of(which)
        coefficients = dict(shape.held)
        for factor, value in zip(shape.factors, last.factors[at], strict=True):
            coefficients |= {key: shape.value_of(key, float(value)) for key in factor}
        company = {id(s) for s, _ in last.own} - {id(shape)}
        near = [
            f for f in others if company <= {id(s) for s, _ in f.own} and self.cost(f) < self.cost(last) + LEAST_GAIN
        ]
        names = (
            s.words
            for f in sorted(near, key=self.cost)
            for s, _ in f.own
            if id(s) not in company and s.term != shape.term
        )
        fall = path[which].chi2 - path[which + 1].chi2
        gain = self.cost(path[which]) - self.cost(path[which + 1])
        return Candidate(
            shape.term,
            shape.words,
            shape.plain,
            shape.scanned,
            coefficients,
            True,
            fall / max(self.none.chi2, TINY),
            gain,
            tuple(dict.fromkeys(names)),
        )


def _holding(found: MissingForce, axis: int) -> Candidate:
    """Friction that holds the rotor still along an axis, of the least size that can: there velocities are noise, from
    which no regression tells it.
    """
    term = f"term_dry_friction_{'xy'[axis]}"
    return dataclasses.replace(
        unseen(term), coefficients={TERMS[term].parameters()[0].name: float(np.max(np.abs(found.force[:, axis])))}
    )


def unseen(term: str) -> Candidate:
    """A term of which only the response says what it does: the regression did not try it, or could not, as it does
    nothing to the orders measured.
    """
    words, scanned = (
        TERMS[term].words,
        next((p.name for p in TERMS[term].parameters() if p.name in SCANNED), None),
    )
    return Candidate(term, words, words, scanned, {}, False, 0.0, 0.0, ())


def _nuisance(found: MissingForce, fitted: Collection[str]) -> list[Shape]:
    """Every parameter of these effects of the model by itself."""
    layout, rotor = found.model.layout, found.model.rotor
    effects = [
        e
        for e in found.model.effects
        if e.name in fitted and not isinstance(e, ReadingEffect | SpeedEffect | WaveformEffect)
    ]
    return [
        Shape(e.name, {}, ({label: STEP * p.prior_scale(rotor)},))
        for e in effects
        for p in e.parameters()
        for label in p.labels(layout)
    ]

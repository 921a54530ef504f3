"""What competes to explain one measurement: effects that may be missing, with their odds, and sets of them, fitted."""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from rotorjax.data.measurement import Measurement
from rotorjax.effects import CATALOG
from rotorjax.effects.of_one_run import RUN_EFFECTS
from rotorjax.inference.budget import Budget
from rotorjax.inference.covariance import anything_random
from rotorjax.inference.data import Data, make_data, residual_vectors
from rotorjax.inference.descent import End
from rotorjax.inference.noise import NO_NOISE, Noise, independent_numbers, misfit_of, run_floor
from rotorjax.inference.space import Space, make_space
from rotorjax.model.contract import Effect, SweepEffect
from rotorjax.model.model import Model

FITS = 5.0
"""Standard deviations of chi-square up to which a fit holds within the noise of the table."""
FAR_OFF = 2.0
"""Cost that a fit under that noise may promise at most to go on, in the largest with which it holds."""
Effects = frozenset[str]
"""A hypothesis: the names of the effects that are there."""


class Contender(NamedTuple):
    """A set of effects fitted to the data, best optimum first."""

    effects: Effects
    ends: tuple[End, ...]
    log_evidence: float
    noise: Noise
    """Under which it was fitted: log evidence is compared under the same noise, or nearly the same."""
    foreseen: bool = False
    """Whether it is known to first order only under this noise, fitted under another."""

    @property
    def best(self) -> End:
        """The best optimum."""
        return self.ends[0]

    @property
    def balanced(self) -> bool:
        """Whether it has an optimum whose motions balance, and evidence."""
        return math.isfinite(self.log_evidence)

    def fitted_under(self, noise: Noise) -> bool:
        """Whether there is nothing to be fitted under this noise."""
        return self.balanced and not self.foreseen and self.noise == noise

    def led_by(self, end: End, noise: Noise) -> "Contender":
        """The same, its evidence too, with another end in the place of the best, fitted under some noise."""
        return self._replace(ends=(end, *self.ends[1:]), noise=noise)


Known = dict[Effects, Contender]
"""Contenders fitted before: where to start, and what need not be fitted again."""


@dataclasses.dataclass(frozen=True)
class Contest:
    """One measurement, and all that hypotheses may be made of."""

    space: Space
    measurement: Measurement
    candidates: tuple[str, ...]
    """Effects that may be missing: not in the model yet, and nothing of theirs declared uncertain."""
    odds: Mapping[str, float]
    """Prior odds of each candidate's presence."""
    training: Bool[np.ndarray, "case"]
    """Cases that count."""
    budget: Budget
    floor: Noise = NO_NOISE
    """Noise beside the table's that is known to be there."""
    linear_may_hold: bool = True
    """Whether linear effects may hold within the table's noise: not if all at once do not."""
    cannot_hold: frozenset[Effects] = frozenset()
    """Sets that were left behind under the table's noise."""
    forces_in_floor: bool = False
    """Whether the floor may come from nonlinear forces: it was told without any."""

    @cached_property
    def coupled(self) -> Effects:
        """Effects that couple the orders, which are balanced together: nonlinear forces, and saturation."""
        return frozenset(self.space.effects_of(self.space.coupled()))

    @cached_property
    def sweeping(self) -> Effects:
        """Candidates by which the speed changes."""
        changing = {e.name for e in self.space.model.effects if isinstance(e, SweepEffect)}
        return frozenset(changing.intersection(self.candidates))

    @property
    def costly(self) -> Effects:
        """Effects that cost many times as much as others: nonlinear forces, and a sweep."""
        return self.coupled | self.sweeping

    @property
    def linear(self) -> Bool[np.ndarray, "param"]:
        """Unknowns of all candidates but those, and what is declared uncertain."""
        return self.free(frozenset(self.candidates) - self.costly)

    @property
    def tries_table_noise(self) -> bool:
        """Whether there is anything to be tried under the noise of the table alone: it is known, and no misfit is known
        to be there that may not come from nonlinear forces.
        """
        return self.measurement.sigma is not None and (self.floor == NO_NOISE or self.forces_in_floor)

    @cached_property
    def shaped(self) -> Effects:
        """Candidates with parameters that are a shape, not a strength."""
        shaped = {e.name for e in self.space.model.effects if any(p.shape_only for p in e.parameters())}
        return frozenset(shaped.intersection(self.candidates))

    @cached_property
    def containing(self) -> dict[str, Effects]:
        """Of every nonlinear force those effects that it is with some of their parameters at zero: of a
        clearance the rub.
        """
        labels = {name: {e.label for e in self.space.entries if e.effect == name} for name in self.coupled}
        return {one: frozenset(other for other in labels if labels[one] < labels[other]) for one in labels}

    def is_special_case(self, one: Effects, other: Effects) -> bool:
        """Whether an effect is one of others with some of its parameters at zero."""
        return len(one) == 1 and not other.isdisjoint(self.containing.get(next(iter(one)), frozenset()))

    def log_odds(self, effects: Iterable[str]) -> float:
        """Logarithm of the prior odds of a set against the empty one."""
        return math.fsum(math.log(self.odds[name]) for name in effects)

    def log_posterior(self, contender: Contender) -> float:
        """Log evidence plus log prior odds."""
        return contender.log_evidence + self.log_odds(contender.effects)

    def free(self, effects: Effects) -> Bool[np.ndarray, "param"]:
        """Unknowns that a hypothesis frees: its effects' and all that the user declared uncertain."""
        return self.space.free(list(effects))

    def lean(self, sets: Iterable[Effects], chosen: Effects, near: Iterable[str]) -> list[Effects]:
        """Those sets whose forces depending on motion are in the chosen one or among the ``near`` ones, and are one at
        most or as many.

        Each such force costs as much as a hundred linear effects.
        """
        coupled, allowed = self.coupled, chosen | frozenset(near)
        return [h for h in sets if h & coupled <= allowed and len(h & coupled) <= max(1, len(chosen & coupled))]

    def only_of(self, effects: Iterable[str]) -> Bool[np.ndarray, "param"]:
        """Unknowns of these effects alone."""
        return self.space.only_of(effects)

    def model_at(self, contender: Contender) -> Model:
        """The full model at a contender's optimum."""
        return self.space.model_at(contender.best.point)

    def data(self, noise: Noise, point: Float[np.ndarray, "param"]) -> Data:
        """The measurement in units of a noise, the sensitivity to what is random taken at a point."""
        return self.data_at(noise, [point])[0]

    def data_at(self, noise: Noise, points: Sequence[Float[np.ndarray, "param"]]) -> list[Data]:
        """The same at several points."""
        m = self.measurement
        if m.calibration is None:
            return [make_data(m, self._felt_by(noise, point), noise) for point in points]
        random = anything_random(m.knowledge, noise.scatter)
        models = [self.space.model_at(point) if random else self.space.model for point in points]
        every = m.calibration.columns_at(self.space, m.conditions, points)
        return [make_data(m, model, noise, columns) for model, columns in zip(models, every, strict=True)]

    def _felt_by(self, noise: Noise, point: Float[np.ndarray, "param"]) -> Model:
        """The model by which errors in common are felt: any, where there are none but of the model's form."""
        random = anything_random(self.measurement.knowledge, noise.scatter)
        shared = random or self.measurement.calibration is not None
        return self.space.model_at(point) if shared else self.space.model

    def misfit_left(self, contender: Contender) -> float:
        """Isotropic misfit that a contender leaves [m]."""
        end = contender.best
        left = self.left(end, self.data(contender.noise, end.point))
        felt_by = self._felt_by(self.floor, end.point)
        return misfit_of(self.kept_measurement(), felt_by, left, len(end.free), self.floor)

    @cached_property
    def steady_rpm(self) -> Float[np.ndarray, "speed"]:
        """Speeds that were held while they were measured, of the cases that count [rpm]."""
        return self.measurement.steady_rpm(self.training)

    @cached_property
    def most_held(self) -> float:
        """Cost of the data up to which a fit holds within the noise of the table."""
        numbers = np.count_nonzero(self.kept_measurement().weights(0.0))
        return float(0.5 * (numbers + FITS * math.sqrt(2.0 * numbers)))

    @property
    def far_off(self) -> float:
        """Cost of the data with which a fit under that noise does not go on, as it cannot come to hold."""
        return FAR_OFF * self.most_held

    def left(self, end: End, data: Data) -> Complex[np.ndarray, "case probe order"]:
        """Model minus measured on the cases that count, zero elsewhere [m]."""
        return residual_vectors(end.local.error, data) * self.training[:, None, None]

    @cached_property
    def independent_numbers(self) -> int:
        """Number of data where the model misses: see `noise.independent_numbers`."""
        kept = self.kept_measurement()
        return max(1, min(independent_numbers(kept) or 1, int(np.count_nonzero(kept.weights(1.0)))))

    def kept_measurement(self) -> Measurement:
        """The measurement with the cases that do not count marked absent."""
        if self.training.all():
            return self.measurement
        return dataclasses.replace(self.measurement, present=self.measurement.present & self.training[:, None, None])


def make_contest(
    model: Model,
    measurement: Measurement,
    candidates: Iterable[str],
    catalog: Mapping[str, type[Effect]] = CATALOG,
    budget: Budget | None = None,
) -> Contest:
    """All candidates at their null beside the model's own effects. That nothing is missing is as probable beforehand as
    that one of them is, which the families share alike, then the members of each.

    Every effect of the catalogue is in the space, candidate or not: the compiled code is then the same. So is what is
    declared uncertain, whatever the catalogue.
    """
    uncertain = {u.effect for u in measurement.knowledge.uncertain}
    classes = {name: CATALOG[name] for name in uncertain if name in CATALOG} | dict(catalog)
    classes |= {cls.name: cls for cls in RUN_EFFECTS.values() if cls.like in classes}
    full = model.with_orders(measurement.orders).with_null_effects(classes.values())
    space = make_space(full, measurement.knowledge)
    possible = tuple(
        name for name in catalog if name in set(candidates) and name not in model and name not in uncertain
    )
    shown = tuple(name for name in possible if any(e.effect == name for e in space.entries))
    families = {
        family: [n for n in shown if catalog[n].family == family] for family in {catalog[n].family for n in shown}
    }
    odds = {n: 1.0 / len(families) / len(members) for members in families.values() for n in members}
    return Contest(space, measurement, shown, odds, np.ones(len(measurement.run), bool), budget or Budget())


def with_floor(contest: Contest, contender: Contender) -> Contest:
    """The contest with the scatter between runs that influence coefficients leave; a contender's residual takes out the
    rest. None beside a nonlinear force: what any effect does there need not be linear in what is
    installed, so that a scatter could hide it.
    """
    if not contest.space.is_linear_at(contender.best.point):
        return dataclasses.replace(contest, floor=NO_NOISE, forces_in_floor=False)
    left = contest.left(contender.best, contest.data(contender.noise, contender.best.point))
    floor = run_floor(contest.kept_measurement(), contest.model_at(contender), -left)
    return dataclasses.replace(contest, floor=floor, forces_in_floor=floor != NO_NOISE)

"""Single fits, of what is hidden, that were once lost: from the starts that its effects declare, with nothing else
known.

Whole explanations of most of the same data are in the campaign (`make campaign`).
"""

from collections.abc import Iterable

import numpy as np
import pytest

from rotorjax import Measurement, Model, effects
from rotorjax.data.declarations import mistakes
from rotorjax.discovery.contest import make_contest
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference.budget import Budget
from rotorjax.inference.data import declared_starts
from rotorjax.inference.descent import best_of, descend, starts_at
from rotorjax.inference.descent_settings import QUICK
from rotorjax.inference.noise import NO_NOISE, Noise

import drawn_effects
import drawn_forces
import hidden_forces
from drawn_mistakes import draw_with_mistake
from helpers import with_campaign

LEAST = {126: 11.02, 300: 64.23, 313: 78.59, 513: 66.30, 563: 173.64, 584: 176.45, 682: 141.90, 781: 24.50, 1356: 74.16}
"""Seed of drawn effects -> cost of a descent that begins at the truth (`benchmarks/regret.py`)."""
LEAST_OF_FORCES = {205: ("term_dead_band_y", 83.62), 425: ("term_dry_friction_x", 120.83)}
"""The same of forces outside the catalogue, with the term that each is."""
SLOW = (313, 425, 563, 781, 1356)
"""Seeds of friction whose motion takes half a minute to integrate: in the campaign."""


def seeds(every: Iterable[int]) -> list:
    return with_campaign(every, lambda seed: seed in SLOW)


def reached(model: Model, measurement: Measurement, hypothesis: tuple[str, ...], noise: Noise) -> float:
    catalog = {**CATALOG, **{name: TERMS[name] for name in hypothesis if name in TERMS}}
    contest = make_contest(model, measurement, catalog, catalog)
    free = contest.free(frozenset(hypothesis))
    starts = starts_at(declared_starts(contest.space, free, measurement))
    training = np.tile(contest.training, (len(starts), 1))
    data = contest.data(noise, contest.space.given_unknowns())
    best = best_of(descend(contest.space, data, starts, free, training, budget=Budget(), settings=QUICK))
    assert best.exact
    return best.cost


@pytest.mark.parametrize("seed", seeds(LEAST))
def test_drawn_effects_are_fitted_as_well_as_from_the_truth(seed):
    hidden = drawn_effects.draw(seed)
    noise = Noise(hidden.sigma if hidden.measurement.sigma is None else 0.0)
    assert reached(hidden.model, hidden.measurement, hidden.effects, noise) < LEAST[seed] + 0.5


@pytest.mark.parametrize("seed", seeds(LEAST_OF_FORCES))
def test_drawn_forces_are_fitted_as_well_as_from_the_truth(seed):
    drawn, (term, least) = drawn_forces.draw(seed), LEAST_OF_FORCES[seed]
    assert drawn.term == term
    assert reached(*drawn_forces.measured(drawn), (term,), Noise()) < least + 0.5


@pytest.mark.campaign
def test_friction_whose_cost_rises_before_it_falls_is_not_ended_by_its_limit():
    """Far from balance the cost is no bound: it rises to 3000 while the freedom of the motions ends, then falls."""
    drawn, _ = draw_with_mistake(31256)
    (absent,) = mistakes(drawn.model, drawn.measurement, ["weight_absent"])
    right = make_contest(*absent.put_right(drawn.model, drawn.measurement), CATALOG)
    friction = frozenset(["coulomb_friction"])
    for force in (0.5, 1.0, 3.75, 21.6, 80.0):
        point = right.space.given_unknowns()
        for entry in right.space.entries:
            if entry.effect in friction and entry.label == "force_n":
                point[entry.unknown] = force / entry.scale
        (end,) = descend(
            right.space, right.data(NO_NOISE, point), starts_at(point[None]), right.free(friction),
            right.training[None], budget=Budget(), settings=QUICK, hopeless=right.far_off,
        )  # fmt: skip
        assert end.exact
        assert end.cost == pytest.approx(123.18, abs=0.1)


@pytest.mark.campaign
def test_friction_that_nearly_holds_the_rotor_is_fitted():
    model, measurement, _ = hidden_forces.sufficient(effects.CoulombFriction, seed=8, factor=10.0)
    assert reached(model, measurement, ("coulomb_friction",), Noise()) < 58.22 + 0.5

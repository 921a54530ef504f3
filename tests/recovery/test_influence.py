"""What is known to first order only, compared with the same with every fit made."""

import math
import sys

import numpy as np
import pytest

from rotorjax import effects
from rotorjax.discovery.contest import make_contest
from rotorjax.discovery.held_out import held_out
from rotorjax.discovery.race import foreseen, race
from rotorjax.discovery.search import begin, select, with_answer
from rotorjax.discovery.ties import find_ties, swap_each
from rotorjax.effects import CATALOG
from rotorjax.inference.data import make_folds
from rotorjax.inference.descent import Start, descend
from rotorjax.inference.descent_settings import THOROUGH
from rotorjax.inference.influence import influenced
from rotorjax.inference.noise import Noise

import hidden

SOME = (
    "residual_unbalance",
    "residual_bow",
    "thermal_bow",
    "cross_coupling",
    "damping_error",
    "chain_gain",
    "probe_gain",
    "time_delay",
    "mass_error",
)


@pytest.fixture(scope="module")
def selection():
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    return select(begin(make_contest(model, measurement, SOME)), 3)


def test_a_fit_without_part_of_the_data_is_foreseen(selection):
    """The cost of the rest, and the error of what was left out, against descents."""
    contest, own = selection.contest, selection.known[selection.present]
    data = contest.data(own.noise, own.best.point)
    folds, reason = make_folds(
        contest.measurement, np.einsum("cmp,cmq->cpq", own.best.local.slopes, own.best.local.slopes)
    )
    assert not reason
    starts, free = [Start.at(own.best)] * len(folds), contest.free(own.effects)
    fitted = descend(contest.space, data, starts, free, ~folds, budget=contest.budget, settings=THOROUGH)
    for fold, end in zip(folds, fitted, strict=True):
        foreseen = influenced(data, own.best, ~fold)
        assert foreseen.cost == pytest.approx(end.cost, abs=0.05)
        there, here = (np.linalg.norm(one.local.error[fold]) for one in (end, foreseen))
        assert here == pytest.approx(there, rel=0.02)
        assert np.linalg.slogdet(foreseen.curvature)[1] == pytest.approx(np.linalg.slogdet(end.curvature)[1], abs=0.1)


def test_held_out_error_and_ties_are_those_of_every_fit_made(selection, monkeypatch):
    contest = selection.contest
    noise = Noise(contest.misfit_left(selection.known[selection.present]), contest.floor.scatter)

    def found():
        before = contest.budget.spent
        ties = find_ties(contest, selection, swap_each(contest, selection, noise), CATALOG)
        held = held_out(contest, selection, ties)
        return [t.effects for t in ties.tied], held.rms, contest.budget.spent - before

    tied, held, took = found()
    for module in ("held_out", "ties"):
        monkeypatch.setattr(sys.modules[f"rotorjax.discovery.{module}"], "CLEAR", math.inf)
    tied_dear, held_dear, took_dear = found()
    assert tied == tied_dear
    np.testing.assert_allclose(held, held_dear, rtol=1e-3)
    assert took < 0.7 * took_dear


@pytest.mark.parametrize(("most", "effects", "small"), [(3, ("cross_coupling",), ()), (0, (), ("cross_coupling",))])
def test_what_was_small_and_matters_in_the_end_is_a_step_of_its_own(selection, most, effects, small):
    """Beside fewer effects it may have been too small; where no more are to be added it is at least
    not called small.
    """
    again = with_answer(selection._replace(effects=(), small=("cross_coupling",), most=most), selection.present, {})
    assert (again.effects, again.small) == (effects, small)


def test_a_fit_under_another_noise_is_foreseen_and_made_where_it_is_wanted(selection):
    contest, own = selection.contest, selection.known[selection.present]
    noise = own.noise._replace(allowance=own.noise.allowance + 0.2e-6)
    there = foreseen(contest, contest.data(noise, own.best.point), own, noise)
    assert not there.fitted_under(noise)
    again = race(contest, noise, [own.effects], {own.effects: there})[own.effects]
    assert again.fitted_under(noise)
    assert there.log_evidence == pytest.approx(again.log_evidence, abs=0.05)
    before = contest.budget.spent
    race(contest, noise, [own.effects], {own.effects: again})
    assert contest.budget.spent == before, "nothing is fitted twice"

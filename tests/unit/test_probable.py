"""Probabilities of whole explanations, and races of mistakes put together."""

import math
from types import SimpleNamespace
from unittest.mock import create_autospec

import pytest

from rotorjax.data.declarations import Mistake
from rotorjax.discovery.answers import Answer, MistakeRace
from rotorjax.discovery.contest import Contender, Contest
from rotorjax.discovery.probable import Probable, credible, probable
from rotorjax.discovery.race import Scored
from rotorjax.inference.noise import NO_NOISE


def nothing_changed(model, measurement):
    return model, measurement


def answer(log, *effects, mistake=None):
    change = None if mistake is None else Mistake(mistake, (), "", "", nothing_changed)
    selection = SimpleNamespace(effects=effects, small=())
    return Answer(change, selection, 0.0, Scored(log, 1.0, 0.0), 0.0, cut_off=False)


def raced(**logs):
    """A contest, and contenders with a log posterior each."""
    contest = create_autospec(Contest, instance=True)
    contest.log_posterior.side_effect = lambda contender: contender.log_evidence
    return contest, [Contender(frozenset(name.split("_and_")), (), log, NO_NOISE) for name, log in logs.items()]


def test_sets_share_a_probability_of_one():
    contest, contenders = raced(rub=math.log(6.0), duffing=math.log(3.0), crack_and_rub=0.0, crack=-math.inf)
    found = probable(contest, contenders, MistakeRace((answer(0.0, "rub"),)))
    assert [one.names for one in found] == [("rub",), ("duffing",), ("crack", "rub")]
    assert [one.probability for one in found] == pytest.approx([0.6, 0.3, 0.1])


def test_an_answer_beside_a_mistake_takes_its_share():
    contest, contenders = raced(rub=0.0)
    written = MistakeRace((answer(0.0, "rub"), answer(-math.log(4.0), "duffing", mistake="amplitude_rms")))
    found = probable(contest, contenders, written)
    assert found == (Probable(("rub",), pytest.approx(0.8)), Probable(("amplitude_rms", "duffing"), pytest.approx(0.2)))
    first, second = probable(contest, contenders, MistakeRace((written.ranked[1], answer(-9.0, "rub"))))
    assert first.names == ("amplitude_rms", "rub")
    assert second.names == ("rub",)


def test_the_fewest_that_have_95_percent():
    every = [Probable((name,), p) for name, p in (("a", 0.6), ("b", 0.3), ("c", 0.06), ("d", 0.04))]
    assert [one.names for one in credible(every)] == [("a",), ("b",), ("c",)]
    assert [one.names for one in credible([Probable((), 0.96), *every])] == [()]


def test_what_an_earlier_race_found_stays_beside_the_answer():
    own, mil = answer(0.0, "rub"), answer(-2.0, "rub", mistake="amplitude_unit.mil")
    rms, again = answer(-1.0, "rub", mistake="amplitude_rms"), answer(-5.0, "duffing", mistake="amplitude_rms")
    earlier = MistakeRace((own, mil, again), cut_off=(mil.mistake,))
    both = MistakeRace((own, rms)).with_others(earlier)
    assert both.ranked == (own, rms, mil)
    assert both.tied == (rms, mil)
    assert both.cut_off == (mil.mistake,)

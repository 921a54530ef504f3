"""Readings chosen one by one: what they tell together, and when there are enough of them."""

import numpy as np
import pytest

from rotorjax.discovery.next_measurement import MOST_READINGS, SETTLES, Shown, chosen_readings


def shown(rng: np.random.Generator, size: float) -> Shown:
    cases, cells, free = 30, 4, 3
    apart, spread = size * rng.standard_normal((cases, cells)), rng.standard_normal((cases, cells, free))
    return Shown(apart, spread, rng.uniform(0.5, 2.0, (cases, cells)), np.arange(cases) % 3 > 0)


@pytest.mark.parametrize("size", [0.1, 0.7, 3.0])
def test_they_tell_together_what_is_said(rng, size: float):
    """Against the whole covariance of all readings at once: noise, and what the parameters leave open."""
    given = shown(rng, size)
    chosen, differ = chosen_readings(given)
    gap = given.apart[chosen].ravel()
    slopes = given.spread[chosen].reshape(len(gap), -1)
    noise = given.variance[chosen].ravel()
    whole = gap @ np.linalg.solve(np.diag(noise) + slopes @ slopes.T, gap)
    assert differ == pytest.approx(np.sqrt(whole), rel=1e-9)
    assert all(given.allowed[chosen])
    assert len(set(chosen)) == len(chosen) <= MOST_READINGS


def test_no_more_are_chosen_than_settle_it(rng):
    assert len(chosen_readings(shown(rng, 30.0))[0]) == 1
    chosen, differ = chosen_readings(shown(rng, 0.05))
    assert (len(chosen), differ < SETTLES) == (MOST_READINGS, True)


def test_none_is_chosen_where_none_is_allowed(rng):
    given = shown(rng, 1.0)
    assert chosen_readings(given._replace(allowed=np.zeros(30, bool))) == ([], 0.0)

"""Readings chosen one by one: what they tell together, and when there are enough of them."""

import dataclasses

import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Measurement, Model, effects, explain, response
from rotorjax.data.knowledge import Limits
from rotorjax.discovery.next_measurement import (
    MOST_READINGS,
    SETTLES,
    Differences,
    chosen_readings,
    covariance_root,
    form_errors,
)
from rotorjax.reporting.answer import sentence
from rotorjax.reporting.explanation import next_lines


def differences(rng: np.random.Generator, size: float) -> Differences:
    cases, cells, errors = 30, 4, 3
    apart, common = size * rng.standard_normal((cases, cells)), rng.standard_normal((cases, cells, errors))
    return Differences(apart, common, np.arange(cases) % 3 > 0)


@pytest.mark.parametrize("size", [0.1, 0.7, 3.0])
@pytest.mark.parametrize("common", [0.0, 1.0, 1e4])
def test_they_tell_together_what_is_said(rng, size: float, common: float):
    """Against the whole covariance of all readings at once: noise, and errors that they have in common."""
    given = differences(rng, size)
    given = given._replace(common=common * given.common)
    chosen, differ = chosen_readings(given)
    gap = given.apart[chosen].ravel()
    columns = given.common[chosen].reshape(len(gap), -1)
    whole = gap @ np.linalg.solve(np.eye(len(gap)) + columns @ columns.T, gap)
    assert differ == pytest.approx(np.sqrt(whole), rel=1e-6)
    assert all(given.allowed[chosen])
    assert len(set(chosen)) == len(chosen) <= MOST_READINGS


def test_no_more_are_chosen_than_settle_it(rng):
    assert len(chosen_readings(differences(rng, 30.0))[0]) == 1
    chosen, differ = chosen_readings(differences(rng, 0.05))
    assert (len(chosen), differ < SETTLES) == (MOST_READINGS, True)


def test_none_is_chosen_where_none_is_allowed(rng):
    given = differences(rng, 1.0)
    assert chosen_readings(given._replace(allowed=np.zeros(30, bool))) == ([], 0.0)


@pytest.mark.parametrize("told", [1e1, 1e5, 1e7])
def test_what_the_data_do_not_determine_spreads_as_the_prior_does(rng, told):
    """Five unknowns, of which the data determine three, to a ten-millionth of the prior."""
    determined, rest = np.split(np.linalg.qr(rng.standard_normal((5, 5)))[0], [3], axis=1)
    root = covariance_root(told**2 * determined @ determined.T + np.eye(5), 1.0)
    np.testing.assert_allclose(np.linalg.norm(rest.T @ root, axis=1), 1.0, rtol=0.05)
    assert np.all(np.linalg.norm(determined.T @ root, axis=1) < 2.0 / told + 1e-6)


def test_what_all_readings_have_in_common_is_not_averaged_away(rng):
    """A difference that is the same everywhere, beside an error that is, too."""
    apart, common = np.full((30, 4), 2.0), np.ones((30, 4, 1))
    assert chosen_readings(Differences(apart, common, np.ones(30, bool)))[1] < 2.0 + 1e-9


def test_relative_errors_of_the_models_form_move_vectors_as_a_matrix_does(rng):
    """Columns in the order of the cells: probe, order, real and imaginary part."""
    z = rng.standard_normal((5, 2, 3)) + 1j * rng.standard_normal((5, 2, 3))
    unit = rng.standard_normal((2, 2, 3, 2))
    epsilon = unit[..., 0] + 1j * unit[..., 1]
    moved = np.einsum("pqn,cqn->cpn", epsilon, z)
    expected = np.stack([moved.real, moved.imag], axis=-1).reshape(5, -1)
    assert np.allclose(form_errors(z, z.shape[1]) @ unit.ravel(), expected)


def test_what_may_be_missing_is_looked_for():
    """An unbalance of some three standard errors, below the resonance: above it shows more."""
    model = Model(Jeffcott(0.9, [5e4, 4.5e4], [0.02, 0.02]))
    unbalance = np.repeat([[[0.0, 0.0]], [[2e-5, 1e-5]]], 5, axis=0)
    conditions = Conditions.at_rpm(np.tile(np.linspace(600.0, 1500.0, 5), 2), unbalance=unbalance)
    z = np.asarray(response(model + effects.ResidualUnbalance(1.6e-6, 0.0), conditions))
    noise = np.random.default_rng(0)
    z = z + 1e-6 * (noise.standard_normal(z.shape) + 1j * noise.standard_normal(z.shape))
    m = Measurement.from_arrays(z, conditions, run=np.repeat([0, 1], 5), runs=("first", "second"), sigma=1e-6)
    knowledge = dataclasses.replace(m.knowledge, limits=Limits(speed_rpm=(600.0, 6000.0)))
    m = dataclasses.replace(m, knowledge=knowledge)
    found = explain(model, m, only=["residual_unbalance"], thorough=False)
    assert (found.verdict, found.effects) == ("undecided", ())
    assert "something more may be missing (33 %), such as residual unbalance (33 %)" in sentence(found)
    proposal = found.next_measurement
    assert proposal.separates == ((), ("residual_unbalance",))
    assert proposal.speed_rpm > 2400.0
    (line,) = next_lines(found)
    assert "at these together residual unbalance would show by 2.8 standard errors" in line

"""Motion and parameters fitted together: kernels against the response, descents against the truth, the count of
linearisations.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rotorjax import Conditions, Jeffcott, Model, effects, response
from rotorjax.arrays import real_pair
from rotorjax.data.knowledge import Knowledge
from rotorjax.discovery import bootstrap
from rotorjax.discovery.common_noise import settle
from rotorjax.discovery.contest import make_contest
from rotorjax.discovery.race import _starts, race
from rotorjax.effects import CATALOG
from rotorjax.effects.terms import TERMS
from rotorjax.inference import descent, linearised
from rotorjax.inference.budget import Budget
from rotorjax.inference.data import declared_starts, make_data
from rotorjax.inference.descent import HOPELESS, Start, best_of, descend, starts_at
from rotorjax.inference.descent_settings import LEFT_BEHIND, NOT_FINITE, QUICK, THOROUGH
from rotorjax.inference.kernels import COLUMNS, Kernels, Rows
from rotorjax.inference.linearised import Linearisation, Point
from rotorjax.inference.motions import BALANCED
from rotorjax.inference.noise import NO_NOISE, Noise
from rotorjax.inference.prediction import predict
from rotorjax.inference.scan import scan
from rotorjax.inference.space import Space, make_space
from rotorjax.physics.steady_state import Ready, without_coupling
from rotorjax.physics.sweep import added_by_sweep

import hidden
import hidden_forces

ORDERS = (1.0, 2.0)


def space_of(model: Model, measurement) -> Space:
    return make_space(model.with_orders(measurement.orders).with_null_effects(CATALOG.values()), measurement.knowledge)


def unknowns_at(space: Space, **values: float) -> np.ndarray:
    """Unknowns at which entries, ``effect__label``, have these values in SI."""
    point = np.zeros(len(space.entries))
    for key, value in values.items():
        entry = next(e for e in space.entries if (e.effect, e.label) == tuple(key.split("__")))
        point[entry.unknown] = value / entry.scale
    return point


@pytest.fixture(scope="module")
def spring():
    """A cubic spring, integrated in time: model, measurement, space, data, true value."""
    model, measurement, (true,) = hidden_forces.sufficient(effects.Duffing, seed=5)
    space = space_of(model, measurement)
    return model, measurement, space, make_data(measurement, space.model, NO_NOISE), true


def test_without_forces_on_the_motion_one_step_is_exact(spring):
    """From any motion at all, with slow roll subtracted or not, the balance gives what the closed form gives."""
    model, measurement, *_ = spring
    for slow_roll in (None, 20.0):
        own = dataclasses.replace(model, slow_roll=slow_roll)
        space = space_of(own, measurement)
        lin = Linearisation(space, make_data(measurement, space.model, NO_NOISE), Budget())
        point = unknowns_at(
            space, residual_unbalance__unbalance_x_kg_m=1e-5, cross_coupling__cross_stiffness_n_per_m=500.0
        )
        free = np.flatnonzero(space.free(["residual_unbalance", "cross_coupling", "probe_gain"]))
        anywhere = 1e-5 * np.random.default_rng(0).standard_normal(lin.at_rest.shape)
        (off,) = lin.at([Point(point, anywhere)], [free])
        assert off.response is not None
        plain, balanced = lin.at([Point(point, None), Point(point, lin.moved(off, -off.response.newton))], [free, free])
        np.testing.assert_allclose(off.shown, plain.shown, rtol=1e-9, atol=1e-16)
        np.testing.assert_allclose(balanced.shown, plain.shown, rtol=1e-9, atol=1e-16)
        np.testing.assert_allclose(balanced.slopes, plain.slopes, rtol=1e-7, atol=1e-7 * np.abs(plain.slopes).max())
        few = np.arange(0, lin.cases, 3)
        (part,) = lin.coupled_at([Point(point, anywhere)], [free], [few])
        np.testing.assert_allclose(part.shown, off.shown[few], rtol=1e-12, atol=1e-18)
        # At slow roll, once for each set of weights.
        weights = np.unique(measurement.run) if slow_roll else ()
        assert len(lin.states.speed) == lin.cases + len(weights)


def test_where_a_force_is_gone_the_sizes_of_those_that_stay_are_found_anew(spring):
    """And motions are as measured: those that balance were that force's. Where no force changes, they are near."""
    model, measurement, *_ = spring
    contest = make_contest(model, measurement, ["duffing", "clearance", "probe_gain"])
    both = frozenset({"duffing", "clearance"})
    known = race(contest, NO_NOISE, [both], {})
    alone, more = frozenset({"clearance"}), both | {"probe_gain"}
    without = _starts(contest, alone, contest.free(alone), known, afresh=False)
    declared = declared_starts(contest.space, contest.free(alone), measurement)
    assert [start.motions is None for start in without] == [True] * len(declared)
    np.testing.assert_allclose([start.point for start in without], declared)
    (beside,) = _starts(contest, more, contest.free(more), known, afresh=False)
    assert beside.motions is known[both].best.motions


def test_starts_are_relative_to_the_motion_of_the_disk_whatever_probes_show_of_it(spring):
    """Converted from mil twice, by probes where the shaft moves half as far: a gap begins within the motion."""
    model, measurement, *_ = spring
    probes = dataclasses.replace(model.probes, scale=25.4, participation=[0.5, 0.5])
    other, shown = (
        dataclasses.replace(model, probes=probes),
        dataclasses.replace(measurement, vectors=12.7 * measurement.vectors),
    )
    contests = (make_contest(model, measurement, ["clearance"]), make_contest(other, shown, ["clearance"]))
    right, large = (
        declared_starts(contest.space, contest.free(frozenset({"clearance"})), contest.measurement)
        for contest in contests
    )
    np.testing.assert_allclose(large, right, rtol=1e-12)


def test_slopes_are_those_of_the_response(spring):
    """At a motion that balances, the slopes are the derivative of the response, motion and all."""
    _, measurement, space, data, true = spring
    free = np.flatnonzero(space.free(["duffing", "residual_unbalance"]))
    point = unknowns_at(space, duffing__cubic_n_per_m3=true)
    every = np.ones((1, len(measurement.run)), bool)
    (end,) = descend(space, data, [Start(point)], np.zeros(len(point), bool), every, budget=Budget(), kept=point)
    assert end.exact
    lin = Linearisation(space, data, Budget())
    (one,) = lin.at([Point(point, end.motions, refined=True)], [free])
    step = 1e-4
    for column, unknown in enumerate(free):
        moved = [predict(space, measurement.conditions, point + side * step * np.eye(len(point))[unknown],
                         budget=Budget(),
                         near=(measurement.conditions, end.motions)).shown for side in (1.0, -1.0)]  # fmt: skip
        quotient = (moved[0] - moved[1]) / (2.0 * step)
        pairs = np.stack([quotient.real, quotient.imag], axis=-1).reshape(len(data.speed), -1)
        expected = data.weight.reshape(pairs.shape) * pairs
        np.testing.assert_allclose(one.slopes[..., column], expected, atol=2e-3 * np.abs(expected).max())


def test_what_stays_far_behind_ends_while_its_motions_have_freedom(spring):
    """Beside a fit that holds; alone it goes on to motions that balance, and is as far behind there."""
    _, measurement, space, data, true = spring
    names = ("duffing", "quadratic_damping")
    masks = np.stack([space.free([name]) for name in names])
    declared = declared_starts(space, masks[1], measurement)[0]
    points = np.stack([unknowns_at(space, duffing__cubic_n_per_m3=true), declared])
    every = np.ones((2, len(measurement.run)), bool)
    right, behind = descend(space, data, starts_at(points), masks, every, budget=Budget())
    (alone,) = descend(space, data, starts_at(points[1:]), masks[1:], every[1:], budget=Budget())
    assert right.exact
    assert alone.exact
    assert alone.cost > right.cost + HOPELESS
    assert behind.result == LEFT_BEHIND
    assert behind.steps < alone.steps


def test_prediction_is_the_response(spring):
    model, measurement, space, _, true = spring
    point = unknowns_at(space, duffing__cubic_n_per_m3=0.1 * true)
    weak = model.with_orders(measurement.orders) + effects.Duffing(0.1 * true)
    expected = np.asarray(response(weak, measurement.conditions))
    shown = predict(space, measurement.conditions, point, budget=Budget()).shown
    np.testing.assert_allclose(shown, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("duffing", 5),
        ("clearance", 5),
        ("rub", 5),
        ("asymmetric_shaft", 5),
        ("quadratic_damping", 5),
        ("probe_saturation", 5),
    ],
)
def test_declared_starts_reach_the_optimum_at_the_truth(name, seed):
    """Regret: the cost from declared starts less that of a descent begun at the true values."""
    factor = {"clearance": 0.5, "rub": 0.3}.get(name, 1.0)
    model, measurement, true = hidden_forces.sufficient(CATALOG[name], seed=seed, factor=factor)
    space = space_of(model, measurement)
    data, free = make_data(measurement, space.model, NO_NOISE), space.free([name])
    entries = [e for e in space.entries if e.effect == name]
    at_truth = np.zeros(len(space.entries))
    at_truth[[e.unknown for e in entries]] = [value / e.scale for e, value in zip(entries, true, strict=True)]
    every = np.ones((8, len(measurement.run)), bool)
    known = best_of(descend(space, data, [Start(at_truth)], free, every, budget=Budget(), settings=THOROUGH))
    budget, starts = Budget(), starts_at(declared_starts(space, free, measurement))
    found = best_of(descend(space, data, starts, free, every, budget=budget, settings=QUICK))
    assert found.exact
    assert found.cost - known.cost < 0.1
    assert budget.spent <= 40 * len(starts) * len(measurement.run)


def test_motions_of_cases_left_out_follow_the_balance(spring):
    """What was not trained on has no pull on its motion, and is predicted as if the model had been simulated there."""
    _, measurement, space, data, _ = spring
    free, training = space.free(["duffing"]), np.ones((1, len(measurement.run)), bool)
    training[0, ::3] = False
    (end,) = descend(
        space, data, starts_at(declared_starts(space, free, measurement))[1:2], free, training, budget=Budget()
    )
    lost = measurement.vectors[::3] - end.shown[::3]
    assert np.sqrt(np.mean(np.abs(lost[measurement.present[::3]]) ** 2)) < 2.0 * np.sqrt(2.0) * np.median(
        measurement.sigma
    )


def test_a_spent_budget_leaves_every_start_linearised_once(spring):
    _, measurement, space, data, _ = spring
    free, budget = space.free(["clearance"]), Budget(1)
    starts = starts_at(declared_starts(space, free, measurement))
    ends = descend(space, data, starts, free, np.ones((len(starts), len(measurement.run)), bool), budget=budget)
    assert budget.exhausted
    assert all(np.isfinite(end.cost) and end.steps == 1 and not end.exact for end in ends)
    # One linear solve for the first motions, which all starts share, and one evaluation of each.
    assert budget.spent == (1 + len(starts)) * len(measurement.run)


def test_fits_that_could_not_hold_go_on_once_an_answer_holds(spring, monkeypatch):
    """Under the noise that is known a fit that cannot come to hold ends early; what ended so is no worse for it."""
    model, measurement, *_ = spring
    sets = [frozenset(), frozenset(["duffing"]), frozenset(["rub"])]
    found = []
    for far_off in (1e9, 2.0):
        monkeypatch.setattr("rotorjax.discovery.contest.FAR_OFF", far_off)
        told = settle(make_contest(model, measurement, CATALOG), sets, {}, Noise(measurement.rms))
        assert (told.winner, told.noise) == (sets[1], NO_NOISE)
        found.append([told.contenders[effects].best for effects in sets])
    assert found[1][1].cost == pytest.approx(found[0][1].cost, abs=0.01)
    assert all(ends[k].cost > ends[1].cost + HOPELESS for ends in found for k in (0, 2))


def test_projected_draws_leave_what_fitted_draws_leave():
    """The linearised fit of a draw against the fit itself, within a twentieth of a log unit."""
    model, measurement, _ = hidden.sufficient(effects.CrossCoupling, seed=1)
    contest = make_contest(model, measurement, CATALOG)
    contender = race(contest, NO_NOISE, [frozenset(["cross_coupling"])], {})[frozenset(["cross_coupling"])]
    data = contest.data(NO_NOISE, contender.best.point)
    draws = bootstrap._Draws(contest, contender.best, data, np.random.default_rng(0))
    noises = draws.make(12)
    pairs = np.stack([contender.best.shown.real, contender.best.shown.imag], axis=-1)
    fitted = [end.cost for end in bootstrap._refitted(contest, contender, data, pairs, noises)]
    np.testing.assert_allclose(draws.costs(noises)[1], fitted, atol=0.05)


def test_heavier_rotor_is_still_one_rotor():
    """Kernels take the rotor as an argument: two rigs with the same probes and orders share one compiled program."""
    one, other = (
        space_of(Model(Jeffcott(mass, 5e4, 0.02)), hidden.sufficient(effects.MassError, seed=1)[1])
        for mass in (1.0, 7.0)
    )
    data = make_data(hidden.sufficient(effects.MassError, seed=1)[1], one.model, NO_NOISE)
    shown = [
        Linearisation(space, data, Budget())
        .at([Point(np.zeros(len(space.entries)), None)], [np.zeros(0, int)])[0]
        .shown
        for space in (one, other)
    ]
    assert not np.allclose(shown[0], shown[1])


def test_of_the_usual_orders_any_may_be_measured_with_one_program():
    model, knowledge = Model(Jeffcott(1.0, 5e4, 0.02)).with_null_effects(CATALOG.values()), Knowledge()
    spaces = [make_space(model.with_orders(orders), knowledge) for orders in ((1.0,), (0.0, 2.0), (0.0, 1.0, 2.0, 3.0))]
    assert len({id(Kernels(space)._along.program) for space in spaces}) == 1
    assert len({id(Kernels(space)._forces[0].slopes.program) for space in spaces}) == 1


class _Mine(effects.Duffing):
    name = "mine"


@pytest.mark.parametrize("more", [TERMS, {"mine": _Mine}], ids=["terms of a missing force", "a force of one's own"])
def test_more_forces_take_programs_of_their_own_only(more):
    """What the catalogue needs is the same with them."""
    model, knowledge = Model(Jeffcott(1.0, 5e4, 0.02)), Knowledge()
    alone, beside = (
        Kernels(make_space(model.with_null_effects(classes.values()), knowledge))
        for classes in (CATALOG, CATALOG | more)
    )
    assert beside._linear.program is alone._linear.program
    assert beside._along.program is alone._along.program
    assert [forces.slopes.program for forces in beside._forces[:1]] == [
        forces.slopes.program for forces in alone._forces
    ]
    assert len(beside._forces) == 2


@pytest.mark.parametrize("orders", [(0.0, 1.0, 2.0), (0.5, 1.0)], ids=["0X to 2X", "half an order"])
def test_equations_of_the_kernel_are_those_of_the_response(orders):
    """Put together from parts and sped up by hand; differentiated as a whole they are the same, whatever is free."""
    whole = Model(Jeffcott(1.0, [5.6e4, 5.1e4], 0.02)).with_orders(orders).with_null_effects(CATALOG.values())
    space = make_space(whole, Knowledge())
    kernels, rng, count = Kernels(space), np.random.default_rng(4), len(space.entries)
    unknowns, motion = 0.3 * rng.normal(size=(3, count)), 1e-4 * rng.normal(size=(3, 2, kernels.coefficients))
    condition = Conditions(jnp.asarray(200.0), jnp.full((1, 2), 1e-5), jnp.zeros(2), jnp.asarray(3.0))

    def along(u, q):
        ready = Ready.of(space.at(u), condition)
        shown = ready.shown(q, orders) + added_by_sweep(without_coupling(space.at(u)), condition)
        both = real_pair(shown).ravel(), (ready.system.lacking(q) + ready.system.force(q)).ravel()
        return both, both

    differentiated = jax.jit(jax.vmap(jax.jacfwd(along, argnums=(0, 1), has_aux=True)))(unknowns, motion)
    ((by_unknown, by_motion), (force_by_unknown, force_by_motion)), (shown, force) = jax.tree.map(
        np.asarray, differentiated
    )
    for first in range(0, count, COLUMNS):
        columns = np.where(np.arange(first, first + COLUMNS) < count, np.arange(first, first + COLUMNS), -1)
        installed = np.full((3, 1, 2), 1e-5), np.zeros((3, 2))
        rows = Rows(unknowns, np.tile(columns, (3, 1)), np.full(3, 200.0), *installed, np.full(3, 3.0))
        found, free = kernels.balanced(rows, motion), columns[columns >= 0]
        for got, expected in (
            (found.shown, shown),
            (found.force, force),
            (found.shown_by_motion, by_motion.reshape(found.shown_by_motion.shape)),
            (found.force_by_motion, force_by_motion.reshape(found.force_by_motion.shape)),
            (found.slopes[..., : len(free)], by_unknown[..., free]),
            (found.force_slopes[..., : len(free)], force_by_unknown[..., free]),
        ):
            np.testing.assert_allclose(got, expected, atol=1e-10 * np.abs(expected).max())


def test_equations_without_a_solution_take_none_from_the_others():
    """One singular matrix and one that is not a number, beside a good one."""
    good, singular, lost = np.array([[2.0, 1.0], [0.0, 4.0]]), np.zeros((2, 2)), np.full((2, 2), np.nan)
    found = linearised._solved(np.stack([good, singular, lost]), np.tile(np.eye(2), (3, 1, 1)))
    np.testing.assert_allclose(found[0] @ good, np.eye(2))
    assert np.all(np.isnan(found[1:]))


def test_motions_of_a_table_with_slow_roll_are_not_begun_with_where_there_is_none(spring):
    _, measurement, space, data, true = spring
    free, every = space.free(["duffing"]), np.ones((1, len(measurement.run)), bool)
    at_rest = Linearisation(space, data, Budget()).at_rest
    start = Start(unknowns_at(space, duffing__cubic_n_per_m3=true), np.concatenate([at_rest, at_rest[:1]]))
    found, afresh = (
        descend(space, data, [one], free, every, budget=Budget(), settings=QUICK)[0]
        for one in (start, Start(start.point))
    )
    assert found.exact
    assert found.cost == afresh.cost


def test_a_scan_follows_the_motion_to_the_strength_that_is_there(spring):
    """Strengths are half as far apart as they are large; of two forces together none is the strength."""
    _, measurement, space, data, _ = spring
    one, two = (np.flatnonzero(space.free(names)) for names in (["coulomb_friction"], ["duffing", "coulomb_friction"]))
    (unknown,), nothing, every = one, np.zeros(len(space.entries)), np.ones(len(measurement.run), bool)
    held = np.where(np.arange(len(nothing)) == unknown, 2.0, 0.0)
    shown = predict(space, measurement.conditions, held, budget=Budget()).shown
    lin = Linearisation(space, data._replace(pairs=np.stack([shown.real, shown.imag], axis=-1)), Budget())
    point, motions = scan(lin, nothing, one, every)
    assert 2.0 / 1.5 < point[unknown] < 2.0 * 1.5
    (there,) = lin.at([Point(point, motions, refined=True)], [one])
    assert np.all(there.response.off <= BALANCED)
    assert scan(lin, nothing, two, every) is None


def test_a_trial_whose_motions_answer_a_force_without_bound_is_not_taken(spring, monkeypatch):
    _, measurement, space, data, true = spring
    free, every = space.free(["duffing"]), np.ones((1, len(measurement.run)), bool)
    whole = Linearisation.at

    def unbounded(self, points, free):
        return [
            one
            if one.response is None or (own := one.response.own) is None
            else one._replace(response=one.response._replace(own=own._replace(reach=np.full_like(own.reach, 1e20))))
            for one in whole(self, points, free)
        ]

    monkeypatch.setattr(Linearisation, "at", unbounded)
    monkeypatch.setattr(descent, "first_motions", lambda lin, points: [lin.at_rest for _ in points])
    monkeypatch.setattr(descent, "scan", lambda *_: None)
    (end,) = descend(
        space,
        data,
        [Start(unknowns_at(space, duffing__cubic_n_per_m3=true))],
        free,
        every,
        budget=Budget(),
        settings=QUICK,
    )
    assert end.result == NOT_FINITE
    assert not end.exact


def test_many_states_are_balanced_in_groups(spring, monkeypatch):
    """As in one go, of which the memory would grow with the hypotheses tried."""
    _, _, space, data, true = spring
    lin = Linearisation(space, data, Budget())
    states = np.tile(np.arange(lin.cases), 3)
    unknowns = np.tile(unknowns_at(space, duffing__cubic_n_per_m3=true), (len(states), 1))
    motions = 1e-5 * np.random.default_rng(0).standard_normal((len(states), *lin.at_rest.shape[1:]))
    whole = lin.imbalance(unknowns, states, motions, refined=True)
    monkeypatch.setattr(linearised, "MOST_ROWS", 7)
    for part, grouped in zip(whole, lin.imbalance(unknowns, states, motions, refined=True), strict=True):
        np.testing.assert_allclose(grouped, part, rtol=1e-12, atol=1e-18)

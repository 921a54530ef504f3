"""How much may be computed."""

import pytest

from rotorjax import explain, read_measurement, read_rig
from rotorjax.data.example import write_example
from rotorjax.discovery.explain import FOR_THE_STEPS
from rotorjax.inference.budget import Budget
from rotorjax.reporting.answer import sentence
from rotorjax.reporting.explanation import explanation_text


def test_what_is_reserved_is_there_at_the_end_however_much_was_spent():
    budget = Budget(1000)
    budget.reserve(5000)
    assert budget.left == 900
    budget.spend(950)
    assert budget.exhausted
    budget.release()
    assert (budget.limit, budget.left, budget.exhausted) == (1000, 50, False)
    budget.release()
    assert budget.limit == 1000


def test_a_part_of_what_is_reserved_is_spent_ahead():
    budget = Budget(1000)
    budget.reserve(100)
    budget.spend(900)
    with budget.ahead(60):
        assert budget.left == 60
        budget.spend(40)
    assert budget.exhausted
    budget.release()
    assert (budget.limit, budget.left) == (1000, 60)


def test_what_is_spent_ahead_begins_where_the_last_step_ended_beyond_the_limit():
    budget = Budget(1000)
    budget.reserve(100)
    budget.spend(930)
    with budget.ahead(60):
        assert budget.left == 60
    assert budget.limit == 900


@pytest.mark.parametrize("most", [300, 5000])
def test_a_share_is_no_more_than_what_is_left(most):
    budget = Budget(1000)
    budget.spend(400)
    with budget.share(most):
        assert budget.left == min(most, 600)
    assert budget.left == 600


def test_without_a_limit_nothing_is_exhausted():
    budget = Budget()
    budget.reserve(10)
    budget.spend(10**9)
    with budget.ahead(10):
        assert not budget.exhausted
    budget.release()
    assert not budget.exhausted


def test_at_the_limit_the_answer_is_open_and_what_was_not_tried_is_named(tmp_path):
    """The shipped example takes some 52,000 linearisations."""
    write_example(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    found = explain(rig.model, read_measurement(tmp_path / "measurement.csv", rig), limit=30_000)
    assert found.verdict == "undecided"
    assert set(found.named) == {"residual_unbalance", "cross_coupling"}
    assert found.cost.exhausted
    assert {"what else would do as well", "error on data held out"} <= set(found.cost.untried)
    assert found.cost.linearisations < 30_000 + FOR_THE_STEPS
    told = explanation_text(found, rig)
    assert "of 30,000 allowed. Not tried when the limit of the search was reached: a further effect, " in told
    assert "the search limit was reached before all was tried" in " ".join(told.split())


def test_where_nothing_explains_at_the_limit_no_more_is_claimed_than_was_tried(tmp_path):
    """A phase sign written wrongly, which the search does not come to."""
    write_example(tmp_path)
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text(rig_file.read_text(encoding="utf-8").replace('phase = "lead"', 'phase = "lag"'), "utf-8")
    rig = read_rig(rig_file)
    found = explain(rig.model, read_measurement(tmp_path / "measurement.csv", rig), limit=3_000)
    assert found.verdict == "unexplained"
    told = sentence(found)
    assert "the search limit was reached before all was tried (--limit raises it)." in told
    assert "no further effect" not in told
    assert "`--mistakes`" not in told
    assert "mistakes in rig file and table" in found.cost.untried

"""How much may be computed."""

import pytest

from rotorjax.inference.budget import Budget


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

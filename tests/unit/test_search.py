"""The sets that a search tries around one, and what held-out folds leave out of a set."""

from rotorjax.discovery.held_out import _pruned
from rotorjax.discovery.search import PRICE, neighbours

CANDIDATES = ("a", "b", "c", "d")


def test_neighbours_hold_swaps_parts_and_pairs():
    around = neighbours(CANDIDATES, frozenset("a"), frozenset("ab"), ["b", "c", "d"])
    swaps = {frozenset(s) for s in ("ac", "ad", "bc", "bd")}
    parts = {frozenset("a"), frozenset("b")}
    pairs = {frozenset(s) for s in ("abc", "abd", "acd")}
    assert set(around) == {frozenset("ab")} | swaps | parts | pairs
    assert len(around) == len(set(around))


def test_neighbours_keep_what_is_small():
    around = neighbours(CANDIDATES, frozenset("z"), frozenset("az"), [], kept=frozenset("z"))
    assert all("z" in effects for effects in around)


def test_pruning_pays_the_price_of_a_detection_for_each_part():
    scores = {frozenset(): -100.0, frozenset("a"): -10.0, frozenset("b"): -50.0, frozenset("ab"): -10.0 + 0.5 * PRICE}
    assert _pruned(scores) == frozenset("a")
    assert _pruned({**scores, frozenset("ab"): -10.0 + 2.0 * PRICE}) == frozenset("ab")

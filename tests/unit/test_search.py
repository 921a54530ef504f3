"""The sets that a search tries around one, and what held-out folds leave out of a set."""

from importlib.resources import as_file, files
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from rotorjax import (
    Conditions,
    Instant,
    Layout,
    Matrices,
    MatrixEffect,
    Measurement,
    Model,
    OperatingPoint,
    Probes,
    Reading,
    ReadingEffect,
    RestoringEffect,
    effects,
    fit,
    parameter,
    read_measurement,
    read_rig,
    tell,
)
from rotorjax.discovery.contest import make_contest
from rotorjax.discovery.held_out import _pruned
from rotorjax.discovery.own_effects import check_catalog, check_effect
from rotorjax.discovery.race import Scored, race
from rotorjax.discovery.ranking import PRICE, ranking
from rotorjax.discovery.search import begin, neighbours, select, with_answer
from rotorjax.effects.terms import TERMS
from rotorjax.model.parameters import Parameter

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


def test_an_answer_that_misses_narrowly_is_counted_by_the_share_of_both():
    misses, holds = Scored(-1000.0, 0.4, -20.0), Scored(-998.0, 1.0, -21.0)
    # By 0.4 of the data each: 0.8 ahead, less 1 for the prior.
    assert holds.lead(misses) == pytest.approx(-0.2)
    assert misses.lead(holds) == pytest.approx(0.2)
    assert holds.log_posterior == pytest.approx(-1019.0)


def test_another_answer_that_begins_with_the_same_effect_has_steps_of_its_own():
    """A step told for one answer alone lacks the effects of the next."""
    with as_file(files("rotorjax") / "data" / "example") as folder:
        rig = read_rig(folder / "rig.toml")
        measurement = read_measurement(folder / "measurement.csv", rig)
    others = ("chain_gain", "probe_angle", "stiffness_axes")
    contest = make_contest(rig.model, measurement, ("residual_unbalance", "cross_coupling", *others))
    answer = select(begin(contest), 3)
    first, *further = (r.effect for r in ranking(contest, answer.races[0], frozenset()) if r.effect in others)
    sets = [frozenset({first, second}) for second in further]
    found = race(contest, answer.races[-1].noise, sets, answer.known)
    for effects_there in sets:
        answer = with_answer(answer, effects_there, found)
        assert answer.present == effects_there
        for count, (step, name) in enumerate(zip(answer.races[:-1], answer.effects, strict=True)):
            assert frozenset({*answer.effects[:count], name}) in step.contenders


def test_a_cut_down_catalogue_keeps_what_is_declared_uncertain():
    with as_file(files("rotorjax") / "data" / "example") as folder:
        rig = read_rig(folder / "rig.toml")
        measurement = read_measurement(folder / "measurement.csv", rig)
    names = ("residual_unbalance", "cross_coupling")
    whole = make_contest(rig.model, measurement, names)
    cut = make_contest(rig.model, measurement, names, {name: effects.CATALOG[name] for name in names})
    freed = [{(e.effect, e.label) for e in c.space.entries if e.declared_uncertain} for c in (whole, cut)]
    assert freed[0] == freed[1] != set()
    assert cut.candidates == whole.candidates
    assert cut.free(frozenset()).sum() == whole.free(frozenset()).sum()


def test_a_catalogue_that_would_lose_an_effect_is_refused(paper_rotor):
    with pytest.raises(ValueError, match=r"'mine'.*is the effect 'mass_error': use its name as the key"):
        check_catalog({"mine": effects.MassError}, paper_rotor)


class Mine(RestoringEffect):
    """What a user wrote."""

    name: ClassVar[str] = "mine"
    family: ClassVar[str] = "restoring"
    meaning: ClassVar[str] = "anything"
    source: ClassVar[str] = "none"
    size_n: Array = parameter("size", scale=1.0, of="force")

    def force(self, instant: Instant) -> Array:
        return self.size_n * instant.position


class OneNumber(Mine):
    def force(self, instant: Instant) -> Array:
        return self.size_n * instant.position[0]


class NoDirection(Mine):
    def force(self, instant: Instant) -> Array:
        return self.size_n * instant.position / jnp.linalg.norm(instant.position)


class WithAnIf(Mine):
    def force(self, instant: Instant) -> Array:
        return self.size_n * instant.position if instant.position[0] > 0.0 else jnp.zeros(2)


class WithNumpy(Mine):
    def force(self, instant: Instant) -> Array:
        return self.size_n * np.tanh(instant.velocity)


class Misspelt(Mine):
    @classmethod
    def forms(cls, layout, angles):
        return (({"size": 1.0},),)


class Elsewhere(Mine):
    family: ClassVar[str] = "magic"


@pytest.mark.parametrize(
    ("cls", "words"),
    [
        (OneNumber, r"shape \(\); return \(f_x, f_y\) in N"),
        (NoDirection, "keep it finite there"),
        (WithAnIf, r"an `if` on a value, .*: write jnp.where"),
        (WithNumpy, "functions of jax.numpy"),
        (Misspelt, r"mine: forms\(\) names 'size'; its parameters are size_n"),
        (Elsewhere, "family 'magic'; there are excitation, structure, restoring, reading"),
    ],
)
def test_an_effect_of_ones_own_is_checked_before_it_is_fitted(cls, words, paper_rotor):
    check_catalog({"mine": Mine}, paper_rotor)
    with pytest.raises(ValueError, match=words):
        check_catalog({"mine": cls}, paper_rotor)
    nothing = Measurement.from_arrays(np.ones((1, 2, 1)), Conditions.at([100.0]), sigma=1e-6)
    for ask in (lambda: fit(Model(paper_rotor) + cls(), nothing), lambda: tell(Model(paper_rotor), nothing, [cls()])):
        with pytest.raises(ValueError, match=words):
            ask()


class Root(Mine):
    def force(self, instant: Instant) -> Array:
        return -jnp.sqrt(self.size_n) * instant.position


class AlwaysThere(Mine):
    def force(self, instant: Instant) -> Array:
        return (1.0 + self.size_n) * instant.position


class WithoutScale(Mine):
    size_n: Array = parameter("size", scale=0.0, of="force")


class Bare(MatrixEffect):
    """Matrices without saying which."""

    name: ClassVar[str] = "mine"
    family: ClassVar[str] = "structure"
    meaning: ClassVar[str] = "anything"
    source: ClassVar[str] = "none"
    share: Array = parameter("share", scale=0.1)

    def matrices(self, point: OperatingPoint) -> Matrices:
        return self.share * point.rotor.mass * jnp.eye(2)


class Scalar(Bare):
    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(mass=self.share * point.rotor.mass)


class LossFactor(Bare):
    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(stiffness=1j * self.share * jnp.diag(point.rotor.stiffness))


class OfWhatIsNot(Bare):
    relatives: ClassVar[tuple[str, ...]] = ("mas_error",)

    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(mass=self.share * point.rotor.mass * jnp.eye(2))


class RootOfMass(Bare):
    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(mass=jnp.sqrt(self.share) * point.rotor.mass * jnp.eye(2))


class Sound(Bare):
    def matrices(self, point: OperatingPoint) -> Matrices:
        return Matrices(mass=(jnp.exp(self.share) - 1.0) * point.rotor.mass * jnp.eye(2))


class Silent(ReadingEffect):
    """A gain of zero at zero."""

    name: ClassVar[str] = "mine"
    family: ClassVar[str] = "reading"
    meaning: ClassVar[str] = "anything"
    source: ClassVar[str] = "none"
    gain: Array = parameter("gain", scale=0.1)

    def reading(self, point: OperatingPoint) -> Reading:
        return Reading(gain=self.gain)


@pytest.mark.parametrize(
    ("cls", "words"),
    [
        (Root, r"mine: force\(\) has no finite slope by size_n at zero"),
        (RootOfMass, r"mine: matrices\(\) has no finite slope by share at zero"),
        (AlwaysThere, r"mine: force\(\) is \[.*\] where all parameters are zero: zero must mean"),
        (Silent, r"mine: reading\(\) is 0.0 where all parameters are zero: .* 1.0 there"),
        (WithoutScale, "mine: the prior scale of size_n is 0: give a scale above zero"),
        (LossFactor, r"mine: matrices\(\): stiffness is complex; it must be real"),
        (OfWhatIsNot, "mine: relatives names 'mas_error'; did you mean 'mass_error'"),
        (Bare, r"mine: matrices\(\) returns \w+: return a Matrices\(mass=...\) of rotorjax"),
        (Scalar, r"mine: matrices\(\) returns mass of shape \(\); its shape must be \(2, 2\)"),
    ],
)
def test_an_effect_that_would_spoil_the_search_is_refused_by_name(cls, words, paper_rotor):
    check_catalog({"mine": Sound}, paper_rotor)
    with pytest.raises(ValueError, match=words):
        check_catalog({"mine": cls}, paper_rotor)


def test_the_effects_of_the_package_keep_the_rules(paper_rotor):
    layout = Layout(("X", "Y", "Z"), ("a", "b"))
    probes = Probes(jnp.array([0.0, 1.5, 3.0]), jnp.ones(3), jnp.zeros(3))
    for cls in {**effects.CATALOG, **TERMS}.values():
        check_effect(cls, Model(paper_rotor, probes, [1.0, 0.5], layout=layout))


def test_a_scale_that_the_rig_lacks_is_named(paper_rotor):
    wrong = Parameter("gain", "a gain", 1.0, "stifness", ())
    with pytest.raises(ValueError, match="of='stifness' is no quantity of the rig"):
        wrong.prior_scale(paper_rotor)

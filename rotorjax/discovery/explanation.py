"""An explanation: which effects were missing, how sure that is, and what may be asked of it."""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from rotorjax.data.declarations import Mistake
from rotorjax.discovery.answers import MistakeRace
from rotorjax.discovery.bootstrap import PValue
from rotorjax.discovery.common_noise import Race
from rotorjax.discovery.contest import Contest
from rotorjax.discovery.healthy import Healthy
from rotorjax.discovery.named_force import NamedForce
from rotorjax.discovery.next_measurement import Proposal
from rotorjax.discovery.probable import Probable, probable
from rotorjax.discovery.ranking import Ranked, may_be_missing, showing
from rotorjax.discovery.story import Story
from rotorjax.discovery.ties import Ties
from rotorjax.effects.of_one_run import RUN_EFFECTS
from rotorjax.inference.faults import fault_sensitivity, installed_faults
from rotorjax.inference.noise import Noise, reduced_chi2
from rotorjax.model.contract import Effect
from rotorjax.model.model import Model
from rotorjax.shown import Reported

Verdict = Literal["explained", "undecided", "nothing missing", "unexplained"]


class Cost(NamedTuple):
    """What an explanation took."""

    linearisations: int
    """Single cases linearised: a count that does not depend on the machine."""
    limit: int
    untried: tuple[str, ...] = ()
    """What was left out when the limit was reached."""

    @property
    def exhausted(self) -> bool:
        """Whether the limit was reached before all was tried."""
        return bool(self.untried)


class Small(NamedTuple):
    """An effect that was detected but changed the prediction by less than the noise when it was found."""

    effect: str
    why: str


@dataclasses.dataclass(frozen=True, eq=False)
class Explanation(Reported):
    """What `explain` found."""

    verdict: Verdict
    effects: tuple[str, ...]
    """In the order added; of every tie the most probable."""
    written: MistakeRace
    """What is stated in rig file and table against changes of it."""
    story: Story
    """Comparison and fit at every step, the first without any addition."""
    races: tuple[Race, ...]
    """For every step what was fitted: its effects, and with a further one."""
    ties: Ties
    detected_but_small: tuple[Small, ...]
    next_measurement: Proposal | None
    p_value: PValue | None
    noise: Noise
    """What the answer leaves beside the table's noise."""
    contest: Contest
    max_effects: int
    catalog: Mapping[str, type[Effect]]
    """What might have been missing."""
    named_force: NamedForce | None
    """The force that is missing, where the verdict is "unexplained" and that was to be looked into; or one of a few
    terms that would do as well as the effects found.
    """
    cost: Cost

    def __repr__(self) -> str:
        p = "" if self.p_value is None else f"; p {self.p_value.value:.2g}"
        return f"Explanation({self.verdict}: {', '.join(self.named) or 'no effect'}; {self.story!r}{p})"

    def since(self, healthy: Healthy) -> "Explanation":
        """The same as what has changed since a measurement of the healthy rotor."""
        return dataclasses.replace(self, story=dataclasses.replace(self.story, healthy=healthy))

    @property
    def mistake(self) -> Mistake | None:
        """What was written down wrongly, if anything."""
        return self.written.best.mistake

    @property
    def named(self) -> tuple[str, ...]:
        """All that was found: what was written down wrongly, then the effects."""
        return (*([] if self.mistake is None else [self.mistake.name]), *self.effects)

    def tied_groups(self) -> list[list[list[str]]]:
        """For every part of the answer that is open: itself, then what ties with it."""
        others = [list(other.named) for other in self.written.tied]
        return [*self.ties.groups(), *([[list(self.named), *others]] if others else [])]

    @property
    def model(self) -> Model:
        """The model with what was added, fitted."""
        return self.story.final_model

    @property
    def confirmed(self) -> bool:
        """Whether the effects found make the error fall on data held out too, as far as that was looked into."""
        return self.story.confirmed

    @property
    def objections(self) -> tuple[str, ...]:
        """What speaks against the values of the effects found."""
        return self.story.fits[-1].objections(self.effects, self.mistake)

    @property
    def more(self) -> tuple[Ranked, ...]:
        """What may be missing beside the answer, where that is not improbable; as in
        `rotorjax.discovery.search.may_be_missing`.
        """
        return tuple(may_be_missing(self.rankings[-1]))

    @cached_property
    def rankings(self) -> tuple[tuple[Ranked, ...], ...]:
        """For every step, what a further effect would bring, "none" among them."""
        return tuple(tuple(showing(self.contest, step, min(step.contenders, key=len))) for step in self.races)

    @cached_property
    def probable(self) -> tuple[Probable, ...]:
        """Every set of effects that was fitted near the answer, with mistakes in what was written down, the most
        probable first; empty where nothing explains the data. As in `rotorjax.discovery.probable.probable`.
        """
        if self.verdict == "unexplained":
            return ()
        contenders = [*self.ties.raced.values(), self.ties.winner, *(r.contender for r in self.rankings[-1])]
        return probable(self.contest, contenders, self.written)

    @property
    def probability(self) -> float | None:
        """Probability that just what is named, with what is too small to matter, is hidden; none where nothing explains
        the data.
        """
        if self.verdict == "unexplained":
            return None
        whole = tuple(sorted({*self.named, *(small.effect for small in self.detected_but_small)}))
        return next((one.probability for one in self.probable if one.names == whole), 0.0)

    @property
    def restricted(self) -> bool:
        """Whether some effects of the catalogue were not allowed to be missing."""
        uncertain = {e.effect for e in self.contest.space.entries if e.declared_uncertain}
        given = {e.name for e in self.story.model.effects} | uncertain | RUN_EFFECTS.keys()
        return bool({e.effect for e in self.contest.space.entries} - given - set(self.contest.candidates))

    def bow_over_unbalance(self) -> dict[float, float]:
        """Speed [rpm] -> response to the installed bow over that to the installed unbalance; empty unless all runs
        carry the same bow.
        """
        m = self.contest.measurement
        bow = np.asarray(m.conditions.bow)
        if 1.0 not in m.orders or not np.any(bow) or not np.allclose(bow, bow[0]):
            return {}
        slopes = fault_sensitivity(self.story.model.with_orders(m.orders), m.conditions)[:, :, m.orders.index(1.0)]
        installed = installed_faults(self.story.model, m)[m.run]
        parts = [
            np.linalg.norm(np.einsum("cpkd,cd->cpk", slopes[..., s], installed[:, s]), axis=(1, 2))
            for s in (slice(0, 2), slice(2, 4))
        ]
        cluster, speeds = m.speed_cluster()
        return {
            float(speed): float(np.median(parts[1][cluster == k]) / np.median(parts[0][cluster == k]))
            for k, speed in enumerate(speeds)
            if np.median(parts[0][cluster == k]) > 0.0
        }

    def chi2(self, ranked: Ranked) -> float | None:
        """Squared residual of a contender in squared standard errors per degree of freedom, as in the fits of the
        story; none where the table's are unknown.
        """
        measurement, end = self.contest.measurement, ranked.contender.best
        residual = measurement.half_order_sign(end.shown) * measurement.vectors - end.shown
        scatter = Noise(0.0, self.contest.floor.scatter)
        return reduced_chi2(
            measurement, self.contest.space.model_at(end.point), residual, fitted=len(end.free), noise=scatter
        )

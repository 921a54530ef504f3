"""What is there, or may be, and does not matter: below the noise, or within the tolerance of the model's form."""

import numpy as np

from rotorjax.discovery.contest import Contender, Contest
from rotorjax.discovery.explanation import Small
from rotorjax.discovery.race import contender_of
from rotorjax.discovery.search import DETECTED, Selection, change_by, noise_size, none_left, ranking
from rotorjax.inference.covariance import NO_SCATTER
from rotorjax.inference.influence import influenced
from rotorjax.units import MICROMETRE


def small_effects(contest: Contest, selection: Selection) -> tuple[Small, ...]:
    """What was detected and not added, each with the size of its part in the prediction; and what would be detected if
    the error of the model's form were not alike in all runs.
    """
    found, contender = [], selection.known[selection.present]
    for name in selection.small:
        change, noise = change_by(contest, contender, name), _noise(contest, selection)
        # Found small beside fewer effects, it need not be so in the end.
        beside = "less than the noise of" if change <= noise else "against a noise of"
        found.append(Small(name, f"{_changes(change)}, {beside} {noise / MICROMETRE:.2g} µm"))
    return (*found, *_within_tolerance(contest, selection))


def _noise(contest: Contest, selection: Selection) -> float:
    return noise_size(
        contest.measurement, selection.races[-1].noise if contest.measurement.sigma is None else contest.floor
    )


def _changes(change: float) -> str:
    return f"it changes the prediction by {change / MICROMETRE:.2g} µm rms"


def _within_tolerance(contest: Contest, selection: Selection) -> list[Small]:
    """The further effect that is the most probable, to first order, where the tolerance counts as noise of every vector
    by itself, if one is detected then.
    """
    race, tolerance = selection.races[-1], contest.measurement.knowledge.tolerance
    if tolerance == 0.0 or race.noise.scatter != NO_SCATTER:
        return []
    data = contest.data(race.noise, selection.known[selection.present].best.point)
    by_itself = data._replace(common=data.common[..., :0])

    def anew(contender: Contender) -> Contender:
        ends = [influenced(by_itself, end, contest.training) for end in contender.ends]
        return contender_of(contest, contender.effects, ends, race.noise)

    balanced = {effects: anew(c) for effects, c in race.contenders.items() if c.balanced}
    if selection.present not in balanced:
        return []
    ranked = ranking(contest, race._replace(contenders=balanced), selection.present)
    first = next((r for r in ranked if r.effect != "none"), None)
    if none_left(ranked) >= DETECTED or first is None:
        return []
    change = change_by(contest, race.contenders[first.contender.effects], first.effect)
    if not np.isfinite(change):
        return []
    why = f"{_changes(change)}, which the tolerance of the model's form, {100.0 * tolerance:.2g} %, allows for"
    return [Small(first.effect, why)]

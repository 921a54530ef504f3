"""Whether the readings that `explain` proposes settle what is open: taken on the detailed rotor, beside random ones.

The table with them is explained anew. The random ones are as many, in one of the runs that may be proposed, within the
same speeds.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from rotorjax import explain, read_measurement, read_rig
from rotorjax.discovery.explanation import Explanation
from rotorjax.discovery.next_measurement import BARE, Proposal
from rotorjax.units import RPM

from answers import answer
from detailed.case import Case, Readings
from detailed.files import write_case
from detailed.in_time import NoSteadyStateError

NOTHING_INSTALLED, ONE_TRIAL_WEIGHT = "bare", "trial"
"""Names of runs that there were none of: with nothing installed, and with nothing but a trial weight."""
NOT_THE_SAME = 1.0 - 1e-5
"""Speed of a reading over that of one before: no speed is held to the digit."""


def after_further_readings(case: Case, found: Explanation) -> dict[str, Any] | None:
    """What is separated, and what is open after the readings that were proposed and after random ones.

    None where nothing was proposed, with a mistake in the case, or where the rotor does not come to rest there.
    """
    proposal = found.next_measurement
    limits = case.stated.limits
    if proposal is None or limits is None or case.mistake is not None or found.mistake is not None:
        return None
    rng = np.random.default_rng([815, case.seed])
    runs = [*case.plan.runs, ONE_TRIAL_WEIGHT, *([NOTHING_INSTALLED] if _all_installed(case) else [])]
    low, high = limits.speeds
    chosen = {
        "proposed": (_run(case, proposal), NOT_THE_SAME * RPM * np.array(proposal.speeds_rpm)),
        "random": (str(rng.choice(runs)), rng.uniform(low, high, len(proposal.speeds_rpm))),
    }
    readings = {
        words: Readings(run, at, proposal.new_probes, limits.trial_weight if run == ONE_TRIAL_WEIGHT else 0.0)
        for words, (run, at) in chosen.items()
    }
    try:
        open_after = {words: _open_after(case, taken, rng) for words, taken in readings.items()}
    except NoSteadyStateError:
        return None
    gone, instead = map(set, proposal.separates)
    told = {"expected": proposal.standardised_difference, "readings": len(proposal.speeds_rpm)}
    return {"separates": [sorted(found.effects), sorted({*found.effects} - gone | instead)], **told, **open_after}


def _run(case: Case, proposal: Proposal) -> str:
    if proposal.run in case.plan.runs:
        return proposal.run
    return NOTHING_INSTALLED if proposal.run == BARE else ONE_TRIAL_WEIGHT


def _all_installed(case: Case) -> bool:
    return all(any(weight for weight, _ in weights) for weights in case.stated.installed.values())


def _open_after(case: Case, readings: Readings, rng: np.random.Generator) -> dict[str, Any]:
    """Verdict, names and ties with the table grown by them."""
    with tempfile.TemporaryDirectory() as folder:
        rig_file, table = write_case(case.with_readings(readings, rng), Path(folder))
        rig = read_rig(rig_file)
        found = answer(explain(rig.model, read_measurement(table, rig)))
    return {key: found[key] for key in ("verdict", "named", "ties", "small", "small_ties", "probability")}

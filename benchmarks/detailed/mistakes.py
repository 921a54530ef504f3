"""Mistakes in what rig file and table state: what somebody wrote down who measured all the same."""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from detailed.stated import Plan, Stated

MIL = 25.4
Mistake = Callable[[Stated, np.ndarray], tuple[Stated, np.ndarray, float]]
"""Rig file and vectors -> both with the mistake, and the factor of the standard error."""


def mistakes(stated: Stated, plan: Plan, present: np.ndarray) -> dict[str, Mistake]:
    """Name as the answers have it -> mistake, for all that a measurement permits and that change anything."""
    found: dict[str, Mistake] = {
        "phase_sign_reversed": lambda s, z: (s, np.conj(z), 1.0),
        "amplitude_doubled": lambda s, z: (s, 2.0 * z, 2.0),
        "amplitude_halved": lambda s, z: (_said(s, amplitude="peak-to-peak"), z, 1.0),
        "amplitude_unit": lambda s, z: (s, z / MIL, 1.0 / MIL),
        "amplitude_unit.mil": lambda s, z: (s, MIL * z, MIL),
        "weight_angles_reversed": lambda s, z: (_said(s, weight_angles="against-rotation"), z, 1.0),
    }
    seen = [name for k, name in enumerate(stated.angles) if present[:, k].any()]
    for name in seen:
        sign = np.where(np.array(list(stated.angles)) == name, -1.0, 1.0)[:, None]
        found[f"probe_reversed.{name}"] = lambda s, z, sign=sign: (s, sign * z, 1.0)
    if len(seen) == 2:
        found["probes_exchanged"] = lambda s, z: (s, z[:, ::-1], 1.0)
        found["rotation_reversed"] = lambda s, z: (_said(s, rotation="y-to-x"), z, 1.0)
    if 0 in plan.orders:
        if stated.gravity == "none":
            found["weight_absent"] = lambda s, z: (dataclasses.replace(s, gravity="-y"), z, 1.0)
        else:
            found["weight_direction"] = lambda s, z: (dataclasses.replace(s, gravity="+y"), z, 1.0)
    return found | _of_runs(stated, plan)


def _of_runs(stated: Stated, plan: Plan) -> dict[str, Mistake]:
    """Weights that were not where the rig file says. Only where the rotor had no other unbalance: what the answers know
    is that nothing was installed in a run, or all of it opposite.
    """
    found: dict[str, Mistake] = {}
    total = {run: sum(u for u, _ in w) for run, w in stated.installed.items()}
    for run, weights in stated.installed.items():
        if len(weights) == 1 and total[run] != 0.0 and total[plan.runs[0]] == 0.0:
            opposite = tuple((-u, plane) for u, plane in weights)
            # In truth the weight is where the table has it: the rig file says the other place.
            found[f"trial_weight_opposite.{run}"] = lambda s, z, run=run, w=opposite: (_installed(s, {run: w}), z, 1.0)
    for a, b in itertools.combinations(stated.installed, 2):
        if not np.isclose(total[a], total[b], atol=0.0):
            swapped = {a: stated.installed[b], b: stated.installed[a]}
            found[f"runs_exchanged.{a}.{b}"] = lambda s, z, swapped=swapped: (_installed(s, swapped), z, 1.0)
    first = plan.runs[0]
    if total[first] == 0.0 and len(plan.runs) > 2:
        weight = stated.installed[plan.runs[1]]
        # Said of the baseline, in which nothing was.
        found[f"trial_weight_absent.{first}"] = lambda s, z: (_installed(s, {first: weight}), z, 1.0)
    return found


def _said(stated: Stated, **convention: str) -> Stated:
    return dataclasses.replace(stated, convention={**stated.convention, **convention})


def _installed(stated: Stated, runs: dict) -> Stated:
    return dataclasses.replace(stated, installed={**stated.installed, **runs})

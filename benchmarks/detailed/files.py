"""A case as files that any tool can read, and the truth of it as one record."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from detailed.case import Case

ANSWERS = "answers.jsonl"
"""What is true, one line for a case: not for the eyes of the tool that is asked."""


def truth(case: Case) -> dict[str, Any]:
    """What is true of a case, in plain JSON: names as in the catalogue, values in SI in the terms of the rotor model of
    one mass.
    """
    outside = case.outside
    return {
        "seed": case.seed,
        "kind": case.kind,
        "poorer": case.poorer,
        "noise": case.noise,
        "tolerance": case.stated.tolerance,
        "orders": list(case.plan.orders),
        "runs": len(case.plan.runs),
        "speeds": len(case.plan.speeds) // len(case.plan.runs),
        "cells": int(case.present.sum()),
        "error": case.error,
        "uncertain": sorted(case.stated.uncertain),
        "effects": [p.hidden.name for p in case.effects],
        "outside": None if outside is None else outside.hidden.name,
        "beyond": case.beyond,
        "detail": dict(case.detail),
        "mistake": case.mistake,
        "improvements": {p.hidden.name: p.improvement for p in (*case.effects, *([outside] if outside else []))},
        "mistake_improvement": case.mistake_improvement,
        "values": {f"{p.hidden.name}.{k}": v for p in case.effects for k, v in p.hidden.truth(p.size).items()},
        "exact": [p.hidden.name for p in case.effects if p.hidden.exact],
    }


def write(cases: Sequence[Case], folder: Path) -> None:
    """Rig file and table of every case, ``SEED.toml`` and ``SEED.csv``, and what is true in `ANSWERS` beside the
    folder, not in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        write_case(case, folder)
    lines = [json.dumps(truth(case), allow_nan=False) for case in cases]
    folder.with_name(f"{folder.name}-{ANSWERS}").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_case(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write the rig file and the table of a case. **Returns** both paths."""
    rig, table = folder / f"{case.seed:06d}.toml", folder / f"{case.seed:06d}.csv"
    rig.write_text(case.stated.toml(), encoding="utf-8")
    table.write_text(case.table(), encoding="utf-8")
    return rig, table

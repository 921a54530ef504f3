"""Small rigs and tables for tests, and which cases run by default."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

RIG = """[rotor]
mass_kg = 0.97
stiffness_n_per_m = { x = 56500.0, y = 51300.0 }
damping_ratio = { x = 0.02, y = 0.02 }
[probes]
X = { angle_deg = 0.0 }
Y = { angle_deg = 90.0 }
[runs.baseline]
[runs.trial-a]
unbalance = { magnitude_g_mm = 30.0, angle_deg = 0.0 }
"""
HEADER = "run,speed_rpm,probe,order,amplitude_um,phase_deg,sigma_um"
ROWS = ["baseline,1500,X,1,19.93,-31.4,0.30", "baseline,1500,Y,1,15.2,-121.0,0.30", "trial-a,1500,X,1,30.0,10.0,0.30"]


def with_campaign(cases: Iterable[Any], slow: Callable[[Any], bool]) -> list:
    """Cases as parameters of a test, those that are slow for `make campaign` only."""
    return [pytest.param(case, marks=[pytest.mark.campaign] if slow(case) else []) for case in cases]


def write(folder: Path, *, rig: str = RIG, table: str | bytes = "\n".join([HEADER, *ROWS]) + "\n") -> tuple[Path, Path]:
    """Table and rig file in a folder: their paths."""
    data, toml = folder / "data.csv", folder / "rig.toml"
    data.write_bytes(table if isinstance(table, bytes) else table.encode("utf-8"))
    toml.write_text(rig, encoding="utf-8")
    return data, toml

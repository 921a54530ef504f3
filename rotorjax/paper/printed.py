"""What the paper prints: its tables, as typed off, with value and printed error combined to four digits."""

import csv
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rotorjax.diagnosis.features import FaultValues, components
from rotorjax.model.rotor import Jeffcott

SPEEDS = (1500.0, 2500.0)
"""Speeds of the experiments [rpm]."""
HALF_DIGIT = 0.0051
"""Rounding of the printed values, in g mm, mm and degrees."""
CASES = ("same-quadrant", "in-phase", "anti-phase", "perpendicular")
PARAMETERS = ("U", "alpha", "s", "theta")
DIAGNOSED = {1500.0: "table04_diagnosis_1500rpm", 2500.0: "table05_diagnosis_2500rpm"}
COMPENSATED = {1500.0: "table10_compensated_1500rpm", 2500.0: "table11_compensated_2500rpm"}
INHERENT = {1500.0: "table08_inherent_1500rpm", 2500.0: "table09_inherent_2500rpm"}


def printed(name: str) -> list[dict[str, str]]:
    """Rows of one of the files in ``rotorjax/data/paper``."""
    return list(
        csv.DictReader((files("rotorjax.data") / "paper" / f"{name}.csv").read_text(encoding="utf-8").splitlines())
    )


def rotor() -> Jeffcott:
    """The paper's rotor, with the effective mass that reproduces its printed natural frequencies (erratum 2)."""
    return Jeffcott(0.9686, [56538.0, 51282.0], [0.0050, 0.0047])  # pyright: ignore


class Printed(NamedTuple):
    """Diagnosed and induced faults of the four cases at one speed, SI components."""

    induced: Float[np.ndarray, "case 4"]
    diagnosed: Float[np.ndarray, "case 4"]


def diagnosed(speed_rpm: float) -> Printed:
    """Tables 4 and 5. The printed error gives what was diagnosed to two digits more than the printed value."""
    values: dict[tuple[str, str], tuple[float, float]] = {}
    for row in printed(DIAGNOSED[speed_rpm]):
        induced, error = float(row["induced"]), float(row["error"])
        found = induced + error if row["error_unit"] == "degree" else induced * (1.0 + error / 100.0)
        values[row["case"], row["parameter"]] = induced, found

    def faults(which: int) -> np.ndarray:
        return components(FaultValues(*(np.array([values[case, p][which] for case in CASES]) for p in PARAMETERS)))

    return Printed(faults(0), faults(1))

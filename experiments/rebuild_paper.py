"""Rebuild the vectors behind tables 4 and 5 of Huang et al. 2026 (Sensors 26:2565), whose raw signals are not public.

The paper inverts measured features to faults; here the printed faults go forward through the same model, closed form,
mass 0.9686 kg (which reproduces the printed natural frequencies). Value and printed error together give four digits:
induced times (1 + error), induced plus error. What comes out is rebuilt, not measured.

    python experiments/rebuild_paper.py rotorjax/data/paper
"""

import argparse
import csv
import math
from pathlib import Path

MASS, STIFFNESS, RATIO = 0.9686, {"X": 56538.0, "Y": 51282.0}, {"X": 0.0050, "Y": 0.0047}
TABLES = {1500.0: "table04_diagnosis_1500rpm.csv", 2500.0: "table05_diagnosis_2500rpm.csv"}
SIGMA_UM = 1.0


def diagnosed(path: Path) -> dict[str, dict[str, float]]:
    """Case -> parameter -> what the paper diagnosed, in g mm, mm and degrees."""
    cases: dict[str, dict[str, float]] = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            induced, error = float(row["induced"]), float(row["error"])
            value = induced + error if row["error_unit"] == "degree" else induced * (1.0 + error / 100.0)
            cases.setdefault(row["case"], {})[row["parameter"]] = value
    return cases


def vector_um(fault: dict[str, float], speed_rpm: float, probe: str) -> complex:
    """Equations 1-9: displacement(t) = Re[z exp(iΩt)]."""
    speed = speed_rpm * math.pi / 30.0
    unbalance = (
        fault["U"] * 1e-6 * complex(math.cos(math.radians(fault["alpha"])), math.sin(math.radians(fault["alpha"])))
    )
    bow = fault["s"] * 1e-3 * complex(math.cos(math.radians(fault["theta"])), math.sin(math.radians(fault["theta"])))
    stiffness, ratio = STIFFNESS[probe], RATIO[probe]
    force = stiffness * bow + unbalance * speed**2
    dynamic = complex(stiffness - MASS * speed**2, 2.0 * ratio * math.sqrt(stiffness * MASS) * speed)
    return 1e6 * force / dynamic * (1.0 if probe == "X" else -1j)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    lines = ["run,speed_rpm,probe,order,amplitude_um,phase_deg,sigma_um"]
    for speed, name in TABLES.items():
        for case, fault in diagnosed(folder / name).items():
            for probe in "XY":
                z = vector_um(fault, speed, probe)
                phase = math.degrees(math.atan2(z.imag, z.real))
                lines.append(f"{case},{speed:.0f},{probe},1,{abs(z):.4f},{phase:.4f},{SIGMA_UM}")
    (folder / "measurement.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Make the measurement table of the RK4 rotor kit that the package ships from the published tables.

Source: M. Nouioua, github.com/M-Nouioua/rk4-rotor-unbalance-estimation, commit f3fd3be0 (MIT), doi
10.5281/zenodo.23152815: 1X vectors of 21 conditions, zero-to-peak, phase leading, slow roll at 251 rpm subtracted.
Plane 2 only, where the orbit is nearly circular. The standard error of every cell is the scatter of the repeated
records, pooled over all conditions and divided by the root of the number of records (nearly always three): three
repeats alone would give a standard error that is itself uncertain by half.

    python experiments/convert_rk4.py rk4_1x_mean.csv rotorjax/data/rk4
"""

import argparse
import csv
import math
from pathlib import Path

PROBES = {"plane2_x": "X", "plane2_y": "Y"}


def pooled_sigma(rows: list[dict[str, str]]) -> float:
    """Standard deviation of real and of imaginary part of one record [µm], from the complex scatter of repeats."""
    squares = freedoms = 0.0
    for row in rows:
        if row["repeat_std_um"]:
            freedom = float(row["n_records"]) - 1.0
            squares += freedom * float(row["repeat_std_um"]) ** 2
            freedoms += freedom
    return math.sqrt(squares / freedoms / 2.0)


def unbalance(row: dict[str, str]) -> str:
    """The weights of a condition as a TOML value."""
    weights = [
        f'{{ plane = "disk{disk}", magnitude_g_mm = {float(row[f"u{disk}_gmm"])}, angle_deg = '
        f"{float(row[f'u{disk}_hole_deg'])} }}"
        for disk in (1, 2)
        if float(row[f"u{disk}_gmm"])
    ]
    return f"[{', '.join(weights)}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    with arguments.source.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["sensor"] in PROBES]
    single = pooled_sigma(rows)
    lines = ["run,speed_rpm,probe,order,amplitude_um,phase_deg,sigma_um"]
    runs = {}
    for row in rows:
        vector = complex(float(row["re_um"]), float(row["im_um"]))
        sigma = single / math.sqrt(float(row["n_records"]))
        phase = math.degrees(math.atan2(vector.imag, vector.real))
        lines.append(
            f"{row['condition']},{row['rpm']},{PROBES[row['sensor']]},1,{abs(vector):.4f},{phase:.3f},{sigma:.4f}"
        )
        runs[row["condition"]] = unbalance(row)
    (arguments.folder / "measurement.csv").write_text("\n".join(lines) + "\n")
    rig = (arguments.folder / "rotor.toml").read_text()
    blocks = [f"[runs.{run}]\nunbalance = {weights}\n" for run, weights in runs.items()]
    (arguments.folder / "rig.toml").write_text(rig + "\n" + "\n".join(blocks))


if __name__ == "__main__":
    main()

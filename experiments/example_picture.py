"""The README's picture: the shipped example before and after, and the error as effects are added.

python experiments/example_picture.py --output docs/example.png
"""

import argparse
from importlib.resources import as_file, files
from pathlib import Path

import jax

from rotorjax import explain, read_measurement, read_rig
from rotorjax.reporting.pictures import headline_figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs/example.png"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    with as_file(files("rotorjax") / "data" / "example") as folder:
        rig = read_rig(folder / "rig.toml")
        found = explain(rig.model, read_measurement(folder / "measurement.csv", rig))
    headline_figure(found.story).savefig(arguments.output, dpi=110)


if __name__ == "__main__":
    main()

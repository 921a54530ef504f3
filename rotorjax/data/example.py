"""The example that ``rotorjax example DIR`` writes: a table, a rig file and what to type."""

import os
import tempfile
from importlib.resources import files
from pathlib import Path

from rotorjax.data.files import refusals, write_whole
from rotorjax.errors import InputError

FILES = ("measurement.csv", "rig.toml")
RECORDINGS = "recordings"
GUIDE = """Written to {folder}: measurement.csv (vibration vectors), rig.toml (the rotor, its probes and runs).
The data hide effects that the rig file does not have. Type, one after the other:

  rotorjax compare {folder}/measurement.csv --rig {folder}/rig.toml
      where the model fails, in micrometres and in standard errors

  rotorjax explain {folder}/measurement.csv --rig {folder}/rig.toml --report {folder}/report.html \\
      --write-rig {folder}/explained.toml
      which effects are missing, how sure that is, what cannot be told apart;
      a report with pictures, and the fitted model as a rig file

  rotorjax compare {folder}/measurement.csv --rig {folder}/rig.toml --effect residual_unbalance
      add an effect of your own choice by name: fitted, with the error before and after

  rotorjax diagnose {folder}/measurement.csv --rig {folder}/explained.toml --reference baseline
      unbalance and bow of every run; what the baseline has is inherent and taken off the others

  rotorjax effects
      everything that can be added

Then put your own vectors and your own rotor into the two files.
"""


def write_example(folder: Path, *, recordings: bool = False) -> str:
    """Write the example's files into a folder, which is made if it is missing, with ``recordings`` in time instead of
    the table: all of them, or none. **Returns** what to type.

    **Errors.** `InputError` if a file of that name is there already, or the folder cannot be made or written to.
    """
    taken = [name for name in (*FILES, *[RECORDINGS] * recordings) if os.path.lexists(folder / name)]
    if taken:
        raise InputError(f"{folder / taken[0]}: exists already; give an empty folder")
    with refusals(folder, "cannot be made", "choose another folder"):
        folder.mkdir(parents=True, exist_ok=True)
    shipped = {name: (files("rotorjax") / "data" / "example" / name).read_text(encoding="utf-8") for name in FILES}
    with refusals(folder, "cannot be written to", "choose another folder"):
        beside = tempfile.TemporaryDirectory(dir=folder, prefix=".")
    with beside as begun:
        if recordings:
            from rotorjax.data.example_recordings import write_recordings  # noqa: PLC0415 - JAX is not needed otherwise

            guide = write_recordings(Path(begun), shipped["rig.toml"])
        else:
            guide = GUIDE
            for name, text in shipped.items():
                write_whole(Path(begun) / name, text)
        with refusals(folder, "cannot be written to", "choose another folder"):
            for made in sorted(Path(begun).iterdir()):
                made.rename(folder / made.name)
    return guide.format(folder=folder)

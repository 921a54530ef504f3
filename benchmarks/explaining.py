"""The whole of `explain`, first and again in one process: a linear effect, a force outside the catalogue, and the RK4
measurements.

Everything in it: held-out error, p-value, ties, the missing force. Called by `benchmarks/run.py`, each in a process of
its own with an empty compilation cache; as a program it prints both times.

    python benchmarks/explaining.py rk4
"""

import sys
from importlib.resources import as_file, files

import jax
import numpy as np
from ranking import sixty_conditions
from timing import timed

from rotorjax import Conditions, Jeffcott, Layout, Measurement, Model, explain, read_measurement, read_rig
from rotorjax.data.simulate import noisy
from rotorjax.effects.terms import TERMS

NOISE_UM = 0.5
ORDERS = (0.0, 1.0, 2.0, 3.0)


def rk4() -> tuple[Model, Measurement]:
    """Measured: see rotorjax/data/rk4."""
    with as_file(files("rotorjax") / "data" / "rk4") as folder:
        rig = read_rig(folder / "rig.toml")
        return rig.model, read_measurement(folder / "measurement.csv", rig)


def outside() -> tuple[Model, Measurement]:
    """A spring along x that stiffens with the cube of displacement: two runs at six speeds, four orders."""
    model = Model(Jeffcott(0.9686, [56538.0, 51282.0], [0.03, 0.05]), layout=Layout(orders=ORDERS))
    speeds = float(model.rotor.natural_frequency()) * np.array([0.5, 0.75, 0.9, 1.0, 1.1, 1.3])
    weights = np.array([[12e-6, 0.0], [-12.6e-6, 21.6e-6]])
    run = np.repeat(np.arange(2), len(speeds))
    conditions = Conditions.at(np.tile(speeds, 2), unbalance=weights[run][:, None])
    nothing = np.zeros((len(run), 2, len(ORDERS)), complex)
    plan = Measurement.from_arrays(nothing, conditions, run=run, runs=("baseline", "trial"), orders=ORDERS)
    return model, noisy(model + TERMS["term_cubic_x"](3e10), plan, noise_um=NOISE_UM, seed=5)


DATA = {"cross-coupling": sixty_conditions, "outside": outside, "rk4": rk4}
"""Name -> model and measurement."""


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    model, measurement = DATA[sys.argv[1]]()
    first, again = (timed(lambda: explain(model, measurement))[1] for _ in range(2))
    print(f"{first:.1f} {again:.1f}")


if __name__ == "__main__":
    main()

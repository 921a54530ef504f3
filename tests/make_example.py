"""Make the example's table: the rig of rotorjax/data/example/rig.toml with two effects that the rig file lacks.

Integrated in time by `oracle`, with Gaussian noise of 0.3 µm. The truth, which no command reads, is here: residual
unbalance 9 g mm at 50°, cross-coupled stiffness 1200 N/m, true stiffness 1 % above the rig file's along x.

    python tests/make_example.py > rotorjax/data/example/measurement.csv
"""

import dataclasses

import numpy as np

from oracle import TimeRotor

WEIGHTS = {"baseline": 0.0, "trial-a": 30e-6, "trial-b": 30e-6 * np.exp(1j * np.radians(120.0))}
SPEEDS_RPM = (700, 900, 1100, 1300, 1500, 1700, 1850, 1950, 2050, 2450, 2600, 2800)
SIGMA_UM = 0.3


def truth() -> TimeRotor:
    """The rotor as it is."""
    mass, stiffness = 0.97, (56500.0 * 1.01, 51300.0)
    damping = tuple(2 * 0.02 * np.sqrt(k * mass) for k in (56500.0, 51300.0))
    return TimeRotor(mass, stiffness, damping, cross=1200.0)


def main() -> None:
    rng = np.random.default_rng(1)
    print("run,speed_rpm,probe,order,amplitude_um,phase_deg,sigma_um")
    for run, weight in WEIGHTS.items():
        rotor = dataclasses.replace(truth(), unbalance=weight + 9e-6 * np.exp(1j * np.radians(50.0)))
        for speed in SPEEDS_RPM:
            clean = rotor.vectors(speed * np.pi / 30.0)[:, 0] * 1e6
            noisy = clean + SIGMA_UM * (rng.standard_normal(2) + 1j * rng.standard_normal(2))
            for probe, z in zip("XY", noisy, strict=True):
                print(f"{run},{speed},{probe},1,{abs(z):.3f},{np.degrees(np.angle(z)):.2f},{SIGMA_UM}")


if __name__ == "__main__":
    main()

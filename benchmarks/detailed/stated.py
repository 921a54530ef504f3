"""What a rig file states: the plain rotor of one mass, written as TOML, and how far vectors are from it.

NumPy only: the response of the plain rotor is written out here once more, for the sizes of what is hidden and for the
values that a rig file takes from a healthy rotor.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares

GRAVITY = 9.80665
GRAM_MILLIMETRE = 1e-6
"""kg m in a g mm."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is measured: the speeds of every run, run after run, and what is installed."""

    speeds: np.ndarray
    """Of every condition [rad/s]."""
    run: np.ndarray
    """Number of the run of every condition."""
    runs: tuple[str, ...]
    orders: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Condition x probe x order."""
        return len(self.speeds), 2, len(self.orders)


@dataclasses.dataclass(frozen=True)
class Limits:
    """What a further measurement may be."""

    speeds: tuple[float, float]
    """[rad/s]."""
    trial_weight: float
    """[kg m]."""

    def toml(self) -> list[str]:
        """The lines of them in a rig file."""
        low, high = (speed * 30.0 / np.pi for speed in self.speeds)
        weight = self.trial_weight / GRAM_MILLIMETRE
        return ["[limits]", f"speed_rpm = [{low:.7g}, {high:.7g}]", f"trial_weight_g_mm = {weight:.4g}"]


@dataclasses.dataclass(frozen=True)
class Stated:
    """Contents of a rig file."""

    mass: float
    stiffness: tuple[float, float]
    ratio: tuple[float, float]
    gravity: str
    """``none`` or ``-y`` or ``+y``."""
    installed: Mapping[str, tuple[tuple[complex, str], ...]]
    """Run -> unbalance [kg m] and plane of each weight, the angle counted with the rotation."""
    planes: Mapping[str, float]
    """Plane -> participation."""
    angles: Mapping[str, float]
    """Probe -> direction [rad]."""
    uncertain: Mapping[str, float]
    """``stiffness``, ``damping_ratio`` or ``mass`` -> relative standard deviation."""
    tolerance: float = 0.0
    limits: Limits | None = None
    convention: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def frequency(self) -> float:
        """Mean natural frequency [rad/s]."""
        return float(np.sqrt(np.mean(self.stiffness) / self.mass))

    def values(self) -> np.ndarray:
        """Stiffness and damping ratio along x and y, and the mass."""
        return np.array([*self.stiffness, *self.ratio, self.mass])

    def doubts(self) -> np.ndarray:
        """Relative standard deviation of each of them, zero where it is held for sure."""
        u = self.uncertain
        k, z, m = (u.get(name, 0.0) for name in ("stiffness", "damping_ratio", "mass"))
        return np.array([k, k, z, z, m])

    def predicted(self, plan: Plan, values: np.ndarray | None = None) -> np.ndarray:
        """Vectors of the plain rotor as the table should have them, condition x probe x order [m]."""
        k, zeta, mass = np.split(self.values() if values is None else values, [2, 4])
        damping = 2 * zeta * np.sqrt(k * mass)
        forward = np.array([1.0, 1j if self.convention.get("rotation") == "y-to-x" else -1j])
        against = self.convention.get("weight_angles") == "against-rotation"
        total = {run: sum(u * self.planes[plane] for u, plane in w) for run, w in self.installed.items()}
        unbalance = np.array([total[plan.runs[run]] for run in plan.run], complex)
        unbalance = np.conj(unbalance) if against else unbalance
        s = plan.speeds[:, None]
        once = s**2 * unbalance[:, None] * forward / (k - mass * s**2 + 1j * s * damping)
        down = {"none": 0.0, "-y": -GRAVITY, "+y": GRAVITY}[self.gravity]
        sag = np.broadcast_to(np.array([0.0, down]) * mass / k, once.shape)
        seen = np.array([[np.cos(a), np.sin(a)] for a in self.angles.values()])
        by_order = {0: sag @ seen.T, 1: once @ seen.T}
        z = np.stack([by_order.get(n, np.zeros_like(once)) for n in plan.orders], axis=2)
        z = np.conj(z) if self.convention.get("phase") == "lag" else z
        return 2 * z if self.convention.get("amplitude") == "peak-to-peak" else z

    def toml(self) -> str:
        """The rig file."""
        pair = "{{ x = {:.9g}, y = {:.9g} }}".format
        lines = ["[rotor]", f"mass_kg = {self.mass:.9g}", f"stiffness_n_per_m = {pair(*self.stiffness)}"]
        lines += [f"damping_ratio = {pair(*self.ratio)}", f'gravity = "{self.gravity}"', "", "[probes]"]
        lines += [f"{name} = {{ angle_deg = {np.degrees(angle):.9g} }}" for name, angle in self.angles.items()]
        if len(self.planes) > 1:
            for name, share in self.planes.items():
                lines += ["", f"[planes.{name}]", f"participation = {share:.9g}"]
        if self.convention:
            lines += ["", "[convention]", *(f'{key} = "{value}"' for key, value in self.convention.items())]
        lines += ["", "[model]", f"tolerance = {self.tolerance:.4g}"]
        if self.uncertain:
            lines += ["", "[uncertainty]", *(f"{name} = {value:.4g}" for name, value in self.uncertain.items())]
        if self.limits:
            lines += ["", *self.limits.toml()]
        for run, weights in self.installed.items():
            each = [
                f"{{ magnitude_g_mm = {abs(u) / GRAM_MILLIMETRE:.9g}, angle_deg = {np.degrees(np.angle(u)):.9g}"
                + (f', plane = "{plane}" }}' if len(self.planes) > 1 else " }")
                for u, plane in weights
            ]
            lines += ["", f"[runs.{run}]", f"unbalance = [{', '.join(each)}]"]
        return "\n".join(lines) + "\n"


def deviation(z: np.ndarray, sigma: float, tolerance: float) -> np.ndarray:
    """Standard deviation of real and imaginary part of every vector [m]: of noise and model."""
    size = np.sqrt(np.sum(np.abs(z) ** 2, axis=1, keepdims=True))
    return np.broadcast_to(np.sqrt(sigma**2 + (tolerance * size) ** 2), z.shape)


def misfit(
    stated: Stated,
    plan: Plan,
    error: np.ndarray,
    spread: np.ndarray,
    present: np.ndarray,
    base: np.ndarray | None = None,
) -> float:
    """Chi-square of an error of the vectors, condition x probe x order, that is left when what the rig file calls
    uncertain is fitted, with what that costs by its prior beyond what ``base`` costs.

    **Arguments:** ``base``: values of the plain rotor without the error, as stated unless given.
    """
    doubts = stated.doubts()
    free = np.flatnonzero(doubts)
    base = stated.values() if base is None else base
    here, off = stated.predicted(plan, base), np.log(base / stated.values())[free] / doubts[free]

    def rows(steps: np.ndarray) -> np.ndarray:
        moved = base.copy()
        moved[free] *= np.exp(doubts[free] * steps)
        whitened = ((error - stated.predicted(plan, moved) + here) / spread)[present]
        return np.concatenate([whitened.real, whitened.imag, off + steps])

    start = rows(np.zeros(len(free)))
    if not len(free):
        return float(start @ start)
    best = least_squares(rows, np.zeros(len(free)), method="lm")
    return float(max(0.0, 2.0 * best.cost - off @ off))


def fitted(stated: Stated, plan: Plan, healthy: np.ndarray) -> Stated:
    """The rig file with stiffness, damping, mass and tolerance as vectors of the healthy rotor give them: relative
    errors are made least, and what is left of them, root mean square per real and imaginary part, is the tolerance.
    """
    size = np.sqrt(np.sum(np.abs(healthy) ** 2, axis=1, keepdims=True))
    seen = np.broadcast_to(size > 1e-3 * size.max(), healthy.shape)
    start = stated.values()

    def errors(logs: np.ndarray) -> np.ndarray:
        relative = (stated.predicted(plan, start * np.exp(logs)) - healthy) / np.where(size > 0.0, size, 1.0)
        return np.concatenate([relative.real[seen], relative.imag[seen]])

    found = least_squares(errors, np.zeros(len(start)), x_scale=0.01)
    tolerance = float(np.sqrt(np.mean(errors(found.x) ** 2)))
    kx, ky, zx, zy, mass = map(float, start * np.exp(found.x))
    return dataclasses.replace(stated, mass=mass, stiffness=(kx, ky), ratio=(zx, zy), tolerance=tolerance)

"""What a measuring chain makes of the motion of the disk: NumPy only.

In this order: direction of the probe, runout, gain, saturation, delay, phase reference.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from detailed.in_time import vectors


@dataclasses.dataclass(frozen=True)
class Chain:
    """Two probes and what is wrong with them; nothing is unless given. Pairs are per probe."""

    angles: tuple[float, float] = (0.0, 0.5 * np.pi)
    """Directions from +x towards +y [rad]."""
    runout: Mapping[int, tuple[complex, complex]] = dataclasses.field(default_factory=dict)
    """Order -> what is added at every speed [m]."""
    gains: tuple[float, float] = (1.0, 1.0)
    common_gain: complex = 1.0
    """Of all probes, its phase times n at order n."""
    inverse_limit: float = 0.0
    """A waveform w becomes tanh(w i)/i [1/m]."""
    delay: float = 0.0
    """[s]."""
    reference: float = 0.0
    """Angle by which phases lead [rad]."""

    def read(self, waves: np.ndarray, speeds: np.ndarray, orders: Sequence[int]) -> np.ndarray:
        """Complex vectors, condition x probe x order [m]. **Arguments:** ``waves``: of the disk, condition x (x, y) x
        time over one turn; ``speeds`` [rad/s].
        """
        directions = np.array([[np.cos(a), np.sin(a)] for a in self.angles])
        seen = directions @ waves
        turn = 2 * np.pi * np.arange(waves.shape[-1]) / waves.shape[-1]
        for order, pair in self.runout.items():
            seen = seen + (np.array(pair)[:, None] * np.exp(1j * order * turn)).real
        seen = seen * np.array(self.gains)[:, None]
        if self.inverse_limit:
            seen = np.tanh(self.inverse_limit * seen) / self.inverse_limit
        z = vectors(seen, orders)
        n = np.array(orders)
        lag = -n * speeds[:, None] * self.delay + n * (self.reference + np.angle(self.common_gain))
        shown = abs(self.common_gain) * z * np.exp(1j * lag)[:, None, :]
        return np.where(n == 0, shown.real, shown)

"""A rotating vector with its error: how large it is, where it points, and whether it is there at all."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, fdtri, ndtri, stdtrit

CONFIDENCE = 0.95
"""Of every interval, region and bound that is told."""


class Fault(NamedTuple):
    """A rotating vector as an (x, y) pair in SI, with its covariance; none where the data do not determine it."""

    pair: Float[np.ndarray, "dof"]
    covariance: Float[np.ndarray, "dof dof"] | None
    freedom: float = math.inf
    """Degrees of freedom of the noise where the residual gave it; infinite where the table did."""

    @property
    def magnitude(self) -> float:
        """Length of the vector, SI."""
        return float(np.hypot(*self.pair))

    @property
    def angle_deg(self) -> float:
        """Angle from +x in the sense of rotation."""
        return math.degrees(math.atan2(self.pair[1], self.pair[0]))

    @property
    def standard_error(self) -> float | None:
        """Of the magnitude: across-section of the error ellipse along the vector."""
        return None if self.covariance is None else self._error_along(self.pair)

    @property
    def angle_standard_error_deg(self) -> float | None:
        """Of the angle; 180 where the vector is within its error of zero."""
        if self.covariance is None:
            return None
        across = self._error_across()
        return math.degrees(math.atan2(across, self.magnitude)) if self.magnitude > across else 180.0

    @property
    def half_interval(self) -> float | None:
        """Half of the 95 % interval of the magnitude: Student's quantile times its standard error, SI."""
        return None if self.covariance is None else self._quantile * self._error_along(self.pair)

    @property
    def angle_half_interval_deg(self) -> float | None:
        """Half of the 95 % interval of the angle; 180 where the vector is not different from zero."""
        if self.covariance is None:
            return None
        across = self._quantile * self._error_across()
        return math.degrees(math.atan2(across, self.magnitude)) if self.differs_from_zero else 180.0

    @property
    def largest_error(self) -> float:
        """Standard error along the worst direction; infinite if nothing determines it."""
        return math.inf if self.covariance is None else math.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0))

    @property
    def differs_from_zero(self) -> bool:
        """Whether its 95 % region leaves zero out: uᵀ C⁻¹ u > 2 F(2, freedom), the region of Hotelling (1931, Ann.
        Math. Stat. 2:360), χ² with two degrees of freedom where the noise is known.
        """
        if self.covariance is None:
            return False
        variance, axes = np.linalg.eigh(self.covariance)
        along = axes.T @ self.pair
        exact = variance <= 0.0
        if np.any(along[exact] != 0.0):
            return True
        return float(np.sum(along[~exact] ** 2 / variance[~exact])) > self._radius**2

    @property
    def below(self) -> float:
        """A bound of the magnitude (95 %): its value and the longest radius of the 95 % region; infinite if nothing
        determines it. SI.
        """
        return math.inf if self.covariance is None else self.magnitude + self.reach

    @property
    def reach(self) -> float:
        """Longest radius of the 95 % region: what the error alone may amount to, SI."""
        return self._radius * self.largest_error

    @property
    def region(self) -> Float[np.ndarray, "dof dof"]:
        """The matrix A with which A c, |c| ≤ 1, is the 95 % region about the vector, SI."""
        assert self.covariance is not None
        variance, axes = np.linalg.eigh(self.covariance)
        return self._radius * axes * np.sqrt(np.maximum(variance, 0.0))

    def scaled(self, factor: float) -> "Fault":
        """The vector times a number."""
        covariance = None if self.covariance is None else factor**2 * self.covariance
        return self._replace(pair=factor * self.pair, covariance=covariance)

    @property
    def _quantile(self) -> float:
        upper = 0.5 * (1.0 + CONFIDENCE)
        return float(ndtri(upper) if math.isinf(self.freedom) else stdtrit(self.freedom, upper))

    @property
    def _radius(self) -> float:
        """Of the 95 % region, in standard errors."""
        if math.isinf(self.freedom):
            return math.sqrt(chdtri(2.0, 1.0 - CONFIDENCE))
        return math.sqrt(2.0 * fdtri(2.0, self.freedom, CONFIDENCE))

    def _error_across(self) -> float:
        return self._error_along(np.array([-self.pair[1], self.pair[0]]))

    def _error_along(self, direction: np.ndarray) -> float:
        assert self.covariance is not None
        size = np.hypot(*direction)
        unit = direction / size if size > 0.0 else np.array([1.0, 0.0])
        return float(np.sqrt(max(unit @ self.covariance @ unit, 0.0)))

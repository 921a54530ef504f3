"""Values and their 95 % intervals in figures that the interval bears."""

import math

from rotorjax.reporting.tables import number

FINEST_ANGLE = 1
"""Decimals of an angle in degrees: nobody installs a mass more finely than to 0.1°."""


def decimals_of(error: float) -> int:
    """Decimals that an error bears: one significant digit of it, two where the first is 1; none below the point."""
    digits = -math.floor(math.log10(error))
    return max(0, digits + (1 if round(error * 10.0**digits, 1) < 2.0 else 0))


def value_and_error(value: float, error: float | None, unit: float = 1.0) -> tuple[str, str]:
    """A value and half of its interval in a unit, to the same decimal; a dash for an error that is not known."""
    if error is None or not math.isfinite(error) or error <= 0.0:
        return number(value / unit), "-"
    decimals = decimals_of(error / unit)
    return f"{value / unit:.{decimals}f}", f"{error / unit:.{decimals}f}"


def together(value_and_error: tuple[str, str]) -> str:
    """Value ± error in one cell; the value alone where no error is known."""
    value, error = value_and_error
    return value if error == "-" else f"{value} ± {error}"


def angle_and_error(degrees: float, error: float | None) -> tuple[str, str]:
    """An angle from 0 up to 360°, and half of its interval, no finer than 0.1°, rounded up."""
    coarse = error is not None and error >= 10.0
    decimals = 0 if coarse else FINEST_ANGLE
    value = f"{degrees % 360.0:.{decimals}f}"
    value = f"{0.0:.{decimals}f}" if float(value) == 360.0 else value
    if error is None or not math.isfinite(error):
        return value, "-"
    return value, f"{math.ceil(error * 10**decimals - 1e-9) / 10**decimals:.{decimals}f}"

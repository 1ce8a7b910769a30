"""How many digits of a number are printed."""

from __future__ import annotations

import math


def unit_of_last_digit(value: float, digits: int) -> float:
    """What the last of so many significant digits of a value counts; 0 for 0."""
    return 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1) if value else 0.0


def printed(value: float, unit_of_last: float) -> str:
    """A value down to a digit: 1234.6 with 0.1, 1200 with 100; without rounding where that is 0."""
    if unit_of_last <= 0.0 or not math.isfinite(unit_of_last):
        return f"{value:.4g}"
    if abs(value) < 0.5 * unit_of_last:
        return "0"
    decimals = -math.floor(math.log10(unit_of_last) + 1e-9)
    if abs(value) >= 1e7 or decimals > 7:
        digits = max(0, math.floor(math.log10(max(abs(value), unit_of_last))) + decimals)
        return f"{value:.{digits}e}"
    return f"{round(value, decimals):.{max(0, decimals)}f}"

"""Times that are equal by arithmetic (0.1 + 0.2 and 0.3 are one instant), and durations in words."""

from __future__ import annotations

import math

_ULPS = 8.0  # units in the last place: round-off of a few sums and products


def same_time(a: float, b: float) -> bool:
    """Return True if two times differ by round-off only."""
    return abs(a - b) <= _ULPS * math.ulp(min(abs(a), abs(b)))


def reached(time: float, due: float) -> bool:
    """Return True if a time is at or after another one."""
    return time >= due or same_time(time, due)


def next_multiple(time: float, period: float) -> float:
    """Return the first whole multiple of a period after a time [s]."""
    period = max(period, math.ulp(time))
    nearest = math.floor(time / period + 0.5)
    return (nearest + reached(time, nearest * period)) * period


def duration(seconds: float) -> str:
    """Return a time with two digits, in a suitable unit."""
    units = ((365.25 * 86400.0, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min"))
    size, unit = next(((size, unit) for size, unit in units if seconds >= 2.0 * size), (1.0, "s"))
    value = float(f"{seconds / size:.2g}")
    return f"{value:.0f} {unit}" if value >= 10.0 else f"{value:g} {unit}"

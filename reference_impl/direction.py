"""Directions of parts of a turn, mirrored to the last bit."""

from __future__ import annotations

import math


def direction(k: int, n: int) -> tuple[float, float]:
    """Cosine and sine of k/n of a turn; mirrored directions agree to the last bit (reduced to one octant)."""
    eighths = 8 * k % (8 * n)  # the angle is eighths / n times 45 degrees
    below, eighths = eighths > 4 * n, min(eighths, 8 * n - eighths)
    behind, eighths = eighths > 2 * n, min(eighths, 4 * n - eighths)
    steep, eighths = eighths > n, min(eighths, 2 * n - eighths)
    angle = math.pi / 4.0 * eighths / n
    c, s = (math.sqrt(0.5), math.sqrt(0.5)) if eighths == n else (math.cos(angle), math.sin(angle))
    if steep:
        c, s = s, c
    return (-c if behind else c), (-s if below else s)

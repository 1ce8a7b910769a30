"""Sizes of one solid of each kind, and distances of points from solids, for tests of shapes."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

SOLID_NUMBERS: dict[str, tuple[float, float, float]] = {
    "box": (1.0, 2.0, 3.0),
    "sphere": (0.7, 0.0, 0.0),
    "capsule": (0.3, 1.5, 0.0),
    "cylinder": (0.5, 2.0, 0.0),
    "frustum": (0.6, 0.2, 1.0),
}


def of_point(kind: str, numbers: Any, point: Any) -> float:
    """Distance of a point from a solid, by what it is: its axis, or its outline in the plane of the axis."""
    a, b, _ = numbers
    x, y, z = point
    if kind == "box":
        return float(
            np.linalg.norm(point - np.clip(point, -0.5 * np.array(numbers), 0.5 * np.array(numbers)))
        )
    if kind in ("sphere", "capsule"):
        return max(math.hypot(x, y, z - np.clip(z, -0.5 * b, 0.5 * b)) - a, 0.0)
    low, high, length = (a, a, b) if kind == "cylinder" else numbers
    here, half = np.array([math.hypot(x, y), z]), 0.5 * length
    if abs(z) < half and here[0] < low + (high - low) * (z / length + 0.5):
        return 0.0
    outline = np.array([[0.0, -half], [low, -half], [high, half], [0.0, half]])
    found = []
    for one, other in itertools.pairwise(outline):
        part = np.clip((here - one) @ (other - one) / ((other - one) @ (other - one)), 0.0, 1.0)
        found.append(float(np.linalg.norm(one + part * (other - one) - here)))
    return min(found)

"""Sizes of one solid of each kind, for tests of shapes."""

from __future__ import annotations

SOLID_NUMBERS: dict[str, tuple[float, float, float]] = {
    "box": (1.0, 2.0, 3.0),
    "sphere": (0.7, 0.0, 0.0),
    "capsule": (0.3, 1.5, 0.0),
    "cylinder": (0.5, 2.0, 0.0),
    "frustum": (0.6, 0.2, 1.0),
}

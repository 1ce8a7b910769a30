"""Vectors between the axes of the scene and of a body, for compiled loops (see `exunet.forces.loops`)."""

from __future__ import annotations

from typing import Any


def in_scene_axes(x: Any, q: int, a: float, b: float, c: float) -> Any:
    """A vector of a body's axes in the scene's; its unit quaternion begins at x[q].

    r + 2 w (u x r) + 2 u x (u x r): Schwab and Meijaard, DETC2006-99307, eq. (8).
    """
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    d = 2.0 * (j * c - k * b)
    e = 2.0 * (k * a - i * c)
    f = 2.0 * (i * b - j * a)
    return a + w * d + j * f - k * e, b + w * e + k * d - i * f, c + w * f + i * e - j * d


def in_body_axes(x: Any, q: int, a: float, b: float, c: float) -> Any:
    """A vector of the scene's axes in a body's."""
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    d = 2.0 * (j * c - k * b)
    e = 2.0 * (k * a - i * c)
    f = 2.0 * (i * b - j * a)
    return a - w * d + j * f - k * e, b - w * e + k * d - i * f, c - w * f + i * e - j * d

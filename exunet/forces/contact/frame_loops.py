"""The frame of a touched body, as compiled loops."""

from __future__ import annotations

from typing import Any


def turn_into(x: Any, q: int, turn: Any) -> None:
    """The rotation (3, 3) from the axes of a body, whose quaternion begins at x[q], to the scene's."""
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    turn[0, 0] = 1.0 - 2.0 * (j * j + k * k)
    turn[0, 1] = 2.0 * (i * j - w * k)
    turn[0, 2] = 2.0 * (i * k + w * j)
    turn[1, 0] = 2.0 * (i * j + w * k)
    turn[1, 1] = 1.0 - 2.0 * (i * i + k * k)
    turn[1, 2] = 2.0 * (j * k - w * i)
    turn[2, 0] = 2.0 * (i * k - w * j)
    turn[2, 1] = 2.0 * (j * k + w * i)
    turn[2, 2] = 1.0 - 2.0 * (i * i + j * j)


def place_in_body(x: Any, n: int, c: int, turn: Any) -> Any:
    """A point whose place begins at x[n], from the centre at x[c], in the body's axes."""
    d = x[n] - x[c]
    e = x[n + 1] - x[c + 1]
    f = x[n + 2] - x[c + 2]
    return (
        turn[0, 0] * d + turn[1, 0] * e + turn[2, 0] * f,
        turn[0, 1] * d + turn[1, 1] * e + turn[2, 1] * f,
        turn[0, 2] * d + turn[1, 2] * e + turn[2, 2] * f,
    )


def velocity_against_body(v: Any, n: int, c: int, s: int, turn: Any, p: Any) -> Any:
    """Its velocity less that of the body's point at the same place p (3), in the body's axes."""
    d, e, f = place_in_body(v, n, c, turn)
    return (
        d - (v[s + 1] * p[2] - v[s + 2] * p[1]),
        e - (v[s + 2] * p[0] - v[s] * p[2]),
        f - (v[s] * p[1] - v[s + 1] * p[0]),
    )


def push_point(force: Any, n: int, c: int, s: int, turn: Any, p: Any, f: Any) -> None:
    """A force f (3) [N], in the body's axes, on the point at p (3), and its opposite on the body there."""
    force[s] -= p[1] * f[2] - p[2] * f[1]
    force[s + 1] -= p[2] * f[0] - p[0] * f[2]
    force[s + 2] -= p[0] * f[1] - p[1] * f[0]
    for axis in range(3):
        d = turn[axis, 0] * f[0] + turn[axis, 1] * f[1] + turn[axis, 2] * f[2]
        force[n + axis] += d
        force[c + axis] -= d


FRAMES = (turn_into, place_in_body, velocity_against_body, push_point)

"""The distance from a core that is sampled on a grid, see `exunet.forces.cores.Samples`, as compiled loops.

Between the grid's points it is that of cubic convolution (Keys, IEEE Trans. Acoust. Speech Signal Process. 29
(1981) 1153, doi 10.1109/TASSP.1981.1163711), which is exact for distances up to the second degree, and whose
gradient is continuous: over inner edges too, where that of the distance itself jumps.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from exunet.forces.contact.core_loops import core_gradient, core_point, from_core


def weights_at(t: float) -> Any:
    """Of the four points around a place, t in [0, 1] cells behind the second."""
    u, w = t * t, t * t * t
    return -0.5 * t + u - 0.5 * w, 1.0 - 2.5 * u + 1.5 * w, 0.5 * t + 2.0 * u - 1.5 * w, 0.5 * (w - u)


def slopes_at(t: float) -> Any:
    """Derivatives of `weights_at`."""
    u = t * t
    return -0.5 + 2.0 * t - 1.5 * u, -5.0 * t + 4.5 * u, 0.5 + 4.0 * t - 4.5 * u, 1.5 * u - t


def sampled_distance(c: Any, x: float, y: float, z: float) -> Any:
    """Distance of a place in the core's axes from the core, and its gradient; far away a lower bound, 0."""
    cell = c.cell
    x = (x - c.corner[0]) / cell
    y = (y - c.corner[1]) / cell
    z = (z - c.corner[2]) / cell
    bricks = c.bricks
    ends = 8.0 * bricks.shape[0], 8.0 * bricks.shape[1], 8.0 * bricks.shape[2]
    if not (0.0 <= x < ends[0] and 0.0 <= y < ends[1] and 0.0 <= z < ends[2]):
        p = max(max(-x, x - ends[0]), 0.0)
        q = max(max(-y, y - ends[1]), 0.0)
        r = max(max(-z, z - ends[2]), 0.0)
        return c.beyond + cell * math.sqrt(p * p + q * q + r * r), 0.0, 0.0, 0.0
    i, j, k = int(x), int(y), int(z)
    n = bricks[i // 8, j // 8, k // 8]
    if n < 0:
        p = x - 8 * (i // 8) - 4.0
        q = y - 8 * (j // 8) - 4.0
        r = z - 8 * (k // 8) - 4.0
        apart = cell * math.sqrt(p * p + q * q + r * r)
        d = c.far[i // 8, j // 8, k // 8]
        return (d - apart if d > 0.0 else d + apart), 0.0, 0.0, 0.0
    of_x, of_y, of_z = weights_at(x - i), weights_at(y - j), weights_at(z - k)
    to_x, to_y, to_z = slopes_at(x - i), slopes_at(y - j), slopes_at(z - k)
    first = np.uint32(((n * 11 + i % 8) * 11 + j % 8) * 11 + k % 8)  # an index that is not negative
    values = c.values
    d, d_x, d_y, d_z = 0.0, 0.0, 0.0, 0.0
    for a in range(4):
        e, e_y, e_z = 0.0, 0.0, 0.0
        for b in range(4):
            row = first + np.uint32(121 * a + 11 * b)
            f, g, h, m = values[row], values[row + 1], values[row + 2], values[row + 3]
            along = of_z[0] * f + of_z[1] * g + of_z[2] * h + of_z[3] * m
            e += of_y[b] * along
            e_y += to_y[b] * along
            e_z += of_y[b] * (to_z[0] * f + to_z[1] * g + to_z[2] * h + to_z[3] * m)
        d += of_x[a] * e
        d_x += to_x[a] * e
        d_y += of_x[a] * e_y
        d_z += of_x[a] * e_z
    part = 1.0 / cell
    return d, part * d_x, part * d_y, part * d_z


def any_core_gradient(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """`core_gradient` of cores of all kinds."""
    if cores.kind[n] != 5:
        return core_gradient(cores, n, x, y, z)
    p, q, r = core_point(cores, n, x, y, z)
    d, i, j, k = sampled_distance(cores, p, q, r)
    i, j, k = from_core(cores, n, i, j, k)
    return d, i, j, k


SAMPLED_DISTANCES = (weights_at, slopes_at, sampled_distance, any_core_gradient)

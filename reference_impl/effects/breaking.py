"""`breaking`: elements that carry no load once a limit was exceeded.

A limit of the axial force N = A E (E11 - e) L/L_ref, eq. (8), is one of the strain: with L/L_ref =
sqrt(1 + 2 E11) the force grows with the strain, so that N = F has one root.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.net import Net


@dataclass(frozen=True)
class Breaking:
    """The limit: Green-Lagrange `strain` (free strain excluded), or elastic axial `force` [N]."""

    strain: float | None
    force: float | None


def limits(breaking: Breaking, net: Net, free_strain: float) -> Floats:
    """Total Green-Lagrange strain E11 (m,) [-], free strain included, at which each element breaks."""
    if breaking.strain is not None:
        return np.full(len(net.area), free_strain + breaking.strain)
    assert breaking.force is not None
    goal = breaking.force / (net.area * net.youngs_modulus)  # (E11 - e) sqrt(1 + 2 E11)
    e11 = free_strain + goal / np.sqrt(1.0 + 2.0 * free_strain)
    for _ in range(60):  # Newton's method on a convex increasing function, from above: it falls to the root
        stretch = np.sqrt(1.0 + 2.0 * e11)
        e11 = e11 - ((e11 - free_strain) * stretch - goal) / (stretch + (e11 - free_strain) / stretch)
    for number, points in enumerate(
        net.curves
    ):  # f(e) = F/(E A) at the stretch 1 + e, beyond it as before it
        own = net.law == number
        last = points[-1] + 10.0 * (points[-1] - points[-2])
        e = np.interp(goal[own], *np.vstack((points, last)).T[::-1])
        e11[own] = e + 0.5 * e * e
    return np.asarray(e11)

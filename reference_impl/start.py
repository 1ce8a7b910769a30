"""Initial state of a case: x(0) and v(0), eq. (17).

Packing is a homothety about the origin; velocity and spin together are one twist (screw theory: Murray, Li &
Sastry, A Mathematical Introduction to Robotic Manipulation, 2.4).  Both are 4 x 4 matrices on (x, y, z, 1).
"""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.bodies import skew
from reference_impl.case import Case
from reference_impl.launch import outwards
from reference_impl.net import Net
from reference_impl.weave import between


def initial_state(case: Case, net: Net) -> tuple[Floats, Floats]:
    """Positions (n, 3) [m] and velocities (n, 3) [m/s] at t = 0.  Fixed nodes start, and stay, at rest."""
    start = case.start
    if start.node_positions is None:
        position = _mapped(np.diag([start.packing] * 3 + [1.0]), net.reference_position)
    else:
        position = _spread(net, start.node_positions)
    velocity = np.zeros_like(position)
    moving = np.setdiff1d(np.arange(len(position)), net.fixed_nodes)
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = skew(np.array(start.spin)), start.velocity
    velocity[moving] = _mapped(twist, position[moving])
    if start.node_velocities is not None:
        velocity[moving] += _spread(net, start.node_velocities)[moving]
    if case.launch is not None:
        radial, axial = case.launch
        throw = np.column_stack((outwards(net)[:, :2] * radial, np.full(len(net.bullet_nodes), axial)))
        velocity[net.bullet_nodes] += throw
    return position, velocity


def _mapped(matrix: Floats, points: Floats) -> Floats:
    """The first three components (n, 3) of a matrix (4, 4) on points (n, 3) with a fourth component 1.

    Sums term by term, of which at most three are not zero: no order that depends on the place in the array.
    """
    terms = [points[:, c : c + 1] * matrix[:3, c] for c in range(3)]
    return np.asarray(((terms[0] + terms[1]) + terms[2]) + matrix[:3, 3])


def _spread(net: Net, listed: tuple[tuple[float, ...], ...]) -> Floats:
    """Values (n, 3) of all nodes from those of the listed ones; between these along divided sides."""
    return between(np.array(listed, dtype=float), net.parents, net.shares)

"""Initial state of a case: x(0) and v(0), eq. (17)."""

from __future__ import annotations

import numpy as np

from reference_impl.read import Case
from reference_impl.weave import Floats, Net, between


def initial_state(case: Case, net: Net) -> tuple[Floats, Floats]:
    """Positions (n, 3) [m] and velocities (n, 3) [m/s] at t = 0.  Fixed nodes start, and stay, at rest."""
    start = case.start
    if start.node_positions is None:
        position = start.packing * net.reference_position
    else:
        position = _listed(net, np.array(start.node_positions, dtype=float))
    velocity = np.array(start.velocity) + np.cross(np.array(start.spin), position)
    if start.node_velocities is not None:
        velocity = velocity + _listed(net, np.array(start.node_velocities, dtype=float))
    if case.launch is not None:
        velocity[net.bullet_nodes] += _launch(net, *case.launch)
    velocity[net.fixed_nodes] = 0.0
    return position, velocity


def _listed(net: Net, values: Floats) -> Floats:
    """Values (n, 3) from those of the listed nodes; inner nodes of a divided side lie between its ends."""
    return np.concatenate((values, between(values, net.inner_ends, net.inner_place)))


def _launch(net: Net, radial: float, axial: float) -> Floats:
    """Velocity (k, 3) [m/s] added to the bullets: `radial` outwards in the net's plane, `axial` along +z."""
    away = net.reference_position[net.bullet_nodes]
    away = away / np.sqrt(away[:, :1] * away[:, :1] + away[:, 1:2] * away[:, 1:2])
    return np.asarray(radial * away + np.array([0.0, 0.0, axial]))

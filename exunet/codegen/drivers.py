"""What calls a kernel's `add_forces`, `potential` and `power` from outside, compiled together with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # the generated module holds these beside the functions below

    def add_forces(t: float, x: Any, v: Any, data: Any, force: Any) -> float: ...
    def potential(x: Any, data: Any) -> float: ...
    def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float: ...


def engine_forces(
    t: float,
    q: Any,
    q_t: Any,
    column: Any,
    free: Any,
    reference: Any,
    data: Any,
    x: Any,
    v: Any,
    push: Any,
    force: Any,
    out: Any,
) -> None:
    """Forces on the free coordinates from the engine's displacements and velocities.

    q, q_t    : all second-order coordinates of the engine
    column    : (n_free,) where in q the free coordinates stand
    free      : (n_free,) which of the 3 n_points coordinates are free
    reference : (n_free,) their reference positions [m]
    x, v      : (3 n_points,) work space that holds the fixed nodes; force : (3 n_points,) work space
    push      : (3 n_points,) forces from outside [N]
    out       : (n_free,) the result [N]
    """
    for k in range(free.size):
        x[free[k]] = reference[k] + q[column[k]]
        v[free[k]] = q_t[column[k]]
    for k in range(force.size):
        force[k] = push[k]
    add_forces(t, x, v, data, force)
    for k in range(free.size):
        out[k] = force[free[k]]


def potentials(positions: Any, data: Any, out: Any) -> None:
    """Potential energy of each row of positions (k, 3 n_points) into out (k,)."""
    for row in range(out.size):
        out[row] = potential(positions[row], data)


def powers(times: Any, positions: Any, velocities: Any, data: Any, out: Any) -> None:
    """Power taken out in each row of (k, 3 n_points) states into out (k,)."""
    scratch = np.empty(positions.shape[1])
    for row in range(out.size):
        out[row] = power(times[row], positions[row], velocities[row], data, scratch)


DRIVERS = (engine_forces, potentials, powers)

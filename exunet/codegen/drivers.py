"""What calls a kernel's `add_forces`, `potential` and `power` from outside, compiled together with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # the generated module holds these beside the functions below

    def add_forces(t: float, x: Any, v: Any, data: Any, force: Any) -> float: ...
    def potential(x: Any, data: Any) -> float: ...
    def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float: ...


class Place(NamedTuple):
    """Where the coordinates of points stand in the engine's, and work space.

    column    : (n_free,) where in the engine's coordinates the free ones stand
    free      : (n_free,) which of the 3 n_points coordinates are free
    reference : (n_free,) their reference positions [m]
    x, v      : (3 n_points,) work space that holds the fixed nodes
    push      : (3 n_points,) forces from outside [N]
    force     : (3 n_points,) work space
    """

    column: NDArray[np.uint32]
    free: NDArray[np.uint32]
    reference: NDArray[np.float64]
    x: NDArray[np.float64]
    v: NDArray[np.float64]
    push: NDArray[np.float64]
    force: NDArray[np.float64]


def engine_forces(t: float, q: Any, q_t: Any, data: Any, place: Any, out: Any) -> None:
    """Forces on the free coordinates [N] into out (n_free,), from all the engine's coordinates q, q_t.

    place : a `Place`
    """
    x = place.x
    v = place.v
    force = place.force
    free = place.free
    for k in range(free.size):
        x[free[k]] = place.reference[k] + q[place.column[k]]
        v[free[k]] = q_t[place.column[k]]
    for k in range(force.size):
        force[k] = place.push[k]
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

"""What a simulation shows of one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import rotation_matrix

Floats = NDArray[np.float64]


class Energies(NamedTuple):
    """Energies at one instant [J]; dissipated: since the start, less what forces from outside put in."""

    kinetic: float
    elastic: float
    potential: float
    dissipated: float

    @property
    def total(self) -> float:
        """Their sum, which stays what it was."""
        return sum(self)


@dataclass(frozen=True, eq=False)
class NetState:
    """The net at one instant; copies that stay what they are.

    bullets            : (n_bullets,) nodes that carry a bullet
    position, velocity : (n_nodes, 3) [m], [m/s]
    strain, tension    : (n_elements,) Green-Lagrange strain, axial force [N]
    """

    bullets: NDArray[np.int64]
    position: Floats
    velocity: Floats
    strain: Floats
    tension: Floats


@dataclass(frozen=True, eq=False)
class BodyState:
    """A body at one instant; a point mass has no attitude.

    position, velocity : (3,) of the centre of mass [m], [m/s]
    attitude           : (4,) unit quaternion (w, x, y, z), from the body's axes to the scene's
    rotation           : (3, 3) the same as a matrix
    angular_velocity   : (3,) [rad/s], in the body's axes
    """

    position: Floats
    velocity: Floats
    attitude: Floats | None = None
    angular_velocity: Floats | None = None

    @property
    def rotation(self) -> Floats | None:
        return None if self.attitude is None else rotation_matrix(self.attitude)

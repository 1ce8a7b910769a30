"""What forces act on: the nodes of the net, then the centres of point masses, in one numbering."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from exunet.net.arrays import Net

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PointMass:
    """A body without attitude: its name, mass [kg] and place at the start [m]; at rest."""

    name: str
    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Points:
    """The points of a scene; nodes of the net come first, so a node's number is its point's number.

    net      : the net
    mass     : (n_points,) [kg]
    position : (n_points, 3) at the start [m]
    body     : name of a point mass -> its point
    """

    net: Net
    mass: Floats
    position: Floats
    body: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of_net(cls, net: Net, position: Floats | None = None) -> Points:
        """The nodes alone; at the reference configuration unless a position is given."""
        return cls(net, net.mass, net.reference_position if position is None else position)

    @classmethod
    def of(cls, net: Net, position: Floats, bodies: Sequence[PointMass]) -> Points:
        """The nodes at position (n_nodes, 3) [m], and point masses."""
        mass = np.append(net.mass, [body.mass for body in bodies])
        places = np.array([body.position for body in bodies], dtype=float).reshape(-1, 3)
        numbers = {body.name: net.n_nodes + k for k, body in enumerate(bodies)}
        return cls(net, mass, np.concatenate([position, places]), numbers)

    @property
    def n_points(self) -> int:
        return len(self.mass)

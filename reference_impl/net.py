"""The record of a net: what `weave` builds and the mechanics reads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reference_impl.anchors import Anchors
from reference_impl.arrays import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Net:
    """n nodes, m elements, k bullets, f fixed nodes.

    Bullets run anticlockwise from the smallest polar angle of their reference position in [-pi, pi), so those
    of a square net are lower left, lower right, upper right, upper left.  Nodes: knots (and bullets) first,
    then inner nodes of divided sides, side by side; an explicit net keeps its listed nodes first, as listed.
    Nodes and elements of tethers come last: first ends on bodies, then inner nodes, tether by tether.  Their
    reference position is their place at time 0, for they have none in the plane of the net.
    """

    reference_position: Floats  # (n, 3) [m]
    element_nodes: Ints  # (m, 2)
    reference_length: Floats  # (m,) [m]
    area: Floats  # (m,) [m2]
    youngs_modulus: Floats  # (m,) [Pa]
    density: Floats  # (m,) [kg/m3]
    mass: Floats  # (n,) [kg] lumped, eq. (9), with bullets and node masses
    bullet_nodes: Ints  # (k,)
    fixed_nodes: Ints  # (f,)
    of_string: Bools  # (m,) true for elements of strings, false for those of cables
    numbered_bullets: Ints  # (k,) node of each bullet as the case format numbers them (`weave`)
    parents: Ints  # (n, 2) the knots between which a node lies; a knot is both of its own
    shares: Floats  # (n, 2) its barycentric coordinates between them
    direction: Floats  # (m, 3) unit vectors from i to j in the reference configuration
    tether: Ints  # (m,) number of the tether that an element is of, -1 for cables and strings
    woven: int  # how many of the nodes are the net's own; those of tethers follow
    numbered_nodes: Ints  # the nodes that the case format numbers, in its order (`weave`)
    corners: Ints  # of the mouth, the first one first; empty for an explicit net
    anchors: Anchors  # nodes that are points of bodies, which are numbered as `Case.bodies` lists them

    @cached_property
    def own_mass(self) -> Floats:
        """Masses (n,) [kg] of the nodes themselves; that of a point of a body is the body's."""
        if not len(self.anchors):
            return self.mass
        own = self.mass.copy()
        own[self.anchors.node] = 0.0
        return own


def between(values: Floats, parents: Ints, shares: Floats) -> Floats:
    """Values (n, 3) at all nodes, from those of the knots: their mean, weighted by the shares."""
    one, two = values[parents[:, 0]], values[parents[:, 1]]
    return np.asarray(one * shares[:, :1] + two * shares[:, 1:])

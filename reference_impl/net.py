"""The record of a net: what `weave` builds and the mechanics reads."""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.arrays import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Net:
    """n nodes, m elements, k bullets, f fixed nodes.

    Bullets run anticlockwise from the smallest polar angle of their reference position in [-pi, pi), so those
    of a square net are lower left, lower right, upper right, upper left.  Nodes: knots (and bullets) first,
    then inner nodes of divided sides, side by side; an explicit net keeps its listed nodes first, as listed.
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

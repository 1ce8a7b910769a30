"""The two values of the net room: a topology's `Mesh` and the finished `Net`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Mesh:
    """What a topology fills in: knots and sides, before strings, bullets and division of the sides.

    knots     : (n_knots, 3) reference positions [m]
    sides     : (n_sides, 2) knots at the ends of each cable side
    anchors   : one tuple of knots for each bullet: the corner knots that its strings hold
                (a plain corner has one, a bridle several); empty when the topology has no corners
    bullet_at : (n_bullets, 3) reference positions of the bullets [m] for strings of the asked
                length; equal to the corner knot where the net has no strings
    faces     : closed loops of knots, one a mesh opening
    mouth     : closed loop of corner knots that spans the net's opening; empty if there is none
    """

    knots: Floats
    sides: Ints
    anchors: tuple[tuple[int, ...], ...] = ()
    bullet_at: Floats | None = None
    faces: tuple[tuple[int, ...], ...] = ()
    mouth: tuple[int, ...] = ()


@dataclass(frozen=True)
class Net:
    """A cable net in its reference configuration, ready for either engine.

    Nodes come in the order bullets (or free string ends), knots, inner nodes of divided cables.

    reference_position : (n_nodes, 3) [m], undeformed
    mass               : (n_nodes,) lumped mass [kg], eq. (9) plus bullets
    element_nodes      : (n_elements, 2)
    reference_length   : (n_elements,) L [m]
    area               : (n_elements,) A [m2], reference
    youngs_modulus     : (n_elements,) E [Pa]
    density            : (n_elements,) rho [kg/m3], reference
    is_string          : (n_elements,) True for the elements of the strings
    bullet_nodes       : (n_bullets,)
    fixed_nodes        : (n_fixed,) nodes that are held still
    faces              : loops of nodes round each mesh opening (inner nodes of sides included)
    mouth              : loop of corner nodes; empty if the topology has none
    """

    reference_position: Floats
    mass: Floats
    element_nodes: Ints
    reference_length: Floats
    area: Floats
    youngs_modulus: Floats
    density: Floats
    is_string: NDArray[np.bool_]
    bullet_nodes: Ints
    fixed_nodes: Ints
    faces: tuple[tuple[int, ...], ...] = ()
    mouth: tuple[int, ...] = ()

    @property
    def n_nodes(self) -> int:
        return len(self.mass)

    @property
    def n_elements(self) -> int:
        return len(self.reference_length)

    @property
    def axial_stiffness(self) -> Floats:
        """(n_elements,) EA [N]."""
        return self.youngs_modulus * self.area

"""The touched surface of a rigid body, as compiled loops take it.

A surface is that of all points within a radius, the rounding, of a core. The core of a solid is the solid
with its faces moved inwards by the rounding; of a sphere its middle, of a capsule its axis. Beyond the core
the distance from it is smooth but for jumps of curvature, so that the direction of a force is continuous over
edges, which that of the distance from a sharp solid is not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BOX, CYLINDER, SPHERE, CAPSULE, FRUSTUM, SAMPLED = range(6)
BRICK = 8  # cells of a brick along each edge
STENCIL = BRICK + 3  # grid points that a brick has along each edge: those that its cells ask for


class Samples(NamedTuple):
    """The distance from a core at the points of a regular grid in the core's axes, in bricks of cells.

    Only bricks near the core's surface have points. Points of a brick are those of its cells and one more on
    each side, so that a place in it asks for no other.

    corner : (3,) where the first brick begins [m]
    cell   : between two points [m]
    beyond : the distance is no less than this outside of all bricks [m]
    bricks : (p, q, r) number of each brick in `values`; -1: it has none
    far    : (p, q, r) distance in the middle of each, below 0 inside the core [m]
    values : of STENCIL^3 points of each brick that has some, along z first [m]
    """

    corner: Floats
    cell: float
    beyond: float
    bricks: Ints
    far: Floats
    values: Floats

    @property
    def unchanged(self) -> frozenset[str]:
        """Arrays that are too large to copy, see `exunet.forces.terms.copied`."""
        return frozenset({"bricks", "far", "values"})


def no_samples() -> Samples:
    """Of cores that have a closed form."""
    one = np.zeros((1, 1, 1))
    return Samples(np.zeros(3), 1.0, 0.0, one.astype(np.int64), one, np.zeros(1))


class Cores(NamedTuple):
    """Cores of the solids of a body, in its principal axes, from its centre of mass.

    kind     : (n,) BOX ... FRUSTUM; SAMPLED of a mesh, which is alone
    numbers  : (n, 3) in the core's own axes [m]: half edges; radius and half length, 0; 0, 0, 0; half length
               between the ends, 0, 0; radii at -z and +z and half length
    place    : (n, 3) of the middle [m]
    turn     : (n, 3, 3) from the core's axes to the principal ones
    rounding : (n,) [m]
    boxes    : (n, 6) least and largest coordinates of each with its rounding, along the principal axes [m]
    samples  : distances from a SAMPLED core
    """

    kind: Ints
    numbers: Floats
    place: Floats
    turn: Floats
    rounding: Floats
    boxes: Floats
    samples: Samples

    def of(self, chosen: NDArray[np.bool_]) -> Cores:
        """Return the chosen cores (n,)."""
        return self._replace(**{name: getattr(self, name)[chosen] for name in self._fields[:-1]})


class Surface(NamedTuple):
    """What can be touched of a body.

    cores    : of its solids
    middle   : (3,) of a ball around all of it, in its principal axes [m]
    radius   : of this ball [m]
    allowed  : depth beyond which nothing may be [m]
    least    : half of its least thickness [m]
    bends    : bound of how fast the direction of a force may turn back towards where it came from along a way
               [1/m], as over an inner edge of a mesh; 0.0 of solids
    error    : of the distance from a mesh, the largest that was found when it was sampled [m]; 0.0 of solids
    attached : nodes that are fixed to it
    wound    : numbers of elements that may be wound on its drums, of each reel
    """

    cores: Cores
    middle: Floats
    radius: float
    allowed: float
    least: float
    attached: Ints
    wound: tuple[tuple[int, ...], ...] = ()
    bends: float = 0.0
    error: float = 0.0


class TouchedBody(NamedTuple):
    """Touched body as compiled loops take it.

    middle, radius, least : as `Surface`
    allowed : depth beyond which nothing may be [m]
    centre, attitude, spin : where the entries of the body begin, see `exunet.forces.blocks`
    """

    middle: Floats
    radius: float
    allowed: float
    least: float
    centre: int
    attitude: int
    spin: int

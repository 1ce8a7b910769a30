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

from exunet.base.arrays import Floats, Ints

BOX, CYLINDER, SPHERE, CAPSULE, FRUSTUM, SAMPLED = range(6)
BRICK = 8  # cells of a brick along each edge
BLOCK = 8  # bricks of a block along each edge
STENCIL = BRICK + 3  # grid points that a brick has along each edge: those that its cells ask for
PLANES = 6  # planes that a brick may have at most


class SampledDistance(NamedTuple):
    """The distance from the core of a mesh, in bricks of cells of a regular grid in the core's axes.

    Where the core is convex near a brick, the brick has the planes of the core's faces, and its distance is
    exact. Other bricks have the distance at their grid points, which are those of its cells and one more on
    each side, so that a place in it asks for no other. A brick beside one of these that has planes has both,
    and goes over from one distance to the other. Bricks stand in blocks; those without planes and points, and
    blocks without bricks, are farther away than what touches, or deep in the core.

    corner : (3,) where the first block begins [m]
    cell   : between two points [m]
    ends   : (3,) number of cells
    beyond : the distance is no less than this outside of all blocks [m]
    blocks : (p, q, r) number of each block in `bricks`; -1: it has no bricks
    far    : (p, q, r) bound of the distance in the middle of each, below 0 inside the core [m]
    bricks : (b, BLOCK^3) number of each brick; -1: it has neither planes nor points
    apart  : (b, BLOCK^3) bound of the distance in the middle of each [m]
    convex : (n,) number in `sets` of each brick's planes, -1: none
    points : (n,) number in `values` of its points, -1: none
    weight : (n, 8) of its planes at its corners, 0 or 1
    sets   : (k, PLANES) numbers in `planes`; sizes : (k,) how many these are
    planes : (m, 4) of the core's faces: outward normal and distance from the origin [m]
    values : of STENCIL^3 points of each brick that has some, along z first [m]
    """

    corner: Floats
    cell: float
    ends: Floats
    beyond: float
    blocks: Ints
    far: Floats
    bricks: NDArray[np.int32]
    apart: NDArray[np.float32]
    convex: NDArray[np.int32]
    points: NDArray[np.int32]
    weight: NDArray[np.int8]
    sets: Ints
    sizes: Ints
    planes: Floats
    values: Floats

    @property
    def unchanged(self) -> frozenset[str]:
        """Arrays that are too large to copy, see `exunet.forces.terms.copied`."""
        return frozenset(self._fields) - {"corner", "cell", "ends", "beyond"}

    @property
    def size(self) -> int:
        """Memory of the arrays [bytes]."""
        return sum(getattr(self, name).nbytes for name in self.unchanged)


def no_samples() -> SampledDistance:
    """Return empty samples, for cores that have a closed form."""
    return SampledDistance(
        corner=np.zeros(3),
        cell=1.0,
        ends=np.zeros(3),
        beyond=0.0,
        blocks=np.zeros((0, 0, 0), dtype=np.int64),
        far=np.zeros((0, 0, 0)),
        bricks=np.zeros((0, 0), dtype=np.int32),
        apart=np.zeros((0, 0), dtype=np.float32),
        convex=np.zeros(0, dtype=np.int32),
        points=np.zeros(0, dtype=np.int32),
        weight=np.zeros((0, 0), dtype=np.int8),
        sets=np.zeros((0, 0), dtype=np.int64),
        sizes=np.zeros(0, dtype=np.int64),
        planes=np.zeros((0, 0)),
        values=np.zeros(0),
    )


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
    samples: SampledDistance

    def of(self, chosen: NDArray[np.bool_]) -> Cores:
        """Return the chosen cores (n,)."""
        return self._replace(**{name: getattr(self, name)[chosen] for name in self._fields[:-1]})


class Surface(NamedTuple):
    """Contact surface of a body.

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

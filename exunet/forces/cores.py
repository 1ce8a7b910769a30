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

BOX, CYLINDER, SPHERE, CAPSULE, FRUSTUM = range(5)


class Cores(NamedTuple):
    """Cores of the solids of a body, in its principal axes, from its centre of mass.

    kind     : (n,) BOX ... FRUSTUM
    numbers  : (n, 3) in the core's own axes [m]: half edges; radius and half length, 0; 0, 0, 0; half length
               between the ends, 0, 0; radii at -z and +z and half length
    place    : (n, 3) of the middle [m]
    turn     : (n, 3, 3) from the core's axes to the principal ones
    rounding : (n,) [m]
    boxes    : (n, 6) least and largest coordinates of each with its rounding, along the principal axes [m]
    """

    kind: Ints
    numbers: Floats
    place: Floats
    turn: Floats
    rounding: Floats
    boxes: Floats


class Surface(NamedTuple):
    """What can be touched of a body.

    cores    : of its solids
    middle   : (3,) of a ball around all of it, in its principal axes [m]
    radius   : of this ball [m]
    allowed  : depth beyond which nothing may be [m]
    least    : half of its least thickness [m]
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

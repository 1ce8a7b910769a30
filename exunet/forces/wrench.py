"""A wrench on a rigid body that somebody outside gives between steps: a controller, or a host."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks
from exunet.forces.rotation_loops import in_body_axes
from exunet.forces.terms import Input, KernelTerm

UNITS = "N, N m"


class Wrench(NamedTuple):
    """centre, attitude, spin : where the entries of the body begin; load : (6,) force [N], torque [N m]."""

    centre: int
    attitude: int
    spin: int
    load: NDArray[np.float64]


def input_name(body: str) -> str:
    """The name of the input that holds the wrench on a body."""
    return f"wrench/{body}"


def wrench_on(blocks: Blocks, body: str) -> KernelTerm:
    """Force [N] at the centre of mass of a free body and torque [N m] about it, in the scene's axes.

    Both are zero until its input is given.
    """
    where = blocks.centre(body), blocks.attitude(body), blocks.spin(body)
    given = Input(input_name(body), "load", np.zeros(6), UNITS)
    data = Wrench(*where, np.zeros(6))
    return KernelTerm("bodies", add_wrench, data, helpers=(in_body_axes,), bodies=(body,), inputs=(given,))


def add_wrench(t: float, x: Any, v: Any, wrench: Any, force: Any) -> None:
    """The force in the scene's axes, the torque in those of the body."""
    load = wrench.load
    a, b, c = in_body_axes(x, wrench.attitude, load[3], load[4], load[5])
    for axis in range(3):
        force[wrench.centre + axis] += load[axis]
    force[wrench.spin] += a
    force[wrench.spin + 1] += b
    force[wrench.spin + 2] += c

"""A wrench on a rigid body that somebody outside gives between steps: a controller, or a host."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks
from exunet.forces.rotation_loops import in_body_axes
from exunet.forces.terms import Input, KernelTerm

Floats = NDArray[np.float64]
UNITS = "N, N m"


class Wrench(NamedTuple):
    """A force and a torque on a body, in the scene's axes.

    centre, attitude, spin : where the entries of the body begin
    arm  : (3,) where the force acts, from the centre of mass in principal axes [m]
    load : (6,) force [N], torque [N m]
    """

    centre: int
    attitude: int
    spin: int
    arm: Floats
    load: Floats


def input_name(body: str) -> str:
    """The name of the input that holds the wrench on a body."""
    return f"wrench/{body}"


def wrench_on(blocks: Blocks, body: str, arm: Floats) -> KernelTerm:
    """Force [N] at a point of a free body and torque [N m], in the scene's axes; zero until given.

    arm : (3,) of the point from the centre of mass, in principal axes [m]
    """
    where = blocks.centre(body), blocks.attitude(body), blocks.spin(body)
    given = Input(input_name(body), "load", np.zeros(6), UNITS)
    data = Wrench(*where, arm, np.zeros(6))
    return KernelTerm("bodies", add_wrench, data, helpers=(in_body_axes,), bodies=(body,), inputs=(given,))


def add_wrench(t: float, x: Any, v: Any, wrench: Any, force: Any) -> None:
    """The force in the scene's axes, the torque, and that of the force's arm, in those of the body."""
    load, arm = wrench.load, wrench.arm
    a, b, c = in_body_axes(x, wrench.attitude, load[3], load[4], load[5])
    d, e, f = in_body_axes(x, wrench.attitude, load[0], load[1], load[2])
    for axis in range(3):
        force[wrench.centre + axis] += load[axis]
    force[wrench.spin] += a + arm[1] * f - arm[2] * e
    force[wrench.spin + 1] += b + arm[2] * d - arm[0] * f
    force[wrench.spin + 2] += c + arm[0] * e - arm[1] * d

"""A rigid body: what does not change of it, and its frame in terms of its principal axes.

Two frames belong to a body. Its *frame* is that of the case, in which its shape is drawn and its points are
named. In its *principal axes*, whose origin is the centre of mass, it is integrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import RigidStates, product, rotation_matrix
from exunet.bodies.shapes import Shape

Floats = NDArray[np.float64]
ROUND_OFF = 1e-14  # of the largest moment: an element of a matrix of inertia that is smaller is 0
ALONG = (1.0, 0.0, 0.0, 0.0)  # principal axes along those of the frame


@dataclass(frozen=True)
class RigidBody:
    """A rigid body.

    mass    : [kg]
    inertia : principal moments [kg m2]
    centre  : of mass, in the frame [m]
    axes    : unit quaternion (w, x, y, z) that turns the principal axes into those of the frame
    shape   : in the frame; None: a body without a surface
    """

    name: str
    mass: float
    inertia: tuple[float, float, float]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[float, float, float, float] = ALONG
    shape: Shape | None = None

    @property
    def is_along_frame(self) -> bool:
        """True if the principal axes are those of the frame."""
        return self.axes == ALONG

    @property
    def rotation(self) -> Floats:
        """(3, 3), from principal axes to those of the frame."""
        return rotation_matrix(np.array(self.axes))

    @property
    def inertia_in_frame(self) -> Floats:
        """(3, 3) about the centre of mass, in the axes of the frame [kg m2]; what is round-off in it is 0."""
        if self.is_along_frame:
            return np.diag(self.inertia)
        turned = self.rotation @ np.diag(self.inertia) @ self.rotation.T
        return np.where(np.abs(turned) > ROUND_OFF * max(self.inertia), turned, 0.0)

    def frame_poses(self, position: Floats, attitude: Floats) -> Floats:
        """(..., 7) place of the frame's origin [m] and its attitude, of states of the body.

        position, attitude : (..., 3) of the centre of mass [m], (..., 4) of the principal axes
        """
        frame = product(attitude, np.array(self.axes) * [1.0, -1.0, -1.0, -1.0])
        return np.concatenate([position - rotation_matrix(frame) @ np.array(self.centre), frame], axis=-1)

    def in_principal_axes(self, point: Sequence[float]) -> Floats:
        """A point (3,) of the frame, from the centre of mass and in principal axes [m]."""
        return np.asarray((np.array(point, dtype=float) - self.centre) @ self.rotation)


def in_frames(bodies: Sequence[RigidBody], states: RigidStates) -> RigidStates:
    """States with attitudes and angular velocities of the frames; places stay those of the centres."""
    if all(body.is_along_frame for body in bodies):
        return states
    axes = np.array([body.axes for body in bodies])
    back = axes * [1.0, -1.0, -1.0, -1.0]
    spin = np.einsum("nij,...nj->...ni", rotation_matrix(axes), states.angular_velocity)
    return replace(states, attitude=product(states.attitude, back), angular_velocity=spin)

"""The engine's coordinates, and what they say of the blocks of a system."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import quaternion_of, rotation_vector
from exunet.system.system import Memories, Moving

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Coordinates(NamedTuple):
    """Displacements and rotation vectors q, their velocities v, first-order states y; (..., n) each."""

    q: Floats
    v: Floats
    y: Floats


class Places(NamedTuple):
    """Where the blocks stand in the engine's second-order coordinates.

    reference : (n_points, 3) places of the points without displacement [m]
    free      : (n_points,) False for fixed points, which have no coordinates
    points    : (3 n_free,) coordinates of the free points
    bodies    : (n_free_bodies, 6) of the free bodies, whose rotation vector is their attitude
    kinematics : what of the system has no coordinates
    """

    reference: Floats
    free: NDArray[np.bool_]
    points: Ints
    bodies: Ints
    kinematics: Kinematics

    def unpack(self, now: Coordinates, time: float | Floats, memory: Memories) -> Moving:
        """What moves, by the engine's coordinates at times (...) [s], with these memories."""
        return self.of_coordinates(now).completed(self.kinematics, time, memory)

    def of_coordinates(self, now: Coordinates) -> Moving:
        """What has coordinates; points without are where they were at the start, and at rest."""
        shape = (*now.q.shape[:-1], *self.reference.shape)
        position = np.broadcast_to(self.reference, shape).copy()
        speed = np.zeros(shape)
        free = (*now.q.shape[:-1], -1, 3)
        position[..., self.free, :] += now.q[..., self.points].reshape(free)
        speed[..., self.free, :] = now.v[..., self.points].reshape(free)
        place, turning = now.q[..., self.bodies], now.v[..., self.bodies]
        attitude = quaternion_of(place[..., 3:])
        bodies = RigidStates(place[..., :3], turning[..., :3], attitude, turning[..., 3:])
        return Moving(position, speed, bodies, now.y)

    def pack(self, moving: Moving, like: Coordinates) -> Coordinates:
        """The engine's coordinates; where a place or an attitude is that of `like`, so is its coordinate."""
        q, v = like.q.copy(), like.v.copy()
        before = self.of_coordinates(like)
        bodies = RigidStates(*(part[: len(self.bodies)] for part in moving.bodies.parts()))
        moved = (moving.position != before.position)[self.free].ravel()
        q[self.points[moved]] = (moving.position - self.reference)[self.free].ravel()[moved]
        v[self.points] = moving.velocity[self.free].ravel()
        turned = (bodies.attitude != before.bodies.attitude).any(axis=1)
        q[self.bodies[:, :3]] = bodies.position
        q[self.bodies[turned, 3:]] = rotation_vector(bodies.attitude[turned])
        v[self.bodies] = np.concatenate([bodies.velocity, bodies.angular_velocity], axis=1)
        return Coordinates(q, v, np.array(moving.first_order))

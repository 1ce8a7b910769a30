"""Ports: bodies that a host moves. It tells where their frames are at the end of a step, and how they move.

Between two such instants the centre of mass goes along the cubic with the places and velocities of both, and
the attitude along the rotation vector phi, also a cubic, with the attitudes and angular velocities of both:
phi = 0 and phi' = w0 at the beginning; at the end phi = log(q0^-1 q1) and phi' = J(phi)^-1 w1, J as in
`exunet.bodies.guide`. So place, attitude and their rates have no jumps whatever the host says.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.errors import InputError
from exunet.bodies import port_motion as motion
from exunet.bodies.body import RigidBody
from exunet.bodies.keys import unit_quaternion

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
_ZERO = (0.0, 0.0, 0.0)
_SIZES = (3, 3, 4, 3)  # of the parts of a frame's state
PER_FRAME = sum(_SIZES)


class FrameState(NamedTuple):
    """Where the frame of a body is, and how it moves.

    position         : (3,) of its origin [m]
    velocity         : (3,) of its origin [m/s]
    attitude         : (4,) unit quaternion (w, x, y, z), from the frame's axes to the scene's
    angular_velocity : (3,) in the frame's axes [rad/s]
    """

    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, state: FrameState | tuple[ArrayLike, ...], whose: str) -> FrameState:
        """As plain floats, the quaternion of length 1; raises InputError for what is no state of a frame.

        whose : for the words of the error
        """
        try:
            if (
                type(state) is cls
                and tuple(map(len, state)) == _SIZES
                and math.isfinite(sum(map(sum, state)))
            ):
                w, x, y, z = state.attitude
                if abs(w * w + x * x + y * y + z * z - 1.0) < 1e-14:
                    return state
            parts = [tuple(map(float, np.asarray(part, dtype=float).tolist())) for part in state]
        except (TypeError, ValueError):
            parts = []
        if tuple(map(len, parts)) != _SIZES:
            raise InputError(
                f"{whose}: a frame has position (3), velocity (3), attitude (4) and angular velocity (3), "
                f"got {state!r}"
            )
        wrong = [
            name for name, part in zip(cls._fields, parts, strict=True) if not all(map(math.isfinite, part))
        ]
        if wrong:
            raise InputError(f"{whose}: {', '.join(wrong)} contains NaN or infinity: {state!r}")
        position, velocity, attitude, spin = parts
        length = math.hypot(*attitude)
        if not abs(length - 1.0) < 1e-6:
            raise InputError(f"{whose}: the attitude is a unit quaternion, got one of length {length:g}")
        return cls(position, velocity, unit_quaternion(attitude), spin)  # type: ignore[arg-type]

    def after(
        self, duration: float, acceleration: Vector = _ZERO, angular_acceleration: Vector = _ZERO
    ) -> FrameState:
        """A time [s] later, at constant accelerations.

        acceleration, angular_acceleration : (3,) of the origin [m/s2]; in the frame's axes [rad/s2]
        """
        return FrameState(*motion.after(self, duration, acceleration, angular_acceleration))


def frames_of(names: Sequence[str], rows: Floats) -> dict[str, FrameState]:
    """States by name, of the numbers of their parts, (n, 13) or in one row that may be longer; unchecked."""
    values = rows.ravel()[: PER_FRAME * len(names)].reshape(-1, PER_FRAME).tolist()
    return {name: FrameState(*motion.state_at(values, k)) for k, name in enumerate(names)}


def rows_of(frames: Iterable[FrameState | PrincipalState]) -> Floats:
    """(n, 13) numbers of n states, as the functions of `exunet.coupling.port_loops` take them."""
    return np.array([[*place, *speed, *turn, *spin] for place, speed, turn, spin in frames], dtype=float)


class Piece(NamedTuple):
    """How a body moves from an instant on, as one piece of an `exunet.bodies.guide.Guide`.

    time     : where it begins [s]
    position : (4, 3) coefficients c0 ... c3 of the place of the centre of mass [m/s3 ... m]
    attitude : (4,) unit quaternion (w, x, y, z) of the principal axes where it begins
    turning  : (4, 3) coefficients of the rotation vector, in principal axes
    """

    time: float
    position: Floats
    attitude: Floats
    turning: Floats

    @classmethod
    def steady(cls, time: float, place: Floats, velocity: Floats, attitude: Floats, spin: Floats) -> Piece:
        """On at constant velocity and angular velocity."""
        position, turning = np.zeros((2, 4, 3))
        position[2], position[3], turning[2] = velocity, place, spin
        return cls(time, position, np.array(attitude), turning)

    def numbers(self) -> Floats:
        """All of it (29,), for a snapshot."""
        return np.concatenate([[self.time], self.position.ravel(), self.attitude, self.turning.ravel()])

    @classmethod
    def of_numbers(cls, numbers: Floats) -> Piece:
        """What `numbers` gave."""
        cubic, turns = numbers[1:13].reshape(4, 3), numbers[17:].reshape(4, 3)
        return cls(float(numbers[0]), cubic.copy(), numbers[13:17].copy(), turns.copy())


class PrincipalState(NamedTuple):
    """The state of a body as it is integrated: centre of mass, principal axes; see `RigidStates`."""

    position: Vector
    velocity: Vector
    attitude: Quaternion
    angular_velocity: Vector


@dataclass(frozen=True)
class FrameOf:
    """Between the states of a body's frame and those of its centre of mass and principal axes."""

    centre: Vector
    axes: Quaternion

    @classmethod
    def body(cls, body: RigidBody) -> FrameOf:
        """Of a body."""
        return cls(body.centre, body.axes)

    def principal(self, frame: FrameState) -> PrincipalState:
        """Of a state of the frame."""
        return PrincipalState(*motion.principal_of(frame, self.centre, self.axes))

    def frame(self, state: PrincipalState) -> FrameState:
        """Of a state of the centre of mass and the principal axes."""
        return FrameState(*motion.frame_of(state, self.centre, self.axes))

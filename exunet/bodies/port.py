"""Ports: bodies that a host moves. It tells where their frames are at the end of a step, and how they move.

Between two such instants the centre of mass goes along the cubic with the places and velocities of both, and
the attitude along the rotation vector phi, also a cubic, with the attitudes and angular velocities of both:
phi = 0 and phi' = w0 at the beginning; at the end phi = log(q0^-1 q1) and phi' = J(phi)^-1 w1, J as in
`exunet.bodies.guide`. So place, attitude and their rates have no jumps whatever the host says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.errors import InputError
from exunet.bodies.body import RigidBody
from exunet.bodies.keys import unit_quaternion
from exunet.bodies.rigid import product, rotation_matrix

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
        half = 0.5 * duration
        speed = _along(self.velocity, duration, acceleration)
        spin = _along(self.angular_velocity, duration, angular_acceleration)
        way = _along(self.velocity, half, acceleration)
        i, j, k = _along(self.angular_velocity, half, angular_acceleration)
        turn = quaternion_of((duration * i, duration * j, duration * k))
        return FrameState(_along(self.position, duration, way), speed, times(self.attitude, turn), spin)


def _along(begin: Vector, duration: float, rate: Vector) -> Vector:
    (a, b, c), (d, e, f) = begin, rate
    return (a + duration * d, b + duration * e, c + duration * f)


def frames_of(names: Sequence[str], values: Sequence[float]) -> dict[str, FrameState]:
    """States by name, of the numbers of their parts, one state after the other; unchecked."""
    return {name: _state_of(values[PER_FRAME * k :]) for k, name in enumerate(names)}


def _state_of(values: Sequence[float]) -> FrameState:
    x, y, z, u, v, w, a, b, c, d, i, j, k = values[:PER_FRAME]
    return FrameState((x, y, z), (u, v, w), (a, b, c, d), (i, j, k))


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


_Turning = FrameState | PrincipalState


@dataclass(frozen=True)
class FrameOf:
    """Between the states of a body's frame and those of its centre of mass and principal axes."""

    centre: Vector
    axes: Quaternion

    @classmethod
    def body(cls, body: RigidBody) -> FrameOf:
        """Of a body."""
        return cls(body.centre, body.axes)

    @property
    def _is_same(self) -> bool:
        return self.axes == (1.0, 0.0, 0.0, 0.0) and not any(self.centre)

    def principal(self, frame: FrameState) -> PrincipalState:
        """Of a state of the frame."""
        if self._is_same:
            return PrincipalState(*frame)
        turn, spin = rotation_matrix(np.array(frame.attitude)), np.array(frame.angular_velocity)
        place = frame.position + turn @ self.centre
        speed = frame.velocity + turn @ np.cross(spin, self.centre)
        attitude = product(np.array(frame.attitude), np.array(self.axes))
        own = spin @ rotation_matrix(np.array(self.axes))
        return PrincipalState(*(tuple(part.tolist()) for part in (place, speed, attitude, own)))

    def frame(self, state: PrincipalState) -> FrameState:
        """Of a state of the centre of mass and the principal axes."""
        if self._is_same:
            return FrameState(*state)
        back = np.array(self.axes) * [1.0, -1.0, -1.0, -1.0]
        attitude = product(np.array(state.attitude), back)
        spin = rotation_matrix(np.array(self.axes)) @ state.angular_velocity
        turn = rotation_matrix(attitude)
        place = state.position - turn @ self.centre
        speed = state.velocity - turn @ np.cross(spin, self.centre)
        return FrameState(*(tuple(part.tolist()) for part in (place, speed, attitude, spin)))


def piece_between(time: float, duration: float, begin: PrincipalState, end: PrincipalState) -> Piece:
    """From one state to another in a time [s], see the module."""
    (a, b, c), (d, e, f) = begin.position, end.position
    way = (d - a, e - b, f - c)
    angle = difference(begin.attitude, end.attitude)
    rate = _rate_of(angle, end.angular_velocity)
    position = [*_cubic(duration, way, begin.velocity, end.velocity), begin.velocity, begin.position]
    turning = [*_cubic(duration, angle, begin.angular_velocity, rate), begin.angular_velocity, _ZERO]
    return Piece(time, np.array(position), np.array(begin.attitude), np.array(turning))


def _cubic(duration: float, way: Vector, first: Vector, last: Vector) -> tuple[Vector, Vector]:
    """Coefficients c0 and c1 of a cubic that goes a way in a time [s], by its rates at both ends."""
    over = 1.0 / duration
    (a, b, c), (i, j, k), (m, n, o) = way, first, last
    x, y, z = over * a, over * b, over * c
    square = over * over
    return (
        (square * (i + m - 2.0 * x), square * (j + n - 2.0 * y), square * (k + o - 2.0 * z)),
        (
            over * (3.0 * x - 2.0 * i - m),
            over * (3.0 * y - 2.0 * j - n),
            over * (3.0 * z - 2.0 * k - o),
        ),
    )


def mean_place(duration: float, begin: FrameState, end: FrameState) -> Vector:
    """(3,) of the frame's origin over a step, along the cubic between both states [m]."""
    (a, b, c), (d, e, f) = begin.position, end.position
    (i, j, k), (m, n, o) = begin.velocity, end.velocity
    part = duration / 12.0
    return (
        0.5 * (a + d) + part * (i - m),
        0.5 * (b + e) + part * (j - n),
        0.5 * (c + f) + part * (k - o),
    )


def turning_between(duration: float, begin: FrameState, end: FrameState) -> Vector:
    """(3,) integral of the angular velocity over a step, in the scene's axes [rad].

    It is no rotation vector where the axis moves. By Simpson's rule, with the middle of the motion of
    `piece_between`.
    """
    i, j, k = angle = difference(begin.attitude, end.attitude)
    a, b, c = first = begin.angular_velocity
    d, e, f = _rate_of(angle, end.angular_velocity)
    over, eighth = 1.5 / duration, 0.125 * duration
    half = (
        0.5 * i + eighth * (a - d),
        0.5 * j + eighth * (b - e),
        0.5 * k + eighth * (c - f),
    )
    rate = (over * i - 0.25 * (a + d), over * j - 0.25 * (b + e), over * k - 0.25 * (c + f))
    a, b, c = turned(begin.attitude, first)
    d, e, f = turned(times(begin.attitude, quaternion_of(half)), _spin_of(half, rate))
    x, y, z = turned(end.attitude, end.angular_velocity)
    part = duration / 6.0
    return (part * (a + 4.0 * d + x), part * (b + 4.0 * e + y), part * (c + 4.0 * f + z))


def times(one: Quaternion, other: Quaternion) -> Quaternion:
    """Quaternion product: turning by `other`, then by `one`."""
    a, b, c, d = one
    e, f, g, h = other
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def turned(turn: Quaternion, vector: Vector) -> Vector:
    """A vector, turned by a unit quaternion: from a body's axes to the scene's."""
    w, i, j, k = turn
    a, b, c = vector
    d, e, f = 2.0 * (j * c - k * b), 2.0 * (k * a - i * c), 2.0 * (i * b - j * a)
    return (a + w * d + j * f - k * e, b + w * e + k * d - i * f, c + w * f + i * e - j * d)


def difference(one: Quaternion, other: Quaternion) -> Vector:
    """The rotation vector from one attitude to another, in the axes of the body [rad]; no longer than pi."""
    w, x, y, z = one
    return rotation_vector(times((w, -x, -y, -z), other))


def rotation_between(begin: _Turning, end: _Turning) -> tuple[Vector, Vector]:
    """The rotation vector from one state to another [rad], and its rate at the end [rad/s].

    It is no longer than pi; its rate at the beginning is the angular velocity there.
    """
    angle = difference(begin.attitude, end.attitude)
    return angle, _rate_of(angle, end.angular_velocity)


def quaternion_of_matrix(matrix: Sequence[float]) -> Quaternion:
    """Unit quaternion of a rotation matrix, row by row (9,), by its largest component.

    Shepperd, "Quaternion from rotation matrix", J. Guidance Control 1 (1978), doi 10.2514/3.55767b.
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = matrix
    trace = xx + yy + zz
    squares = (trace, xx, yy, zz)
    largest = squares.index(max(squares))
    if largest == 0:
        parts = (1.0 + trace, zy - yz, xz - zx, yx - xy)
    elif largest == 1:
        parts = (zy - yz, 1.0 + 2.0 * xx - trace, xy + yx, xz + zx)
    elif largest == 2:
        parts = (xz - zx, xy + yx, 1.0 + 2.0 * yy - trace, yz + zy)
    else:
        parts = (yx - xy, xz + zx, yz + zy, 1.0 + 2.0 * zz - trace)
    size = math.hypot(*parts)
    w, x, y, z = parts
    return (w / size, x / size, y / size, z / size)


def quaternion_of(angle: Vector) -> Quaternion:
    """Unit quaternion of a rotation vector [rad]."""
    half = 0.5 * math.hypot(*angle)
    ratio = 0.5 * math.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
    return (math.cos(half), ratio * angle[0], ratio * angle[1], ratio * angle[2])


def rotation_vector(turn: Quaternion) -> Vector:
    """Of a unit quaternion, no longer than pi [rad]."""
    w, x, y, z = turn if turn[0] >= 0.0 else tuple(-part for part in turn)
    sine = math.hypot(x, y, z)
    # 2 asin(s) / s = 2 + s^2 / 3 to the last bit below 1e-4
    ratio = 2.0 * math.atan2(sine, w) / sine if sine > 1e-4 else 2.0 + sine * sine / 3.0
    return (ratio * x, ratio * y, ratio * z)


def _rate_of(angle: Vector, spin: Vector) -> Vector:
    """J(phi)^-1 w = w + phi x w / 2 + (1/a^2 - cot(a/2) / (2 a)) phi x (phi x w), a = |phi| [rad/s]."""
    i, j, k = angle
    a, b, c = spin
    d, e, f = j * c - k * b, k * a - i * c, i * b - j * a
    size = math.hypot(i, j, k)
    # where the difference loses digits, two terms of its series are exact
    near = size < 1e-2
    twice = 1.0 / 12.0 + size * size / 720.0 if near else 1.0 / size**2 - 0.5 / (size * math.tan(0.5 * size))
    return (
        a + 0.5 * d + twice * (j * f - k * e),
        b + 0.5 * e + twice * (k * d - i * f),
        c + 0.5 * f + twice * (i * e - j * d),
    )


def _spin_of(angle: Vector, rate: Vector) -> Vector:
    """J(phi) phi' = phi' - (1 - cos a) / a^2 phi x phi' + (a - sin a) / a^3 phi x (phi x phi') [rad/s]."""
    i, j, k = angle
    a, b, c = rate
    d, e, f = j * c - k * b, k * a - i * c, i * b - j * a
    square = i * i + j * j + k * k
    size = math.sqrt(square)
    # where the differences lose digits, two terms of their series are exact
    near = size < 1e-2
    once = 0.5 - square / 24.0 if near else (1.0 - math.cos(size)) / square
    twice = 1.0 / 6.0 - square / 120.0 if near else (size - math.sin(size)) / (square * size)
    return (
        a - once * d + twice * (j * f - k * e),
        b - once * e + twice * (k * d - i * f),
        c - once * f + twice * (i * e - j * d),
    )

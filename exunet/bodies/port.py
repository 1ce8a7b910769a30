"""Prescribed motion of bodies: by the poses of a case, piece by piece, and by a host, within its steps.

A state of a frame, or of a centre of mass in principal axes, is a tuple of place, velocity, attitude (a unit
quaternion) and angular velocity, as `exunet.bodies.port.FrameState` is; the functions take that as it is.
Their text goes into the module of `exunet.coupling.net_system`, so they use no global name but each other's.

Between two such instants the centre of mass goes along the cubic with the places and velocities of both, and
the attitude along the rotation vector phi, also a cubic, with the attitudes and angular velocities of both:
phi = 0 and phi' = w0 at the beginning; at the end phi = log(q0^-1 q1) and phi' = J(phi)^-1 w1, J as in
`exunet.bodies.port`. So place, attitude and their rates have no jumps whatever the host says.

In the piece that begins at t_i the prescribed point is at c0 s^3 + c1 s^2 + c2 s + c3, s = t - t_i; the
attitude is that of t_i turned by the rotation vector phi(s), also a cubic, about axes of the body. Its
angular velocity, in axes of the body, is J(phi) phi' with

    J(phi) u = u - (1 - cos a) / a^2 phi x u + (a - sin a) / a^3 phi x (phi x u),  a = |phi|,

Bullo and Murray, "Proportional derivative (PD) control on the Euclidean group", ECC 1995, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.bodies import rotations
from exunet.bodies.config import unit_quaternion
from exunet.bodies.rigid import RigidBody, RigidStates
from exunet.bodies.rotations import product, rotation_matrix


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """The poses of a body over time, in its principal axes.

    time     : (n,) where the pieces begin [s]; the last one has no end
    position : (n, 4, 3) coefficients c0 ... c3 of the place of the prescribed point [m/s3 ... m]
    attitude : (n, 4) unit quaternions (w, x, y, z) where the pieces begin
    turning  : (n, 4, 3) coefficients of the rotation vector phi, in the body's axes
    offset   : (3,) of the centre of mass from the prescribed point, in the body's axes [m]
    """

    time: Floats
    position: Floats
    attitude: Floats
    turning: Floats
    offset: Floats

    @classmethod
    def steady(cls, place: Floats, velocity: Floats, attitude: Floats, spin: Floats) -> PrescribedMotion:
        """The centre of mass moves at a constant velocity, the body turns at a constant one in its axes.

        place, velocity : (3,) at time 0 [m], [m/s]; attitude (4,); spin (3,) [rad/s]
        """
        position, turning = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
        position[0, 2:] = velocity, place
        turning[0, 2] = spin
        return cls(np.zeros(1), position, attitude[None], turning, np.zeros(3))

    @classmethod
    def through(cls, time: Floats, place: Floats, attitude: Floats, offset: Floats) -> PrescribedMotion:
        """Smoothly through poses: splines whose velocities and accelerations have no jumps.

        time (n,) [s], increasing, n >= 2; place (n, 3) of the prescribed point [m]; attitude (n, 4), the
        shorter way between neighbours is taken; offset : as above. At both ends the accelerations are zero.
        """
        line = scipy.interpolate.CubicSpline(time, place, bc_type="natural")
        turns = scipy.spatial.transform.Rotation.from_quat(attitude, scalar_first=True)
        spline = scipy.spatial.transform.RotationSpline(time, turns)
        # The spline's rotation vectors are cubics, which three values beside zero determine.
        thirds = np.array([1.0, 2.0, 3.0]) / 3.0
        powers = thirds[:, None] ** np.array([3.0, 2.0, 1.0])
        turning = np.zeros((len(time) - 1, 4, 3))
        for k, step in enumerate(np.diff(time)):
            angles = (turns[k].inv() * spline(time[k] + thirds * step)).as_rotvec()
            turning[k, :3] = np.linalg.solve(powers, angles) / np.array([[step**3], [step**2], [step]])
        return cls(time[:-1], np.moveaxis(line.c, 1, 0).copy(), attitude[:-1], turning, offset)

    @property
    def rests(self) -> bool:
        """True if the body does not move."""
        return not self.position[:, :3].any() and not self.turning[:, :3].any()

    def at(self, time: Floats) -> RigidStates:
        """States of the centre of mass, (k, ...) at times (k,) [s]."""
        piece = np.maximum(np.searchsorted(self.time, time, side="right") - 1, 0)
        s = (time - self.time[piece])[:, None]
        position, turning = self.position[piece], self.turning[piece]
        place, speed = _cubic(position, s)
        angle, rate = _cubic(turning, s)
        attitude = product(self.attitude[piece], rotations.quaternion_of(angle))
        spin = _jacobian(angle, rate)
        turn = rotation_matrix(attitude)
        place = place + turn @ self.offset
        speed = speed + np.einsum("kij,kj->ki", turn, np.cross(spin, self.offset))
        return RigidStates(place, speed, attitude, spin)


def _cubic(coefficients: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Values and rates (k, 3) of cubics (k, 4, 3) at s (k, 1)."""
    c0, c1, c2, c3 = np.moveaxis(coefficients, 1, 0)
    return ((c0 * s + c1) * s + c2) * s + c3, (3.0 * c0 * s + 2.0 * c1) * s + c2


def _jacobian(angle: Floats, rate: Floats) -> Floats:
    size = np.linalg.norm(angle, axis=-1, keepdims=True)
    near = size < 1e-3  # where the differences below lose digits, two terms of their series are exact
    a = np.where(near, 1.0, size)
    first = np.where(near, 0.5 - size**2 / 24.0, 2.0 * (np.sin(0.5 * a) / a) ** 2)
    second = np.where(near, 1.0 / 6.0 - size**2 / 120.0, (a - np.sin(a)) / a**3)
    across = np.cross(angle, rate)
    return np.asarray(rate - first * across + second * np.cross(angle, across))


def along(begin: Any, duration: float, rate: Any) -> Any:
    """A vector after a time, at a rate."""
    return (
        begin[0] + duration * rate[0],
        begin[1] + duration * rate[1],
        begin[2] + duration * rate[2],
    )


def cross(one: Any, other: Any) -> Any:
    """Return the cross product of two vectors."""
    a, b, c = one
    i, j, k = other
    return (b * k - c * j, c * i - a * k, a * j - b * i)


def length(vector: Any) -> float:
    """Return the length of a vector."""
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


def apart(one: Any, other: Any) -> float:
    """How far two vectors are from each other."""
    return length((other[0] - one[0], other[1] - one[1], other[2] - one[2]))


def times(one: Any, other: Any) -> Any:
    """Quaternion product: turning by `other`, then by `one`."""
    a, b, c, d = one
    e, f, g, h = other
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def turned(turn: Any, vector: Any) -> Any:
    """A vector, turned by a unit quaternion: from a body's axes to the scene's."""
    w, i, j, k = turn
    a, b, c = vector
    d, e, f = 2.0 * (j * c - k * b), 2.0 * (k * a - i * c), 2.0 * (i * b - j * a)
    return (a + w * d + j * f - k * e, b + w * e + k * d - i * f, c + w * f + i * e - j * d)


def difference(one: Any, other: Any) -> Any:
    """The rotation vector from one attitude to another, in the axes of the body [rad]; no longer than pi."""
    w, x, y, z = times((one[0], -one[1], -one[2], -one[3]), other)
    sign = 1.0 if w >= 0.0 else -1.0
    sine = length((x, y, z))
    # 2 asin(s) / s = 2 + s^2 / 3 to the last bit below 1e-4
    ratio = 2.0 * math.atan2(sine, sign * w) / sine if sine > 1e-4 else 2.0 + sine * sine / 3.0
    return (ratio * (sign * x), ratio * (sign * y), ratio * (sign * z))


def quaternion_of(angle: Any) -> Any:
    """Unit quaternion of a rotation vector [rad]."""
    half = 0.5 * length(angle)
    ratio = 0.5 * math.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
    return (math.cos(half), ratio * angle[0], ratio * angle[1], ratio * angle[2])


def quaternion_of_matrix(matrix: Any) -> Any:
    """Unit quaternion of a rotation matrix, row by row (9,), by its largest component.

    Shepperd, "Quaternion from rotation matrix", J. Guidance Control 1 (1978), doi 10.2514/3.55767b.
    """
    xx, xy, xz = matrix[0], matrix[1], matrix[2]
    yx, yy, yz = matrix[3], matrix[4], matrix[5]
    zx, zy, zz = matrix[6], matrix[7], matrix[8]
    trace = xx + yy + zz
    if trace >= xx and trace >= yy and trace >= zz:
        w, x, y, z = 1.0 + trace, zy - yz, xz - zx, yx - xy
    elif xx >= yy and xx >= zz:
        w, x, y, z = zy - yz, 1.0 + 2.0 * xx - trace, xy + yx, xz + zx
    elif yy >= zz:
        w, x, y, z = xz - zx, xy + yx, 1.0 + 2.0 * yy - trace, yz + zy
    else:
        w, x, y, z = yx - xy, xz + zx, yz + zy, 1.0 + 2.0 * zz - trace
    size = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / size, x / size, y / size, z / size)


def rate_of(angle: Any, spin: Any) -> Any:
    """J(phi)^-1 w = w + phi x w / 2 + (1/a^2 - cot(a/2) / (2 a)) phi x (phi x w), a = |phi| [rad/s]."""
    across = cross(angle, spin)
    again = cross(angle, across)
    size = length(angle)
    # where the difference loses digits, two terms of its series are exact
    if size < 1e-2:
        twice = 1.0 / 12.0 + size * size / 720.0
    else:
        twice = 1.0 / (size * size) - 0.5 / (size * math.tan(0.5 * size))
    return along(along(spin, 0.5, across), twice, again)


def spin_of(angle: Any, rate: Any) -> Any:
    """J(phi) phi' = phi' - (1 - cos a) / a^2 phi x phi' + (a - sin a) / a^3 phi x (phi x phi') [rad/s]."""
    across = cross(angle, rate)
    again = cross(angle, across)
    square = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    size = math.sqrt(square)
    # where the differences lose digits, two terms of their series are exact
    if size < 1e-2:
        once, twice = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        once, twice = (1.0 - math.cos(size)) / square, (size - math.sin(size)) / (square * size)
    return along(along(rate, -once, across), twice, again)


def after(state: Any, duration: float, acceleration: Any, angular_acceleration: Any) -> Any:
    """A state a time [s] later, at constant accelerations [m/s2], and [rad/s2] in the frame's axes."""
    half = 0.5 * duration
    way = along(state[1], half, acceleration)
    i, j, k = along(state[3], half, angular_acceleration)
    turn = quaternion_of((duration * i, duration * j, duration * k))
    return (
        along(state[0], duration, way),
        along(state[1], duration, acceleration),
        times(state[2], turn),
        along(state[3], duration, angular_acceleration),
    )


def is_frame_itself(centre: Any, axes: Any) -> bool:
    """True if the principal axes about the centre of mass are those of the frame."""
    along_axes = axes[0] == 1.0 and axes[1] == 0.0 and axes[2] == 0.0 and axes[3] == 0.0
    return along_axes and centre[0] == 0.0 and centre[1] == 0.0 and centre[2] == 0.0


def principal_of(frame: Any, centre: Any, axes: Any) -> Any:
    """The state of the centre of mass in principal axes, of that of the frame.

    centre, axes : of the body in its frame [m], unit quaternion
    """
    if is_frame_itself(centre, axes):
        return (frame[0], frame[1], frame[2], frame[3])
    swing = turned(frame[2], cross(frame[3], centre))
    back = (axes[0], -axes[1], -axes[2], -axes[3])
    return (
        along(frame[0], 1.0, turned(frame[2], centre)),
        along(frame[1], 1.0, swing),
        times(frame[2], axes),
        turned(back, frame[3]),
    )


def frame_of(state: Any, centre: Any, axes: Any) -> Any:
    """The state of the frame, of that which `principal_of` gave."""
    if is_frame_itself(centre, axes):
        return (state[0], state[1], state[2], state[3])
    attitude = times(state[2], (axes[0], -axes[1], -axes[2], -axes[3]))
    spin = turned(axes, state[3])
    swing = turned(attitude, cross(spin, centre))
    place = along(state[0], -1.0, turned(attitude, centre))
    return (place, along(state[1], -1.0, swing), attitude, spin)


def cubic_of(duration: float, way: Any, first: Any, last: Any) -> Any:
    """Coefficients c0 and c1 of a cubic that goes a way in a time [s], by its rates at both ends."""
    over = 1.0 / duration
    square = over * over
    (a, b, c), (i, j, k), (m, n, o) = way, first, last
    x, y, z = over * a, over * b, over * c
    return (
        (square * (i + m - 2.0 * x), square * (j + n - 2.0 * y), square * (k + o - 2.0 * z)),
        (
            over * (3.0 * x - 2.0 * i - m),
            over * (3.0 * y - 2.0 * j - n),
            over * (3.0 * z - 2.0 * k - o),
        ),
    )


def way_between(duration: float, begin: Any, end: Any) -> Any:
    """Coefficients c0 and c1 of the place, then of the rotation vector, from one state to another."""
    (a, b, c), (d, e, f) = begin[0], end[0]
    angle = difference(begin[2], end[2])
    return (
        cubic_of(duration, (d - a, e - b, f - c), begin[1], end[1]),
        cubic_of(duration, angle, begin[3], rate_of(angle, end[3])),
    )


def mean_place(duration: float, begin: Any, end: Any) -> Any:
    """(3,) of the frame's origin over a step, along the cubic between both states [m]."""
    (a, b, c), (d, e, f) = begin[0], end[0]
    (i, j, k), (m, n, o) = begin[1], end[1]
    part = duration / 12.0
    return (
        0.5 * (a + d) + part * (i - m),
        0.5 * (b + e) + part * (j - n),
        0.5 * (c + f) + part * (k - o),
    )


def turning_between(duration: float, begin: Any, end: Any) -> Any:
    """(3,) integral of the angular velocity over a step, in the scene's axes [rad].

    It is no rotation vector where the axis moves. By Simpson's rule, with the middle of the motion of
    `way_between`.
    """
    i, j, k = difference(begin[2], end[2])
    a, b, c = begin[3]
    d, e, f = rate_of((i, j, k), end[3])
    over, eighth = 1.5 / duration, 0.125 * duration
    half = (
        0.5 * i + eighth * (a - d),
        0.5 * j + eighth * (b - e),
        0.5 * k + eighth * (c - f),
    )
    rate = (over * i - 0.25 * (a + d), over * j - 0.25 * (b + e), over * k - 0.25 * (c + f))
    first = turned(begin[2], begin[3])
    middle = turned(times(begin[2], quaternion_of(half)), spin_of(half, rate))
    last = turned(end[2], end[3])
    part = duration / 6.0
    return (
        part * (first[0] + 4.0 * middle[0] + last[0]),
        part * (first[1] + 4.0 * middle[1] + last[1]),
        part * (first[2] + 4.0 * middle[2] + last[2]),
    )


def off_way(step: float, way: Any, first: Any, last: Any, before: float, part: float) -> Any:
    """How far a way is from that at the mean of the rates at both ends of a step [s], and may be.

    before, part : see `exunet.coupling.net_system`: acceleration of the step before, and how much it explains
    """
    half = 0.5 * step
    (x, y, z), (a, b, c), (d, e, f) = way, first, last
    off = length((x - half * (a + d), y - half * (b + e), z - half * (c + f)))
    change = apart(first, last) + step * before
    fastest = max(length(first), length(last))
    return off, step * (part * change + 0.1 * fastest)


def jump_of(
    step: float, begin: Any, end: Any, of_place: float, of_turning: float, part: float, size: float
) -> Any:
    """Whether a state is elsewhere after a step [s] than it moves: 0 its place is, 1 its attitude, -1 not.

    of_place, of_turning : accelerations of the step before [m/s2], [rad/s2]
    part, size           : see `exunet.coupling.net_system`
    Returns that, how far it is off, and how far it may be off [m] or [rad].
    """
    round_off = 1e-9  # of a turn [rad], and of the sizes in a way
    (a, b, c), (d, e, f) = begin[0], end[0]
    near = round_off * max(size, abs(d), abs(e), abs(f))
    off, allowed = off_way(step, (d - a, e - b, f - c), begin[1], end[1], of_place, part)
    if not off <= allowed + near:
        return 0, off, allowed
    angle = difference(begin[2], end[2])
    off, allowed = off_way(step, angle, begin[3], rate_of(angle, end[3]), of_turning, part)
    return (-1 if off <= allowed + round_off else 1), off, allowed


def state_at(rows: Any, p: int) -> Any:
    """The state in a row (13 numbers)."""
    row = rows[p]
    return (
        (row[0], row[1], row[2]),
        (row[3], row[4], row[5]),
        (row[6], row[7], row[8], row[9]),
        (row[10], row[11], row[12]),
    )


def put_state(rows: Any, p: int, state: Any) -> None:
    """Put a state into a row."""
    row = rows[p]
    row[0], row[1], row[2] = state[0]
    row[3], row[4], row[5] = state[1]
    row[6], row[7], row[8], row[9] = state[2]
    row[10], row[11], row[12] = state[3]


INSIDE = (
    along,
    cross,
    length,
    apart,
    times,
    turned,
    difference,
    quaternion_of,
    quaternion_of_matrix,
    rate_of,
    spin_of,
    after,
    is_frame_itself,
    principal_of,
    frame_of,
    cubic_of,
    way_between,
    mean_place,
    turning_between,
    off_way,
    jump_of,
    state_at,
    put_state,
)


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
        return FrameState(*after(self, duration, acceleration, angular_acceleration))


def frames_of(names: Sequence[str], rows: Floats) -> dict[str, FrameState]:
    """States by name, of the numbers of their parts, (n, 13) or in one row that may be longer; unchecked."""
    values = rows.ravel()[: PER_FRAME * len(names)].reshape(-1, PER_FRAME).tolist()
    return {name: FrameState(*state_at(values, k)) for k, name in enumerate(names)}


def rows_of(frames: Iterable[FrameState | PrincipalState]) -> Floats:
    """(n, 13) numbers of n states, as the functions of `exunet.coupling.net_system` take them."""
    return np.array([[*place, *speed, *turn, *spin] for place, speed, turn, spin in frames], dtype=float)


class Piece(NamedTuple):
    """How a body moves from an instant on, as one piece of an `exunet.bodies.port.PrescribedMotion`.

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
        """Build a piece from the array that `numbers` returned."""
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
        """Build the conversion for a body."""
        return cls(body.centre, body.axes)

    def principal(self, frame: FrameState) -> PrincipalState:
        """Convert a state of the frame to the centre of mass and the principal axes."""
        return PrincipalState(*principal_of(frame, self.centre, self.axes))

    def frame(self, state: PrincipalState) -> FrameState:
        """Convert a state of the centre of mass and the principal axes to the frame."""
        return FrameState(*frame_of(state, self.centre, self.axes))

    def frame_in(self, bodies: RigidStates, number: int) -> FrameState:
        """Return the state of the frame of one of some bodies."""
        return self.frame(PrincipalState(*(tuple(part[number].tolist()) for part in bodies.parts())))

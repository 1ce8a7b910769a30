"""Motion of a net's ports: the loops over their states, and consistency with their host's bodies.

With velocities v0 and v1 at the ends of a step H, a velocity that goes from one to the other monotonically
leads away from H (v0 + v1) / 2 by at most H |v1 - v0| / 2; so do integrators of first order, which step by v0
or by v1. A velocity that reverses in between is bounded by the acceleration a of the step before, H a. What
is left, such as half a swing between two equal velocities, is within a tenth of the path at the larger speed
as long as a body swings by less than 1 rad in a step. A larger distance is a jump. Attitudes alike, by the
rotation vector and its rates at both ends.

The text of the loops and that of `exunet.bodies.port` form a generated module (see
`exunet.kernels.source.loops_source`), so they use no global name but each other's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import whole_number
from exunet.base.errors import InputError
from exunet.bodies.port import (
    INSIDE,
    FrameState,
    after,
    apart,
    difference,
    frame_of,
    jump_of,
    length,
    mean_place,
    principal_of,
    put_state,
    quaternion_of_matrix,
    state_at,
    turning_between,
    way_between,
)
from exunet.kernels.compile import compiled_module, interpreted_module, numba_installed
from exunet.kernels.source import hold, loops_source

if TYPE_CHECKING:
    from exunet.kernels.pointers import borrowed


Floats = NDArray[np.float64]


class PortArrays(NamedTuple):
    """Arrays of a net that the loops over its ports read, and their work space.

    position, velocity, attitude, angular_velocity : of all bodies, (n, 3) or (n, 4) each
    first_order   : (m,) of the net
    number, entry : (n,) bodies of the ports; first entry of each port's impulse and work in `first_order`
    centre, axes  : (n, 3), (n, 4) centres of mass and principal axes in the frames
    frames, given : (n, 13) states of the frames at the begin of a step; (n, 7) impulse and work until then
    begin, end    : (n, 13) states of the centres of mass at both ends of a step
    """

    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats
    first_order: Floats
    number: NDArray[np.int64]
    entry: NDArray[np.int64]
    centre: Floats
    axes: Floats
    frames: Floats
    given: Floats
    begin: Floats
    end: Floats


def read_markers(outputs: Any, frames: Any) -> int:
    """Convert outputs of markers to states of frames (n, 13).

    outputs : (n, 18) position, velocity, rotation matrix by rows, angular velocity in the frame's axes
    Returns the number of the first with NaN or infinity, or -1.
    """
    wrong = -1
    for p in range(len(outputs)):
        row = outputs[p]
        total = 0.0
        for k in range(18):
            total += row[k]
        if wrong < 0 and not math.isfinite(total):
            wrong = p
        place, speed, spin = (row[0], row[1], row[2]), (row[3], row[4], row[5]), (row[15], row[16], row[17])
        put_state(frames, p, (place, speed, quaternion_of_matrix(row[6:15]), spin))
    return wrong


def extrapolate(now: Any, before: Any, since: float, duration: float, ahead: Any) -> None:
    """Extrapolate states (n, 13) by a time [s], at the mean acceleration since `before`.

    since : from `before` to `now` [s]; 0: at constant velocity
    """
    for p in range(len(now)):
        state = state_at(now, p)
        acceleration = angular = (0.0, 0.0, 0.0)
        if since > 0.0:
            (a, b, c), (d, e, f) = state_at(before, p)[1], state[1]
            acceleration = ((d - a) / since, (e - b) / since, (f - c) / since)
            (a, b, c), (d, e, f) = state_at(before, p)[3], state[3]
            angular = ((d - a) / since, (e - b) / since, (f - c) / since)
        put_state(ahead, p, after(state, duration, acceleration, angular))


def find_jump(step: float, begin: Any, end: Any, before: Any, since: float, part: float, size: float) -> Any:
    """Return the first row that jumps in a step [s] with the values of `jump_of`, or -1.

    begin, end, before : (n, 13) states; since : from `before` to `begin` [s]; 0: there is no state before
    """
    for p in range(len(begin)):
        first, of_place, of_turning = state_at(begin, p), 0.0, 0.0
        if since > 0.0:
            earlier = state_at(before, p)
            of_place = apart(earlier[1], first[1]) / since
            of_turning = apart(earlier[3], first[3]) / since
        kind, off, allowed = jump_of(step, first, state_at(end, p), of_place, of_turning, part, size)
        if kind >= 0:
            return p, kind, off, allowed
    return -1, -1, 0.0, 0.0


def max_rotation(step: float, begin: Any, end: Any) -> Any:
    """Return the row that rotates most in a step [s] and its angle [rad], by the larger angular velocity."""
    number, most = 0, 0.0
    for p in range(len(begin)):
        turn = step * max(length(state_at(begin, p)[3]), length(state_at(end, p)[3]))
        if turn > most:
            number, most = p, turn
    return number, most


def plan_motion(step: float, target: Any, position: Any, attitude: Any, turning: Any, held: Any) -> Any:
    """Compute the motion of ports from their present states to target states after a step [s].

    target : (n, 13) states of the frames at the end
    position, attitude, turning : (n, 4, 3), (n, 4), (n, 4, 3) output: pieces of an
                                  `exunet.bodies.guide.Guide`
    held   : from `hold`, of `PortArrays`
    Returns `max_rotation`.
    """
    room = borrowed(held.value)
    begin, end = room.begin, room.end
    for p in range(len(target)):
        number, entry = room.number[p], room.entry[p]
        for k in range(3):
            begin[p, k] = room.position[number, k]
            begin[p, 3 + k] = room.velocity[number, k]
            begin[p, 10 + k] = room.angular_velocity[number, k]
        for k in range(4):
            begin[p, 6 + k] = room.attitude[number, k]
        for k in range(7):
            room.given[p, k] = room.first_order[entry + k]
        centre = (room.centre[p, 0], room.centre[p, 1], room.centre[p, 2])
        axes = (room.axes[p, 0], room.axes[p, 1], room.axes[p, 2], room.axes[p, 3])
        first = state_at(begin, p)
        last = principal_of(state_at(target, p), centre, axes)
        put_state(room.frames, p, frame_of(first, centre, axes))
        put_state(end, p, last)
        ways = way_between(step, first, last)
        for k in range(2):
            position[p, k, 0], position[p, k, 1], position[p, k, 2] = ways[0][k]
            turning[p, k, 0], turning[p, k, 1], turning[p, k, 2] = ways[1][k]
        position[p, 2, 0], position[p, 2, 1], position[p, 2, 2] = first[1]
        position[p, 3, 0], position[p, 3, 1], position[p, 3, 2] = first[0]
        turning[p, 2, 0], turning[p, 2, 1], turning[p, 2, 2] = first[3]
        turning[p, 3, 0], turning[p, 3, 1], turning[p, 3, 2] = (0.0, 0.0, 0.0)
        attitude[p, 0], attitude[p, 1], attitude[p, 2], attitude[p, 3] = first[2]
    return max_rotation(step, begin, end)


def collect_loads(step: float, target: Any, impulses: Any, wrenches: Any, held: Any) -> None:
    """Compute what the net has done to the bodies of its ports in a step [s] after `plan_motion`.

    impulses : (n, 7) output: impulse, angular impulse about the scene's origin, work
    wrenches : (n, 6) output: mean force, and mean torque about the frame's origin
    """
    room = borrowed(held.value)
    over = 1.0 / step
    for p in range(len(target)):
        row, wrench = impulses[p], wrenches[p]
        for k in range(7):
            row[k] = -(room.first_order[room.entry[p] + k] - room.given[p, k])
        x, y, z = mean_place(step, state_at(room.frames, p), state_at(target, p))
        wrench[0], wrench[1], wrench[2] = over * row[0], over * row[1], over * row[2]
        wrench[3] = over * (row[3] - y * row[2] + z * row[1])
        wrench[4] = over * (row[4] - z * row[0] + x * row[2])
        wrench[5] = over * (row[5] - x * row[1] + y * row[0])


def add_to_balances(
    steps: Any, recoils: Any, applied: Any, impulses: Any, begin: Any, end: Any, balances: Any
) -> None:
    """Add steps (k,) [s] to the balances of ports.

    recoils    : (k,) steps that contain the jump of an ejection
    applied    : (k, n, 6) forces and torques on the host's bodies
    impulses   : (k, n, 7) of `collect_loads`; begin, end : (k, n, 13) states of the frames at both ends
    balances   : (n, 13) as of `exunet.coupling.ledger.PortBalance`, without its last field
    """
    for s in range(len(steps)):
        for p in range(len(balances)):
            row, load, six = balances[p], impulses[s, p], applied[s, p]
            first, last = state_at(begin[s], p), state_at(end[s], p)
            turn = turning_between(steps[s], first, last)
            (a, b, c), (d, e, f) = first[0], last[0]
            work = six[0] * (d - a) + six[1] * (e - b) + six[2] * (f - c)
            work = work + six[3] * turn[0] + six[4] * turn[1] + six[5] * turn[2]
            error = work - load[6]
            for k in range(7):
                row[k] += load[k]
            row[9] += abs(load[6])
            row[11], row[12] = min(row[11], row[6]), max(row[12], row[6])
            if recoils[s]:
                row[10] += error  # the launcher supplies the energy
                continue
            row[7] += error
            row[8] = max(row[8], abs(error))


LOOPS = (
    read_markers,
    extrapolate,
    find_jump,
    max_rotation,
    plan_motion,
    collect_loads,
    add_to_balances,
)


@cache
def port_loops() -> ModuleType:
    """Return the module of the loops: compiled if Numba is installed, else plain Python."""
    source = loops_source((hold, *LOOPS), INSIDE)
    return compiled_module(source) if numba_installed() else interpreted_module(source)


# Fractions of the changes of velocity in this step and the one before that, times the step, explain a
# deviation of the path: for a host's own states, and for states given to a net, which may be predicted at
# constant velocity. The next step corrects such a prediction, by the change of velocity for a host of first
# order.
OWN, PREDICTED = 0.5, 1.5
# Largest rotation in a step [rad], at the larger angular velocity of both ends. Two attitudes do not
# determine a rotation beyond pi, and a force held over the step is far from one that rotates with the body.
LARGEST_TURN = 1.0


class Earlier(NamedTuple):
    """Step before, which determines accelerations.

    states : (n, 13) at its begin, of which the velocities are used
    since  : its length [s]; 0: no step before
    """

    states: Floats
    since: float


def validate_no_jump(
    who: str,
    names: Sequence[str],
    times: tuple[float, float],
    states: tuple[Floats, Floats],
    earlier: Earlier,
    part: float,
    size: float,
) -> None:
    """Raise InputError if a body's change of pose in a step does not follow from its velocities.

    who, names    : begin of the message; names of the bodies (n)
    times, states : begin and end of the step [s], (n, 13)
    part          : `OWN` or `PREDICTED`
    size          : scale of the round-off of positions [m]
    """
    number, kind, off, allowed = port_loops().find_jump(times[1] - times[0], *states, *earlier, part, size)
    if number < 0:
        return
    what, unit = ("attitude", "rad") if kind else ("position", "m")
    raise InputError(
        f"{who} {names[number]} jumps: in the step from {times[0]:.6g} s to {times[1]:.6g} s its {what} is "
        f"{off:.3g} {unit} from where its velocities lead, and accelerations explain {allowed:.3g} {unit}. "
        "Give the state at the end of the step, use shorter steps if it swings within one, or restore a "
        "snapshot"
    )


def validate_rotation(
    who: str, names: Sequence[str], times: tuple[float, float], largest: tuple[int, float]
) -> None:
    """Raise InputError if a body rotates too far in a step; largest : as of `max_rotation`."""
    number, turn = largest
    if turn <= LARGEST_TURN * (1.0 + 1e-6):
        return
    start, stop = times
    raise InputError(
        f"{who} {names[number]} turns too far: in the step from {start:.6g} s to {stop:.6g} s by {turn:.3g} "
        f"rad, at {turn / (stop - start):.3g} rad/s. The limit is {LARGEST_TURN:g} rad a step: use shorter "
        "steps"
    )


def validate_ports(who: str, given: object, names: Sequence[str], what: str) -> None:
    """Raise InputError unless a mapping has an entry, what, for each of these ports and no other."""
    if not isinstance(given, Mapping):
        raise InputError(f"{who}: requires {what} by the name of each port, got {given!r}")
    if unknown := [name for name in given if name not in names]:
        raise InputError(f"{who}: there is no port {unknown[0]!r}: {', '.join(names) or 'the case has none'}")
    if missing := [name for name in names if name not in given]:
        raise InputError(f"{who}: {what} is missing for port {', '.join(missing)}")


def validated_number(who: str, port: str, what: str, given: object, count: int) -> int:
    """Return the number of an item of a system of `count` items; raise InputError for another object."""
    number = whole_number(given)
    if number is None or not 0 <= number < count:
        raise InputError(f"{who}: port {port}: there is no {what} {given!r}: the system has {count}")
    return number


# Tolerance at the start, relative to the net's size, to the larger of 1 m/s or 1 rad/s and the speed, or in
# radians: round-off of numbers that were given with six digits.
_SAME = 1e-6
_MIN_SIZE = 1e-3  # [m], of a net of one node


def distance(one: FrameState, other: FrameState, size: float) -> float:
    """Return the larger distance: of two positions relative to a size [m], of two attitudes [rad]."""
    angle = math.hypot(*difference(one.attitude, other.attitude))
    return max(math.dist(one.position, other.position) / max(size, _MIN_SIZE), angle)


def validate_same_start(who: str, name: str, port: FrameState, host: FrameState, size: float) -> None:
    """Raise InputError if a port and its host's body differ at the start."""
    speed, spin = math.hypot(*port.velocity), math.hypot(*port.angular_velocity)
    turn = math.hypot(*difference(port.attitude, host.attitude))
    for what, off, unit, scale in (
        ("position", math.dist(port.position, host.position), "m", max(size, _MIN_SIZE)),
        ("attitude", turn, "rad", 1.0),
        ("velocity", math.dist(port.velocity, host.velocity), "m/s", max(1.0, speed)),
        (
            "angular_velocity",
            math.dist(port.angular_velocity, host.angular_velocity),
            "rad/s",
            max(1.0, spin),
        ),
    ):
        if off > _SAME * scale:
            values = " and ".join(_shown(getattr(state, what)) for state in (port, host))
            raise InputError(
                f"{who}: port {name}: its {what} at the start in the case and that in the host differ by "
                f"{off:.3g} {unit}: {values}. Give bodies.{name} the start that it has in the host"
            )


def _shown(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"

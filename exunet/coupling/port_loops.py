"""The loops over the ports of a net, whose states are rows of arrays, with no Python between when compiled.

Their text and that of `exunet.bodies.port` go into a module of its own (see
`exunet.kernels.source.loops_source`), so they use no global name but each other's.
"""

from __future__ import annotations

import math
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.port import (
    INSIDE,
    after,
    apart,
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


class PortRoom(NamedTuple):
    """What the loops over the ports of a net read of it, and room for what they find, as long as it is one.

    position, velocity, attitude, angular_velocity : of all bodies, (n, 3) or (n, 4) each
    first_order   : (m,) of the net
    number, entry : (n,) of the ports' bodies; where in `first_order` begins what each has given
    centre, axes  : (n, 3), (n, 4) centres of mass and principal axes in their frames
    frames, given : (n, 13) states of the frames where a step begins; (n, 7) what each has given until then
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


def see(seen: Any, frames: Any) -> int:
    """Put the states of frames into rows (n, 13); returns the number of the first that has NaN or infinity,
    or -1.

    seen : (n, 18) what their markers tell: place, velocity, rotation matrix row by row, angular velocity in
           the frame's axes
    """
    wrong = -1
    for p in range(len(seen)):
        row = seen[p]
        total = 0.0
        for k in range(18):
            total += row[k]
        if wrong < 0 and not math.isfinite(total):
            wrong = p
        place, speed, spin = (row[0], row[1], row[2]), (row[3], row[4], row[5]), (row[15], row[16], row[17])
        put_state(frames, p, (place, speed, quaternion_of_matrix(row[6:15]), spin))
    return wrong


def go_on(now: Any, before: Any, since: float, duration: float, told: Any) -> None:
    """Put states after a time [s] into rows, at the mean acceleration since others, or at none.

    now, before, told : (n, 13); since : from `before` to `now` [s]; 0: there is no state before
    """
    for p in range(len(now)):
        state = state_at(now, p)
        acceleration = angular = (0.0, 0.0, 0.0)
        if since > 0.0:
            (a, b, c), (d, e, f) = state_at(before, p)[1], state[1]
            acceleration = ((d - a) / since, (e - b) / since, (f - c) / since)
            (a, b, c), (d, e, f) = state_at(before, p)[3], state[3]
            angular = ((d - a) / since, (e - b) / since, (f - c) / since)
        put_state(told, p, after(state, duration, acceleration, angular))


def find_jump(step: float, begin: Any, end: Any, before: Any, since: float, part: float, size: float) -> Any:
    """The number of the first of rows that jumps in a step [s], with what `jump_of` tells of it; or -1.

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


def see_ended(
    seen: Any, frames: Any, step: float, begin: Any, before: Any, since: float, part: float, size: float
) -> Any:
    """`see`, and `find_jump` in a step [s] that has led from `begin` to there; what both return."""
    return see(seen, frames), find_jump(step, begin, frames, before, since, part, size)


def most_turned(step: float, begin: Any, end: Any) -> Any:
    """The number of the row (n, 13) that turns most in a step [s], and by how much [rad], at the larger
    angular velocity of both ends."""
    number, most = 0, 0.0
    for p in range(len(begin)):
        turn = step * max(length(state_at(begin, p)[3]), length(state_at(end, p)[3]))
        if turn > most:
            number, most = p, turn
    return number, most


def stand(held: Any, row: Any) -> None:
    """Put all numbers of bodies and first-order states into a row (m + 13 n,), the bodies' attitudes last.

    held : from `hold`, of a `PortRoom`
    """
    room = borrowed(held.value)
    number, k = len(room.position), len(room.first_order)
    for i in range(k):
        row[i] = room.first_order[i]
    for b in range(number):
        for i in range(3):
            row[k + i], row[k + 3 + i] = room.position[b, i], room.velocity[b, i]
            row[k + 6 + i] = room.angular_velocity[b, i]
        k += 9
    for b in range(number):
        for i in range(4):
            row[k + i] = room.attitude[b, i]
        k += 4


def set_out(step: float, told: Any, position: Any, attitude: Any, turning: Any, held: Any) -> Any:
    """How ports go from where they are to where they are told to be after a step [s]; returns `most_turned`.

    told : (n, 13) states of the frames at the end
    position, attitude, turning : (n, 4, 3), (n, 4), (n, 4, 3) puts there pieces of an
                                  `exunet.bodies.guide.Guide`
    held : from `hold`, of a `PortRoom`
    """
    room = borrowed(held.value)
    begin, end = room.begin, room.end
    for p in range(len(told)):
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
        last = principal_of(state_at(told, p), centre, axes)
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
    return most_turned(step, begin, end)


def go_out(
    now: Any,
    before: Any,
    since: float,
    step: float,
    told: Any,
    position: Any,
    attitude: Any,
    turning: Any,
    held: Any,
) -> Any:
    """`go_on`, and `set_out` to where that leads."""
    go_on(now, before, since, step, told)
    return set_out(step, told, position, attitude, turning, held)


def share(step: float, told: Any, taken: Any, wrenches: Any, stands: Any, held: Any) -> None:
    """What the net has done to the bodies of its ports in a step [s]: what it was given is taken from them.

    told, held : as in `set_out`, which was called at the beginning
    taken      : (n, 7) puts there impulse, angular impulse about the scene's origin and work
    wrenches   : (n, 6) and the mean force, and the mean torque about the frame's origin
    stands     : (m + 13 n,) what `stand` puts there
    """
    stand(held, stands)
    room = borrowed(held.value)
    over = 1.0 / step
    for p in range(len(told)):
        row, wrench = taken[p], wrenches[p]
        for k in range(7):
            row[k] = -(room.first_order[room.entry[p] + k] - room.given[p, k])
        x, y, z = mean_place(step, state_at(room.frames, p), state_at(told, p))
        wrench[0], wrench[1], wrench[2] = over * row[0], over * row[1], over * row[2]
        wrench[3] = over * (row[3] - y * row[2] + z * row[1])
        wrench[4] = over * (row[4] - z * row[0] + x * row[2])
        wrench[5] = over * (row[5] - x * row[1] + y * row[0])


def enter(steps: Any, recoils: Any, applied: Any, taken: Any, begin: Any, end: Any, books: Any) -> None:
    """Take steps (k,) [s] into the books of ports.

    recoils    : (k,) whether the jump of a throw is in them
    applied    : (k, n, 6) forces and torques that the host's method has applied
    taken      : (k, n, 7) as of `share`; begin, end : (k, n, 13) where the frames were at both ends
    books      : (n, 13) as of `exunet.coupling.ledger.PortBook.numbers`
    """
    for s in range(len(steps)):
        for p in range(len(books)):
            book, load, six = books[p], taken[s, p], applied[s, p]
            first, last = state_at(begin[s], p), state_at(end[s], p)
            turn = turning_between(steps[s], first, last)
            (a, b, c), (d, e, f) = first[0], last[0]
            work = six[0] * (d - a) + six[1] * (e - b) + six[2] * (f - c)
            work = work + six[3] * turn[0] + six[4] * turn[1] + six[5] * turn[2]
            error = work - load[6]
            for k in range(7):
                book[k] += load[k]
            book[9] += abs(load[6])
            book[11], book[12] = min(book[11], book[6]), max(book[12], book[6])
            if recoils[s]:
                book[10] += error  # the launcher brings the energy
                continue
            book[7] += error
            book[8] = max(book[8], abs(error))


CALLED = (
    see,
    go_on,
    find_jump,
    see_ended,
    most_turned,
    stand,
    set_out,
    go_out,
    share,
    enter,
)


@cache
def port_loops() -> ModuleType:
    """Their module: compiled as far as Numba is installed, else plain Python."""
    source = loops_source((hold, *CALLED), INSIDE)
    return compiled_module(source) if numba_installed() else interpreted_module(source)

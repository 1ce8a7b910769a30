"""The loops over the ports of a net, whose states are rows of arrays, with no Python between when compiled.

Their text and that of `exunet.bodies.port_motion` go into a module of its own (see
`exunet.codegen.generate.loops_source`), so they use no global name but each other's.
"""

from __future__ import annotations

import math
from typing import Any

from exunet.bodies.port_motion import (
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


def most_turned(step: float, begin: Any, end: Any) -> Any:
    """The number of the row (n, 13) that turns most in a step [s], and by how much [rad], at the larger
    angular velocity of both ends."""
    number, most = 0, 0.0
    for p in range(len(begin)):
        turn = step * max(length(state_at(begin, p)[3]), length(state_at(end, p)[3]))
        if turn > most:
            number, most = p, turn
    return number, most


def stand(bodies: Any, first_order: Any, row: Any) -> None:
    """Put all numbers of bodies and first-order states into a row (m + 13 n,), the bodies' attitudes last.

    bodies      : places, velocities, attitudes, angular velocities of all bodies, (n, 3) or (n, 4) each
    first_order : (m,) of a net
    """
    number, k = len(bodies[0]), len(first_order)
    for i in range(k):
        row[i] = first_order[i]
    for b in range(number):
        for i in range(3):
            row[k + i], row[k + 3 + i], row[k + 6 + i] = bodies[0][b, i], bodies[1][b, i], bodies[3][b, i]
        k += 9
    for b in range(number):
        for i in range(4):
            row[k + i] = bodies[2][b, i]
        k += 4


def set_out(
    step: float,
    bodies: Any,
    first_order: Any,
    of: Any,
    told: Any,
    frames: Any,
    given: Any,
    begin: Any,
    end: Any,
    position: Any,
    attitude: Any,
    turning: Any,
) -> Any:
    """How ports go from where they are to where they are told to be after a step [s]; returns `most_turned`.

    bodies, first_order : as in `stand`
    of   : numbers of the ports' bodies (n,), where in `first_order` begins what each has given (n,), centres
           of mass (n, 3) and principal axes (n, 4) in their frames
    told : (n, 13) states of the frames at the end
    What it puts into arrays:
    frames, given : (n, 13) states of the frames now; (n, 7) what each has given so far
    begin, end    : (n, 13) states of the centres of mass
    position, attitude, turning : (n, 4, 3), (n, 4), (n, 4, 3) pieces of an `exunet.bodies.guide.Guide`
    """
    for p in range(len(told)):
        number, entry = of[0][p], of[1][p]
        for k in range(3):
            begin[p, k] = bodies[0][number, k]
            begin[p, 3 + k] = bodies[1][number, k]
            begin[p, 10 + k] = bodies[3][number, k]
        for k in range(4):
            begin[p, 6 + k] = bodies[2][number, k]
        for k in range(7):
            given[p, k] = first_order[entry + k]
        centre = (of[2][p, 0], of[2][p, 1], of[2][p, 2])
        axes = (of[3][p, 0], of[3][p, 1], of[3][p, 2], of[3][p, 3])
        first = state_at(begin, p)
        last = principal_of(state_at(told, p), centre, axes)
        put_state(frames, p, frame_of(first, centre, axes))
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


def share(
    step: float,
    first_order: Any,
    of: Any,
    frames: Any,
    given: Any,
    told: Any,
    taken: Any,
    wrenches: Any,
) -> None:
    """What the net has done to the bodies of its ports in a step [s]: what it was given is taken from them.

    first_order, of, frames, given, told : as in `set_out`
    taken    : (n, 7) puts there impulse, angular impulse about the scene's origin and work
    wrenches : (n, 6) and the mean force, and the mean torque about the frame's origin
    """
    over = 1.0 / step
    for p in range(len(told)):
        row, wrench = taken[p], wrenches[p]
        for k in range(7):
            row[k] = -(first_order[of[1][p] + k] - given[p, k])
        x, y, z = mean_place(step, state_at(frames, p), state_at(told, p))
        wrench[0], wrench[1], wrench[2] = over * row[0], over * row[1], over * row[2]
        wrench[3] = over * (row[3] - y * row[2] + z * row[1])
        wrench[4] = over * (row[4] - z * row[0] + x * row[2])
        wrench[5] = over * (row[5] - x * row[1] + y * row[0])


def enter(steps: Any, recoils: Any, applied: Any, taken: Any, begin: Any, end: Any, books: Any) -> None:
    """Take steps (k,) [s] into the books of ports.

    recoils    : (k,) whether the jump of a throw is in them
    applied    : (k, n, 6) forces and torques that the host's method has applied
    taken      : (k, n, 7) as of `share`; begin, end : (k, n, 13) where the frames were at both ends
    books      : (n, 13) as of `exunet.coupling.books.PortBook.numbers`
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
    most_turned,
    stand,
    set_out,
    share,
    enter,
)

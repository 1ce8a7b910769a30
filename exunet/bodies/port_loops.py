"""The motion of ports as scalar functions, in the subset of Python that Numba compiles.

A state of a frame, or of a centre of mass in principal axes, is a tuple of place, velocity, attitude (a unit
quaternion) and angular velocity, as `exunet.bodies.port.FrameState` is; the functions take that as it is. The
functions of `CALLED` go through the ports of a net, whose states are rows of arrays, with no Python between;
their text goes into a module of its own (see `exunet.codegen.generate.loops_source`), so they use no global
name but each other's.
"""

from __future__ import annotations

import math
from typing import Any


def along(begin: Any, duration: float, rate: Any) -> Any:
    """A vector after a time, at a rate."""
    return (
        begin[0] + duration * rate[0],
        begin[1] + duration * rate[1],
        begin[2] + duration * rate[2],
    )


def cross(one: Any, other: Any) -> Any:
    """Of two vectors."""
    a, b, c = one
    i, j, k = other
    return (b * k - c * j, c * i - a * k, a * j - b * i)


def length(vector: Any) -> float:
    """Of a vector."""
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

    before, part : see `exunet.coupling.jumps`: the acceleration of the step before, and how much it explains
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
    part, size           : see `exunet.coupling.jumps`
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

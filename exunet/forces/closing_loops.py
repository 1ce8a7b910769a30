"""The closing line as scalar loops, in the subset of Python that Numba compiles.

Between two neighbours on its path, d apart, the line has the way d to go; within the diameter D of a ring it
goes round them, D (3/8 + 3/4 u^2 - u^4/8) with u = d / D, so that way, slope and curvature are continuous and
the pull of two rings that meet falls to zero with their distance. The slope h = dway/dd is 1, and there
3/2 u - u^3/2.

Without friction the line has one strain: that of its whole way L over its natural length L1 = r (length - s),
with stretch lambda = L / L1, e = (lambda^2 - 1) / 2, tension N = E1A e lambda, energy U = E1A e^2 L1 / 2. The
winch feels r (N lambda - E1A e^2 / 2), as of the outlet of a reel (`exunet.forces.reel_loops`).

With friction each piece between two rings has its own length of line l_k, free of stress, and its own
tension. The line slides through a ring only where the tensions beside it have the ratio e^(mu phi h h'), phi
the angle by which it turns there; it moves to where the tension is higher. The l_k are a memory: in a step
they are those at its start, less what must have slid for no ratio to be exceeded. That has one solution: with
convex functions whose slope is -ln N(l_k), their sum and that of mu phi h h' |slide| is least.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.loops import Index
from exunet.forces.reel_loops import winding_rate

Floats = NDArray[np.float64]


class Status(NamedTuple):
    """What is known of a line at the end of an accepted step, in the order of the memory.

    commands : number of the winch's commands that have come
    tension_start, tension_end : at the ends of the line [N]
    way      : of the line from end to end [m]
    largest, largest_time : largest tension so far [N], and when [s]
    load     : that over the strength; 0.0 where none is known
    stretch  : largest stretch of any piece now
    """

    commands: float
    tension_start: float
    tension_end: float
    way: float
    largest: float
    largest_time: float
    load: float
    stretch: float


STATUS = len(Status._fields)


class Line(NamedTuple):
    """A closing line of n pieces, its winch, its memory and work space.

    node      : (n + 1,) 3 x nodes along it
    state, rate : (1,) where the length wound up stands in x; where its rate stands in force, before that of
                the work of the winch and, with friction, of what friction takes and of the elastic energy
    whole, ratio, stiffness, time : L1 with nothing wound up [m], r, E1A [N], relaxation time [s]
    ring      : diameter of the rings [m]
    friction  : mu
    winch     : number of the piece at the winch
    strength  : [N]; infinite: not known
    rate_at_rest ... slows : of the drive, as in `exunet.forces.reel_loops.Outlet`
    kept      : (STATUS,) the memory; with friction (STATUS + 2 n,), with the length of line in each piece
                [m], and 1.0, -1.0 or 0.0 for rings through which the line slides forwards, backwards, or not
    pieces    : (n, 6) work space: d as a vector [m], its length [m], slope h, way [m]
    pull      : (2,) work space: tension at both ends in the state that was looked at last [N]
    Work space with friction, (n,) each, of a piece or of the ring after it:
    old, material : length of line in the piece at the start of the step, and now [m]
    tension, factor : [N], and its ratio to that of the first piece that it slides with
    limit, slides : mu phi h h', and whether the line slides through the ring
    parting, turning : rate of the way [m/s], rate of mu phi h h' where it slides [1/s]
    """

    node: NDArray[Index]
    state: NDArray[Index]
    rate: NDArray[Index]
    whole: float
    ratio: float
    stiffness: float
    time: float
    ring: float
    friction: float
    winch: int
    strength: float
    rate_at_rest: float
    force: float
    gives_way: float
    takes_up: float
    asked: Floats
    largest_rate: float
    longest_wound: float
    slows: float
    kept: Floats
    pieces: Floats
    pull: Floats
    old: Floats
    material: Floats
    tension: Floats
    factor: Floats
    limit: Floats
    slides: Floats
    parting: Floats
    turning: Floats


def lay_line(x: Any, line: Any) -> float:
    """Put the pieces of the line into its work space; its whole way [m]."""
    total = 0.0
    pieces = line.pieces
    for k in range(pieces.shape[0]):
        i = line.node[k]
        j = line.node[k + 1]
        square = 0.0
        for c in range(3):
            pieces[k, c] = x[j + c] - x[i + c]
            square += pieces[k, c] * pieces[k, c]
        d = math.sqrt(square)
        pieces[k, 3] = d
        pieces[k, 4] = 1.0
        pieces[k, 5] = d
        if d < line.ring:
            u = d / line.ring
            pieces[k, 4] = u * (1.5 - 0.5 * u * u)
            pieces[k, 5] = line.ring * (0.375 + u * u * (0.75 - 0.125 * u * u))
        total += pieces[k, 5]
    return total


def parting_of(v: Any, line: Any, k: int) -> float:
    """Rate [m/s] at which the way of piece k grows."""
    piece = line.pieces[k]
    along = 0.0
    for c in range(3):
        along += piece[c] * (v[line.node[k + 1] + c] - v[line.node[k] + c])
    return piece[4] * along / piece[3] if piece[3] > 0.0 else 0.0


def pull_piece(line: Any, k: int, tension: float, force: Any) -> None:
    """The tension of piece k [N] on the nodes at its ends."""
    piece = line.pieces[k]
    if tension > 0.0 and piece[3] > 0.0:
        for c in range(3):
            pull = tension * piece[4] * piece[c] / piece[3]
            force[line.node[k] + c] += pull
            force[line.node[k + 1] + c] -= pull


def line_strain(x: Any, line: Any) -> Any:
    """Natural length L1 [m], stretch and strain of a line without friction; no strain where it is slack."""
    natural = line.whole - line.ratio * x[line.state[0]]
    stretch = lay_line(x, line) / natural
    return natural, stretch, max(0.0, 0.5 * (stretch - 1.0) * (stretch + 1.0))


def line_pulls(x: Any, v: Any, line: Any) -> Any:
    """Rate of winding [m/s], tension [N], viscous part of it, dlambda/dt [1/s], what the winch feels [N]."""
    natural, stretch, strain = line_strain(x, line)
    elastic = line.stiffness * strain * stretch
    w = winding_rate(x[line.state[0]], elastic, line)
    tension = elastic
    parting = 0.0
    if strain > 0.0:
        grows = 0.0
        for k in range(line.pieces.shape[0]):
            grows += parting_of(v, line, k)
        parting = (grows + stretch * line.ratio * w) / natural
        whole = strain + line.time * stretch * parting
        tension = line.stiffness * max(whole, 0.0) * stretch
    felt = line.ratio * (tension * stretch - 0.5 * line.stiffness * strain * strain)
    return w, tension, tension - elastic, parting, felt


def add_line(t: float, x: Any, v: Any, line: Any, force: Any) -> None:
    """One tension on all nodes along the line, the rate of winding, and the power of the winch."""
    w, tension, _, _, felt = line_pulls(x, v, line)
    k = line.rate[0]
    force[k] += w
    force[k + 1] += felt * w
    for piece in range(line.pieces.shape[0]):
        pull_piece(line, piece, tension, force)
    line.pull[0] = tension
    line.pull[1] = tension


def line_potential(x: Any, line: Any) -> float:
    """U [J]."""
    natural, _, strain = line_strain(x, line)
    return 0.5 * line.stiffness * strain * strain * natural


def line_power(t: float, x: Any, v: Any, line: Any) -> float:
    """What the viscous stress takes out [W]."""
    natural, _, _ = line_strain(x, line)
    _, _, viscous, parting, _ = line_pulls(x, v, line)
    return viscous * natural * parting


def remember_line(t: float, x: Any, v: Any, line: Any) -> None:
    """What the results tell of the line; `add_line` has looked at this state last."""
    _, stretch, _ = line_strain(x, line)
    remember_pull(t, line, max(line.pull[0], line.pull[1]), stretch)


def remember_pull(t: float, line: Any, largest: float, stretch: float) -> None:
    """Put tensions, way and stretch into the memory."""
    kept = line.kept
    kept[1] = line.pull[0]
    kept[2] = line.pull[1]
    kept[3] = 0.0
    for k in range(line.pieces.shape[0]):
        kept[3] += line.pieces[k, 5]
    if largest > kept[4]:
        kept[4] = largest
        kept[5] = t
        kept[6] = largest / line.strength
    kept[7] = stretch


def stretch_at(strain_force: float) -> float:
    """The stretch at which N / E1A = (lambda^3 - lambda) / 2 is this; Newton's method from above the root."""
    q = 2.0 * strain_force
    s = 1.0 + min(0.5 * q, q ** (1.0 / 3.0))
    for _ in range(60):
        step = (s * s * s - s - q) / (3.0 * s * s - 1.0)
        s -= step
        if step <= 1e-15 * s:
            break
    return s


def turn_of(line: Any, k: int) -> float:
    """phi h h' [rad] at the ring between the pieces k and k + 1."""
    a = line.pieces[k]
    b = line.pieces[k + 1]
    p = a[1] * b[2] - a[2] * b[1]
    q = a[2] * b[0] - a[0] * b[2]
    r = a[0] * b[1] - a[1] * b[0]
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return math.atan2(math.sqrt(p * p + q * q + r * r), dot) * a[4] * b[4]


def settle_line(x: Any, line: Any) -> None:
    """Let the line slide from what its memory says until no ring exceeds its friction."""
    lay_line(x, line)
    n = line.pieces.shape[0]
    first = line.kept.size - 2 * n
    held = 0.0
    for k in range(n):
        line.old[k] = line.kept[first + k]
        line.slides[k] = line.kept[first + n + k]
        held += line.old[k]
    line.old[line.winch] += line.whole - line.ratio * x[line.state[0]] - held
    for k in range(n - 1):
        line.limit[k] = line.friction * turn_of(line, k)
    attempts = 0
    while attempts < 12 * n + 20:
        begin = 0
        for k in range(n):
            if k == n - 1 or line.slides[k] == 0.0:
                settle_block(line, begin, k)
                begin = k + 1
        attempts += 1
        if not slides_otherwise(line, attempts < 6 * n):
            break


def settle_block(line: Any, begin: int, end: int) -> None:
    """Tensions of pieces that slide with each other, whose lengths of line together stay what they are."""
    material = 0.0
    way = 0.0
    slope = 0.0
    ratio = 0.0
    for k in range(begin, end + 1):
        if k > begin:
            ratio += line.slides[k - 1] * line.limit[k - 1]
        line.factor[k] = math.exp(max(-300.0, min(300.0, ratio)))  # no number overflows
        material += line.old[k]
        way += line.pieces[k, 5]
        slope += line.pieces[k, 5] * line.factor[k]
    if way <= material:  # slack
        for k in range(begin, end + 1):
            line.tension[k] = 0.0
            line.material[k] = material * line.pieces[k, 5] / way if end > begin else material
        return
    base = (
        1e3  # over E1A; of a piece all of whose line was wound up, so that it takes some from its neighbour
    )
    if material > 1e-3 * way:
        base = (way - material) / slope  # where the tangent from no tension ends, below the root
        for _ in range(60):
            value = -material
            fall = 0.0
            for k in range(begin, end + 1):
                s = stretch_at(base * line.factor[k])
                value += line.pieces[k, 5] / s
                fall += line.pieces[k, 5] * line.factor[k] * 2.0 / (s * s * (3.0 * s * s - 1.0))
            base += value / fall
            if value <= 1e-15 * fall * base:
                break
    for k in range(begin, end + 1):
        line.tension[k] = line.stiffness * base * line.factor[k]
        line.material[k] = line.pieces[k, 5] / stretch_at(base * line.factor[k])


def slides_otherwise(line: Any, may_stick: bool) -> bool:
    """Let rings slide whose ratio is exceeded, and stick where the line would slide the wrong way."""
    otherwise = False
    slid = 0.0
    for k in range(line.pieces.shape[0] - 1):
        slid += line.old[k] - line.material[k]
        left = line.tension[k]
        right = line.tension[k + 1]
        if line.slides[k] == 0.0:
            holds = math.exp(line.limit[k]) * (1.0 + 1e-12)
            if right > left * holds:
                line.slides[k] = 1.0
                otherwise = True
            elif left > right * holds:
                line.slides[k] = -1.0
                otherwise = True
        elif may_stick and right > 0.0 and slid * line.slides[k] < -1e-13 * line.whole:
            line.slides[k] = 0.0
            otherwise = True
    return otherwise


def rate_of_turn(v: Any, line: Any, k: int) -> float:
    """Rate [rad/s] of phi h h' at the ring between the pieces k and k + 1."""
    a = line.pieces[k]
    b = line.pieces[k + 1]
    if a[3] == 0.0 or b[3] == 0.0:
        return 0.0
    i, j, m = line.node[k], line.node[k + 1], line.node[k + 2]
    cosine = 0.0
    change = 0.0
    along_a = 0.0
    along_b = 0.0
    for c in range(3):
        u = v[j + c] - v[i + c]
        w = v[m + c] - v[j + c]
        cosine += a[c] * b[c] / (a[3] * b[3])
        change += (u * b[c] + a[c] * w) / (a[3] * b[3])
        along_a += a[c] * u / a[3]
        along_b += b[c] * w / b[3]
    change -= cosine * (along_a / a[3] + along_b / b[3])
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    phi = math.atan2(sine, cosine)
    rate = -change / sine * a[4] * b[4] if sine > 1e-6 else 0.0
    if a[3] < line.ring:
        u = a[3] / line.ring
        rate += phi * b[4] * 1.5 * (1.0 - u * u) / line.ring * along_a
    if b[3] < line.ring:
        u = b[3] / line.ring
        rate += phi * a[4] * 1.5 * (1.0 - u * u) / line.ring * along_b
    return rate


def felt_in(line: Any, k: int) -> float:
    """dU/ds of taking line out of piece k [N], per length that is free of stress."""
    s = stretch_at(line.tension[k] / line.stiffness)
    strain = 0.5 * (s - 1.0) * (s + 1.0)
    return line.tension[k] * s - 0.5 * line.stiffness * strain * strain


def power_of_friction(v: Any, w: float, line: Any) -> float:
    """What friction takes [W]: at each ring that slides, the rate of sliding times the step of `felt_in`."""
    n = line.pieces.shape[0]
    for k in range(n):
        line.parting[k] = parting_of(v, line, k)
        line.turning[k] = 0.0
        if k < n - 1 and line.slides[k] != 0.0:
            line.turning[k] = line.slides[k] * line.friction * rate_of_turn(v, line, k)
    taken = 0.0
    begin = 0
    while begin < n:
        end = begin
        while end < n - 1 and line.slides[end] != 0.0:
            end += 1
        if end > begin and line.tension[begin] > 0.0:
            taken += power_in_block(line, w, begin, end)
        begin = end + 1
    return taken


def power_in_block(line: Any, w: float, begin: int, end: int) -> float:
    """What friction takes [W] between pieces that slide with each other."""
    grows = 0.0
    gives = 0.0
    turning = 0.0
    for k in range(begin, end + 1):
        s = stretch_at(line.tension[k] / line.stiffness)
        give = line.material[k] / s * line.tension[k] * 2.0 / (line.stiffness * (3.0 * s * s - 1.0))
        grows += line.parting[k] / s - give * turning
        gives += give
        turning += line.turning[k] if k < end else 0.0
        if k == line.winch:
            grows += line.ratio * w
    rate = grows / gives  # of ln N, of the first piece
    slid = 0.0
    taken = 0.0
    for k in range(begin, end):
        s = stretch_at(line.tension[k] / line.stiffness)
        give = line.material[k] / s * line.tension[k] * 2.0 / (line.stiffness * (3.0 * s * s - 1.0))
        slid -= line.parting[k] / s - give * rate
        if k == line.winch:
            slid -= line.ratio * w
        taken += max(0.0, slid * (felt_in(line, k + 1) - felt_in(line, k)))
        rate += line.turning[k]
    return taken


def add_rubbing_line(t: float, x: Any, v: Any, line: Any, force: Any) -> None:
    """The tension of each piece on its nodes, and the rates of the line's states."""
    settle_line(x, line)
    n = line.pieces.shape[0]
    w = winding_rate(x[line.state[0]], line.tension[line.winch], line)
    k = line.rate[0]
    force[k] += w
    felt = line.ratio * felt_in(line, line.winch) * w
    taken = power_of_friction(v, w, line)
    force[k + 1] += felt
    force[k + 2] += taken
    force[k + 3] += felt - taken
    for piece in range(n):
        force[k + 3] += line.tension[piece] * line.parting[piece]
        pull_piece(line, piece, line.tension[piece], force)
    line.pull[0] = line.tension[0]
    line.pull[1] = line.tension[n - 1]


def rubbing_potential(x: Any, line: Any) -> float:
    """Elastic energy [J], a state of its own: it depends on where the line has slid, not on x alone."""
    energy: float = x[line.state[0] + 3]
    return energy


def remember_rubbing(t: float, x: Any, v: Any, line: Any) -> None:
    """How much line is in each piece, where it slides, and what the results tell of it."""
    settle_line(x, line)
    n = line.pieces.shape[0]
    first = line.kept.size - 2 * n
    largest = 0.0
    for k in range(n):
        line.kept[first + k] = line.material[k]
        line.kept[first + n + k] = line.slides[k]
        largest = max(largest, line.tension[k])
    remember_pull(t, line, largest, stretch_at(largest / line.stiffness))


LAID = (lay_line, parting_of, pull_piece, remember_pull)
SMOOTH = (line_strain, line_pulls)
RUBBING = (
    stretch_at, turn_of, settle_line, settle_block, slides_otherwise, rate_of_turn, felt_in,
    power_of_friction, power_in_block,
)  # fmt: skip

"""Closing line as a force term: scalar loops with and without friction, winch commands, bounds of the step.

Each piece between two rings has its own length of line l_k, free of stress, and its own tension. The line
slides through a ring only where the tensions beside it have the ratio e^(mu phi h h'), phi the angle by which
it turns there and h, h' the slopes of both pieces; it moves to where the tension is higher. The l_k are a
discrete state: in a step they are those at its start, less what must have slid for no ratio to be exceeded.
That has
one solution: with convex functions whose slope is -ln N(l_k), their sum and that of mu phi h h' |slide| is
least.

Between two neighbours on its path, d apart, the line has the way d to go; within the diameter D of a ring it
goes round them, D (3/8 + 3/4 u^2 - u^4/8) with u = d / D, so that way, slope and curvature are continuous and
the pull of two rings that meet falls to zero with their distance. The slope h = dway/dd is 1, and there
3/2 u - u^3/2.

Without friction the line has one strain: that of its whole way L over its natural length L1 = r (length - s),
with stretch lambda = L / L1, e = (lambda^2 - 1) / 2, tension N = E1A e lambda, energy U = E1A e^2 L1 / 2. The
winch feels r (N lambda - E1A e^2 / 2), as of the outlet of a reel (`exunet.forces.reel`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.base.run_events import ClosingEvent
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.law import STRETCH_BOUND, green_lagrange_strain, strain_at, stretch_at, tangent_at
from exunet.forces.loops import Index
from exunet.forces.reel import NOTHING_ASKED, command_name, winding_rate
from exunet.forces.terms import Change, DiscreteState, DiscreteStates, Input, KernelTerm, Series, Switch
from exunet.net.closing import NAME, SLOWS, LineThroughRings


def slope_of(line: Any, k: int) -> float:
    """h of piece k."""
    return line.pull[k] * math.sqrt(line.square[k])


def parting_of(v: Any, line: Any, k: int) -> float:
    """Rate [m/s] at which the way of piece k grows."""
    i = line.node[k]
    j = line.node[k + 1]
    along = (
        line.dx[k] * (v[j] - v[i]) + line.dy[k] * (v[j + 1] - v[i + 1]) + line.dz[k] * (v[j + 2] - v[i + 2])
    )
    return line.pull[k] * along


def pull_piece(line: Any, k: int, tension: float, force: Any) -> None:
    """The tension of piece k [N] on the nodes at its ends."""
    i = line.node[k]
    j = line.node[k + 1]
    pull = tension * line.pull[k]
    for c, d in enumerate((line.dx[k], line.dy[k], line.dz[k])):
        force[i + c] += pull * d
        force[j + c] -= pull * d


def turn_of(line: Any, k: int) -> float:
    """phi h h' [rad] at the ring between the pieces k and k + 1."""
    dx, dy, dz = line.dx, line.dy, line.dz
    p = dy[k] * dz[k + 1] - dz[k] * dy[k + 1]
    q = dz[k] * dx[k + 1] - dx[k] * dz[k + 1]
    r = dx[k] * dy[k + 1] - dy[k] * dx[k + 1]
    dot = dx[k] * dx[k + 1] + dy[k] * dy[k + 1] + dz[k] * dz[k + 1]
    return math.atan2(math.sqrt(p * p + q * q + r * r), dot) * slope_of(line, k) * slope_of(line, k + 1)


def settle_line(x: Any, line: Any) -> None:
    """Let the line slide from what its discrete state says until no ring exceeds its friction."""
    lay_line(x, line)
    n = line.way.size
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
        way += line.way[k]
        slope += line.way[k] * line.factor[k]
    if way <= material:  # slack
        for k in range(begin, end + 1):
            line.tension[k] = 0.0
            line.material[k] = material * line.way[k] / way if end > begin else material
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
                value += line.way[k] / s
                fall += line.way[k] * line.factor[k] / (s * s * tangent_at(s))
            base += value / fall
            if value <= 1e-15 * fall * base:
                break
    for k in range(begin, end + 1):
        line.tension[k] = line.stiffness * base * line.factor[k]
        line.material[k] = line.way[k] / stretch_at(base * line.factor[k])


def slides_otherwise(line: Any, may_stick: bool) -> bool:
    """Let rings slide whose ratio is exceeded, and stick where the line would slide the wrong way."""
    otherwise = False
    slid = 0.0
    for k in range(line.way.size - 1):
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
    apart_a = math.sqrt(line.square[k])
    apart_b = math.sqrt(line.square[k + 1])
    if apart_a == 0.0 or apart_b == 0.0:
        return 0.0
    a = (line.dx[k] / apart_a, line.dy[k] / apart_a, line.dz[k] / apart_a)
    b = (line.dx[k + 1] / apart_b, line.dy[k + 1] / apart_b, line.dz[k + 1] / apart_b)
    slope_a = slope_of(line, k)
    slope_b = slope_of(line, k + 1)
    i, j, m = line.node[k], line.node[k + 1], line.node[k + 2]
    cosine = 0.0
    change = 0.0
    along_a = 0.0
    along_b = 0.0
    for c in range(3):
        u = v[j + c] - v[i + c]
        w = v[m + c] - v[j + c]
        cosine += a[c] * b[c]
        change += u * b[c] / apart_a + a[c] * w / apart_b
        along_a += a[c] * u
        along_b += b[c] * w
    change -= cosine * (along_a / apart_a + along_b / apart_b)
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    phi = math.atan2(sine, cosine)
    rate = -change / sine * slope_a * slope_b if sine > 1e-6 else 0.0
    if apart_a < line.ring:
        u = apart_a / line.ring
        rate += phi * slope_b * 1.5 * (1.0 - u * u) / line.ring * along_a
    if apart_b < line.ring:
        u = apart_b / line.ring
        rate += phi * slope_a * 1.5 * (1.0 - u * u) / line.ring * along_b
    return rate


def felt_in(line: Any, k: int) -> float:
    """dU/ds of taking line out of piece k [N], per length that is free of stress."""
    s = stretch_at(line.tension[k] / line.stiffness)
    strain = strain_at(s)
    return line.tension[k] * s - 0.5 * line.stiffness * strain * strain


def power_of_friction(v: Any, w: float, line: Any) -> float:
    """Compute the friction power [W]: at each sliding ring, rate of sliding times the step of `felt_in`."""
    n = line.way.size
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
    """Compute the power that friction dissipates [W] between pieces that slide with each other."""
    grows = 0.0
    gives = 0.0
    turning = 0.0
    for k in range(begin, end + 1):
        s = stretch_at(line.tension[k] / line.stiffness)
        give = line.material[k] / s * line.tension[k] / (line.stiffness * tangent_at(s))
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
        give = line.material[k] / s * line.tension[k] / (line.stiffness * tangent_at(s))
        slid -= line.parting[k] / s - give * rate
        if k == line.winch:
            slid -= line.ratio * w
        taken += max(0.0, slid * (felt_in(line, k + 1) - felt_in(line, k)))
        rate += line.turning[k]
    return taken


def add_rubbing_line(t: float, x: Any, v: Any, line: Any, force: Any) -> None:
    """The tension of each piece on its nodes, and the rates of the line's states."""
    settle_line(x, line)
    n = line.way.size
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
    line.reported[0] = line.tension[0]
    line.reported[1] = line.tension[n - 1]
    line.reported[2] = total_of(line.way)


def rubbing_potential(x: Any, line: Any) -> float:
    """Elastic energy [J], a state of its own: it depends on where the line has slid, not on x alone."""
    energy: float = x[line.state[0] + 3]
    return energy


def remember_rubbing(t: float, x: Any, v: Any, line: Any) -> None:
    """Discrete state of the line: length in each piece, sliding, and the numbers in the result."""
    settle_line(x, line)
    n = line.way.size
    first = line.kept.size - 2 * n
    largest = 0.0
    for k in range(n):
        line.kept[first + k] = line.material[k]
        line.kept[first + n + k] = line.slides[k]
        largest = max(largest, line.tension[k])
    remember_reported(t, largest, stretch_at(largest / line.stiffness), line)


RUBBING = (
    strain_at, tangent_at, stretch_at,
    slope_of, parting_of, pull_piece, turn_of, settle_line, settle_block, slides_otherwise, rate_of_turn,
    felt_in, power_of_friction, power_in_block,
)  # fmt: skip


class LineStatus(NamedTuple):
    """Status of a line at the end of an accepted step, in the order of the discrete state.

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


STATUS = len(LineStatus._fields)


class Line(NamedTuple):
    """A closing line of n pieces, its winch, its discrete state and work space.

    node      : (n + 1,) 3 x nodes along it
    state, rate : (1,) where the length wound up stands in x; where its rate stands in force, before that of
                the work of the winch and of what viscous stress takes, or of what friction takes and of the
                elastic energy
    whole, ratio, stiffness, time : L1 with nothing wound up [m], r, E1A [N], relaxation time [s]
    ring      : diameter of the rings [m]
    friction  : mu
    winch     : number of the piece at the winch
    strength  : [N]; infinite: not known
    rate_at_most ... slows : of the drive, as in `exunet.forces.reel.Outlet`
    kept      : (STATUS,) the discrete state; with friction (STATUS + 2 n,), with the length of line in each
                piece [m], and 1.0, -1.0 or 0.0 for rings through which the line slides forwards, backwards,
                or not
    Work space of each piece, (n,), each contiguous, as most of the time goes into these loops:
    dx, dy, dz, square : d as a vector [m], d^2 [m2]
    way, pull : way [m], pull on the nodes at its ends over tension and d: h / d [1/m]
    reported  : (3,) of the state that `add` has looked at last: tension at both ends [N], whole way [m]
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
    rate_at_most: float
    force: float
    gives: float
    asked: Floats
    largest_rate: float
    longest_wound: float
    slows: float
    kept: Floats
    dx: Floats
    dy: Floats
    dz: Floats
    square: Floats
    way: Floats
    pull: Floats
    reported: Floats
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
    node, dx, dy, dz, square = line.node, line.dx, line.dy, line.dz, line.square
    way, pull, ring = line.way, line.pull, line.ring
    i = node[0]
    px = x[i]
    py = x[i + 1]
    pz = x[i + 2]
    for k in range(way.size):
        j = node[k + 1]
        qx = x[j]
        qy = x[j + 1]
        qz = x[j + 2]
        a = qx - px
        b = qy - py
        c = qz - pz
        dx[k] = a
        dy[k] = b
        dz[k] = c
        square[k] = a * a + b * b + c * c
        px = qx
        py = qy
        pz = qz
    inverse = 1.0 / ring  # two multiplications take less time than two divisions
    for k in range(way.size):  # several pieces at once: nothing here depends on other pieces
        d = math.sqrt(square[k])
        u = d * inverse
        way[k] = ring * (0.375 + u * u * (0.75 - 0.125 * u * u)) if u < 1.0 else d
        pull[k] = (1.5 - 0.5 * u * u) * inverse if u < 1.0 else 1.0 / d
    return total_of(way)


def total_of(values: Any) -> float:
    """The sum, by four sums that the processor can make side by side."""
    a = 0.0
    b = 0.0
    c = 0.0
    d = 0.0
    whole = values.size - values.size % 4
    for k in range(0, whole, 4):
        a += values[k]
        b += values[k + 1]
        c += values[k + 2]
        d += values[k + 3]
    for k in range(whole, values.size):
        a += values[k]
    return (a + b) + (c + d)


def line_strain(way: float, x: Any, line: Any) -> Any:
    """Natural length L1 [m], stretch and strain of a line without friction; no strain where it is slack."""
    natural = line.whole - line.ratio * x[line.state[0]]
    stretch = way / natural
    return natural, stretch, strain_at(stretch)


def growth_of_way(v: Any, line: Any) -> float:
    """Rate [m/s] at which the whole way grows."""
    node, dx, dy, dz, pull = line.node, line.dx, line.dy, line.dz, line.pull
    grows = 0.0
    i = node[0]
    px = v[i]
    py = v[i + 1]
    pz = v[i + 2]
    for k in range(pull.size):
        j = node[k + 1]
        qx = v[j]
        qy = v[j + 1]
        qz = v[j + 2]
        grows += pull[k] * (dx[k] * (qx - px) + dy[k] * (qy - py) + dz[k] * (qz - pz))
        px = qx
        py = qy
        pz = qz
    return grows


def line_pulls(way: float, x: Any, v: Any, line: Any) -> Any:
    """Rate of winding [m/s], tension [N], what the winch feels [N], what viscosity takes out [W].

    Of a line that has been laid at this state, with this whole way [m].
    """
    natural, stretch, strain = line_strain(way, x, line)
    elastic = line.stiffness * strain * stretch
    w = winding_rate(x[line.state[0]], elastic, line)
    tension = elastic
    parting = 0.0
    if strain > 0.0 and line.time > 0.0:
        parting = (growth_of_way(v, line) + stretch * line.ratio * w) / natural
        whole = strain + line.time * stretch * parting
        tension = line.stiffness * max(whole, 0.0) * stretch
    felt = line.ratio * (tension * stretch - 0.5 * line.stiffness * strain * strain)
    return w, tension, felt, (tension - elastic) * natural * parting


def add_line(t: float, x: Any, v: Any, line: Any, force: Any) -> None:
    """One tension on all nodes along the line, the rate of winding, the powers of winch and viscous stress.

    These are integrated with the motion: Simpson's rule would lay the line two more times a step.
    """
    way = lay_line(x, line)
    w, tension, felt, taken = line_pulls(way, x, v, line)
    k = line.rate[0]
    force[k] += w
    force[k + 1] += felt * w
    if line.time > 0.0:
        force[k + 2] += taken
    if tension > 0.0:
        pull_nodes(tension, line, force)
    reported = line.reported
    reported[0] = tension
    reported[1] = tension
    reported[2] = way


def pull_nodes(tension: float, line: Any, force: Any) -> None:
    """One tension [N] in all pieces on the nodes: at each, that of the piece after it less that before."""
    node, dx, dy, dz, pull = line.node, line.dx, line.dy, line.dz, line.pull
    px = 0.0
    py = 0.0
    pz = 0.0
    for k in range(pull.size):
        one = tension * pull[k]
        qx = one * dx[k]
        qy = one * dy[k]
        qz = one * dz[k]
        i = node[k]
        force[i] += qx - px
        force[i + 1] += qy - py
        force[i + 2] += qz - pz
        px = qx
        py = qy
        pz = qz
    i = node[pull.size]
    force[i] -= px
    force[i + 1] -= py
    force[i + 2] -= pz


def line_potential(x: Any, line: Any) -> float:
    """U [J]."""
    natural, _, strain = line_strain(lay_line(x, line), x, line)
    return 0.5 * line.stiffness * strain * strain * natural


def remember_line(t: float, x: Any, v: Any, line: Any) -> None:
    """Return the numbers that the result stores of the line; `add_line` was evaluated at this state last."""
    _, stretch, _ = line_strain(line.reported[2], x, line)
    remember_reported(t, line.reported[0], stretch, line)


def remember_reported(t: float, largest: float, stretch: float, line: Any) -> None:
    """Put tensions, way, and the largest tension [N] and stretch of any piece into the discrete state."""
    kept, reported = line.kept, line.reported
    kept[1] = reported[0]
    kept[2] = reported[1]
    kept[3] = reported[2]
    if largest > kept[4]:
        kept[4] = largest
        kept[5] = t
        kept[6] = largest / line.strength
    kept[7] = stretch


LAID = (total_of, lay_line, remember_reported)
SMOOTH = (strain_at, line_strain, growth_of_way, line_pulls, pull_nodes)


STATE_NAME = f"{NAME}/line"
_SERIES = {  # fields of the status: units
    "tension_start": "N",
    "tension_end": "N",
    "way": "m",
    "largest": "N",
    "largest_time": "s",
    "load": "1",
}
_STRAIN = 0.01  # up to which the bound for the step counts what the tension itself adds to the stiffness


def states_of(line: LineThroughRings, position: Floats, ratio: float, time: float) -> tuple[FirstOrder, ...]:
    """Length wound up [m], work of the winch on the line [J]; what viscous stress has taken [J], if there is
    any; with friction what that has taken, and elastic energy [J].

    position : (n_nodes, 3) at the start [m]; ratio, time : as of `Drawstring`
    """
    states = (
        FirstOrder(f"{NAME}/wound_up", (line.wound,), "m"),
        FirstOrder(f"{NAME}/work", (0.0,), "J", gives=1.0),
    )
    if line.friction == 0.0:
        return (*states, FirstOrder(f"{NAME}/viscosity", (0.0,), "J", gives=-1.0)) if time > 0.0 else states
    natural = ratio * line.length_at_start
    strain = max(0.0, float(green_lagrange_strain(way_of(line, position).sum(), natural)))
    energy = 0.5 * ratio**3 * line.stiffness * strain**2 * natural
    taken = FirstOrder(f"{NAME}/friction", (0.0,), "J", gives=-1.0)
    return *states, taken, FirstOrder(f"{NAME}/elastic", (energy,), "J")


def way_of(line: LineThroughRings, position: Floats) -> Floats:
    """(n,) way of each piece of the line [m]; position (n_nodes, 3) [m]."""
    apart = np.linalg.norm(np.diff(position[list(line.path)], axis=0), axis=1)
    u = np.minimum(apart / line.ring_diameter, 1.0)
    return np.maximum(apart, line.ring_diameter * (0.375 + u**2 * (0.75 - 0.125 * u**2)))


@dataclass(frozen=True, eq=False)
class Drawstring:
    """A closing line in a scene.

    ratio : of its length that is free of stress to that in the reference configuration, by a thermal strain
    time  : relaxation time of viscous stress [s]; 0.0 without it, as for a line with friction
    """

    line: LineThroughRings
    blocks: Blocks
    ratio: float = 1.0
    time: float = 0.0

    @property
    def rubs(self) -> bool:
        """True with friction."""
        return self.line.friction > 0.0

    @property
    def at_start(self) -> Floats:
        """The discrete state at time 0: line in the pieces by their ways, so that all have one tension."""
        line = self.line
        way = way_of(line, self.blocks.position)
        stretch = float(way.sum()) / (self.ratio * line.length_at_start)
        strain = strain_at(stretch)
        tension = line.stiffness * self.ratio**3 * strain * stretch
        status = LineStatus(
            commands=float(np.searchsorted(line.times, 0.0, side="right")),
            tension_start=tension,
            tension_end=tension,
            way=float(way.sum()),
            largest=tension,
            largest_time=0.0,
            load=0.0 if line.strength is None else tension / line.strength,
            stretch=stretch,
        )
        if not self.rubs:
            return np.array(status)
        laid = self.ratio * line.length_at_start * way / way.sum()
        return np.concatenate([status, laid, np.zeros(len(way))])

    def data(self, discrete: Floats) -> Line:
        """Build the data for the loops at a discrete state."""
        line, blocks = self.line, self.blocks
        n, drive = len(line.path) - 1, line.drives[int(discrete[0])]
        laid, room = np.zeros((6, n)), np.zeros((8, n if self.rubs else 0))
        return Line(
            node=(3 * np.array(line.path)).astype(Index),
            state=np.array([blocks.state(f"{NAME}/wound_up")], dtype=Index),
            rate=np.array([blocks.rate(f"{NAME}/wound_up")], dtype=Index),
            whole=self.ratio * line.length,
            ratio=self.ratio,
            stiffness=line.stiffness * self.ratio**3,
            time=self.time,
            ring=line.ring_diameter,
            friction=line.friction,
            winch=n - 1 if line.winch_at_end else 0,
            strength=np.inf if line.strength is None else line.strength,
            rate_at_most=drive.rate,
            force=drive.force,
            gives=drive.gives,
            asked=NOTHING_ASKED,
            largest_rate=line.largest_rate,
            longest_wound=line.length - line.shortest,
            slows=SLOWS * line.length,
            kept=discrete,
            dx=laid[0],
            dy=laid[1],
            dz=laid[2],
            square=laid[3],
            way=laid[4],
            pull=laid[5],
            reported=np.zeros(3),
            old=room[0],
            material=room[1],
            tension=room[2],
            factor=room[3],
            limit=room[4],
            slides=room[5],
            parting=room[6],
            turning=room[7],
        )

    @property
    def discrete(self) -> DiscreteState:
        """Status and, with friction, how much line is where."""
        wanted = {name: units for name, units in _SERIES.items() if name != "load" or self.line.strength}
        series = tuple(
            Series(f"{NAME}/{name}", units, LineStatus._fields.index(name)) for name, units in wanted.items()
        )
        return DiscreteState(STATE_NAME, self.at_start, self.data, "kept", too_long, series)

    @property
    def rates(self) -> tuple[float, float]:
        """Bounds [1/s2], [1/s] of what the line adds to the eigenvalues, while its strain is not above 1 %.

        Along the line, EA over its least length times the sum of |dL/dx|^2 / m: a ring turns it by half a
        turn at most. Without friction the line stretches as a whole, with friction it may stretch between any
        two rings alone; there it is taken to have its even share of the least length. Across the line, its
        tension over the diameter of the rings, where they meet (3/2, the largest curvature of the way).
        """
        line, mass = self.line, self.blocks.mass
        free = np.ones(len(mass), dtype=bool)
        free[self.blocks.net.fixed_nodes] = False
        mobility = np.where(free, 1.0 / mass, 0.0)[list(line.path)]
        least = self.ratio * (line.shortest if line.has_winch else line.length)
        turns = np.full(len(line.path), 4.0)
        turns[[0, -1]] = 1.0
        slope = line.stiffness / least  # of the tension over the length
        along = slope * float(turns @ mobility)
        if self.rubs:
            slope *= len(line.path) - 1
            along = slope * 4.0 * float(mobility.max())
        across = 6.0 * _STRAIN * line.stiffness / line.ring_diameter * float(mobility.max())
        give = max(drive.gives for drive in (*line.drives, line.softest))
        return 2.0 * along + across, slope * give + 2.0 * self.time * along

    def term(self) -> KernelTerm:
        """Its forces, its energy, its winch and, with friction, what that takes."""
        line, discrete, rates = self.line, self.discrete, self.rates
        asked = Input(command_name(NAME), "asked", NOTHING_ASKED, "1, m/s, N, m/(N s)")
        helpers = (winding_rate, *LAID, *(RUBBING if self.rubs else SMOOTH))
        return KernelTerm(
            "nodes with rings",
            add_rubbing_line if self.rubs else add_line,
            self.data(discrete.initial),
            potential=rubbing_potential if self.rubs else line_potential,
            helpers=helpers,
            stiffness_rate=rates[0],
            damping_rate=rates[1],
            discrete=discrete,
            switch=Instants(line.times) if line.times else None,
            inputs=(asked,) if line.is_commanded else (),
            remember=remember_rubbing if self.rubs else remember_line,
            internal=True,
        )


def elastic_once_slid(x: Floats, line: Line, friction: float) -> float:
    """Energy [J] of a line with friction at x, once it has slid as far as this coefficient lets it."""
    line = line._replace(friction=friction)
    settle_line(x, line)
    stretch = np.array([stretch_at(pull / line.stiffness) for pull in line.tension.tolist()])
    strain = green_lagrange_strain(stretch, 1.0)
    return float(0.5 * line.stiffness * (strain**2 @ line.material))


def too_long(values: Floats) -> str:
    """Why a run with this discrete state must stop, and what to change; "" if it need not."""
    stretch = float(values[LineStatus._fields.index("stretch")])
    if stretch <= STRETCH_BOUND:
        return ""
    words = (
        f"the closing line is {stretch:.4g} times as long as when free of stress; above {STRETCH_BOUND:g} "
    )
    return f"{words}it is outside the cable law's validity: make it stiffer, or its winch weaker"


@dataclass(frozen=True)
class Instants(Switch):
    """Known instants of a closing, whose number so far is the first value of the discrete state.

    words : of the event at each; None: "command" and its number
    """

    times: tuple[float, ...]
    words: tuple[str, ...] | None = None

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """The only item, if an instant has passed since the discrete state was set."""
        return np.flatnonzero([np.searchsorted(self.times, time, side="right") > discrete[0]])

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Count the instants; nothing else changes."""
        after, number = discrete.copy(), int(np.searchsorted(self.times, time, side="right"))
        after[0] = number
        words = f"command {number}" if self.words is None else self.words[number - 1]
        return Change(after, events=(ClosingEvent(time_s=time, event=words),))

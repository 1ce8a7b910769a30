"""The closing line as scalar loops, in the subset of Python that Numba compiles.

Between two neighbours on its path, d apart, the line has the way d to go; within the diameter D of a ring it
goes round them, D (3/8 + 3/4 u^2 - u^4/8) with u = d / D, so that way, slope and curvature are continuous and
the pull of two rings that meet falls to zero with their distance. The slope h = dway/dd is 1, and there
3/2 u - u^3/2.

Without friction the line has one strain: that of its whole way L over its natural length L1 = r (length - s),
with stretch lambda = L / L1, e = (lambda^2 - 1) / 2, tension N = E1A e lambda, energy U = E1A e^2 L1 / 2. The
winch feels r (N lambda - E1A e^2 / 2), as of the outlet of a reel (`exunet.forces.reel_loops`).

The line with friction is in `exunet.forces.rubbing_loops`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.loops import Index
from exunet.forces.reel_loops import winding_rate

Floats = NDArray[np.float64]


class LineStatus(NamedTuple):
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


STATUS = len(LineStatus._fields)


class Line(NamedTuple):
    """A closing line of n pieces, its winch, its memory and work space.

    node      : (n + 1,) 3 x nodes along it
    state, rate : (1,) where the length wound up stands in x; where its rate stands in force, before that of
                the work of the winch and of what viscous stress takes, or of what friction takes and of the
                elastic energy
    whole, ratio, stiffness, time : L1 with nothing wound up [m], r, E1A [N], relaxation time [s]
    ring      : diameter of the rings [m]
    friction  : mu
    winch     : number of the piece at the winch
    strength  : [N]; infinite: not known
    rate_at_most ... slows : of the drive, as in `exunet.forces.reel_loops.Outlet`
    kept      : (STATUS,) the memory; with friction (STATUS + 2 n,), with the length of line in each piece
                [m], and 1.0, -1.0 or 0.0 for rings through which the line slides forwards, backwards, or not
    Work space of each piece, (n,), each contiguous, as most of the time goes into these loops:
    dx, dy, dz, square : d as a vector [m], d^2 [m2]
    way, pull : way [m], pull on the nodes at its ends over tension and d: h / d [1/m]
    told      : (3,) of the state that `add` has looked at last: tension at both ends [N], whole way [m]
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
    told: Floats
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
    return natural, stretch, max(0.0, 0.5 * (stretch - 1.0) * (stretch + 1.0))


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
    told = line.told
    told[0] = tension
    told[1] = tension
    told[2] = way


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
    """What the results tell of the line; `add_line` has looked at this state last."""
    _, stretch, _ = line_strain(line.told[2], x, line)
    remember_told(t, line.told[0], stretch, line)


def remember_told(t: float, largest: float, stretch: float, line: Any) -> None:
    """Put tensions, way, and the largest tension [N] and stretch of any piece into the memory."""
    kept, told = line.kept, line.told
    kept[1] = told[0]
    kept[2] = told[1]
    kept[3] = told[2]
    if largest > kept[4]:
        kept[4] = largest
        kept[5] = t
        kept[6] = largest / line.strength
    kept[7] = stretch


LAID = (total_of, lay_line, remember_told)
SMOOTH = (line_strain, growth_of_way, line_pulls, pull_nodes)

"""The closing line with friction as scalar loops, in the subset of Python that Numba compiles.

Each piece between two rings has its own length of line l_k, free of stress, and its own tension. The line
slides through a ring only where the tensions beside it have the ratio e^(mu phi h h'), phi the angle by which
it turns there and h, h' the slopes of both pieces (`exunet.forces.closing_loops`, where the data are too); it
moves to where the tension is higher. The l_k are a memory: in a step they are those at its start, less what
must have slid for no ratio to be exceeded. That has one solution: with convex functions whose slope is
-ln N(l_k), their sum and that of mu phi h h' |slide| is least.
"""

from __future__ import annotations

import math
from typing import Any

from exunet.forces.closing_loops import lay_line, remember_told, total_of
from exunet.forces.reel_loops import winding_rate


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
    dx, dy, dz = line.dx, line.dy, line.dz
    p = dy[k] * dz[k + 1] - dz[k] * dy[k + 1]
    q = dz[k] * dx[k + 1] - dx[k] * dz[k + 1]
    r = dx[k] * dy[k + 1] - dy[k] * dx[k + 1]
    dot = dx[k] * dx[k + 1] + dy[k] * dy[k + 1] + dz[k] * dz[k + 1]
    return math.atan2(math.sqrt(p * p + q * q + r * r), dot) * slope_of(line, k) * slope_of(line, k + 1)


def settle_line(x: Any, line: Any) -> None:
    """Let the line slide from what its memory says until no ring exceeds its friction."""
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
                fall += line.way[k] * line.factor[k] * 2.0 / (s * s * (3.0 * s * s - 1.0))
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
    strain = 0.5 * (s - 1.0) * (s + 1.0)
    return line.tension[k] * s - 0.5 * line.stiffness * strain * strain


def power_of_friction(v: Any, w: float, line: Any) -> float:
    """What friction takes [W]: at each ring that slides, the rate of sliding times the step of `felt_in`."""
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
    line.told[0] = line.tension[0]
    line.told[1] = line.tension[n - 1]
    line.told[2] = total_of(line.way)


def rubbing_potential(x: Any, line: Any) -> float:
    """Elastic energy [J], a state of its own: it depends on where the line has slid, not on x alone."""
    energy: float = x[line.state[0] + 3]
    return energy


def remember_rubbing(t: float, x: Any, v: Any, line: Any) -> None:
    """How much line is in each piece, where it slides, and what the results tell of it."""
    settle_line(x, line)
    n = line.way.size
    first = line.kept.size - 2 * n
    largest = 0.0
    for k in range(n):
        line.kept[first + k] = line.material[k]
        line.kept[first + n + k] = line.slides[k]
        largest = max(largest, line.tension[k])
    remember_told(t, largest, stretch_at(largest / line.stiffness), line)


RUBBING = (
    slope_of, parting_of, pull_piece, stretch_at, turn_of, settle_line, settle_block, slides_otherwise,
    rate_of_turn, felt_in, power_of_friction, power_in_block,
)  # fmt: skip

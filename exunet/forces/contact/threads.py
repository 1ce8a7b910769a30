"""Contact of the threads of a net, and of tethers, with a rigid body."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks
from exunet.forces.contact.core_loops import DISTANCES, is_flat
from exunet.forces.contact.frame_loops import (
    FRAMES,
    place_in_body,
    push_point,
    turn_into,
    velocity_against_body,
)
from exunet.forces.contact.friction_loops import (
    FRICTION,
    friction,
    regularised_friction,
    shift_for,
)
from exunet.forces.contact.near_loops import NEAR, choose_near, is_near, keep_row, remember_status
from exunet.forces.contact.status import memory_of, untouched
from exunet.forces.contact.touching_loops import TOUCHING, find_spans, touch
from exunet.forces.contact.trouble import trouble
from exunet.forces.cores import Cores, Surface
from exunet.forces.loops import Index
from exunet.forces.terms import KernelTerm

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROW = 5  # numbers of a pair in the memory, see `friction_loops`


def gauss_rules(*numbers: int) -> Floats:
    """(2, sum n) places in [0, 1] and weights of Gauss and Legendre's rules one after the other."""
    rules = [np.polynomial.legendre.leggauss(n) for n in numbers]
    return np.concatenate([np.stack([0.5 + 0.5 * x, 0.5 * w]) for x, w in rules], axis=1)


class Friction(NamedTuple):
    """friction : mu; slip_speed : v_s [m/s], 0.0 for friction with memory; ratio : kappa; damping : zeta."""

    friction: float
    slip_speed: float = 0.0
    ratio: float = 1.0
    damping: float = 0.0


class ThreadContact(NamedTuple):
    """Elements that may touch a body, the body's surface, the law, the memory and work space.

    first, second : (m,) 3 x nodes at the ends
    element  : (m,) numbers of the elements
    length   : (m,) L0 [m]
    thick    : (m,) radius of the thread [m]
    spring, relaxation : (m,) k_t [N/m] and theta [s] of friction
    kind, numbers, place, turn, rounding, boxes : as `Cores`
    middle, radius, allowed, least : as `Surface`
    centre, attitude, spin : where the entries of the body begin, see `exunet.forces.blocks`
    taken    : where in force the rates of the energies that damping and friction take stand
    stiffness, damping : K [N/m2], a [s/m]
    friction, slip_speed : as `Friction`
    kept     : (ROW m + STATUS,) the memory
    after    : (m, ROW) what the memory would be after the state that was looked at last
    now      : (7,) of that state: largest depth [m], its pair, pairs that touch, largest speed against the
               body of what is near [m/s]; 1 + the number of a pair that came into reach unseen, less than 0
               of one that is too deep, or 0; sum of the forces across the surface [N]; the fastest pair
    near     : (m,) numbers of the pairs that are looked at, in order
    listed   : (m,) 1.0 for these
    look     : (6,) how many there are, when they were chosen [s], how long they are right [s], their
               largest speed against the body then [m/s], how many nodes they have, and which is the fastest
    nodes    : (k,) where the coordinates of the nodes of all pairs begin
    clear    : (m,) how far each pair was at least from the surface when this was worked out last [m]; 0.0:
               it may touch
    seen     : (m, 6) where its ends were then, in the body's axes [m]
    near_nodes : (k,) of those that are looked at, as many as `look` says; wanted : (n_nodes,) 1 for these
    frame    : (3, 3) work space: the rotation of the body
    own      : (3 n_nodes,) work space: places of the nodes in the body's axes [m]
    lines    : (n, 6) work space: the thread in the axes of each core, where it begins and to where it goes
    spans, splits, sums, rule : work space and Gauss's rules, see `touching_loops`
    """

    first: NDArray[Index]
    second: NDArray[Index]
    element: Ints
    length: Floats
    thick: Floats
    spring: Floats
    relaxation: Floats
    kind: Ints
    numbers: Floats
    place: Floats
    turn: Floats
    rounding: Floats
    boxes: Floats
    middle: Floats
    radius: float
    allowed: float
    least: float
    centre: int
    attitude: int
    spin: int
    taken: int
    stiffness: float
    damping: float
    friction: float
    slip_speed: float
    kept: Floats
    after: Floats
    now: Floats
    near: Ints
    listed: Floats
    look: Floats
    clear: Floats
    seen: Floats
    nodes: Ints
    near_nodes: Ints
    wanted: Ints
    frame: Floats
    own: Floats
    lines: Floats
    spans: Floats
    splits: Floats
    sums: Floats
    rule: Floats


def thread_contact(
    blocks: Blocks, body: str, surface: Surface, law: tuple[float, float], rubbing: Friction, inside: Ints
) -> KernelTerm:
    """The term of the threads' contact with a body.

    law    : K [N/m2], a [s/m]
    inside : elements that start inside the body, in its canister: they touch once they have come out
    """
    net = blocks.net
    held = np.isin(net.element_nodes, surface.attached).any(axis=1)
    wound = [number for reel in surface.wound for number in reel]
    element = np.setdiff1d(np.flatnonzero(~held), np.array(wound, dtype=np.int64))
    ends, length = net.element_nodes[element], net.reference_length[element]
    stiffness, damping = law
    spring = rubbing.ratio * stiffness * length
    mass = net.density[element] * net.area[element] * length
    rows = np.zeros((len(element), ROW))
    rows[:, 0] = np.where(np.isin(element, inside), -1.0, 0.0)
    kept = untouched(rows)
    cores: Cores = surface.cores
    data = ThreadContact(
        (3 * ends[:, 0]).astype(Index),
        (3 * ends[:, 1]).astype(Index),
        element,
        length,
        np.sqrt(net.area[element] / math.pi),
        spring,
        2.0 * rubbing.damping * np.sqrt(mass / spring),
        *cores,
        surface.middle,
        surface.radius,
        surface.allowed,
        surface.least,
        blocks.centre(body),
        blocks.attitude(body),
        blocks.spin(body),
        blocks.rate("contact/damping"),
        stiffness,
        damping,
        rubbing.friction,
        rubbing.slip_speed,
        kept,
        np.zeros((len(element), ROW)),
        np.zeros(7),
        np.zeros(len(element), dtype=np.int64),
        np.zeros(len(element)),
        np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]),
        np.zeros(len(element)),
        np.zeros((len(element), 6)),
        3 * np.unique(ends),
        np.zeros(np.unique(ends).size, dtype=np.int64),
        np.zeros(net.n_nodes, dtype=np.int64),
        np.zeros((3, 3)),
        np.zeros(3 * net.n_nodes),
        np.zeros((len(cores.kind), 6)),
        np.zeros((len(cores.kind), 2)),
        np.zeros(16 * len(cores.kind)),
        np.zeros(12),
        gauss_rules(2, 4, 8),
    )
    rates = _rates(blocks, body, surface, data)

    def wrong(values: Floats) -> str:
        return trouble(values, surface, body, lambda pair: f"element {element[pair]}")

    return KernelTerm(
        f"threads and {body}",
        add_thread_contact,
        data,
        thread_contact_potential,
        (*FRAMES, *DISTANCES, is_flat, *TOUCHING, *NEAR, *FRICTION, *_OWN),
        bodies=(body,) if body in blocks.free_bodies else (),
        stiffness_rate=rates[0],
        damping_rate=rates[1],
        memory=memory_of("threads", body, kept, wrong),
        remember=remember_thread_contact,
        internal=True,
    )


def _rates(blocks: Blocks, body: str, surface: Surface, data: ThreadContact) -> tuple[float, float]:
    """Bounds [1/s2], [1/s] of what contact adds to the eigenvalues, while nothing is too deep.

    The stiffness of a thread that touches all along, K L0 / 2 at each end, along and across the surface
    (kappa is not above 1). From (a - b)^2 <= (1 + c) a^2 + (1 + 1/c) b^2 with the best c follows that the
    body adds its own rate, of all threads at once at its farthest points.
    """
    net = blocks.net
    touching = np.zeros(net.n_nodes)
    np.add.at(touching, net.element_nodes[data.element], 0.5 * data.length[:, None])
    free = np.ones(net.n_nodes, dtype=bool)
    free[net.fixed_nodes] = False
    free[blocks.inertia.points] = False
    rate = float((data.stiffness * touching / net.mass)[free].max(initial=0.0))
    if body in blocks.free_bodies:
        number = blocks.free_bodies.index(body)
        arm = float(np.linalg.norm(surface.middle)) + surface.radius
        mobility = 1.0 / blocks.inertia.mass[number] + arm**2 / blocks.inertia.moments[number].min()
        rate += data.stiffness * float(data.length.sum()) * mobility
    return rate, 0.0


# Scalar loops, in the subset of Python that Numba compiles.


def add_thread_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces of all threads that touch the body, and what they would leave in the memory."""
    if not is_near(t, c):
        choose_near(t, x, v, c)
    now = c.now
    now[0] = 0.0
    now[1] = -1.0
    now[2] = 0.0
    now[5] = 0.0
    now[4] = max(now[4], 0.0)  # an attempt that was rejected may have been too deep
    number = int(c.look[0])
    now[3] = c.look[3] if number > 0 else 0.0
    now[6] = c.look[5]
    if number == 0:
        return
    turn_into(x, c.attitude, c.frame)
    own = c.own
    for one in range(int(c.look[4])):
        i = c.near_nodes[one]
        own[i], own[i + 1], own[i + 2] = place_in_body(x, i, c.centre, c.frame)
    for one in range(number):
        add_thread(x, v, c, c.near[one], force)


def add_thread(x: Any, v: Any, c: Any, k: int, force: Any) -> None:
    """Forces of the pair k."""
    i = c.first[k]
    j = c.second[k]
    own = c.own
    a = (own[i], own[i + 1], own[i + 2])
    b = (own[j], own[j + 1], own[j + 2])
    if is_clear(c, k, a, b):
        return
    sums = c.sums
    row = c.after[k]
    kept = c.kept
    row[0] = min(kept[5 * k], 0.0)
    m, clear = find_spans(c, c.thick[k], a, b)
    keep_clear(c, k, a, b, clear)
    if m == 0:
        row[0] = 0.0
        return
    w_a = velocity_against_body(v, i, c.centre, c.spin, c.frame, a)
    w_b = velocity_against_body(v, j, c.centre, c.spin, c.frame, b)
    if not touch(c, c.thick[k], w_a, w_b, m, sums):
        row[0] = 0.0
        return
    if kept[5 * k] < 0.0:
        return
    c.now[2] += 1.0
    c.now[5] += c.length[k] * sums[6]
    if sums[10] > c.now[0]:
        c.now[0] = sums[10]
        c.now[1] = k
    if sums[10] > c.allowed + c.thick[k]:
        c.now[4] = -1.0 - k
    length = c.length[k]
    on_b = (length * sums[3], length * sums[4], length * sums[5])
    on_a = (length * sums[0] - on_b[0], length * sums[1] - on_b[1], length * sums[2] - on_b[2])
    force[c.taken] += length * sums[8]
    if c.friction > 0.0:
        size = math.sqrt(sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2])
        rub = (0.0, 0.0, 0.0)
        at = 0.0
        if size > 0.0:
            at = sums[7] / sums[6]
            n = (sums[0] / size, sums[1] / size, sums[2] / size)
            push = length * sums[6]
            if c.slip_speed > 0.0:
                w = between(w_a, w_b, at)
                rub = regularised_friction(push, n, w, c)
            else:
                rub, at = rub_with_memory(c, k, push, n, a, b, w_a, w_b, at, row)
            w = between(w_a, w_b, at)
            force[c.taken + 1] -= rub[0] * w[0] + rub[1] * w[1] + rub[2] * w[2]
            on_a = along(on_a, rub, 1.0 - at)
            on_b = along(on_b, rub, at)
    push_point(force, i, c.centre, c.spin, c.frame, a, on_a)
    push_point(force, j, c.centre, c.spin, c.frame, b, on_b)


def is_clear(c: Any, k: int, a: Any, b: Any) -> bool:
    """True if no end of the pair k has moved as far as this was from the surface: it cannot touch.

    This follows from the places alone, so that neither the past nor a restart changes a bit of the forces;
    its row in `after` is that of one that does not touch.
    """
    clear = c.clear[k]
    if clear <= 0.0:
        return False
    seen = c.seen[k]
    p = a[0] - seen[0]
    q = a[1] - seen[1]
    r = a[2] - seen[2]
    f = b[0] - seen[3]
    g = b[1] - seen[4]
    h = b[2] - seen[5]
    return max(p * p + q * q + r * r, f * f + g * g + h * h) < clear * clear


def keep_clear(c: Any, k: int, a: Any, b: Any, clear: float) -> None:
    """Remember how far from the surface the pair k is at least [m], less what round-off may change."""
    c.clear[k] = clear - 1e-9 * c.radius
    seen = c.seen[k]
    seen[0], seen[1], seen[2] = a
    seen[3], seen[4], seen[5] = b


def rub_with_memory(
    c: Any, k: int, push: float, n: Any, a: Any, b: Any, w_a: Any, w_b: Any, middle: float, row: Any
) -> Any:
    """Friction (3) [N] of a pair, and where on the thread it acts; its next memory into `row`.

    n : (3) direction of the normal force `push` [N]; middle : where on the thread this acts
    """
    kept = c.kept
    first = 5 * k
    here = between(a, b, middle)
    spring, time = c.spring[k], c.relaxation[k]
    at = middle
    u = (0.0, 0.0, 0.0)
    remembers = kept[first] == 1.0
    if remembers:
        at = kept[first + 1]
        p = between(a, b, at)
        u = (p[0] - kept[first + 2], p[1] - kept[first + 3], p[2] - kept[first + 4])
    rub, slides = friction(push, n, u, between(w_a, w_b, at), spring, time, c)
    if slides or not remembers or not touches_at(c, at):
        at = middle
        u = shift_for(rub, n, between(w_a, w_b, middle), spring, time)
        remember_anchor(row, middle, along(here, u, -1.0))
    else:
        remember_anchor(row, at, (kept[first + 2], kept[first + 3], kept[first + 4]))
    return rub, at


def touches_at(c: Any, s: float) -> bool:
    """True if the thread that `touch` looked at last touches at s."""
    touches = False
    for n in range(c.kind.size):
        touches = touches or c.spans[n, 0] < s < c.spans[n, 1]
    return touches


def remember_anchor(row: Any, s: float, place: Any) -> None:
    """Put an anchor into a row of the memory."""
    row[0] = 1.0
    row[1] = s
    row[2] = place[0]
    row[3] = place[1]
    row[4] = place[2]


def between(a: Any, b: Any, s: float) -> Any:
    """(1 - s) a + s b."""
    return a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])


def along(a: Any, b: Any, s: float) -> Any:
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


def thread_contact_potential(x: Any, c: Any) -> float:
    """Energy [J] stored across the surface."""
    turn_into(x, c.attitude, c.frame)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.length.size):
        if c.kept[5 * k] >= 0.0:
            a = place_in_body(x, c.first[k], c.centre, c.frame)
            b = place_in_body(x, c.second[k], c.centre, c.frame)
            m, _ = find_spans(c, c.thick[k], a, b)
            if m > 0 and touch(c, c.thick[k], rest, rest, m, c.sums):
                total += c.length[k] * c.sums[9]
    return total


def remember_thread_contact(t: float, x: Any, v: Any, c: Any) -> None:
    """What the pairs that were looked at leave in the memory, and the largest depth.

    `add_thread_contact` has looked at this state last.
    """
    kept = c.kept
    for one in range(int(c.look[0])):
        keep_row(kept, c.near[one], c.after[c.near[one]])
    last = 5 * c.length.size
    remember_status(t, c, kept[last:])


_OWN = (add_thread, is_clear, keep_clear, rub_with_memory, touches_at, remember_anchor, between, along)

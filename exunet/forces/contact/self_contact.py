"""Contact of the threads of a net with each other."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces.blocks import Blocks
from exunet.forces.contact.broad_phase import KEPT, remember_touch, remember_wrong
from exunet.forces.contact.estimate import damping_rate, speed_of_threads
from exunet.forces.contact.segment_segment import (
    PAIRS,
    TOGETHER,
    are_neighbours,
    distance_of,
    dot,
    list_is_right,
    list_pairs,
    longest_way,
    passed,
    place_of,
    point_of,
    press,
    way,
)
from exunet.forces.contact.status import series_of, status_of, untouched
from exunet.forces.loops import Index
from exunet.forces.terms import DiscreteState, KernelTerm
from exunet.net.arrays import Net

NAME = "self_contact"
LEAST = 1.0 / math.sqrt(3.0)  # of the reach: where threads side by side push hardest, the nearest they may be
AROUND = 6  # threads that have room around one of the same radius
SKIN = 0.25  # of the mean length of the elements
FEW, ROOM = 8, 64  # pairs in the list, for each element: as a rule, and at most
POINTS = 16  # of the outer rule, see `segment_segment.press`
TOO_DEEP, PASSED, TOO_MANY = 1.0, 2.0, 3.0


class Together(NamedTuple):
    """Elements that may touch each other, the law, the discrete state and work space.

    first, second : (m,) 3 x nodes at the ends
    length     : (m,) L0 [m]
    thick      : (m,) radius [m]
    nodes      : (k,) where the coordinates of all nodes begin
    neighbours : pairs of elements that do not touch, though they share no node, increasing
    initial    : (b,) pairs that were nearer than their reach at the start, increasing
    initial_reach : (b,) how far apart their axes were then [m], which is their reach
    stiffness, damping : K [N/m2], a [s/m]
    least      : of the reach, the nearest that elements may be
    taken      : where in force the rate of the energy that damping takes stands
    skin       : the most of the list [m]
    few        : pairs that the list should not exceed
    kept       : (3 n_nodes + STATUS,) the discrete state: where the nodes were at the end of the last step
                 [m], the status
    now        : (8,) of the state that was looked at last: largest depth [m], its pair, pairs that touch; not
                 used; 1 + the number of a pair that is too near, or 0; sum of the forces [N];
                 not used; energy stored [J]
    pairs      : list of the pairs that are near; a pair of the elements k < l has the number k m + l
    gaps       : how far apart their surfaces were when they were listed [m]
    look       : (4,) how many they are, skin of the list [m], 1.0 if there are more than there is room for,
                 how far nodes have moved since, but for a common shift [m]
    listed_at  : (3 n_nodes,) where the nodes were when it was made
    order      : (m,) the elements, as they were swept last; begins : (m,) by which they were sorted [m]
    none       : (0,)
    boxes, sums, splits, ends, rule : work space and rule, see `segment_segment`
    """

    first: NDArray[Index]
    second: NDArray[Index]
    length: Floats
    thick: Floats
    nodes: Ints
    neighbours: Ints
    initial: Ints
    initial_reach: Floats
    stiffness: float
    damping: float
    least: float
    taken: int
    skin: float
    few: int
    kept: Floats
    now: Floats
    pairs: Ints
    gaps: Floats
    look: Floats
    listed_at: Floats
    order: Ints
    begins: Floats
    none: Floats
    boxes: Floats
    sums: Floats
    splits: Floats
    ends: Floats
    rule: Floats


def threads_together(blocks: Blocks, thick: Floats, stiffness: float, damping: float) -> KernelTerm:
    """The term of the contact of elements of the net and its strings, of radii (m,); K [N/m2], a [s/m]."""
    net = blocks.net
    number = net.n_net_elements
    ends, length = net.element_nodes[:number], net.reference_length[:number]
    position = blocks.position[: net.n_nodes].ravel()
    room = min(number * (number - 1) // 2, max(ROOM * number, 10_000))
    x, weight = np.polynomial.legendre.leggauss(POINTS)
    angle = 0.5 * math.pi * x
    data = Together(
        first=(3 * ends[:, 0]).astype(Index),
        second=(3 * ends[:, 1]).astype(Index),
        length=length,
        thick=thick,
        nodes=3 * np.unique(ends),
        neighbours=neighbours_of(net, thick),
        initial=np.zeros(0, dtype=np.int64),
        initial_reach=np.zeros(0),
        stiffness=stiffness,
        damping=damping,
        least=LEAST,
        taken=blocks.rate(f"{NAME}/damping"),
        skin=max(SKIN * float(length.mean()), 2.0 * float(thick.max())),
        few=FEW * number,
        kept=np.zeros(0),
        now=np.zeros(8),
        pairs=np.zeros(room, dtype=np.int64),
        gaps=np.zeros(room),
        look=np.zeros(4),
        listed_at=position.copy(),
        order=np.arange(number),
        begins=np.zeros(number),
        none=np.zeros(0),
        boxes=np.zeros((number, 6)),
        sums=np.zeros(10),
        splits=np.zeros(8),
        ends=np.zeros((4, 3)),
        rule=np.stack([np.sin(angle), 0.5 * math.pi * weight * np.cos(angle)]),
    )
    initial, reach = _initial_pairs(position, data)
    kept = untouched(position)
    data = data._replace(initial=initial, initial_reach=reach, kept=kept)
    data.pairs[: len(initial)] = initial[:room]  # the list, until something moves
    data.look[:3] = min(len(initial), room), 0.0, float(len(initial) > room)
    wrong = partial(trouble, data=data)
    discrete = DiscreteState(
        f"{NAME}/threads", kept, kept_in="kept", wrong=wrong, series=series_of(f"{NAME}/")
    )
    return KernelTerm(
        "threads of the net",
        add_together,
        data,
        together_potential,
        (*PAIRS, *TOGETHER, *KEPT, add_pair, reach_of, is_watched, press_pair),
        stiffness_rate=(rate := _stiffness_rate(net, stiffness)),
        damping_rate=damping_rate(damping, rate, speed_of_threads(blocks)),
        discrete=discrete,
        remember=remember_together,
        internal=True,
    )


def neighbours_of(net: Net, thick: Floats) -> Ints:
    """Pairs of elements without a common node that could touch in a bend only that is sharper than a thread.

    Those whose way along the threads is at most half a turn of a thread that lies at itself, pi R / 2.
    """
    number, reach = net.n_net_elements, 2.0 * float(thick.max())
    ends, length = net.element_nodes[:number], net.reference_length[:number]
    most = 0.5 * math.pi * reach
    if not (length <= most).any():
        return np.zeros(0, dtype=np.int64)
    graph = scipy.sparse.coo_array(
        (length, (ends[:, 0], ends[:, 1])), shape=(net.n_nodes, net.n_nodes)
    ).tocsr()
    found = set()
    for k, own in enumerate(ends):
        near = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=own, limit=most, min_only=True)
        for m in np.flatnonzero((near[ends] <= most).any(axis=1)):
            way = near[ends[m]].min()
            if m > k and 0.0 < way <= 0.5 * math.pi * (thick[k] + thick[m]):
                found.add(k * number + int(m))
    return np.array(sorted(found), dtype=np.int64)


def _initial_pairs(position: Floats, data: Together) -> tuple[Ints, Floats]:
    """Pairs that overlap at the start, and how far apart their axes are [m]."""
    number = len(data.length)
    found = [
        (k * number + m, apart)
        for k, m in zip(*_meeting(position, data), strict=True)
        if not are_neighbours(data, k, m)
        and (apart := distance_of(position, data, k, m)) < data.thick[k] + data.thick[m]
    ]
    pairs = sorted(found)
    return np.array([pair for pair, _ in pairs], dtype=np.int64), np.array([apart for _, apart in pairs])


def _meeting(position: Floats, data: Together) -> tuple[Ints, Ints]:
    """Numbers k < m of the elements around which boxes meet."""
    ends = position[np.stack([data.first, data.second])[..., None] + np.arange(3)]
    low, high = ends.min(axis=0) - data.thick[:, None], ends.max(axis=0) + data.thick[:, None]
    axis = int(np.argmax(np.ptp(low, axis=0)))
    order = np.argsort(low[:, axis], kind="stable")
    until = np.searchsorted(low[order, axis], high[order, axis], side="right")
    found = [np.zeros((2, 0), dtype=np.int64)]
    for place, k in enumerate(order):
        others = order[place + 1 : until[place]]
        meet = (low[others] <= high[k]).all(axis=1) & (low[k] <= high[others]).all(axis=1)
        both = others[meet]
        found.append(np.stack([np.minimum(both, k), np.maximum(both, k)]))
    pairs = np.concatenate(found, axis=1)
    return pairs[0], pairs[1]


def _stiffness_rate(net: Net, stiffness: float) -> float:
    """Bound [1/s2] of what contact adds to the eigenvalues, with `AROUND` threads along all of each element.

    Per length of one thread the second derivative across a straight one is at most K; as (a - b)^2 is at most
    2 a^2 + 2 b^2, each thread has twice that of its own motion, K L0 at each end.
    """
    number = net.n_net_elements
    touching = np.zeros(net.n_nodes)
    np.add.at(touching, net.element_nodes[:number], net.reference_length[:number, None])
    free = np.ones(net.n_nodes, dtype=bool)
    free[net.fixed_nodes] = False
    return AROUND * float((stiffness * touching / net.mass)[free].max(initial=0.0))


def trouble(values: Floats, data: Together) -> str:
    """Return the error message of a discrete state; "": no error."""
    status = status_of(values)
    when = f"at t = {status.wrong_time:.6g} s"
    if status.wrong == TOO_MANY:
        return (
            f"more than {len(data.pairs):,} pairs of elements touch each other {when}: more than contact of "
            f"threads can look at. Give a smaller effects.{NAME}.radius, or fewer elements"
        )
    k, m = divmod(int(status.wrong_pair), len(data.length))
    advice = f"Give a larger effects.{NAME}.stiffness or radius, or smaller steps"
    if status.wrong == PASSED:
        return f"elements {k} and {m} have passed through each other in the step that ends {when}. {advice}"
    if status.wrong == TOO_DEEP:
        nearest = LEAST * reach_of(data, int(status.wrong_pair), k, m)
        return (
            f"the axes of elements {k} and {m} are nearer than {nearest:.3g} m {when}. Contact yields "
            f"there, and they may pass through each other. {advice}"
        )
    return ""


# Scalar loops, in the subset of Python that Numba compiles.


def add_together(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces of all elements that touch each other."""
    if not list_is_right(x, c):
        list_pairs(x, c)
    now = c.now
    for n in range(now.size):
        now[n] = 0.0
    now[1] = -1.0
    for item in range(int(c.look[0])):
        if c.gaps[item] <= 2.0 * c.look[3]:
            add_pair(x, v, c, c.pairs[item], force)


def add_pair(x: Any, v: Any, c: Any, pair: int, force: Any) -> None:
    """Forces of a pair, those on one element the opposite of those on the other."""
    number = c.length.size
    k, m = pair // number, pair % number
    reach = reach_of(c, pair, k, m)
    if not press_pair(x, c, k, m, reach):
        return
    sums, now = c.sums, c.now
    size = c.stiffness / (math.pi * reach * reach) * c.length[k] * c.length[m]
    normal_force = size * math.sqrt(sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2])
    depth = reach - distance_of(x, c, k, m)
    now[2] += 1.0
    if depth > now[0]:
        now[0] = depth
        now[1] = pair
    if is_watched(c, k, m, reach) and reach - depth < c.least * reach:
        now[4] = 1.0 + pair
    i, j, p, q = c.first[k], c.second[k], c.first[m], c.second[m]
    damped = 1.0
    if c.damping > 0.0 and normal_force > 0.0:
        power = 0.0
        for axis in range(3):
            on_j, on_q = size * sums[3 + axis], size * sums[6 + axis]
            both = size * sums[axis]
            power += (both - on_j) * v[i + axis] + on_j * v[j + axis]
            power -= (both - on_q) * v[p + axis] + on_q * v[q + axis]
        rate = -power / normal_force
        damped = max(1.0 + c.damping * rate, 0.0)
        force[c.taken] += (damped - 1.0) * normal_force * rate
    now[5] += damped * normal_force
    now[7] += size * sums[9] / 3.0
    size *= damped
    for axis in range(3):
        on_j, on_q = size * sums[3 + axis], size * sums[6 + axis]
        both = size * sums[axis]
        force[i + axis] += both - on_j
        force[j + axis] += on_j
        force[p + axis] -= both - on_q
        force[q + axis] -= on_q


def press_pair(x: Any, c: Any, k: int, m: int, reach: float) -> bool:
    """`press` of the elements k and m, the inner integral along the longer one; the first is k."""
    a, b, p, q = (
        point_of(x, c.first[k]),
        point_of(x, c.second[k]),
        point_of(x, c.first[m]),
        point_of(x, c.second[m]),
    )
    d, e = way(a, b), way(p, q)
    if dot(e, e) >= dot(d, d):
        return press(c, a, b, p, q, reach)
    if not press(c, p, q, a, b, reach):
        return False
    sums = c.sums
    for axis in range(3):
        sums[axis] = -sums[axis]
        on_k = -sums[6 + axis]
        sums[6 + axis] = -sums[3 + axis]
        sums[3 + axis] = on_k
    return True


def reach_of(c: Any, pair: int, k: int, m: int) -> float:
    """From where on the elements k and m push each other [m]; 0.0: they crossed at the start."""
    if c.initial.size > 0:
        place = place_of(c.initial, pair)
        if place >= 0:
            return c.initial_reach[place]
    return c.thick[k] + c.thick[m]


def is_watched(c: Any, k: int, m: int, reach: float) -> bool:
    """True if a run stops where the elements are too near: not if they began at less than half."""
    return reach >= 0.5 * (c.thick[k] + c.thick[m])


def together_potential(x: Any, c: Any) -> float:
    """Energy [J] stored."""
    if not list_is_right(x, c):
        list_pairs(x, c)
    number = c.length.size
    total = 0.0
    for item in range(int(c.look[0])):
        pair = c.pairs[item]
        k, m = pair // number, pair % number
        reach = reach_of(c, pair, k, m)
        if press_pair(x, c, k, m, reach):
            size = c.stiffness / (math.pi * reach * reach) * c.length[k] * c.length[m]
            total += size * c.sums[9] / 3.0
    return total


def remember_together(t: float, x: Any, v: Any, c: Any) -> None:
    """At the end of a step: reported extremes, pairs that passed through each other, and where the nodes are.

    `add_together` has looked at this state last.
    """
    now, number, last = c.now, c.length.size, c.listed_at.size
    before, status = c.kept[:last], c.kept[last:]
    remember_touch(t, now, status)
    remember_wrong(t, 3.0 * c.look[2], 0.0, status)
    if now[4] > 0.0:
        remember_wrong(t, 1.0, now[4] - 1.0, status)
    near = 2.0 * c.look[3] + 4.0 * longest_way(x, before)
    for item in range(int(c.look[0])):
        if c.gaps[item] > near:
            continue
        pair = c.pairs[item]
        k, m = pair // number, pair % number
        reach = reach_of(c, pair, k, m)
        if is_watched(c, k, m, reach) and passed(x, before, c, k, m, c.least * reach):
            remember_wrong(t, 2.0, float(pair), status)
    for n in range(last):
        before[n] = x[n]

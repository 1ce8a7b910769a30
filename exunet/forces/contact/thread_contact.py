"""Contact of the threads of a net, and of tethers, with a rigid body."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces.blocks import Blocks
from exunet.forces.contact.broad_phase import NEAR, RESULTANT, begin_resultant, end_resultant
from exunet.forces.contact.estimate import damping_rate, friction_rate, speed_of_net
from exunet.forces.contact.law import FRICTION, ContactLaw, Friction, sum_place, touched_body
from exunet.forces.contact.segment_surface import (
    PIECES,
    THREADS,
    TOUCHING,
    add_mesh_contact,
    apply_to_element,
    ends_at,
    ends_now,
    find_spans,
    is_clear,
    keep_clear,
    mesh_contact_potential,
    places_now,
    remember_thread_contact,
    speeds_now,
    touch,
    touches_at,
)
from exunet.forces.contact.signed_distance import DISTANCES, FRAMES, SAMPLED_DISTANCES, is_flat, turn_into
from exunet.forces.contact.status import discrete_state_of, trouble, untouched
from exunet.forces.cores import SAMPLED, Cores, Surface, TouchedBody
from exunet.forces.loops import Index
from exunet.forces.terms import Function, KernelTerm

# Of a cell, by which the ends of a thread may move before its pieces are listed anew: a longer way lists them
# more rarely, but lets more of them come near. Of 0.012 to 0.8 this takes least time on a wrapped satellite.
SKIN = 0.025
ROW = 5  # numbers of a pair in the discrete state, see `segment_surface.remember_anchor`


def gauss_rules(*numbers: int) -> Floats:
    """(2, sum n) places in [0, 1] and weights of Gauss and Legendre's rules one after the other."""
    rules = [np.polynomial.legendre.leggauss(n) for n in numbers]
    return np.concatenate([np.stack([0.5 + 0.5 * x, 0.5 * w]) for x, w in rules], axis=1)


class ContactElements(NamedTuple):
    """Elements that may touch a body, (m,) each.

    first, second : 3 x nodes at the ends
    element  : numbers of the elements
    length   : L0 [m]
    thick    : radius of the thread [m]
    pieces   : into how many it is cut to touch a sampled core
    spring, relaxation : k_t [N/m] and theta [s] of friction
    """

    first: NDArray[Index]
    second: NDArray[Index]
    element: Ints
    length: Floats
    thick: Floats
    pieces: Ints
    spring: Floats
    relaxation: Floats


class Near(NamedTuple):
    """Pairs of threads and body that are near each other, which alone are evaluated.

    pairs    : (m,) their numbers, in order
    listed   : (m,) 1.0 for these, and 2.0 more for those of the choice before
    look     : (7,) how many there are, when they were chosen [s], how long they are right [s], their
               largest speed against the body then [m/s], how many nodes they have, which is the fastest, and
               when the choice before was made [s]
    clear    : (m,) how far each pair was at least from the surface when this was computed last [m]; 0.0:
               it may touch
    seen     : (m, 6) where its ends were then, in the body's axes [m]
    listed_pieces : (m,) how many of its pieces are near a sampled core; pieces : (m, n) these; apart : (m, n)
               how much farther away each was than what touches [m]; right until an end moves by `clear`,
               at most by `skin`
    nodes    : (k,) where the coordinates of the nodes of all pairs begin
    near_nodes : (k,) of those that are evaluated, as many as `look` says; wanted : (n_nodes,) 1 for these
    """

    pairs: Ints
    listed: Floats
    look: Floats
    clear: Floats
    seen: Floats
    listed_pieces: Ints
    pieces: Ints
    apart: Floats
    skin: float
    nodes: Ints
    near_nodes: Ints
    wanted: Ints


class ThreadWorkspace(NamedTuple):
    """Work space of a contact of threads, and Gauss's rules.

    frame    : (3, 3) the rotation of the body
    own      : (3 n_nodes,) places of the nodes in the body's axes [m]
    lines    : (n, 6) the thread in the axes of each core, where it begins and to where it goes
    spans, splits, sums : see `find_spans` and `touch`
    found    : (n, 8) distance and gradient at both places of each piece on a sampled core
    rule     : as of `gauss_rules`
    """

    frame: Floats
    own: Floats
    lines: Floats
    spans: Floats
    splits: Floats
    found: Floats
    sums: Floats
    rule: Floats


class ThreadContact(NamedTuple):
    """Contact of threads with a body.

    taken    : where in force the rates of the energies that damping and friction take stand
    kept     : (ROW m + STATUS,) the discrete state
    after    : (m, ROW) what the discrete state would be after the state that was evaluated last
    now      : (14,) of that state: largest depth [m], its pair, pairs that touch, largest speed against the
               body of what is near [m/s]; 1 + the number of a pair that came into reach unseen, less than 0
               of one that is too deep, or 0; sum of the forces across the surface [N]; the fastest pair;
               energy stored [J]; force and torque as of `Status` [N], [N m]
    """

    threads: ContactElements
    cores: Cores
    body: TouchedBody
    law: ContactLaw
    taken: int
    kept: Floats
    after: Floats
    now: Floats
    near: Near
    work: ThreadWorkspace


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
    pieces = np.ones(len(element), dtype=np.int64)
    if cores.kind[0] == SAMPLED:
        pieces = np.ceil(length / cores.samples.cell).astype(np.int64)
    number, most, nodes = len(element), int(pieces.max(initial=1)), np.unique(ends)
    threads = ContactElements(
        first=(3 * ends[:, 0]).astype(Index),
        second=(3 * ends[:, 1]).astype(Index),
        element=element,
        length=length,
        thick=np.sqrt(net.area[element] / math.pi),
        pieces=pieces,
        spring=spring,
        relaxation=2.0 * rubbing.damping * np.sqrt(mass / spring),
    )
    near = Near(
        pairs=np.zeros(number, dtype=np.int64),
        listed=np.zeros(number),
        look=np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]),
        clear=np.zeros(number),
        seen=np.zeros((number, 6)),
        listed_pieces=np.zeros(number, dtype=np.int64),
        pieces=np.zeros((number, most), dtype=np.int64),
        apart=np.zeros((number, most)),
        skin=SKIN * cores.samples.cell,
        nodes=3 * nodes,
        near_nodes=np.zeros(nodes.size, dtype=np.int64),
        wanted=np.zeros(net.n_nodes, dtype=np.int64),
    )
    work = ThreadWorkspace(
        frame=np.zeros((3, 3)),
        own=np.zeros(3 * net.n_nodes),
        lines=np.zeros((len(cores.kind), 6)),
        spans=np.zeros((len(cores.kind), 2)),
        splits=np.zeros(max(16 * len(cores.kind), most)),
        found=np.zeros((most, 8)),
        sums=np.zeros(12),
        rule=gauss_rules(2, 4, 8),
    )
    data = ThreadContact(
        threads=threads,
        cores=cores,
        body=touched_body(blocks, body, surface, surface.allowed),
        law=ContactLaw(stiffness, damping, 1.0, rubbing.friction, rubbing.slip_speed),
        taken=blocks.rate("contact/damping"),
        kept=kept,
        after=np.zeros((number, ROW)),
        now=np.zeros(14),
        near=near,
        work=work,
    )
    rates = _rates(blocks, body, surface, data, rubbing)

    wrong = partial(trouble, surface=surface, body=body, what="element", numbers=element)
    add, potential, own = add_thread_contact, thread_contact_potential, _OF_SOLIDS
    if cores.kind[0] == SAMPLED:
        add, potential, own = add_mesh_contact, mesh_contact_potential, _OF_MESHES
    return KernelTerm(
        f"threads and {body}",
        add,
        data,
        potential,
        (*FRAMES, *DISTANCES, sum_place, *NEAR, *RESULTANT, *FRICTION, *THREADS, *own),
        bodies=(body,) if body in blocks.free_bodies else (),
        stiffness_rate=rates[0],
        damping_rate=rates[1],
        friction_rate=rates[2],
        discrete=discrete_state_of("threads", body, kept, wrong),
        remember=remember_thread_contact,
        internal=True,
    )


def _rates(
    blocks: Blocks, body: str, surface: Surface, data: ThreadContact, rubbing: Friction
) -> tuple[float, float, float]:
    """Bounds [1/s2], [1/s], [1/s] of what contact adds to the eigenvalues, while nothing is too deep.

    The stiffness of a thread that touches all along, K L0 / 2 at each end, along and across the surface
    (kappa is not above 1). From (a - b)^2 <= (1 + c) a^2 + (1 + 1/c) b^2 with the best c follows that the
    body adds its own rate, of all threads at once at its farthest points. Over an inner edge of a mesh the
    direction of a force F turns by `Surface.bends`, which adds F times that. Damping and smooth friction: see
    `impact`.
    """
    net = blocks.net
    touching = np.zeros(net.n_nodes)
    np.add.at(touching, net.element_nodes[data.threads.element], 0.5 * data.threads.length[:, None])
    depth = float(data.body.allowed + data.threads.thick.max(initial=0.0))
    stiffness = data.law.stiffness * (1.0 + surface.bends * depth)
    free = np.ones(net.n_nodes, dtype=bool)
    free[net.fixed_nodes] = False
    free[blocks.inertia.points] = False
    rate = float((stiffness * touching / net.mass)[free].max(initial=0.0))
    if body in blocks.free_bodies:
        number = blocks.free_bodies.index(body)
        arm = _arm(surface)
        mobility = 1.0 / blocks.inertia.mass[number] + arm**2 / blocks.inertia.moments[number].min()
        rate += stiffness * float(data.threads.length.sum()) * mobility
    speed = speed_of_net(blocks, body, _arm(surface))
    return rate, damping_rate(data.law.damping, rate, speed), friction_rate(rubbing, rate, speed)


def _arm(surface: Surface) -> float:
    """From the centre of mass to the farthest of a body [m]."""
    return float(np.linalg.norm(surface.middle)) + surface.radius


# Scalar loops, in the subset of Python that Numba compiles.


def add_thread_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces of all threads that touch the body, and what they would leave in the discrete state."""
    begin_resultant(c, force)
    for item in range(places_now(t, x, v, c)):
        k = c.near.pairs[item]
        a, b = ends_now(c, k)
        if is_clear(c, k, a, b):
            continue
        m, clear = find_spans(c, c.threads.thick[k], a, b)
        keep_clear(c, k, a, b, clear)
        if m > 0:
            w_a, w_b = speeds_now(v, c, k, a, b)
            if touch(c, c.threads.thick[k], w_a, w_b, m, c.work.sums):
                holds = c.kept[5 * k] == 1.0 and touches_at(c, c.kept[5 * k + 1])
                apply_to_element(c, k, force, a, b, w_a, w_b, holds)
    end_resultant(c, force)


def thread_contact_potential(x: Any, c: Any) -> float:
    """Energy [J] stored across the surface."""
    turn_into(x, c.body.attitude, c.work.frame)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.threads.length.size):
        if c.kept[5 * k] >= 0.0:
            a, b = ends_at(x, c, k)
            m, _ = find_spans(c, c.threads.thick[k], a, b)
            if m > 0 and touch(c, c.threads.thick[k], rest, rest, m, c.work.sums):
                total += c.threads.length[k] * c.work.sums[9]
    return total


_OF_SOLIDS: tuple[Function, ...] = (is_flat, *TOUCHING, touches_at)
_OF_MESHES: tuple[Function, ...] = (*SAMPLED_DISTANCES, *PIECES)

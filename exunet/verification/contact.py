"""Rung 9: contact in both codes, at random states in which what touches presses in, and over a run.

The reference finds where a thread touches, integrates along it, and keeps what friction remembers in ways of
its own (`reference_impl.contacts`, `quadrature`, `friction`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from exunet.bodies.overlap import least_along
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Solid
from exunet.bodies.touched import core_of_solid
from exunet.forces.contact.sphere_contact import bullets_of, nodes_of
from exunet.forces.contact.status import status_of
from exunet.forces.effects import switched_on
from exunet.forces.terms import copied
from exunet.model.system import State
from exunet.net.arrays import Ints, Net
from exunet.studies.both_codes import BothCodes, Floats
from exunet.verification.check import Check, difference, left_out
from exunet.verification.tolerances import CONTACT, CONTACT_COUNT, CONTACT_RUN
from reference_impl import contact_forces
from reference_impl.friction import nothing

CONTACT_CASES = "verification/contact"  # below cases/
SEED = 20261123
STATES = 40
SPEED = 1.0  # m/s, of nodes, and rad/s: some of what touches comes, some goes
QUANTITIES = {
    "forces on nodes": "N",
    "force on the body": "N",
    "torque on the body": "N m",
    "power taken": "W",
    "energy stored": "J",
}


def at_states(case: BothCodes, count: int = STATES) -> Iterator[Check]:
    """What contact does to nodes and body, takes and stores, as the law is written and in the reference.

    exunet's functions are called as they are; every form makes its own from their text.
    """
    random = np.random.default_rng(SEED)
    ours, theirs, touching, deepest = [], [], 0.0, 0.0
    for state in pressed_states(case, count, random):
        found, number, depth = _of_exunet(case, state)
        ours.append(found)
        theirs.append(_of_reference(case, state))
        touching, deepest = touching + number, max(deepest, depth)
    for k, (name, unit) in enumerate(QUANTITIES.items()):
        a, b = (np.array([item[k] for item in side]) for side in (ours, theirs))
        axes = ("state", "node", "xyz") if a.ndim == 3 else ("state", "number")
        yield difference(f"{name}, {count} random states", a, b, CONTACT, axes, unit)
    told = f"{touching / count:.1f} of them contact_forces, down to {deepest:.3g} m"
    yield Check("states in which nothing touches", float(touching < count), CONTACT_COUNT, told)


def pressed_states(case: BothCodes, count: int, random: np.random.Generator) -> Iterator[State]:
    """Random states in which each thread, node or bullet is as deep in one solid of the body as it may be.

    Lines are moved along the direction of their distance from a core, which then changes by just as much.
    """
    start = case.start
    (name,) = start.system.blocks.surfaces
    allowed = start.system.blocks.surfaces[name].allowed
    body = next(item for item in start.system.bodies if item.name == name)
    assert body.shape is not None
    cores = [_core(solid, body.shape.edge_radius) for solid in body.shape.solids]
    net = start.net
    lines, thick = _lines(_contact(case), net)
    size = 0.5 * float(net.reference_length.min())
    for _ in range(count):
        own = random.normal(size=(net.n_nodes, 3))  # in the body's frame
        for (i, j), radius in zip(lines, thick, strict=True):
            own[i], own[j] = _pressed_line(cores, float(radius), allowed, size * float(i != j), random)
        attitude = random.normal(size=4)
        bodies = replace(
            start.state.bodies,
            position=random.normal(size=(1, 3)),
            attitude=attitude[None] / np.linalg.norm(attitude),
            velocity=SPEED * random.normal(size=(1, 3)),
            angular_velocity=SPEED * random.normal(size=(1, 3)),
        )
        seen = np.array([body.in_principal_axes(tuple(place)) for place in own])
        position = bodies.position + seen @ rotation_matrix(bodies.attitude[0]).T
        velocity = bodies.velocity + SPEED * random.normal(size=position.shape)
        yield replace(start.state, position=position, velocity=velocity, bodies=bodies)


def _lines(contact: Any, net: Net) -> tuple[Ints, Floats]:
    """What touches, as ends of lines (m, 2), which of points are the same, and their radii (m,) [m]."""
    if contact.threads:
        return net.element_nodes, np.sqrt(net.area / np.pi)
    balls = [(nodes_of(net), contact.node_radius)] * bool(contact.nodes)
    balls += [(bullets_of(net), contact.bullet_radius)] * bool(contact.bullets)
    nodes = np.concatenate([ball.nodes for ball, _ in balls])
    thick = np.concatenate([np.full(len(ball.nodes), radius) for ball, radius in balls])
    return np.stack([nodes] * 2, axis=1), thick


def _contact(case: BothCodes) -> Any:
    """Its `[effects.contact]`."""
    return switched_on(case.start.scene.effects)["contact"]


def _pressed_line(
    cores: list[tuple[Solid, float]], radius: float, allowed: float, size: float, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """Ends of a line that is 0 to 2 x `size` [m] long on each side and presses in by up to `allowed`."""
    while True:
        middle, half = random.normal(size=3), size * random.normal(size=3)
        begin, end = middle - half, middle + half
        chosen, rounding = cores[random.integers(len(cores))]
        depth = allowed * random.uniform(0.01, 0.9)
        for _ in range(2):  # the place that is nearest may be found to 1e-9 of the length only
            part, gap = _nearest(chosen, begin, end)
            place = begin + part * (end - begin)
            shift = (rounding + radius - depth - gap) * _outwards(chosen, place)
            begin, end = begin + shift, end + shift
        gaps = [_nearest(core, begin, end)[1] - around for core, around in cores]
        if min(gaps) > radius - allowed and gap > 0.0:
            return begin, end


def _nearest(core: Solid, begin: Floats, end: Floats) -> tuple[float, float]:
    """Where along a line it is nearest to a core, and how near [m]."""
    if np.array_equal(begin, end):
        return 0.0, float(core.distance(begin[None])[0])
    gap = float(least_along(core.distance, begin[None], end[None])[0])
    parts = np.linspace(0.0, 1.0, 2001)
    values = core.distance(begin + parts[:, None] * (end - begin))
    return float(parts[int(values.argmin())]), gap


def _outwards(core: Solid, place: Floats, by: float = 1e-6) -> Floats:
    """The direction in which the distance of a place from a core grows, by differences."""
    steps = by * np.eye(3)
    slope = core.distance(place + steps) - core.distance(place - steps)
    return np.asarray(slope / (np.linalg.norm(slope) or 1.0))


def _core(solid: Solid, edge: float) -> tuple[Solid, float]:
    """The core of a box or a sphere, which is all that the reference knows, and its rounding [m]."""
    (a, b, c), _, rounding = core_of_solid(solid, edge)
    return replace(solid, numbers=(2.0 * a, 2.0 * b, 2.0 * c)), rounding


def _of_exunet(case: BothCodes, state: State) -> tuple[list[Floats], float, float]:
    """`QUANTITIES`, how many contact_forces, and how deep [m]."""
    system = case.start.system
    blocks, n = system.blocks, case.start.net.n_nodes
    x, v = system.layout.pack(state.moving)
    force, stored, touching, depth = np.zeros(blocks.n_force), 0.0, 0.0, 0.0
    (name,) = blocks.surfaces
    for term in system.forces.kernels:
        if term.memory is None or not term.memory.name.startswith("contact/"):
            continue
        data = copied(term.data)  # which has work space
        term.add(state.time, x, v, data, force)
        assert term.potential is not None
        stored += float(term.potential(x, data))
        assert term.remember is not None
        term.remember(state.time, x, v, data)
        status = status_of(getattr(data, term.memory.kept_in))
        touching, depth = touching + status.touching, max(depth, status.depth)
    turn = rotation_matrix(state.bodies.attitude[0])
    centre, spin, taken = blocks.centre(name), blocks.spin(name), blocks.rate("contact/damping")
    found = [force[: 3 * n].reshape(n, 3), force[centre : centre + 3], turn @ force[spin : spin + 3]]
    return [*found, force[taken : taken + 2], np.array([stored])], touching, depth


def _of_reference(case: BothCodes, state: State) -> list[Floats]:
    """`QUANTITIES`."""
    system, theirs = case.theirs.system, case.theirs_at(state.moving)
    contacts, bodies = system.contacts, theirs.bodies
    assert contacts is not None
    views = contact_forces.view_of_states(system, theirs.x, theirs.v, bodies, None, False)
    memory = nothing(contacts.pairs) if contacts.law.sticks else None
    attitude = bodies.attitude[system.bodies.rigid]
    found = contact_forces.touched(contacts, views, attitude, memory, np.zeros((contacts.pairs, 3)))
    force = sum((one for _, one in found.on_nodes), np.zeros_like(theirs.x))
    torque = -np.cross(theirs.x - bodies.position[system.bodies.rigid[0]], force).sum(axis=0)
    on_nodes = case.from_reference(force)
    return [
        on_nodes,
        -force.sum(axis=0),
        torque,
        found.taken,
        np.array([contact_forces.stored(contacts, views)]),
    ]


def over_a_run(case: BothCodes) -> Iterator[Check]:
    """Compare the places of nodes and body at four times of a whole run, in exunet's quickest form."""
    if _contact(case).threads:
        yield left_out("whole runs", "the reference takes many minutes where threads touch parts of a body")
        return
    times = np.linspace(0.0, case.start.scene.time.end, 4)
    a, b = case.fastest().run_exunet(times), case.run_reference(times)
    axes = ("time", "point", "xyz")
    yield difference("places over a run", a.position, b.position, CONTACT_RUN, axes, "m", scale=case.size)

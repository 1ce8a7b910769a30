"""Random nets, which both codes weave alike, and random states at which both codes are compared."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from exunet.base.errors import InputError
from exunet.bodies.distance import least_along
from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Solid
from exunet.bodies.touched import core_as_solid
from exunet.forces.contact.self_contact import LEAST
from exunet.forces.contact.sphere_contact import bullets_of, nodes_of
from exunet.forces.effects.contact import Contact
from exunet.forces.effects.self_contact import SelfContact
from exunet.model.ejection import HELD
from exunet.model.system import State, System
from exunet.net.arrays import Ints, Net
from exunet.net.closing import NAME
from exunet.simulation.preparation import Start
from exunet.studies.both_codes import BothCodes, both_of_text
from exunet.verification.check import Check, Floats, difference, worst_of
from exunet.verification.tolerances import CONNECTIVITY, TOPOLOGY

TOPOLOGIES = ("square", "rectangular", "hexagonal", "radial", "cut", "explicit")


def random_case(random: np.random.Generator, topology: str | None = None) -> tuple[str, str]:
    """Draw a valid case: its topology, unless given, and its TOML text."""
    kind = topology or str(random.choice(TOPOLOGIES))
    net: dict[str, Any] = {"topology": kind, "divisions": int(random.integers(1, 4))}
    side = float(random.uniform(0.2, 2.0))
    match kind:
        case "square":
            net |= {"mesh": side, "size": side * int(random.integers(1, 6))}
        case "rectangular":
            other = float(random.uniform(0.2, 2.0))
            cells = random.integers(1, 6, size=2).tolist()
            net |= {"mesh": [side, other], "size": [side * cells[0], other * cells[1]]}
        case "hexagonal":
            net |= {"mesh": side, "rings": int(random.integers(0, 3))}
        case "radial":
            spokes, rings = int(random.integers(3, 9)), int(random.integers(1, 4))
            net |= {"radius": side * rings, "spokes": spokes, "rings": rings}
        case "cut":
            net |= {"mesh": side, "size": side * float(random.uniform(4.0, 8.0)), "border": _cable(random)}
            net["outline"] = str(random.choice(["square", "hexagon", "octagon", "circle"]))
            net["mesh_shape"] = str(random.choice(["square", "triangle", "hexagon"]))
            if net["outline"] == "circle":
                net["corners"] = int(random.integers(3, 7))
        case "explicit":
            net |= _listed(random)
    thrown = kind != "explicit"
    tables: dict[str, dict[str, Any]] = {"net": net, "net.cable": _cable(random)}
    if thrown:
        longer = side * float(random.uniform(0.6, 2.0))
        tables["net.strings"] = _cable(random) | {"length": longer, "divisions": int(random.integers(1, 3))}
        tables["net.bullets"] = {"mass": float(random.uniform(0.05, 2.0))}
    packing, (velocity, spin) = random.uniform(0.02, 1.0), random.normal(size=(2, 3)).tolist()
    tables["initial"] = {"packing": packing, "velocity": velocity, "spin": spin}
    if thrown:
        radial, axial = random.uniform(0.1, 5.0), random.uniform(-5.0, 5.0)
        tables["launch"] = {"radial_speed": radial, "axial_speed": axial}
    if random.random() < 0.5:
        tables["effects.rayleigh_damping"] = {"alpha": float(random.uniform(0, 1e-2)), "beta": 1e-7}
    head = f'format = 1\ntitle = "random {kind} net"\n[time]\nend = 0.1\noutput_step = 0.1\n'
    return kind, head + "".join(_table(name, keys) for name, keys in tables.items())


def _cable(random: np.random.Generator) -> dict[str, float]:
    return {
        "diameter": float(random.uniform(5e-4, 5e-3)),
        "density": float(random.uniform(500.0, 3000.0)),
        "youngs_modulus": float(10.0 ** random.uniform(6.0, 11.5)),
    }


def _listed(random: np.random.Generator) -> dict[str, Any]:
    """Draw a chain through random places with some chords, one node heavier, perhaps one fixed."""
    count = int(random.integers(3, 9))
    nodes = random.uniform(-2.0, 2.0, size=(count, 3))
    pairs = {(k, k + 1) for k in range(count - 1)}
    for _ in range(int(random.integers(0, count))):
        i, j = sorted(random.choice(count, size=2, replace=False).tolist())
        pairs.add((i, j))
    masses = np.zeros(count)
    masses[int(random.integers(count))] = random.uniform(0.1, 1.0)
    listed = {"nodes": nodes.tolist(), "elements": sorted(pairs), "node_masses": masses.tolist()}
    if random.random() < 0.5:
        listed["fixed"] = [int(random.integers(count))]
    return listed


def _table(name: str, keys: dict[str, Any]) -> str:
    """Write a TOML table; JSON writes strings, numbers and lists as TOML does."""
    own = "".join(
        f"{key} = {json.dumps(value)}\n" for key, value in keys.items() if not isinstance(value, dict)
    )
    inner = (_table(f"{name}.{key}", value) for key, value in keys.items() if isinstance(value, dict))
    return f"\n[{name}]\n{own}" + "".join(inner)


KINDS = ("packed", "slack", "taut", "overstretched", "coincident", "crumpled")
INTACT = 0.9  # of the elements, where some have broken


def random_states(
    net: Net, kind: str, count: int, random: np.random.Generator
) -> Iterator[tuple[Floats, Floats]]:
    """Draw positions and velocities (n, 3) [m], [m/s] of all nodes, fixed nodes included.

    packed        : 2 to 30 % of the reference configuration, scattered
    slack         : 80 to 99.9 %, so that only elements stretched by the scatter of the nodes pull
    taut          : strains between 1e-3 and 0.03
    overstretched : 1.1 to 3 times the reference configuration
    coincident    : crumpled, with a third of the nodes on one spot: elements of no length
    crumpled      : nodes anywhere in a ball, slack and taut elements mixed
    """
    x, n = net.reference_position, net.n_nodes
    size = float(np.ptp(x, axis=0).max()) or 1.0
    mesh = float(net.reference_length.min(initial=size))
    for _ in range(count):
        turn = _rotation(random)
        match kind:
            case "packed":
                position = x * random.uniform(0.02, 0.3) + _ball(random, n, 0.1 * mesh)
            case "slack":
                position = x * random.uniform(0.8, 0.999) + _ball(random, n, 0.01 * mesh)
            case "taut":
                position = x * random.uniform(1.002, 1.02) + _ball(random, n, 3e-4 * mesh)
            case "overstretched":
                position = x * random.uniform(1.1, 3.0) + _ball(random, n, 0.05 * mesh)
            case "coincident":
                position = _ball(random, n, size)
                position[random.random(n) < 1 / 3] = position[0]
                position[net.element_nodes[:1, 1]] = position[net.element_nodes[:1, 0]]
            case _:
                position = x * random.uniform(0.3, 1.1) + _ball(random, n, 0.7 * mesh)
        yield position @ turn.T, random.normal(size=(n, 3)) * random.choice([0.0, 0.1, 10.0])


def random_instants(start: Start, kind: str, count: int, random: np.random.Generator) -> Iterator[State]:
    """Draw states of a whole system: `random_states`, bodies anywhere.

    Where elements may break, a tenth of them is broken in every other state. Forces that depend on time have
    any time of the scene. Any length of a closing line is wound up, any part of a perimeter is left. Fixed
    nodes are where they start.
    """
    system, net = start.system, start.net
    cable, fixed = system.forces.cable, net.fixed_nodes
    bodies = len(system.bodies)
    first, drawn = system.blocks.n_x - system.blocks.n_states, _drawn(system)
    timed = [
        (term.discrete, switch) for term, switch in system.forces.switches if switch.times and term.discrete
    ]
    for number, (position, velocity) in enumerate(random_states(net, kind, count, random)):
        position[fixed], velocity[fixed] = start.position[fixed], 0.0
        state = replace(start.state, position=position, velocity=velocity)
        discrete = dict(state.discrete)
        if bodies:
            turned = np.array([_quaternion(random) for _ in range(bodies)])
            centres, moving, turning = random.normal(size=(3, bodies, 3))
            state = replace(state, bodies=RigidStates(centres, moving, turned, turning))
        if cable.discrete is not None and number % 2:
            discrete[cable.discrete.name] = (random.random(net.n_elements) < INTACT).astype(float)
        if timed:
            state = replace(state, time=random.uniform(0.0, start.scene.time.end))
        for held, switch in timed:
            x, v = system.layout.pack(state.moving)
            if len(items := switch.crossed(state.time, x, v, held.initial)):
                passed = switch.change(state.time, x, v, held.initial, items, state.discrete)
                discrete[held.name] = passed.discrete
        if drawn is not None:
            name, least, most = drawn
            first_order = state.first_order.copy()
            first_order[system.blocks.state(name) - first] = random.uniform(least, most)
            state = replace(state, first_order=first_order)
        yield replace(state, discrete=discrete)


def _drawn(system: System) -> tuple[str, float, float] | None:
    """Return the first-order state that closes the mouth, and its range; None if it is constant."""
    if system.line is not None and system.line.has_winch:
        return f"{NAME}/wound_up", 0.0, system.line.length - system.line.shortest
    if (edge := system.forces.cable.shortening) is not None:
        return f"{NAME}/part", edge.perimeter.part, 1.0
    return None


def _ball(random: np.random.Generator, count: int, radius: float) -> Floats:
    """Draw points (count, 3) uniformly in a ball."""
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * radius * random.random((count, 1)) ** (1 / 3)


def _quaternion(random: np.random.Generator) -> Floats:
    """Draw a unit quaternion, uniform over attitudes."""
    drawn = random.normal(size=4)
    return np.asarray(drawn / np.linalg.norm(drawn))


def _rotation(random: np.random.Generator) -> Floats:
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


# Distance of bodies from the origin, in parts of the extent of the scene at the start. Near bodies leave
# tethers between them slack: only effects and gyroscopic torques are left.
REACH = {"packed": 0.02, "slack": 0.2, "overstretched": 1.0, "crumpled": 0.5}


def kinds_of(start: Start) -> tuple[str, ...]:
    """Return the kinds of states of a scene: `KINDS`, or those of `REACH` if it has bodies."""
    return tuple(REACH) if len(start.system.bodies) else KINDS


def random_bodies(start: Start, kind: str, count: int, random: np.random.Generator) -> Iterator[State]:
    """Draw `random_instants`, with bodies at distances of `REACH`, rotating at up to some rad/s."""
    everything = np.concatenate([start.position, start.state.bodies.position])
    reach = REACH.get(kind, 1.0) * float(np.ptp(everything, axis=0).max())
    for state in random_instants(start, kind, count, random):
        bodies = replace(state.bodies, position=reach * state.bodies.position)
        yield _with_packed_net(start.system, replace(state, bodies=bodies))


def moved(start: Start, kind: str, count: int, random: np.random.Generator) -> Iterator[State]:
    """Draw `random_instants`, moved as a whole, the first at rest.

    Off the origin the shares of the nodes in a potential or an angular momentum do not cancel.
    """
    fixed = start.net.fixed_nodes
    for number, state in enumerate(random_instants(start, kind, count, random)):
        position = state.position + start.net.size * random.normal(size=3)
        position[fixed] = start.position[fixed]
        yield state.at(position, state.velocity * (number > 0))


def _with_packed_net(system: System, state: State) -> State:
    """Put the nodes of a net that a body holds where the body holds them: the engine does not move them."""
    for held in system.kinematics.held:
        if held.discrete == HELD and (nodes := held.points[: held.number(state.discrete)]).size:
            moving = state.moving.completed(system.kinematics, state.time, state.discrete)
            position, velocity = state.position.copy(), state.velocity.copy()
            position[nodes], velocity[nodes] = moving.position[nodes], moving.velocity[nodes]
            state = replace(state, position=position, velocity=velocity)
    return state


# m/s of nodes and rad/s of the body in contact: some points approach, others separate, but not so fast that
# damping cancels the force within a thread, where the integrand has a kink.
SPEED = 0.5
MOST_MOVES = 200  # of lines along a direction; those that pass a solid at a small angle need more


def in_contact(start: Start, count: int, random: np.random.Generator) -> Iterator[State]:
    """Draw states in which threads, nodes or bullets penetrate a solid of the body, within the limit.

    Lines without common nodes penetrate one by one. Those of a connected net are crumpled and moved together,
    until the deepest does.
    """
    (name,) = start.system.blocks.surfaces
    body = next(item for item in start.system.bodies if item.name == name)
    assert body.shape is not None
    cores = [core_as_solid(solid, body.shape.edge_radius) for solid in body.shape.solids]
    net, allowed = start.net, start.system.blocks.surfaces[name].allowed
    lines, thick = _lines(start.scene.effects.get(Contact), net)
    size, n = 0.5 * float(net.reference_length.min()), len(lines)
    connected = len(np.unique(lines)) < lines.size and bool(np.any(lines[:, 0] != lines[:, 1]))
    groups = [np.arange(n)] if connected else list(np.arange(n)[:, None])
    for _ in range(count):
        if connected:
            ((own, _),) = random_states(net, "crumpled", 1, random)
        else:
            own = random.normal(size=(net.n_nodes, 3))  # in the body's frame
            for i, j in lines[lines[:, 0] != lines[:, 1]]:
                half = size * random.normal(size=3)
                own[i], own[j] = own[i] - half, own[i] + half
        for group in groups:
            depth = allowed * random.uniform(0.01, 0.9)
            by = _pressed(cores, own[lines[group]], thick[group], depth, random)
            own[np.unique(lines[group])] += by
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


def _pressed(
    cores: list[tuple[Solid, float]], ends: Floats, thick: Floats, depth: float, random: np.random.Generator
) -> Floats:
    """Return the translation (3,) [m] after which the deepest of some lines penetrates by about `depth` [m].

    Lines come from afar and are moved by their distance, which none can overshoot: Hart, The Visual
    Computer 12 (1996) 527, doi 10.1007/s003710050084.

    Parameters
    ----------
    ends : ndarray, shape (m, 2, 3)
        In the body's frame [m].
    thick : ndarray, shape (m,)
        Radii of the lines [m].
    """

    def gap(by: Floats) -> float:
        begin, end = (ends[:, side] + by for side in range(2))
        found = (least_along(core.distance, begin, end) - around - thick for core, around in cores)
        return min(float(distance.min()) for distance in found)

    extent = float(np.ptp(ends.reshape(-1, 3), axis=0).max()) + max(
        float(np.linalg.norm(core.position)) + sum(core.numbers) + around for core, around in cores
    )
    while True:
        aim, way = ends[random.integers(len(ends))], random.normal(size=3)
        way /= np.linalg.norm(way)
        target = cores[random.integers(len(cores))][0].position
        by = (
            target
            - (aim[0] + random.random() * (aim[1] - aim[0]))
            - 4.0 * (extent + float(thick.max())) * way
        )
        for _ in range(MOST_MOVES):
            left = gap(by) + depth
            if left < 0.1 * depth:
                return by
            by = by + left * way


def _lines(contact: Any, net: Net) -> tuple[Ints, Floats]:
    """Return ends of the lines that touch (m, 2), equal for points, and their radii (m,) [m]."""
    if contact.threads:
        return net.element_nodes, np.sqrt(net.area / np.pi)
    balls = [(nodes_of(net), contact.node_radius)] * bool(contact.nodes)
    balls += [(bullets_of(net), contact.bullet_radius)] * bool(contact.bullets)
    nodes = np.concatenate([ball.nodes for ball, _ in balls])
    thick = np.concatenate([np.full(len(ball.nodes), radius) for ball, radius in balls])
    return np.stack([nodes] * 2, axis=1), thick


def threads_in_contact(start: Start, count: int, random: np.random.Generator) -> Iterator[State]:
    """Draw states of elements without common nodes, each second element in contact with the one before.

    A third of the pairs is nearly parallel; some touch over an end.
    """
    law = start.scene.effects.get(SelfContact)
    assert law is not None
    reach = 2.0 * float(law.radii(start.net).max())
    ends, size = start.net.element_nodes, float(start.net.reference_length.mean())
    for number in range(count):
        position = np.array(start.position)
        for pair, (first, second) in enumerate(zip(ends[::2], ends[1::2], strict=True)):
            d, e = random.normal(size=(2, 3)) * size * random.uniform(0.05, 1.0, size=(2, 1))
            if (number + pair) % 3 == 0:
                e = random.uniform(0.3, 1.5) * d + 1e-3 * size * random.normal(size=3)
            side = np.cross(d, random.normal(size=3))
            side *= random.uniform(1.05 * LEAST, 1.0) * reach / np.linalg.norm(side)
            begin = 10.0 * size * np.array([pair, 0.0, 0.0]) - random.uniform() * d
            place = 10.0 * size * np.array([pair, 0.0, 0.0]) + side - random.uniform() * e
            position[first], position[second] = (begin, begin + d), (place, place + e)
        velocity = SPEED * random.normal(size=position.shape)
        yield replace(start.state, position=position, velocity=velocity)


SEED = 20210613


def topology(case: BothCodes) -> Iterator[Check]:
    """Compare connectivity, geometry, masses and initial state of a case, bodies included."""
    error = _mismatch(case)
    yield Check("nodes, elements, bullets, fixed nodes, bodies", bool(error), CONNECTIVITY, error)
    if not error:
        yield worst_of("geometry, masses, start", _differences(case))


def random_topologies(count: int) -> Iterator[Check]:
    """Compare `count` random valid nets of all topologies."""
    random = np.random.default_rng(SEED)
    found: list[Check] = []
    for k in range(count):
        kind, text = random_case(random)
        name = f"random-{k}-{kind}"
        found += [replace(check, name=name) for check in topology(both_of_text(name, text))]
    differing = [check for check in found if not check.holds]
    measured = [check for check in found if check.tolerance is TOPOLOGY]
    where = f"{differing[0].name}: {differing[0].where}" if differing else ""
    yield Check(f"random nets that differ, of {count}", len(differing), CONNECTIVITY, where)
    if measured:
        yield worst_of(f"geometry, masses, start of {count} random nets", measured)


def _mismatch(case: BothCodes) -> str:
    """Return what makes both nets differ in kind; empty if nothing does."""
    try:
        match, _ = case.reference_nodes, case.reference_bodies
    except InputError as error:
        return str(error)
    if set(match[case.start.net.fixed_nodes]) != set(case.theirs.net.fixed_nodes.tolist()):
        return "different nodes are fixed"
    return ""


def _differences(case: BothCodes) -> Iterator[Check]:
    """Yield the largest difference of each quantity."""
    for axis, match, names in (
        ("node", case.reference_nodes, ("reference_position", "mass")),
        ("element", case.reference_elements, ("reference_length", "area", "youngs_modulus", "density")),
    ):
        for name in names:
            a, b = getattr(case.start.net, name), getattr(case.theirs.net, name)[match]
            if name == "reference_position":  # nodes of tethers have none of their own
                a, b = a[: case.start.net.n_net_nodes], b[: case.start.net.n_net_nodes]
            yield difference(name.replace("_", " "), a, b, TOPOLOGY, (axis, "xyz")[: a.ndim])
    system, theirs = case.start.system, case.theirs
    order, beside = case.reference_bodies, theirs.system.bodies
    yield difference("mass of bodies", system.body_mass, beside.mass[order], TOPOLOGY, ("body",))
    inertia = np.array([body.inertia_in_frame for body in system.bodies]).reshape(-1, 3, 3)
    yield difference("inertia", inertia, beside.inertia[order], TOPOLOGY, ("body", "xyz", "axis"))
    yield from _ejection(case)
    ours = case.theirs_at(case.start.state.moving)
    for name, a, b in (("position", ours.x, theirs.x0), ("velocity", ours.v, theirs.v0)):
        a, b = a[case.reference_nodes], b[case.reference_nodes]
        yield difference(f"initial {name}", a, b, TOPOLOGY, ("node", "xyz"))
    for name in ("position", "velocity", "attitude", "angular_velocity"):
        a, b = getattr(ours.bodies, name)[order], getattr(theirs.bodies0, name)[order]
        axes = ("body", "xyz", "axis")[: a.ndim]
        yield difference(f"initial {name.replace('_', ' ')} of bodies", a, b, TOPOLOGY, axes)


def _ejection(case: BothCodes) -> Iterator[Check]:
    """Compare impulse, angular impulse, work and lost energy at time 0 of a net that a body ejects then."""
    ours, theirs = np.zeros(8), np.zeros(8)
    ejection, started = case.start.system.ejection, case.theirs.system.begun
    if ejection is None and started is None:
        return
    if ejection is not None:
        lost = case.start.system.lost_at_start
        ours[:] = [*ejection.impulse, *ejection.angular_impulse, ejection.work, lost]
    if started is not None:
        theirs[:] = [*started.given, started.left]
    yield difference("balances of the ejection", ours, theirs, TOPOLOGY, ("number",))

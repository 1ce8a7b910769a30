"""Forces of both codes at random states of random nets."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from exunet.bodies.rigid import RigidStates
from exunet.forces import cable
from exunet.model import energy
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.net.arrays import Net
from exunet.net.closing import NAME
from exunet.simulation.preparation import Start
from exunet.studies.both_codes import BothCodes
from exunet.verification.check import Check, Floats, difference, worst_of
from exunet.verification.tolerances import FORCES, MEASURES
from reference_impl import energy as their_energy
from reference_impl import forces as formulas

TOPOLOGIES = ("square", "rectangular", "hexagonal", "radial", "cut", "explicit")


def random_case(random: np.random.Generator, topology: str | None = None) -> tuple[str, str]:
    """(topology, TOML text) of a valid case, drawn from `random`; `topology` fixes its kind."""
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
    """A chain through random places with a few random chords, one node heavier, maybe one fixed."""
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
    """A TOML table; JSON writes its strings, numbers and lists as TOML does."""
    own = "".join(
        f"{key} = {json.dumps(value)}\n" for key, value in keys.items() if not isinstance(value, dict)
    )
    inner = (_table(f"{name}.{key}", value) for key, value in keys.items() if isinstance(value, dict))
    return f"\n[{name}]\n{own}" + "".join(inner)


KINDS = ("packed", "slack", "taut", "overstretched", "coincident", "crumpled")
HALF_SLACK = "half slack"
NO_HALF_SLACK = "no stretch of this net makes some elements taut and others slack, away from the transition"
INTACT = 0.9  # of the elements, where some have broken
CLEAR_OF_THE_KINK = 1e-4  # strains below this are in neither state for a numerical derivative


def random_states(
    net: Net, kind: str, count: int, random: np.random.Generator
) -> Iterator[tuple[Floats, Floats]]:
    """`count` states (position, velocity), (n, 3) each [m], [m/s], fixed nodes included.

    packed        : 2 to 30 % of the reference configuration, scattered
    slack         : 80 to 99.9 %, so nothing pulls but what the scatter of the nodes stretches
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
    """`random_states` of a whole system: point masses anywhere among the nodes, rigid bodies anywhere.

    Where elements may break, a tenth has broken in every other state; where forces depend on the time, it is
    any time of the scene; of a closing line any length is wound up, of a perimeter any part is left. Fixed
    nodes are where they start.
    """
    system, net = start.system, start.net
    cable, fixed = system.forces.cable, net.fixed_nodes
    beside, bodies = system.blocks.n_points - net.n_nodes, len(system.bodies)
    first, drawn = system.blocks.n_x - system.blocks.n_states, _drawn(system)
    timed = [(term.memory, switch) for term, switch in system.forces.switches if switch.times and term.memory]
    for number, (position, velocity) in enumerate(random_states(net, kind, count, random)):
        position[fixed], velocity[fixed] = start.position[fixed], 0.0
        places = np.concatenate([position, _ball(random, beside, net.size)])
        speeds = np.concatenate([velocity, random.normal(size=(beside, 3))])
        state = replace(start.state, position=places, velocity=speeds)
        memory = dict(state.memory)
        if bodies:
            turned = np.array([_quaternion(random) for _ in range(bodies)])
            centres, moving, turning = random.normal(size=(3, bodies, 3))
            state = replace(state, bodies=RigidStates(centres, moving, turned, turning))
        if cable.memory is not None and number % 2:
            memory[cable.memory.name] = (random.random(net.n_elements) < INTACT).astype(float)
        if timed:
            state = replace(state, time=random.uniform(0.0, start.scene.time.end))
        for held, switch in timed:
            x, v = system.layout.pack(state.moving)
            if len(items := switch.crossed(state.time, x, v, held.initial)):
                passed = switch.change(state.time, x, v, held.initial, items, state.memory)
                memory[held.name] = passed.memory
        if drawn is not None:
            name, least, most = drawn
            first_order = state.first_order.copy()
            first_order[system.blocks.state(name) - first] = random.uniform(least, most)
            state = replace(state, first_order=first_order)
        yield replace(state, memory=memory)


def _drawn(system: System) -> tuple[str, float, float] | None:
    """The first-order state that closes the mouth, and its range; None: nothing does, or it is constant."""
    if system.line is not None and system.line.has_winch:
        return f"{NAME}/wound_up", 0.0, system.line.length - system.line.shortest
    if (edge := system.forces.cable.shortening) is not None:
        return f"{NAME}/part", edge.perimeter.part, 1.0
    return None


def smooth_states(net: Net, random: np.random.Generator) -> dict[str, Floats]:
    """A taut and a half-slack position (n, 3) [m] with every strain well away from zero.

    The half-slack one is the net stretched by unequal amounts along three random axes; it is left out where
    no draw makes some elements taut and some slack (a net of one element has no such state).
    """
    mesh = float(net.reference_length.min())
    x = net.reference_position
    states = {"taut": x * 1.02 + _ball(random, net.n_nodes, 2e-3 * mesh)}
    for _ in range(200):
        axes = _rotation(random)
        stretch = axes @ np.diag(random.uniform(0.9, 1.06, size=3)) @ axes.T
        position = x @ stretch
        strain = cable.green_lagrange_strain(cable.lengths(net, position), net.reference_length)
        if strain.min() < 0 < strain.max() and np.abs(strain).min() > CLEAR_OF_THE_KINK:
            states[HALF_SLACK] = position
            break
    return states


def _ball(random: np.random.Generator, count: int, radius: float) -> Floats:
    """Points spread evenly in a ball (count, 3)."""
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * radius * random.random((count, 1)) ** (1 / 3)


def _quaternion(random: np.random.Generator) -> Floats:
    """A unit quaternion, all attitudes alike."""
    drawn = random.normal(size=4)
    return np.asarray(drawn / np.linalg.norm(drawn))


def _rotation(random: np.random.Generator) -> Floats:
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


SEED, SEED_OF_MEASURES = 20210614, 20210620
STATES, MEASURED = 200, 20  # of each of six kinds: 1200 and 120 states a case
RARE = ("potential energy", "power taken")  # rows only where one of the codes has any


def forces(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """The kind of state that differs most: largest difference over the largest acceleration of that kind."""
    checks = []
    probe, system, random = case.probe(), case.start.system, np.random.default_rng(SEED)
    for kind in KINDS:
        ours, others = [], []
        for state in random_instants(case.start, kind, states_of_a_kind, random):
            if state.memory:
                probe.remember(system, state.memory)
            ours.append(probe.accelerations(state.position, state.velocity, state.time))
            others.append(case.reference_motion(state)[0][: system.blocks.n_points])
        a, b, axes = np.array(ours), np.array(others), ("state", "node", "xyz")
        checks.append(difference(kind, a, b, FORCES, axes, "m/s2"))
    yield worst_of(f"accelerations, {states_of_a_kind * len(KINDS)} random states", checks)


def measures(case: BothCodes, states_of_a_kind: int = MEASURED) -> Iterator[Check]:
    """Energies, momenta, strains, tensions, power: a row for each, of the kind of state that differs most.

    The states are those of `random_instants`, moved as a whole, the first of each kind at rest. Differences
    are parts of the largest value among the states of a kind, those of a potential and a power of any kind.
    """
    fixed, random = case.start.net.fixed_nodes, np.random.default_rng(SEED_OF_MEASURES)
    found: dict[str, list[tuple[str, str, Floats, Floats]]] = {}
    for kind in KINDS:
        values: dict[tuple[str, str], list[tuple[Floats, Floats]]] = {}
        for number, state in enumerate(random_instants(case.start, kind, states_of_a_kind, random)):
            # Off the origin the nodes' shares of a potential or of an angular momentum do not cancel.
            moved = state.position + case.size * random.normal(size=3)
            moved[fixed] = case.start.position[fixed]
            there = state.at(moved, state.velocity * (number > 0))
            for name, unit, a, b in _quantities(case, there):
                values.setdefault((name, unit), []).append((a, b))
        for (name, unit), pairs in values.items():
            a, b = (np.array(side) for side in zip(*pairs, strict=True))
            found.setdefault(name, []).append((kind, unit, a, b))
    for name, kinds in found.items():
        # A potential of matrices is small where their terms cancel: a part of its largest value in any kind.
        every = [np.abs(side).max(initial=0.0) for *_, a, b in kinds for side in (a, b)]
        scale = float(max(every)) if name in RARE else None
        if scale != 0.0:
            checks = [
                difference(kind, a, b, MEASURES, ("state", "number")[: a.ndim], unit, scale=scale)
                for kind, unit, a, b in kinds
            ]
            yield worst_of(f"{name}, {states_of_a_kind * len(KINDS)} random states", checks)


def _quantities(case: BothCodes, state: State) -> Iterator[tuple[str, str, Floats, Floats]]:
    """Name, unit, and the values (...) of exunet and of the reference."""
    system, elements = case.theirs.system, case.reference_elements
    kinematics = case.start.system.kinematics
    if kinematics.held:  # elements on a drum have no length
        moving = state.moving.completed(kinematics, state.time, state.memory)
        state = State.of(state.time, moving, state.memory)
    ours, theirs = States.of(case.start.system, state), case.theirs_at(state.moving)
    x, v, bodies = theirs.x, theirs.v, theirs.bodies
    intact, wound = case.intact_in_reference(state), case.wound_in_reference(state)
    drawn = case.drawn_in_reference(state.first_order)
    lengths = their_energy.lengths(system, wound, drawn)
    stored = their_energy.at_outlets(system, x, wound)[1] + their_energy.of_closing(system, x, drawn)[1]
    yield "kinetic energy", "J", ours.kinetic[0], their_energy.kinetic(system, v, bodies)
    yield "elastic energy", "J", ours.elastic[0], their_energy.elastic(system, x, intact)
    yield "potential energy", "J", ours.potential[0], their_energy.potential(system, x, bodies) + stored
    yield "momentum", "kg m/s", ours.momentum[0], their_energy.momentum(system, v, bodies)
    angular = their_energy.angular_momentum(system, x, v, bodies)
    yield "angular momentum", "kg m2/s", ours.angular_momentum[0], angular
    yield "strain", "", ours.strain[0], formulas.strain(system, x, lengths)[elements]
    viscous = "material_damping" in case.effects
    # The reference tells the elastic tension; with a viscous one beside it the two are the same at rest.
    if not viscous or not state.velocity.any():
        pulling = None if lengths is not None else intact  # outlets pull, though no element of the net does
        yield "tension", "N", ours.tension[0], formulas.tension(system, x, pulling, lengths)[elements]
    # exunet integrates the work of the viscous stress over steps, and has no power at an instant: rung 5.
    if not viscous:
        taken = energy.power_taken(case.start.system.forces, ours.time, *ours.flat, state.memory)
        yield "power taken", "W", taken[0], np.asarray(case.reference_motion(state)[1])

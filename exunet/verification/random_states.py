"""Random states of a net, of the kinds that a deployment passes through."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from exunet.bodies.rigid import RigidStates
from exunet.forces import cable
from exunet.net.arrays import Net
from exunet.net.closing import NAME
from exunet.simulation.preparation import Start
from exunet.system.system import State, System
from exunet.verification.check import Floats

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

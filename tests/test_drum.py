"""Reels by hand: what lies on the drum, when a node goes on or comes off, and how it then moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripts import case_of
from test_reels import command, start_of

from exunet.bodies.rotations import rotation_matrix
from exunet.model.drum import Drum
from exunet.net.drive import WITHOUT_LIMIT, Drive
from exunet.net.reel import Reel, ReelConfig, reel_of
from exunet.simulation.preparation import Start, prepare_case

NODES, ELEMENTS = (9, 3, 4, 5, 8), (2, 3, 4, 5)


def reel(length: float = 2.0, **keys: Any) -> Reel:
    return reel_of("line", ReelConfig.model_validate(keys), "left", length, NODES, ELEMENTS)


def test_a_reel_at_either_end() -> None:
    """Four elements of 0.5 m, of which 0.7 m are wound up: one node, and an outlet of 0.3 m."""
    found = reel(paid_out=1.3)
    assert (found.nodes, found.elements, found.element_length) == (NODES, ELEMENTS, 0.5)
    assert (found.wound, found.on_drum, found.shortest) == (pytest.approx(0.7, rel=1e-15), 1, 0.125)
    assert found.outlet(1, 0.7) == pytest.approx(0.3, rel=1e-15)
    assert found.length == 2.0
    assert (found.largest_rate, found.times, found.drives) == (WITHOUT_LIMIT, (), (Drive(),))
    end = reel(paid_out=1.3, at="end", shortest=0.2, largest_rate=3.0, damping=20.0)
    assert (end.nodes, end.elements) == (NODES[::-1], ELEMENTS[::-1])
    assert (end.on_drum, end.shortest, end.largest_rate, end.damping) == (1, 0.2, 3.0, 20.0)


@pytest.mark.parametrize(
    ("outside", "nodes"),
    [
        (2.0, 0),
        (1.625 + 1e-9, 0),
        (1.625, 1),
        (1.625 + 4e-10, 1),
        (1.126, 1),
        (0.626, 2),
        (0.625, 3),
        (0.1251, 3),
    ],
)
def test_nodes_on_the_drum(outside: float, nodes: int) -> None:
    """An outlet of a quarter of an element, to 1e-9 of it, goes on with the next; the last stays."""
    assert reel(paid_out=outside).on_drum == nodes


def test_how_short_an_outlet_gets() -> None:
    """A quarter of an element where nodes go on; half of one where they only come off."""
    wind, pay = {"at": 0.1, "mode": "rate", "rate": 0.5}, {"at": 0.1, "mode": "brake", "force": 5.0}
    assert reel(paid_out=1.3).least_outlet == 0.125
    assert reel(paid_out=1.3, commands=[wind]).least_outlet == 0.125
    assert reel(paid_out=1.3, commands=[wind]).most_on_drum == 3
    assert reel(paid_out=1.3, commands=[pay], damping=9.0).most_on_drum == 1
    assert reel(paid_out=1.3, commands=[pay], damping=9.0).least_outlet == 0.25
    assert reel(paid_out=1.26, commands=[pay], damping=9.0).least_outlet == 0.25
    assert reel(paid_out=1.2, commands=[pay], damping=9.0).least_outlet == pytest.approx(0.2, rel=1e-14)
    assert reel(paid_out=1.8, commands=[pay], damping=9.0).least_outlet == pytest.approx(0.3, rel=1e-14)
    assert reel(paid_out=1.3, commands=[{"at": 0.1, "mode": "lock"}]).least_outlet == pytest.approx(
        0.3, rel=1e-14
    )
    one = reel_of("line", ReelConfig(shortest=0.7), "left", 2.0, (4, 5), (6,))
    assert (one.least_outlet, one.most_on_drum) == (0.7, 0)


def faults(**keys: Any) -> list[tuple[Any, ...]]:
    return [fault.path for fault in ReelConfig.model_validate(keys).faults_on(2.0, 4)]


def test_what_a_reel_cannot_have() -> None:
    """Outside are a quarter of an element to all of it; winding can begin."""
    assert faults(paid_out=0.125, shortest=0.125) == []
    assert faults(paid_out=2.0, shortest=2.0) == []
    assert faults(paid_out=0.1249) == [("paid_out",)]
    assert faults(paid_out=2.0001) == [("paid_out",)]
    assert faults(shortest=2.0001) == [("shortest",)]
    assert faults(paid_out=0.5, shortest=0.5) == []
    assert faults(paid_out=0.5, shortest=0.5001) == [("shortest",)]


# 8 elements of 0.5 m; see `test_reels.SCENE`. The state of the run begins with two nodes on the drum.
CLOSE, HALF = 5e-10, 0.5


def made(folder: Path, commands: str = "", **given: float) -> tuple[Start, Drum]:
    start = start_of(folder, commands=commands, **given)
    (drum,) = (force.switch for force in start.system.forces if isinstance(force.switch, Drum))
    return start, drum


def wound(start: Start, length: float) -> tuple[np.ndarray, np.ndarray]:
    """The start, with another length wound up."""
    x, v = start.system.layout.pack(start.state.moving)
    x = x.copy()
    x[start.system.blocks.state("line/wound_up")] = length
    return x, v


@pytest.mark.parametrize(
    ("nodes", "outlet", "known"),
    [
        (2, 0.125 + 0.8 * CLOSE, [1]),
        (2, 0.125 + 1.5 * CLOSE, []),
        (2, 0.125 - 0.8 * CLOSE, [1]),
        (2, 0.75 - 0.8 * CLOSE, [2]),
        (2, 0.75 - 1.5 * CLOSE, []),
        (2, 0.75 + 0.8 * CLOSE, [2]),
        (0, 0.8, []),  # there is none to come off
        (6, 0.1, [1]),
        (7, 0.1, []),  # nor one that could go on
    ],
)
def test_when_a_node_is_due(tmp_path: Path, nodes: int, outlet: float, known: list[int]) -> None:
    start, drum = made(tmp_path, command(0.25, "rate", rate=0.5))
    memory = np.array([nodes, 1.0])
    x, v = wound(start, HALF * (nodes + 1) - outlet)
    assert drum.crossed(0.3, x, v, memory).tolist() == known
    memory = np.array([nodes, 0.0])
    assert drum.crossed(0.2499, x, v, memory).tolist() == known
    assert drum.crossed(0.25, x, v, memory).tolist() == [0, *known]


@pytest.mark.parametrize(
    ("rate", "nodes", "outlet", "way"),
    [
        (0.5, 2, 0.3, 0.175 - 0.999 * CLOSE),
        (-0.5, 2, 0.3, 0.45 - 0.999 * CLOSE),
        (0.5, 7, 0.3, None),
        (-0.5, 0, 0.3, None),
    ],
)
def test_a_step_ends_just_within_reach_of_a_limit(
    tmp_path: Path, rate: float, nodes: int, outlet: float, way: float | None
) -> None:
    """At 0.5 m/s, whatever pulls; what goes no farther stays as it is, none is too short."""
    start, drum = made(tmp_path, command(0.0, "rate", rate=rate))
    memory, (x, v) = np.array([nodes, 1.0]), wound(start, HALF * (nodes + 1) - outlet)
    assert drum.in_steps(memory)
    found = drum.step_within(2.0, 1e-6, x, v, memory)
    if way is None:
        assert found == 2.0
        return
    assert found == pytest.approx(way / 0.5, rel=1e-15, abs=2e-16)
    enough = (way + 1.999 * CLOSE) / 0.5
    assert drum.step_within(enough * (1.0 - 1e-12), 1e-6, x, v, memory) == enough * (1.0 - 1e-12)
    assert drum.step_within(enough * (1.0 + 1e-10), 1e-6, x, v, memory) == pytest.approx(way / 0.5, abs=2e-16)
    assert drum.step_within(2.0, 1.5, x, v, memory) == 1.5
    still = np.array([nodes, 0.0])  # before the command
    assert drum.step_within(2.0, 1e-6, x, v, still) == 2.0
    other = np.array([nodes + 1, 1.0])
    x, v = wound(start, HALF * (nodes + 2) - outlet)
    assert drum.step_within(2.0, 1e-6, x, v, other) == pytest.approx(way / 0.5, abs=5e-16)


def stirred(start: Start, nodes: int, outlet: float) -> tuple[np.ndarray, np.ndarray]:
    """All places and velocities a little other than at the start, and turning."""
    system, rng = start.system, np.random.default_rng(8)
    x, v = wound(start, HALF * (nodes + 1) - outlet)
    points = 3 * system.blocks.n_points
    x[:points] += rng.normal(size=points) * 0.05
    v = v + rng.normal(size=len(v)) * 0.3
    memory = system.memory | {"line/reel": np.array([float(nodes), 0.0])}
    moving = system.layout.unpack(x, v).completed(system.kinematics, 0.3, memory)
    return system.layout.pack(moving)


def momenta(start: Start, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(6,) linear and angular momentum of both bodies and of the nodes that are no part of them."""
    system = start.system
    moving = system.layout.unpack(x, v)
    tied = system.kinematics.tied
    mass = np.array(system.net.mass)
    mass[tied] = 0.0  # which the bodies have
    place, speed = moving.position[: len(mass)], moving.velocity[: len(mass)]
    linear = mass @ speed
    angular = (mass[:, None] * np.cross(place, speed)).sum(axis=0)
    for k, body in enumerate(system.bodies):
        centre, speed, attitude, spin = (part[k] for part in moving.bodies.parts())
        linear = linear + body.mass * speed
        own = rotation_matrix(attitude) @ (np.array(body.inertia) * spin)
        angular = angular + np.cross(centre, body.mass * speed) + own
    return np.concatenate([linear, angular])


@pytest.mark.parametrize(("nodes", "outlet", "item"), [(2, 0.125, 1), (2, 0.75, 2)])
def test_a_node_that_goes_on_or_comes_off_keeps_the_momenta(
    tmp_path: Path, nodes: int, outlet: float, item: int
) -> None:
    """It comes off on the line to the next node: along it with the velocity of the next, across it with
    that of its place on it. Going on, it is put to the drum.
    """
    start, drum = made(tmp_path, density=1e5)
    x, v = stirred(start, nodes, outlet)
    memory, every = np.array([nodes, 0.0]), start.system.memory | {"line/reel": np.array([nodes, 0.0])}
    change = drum.change(0.3, x, v, memory, np.array([item]), every)
    assert change.x is not None
    assert change.v is not None
    np.testing.assert_allclose(momenta(start, change.x, change.v), momenta(start, x, v), rtol=1e-12)
    after = nodes + 1 if item == 1 else nodes - 1
    assert change.memory.tolist() == [after, 0.0]
    (tether,) = start.net.tethers
    before, then = (start.system.layout.unpack(*entry) for entry in ((x, v), (change.x, change.v)))
    drums, node = tether.nodes[0], tether.nodes[3 if item == 1 else 2]
    (event,) = change.events
    assert event["node"] == node
    if item == 1:
        np.testing.assert_allclose(then.position[node], then.position[drums], atol=1e-15)
        np.testing.assert_allclose(then.velocity[node], then.velocity[drums], atol=1e-15)
        return
    far = tether.nodes[3]
    part = 0.25 / 0.75
    line, apart = (values[far] - values[drums] for values in before[:2])
    np.testing.assert_allclose(then.position[node], before.position[drums] + part * line, rtol=1e-13)
    way = line / np.linalg.norm(line)
    along, speed = then.velocity[node] @ way, then.velocity[node]
    assert along == pytest.approx(before.velocity[far] @ way, rel=1e-12)
    across = before.velocity[drums] + part * apart
    np.testing.assert_allclose(speed - along * way, across - (across @ way) * way, atol=1e-13)


def test_elements_that_a_body_winds_up_are_those_of_its_own_reels() -> None:
    """By its contact: the tether of the reel on the left one, and none of the right one."""
    more = [
        f"bodies.{name}={{shape='sphere', radius=0.2, mass=2.0, position=[{x}, 50.0, 0.0]}}"
        for name, x in (("left", 0.0), ("right", 3.0))
    ]
    contact = "effects.contact={threads=['left', 'right'], law='linear', stiffness=1e3, damping=0.0}"
    system = prepare_case(case_of("", *more, contact)).system
    assert {name: one.wound for name, one in system.blocks.surfaces.items()} == {
        "left": ((0, 1),),
        "right": (),
    }

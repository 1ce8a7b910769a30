"""`engine.contact = "general"`: the engine's own contact of spheres, and exunet's, which check each other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.backends.exudyn.build import build, expected_items
from exunet.bodies.rigid import rotation_matrix
from exunet.forces.contact.status import Status, status_of
from exunet.results.course import course_of
from exunet.results.headlines import headlines_of
from exunet.simulation.preparation import prepare
from exunet.simulation.simulation import Simulation
from exunet.studies.both_codes import read_both
from exunet.verification import contact
from exunet.verification.shipped import shipped

NODES = shipped(contact.CONTACT_CASES)["nodes"]
STEP, END, MIDDLE = "solver.step=1e-4", 0.06, 0.045  # s; bullets touch from 26 ms on, nodes too from 43 ms on
OWN = "engine.contact=own"
FORMS = {
    "connectors": ["engine.net=connectors"],
    "fused": ["engine.net=fused"],
    "VelocityVerlet": ["solver.method=VelocityVerlet"],
    "DOPRI5": ["solver={method='DOPRI5', tolerance=1e-8}"],
}
# m, between both contacts. Equal steps: 6e-17 seen. Where round-off at a kink moves chosen steps: 7e-9 seen.
APART = dict.fromkeys(FORMS, 1e-14) | {"DOPRI5": 1e-7}
# N m s, by which the angular momentum changes; Verlet of Exudyn turns bodies to first order: 9e-8 seen.
TURNED = dict.fromkeys(FORMS, 1e-12) | {"VelocityVerlet": 1e-6}


def statuses(sim: Simulation) -> list[Status]:
    """Of nodes and of bullets."""
    return [status_of(sim.view.memory[f"contact/{what}/target"]) for what in ("nodes", "bullets")]


def momenta(sim: Simulation) -> np.ndarray:
    """Momentum [N s] and angular momentum about the origin [N m s] of net and ball: (6,)."""
    state, system = sim.state, sim.start.system
    (ball,) = system.bodies
    x, p = state.position, system.mass[:, None] * state.velocity
    own = rotation_matrix(state.bodies.attitude[0]) @ (
        np.array(ball.inertia) * state.bodies.angular_velocity[0]
    )
    push = ball.mass * state.bodies.velocity[0]
    turn = np.cross(x, p).sum(axis=0) + np.cross(state.bodies.position[0], push) + own
    return np.concatenate([p.sum(axis=0) + push, turn])


def same(a: Any, b: Any) -> bool:
    parts = zip(
        (a.position, a.velocity, *a.bodies.parts()), (b.position, b.velocity, *b.bodies.parts()), strict=True
    )
    return all(np.array_equal(one, other) for one, other in parts)


def test_both_give_the_same_accelerations() -> None:
    checks = list(contact.by_the_engine(read_both(NODES), 3))
    assert len(checks) == 2
    assert all(one.holds for one in checks), checks
    assert list(contact.by_the_engine(read_both(NODES, [OWN]), 3)) == []


@pytest.mark.parametrize("form", FORMS)
def test_both_give_the_same_motion_and_the_books_close(form: str) -> None:
    """The engine tells no energy of its contact: that of exunet's law closes the balance of its motion."""
    sims = [Simulation(str(NODES), [STEP, *FORMS[form], *more]) for more in ([], [OWN])]
    before, energy = momenta(sims[0]), sims[0].energy.total
    for sim in sims:
        sim.advance_to(END)
    general, own = sims
    places = np.abs(general.state.position - own.state.position).max()
    ball = np.abs(general.state.bodies.position - own.state.bodies.position).max()
    assert max(places, ball) < APART[form]
    # Kinks of the force at first touches cost methods their order: 3e-6 of all energy seen, of both contacts.
    assert abs(general.energy.total - energy) < 1e-5 * energy
    assert abs(general.energy.total - own.energy.total) < 100.0 * APART[form] * energy
    assert general.energy.dissipated == 0.0
    wrong = np.abs(momenta(general) - before)
    assert wrong[:3].max() < 1e-14 * 3.2  # N s, of the net
    assert wrong[3:].max() < TURNED[form]
    for one, other in zip(statuses(general), statuses(own), strict=True):
        assert one.most > 0.0
        assert one == pytest.approx(other, rel=1e-4 if form == "DOPRI5" else 1e-10, abs=1e-12)


@pytest.mark.parametrize("form", ["fused", "VelocityVerlet", "DOPRI5"])
def test_a_run_that_is_restored_in_mid_contact_repeats_bitwise(form: str) -> None:
    sim = Simulation(str(NODES), [STEP, *FORMS[form]])
    sim.advance_to(MIDDLE)
    assert min(one.touching for one in statuses(sim)) > 0.0
    middle = sim.snapshot()
    sim.advance_to(END)
    end = sim.state
    for again in (sim, Simulation(str(NODES), [STEP, *FORMS[form]])):
        again.restore(middle)
        again.advance_to(END)
        assert same(again.state, end)


def test_a_force_from_outside_comes_beside_it() -> None:
    """Connectors are built anew for it, with their contact."""
    sims = [Simulation(str(NODES), [STEP, "engine.net=connectors", *more]) for more in ([], [OWN])]
    for sim in sims:
        sim.advance_to(0.03)
        sim.set_force(4, [0.0, 0.0, 1.0])
        sim.advance_to(MIDDLE)
    assert np.abs(sims[0].state.position - sims[1].state.position).max() < 1e-11


@pytest.mark.parametrize("fused", [False, True])
def test_the_engine_holds_what_is_expected(fused: bool) -> None:
    start = prepare(exunet.load(NODES).scene)
    items = build(start.system, start.state, start.plan, fused=fused, general=True).items()
    assert items == expected_items(start.system, fused=fused, general=True)
    assert items["GeneralContact"] == 2


def test_a_result_tells_of_nodes_that_touch() -> None:
    result = exunet.run(exunet.load(NODES, [STEP, f"time.end={END}"]))
    touching = result.states["contact_target/nodes_touching"].values[:]
    assert touching.max() >= 1.0
    stored = sum(result.states[f"contact_target/{one}_stored"].values[:, 0] for one in ("nodes", "bullets"))
    assert stored == pytest.approx(np.asarray(result.potential), rel=1e-9, abs=1e-15)
    assert "contact_target_most_touching" in headlines_of(course_of(result))


def test_a_node_that_is_too_deep_stops_the_run() -> None:
    """A ball of 0.25 m allows 0.125 m, and the nodes' radius."""
    soft = ["effects.contact.node_stiffness=0.01", "effects.contact.bullet_stiffness=0.01", "time.end=0.3"]
    with pytest.raises(exunet.RunStopped, match=r"(node|bullet) \d+ is deeper than 0\.125 m in target"):
        exunet.run(exunet.load(NODES, [STEP, *soft]))


CASE = """format = 1
title = "contact"
time = { end = 1.0, output_step = 0.1 }
initial = { packing = 1.0 }
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.cable = { diameter = 0.001, density = 1000.0, youngs_modulus = 1e6 }
solver = { method = "RK44", step = 1e-4 }
engine.contact = "general"
engine.loop = "exudyn"
[bodies.target]
shape = "sphere"
radius = 0.2
position = [0.0, 0.0, -1.0]
mass = 1.0
[effects.contact]
nodes = ["target"]
node_radius = 0.01
law = "linear"
node_stiffness = 1e3
damping = 0.0
friction = 0.0
"""
BOX = 'shape = "box"\nsize = [0.2, 0.2, 0.2]\nedge_radius = 0.02'
THREADS = 'threads = ["target"]\nstiffness = 1e3'
WRONG = {
    "no contact": (CASE[CASE.index("[effects") :], "", r":10: engine\.contact: needs \[effects\.contact\]"),
    "compiled": (
        'loop = "exudyn"',
        'loop = "compiled"',
        r':11: engine\.loop: .* needs engine\.loop = "exudyn"',
    ),
    "auto": ('loop = "exudyn"', 'loop = "auto"', r':11: engine\.loop: .* needs engine\.loop = "exudyn"'),
    "threads": (
        'nodes = ["target"]\nnode_radius = 0.01\n',
        'threads = ["target"]\n',
        r":18: effects\.contact\.threads: .* knows spheres, no threads: name the bodies in nodes",
    ),
    "hertz": (
        'law = "linear"\nnode_stiffness = 1e3',
        'law = "hertz"\nmodulus = 1e6',
        r':20: effects\.contact\.law: .* give law = "linear"',
    ),
    "damping": ("damping = 0.0", "damping = 0.1", r":22: effects\.contact\.damping: .* give damping = 0\.0"),
    "restitution": (
        "damping = 0.0",
        "restitution = 0.9\nimpact_speed = 1.0",
        r":22: effects\.contact\.restitution: .* give damping = 0\.0",
    ),
    "friction": (
        "friction = 0.0",
        'friction = 0.1\nfriction_law = "sticking"',
        r":23: effects\.contact\.friction: .* give friction = 0\.0",
    ),
    "a box": ('shape = "sphere"\nradius = 0.2', BOX, r":13: bodies\.target\.shape: .* touches spheres only"),
    "fixed": (
        "mass = 1.0\n",
        'mass = 1.0\nmotion = "fixed"\n',
        r':17: bodies\.target\.motion: .* give motion = "free"',
    ),
    "held nodes": (
        "net.elements",
        "net.fixed = [1]\nnet.elements",
        r":11: engine\.contact: .* nodes that are fixed, .* such as node 1: let them be free",
    ),
    "a name": (
        '"general"',
        '"exudyn"',
        r':10: engine\.contact: must be one of "own", "general", got "exudyn"',
    ),
}


def refused(folder: Path, old: str, new: str) -> str:
    assert old in CASE
    path = folder / "case.toml"
    path.write_text(CASE.replace(old, new))
    try:
        Simulation(str(path))
    except exunet.CaseError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("wrong", WRONG)
def test_what_it_cannot_is_refused(wrong: str, tmp_path: Path) -> None:
    old, new, message = WRONG[wrong]
    found = refused(tmp_path, old, new)
    assert re.search(message, found), found
    if wrong != "a name":
        assert re.search(r'engine\.contact = "own"', found), found


def test_a_restitution_of_one_is_no_damping(tmp_path: Path) -> None:
    assert refused(tmp_path, "damping = 0.0", "restitution = 1.0\nimpact_speed = 1.0") == ""


def test_threads_and_nodes_of_one_body_are_refused(tmp_path: Path) -> None:
    found = refused(tmp_path, 'nodes = ["target"]\n', f'nodes = ["target"]\n{THREADS}\n')
    assert re.search(
        r":18: effects\.contact\.nodes\[0\]: threads touch target along their whole length", found
    )


def test_nodes_need_their_radius_and_stiffness(tmp_path: Path) -> None:
    found = refused(tmp_path, "node_radius = 0.01\n", "")
    assert re.search(r":17: effects\.contact: needs node_radius, as nodes touch", found), found
    found = refused(tmp_path, "node_stiffness = 1e3\n", "")
    assert re.search(r':17: effects\.contact: needs node_stiffness, for law = "linear"', found), found

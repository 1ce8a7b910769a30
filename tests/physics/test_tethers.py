"""Tethers: nodes and masses, a snap off the centres, loads on bodies, ends that a script releases."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scenes import BACKENDS, case_in, continue_alike, every_backend, of_text, refused, restarted, stored
from scripts import END, FREE, SCENE, TOWED, case_of, entry, happened

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.effects import bending
from exunet.results.measures import momentum_books, net_centre
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import run_into, simulate
from exunet.simulation.simulation import Simulation

PAIR = """
format = 1
title = "Two bodies and a slack tether"
time = { end = 0.06, output_step = 0.01 }
solver = { method = "RK44", step = 2e-6 }
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[0.0, 5.0, 0.0], [0.0, 6.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.3, 0.1]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }

[tethers.tow]
diameter = 0.001
density = 1390.0
youngs_modulus = 70e9
length = 1.0
start = { body = "left" }
end = { body = "right" }
"""
LUMP = 1390.0 * math.pi * 0.0005**2 / 2.0  # half of a tether of 1 m [kg]


KEYS = f"mass={0.5 - LUMP!r}, inertia=[0.1, 0.1, 0.1]"
PAIR_OF_BODIES = (
    f"bodies.left={{{KEYS}}}",
    f"bodies.right={{{KEYS}, position=[0.9, 0, 0], velocity=[2.5, 0, 0]}}",
)


def start(*overrides: str) -> Start:
    return prepare_case(of_text(PAIR, *PAIR_OF_BODIES, *overrides))


def test_what_a_tether_adds() -> None:
    """Two nodes for its ends, then its inner ones; their masses are those of lumped elements, eq. (9)."""
    net = start("tethers.tow.divisions=4").net
    assert (net.n_net_nodes, net.n_nodes, net.n_net_elements, net.n_elements) == (2, 7, 1, 5)
    (tether,) = net.tethers
    assert tether.nodes == (2, 4, 5, 6, 3)
    assert net.tether_elements == {"tow": range(1, 5)}
    assert net.element_nodes[1:].tolist() == [[2, 4], [4, 5], [5, 6], [6, 3]]
    np.testing.assert_allclose(net.reference_length[1:], 0.25, rtol=1e-15)
    np.testing.assert_allclose(net.mass[2:], np.array([1, 1, 2, 2, 2]) * LUMP / 4, rtol=1e-14)
    assert net.size == 1.0  # of the net alone


def test_it_lies_straight_and_moves_with_its_ends() -> None:
    """Nodes at a quarter, a half and three quarters of the way between the ends, and of their velocities."""
    turned = (
        "bodies.left.axis=[0, 0, 1]",
        "bodies.left.angle=0.5",
        "bodies.left.angular_velocity=[0, 0, 2]",
        "tethers.tow.start.point=[0.1, 0.2, 0.0]",
        "tethers.tow.divisions=4",
    )
    begin = start(*turned)
    arm = rotation_matrix(np.array([math.cos(0.25), 0.0, 0.0, math.sin(0.25)])) @ [0.1, 0.2, 0.0]
    place = arm
    body = begin.state.bodies  # the tether's end moves the centre of mass, which has the given velocity
    centre = body.position[0]
    speed = np.cross([0.0, 0.0, 2.0], place - centre)
    for k, part in ((2, 0.0), (4, 0.25), (5, 0.5), (6, 0.75), (3, 1.0)):
        np.testing.assert_allclose(
            begin.position[k], (1 - part) * place + part * np.array([0.9, 0, 0]), atol=1e-14
        )
        np.testing.assert_allclose(
            begin.velocity[k], (1 - part) * speed + part * np.array([2.5, 0, 0]), atol=1e-13
        )


OFF_CENTRE = (
    "tethers.tow.start.point=[0.1, 0.2, -0.1]",
    "tethers.tow.end.point=[-0.1, 0.1, 0.1]",
    "tethers.tow.divisions=3",
    "solver.step=1e-5",
    "time.end=0.2",
)


def test_both_back_ends_agree_on_a_snap_off_the_centres() -> None:
    found = [
        simulate(start(*OFF_CENTRE, "solver.step=5e-5", "time.end=0.08", backend)).position
        for backend in BACKENDS.values()
    ]
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_from_the_net_to_a_body() -> None:
    """Tied to a node of the net, whose mass takes half an element; the net has its centre without it."""
    begin = start("tethers.tow.start={node=1}", "tethers.tow.length=9.0", "tethers.tow.divisions=3")
    net = begin.net
    assert net.tethers[0].nodes == (1, 3, 4, 2)
    half = LUMP * 9.0 / 3.0
    assert net.mass[1] == pytest.approx(0.1 + LUMP + half, rel=1e-14)
    centre = net_centre(net, begin.position[None, : net.n_nodes])[0]
    own = net.mass[:2]
    np.testing.assert_allclose(centre, own @ begin.position[:2] / own.sum(), rtol=1e-14)


SLANTED = (  # along (3, 4, 0) / 5
    "bodies.right.position=[0.3, 0.4, 0.0]",
    "tethers.tow.divisions=2",
)


def test_rayleigh_damping_acts_along_the_way_between_the_ends() -> None:
    """Eq. (13): each half damps along n = (3, 4, 0) / 5 with beta EA / L0, slack or not."""
    begin = start(*SLANTED, "effects.rayleigh_damping={alpha=0.0, beta=1e-4}")
    damping = begin.system.forces.linear.damping.toarray()
    between = 3 * begin.net.tethers[0].nodes[1]
    n = np.array([0.6, 0.8, 0.0])
    rate = 1e-4 * 70e9 * math.pi * 0.0005**2 / 0.5
    own = damping[between : between + 3, between : between + 3]
    np.testing.assert_allclose(own, 2.0 * rate * np.outer(n, n), atol=1e-12 * rate)
    with_end = damping[between : between + 3, 6:9]  # node 2, at the body on the left
    np.testing.assert_allclose(with_end, -rate * np.outer(n, n), atol=1e-12 * rate)


def test_a_tether_bends_by_itself() -> None:
    """Joints at its inner nodes, none at its ends or to the net."""
    net = start("tethers.tow.divisions=4").net
    nodes, length, elements = bending.joints(net)
    assert [{before, after} for before, _, after in nodes.tolist()] == [{2, 5}, {4, 6}, {5, 3}]
    assert nodes[:, 1].tolist() == [4, 5, 6]
    assert elements.tolist() == [[1, 2], [2, 3], [3, 4]]
    np.testing.assert_allclose(length, 0.25, rtol=1e-15)


def test_rayleigh_damping_needs_a_direction() -> None:
    """Both bodies at the origin: nothing says along what to damp. Without beta there is nothing to say."""
    here = "bodies.right.position=[0.0, 0.0, 5e-10]"  # half of what a way of 1 m needs
    beta = "effects.rayleigh_damping={alpha=0.0, beta=1e-6}"
    assert refused(PAIR, *PAIR_OF_BODIES, here, beta) == ["tethers.tow.end"]
    start(here, "effects.rayleigh_damping={alpha=0.1, beta=0.0}")


@pytest.mark.ci
@pytest.mark.slow
def test_loads_on_the_bodies() -> None:
    """One thread: equal and opposite pulls of its tension along it, with the torques of its arms."""
    result = simulate(start(*OFF_CENTRE, "tethers.tow.divisions=1"))
    left, right = exunet.loads(result, "left"), exunet.loads(result, "right")
    assert (left.nodes.tolist(), right.nodes.tolist()) == ([2], [3])
    np.testing.assert_allclose(left.size[:, 0], result.tension[:, 1], rtol=1e-12)
    np.testing.assert_allclose(left.force, -right.force, rtol=1e-12)
    span = result.position[:, 3] - result.position[:, 2]
    assert np.abs(np.cross(left.force[:, 0], span)).max() < 1e-9 * left.size.max()
    assert (np.einsum("ta,ta->t", left.force[:, 0], span) >= 0.0).all()  # towards the other body
    arm = result.position[:, 2] - result.bodies["left"].position
    np.testing.assert_allclose(left.torque[:, 0], np.cross(arm, left.force[:, 0]), atol=1e-12)


# The node of the net is fixed to the body on the left, which turns.
HOOKED = FREE[: FREE.index("[tethers.tow]")] + FREE[FREE.index("[capture]") :]
HOOKED = HOOKED.replace(
    "position = [0.0, 50.0, 0.0]\n",
    "position = [0.0, 50.0, 0.0]\nvelocity = [0.1, -0.2, 0.3]\nangular_velocity = [0.7, 2.0, -0.5]\n"
    "attachments.hook = { point = [0.2, 0.1, -0.3], node = 0 }\n",
)
TIE = "bodies.left.attachments.hook"
LET_GO = entry("go", at=0.4, do="release", on=TIE)


@pytest.mark.slow_for("exudyn")
@every_backend
def test_a_node_leaves_a_turning_body_along_its_tangent(backend: str) -> None:
    """It goes on straight with v + w x r; the body keeps its motion, and all their momenta and energy.

    Until then both move as one: as with an attachment that stays, whose mass is the body's.
    """
    result = exunet.run(case_of(LET_GO, BACKENDS[backend], scene=HOOKED))
    at, node, body = 8, result.position[:, 0], result.bodies["left"]
    assert result.time[at] == pytest.approx(0.4)
    assert body.attitude is not None
    assert body.angular_velocity is not None
    turn = rotation_matrix(body.attitude[at])
    lever, spin = turn @ np.array([0.2, 0.1, -0.3]), turn @ body.angular_velocity[at]
    np.testing.assert_allclose(node[at], body.position[at] + lever, atol=1e-12)
    speed = body.velocity[at] + np.cross(spin, lever)
    since = (result.time[at:] - result.time[at])[:, None]
    np.testing.assert_allclose(node[at:], node[at] + since * speed, atol=1e-11)
    np.testing.assert_allclose(body.position[at:], body.position[at] + since * body.velocity[at], atol=1e-11)
    assert np.ptp(result.kinetic) < 1e-10 * result.kinetic[0]  # of RK44 in steps of 1 ms
    for name, book in momentum_books(result).items():
        assert book.gained < 1e-10, name
    stays = exunet.run(case_of("", BACKENDS[backend], scene=HOOKED))
    assert stays.bodies["left"].mass == pytest.approx(3.0)  # 2 kg, and the node's 1 kg
    assert body.mass == 2.0
    np.testing.assert_allclose(node[: at + 1], stays.position[: at + 1, 0], atol=1e-10)


@pytest.mark.slow_for("exudyn")
@every_backend
@pytest.mark.parametrize("motion", ["free", "prescribed"])
def test_the_end_of_a_taut_tether_leaves_a_body(backend: str, motion: str) -> None:
    """As without the script until then, to round-off; then no pull on the body; all balances are kept."""
    numbers = [BACKENDS[backend], "solver.step=4e-4", "time.end=0.6", f"bodies.right.motion={motion}"]
    result, stays = (exunet.run(case_of(script, *numbers, scene=TOWED)) for script in (END, ""))
    before = slice(0, 9)
    np.testing.assert_allclose(result.position[before], stays.position[before], atol=1e-10)
    of = exunet.loads(result, "right")
    assert of.nodes.tolist() == [2]
    assert of.size[7, 0] > 5.0
    assert not of.size[8:].any()
    np.testing.assert_allclose(of.size[:8], exunet.loads(stays, "right").size[:8], rtol=1e-6, atol=1e-9)
    for name, book in momentum_books(result).items():
        assert book.gained < 1e-9, name
    balance = result.kinetic + result.elastic + result.dissipated
    assert np.ptp(balance) < 2e-4 * result.kinetic.max()  # what snapping costs RK44, as without the script
    velocity = result.bodies["right"].velocity
    assert np.ptp(velocity[8:], axis=0).max() < 1e-12
    (event,) = result.run.script
    assert (event.tie, event.node) == ("tethers.tow.end", 2)


@every_backend
@pytest.mark.parametrize(("at", "until"), [(0.35, 0.45), (0.45, 0.5)])
def test_a_snapshot_before_or_after_a_release_goes_on(
    at: float, until: float, backend: str, tmp_path: Path
) -> None:
    case = case_of(END, BACKENDS[backend], scene=TOWED)
    one, other = Simulation(case), Simulation(case)
    one.advance_to(at)
    continue_alike(one, other, until, tmp_path)
    assert one.state.discrete["tethers.tow.end/held"] == [0.0]
    assert [event.entry for event in other.log.events] == ["go"]


def test_a_drive_that_is_released_turns_freely() -> None:
    """Bitwise as with a brake of 0 N, out of a lock; it can be locked again."""
    hold, again = entry("hold", at=0.02, do="lock", on="tow"), entry("again", at=0.5, do="lock", on="tow")
    go = (entry("go", at=0.1, do="release", on="tow"), entry("go", at=0.1, do="brake", on="tow", force=0.0))
    fast = ["bodies.right.velocity=[2.0, 0.0, 0.0]"]
    ours, theirs = (exunet.run(case_of(hold + item + again, *fast)) for item in go)
    assert np.array_equal(ours.position, theirs.position)
    wound = ours.states["tow/wound_up"].values[:, 0]
    assert [name for name, _ in happened(ours)] == ["hold", "go", "again"]
    assert not wound.any()  # all of it is outside: nothing can be paid out
    outside = [*fast, "tethers.tow.reel.paid_out=3.1"]
    wound = exunet.run(case_of(hold + go[0] + again, *outside)).states["tow/wound_up"].values[:, 0]
    assert np.ptp(wound[:3]) == 0.0
    assert wound[10] < wound[2] - 0.005
    assert np.ptp(wound[10:]) == 0.0


def test_a_run_goes_on_from_before_and_after_a_release(tmp_path: Path) -> None:
    """What had been released stays so in a case that starts there; what had not is still held."""
    first = stored(tmp_path, case_in(tmp_path, TOWED + END))
    (tmp_path / "other").mkdir()
    run_into(tmp_path / "other", case_in(tmp_path, TOWED))
    soon = END.replace("0.4", "0.1")
    for at, script, ties in (("first@0.3", soon, 1.0), ("other@0.3", soon, 1.0), ("first@0.6", "", 0.0)):
        sim = Simulation(restarted(tmp_path, TOWED + script, at))
        assert sim.state.discrete["tethers.tow.end/held"] == [ties]
        sim.advance_to(0.9 - float(at[-3:]))
        assert sim.state.discrete["tethers.tow.end/held"] == [0.0]
        row = int(np.argmin(np.abs(first.time - 0.9)))
        np.testing.assert_allclose(sim.state.position, first.position[row], atol=1e-8)


def test_the_end_of_a_tether_leaves_through_the_surface_of_a_body() -> None:
    """It began within the body, and is not touched: contact leaves out what has been fixed to a body."""
    shape = '[bodies.right]\nshape = "sphere"\nradius = 0.4\nmass = 3.0'
    scene = TOWED.replace("[bodies.right]\nmass = 3.0\ninertia = [0.3, 0.4, 0.5]", shape)
    contact = (
        'effects.contact={threads=["right"], law="linear", stiffness=1e4, restitution=0.5, impact_speed=1.0, '
        'friction={law="regularised", coefficient=0.0, slip_speed=0.01}}'
    )
    result = exunet.run(case_of(END, contact, "solver.step=2e-4", scene=scene))
    inside = np.linalg.norm(result.position[:, 2] - result.bodies["right"].position, axis=1) < 0.4
    assert inside[8]
    assert not inside[-1]
    assert not any(np.any(one.values) for name, one in result.states.items() if name.endswith("/touching"))


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ("length=0.8", "length"),  # of ends that are 0.9 m apart
        ("length=1e200", "length"),
        ("end={body='nobody'}", "end.body"),
        ("end={node=7}", "end.node"),
        ("end={bullet=0}", "end.bullet"),
        ("end={body='left', point=[1, 0, 0]}", "end"),
        ("end={node=0, body='left'}", "end.body"),
        ("end={node=0, point=[1, 0, 0]}", "end.point"),
        ("end={}", "end"),
        ("end=", "end"),
        ("area=1e-6", "area"),
        ("lenght=1.0", "lenght"),
        ("divisions=2000000", "divisions"),
        ("diameter=1e160", ""),
    ],
)
def test_wrong_keys_are_refused(keys: str, key: str) -> None:
    faults = refused(PAIR, *PAIR_OF_BODIES, f"tethers.tow.{keys}")
    assert f"tethers.tow.{key}".removesuffix(".") in faults


@pytest.mark.parametrize(
    ("what", "scene", "key"),
    [
        ("tow", SCENE.replace("damping = 100.0\n", ""), "do"),
        ("tethers.tow.start", SCENE, "on"),
        ("tethers.tow", SCENE, "on"),
        ("tow", HOOKED, "on"),
    ],
)
def test_wrong_releases_are_refused(what: str, scene: str, key: str) -> None:
    assert refused(scene + entry("go", at=0.4, do="release", on=what)) == [f"script[0].{key}"]

"""Tethers: what they add to the net, the snap of two bodies, books, files, and what is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.cli.check import describe
from exunet.forces.effects import bending
from exunet.results import loads as loads_module
from exunet.results.course import course_of
from exunet.results.headlines import headline, headlines_of
from exunet.results.io import load_result
from exunet.results.measures import net_centre
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import run_into, simulate
from exunet.studies.both_codes import both_of_text
from exunet.verification.bodies import motions

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


def pair(folder: Path, *overrides: str, mass: float = 0.5 - LUMP) -> exunet.Case:
    path = folder / "pair.toml"
    path.write_text(PAIR)
    keys = f"mass={mass!r}, inertia=[0.1, 0.1, 0.1]"
    bodies = (
        f"bodies.left={{{keys}}}",
        f"bodies.right={{{keys}, position=[0.9, 0, 0], velocity=[2.5, 0, 0]}}",
    )
    return exunet.load(path, [*bodies, *overrides])


def start(folder: Path, *overrides: str) -> Start:
    return prepare_case(pair(folder, *overrides))


def test_what_a_tether_adds(tmp_path: Path) -> None:
    """Two nodes for its ends, then its inner ones; their masses are those of lumped elements, eq. (9)."""
    net = start(tmp_path, "tethers.tow.divisions=4").net
    assert (net.n_net_nodes, net.n_nodes, net.n_net_elements, net.n_elements) == (2, 7, 1, 5)
    (tether,) = net.tethers
    assert tether.nodes == (2, 4, 5, 6, 3)
    assert net.tether_elements == {"tow": range(1, 5)}
    assert net.element_nodes[1:].tolist() == [[2, 4], [4, 5], [5, 6], [6, 3]]
    np.testing.assert_allclose(net.reference_length[1:], 0.25, rtol=1e-15)
    np.testing.assert_allclose(net.mass[2:], np.array([1, 1, 2, 2, 2]) * LUMP / 4, rtol=1e-14)
    assert net.size == 1.0  # of the net alone


def test_it_lies_straight_and_moves_with_its_ends(tmp_path: Path) -> None:
    """Nodes at a quarter, a half and three quarters of the way between the ends, and of their velocities."""
    turned = (
        "bodies.left.axis=[0, 0, 1]",
        "bodies.left.angle=0.5",
        "bodies.left.angular_velocity=[0, 0, 2]",
        "tethers.tow.start.point=[0.1, 0.2, 0.0]",
        "tethers.tow.divisions=4",
    )
    begin = start(tmp_path, *turned)
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


@pytest.mark.slow
@pytest.mark.parametrize("form", ["exudyn", "compiled"])
def test_the_snap_of_two_bodies(form: str, tmp_path: Path) -> None:
    """As of two masses: E11 = v sqrt(mu / EA L0), N = EA E11 sqrt(1 + 2 E11): 294.65036 N for E = 70 GPa,
    d = 1 mm, L0 = 1 m, mu = 0.25 kg, v = 2.5 m/s; the undamped rebound reverses the relative velocity."""
    sim = exunet.Simulation(prepare_case(pair(tmp_path, f"engine.backend={form}")))
    sim.advance_to(0.06)
    assert sim.largest_tension["tension_N"] == pytest.approx(294.65036, rel=1e-6)
    assert sim.largest_tension["element"] == 1
    assert sim.bodies["right"].velocity[0] == pytest.approx(0.0, abs=1e-6)
    assert sim.bodies["left"].velocity[0] == pytest.approx(2.5, rel=1e-6)


OFF_CENTRE = (
    "tethers.tow.start.point=[0.1, 0.2, -0.1]",
    "tethers.tow.end.point=[-0.1, 0.1, 0.1]",
    "tethers.tow.divisions=3",
    "solver.step=1e-5",
    "time.end=0.2",
)


@pytest.mark.ci
@pytest.mark.slow
def test_books_of_a_snap_off_the_centres(tmp_path: Path) -> None:
    """Momentum and energy before, in and after the snap, to 1e-8 of their scales."""
    begin = start(tmp_path, *OFF_CENTRE)
    result = simulate(begin)
    assert result.tension.max() > 10.0  # it did snap
    assert result.tension[-1].max() == 0.0  # and is slack again
    scale = 2.5 * 0.5
    momentum = result.momentum
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-12 * scale)
    turning = result.angular_momentum
    np.testing.assert_allclose(turning, np.broadcast_to(turning[0], turning.shape), atol=1e-8 * scale)
    total = result.kinetic + result.elastic
    assert np.abs(total / total[0] - 1.0).max() < 1e-5


def test_the_backends_agree_on_a_snap_off_the_centres(tmp_path: Path) -> None:
    found = [
        simulate(start(tmp_path, *OFF_CENTRE, f"engine.backend={backend}")).position
        for backend in ("exudyn", "compiled")
    ]
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_from_the_net_to_a_body(tmp_path: Path) -> None:
    """Tied to a node of the net, whose mass takes half an element; the net has its centre without it."""
    case = pair(tmp_path, "tethers.tow.start={node=1}", "tethers.tow.length=9.0", "tethers.tow.divisions=3")
    begin = prepare_case(case)
    net = begin.net
    assert net.tethers[0].nodes == (1, 3, 4, 2)
    half = LUMP * 9.0 / 3.0
    assert net.mass[1] == pytest.approx(0.1 + LUMP + half, rel=1e-14)
    centre = net_centre(net, begin.position[None, : net.n_nodes])[0]
    own = net.mass[:2]
    np.testing.assert_allclose(centre, own @ begin.position[:2] / own.sum(), rtol=1e-14)


def test_a_result_keeps_its_tethers(tmp_path: Path) -> None:
    case = pair(
        tmp_path,
        "time.end=0.01",
        "tethers.line={diameter=0.001, density=1e3, youngs_modulus=1e9, "
        "length=9.0, start={node=0}, end={body='left', point=[0, 0.1, 0]}}",
    )
    (tmp_path / "out").mkdir()
    result = run_into(tmp_path / "out", case)
    assert [tether.name for tether in result.net.tethers] == ["tow", "line"]
    again = load_result(tmp_path / "out" / "result.h5")
    assert again.net.tethers == result.net.tethers
    assert again.net.tether_elements == {"tow": range(1, 2), "line": range(2, 3)}


def test_check_tells_of_tethers(tmp_path: Path) -> None:
    rows = dict(describe(pair(tmp_path, "tethers.tow.start={node=1}", "tethers.tow.length=9.0")))
    assert rows["tether tow"] == "9 m, elements: 1, from node 1 to body right, 6.06712 m apart at the start"


@pytest.mark.parametrize(("height", "told"), [(0.25, ""), (0.5, "0.25")])
def test_check_tells_of_a_point_beside_its_body(height: float, told: str, tmp_path: Path) -> None:
    """On a sphere of 0.25 m, and 0.25 m from it."""
    sphere = "bodies.right.shape='sphere'", "bodies.right.radius=0.25"
    end = f"tethers.tow.end={{body='right', point=[0, 0, {height}]}}"
    case = pair(tmp_path, "tethers.tow.start={node=1}", "tethers.tow.length=9.0", *sphere, end)
    row = dict(describe(case))["tether tow"]
    assert ("outside its shape" in row) == bool(told)
    if told:
        assert row.endswith(f"; the point (0, 0, {height}) m of right is {told} m outside its shape")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("length=0.8", "length:"),
        ("length=1e200", "length:"),
        ("end={body='nobody'}", "end.body:"),
        ("end={node=7}", "end.node:"),
        ("end={bullet=0}", "end.bullet:"),
        ("end={body='left', point=[1, 0, 0]}", "end:"),
        ("end={node=0, body='left'}", "end.body:"),
        ("end={node=0, point=[1, 0, 0]}", "end.point:"),
        ("end={}", "end:"),
        ("area=1e-6", "area:"),
        ("lenght=1.0", "lenght"),
    ],
)
def test_what_is_refused(keys: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(exunet.CaseError, match=re.escape(f"tethers.tow.{words}")):
        start(tmp_path, f"tethers.tow.{keys}")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("end=", "tethers.tow.end:"),
        (
            "divisions=2000000",
            "tethers.tow.divisions:",
        ),
        ("diameter=1e160", "tethers.tow: "),
    ],
)
def test_what_is_refused_of_a_whole_tether(keys: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(exunet.CaseError, match=re.escape(words)):
        start(tmp_path, f"tethers.tow.{keys}")


def test_names_that_differ_by_capital_letters_are_refused(tmp_path: Path) -> None:
    words = r'tethers\.Tow: differs from "tow" by capital letters only'
    with pytest.raises(exunet.CaseError, match=words):
        start(
            tmp_path,
            "tethers.Tow={diameter=1e-3, density=1e3, youngs_modulus=1e9, length=9.0, "
            "start={node=0}, end={body='right'}}",
        )


def test_a_bullet_and_its_node_are_one_place(tmp_path: Path) -> None:
    """Without strings bullets are nodes of the net: bullet 2 of a square net of one mesh is its node 3."""
    path = tmp_path / "loop.toml"
    path.write_text(LOOP)
    words = "tethers.loop.end: is tied to the same node of the net, 3, as start: a tether joins two"
    with pytest.raises(exunet.CaseError, match=re.escape(words)):
        prepare_case(exunet.load(path, ["tethers.loop.end={node=3}"]))
    prepare_case(exunet.load(path, ["tethers.loop.end={node=2}"]))  # the corner beside it


LOOP = """
format = 1
title = "A tether from a corner"
time = { end = 0.1, output_step = 0.1 }
initial.packing = 1.0
net.topology = "square"
net.size = 1.0
net.mesh = 1.0
net.bullets.mass = 0.1
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
tethers.loop = { diameter = 0.001, density = 1e3, youngs_modulus = 1e9, length = 2.0, start = { bullet = 2 } }
"""

SLANTED = (  # along (3, 4, 0) / 5
    "bodies.right.position=[0.3, 0.4, 0.0]",
    "tethers.tow.divisions=2",
)


def test_rayleigh_damping_acts_along_the_way_between_the_ends(tmp_path: Path) -> None:
    """Eq. (13): each half damps along n = (3, 4, 0) / 5 with beta EA / L0, slack or not."""
    begin = start(tmp_path, *SLANTED, "effects.rayleigh_damping={alpha=0.0, beta=1e-4}")
    damping = begin.system.forces.linear.damping.toarray()
    between = 3 * begin.net.tethers[0].nodes[1]
    n = np.array([0.6, 0.8, 0.0])
    rate = 1e-4 * 70e9 * math.pi * 0.0005**2 / 0.5
    own = damping[between : between + 3, between : between + 3]
    np.testing.assert_allclose(own, 2.0 * rate * np.outer(n, n), atol=1e-12 * rate)
    with_end = damping[between : between + 3, 6:9]  # node 2, at the body on the left
    np.testing.assert_allclose(with_end, -rate * np.outer(n, n), atol=1e-12 * rate)


def test_rayleigh_damping_needs_a_direction(tmp_path: Path) -> None:
    """Both bodies at the origin: nothing says along what to damp. Without beta there is nothing to say."""
    here = "bodies.right.position=[0.0, 0.0, 5e-10]"  # half of what a way of 1 m needs
    words = "tethers.tow.end: its ends are at one place at the start"
    with pytest.raises(exunet.CaseError, match=re.escape(words)):
        start(tmp_path, here, "effects.rayleigh_damping={alpha=0.0, beta=1e-6}")
    start(tmp_path, here, "effects.rayleigh_damping={alpha=0.1, beta=0.0}")


ACROSS = """
format = 1
title = "Tethers across a thread, and in line with it"
time = { end = 0.1, output_step = 0.1 }
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
net.elements = [[0, 1]]
net.node_masses = [0.01, 0.01]
net.divisions = 2
net.cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e8 }
initial.packing = 1.0
bodies.beside = { mass = 10.0, inertia = [0.1, 0.2, 0.25], position = [1.0, 0.3, 0.0] }
bodies.below = { mass = 1.0, inertia = [0.1, 0.2, 0.25], position = [0.0, 0.0, -1.0] }

[tethers.across]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e8
length = 1.2
divisions = 3
start = { node = 0 }
end = { body = "beside", point = [-0.1, 0.0, 0.0] }

[tethers.on]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e8
length = 1.2
divisions = 2
start = { body = "below", point = [0.0, 0.0, 0.1] }
end = { node = 0 }
"""


def test_a_tether_bends_by_itself(tmp_path: Path) -> None:
    """Joints inside the thread and each tether, of one section; none where these meet, in line or not."""
    path = tmp_path / "across.toml"
    path.write_text(ACROSS)
    net = prepare_case(exunet.load(path)).net
    nodes, length, elements = bending.joints(net)
    across, on = (tether.nodes for tether in net.tethers)
    assert {at: {before, after} for before, at, after in nodes[1:].tolist()} == {
        across[1]: {across[0], across[2]},
        across[2]: {across[1], across[3]},
        on[1]: {on[0], on[2]},
    }
    assert set(nodes[0].tolist()) == {0, 1, 2}  # the thread of two elements, of nodes 0 to 2
    assert elements[1:].tolist() == [[2, 3], [3, 4], [5, 6]]
    np.testing.assert_allclose(length[1:], [[0.4, 0.4], [0.4, 0.4], [0.6, 0.6]], rtol=1e-15)


EFFECTS = {
    "bending": "effects.bending={modulus=1e9}",
    "rayleigh_damping": "effects.rayleigh_damping={alpha=0.2, beta=1e-3}",
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_both_codes_have_the_same_forces_on_tethers(effect: str) -> None:
    """Accelerations of nodes and bodies at random states, in every form, as on the ladder (rung 8)."""
    text = f"{EFFECTS[effect]}\n{ACROSS}".replace("effects.", "effects.", 1)
    for check in motions(both_of_text(effect, text), 2):
        assert check.holds, check


@pytest.mark.slow
def test_headlines_of_tethers_and_bodies(tmp_path: Path) -> None:
    """The peak of 294.65 N lasts for a few ms, which all steps see, however few of them are stored."""
    case = pair(tmp_path, "time.output_step=0.02")
    result = exunet.run(case)
    found = headlines_of(course_of(result))
    assert found["tether_tow_largest_tension_N"] == pytest.approx(294.65036, rel=1e-6)
    assert found["tether_tow_largest_tension_N"] == found["largest_tension_N"]
    way = result.bodies["left"].position[-1, 0]
    assert found["body_left_displacement_m"] == pytest.approx(way, rel=1e-12)
    assert headline("tether_tow_largest_tension_N").unit == "N"
    assert headline("body_my_body_displacement_m").words == "displacement of my_body"
    with pytest.raises(KeyError):
        headline("tether_tow_length_m")


@pytest.mark.ci
@pytest.mark.slow
def test_loads_on_the_bodies(tmp_path: Path) -> None:
    """One thread: equal and opposite pulls of its tension along it, with the torques of its arms."""
    result = simulate(start(tmp_path, *OFF_CENTRE, "tethers.tow.divisions=1"))
    left, right = exunet.loads(result, "left"), exunet.loads(result, "right")
    assert (left.nodes.tolist(), right.nodes.tolist()) == ([2], [3])
    np.testing.assert_allclose(left.size[:, 0], result.tension[:, 1], rtol=1e-12)
    np.testing.assert_allclose(left.force, -right.force, rtol=1e-12)
    span = result.position[:, 3] - result.position[:, 2]
    assert np.abs(np.cross(left.force[:, 0], span)).max() < 1e-9 * left.size.max()
    assert (np.einsum("ta,ta->t", left.force[:, 0], span) >= 0.0).all()  # towards the other body
    arm = result.position[:, 2] - result.bodies["left"].position
    np.testing.assert_allclose(left.torque[:, 0], np.cross(arm, left.force[:, 0]), atol=1e-12)
    force, torque = left.total
    np.testing.assert_array_equal(force, left.force[:, 0])
    np.testing.assert_array_equal(torque, left.torque[:, 0])


@pytest.mark.slow
def test_loads_change_the_momentum(tmp_path: Path) -> None:
    """Their integral over the snap is the change of the body's momentum and of its angular momentum."""
    result = simulate(start(tmp_path, *OFF_CENTRE, "time.output_step=1e-4"))
    left = result.bodies["left"]
    force, torque = exunet.loads(result, "left").total
    turns = np.array([rotation_matrix(attitude) for attitude in left.attitude[[0, -1]]])
    spin = np.einsum("tij,jk,tk->ti", turns, left.inertia, left.angular_velocity[[0, -1]])
    gained = (left.mass * (left.velocity[-1] - left.velocity[0]), spin[1] - spin[0])
    for pull, change in zip((force, torque), gained, strict=True):
        size = float(np.linalg.norm(change))
        assert size > 0.01
        given = np.trapezoid(pull, result.time, axis=0)  # of some 200 states in the snap: to 1e-3
        np.testing.assert_allclose(given, change, atol=1e-3 * size)


@pytest.mark.ci
@pytest.mark.slow
def test_loads_of_a_large_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Looked at in parts, the same."""
    result = simulate(start(tmp_path, *OFF_CENTRE))
    whole = exunet.loads(result, "left")
    monkeypatch.setattr(loads_module, "_ROWS", 4)
    parts = exunet.loads(result, "left")
    np.testing.assert_array_equal(parts.force, whole.force)
    np.testing.assert_array_equal(parts.torque, whole.torque)


def test_a_node_that_is_not_there_is_told(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    run_into(tmp_path / "out", pair(tmp_path, "time.end=0.01"))
    with h5py.File(tmp_path / "out" / "result.h5", "r+") as file:
        file["bodies/left/nodes"][0] = 99
    with pytest.raises(exunet.InputError, match="a node is fixed to body left that the net does not have"):
        load_result(tmp_path / "out" / "result.h5")


def test_loads_of_nothing(tmp_path: Path) -> None:
    result = simulate(
        start(tmp_path, "tethers.tow.start={node=1}", "tethers.tow.length=9.0", "time.end=0.01")
    )
    assert exunet.loads(result, "left").force.shape == (2, 0, 3)
    with pytest.raises(exunet.InputError, match=r"no body 'nobody' \(bodies: left, right\)"):
        exunet.loads(result, "nobody")

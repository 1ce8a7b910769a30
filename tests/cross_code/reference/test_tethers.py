"""Tethers and reels of reference_impl: places, masses, known answers, jumps of nodes."""

from __future__ import annotations

import math
import tomllib
from itertools import pairwise

import numpy as np
import pytest

from reference_impl import Refused, acceleration, energy, prepare, read_document
from reference_impl.jumps import hand_over
from reference_impl.reels import Wound, at_start, spread_outside
from reference_impl.state import layout

THREAD = {"area": 1e-6, "density": 1e-9, "youngs_modulus": 1e9}  # E A = 1000 N, next to no mass
FAR = {"nodes": [[100.0, 0, 0], [101.0, 0, 0]], "elements": [[0, 1]], "fixed": [0, 1]}


@pytest.fixture(scope="module")
def tied(explicit):
    """tied(tether, bodies, effects, **net): a case of bodies and a tether, far from a net at rest."""

    def make(tether, bodies, effects=None, **net):
        case = explicit(**{**FAR, **net})
        tethers = {"line": {**THREAD, **tether}} if tether else {}
        return {**case, "bodies": bodies, "tethers": tethers, "effects": effects or {}}

    return make


def ball(mass, **keys):
    return {"mass": mass, "inertia": [0.4 * mass] * 3, **keys}


OFF_CENTRE = {
    "a": {**ball(3.0, velocity=[-1.0, 0.3, 0]), "inertia": [0.5, 0.8, 1.1]},
    "b": {
        **ball(
            6.0, position=[2.0, 0.2, 0.1], attitude=[1.0, 0.2, 0.1, 0.3], angular_velocity=[0.3, 0.1, 0.2]
        ),
        "inertia": [2.0, 1.5, 1.0],
        "centre_of_mass": [0.05, 0.1, -0.1],
    },
}
LINE = {
    "length": 2.2,
    "divisions": 3,
    "density": 50.0,
    "area": 1e-4,
    "youngs_modulus": 1e7,
    "start": {"body": "a", "point": [0.1, 0.3, 0.2]},
    "end": {"body": "b", "point": [-0.3, 0.2, 0.4]},
}


def test_nodes_are_numbered_tether_by_tether(tied, scene):
    """docs/theory.md: of each tether first its ends on bodies, then its inner nodes from start to end."""
    case = tied(LINE, OFF_CENTRE)
    case["tethers"]["led"] = {**LINE, "start": {"node": 1}, "length": 110.0, "divisions": 2}
    case["tethers"]["last"] = {**LINE, "length": 3.0, "divisions": 2}
    made = scene(case)
    chains = [[2, 4, 5, 3], [1, 7, 6], [8, 10, 9]]
    for number, nodes in enumerate(chains):
        pairs = made.net.element_nodes[made.net.tether == number]
        assert pairs.tolist() == [list(pair) for pair in pairwise(nodes)]
    assert sorted(made.net.anchors.node.tolist()) == [2, 3, 6, 8, 9]
    for start, middle, end in chains[1:]:
        np.testing.assert_allclose(made.x0[middle], 0.5 * (made.x0[start] + made.x0[end]), atol=1e-13)
        np.testing.assert_allclose(made.v0[middle], 0.5 * (made.v0[start] + made.v0[end]), atol=1e-13)


def test_a_tether_lies_straight_and_moves_linearly_between_its_ends(tied, scene):
    made = scene(tied(LINE, OFF_CENTRE))
    net, (a, b) = made.net, made.case.bodies
    assert (net.woven, len(net.mass), len(net.area)) == (2, 6, 4)
    (start, speed), (end, other) = a.at(np.array([0.1, 0.3, 0.2])), b.at(np.array([-0.3, 0.2, 0.4]))
    chain = [*net.element_nodes[1:, 0].tolist(), net.element_nodes[-1, 1]]
    for k, node in enumerate(chain):
        assert made.x0[node] == pytest.approx(start + k / 3.0 * (end - start), rel=1e-14)
        if 0 < k < 3:
            expected = made.v0[chain[0]] + k / 3.0 * (made.v0[chain[3]] - made.v0[chain[0]])
            assert made.v0[node] == pytest.approx(expected, rel=1e-13)
    element = 50.0 * 1e-4 * 2.2 / 3.0
    assert net.mass[chain] == pytest.approx([element / 2, element, element, element / 2], rel=1e-14)
    assert made.system.bodies.mass == pytest.approx([3.0 + element / 2, 6.0 + element / 2], rel=1e-15)
    assert speed == pytest.approx(
        made.v0[chain[0]], abs=0.01
    )  # the mass of its end moves the centre a little
    assert other == pytest.approx(made.v0[chain[3]], abs=0.01)


def test_a_tether_between_nodes_is_an_element_like_any_other(explicit, scene):
    """Two nodes joined by a tether move as if the net had the element."""
    nodes, cable = [[0.0, 0, 0], [1.0, 0, 0], [2.5, 0.5, 0]], {**THREAD, "density": 1000.0}
    start = {"node_velocities": [[0.0, 0, 0], [0, 0, 0], [1.0, 2.0, 0.5]]}
    length = math.dist(nodes[1], nodes[2])
    whole = explicit(nodes, [[0, 1], [1, 2]], start, cable=cable)
    parts = explicit(nodes, [[0, 1]], start, cable=cable)
    rope = {**cable, "length": length, "start": {"node": 1}, "end": {"node": 2}}
    parts["net"]["node_masses"] = whole["net"]["node_masses"] = [0.1, 0.1, 0.1]
    one, two = scene(whole), scene({**parts, "tethers": {"rope": rope}})
    assert np.array_equal(one.net.mass, two.net.mass)
    assert np.array_equal(one.net.element_nodes, two.net.element_nodes)
    times = [0.0, 0.05]
    assert two.integrate(times).x == pytest.approx(one.integrate(times).x, abs=1e-12)


def test_acceleration_of_an_end_on_a_body_is_that_of_the_point(tied, scene):
    """By differences of a run with short steps."""
    made = scene(
        tied({**LINE, "length": 2.0}, {**OFF_CENTRE, "a": {**OFF_CENTRE["a"], "position": [-0.2, 0, 0]}})
    )
    h = 1e-5
    run = made.integrate([0.0, h, 2.0 * h])
    found = (run.v[2] - run.v[0]) / (2.0 * h)
    states = type(run.bodies)(*(getattr(run.bodies, k)[1] for k in vars(run.bodies)))
    a = acceleration(made.system, h, run.x[1], run.v[1], states)
    assert a == pytest.approx(found, rel=1e-4, abs=1e-3)
    with pytest.raises(ValueError, match="points of bodies"):
        acceleration(made.system, h, run.x[1], run.v[1])


def test_nodes_of_woven_nets_have_no_numbers_but_free_ends_of_strings(document):
    case = {**document("radial"), "bodies": {"a": ball(1.0)}}
    case["tethers"] = {"line": {**THREAD, "length": 9.0, "start": {"node": 2}, "end": {"body": "a"}}}
    with pytest.raises(Refused, match=r"does not know tethers.line.start.node = 2"):
        read_document(case)
    del case["net"]["bullets"], case["launch"]
    net = prepare(read_document(case)).net
    place = net.reference_position[net.element_nodes[-1, 0]]
    assert math.atan2(place[1], place[0]) == pytest.approx(math.pi / 2.0)
    assert np.hypot(*place[:2]) == pytest.approx(2.0 + math.sqrt(2.0))


HEAD = """
format = 1
title = "A reel"
time = { end = 1.0, output_step = 0.1 }
net.topology = "explicit"
net.nodes = [[100.0, 0.0, 0.0], [101.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.1, 0.1]
net.fixed = [0, 1]
net.cable = { diameter = 0.001, density = 1000.0, youngs_modulus = 1e9 }
initial.packing = 1.0
"""

# E A = 1000 N, a node has 40 g; 4 m of it are a spring of 250 N/m
REELED = """
[bodies.drum]
mass = 1e6
inertia = [1e6, 1e6, 1e6]
[bodies.target]
mass = 5.0
inertia = [3.0, 4.0, 5.0]
position = [4.0, 0.0, 0.0]
[tethers.line]
length = 6.0
divisions = 3
area = 1e-6
density = 2e4
youngs_modulus = 1e9
start = { body = "drum" }
end = { body = "target" }
[tethers.line.reel]
paid_out = 4.0
damping = 10.0
"""
MASS, SPRING = 5.0, 250.0

TUMBLING = """
[bodies.drum]
mass = 6.0
inertia = [1.0, 1.5, 2.0]
products_of_inertia = [0.1, -0.2, 0.15]
centre_of_mass = [0.05, 0.1, -0.1]
velocity = [0.1, -0.2, 0.05]
angular_velocity = [0.2, 0.3, -0.5]
[bodies.target]
mass = 4.0
inertia = [0.8, 1.0, 1.2]
position = [2.6, 0.1, 0.3]
angular_velocity = [-0.3, 0.1, 0.4]
[tethers.line]
length = 4.0
divisions = 8
area = 1e-4
density = 800.0
youngs_modulus = 1e6
start = { body = "target", point = [-0.3, 0.1, 0.0] }
end = { body = "drum", point = [0.4, 0.3, -0.2] }
[tethers.line.reel]
at = "end"
paid_out = 2.4
largest_rate = 2.0
damping = 30.0
commands = [
  { at = 0.0, mode = "rate", rate = 1.0 },
  { at = 1.0, mode = "brake", force = 0.5 },
  { at = 1.5, mode = "rate", rate = -1.2, force = 2.0 },
  { at = 2.6, mode = "tension", force = 1.0 },
  { at = 3.0, mode = "lock" },
]
"""


@pytest.fixture(scope="module")
def reel():
    """reel(text, overrides, commands): a scene of the head and this text."""

    def make(text=REELED, overrides=None, commands=None):
        document = tomllib.loads(HEAD + text)
        if commands is not None:
            document["tethers"]["line"]["reel"]["commands"] = commands
        return prepare(read_document(document, overrides))

    return make


# known answers


@pytest.mark.slow
def test_brake_stops_a_drifting_target(reel):
    """m v' = -(F + c v): it pays out (m/c)(v0 - (F/c) ln(1 + c v0/F)); the brake takes all of K but what the
    line holds then, F^2/(2 k).  With c = 0 the way would be K/F."""
    force, speed, damping = 2.0, 0.8, 2.0
    made = reel(
        overrides={"bodies.target.velocity": [speed, 0, 0], "tethers.line.reel.damping": damping},
        commands=[{"at": 0.0, "mode": "brake", "force": force}],
    )
    run = made.integrate(np.linspace(0.0, 2.0, 101), rtol=1e-7, atol=1e-9)
    paid, kinetic = 2.0 - run.reels.wound_up[:, 0], 0.5 * MASS * speed**2
    way = MASS / damping * (speed - force / damping * math.log(1.0 + damping * speed / force))
    assert paid[-1] == pytest.approx(way, rel=2e-2)
    assert paid[-1] < kinetic / force
    assert np.all(np.diff(paid) >= 0.0)
    assert -run.reels.work[-1, 0] == pytest.approx(kinetic - 0.5 * force**2 / SPRING, rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("commands", [None, [{"at": 0.0, "mode": "lock"}]], ids=["none", "lock"])
def test_locked_is_a_tether_of_that_length(reel, commands):
    """Nothing is wound up, and the target moves as on a tether of 4 m in 2 pieces with the same nodes."""
    drift = {"bodies.target.velocity": [0.3, 0.1, 0]}
    run = reel(overrides=drift, commands=commands).integrate([0.0, 2.0], rtol=1e-8, atol=1e-10)
    document = tomllib.loads(HEAD + REELED)
    line = document["tethers"]["line"]
    del line["reel"]
    line.update(length=4.0, divisions=2)
    plain = prepare(read_document(document, drift)).integrate([0.0, 2.0], rtol=1e-8, atol=1e-10)
    assert np.all(run.reels.wound_up == 2.0)
    assert np.all(run.reels.work == 0.0)
    assert run.bodies.position[1, 1] == pytest.approx(plain.bodies.position[1, 1], abs=1e-7)


@pytest.mark.slow
def test_limits_slow_the_drum(reel):
    """The way d left to a limit falls by rate d/(l/4) in the last quarter of an element: exponentially."""
    rate, quarter = 0.5, 0.5
    made = reel(
        overrides={"tethers.line.reel.shortest": 3.0, "tethers.line.reel.largest_rate": rate},
        commands=[{"at": 0.0, "mode": "rate", "rate": 9.0}, {"at": 4.0, "mode": "rate", "rate": -9.0}],
    )
    run = made.integrate([0.0, 1.0, 1.5, 2.0, 4.0, 5.0, 10.0, 11.0], rtol=1e-6, atol=1e-8)
    s = run.reels.wound_up[:, 0]
    assert s[:2] == pytest.approx([2.0, 2.5], abs=1e-9)
    assert s[2:5] == pytest.approx(3.0 - quarter * np.exp(1.0 - run.t[2:5]), rel=1e-5)
    reached = 4.0 + (s[4] - quarter) / rate
    assert s[5] == pytest.approx(s[4] - rate, abs=1e-9)
    assert s[6:] == pytest.approx(quarter * np.exp(reached - run.t[6:]), rel=1e-3)


# conservation


def test_a_node_that_changes_hands_keeps_all_momenta(reel):
    """Off the drum and on again: what the energy falls by is counted, momenta stay to round-off."""
    made = reel(TUMBLING)
    where = layout(made.system)
    y = where.pack(made.x0, made.v0, made.bodies0)
    y[: where.half] += 0.05 * np.sin(np.arange(where.half))
    y[where.half : 2 * where.half] += 0.3 * np.cos(np.arange(where.half))
    where.wound(y).wound_up[:] = 1.4  # of pieces of 0.5 m, 3 on the drum: the outlet is 0.6 m long
    for onto, k in ((True, 4.0), (False, 3.0), (False, 2.0)):
        after = hand_over(where, y, 0, onto)
        assert where.wound(after).held[0] == k
        old, new = (balance(made.system, where, state) for state in (y, after))
        assert new[0] == pytest.approx(old[0], abs=1e-14)
        assert new[1] == pytest.approx(old[1], abs=1e-14)
        assert new[2] + after[-1] == pytest.approx(old[2] + y[-1], rel=1e-13)
        assert abs(after[-1] - y[-1]) > 1e-5
        y = after


def test_a_node_that_comes_off_lies_on_the_line(reel):
    """At the part f = (L0 - l)/L0 of the way; its velocity along the line the next node.s, across f of it."""
    made = reel(TUMBLING)
    where, reels = layout(made.system), made.system.reels
    y = where.pack(made.x0, made.v0, made.bodies0)
    where.wound(y).wound_up[:] = 1.25
    where.wound(y).held[:] = 3.0  # L0 = 4 l - s = 0.75 m
    node, following, drum = reels.nodes[0][2], reels.nodes[0][3], reels.drum[0]
    before, after = where.whole(y), where.whole(hand_over(where, y, 0, onto=False))
    way = before.x[following] - before.x[drum]
    assert after.x[node] - before.x[drum] == pytest.approx(way / 3.0, abs=1e-14)
    along, u = way / np.linalg.norm(way), before.v[following] - before.v[drum]
    own = after.v[node] - before.v[drum]
    assert own @ along == pytest.approx(u @ along, abs=1e-14)
    assert np.cross(own, along) == pytest.approx(np.cross(u, along) / 3.0, abs=1e-14)


def balance(system, where, y):
    """Momentum, angular momentum and energy of a state y."""
    whole, bodies, wound = where.whole(y), where.body_states(y), where.wound(y)
    x, v = whole.x[: where.nodes], whole.v[: where.nodes]
    inside, outlets = energy.at_outlets(system, x, wound)
    held = energy.elastic(system, x, inside) + outlets + energy.potential(system, x, bodies)
    return (
        energy.momentum(system, v, bodies),
        energy.angular_momentum(system, x, v, bodies),
        held + energy.kinetic(system, v, bodies),
    )


def test_acceleration_of_a_state(reel):
    """Nodes on the drum have its acceleration; without the reels' state it is refused."""
    made = reel(TUMBLING)
    state = Wound(np.array([1.4]), np.array([3.0]), np.zeros(1))
    a = acceleration(made.system, 0.5, made.x0, made.v0, made.bodies0, reels=state)
    drum, held = made.system.reels.drum[0], made.system.reels.nodes[0][:3]
    assert np.all(a[held] == a[drum])
    assert np.abs(a[drum]).max() > 0.01
    with pytest.raises(ValueError, match="reel"):
        acceleration(made.system, 0.5, made.x0, made.v0, made.bodies0)


# places at time 0


@pytest.mark.parametrize(
    ("paid_out", "held"), [(6.0, 0), (4.0, 2), (3.5, 2), (3.25, 3), (3.26, 2), (1.2, 5), (0.25, 5)]
)
def test_nodes_on_the_drum_at_time_0(paid_out, held):
    """Pieces of 1 m: L0 = paid_out - (5 - k) l must exceed a quarter, and the last piece is outside."""
    assert at_start(6.0, 6, paid_out) == (6.0 - paid_out, held)
    places = spread_outside(6.0, 6, paid_out)
    outside = [paid_out - rest for rest in range(5 - held, 0, -1)]
    assert places == pytest.approx([0.0] * held + [place / paid_out for place in outside], abs=1e-15)


def test_a_launch_recoils_on_body_and_held_nodes(reel):
    """Bullets that a body throws take their momenta from it and what it holds: three nodes of 0.04 kg."""
    thrown = {"net.topology": "square", "net.size": 1.0, "net.mesh": 0.5, "net.bullets.mass": 0.3}
    thrown |= {f"net.{key}": None for key in ("nodes", "elements", "node_masses", "fixed")}
    thrown |= {"initial.packing": 0.2, "initial.frame": {"body": "drum", "position": [0.5, 0.6, 0.7]}}
    made = [
        reel(TUMBLING, {**thrown, "launch": {"radial_speed": speed, "axial_speed": speed}})
        for speed in (0.0, 2.0)
    ]
    rest, recoiled = (_kept(item, 3) for item in made)
    assert recoiled == pytest.approx(rest, abs=1e-14)
    assert np.abs(made[1].bodies0.velocity[0] - made[0].bodies0.velocity[0]).max() > 0.1


def _kept(made, held):
    """Momentum and angular momentum (6,) at time 0 of the drum's body, the nodes on it, and the bullets."""
    system, bodies = made.system, made.bodies0
    nodes = np.concatenate((system.reels.nodes[0][:held], made.net.bullet_nodes))
    momenta = made.net.mass[nodes, None] * made.v0[nodes]
    own = system.bodies.mass[0] * bodies.velocity[0]
    spin = bodies.attitude[0] @ system.bodies.inertia[0] @ bodies.angular_velocity[0]
    moment = np.cross(made.x0[nodes], momenta).sum(axis=0) + np.cross(bodies.position[0], own)
    return np.concatenate((momenta.sum(axis=0) + own, moment + spin))


# bad input

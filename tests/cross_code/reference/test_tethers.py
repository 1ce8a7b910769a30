"""Tethers and reels of reference_impl: locked reels, jumps of nodes, recoil."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest

from reference_impl import energy, prepare, read_document
from reference_impl.jumps import hand_over
from reference_impl.state import layout

THREAD = {"area": 1e-6, "density": 1e-9, "youngs_modulus": 1e9}  # E A = 1000 N, next to no mass


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


# places at time 0


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

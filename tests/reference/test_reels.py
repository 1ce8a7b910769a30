"""Reels of reference_impl: known answers, conservation over nodes that go on and off drums, bad input."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest

from reference_impl import Refused, acceleration, energy, prepare, read_document
from reference_impl.bodies import BodyStates, loaded
from reference_impl.reels import at_start, spread_outside

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

# E A = 100 N; the tether's mass is 1e-6 kg, next to nothing, but for TUMBLING
LINE = """
[bodies.drum]
mass = 1e6
inertia = [1e6, 1e6, 1e6]
[bodies.target]
mass = 20.0
inertia = [3.0, 4.0, 5.0]
position = [4.0, 0.0, 0.0]
[tethers.line]
length = 6.0
divisions = 6
area = 1e-6
density = 2000.0
youngs_modulus = 1e8
start = { body = "drum" }
end = { body = "target" }
[tethers.line.reel]
paid_out = 4.0
damping = 200.0
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

    def make(text=LINE, overrides=None, commands=None):
        document = tomllib.loads(HEAD + text)
        if commands is not None:
            document["tethers"]["line"]["reel"]["commands"] = commands
        return prepare(read_document(document, overrides))

    return make


def apart(run):
    return np.linalg.norm(run.bodies.position[:, 1] - run.bodies.position[:, 0], axis=1)


def turned_off(run):
    """Greatest changes of momentum and angular momentum over what one body has of them."""
    return np.abs(run - run[0]).max() / np.abs(run).max()


# known answers


def test_constant_rate_pulls_the_target_at_that_rate(reel):
    """After the snap, v sqrt(E A m/L0) by hand, a line without mass or damping leaves the target with twice the
    rate; one that is viscous leaves it with the rate, and no tension."""
    rate = 0.2
    made = reel(
        commands=[{"at": 0.0, "mode": "rate", "rate": rate}],
        overrides={"effects.material_damping.relaxation_time": 0.4},
    )
    run = made.integrate([0.0, 6.0, 7.0, 8.0], rtol=1e-8, atol=1e-10)
    speed = -run.bodies.velocity[1:, 1, 0]
    assert run.reels.wound_up[1:, 0] == pytest.approx(2.0 + rate * np.array([6.0, 7.0, 8.0]), abs=1e-9)
    assert speed == pytest.approx([rate] * 3, rel=2e-2)


def test_greatest_tension_of_a_snap(reel):
    """A rate v against a target at rest: N = v sqrt(E A m/L0), for a line without mass (a spring, L0 constant).

    The length changes by a hundredth meanwhile, and E11 is not the engineering strain.
    """
    rate, mass, stiffness, length = 0.02, 20.0, 100.0, 4.0
    made = reel(commands=[{"at": 0.0, "mode": "rate", "rate": rate}])
    quarter = 0.5 * math.pi * math.sqrt(mass * length / stiffness)
    run = made.integrate([0.0, quarter], rtol=1e-8, atol=1e-10)
    strain = apart(run)[1] / (6.0 - run.reels.wound_up[1, 0]) - 1.0
    assert stiffness * strain == pytest.approx(rate * math.sqrt(stiffness * mass / length), rel=2e-2)
    assert -run.bodies.velocity[1, 1, 0] == pytest.approx(rate, rel=2e-2)


def test_constant_force_accelerates_the_target(reel):
    """In balance ds/dt = (F - N)/c is the speed v of the target, m dv/dt = N: v = F/c (1 - exp(-t c/m))."""
    force, damping, mass = 2.0, 200.0, 20.0
    made = reel(commands=[{"at": 0.0, "mode": "tension", "force": force}])
    times = np.linspace(0.0, 0.5, 6)
    run = made.integrate(times, rtol=1e-8, atol=1e-10)
    stiff = made.net.youngs_modulus[-1] * made.net.area[-1] / 4.0
    # the line is a spring k in series with the drive: m v' = N, N' = k (ds/dt - v)
    matrix = np.array([[0.0, 1.0 / mass], [-stiff, -stiff / damping]])
    driving = np.array([0.0, stiff * force / damping])
    rest = np.linalg.solve(matrix, -driving)
    values, vectors = np.linalg.eig(matrix)
    weights = np.linalg.solve(vectors, -rest)
    speed = [rest[0] + (vectors[0] * weights * np.exp(values * t)).sum().real for t in times]
    assert -run.bodies.velocity[:, 1, 0] == pytest.approx(speed, rel=2e-2, abs=1e-5)


def test_constant_force_by_hand(reel):
    """A heavy target and a weak drive: N = F, so the acceleration is F/m; the drum does the work F s."""
    force, mass = 2.0, 2e4
    made = reel(
        overrides={"bodies.target.mass": mass, "effects.material_damping.relaxation_time": 0.05},
        commands=[{"at": 0.0, "mode": "tension", "force": force}],
    )
    run = made.integrate([0.0, 4.0, 8.0], rtol=1e-7, atol=1e-10)
    speed = -run.bodies.velocity[:, 1, 0]
    assert (speed[2] - speed[1]) / 4.0 == pytest.approx(force / mass, rel=2e-2)


def test_brake_stops_a_drifting_target(reel):
    """K = F d by hand: the brake takes all but what the line stores, and the excess c ds/dt takes the rest."""
    force, mass, speed = 5.0, 20.0, 0.8
    made = reel(
        overrides={
            "bodies.target.velocity": [speed, 0, 0],
            "tethers.line.length": 12.0,
            "tethers.line.divisions": 6,
            "tethers.line.youngs_modulus": 1e9,
            "tethers.line.reel.damping": 1.0,
            "effects.material_damping.relaxation_time": 0.02,
        },
        commands=[{"at": 0.0, "mode": "brake", "force": force}],
    )
    run = made.integrate(np.linspace(0.0, 4.0, 401), rtol=1e-7, atol=1e-9)
    paid = 8.0 - run.reels.wound_up[:, 0]
    kinetic = 0.5 * mass * speed**2
    stored = 0.5 * force**2 / 1000.0 * (4.0 + paid[-1])
    assert 0.9 < paid[-1] / ((kinetic - stored) / force) < 1.0
    assert np.all(np.diff(run.reels.wound_up[:, 0]) <= 0.0)
    assert run.reels.work[-1, 0] == pytest.approx(-force * paid[-1], rel=0.15)
    assert run.reels.work[-1, 0] < -force * paid[-1]


@pytest.mark.parametrize("commands", [[], [{"at": 0.0, "mode": "lock"}]], ids=["none", "lock"])
def test_locked_is_a_tether_of_that_length(reel, scene, commands):
    """Nothing is wound up, and target and nodes move as with a tether of 4 m in 4 pieces of the same mass."""
    drift = {"bodies.target.velocity": [0.3, 0.1, 0]}
    run = reel(overrides=drift, commands=commands).integrate([0.0, 2.0])
    document = tomllib.loads(HEAD + LINE)
    line = document["tethers"]["line"]
    del line["reel"]
    line.update(length=4.0, divisions=4)
    plain = prepare(read_document(document, drift)).integrate([0.0, 2.0])
    assert np.all(run.reels.wound_up == 2.0)
    assert np.all(run.reels.work == 0.0)
    assert run.bodies.position[1, 1] == pytest.approx(plain.bodies.position[1, 1], abs=1e-9)


def test_limits_slow_the_drum(reel):
    """Towards a limit d' = -rate d/(l/4): after the last quarter element, exponential in t rate/(l/4)."""
    rate = 0.5
    made = reel(
        overrides={"tethers.line.reel.shortest": 3.0, "tethers.line.reel.largest_rate": rate},
        commands=[{"at": 0.0, "mode": "rate", "rate": 9.0}, {"at": 4.0, "mode": "rate", "rate": -9.0}],
    )
    run = made.integrate([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0, 13.0], rtol=1e-7, atol=1e-10)
    s = run.reels.wound_up[:, 0]
    left = 0.25 * np.exp(-(np.array([1.5, 2.0, 3.0, 4.0]) - 1.5) * rate / 0.25)
    assert s[:2] == pytest.approx([2.0, 2.5], abs=1e-9)
    assert s[2:6] == pytest.approx(3.0 - left, rel=1e-6)
    begin = s[5]
    reached = (begin - 0.25) / rate
    assert s[6:] == pytest.approx(0.25 * np.exp(-(np.array([5.0, 9.0]) - reached) * rate / 0.25), rel=1e-5)


# conservation


@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({"rtol": 1e-9, "atol": 1e-11}, 1e-7),
        ({"method": "RK45", "rtol": 1e-7, "atol": 1e-9}, 1e-5),
        ({"method": "RK4", "step": 1e-3}, 1e-3),
        ({"method": "Verlet", "step": 5e-4}, 1e-3),
    ],
    ids=["DOP853", "RK45", "RK4", "Verlet"],
)
def test_books_close_over_nodes_going_on_and_off(reel, unbalanced, options, bound):
    made = reel(TUMBLING, {"effects.material_damping.relaxation_time": 2e-3})
    run = made.integrate(np.linspace(0.0, 3.5, 36), **options)
    held = run.reels.held[:, 0]
    assert held.max() >= 5.0
    assert np.diff(held).min() < 0.0 < np.diff(held).max()
    books = energy.books(made.system, run)
    assert np.abs(books.momentum - books.momentum[0]).max() < 1e-10
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < bound
    assert unbalanced(made, run) < bound

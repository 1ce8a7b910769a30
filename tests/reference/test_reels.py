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

# E A = 1000 N, a node has 40 g; 4 m of it are a spring of 250 N/m
LINE = """
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
MASS, SPRING, DAMPING = 5.0, 250.0, 10.0
RK4 = {"method": "RK4", "step": 4e-3}

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


def pulled(times, force):
    """Speeds of a target that hangs on a spring in series with a drive: m v' = N, N' = k ((F - N)/c - v)."""
    matrix = np.array([[0.0, 1.0 / MASS], [-SPRING, -SPRING / DAMPING]])
    rest = np.array([force / DAMPING, 0.0])  # v = F/c, N = 0
    rates, modes = np.linalg.eig(matrix)
    weights = np.linalg.solve(modes, -rest)
    return rest[0] + np.exp(np.outer(times, rates)) @ (modes[0] * weights)


# known answers


def test_constant_rate_pulls_the_target_at_that_rate(reel):
    """After the transient of a rate that slips, rate - N/c, the speed is the rate and the line has no tension."""
    rate = 0.1
    made = reel(commands=[{"at": 0.0, "mode": "rate", "rate": rate, "force": 0.0}])
    times = np.array([0.0, 0.3, 0.6, 5.0, 6.0])
    run = made.integrate(times, **RK4)
    speed = -run.bodies.velocity[:, 1, 0]
    assert speed == pytest.approx(pulled(times, rate * DAMPING), rel=2e-2)
    assert speed[-2:] == pytest.approx([rate] * 2, rel=2e-2)
    assert np.diff(run.reels.wound_up[-2:, 0]) == pytest.approx([rate], rel=2e-2)


def test_rebound_from_a_rate_that_does_not_slip(reel):
    """A line that shortens by a constant rate is an elastic wall that moves: rate at a quarter of the period
    2 pi sqrt(m/k), twice the rate at half of it, where the line goes slack."""
    rate, period = 0.1, 2.0 * math.pi * math.sqrt(MASS / SPRING)
    made = reel(commands=[{"at": 0.0, "mode": "rate", "rate": rate}])
    run = made.integrate(np.array([0.0, 0.25, 0.5, 1.0]) * period, **RK4)
    assert -run.bodies.velocity[1:, 1, 0] == pytest.approx([rate, 2.0 * rate, 2.0 * rate], rel=3e-2)
    assert run.reels.wound_up[:, 0] == pytest.approx(2.0 + rate * run.t, abs=1e-12)


def test_constant_force_accelerates_the_target(reel):
    """(F - N)/c is the speed in the end: m v' = N = F - c v, and before that the spring fills."""
    times = np.linspace(0.0, 1.0, 6)
    run = reel(commands=[{"at": 0.0, "mode": "tension", "force": 2.0}]).integrate(times, **RK4)
    assert -run.bodies.velocity[:, 1, 0] == pytest.approx(pulled(times, 2.0), rel=2e-2, abs=1e-4)


def test_constant_force_on_a_heavy_target(reel):
    """Of a target that hardly moves the acceleration is F/m."""
    force, mass = 2.0, 2e4
    commands = [{"at": 0.0, "mode": "tension", "force": force}]
    run = reel(overrides={"bodies.target.mass": mass}, commands=commands).integrate([0.0, 2.0, 4.0], **RK4)
    speed = -run.bodies.velocity[:, 1, 0]
    assert (speed[2] - speed[1]) / 2.0 == pytest.approx(force / mass, rel=1e-2)


def test_brake_stops_a_drifting_target(reel):
    """m v' = -(F + c v): it pays out (m/c)(v0 - (F/c) ln(1 + c v0/F)); the brake takes all of K but what the
    line holds then, F^2/(2 k).  With c = 0 the way would be K/F."""
    force, speed, damping = 2.0, 0.8, 2.0
    made = reel(
        overrides={"bodies.target.velocity": [speed, 0, 0], "tethers.line.reel.damping": damping},
        commands=[{"at": 0.0, "mode": "brake", "force": force}],
    )
    run = made.integrate(np.linspace(0.0, 2.0, 101), method="RK4", step=2e-3)
    paid, kinetic = 2.0 - run.reels.wound_up[:, 0], 0.5 * MASS * speed**2
    way = MASS / damping * (speed - force / damping * math.log(1.0 + damping * speed / force))
    assert paid[-1] == pytest.approx(way, rel=2e-2)
    assert paid[-1] < kinetic / force
    assert np.all(np.diff(paid) >= 0.0)
    assert -run.reels.work[-1, 0] == pytest.approx(kinetic - 0.5 * force**2 / SPRING, rel=1e-2)


@pytest.mark.parametrize("commands", [[], [{"at": 0.0, "mode": "lock"}]], ids=["none", "lock"])
def test_locked_is_a_tether_of_that_length(reel, commands):
    """Nothing is wound up, and the target moves as on a tether of 4 m in 2 pieces with the same nodes."""
    drift = {"bodies.target.velocity": [0.3, 0.1, 0]}
    run = reel(overrides=drift, commands=commands).integrate([0.0, 2.0], **RK4)
    document = tomllib.loads(HEAD + LINE)
    line = document["tethers"]["line"]
    del line["reel"]
    line.update(length=4.0, divisions=2)
    plain = prepare(read_document(document, drift)).integrate([0.0, 2.0], **RK4)
    assert np.all(run.reels.wound_up == 2.0)
    assert np.all(run.reels.work == 0.0)
    assert run.bodies.position[1, 1] == pytest.approx(plain.bodies.position[1, 1], abs=1e-7)


def test_limits_slow_the_drum(reel):
    """The way d left to a limit falls by rate d/(l/4) in the last quarter of an element: exponentially."""
    rate, quarter = 0.5, 0.5
    made = reel(
        overrides={"tethers.line.reel.shortest": 3.0, "tethers.line.reel.largest_rate": rate},
        commands=[{"at": 0.0, "mode": "rate", "rate": 9.0}, {"at": 4.0, "mode": "rate", "rate": -9.0}],
    )
    run = made.integrate([0.0, 1.0, 1.5, 2.0, 4.0, 5.0, 10.0, 11.0], **RK4)
    s = run.reels.wound_up[:, 0]
    assert s[:2] == pytest.approx([2.0, 2.5], abs=1e-9)
    assert s[2:5] == pytest.approx(3.0 - quarter * np.exp(1.0 - run.t[2:5]), rel=1e-5)
    reached = 4.0 + (s[4] - quarter) / rate
    assert s[5] == pytest.approx(s[4] - rate, abs=1e-9)
    assert s[6:] == pytest.approx(quarter * np.exp(reached - run.t[6:]), rel=1e-3)


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

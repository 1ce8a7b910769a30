"""Reels: the drive's law, the outlet's force and energy, nodes on and off the drum, what is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scenes import BACKENDS, case_file, continue_alike, every_backend, of_text, refused

import exunet
import reference_impl
from exunet.bodies import kinematics
from exunet.bodies.port import PrescribedMotion
from exunet.bodies.rotations import rotation_matrix
from exunet.forces import reel
from exunet.forces.on_bodies import mass_matrix
from exunet.forces.reel import reel_term
from exunet.model.components import Drum
from exunet.model.states import States
from exunet.net.drive import WITHOUT_LIMIT, Drive
from exunet.net.tether import Reel, ReeledTether, reel_of
from exunet.simulation.guards import state_of_worst
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.simulation import Simulation

Floats = np.ndarray

# Two bodies, 3 m apart, which fly together or apart; a tether of 4 m in 8 elements of 0.5 m and 1 kN.
SCENE = """
format = 1
title = "A reel between two bodies"
time = {{ end = 0.4, output_step = 0.02 }}
solver = {{ method = "RK44", step = 2e-4 }}
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[0.0, 50.0, 0.0]]
net.elements = []
net.node_masses = [1.0]
net.cable = {{ diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }}

[bodies.left]
mass = {left}
inertia = [0.3, 0.4, 0.5]
angular_velocity = [0.1, -0.2, 0.3]

[bodies.right]
mass = {right}
inertia = [0.5, 0.4, 0.6]
position = [3.0, 0.1, 0.0]
velocity = [{speed}, 0.0, 0.0]
angular_velocity = [-0.2, 0.1, 0.4]

[tethers.line]
diameter = 0.01
density = {density}
youngs_modulus = {modulus}
length = 4.0
divisions = 8
start = {{ body = "left", point = [0.1, 0.05, -0.02] }}
end = {{ body = "right", point = [-0.1, 0.1, 0.03] }}

[tethers.line.reel]
paid_out = 2.9
damping = 20.0
commands = [{commands}]
"""
SECTION = math.pi * 0.005**2
LUMP = 1390.0 * SECTION * 0.5  # of a node between two elements of 0.5 m [kg]


def case_of(*overrides: str, commands: str = "", **given: float) -> exunet.Case:
    numbers = {"left": 2.0, "right": 3.0, "speed": 0.0, "density": 1390.0, "modulus": 1e3 / SECTION} | given
    return of_text(SCENE.format(commands=commands, **numbers), *overrides)


def start_of(*overrides: str, commands: str = "", **given: float) -> Start:
    return prepare_case(case_of(*overrides, commands=commands, **given))


EMPTY = SCENE.format(left=2.0, right=3.0, speed=0.0, density=1390.0, modulus=1e3 / SECTION, commands="")


def command(at: float, mode: str, **numbers: float) -> str:
    keys = [f"at = {at}", f'mode = "{mode}"', *(f"{key} = {value}" for key, value in numbers.items())]
    return "{ " + ", ".join(keys) + " },"


def test_where_nodes_are_at_the_start() -> None:
    """1.1 m are wound up: two nodes at the drum, an outlet of 0.4 m, five elements of 0.5 m."""
    start = start_of()
    (tether,) = start.net.tethers
    chain = start.position[list(tether.nodes)]
    np.testing.assert_array_equal(chain[:3], np.repeat(chain[:1], 3, axis=0))
    way = (chain - chain[0]) @ (chain[-1] - chain[0]) / ((chain[-1] - chain[0]) @ (chain[-1] - chain[0]))
    np.testing.assert_allclose(way[2:] * 2.9, [0.0, 0.4, 0.9, 1.4, 1.9, 2.4, 2.9], atol=1e-14)
    own = 0.5 * LUMP  # of the node at the drum's point, which moves the body's centre of mass
    speed = np.cross([0.1, -0.2, 0.3], [0.1, 0.05, -0.02]) * 2.0 / (2.0 + own)
    np.testing.assert_allclose(start.velocity[list(tether.nodes[:3])], np.tile(speed, (3, 1)), rtol=1e-12)
    assert start.state.first_order.tolist() == [pytest.approx(1.1), 0.0]
    assert start.state.discrete["line/reel"].tolist() == [2.0, 0.0]


def outlet(**given: Any) -> reel.Outlet:
    none = np.zeros(1, dtype=np.uint32)
    numbers = dict.fromkeys(reel.Outlet._fields, 0.0) | {
        "drum": none, "far": none + 3, "state": none + 6, "rate": none + 6, "base": 1.0, "least": 0.05,
        "ratio": 1.0, "stiffness": 500.0, "asked": np.zeros(4), "largest_rate": 2.0, "longest_wound": 3.0,
        "slows": 0.1,
    }  # fmt: skip
    return reel.Outlet(**(numbers | given))


@pytest.mark.parametrize(
    ("drive", "pull", "rate"),
    [
        (Drive(), 70.0, 0.0),
        (Drive(0.0, 10.0, 0.05), 8.0, 0.0),  # a brake holds below its force
        (Drive(0.0, 10.0, 0.05), 30.0, -1.0),  # 20 N over 20 N s/m
        (Drive(0.5), 900.0, 0.5),  # no limit of force
        (Drive(0.2, 10.0, 0.05), 5.9, 0.2),  # 10 N less 0.2 m/s times 20 N s/m are 6 N
        (Drive(0.2, 10.0, 0.05), 8.0, 0.1),
        (Drive(0.2, 10.0, 0.05), 10.0, 0.0),  # it pulls by its force at most
        (Drive(0.2, 10.0, 0.05), 14.0, -0.2),
        (Drive(-0.2, 10.0, 0.05), 12.0, -0.2),  # pays out, and faster above 14 N
        (Drive(-0.2, 10.0, 0.05), 18.0, -0.4),
        (Drive(WITHOUT_LIMIT, 10.0, 0.05), 4.0, 0.3),  # constant tension: winds up what is slack
        (Drive(WITHOUT_LIMIT, 10.0, 0.05), 14.0, -0.2),
        (Drive(-5.0), 0.0, -2.0),  # the limit of rate
    ],
)
def test_the_law_of_the_drive(drive: Drive, pull: float, rate: float) -> None:
    """docs/explanation/theory_bodies.md, Reels; far from both limits of length."""
    asked = outlet(rate_at_most=drive.rate, **{k: v for k, v in vars(drive).items() if k != "rate"})
    assert reel.winding_rate(1.5, pull, asked) == pytest.approx(rate)


@pytest.mark.parametrize(("wound", "rate"), [(2.95, 0.25), (3.0, 0.0), (3.1, 0.0), (0.0, 0.5), (2.8, 0.5)])
def test_it_slows_down_before_a_limit(wound: float, rate: float) -> None:
    assert reel.winding_rate(wound, 0.0, outlet(rate_at_most=0.5)) == pytest.approx(rate)
    backwards = reel.winding_rate(3.0 - wound, 0.0, outlet(rate_at_most=-0.5))
    assert backwards == pytest.approx(-rate)


@pytest.mark.parametrize("time", [0.0, 0.01])
def test_force_work_and_energy_of_the_outlet(time: float) -> None:
    """-dU/dx on the ends, dU/ds at the drum, by differences; what is left is what viscosity takes out."""
    taken = {"time": time, "ratio": 1.02, "rate_at_most": 0.4, "force": 5.0, "gives": 0.01}
    data = outlet(**taken)
    rng = np.random.default_rng(5)
    x = np.array([0.1, -0.2, 0.3, 0.5, 0.3, 0.6, 0.5])  # 0.71 m on 1.02 x (1 m - 0.5 m)
    v = rng.normal(scale=0.3, size=6)
    force = np.zeros(8)
    reel.add_outlet(0.0, x, v, data, force)
    np.testing.assert_allclose(force[:3], -force[3:6], rtol=1e-15)
    slope = np.zeros(7)
    for k in range(7):
        step = 1e-6 * np.eye(7)[k]
        ends = [reel.energy_of_outlet(x + sign * step, data) for sign in (1.0, -1.0)]
        slope[k] = (ends[0] - ends[1]) / 2e-6
    if time == 0.0:
        np.testing.assert_allclose(force[:6], -slope[:6], rtol=1e-7)
        assert force[7] == pytest.approx(slope[6] * force[6], rel=1e-7)
    balance = force[7] - force[:6] @ v - slope[:6] @ v - slope[6] * force[6]
    assert reel.power_in_outlet(0.0, x, v, data) == pytest.approx(balance, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("damped", [False, True])
def test_arrays_and_loops_say_the_same(damped: bool) -> None:
    """Two forms of one law, which are written apart."""
    damping = ["effects.material_damping.relaxation_time=1e-3"] if damped else []
    pull = command(0.0, "tension", force=3.0)
    warm = "effects.thermal_strain={expansion_coefficient=1e-4, temperature_change=80.0}"
    start = start_of(warm, *damping, commands=pull)
    (winding,) = start.system.forces.cable.reels
    rng = np.random.default_rng(3)
    x, v = start.system.layout.pack(start.state.moving)
    far = start.net.tethers[0].nodes[3]
    rows = np.repeat(x[None], 40, axis=0)
    rows[:, 3 * far : 3 * far + 3] += rng.normal(scale=0.3, size=(40, 3))
    speeds = rng.normal(size=(40, len(v)))
    discrete = start.state.discrete
    element, strain, tension = winding.outlets(discrete, rows, speeds)
    assert element == 2
    assert 5 < np.count_nonzero(tension) < 40
    data = winding.outlet(discrete["line/reel"])
    for k in range(40):
        natural, length, of_loop = reel.stretched(rows[k], data)
        assert tension[k] == pytest.approx(reel.pulls(rows[k], speeds[k], data)[1], rel=1e-10, abs=1e-9)
        assert strain[k] == pytest.approx(0.5 * ((length / 0.4) ** 2 - 1.0), rel=1e-10)
        assert natural == pytest.approx(0.4 * 1.008, rel=1e-12)  # 80 K times 1e-4 / K
        assert of_loop == pytest.approx(max(0.0, 0.5 * ((length / natural) ** 2 - 1.0)), rel=1e-10)


def test_bounds_for_the_step_are_of_the_shortest_outlet() -> None:
    """Twice EA over its length on the lightest node; the brake of 20 N s/m gives, and tau of 1 ms damps."""
    tau = "effects.material_damping.relaxation_time=1e-3"
    warm = "effects.thermal_strain={expansion_coefficient=1e-4, temperature_change=80.0}"
    start = start_of(warm, tau, commands=command(0.0, "brake", force=3.0))
    (winding,) = start.system.forces.cable.reels
    term = reel_term(winding, Mock())
    slope = 1e3 * 1.008**3 / (1.008 * 0.125)  # a quarter of an element of 0.5 m, warmer by 80 K
    mass = start.system.blocks.mass[list(winding.reel.nodes)].min()
    assert mass <= LUMP
    assert term.stiffness_rate == pytest.approx(2.0 * slope / mass, rel=1e-12)
    assert term.damping_rate == pytest.approx(slope * (0.05 + 2e-3 / mass), rel=1e-12)


def random_held(rng: np.random.Generator) -> tuple[Floats, Floats]:
    return rng.uniform(0.1, 0.5, 4), rng.normal(size=(4, 3))


def test_forces_are_shared_with_what_a_body_holds() -> None:
    """Newton's and Euler's laws of body and points: the forces that hold the points act back on the body."""
    rng = np.random.default_rng(2)
    held, arm = random_held(rng)
    moments, mass = np.array([0.3, 0.4, 0.5]), 2.0
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    x, v, given = np.concatenate([np.zeros(3), quaternion]), rng.normal(size=6), rng.normal(size=6)
    at = [np.array([k], dtype=np.uint32) for k in (0, 3, 3)]
    data = kinematics.HeldMasses(
        *at, np.array([mass]), moments[None], (held @ arm)[None], ((held[:, None] * arm).T @ arm)[None],
        np.linalg.inv(mass_matrix(mass, moments, held, arm))[None],
    )  # fmt: skip
    force = given.copy()
    kinematics.share_with_held(0.0, x, v, data, force)
    turn, spin = rotation_matrix(quaternion), v[3:]
    along = force[:3] @ turn / mass
    turning = (force[3:] - np.cross(spin, moments * spin)) / moments
    of_points = held[:, None] * (along + np.cross(turning, arm) + np.cross(spin, np.cross(spin, arm)))
    np.testing.assert_allclose(force[:3] @ turn, given[:3] @ turn - of_points.sum(axis=0), atol=1e-13)
    np.testing.assert_allclose(force[3:], given[3:] - np.cross(arm, of_points).sum(axis=0), atol=1e-13)


def test_prescribed_bodies_give_what_moves_the_points_that_they_hold() -> None:
    """Sums of m a over points, their accelerations by differences of the prescribed motion's poses."""
    rng = np.random.default_rng(3)
    held, arm = random_held(rng)
    turned = rng.normal(size=(3, 4))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    knots = np.array([-0.1, 0.5, 1.2])
    motion = PrescribedMotion.through(knots, rng.normal(size=(3, 3)), turned, np.array([0.1, 0.2, 0.3]))
    motion.turning[:, 3] = [[0.1, -0.2, 0.3], [0.3, 0.1, -0.1]]  # turned where the pieces begin, too
    at = [np.array([k], dtype=np.uint32) for k in (0, 3, 3)]
    pieces = np.array([0, 2]), motion.time, motion.position, motion.turning, motion.offset[None], *at
    second = ((held[:, None] * arm).T @ arm)[None]
    data = kinematics.OnPrescribed(*pieces, np.array([held.sum()]), (held @ arm)[None], second)
    for time in (0.2, 0.501, 0.9):
        h = 1e-4
        poses = motion.at(time + np.array([-h, 0.0, h]))
        turns = rotation_matrix(poses.attitude)
        points = poses.position[:, None] + np.einsum("kij,nj->kni", turns, arm)
        needed = held[:, None] * (points[2] - 2.0 * points[1] + points[0]) / h**2
        x = np.concatenate([poses.position[1], poses.attitude[1]])
        v = np.concatenate([poses.velocity[1], poses.angular_velocity[1]])
        force = np.zeros(6)
        kinematics.bear_held(time, x, v, data, force)
        np.testing.assert_allclose(force[:3], -needed.sum(axis=0), atol=1e-5)
        torque = np.cross(points[1] - poses.position[1], needed).sum(axis=0) @ turns[1]
        np.testing.assert_allclose(force[3:], -torque, atol=1e-5)


REEL = "tethers.line.reel"


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("reel.paid_out=4.1", "reel.paid_out"),
        ("reel.paid_out=0.1", "reel.paid_out"),
        ("reel.paid_out=2.5", "reel.paid_out"),  # less than the distance
        ("reel.shortest=0.1", "reel.shortest"),
        ("reel={paid_out=3.0, shortest=3.5}", "reel.shortest"),
        ("reel.largest_rate=0.0", "reel.largest_rate"),
        ("start={node=0}", "reel.at"),
        ("reel.commands=[{at=0.0, mode='brake'}]", "reel.commands[0].force"),
        ("reel.commands=[{at=0.0, mode='rate'}]", "reel.commands[0].rate"),
        ("reel.commands=[{at=0.0, mode='lock', force=1.0}]", "reel.commands[0].force"),
        ("reel.commands=[{at=1.0, mode='lock'}, {at=1.0, mode='lock'}]", "reel.commands[1].at"),
        ("reel.commands=[{at=-1.0, mode='lock'}]", "reel.commands[0].at"),
        ("reel.commands=[{at=0.0, mode='wind'}]", "reel.commands[0].mode"),
        ("reel={commands=[{at=0.0, mode='brake', force=1.0}]}", "reel.commands[0].force"),
        ("reel={largest_rate=0.5, commands=[{at=0.0, mode='rate', rate=-0.51}]}", "reel.commands[0].rate"),
    ],
)
def test_wrong_keys_are_refused(override: str, key: str) -> None:
    assert refused(EMPTY, f"tethers.line.{override}") == [f"tethers.line.{key}"]


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("effects.breaking.strain=0.1", "effects.breaking"),
        ("effects.bending.modulus=1e6", "effects.bending"),
        ("effects.rayleigh_damping={alpha=0.0, beta=1e-6}", "effects.rayleigh_damping"),
        ("solver={method='GeneralizedAlpha', step=1e-3}", "solver.method"),
        ("bodies.line={mass=1.0, inertia=[1.0, 1.0, 1.0], position=[0.0, 9.0, 0.0]}", "tethers.line"),
    ],
)
def test_scenes_that_exclude_reels_are_refused(override: str, key: str) -> None:
    assert key in refused(EMPTY, override)


REST = [
    "bodies.right={mass=3.0, inertia=[0.5, 0.4, 0.6], position=[3.0, 0.1, 0.0]}",
    "bodies.left={mass=2.0, inertia=[0.3, 0.4, 0.5]}",
    "effects.material_damping.relaxation_time=1e-3",
    "solver={method='VelocityVerlet', step=2e-5, retry=0}",
    "engine.backend=compiled",
]


@pytest.mark.slow
@pytest.mark.parametrize("paid_out", [2.9, 3.4])
def test_a_scene_at_rest_is_wound_up(paid_out: float) -> None:
    """Nothing has energy until the tether is taut: the first step then errs by more than all that there is.

    So the balance is measured by the tether's kinetic energy at the 0.2 m/s of the drum too.
    """
    taut = 0.02 + (paid_out - math.hypot(2.8, 0.15, 0.05)) / 0.2
    given = [f"{REEL}.paid_out={paid_out}", f"time.end={taut + 0.05}"]
    result = exunet.run(case_of(*REST, *given, commands=command(0.02, "rate", rate=0.2)))
    assert result.tension.max() > 1.0
    assert result.run.energy_scale_J >= 0.5 * 8 * LUMP * 0.2**2


FIXED = "bodies.left={mass=2.0, inertia=[0.3, 0.4, 0.5], motion='fixed'}"
COMPILED = ("engine.backend=compiled", "solver={method='DOPRI5', tolerance=1e-9}")
ON_AND_OFF = "".join(
    [
        command(0.0, "rate", rate=3.0),  # 0.6 m: a node goes on at 0.275 m, one at 0.775 m
        command(0.3, "lock"),
        command(0.32, "rate", rate=-4.0),
    ]
)


def assert_balances(found: exunet.Result) -> None:
    """Linear momentum to 1e-10 and angular momentum to 1e-8 of what single parts have; the energy to 1e-5."""
    assert found.verdict == "ok"
    speeds = [np.linalg.norm(body.velocity, axis=1).max() * body.mass for body in found.bodies.values()]
    reach = float(np.abs(found.position[:, 1:]).max())
    assert np.abs(found.momentum - found.momentum[0]).max() < 1e-10 * max(speeds)
    assert np.abs(found.angular_momentum - found.angular_momentum[0]).max() < 1e-8 * max(speeds) * reach
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total - total[0]).max() < 1e-5 * (found.kinetic + found.elastic + found.potential).max()


@pytest.mark.ci_for("4-compiled")
@pytest.mark.slow_for("9}", "compiled")
@every_backend
@pytest.mark.parametrize("method", ["solver.step=2e-4", "solver={method='DOPRI5', tolerance=1e-9}"])
def test_nodes_go_on_and_come_off(backend: str, method: str) -> None:
    damped = "effects.material_damping.relaxation_time=1e-4"
    found = exunet.run(case_of(BACKENDS[backend], method, damped, commands=ON_AND_OFF))
    words = [e.event.split(" ", 2)[-1] for e in found.run.events if e.node is not None]
    assert words[:3] == ["goes onto the drum", "goes onto the drum", "comes off the drum"]
    assert_balances(found)
    assert found.states["line/work"].values[-1, 0] != 0.0
    chain, elements = found.net.tethers[0].nodes, found.net.tether_elements["line"]
    held = (found.position[:, chain[1:5]] == found.position[:, [chain[0]]]).all(axis=-1).sum(axis=1)
    assert (held.min(), held.max()) == (2, 4)
    pulls = exunet.loads(found, "left")
    of_outlet = found.tension[np.arange(len(held)), elements.start + held]
    np.testing.assert_allclose(pulls.size[:, 0], of_outlet, rtol=1e-12, atol=1e-12)
    assert of_outlet.max() > 1.0


@pytest.mark.slow
def test_a_body_with_nodes_on_its_drum_tumbles_as_one_of_their_masses() -> None:
    """Free and slack: against a body whose mass, centre and inertia have the nodes in them (Steiner)."""
    point, spin = np.array([0.4, 0.3, -0.2]), "bodies.left.angular_velocity=[2.0, -3.0, 1.0]"
    both = (f"tethers.line.start.point={point.tolist()}", spin, "time.end=1.0", *COMPILED)
    found = exunet.run(case_of(*both, modulus=1e-6))  # the tether hardly pulls
    assert found.tension.max() < 1e-7
    held, centre = 2.5 * LUMP, 2.5 * LUMP / (2.0 + 2.5 * LUMP) * point
    before = 0.5 * LUMP / (2.0 + 0.5 * LUMP) * point  # with the node at the drum's point alone

    def steiner(mass: float, at: Floats) -> Floats:
        return mass * (at @ at * np.eye(3) - np.outer(at, at))

    inertia = np.diag([0.3, 0.4, 0.5]) + steiner(2.0, centre) + steiner(held, point - centre)
    products = [float(inertia[0, 1]), float(inertia[0, 2]), float(inertia[1, 2])]
    alone = SCENE.partition("[tethers")[0].format(left=2.0 + held, right=3.0, speed=0.0)
    one = (
        f"bodies.left.centre_of_mass={centre.tolist()}",
        f"bodies.left.inertia={np.diag(inertia).tolist()}",
        f"bodies.left.products_of_inertia={products}",
        f"bodies.left.velocity={np.cross([2.0, -3.0, 1.0], centre - before).tolist()}",
    )
    same = exunet.run(of_text(alone, *both[1:], *one)).bodies["left"]
    body = found.bodies["left"]
    np.testing.assert_allclose(body.angular_velocity, same.angular_velocity, atol=1e-8)
    np.testing.assert_allclose(np.abs(body.attitude), np.abs(same.attitude), atol=1e-8)
    arms = np.einsum("kij,j->ki", rotation_matrix(same.attitude), before - centre)
    np.testing.assert_allclose(body.position, same.position + arms, atol=1e-8)
    assert np.abs(body.angular_velocity[-1] - body.angular_velocity[0]).max() > 0.1


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize(
    ("backend", "solver"),
    [("exudyn", "solver.step=1e-3"), ("compiled", "solver.step=2e-4"), ("compiled", COMPILED[1])],
)
def test_a_snapshot_goes_on_to_the_bit(backend: str, solver: str, tmp_path: Path) -> None:
    """With nodes that go on and come off in either half."""
    case = case_of(BACKENDS[backend], solver, commands=ON_AND_OFF)
    one, other = Simulation(case), Simulation(case)
    one.advance_to(0.31)
    continue_alike(one, other, 0.4, tmp_path)


@pytest.mark.slow
def test_a_drum_that_flies_straight_does_what_one_at_rest_does() -> None:
    """Galileo: places shifted by V t, the same impulse, and the work of the moving support, V times it."""
    flight = np.array([0.7, -0.4, 1.1])
    led = FIXED.replace("'fixed'", f"'prescribed', velocity={flight.tolist()}")
    right = f"bodies.right.velocity={flight.tolist()}"
    node = f"initial.velocity={flight.tolist()}"
    rest, moved = (
        exunet.run(case_of(*COMPILED, *keys, commands=ON_AND_OFF)) for keys in ([FIXED], [led, right, node])
    )
    shift = moved.time[:, None] * flight
    np.testing.assert_allclose(
        moved.bodies["right"].position, rest.bodies["right"].position + shift, atol=1e-7
    )
    impulse, work = (moved.states[f"left/{name}"].values for name in ("impulse", "work"))
    np.testing.assert_allclose(impulse, rest.states["left/impulse"].values, atol=1e-6)
    np.testing.assert_allclose(work[:, 0], impulse @ flight, atol=1e-9)
    assert np.abs(impulse).max() > 1.0
    assert not rest.states["left/work"].values.any()
    np.testing.assert_allclose(moved.states["line/work"].values, rest.states["line/work"].values, atol=1e-6)


@pytest.mark.slow_for("compiled")
@every_backend
def test_commands_of_a_script_act_as_those_of_a_case(backend: str) -> None:
    """A rate, then a brake, then a lock; nodes go on and come off at the same times, to round-off."""
    given = [BACKENDS[backend], "solver={method='DOPRI5', tolerance=1e-5}", "time.end=0.4"]
    orders = ((0.0, "rate", {"rate": 3.0, "force": 50.0}), (0.2, "brake", {"force": 0.5}), (0.3, "lock", {}))
    commands = "".join(command(at, mode, **numbers) for at, mode, numbers in orders)
    by_case = Simulation(case_of(*given, commands=commands, speed=0.6))
    by_script = Simulation(case_of(*given, speed=0.6))
    for until, (_, mode, numbers) in zip((0.2, 0.3, 0.4), orders, strict=True):
        by_script.command("line", mode, **numbers)
        by_script.advance_to(until)
        by_case.advance_to(until)
    found, known = by_script.state, by_case.state
    assert found.discrete["line/reel"][0] == known.discrete["line/reel"][0] > 2.0
    np.testing.assert_allclose(found.position, known.position, atol=1e-9)
    np.testing.assert_allclose(found.first_order, known.first_order, atol=1e-9)
    for wrong in (("rope", "lock"), ("line", "rate"), ("line", "pull"), ("line", "brake", None, -1.0)):
        with pytest.raises(exunet.InputError):
            by_script.command(*wrong)
    with pytest.raises(exunet.InputError):
        by_case.command("line", "lock")  # whose commands are in the case


# The drum by itself

NODES, ELEMENTS = (9, 3, 4, 5, 8), (2, 3, 4, 5)


def reel_of_four(length: float = 2.0, **keys: Any) -> ReeledTether:
    return reel_of("line", Reel.model_validate(keys), "left", length, NODES, ELEMENTS)


def test_a_reel_at_either_end() -> None:
    """Four elements of 0.5 m, of which 0.7 m are wound up: one node, and an outlet of 0.3 m."""
    found = reel_of_four(paid_out=1.3)
    assert (found.nodes, found.elements, found.element_length) == (NODES, ELEMENTS, 0.5)
    assert (found.wound, found.on_drum, found.shortest) == (pytest.approx(0.7, rel=1e-15), 1, 0.125)
    assert found.outlet(1, 0.7) == pytest.approx(0.3, rel=1e-15)
    assert found.length == 2.0
    assert (found.largest_rate, found.times, found.drives) == (WITHOUT_LIMIT, (), (Drive(),))
    end = reel_of_four(paid_out=1.3, at="end", shortest=0.2, largest_rate=3.0, damping=20.0)
    assert (end.nodes, end.elements) == (NODES[::-1], ELEMENTS[::-1])
    assert (end.on_drum, end.shortest, end.largest_rate, end.damping) == (1, 0.2, 3.0, 20.0)


def test_nodes_on_the_drum() -> None:
    """An outlet of a quarter of an element, to 1e-9 of it, goes on with the next; the last stays."""
    outside = [2.0, 1.625 + 1e-9, 1.625, 1.625 + 4e-10, 1.126, 0.626, 0.625, 0.1251]
    assert [reel_of_four(paid_out=length).on_drum for length in outside] == [0, 0, 1, 1, 1, 2, 3, 3]


# 8 elements of 0.5 m. The state of the run begins with two nodes on the drum.
CLOSE, HALF = 5e-10, 0.5


def drum_of(commands: str = "", **given: float) -> tuple[Start, Drum]:
    start = start_of(commands=commands, **given)
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
        (0, 0.8, []),  # no node can come off
        (6, 0.1, [1]),
        (7, 0.1, []),  # no node can go on
    ],
)
def test_when_a_node_is_due(nodes: int, outlet: float, known: list[int]) -> None:
    start, drum = drum_of(command(0.25, "rate", rate=0.5))
    discrete = np.array([nodes, 1.0])
    x, v = wound(start, HALF * (nodes + 1) - outlet)
    assert drum.crossed(0.3, x, v, discrete).tolist() == known
    discrete = np.array([nodes, 0.0])
    assert drum.crossed(0.2499, x, v, discrete).tolist() == known
    assert drum.crossed(0.25, x, v, discrete).tolist() == [0, *known]
    (winding,) = start.system.forces.cable.reels
    assert (reel.node_is_due(0.25, x, v, winding.outlet(discrete)) >= 0.0) == bool(known)


@pytest.mark.parametrize("viscous", [False, True])
def test_the_outlet_of_a_turning_drum_is_observed_at_every_step(viscous: bool) -> None:
    """Largest tensions are those of a run that stores each step, whose states arrays evaluate."""
    settings = ["engine.backend=compiled"]
    settings += ["effects.material_damping={relaxation_time=1e-4}"] if viscous else []
    drive = command(0.0, "rate", rate=3.0)
    every, some = (
        exunet.run(case_of(*settings, f"time.output_step={step}", commands=drive, density=140.0)).run
        for step in (2e-4, 0.4)
    )
    assert len(some.events) > 1
    known, found = ([event.time_s for event in run.events] for run in (every, some))
    assert found == pytest.approx(known, rel=1e-12)
    known, found = (run.largest_tensions["tether line"] for run in (every, some))
    assert min(every.peak_tensions_N[2:4]) > 1.0  # outlets, one after the other
    assert found.tension == pytest.approx(known.tension, rel=1e-9)
    assert found.time == pytest.approx(known.time, rel=1e-12)
    np.testing.assert_allclose(some.peak_tensions_N, every.peak_tensions_N, rtol=1e-9)


def test_a_node_comes_off_on_the_line_to_the_next() -> None:
    """Along the line it has the velocity of the next node, across it that of its place on the line."""
    start, drum = drum_of()
    system, discrete = start.system, np.array([2.0, 0.0])
    every = system.discrete | {"line/reel": discrete}
    x, v = wound(start, HALF * 3 - 0.75)
    v = v + 0.3 * np.random.default_rng(8).normal(size=len(v))
    before = system.layout.unpack(x, v).completed(system.kinematics, 0.3, every)
    change = drum.change(0.3, *system.layout.pack(before), discrete, np.array([2]), every)
    assert change.x is not None
    assert change.v is not None
    then = system.layout.unpack(change.x, change.v)
    at, node, far = (start.net.tethers[0].nodes[k] for k in (0, 2, 3))
    part = 0.25 / 0.75
    line, apart = before.position[far] - before.position[at], before.velocity[far] - before.velocity[at]
    np.testing.assert_allclose(then.position[node], before.position[at] + part * line, rtol=1e-13)
    way, across = line / np.linalg.norm(line), before.velocity[at] + part * apart
    along = before.velocity[far] @ way
    known = along * way + across - (across @ way) * way
    np.testing.assert_allclose(then.velocity[node], known, atol=1e-13)
    assert change.discrete.tolist() == [1.0, 0.0]


# A body that carries a net of two nodes and turns, and one that drifts. Tethers, slack, have elements of 1 m.
ROUND = """
format = 1
title = "Round numbers"
time = {{ end = 0.4, output_step = 0.1 }}
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.3, 0.1]
net.cable = {{ diameter = 0.002, density = 1390.0, youngs_modulus = 1e7 }}

[initial]
packing = 1.0
node_velocities = [[0.3, 0.0, 2.0], [0.3, 0.1, 2.0]]
[initial.frame]
body = "chaser"
position = [0.1, -0.2, 1.0]
eject_at = {eject_at}

[bodies.chaser]
mass = 3.0
inertia = [0.6, 0.7, 0.5]
angular_velocity = [0.5, 0.2, -0.8]
[bodies.target]
mass = 2.0
inertia = [0.5, 0.4, 0.6]
position = [0.6, 0.1, 0.0]
velocity = [0.1, 0.0, -0.1]
"""
TETHER = """
[tethers.{name}]
length = 4.0
divisions = 4
diameter = 0.004
density = 1390.0
youngs_modulus = 1e7
start = {{ body = "chaser", point = {point} }}
end = {{ body = "target" }}
[tethers.{name}.reel]
paid_out = {paid_out}
damping = 5.0
commands = [{{ at = 0.0, mode = "rate", rate = {rate} }}, {{ at = 0.2, {then} }}]
"""
BRAKE, LOCK = 'mode = "brake", force = 5.0', 'mode = "lock"'
# Until 0.2 s they come to an outlet of 3/2 of an element, or of a quarter.
OUT = {"paid_out": 1.0, "rate": -2.5}
IN = {"paid_out": 3.0, "rate": 3.75}


def tether(name: str, given: dict[str, float], then: str, point: str = "[0.1, 0.05, -0.02]") -> str:
    return TETHER.format(name=name, point=point, then=then, **given)


HELD = {"out": [3, 3, 2, 2, 2], "in": [1, 1, 2, 2, 2]}  # nodes on the drum
INSTANTS = {
    "out": (0.0, tether("one", OUT, LOCK), ["out"]),
    "in": (0.0, tether("one", IN, LOCK), ["in"]),
    "brake": (0.0, tether("one", OUT, BRAKE), ["out"]),
    "all": (0.2, tether("one", OUT, LOCK) + tether("two", IN, LOCK, "[-0.3, 0.2, 0.4]"), ["out", "in"]),
}


@pytest.mark.ci_for("all-compiled")
@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("name", INSTANTS)
def test_nodes_due_at_the_instant_of_a_command(name: str, backend: str, tmp_path: Path) -> None:
    """As the reference: commands, then nodes tether by tether, then an ejection; each jumps with the body as
    left before. 1e-8 is ten times what the margin of 1e-9 of an element may make of a motion.
    """
    eject_at, tethers, expected = INSTANTS[name]
    path = case_file(tmp_path, ROUND.format(eject_at=eject_at) + tethers)
    ours = exunet.run(exunet.load(path, [BACKENDS[backend], "solver={method='DOPRI5', tolerance=1e-10}"]))
    theirs = reference_impl.load(path).integrate(rtol=1e-11, atol=1e-11)
    for number, (chain, held) in enumerate(zip(ours.net.tethers, expected, strict=True)):
        assert theirs.reels.held[:, number].tolist() == HELD[held]
        at_drum = ours.position[:, chain.nodes[1:-1]] == ours.position[:, [chain.nodes[0]]]
        assert at_drum.all(axis=-1).sum(axis=1).tolist() == HELD[held]
    np.testing.assert_allclose(ours.position, theirs.x, atol=1e-8)
    np.testing.assert_allclose(ours.velocity, theirs.v, atol=1e-8)
    for number, body in enumerate(ours.bodies.values()):
        np.testing.assert_allclose(body.position, theirs.bodies.position[:, number], atol=1e-8)
        np.testing.assert_allclose(body.velocity, theirs.bodies.velocity[:, number], atol=1e-8)
    wound = [values.values[:, 0] for name, values in ours.states.items() if name.endswith("/wound_up")]
    np.testing.assert_allclose(np.transpose(wound), theirs.reels.wound_up, atol=1e-12)
    if eject_at:
        (ejection,) = ours.run.ejections
        assert ejection.time_s == 0.2


def test_guards_report_the_force_of_a_reels_outlet() -> None:
    """The most stretched element has its own tension, also where its length changes with the drum."""
    near = "bodies.right.position=[0.5, 0.0, -0.05]", "tethers.line.reel.paid_out=0.32"
    start = start_of(*near, speed=2.0)  # all but the outlet is on the drum
    sim = Simulation(start)
    sim.advance_to(0.02)
    tension = States.of(start.system, sim.state).tension[0]
    reported = re.search(r"element is (\d+) .* force (\S+) N", state_of_worst(start.system, sim.state))
    assert reported is not None
    assert tension.max() > 1.0
    assert float(reported[2]) == pytest.approx(tension[int(reported[1])], rel=5e-3)  # three digits
    assert float(reported[2]) > 0.9 * tension.max()

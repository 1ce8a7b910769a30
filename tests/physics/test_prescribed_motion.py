"""Bodies that are fixed or whose motion is prescribed: poses, velocities, and what they give to all else."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BACKENDS, PAIR, case_file, every_backend, of_text, refused, start_of

import exunet
from exunet.bodies.kinematics import (
    Prescribed,
    angular_acceleration,
    give_to_others,
    place_prescribed,
)
from exunet.bodies.port import PrescribedMotion
from exunet.bodies.rotations import angular_velocity_of, rotation_matrix
from exunet.forces.blocks import Blocks
from exunet.forces.terms import KernelTerm
from exunet.model.states import States
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.simulation import Simulation

MASS = (
    "mass=2.0, inertia=[0.2, 0.3, 0.4], products_of_inertia=[0.05, 0.02, 0.01], "
    "centre_of_mass=[0.1, 0.2, 0.3]"
)
MOTIONS = {
    "fixed": "position=[-0.5, 0.2, 0.1], attitude=[0.9, 0.1, 0.3, 0.2], motion='fixed'",
    "steady": "position=[-0.5, 0.2, 0.1], velocity=[0.1, 0.0, 0.2], attitude=[0.9, 0.1, 0.3, 0.2], "
    "angular_velocity=[1.0, 2.0, -1.5], motion='prescribed'",
    "poses": "motion='prescribed', pose_times=[0.0, 0.1, 0.2, 0.4], pose_positions=[[0.0, 0.0, 0.0], "
    "[0.0, 0.1, 0.02], [0.1, 0.3, 0.0], [0.0, 0.0, 0.0]], pose_attitudes=[[1.0, 0.0, 0.0, 0.0], "
    "[1.0, 0.3, 0.0, 0.0], [1.0, 0.3, 0.2, 0.0], [1.0, 0.0, 0.0, 0.0]]",
}
OTHER = "bodies.other={mass=3.0, inertia=[0.2, 0.3, 0.4], position=[5, 0, 0], angular_velocity=[1, 2, 3]}"


class Spring(NamedTuple):
    """Where the entries of a node, and of a body's centre and angular velocity, begin; N/m; N m."""

    node: int
    centre: int
    spin: int
    stiffness: float
    torque: float


def add_spring(t: float, x: Any, v: Any, spring: Any, force: Any) -> None:
    """k d between both, and a torque on the body alone."""
    for axis in range(3):
        pull = spring.stiffness * (x[spring.centre + axis] - x[spring.node + axis])
        force[spring.node + axis] += pull
        force[spring.centre + axis] -= pull
    force[spring.spin] += spring.torque


def spring(blocks: Blocks, torque: float = 0.0) -> tuple[KernelTerm, ...]:
    data = Spring(0, blocks.centre("target"), blocks.spin("target"), 50.0, torque)
    return (KernelTerm("node and body", add_spring, data, bodies=("target",)),)


def start(folder: Path, motion: str, backend: str, method: str = "RK44") -> Start:
    how = "solver.tolerance=1e-10" if method == "DOPRI5" else "solver.step=1e-4"
    keys = (
        f"bodies.target={{{MASS}, {MOTIONS[motion]}}}",
        OTHER,
        BACKENDS[backend],
        f"solver.method={method}",
        how,
    )
    return start_of(case_file(folder), keys, spring)


def random_motion() -> tuple[PrescribedMotion, Any, Any, Any]:
    rng = np.random.default_rng(0)
    time, place, attitude = np.array([-0.1, 0.5, 1.2, 2.0]), rng.normal(size=(4, 3)), rng.normal(size=(4, 4))
    attitude /= np.linalg.norm(attitude, axis=1)[:, None]
    return PrescribedMotion.through(time, place, attitude, np.array([0.1, 0.2, 0.3])), time, place, attitude


def test_a_guide_goes_through_its_poses() -> None:
    motion, time, place, attitude = random_motion()
    states = motion.at(time)
    points = states.position - rotation_matrix(states.attitude) @ motion.offset
    np.testing.assert_allclose(points, place, atol=1e-14)
    assert motion.position.shape == motion.turning.shape == (3, 4, 3)  # which stand one after the other
    np.testing.assert_allclose(np.abs((states.attitude * attitude).sum(axis=1)), 1.0, atol=1e-14)


def test_a_guides_velocities_are_the_rates_of_its_poses() -> None:
    """Central differences of step 1e-5: their error is some 1e-10 / 6 of third derivatives of 1e2."""
    motion, time, *_ = random_motion()
    at, h = np.linspace(0.01, 1.99, 101), 1e-5
    before, now, after = (motion.at(at + shift) for shift in (-h, 0.0, h))
    rate = (after.position - before.position) / (2.0 * h)
    np.testing.assert_allclose(now.velocity, rate, atol=1e-7)
    one_way = (
        np.sign((now.attitude * before.attitude).sum(axis=1))[:, None],
        np.sign((now.attitude * after.attitude).sum(axis=1))[:, None],
    )
    rate = (one_way[1] * after.attitude - one_way[0] * before.attitude) / (2.0 * h)
    np.testing.assert_allclose(now.angular_velocity, angular_velocity_of(now.attitude, rate), atol=1e-7)
    for knot in time[1:3]:  # no jump of a velocity
        low, high = motion.at(np.array([knot - 1e-12, knot + 1e-12])).angular_velocity
        np.testing.assert_allclose(low, high, atol=1e-9)


def entries(motions: list[PrescribedMotion]) -> Prescribed:
    """Of n bodies: all centres, then all attitudes in x, all spins in v, and what they give behind that."""
    n = np.arange(len(motions), dtype=np.uint32)
    parts = ("time", "position", "attitude", "turning")
    return Prescribed(
        np.cumsum([0, *(len(motion.time) for motion in motions)]),
        *(np.concatenate([getattr(motion, part) for motion in motions]) for part in parts),
        np.stack([motion.offset for motion in motions]),
        *(3 * n, 3 * len(n) + 4 * n, 3 * len(n) + 3 * n, 6 * len(n) + 7 * n),
    )


def test_the_loop_places_several_bodies() -> None:
    """Of different numbers of pieces, where one piece meets the next and beyond the last."""
    rng, motions = np.random.default_rng(6), []
    for number in (3, 2, 4):
        place, attitude = rng.normal(size=(number + 1, 3)), rng.normal(size=(number + 1, 4))
        attitude /= np.linalg.norm(attitude, axis=1)[:, None]
        time = np.linspace(-0.1, 0.6, number + 1)
        motions.append(PrescribedMotion.through(time, place, attitude, rng.normal(size=3)))
    knots = np.concatenate([motion.time[1:] for motion in motions])
    for time in (0.0, *knots, 0.4, 0.59):
        x, v = np.zeros(21), np.zeros(18)
        place_prescribed(time, x, v, entries(motions))
        known = [motion.at(np.array([time])) for motion in motions]
        for found, part in (
            (x[:9], "position"), (v[:9], "velocity"), (x[9:], "attitude"), (v[9:], "angular_velocity"),
        ):  # fmt: skip
            expected = np.concatenate([getattr(item, part)[0] for item in known])
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=2e-14)


def test_rates_of_impulses_about_the_origin_and_of_work() -> None:
    """Of force f and torque c in the body's axes: f, x x f + R c, and f v + c w."""
    rng, motions = np.random.default_rng(7), [random_motion()[0]] * 2
    x, v, force = rng.normal(size=14), rng.normal(size=12), rng.normal(size=26)
    x[6:] /= np.repeat(np.linalg.norm(x[6:].reshape(2, 4), axis=1), 4)
    before = force.copy()
    give_to_others(0.2, x, v, entries(motions), force)
    np.testing.assert_array_equal(force[:12], before[:12])
    for b, (f, c) in enumerate(zip(before[:6].reshape(2, 3), before[6:12].reshape(2, 3), strict=True)):
        given = (before - force)[12 + 7 * b : 19 + 7 * b]
        place, quaternion = x[3 * b : 3 * b + 3], x[6 + 4 * b : 10 + 4 * b]
        about = np.cross(place, f) + rotation_matrix(quaternion) @ c
        work = f @ v[3 * b : 3 * b + 3] + c @ v[6 + 3 * b : 9 + 3 * b]
        np.testing.assert_allclose(given, [*f, *about, work], rtol=0.0, atol=1e-14)


def test_the_loops_angular_acceleration_is_the_rate_of_the_angular_velocity() -> None:
    """Central differences of step 1e-5 at small and large angles, on either side of the change of formula."""
    motion, time, *_ = random_motion()
    h, found = 1e-5, np.empty(3)
    for at in (*(time[1] + np.array([2e-5, 0.002, 0.0028, 0.01, 0.3])), 0.3, 1.5):
        piece = int(np.searchsorted(motion.time, at, side="right")) - 1
        s, (c0, c1, c2, c3) = at - motion.time[piece], motion.turning[piece]
        angle, rate, bend = (
            ((c0 * s + c1) * s + c2) * s + c3,
            (3 * c0 * s + 2 * c1) * s + c2,
            6 * c0 * s + 2 * c1,
        )
        angular_acceleration(angle, rate, bend, found)
        low, high = motion.at(np.array([at - h, at + h])).angular_velocity
        np.testing.assert_allclose(found, (high - low) / (2.0 * h), rtol=1e-7, atol=1e-7)


def test_a_steady_guide_turns_evenly_however_long() -> None:
    """The centre moves straight; w t about a constant axis; 1e3 rad, to the bits of a sine of that."""
    spin = np.array([3.0, 0.0, 4.0])
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    states = PrescribedMotion.steady(np.ones(3), np.array([1.0, 2.0, 3.0]), identity, spin).at(
        np.array([0.0, 200.0])
    )
    np.testing.assert_array_equal(states.position[1], [201.0, 401.0, 601.0])
    expected = [math.cos(500.0), *(math.sin(500.0) * spin / 5.0)]
    sign = np.sign(states.attitude[1] @ expected)
    np.testing.assert_allclose(sign * states.attitude[1], expected, atol=1e-13)
    np.testing.assert_allclose(states.angular_velocity, np.stack([spin, spin]), atol=1e-12)


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("motion", MOTIONS)
@every_backend
def test_impulse_and_work_of_a_prescribed_body(backend: str, motion: str, tmp_path: Path) -> None:
    """A spring between a node and the body. Of all else momentum and angular momentum change by what the body
    gives, and energy by its work; and the body is where its prescribed motion says, whatever pulls at it.

    RK44 at 1e-4 s: measured 1e-14 N s, 3e-13 N m s and 2e-13 J of 0.01 J and more that are given.
    """
    begin = start(tmp_path, motion, backend)
    sim = Simulation(begin)
    energy, first = sim.energy.total, States.of(begin.system, begin.state)
    sim.advance_to(0.15)
    state, last = sim.state, States.of(begin.system, sim.state)
    given = state.first_order
    np.testing.assert_allclose(last.momentum[0] - first.momentum[0], given[:3], atol=1e-13)
    np.testing.assert_allclose(last.angular_momentum[0] - first.angular_momentum[0], given[3:6], atol=1e-12)
    assert sim.energy.total == pytest.approx(energy, abs=1e-11)
    assert np.linalg.norm(given[:3]) > 0.1
    assert (given[6] == 0.0) == (motion == "fixed")
    where = begin.system.kinematics.motions[0].at(np.array([state.time]))
    for found, expected in zip(state.bodies.parts(), where.parts(), strict=True):
        np.testing.assert_allclose(found[1], expected[0], atol=1e-14)


@pytest.mark.ci_for("compiled")
@pytest.mark.slow_for("compiled")
@every_backend
def test_back_ends_and_methods_agree(backend: str, tmp_path: Path) -> None:
    """DOPRI5 at 1e-10 against RK44: the error of the steps, 1e-8 where the poses have jumps of the third
    derivative."""
    how = ((backend, "DOPRI5"), ("exudyn", "RK44"))
    sims = [Simulation(start(tmp_path, "poses", *keys)) for keys in how]
    for sim in sims:
        sim.advance_to(0.15)
    one, other = (sim.state for sim in sims)
    np.testing.assert_allclose(one.position, other.position, atol=1e-7)
    np.testing.assert_allclose(one.first_order, other.first_order, atol=1e-6)


def test_a_torque_alone_does_work_on_a_turning_body(tmp_path: Path) -> None:
    """0.6 N m for 0.15 s about the axis of 1 rad/s: the body takes 0.09 J from the term."""
    keys = (
        "bodies.target={mass=1.0, inertia=[1, 1, 1], angular_velocity=[1, 0, 0], motion='prescribed'}",
        "solver.method=RK44", "solver.step=1e-3", BACKENDS["exudyn"],
    )  # fmt: skip
    begin = start_of(case_file(tmp_path), keys, lambda blocks: spring(blocks, torque=0.6))
    sim = Simulation(begin)
    before = sim.energy.total
    sim.advance_to(0.15)
    given = sim.state.first_order
    assert given[3] == pytest.approx(-0.6 * 0.15, rel=1e-12)
    assert given[6] == pytest.approx(-0.6 * 0.15, rel=1e-9)
    assert sim.energy.total == pytest.approx(before, abs=1e-8)


KNOT = 0.173  # [s], which no step of a run to 0.4 s by equal steps of 0.4 s / 20, 40, 80 ends at
LED = (
    f"bodies.target={{mass=2.0, inertia=[0.2, 0.3, 0.4], motion='prescribed', pose_times=[0.0, {KNOT}, 0.5], "
    "pose_positions=[[0.0, 0.0, 0.0], [0.3, 0.4, -0.2], [-0.4, 0.6, 0.4]], "
    "pose_attitudes=[[1.0, 0.0, 0.0, 0.0], [0.9, 0.3, -0.1, 0.2], [0.7, 0.1, 0.6, 0.3]]}"
)


@pytest.mark.slow_for("compiled")
@every_backend
def test_steps_end_where_the_pieces_of_a_guide_meet(backend: str, tmp_path: Path) -> None:
    """Order 4 of RK44 for what a prescribed body gives to masses that it holds, which is their momentum.

    Its rate has a kink there: steps across it would leave the order 2.
    """
    held = ("initial.frame={body='target', eject_at=0.45}", "time={end=0.5, output_times=[0.4]}")
    errors = []
    for number in (20, 40, 80):
        keys = (LED, *held, BACKENDS[backend], "solver.method=RK44", f"solver.step={0.4 / number}")
        sim = Simulation(exunet.load(case_file(tmp_path), keys))
        first = sim.state
        sim.advance_to(0.4)
        last = sim.state
        mass = sim.start.system.blocks.mass[:, None]
        change = (mass * (last.velocity - first.velocity)).sum(axis=0)
        errors.append(np.abs(change - last.first_order[:3]).max())
    assert errors[0] > 1e-9
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 3.7), errors


def test_poses_are_of_the_frame_and_not_of_the_centre_of_mass() -> None:
    """Where the first pose puts the frame, its centre of mass is (0.1, 0.2, 0.3) m from it, in its axes."""
    turned = MOTIONS["poses"].replace("[[0.0, 0.0, 0.0], ", "[[0.4, -0.5, 0.6], ", 1)
    turned = turned.replace("pose_attitudes=[[1.0, 0.0, 0.0, 0.0]", "pose_attitudes=[[0.9, 0.1, 0.3, 0.2]")
    start = prepare_case(of_text(PAIR, f"bodies.hub={{{MASS}, {turned}}}"))
    k = start.system.blocks.rigid.index("hub")
    attitude = np.array([0.9, 0.1, 0.3, 0.2]) / np.linalg.norm([0.9, 0.1, 0.3, 0.2])
    place = np.array([0.4, -0.5, 0.6]) + rotation_matrix(attitude) @ [0.1, 0.2, 0.3]
    np.testing.assert_allclose(start.state.bodies.position[k], place, atol=1e-14)


HUB = "bodies.target={mass=1.0, inertia=[1.0, 1.0, 1.0]}"
TABLE = ("motion='prescribed'", "pose_times=[0, 1]", "pose_positions=[[0, 0, 0], [1, 0, 0]]")


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        (("motion=held",), "motion"),
        (("motion=fixed", "velocity=[1, 0, 0]"), "velocity"),
        (("motion=fixed", *TABLE[1:]), "pose_times"),
        ((*TABLE, "pose_times=[0, 0]"), "pose_times[1]"),
        ((*TABLE, "pose_times=[0.1, 1]"), "pose_times[0]"),
        ((*TABLE, "pose_times=[0, 0.1]"), "pose_times[1]"),  # before the end of the run
        ((*TABLE, "pose_times=[0, 1, 2]"), "pose_positions"),
        ((*TABLE, "pose_times="), "pose_positions"),
        ((*TABLE, "pose_attitudes=[[1, 0, 0, 0]]"), "pose_attitudes"),
        ((*TABLE, "pose_attitudes=[[1, 0, 0, 0], [0, 0, 0, 0]]"), "pose_attitudes[1]"),
        ((*TABLE, "pose_attitudes=[[1, 0, 0, 0], [0, 0, -1, 0]]"), "pose_attitudes[1]"),  # half a turn
        ((*TABLE, f"pose_attitudes=[[1, 1, 0, 0], [1, {-1.0 + 0.9e-6}, 0, 0]]"), "pose_attitudes[1]"),
        ((*TABLE, "pose_times=[0, 1e-300, 1]", f"pose_positions={[[0, 0, 0]] * 3}"), "pose_times[1]"),
        ((*TABLE, "pose_times=[-1e200, 1e200]"), "pose_times[1]"),
        ((*TABLE, "position=[0, 0, 0]"), "position"),
    ],
)
def test_wrong_keys_are_refused(keys: tuple[str, ...], key: str) -> None:
    assert f"bodies.target.{key}" in refused(PAIR, HUB, *(f"bodies.target.{item}" for item in keys))


def test_the_limits_of_prescribed_motion() -> None:
    """A turn by 1.1e-6 rad less than half has a shorter way; implicit methods have no such bodies."""
    almost = (*TABLE, f"pose_attitudes=[[1, 1, 0, 0], [1, {-1.0 + 1.1e-6}, 0, 0]]")
    prepare_case(of_text(PAIR, HUB, *(f"bodies.target.{key}" for key in almost)))
    implicit = "solver={method='GeneralizedAlpha', step=1e-3}"
    assert refused(PAIR, HUB, "bodies.target.motion=fixed", implicit) == ["solver.method"]

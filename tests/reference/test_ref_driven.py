"""Bodies whose motion is given, in reference_impl: motions, what they give, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import Refused, energy, read_document
from reference_impl.bodies import Poses, rotation, turn

BODY = {"mass": 2.0, "inertia": [1.0, 1.5, 2.0]}
SOFT = {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e6}
TIMES = [-0.5, 0.0, 0.4, 1.0]
POSES = {
    "motion": "prescribed",
    "pose_times": TIMES,
    "pose_positions": [[0.0, 0, 0], [0.1, 0.2, 0], [0.0, 0.4, 0.3], [-0.3, 0.2, 0.5]],
    "pose_attitudes": [[1.0, 0, 0, 0], [2.0, 0.3, 0, 0], [1.0, 0.3, 0.2, 0], [-1.0, -0.3, -0.4, 0.5]],
}
MOVED = {key: value for key, value in POSES.items() if key != "pose_attitudes"}
HALF = [[1.0, 1.0, 0, 0], [1.0, -1.0 + 0.9e-6, 0, 0]]  # half a turn apart but for 0.9e-6 rad
STEADY = {"motion": "prescribed", "velocity": [-1.0, 0.5, 0], "angular_velocity": [0.0, 0.5, 1.0]}


@pytest.fixture(scope="module")
def led(explicit):
    """led(**body): a body of given motion that leads a net of two elements by its first node."""

    def make(effects=None, **body):
        nodes = [[1.0, 0, 0], [2.0, 0, 0], [2.5, 0.5, 0]]
        case = explicit(nodes, [[0, 1], [1, 2]], cable=SOFT, node_masses=[0.3, 0.25, 0.5])
        hook = {"attachments": {"hook": {"point": [0.8, 0.1, 0.0], "node": 0}}}
        return {**case, "bodies": {"arm": {**BODY, **hook, **body}}, "effects": effects or {}}

    return make


@pytest.mark.slow_for("poses")
@pytest.mark.parametrize("keys", [POSES, STEADY], ids=["poses", "steady"])
def test_what_is_given_closes_the_books(led, scene, unbalanced, keys):
    """Momentum and angular momentum of all else less what is given, and the energy, stay what they were."""
    made = scene(led(**keys, effects={"material_damping": {"relaxation_time": 1e-3}}))
    run = made.integrate([0.0, 0.5, 1.0])
    books = energy.books(made.system, run)
    assert np.abs(run.given.impulse[-1]).max() > 0.05
    assert books.momentum - run.given.impulse[:, 0] == pytest.approx(
        np.tile(books.momentum[0], (3, 1)), abs=1e-8
    )
    turned = books.angular_momentum - run.given.angular_impulse[:, 0]
    assert turned == pytest.approx(np.tile(books.angular_momentum[0], (3, 1)), abs=1e-8)
    assert unbalanced(made, run) < 1e-7
    assert run.given.work[-1, 0] > 0.0


@pytest.mark.ci_for("{'method': 'Verlet', 'step': 0.001}")
@pytest.mark.slow_for("{'method': 'RK4', 'step': 0.002}", "{'method': 'Verlet', 'step': 0.001}")
@pytest.mark.parametrize(
    "options",
    [{"method": "RK4", "step": 2e-3}, {"method": "Verlet", "step": 1e-3}, {"method": "RK45"}],
    ids=str,
)
def test_methods_agree(led, scene, options):
    made = scene(led(**POSES))
    best, other = made.integrate([0.0, 0.4]), made.integrate([0.0, 0.4], **options)
    assert other.x[1] == pytest.approx(best.x[1], abs=2e-3)
    assert other.bodies.attitude[1] == pytest.approx(best.bodies.attitude[1], abs=1e-12)


def test_constant_velocities(led, scene):
    """The centre of mass runs straight, the body turns about it with a constant angular velocity."""
    run = scene(led(**STEADY, centre_of_mass=[0.1, 0.0, 0.0])).integrate([0.0, 0.7])
    w = np.array([0.0, 0.5, 1.0])
    attitude = turn(w / np.linalg.norm(w), 0.7 * np.linalg.norm(w))
    assert run.bodies.position[1, 0] == pytest.approx([0.1 - 0.7, 0.35, 0.0], abs=1e-14)
    assert run.bodies.attitude[1, 0] == pytest.approx(attitude, abs=1e-14)
    assert run.bodies.angular_velocity[1, 0] == pytest.approx(w, abs=1e-14)
    assert run.x[1, 0] == pytest.approx(run.bodies.position[1, 0] + attitude @ [0.7, 0.1, 0.0], abs=1e-14)


def test_a_fixed_body_rests_whatever_pulls(led, scene):
    """Neither weight nor orbit nor the net moves it; the load it bears is what it gives."""
    made = scene(led(motion="fixed", effects={"gravity": {"acceleration": [3.0, 0, 0]}}))
    run = made.integrate([0.0, 1.0])
    assert np.array_equal(run.bodies.position[1], run.bodies.position[0])
    assert np.array_equal(run.x[1, 0], run.x[0, 0])
    own = made.net.own_mass.sum()
    books = energy.books(made.system, run)
    assert books.momentum[1] == pytest.approx(run.given.impulse[1, 0] + own * np.array([3.0, 0, 0]), abs=1e-9)
    assert not run.given.work.any()


def test_poses_are_met_and_motion_is_smooth(led, scene):
    """Attitudes as listed, of any sign and length; velocities are the derivatives."""
    (body,) = scene(led(**POSES)).case.bodies
    drive = body.drive
    assert isinstance(drive, Poses)
    at = drive.at(np.array(TIMES))
    assert at.position == pytest.approx(np.array(POSES["pose_positions"]), abs=1e-14)
    for k, quaternion in enumerate(POSES["pose_attitudes"]):
        assert at.attitude[k] == pytest.approx(rotation(tuple(quaternion)), abs=1e-14)
    assert at.acceleration[[0, -1]] == pytest.approx(np.zeros((2, 3)), abs=1e-12)
    h = 1e-5
    for t in (0.2, 0.7, 1.3):
        before, now, after = (drive.at(np.array(t + d)) for d in (-h, 0.0, h))
        assert (after.position - before.position) / (2 * h) == pytest.approx(now.velocity, abs=1e-7)
        rate = (after.attitude - before.attitude) / (2 * h) @ now.attitude.T
        assert [rate[2, 1], rate[0, 2], rate[1, 0]] == pytest.approx(now.turning.tolist(), abs=1e-7)
        assert (after.turning - before.turning) / (2 * h) == pytest.approx(now.angular, abs=1e-6)


@pytest.mark.ci_for("{'axis': [0.0, 1.0, 2.0], 'angle': 0.4}")
@pytest.mark.slow_for("{'axis': [0.0, 1.0, 2.0], 'angle': 0.4}")
@pytest.mark.parametrize(
    "turned", [{}, {"attitude": [1.0, 0.5, -0.2, 0.3]}, {"axis": [0.0, 1.0, 2.0], "angle": 0.4}], ids=str
)
def test_without_attitudes_of_poses_a_body_keeps_its_own(led, scene, turned):
    """docs/theory_bodies.md; its origin moves the same, its centre of mass is always at R c from it."""
    centre = [0.1, 0.2, -0.3]
    made = scene(led(**MOVED, **turned, centre_of_mass=centre))
    attitude = scene(led(motion="fixed", **turned)).bodies0.attitude[0]
    run = made.integrate([0.0, 0.4, 0.7])
    assert run.bodies.attitude[:, 0] == pytest.approx(np.tile(attitude, (3, 1, 1)), abs=1e-14)
    assert np.abs(run.bodies.angular_velocity).max() < 1e-14
    assert run.bodies.position[1, 0] == pytest.approx([0.0, 0.4, 0.3] + attitude @ centre, abs=1e-14)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"motion": "guided"}, 'reference_impl does not know bodies.arm.motion = "guided"'),
        ({"motion": "fixed", "velocity": [1.0, 0, 0]}, "bodies.arm.velocity: a fixed body rests"),
        ({**POSES, "motion": "free"}, "bodies.arm.pose_times: only with motion"),
        ({**POSES, "position": [1.0, 0, 0]}, "bodies.arm.position: leave it out"),
        (
            {**POSES, "attitude": [1.0, 0, 0, 0]},
            "bodies.arm.attitude: leave it out, bodies.arm.pose_attitudes are in its place",
        ),
        ({**POSES, "axis": [1.0, 0, 0], "angle": 0.1}, "bodies.arm.angle: leave it out"),
        ({**MOVED, "angular_velocity": [0.0, 0, 1.0]}, "bodies.arm.angular_velocity: leave it out"),
        ({**POSES, "pose_times": [0.0, 0.2, 0.1, 2.0]}, "must be at least two times that increase"),
        ({**POSES, "pose_times": [0.0, 0.2, 0.3, 0.5]}, "must go from 0 or before to time.end"),
        ({**POSES, "pose_positions": [[0.0, 0, 0]]}, "bodies.arm.pose_positions: 1 entries for 4 times"),
        ({**POSES, "pose_attitudes": [[0.0] * 4] * 4}, "bodies.arm.pose_attitudes: must not be zero"),
        ({**POSES, "pose_attitudes": [[1.0, 0, 0, 0], [1.0, 0.1, 0, 0], *HALF]}, "half a turn apart"),
        ({"motion": "prescribed", "pose_times": [0.0, 1.0]}, "bodies.arm.pose_positions: missing"),
    ],
)
def test_bad_motions_are_refused(led, keys, words):
    with pytest.raises(Refused) as refused:
        read_document(led(**keys))
    assert any(words in fault for fault in refused.value.faults), refused.value.faults


def test_a_launch_has_no_recoil_on_a_driven_body(document, scene):
    case = document("square")
    case["initial"] = {"packing": 0.1, "frame": {"body": "arm"}}
    made = scene({**case, "bodies": {"arm": {**BODY, **STEADY}}})
    assert made.bodies0.velocity[0].tolist() == STEADY["velocity"]
    assert math.isfinite(made.v0.sum())

"""Bodies of reference_impl: attitudes, given motion, attached nodes, balances."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import energy
from reference_impl.arrays import rotation
from reference_impl.bodies import Poses

BOX = {
    "mass": 2.0,
    "inertia": [1.0, 2.0, 2.5],
    "angular_velocity": [0.05, 3.0, 0.02],
    "position": [1.0, 2.0, 3.0],
    "velocity": [0.5, -0.25, 0.125],
    "attitude": [1.0, 2.0, -1.0, 0.5],
}


@pytest.fixture(scope="module")
def beside(explicit, scene):
    """beside(**bodies): the bodies beside a single element at rest."""
    return lambda **bodies: scene({**explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]]), "bodies": bodies})


def test_attitude_of_a_quaternion():
    """A quarter turn about z carries x to y, a third about (1, 1, 1) permutes the axes; length is free."""
    half = math.sqrt(0.5)
    assert rotation((half, 0.0, 0.0, half)) @ [1, 0, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    assert rotation((5.0, 5.0, 5.0, 5.0)) == pytest.approx(
        np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), abs=1e-15
    )
    assert rotation((-2.0, 0.0, 0.0, 0.0)) == pytest.approx(np.eye(3))
    assert rotation((0.0, 1e-300, 0.0, 0.0)) == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-15)
    # by the textbook's polynomial (Goldstein, eq. 4.47'), of a quaternion without symmetry
    w, x, y, z = np.array([1.0, 2.0, -1.0, 0.5]) / math.sqrt(6.25)
    expected = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    assert rotation((1.0, 2.0, -1.0, 0.5)) == pytest.approx(np.array(expected), abs=1e-15)


@pytest.mark.parametrize(
    "options",
    [{}, {"method": "RK45", "rtol": 1e-8}, {"method": "EM", "step": 4e-3}],
    ids=["DOP853", "RK45", "EM"],
)
def test_full_inertia_is_principal_axes_turned(beside, options):
    """One body in the frame of its principal axes, and in a frame turned by Q against it.

    J' = Q^T J Q, R' = R Q, w' = Q^T w, c' = Q^T c: both start, and stay, in the same places.
    """
    q = rotation((3.0, -1.0, 2.0, 0.5))
    full = q.T @ np.diag(BOX["inertia"]) @ q
    other = {
        "mass": BOX["mass"],
        "inertia": np.diag(full).tolist(),
        "products_of_inertia": [full[0, 1], full[0, 2], full[1, 2]],
        "centre_of_mass": (q.T @ [0.5, -1.0, 2.0]).tolist(),
        "position": BOX["position"],
        "velocity": BOX["velocity"],
        "attitude": product(BOX["attitude"], [3.0, -1.0, 2.0, 0.5]),
        "angular_velocity": (q.T @ BOX["angular_velocity"]).tolist(),
    }
    made = beside(one={**BOX, "centre_of_mass": [0.5, -1.0, 2.0]}, other=other)
    run = made.integrate(np.linspace(0.0, 1.0, 5), **options)
    one, turned_one = np.moveaxis(run.bodies.attitude, 1, 0)
    assert one @ q == pytest.approx(turned_one, abs=1e-10)  # the same steps: far below the methods' errors
    w, turned_w = np.moveaxis(run.bodies.angular_velocity, 1, 0)
    assert w @ q == pytest.approx(turned_w, abs=1e-10)
    assert run.bodies.position[:, 0] == pytest.approx(run.bodies.position[:, 1], abs=1e-14)


def product(a, b):
    """Of two quaternions [w, x, y, z] (Hamilton): b turns first."""
    a0, a1, b0, b1 = a[0], np.array(a[1:]), b[0], np.array(b[1:])
    return [float(a0 * b0 - a1 @ b1), *(a0 * b1 + b0 * a1 + np.cross(a1, b1)).tolist()]


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
    """theory_bodies.md; its origin moves the same, its centre of mass is always at R c from it."""
    centre = [0.1, 0.2, -0.3]
    made = scene(led(**MOVED, **turned, centre_of_mass=centre))
    attitude = scene(led(motion="fixed", **turned)).bodies0.attitude[0]
    run = made.integrate([0.0, 0.4, 0.7])
    assert run.bodies.attitude[:, 0] == pytest.approx(np.tile(attitude, (3, 1, 1)), abs=1e-14)
    assert np.abs(run.bodies.angular_velocity).max() < 1e-14
    assert run.bodies.position[1, 0] == pytest.approx([0.0, 0.4, 0.3] + attitude @ centre, abs=1e-14)


LINK = {"nodes": [[1.0, 0, 0], [2.0, 0, 0]], "elements": [[0, 1]]}
TOW = {"cable": {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e7}, "node_masses": [0.5, 0.25]}


@pytest.fixture(scope="module")
def towing(explicit):
    """towing(point, effects, start, **body): a body whose point is node 0 of a net of one element."""

    def make(point=(1.0, 0.0, 0.0), effects=None, start=None, **body):
        case = explicit(**LINK, initial=start, **TOW)
        held = {**BODY, **body, "attachments": {"hook": {"point": list(point), "node": 0}}}
        return {**case, "bodies": {"tug": held}, "effects": effects or {}}

    return make


@pytest.mark.parametrize("arithmetic", [{}, {"assembled": True}, {"symmetric": True}], ids=str)
def test_books_close_with_damping_and_weight(towing, scene, unbalanced, arithmetic):
    effects = {
        "gravity": {"acceleration": [0.0, 0.0, -1.0]},
        "material_damping": {"relaxation_time": 1e-4},
        "rayleigh_damping": {"alpha": 0.2, "beta": 1e-5},
    }
    start = {"node_velocities": [[0.0, 0, 0], [0.3, 1.0, 0.2]]}
    made = scene(towing(effects=effects, start=start, angular_velocity=[1.0, 0.5, -1.0]), **arithmetic)
    run = made.integrate([0.0, 0.2, 0.5])
    assert unbalanced(made, run) < 1e-8
    assert run.dissipated[-1] > 0.0


def test_light_and_thrust_on_a_fixed_body_change_nothing_else(document, scene, unbalanced):
    """Their work would be done on what holds the body; the balance of all else is kept without it."""
    light = {"flux": 1e9, "direction": [1.0, 0, 0], "pressure_coefficient": 1.0, "bullet_area": 0.1}
    thrust = {"bullets": [1], "time": [0.0, 1.0], "force": [[5.0, 0, 0], [5.0, 0, 0]]}
    case = document("radial", cable={"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e7})
    case["net"]["strings"] = {**case["net"]["strings"], "youngs_modulus": 1e7}
    hook = {"attachments": {"k": {"point": [0.3, 0.3, 0], "bullet": 1}}}
    prescribed = {**BODY, **hook, "motion": "prescribed", "velocity": [2.0, 0.5, 0]}
    case |= {"bodies": {"tug": prescribed}, "effects": {"solar_pressure": light, "thrust": thrust}}
    made = scene(case)
    run = made.integrate([0.0, 0.1, 0.3])
    assert unbalanced(made, run) < 1e-8

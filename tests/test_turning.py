"""Single steps of turning bodies in the compiled loop, as plain Python, against a solution by DOP853."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import no_table
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from exunet.bodies.port import quaternion_of_matrix
from exunet.bodies.rigid import RigidStates, angular_momentum, kinetic
from exunet.bodies.rotations import (
    angular_velocity_of,
    quaternion_of,
    rotation_matrix,
    rotation_vector,
    turning,
)
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.workspace import Motion, motion_at
from exunet.kernels.kernel import Takes

START = 0.2  # [s]
INERTIA = np.array([[2.0, 3.0, 4.5], [1.0, 0.7, 0.4]])
SPIN = np.array([[1.0, -2.0, 0.7], [-0.6, 0.9, 1.4]])
ATTITUDE = np.array([[0.7, 0.1, -0.5, 0.5], [0.5, -0.7, 0.1, 0.5]])  # of length one
CENTRES = 6  # coordinates of x: no point, two centres; the angular velocities stand behind


def torque(t: float) -> np.ndarray:
    """(2, 3) [N m] in the bodies' axes."""
    return np.array([[np.cos(3.0 * t), 0.5, -t], [t * t, -np.sin(2.0 * t), 0.8]])


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """The names that a generated module has: bodies, and a torque that changes with time."""

    def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
        out[CENTRES:] += torque(t).ravel()
        return 0.0, 0.0

    monkeypatch.setattr(steps, "add_forces", add_forces, raising=False)
    monkeypatch.setattr(steps, "borrowed", lambda value: value, raising=False)
    for name in ("BODIES", "FIRST_ORDER"):
        monkeypatch.setattr(steps, name, True, raising=False)
    monkeypatch.setattr(steps, "remember", lambda *state: None, raising=False)


def at_start() -> Motion:
    v = np.concatenate([np.zeros(CENTRES), SPIN.ravel()])
    inverse = np.concatenate([np.ones(CENTRES), (1.0 / INERTIA).ravel()])
    x = np.concatenate([np.zeros(CENTRES), ATTITUDE.ravel()])
    return motion_at(x, v, inverse, no_table(), INERTIA.copy(), CENTRES)


def exact(h: float) -> np.ndarray:
    """(2, 7) attitudes and angular velocities after h: the product of quaternions, and Euler's equations."""
    found = []
    for body in range(2):

        def rate(t: float, y: np.ndarray, b: int = body) -> np.ndarray:
            (w, *u), spin = y[:4], y[4:]
            turn = 0.5 * np.array([-np.dot(u, spin), *(w * spin + np.cross(u, spin))])
            return np.concatenate([turn, (torque(t)[b] - np.cross(spin, INERTIA[b] * spin)) / INERTIA[b]])

        start = np.concatenate([ATTITUDE[body], SPIN[body]])
        end = solve_ivp(rate, (START, START + h), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        found.append(end)
    return np.array(found)


@pytest.mark.parametrize(
    ("method", "order"), [("verlet_step", 2), ("runge_kutta_4_step", 4), ("dormand_prince_step", 5)]
)
def test_a_step_turns_bodies_with_its_order(method: str, order: int) -> None:
    """Half the step, 2^(order + 1) times less error in attitude and in angular velocity."""
    errors = []
    for h in (0.1, 0.05, 0.025):
        motion = at_start()
        steps.begin(START, method == "verlet_step", motion)
        told = getattr(steps, method)(START, h, motion)
        spin = steps.stages_of(motion.work).v1[CENTRES : CENTRES + 6].reshape(2, 3)
        error = np.abs(np.hstack([motion.z1.reshape(2, 4), spin]) - exact(h))
        errors.append([error[:, :4].max(), error[:, 4:].max()])
        if method == "dormand_prince_step":  # what it tells of its error is that of a method of order 4
            assert max(errors[-1]) < told[0] < 0.1 * h**4
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > order + 0.7, orders
    assert np.max(errors[0]) < 10.0 * 0.1 ** (order + 1)  # a far too large coefficient may shrink as fast


@pytest.mark.parametrize("method", ["verlet_step", "runge_kutta_4_step", "dormand_prince_step"])
def test_states_of_terms_go_with_the_order_of_the_method(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """y' = sin 3t - 2 y + place: half the step, 2^(order + 1) times less error. All else is as before."""
    errors = []
    for h in (0.1, 0.05):
        motion = with_a_state(monkeypatch)
        steps.begin(START, method == "verlet_step", motion)
        getattr(steps, method)(START, h, motion)
        errors.append(abs(motion.z1[8] - whole(h)[-2]))
    order = {"verlet_step": 2, "runge_kutta_4_step": 4, "dormand_prince_step": 5}[method]
    assert np.log2(errors[0] / errors[1]) > order + 0.6, errors
    assert errors[0] < 20.0 * 0.1 ** (order + 1)


@pytest.mark.parametrize("takes", [Takes.INTEGRATED, Takes.REPORTED])
def test_work_of_all_that_moves_and_turns_is_of_order_4(
    takes: Takes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a power of places, attitudes, states and all speeds: half the step, 2^5 times less error."""
    errors = []
    for h in (0.1, 0.05):
        motion = with_a_state(monkeypatch)._replace(takes=int(takes))
        steps.begin(START, False, motion)
        steps.dormand_prince_step(START, h, motion)
        watts = power(START, motion.x, motion.v, None, None)
        a7 = steps.stages_of(motion.work).a7
        at_end = steps.work_of_step(START, h, watts, a7, motion)
        end = steps.stages_of(motion.work)
        assert at_end == power(START + h, end.x1, end.v1[:12], None, None)
        errors.append(abs(motion.taken[0] - 0.25 * h - whole(h)[-1]))
    assert np.log2(errors[0] / errors[1]) > 4.6, errors
    assert errors[0] < 1e-4


FORCE = np.array([0.5, -1.0, 0.8, 0.3, 0.9, -0.4])  # N, on both centres of 1 kg
ARM = np.random.default_rng(5).normal(size=(27, 2))  # of a power: by entries of x and v, twice each


def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float:
    """[W], of all that there is: 15 entries of x and 12 of v."""
    assert (len(x), len(v)) == (15, 12)
    both = np.concatenate([x, v])
    return float(t * (ARM[:, 0] @ both) + (ARM[:, 1] @ both) ** 2)


def with_a_state(monkeypatch: pytest.MonkeyPatch) -> Motion:
    """Both bodies and one state behind their attitudes; centres move under FORCE times the time."""

    def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
        assert (len(v), len(out)) == (12, 13)
        out[:CENTRES] += t * FORCE
        out[CENTRES:12] += torque(t).ravel()
        out[12] += np.sin(3.0 * t) - 2.0 * x[14] + x[0]
        return 0.0, 0.0

    monkeypatch.setattr(steps, "add_forces", add_forces, raising=False)
    for name, value in (
        ("power", power), ("has_power", lambda rows: True), ("FIRST_ORDER", True),
        ("extra_work", lambda h, before, after, rows: 0.25 * h),
    ):  # fmt: skip
        monkeypatch.setattr(steps, name, value, raising=False)
    v = np.concatenate([0.1 * np.arange(CENTRES), SPIN.ravel()])
    inverse = np.concatenate([np.ones(CENTRES), (1.0 / INERTIA).ravel(), [1.0]])
    x = np.concatenate([0.2 * np.arange(CENTRES), ATTITUDE.ravel(), [0.6]])
    return motion_at(x, v, inverse, no_table(), INERTIA.copy(), CENTRES)


def whole(h: float) -> np.ndarray:
    """x, v, and the state again, and the steps, after h."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        x, v = y[:15], y[15:27]
        turning = []
        for body in range(2):
            w, *u = x[6 + 4 * body : 10 + 4 * body]
            spin = v[6 + 3 * body : 9 + 3 * body]
            turning.append(0.5 * np.array([-np.dot(u, spin), *(w * spin + np.cross(u, spin))]))
        spins = [
            (torque(t)[b] - np.cross(s, INERTIA[b] * s)) / INERTIA[b]
            for b, s in enumerate(v[6:].reshape(2, 3))
        ]
        state = np.sin(3.0 * t) - 2.0 * x[14] + x[0]
        return np.concatenate([v[:6], *turning, [state], t * FORCE, *spins, [power(t, x, v, None, None)]])

    x = np.concatenate([0.2 * np.arange(CENTRES), ATTITUDE.ravel(), [0.6]])
    v = np.concatenate([0.1 * np.arange(CENTRES), SPIN.ravel()])
    start = np.concatenate([x, v, [0.0]])
    end = solve_ivp(rate, (START, START + h), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return np.concatenate([end[:27], [end[14], end[27]]])


def test_without_torque_verlet_turns_with_order_4(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the half steps of the torque, bodies rotate freely by a step of order 4."""
    monkeypatch.setitem(globals(), "torque", lambda t: np.zeros((2, 3)))
    errors = []
    for h in (0.1, 0.05):
        motion = at_start()
        steps.begin(START, True, motion)
        steps.verlet_step(START, h, motion)
        spin = steps.stages_of(motion.work).v1[CENTRES : CENTRES + 6].reshape(2, 3)
        errors.append(np.abs(np.hstack([motion.z1.reshape(2, 4), spin]) - exact(h)).max())
    assert np.log2(errors[0] / errors[1]) > 4.7, errors


def test_attitudes_are_of_length_one_after_a_step() -> None:
    motion = at_start()
    steps.begin(START, False, motion)
    steps.dormand_prince_step(START, 0.5, motion)
    lengths = np.linalg.norm(motion.z1.reshape(2, 4), axis=1)
    assert np.abs(lengths - 1.0).max() > 1e-6  # the step's error
    direction = motion.z1.reshape(2, 4) / lengths[:, None]
    steps.accept(motion, np.zeros(motion.v.size))
    np.testing.assert_allclose(motion.z.reshape(2, 4), direction, rtol=1e-14)


def test_rotation_matrices_and_angular_momentum_are_those_of_scipy() -> None:
    np.testing.assert_allclose(
        rotation_matrix(ATTITUDE), Rotation.from_quat(ATTITUDE, scalar_first=True).as_matrix(), atol=1e-15
    )
    mass, place = np.array([2.0, 5.0]), np.array([[1.0, 2.0, -1.0], [0.5, -3.0, 2.0]])
    speed = np.array([[0.3, -0.2, 0.9], [-1.0, 0.4, 0.7]])
    wanted = sum(
        m * np.cross(p, v) + Rotation.from_quat(q, scalar_first=True).apply(i * w)
        for m, p, v, q, i, w in zip(mass, place, speed, ATTITUDE, INERTIA, SPIN, strict=True)
    )
    found = angular_momentum(mass, INERTIA, RigidStates(place, speed, ATTITUDE, SPIN))
    np.testing.assert_allclose(found, wanted, rtol=1e-14)


def test_quaternions_of_matrices_are_those_of_scipy_up_to_their_sign() -> None:
    drawn = np.random.default_rng(3).normal(size=(50, 4))
    half_turns = np.eye(4)  # and no turn at all
    for wanted in (*drawn / np.linalg.norm(drawn, axis=1)[:, None], *half_turns, *ATTITUDE):
        matrix = Rotation.from_quat(wanted, scalar_first=True).as_matrix()
        found = np.array(quaternion_of_matrix(matrix.ravel().tolist()))
        np.testing.assert_allclose(found * np.sign(found @ wanted), wanted, atol=1e-15)


def test_rates_of_quaternions_and_angular_velocities() -> None:
    """By what 2e-6 s of turning do; back from quaternions of any length, which may grow as they turn."""
    h = 1e-6
    now, before, after = (
        Rotation.from_quat(ATTITUDE, scalar_first=True) * Rotation.from_rotvec(t * SPIN) for t in (0.0, -h, h)
    )
    found = turning(ATTITUDE, SPIN)
    change = after.as_quat(scalar_first=True) - before.as_quat(scalar_first=True)
    np.testing.assert_allclose(found, change / (2.0 * h), atol=1e-9)
    np.testing.assert_allclose(now.as_quat(scalar_first=True), ATTITUDE, atol=1e-15)
    np.testing.assert_array_equal(turning(ATTITUDE[None], SPIN[None]), found[None])
    back = angular_velocity_of(1.7 * ATTITUDE, 1.7 * found - 0.6 * ATTITUDE)
    np.testing.assert_allclose(back, SPIN, rtol=1e-14)


def test_rotation_vectors_of_any_number_of_axes_and_energy() -> None:
    """Of half a turn at most they come back; m v2 / 2 and the moments, for each body of each instant."""
    rng = np.random.default_rng(4)
    vector = rng.uniform(-1.8, 1.8, (2, 5, 3))
    assert quaternion_of(vector).shape == (2, 5, 4)
    np.testing.assert_allclose(rotation_vector(quaternion_of(vector)), vector, rtol=1e-13)
    place, speed, spin = rng.normal(size=(3, 5, 2, 3))
    states = RigidStates(place, speed, np.broadcast_to(ATTITUDE, (5, 2, 4)), spin)
    for body, mass in enumerate((2.0, 5.0)):
        (own,) = np.moveaxis(kinetic(np.array([mass]), INERTIA[body : body + 1], states.of_body(body)), -1, 0)
        known = 0.5 * mass * (speed[:, body] ** 2).sum(axis=1)
        known += 0.5 * (INERTIA[body] * spin[:, body] ** 2).sum(axis=1)
        np.testing.assert_allclose(own, known, rtol=1e-14)
        np.testing.assert_allclose(kinetic(np.array([2.0, 5.0]), INERTIA, states)[:, body], known, rtol=1e-14)

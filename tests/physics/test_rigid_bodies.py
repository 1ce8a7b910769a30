"""Free rigid bodies: rotation against known answers, order of steps, guards, shipped scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import BACKENDS, CASES, every_backend, no_table, of_text, refused
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import exunet
from exunet.base.errors import RunStopped
from exunet.bodies.port import quaternion_of_matrix
from exunet.bodies.rigid import RigidStates, kinetic
from exunet.bodies.rotations import (
    quaternion_of,
    rotation_matrix,
    rotation_vector,
)
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.workspace import Motion, motion_at
from exunet.kernels.kernel import Takes
from exunet.methods.method import Backend, Method, Plan, turning_polynomial
from exunet.model.limits import SAFETY, RotationError, rotation_step_limit
from exunet.results.measures import momentum_books
from exunet.simulation.guards import ENERGY_BOUND
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate
from exunet.verification.answers.bodies import FreeRotation

SNAP = CASES / "verification" / "snap.toml"
MOMENTS = np.array([2.0, 3.0, 4.0])
TUMBLING = np.array([0.01, 2.0, 0.02])  # nearly about the intermediate axis: it turns over
END = float(10 * 2.0 * np.pi / TUMBLING[1])
AT_START = np.array([0.9, 0.1, 0.3, 0.2]) / np.linalg.norm([0.9, 0.1, 0.3, 0.2])
BODY = (
    "bodies.target={mass=7.0, inertia=[2.0, 3.0, 4.0], position=[3, 0, 0], velocity=[0, 0.1, 0], "
    "attitude=[0.9, 0.1, 0.3, 0.2], angular_velocity=[0.01, 2.0, 0.02]}"
)


def with_body(backend: str, method: str, *more: str) -> exunet.Case:
    step = "solver.tolerance=1e-10" if method == "DOPRI5" else "solver.step=1e-3"
    times = (f"time.end={END!r}", "time.output_step=1.0", "time.output_times=")
    return exunet.load(SNAP, [BODY, BACKENDS[backend], f"solver.method={method}", step, *times, *more])


# Errors over ten turns are below 1e-9, which includes a turn over that multiplies errors by about 1e2: 2e-11
# seen with 3142 steps a turn, by RK44, and by Verlet in the compiled loop, which rotates bodies by a step of
# order 4 between the half steps of the torque.
@pytest.mark.ci_for("exudyn-RK44")
@pytest.mark.slow
@pytest.mark.parametrize(("backend", "method"), [("compiled", "VelocityVerlet"), ("exudyn", "RK44")])
def test_a_free_body_turns_by_jacobis_functions(backend: str, method: str) -> None:
    """By fixed steps; the known answers have adaptive steps on all backends."""
    result = exunet.run(with_body(backend, method))
    body, allowed = result.bodies["target"], 1e-9
    known = FreeRotation(np.diag(MOMENTS), TUMBLING, rotation_matrix(AT_START))
    frame = rotation_matrix(body.attitude)
    assert np.abs(frame - known.attitudes(result.time)).max() < 2.0 * allowed  # twice those of quaternions
    assert np.abs(body.angular_velocity - known.rates(result.time)).max() < 10.0 * allowed
    energy = 0.5 * body.angular_velocity**2 @ MOMENTS
    momentum = np.einsum("kab,kb->ka", frame, MOMENTS * body.angular_velocity)
    assert np.ptp(energy) < allowed * energy[0]
    assert np.abs(momentum - momentum[0]).max() < 10.0 * allowed * np.linalg.norm(momentum[0])
    np.testing.assert_allclose(body.position[-1], [3.0, 0.1 * END, 0.0], atol=1e-10)  # eps x 31 416 x 6 m


@every_backend
def test_a_body_changes_nothing_of_the_net_that_it_does_not_touch(backend: str) -> None:
    equal = (BACKENDS[backend], "solver.method=RK44", "solver.step=1e-4")  # which the bodies may limit
    alone, beside = (exunet.run(exunet.load(SNAP, [*equal, *more])) for more in ([], [BODY]))
    np.testing.assert_array_equal(beside.position, alone.position)
    momentum, place = 7.0 * np.array([0.0, 0.1, 0.0]), [3.0, 0.0, 0.0]
    spin = rotation_matrix(AT_START) @ (MOMENTS * TUMBLING)
    np.testing.assert_allclose(beside.momentum[0] - alone.momentum[0], momentum, rtol=1e-14)
    turning = beside.angular_momentum[0] - alone.angular_momentum[0]
    np.testing.assert_allclose(turning, spin + np.cross(place, momentum), rtol=1e-13)


def test_the_energy_of_bodies_is_guarded() -> None:
    """Steps of five radians, which a script has planned."""
    fast = "bodies.target.angular_velocity=[2e3, 4e3, 2e3]"
    case = with_body("compiled", "DOPRI5", fast, "solver.retry=0")
    start = replace(prepare_case(case), plan=Plan(Method.RK44, step=1e-3))
    with pytest.raises(RunStopped, match="the energy of the rigid bodies"):
        simulate(start)


def test_a_heavy_body_does_not_blunt_the_guards_of_the_net() -> None:
    """A step too long stops the run where it would without the body."""
    step = "solver={method='RK44', step=4e-4, force=true, retry=0}"
    heavy = "bodies.target={mass=500.0, inertia=[80.0, 100.0, 120.0], angular_velocity=[0.0, 1.0, 0.1]}"
    found = []
    for more in ([], [heavy]):
        with pytest.raises(RunStopped) as stopped:
            exunet.run(exunet.load(CASES / "planar_undamped.toml", ["engine.backend=compiled", step, *more]))
        found.append(str(stopped.value))
    assert found[0] == found[1]


# Single steps of the compiled loop, as plain Python

START = 0.2  # [s]
INERTIA = np.array([[2.0, 3.0, 4.5], [1.0, 0.7, 0.4]])
SPIN = np.array([[1.0, -2.0, 0.7], [-0.6, 0.9, 1.4]])
ATTITUDE = np.array([[0.7, 0.1, -0.5, 0.5], [0.5, -0.7, 0.1, 0.5]])  # of length one
CENTRES = 6  # coordinates of x: no point, two centres; the angular velocities stand behind


FORCE = np.array([0.5, -1.0, 0.8, 0.3, 0.9, -0.4])  # N/s, on both centres of 1 kg
ARM = np.random.default_rng(5).normal(size=(27, 2))  # of a power: by entries of x and v, twice each


def torque(t: float) -> np.ndarray:
    """(2, 3) [N m] in the bodies' axes."""
    return np.array([[np.cos(3.0 * t), 0.5, -t], [t * t, -np.sin(2.0 * t), 0.8]])


def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float:
    """[W], of all that there is: 15 entries of x and 12 of v."""
    assert (len(x), len(v)) == (15, 12)
    both = np.concatenate([x, v])
    return float(t * (ARM[:, 0] @ both) + (ARM[:, 1] @ both) ** 2)


@pytest.fixture
def motion(monkeypatch: pytest.MonkeyPatch) -> Callable[[], Motion]:
    """Two bodies and a state behind their attitudes; centres move under FORCE times the time.

    The module of the steps has the names that a generated module has.
    """

    def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
        assert (len(v), len(out)) == (12, 13)
        out[:CENTRES] += t * FORCE
        out[CENTRES:12] += torque(t).ravel()
        out[12] += np.sin(3.0 * t) - 2.0 * x[14] + x[0]
        return 0.0, 0.0

    for name, value in (
        ("add_forces", add_forces), ("borrowed", lambda value: value), ("BODIES", True),
        ("FIRST_ORDER", True), ("remember", lambda *state: None), ("power", power),
        ("has_power", lambda rows: True), ("extra_work", lambda h, *state: 0.25 * h),
    ):  # fmt: skip
        monkeypatch.setattr(steps, name, value, raising=False)
    inverse = np.concatenate([np.ones(CENTRES), (1.0 / INERTIA).ravel(), [1.0]])
    x, v = exact(0.0)[:15], exact(0.0)[15:27]
    return lambda: motion_at(x.copy(), v.copy(), inverse, no_table(), INERTIA.copy(), CENTRES)


def exact(h: float) -> np.ndarray:
    """(28,) x, v and the work after h: the product of quaternions and Euler's equations, by DOP853."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        x, v = y[:15], y[15:27]
        rates, spins = [], []
        for body, spin in enumerate(v[6:].reshape(2, 3)):
            w, *u = x[6 + 4 * body : 10 + 4 * body]
            rates.append(0.5 * np.array([-np.dot(u, spin), *(w * spin + np.cross(u, spin))]))
            spins.append((torque(t)[body] - np.cross(spin, INERTIA[body] * spin)) / INERTIA[body])
        state = np.sin(3.0 * t) - 2.0 * x[14] + x[0]
        return np.concatenate([v[:6], *rates, [state], t * FORCE, *spins, [power(t, x, v, None, None)]])

    x = np.concatenate([0.2 * np.arange(CENTRES), ATTITUDE.ravel(), [0.6]])
    start = np.concatenate([x, 0.1 * np.arange(CENTRES), SPIN.ravel(), [0.0]])
    return solve_ivp(rate, (START, START + h), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


@pytest.mark.parametrize(
    ("method", "order"), [("verlet_step", 2), ("runge_kutta_4_step", 4), ("dormand_prince_step", 5)]
)
def test_a_step_has_its_order(method: str, order: int, motion: Callable[[], Motion]) -> None:
    """Half the step, 2^(order + 1) times less error in attitudes, angular velocities and states of terms."""
    errors = []
    for h in (0.1, 0.05, 0.025):
        now, known = motion(), exact(h)
        steps.begin(START, method == "verlet_step", now)
        estimate = getattr(steps, method)(START, h, now)
        error = np.abs(now.z1 - known[6:15])  # attitudes, and the state
        spin = np.abs(steps.stages_of(now.work).v1[CENTRES:12] - known[21:27])
        errors.append([error[:8].max(), spin.max(), error[8]])
        if method == "dormand_prince_step":  # its estimate is the error of a method of order 4
            assert max(errors[-1]) < estimate[0] < 0.1 * h**4
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > order + 0.6, orders
    assert np.max(errors[0]) < 20.0 * 0.1 ** (order + 1)  # a far too large coefficient may shrink as fast


@pytest.mark.parametrize("takes", [Takes.INTEGRATED, Takes.REPORTED])
def test_the_work_of_a_step_is_of_order_4(takes: Takes, motion: Callable[[], Motion]) -> None:
    """Of a power of places, attitudes, states and all speeds: half the step, 2^5 times less error."""
    errors = []
    for h in (0.1, 0.05):
        now = motion()._replace(takes=int(takes))
        steps.begin(START, False, now)
        steps.dormand_prince_step(START, h, now)
        watts = power(START, now.x, now.v, None, None)
        at_end = steps.work_of_step(START, h, watts, steps.stages_of(now.work).a7, now, False)
        end = steps.stages_of(now.work)
        assert at_end == power(START + h, end.x1, end.v1[:12], None, None)
        errors.append(abs(now.taken[0] - 0.25 * h - exact(h)[-1]))
    assert np.log2(errors[0] / errors[1]) > 4.6, errors
    assert errors[0] < 1e-4


def test_attitudes_are_of_length_one_after_a_step(motion: Callable[[], Motion]) -> None:
    now = motion()
    steps.begin(START, False, now)
    steps.dormand_prince_step(START, 0.5, now)
    attitudes = now.z1[:8].reshape(2, 4)
    lengths = np.linalg.norm(attitudes, axis=1)
    assert np.abs(lengths - 1.0).max() > 1e-6  # the step's error
    direction = attitudes / lengths[:, None]
    steps.accept(now, np.zeros(now.v.size))
    np.testing.assert_allclose(now.z[:8].reshape(2, 4), direction, rtol=1e-14)


def test_quaternions_of_matrices_are_those_of_scipy_up_to_their_sign() -> None:
    drawn = np.random.default_rng(3).normal(size=(50, 4))
    half_turns = np.eye(4)  # and no turn at all
    for wanted in (*drawn / np.linalg.norm(drawn, axis=1)[:, None], *half_turns, *ATTITUDE):
        matrix = Rotation.from_quat(wanted, scalar_first=True).as_matrix()
        found = np.array(quaternion_of_matrix(matrix.ravel().tolist()))
        np.testing.assert_allclose(found * np.sign(found @ wanted), wanted, atol=1e-15)


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


# Guards of the rotation in a step: a light body turns about its middle axis, with a slack tether, beside a
# net of far more energy.
TETHERED = """
format = 1
title = "A body that turns"
time = { end = 0.2, output_step = 0.05 }
engine.backend = "exudyn"
net.topology = "explicit"
net.nodes = [[5.0, 0.0, 0.0], [6.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [20.0, 20.0]
net.cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e6 }
initial = { packing = 1.0, node_velocities = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]] }

[bodies.chaser]
mass = 0.02
inertia = [1e-6, 2e-6, 2.5e-6]
angular_velocity = [100.0, 700.0, 50.0]

[tethers.slack]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e6
length = 8.0
start = { body = "chaser", point = [0.001, 0.0, 0.0] }
end = { node = 0 }
"""
LONG = 3.5e-3  # 2.5 rad of the body


def tethered(*overrides: str) -> Start:
    return prepare_case(of_text(TETHERED, *overrides))


def in_steps(step: float, *overrides: str) -> Start:
    """With the plan of a script."""
    start = tethered(*overrides)
    return replace(start, plan=Plan(Method.RK44, backend=start.plan.backend, step=step))


def test_a_step_in_which_a_body_turns_far_is_refused() -> None:
    assert refused(TETHERED, "solver.method=RK44", f"solver.step={LONG}") == ["solver.step"]


def test_without_a_step_it_is_a_part_of_the_longest() -> None:
    begin = tethered("solver.method=RK44")
    limit = rotation_step_limit(
        begin.system,
        begin.state.bodies.angular_velocity,
        turning_polynomial(Method.RK44, Backend.EXUDYN),
        0.2,
        ENERGY_BOUND,
    )
    assert begin.plan.step == SAFETY * limit


@pytest.mark.parametrize(
    ("method", "backend", "known"),
    [
        # |R(iz)|^2 - 1 = -z^6 / 72 + z^8 / 576, -z^4 / 12 + z^6 / 36, z^4 / 4, z^2
        (Method.RK44, Backend.EXUDYN, lambda z: z**6 / 72 + z**8 / 576),
        (Method.VELOCITY_VERLET, Backend.COMPILED, lambda z: z**6 / 72 + z**8 / 576),
        (Method.RK33, Backend.EXUDYN, lambda z: z**4 / 12 + z**6 / 36),
        (Method.EXPLICIT_MIDPOINT, Backend.EXUDYN, lambda z: z**4 / 4),
        (Method.VELOCITY_VERLET, Backend.EXUDYN, lambda z: z**2),
    ],
)
def test_what_steps_do_to_a_body(method: Method, backend: Backend, known: Any) -> None:
    """At 3 rad/s, by moments 1, 2 and 2.5 with (2.5 - 1) / 2 = 0.75, in steps of 0.1 s until 2 s.

    The tether's end adds to the body's moments less than 1e-2 of them.
    """
    heavy = "bodies.chaser.inertia=[1.0, 2.0, 2.5]"
    rotation = RotationError(tethered(heavy).system, 0.1, turning_polynomial(method, backend))
    (error,), (angle,) = (
        found[0]
        for found in (
            rotation.error(np.array([[[0.0, 3.0, 0.0]]]), np.array([2.0])),
            rotation.angle(np.array([[[0.0, 3.0, 0.0]]])),
        )
    )
    assert angle == pytest.approx(0.3, rel=1e-15)
    assert error == pytest.approx(20 * known(0.75 * 0.3), rel=1e-2)


def test_a_run_of_such_steps_is_stopped() -> None:
    with pytest.raises(RunStopped, match=r"chaser rotates by 2\.\d+ rad a step") as stop:
        simulate(in_steps(LONG, "solver.retry=0"))
    assert stop.value.step_cause


def test_a_retry_mends_it() -> None:
    """Half the step twice; the body's energy is then kept, on which nothing ever acts."""
    run = simulate(in_steps(LONG, "time.end=0.1"))
    assert run.complete
    assert [item.step_s for item in run.run.retries] == [LONG / 2, LONG / 4]
    spin = run.bodies["chaser"].angular_velocity
    energy = spin**2 @ [1e-6, 2e-6, 2.5e-6]
    assert np.abs(energy / energy[0] - 1.0).max() < ENERGY_BOUND


def ran(name: str, *overrides: str) -> exunet.Result:
    return exunet.run(exunet.load(CASES / "bodies" / f"{name}.toml", overrides))


def assert_momentum_stays(found: exunet.Result) -> None:
    """Linear momentum to 1e-10 and angular momentum to 1e-8 of their sizes."""
    for kind, bound in (("linear", 1e-10), ("angular", 1e-8)):
        book = momentum_books(found)[kind]
        assert book.residual < bound * book.size


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_carried_net_waits_for_its_release(backend: str) -> None:
    """The line from a held bullet pulls at the deployer, also where the engine has elements of its own."""
    found = ran("release", "time.end=0.5", BACKENDS[backend])
    assert_momentum_stays(found)
    deployer, held = found.bodies["deployer"], found.time < 0.4
    net = found.position[:, : found.net.n_net_nodes] - deployer.position[:, None]
    inside = np.einsum("kij,kni->knj", rotation_matrix(np.asarray(deployer.attitude)), net)
    assert np.ptp(inside[held], axis=0).max() < 1e-13
    pulled = found.tension[:, found.net.tether_elements["line"]].max(axis=1) > 0.0
    first = found.time[pulled][0]
    assert 0.1 < first < 0.2
    spin = np.linalg.norm(deployer.angular_velocity - deployer.angular_velocity[0], axis=1)
    assert spin[found.time < first].max() < 1e-3 < 1e-2 < spin[held][-1]
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total - total[0]).max() < 1e-6 * found.kinetic.max()


@pytest.mark.slow
def test_the_snap_throws_back() -> None:
    found = ran("snap", "time.end=1.4")
    assert_momentum_stays(found)
    slack = found.tension.max(axis=1) == 0.0
    assert slack[0]
    assert not slack.all()
    chaser, target = found.bodies["chaser"], found.bodies["target"]
    assert target.velocity[-1, 2] < 0.5 < 1.0 < chaser.velocity[-1, 2]  # 2/3 - 1/3, 2/3 + 2/3 if on the line
    assert np.abs(chaser.angular_velocity[-1]).max() > 0.5
    total = found.kinetic + found.elastic
    assert np.abs(total / total[0] - 1.0).max() < 1e-5


def test_the_throw_turns_the_chaser() -> None:
    found = ran("launch", "time.end=0.4", BACKENDS["exudyn"])
    assert_momentum_stays(found)
    chaser = found.bodies["chaser"]
    assert chaser.velocity[0] @ [0.0, -math.sin(0.3), math.cos(0.3)] < -0.02  # against the throw
    bullets = found.net.bullet_nodes
    way = found.velocity[0, bullets].mean(axis=0)
    assert way @ [0.0, -math.sin(0.3), math.cos(0.3)] == pytest.approx(3.0 * math.cos(0.5), rel=0.01)
    assert found.kinetic[0] == pytest.approx(0.5 * 4 * 0.2 * 9.0, rel=0.2)


@pytest.mark.ci
@pytest.mark.slow
def test_the_tow_pays_out_and_winds_up() -> None:
    """The pull is that of the drive, theory_bodies.md, Reels: N_e = force + damping x rate given way."""
    found = ran("tow")
    assert_momentum_stays(found)
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total / total[0] - 1.0).max() < 1e-7
    wound = found.states["tow/wound_up"].values[:, 0]
    rate = CubicSpline(found.time, wound)(found.time, 1)
    pull = exunet.loads(found, "chaser").size[:, 0]
    braking, winding = (found.time > 3.0) & (found.time < 9.5), (found.time > 11.0) & (found.time < 12.5)
    np.testing.assert_allclose(pull[braking], 6.0 - 40.0 * rate[braking], rtol=2e-3)
    np.testing.assert_allclose(pull[winding], 40.0 - 40.0 * rate[winding], rtol=2e-3)  # below 0.4 m/s
    assert rate[winding].max() < 0.4
    nodes = [e.event.split(" ", 2)[2] for e in found.run.events if e.node is not None]
    assert nodes == ["comes off the drum", "goes onto the drum", "goes onto the drum"]
    assert found.tension[found.time > 20.0].max() == 0.0
    apart = np.linalg.norm(found.bodies["chaser"].position - found.bodies["target"].position, axis=1)
    assert (np.diff(apart[found.time > 20.0]) < 0.0).all()

"""Corner units: the sampled law against its closed form, limits, noise, energy, restarts, Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import cut_short
from pydantic import TypeAdapter
from scenes import BACKENDS, CASES, continue_alike, every_backend, refused
from scipy.spatial.distance import pdist

import exunet
from exunet.base.errors import InputError
from exunet.forces.corner_units import (
    SPENT,
    STATE_NAME,
    WORK,
    AnyControl,
    Control,
    Sensed,
    fired,
    growth_of_error,
    with_noise,
)
from exunet.net.areas import mouth_diameter
from exunet.results.measures import dissipation
from exunet.results.summary import summarise
from exunet.scene.casefile import Case
from exunet.simulation import run as runs
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation

PLANAR = CASES / "planar_undamped.toml"  # its strings are slack for 0.3 s, so each bullet is free
STILL = ("time.end=0.2", "time.output_step=0.02", "launch={radial_speed=0.0,axial_speed=0.0}")
COMPILED = BACKENDS["compiled"]
GAINS: dict[str, Any] = {"stiffness": 200.0, "damping": 12.0}
POINT: dict[str, Any] = {"kind": "point", "point": [0.9, 0.8, 0.1], **GAINS}
PUSH: dict[str, Any] = {  # constant forces on bullets 1 and 3
    "bullets": [1, 3], "kind": "table", "time": [0.0, 1.0],
    "force": [[[3.0, 0.0, 4.0], [0.0, 1.0, 0.0]]] * 2,
}  # fmt: skip
NOISE = {"position": 0.02, "velocity": 0.1, "seed": 7}


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}={toml(item)}" for key, item in value.items()) + "}"
    return f"[{','.join(map(toml, value))}]" if isinstance(value, list) else repr(value)


def keys_of(**more: Any) -> dict[str, Any]:
    return {"bullets": [1], "period": 0.02, "largest_thrust": 1e3} | more


def case_of(*overrides: str, **more: Any) -> Case:
    return exunet.load(PLANAR, [*STILL, f"control={toml(keys_of(**more))}", *overrides])


def control_of(**more: Any) -> Control:
    control: Control = TypeAdapter(AnyControl).validate_python(keys_of(**more))
    return control


def thrust_of(simulation: Simulation) -> np.ndarray:
    """(n, 3) the forces that act now."""
    return simulation.state.discrete[STATE_NAME][4:].reshape(-1, 3)


def free_motion(case: Case, goal: np.ndarray, drift: np.ndarray, n: int) -> list[np.ndarray]:
    """(2, 3) offset from the goal and its rate at n + 1 samples, by powers of the matrix of one period.

    Under the force -k x - c v of its beginning.
    """
    start = prepare_case(case)
    node = start.net.bullet_nodes[1]
    mass, h = start.net.mass[node], 0.02
    push = np.outer([0.5 * h * h, h], [GAINS["stiffness"], GAINS["damping"]]) / mass
    one = np.array([[1.0, h], [0.0, 1.0]]) - push
    at_start = np.array([start.position[node] - goal, start.velocity[node] - drift])
    return [np.linalg.matrix_power(one, k) @ at_start for k in range(n + 1)]


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_free_unit_follows_the_sampled_system(backend: str) -> None:
    """To a point at rest; 1e-13 is round-off of ten periods; what it puts in is in the energy balance."""
    case = case_of(BACKENDS[backend], **POINT)
    result = exunet.run(case)
    node, goal = result.net.bullet_nodes[1], np.array(POINT["point"])
    for k, known in enumerate(free_motion(case, goal, np.zeros(3), 10)):
        assert np.abs(result.position[k, node] - goal - known[0]).max() < 1e-13
        assert np.abs(result.velocity[k, node] - known[1]).max() < 1e-12
    total = result.kinetic + result.elastic + result.potential + result.dissipated
    assert np.ptp(total) < 1e-11  # J, of 0.7 J put in
    work = np.asarray(result.states[WORK].values)[:, 0]
    np.testing.assert_allclose(work, result.kinetic - result.kinetic[0], rtol=0, atol=1e-11)
    assert work[-1] > 0.5
    assert np.abs(dissipation(result)).max() < 1e-11  # nothing is


@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK44", "VelocityVerlet"])
@every_backend
def test_a_unit_sees_a_body_that_accelerates(backend: str, method: str) -> None:
    """The velocity gained in a period is that of the force at the stored state of its beginning."""
    motion = (
        'motion="prescribed",pose_times=[0.0,0.1,0.2],pose_positions=[[0.4,0,0.0],[0.45,0,0.0],[0.7,0,0.1]]'
    )
    body = f"bodies.ball={{mass=2.0,inertia=[0.3,0.3,0.3],{motion}}}"
    to_body = {"kind": "point", "body": "ball", **GAINS}
    result = exunet.run(
        case_of(BACKENDS[backend], body, f"solver.method={method}", "solver.step=1e-4", **to_body)
    )
    node, ball = result.net.bullet_nodes[1], result.bodies["ball"]
    away, parting = ball.position - result.position[:, node], ball.velocity - result.velocity[:, node]
    force = GAINS["stiffness"] * away + GAINS["damping"] * parting
    gained = np.diff(result.velocity[:, node], axis=0)
    # Round-off of 200 steps.
    np.testing.assert_allclose(gained, 0.02 * force[:-1] / result.net.mass[node], rtol=0, atol=1e-12)


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@every_backend
def test_a_unit_on_a_body(backend: str) -> None:
    """A bullet fixed to a body that turns: the momentum gained in a period is that of the force at the
    stored state of its beginning, with the velocity that the body gives the bullet then.
    """
    body = (
        "bodies.ball={mass=2.0,inertia=[0.3,0.4,0.5],position=[0.35,-0.35,0.2],angular_velocity=[3,2.0,0],"
        "attachments.one={bullet=1,point=[0.0,0.0,-0.2]}}"
    )
    result = exunet.run(
        case_of(BACKENDS[backend], body, "solver.method=VelocityVerlet", "solver.step=1e-4", **POINT)
    )
    node = result.net.bullet_nodes[1]
    force = GAINS["stiffness"] * (np.array(POINT["point"]) - result.position[:, node])
    force -= GAINS["damping"] * result.velocity[:, node]
    np.testing.assert_allclose(np.diff(result.momentum, axis=0), 0.02 * force[:-1], rtol=0, atol=1e-12)


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_table_gives_its_impulse(backend: str) -> None:
    """Each sample's force for a period: force over time is a ramp, its samples a staircase."""
    ramp = {"kind": "table", "time": [0.03, 0.11], "force": [[[0.0, 0.0, 1.0]], [[0.0, 4.0, 1.0]]]}
    result = exunet.run(case_of(BACKENDS[backend], **ramp))
    at = np.arange(0.04, 0.111, 0.02)  # the samples in the table
    force = np.stack([0 * at, 4.0 * (at - 0.03) / 0.08, np.ones_like(at)], axis=1)
    gained = result.momentum[-1] - result.momentum[0]
    np.testing.assert_allclose(gained, 0.02 * force.sum(axis=0), rtol=0, atol=1e-13)
    spent = 0.02 * np.linalg.norm(force, axis=1).sum()
    np.testing.assert_allclose(result.states[SPENT].values[-1], [spent], rtol=1e-12)


@pytest.mark.parametrize("times", [[0.1, 0.3], [0.2, 0.4]])
def test_a_sample_at_the_end_of_a_table_is_in_it(times: list[float]) -> None:
    """6 x 0.05 is 0.3 up to round-off: five samples of 5 N, each for 0.05 s."""
    table = {"kind": "table", "period": 0.05, "time": times, "force": [[[0.0, 0.0, 5.0]]] * 2}
    result = exunet.run(case_of(COMPILED, "time.end=0.5", **table))
    assert result.states[SPENT].values[-1] == pytest.approx(1.25, rel=1e-12)


def test_limits() -> None:
    """A demand above the limit keeps its direction; one whose impulse is too small is not fired."""
    control = control_of(**POINT, bullets=[0, 1, 2], largest_thrust=5.0, minimum_impulse=0.04)
    sensed = Sensed(0.0, [0.0] * 9, [0.0] * 9, [0.0] * 3, [0.0] * 3)
    demand = [30.0, 40.0, 0.0, 0.0, 0.0, 2.0, 1.9, 0.0, 0.0]  # 2 N for 0.02 s is 0.04 N s
    known = [3.0, 4.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(fired(control, demand, sensed), known, rtol=1e-15)
    far = [3e200, 4e200, 0.0, *demand[3:]]  # the square of which is beyond all numbers
    np.testing.assert_allclose(fired(control, far, sensed), known, rtol=1e-15)


def test_directions() -> None:
    """What is demanded across the line of the thrusters is lost; along it either way is fired."""
    place = [2.0, 0.0, 0.0, -2.0, 0.0, 0.0]
    speed = [0.0, 3.0, 0.0, 0.0, 0.0, 0.0]
    sensed = Sensed(0.0, place, speed, [0.0] * 3, [0.0] * 3)
    demand = [1.0, -2.0, 5.0] * 2
    for direction, known in (
        ("outward", [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]),
        ("flight", [0.0, -2.0, 0.0, 0.0, 0.0, 0.0]),  # the second does not fly
    ):
        control = control_of(**POINT, bullets=[0, 1], direction=direction)
        np.testing.assert_allclose(fired(control, demand, sensed), known, atol=1e-15)


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_formation_about_its_mean_moves_no_centre(backend: str) -> None:
    """Errors sum to zero, so do the forces; by symmetry the mean rests at 0, and each unit goes to its place
    as one that goes to a point.
    """
    offsets = [[-0.5, -0.5, 0.3], [0.5, -0.5, -0.3], [0.5, 0.5, 0.3], [-0.5, 0.5, -0.3]]
    formation = {"kind": "formation", "bullets": [0, 1, 2, 3], "offsets": offsets, **GAINS}
    case = case_of(BACKENDS[backend], **formation)
    result = exunet.run(case)
    assert np.abs(result.momentum - result.momentum[0]).max() < 1e-13  # round-off of 0.9 kg m/s on each
    for k, known in enumerate(free_motion(case, np.array(offsets[1]), np.zeros(3), 10)):
        assert np.abs(result.position[k, result.net.bullet_nodes[1]] - offsets[1] - known[0]).max() < 1e-13


def noisy(*overrides: str, seed: int = 7) -> exunet.Result:
    return exunet.run(case_of(*overrides, **POINT, noise=NOISE | {"seed": seed}))


def test_noise_has_the_bits_of_its_seed() -> None:
    """In a second run too; another seed has others."""
    once, again, other = noisy(COMPILED), noisy(COMPILED), noisy(COMPILED, seed=8)
    assert np.array_equal(once.position, again.position)
    assert np.abs(once.position - other.position).max() > 1e-3


def test_noise_is_the_same_in_both_back_ends() -> None:
    """Without noise the unit would be elsewhere by millimetres; 1e-12 is round-off."""
    compiled, exudyn = noisy(COMPILED), noisy(BACKENDS["exudyn"])
    np.testing.assert_allclose(compiled.position[:, 20:], exudyn.position[:, 20:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(compiled.states[SPENT].values, exudyn.states[SPENT].values, rtol=1e-11)
    quiet = exunet.run(case_of(COMPILED, **POINT))
    assert np.abs(compiled.position - quiet.position).max() > 1e-3


def test_noise_has_its_standard_deviations() -> None:
    """Of 9000 numbers a deviation is known to 1 / sqrt(18000) = 0.75 %, a bound is four times that; errors
    of two units, and of place and velocity, are independent.
    """
    control = control_of(**POINT, bullets=[0, 1], noise=NOISE)
    zero = [0.0] * 6
    drawn = np.array([with_noise(control.noise, control.bullets, k, zero, zero) for k in range(3000)])
    drawn = drawn.reshape(3000, 2, 2, 3)
    for part, deviation in enumerate((0.02, 0.1)):
        assert np.sqrt((drawn[:, part] ** 2).mean(axis=(0, 2))) == pytest.approx(deviation, rel=0.03)
    scaled = drawn / np.array([0.02, 0.1])[:, None, None]
    every = scaled.reshape(3000, -1)
    correlated = every.T @ every / 3000 - np.eye(12)
    assert np.abs(correlated).max() < 5.0 * np.sqrt(2.0 / 3000)


def test_a_controller_does_not_see_what_comes() -> None:
    """A push between two samples changes nothing of the force until the second, and the force then."""
    first, other = (Simulation(case_of(COMPILED, **POINT)) for _ in range(2))
    for item in (first, other):
        item.advance_to(0.05)  # samples at 0, 0.02, 0.04
    held = thrust_of(first).copy()
    other.set_force(int(other.net.bullets[1]), [0.0, 5.0, 0.0])
    for entry in (first, other):
        entry.advance_to(0.0599)
    assert np.array_equal(thrust_of(first), held)
    assert np.array_equal(thrust_of(other), held)
    assert np.abs(first.net.velocity - other.net.velocity).max() > 0.05
    for element in (first, other):
        element.advance_to(0.06)
    assert np.abs(thrust_of(first) - thrust_of(other)).max() > 1.0


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_restart_between_two_samples_goes_on_bitwise(backend: str, tmp_path: Path) -> None:
    """With noise, which depends on the number of the sample; a retry goes back to that of its state."""
    case = case_of(BACKENDS[backend], **POINT, noise=NOISE)
    one, other = Simulation(case), Simulation(case)
    for time, samples in ((0.06, 4.0), (0.07, 4.0)):  # at a sample, which is done then, and between two
        one.advance_to(time)
        discrete, safe = one.state.discrete[STATE_NAME], one.run.observers.safe.state
        assert (safe.time, discrete[2]) == (time, samples)
        np.testing.assert_array_equal(safe.discrete[STATE_NAME], discrete)
    continue_alike(one, other, 0.15, tmp_path)


def script(*entries: str) -> str:
    return f"script=[{','.join(entries)}]"


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_script_begins_and_ends_the_control(backend: str) -> None:
    """The first sample is at the instant of the entry; after the release nothing fires."""
    entries = script(
        '{name="on",at=0.03,do="control"}',
        '{name="off",at=0.075,do="release_control"}',
        '{name="again",at=0.11,do="control"}',
    )
    result = exunet.run(case_of(BACKENDS[backend], entries, "time.output_step=0.005", **PUSH))
    burnt = np.clip(result.time - 0.03, 0.0, 0.045) + np.clip(result.time - 0.11, 0.0, None)
    known = burnt[:, None] * [5.0, 1.0]
    np.testing.assert_allclose(result.states[SPENT].values, known, rtol=0, atol=1e-13)


def test_the_period_beyond_which_the_control_is_unstable() -> None:
    """A free mass under a gain of c alone: 2 m / c."""
    braked = {"kind": "point", "point": [0.0, 0.0, 0.0], "stiffness": 0.0, "damping": 12.0}
    for part, grows in ((0.999, False), (1.001, True)):
        growth = growth_of_error(control_of(**braked, period=part * 2.0 * 0.5 / 12.0), 0.5)
        assert growth is not None
        assert (growth > 1.0) == grows


@pytest.mark.slow
def test_a_killed_mission_goes_on_bitwise(tmp_path: Path) -> None:
    """From a checkpoint whose states are not sampled yet, with the times that contact remembers of them."""
    mission = CASES / "missions" / "drift_controlled.toml"
    case = exunet.load(mission, ["time.end=0.3", "time.output_step=0.05"])
    cut_short(tmp_path, case, 0.25, every=0.1)
    resumed, whole = runs.resume(tmp_path), exunet.run(case)
    np.testing.assert_array_equal(resumed.position[:], whole.position)
    for state, values in whole.states.items():
        np.testing.assert_array_equal(resumed.states[state].values[:], values.values)


# From Python


def test_a_function_is_called_at_each_sample_and_its_forces_are_limited() -> None:
    """The law of the case written in Python gives bitwise identical motion; a constant law is limited."""
    seen: list[tuple[float, tuple[int, ...]]] = []

    def law(time: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        seen.append((time, position.shape))
        return 200.0 * (np.array(POINT["point"]) - position) + 12.0 * (np.zeros(3) - velocity)

    by_case = Simulation(case_of(COMPILED, **POINT, noise=NOISE))
    by_python = Simulation(case_of(COMPILED, kind="given", noise=NOISE), controller=law)
    for item in (by_case, by_python):
        item.advance_to(0.1)
    assert seen == [(pytest.approx(0.02 * k, abs=1e-15), (1, 3)) for k in range(6)]
    assert np.array_equal(by_case.state.position, by_python.state.position)
    hard = Simulation(
        case_of(COMPILED, kind="given", largest_thrust=2.0), controller=lambda t, x, v: [[0, 30, 40]]
    )
    hard.advance_to(0.03)
    np.testing.assert_allclose(thrust_of(hard), [[0.0, 1.2, 1.6]], rtol=1e-15)
    result = exunet.run(case_of(COMPILED, kind="given"))  # without a function nothing fires
    assert not np.asarray(result.states[SPENT].values).any()
    assert any("requires a Python function" in note for note in result.run.plan.notes)


# The missions


@pytest.mark.slow
def test_controlled_corners_catch_what_drifts_past_a_net_without() -> None:
    """Box at 1.2 m/s sideways. Without control the net closes beside it; with it the whole rim of the mouth
    is closed to less than the box's least width, 0.3 m, and holds the box after the thrusters stop.

    At 1.2 s the corners have met within 0.2 m, and the rim between them gapes: the mouth is not closed.
    """
    found = {}
    for name in ("drift", "drift_controlled"):
        result = exunet.run(exunet.load(CASES / "missions" / f"{name}.toml"))
        summary = summarise(result)
        ends = {key: one["value"] for key, one in summary["metrics"].items()}
        found[name] = (
            summary["capture"]["outcome"],
            ends["capture_enclosed"],
            ends["capture_relative_speed_m_s"],
        )
        assert summary["energy"]["balance_error"] < 1e-4
        assert summary["momentum"]["linear_residual_kg_m_s"] < 1e-12
    assert found["drift"][0] == "touched"
    assert found["drift"][1] < 0.1
    assert found["drift_controlled"][0] == "captured"
    assert found["drift_controlled"][1] > 0.9
    assert found["drift_controlled"][2] < 0.3 < found["drift"][2]
    mouth = mouth_diameter(result.net, np.asarray(result.position))
    corners = pdist(result.position[120][list(result.net.mouth)]).max()
    assert corners < 0.2 < 0.5 < mouth[120]
    assert mouth[result.time >= 1.95].max() < 0.3
    spent = np.asarray(result.states["control/spent"].values).sum(axis=1)
    assert spent[-1] == spent[200] > 1.0  # N s, all until 2 s


# What is refused

FORMATION = {"kind": "formation", "bullets": [0, 2], "offsets": [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], **GAINS}
TABLE = {"kind": "table", "bullets": [0], "time": [0.0, 1.0], "force": [[[0.0, 0.0, 1.0]]] * 2}


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        (POINT | {"bullets": [0, 7]}, ".bullets[1]"),
        (POINT | {"bullets": [2, 2]}, ".bullets[1]"),
        (POINT | {"kind": "orbit"}, ".kind"),
        (POINT | {"period": 0.0}, ".period"),
        (POINT | {"period": 1e-7}, ".period"),
        (POINT | {"largest_thrust": -1.0}, ".largest_thrust"),
        (POINT | {"minimum_impulse": 30.0}, ".minimum_impulse"),  # 1 kN for a period are 20 N s
        (POINT | {"start": 0.3}, ".start"),
        (POINT | {"body": "target"}, ".body"),
        (POINT | {"offset": [0.0, 0.0, 1.0]}, ".offset"),
        ({"kind": "point", **GAINS}, ""),
        ({"kind": "point", "point": [0.0, 0.0, 1.0], "damping": 1.0}, ".stiffness"),
        (POINT | {"time": [0.0, 1.0]}, ".time"),
        (POINT | {"direction": "outwards"}, ".direction"),
        (POINT | {"noise": {"position": 0.1, "velocity": 0.1}}, ".noise.seed"),
        (TABLE | {"time": [1.0, 0.5]}, ".time[1]"),
        (TABLE | {"time": [0.0, 0.5, 1.0]}, ".force"),
        (FORMATION | {"offsets": [[1.0, 0.0, 0.0]]}, ".offsets"),
        (FORMATION | {"offsets": [[1.0, 0.0, 0.0], [-0.5, 0.0, 0.0]]}, ".offsets"),
        (POINT | {"kind": "given"}, ".point"),
    ],
)
def test_wrong_keys_are_refused(keys: dict[str, Any], key: str) -> None:
    assert refused(PLANAR, *STILL, f"control={toml(keys_of(**keys))}")[0].startswith(f"control{key}")


@pytest.mark.parametrize(
    ("kind", "function"),
    [
        ("given", lambda t, x, v: x[0]),
        ("given", lambda t, x, v: np.inf * np.ones((1, 3))),
        ("given", lambda t, x, v: "up"),
        ("given", lambda t, x, v: 0j * x),
        ("given", "math"),
        ("given", "no_such_package.laws:steer"),
        ("given", "math:no_such_law"),
        ("given", 3.0),
        ("point", lambda t, x, v: x),
    ],
)
def test_functions_that_cannot_be_used(kind: str, function: Any) -> None:
    case = case_of(COMPILED, **(POINT if kind == "point" else {"kind": kind}))
    with pytest.raises(InputError):
        Simulation(case, controller=function).advance_to(0.03)

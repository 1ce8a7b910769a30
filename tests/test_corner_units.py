"""Corner units: the sampled law against its closed form, limits, noise, books, restarts, script, Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import cut_short
from pydantic import TypeAdapter
from scipy.spatial.distance import pdist

import exunet
from exunet.base.errors import InputError
from exunet.cli.check import control_rows
from exunet.forces import corner_units
from exunet.forces.control_config import AnyControl, Control
from exunet.forces.corner_units import MEMORY, SPENT, WORK, Sensed, fired, growth_of_error, with_noise
from exunet.integrators.compiled.loop import CompiledLoop
from exunet.net.areas import mouth_diameter
from exunet.plots.registry import figure
from exunet.results.corner_units import STANDARD_GRAVITY
from exunet.results.measures import dissipation, energy_balance
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.scene.casefile import Case
from exunet.simulation import run as runs
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation
from exunet.studies.both_codes import refusal

CASES = Path(__file__).parents[1] / "cases"
PLANAR = CASES / "planar_undamped.toml"  # its strings are slack for 0.3 s, so each bullet is free
BACKENDS = ("engine.backend=compiled", "engine.backend=exudyn")
STILL = ("time.end=0.2", "time.output_step=0.02", "launch={radial_speed=0.0,axial_speed=0.0}")
GAINS: dict[str, Any] = {"stiffness": 200.0, "damping": 12.0}
POINT: dict[str, Any] = {"kind": "point", "point": [0.9, 0.8, 0.1], **GAINS}
PUSH: dict[str, Any] = {  # constant forces on bullets 1 and 3
    "bullets": [1, 3], "kind": "table", "time": [0.0, 1.0],
    "force": [[[3.0, 0.0, 4.0], [0.0, 1.0, 0.0]]] * 2,
}  # fmt: skip
NOISE = {"position": 0.02, "velocity": 0.1, "seed": 7}
SPHERE = "bodies.ball={mass=2.0,inertia=[0.3,0.3,0.3],position=[0.5,-0.2,3.0],velocity=[0.4,0.1,-0.3]%s}"


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}={toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def keys_of(**more: Any) -> dict[str, Any]:
    return {"bullets": [1], "period": 0.02, "largest_thrust": 1e3} | more


def case_of(*overrides: str, **more: Any) -> Case:
    return exunet.load(PLANAR, [*STILL, f"control={toml(keys_of(**more))}", *overrides])


def control_of(**more: Any) -> Control:
    control: Control = TypeAdapter(AnyControl).validate_python(keys_of(**more))
    return control


def thrust_in(simulation: Simulation) -> np.ndarray:
    """(n, 3) the forces that act now."""
    return simulation.state.memory[MEMORY][4:].reshape(-1, 3)


def free_motion(case: Case, goal: np.ndarray, drift: np.ndarray, n: int) -> list[np.ndarray]:
    """(2, 3) offset from the goal and its rate at n + 1 samples, by powers of the matrix of one period.

    Under the force -k x - c v of its beginning, of a unit whose mass the net tells.
    """
    start = prepare_case(case)
    node = start.net.bullet_nodes[1]
    mass, h = start.net.mass[node], 0.02
    push = np.outer([0.5 * h * h, h], [GAINS["stiffness"], GAINS["damping"]]) / mass
    one = np.array([[1.0, h], [0.0, 1.0]]) - push
    at_start = np.array([start.position[node] - goal, start.velocity[node] - drift])
    return [np.linalg.matrix_power(one, k) @ at_start for k in range(n + 1)]


@pytest.mark.ci_for("engine.backend=compiled")
@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_free_unit_follows_the_sampled_system(form: str) -> None:
    """To a point at rest; 1e-13 is round-off of ten periods; what it puts in is in the energy balance."""
    case = case_of(form, **POINT)
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
@pytest.mark.parametrize("motion", ["", ',motion="prescribed"'])
@pytest.mark.parametrize("form", BACKENDS)
def test_a_unit_goes_to_a_body_that_moves(form: str, motion: str) -> None:
    """Relative to the body the same system; that of a body of given motion is of the sample's time too."""
    offset, drift = [0.1, 0.2, -2.5], np.array([0.4, 0.1, -0.3])
    to_body = {"kind": "point", "body": "ball", "offset": offset, **GAINS}
    case = case_of(form, SPHERE % motion, "solver.method=RK44", "solver.step=2e-4", **to_body)
    result = exunet.run(case)
    node, ball = result.net.bullet_nodes[1], result.bodies["ball"].position
    goal = np.array([0.5, -0.2, 3.0]) + offset
    for k, known in enumerate(free_motion(case, goal, drift, 10)):
        assert np.abs(result.position[k, node] - ball[k] - offset - known[0]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("method", ["RK44", "VelocityVerlet"])
@pytest.mark.parametrize("form", BACKENDS)
def test_a_unit_sees_a_body_that_accelerates(form: str, method: str) -> None:
    """The velocity gained in a period is that of the force at the stored state of its beginning."""
    motion = (
        'motion="prescribed",pose_times=[0.0,0.1,0.2],pose_positions=[[0.4,0,0.0],[0.45,0,0.0],[0.7,0,0.1]]'
    )
    body = f"bodies.ball={{mass=2.0,inertia=[0.3,0.3,0.3],{motion}}}"
    to_body = {"kind": "point", "body": "ball", **GAINS}
    result = exunet.run(case_of(form, body, f"solver.method={method}", "solver.step=1e-4", **to_body))
    node, ball = result.net.bullet_nodes[1], result.bodies["ball"]
    away, parting = ball.position - result.position[:, node], ball.velocity - result.velocity[:, node]
    force = GAINS["stiffness"] * away + GAINS["damping"] * parting
    gained = np.diff(result.velocity[:, node], axis=0)
    # Round-off of 200 steps.
    np.testing.assert_allclose(gained, 0.02 * force[:-1] / result.net.mass[node], rtol=0, atol=1e-12)


@pytest.mark.ci_for("engine.backend=exudyn")
@pytest.mark.slow
@pytest.mark.parametrize("form", BACKENDS)
def test_a_unit_on_a_body(form: str) -> None:
    """A bullet fixed to a body that turns: the momentum gained in a period is that of the force at the
    stored state of its beginning, with the velocity that the body gives the bullet then.
    """
    body = (
        "bodies.ball={mass=2.0,inertia=[0.3,0.4,0.5],position=[0.35,-0.35,0.2],angular_velocity=[3,2.0,0],"
        "attachments.one={bullet=1,point=[0.0,0.0,-0.2]}}"
    )
    result = exunet.run(case_of(form, body, "solver.method=VelocityVerlet", "solver.step=1e-4", **POINT))
    node = result.net.bullet_nodes[1]
    force = GAINS["stiffness"] * (np.array(POINT["point"]) - result.position[:, node])
    force -= GAINS["damping"] * result.velocity[:, node]
    np.testing.assert_allclose(np.diff(result.momentum, axis=0), 0.02 * force[:-1], rtol=0, atol=1e-12)


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_table_gives_its_impulse(form: str) -> None:
    """Each sample's force for a period: force over time is a ramp, its samples a staircase."""
    ramp = {"kind": "table", "time": [0.03, 0.11], "force": [[[0.0, 0.0, 1.0]], [[0.0, 4.0, 1.0]]]}
    result = exunet.run(case_of(form, **ramp))
    at = np.arange(0.04, 0.111, 0.02)  # the samples in the table
    force = np.stack([0 * at, 4.0 * (at - 0.03) / 0.08, np.ones_like(at)], axis=1)
    gained = result.momentum[-1] - result.momentum[0]
    np.testing.assert_allclose(gained, 0.02 * force.sum(axis=0), rtol=0, atol=1e-13)
    spent = 0.02 * np.linalg.norm(force, axis=1).sum()
    np.testing.assert_allclose(result.states[SPENT].values[-1], [spent], rtol=1e-12)


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


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_formation_about_its_mean_moves_no_centre(form: str) -> None:
    """Errors sum to zero, so do the forces; by symmetry the mean rests at 0, and each unit goes to its place
    as one that goes to a point.
    """
    offsets = [[-0.5, -0.5, 0.3], [0.5, -0.5, -0.3], [0.5, 0.5, 0.3], [-0.5, 0.5, -0.3]]
    formation = {"kind": "formation", "bullets": [0, 1, 2, 3], "offsets": offsets, **GAINS}
    case = case_of(form, **formation)
    result = exunet.run(case)
    assert np.abs(result.momentum - result.momentum[0]).max() < 1e-13  # round-off of 0.9 kg m/s on each
    for k, known in enumerate(free_motion(case, np.array(offsets[1]), np.zeros(3), 10)):
        assert np.abs(result.position[k, result.net.bullet_nodes[1]] - offsets[1] - known[0]).max() < 1e-13


def noisy(*overrides: str, seed: int = 7) -> exunet.Result:
    return exunet.run(case_of(*overrides, **POINT, noise=NOISE | {"seed": seed}))


def test_noise_has_the_bits_of_its_seed() -> None:
    """In a second run too, in which all is drawn anew; another seed has others."""
    once = noisy(BACKENDS[0])
    corner_units._errors.cache_clear()
    again, other = noisy(BACKENDS[0]), noisy(BACKENDS[0], seed=8)
    assert np.array_equal(once.position, again.position)
    assert np.abs(once.position - other.position).max() > 1e-3


def test_noise_is_the_same_in_both_loops() -> None:
    """One unit without noise would be elsewhere by millimetres; 1e-12 is round-off."""
    compiled, exudyn = noisy(BACKENDS[0]), noisy(BACKENDS[1])
    np.testing.assert_allclose(compiled.position[:, 20:], exudyn.position[:, 20:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(compiled.states[SPENT].values, exudyn.states[SPENT].values, rtol=1e-11)
    quiet = exunet.run(case_of(BACKENDS[0], **POINT))
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


@pytest.mark.parametrize("sample", [0, 63, 64, 1000])
def test_noise_of_a_sample_is_drawn_from_its_number(sample: int) -> None:
    """Whatever was drawn before: of a generator that begins with the seed and the number of the sample."""
    control = control_of(**POINT, bullets=[3, 1], noise=NOISE)
    assert control.noise is not None
    seen = with_noise(control.noise, control.bullets, sample, [0.0] * 6, [0.0] * 6)
    bits = np.random.Philox(key=control.noise.seed, counter=[0, 0, 0, sample])
    drawn = np.random.Generator(bits).standard_normal((4, 6))[[3, 1]]
    assert np.array_equal(np.reshape(seen[0], (2, 3)), control.noise.position * drawn[:, :3])
    assert np.array_equal(np.reshape(seen[1], (2, 3)), control.noise.velocity * drawn[:, 3:])


def test_a_sample_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the compiled loop nothing else can be due after it: 10 samples, and 10 stored times, at 0.02 s."""
    looks, real = [], CompiledLoop._look_for_events

    def look(loop: CompiledLoop) -> Any:
        looks.append(loop.time)
        return real(loop)

    monkeypatch.setattr(CompiledLoop, "_look_for_events", look)
    exunet.run(case_of(BACKENDS[0], **POINT))
    assert len(looks) == len(set(looks)) == 11


def test_a_controller_does_not_see_what_comes() -> None:
    """A push between two samples changes nothing of the force until the second, and the force then."""
    first, other = (Simulation(case_of(BACKENDS[0], **POINT)) for _ in range(2))
    for item in (first, other):
        item.advance_to(0.05)  # samples at 0, 0.02, 0.04
    held = thrust_in(first).copy()
    other.set_force(int(other.net.bullets[1]), [0.0, 5.0, 0.0])
    for entry in (first, other):
        entry.advance_to(0.0599)
    assert np.array_equal(thrust_in(first), held)
    assert np.array_equal(thrust_in(other), held)
    assert np.abs(first.net.velocity - other.net.velocity).max() > 0.05
    for element in (first, other):
        element.advance_to(0.06)
    assert np.abs(thrust_in(first) - thrust_in(other)).max() > 1.0


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_restart_between_two_samples_goes_on_bitwise(form: str, tmp_path: Path) -> None:
    """With noise, which depends on the number of the sample: restored here, and from a file in another."""
    case = case_of(form, **POINT, noise=NOISE)
    once = Simulation(case)
    once.advance_to(0.07)
    here = once.snapshot()
    here.save(tmp_path / "here.exu")
    once.advance_to(0.15)
    known = once.state.arrays()
    once.restore(here)
    other = Simulation(case)
    other.restore(exunet.Snapshot.load(tmp_path / "here.exu"))
    for item in (once, other):
        item.advance_to(0.15)
        for name, values in known.items():
            np.testing.assert_array_equal(item.state.arrays()[name], values)


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_retry_has_the_samples_of_the_state_that_it_goes_back_to(form: str) -> None:
    """Between two samples, and at one, which is done then; nothing tells the guards of it meanwhile."""
    simulation = Simulation(case_of(form, **POINT, noise=NOISE))
    for time, samples in ((0.05, 3.0), (0.06, 4.0)):
        simulation.advance_to(time)
        memory = simulation.state.memory[MEMORY]
        safe = simulation.monitor.safe
        assert safe.time == time
        assert memory[2] == samples
        np.testing.assert_array_equal(safe.memory[MEMORY], memory)


def script(*entries: str) -> str:
    return f"script=[{','.join(entries)}]"


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_a_script_begins_and_ends_the_control(form: str) -> None:
    """The first sample is at the instant of the entry; from the release on nothing fires; begun again."""
    entries = script(
        '{name="on",at=0.03,do="control"}',
        '{name="off",at=0.075,do="release_control"}',
        '{name="again",at=0.11,do="control"}',
    )
    result = exunet.run(case_of(form, entries, "time.output_step=0.005", **PUSH))
    burnt = np.clip(result.time - 0.03, 0.0, 0.045) + np.clip(result.time - 0.11, 0.0, None)
    known = burnt[:, None] * [5.0, 1.0]
    np.testing.assert_allclose(result.states[SPENT].values, known, rtol=0, atol=1e-13)


def test_samples_begin_at_start() -> None:
    result = exunet.run(case_of(BACKENDS[0], **PUSH, start=0.05))
    known = np.clip(result.time - 0.05, 0.0, None)[:, None] * [5.0, 1.0]
    np.testing.assert_allclose(result.states[SPENT].values, known, rtol=0, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("form", BACKENDS)
def test_books_of_a_scene_with_a_body(form: str) -> None:
    """The momentum that all gains is the impulse of the units, kept as a state."""
    case = case_of(form, SPHERE % "", "solver.method=RK44", "solver.step=2e-4", **PUSH)
    result = exunet.run(case)
    given = np.asarray(result.states["effect.control/impulse"].values[-1])
    np.testing.assert_allclose(given, 0.2 * np.array([3.0, 1.0, 4.0]), rtol=1e-12)
    assert energy_balance(result) < 1e-9
    books = summarise(result)["momentum"]
    assert books["linear_gained_kg_m_s"] > 0.9  # of sqrt(26) x 0.2 N s
    assert books["linear_residual_kg_m_s"] < 1e-12
    assert books["angular_residual_kg_m2_s"] < 1e-9  # RK44 keeps it to its order


@pytest.mark.slow
def test_summary_table_and_figure() -> None:
    """Impulse and propellant of each unit, by hand: 5 N and 1 N for 0.2 s."""
    result = exunet.run(case_of(BACKENDS[0], **PUSH, specific_impulse=100.0))
    summary = summarise(result)
    told = summary["control"]
    assert [item["bullet"] for item in told["units"]] == [1, 3]
    assert [entry["impulse_N_s"] for entry in told["units"]] == pytest.approx([1.0, 0.2], rel=1e-12)
    assert told["propellant_kg"] == pytest.approx(1.2 / (STANDARD_GRAVITY * 100.0), rel=1e-12)
    assert summary["headlines"]["impulse_of_units_N_s"]["this_run"] == pytest.approx(1.2, rel=1e-12)
    table = dict(rows(summary))
    told_of_units = "by table; units: 2, which spent 1, 0.2 N s in this run; propellant 0.00122 kg"
    assert table["control"].startswith(told_of_units)
    assert told["work_J"] == summary["headlines"]["work_of_units_J"]["this_run"]
    (axes,) = figure(result, "control").axes
    assert [line.get_label() for line in axes.lines[:2]] == ["bullet 1", "bullet 3"]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 5.0, rtol=1e-12)
    bare = exunet.run(exunet.load(PLANAR, [*STILL, BACKENDS[0]]))
    assert summarise(bare)["control"] is None
    with pytest.raises(exunet.InputError, match="'control' requires"):
        figure(bare, "control")


def test_check_tells_the_control_and_whether_it_is_stable() -> None:
    """A free mass of 0.512 kg under a gain of 12 N s/m alone is unstable from 2 m / c = 0.085 s on."""
    told = dict(control_rows(prepare_case(case_of(**POINT, minimum_impulse=0.1, noise=NOISE))))
    assert told["control"] == "point, to (0.9, 0.8, 0.1) m; 200 N/m, 12 N s/m; units: bullets 1"
    assert told["control: samples"] == "every 0.02 s, from 0 s on; noise of 0.02 m, 0.1 m/s, seed 7"
    assert "below 0.1 N s in a period (5 N) nothing is fired" in told["control: limits"]
    rare = dict(control_rows(prepare_case(case_of(**POINT | {"period": 10.0}))))["control: samples"]
    assert rare.startswith("every 10 s, from 0 s on: one at most, since the run ends at ")
    assert told["control: an error"].endswith("stable")
    mass = float(prepare_case(case_of(**POINT)).net.mass[-1])
    braked = {"kind": "point", "point": [0.0, 0.0, 0.0], "stiffness": 0.0, "damping": 12.0}
    for period, grows in ((2.0 * mass / 12.0 * 0.999, False), (2.0 * mass / 12.0 * 1.001, True)):
        growth = growth_of_error(control_of(**braked, period=period), mass)
        assert growth is not None
        assert (growth > 1.0) == grows
    unstable = dict(control_rows(prepare_case(case_of(**braked, period=0.1))))
    assert unstable["control: an error"].endswith("unstable: choose a shorter period, or weaker gains")


def test_the_reference_refuses_the_case() -> None:
    case = case_of(**POINT)
    assert "reference_impl does not know control" in refusal(case, case.scene)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drift", "drift_controlled"])
def test_a_killed_mission_goes_on_bitwise(name: str, tmp_path: Path) -> None:
    """From a checkpoint whose states wait to be looked at, with what contact remembers of their times."""
    case = exunet.load(CASES / "missions" / f"{name}.toml", ["time.end=0.3", "time.output_step=0.05"])
    cut_short(tmp_path, case, 0.25, every=0.1)
    resumed, whole = runs.resume(tmp_path), exunet.run(case)
    np.testing.assert_array_equal(resumed.position[:], whole.position)
    for state, values in whole.states.items():
        np.testing.assert_array_equal(resumed.states[state].values[:], values.values)


# From Python


def test_a_function_is_called_at_each_sample_and_its_forces_are_limited() -> None:
    """The law of the case written in Python: the same bits; and a constant one, cut to the limit."""
    seen: list[tuple[float, tuple[int, ...]]] = []

    def law(time: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        seen.append((time, position.shape))
        return 200.0 * (np.array(POINT["point"]) - position) + 12.0 * (np.zeros(3) - velocity)

    by_case = Simulation(case_of(BACKENDS[0], **POINT, noise=NOISE))
    by_python = Simulation(case_of(BACKENDS[0], kind="given", noise=NOISE), controller=law)
    for item in (by_case, by_python):
        item.advance_to(0.1)
    assert seen == [(pytest.approx(0.02 * k, abs=1e-15), (1, 3)) for k in range(6)]
    assert np.array_equal(by_case.state.position, by_python.state.position)
    hard = Simulation(
        case_of(BACKENDS[0], kind="given", largest_thrust=2.0), controller=lambda t, x, v: [[0, 30, 40]]
    )
    hard.advance_to(0.03)
    np.testing.assert_allclose(thrust_in(hard), [[0.0, 1.2, 1.6]], rtol=1e-15)
    result = exunet.run(case_of(BACKENDS[0], kind="given"))  # without a function nothing fires
    assert not np.asarray(result.states[SPENT].values).any()
    assert any("requires a Python function" in note for note in result.provenance["notes"])


def steer(time: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """What the test below names."""
    return -0.5 * (position + time * velocity)


@pytest.mark.parametrize("path", [f"{__name__}:steer", f"{__name__}.steer"])
def test_a_function_by_its_dotted_path(path: str) -> None:
    """To the same bits as the function."""
    case = case_of(BACKENDS[0], kind="given", noise=NOISE)
    ours, theirs = (Simulation(case, controller=entry) for entry in (path, steer))
    for item in (ours, theirs):
        item.advance_to(0.05)
    assert np.abs(thrust_in(ours)).max() > 0.0
    assert np.array_equal(ours.state.position, theirs.state.position)


@pytest.mark.parametrize(
    ("kind", "function", "words"),
    [
        ("given", lambda t, x, v: x[0], "must return 1 x 3 finite real numbers"),
        ("given", lambda t, x, v: np.inf * np.ones((1, 3)), "must return 1 x 3 finite real numbers"),
        ("given", lambda t, x, v: "up", "must return 1 x 3 finite real numbers"),
        ("given", lambda t, x, v: 0j * x, "must return 1 x 3 finite real numbers"),
        ("given", lambda t, x, v: [[1.0, 2.0, 3j]], "must return 1 x 3 finite real numbers"),
        ("given", "math", 'must be "package.module:function"'),
        ("given", "no_such_package.laws:steer", "'no_such_package.laws' of .* cannot be imported: No module"),
        ("given", "math:no_such_law", "'math' does not have a function 'no_such_law'"),
        ("given", "math.pi", "'math' does not have a function 'pi'"),
        ("given", 3.0, "must be a function of time, positions, velocities, got 3.0"),
        ("point", lambda t, x, v: x, 'the case has control.kind = "point"'),
    ],
)
def test_functions_that_cannot_be_used(kind: str, function: Any, words: str) -> None:
    case = case_of(BACKENDS[0], **(POINT if kind == "point" else {"kind": kind}))
    with pytest.raises(InputError, match=words):
        Simulation(case, controller=function).advance_to(0.03)


def test_a_function_without_units() -> None:
    with pytest.raises(InputError, match=r"the case has no \[control\]"):
        Simulation(PLANAR, controller=lambda t, x, v: x)


# The missions


@pytest.mark.slow
def test_controlled_corners_catch_what_drifts_past_a_net_without() -> None:
    """Box at 1.2 m/s sideways. Without control the net closes beside it; with it the whole rim of the mouth
    is closed to less than the box's least width, 0.3 m, and holds the box once the thrusters fire no more.

    At 1.2 s the corners have met within 0.2 m, and the rim between them gapes: the mouth is not closed.
    """
    found = {}
    for name in ("drift", "drift_controlled"):
        result = exunet.run(exunet.load(CASES / "missions" / f"{name}.toml"))
        summary = summarise(result)
        ends = {key: one["this_run"] for key, one in summary["headlines"].items()}
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

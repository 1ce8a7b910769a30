"""What effects from outside give: impulse and angular impulse are lines, and with them the books close."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BODY, case_file, start_of

import exunet
from exunet.forces.blocks import Blocks
from exunet.forces.terms import KernelTerm
from exunet.results.measures import momentum_books
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case, with_wrenches
from exunet.simulation.recorder import Recorder
from exunet.simulation.run import simulate
from exunet.simulation.simulation import Simulation

CASE = Path(exunet.__file__).parent / "cases" / "bodies" / "launch.toml"
TURNING = "bodies.chaser.angular_velocity=[2.0, 4.0, 3.0]"
STEP = 4e-3  # with threads so soft that errors are far above round-off
SOFT = [f"{cable}.youngs_modulus=1e6" for cable in ("net.cable", "net.strings", "tethers.line")]
G = [0.3, 0.0, -2.0]
GRAVITY = f"effects.gravity.acceleration={G}"
RAYLEIGH = "effects.rayleigh_damping={alpha=0.1, beta=1e-5}"
DRAG = "effects.air_drag={density=1.2, drag_coefficient=1.0, bullet_drag_coefficient=0.5, bullet_area=0.01}"
AXES = "radial=[0.0, 0.0, 1.0], along_track=[1.0, 0.0, 0.0]"
BACKENDS = ("engine.backend=compiled", "engine.backend=exudyn")


def run(*overrides: str, step: float = STEP, end: float = 0.4) -> exunet.Result:
    times = (f"time.end={end}", "time.output_step=0.1", f"solver={{method='RK44', step={step}}}")
    return exunet.run(exunet.load(CASE, [*times, *SOFT, *overrides]))


def closes_by_order_4(*overrides: str) -> exunet.Result:
    """Linear momentum to round-off at any step; angular momentum by an error that halving divides by 16.

    Measured at steps of 4, 2 and 1 ms: 16 each time, with each effect and without any.
    """
    found = run(*overrides, step=0.5 * STEP)
    coarse, fine = momentum_books(run(*overrides)), momentum_books(found)
    for book in (coarse, fine):
        assert book["linear"].residual < 1e-12 * book["linear"].size  # measured 3e-15
    assert fine["angular"].residual == pytest.approx(coarse["angular"].residual / 16.0, rel=0.1)
    assert fine["angular"].residual < 1e-7 * fine["angular"].gained
    return found


@pytest.mark.ci
@pytest.mark.slow
def test_gravity_drag_and_rayleigh_damping_together() -> None:
    """By hand: gravity gives M g t to all; beta T gives no impulse, as its forces cancel, but a moment."""
    found = closes_by_order_4(TURNING, GRAVITY, RAYLEIGH, DRAG)
    given = {name: np.asarray(one.values)[-1] for name, one in found.states.items()}
    mass = summarise(found)["mass_of_all_kg"]
    np.testing.assert_allclose(
        given["effect.gravity/impulse"], np.array(G) * mass * 0.4, rtol=1e-11, atol=1e-15
    )
    assert given["effect.air_drag/impulse"] @ [0.0, -np.sin(0.3), np.cos(0.3)] < 0.0  # against the throw
    table, headlines = dict(rows(summarise(found))), summarise(found)["headlines"]
    for effect in ("gravity", "rayleigh_damping", "air_drag"):
        assert f"impulse of {effect}" in table
        assert f"angular impulse of {effect}" in table
        value = headlines[f"effect_{effect}_angular_impulse_z_N_m_s"]["this_run"]
        assert value == pytest.approx(given[f"effect.{effect}/angular_impulse"][2], rel=1e-12)
    assert "beside the impulse of air_drag and gravity and rayleigh_damping" in table["momentum of all"]


def test_what_is_inside_has_no_line() -> None:
    """Material damping is in the case; no effect from outside is."""
    found = run(end=0.1)
    assert not found.states
    books = summarise(found)["momentum"]
    assert books["angular_residual_kg_m2_s"] == books["angular_gained_kg_m2_s"]


def test_a_scene_without_bodies_has_no_line() -> None:
    case = exunet.load(CASE.parent.parent / "planar_deployment.toml", [GRAVITY])
    assert not prepare_case(case).system.blocks.states


def test_implicit_methods_have_no_first_order_states() -> None:
    """A body that nothing acts on, which they can run: they have no line, and are not refused for it."""
    snap = CASE.parents[1] / "verification" / "snap.toml"
    body = "bodies.one={mass=1.0, inertia=[1.0, 1.0, 1.0], position=[0.0, 9.0, 0.0]}"
    damped = "effects.rayleigh_damping={alpha=0.0, beta=1e-6}"
    short = ("time.end=0.01", "time.output_step=0.01", "time.output_times=")
    implicit = "solver={method='GeneralizedAlpha', step=1e-3}"
    found = exunet.run(exunet.load(snap, [body, damped, implicit, *short]))
    assert not found.states


@pytest.mark.slow
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize(
    "effect",
    [
        GRAVITY,
        RAYLEIGH,
        DRAG,
        "effects.mass_damping.alpha=0.5",
        f"effects.orbit={{mean_motion=0.05, {AXES}, model='linear'}}",
        f"effects.orbit={{altitude=700e3, {AXES}, model='two_body'}}",
    ],
)
def test_each_effect_by_itself(form: str, effect: str) -> None:
    closes_by_order_4(TURNING, form, effect)


@pytest.mark.slow
def test_forces_on_nodes_of_a_guided_body_count() -> None:
    """The chaser is fixed, and holds the end of the line, which beta T pulls too: its impulse has that."""
    found = run("bodies.chaser.motion=fixed", "bodies.chaser.angular_velocity=", RAYLEIGH, step=STEP)
    books = momentum_books(found)
    assert books["linear"].residual < 1e-13 * books["linear"].size
    assert books["angular"].residual < 1e-6 * books["angular"].gained


BESIDE = ("solver.method=RK44", "solver.step=2e-4", "effects.gravity.acceleration=[0.0, 0.0, -9.81]")


def left(result: exunet.Result) -> tuple[float, float, float]:
    """Of the linear momentum: how much of its size is gained, and left; how much of the angular is left."""
    books = momentum_books(result)
    linear, angular = books["linear"], books["angular"]
    return linear.gained / linear.size, linear.residual / linear.size, angular.residual / angular.size


@pytest.mark.parametrize("form", BACKENDS)
def test_what_holds_fixed_nodes_is_a_line(tmp_path: Path, form: str) -> None:
    """A cable swings at a fixed node beside a body that falls, with damping: nothing is left but round-off of
    sums, and for angular momentum what RK44 leaves at 2e-4 s. Along x nothing else acts on the other node, of
    0.5 kg, but damping by the mass, which takes 4 % of its momentum in 0.15 s at 0.5 m/s.
    """
    given = (BODY, *BESIDE, form, "net.fixed=[0]", "effects.rayleigh_damping={alpha=0.5, beta=1e-4}")
    result = simulate(prepare_case(exunet.load(case_file(tmp_path), given)))
    gained, linear, angular = left(result)
    assert gained > 0.1
    assert linear < 1e-13
    assert angular < 1e-8
    speed = np.asarray(result.velocity)[:, 1, 0]
    impulse = np.asarray(result.states["effect.fixed_nodes/impulse"].values[-1])
    assert impulse[0] == pytest.approx(0.5 * (speed[-1] - speed[0]), rel=0.08)


def test_there_is_no_line_without_fixed_nodes_or_bodies(tmp_path: Path) -> None:
    """Nor for forces of a script that adds none, or by a method without first-order states."""
    path = case_file(tmp_path)

    def names(*given: str) -> list[str]:
        start = prepare_case(exunet.load(path, given))
        return [state.name for state in start.system.blocks.states]

    assert names(BODY) == []
    assert names("net.fixed=[0]") == []
    assert len(names(BODY, "net.fixed=[0]")) == 2
    assert names(BODY, "net.fixed=[0]", "solver.method=GeneralizedAlpha", "solver.step=1e-3") == []


class Pull(NamedTuple):
    """Where the entries of a node, a body's centre and its angular velocity begin; N, N m."""

    node: int
    centre: int
    spin: int
    size: float


def add_pull(t: float, x: Any, v: Any, pull: Any, force: Any) -> None:
    """A force on a node that grows with time, another on a body, and a torque about its own axis."""
    force[pull.node + 1] += pull.size * (1.0 + t)
    force[pull.centre] += 2.0 * pull.size
    force[pull.spin + 2] += 0.1 * pull.size


@pytest.mark.parametrize("form", BACKENDS)
def test_forces_of_a_script_are_a_line(tmp_path: Path, form: str) -> None:
    def pulls(blocks: Blocks) -> tuple[KernelTerm, ...]:
        data = Pull(3, blocks.centre("target"), blocks.spin("target"), 4.0)
        return (KernelTerm("node and body", add_pull, data, bodies=("target",)),)

    gained, linear, angular = left(simulate(start_of(case_file(tmp_path), (BODY, *BESIDE, form), pulls)))
    assert gained > 0.1
    assert linear < 1e-13
    assert angular < 1e-8


def test_wrenches_are_a_line(tmp_path: Path) -> None:
    """Of a simulation that stores, with another wrench in each interval; 3 N for 0.05 s, then 1 N."""
    start = prepare_case(exunet.load(case_file(tmp_path), (BODY, *BESIDE[:2], BACKENDS[0])))
    start = with_wrenches(start, ["target"])
    recorder = Recorder(start, {})
    sim = Simulation(start, recorder=recorder)
    for until, force in ((0.05, 3.0), (0.1, 1.0), (0.15, 0.0)):
        sim.set_input("wrench/target", [force, 0.0, 0.0, 0.0, 0.2, 0.0])
        sim.advance_to(until)
    sim.settle()
    result = recorder.result("ok", sim.monitor)
    gained, linear, angular = left(result)
    assert gained > 0.05
    assert linear < 1e-13
    assert angular < 1e-8
    impulse = np.asarray(result.states["effect.script/impulse"].values[-1])
    np.testing.assert_allclose(impulse, [0.05 * 3.0 + 0.05 * 1.0, 0.0, 0.0], atol=1e-14)

"""What effects from outside give: impulse and angular impulse are lines, and with them the books close."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.results.measures import momentum_books
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case

CASE = Path(exunet.__file__).parent / "cases" / "bodies" / "launch.toml"
TURNING = "bodies.chaser.angular_velocity=[2.0, 4.0, 3.0]"
STEP = 4e-3  # with threads so soft that errors are far above round-off
SOFT = [f"{cable}.youngs_modulus=1e6" for cable in ("net.cable", "net.strings", "tethers.line")]
G = [0.3, 0.0, -2.0]
GRAVITY = f"effects.gravity.acceleration={G}"
RAYLEIGH = "effects.rayleigh_damping={alpha=0.1, beta=1e-5}"
DRAG = "effects.air_drag={density=1.2, drag_coefficient=1.0, bullet_drag_coefficient=0.5, bullet_area=0.01}"
AXES = "radial=[0.0, 0.0, 1.0], along_track=[1.0, 0.0, 0.0]"
FORMS = ("engine.loop=compiled", "engine.net=fused", "engine.net=connectors")


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
@pytest.mark.ci
@pytest.mark.parametrize("form", FORMS)
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
@pytest.mark.ci
def test_forces_on_nodes_of_a_guided_body_count() -> None:
    """The chaser is fixed, and holds the end of the line, which beta T pulls too: its impulse has that."""
    found = run("bodies.chaser.motion=fixed", "bodies.chaser.angular_velocity=", RAYLEIGH, step=STEP)
    books = momentum_books(found)
    assert books["linear"].residual < 1e-13 * books["linear"].size
    assert books["angular"].residual < 1e-6 * books["angular"].gained

"""The keys of effects.thrust and what they demand of the net."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from exunet.base.errors import CaseError
from exunet.forces.effects import thrust
from exunet.scene.casefile import load, parse_case
from exunet.simulation.run import run

PLANAR = Path(__file__).parents[1] / "cases" / "planar_deployment.toml"  # four bullets
GOOD: dict[str, Any] = {"bullets": [0, 3], "time": [0.0, 0.5], "force": [[0, 0, 1], [0, 0, 2]]}


@pytest.mark.parametrize(
    ("changes", "keys"),
    [
        ({}, []),
        ({"bullets": [0, 4, 7]}, ["bullets[1]", "bullets[2]"]),
        ({"bullets": [1, 2, 1]}, ["bullets[2]"]),
        ({"time": [0.5, 0.5]}, ["time[1]"]),
        ({"time": [0.5, 0.2]}, ["time[1]"]),
        ({"time": [0.0, 0.5, 1.0]}, ["force"]),
        (
            {"bullets": [1, 1], "time": [0.5, 0.1], "force": [[0, 0, 1]] * 3},
            ["bullets[1]", "time[1]", "force"],
        ),
    ],
)
def test_faults_between_keys(changes: dict[str, Any], keys: list[str]) -> None:
    text = PLANAR.read_text(encoding="utf-8") + "[effects.thrust]\n"
    text += "".join(f"{key} = {value}\n" for key, value in (GOOD | changes).items())
    found: list[str] = []
    try:
        parse_case(text, PLANAR)
    except CaseError as error:
        found = [fault.key.removeprefix("effects.thrust.") for fault in error.faults]
    assert found == keys


@pytest.mark.parametrize(
    "changes",
    [
        {"bullets": []},
        {"bullets": [-1]},
        {"bullets": [0.5]},
        {"time": [0.0], "force": [[0, 0, 1]]},
        {"time": [-0.1, 0.5]},
        {"force": [[0, 0], [0, 0, 1]]},
    ],
)
def test_faults_of_single_keys(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        thrust.ThrustConfig.model_validate(GOOD | changes)


# Two bullets: 1.5 N for 0.05 s, then on average (0.25, 0, 1) N for 0.15 s.
def test_a_net_without_bullets_is_told_that_the_effect_acts_on_them() -> None:
    table = "effects.thrust={bullets=[0],time=[0.0,0.5],force=[[0,0,1.0],[0,0,1.0]]}"
    with pytest.raises(CaseError, match=r"effects\.thrust.*acts on bullets, and the net has none: add \[net"):
        load(PLANAR.parent / "verification" / "square_net.toml", [table])


PUSH = "effects.thrust={bullets=[0,2],time=[0.1,0.15,0.3],force=[[0,0,1],[0,0,2.0],[0.5,0,0]]}"
IMPULSE = 2.0 * (np.array([0.0, 0.0, 1.5]) * 0.05 + np.array([0.25, 0.0, 1.0]) * 0.15)
BACKENDS = ("engine.backend=compiled", "engine.backend=exudyn")


@pytest.mark.slow_for("engine.backend=compiled", "RK44", "VelocityVerlet")
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
def test_thrust_gives_its_impulse_and_its_work_is_booked(form: str, method: str) -> None:
    """Steps end at the knots, so the impulse of a force linear in time is exact for every method."""
    case = load(
        PLANAR.with_name("planar_undamped.toml"), [PUSH, "time.end=0.4", form, f"solver.method={method}"]
    )
    result = run(case)
    # 1e4 added steps of round-off
    np.testing.assert_allclose(result.momentum[-1] - result.momentum[0], IMPULSE, rtol=0, atol=1e-13)
    total = result.kinetic + result.elastic + result.dissipated
    assert result.dissipated[-1] < 0.0  # put in
    # As without thrust on this undamped net: 1e-3 J for Verlet, 4e-4 J for RK44.
    assert np.abs(total - total[0]).max() < {"DOPRI5": 1e-6, "RK44": 1e-3, "VelocityVerlet": 3e-3}[method]


@pytest.mark.slow
def test_a_thrust_that_is_over_leaves_the_bare_motion() -> None:
    """On a bullet alone: velocity F T / m, place F T^2 / 2 m after a constant force over T."""
    # The strings are slack until 0.3 s, so the bullet is free.
    push = "effects.thrust={bullets=[1],time=[0.02,0.06],force=[[0,0,3.0],[0,0,3.0]]}"
    case = load(
        PLANAR.with_name("planar_undamped.toml"),
        [push, "time.end=0.08", "time.output_step=0.01", BACKENDS[0]],
    )
    result = run(case)
    bullet = result.net.bullet_nodes[1]
    mass = result.net.mass[bullet]
    late = np.clip(result.time - 0.02, 0.0, 0.04)
    np.testing.assert_allclose(result.velocity[:, bullet, 2], 3.0 * late / mass, rtol=1e-12, atol=1e-15)
    coast = np.clip(result.time - 0.06, 0.0, None)
    way = 3.0 / mass * (0.5 * late**2 + 0.04 * coast)
    np.testing.assert_allclose(result.position[:, bullet, 2], way, rtol=1e-12, atol=1e-15)

"""Equal steps in which a body turns far: refused before a run, stopped and retried in it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.base.errors import CaseError, RunStopped
from exunet.methods.method import Backend, Method, Plan, turning_polynomial
from exunet.model.stability import SAFETY, RotationError, rotation_step_limit
from exunet.simulation.guards import ENERGY_BOUND
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

# A light body that turns about its middle axis, with a slack tether, beside a net of far more energy.
CASE = """
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
STEP = 3.5e-3  # 2.5 rad of the body


def start(folder: Path, *overrides: str) -> Start:
    path = folder / "turning.toml"
    path.write_text(CASE)
    return prepare_case(exunet.load(path, overrides))


def in_steps(folder: Path, step: float, *overrides: str) -> Start:
    """As a script may begin it, which has its plan from elsewhere."""
    return replace(start(folder, *overrides), plan=Plan(Method.RK44, step=step))


def test_a_step_in_which_a_body_turns_far_is_refused(tmp_path: Path) -> None:
    words = "solver.step: bodies rotate at up to 708.9 rad/s: above "  # sqrt(100^2 + 700^2 + 50^2)
    with pytest.raises(CaseError, match=re.escape(words)):
        start(tmp_path, "solver.method=RK44", f"solver.step={STEP}")


def test_without_a_step_it_is_a_part_of_the_longest(tmp_path: Path) -> None:
    begin = start(tmp_path, "solver.method=RK44")
    limit = rotation_step_limit(
        begin.system,
        begin.state.bodies.angular_velocity,
        turning_polynomial(Method.RK44, Backend.EXUDYN),
        0.2,
        ENERGY_BOUND,
    )
    assert begin.plan.step == SAFETY * limit
    assert any("that RK44 allows for the rotation of bodies" in note for note in begin.plan.notes)


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
def test_what_steps_do_to_a_body(method: Method, backend: Backend, known, tmp_path: Path) -> None:
    """At 3 rad/s, by moments 1, 2 and 2.5 with (2.5 - 1) / 2 = 0.75, in steps of 0.1 s until 2 s.

    The tether's end adds to the body's moments less than 1e-2 of them.
    """
    heavy = "bodies.chaser.inertia=[1.0, 2.0, 2.5]"
    turning = RotationError(start(tmp_path, heavy).system, 0.1, turning_polynomial(method, backend))
    (error,), (angle,) = (
        found[0]
        for found in (
            turning.error(np.array([[[0.0, 3.0, 0.0]]]), np.array([2.0])),
            turning.angle(np.array([[[0.0, 3.0, 0.0]]])),
        )
    )
    assert angle == pytest.approx(0.3, rel=1e-15)
    assert error == pytest.approx(20 * known(0.75 * 0.3), rel=1e-2)


def test_a_sphere_turns_as_fast_as_it_likes(tmp_path: Path) -> None:
    """A body whose moments are equal has no gyroscopic torque: nothing oscillates."""
    ball = "bodies.chaser={shape='sphere', radius=0.01, mass=0.02, angular_velocity=[100.0, 700.0, 50.0]}"
    end = "tethers.slack.start={node=1}"
    other = "tethers.slack.end={body='chaser'}"
    system = start(tmp_path, ball, end, other).system
    polynomial = turning_polynomial(Method.RK44, Backend.EXUDYN)
    assert math.isinf(
        rotation_step_limit(system, np.array([[100.0, 700.0, 50.0]]), polynomial, 1.0, ENERGY_BOUND)
    )


def test_a_run_of_such_steps_is_stopped(tmp_path: Path) -> None:
    with pytest.raises(RunStopped, match=r"chaser rotates by 2\.\d+ rad a step") as stop:
        simulate(in_steps(tmp_path, STEP, "solver.retry=0"))
    assert stop.value.step_cause
    assert "too long for RK44 for the rotation of a body" in str(stop.value)


def test_a_retry_mends_it(tmp_path: Path) -> None:
    """Half the step twice; the body's energy is then kept, on which nothing ever acts."""
    run = simulate(in_steps(tmp_path, STEP, "time.end=0.1"))
    assert run.complete
    assert [item["step"] for item in run.provenance["retries"]] == [STEP / 2, STEP / 4]
    spin = run.bodies["chaser"].angular_velocity
    energy = spin**2 @ [1e-6, 2e-6, 2.5e-6]
    assert np.abs(energy / energy[0] - 1.0).max() < ENERGY_BOUND


def test_the_bound_is_one(tmp_path: Path) -> None:
    """RK44 on Euler's equations, where the bound is sharpest: a thin rod about its axis, over 300 rad."""
    inertia, spin, step, steps = np.array([1.0, 0.999, 0.0044]), np.array([0.03, -0.117, -0.9927]), 0.3, 1000
    rates = (np.roll(inertia, -1) - np.roll(inertia, -2)) / inertia

    def change(w: np.ndarray) -> np.ndarray:
        return rates * np.roll(w, -1) * np.roll(w, -2)

    w = spin
    for _ in range(steps):
        k1 = change(w)
        k2 = change(w + step / 2 * k1)
        k3 = change(w + step / 2 * k2)
        k4 = change(w + step * k3)
        w = w + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    lost = 1.0 - (w**2 @ inertia) / (spin**2 @ inertia)
    # Of this body: a = (1 - 0.0044) / 0.999.
    z = (1.0 - 0.0044) / 0.999 * step * np.linalg.norm(spin)
    bound = steps * (z**6 / 72 + z**8 / 576)
    assert 0.5 * bound < lost < bound

"""Damping by the mass, by Rayleigh's matrix and of the material: rates of decay that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import THREAD, bodies_alone, every_backend, listed, one_thread, ran, reference_run

from exunet.simulation.run import simulate


@every_backend
def test_mass_damping_decays_at_its_rate(backend: str) -> None:
    case = one_thread(2.0,
        initial={"velocity": [1.0, -2.0, 0.5]}, effects={"mass_damping": {"alpha": 0.7}},
    )  # fmt: skip
    run = ran(case, backend)
    expected = np.exp(-0.7 * run.time)[:, None] * [1.0, -2.0, 0.5]
    assert np.abs(run.velocity[:, 0] - expected).max() < 1e-9
    assert np.abs(reference_run(case)[1] - run.position).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["material_damping", "rayleigh_damping"])
def test_a_hanging_mass_rings_down_at_the_rate_of_its_damping(effect: str) -> None:
    """Small vibration of a taut cable: decay rate tau omega^2 / 2, as beta omega^2 / 2 of eq. (13)."""
    mass, length, tau = 1.0, 1.0, 2e-5
    stiffness = THREAD["youngs_modulus"] * THREAD["area"] / length
    omega = math.sqrt(stiffness / mass)
    keys = {"relaxation_time": tau} if effect == "material_damping" else {"alpha": 0.0, "beta": tau}
    stretched = 9.81 * mass / stiffness
    case = listed(
        [[0.0, 0.0, 0.0], [0.0, 0.0, -length]], [[0, 1]], 40 * 2 * math.pi / omega,
        net={"fixed": [0], "node_masses": [0.0, mass - 0.5e-3]},
        initial={
            "node_positions": [[0.0, 0.0, 0.0], [0.0, 0.0, -length - stretched]],
            "node_velocities": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.02]],
        },
        effects={effect: keys, "gravity": {"acceleration": [0.0, 0.0, -9.81]}},
    )  # fmt: skip
    case["time"]["output_step"] = case["time"]["end"] / 1600
    run = ran(case)
    assert run.strain.min() > 0.0
    speed = np.abs(run.velocity[:, 1, 2])
    first, last = (
        speed[part].argmax() + offset for part, offset in ((slice(40), 0), (slice(-40, None), 1561))
    )
    rate = math.log(speed[first] / speed[last]) / (run.time[last] - run.time[first])
    assert rate == pytest.approx(0.5 * tau * omega**2, rel=0.05)
    assert np.abs(reference_run(case)[1][-1] - run.position[-1]).max() < 1e-8


@pytest.mark.parametrize("effect", ["mass_damping.alpha=0.5", "rayleigh_damping={alpha=0.5, beta=0.0}"])
def test_damping_by_the_mass(effect: str) -> None:
    """Speed and spin of a sphere decay as exp(-alpha t), and the energy is booked."""
    body = "bodies.ball={mass=3.0, inertia=[0.2, 0.2, 0.2], velocity=[1, 2, 3], angular_velocity=[0, 0, 4]}"
    result = simulate(bodies_alone(body, f"effects.{effect}", "engine.backend=exudyn"))
    decay = np.exp(-0.5 * result.time)[:, None]
    ball = result.bodies["ball"]
    np.testing.assert_allclose(ball.velocity, decay * [1.0, 2.0, 3.0], rtol=1e-9)
    np.testing.assert_allclose(ball.angular_velocity, decay * [0.0, 0.0, 4.0], rtol=1e-9, atol=1e-12)
    total = result.kinetic + result.dissipated
    assert np.abs(total / total[0] - 1.0).max() < 1e-8

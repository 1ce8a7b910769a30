"""Balances of momentum and energy of scenes with bodies, and the potential energy and the work in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import BODY, CASES, HEAD, PAIR, values_of

import exunet
from exunet.model import energy
from exunet.results.measures import all_have_lines, dissipation, energy_errors
from exunet.results.summary import summarise
from exunet.scene.casefile import parse_case
from exunet.simulation.preparation import prepare_case
from exunet.studies.ensemble import perturbed_bodies_of, perturbed_runs

FREE = """
format = 1
title = "A body that turns"
[time]
end = 0.1
output_step = 0.01
[solver]
method = "VelocityVerlet"
step = 1e-4
[net]
topology = "explicit"
nodes = [[5.0, 3.0, 0.0]]
elements = []
node_masses = [0.1]
[net.cable]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e9
[initial]
packing = 1.0
[bodies.one]
mass = 10.0
inertia = [2.0, 3.0, 4.5]
angular_velocity = [0.05, 3.0, 0.02]
"""
BODIES = CASES / "bodies"
THROWN = "release", ("time.end=0.45", "engine.backend=compiled")  # the net is thrown at 0.4 s
TOWED = "tow", ("time.end=6.0", "solver.tolerance=1e-6")  # the brake pays out under a load
HELD = "snap", ("time.end=0.9", "solver.step=1e-3", "engine.backend=compiled", "bodies.chaser.motion=fixed")


def vector(found: dict[str, Any], name: str, unit: str) -> np.ndarray:
    return np.array([found[f"{name}_{axis}_{unit}"] for axis in "xyz"])


@pytest.mark.parametrize(("case", "overrides"), [THROWN, TOWED, HELD], ids=["thrown", "towed", "held"])
def test_gains_of_momentum_and_energy_add_up(case: str, overrides: tuple[str, ...]) -> None:
    """All gains equal what prescribed bodies give; gains of energy equal the works less the dissipation."""
    result = exunet.run(exunet.load(BODIES / f"{case}.toml", overrides))
    found = values_of(result)
    free = [f"body_{name}" for name in result.bodies if f"body_{name}_momentum_gained_x_kg_m_s" in found]
    given = [f"body_{name}" for name in result.bodies if f"body_{name}_work_J" in found]
    assert len(free) + len(given) == len(result.bodies) == 2
    moved = 0.0
    for gained, unit, impulse, units in (
        ("momentum_gained", "kg_m_s", "impulse", "N_s"),
        ("angular_momentum_gained", "kg_m2_s", "angular_impulse", "N_m_s"),
    ):
        every = np.array([vector(found, f"{name}_{gained}", unit) for name in (*free, "net")])
        back = sum((vector(found, f"{name}_{impulse}", units) for name in given), np.zeros(3))
        assert np.abs(every.sum(axis=0) - back).max() < 1e-7 * np.abs(every).max()
        moved = max(moved, float(np.abs(every).max()))
    assert moved > 0.1
    gains = [found[f"{name}_kinetic_energy_gained_J"] for name in (*free, "net")]
    gains += [found["elastic_energy_gained_J"], found.get("potential_energy_gained_J") or 0.0]
    put_in = found.get("work_of_ejection_J") or found.get("tether_tow_work_of_reel_J") or 0.0
    works = [found[f"{name}_work_J"] for name in given] + [put_in]
    allowed = 1e-6 * float(result.kinetic.max())
    assert sum(gains) == pytest.approx(sum(works) - found["dissipated_energy_J"], abs=allowed)
    # A throw puts energy in, a brake takes it out: neither counts as dissipated.
    taken = dissipation(result)
    assert put_in == pytest.approx(taken[-1] - result.dissipated[-1], rel=1e-12, abs=1e-12)
    assert np.diff(taken).min() > -1e-6
    assert 0.0 <= taken[-1] < 0.5
    if case != "snap":  # undamped, with nothing that works but the body held still
        assert taken[-1] > 0.0
        assert put_in * {"release": 1.0, "tow": -1.0}[case] > 1.0


def test_perturbations_move_free_bodies() -> None:
    """A body holds the net that is launched: perturbed nodes alone would change nothing."""
    start = prepare_case(
        exunet.load(BODIES / "release.toml", (*THROWN[1], "bodies.satellite.motion=prescribed"))
    )
    first, last = (perturbed_bodies_of(start, 2, 1e-9, 3, first=k) for k in (0, 1))
    assert first is not None
    assert last is not None
    for own, moved, again in zip(start.state.bodies.parts(), first.parts(), last.parts(), strict=True):
        assert np.array_equal(moved[1], again[0])  # a run is moved in one way, however many there are
        assert np.array_equal(moved[:, 1], np.stack([own[1]] * 2))  # the satellite
    places, attitudes = np.abs(first.position - start.state.bodies.position), first.attitude[:, 0]
    assert 1e-10 < places.max() <= 1e-9
    assert (first.velocity == start.state.bodies.velocity).all()
    np.testing.assert_allclose(np.linalg.norm(attitudes, axis=-1), 1.0, rtol=1e-14)
    assert 1e-10 < np.abs(attitudes - start.state.bodies.attitude[0]).max() < 1e-9
    both = perturbed_runs(start, 2).metrics
    for key in ("body_satellite_angular_impulse_x_N_m_s", "body_deployer_angular_velocity_x_rad_s"):
        assert key not in both or both[key][0] != both[key][1]
    assert both["largest_tension_N"][0] != both["largest_tension_N"][1]
    alone = prepare_case(exunet.load(CASES / "planar_deployment.toml"))
    assert perturbed_bodies_of(alone, 2, 1e-9, 3) is None


def test_the_momentum_residual_is_an_error_where_every_force_from_outside_has_a_line() -> None:
    """Material damping pulls along elements; gravity has a line."""
    for more in (["effects="], [], ["effects.gravity.acceleration=[0.0, 0.0, -2.0]"]):
        found = exunet.run(exunet.load(BODIES / "launch.toml", ["time.end=0.005", *more]))
        assert all_have_lines(found)
    plan = replace(found.run.plan, method="TrapezoidalIndex2")  # which has no first-order states
    assert not all_have_lines(replace(found, run=replace(found.run, plan=plan)))


def free_body(folder: Path, *overrides: str) -> exunet.Result:
    path = folder / "free.toml"
    path.write_text(FREE, encoding="utf-8")
    return exunet.run(exunet.load(path, overrides))


def test_the_angle_that_a_body_has_turned_is_at_most_half_a_turn(tmp_path: Path) -> None:
    """6 rad about a principal axis, which is 2 pi - 6 the other way round."""
    turning = ("bodies.one.angular_velocity=[0.0, 0.0, 3.0]", "time={end=2.0, output_step=1.0}")
    found = values_of(free_body(tmp_path, *turning, "solver={method='RK44', step=1e-2}"))
    assert found["body_one_turned_rad"] == pytest.approx(2.0 * np.pi - 6.0, rel=1e-6)
    assert found["body_one_angular_velocity_z_rad_s"] == pytest.approx(3.0, rel=1e-9)
    assert found["body_one_momentum_gained_x_kg_m_s"] == 0.0


def test_the_error_of_energy_is_relative_to_what_can_deform_the_net(tmp_path: Path) -> None:
    """Of a body without forces nothing can deform the net: its error is relative to all motion.

    Exudyn's Verlet turns bodies by Euler's method: within 0.1 s it errs by 4e-8 J (measured).
    """
    found = free_body(tmp_path, "engine.backend=exudyn")
    energy = summarise(found)["energy"]
    error = np.abs(energy_errors(found)).max()
    assert energy["scale_of"] == "motion"
    assert energy["scale_J"] == found.kinetic.max() > 10.0
    assert energy["balance_error"] == error / energy["scale_J"] > 1e-9
    tumbling = exunet.run(exunet.load(BODIES / "tumbling.toml", ["time.end=0.04", "engine.backend=compiled"]))
    energy = summarise(tumbling)["energy"]
    assert energy["scale_of"] == "deformation"
    assert energy["scale_J"] < 1.0 < 800.0 < tumbling.kinetic[0]  # 869 J of spin


LINE = """
net.elements = []
net.nodes = [[0.2, 0.0, 0.0], [0.5, 0.9, 0.1], [-0.5, 0.8, 0.0]]
net.node_masses = [2.0, 0.1, 0.3]
time = { end = 0.5, output_step = 0.1 }
effects.gravity.acceleration = [0.1, -0.2, -9.81]
[closing]
kind = "line"
nodes = [0, 1, 2]
length = 2.0
stiffness = 200.0
linear_density = 0.0
ring_diameter = 0.001
friction = 0.0
"""


def test_the_potential_is_that_of_loads_and_of_kernel_terms() -> None:
    """m g h, and EA L (e^2 - 1)^2 / 8 of a closing line round three nodes, 2 m long."""
    system = prepare_case(parse_case(HEAD + LINE, Path("line.toml"))).system
    x = np.random.default_rng(1).normal(size=(3, system.blocks.n_x)) * 2.0
    at = x[:, :9].reshape(3, 3, 3)
    x[:, 9:] = 0.0  # nothing is wound up
    around = np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).sum(axis=1)
    known = 200.0 * 2.0 / 8.0 * ((around / 2.0) ** 2 - 1.0) ** 2
    known -= np.einsum("n,kna,a->k", [2.0, 0.1, 0.3], at, [0.1, -0.2, -9.81])
    found = energy.potential(system.forces, x, dict(system.discrete))
    np.testing.assert_allclose(found, known, rtol=1e-3)


def test_the_work_taken_in_steps_is_exact_for_a_quadratic_motion(tmp_path: Path) -> None:
    """Mass damping of points and a body: alpha m |v|^2, a square of time, and alpha w I w of steady rotation.

    Steps of different lengths; the attitude changes its sign from state to state, as it may.
    """
    case = parse_case(PAIR, tmp_path / "case.toml", [BODY, "effects.mass_damping.alpha=0.5"])
    start = prepare_case(case)
    system, centres = start.system, start.system.blocks.centres
    x0, v0 = system.layout.pack(start.state.moving)
    time, spin = np.array([0.3, 0.4, 0.45, 0.6]), np.array([0.4, -0.2, 0.3])
    slope = np.random.default_rng(6).normal(size=centres)
    t, size = time[:, None], np.linalg.norm(spin)
    x, v = np.tile(x0, (4, 1)), np.tile(v0, (4, 1))
    x[:, :centres] += v0[:centres] * t + 0.5 * slope * t**2
    v[:, :centres] += slope * t
    x[:, centres : centres + 4] = np.concatenate(
        [np.cos(0.5 * size * t), np.sin(0.5 * size * t) * spin / size], 1
    )
    x[1::2, centres : centres + 4] *= -1.0
    v[:, centres:] = spin
    weight = 0.5 * np.repeat([*system.blocks.own_mass, 2.0], 3)  # alpha m of each coordinate of a centre
    turning = 0.5 * spin @ (np.array([0.2, 0.3, 0.4]) * spin)
    speed = v0[:centres]
    power = [weight @ speed**2 + turning, 2.0 * weight @ (speed * slope), weight @ slope**2]
    known = np.diff(np.polynomial.Polynomial(power).integ()(time))
    np.testing.assert_allclose(energy.work_taken(system, time, x, v), known, rtol=1e-6)

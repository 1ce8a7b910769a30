"""Barrels on a rigid body: the push and its reaction, the books of a launch, bullets that have left."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scenes import BACKENDS, continue_alike
from scipy.spatial.transform import Rotation

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.forces import barrels
from exunet.forces.effects import launch_force
from exunet.integrators.events import Events
from exunet.model.energy_scale import EnergyScale
from exunet.model.states import States
from exunet.results.measures import energy_balance
from exunet.simulation.preparation import Start, prepare_case

CASE = Path(__file__).parents[1] / "cases" / "effects" / "launch_force.toml"
SPIN = "[2.2, 5.5, -3.3]"  # rad/s: the chaser turns by 0.3 rad while the bullets are in their barrels
CHASER = (
    "bodies.chaser={mass=20.0, inertia=[4.0, 6.0, 8.0], products_of_inertia=[0.3, -0.2, 0.4], "
    "centre_of_mass=[0.1, -0.05, 0.2], position=[10.0, -4.0, 2.0], velocity=[0.3, -0.2, 0.1], "
    f"attitude=[0.8, 0.3, -0.4, 0.2], angular_velocity={SPIN}}}"
)
FRAME = "initial.frame={body='chaser', position=[0.0, 0.2, 0.8], axis=[0.0, 1.0, 0.0], angle=0.3}"
STILL = "bodies.chaser={mass=5.0, inertia=[4.0, 6.0, 8.0]}"
SPRING: dict[str, Any] = {"kind": "spring", "force": 64.0, "stroke": 0.05, "spread_angle": 0.2}
GAS = SPRING | {"kind": "gas", "dead_length": 0.1, "exponent": 1.4}
LAWS = {"spring": SPRING, "gas": GAS}


def launch(law: dict[str, Any], **changes: Any) -> str:
    pairs = (f"{key}={value!r}" for key, value in (law | {"body": "chaser"} | changes).items())
    return f"effects.launch_force={{{', '.join(pairs)}}}"


def case(*overrides: str) -> exunet.Case:
    return exunet.load(CASE, ["solver.tolerance=1e-10", *overrides])


def work(law: dict[str, Any]) -> float:
    return launch_force.LaunchForceConfig.model_validate(law | {"body": "chaser"}).work


RNG = np.random.default_rng(3)
AXES = np.array([[0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [0.48, 0.64, 0.6], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("law", [barrels.BarrelLaw(60.0, 0.4), barrels.BarrelLaw(60.0, 0.4, 0.15, 1.4)])
def test_force_and_torque_do_the_virtual_work_of_the_potential(law: barrels.BarrelLaw) -> None:
    """Moves of bullet and body, and turns of the body, against the change of U by central differences.

    Behind the start, in the barrel, out of it, and back in it after it had left.
    """
    points = np.arange(0, 12, 3)
    inside, start = np.array([1.0, 1.0, 1.0, 0.0]), np.array([0.1, 0.2, -0.3, 0.0])
    # Four bullets, the centre, the attitude; velocities have their spin at 15.
    data = barrels.Barrels(points, inside, AXES, start, 12, 15, 15, *law)
    x, force = np.concatenate([RNG.normal(0.0, 0.3, 15), RNG.normal(size=4)]), np.zeros(18)
    x[15:] /= np.linalg.norm(x[15:])
    turn, wanted = rotation_matrix(x[15:]), np.array([-0.05, 0.2, 0.5, 0.1])
    for b in range(4):
        arm = (x[3 * b : 3 * b + 3] - x[12:15]) @ turn
        arm += (wanted[b] + start[b] - arm @ AXES[b]) * AXES[b]
        x[3 * b : 3 * b + 3] = x[12:15] + turn @ arm
    barrels.add_push_of_body(0.0, x, np.zeros(18), data, force)
    assert [barrels.way_in_barrel(x, b, data) for b in range(4)] == pytest.approx(wanted, abs=1e-14)
    pushes = np.linalg.norm(force[:12].reshape(4, 3), axis=1)
    if law.exponent:
        ratio = (0.15 / np.array([0.15, 0.35])) ** 1.4
        assert pushes == pytest.approx([*60.0 * ratio, 0.0, 0.0], rel=1e-12)
    else:
        assert pushes == pytest.approx([67.5, 30.0, 0.0, 0.0], rel=1e-12)
    step, slope = 1e-6, np.zeros(18)
    for k in range(18):
        ends = []
        for sign in (step, -step):
            moved = x.copy()
            if k < 15:
                moved[k] += sign
            else:
                axis = sign * np.eye(3)[k - 15]
                attitude = Rotation.from_quat(x[15:], scalar_first=True) * Rotation.from_rotvec(axis)
                moved[15:] = attitude.as_quat(scalar_first=True)
            ends.append(barrels.push_of_body_potential(moved, data))
        slope[k] = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(force, -slope, atol=1e-7)
    # One line: no net force, and no net torque about any point.
    assert np.abs(force[:15].reshape(5, 3).sum(axis=0)).max() < 1e-14 * 60.0
    about = np.cross(x[:15].reshape(5, 3), force[:15].reshape(5, 3)).sum(axis=0) + turn @ force[15:]
    assert np.abs(about).max() < 1e-13 * 60.0


@pytest.mark.ci_for("exudyn-spring")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "kind"),
    [
        pytest.param(form, kind, marks=[pytest.mark.slow] * (form == "exudyn" and kind == "gas"))
        for form in BACKENDS
        for kind in LAWS
    ],
)
def test_the_books_of_a_launch_from_a_turning_chaser(form: str, kind: str) -> None:
    """Momentum to 1e-12 and angular momentum to 1e-8 of what is there, energy to 1e-5 of what was stored."""
    result = exunet.run(
        case(CHASER, FRAME, launch(LAWS[kind]), "time={end=0.3,output_step=0.01}", BACKENDS[form])
    )
    for values, part in ((result.momentum, 1e-12), (result.angular_momentum, 1e-8)):
        assert np.abs(values - values[0]).max() < part * np.abs(values).max()
    stored = 4 * work(LAWS[kind])
    assert result.potential[0] == pytest.approx(stored, rel=1e-12)
    assert not result.potential[result.time > 0.035].any()  # all have left, wherever the barrels turn to
    total = result.kinetic + result.elastic + result.potential
    assert np.abs(total - total[0]).max() < 1e-5 * stored
    assert energy_balance(result) < 1e-5
    assert result.complete


@pytest.mark.slow
@pytest.mark.parametrize("spin", [0.0, 30.0])
def test_the_books_at_any_spin(spin: float) -> None:
    turning = CHASER.replace(SPIN, f"[{0.4 * spin}, {0.7 * spin}, {-0.6 * spin}]")
    result = exunet.run(
        case(turning, FRAME, launch(SPRING), "time={end=0.1,output_step=0.01}", BACKENDS["compiled"])
    )
    for values, part in ((result.momentum, 1e-12), (result.angular_momentum, 1e-8)):
        assert np.abs(values - values[0]).max() < part * np.abs(values).max()
    total = result.kinetic + result.elastic + result.potential
    assert np.abs(total - total[0]).max() < 1e-5 * result.potential[0]


def test_what_springs_store_is_energy_that_can_deform_the_net() -> None:
    """All of it, whatever it would be with all at their centre of mass."""
    begin = prepare_case(case(CHASER, FRAME, launch(SPRING)))
    scale = EnergyScale(States.of(begin.system, begin.state))
    sim = exunet.Simulation(begin)
    sim.advance_to(0.1)
    own, added = scale.gained(States.of(begin.system, sim.state), np.zeros(1))
    assert own[0] == pytest.approx(4 * work(SPRING), rel=1e-6)
    assert added[0] == pytest.approx(4 * work(SPRING), rel=1e-12)


def test_barrels_are_fixed_in_the_chaser_as_the_net_lies_at_the_start() -> None:
    """Along the net's axes at time 0, those of [initial.frame] or else the scene's."""
    begin = prepare_case(case(CHASER, FRAME, launch(SPRING)))
    (term,) = begin.system.forces.kernels
    body = begin.system.bodies[0]
    net = rotation_matrix(np.array([math.cos(0.15), 0.0, math.sin(0.15), 0.0]))
    bullets = begin.net.bullet_nodes
    outward = begin.net.reference_position[bullets]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    axes = math.sin(0.2) * outward + math.cos(0.2) * np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(term.data.axes @ body.rotation.T, axes @ net.T, atol=1e-14)
    # Without [initial.frame] the net lies in the scene's axes.
    begin = prepare_case(case(CHASER, launch(SPRING)))
    (term,) = begin.system.forces.kernels
    turn = rotation_matrix(begin.state.bodies.attitude[0])
    np.testing.assert_allclose(term.data.axes @ turn.T, axes, atol=1e-14)
    arms = begin.position[bullets] - begin.state.bodies.position[0]
    np.testing.assert_allclose(term.data.start, np.einsum("ba,ba->b", arms, axes), rtol=1e-12)


@pytest.mark.ci_for("spring")
@pytest.mark.slow
@pytest.mark.parametrize("kind", LAWS)
def test_the_muzzle_speed_of_a_chaser_that_does_not_turn(kind: str) -> None:
    """Four bullets straight ahead, of mass m, from M: 4 W = mu u^2 / 2, mu = 4 m M / (4 m + M)."""
    loose = ("net.strings.density=1e-3", "net.cable.density=1e-3", "time={end=0.03,output_step=0.03}")
    result = exunet.run(case(STILL, launch(LAWS[kind], spread_angle=0.0), *loose))
    mass = 4.0 * 0.2
    speed = math.sqrt(2.0 * 4.0 * work(LAWS[kind]) * (1.0 / mass + 1.0 / 5.0))
    chaser = result.bodies["chaser"]
    found = result.velocity[-1, result.net.bullet_nodes, 2] - chaser.velocity[-1, 2]
    np.testing.assert_allclose(found, speed, rtol=1e-6)  # threads weigh 1e-8 kg
    assert chaser.velocity[-1, 2] == pytest.approx(-speed * mass / (mass + 5.0), rel=1e-6)
    assert np.abs(chaser.angular_velocity[-1]).max() < 1e-9


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_a_guided_chaser_gives_what_the_bullets_get(motion: str, form: str) -> None:
    """Its impulse, angular impulse and work are in the result; with them the books close."""
    spin = f", angular_velocity={SPIN}, velocity=[0.3, -0.2, 0.1]" if motion == "prescribed" else ""
    body = f"bodies.chaser={{mass=20.0, inertia=[4.0, 6.0, 8.0], motion='{motion}'{spin}}}"
    frame = "initial.frame={body='chaser', position=[0.0, 0.2, 0.8]}"
    result = exunet.run(case(body, frame, launch(SPRING), "time={end=0.1,output_step=0.01}", BACKENDS[form]))
    given = {name: result.states[f"chaser/{name}"].values for name in ("impulse", "angular_impulse", "work")}
    for values, name in ((result.momentum, "impulse"), (result.angular_momentum, "angular_impulse")):
        kept = values - given[name]
        assert np.abs(given[name]).max() > 0.1
        assert np.abs(kept - kept[0]).max() < 1e-8 * np.abs(values).max()
    total = result.kinetic + result.elastic + result.potential - given["work"][:, 0]
    assert np.abs(total - total[0]).max() < 1e-5 * result.potential[0]


@pytest.mark.ci
@pytest.mark.slow
def test_a_bullet_that_has_left_is_not_pushed_again() -> None:
    """The barrels turn by 3 rad, until the ways of the bullets along them are less than the stroke again."""
    spun = STILL.replace("mass=5.0", "mass=50.0, angular_velocity=[5.0, 0.0, 0.0]")
    begin = prepare_case(case(spun, launch(SPRING), "time={end=0.6,output_step=0.1}"))
    sim = exunet.Simulation(begin)
    sim.advance_to(0.1)
    total = sim.energy.kinetic + sim.energy.elastic
    assert total == pytest.approx(4 * work(SPRING) + begin_energy(begin), rel=1e-6)
    sim.advance_to(0.6)
    (term,) = begin.system.forces.kernels
    x, _ = begin.system.layout.pack(sim.state.moving)
    assert max(barrels.way_in_barrel(x, b, term.data) for b in range(4)) < 0.0
    assert sim.energy.potential == 0.0
    assert sim.energy.kinetic + sim.energy.elastic == pytest.approx(total, rel=1e-6)


def test_runs_look_at_each_step_only_until_all_have_left() -> None:
    begin = prepare_case(case(STILL, launch(SPRING)))
    events = Events(begin.system, begin.state.memory, Mock())
    assert events.in_steps
    x, v = begin.system.layout.pack(begin.state.moving)
    for ahead in (0.04, 0.06):
        moved = x.copy()
        moved[3 * begin.net.bullet_nodes + 2] += ahead / math.cos(0.2)
        assert len(list(events.at(0.0, moved, v))) == (ahead > 0.05)
    assert events.memory["launch_force/inside"].tolist() == [0.0] * 4
    assert not events.in_steps


def begin_energy(begin: Start) -> float:
    """Kinetic, at the start [J]."""
    return exunet.Simulation(begin).energy.kinetic


@pytest.mark.slow
@pytest.mark.parametrize("form", BACKENDS)
@pytest.mark.parametrize("cut", [0.01, 0.1])
def test_a_snapshot_continues_to_the_bit(form: str, cut: float, tmp_path: Path) -> None:
    """Cut while bullets are in their barrels, and after all have left."""
    begin = prepare_case(case(CHASER, FRAME, launch(GAS), "time={end=0.2,output_step=0.01}", BACKENDS[form]))
    one, other = exunet.Simulation(begin), exunet.Simulation(begin)
    one.advance_to(cut)
    continue_alike(one, other, 0.15, tmp_path)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([], r"effects\.launch_force\.body:"),
        ([CHASER, launch(SPRING, chaser_mass=5.0)], r"effects\.launch_force\.\w+: "),
        (["effects.launch_force.body="], r"effects\.launch_force: "),
        ([CHASER, "solver={method='GeneralizedAlpha', step=1e-4}"], r"solver\.method:"),
        (
            [CHASER.replace("chaser", "ship"), FRAME.replace("chaser", "ship"), "effects.launch_force.body=",
             "effects.launch_force.chaser_mass=5.0"],
            r"effects\.launch_force\.chaser_mass:",
        ),
    ],
)  # fmt: skip
def test_what_is_refused(overrides: list[str], words: str) -> None:
    with pytest.raises(exunet.CaseError, match=words):
        prepare_case(exunet.load(CASE, [launch(SPRING), *overrides]))

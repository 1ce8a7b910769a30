"""Nets that a body carries, holds and ejects, and bullets from barrels on it: momentum, energy, reactions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scenes import BACKENDS, CASES, continue_alike, every_backend, refused

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.effects import launch_force
from exunet.model.states import States
from exunet.results.measures import energy_balance
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.simulation import Simulation

PAPER = CASES / "planar_deployment.toml"
CHASER = (
    "bodies.chaser={mass=200.0, inertia=[40.0, 60.0, 80.0], products_of_inertia=[3.0, -2.0, 4.0], "
    "centre_of_mass=[0.1, -0.05, 0.2], position=[10.0, -4.0, 2.0], velocity=[0.3, -0.2, 0.1], "
    "attitude=[0.8, 0.3, -0.4, 0.2], angular_velocity=[0.2, 0.5, -0.3]}"
)
CARRIED = "initial.frame={body='chaser', position=[0.0, 0.2, 1.5], axis=[0.0, 1.0, 0.0], angle=0.3}"
WITHOUT = ("effects.rayleigh_damping=", "launch=")


def carried(*overrides: str) -> Start:
    return prepare_case(exunet.load(PAPER, [CHASER, CARRIED, "effects.rayleigh_damping=", *overrides]))


def momenta(begin: Start) -> tuple[np.ndarray, np.ndarray]:
    states = States.of(begin.system, begin.state)
    return states.momentum[0], states.angular_momentum[0]


def test_the_net_is_where_its_body_has_it() -> None:
    """Frame to scene: p + R (p_net + R_net x); velocities of a rigid whole of body and net."""
    begin, alone = carried("launch="), prepare_case(exunet.load(PAPER, WITHOUT))
    attitude = np.array([0.8, 0.3, -0.4, 0.2])
    turn = rotation_matrix(attitude / np.linalg.norm(attitude))
    net = rotation_matrix(np.array([np.cos(0.15), 0.0, np.sin(0.15), 0.0]))
    places = np.array([10.0, -4.0, 2.0]) + (np.array([0.0, 0.2, 1.5]) + alone.position @ net.T) @ turn.T
    np.testing.assert_allclose(begin.position, places, rtol=1e-13)
    centre = np.array([10.0, -4.0, 2.0]) + turn @ [0.1, -0.05, 0.2]
    speeds = np.array([0.3, -0.2, 0.1]) + np.cross(turn @ [0.2, 0.5, -0.3], places - centre)
    np.testing.assert_allclose(begin.velocity, speeds, rtol=1e-12, atol=1e-14)


UNEVEN = "speed_factors=[1.05, 1.0, 0.9, 0.0], tilts=[[0.02, 0.0], [0.0, 0.3], [-0.1, 0.1], [0.0, 0.0]]"


@pytest.mark.parametrize(
    "keys",
    [
        "radial_speed=2.5, axial_speed=1.0",
        "speed=3.0, spread_angle=0.6",
        f"speed=3.0, spread_angle=0.6, {UNEVEN}",
    ],
)
def test_a_launch_keeps_both_momenta(keys: str) -> None:
    """At any spin of the chaser, to 1e-12 of the bullets' share."""
    before, after = momenta(carried("launch=")), momenta(carried(f"launch={{{keys}}}"))
    for one, other, scale in zip(before, after, (10.0, 100.0), strict=True):
        np.testing.assert_allclose(other, one, atol=1e-12 * scale)


def test_a_light_body_recoils_from_a_launch() -> None:
    """Along z: bullets get 3 m/s, and fly at 3 (1 + sum(m) / M) m/s relative to the body after it."""
    body = "bodies.chaser={mass=20.0, inertia=[4.0, 6.0, 8.0]}"
    keys = (body, "initial.frame={body='chaser'}", "launch={radial_speed=0.0, axial_speed=3.0}", WITHOUT[0])
    begin = prepare_case(exunet.load(PAPER, keys))
    (event,) = Simulation(begin).log.events
    thrown = begin.net.mass[begin.net.bullet_nodes].sum()
    assert event.launch_speed_added_m_s == pytest.approx(3.0, rel=1e-12)
    assert event.launch_speed_relative_m_s == pytest.approx(3.0 * (1.0 + thrown / 20.0), rel=1e-12)


def test_the_bullets_get_their_speed_relative_to_the_carried_net() -> None:
    """And nothing else does but the body, by -sum(m dv) / M and -J^-1 sum(r x m dv)."""
    before, after = carried("launch="), carried("launch={radial_speed=2.5, axial_speed=1.0}")
    added = after.velocity - before.velocity
    bullets = before.net.bullet_nodes
    np.testing.assert_allclose(np.linalg.norm(added[bullets], axis=1), np.hypot(2.5, 1.0), rtol=1e-12)
    assert not np.delete(added, bullets, axis=0).any()
    one, other = before.state.bodies, after.state.bodies
    assert other.position.tolist() == one.position.tolist()
    assert other.attitude.tolist() == one.attitude.tolist()
    impulse = before.net.mass[bullets, None] * added[bullets]
    np.testing.assert_allclose(other.velocity - one.velocity, [-impulse.sum(axis=0) / 200.0], rtol=1e-12)
    turn = rotation_matrix(one.attitude[0])
    arms = before.position[bullets] - one.position[0]
    angular = -np.cross(arms, impulse).sum(axis=0) @ turn / np.array(before.system.bodies[0].inertia)
    np.testing.assert_allclose(other.angular_velocity - one.angular_velocity, [angular], rtol=1e-9)


LINE = (
    "tethers.line={diameter=0.01, density=1390.0, youngs_modulus=1e7, length=30.0, divisions=4, "
    "start={bullet=0}, end={body='chaser', point=[0.0, 0.2, 1.2]}}"
)


@pytest.mark.parametrize("more", [(), ("bodies.chaser.attachments.held={bullet=2, point=[0.0, 0.3, 1.2]}",)])
def test_a_throw_leaves_the_inner_nodes_of_a_tether_as_they_are(more: tuple[str, ...]) -> None:
    """Neither has the bullet that it is tied to more to pay than its own share, nor does one that is held."""
    before = carried("launch=", LINE, *more)
    after = carried("launch={radial_speed=2.5, axial_speed=1.0}", LINE, *more)
    bullet, *inner, end = before.net.tethers[0].nodes
    assert len(inner) == 3
    assert after.velocity[inner].tolist() == before.velocity[inner].tolist()
    assert np.abs(after.velocity[bullet] - before.velocity[bullet]).max() > 1.0
    assert (after.velocity[end] != before.velocity[end]).any()  # it moves on with its body
    for one, other, scale in zip(momenta(before), momenta(after), (10.0, 100.0), strict=True):
        np.testing.assert_allclose(other, one, atol=1e-12 * scale)


@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_a_prescribed_body_takes_the_launch_without_moving(motion: str) -> None:
    body = f"bodies.chaser={{mass=200.0, inertia=[40, 60, 80], motion='{motion}'}}"
    begin = carried(body, "launch={radial_speed=2.5, axial_speed=1.0}")
    assert not begin.state.bodies.velocity.any()
    assert not begin.state.bodies.angular_velocity.any()
    assert begin.velocity.any()


LAUNCH = CASES / "bodies" / "launch.toml"
LATER, FREE = "initial.frame.eject_at=0.2", "tethers={}"
SHORT = (
    "time={end=0.3, output_step=0.02}",
    "solver.tolerance=1e-9",
    "bodies.chaser.angular_velocity=[0.5, 2.0, 1.0]",
)


# A bent path and an attitude that turns there and back; steps end where the second piece begins.
POSES = (
    ", pose_times=[0.0, 0.14, 0.3], pose_positions=[[0.0, 0.0, 0.0], [0.1, 0.2, -0.1], [-0.2, 0.3, 0.2]]"
    ", pose_attitudes=[[1.0, 0.0, 0.0, 0.0], [0.95, 0.2, 0.1, 0.05], [0.8, 0.1, 0.5, 0.3]]"
)


def held(*overrides: str) -> exunet.Case:
    return exunet.load(LAUNCH, [*SHORT, LATER, *overrides])


@pytest.mark.slow_for("compiled")
@every_backend
@pytest.mark.parametrize("tied", [False, True])
def test_an_ejection_keeps_momentum_and_energy(backend: str, tied: bool) -> None:
    """Momentum to 1e-12 and angular momentum to 1e-8 of what single parts have; the energy to 1e-5."""
    found = exunet.run(held(BACKENDS[backend], *([] if tied else [FREE])))
    assert found.verdict == "ok"
    (event,) = found.run.ejections
    work = -event.energy_lost_J
    assert event.time_s == 0.2
    assert event.nodes == found.net.n_net_nodes
    assert event.body == "chaser"
    (before, after) = found.dissipated[np.searchsorted(found.time, 0.2 - 1e-12) - 1 :][:2]
    assert work == pytest.approx(before - after, abs=1e-3 * work)
    scale = float((found.net.mass[:, None] * np.linalg.norm(found.velocity, axis=-1).T).sum(axis=0).max())
    assert np.abs(found.momentum - found.momentum[0]).max() < 1e-12 * scale + 1e-13
    turning = float(np.linalg.norm(found.angular_momentum[0])) + scale
    assert np.abs(found.angular_momentum - found.angular_momentum[0]).max() < 1e-8 * turning
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.abs(total - total[0]).max() < 1e-5 * found.kinetic.max()
    thrown = found.time >= 0.2 - 1e-12  # a state that is stored then is the one after it
    speeds = np.linalg.norm(found.velocity[:, found.net.bullet_nodes], axis=-1)
    assert speeds[~thrown].max() < 2.5 < 2.9 < speeds[thrown].min()
    # until then the net rests in the chaser's frame
    body = found.bodies["chaser"]
    turn = rotation_matrix(np.asarray(body.attitude))
    net = found.position[:, : found.net.n_net_nodes]
    inside = np.einsum("kij,kni->knj", turn, net - np.asarray(body.position)[:, None])
    assert np.ptp(inside[found.time < 0.2], axis=0).max() < 1e-13
    assert np.ptp(inside[thrown], axis=0).max() > 0.1


@pytest.mark.slow_for("compiled")
@every_backend
@pytest.mark.parametrize("cut", [0.1, 0.24])
def test_a_snapshot_before_and_after(backend: str, cut: float, tmp_path: Path) -> None:
    one, other = Simulation(held(BACKENDS[backend])), Simulation(held(BACKENDS[backend]))
    one.advance_to(cut)
    continue_alike(one, other, 0.28, tmp_path)


GIVEN_TO_THE_NET = ("initial.velocity=[0.3, -0.2, 1.0]", "initial.spin=[0.5, 1.0, 2.0]")
MOTIONS = {
    "free": (),
    "fixed": ("bodies.chaser={mass=80.0, inertia=[1.0, 1.0, 1.0], motion='fixed'}",),
    "prescribed": (f"bodies.chaser={{mass=80.0, inertia=[1.0, 1.0, 1.0], motion='prescribed'{POSES}}}",),
}


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("motion", MOTIONS)
def test_an_ejection_at_the_start_is_the_limit_of_a_later_one(motion: str, tied: bool) -> None:
    """At 0 and at 1e-9 s: what 1e-9 s do to a state is 1e-9 times its rates, which are below 100 a second."""
    short = "time={end=0.3, output_times=[0.001, 0.002]}"
    more = (*([] if tied else [FREE]), *MOTIONS[motion], *GIVEN_TO_THE_NET, BACKENDS["exudyn"])
    if motion == "free":
        more = (*more, SHORT[2])
    runs = []
    for at in (0.0, 1e-9):
        sim = Simulation(exunet.load(LAUNCH, [short, SHORT[1], *more, f"initial.frame.eject_at={at}"]))
        sim.advance_to(0.002)
        runs.append(sim)
    now, later = runs
    for name in ("position", "velocity", "first_order"):
        one, other = (getattr(sim.state, name) for sim in runs)
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7)
    for one, other in zip(now.state.bodies.parts(), later.state.bodies.parts(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
    (event,), (after,) = ([item.as_json() for item in sim.log.events] for sim in runs)
    assert (event.pop("time_s"), after.pop("time_s")) == (0.0, 1e-9)
    assert event.keys() == after.keys()
    for name in event.keys() - {"body"}:
        np.testing.assert_allclose(event[name], after[name], rtol=1e-7, atol=1e-7)
    assert event["energy_lost_J"] < -1.0
    assert now.balance.dissipated == pytest.approx(later.balance.dissipated, rel=1e-7)


@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_a_support_takes_the_reaction_of_an_ejection(backend: str, motion: str) -> None:
    """What a support or a prescribed body gives is the change of the momenta; the ejection adds energy."""
    keys = f"{{mass=80.0, inertia=[1.0, 1.0, 1.0], motion='{motion}'{POSES * (motion != 'fixed')}}}"
    short = SHORT[:2]
    found = exunet.run(exunet.load(LAUNCH, [*short, LATER, FREE, BACKENDS[backend], f"bodies.chaser={keys}"]))
    given = (found.states["chaser/impulse"].values, found.states["chaser/angular_impulse"].values)
    bound = 1e-11 if motion == "fixed" else 1e-8 * np.abs(given[0]).max()  # which is integrated
    assert np.ptp(found.momentum - given[0], axis=0).max() < bound
    assert np.ptp(found.angular_momentum - given[1], axis=0).max() < 10.0 * bound
    total = found.kinetic + found.elastic + found.potential + found.dissipated
    assert np.ptp(total) < 1e-8 * found.kinetic.max()
    work, before = found.states["chaser/work"].values[:, 0], found.time < 0.2 - 1e-12
    if motion == "fixed":
        assert not found.kinetic[before].any()
        assert not work.any()
    else:  # which carries the net: what it has given is the net's energy, until it is thrown
        np.testing.assert_allclose(work[before], found.kinetic[before] - found.kinetic[0], atol=1e-8)
        assert np.ptp(work[before]) > 1.0
    assert found.kinetic[~before].min() > found.kinetic[before].max() + 1.0


BARRELS = CASES / "effects" / "launch_force.toml"
SPIN = "[2.2, 5.5, -3.3]"  # rad/s: the chaser turns by 0.3 rad while the bullets are in their barrels
TURNING = (
    "bodies.chaser={mass=20.0, inertia=[4.0, 6.0, 8.0], products_of_inertia=[0.3, -0.2, 0.4], "
    "centre_of_mass=[0.1, -0.05, 0.2], position=[10.0, -4.0, 2.0], velocity=[0.3, -0.2, 0.1], "
    f"attitude=[0.8, 0.3, -0.4, 0.2], angular_velocity={SPIN}}}"
)
IN_FRAME = "initial.frame={body='chaser', position=[0.0, 0.2, 0.8], axis=[0.0, 1.0, 0.0], angle=0.3}"
STILL = "bodies.chaser={mass=5.0, inertia=[4.0, 6.0, 8.0]}"
SPRING: dict[str, Any] = {"kind": "spring", "force": 64.0, "stroke": 0.05, "spread_angle": 0.2}
GAS = SPRING | {"kind": "gas", "dead_length": 0.1, "exponent": 1.4}
LAWS = {"spring": SPRING, "gas": GAS}


def launch(law: dict[str, Any], **changes: Any) -> str:
    pairs = (f"{key}={value!r}" for key, value in (law | {"body": "chaser"} | changes).items())
    return f"effects.launch_force={{{', '.join(pairs)}}}"


def loaded(*overrides: str) -> exunet.Case:
    return exunet.load(BARRELS, ["solver.tolerance=1e-10", *overrides])


def work(law: dict[str, Any]) -> float:
    return TypeAdapter(launch_force.AnyLaunchForce).validate_python(law | {"body": "chaser"}).work


@pytest.mark.ci_for("exudyn-spring")
@pytest.mark.slow
@pytest.mark.parametrize("kind", LAWS)
@every_backend
def test_a_launch_from_a_turning_chaser(backend: str, kind: str) -> None:
    """Momentum to 1e-12 and angular momentum to 1e-8 of what is there, energy to 1e-5 of what was stored."""
    result = exunet.run(
        loaded(TURNING, IN_FRAME, launch(LAWS[kind]), "time={end=0.3,output_step=0.01}", BACKENDS[backend])
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


def test_barrels_are_fixed_in_the_chaser_as_the_net_lies_at_the_start() -> None:
    """Along the net's axes at time 0, those of [initial.frame] or else the scene's."""
    begin = prepare_case(loaded(TURNING, IN_FRAME, launch(SPRING)))
    (term,) = begin.system.forces.kernels
    body = begin.system.bodies[0]
    net = rotation_matrix(np.array([math.cos(0.15), 0.0, math.sin(0.15), 0.0]))
    bullets = begin.net.bullet_nodes
    outward = begin.net.reference_position[bullets]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    axes = math.sin(0.2) * outward + math.cos(0.2) * np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(term.data.axes @ body.rotation.T, axes @ net.T, atol=1e-14)
    # Without [initial.frame] the net lies in the scene's axes.
    begin = prepare_case(loaded(TURNING, launch(SPRING)))
    (term,) = begin.system.forces.kernels
    turn = rotation_matrix(begin.state.bodies.attitude[0])
    np.testing.assert_allclose(term.data.axes @ turn.T, axes, atol=1e-14)
    arms = begin.position[bullets] - begin.state.bodies.position[0]
    np.testing.assert_allclose(term.data.start, np.einsum("ba,ba->b", arms, axes), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", LAWS)
def test_the_muzzle_speed_of_a_chaser_that_does_not_turn(kind: str) -> None:
    """Four bullets straight ahead, of mass m, from M: 4 W = mu u^2 / 2, mu = 4 m M / (4 m + M)."""
    loose = ("net.strings.density=1e-3", "net.cable.density=1e-3", "time={end=0.03,output_step=0.03}")
    result = exunet.run(loaded(STILL, launch(LAWS[kind], spread_angle=0.0), *loose))
    mass = 4.0 * 0.2
    speed = math.sqrt(2.0 * 4.0 * work(LAWS[kind]) * (1.0 / mass + 1.0 / 5.0))
    chaser = result.bodies["chaser"]
    found = result.velocity[-1, result.net.bullet_nodes, 2] - chaser.velocity[-1, 2]
    np.testing.assert_allclose(found, speed, rtol=1e-6)  # threads weigh 1e-8 kg
    assert chaser.velocity[-1, 2] == pytest.approx(-speed * mass / (mass + 5.0), rel=1e-6)
    assert np.abs(chaser.angular_velocity[-1]).max() < 1e-9


@pytest.mark.slow_for("compiled")
@every_backend
@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_a_prescribed_chaser_gives_what_the_bullets_get(motion: str, backend: str) -> None:
    """Momenta and energy are kept with the impulse, angular impulse and work in the result."""
    spin = f", angular_velocity={SPIN}, velocity=[0.3, -0.2, 0.1]" if motion == "prescribed" else ""
    body = f"bodies.chaser={{mass=20.0, inertia=[4.0, 6.0, 8.0], motion='{motion}'{spin}}}"
    frame = "initial.frame={body='chaser', position=[0.0, 0.2, 0.8]}"
    result = exunet.run(
        loaded(body, frame, launch(SPRING), "time={end=0.1,output_step=0.01}", BACKENDS[backend])
    )
    given = {name: result.states[f"chaser/{name}"].values for name in ("impulse", "angular_impulse", "work")}
    for values, name in ((result.momentum, "impulse"), (result.angular_momentum, "angular_impulse")):
        kept = values - given[name]
        assert np.abs(given[name]).max() > 0.1
        assert np.abs(kept - kept[0]).max() < 1e-8 * np.abs(values).max()
    total = result.kinetic + result.elastic + result.potential - given["work"][:, 0]
    assert np.abs(total - total[0]).max() < 1e-5 * result.potential[0]


@pytest.mark.slow
def test_a_bullet_that_has_left_is_not_pushed_again() -> None:
    """The barrels turn by 3 rad, until the ways of the bullets along them are less than the stroke again."""
    spun = STILL.replace("mass=5.0", "mass=50.0, angular_velocity=[5.0, 0.0, 0.0]")
    end = "time={end=0.6,output_step=0.1}"
    begin = prepare_case(loaded(spun, launch(SPRING), end, BACKENDS["exudyn"]))
    sim = Simulation(begin)
    kinetic = sim.energy.kinetic
    sim.advance_to(0.1)
    total = sim.energy.kinetic + sim.energy.elastic
    assert total == pytest.approx(4 * work(SPRING) + kinetic, rel=1e-6)
    sim.advance_to(0.6)
    (term,) = begin.system.forces.kernels
    x, _ = begin.system.layout.pack(sim.state.moving)
    assert max(launch_force.way_in_barrel(x, b, term.data) for b in range(4)) < 0.0
    assert sim.energy.potential == 0.0
    assert sim.energy.kinetic + sim.energy.elastic == pytest.approx(total, rel=1e-6)


@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("cut", [0.01, 0.1])
def test_a_snapshot_continues_to_the_bit(backend: str, cut: float, tmp_path: Path) -> None:
    """Cut while bullets are in their barrels, and after all have left."""
    begin = prepare_case(
        loaded(TURNING, IN_FRAME, launch(GAS), "time={end=0.2,output_step=0.01}", BACKENDS[backend])
    )
    one, other = Simulation(begin), Simulation(begin)
    one.advance_to(cut)
    continue_alike(one, other, 0.15, tmp_path)


@pytest.mark.parametrize(
    ("case", "changes", "key"),
    [
        (PAPER, [CHASER, CARRIED, "initial.frame.body=nobody"], "initial.frame.body"),
        (PAPER, [CHASER, CARRIED, "initial.frame.attitude=[1, 0, 0, 0]"], "initial.frame.axis"),
        (PAPER, [CHASER, CARRIED, "initial.frame.angle="], "initial.frame.axis"),
        (LAUNCH, [*SHORT, "initial.frame.eject_at=-0.1"], "initial.frame.eject_at"),
        (LAUNCH, [*SHORT, "initial.frame.eject_at=0.3"], "initial.frame.eject_at"),
        (BARRELS, [launch(SPRING, body="nobody")], "effects.launch_force.body"),
        (
            BARRELS,
            [TURNING, launch(SPRING), "solver={method='GeneralizedAlpha', step=1e-4}"],
            "solver.method",
        ),
    ],
)
def test_wrong_keys_are_refused(case: Path, changes: list[str], key: str) -> None:
    assert key in refused(case, *changes)

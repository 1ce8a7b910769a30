"""A net that a body carries at the start: where it is, how it moves, and the reaction of its launch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.model.states import States
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

PAPER = Path(__file__).parents[1] / "cases" / "planar_deployment.toml"
BODY = (
    "bodies.chaser={mass=200.0, inertia=[40.0, 60.0, 80.0], products_of_inertia=[3.0, -2.0, 4.0], "
    "centre_of_mass=[0.1, -0.05, 0.2], position=[10.0, -4.0, 2.0], velocity=[0.3, -0.2, 0.1], "
    "attitude=[0.8, 0.3, -0.4, 0.2], angular_velocity=[0.2, 0.5, -0.3]}"
)
FRAME = "initial.frame={body='chaser', position=[0.0, 0.2, 1.5], axis=[0.0, 1.0, 0.0], angle=0.3}"
WITHOUT = ("effects.rayleigh_damping=", "launch=")


def start(*overrides: str) -> Start:
    return prepare_case(exunet.load(PAPER, [BODY, FRAME, "effects.rayleigh_damping=", *overrides]))


def momenta(begin: Start) -> tuple[np.ndarray, np.ndarray]:
    states = States.of(begin.system, begin.state)
    return states.momentum[0], states.angular_momentum[0]


def test_the_net_is_where_its_body_has_it() -> None:
    """Frame to scene: p + R (p_net + R_net x); velocities of a rigid whole of body and net."""
    begin, alone = start("launch="), prepare_case(exunet.load(PAPER, WITHOUT))
    attitude = np.array([0.8, 0.3, -0.4, 0.2])
    turn = rotation_matrix(attitude / np.linalg.norm(attitude))
    net = rotation_matrix(np.array([np.cos(0.15), 0.0, np.sin(0.15), 0.0]))
    places = np.array([10.0, -4.0, 2.0]) + (np.array([0.0, 0.2, 1.5]) + alone.position @ net.T) @ turn.T
    np.testing.assert_allclose(begin.position, places, rtol=1e-13)
    centre = np.array([10.0, -4.0, 2.0]) + turn @ [0.1, -0.05, 0.2]
    speeds = np.array([0.3, -0.2, 0.1]) + np.cross(turn @ [0.2, 0.5, -0.3], places - centre)
    np.testing.assert_allclose(begin.velocity, speeds, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("keys", ["radial_speed=2.5, axial_speed=1.0", "speed=3.0, spread_angle=0.6"])
def test_a_launch_keeps_both_momenta(keys: str) -> None:
    """At any spin of the chaser, to 1e-12 of the bullets' share."""
    before, after = momenta(start("launch=")), momenta(start(f"launch={{{keys}}}"))
    for one, other, scale in zip(before, after, (10.0, 100.0), strict=True):
        np.testing.assert_allclose(other, one, atol=1e-12 * scale)


def test_the_bullets_get_their_speed_relative_to_the_carried_net() -> None:
    """And nothing else does but the body, by -sum(m dv) / M and -J^-1 sum(r x m dv)."""
    before, after = start("launch="), start("launch={radial_speed=2.5, axial_speed=1.0}")
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
    before = start("launch=", LINE, *more)
    after = start("launch={radial_speed=2.5, axial_speed=1.0}", LINE, *more)
    bullet, *inner, end = before.net.tethers[0].nodes
    assert len(inner) == 3
    assert after.velocity[inner].tolist() == before.velocity[inner].tolist()
    assert np.abs(after.velocity[bullet] - before.velocity[bullet]).max() > 1.0
    assert (after.velocity[end] != before.velocity[end]).any()  # it moves on with its body
    for one, other, scale in zip(momenta(before), momenta(after), (10.0, 100.0), strict=True):
        np.testing.assert_allclose(other, one, atol=1e-12 * scale)


@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_a_guided_body_takes_the_launch_without_moving(motion: str) -> None:
    body = f"bodies.chaser={{mass=200.0, inertia=[40, 60, 80], motion='{motion}'}}"
    begin = start(body, "launch={radial_speed=2.5, axial_speed=1.0}")
    assert not begin.state.bodies.velocity.any()
    assert not begin.state.bodies.angular_velocity.any()
    assert begin.velocity.any()


@pytest.mark.ci
@pytest.mark.slow
def test_a_throw_from_a_turning_chaser_keeps_the_books() -> None:
    """Tied to the chaser by a tether, of material damping, to 0.2 s: momentum to 1e-10, angular to 1e-8."""
    tether = (
        "tethers.line={diameter=0.001, density=1390.0, youngs_modulus=70e9, length=20.0, divisions=4, "
        "start={node=20}, end={body='chaser', point=[0.0, 0.2, 1.2]}}"
    )
    case = ("time={end=0.2, output_step=0.05}", "effects.material_damping.relaxation_time=1e-3")
    how = ("solver={method='RK44', step=1.9e-5}", "engine.backend=exudyn")
    result = simulate(start(tether, *case, *how))
    for found, part in ((result.momentum, 1e-10), (result.angular_momentum, 1e-8)):
        scale = np.abs(found).max()
        np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), atol=part * scale)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("initial.frame.body=nobody", r"initial\.frame\.body:"),
        ("initial.frame.attitude=[1, 0, 0, 0]", r"initial\.frame\.axis:"),
        ("initial.frame.angle=", r"initial\.frame\.axis:"),
        ("initial.frame.body=", r"initial\.frame\.body:"),
    ],
)
def test_what_is_refused(override: str, words: str) -> None:
    with pytest.raises(exunet.CaseError, match=words):
        start(override)

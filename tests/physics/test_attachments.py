"""Nodes of the net that are fixed to points of bodies: masses, motion, momentum and energy, back ends."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scenes import BACKENDS, continue_alike, every_backend, of_text, refused

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.cable import reference_tangent_stiffness
from exunet.model.limits import largest_frequency
from exunet.model.states import States
from exunet.simulation.preparation import Start, prepare_case

# A cable of two elements, 1 m and 55 N each, between two bodies; the first element is taut at the start, the
# second snaps taut at some 0.1 s.
CHAIN = """
format = 1
title = "Two bodies on a cable"
time = { end = 0.3, output_step = 0.05 }
initial.packing = 1.0
initial.node_positions = [[0.0, 0.0, 0.0], [1.05, 0.0, 0.0], [2.0, 0.0, 0.0]]
initial.node_velocities = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [0.0, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
net.elements = [[0, 1], [1, 2]]
net.node_masses = [0.1, 0.5, 0.1]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }
"""
LUMP = 1390.0 * math.pi * 0.0005**2 / 2.0  # half an element [kg]

INERTIA = np.array([[0.2, 0.05, 0.02], [0.05, 0.3, 0.01], [0.02, 0.01, 0.4]])
FIRST = (
    "bodies.first={mass=2.0, inertia=[0.2, 0.3, 0.4], products_of_inertia=[0.05, 0.02, 0.01], "
    "centre_of_mass=[0.1, 0.2, 0.3], position=[-0.5, 0.2, 0.1], velocity=[-0.3, 0.0, 0.2], "
    "attitude=[0.9, 0.1, 0.3, 0.2], angular_velocity=[1.0, 2.0, -1.5]}",
    "bodies.first.attachments.x={point=[0.3, 0.1, -0.2], node=0}",
)
SECOND = (
    "bodies.second={mass=3.0, inertia=[0.2, 0.3, 0.4], position=[2.2, 0.1, 0.0], velocity=[0.5, 0.0, 0.3], "
    "angular_velocity=[0.1, 2.0, 0.0]}",
    "bodies.second.attachments.x={point=[-0.1, 0.1, 0.2], node=2}",
)
PRESCRIBED = (*SECOND, "bodies.second.motion=prescribed")
RK44 = ("solver.method=RK44", "solver.step=5e-5")


def start(*overrides: str) -> Start:
    return prepare_case(of_text(CHAIN, *overrides))


def test_the_mass_of_a_node_is_the_bodys() -> None:
    """Sums over the body and a point of 0.1 kg and half an element: mass, centre, and Steiner's theorem."""
    begin = start(*FIRST)
    (body,) = begin.system.bodies
    m = 0.1 + LUMP
    assert body.mass == pytest.approx(2.0 + m, rel=1e-15)
    own, point = np.array([0.1, 0.2, 0.3]), np.array([0.3, 0.1, -0.2])
    centre = (2.0 * own + m * point) / (2.0 + m)
    np.testing.assert_allclose(body.centre, centre, rtol=1e-14)
    expected = INERTIA.copy()
    for mass, place in ((2.0, own - centre), (m, point - centre)):
        expected += mass * (place @ place * np.eye(3) - np.outer(place, place))
    np.testing.assert_allclose(body.inertia_in_frame, expected, rtol=1e-13)
    assert begin.system.mass[0] == 0.0
    assert begin.net.mass[0] == pytest.approx(m, rel=1e-14)


def test_the_node_is_where_its_point_is() -> None:
    """At the start: position + R point, velocity + w x the arm from the centre."""
    state = start(*FIRST).state
    attitude = np.array([0.9, 0.1, 0.3, 0.2])
    turn = rotation_matrix(attitude / np.linalg.norm(attitude))
    place = turn @ np.array([0.3, 0.1, -0.2]) + np.array([-0.5, 0.2, 0.1])
    np.testing.assert_allclose(state.position[0], place, rtol=1e-14)
    arm = place - state.bodies.position[0]
    speed = np.array([-0.3, 0.0, 0.2]) + np.cross(turn @ [1.0, 2.0, -1.5], arm)
    np.testing.assert_allclose(state.velocity[0], speed, rtol=1e-13)


def test_the_loops_state_what_the_arrays_do() -> None:
    """Placed by both; the forces handed on do the same work for any motion, and leave none on the point."""
    system = start(*FIRST, *SECOND).system
    constraint, blocks, rng = system.forces.constraint, system.blocks, np.random.default_rng(4)
    assert constraint is not None
    (call,) = constraint.calls
    x, v, force = rng.normal(size=blocks.n_x), rng.normal(size=blocks.n_v), rng.normal(size=blocks.n_force)
    for name in blocks.rigid:
        q = blocks.attitude(name)
        x[q : q + 4] /= np.linalg.norm(x[q : q + 4])
    moving = system.layout.unpack(x.copy(), v.copy()).completed(system.kinematics, 0.0, {})
    call.place(0.0, x, v, call.data)
    for found, expected in zip((x, v), system.layout.pack(moving), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)
    power = force @ v
    call.add(0.0, x, v, call.data, force)
    assert force @ v == pytest.approx(power, rel=1e-12)
    np.testing.assert_array_equal(force[[0, 1, 2, 6, 7, 8]], np.zeros(6))


DAMPED = "effects.material_damping.relaxation_time=1e-3"
BROKEN = "effects.breaking.force=20.0"


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["", DAMPED, BROKEN], ids=["kept", "damped", "broken"])
@pytest.mark.parametrize("second", [SECOND, PRESCRIBED], ids=["free", "prescribed"])
@every_backend
def test_momentum_and_energy_are_kept(
    backend: str, second: tuple[str, ...], effect: str, tmp_path: Path
) -> None:
    """Through a snap, off the centres. Measured: 2e-14 N s, 1e-12 N m s, and 1e-7 J of 7 J."""
    begin = start(*FIRST, *second, *([effect] if effect else []), BACKENDS[backend], *RK44)
    sim = exunet.Simulation(begin)
    energy, first = sim.energy.total, States.of(begin.system, begin.state)
    sim.advance_to(0.3)
    last = States.of(begin.system, sim.state)
    given = np.zeros(7) if second is SECOND else sim.state.first_order
    np.testing.assert_allclose(last.momentum[0] - first.momentum[0], given[:3], atol=1e-13)
    np.testing.assert_allclose(last.angular_momentum[0] - first.angular_momentum[0], given[3:6], atol=1e-11)
    assert sim.energy.total == pytest.approx(energy, abs=1e-6 if effect != BROKEN else 1e-4)
    assert sim.largest_tension.tension > 20.0
    if second is SECOND:  # else what the prescribed body gives is in it too
        assert (sim.energy.dissipated > 1e-3) == (effect != "")


@pytest.mark.slow_for("compiled")
@every_backend
def test_verlet(backend: str) -> None:
    """Momentum to round-off, energy to its order in the compiled loop; velocities of points follow bodies."""
    how = (BACKENDS[backend], "solver.method=VelocityVerlet", "solver.step=5e-5")
    begin = start(*FIRST, *SECOND, *how)
    sim = exunet.Simulation(begin)
    energy, first = sim.energy.total, States.of(begin.system, begin.state)
    sim.advance_to(0.3 if backend == "compiled" else 0.05)
    state, last = sim.state, States.of(begin.system, sim.state)
    if backend == "compiled":
        np.testing.assert_allclose(last.momentum, first.momentum, atol=1e-12)
        assert sim.energy.total == pytest.approx(energy, rel=1e-4)
    expected = state.moving.completed(begin.system.kinematics, state.time, {})
    np.testing.assert_allclose(state.velocity, expected.velocity, atol=1e-15)


@pytest.mark.ci_for("compiled")
@pytest.mark.slow
@every_backend
def test_a_force_on_an_attached_node_is_one_on_its_body(backend: str) -> None:
    """F t of momentum, r x F of angular momentum as the node goes, and its work in the balance."""
    begin = start(*FIRST, *SECOND, BACKENDS[backend], *RK44)
    sim = exunet.Simulation(begin)
    force, energy, first = np.array([0.3, -0.2, 0.5]), sim.energy.total, States.of(begin.system, begin.state)
    sim.set_force(0, force)
    places = [sim.net.position[0]]
    while sim.time < 0.1:
        sim.advance(1e-3)
        places.append(sim.net.position[0])
    last = States.of(begin.system, sim.state)
    np.testing.assert_allclose(last.momentum[0] - first.momentum[0], 0.1 * force, atol=1e-12)
    mean = np.trapezoid(places, dx=1e-3, axis=0)  # h^2 / 12 t a errs by 3e-7 m s for 30 m/s2
    turned = last.angular_momentum[0] - first.angular_momentum[0]
    np.testing.assert_allclose(turned, np.cross(mean, force), atol=1e-6)
    assert sim.energy.total == pytest.approx(energy, abs=1e-6)


@pytest.mark.slow
@every_backend
def test_a_snapshot_of_bodies_on_a_cable(backend: str, tmp_path: Path) -> None:
    begin = start(*FIRST, *PRESCRIBED, BACKENDS[backend], "solver.method=RK44", "solver.step=1e-4")
    one, other = exunet.Simulation(begin), exunet.Simulation(begin)
    one.advance_to(0.1)
    other.advance_to(0.02)
    continue_alike(one, other, 0.2, tmp_path)


def test_the_stable_step_bounds_the_fastest_mode() -> None:
    """The eigenvalues of the taut net with the mobilities 1/m + [p]x^T J^-1 [p]x of light bodies."""
    light = "bodies.{}={{mass=0.01, inertia=[1e-4, 1e-4, 1e-4], position=[{}, 0, 0]}}"
    bodies = [light.format("first", 0.0), light.format("second", 2.0)]
    bodies += ["bodies.first.attachments.a={point=[0, 0.1, 0], node=0}"]
    bodies += ["bodies.first.attachments.b={point=[1, 0, 0.05], node=1}"]
    bodies += ["bodies.second.attachments.a={point=[0, 0.03, 0], node=2}"]
    system = start(*bodies).system
    mobility = np.zeros((9, 9))
    for k, body in enumerate(system.bodies):
        own = np.flatnonzero(system.kinematics.body == k)
        levers = {system.kinematics.point[n]: np.cross(np.eye(3), system.kinematics.arm[n]) for n in own}
        for p, one in levers.items():
            for q, other in levers.items():
                turns = (
                    body.rotation @ one @ np.diag(1.0 / np.array(body.inertia)) @ other.T @ body.rotation.T
                )
                mobility[3 * p : 3 * p + 3, 3 * q : 3 * q + 3] = np.eye(3) / body.mass + turns
    stiffness = reference_tangent_stiffness(
        system.net, system.blocks.position, system.blocks.poses.net
    ).toarray()
    fastest = math.sqrt(np.abs(np.linalg.eigvals(mobility @ stiffness)).max())
    assert fastest <= largest_frequency(system) <= 3.0 * fastest


@pytest.mark.parametrize(
    ("key", "value", "fault"),
    [
        ("attachments.x.node", "7", "attachments.x.node"),
        ("attachments.x.bullet", "0", "attachments.x.bullet"),
        ("attachments.x.node", "", "attachments.x"),
        ("attachments.y", "{point=[0, 0, 0], node=0}", "attachments.y.node"),
        ("attachments.x.point", "[0, 0]", "attachments.x.point"),
        ("position", "[-9, 0, 0]", "attachments"),  # which stretches an element to 9.5 times its length
    ],
)
def test_wrong_keys_are_refused(key: str, value: str, fault: str) -> None:
    assert refused(CHAIN, *FIRST, f"bodies.first.{key}={value}") == [f"bodies.first.{fault}"]
    assert refused(CHAIN, *FIRST, "net.fixed=[0]") == ["bodies.first.attachments.x.node"]

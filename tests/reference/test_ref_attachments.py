"""Nodes that are points of bodies, and effects by the mass on bodies, in reference_impl."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from reference_impl import Refused, energy, prepare, read_document

BODY = {"mass": 2.0, "inertia": [1.0, 1.5, 2.0]}
LINK = {"nodes": [[1.0, 0, 0], [2.0, 0, 0]], "elements": [[0, 1]]}
TOW = {"cable": {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e7}, "node_masses": [0.5, 0.25]}


@pytest.fixture(scope="module")
def towing(explicit):
    """towing(point, effects, start, **body): a body whose point is node 0 of a net of one element."""

    def make(point=(1.0, 0.0, 0.0), effects=None, start=None, **body):
        case = explicit(**LINK, initial=start, **TOW)
        held = {**BODY, **body, "attachments": {"hook": {"point": list(point), "node": 0}}}
        return {**case, "bodies": {"tug": held}, "effects": effects or {}}

    return make


def test_mass_of_attached_nodes_is_the_bodys_by_steiners_theorem(towing, scene):
    """A point mass m at d beside M: reduced mass times d^2 about the common centre."""
    made = scene(towing(point=[3.0, 0.0, 0.0], centre_of_mass=[1.0, 0.0, 0.0]))
    m, bodies = 0.5 + 0.5e-3, made.system.bodies
    extra = 2.0 * m / (2.0 + m) * 4.0
    assert bodies.mass[0] == pytest.approx(2.0 + m, rel=1e-15)
    assert bodies.centre_of_mass[0] == pytest.approx([1.0 + 2.0 * m / (2.0 + m), 0.0, 0.0], rel=1e-15)
    assert bodies.inertia[0] == pytest.approx(np.diag([1.0, 1.5 + extra, 2.0 + extra]), rel=1e-14)
    total = made.net.own_mass.sum() + bodies.mass.sum()
    assert total == pytest.approx(2.0 + 0.75 + 1e-3, rel=1e-15)


@pytest.mark.ci
@pytest.mark.slow
def test_an_attached_node_follows_its_point_whatever_its_start(towing, scene):
    case = towing(start={"velocity": [7.0, 0, 0], "spin": [0.0, 0, 3.0]}, angular_velocity=[0.0, 0, 1.0])
    made = scene(case)
    centre = made.system.bodies.centre_of_mass[0]
    run = made.integrate([0.0, 0.3, 1.0])
    place = run.bodies.position[:, 0] + run.bodies.attitude[:, 0] @ (np.array([1.0, 0, 0]) - centre)
    assert run.x[:, 0] == pytest.approx(place, abs=1e-12)
    assert made.v0[0] == pytest.approx([0.0, 1.0 - centre[0], 0.0], abs=1e-15)


@pytest.mark.parametrize("arithmetic", [{}, {"assembled": True}, {"symmetric": True}], ids=str)
def test_books_close_with_damping_and_weight(towing, scene, unbalanced, arithmetic):
    effects = {
        "gravity": {"acceleration": [0.0, 0.0, -1.0]},
        "material_damping": {"relaxation_time": 1e-4},
        "rayleigh_damping": {"alpha": 0.2, "beta": 1e-5},
    }
    start = {"node_velocities": [[0.0, 0, 0], [0.3, 1.0, 0.2]]}
    made = scene(towing(effects=effects, start=start, angular_velocity=[1.0, 0.5, -1.0]), **arithmetic)
    run = made.integrate([0.0, 0.2, 0.5])
    assert unbalanced(made, run) < 1e-8
    assert run.dissipated[-1] > 0.0


def test_all_falls_alike(towing, scene):
    """Body, node of the body and the other node: g t^2/2, without a turn."""
    made = scene(towing(effects={"gravity": {"acceleration": [0.0, 0.5, -2.0]}}))
    run = made.integrate([0.0, 2.0])
    fall = np.array([0.0, 1.0, -4.0])
    assert run.x[1] - run.x[0] == pytest.approx(np.tile(fall, (2, 1)), abs=1e-12)
    assert run.bodies.position[1] - run.bodies.position[0] == pytest.approx(fall[None], abs=1e-12)
    assert run.bodies.attitude[1, 0] == pytest.approx(np.eye(3), abs=1e-14)


def test_damping_by_the_mass_slows_body_and_spin(towing, scene):
    case = towing(effects={"mass_damping": {"alpha": 0.5}}, velocity=[1.0, 2.0, 3.0])
    case["bodies"]["tug"] |= {
        "angular_velocity": [0.0, 0.0, 2.0],
        "position": [50.0, 0, 0],
        "attachments": {},
    }
    made = scene(case)
    run = made.integrate([0.0, 1.0])
    assert run.bodies.velocity[1, 0] == pytest.approx(np.array([1.0, 2.0, 3.0]) * math.exp(-0.5), rel=1e-9)
    assert run.bodies.angular_velocity[1, 0] == pytest.approx([0.0, 0.0, 2.0 * math.exp(-0.5)], rel=1e-9)
    lost = 0.5 * (2.0 * 14.0 + 2.0 * 4.0) * (1.0 - math.exp(-1.0))
    assert run.dissipated[1] == pytest.approx(lost, rel=1e-9)


N = 1e-3
ORBIT = {"mean_motion": N, "radial": [1.0, 0, 0], "along_track": [0.0, 1, 0]}


@pytest.fixture(scope="module")
def orbiting(explicit):
    """orbiting(model, time, effects, **body): a body alone in orbit."""

    def make(model, times, effects=None, **body):
        case = explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]], fixed=[0, 1])
        case["time"] = {"end": times[-1], "output_times": times}
        shown = {"orbit": {**ORBIT, "model": model}, **(effects or {})}
        return {**case, "bodies": {"sat": {**BODY, **body}}, "effects": shown}

    return make


@pytest.mark.parametrize("model", ["linear", "two_body"])
def test_gravity_gradient_libration(orbiting, scene, model):
    """Pitch has n sqrt(3 (I_along - I_radial)/I_normal) (Wertz, Spacecraft Attitude Determination, 18.3)."""
    angle, rate = 1e-3, N * math.sqrt(3.0 * (1.5 - 1.0) / 2.0)
    half = math.pi / rate
    made = scene(orbiting(model, [half, 2.0 * half], axis=[0.0, 0, 1.0], angle=angle))
    run = made.integrate()
    assert run.bodies.attitude[:, 0, 1, 0] == pytest.approx([angle, -angle, angle], abs=1e-5 * angle)
    assert np.abs(run.bodies.position).max() < 1e-6


@pytest.mark.ci
@pytest.mark.slow
def test_spin_in_orbit_agrees_with_eulers_equations_in_inertial_axes(orbiting, scene, unbalanced):
    """H' = 3 n^2 r x I r for the spin w + n h, in axes that do not turn."""
    inertia, n = np.diag(BODY["inertia"]), N
    spin = np.array([2.0 * n, -n, 3.0 * n])
    end = 2000.0
    made = scene(orbiting("linear", [end], angular_velocity=spin.tolist()))
    run = made.integrate()
    assert unbalanced(made, run) < 1e-9

    def rates(t, y):
        attitude, momentum = y[:9].reshape(3, 3), y[9:]
        turned = attitude @ inertia @ attitude.T
        w, r = np.linalg.solve(turned, momentum), np.array([math.cos(n * t), math.sin(n * t), 0.0])
        return np.concatenate((np.cross(w, attitude.T).T.ravel(), 3.0 * n * n * np.cross(r, turned @ r)))

    begin = np.concatenate((np.eye(3).ravel(), inertia @ (spin + np.array([0.0, 0.0, n]))))
    found = (
        solve_ivp(rates, (0.0, end), begin, rtol=1e-11, atol=1e-14, method="DOP853").y[:9, -1].reshape(3, 3)
    )
    c, s = math.cos(n * end), math.sin(n * end)
    to_scene = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    assert run.bodies.attitude[-1, 0] == pytest.approx(to_scene @ found, abs=1e-8)


def test_a_body_feels_what_two_far_nodes_feel(explicit, scene):
    """Two nodes on a light body: orbit with j2 turns it as it does one rigid body of the same J."""
    j2 = {**ORBIT, "inclination": 1.0, "argument_of_latitude": 0.7}
    effects = {"orbit": {**ORBIT, "model": "linear"}, "j2": j2}
    nodes = [[0.6, 0.8, 0.0], [-0.6, -0.8, 0.0]]
    case = explicit(nodes, [[0, 1]], node_masses=[3.0, 3.0])
    held = {f"n{k}": {"point": node, "node": k} for k, node in enumerate(nodes)}
    core = {"mass": 1.0, "inertia": [1e-3, 1e-3, 1e-3]}
    whole = scene({**case, "bodies": {"rod": {**core, "attachments": held}}, "effects": effects}).system
    m = whole.bodies.mass[0]
    beside = explicit([[50.0, 0, 0], [51.0, 0, 0]], [[0, 1]], fixed=[0, 1])
    inertia = whole.bodies.inertia[0]
    same = {
        "mass": m,
        "inertia": np.diag(inertia).tolist(),
        "products_of_inertia": [inertia[0, 1], inertia[0, 2], inertia[1, 2]],
    }
    other = scene({**beside, "bodies": {"rod": same}, "effects": effects})
    times = [0.0, 150.0, 300.0]
    first = scene({**case, "bodies": {"rod": {**core, "attachments": held}}, "effects": effects}).integrate(
        times
    )
    assert other.integrate(times).bodies.attitude == pytest.approx(first.bodies.attitude, abs=1e-10)
    assert abs(first.bodies.attitude[-1, 0, 1, 0]) > 1e-4


@pytest.mark.parametrize(
    ("hooks", "words"),
    [
        ({"a": {"point": [1.0, 0, 0], "node": 5}}, "there is no node 5"),
        ({"a": {"point": [1.0, 0, 0], "bullet": 0}}, "there is no bullet 0"),
        ({"a": {"point": [1.0, 0, 0]}}, "give exactly one of bodies.tug.attachments.a.node and"),
        ({"a": {"point": [1.0, 0, 0], "node": 0, "bullet": 0}}, "give exactly one of"),
        ({"a": {"node": 0}}, "bodies.tug.attachments.a.point: missing"),
        (
            {"a": {"point": [1.0, 0, 0], "node": 0}, "b": {"point": [2.0, 0, 0], "node": 0}},
            "attached 2 times",
        ),
        ({"a": {"point": [1.0, 0, 0], "node": 1}}, "node 1 is one of net.fixed"),
        ({"a": {"point": [1.0, 0, 0], "node": 0, "glue": 1}}, "reference_impl does not know"),
        ({"a": 3}, "bodies.tug.attachments.a: must be a table"),
    ],
)
def test_bad_attachments_are_refused(towing, hooks, words):
    case = towing()
    case["net"]["fixed"] = [1]
    case["bodies"]["tug"]["attachments"] = hooks
    with pytest.raises(Refused) as refused:
        read_document(case)
    assert any(words in fault for fault in refused.value.faults), refused.value.faults


def test_em_refuses_points_of_bodies(towing):
    made = prepare(read_document(towing()))
    with pytest.raises(ValueError, match="points of bodies"):
        made.integrate(method="EM", step=0.1)


@pytest.mark.slow
def test_a_launched_bullet_can_be_held(document, scene):
    """Its mass is the body's, the launch leaves it alone, strings break, and the books close."""
    case = document("square", size=2.0, cable={"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e8})
    case["initial"] = {"packing": 0.95}
    case["effects"] = {"breaking": {"strain": 0.02}}
    case["bodies"] = {"tug": {**BODY, "attachments": {"k": {"point": [0.1, 0, 0], "bullet": 1}}}}
    made = scene(case)
    node = made.net.numbered_bullets[1]
    assert not made.v0[node].any()
    assert made.net.mass[node] > 0.5
    assert made.net.own_mass[node] == 0.0
    run = made.integrate([0.0, 0.1])
    assert run.breaks
    books = energy.books(made.system, run)
    assert books.momentum[1] == pytest.approx(books.momentum[0], abs=1e-11)
    assert books.total[1] == pytest.approx(books.total[0], rel=1e-7)


def test_the_chaser_of_a_launch_falls_with_the_net(scene, unbalanced):
    """It is a free body, without attitude; all that is not held falls alike."""
    weight = {
        "effects.gravity": {"acceleration": [0.0, 0.5, -2.0]},
        "time.end": 0.05,
        "time.output_step": 0.05,
    }
    made = scene("effects/launch_force.toml", weight)
    run = made.integrate()
    books = energy.books(made.system, run)
    mass = made.net.mass.sum() + made.system.bodies.mass.sum()
    gained = books.momentum[-1] - books.momentum[0]
    assert gained == pytest.approx(mass * 0.05 * np.array([0.0, 0.5, -2.0]), abs=1e-11)
    assert unbalanced(made, run) < 1e-9


def test_light_and_thrust_on_a_fixed_body_change_nothing_else(document, scene, unbalanced):
    """Their work would be done on what holds the body; the books of all else close without it."""
    light = {"flux": 1e9, "direction": [1.0, 0, 0], "pressure_coefficient": 1.0, "bullet_area": 0.1}
    thrust = {"bullets": [1], "time": [0.0, 1.0], "force": [[5.0, 0, 0], [5.0, 0, 0]]}
    case = document("radial", cable={"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e7})
    case["net"]["strings"] = {**case["net"]["strings"], "youngs_modulus": 1e7}
    hook = {"attachments": {"k": {"point": [0.3, 0.3, 0], "bullet": 1}}}
    guided = {**BODY, **hook, "motion": "prescribed", "velocity": [2.0, 0.5, 0]}
    case |= {"bodies": {"tug": guided}, "effects": {"solar_pressure": light, "thrust": thrust}}
    made = scene(case)
    run = made.integrate([0.0, 0.1, 0.3])
    assert unbalanced(made, run) < 1e-8

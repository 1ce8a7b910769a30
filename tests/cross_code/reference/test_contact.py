"""Contact in reference_impl: bounces, sliding and sticking, threads on faces and edges, balances."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from reference_impl import acceleration, contact_forces, energy
from reference_impl.effects.contact import braking
from reference_impl.integration import Pierced

PLATE = {
    "mass": 1.0,
    "shape": "box",
    "size": [4.0, 4.0, 0.2],
    "edge_radius": 0.05,
    "motion": "fixed",
    "position": [0.0, 0.0, -0.1],
}
BALL = {"mass": 1.0, "shape": "sphere", "radius": 0.1, "motion": "fixed"}
SMOOTH = {"bullets": ["target"], "bullet_radius": 0.02}
LINEAR = {**SMOOTH, "law": "linear", "bullet_stiffness": 1e4, "damping": 0.0}
HERTZ = {**SMOOTH, "law": "hertz", "modulus": 1e7, "damping": 0.0}
STUCK = {"law": "sticking", "coefficient": 0.3}
STICKING = {**LINEAR, "friction": STUCK}
REGULARISED = {**LINEAR, "friction": {"law": "regularised", "coefficient": 0.3, "slip_speed": 0.01}}
QUICK = {"rtol": 1e-8, "atol": 1e-10}


@pytest.fixture(scope="module")
def bullets():
    """bullets(body, contact, height, velocity, **effects): four bullets of 0.5 kg on a net that stays slack.

    They start 0.5 m apart in z = 0, on cables that are 1 m long and next to massless; the body is lowered by
    the height.
    """

    def make(body, contact, height, velocity=(0.0, 0.0, -1.0), **effects):
        x, y, z = body.get("position", [0.0, 0.0, 0.0])
        return {
            "format": 1,
            "title": "bullets",
            "time": {"end": 1.0, "output_step": 0.1},
            "net": {
                "topology": "square",
                "size": 1.0,
                "mesh": 1.0,
                "cable": {"diameter": 1e-3, "density": 1e-3, "youngs_modulus": 1e3},
                "bullets": {"mass": 0.5},
            },
            "initial": {"packing": 0.5, "velocity": list(velocity)},
            "bodies": {"target": {**body, "position": [x, y, z - height]}},
            "effects": {"contact": dict(contact), **effects},
        }

    return make


@pytest.fixture(scope="module")
def thread(explicit):
    """thread(places, body, contact, velocities): one element of 1 m between two nodes of 0.1 kg, slack."""

    def make(places, body, contact=None, velocities=None):
        initial = {"node_positions": places}
        if velocities is not None:
            initial["node_velocities"] = velocities
        case = explicit([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0, 1]], initial, node_masses=[0.1, 0.1])
        law = {"threads": ["target"], "law": "linear", "stiffness": 1e4, "damping": 0.0}
        case["bodies"] = {"target": body}
        contact = {**law, **(contact or {})}
        case["effects"] = {"contact": {key: value for key, value in contact.items() if value is not None}}
        return case

    return make


def views(made, x=None):
    """What the bodies see of the net at places x (n, 3)."""
    x = made.x0 if x is None else x
    return contact_forces.view_of_states(made.system, x, made.v0, made.bodies0, None, packed=False)


def forces(made, x=None, v=None):
    """Forces (n, 3) [N] on the nodes."""
    x, v = (made.x0 if x is None else x), (made.v0 if v is None else v)
    return made.net.mass[:, None] * acceleration(made.system, 0.0, x, v, made.bodies0)


@pytest.mark.parametrize("e", [1.0, 1.0 - 1e-9, 0.9, 0.5, 0.2])
def test_damping_of_a_restitution(e):
    """d (1 + e) = ln((1 + d)/(1 - e d)): the equation itself; near e = 1 its series, d = 3 (1 - e)/2."""
    d = braking(e)
    if e > 0.99:
        assert d == pytest.approx(1.5 * (1.0 - e), rel=1e-6)
    else:
        assert d > 0.0
        assert math.log((1.0 + d) / (1.0 - e * d)) == pytest.approx(d * (1.0 + e), rel=1e-13)


@pytest.mark.ci_for("100000.0")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("e", "stiffness", "shape"),
    [(0.9, 1e4, "box"), (0.5, 1e5, "box"), (0.5, 1e7, "ball"), (0.2, 1e6, "ball")],
)
def test_a_bullet_leaves_with_the_restitution(bullets, scene, e, stiffness, shape):
    """v0 in, e v0 out, whatever stiffness and exponent: the case format says so."""
    body, height = (PLATE, 0.03) if shape == "box" else ({**BALL, "position": [0.25, 0.25, 0.0]}, 0.13)
    law = {**LINEAR, "bullet_stiffness": stiffness} if shape == "box" else {**HERTZ, "modulus": stiffness}
    del law["damping"]
    made = scene(bullets(body, {**law, "restitution": e, "impact_speed": 1.0}, height))
    run = made.integrate([0.0, 0.1], **QUICK)
    hit = made.net.numbered_bullets[2]  # upper right
    assert run.v[-1, hit] == pytest.approx([0.0, 0.0, e], abs=1e-6)
    lost = (4 if shape == "box" else 1) * 0.25 * (1.0 - e**2)
    assert run.rubbing[-1] == pytest.approx([lost, 0.0], abs=1e-6)


FREE = {
    "mass": 2.0,
    "shape": "box",
    "size": [0.5, 0.6, 0.4],
    "edge_radius": 0.05,
    "position": [0.1, 0.15, -0.2],
    "velocity": [0.1, 0.0, 0.2],
    "angular_velocity": [0.5, -0.3, 0.4],
    "centre_of_mass": [0.02, -0.01, 0.03],
    "inertia": [0.1, 0.12, 0.09],
    "products_of_inertia": [0.01, -0.005, 0.0],
}


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [LINEAR, REGULARISED, pytest.param(STICKING, marks=SLOW)],
    ids=["smooth", "regularised", "sticking"],
)
def test_what_a_free_box_gets(bullets, scene, unbalanced, law):
    """A bullet that hits off centre: momentum, angular momentum and energy of both are kept."""
    case = bullets(FREE, {**law, "damping": 0.5}, 0.03, (0.4, 0.2, -1.0))
    made = scene(case)
    run = made.integrate([0.0, 0.03, 0.1], **QUICK)
    books = energy.books(made.system, run)
    assert np.linalg.norm(run.bodies.velocity[-1, 0] - FREE["velocity"]) > 0.05
    assert np.abs(books.momentum - books.momentum[0]).max() < 1e-13
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < 1e-10
    assert unbalanced(made, run) < 1e-7
    assert books.dissipated == pytest.approx(run.rubbing.sum(axis=1), abs=1e-12)
    assert run.rubbing[-1, 0] > 0.01
    assert (run.rubbing[-1, 1] > 1e-3) == (law is not LINEAR)


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["fixed", "prescribed"])
def test_what_a_driven_body_gives(bullets, scene, unbalanced, motion):
    """Momentum less impulse, angular momentum less angular impulse, energy less work are kept."""
    still = {key: value for key, value in FREE.items() if key not in ("velocity", "angular_velocity")}
    body = {**(FREE if motion == "prescribed" else still), "motion": motion}
    made = scene(bullets(body, REGULARISED, 0.03, (0.4, 0.2, -1.0)))
    run = made.integrate([0.0, 0.1])
    books = energy.books(made.system, run)
    assert unbalanced(made, run) < 1e-8
    for kept, given in (("momentum", "impulse"), ("angular_momentum", "angular_impulse")):
        rest = getattr(books, kept) - getattr(run.given, given)[:, 0]
        assert np.abs(rest - rest[0]).max() < 1e-9
    assert np.linalg.norm(run.given.impulse[-1, 0]) > 0.1
    assert (abs(run.given.work[-1, 0]) > 1e-3) == (motion == "prescribed")


FLAT = {**PLATE, "size": [4.0, 4.0, 0.4], "position": [0.0, 0.0, -0.2]}
RADIUS = 0.001  # of the thread, half of the diameter that all nets of these tests have


def test_a_thread_flat_on_a_face(thread, scene):
    """p linear along the thread: forces K L (p_i/3 + p_j/6) and K L (p_i/6 + p_j/3), energy K L (..)/6."""
    p = np.array([0.004, 0.01])
    places = [[-0.4, 0.0, RADIUS - p[0]], [0.5, 0.1, RADIUS - p[1]]]
    made = scene(thread(places, FLAT))
    expected = 1e4 * np.array([p[0] / 3.0 + p[1] / 6.0, p[0] / 6.0 + p[1] / 3.0])
    assert forces(made)[:, 2] == pytest.approx(expected, rel=1e-11)
    assert np.abs(forces(made)[:, :2]).max() < 1e-10
    view = views(made)
    stored = 1e4 * (p[0] ** 2 + p[0] * p[1] + p[1] ** 2) / 6.0
    assert contact_forces.stored(made.system.contacts, view) == pytest.approx(stored, rel=1e-11)
    assert contact_forces.deepest(view).depth == pytest.approx(0.01, rel=1e-12)


def test_a_thread_under_hertz(thread, scene):
    """K = pi/4 E* (Johnson, Contact Mechanics, 4.2, as the case format has it)."""
    places = [[-0.4, 0.0, RADIUS - 0.004], [0.5, 0.0, RADIUS - 0.004]]
    made = scene(thread(places, FLAT, {"law": "hertz", "modulus": 1e5, "stiffness": None}))
    assert forces(made)[:, 2] == pytest.approx(0.5 * math.pi / 4.0 * 1e5 * 0.004, rel=1e-11)


def by_quad(case, x, v, damping=0.0):
    """Forces on both nodes by SciPy's quadrature, with a distance from a rounded box written here."""
    body = case["bodies"]["target"]
    rho, half = body["edge_radius"], 0.5 * np.array(body["size"])
    core, middle = half - rho, np.array(body["position"])

    def density(s, part, component):
        place, w = (1.0 - s) * x[0] + s * x[1] - middle, (1.0 - s) * v[0] + s * v[1]
        away = np.sign(place) * np.maximum(np.abs(place) - core, 0.0)
        distance = math.sqrt(float(away @ away))
        p = rho + RADIUS - distance
        if p <= 0.0:
            return 0.0
        n = away / distance
        weight = s if part else 1.0 - s
        return weight * 1e4 * p * max(1.0 - damping * float(n @ w), 0.0) * n[component]

    places = np.linspace(0.0, 1.0, 201)  # so that no kink is far from the end of an interval

    def whole(part, component):
        return sum(
            quad(density, a, b, (part, component), epsabs=1e-13, epsrel=1e-12)[0]
            for a, b in pairwise(places.tolist())
        )

    return np.array([[whole(part, c) for c in range(3)] for part in (0, 1)])


@pytest.mark.ci
@pytest.mark.slow
def test_a_thread_across_an_edge(thread, scene):
    """From a face round the edge to the next one, with damping that ends on part of the way."""
    places = np.array([[1.75, -0.1, 0.012], [2.03, 0.2, -0.05]])
    speeds = np.array([[0.0, 0.1, 1.5], [-0.6, 0.3, -1.0]])
    case = thread(places.tolist(), FLAT, {"damping": 1.0}, speeds.tolist())
    made = scene(case)
    expected = by_quad(case, places, speeds, 1.0)
    assert np.abs(expected).max() > 1.0
    found = forces(made)
    assert np.abs(found[:, [0, 2]]).min() > 0.01
    assert found == pytest.approx(expected, abs=1e-9)


def test_forces_are_continuous_where_a_thread_becomes_parallel_to_a_face(thread, scene):
    """Tilted by 1e-3 to 1e-17 and not at all: forces as of the linear depth, to round-off."""
    made = scene(thread([[-0.45, 0.0, -0.004], [0.45, 0.0, -0.004]], FLAT))
    for tilt in (1e-3, 1e-6, 1e-9, 1e-13, 1e-15, 1e-17, 0.0, -1e-9):
        x = made.x0 + np.array([[0.0, 0.0, tilt], [0.0, 0.0, -tilt]])
        p = RADIUS - x[:, 2]
        expected = 1e4 * np.array([p[0] / 3.0 + p[1] / 6.0, p[0] / 6.0 + p[1] / 3.0])
        assert forces(made, x)[:, 2] == pytest.approx(expected, rel=1e-11)


COMPOUND = {
    "mass": 1.0,
    "edge_radius": 0.05,
    "motion": "fixed",
    "parts": {
        "box": {"shape": "box", "size": [0.6, 0.4, 0.3]},
        "ball": {"shape": "sphere", "radius": 0.2, "position": [0.25, 0.05, 0.1]},
    },
}


def test_forces_of_a_compound_are_the_slope_of_its_energy(thread, scene):
    """-dU/dx by central differences; the thread lies in the hollow between both parts."""
    made = scene(thread([[0.0, 0.02, 0.155], [0.2, 0.1, 0.28]], COMPOUND))
    found = forces(made)
    assert np.abs(found).max() > 10.0
    for node, axis in np.ndindex(2, 3):
        stored = []
        for side in (-1.0, 1.0):
            x = made.x0.copy()
            x[node, axis] += side * 1e-6
            stored.append(contact_forces.stored(made.system.contacts, views(made, x)))
        assert found[node, axis] == pytest.approx(-(stored[1] - stored[0]) / 2e-6, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("friction", ["regularised", pytest.param("sticking", marks=SLOW)])
def test_a_thread_thrown_over_a_free_box(explicit, scene, unbalanced, friction):
    """Momenta to round-off, energy to the accuracy of the method, as four elements hit, slide and stick."""
    nodes = [[0.25 * i, 0.0, 0.0] for i in range(5)]
    places = [[0.225 * i - 0.3, 0.05 * math.sin(i), 0.25 + 0.02 * math.cos(2 * i)] for i in range(5)]
    start = {"node_positions": places, "velocity": [0.1, 0.3, -1.0]}
    case = explicit(nodes, [[i, i + 1] for i in range(4)], start, node_masses=[0.1] * 5)
    case["net"]["cable"] = {"diameter": 0.004, "density": 1000.0, "youngs_modulus": 1e7}
    case["bodies"] = {
        "target": {
            "mass": 2.0,
            "shape": "box",
            "size": [0.5, 0.4, 0.3],
            "edge_radius": 0.04,
            "angular_velocity": [0.5, -1.0, 0.3],
            "attitude": [1.0, 0.1, 0.2, -0.1],
        }
    }
    law = {"threads": ["target"], "law": "linear", "stiffness": 5e4, "restitution": 0.5, "impact_speed": 1.0}
    slip = {"slip_speed": 0.01} if friction == "regularised" else {}
    case["effects"] = {"contact": {**law, "friction": {"law": friction, "coefficient": 0.3, **slip}}}
    made = scene(case)
    run = made.integrate([0.0, 0.03, 0.06], rtol=1e-7, atol=1e-9)
    books = energy.books(made.system, run)
    assert np.abs(books.momentum - books.momentum[0]).max() < 1e-13
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < 1e-8
    assert unbalanced(made, run) < 1e-5
    assert run.rubbing[-1].min() > 1e-4
    assert energy.depth(made.system, run).max() > 1e-4


def test_what_ends_in_a_node_of_the_body_does_not_touch_it(thread, scene):
    places = [[0.0, 0.0, 0.0], [0.5, 0.0, -0.004]]
    case = thread(places, FLAT)
    assert np.abs(forces(scene(case))).max() > 1.0
    case["bodies"]["target"] = {**FLAT, "attachments": {"a": {"node": 0, "point": [0.0, 0.0, 0.2]}}}
    assert np.abs(forces(scene(case))).max() == 0.0


@pytest.mark.ci_for("sticking")
@pytest.mark.slow
@pytest.mark.parametrize("law", [LINEAR, STICKING], ids=["smooth", "sticking"])
def test_a_packed_net_touches_nothing_until_it_is_ejected(bullets, scene, unbalanced, law):
    """5 mm deep in the plate that holds them: k p^2/2 each is there from the ejection on, put in by it."""
    case = bullets({**PLATE, "position": [0.0, 0.0, 0.0]}, law, 0.0, (0.1, 0.0, 0.0))
    case["initial"]["frame"] = {
        "body": "target",
        "position": [0.0, 0.0, 0.1 + 0.02 - 0.005],
        "eject_at": 0.01,
    }
    made = scene(case)
    run = made.integrate([0.0, 0.009, 0.01, 0.06], **QUICK)
    stored = 4 * 0.5 * 1e4 * 0.005**2
    assert energy.contact(made.system, run) == pytest.approx([0.0, 0.0, stored, 0.0], rel=1e-9, abs=1e-12)
    assert np.array_equal(run.x[1], run.x[0])
    assert run.v[3, 0, 2] == pytest.approx(math.sqrt(2.0 * stored / 2.0), rel=1e-3)  # each of 0.5 kg
    assert unbalanced(made, run) < 1e-3


def test_how_deep_a_thread_may_be(thread, scene):
    """At most the edge_radius, 0.05 m, beside the radius; half of the half-thickness, 0.1 m, is more."""
    for height, deep in ((-0.06, True), (-0.0499, False)):
        made = scene(thread([[-0.4, 0.0, height], [0.5, 0.0, height]], FLAT))
        assert (contact_forces.deepest(views(made)).over > contact_forces.TOO_DEEP) == deep


@pytest.mark.ci
@pytest.mark.slow
def test_a_run_that_goes_too_deep_is_stopped(bullets, scene):
    """v sqrt(m/k) = 1 m is far more than r + 0.05 m; a step does not pass over that either."""
    made = scene(bullets(PLATE, {**LINEAR, "bullet_stiffness": 0.5}, 0.5))
    with pytest.raises(Pierced, match=r"bullet 0 is deeper in the body target than 0\.07 m, at t ="):
        made.integrate([0.0, 1.0])

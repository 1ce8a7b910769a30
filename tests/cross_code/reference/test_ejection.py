"""A packed net that a body holds until it ejects it, in reference_impl: balances, and the ejection itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reference_impl import acceleration, energy
from reference_impl.bodies import loaded
from reference_impl.jumps import eject
from reference_impl.state import layout

SOFT = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 5e5}
BODY = {
    "mass": 6.0,
    "inertia": [0.8, 1.0, 1.2],
    "products_of_inertia": [0.1, -0.15, 0.05],
    "centre_of_mass": [0.1, -0.2, 0.3],
    "position": [0.5, 0.6, 0.7],
    "velocity": [0.3, -0.2, 0.1],
    "attitude": [1.0, 0.5, -0.2, 0.3],
    "angular_velocity": [0.5, 1.0, -1.5],
}
FIXED = {key: value for key, value in BODY.items() if "velocity" not in key} | {"motion": "fixed"}
FRAME = {"body": "chief", "position": [0.2, 0.4, 0.8], "axis": [1.0, 2.0, 0.5], "angle": 0.7}
PUSH = {"velocity": [0.2, -0.1, 0.4], "spin": [0.3, -0.5, 0.8]}
LINE = {"area": 1e-5, "density": 4000.0, "youngs_modulus": 1e6, "length": 1.7, "divisions": 4}
ORBIT = {"mean_motion": 0.3, "radial": [1.0, 0, 0], "along_track": [0.0, 1.0, 0], "model": "linear"}
EJECTED = 0.15  # [s]
TIMES = [0.0, 0.1, EJECTED, 0.18, 0.2]
FINE = {"rtol": 1e-11, "atol": 1e-12}


@pytest.fixture(scope="module")
def held(document):
    """held(initial, body, **more): a net nearly taut, its bullets of 0.3 kg, and a body that holds it."""

    def make(initial=None, body=BODY, **more):
        strings, bullets = {**SOFT, "length": 0.3}, {"mass": 0.3}
        case = document("square", size=1.0, mesh=0.5, cable=SOFT, strings=strings, bullets=bullets)
        case["initial"] = {"packing": 0.9, "frame": {**FRAME, "eject_at": EJECTED}, **(initial or {})}
        case["launch"] = {"radial_speed": 2.5, "axial_speed": 1.5}
        case["bodies"] = {"chief": body}
        case["time"] = {"end": 0.3, "output_times": TIMES[1:]}
        return {**case, **more}

    return make


def packed_places(made):
    """Places (n, 3) [m] of the net's nodes in the frame of the body, from the keys of the case."""
    turn = Rotation.from_rotvec(0.7 * np.array([1.0, 2.0, 0.5]) / math.sqrt(5.25)).as_matrix()
    return FRAME["position"] + 0.9 * made.net.reference_position[: made.net.woven] @ turn.T, turn


def start_of(made):
    """The array of the state at time 0, and its layout."""
    where = layout(made.system)
    return where, where.pack(made.x0, made.v0, made.bodies0)


def books_of(made, where, y):
    """Momentum, angular momentum and energy of an array of a state."""
    whole, bodies = where.whole(y), where.body_states(y)
    x, v = whole.x[: where.nodes], whole.v[: where.nodes]
    inside, outlets = energy.at_outlets(made.system, x, where.wound(y))
    stored = energy.elastic(made.system, x, inside) + outlets + energy.potential(made.system, x, bodies)
    return (
        energy.momentum(made.system, v, bodies),
        energy.angular_momentum(made.system, x, v, bodies),
        float(stored + energy.kinetic(made.system, v, bodies)),
    )


def later(case, run, k):
    """The case with the body as it is at the k-th stored time, and the net thrown from there at time 0."""
    (body,) = case["bodies"]
    attitude = run.bodies.attitude[k, 0]
    now = {
        "position": (run.bodies.position[k, 0] - attitude @ BODY["centre_of_mass"]).tolist(),
        "attitude": Rotation.from_matrix(attitude).as_quat(scalar_first=True).tolist(),
        "velocity": run.bodies.velocity[k, 0].tolist(),
        "angular_velocity": run.bodies.angular_velocity[k, 0].tolist(),
    }
    return {**case, "initial": {"packing": 0.9, "frame": FRAME}, "bodies": {body: {**BODY, **now}}}


# before the ejection


def test_body_and_net_move_as_one_rigid_body(held, scene, document):
    """The body with the masses of the nodes built in, in Hill's frame: with torques of gravity and turning.

    `velocity` is that of the body's own centre of mass, which results give too.
    """
    made = scene(held(PUSH, effects={"orbit": ORBIT}))
    run = made.integrate([0.0, 0.07, 0.14])
    (body,) = made.case.bodies
    both = loaded(body, made.net.mass, packed_places(made)[0])
    shift = both.centre_of_mass - body.centre_of_mass
    lever, moments = body.attitude @ shift, both.inertia
    case = document("square", size=1.0)
    case["bodies"] = {
        "both": {
            "mass": both.mass,
            "inertia": np.diagonal(moments).tolist(),
            "products_of_inertia": [moments[0, 1], moments[0, 2], moments[1, 2]],
            "centre_of_mass": both.centre_of_mass.tolist(),
            "position": BODY["position"],
            "attitude": BODY["attitude"],
            "velocity": (body.velocity + np.cross(body.attitude @ body.angular_velocity, lever)).tolist(),
            "angular_velocity": BODY["angular_velocity"],
        }
    }
    del case["launch"]
    alone = scene({**case, "initial": {"packing": 0.0}, "effects": {"orbit": ORBIT}}).integrate(run.t)
    moved = run.bodies.position[:, 0] + run.bodies.attitude[:, 0] @ shift
    assert run.bodies.attitude == pytest.approx(alone.bodies.attitude, abs=1e-10)
    assert run.bodies.angular_velocity == pytest.approx(alone.bodies.angular_velocity, abs=1e-9)
    assert moved == pytest.approx(alone.bodies.position[:, 0], abs=1e-10)
    assert np.linalg.norm(shift) > 0.1


def test_what_acts_on_a_held_node_acts_on_body_and_net_as_one(held, scene):
    """Newton's and Euler's equations of the body with the nodes' masses: weight, thrust on a bullet, and the
    pull of a tether of one element between another bullet and a second body, E A E11 L/L0 along it."""
    thrust, g = [3.0, -2.0, 1.0], np.array([0.5, -1.0, -2.0])
    made = scene(
        held(
            effects={
                "gravity": {"acceleration": g.tolist()},
                "thrust": {"bullets": [0], "time": [0.0, 1.0], "force": [thrust, thrust]},
                "thermal_strain": {"temperature_change": -100.0, "expansion_coefficient": 1e-3},
            },
            bodies={
                "chief": BODY,
                "target": {"mass": 3.0, "inertia": [1.0] * 3, "position": [3.0, 2.0, 1.0]},
            },
            tethers={
                "line": {
                    **LINE,
                    "divisions": 1,
                    "length": 3.2,
                    "start": {"bullet": 2},
                    "end": {"body": "target"},
                }
            },
        )
    )
    body, target = made.case.bodies
    nodes = slice(made.net.woven)
    both = loaded(body, made.net.mass[nodes], packed_places(made)[0])
    centre = body.at(both.centre_of_mass)[0]
    inertia, w = body.attitude @ both.inertia @ body.attitude.T, body.attitude @ body.angular_velocity
    pushed, pulled = made.net.numbered_bullets[[0, 2]]
    way = target.position - made.x0[pulled]
    distance, free = np.linalg.norm(way), -0.1 + 0.5 * 0.1**2
    tension = 1e-5 * 1e6 * (0.5 * (distance**2 / 3.2**2 - 1.0) - free) * way / 3.2
    force = tension + thrust + both.mass * g
    torque = np.cross(made.x0[pulled] - centre, tension) + np.cross(made.x0[pushed] - centre, thrust)
    angular = np.linalg.solve(inertia, torque - np.cross(w, inertia @ w))
    lever = made.x0[nodes] - centre
    expected = force / both.mass + np.cross(angular, lever) + np.cross(w, np.cross(w, lever))
    got = acceleration(made.system, 0.0, made.x0, made.v0, made.bodies0)
    assert got[nodes] == pytest.approx(expected, abs=1e-12)
    assert np.linalg.norm(tension) > 0.5


# the ejection


def test_each_node_gets_its_velocity_and_all_momenta_stay(held, scene):
    """Beside the velocity with the body before: R A (velocity + spin x p + throw), p the packed place.

    Momenta of 4 kg m/s and 8 kg m2/s to round-off; what the energy rises by is booked.
    """
    made = scene(held(PUSH))
    where, y = start_of(made)
    after = eject(where, y)
    (body,) = made.case.bodies
    p = 0.9 * made.net.reference_position
    turn = body.attitude @ packed_places(made)[1]
    throw = np.zeros_like(p)
    corner = p[made.net.bullet_nodes, :2]
    throw[made.net.bullet_nodes, :2] = 2.5 * corner / np.linalg.norm(corner, axis=1)[:, None]
    throw[made.net.bullet_nodes, 2] = 1.5
    given = PUSH["velocity"] + np.cross(PUSH["spin"], p) + throw
    assert where.whole(after).x == pytest.approx(where.whole(y).x, abs=0.0)
    assert where.whole(after).v[: where.nodes] == pytest.approx(made.v0 + given @ turn.T, abs=1e-14)
    old, new = (books_of(made, where, state) for state in (y, after))
    assert new[0] == pytest.approx(old[0], abs=1e-14)
    assert new[1] == pytest.approx(old[1], abs=2e-14)
    assert new[2] + after[-1] == pytest.approx(old[2] + y[-1], abs=1e-13)
    assert after[-1] < -5.0


@pytest.mark.parametrize(
    ("options", "booked", "kept"),
    [
        (FINE, 1e-10, 1e-12),
        ({"method": "RK45", "rtol": 1e-8, "atol": 1e-11}, 1e-7, 1e-9),
    ],
    ids=["DOP853", "RK45"],
)
def test_books_close_over_the_ejection(held, scene, options, booked, kept):
    """14 J, of which 9 J are put in, 4 kg m/s, 8 kg m2/s; the net is taut after the ejection."""
    made = scene(held(PUSH))
    run = made.integrate(TIMES, **options)
    books = energy.books(made.system, run)
    assert np.abs(books.momentum - books.momentum[0]).max() < kept
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < kept
    assert np.abs(books.total - books.total[0]).max() < booked * books.kinetic.max()
    assert np.all(books.dissipated[:2] == 0.0)
    assert np.all(books.dissipated[2:] < -5.0)
    assert books.elastic[-1] > 0.03


@pytest.mark.ci
@pytest.mark.slow
def test_the_same_as_a_net_thrown_at_that_instant(held, scene):
    """A second case starts with the body where the first has it then, and throws at time 0."""
    case = held()
    waiting = scene(case, {"initial.frame.eject_at": 0.29}).integrate([0.0, EJECTED], **FINE)
    run = scene(case).integrate(TIMES, **FINE)
    other = scene(later(case, waiting, -1)).integrate(np.array(TIMES[2:]) - EJECTED, **FINE)
    for key in ("x", "v"):
        assert getattr(run, key)[2:] == pytest.approx(getattr(other, key), abs=1e-9)
    for key in ("position", "velocity", "attitude", "angular_velocity"):
        assert getattr(run.bodies, key)[2:] == pytest.approx(getattr(other.bodies, key), abs=1e-9)
    assert np.abs(run.x[-1] - run.x[2]).max() > 0.1


LED = {
    key: value for key, value in BODY.items() if "velocity" not in key and key not in ("position", "attitude")
}
LED |= {
    "motion": "prescribed",
    "pose_times": [0.0, 0.1, 0.3],
    "pose_positions": [[0.5, 0.6, 0.7], [0.6, 0.4, 0.7], [0.7, 0.5, 0.4]],
    "pose_attitudes": [[1.0, 0.5, -0.2, 0.3], [1.0, 0.4, -0.1, 0.5], [1.0, 0.1, -0.1, 0.4]],
}


STEADY = {**BODY, "motion": "prescribed"}


@pytest.mark.parametrize("body", [BODY, FIXED, STEADY], ids=["free", "fixed", "steady"])
@pytest.mark.parametrize("tied", [False, True])
def test_an_ejection_at_the_start_is_the_limit_of_a_later_one(held, scene, body, tied):
    """At 0 and at 1e-9 s, motion and balances: what 1e-9 s do is 1e-9 times rates of at most 1e3 a second."""
    case = held(PUSH, body)
    if tied:
        case["tethers"] = {
            "line": {**LINE, "length": 4.0, "start": {"body": "chief"}, "end": {"bullet": 1}},
        }
    runs = []
    for at in (0.0, 1e-9):
        made = scene(case, {"initial.frame.eject_at": at})
        run = made.integrate([0.0, 1e-3, 2e-3], **FINE)
        books = energy.books(made.system, run)
        given = run.given.impulse, run.given.angular_impulse, run.given.work
        moving = run.x, run.v, run.bodies.velocity, run.bodies.angular_velocity
        runs.append([values[1:] for values in (*moving, run.dissipated, *given)])
        assert np.abs(books.total - books.total[0]).max() < 1e-9
        assert (
            np.abs(books.momentum - given[0].sum(axis=1) - books.momentum[0] + given[0][0].sum(axis=0)).max()
            < 1e-10
        )
    for now, later in zip(*runs, strict=True):
        assert now == pytest.approx(later, rel=1e-6, abs=1e-6)
    assert runs[0][4][0] < -1.0

"""Tethers of reference_impl: known answers, conservation, places, mass, bad input."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from reference_impl import BodyStates, Refused, acceleration, energy, prepare, read_document

THREAD = {"area": 1e-6, "density": 1e-9, "youngs_modulus": 1e9}  # E A = 1000 N, next to no mass
FAR = {"nodes": [[100.0, 0, 0], [101.0, 0, 0]], "elements": [[0, 1]], "fixed": [0, 1]}


@pytest.fixture(scope="module")
def tied(explicit):
    """tied(tether, bodies, effects, **net): a case of bodies and a tether, far from a net at rest."""

    def make(tether, bodies, effects=None, **net):
        case = explicit(**{**FAR, **net})
        tethers = {"line": {**THREAD, **tether}} if tether else {}
        return {**case, "bodies": bodies, "tethers": tethers, "effects": effects or {}}

    return make


def ball(mass, **keys):
    return {"mass": mass, "inertia": [0.4 * mass] * 3, **keys}


def angular(run, system):
    return energy.books(system, run).angular_momentum


@pytest.mark.ci
@pytest.mark.slow
def test_two_bodies_snap(tied, scene):
    """A slack line runs out at the speed v: greatest E11 = v sqrt(mu/(E A L0)), mu the reduced mass."""
    v, length, m1, m2 = 0.5, 2.0, 3.0, 6.0
    made = scene(
        tied(
            {"length": length, "start": {"body": "a"}, "end": {"body": "b"}},
            {"a": ball(m1, velocity=[-v, 0, 0]), "b": ball(m2, position=[1.9, 0, 0])},
        )
    )
    times = np.linspace(0.0, 0.6, 241)
    run = made.integrate(times)
    length_of = np.linalg.norm(run.bodies.position[:, 1] - run.bodies.position[:, 0], axis=1)
    e11 = 0.5 * (length_of**2 - length**2) / length**2
    mu = m1 * m2 / (m1 + m2)
    assert e11.max() == pytest.approx(v * math.sqrt(mu / (1000.0 * length)), rel=2e-3)
    books = energy.books(made.system, run)
    assert np.abs(books.total - books.total[0]).max() < 1e-9 * books.total[0]


OFF_CENTRE = {
    "a": {**ball(3.0, velocity=[-1.0, 0.3, 0]), "inertia": [0.5, 0.8, 1.1]},
    "b": {
        **ball(
            6.0, position=[2.0, 0.2, 0.1], attitude=[1.0, 0.2, 0.1, 0.3], angular_velocity=[0.3, 0.1, 0.2]
        ),
        "inertia": [2.0, 1.5, 1.0],
        "centre_of_mass": [0.05, 0.1, -0.1],
    },
}
LINE = {
    "length": 2.2,
    "divisions": 3,
    "density": 50.0,
    "area": 1e-4,
    "youngs_modulus": 1e7,
    "start": {"body": "a", "point": [0.1, 0.3, 0.2]},
    "end": {"body": "b", "point": [-0.3, 0.2, 0.4]},
}


def test_nodes_are_numbered_tether_by_tether(tied, scene):
    """docs/theory.md: of each tether first its ends on bodies, then its inner nodes from start to end."""
    case = tied(LINE, OFF_CENTRE)
    case["tethers"]["led"] = {**LINE, "start": {"node": 1}, "length": 110.0, "divisions": 2}
    case["tethers"]["last"] = {**LINE, "length": 3.0, "divisions": 2}
    made = scene(case)
    chains = [[2, 4, 5, 3], [1, 7, 6], [8, 10, 9]]
    for number, nodes in enumerate(chains):
        pairs = made.net.element_nodes[made.net.tether == number]
        assert pairs.tolist() == [list(pair) for pair in pairwise(nodes)]
    assert sorted(made.net.anchors.node.tolist()) == [2, 3, 6, 8, 9]
    for start, middle, end in chains[1:]:
        np.testing.assert_allclose(made.x0[middle], 0.5 * (made.x0[start] + made.x0[end]), atol=1e-13)
        np.testing.assert_allclose(made.v0[middle], 0.5 * (made.v0[start] + made.v0[end]), atol=1e-13)


@pytest.mark.ci_for("RK4")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "bound"),
    [({}, 1e-10), ({"method": "RK4", "step": 5e-4}, 1e-5), ({"method": "Verlet", "step": 2e-4}, 1e-4)],
    ids=["DOP853", "RK4", "Verlet"],
)
def test_an_off_centre_snap_keeps_momentum_angular_momentum_and_energy(tied, scene, options, bound):
    made = scene(tied(LINE, OFF_CENTRE))
    run = made.integrate([0.0, 0.2, 0.45], **options)
    books = energy.books(made.system, run)
    assert np.abs(run.bodies.angular_velocity[-1] - run.bodies.angular_velocity[0]).max() > 0.1
    assert np.abs(books.momentum - books.momentum[0]).max() < 1e-10
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < bound
    assert np.abs(books.total - books.total[0]).max() < 10.0 * bound * books.kinetic[0]


def test_a_tether_lies_straight_and_moves_linearly_between_its_ends(tied, scene):
    made = scene(tied(LINE, OFF_CENTRE))
    net, (a, b) = made.net, made.case.bodies
    assert (net.woven, len(net.mass), len(net.area)) == (2, 6, 4)
    (start, speed), (end, other) = a.at(np.array([0.1, 0.3, 0.2])), b.at(np.array([-0.3, 0.2, 0.4]))
    chain = [*net.element_nodes[1:, 0].tolist(), net.element_nodes[-1, 1]]
    for k, node in enumerate(chain):
        assert made.x0[node] == pytest.approx(start + k / 3.0 * (end - start), rel=1e-14)
        if 0 < k < 3:
            expected = made.v0[chain[0]] + k / 3.0 * (made.v0[chain[3]] - made.v0[chain[0]])
            assert made.v0[node] == pytest.approx(expected, rel=1e-13)
    element = 50.0 * 1e-4 * 2.2 / 3.0
    assert net.mass[chain] == pytest.approx([element / 2, element, element, element / 2], rel=1e-14)
    assert made.system.bodies.mass == pytest.approx([3.0 + element / 2, 6.0 + element / 2], rel=1e-15)
    assert speed == pytest.approx(
        made.v0[chain[0]], abs=0.01
    )  # the mass of its end moves the centre a little
    assert other == pytest.approx(made.v0[chain[3]], abs=0.01)


def test_a_tether_between_nodes_is_an_element_like_any_other(explicit, scene):
    """Two nodes joined by a tether move as if the net had the element."""
    nodes, cable = [[0.0, 0, 0], [1.0, 0, 0], [2.5, 0.5, 0]], {**THREAD, "density": 1000.0}
    start = {"node_velocities": [[0.0, 0, 0], [0, 0, 0], [1.0, 2.0, 0.5]]}
    length = math.dist(nodes[1], nodes[2])
    whole = explicit(nodes, [[0, 1], [1, 2]], start, cable=cable)
    parts = explicit(nodes, [[0, 1]], start, cable=cable)
    rope = {**cable, "length": length, "start": {"node": 1}, "end": {"node": 2}}
    parts["net"]["node_masses"] = whole["net"]["node_masses"] = [0.1, 0.1, 0.1]
    one, two = scene(whole), scene({**parts, "tethers": {"rope": rope}})
    assert np.array_equal(one.net.mass, two.net.mass)
    assert np.array_equal(one.net.element_nodes, two.net.element_nodes)
    times = [0.0, 0.05]
    assert two.integrate(times).x == pytest.approx(one.integrate(times).x, abs=1e-12)


def test_a_tether_holds_a_bullet(document, scene):
    case = document("radial")
    case["bodies"] = {"hub": ball(10.0, position=[0.0, 0, -1.0])}
    line = {**THREAD, "length": 9.0, "start": {"bullet": 3}, "end": {"body": "hub"}}
    made = scene({**case, "tethers": {"line": line}})
    assert made.net.element_nodes[-1, 0] == made.net.numbered_bullets[3]
    assert made.net.reference_position[made.net.numbered_bullets[3], 0] < 0.0


def test_a_throw_moves_the_end_of_a_tether_alone(document, scene):
    """docs/theory_bodies.md: inner nodes move with the ends as these were before the launch."""
    case = document("square")
    case["initial"]["velocity"] = [0.0, 0.0, 0.7]
    case["bodies"] = {"hub": ball(10.0, position=[0.0, 0, -1.0], velocity=[0.0, 0, 0.3])}
    line = {**THREAD, "length": 9.0, "divisions": 4, "start": {"bullet": 0}, "end": {"body": "hub"}}
    made = scene({**case, "tethers": {"line": line}})
    assert made.v0[made.net.woven + 1 :] == pytest.approx(np.outer([0.6, 0.5, 0.4], [0.0, 0, 1.0]), abs=1e-15)
    assert np.linalg.norm(made.v0[made.net.numbered_bullets[0]]) == pytest.approx(math.hypot(2.5, 0.7))


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "axis"), [(math.sqrt(3.0), 1), (2.0, 2)], ids=["in plane", "out of plane"])
def test_dumbbell_librates_with_the_orbit(tied, scene, rate, axis):
    """Clohessy and Wiltshire: small angles in the plane have n sqrt(3), out of the plane 2 n."""
    n, length, angle = 1e-3, 1000.0, 1e-2
    orbit = {"mean_motion": n, "radial": [1.0, 0, 0], "along_track": [0.0, 1, 0], "model": "linear"}
    ends = np.array([0.4999 * length * math.cos(angle), 0.0, 0.0])
    ends[axis] = 0.4999 * length * math.sin(angle)
    bodies = {"up": ball(1.0, position=ends.tolist()), "down": ball(1.0, position=(-ends).tolist())}
    line = {"length": length, "youngs_modulus": 1.5e7, "start": {"body": "up"}, "end": {"body": "down"}}
    made = scene(tied(line, bodies, {"orbit": orbit}))
    taut = {**vars(made.bodies0), "position": made.bodies0.position * 1.0001 / 0.9998}
    run = made.integrate([0.0, math.pi / (rate * n)], rtol=1e-7, bodies0=BodyStates(**taut))
    across = run.bodies.position[:, 0, axis] / np.linalg.norm(run.bodies.position[:, 0], axis=1)
    assert across == pytest.approx([angle, -angle], abs=2e-3 * angle)


def test_acceleration_of_an_end_on_a_body_is_that_of_the_point(tied, scene):
    """By differences of a run with short steps."""
    made = scene(
        tied({**LINE, "length": 2.0}, {**OFF_CENTRE, "a": {**OFF_CENTRE["a"], "position": [-0.2, 0, 0]}})
    )
    h = 1e-5
    run = made.integrate([0.0, h, 2.0 * h])
    found = (run.v[2] - run.v[0]) / (2.0 * h)
    states = type(run.bodies)(*(getattr(run.bodies, k)[1] for k in vars(run.bodies)))
    a = acceleration(made.system, h, run.x[1], run.v[1], states)
    assert a == pytest.approx(found, rel=1e-4, abs=1e-3)
    with pytest.raises(ValueError, match="points of bodies"):
        acceleration(made.system, h, run.x[1], run.v[1])


BODIES = {"a": ball(1.0), "b": ball(1.0, position=[1.0, 0, 0])}
ENDS = {"length": 2.0, "start": {"body": "a"}, "end": {"body": "b"}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"length": 0.5}, "tethers.line.length: must not be below the distance"),
        ({"end": {"body": "a", "point": [1.0, 0, 0]}}, "must not both be tied to the same"),
        ({"end": {"body": "c"}}, "tethers.line.end.body: there is no body c"),
        ({"end": {"node": 2}}, "there is no node 2, they go from 0 to 1"),
        ({"end": {"bullet": 0}}, "there is no bullet 0, this net has none"),
        ({"end": {}}, "give exactly one of tethers.line.end.node and"),
        ({"end": {"node": 0, "point": [0.0, 0, 0]}}, "tethers.line.end.point: only with"),
        ({"end": {"node": 0, "body": "a"}}, "not node beside body"),
        ({"divisions": 0}, "tethers.line.divisions"),
        ({"slack": 1.0}, "reference_impl does not know tethers.line.slack"),
        ({"start": None}, "tethers.line.start]: missing"),
        ({"diameter": 1e-3}, "give exactly one of tethers.line.diameter and tethers.line.area"),
    ],
)
def test_bad_tethers_are_refused(tied, change, words):
    tether = {key: value for key, value in {**ENDS, **change}.items() if value is not None}
    with pytest.raises(Refused) as refused:
        prepare(read_document(tied(tether, BODIES)))
    assert any(words in fault for fault in refused.value.faults), refused.value.faults


def test_a_body_that_cannot_be_read_is_there_all_the_same(tied):
    """Of a tether to a body whose mesh is of an unknown kind, the mesh is told, not that there is no body."""
    mesh = {"shape": "mesh", "file": "a.glb", "unit": "m", "mass": 1.0}
    with pytest.raises(Refused) as refused:
        read_document(tied(ENDS, {**BODIES, "a": mesh}))
    assert len(refused.value.faults) == 1
    assert refused.value.faults[0].startswith("bodies.a.file: reference_impl does not know")


def test_nodes_of_woven_nets_have_no_numbers_but_free_ends_of_strings(document):
    case = {**document("radial"), "bodies": {"a": ball(1.0)}}
    case["tethers"] = {"line": {**THREAD, "length": 9.0, "start": {"node": 2}, "end": {"body": "a"}}}
    with pytest.raises(Refused, match=r"does not know tethers.line.start.node = 2"):
        read_document(case)
    del case["net"]["bullets"], case["launch"]
    net = prepare(read_document(case)).net
    place = net.reference_position[net.element_nodes[-1, 0]]
    assert math.atan2(place[1], place[0]) == pytest.approx(math.pi / 2.0)
    assert np.hypot(*place[:2]) == pytest.approx(2.0 + math.sqrt(2.0))


def test_ends_that_coincide_have_no_direction_to_damp_along(tied):
    case = tied(ENDS, {"a": ball(1.0), "b": ball(1.0)}, {"rayleigh_damping": {"alpha": 0.0, "beta": 1e-6}})
    with pytest.raises(Refused, match="no direction to damp along"):
        prepare(read_document(case))
    assert prepare(read_document({**case, "effects": {}})).integrate([0.0, 0.1]).n_steps

"""`[bodies.NAME]` as reference_impl reads it: mass properties, frames, what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import Refused, read_document
from reference_impl.bodies import Body, rotation

BRICK = {"shape": "box", "size": [2.0, 3.0, 5.0]}
OWN = {"mass": 2.0, "inertia": [1.0, 2.0, 2.5]}
TURNED = [1.0, 2.0, -1.0, 0.5]
PARTS = {
    "hub": {"shape": "cylinder", "radius": 0.5, "length": 1.0},
    "boom": {"shape": "box", "size": [4.0, 0.2, 0.2], "position": [2.5, 0.0, 0.25]},
}


@pytest.fixture(scope="module")
def read_body(document):
    """read_body(**keys): the body of a case with these keys."""

    def make(**keys) -> Body:
        (body,) = read_document({**document(), "bodies": {"box": keys}}).bodies
        return body

    return make


@pytest.fixture(scope="module")
def faults(document):
    """faults(**keys): what is wrong with a body of these keys, () if nothing is."""

    def find(**keys):
        try:
            read_document({**document(), "bodies": {"box": keys}})
        except Refused as refused:
            return refused.faults
        return ()

    return find


@pytest.mark.parametrize("given", [{"mass": 60.0}, {"density": 2.0}], ids=["mass", "density"])
def test_a_shape_is_filled_evenly(read_body, given):
    body = read_body(**BRICK, **given)
    assert body.mass == pytest.approx(60.0, rel=1e-15)
    assert body.inertia == pytest.approx(5.0 * np.diag([34.0, 29.0, 13.0]), rel=1e-14)
    assert not body.centre_of_mass.any()


def test_every_shape_by_its_keys(read_body):
    """Mass at a density of 1 is the volume."""
    volumes = (
        ({"shape": "cylinder", "radius": 2.0, "length": 3.0}, 12.0 * math.pi),
        ({"shape": "sphere", "radius": 3.0}, 36.0 * math.pi),
        ({"shape": "capsule", "radius": 3.0, "length": 2.0}, 54.0 * math.pi),
        ({"shape": "frustum", "radii": [1.0, 2.0], "length": 3.0}, 7.0 * math.pi),
    )
    for keys, volume in volumes:
        assert read_body(density=1.0, **keys).mass == pytest.approx(volume, rel=1e-14)


def test_a_frustum_has_its_centre_of_mass_off_the_origin(read_body):
    cone = {"shape": "frustum", "radii": [1.0, 0.0], "length": 2.0, "mass": 3.0}
    assert read_body(**cone).centre_of_mass == pytest.approx([0.0, 0.0, -0.5], rel=1e-14)


def test_given_inertia_stands_beside_a_shape(read_body):
    """The shape then gives volume and centre of mass, unless that is given too."""
    cone = {"shape": "frustum", "radii": [1.0, 0.0], "length": 2.0, "inertia": [1.0, 2.0, 2.5]}
    for given, mass in (({"mass": 3.0}, 3.0), ({"density": 3.0}, 2.0 * math.pi)):
        body = read_body(**cone, **given)
        assert body.mass == pytest.approx(mass, rel=1e-14)
        assert np.array_equal(body.inertia, np.diag([1.0, 2.0, 2.5]))
        assert body.centre_of_mass == pytest.approx([0.0, 0.0, -0.5], rel=1e-14)
    moved = read_body(**cone, mass=3.0, centre_of_mass=[0.1, 0.2, 0.3])
    assert np.array_equal(moved.centre_of_mass, [0.1, 0.2, 0.3])


def test_products_of_inertia_are_elements_of_the_matrix(read_body):
    body = read_body(**OWN, products_of_inertia=[0.1, -0.2, 0.3], centre_of_mass=[1.0, 0.0, 0.0])
    assert np.array_equal(body.inertia, [[1.0, 0.1, -0.2], [0.1, 2.0, 0.3], [-0.2, 0.3, 2.5]])
    assert np.array_equal(body.centre_of_mass, [1.0, 0.0, 0.0])


def test_products_of_inertia_have_the_sign_of_the_page(read_body):
    """A boom along x = y has Ixy = -integral of x y dm < 0."""
    boom = {"shape": "box", "size": [2.0, 0.1, 0.1], "axis": [0.0, 0.0, 3.0], "angle": math.pi / 4.0}
    body = read_body(density=1.0, parts={"boom": boom})
    assert body.inertia[0, 1] == pytest.approx(-body.mass * (4.0 - 0.01) / 24.0, rel=1e-13)


def test_a_compound_by_hand(read_body):
    """A hub pi/4 m3 in the origin and a boom of 0.16 m3 at (2.5, 0, 0.25): two points and two matrices."""
    volumes = math.pi / 4.0, 0.16
    total = sum(volumes)
    arm, lift = volumes[1] / total * 2.5, volumes[1] / total * 0.25
    both = volumes[0] * volumes[1] / total  # of the pair, as one point at their distance
    hub = volumes[0] * np.array([(0.75 + 1.0) / 12.0, (0.75 + 1.0) / 12.0, 0.125])
    boom = volumes[1] * np.array([0.08, 16.04, 16.04]) / 12.0
    expected = np.diag(hub + boom + both * np.array([0.0625, 6.3125, 6.25]))
    expected[0, 2] = expected[2, 0] = -both * 2.5 * 0.25
    for given, scale in (({"density": 3.0}, 3.0), ({"mass": 5.0}, 5.0 / total)):
        body = read_body(parts=PARTS, **given)
        assert body.mass == pytest.approx(scale * total, rel=1e-14)
        assert body.centre_of_mass == pytest.approx([arm, 0.0, lift], rel=1e-14)
        assert body.inertia == pytest.approx(scale * expected, rel=1e-13, abs=1e-14)


def test_parts_may_be_turned(read_body):
    """By a quaternion or about an axis: a box on its side is the box of exchanged edges."""
    other = read_body(shape="box", size=[5.0, 3.0, 2.0], density=1.0)
    half = math.sqrt(0.5)
    for turn in ({"attitude": [half, 0.0, half, 0.0]}, {"axis": [0.0, 2.0, 0.0], "angle": math.pi / 2.0}):
        body = read_body(density=1.0, parts={"side": {**BRICK, **turn}})
        assert body.inertia == pytest.approx(other.inertia, rel=1e-14, abs=1e-13)


def test_an_axis_and_an_angle_are_an_attitude(read_body):
    half = 0.35
    w, s = math.cos(half), math.sin(half) / math.sqrt(14.0)
    expected = read_body(**OWN, attitude=[w, s, 2.0 * s, 3.0 * s]).attitude
    for axis in ([1.0, 2.0, 3.0], [1e-200, 2e-200, 3e-200], [1e300, 2e300, 3e300]):
        assert read_body(**OWN, axis=axis, angle=0.7).attitude == pytest.approx(expected, abs=1e-15)


def test_edge_radius_changes_no_mass(read_body):
    sharp, rounded = (read_body(**BRICK, density=2.0, edge_radius=r) for r in (0.0, 1.0))
    assert rounded.mass == sharp.mass
    assert np.array_equal(rounded.inertia, sharp.inertia)


def test_position_is_of_the_frame_and_velocity_of_the_centre_of_mass(scene, document):
    body = {
        **OWN,
        "centre_of_mass": [0.5, -1.0, 2.0],
        "position": [10.0, 20.0, 30.0],
        "velocity": [1.0, 2.0, 3.0],
        "attitude": TURNED,
        "angular_velocity": [0.1, 0.2, 0.3],
    }
    made = scene({**document(), "bodies": {"box": body}})
    start, turn = made.bodies0, rotation(tuple(TURNED))
    assert start.position[0] == pytest.approx([10.0, 20.0, 30.0] + turn @ [0.5, -1.0, 2.0], rel=1e-15)
    assert np.array_equal(start.velocity[0], [1.0, 2.0, 3.0])
    assert np.array_equal(start.angular_velocity[0], [0.1, 0.2, 0.3])
    assert np.array_equal(start.attitude[0], turn)
    assert np.array_equal(made.system.bodies.centre_of_mass, [[0.5, -1.0, 2.0]])


def test_frames_of_the_angular_velocity(read_body):
    """The same vector in the axes of body or scene, and the two ways to say the same spin."""
    spin, turn = [0.1, 0.2, 0.3], rotation(tuple(TURNED))
    body = {**OWN, "attitude": TURNED}
    for keys in ({}, {"angular_velocity_frame": "body"}):
        assert np.array_equal(read_body(**body, angular_velocity=spin, **keys).angular_velocity, spin)
    of_scene = read_body(**body, angular_velocity=spin, angular_velocity_frame="scene")
    assert turn @ of_scene.angular_velocity == pytest.approx(spin, rel=1e-14)
    quarter = {"axis": [0.0, 0.0, 1.0], "angle": math.pi / 2.0, "angular_velocity_frame": "scene"}
    about_x = read_body(**OWN, **quarter, angular_velocity=[2.0, 0.0, 0.0])
    assert about_x.angular_velocity == pytest.approx([0.0, -2.0, 0.0], abs=1e-15)


GIVEN = {**OWN, "products_of_inertia": [0.1, -0.2, 0.3], "centre_of_mass": [0.1, 0.2, 0.3]}
FILLED = {**BRICK, "density": 2.0}
BAD = [
    ({"inertia": [1.0, 1.0, 1.0]}, "bodies.box: give exactly one of bodies.box.mass and bodies.box.density"),
    ({**FILLED, "mass": 1.0}, "bodies.box: give exactly one of bodies.box.mass and bodies.box.density"),
    ({"mass": 1.0}, "bodies.box.inertia: missing"),
    (
        {"density": 1.0, "inertia": [1.0] * 3},
        "bodies.box.density: needs bodies.box.shape or bodies.box.parts",
    ),
    ({**FILLED, "density": 0.0}, "bodies.box.density: must be greater than 0"),
    (
        {**FILLED, "products_of_inertia": [0.0] * 3},
        "bodies.box.products_of_inertia: needs bodies.box.inertia",
    ),
    ({**FILLED, "centre_of_mass": [0.0] * 3}, "bodies.box.centre_of_mass: needs bodies.box.inertia"),
    ({**GIVEN, "products_of_inertia": [3.0, 0.0, 0.0]}, "bodies.box.products_of_inertia: no body has"),
    ({**OWN, "products_of_inertia": [1.3, 0.0, 0.0]}, "bodies.box.products_of_inertia: no body has"),
    ({**OWN, "size": [1.0] * 3}, "reference_impl does not know bodies.box.size"),
    ({**FILLED, "radius": 1.0}, "reference_impl does not know bodies.box.radius"),
    ({**FILLED, "size": [1.0, 0.0, 1.0]}, "bodies.box.size: must be greater than 0"),
    ({"mass": 1.0, "shape": "sphere"}, "bodies.box.radius: missing"),
    ({"mass": 1.0, "shape": "capsule", "radius": 1.0}, "bodies.box.length: missing"),
    (
        {"mass": 1.0, "shape": "frustum", "radii": [0.0, 0.0], "length": 1.0},
        "bodies.box.radii: must not both",
    ),
    ({"mass": 1.0, "shape": "frustum", "radii": [-1.0, 1.0], "length": 1.0}, "bodies.box.radii: must be at"),
    ({"mass": 1.0, "shape": "cone"}, 'reference_impl does not know bodies.box.shape = "cone": it knows box'),
    (
        {"mass": 1.0, "shape": "mesh", "file": "a.glb", "unit": "mm"},
        "bodies.box.file: reference_impl does not",
    ),
    ({"mass": 1.0, "shape": 3}, "bodies.box.shape: must be one line of text"),
    ({**FILLED, "parts": PARTS}, "bodies.box: give either bodies.box.shape or bodies.box.parts, not both"),
    ({"mass": 1.0, "parts": {}}, "bodies.box.parts: must have at least one part"),
    ({"mass": 1.0, "parts": 3}, "bodies.box.parts: must be a table"),
    ({"mass": 1.0, "parts": {"hub": 3}}, "bodies.box.parts.hub: must be a table"),
    ({"mass": 1.0, "parts": {"a b": PARTS["hub"]}}, "bodies.box.parts.a b: the name must be of letters"),
    ({"mass": 1.0, "parts": {"hub": {}}}, "bodies.box.parts.hub.shape: missing"),
    (
        {"mass": 1.0, "parts": {"hub": {"shape": "mesh"}}},
        "reference_impl does not know bodies.box.parts.hub.shape",
    ),
    (
        {"mass": 1.0, "parts": {"hub": {**PARTS["hub"], "density": 1.0}}},
        "reference_impl does not know bodies.box.parts.hub.density",
    ),
    (
        {"mass": 1.0, "parts": {**PARTS, "hub": {**PARTS["hub"], "attitude": [0.0] * 4}}},
        "bodies.box.parts.hub.attitude: must not be zero",
    ),
    (
        {**FILLED, "edge_radius": 1.01},
        "bodies.box.edge_radius: must be at most half of the smallest dimension, 1,",
    ),
    ({**FILLED, "edge_radius": -0.1}, "bodies.box.edge_radius: must be at least 0"),
    ({**OWN, "edge_radius": 0.1}, "bodies.box.edge_radius: needs bodies.box.shape or bodies.box.parts"),
    ({"mass": 1.0, "parts": PARTS, "edge_radius": 0.11}, "bodies.box.edge_radius: must be at most half"),
    ({**OWN, "axis": [0.0, 0.0, 1.0]}, "bodies.box.angle: missing"),
    ({**OWN, "angle": 1.0}, "bodies.box.axis: missing"),
    ({**OWN, "axis": [0.0] * 3, "angle": 1.0}, "bodies.box.axis: must not be zero"),
    (
        {**OWN, "axis": [1.0] * 3, "angle": 1.0, "attitude": TURNED},
        "bodies.box: give either bodies.box.attitude or bodies.box.axis and bodies.box.angle, not both",
    ),
    (
        {**OWN, "angular_velocity_frame": "net"},
        'bodies.box.angular_velocity_frame: must be "body" or "scene"',
    ),
    ({**FILLED, "size": [1e200] * 3}, "bodies.box: mass and inertia of its shape leave the range"),
    (
        {"density": 1.0, "shape": "sphere", "radius": 1e-200},
        "bodies.box: mass and inertia of its shape leave",
    ),
]


@pytest.mark.parametrize(("keys", "fault"), BAD, ids=[str(k) for k in range(len(BAD))])
def test_bad_bodies_are_refused_by_name(faults, keys, fault):
    (found,) = faults(**keys)
    assert found.startswith(fault)


def test_faults_of_a_body_are_reported_at_once(faults):
    found = faults(
        mass=-1.0,
        shape="box",
        size=[1.0],
        centre_of_mass=[0.0, 0.0],
        axis=[0.0, 0.0, 0.0],
        velocity="fast",
        angular_velocity_frame=3,
        colour="red",
    )
    keys = ("mass", "size", "centre_of_mass", "axis", "angle", "velocity", "angular_velocity_frame")
    for key in keys:
        assert any(fault.startswith(f"bodies.box.{key}:") for fault in found), key
    assert any("does not know bodies.box.colour" in fault for fault in found)


def test_bodies_that_can_just_exist_are_read(faults):
    """A plate and a needle given in axes that are not principal ones: round-off refuses neither."""
    turn = rotation(tuple(TURNED))
    for principal in ([0.1, 0.2, 0.3], [1e-9, 1.0, 1.0]):
        full = turn @ np.diag(principal) @ turn.T
        diagonal, products = np.diag(full).tolist(), [full[0, 1], full[0, 2], full[1, 2]]
        assert faults(mass=1.0, inertia=diagonal, products_of_inertia=products) == ()


ODD = [
    "x",
    [],
    [1.0],
    [[1.0, 2.0]],
    {},
    {"x": 1.0},
    math.nan,
    True,
    10**400,
    [math.nan] * 3,
    0,
    -1,
    1e308,
    5e-324,
]


@pytest.mark.parametrize(
    "keys",
    [
        {**GIVEN, **BRICK, "axis": [1.0, 2.0, 3.0], "angle": 0.1, "edge_radius": 0.1},
        {"density": 1.0, "shape": "capsule", "radius": 1.0, "length": 2.0, "angular_velocity_frame": "scene"},
        {"density": 1.0, "shape": "frustum", "radii": [1.0, 2.0], "length": 2.0, "attitude": TURNED},
        {"density": 1.0, "parts": PARTS},
    ],
    ids=["box", "capsule", "frustum", "compound"],
)
def test_odd_values_are_faults_not_tracebacks(faults, keys):
    for odd in [*ODD, [1e308] * 3, [5e-324] * 3, [1e308] * 2, [5e-324] * 2]:
        for key in keys:
            assert all("bodies.box" in fault for fault in faults(**{**keys, key: odd}))
        if "parts" in keys:
            for key in keys["parts"]["boom"]:
                boom = {**keys["parts"]["boom"], key: odd}
                found = faults(**{**keys, "parts": {**PARTS, "boom": boom}})
                assert all("bodies.box" in fault for fault in found)

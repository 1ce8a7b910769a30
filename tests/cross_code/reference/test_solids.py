"""Mass properties of solids and meshes in reference_impl against closed forms; the files that it reads."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from reference_impl import Refused, read_document
from reference_impl.arrays import rotation
from reference_impl.solids import box, capsule, cylinder, enclosed, frustum, moments, sphere, union

TURN = rotation((1.0, 2.0, -1.0, 0.5))


def cone(radius, length):
    """Volume; height of the centroid over the base; Ixx, Izz about it over the mass."""
    across = 3.0 / 20.0 * radius**2 + 3.0 / 80.0 * length**2
    return math.pi * radius**2 * length / 3.0, length / 4.0, across, 0.3 * radius**2


def test_cylinder():
    volume, centroid, inertia = moments(cylinder(0.5, 3.0))
    assert volume == pytest.approx(0.75 * math.pi, rel=1e-15)
    assert not centroid.any()
    across = (3.0 * 0.25 + 9.0) / 12.0
    assert inertia == pytest.approx(np.diag([across, across, 0.125]), rel=1e-14)


def test_capsule():
    """Cylinder and two half-spheres, each 3/8 r above its face, with 2/5 r^2 about the ball's centre."""
    r, h = 0.7, 1.9
    tube, balls = math.pi * r**2 * h, 4.0 / 3.0 * math.pi * r**3
    volume, centroid, inertia = moments(capsule(r, h))
    assert volume == pytest.approx(tube + balls, rel=1e-15)
    assert not centroid.any()
    along = tube * r**2 / 2.0 + balls * 0.4 * r**2
    about_face = balls * (0.4 * r**2 + h**2 / 4.0 + 3.0 / 8.0 * h * r)
    across = tube * (3.0 * r**2 + h**2) / 12.0 + about_face
    assert inertia * volume == pytest.approx(np.diag([across, across, along]), rel=1e-14)


def test_cone_points_up_or_down():
    volume, height, across, along = cone(1.5, 2.0)
    for radii, place in (((1.5, 0.0), height - 1.0), ((0.0, 1.5), 1.0 - height)):
        found, centroid, inertia = moments(frustum(radii, 2.0))
        assert found == pytest.approx(volume, rel=1e-14)
        assert centroid == pytest.approx([0.0, 0.0, place], rel=1e-14)
        assert inertia == pytest.approx(np.diag([across, across, along]), rel=1e-14)


def test_frustum_is_a_cone_less_its_tip():
    """Radii 2 and 1 over 3 m: the cone of 6 m less one of 3 m."""
    whole, tip = cone(2.0, 6.0), cone(1.0, 3.0)
    volume, centroid, inertia = moments(frustum((2.0, 1.0), 3.0))
    assert volume == pytest.approx(whole[0] - tip[0], rel=1e-14)
    height = (whole[0] * whole[1] - tip[0] * (3.0 + tip[1])) / volume
    assert centroid == pytest.approx([0.0, 0.0, height - 1.5], rel=1e-14)
    across = whole[0] * (whole[2] + (whole[1] - height) ** 2)
    across -= tip[0] * (tip[2] + (3.0 + tip[1] - height) ** 2)
    along = whole[0] * whole[3] - tip[0] * tip[3]
    assert inertia * volume == pytest.approx(np.diag([across, across, along]), rel=1e-13)


@pytest.mark.parametrize(
    "solid",
    [box((1.0, 2.0, 3.0)), capsule(0.4, 1.0), frustum((1.0, 0.3), 2.0)],
    ids=["box", "capsule", "frustum"],
)
def test_moved_solids_carry_their_moments_along(solid):
    volume, centroid, inertia = moments(solid)
    shift = np.array([3.0, -1.0, 2.0])
    other, place, turned = moments(solid.moved(TURN, shift))
    assert other == pytest.approx(volume, rel=1e-15)
    assert place == pytest.approx(TURN @ centroid + shift, rel=1e-14)
    assert turned == pytest.approx(TURN @ inertia @ TURN.T, abs=1e-14)


def test_thin_solids_keep_their_least_moment():
    """A rod of 1 um by 1 m: Izz is 1e-12 of Ixx, and not the difference of two that are as large."""
    inertia = moments(cylinder(1e-6, 1.0))[2]
    assert inertia[2, 2] == pytest.approx(5e-13, rel=1e-14)
    assert moments(box((1e-9, 1e-9, 1.0)))[2][2, 2] == pytest.approx(1e-18 / 6.0, rel=1e-14)


def test_dumbbell_by_hand():
    """Spheres of 1 m and 2 m, 9 m apart along (1, 1, 0): 1 to 8 in mass, centroid 8 m from the small one."""
    axis = np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)
    volume, centroid, inertia = moments(union([sphere(1.0), sphere(2.0).moved(np.eye(3), 9.0 * axis)]))
    unit = 4.0 / 3.0 * math.pi
    assert volume == pytest.approx(9.0 * unit, rel=1e-15)
    assert centroid == pytest.approx(8.0 * axis, rel=1e-14)
    own, apart = 0.4 * (1.0 + 8.0 * 4.0), 1.0 * 64.0 + 8.0 * 1.0
    expected = (own * np.eye(3) + apart * (np.eye(3) - np.outer(axis, axis))) * unit
    assert inertia * volume == pytest.approx(expected, rel=1e-13, abs=1e-12)


EDGES = np.array([2.0, 3.0, 5.0])
CORNERS = np.array(
    [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float
)  # number 4x + 2y + z
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # from outside
BRICK = EDGES * (CORNERS - 0.5)


def brick(shift=(0.0, 0.0, 0.0), edges=EDGES):
    """Triangles (12, 3, 3) of a box."""
    at = edges * (CORNERS - 0.5) + np.array(shift)
    return np.array([at[list(t)] for q in QUADS for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])


def binary(corners, header=b"solid of a program that says so"):
    rows = [struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in corners]
    return header.ljust(80) + struct.pack("<I", len(corners)) + b"".join(rows)


def ascii_stl(corners):
    facet = "facet normal 0 0 0\n outer loop\n{} endloop\nendfacet\n"
    vertices = [("  vertex {:.9g} {:.9g} {:.9g}\n" * 3).format(*triangle.ravel()) for triangle in corners]
    return ("solid brick\n" + "".join(map(facet.format, vertices)) + "endsolid brick\n").encode()


def obj(points, faces):
    lines = [
        "# a comment",
        "o thing",
        "vn 0 0 1",
        *(f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in points),
        *faces,
    ]
    return ("\n".join(lines) + "\n").encode()


FACES = ["f " + " ".join(f"{k + 1}/7/1" for k in quad) for quad in QUADS]
BACKWARDS = ["f " + " ".join(f"{k - 8}//1" for k in quad) for quad in QUADS]
FILES = {
    "brick.stl": binary(brick()),
    "text.STL": ascii_stl(brick()),
    "brick.obj": obj(BRICK, FACES),
    "backwards.OBJ": obj(BRICK, BACKWARDS),
}


@pytest.fixture
def body(document, tmp_path):
    """body(content, name, **keys): the body whose shape is in a file of this content."""

    def make(content, name="shape.stl", **keys):
        (tmp_path / name).write_bytes(content)
        shape = {
            "shape": "mesh",
            "file": name,
            "unit": "m",
            **({} if "mass" in keys else {"density": 2.0}),
            **keys,
        }
        (made,) = read_document({**document(), "bodies": {"box": shape}}, folder=tmp_path).bodies
        return made

    return make


@pytest.mark.parametrize("name", FILES)
def test_every_kind_of_file_holds_the_brick(body, name):
    """30 m3 at 2 kg/m3; m/12 (b^2 + c^2)."""
    found = body(FILES[name], name)
    assert found.mass == pytest.approx(60.0, rel=1e-14)
    assert found.inertia == pytest.approx(5.0 * np.diag([34.0, 29.0, 13.0]), rel=1e-14, abs=1e-12)
    assert found.centre_of_mass == pytest.approx(np.zeros(3), abs=1e-14)


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("inch", 0.0254)])
def test_units(body, unit, scale):
    found = body(FILES["brick.obj"], "brick.obj", unit=unit)
    assert found.mass == pytest.approx(60.0 * scale**3, rel=1e-13)
    given = body(FILES["brick.obj"], "brick.obj", unit=unit, mass=60.0)
    assert given.inertia == pytest.approx(5.0 * scale**2 * np.diag([34.0, 29.0, 13.0]), rel=1e-13, abs=1e-15)


def test_a_corner_of_a_cube_by_hand():
    """Three unit edges: volume 1/6, centroid 1/4; Ixx = 2 (1/10 - 1/16), Ixy = -(1/20 - 1/16)."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    volume, centroid, inertia = moments(enclosed(points[np.array(faces)]))
    assert volume == pytest.approx(1.0 / 6.0, rel=1e-15)
    assert centroid == pytest.approx([0.25] * 3, rel=1e-15)
    assert inertia == pytest.approx(np.full((3, 3), 1 / 80) + np.eye(3) * (3 / 40 - 1 / 80), rel=1e-14)


def test_far_from_the_origin_and_turned():
    """Steiner's theorem and the rule of turned axes; 1 km away still to 1e-9."""
    turn, shift = rotation((1.0, 0.5, -0.2, 0.3)), np.array([1000.0, -300.0, 20.0])
    volume, centroid, inertia = moments(enclosed(brick() @ turn.T + shift))
    assert volume == pytest.approx(30.0, rel=1e-11)
    assert centroid == pytest.approx(shift, rel=1e-12)
    assert inertia == pytest.approx(turn @ np.diag([34.0, 29.0, 13.0]) @ turn.T / 12.0, rel=1e-9, abs=1e-9)


def test_a_hollow_and_one_turned_inside_out():
    """Box less box: volumes and moments subtract.  All triangles the other way round are the same solid."""
    inside = np.array([1.0, 1.0, 2.0])
    shell = np.concatenate((brick(), brick(edges=inside)[:, ::-1]))
    volume, centroid, inertia = moments(enclosed(shell))
    assert volume == pytest.approx(28.0, rel=1e-14)
    assert centroid == pytest.approx(np.zeros(3), abs=1e-14)
    whole, hole = (np.prod(e) / 12 * (np.sum(e**2) - e**2) for e in (EDGES, inside))
    assert inertia * volume == pytest.approx(np.diag(whole - hole), rel=1e-13, abs=1e-12)
    out, back = moments(enclosed(brick())), moments(enclosed(brick()[:, ::-1]))
    assert out[0] == back[0]
    assert out[2] == pytest.approx(back[2], rel=1e-15, abs=1e-16)


# 2 m high over an L of 3 m2, whose inner corner is number 4; from corners 1 and 4 all others are seen
ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
WALLS = [f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}" for k in range(6)]
PRISM = np.array([(x, y, z) for z in (0, 2) for x, y in ELL])


@pytest.mark.parametrize("caps", [("1 6 5 4 3 2", "7 8 9 10 11 12"), ("4 3 2 1 6 5", "10 11 12 7 8 9")])
def test_a_concave_face_seen_from_its_first_corner(body, caps):
    """A square of 2 m less one of 1 m: the integral of y is 2.5 m3, of y^2 3 m4, over 3 m2."""
    found = body(obj(PRISM, [f"f {cap}" for cap in caps] + WALLS), "ell.obj")
    assert found.mass == pytest.approx(12.0, rel=1e-14)
    assert found.centre_of_mass == pytest.approx([5 / 6, 5 / 6, 1.0], rel=1e-14)
    assert found.inertia[0, 0] == pytest.approx(12 * (1 - 25 / 36 + 1 / 3), rel=1e-13)


@pytest.mark.parametrize(
    ("caps", "line"),
    [
        (("6 5 4 3 2 1", "7 8 9 10 11 12"), 16),
        (("1 6 5 4 3 2", "9 10 11 12 7 8"), 17),
        (("1 6 5 \\\n4 3 2", "9 10 \\\n11 12 7 8"), 18),
    ],
)
def test_a_concave_face_whose_triangles_overlap_is_refused(body, caps, line):
    with pytest.raises(Refused, match=rf"ell\.obj: line {line}: a concave face"):
        body(obj(PRISM, [f"f {cap}" for cap in caps] + WALLS), "ell.obj")

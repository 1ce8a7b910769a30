"""Bodies whose shape is a mesh, in reference_impl: files, mass properties, bad input."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from reference_impl import Refused, read, read_document
from reference_impl.bodies import rotation
from reference_impl.mesh_files import triangles
from reference_impl.solids import enclosed, moments

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


def test_a_torus_comes_near_its_formula():
    """R = 2, r = 0.5: 2 pi^2 R r^2, Izz/m = R^2 + 3 r^2/4, Ixx/m = R^2/2 + 5 r^2/8; error of order 1/k^2."""
    big, small, errors = 2.0, 0.5, []
    for k in (24, 48):
        u, v = np.meshgrid(*2 * [2 * math.pi * np.arange(k) / k], indexing="ij")
        ring = big + small * np.cos(v)
        at = np.stack((ring * np.cos(u), ring * np.sin(u), small * np.sin(v)), axis=-1)
        ahead = np.roll(at, -1, axis=0)
        corners = [at, ahead, np.roll(ahead, -1, axis=1), np.roll(at, -1, axis=1)]
        halves = [np.stack([corners[c] for c in t], axis=2).reshape(-1, 3, 3) for t in ((0, 1, 2), (0, 2, 3))]
        volume, _, inertia = moments(enclosed(np.concatenate(halves)))
        exact = (2 * math.pi**2 * big * small**2, big**2 / 2 + 5 * small**2 / 8, big**2 + 0.75 * small**2)
        errors.append([volume / exact[0] - 1, inertia[0, 0] / exact[1] - 1, inertia[2, 2] / exact[2] - 1])
    assert np.abs(errors[1]).max() < 0.01
    assert np.array(errors[0]) / np.array(errors[1]) == pytest.approx([4.0] * 3, rel=0.02)


def test_files_are_beside_the_case(tmp_path, document, scene):
    """Whatever the present folder is; edge_radius is at most half of the least width, 2 m."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a b.stl").write_bytes(FILES["brick.stl"])
    text = (
        'format = 1\ntitle = "a"\n[time]\nend = 1.0\noutput_step = 0.5\n[net]\ntopology = "explicit"\n'
        "nodes = [[0, 0, 0], [9, 0, 0]]\nelements = [[0, 1]]\n"
        "cable = { area = 1e-6, density = 1e3, youngs_modulus = 1e9 }\n[initial]\npacking = 1.0\n"
        '[bodies.b]\nshape = "mesh"\nfile = "parts/a b.stl"\nunit = "m"\ndensity = 2.0\nedge_radius = {}\n'
    )
    case = tmp_path / "case.toml"
    case.write_text(text.replace("{}", "1.0"))
    (found,) = read(case).bodies
    assert found.mass == pytest.approx(60.0)
    case.write_text(text.replace("{}", "1.01"))
    with pytest.raises(Refused, match=r"edge_radius: must be at most half of the smallest dimension, 1,"):
        read(case)


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


OPEN = brick()[:-1]
WRONG = np.concatenate((brick()[:-1], brick()[-1:, ::-1]))


@pytest.mark.parametrize(
    ("content", "name", "words"),
    [
        (binary(OPEN), "a.stl", "its surface must be closed: 3 sides of triangles are free"),
        (binary(WRONG), "a.stl", "its triangles must all turn the same way round"),
        (binary(np.concatenate((brick(), brick()[:, ::-1]))), "a.stl", "its surface encloses no volume"),
        (binary(brick()[:0]), "a.stl", "no triangles in it"),
        (binary(np.zeros((2, 3, 3))), "a.stl", "no triangles that have an area"),
        (binary(brick() * np.nan), "a.stl", "its coordinates must be finite"),
        (binary(brick())[:-3], "a.stl", "neither a text nor of the length"),
        (
            b"solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nendfacet\n",
            "a.stl",
            "facets must have three vertices",
        ),
        (b"solid a\nfacet\nvertex 0 0\nvertex 1 0 0\nvertex 1 1 0\nendfacet", "a.stl", "could not convert"),
        (b"", "a.stl", "not an STL file"),
        (obj(BRICK, ["f 1 2 9"]), "a.obj", "a face names a vertex that is not there"),
        (obj(BRICK, ["f 1 2"]), "a.obj", "not a face: f 1 2"),
        (obj(BRICK, ["f 0 1 2"]), "a.obj", "not a face: f 0 1 2"),
        (obj(BRICK, ["f -9 1 2"]), "a.obj", "not a face: f -9 1 2"),
        (obj(BRICK, ["f a b c"]), "a.obj", "invalid literal"),
        (b"v 1 2\nf 1 1 1\n", "a.obj", "a vertex must have three coordinates"),
        (b"glTF", "a.glb", "reference_impl does not know files of the kind .glb: it knows .stl, .obj"),
        (b"", "shape", "reference_impl does not know files of the kind without a suffix"),
    ],
)
def test_bad_files_are_refused(body, content, name, words):
    with pytest.raises(Refused) as refused:
        body(content, name)
    (fault,) = refused.value.faults
    assert fault.startswith("bodies.box.file: ")
    assert words in fault


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"file": "none.stl"}, "none.stl: No such file"),
        ({"file": "."}, "reference_impl does not know files of the kind"),
        ({"unit": "furlong"}, "bodies.box.unit: must be one of m, cm, mm, inch, not 'furlong'"),
        ({"unit": None}, "bodies.box.unit: missing"),
        ({"file": None}, "bodies.box.file: missing"),
        ({"radius": 1.0}, "reference_impl does not know bodies.box.radius"),
    ],
)
def test_bad_keys_are_refused(document, tmp_path, keys, words):
    (tmp_path / "a.stl").write_bytes(FILES["brick.stl"])
    shape = {"shape": "mesh", "file": "a.stl", "unit": "m", "density": 1.0, **keys}
    shape = {key: value for key, value in shape.items() if value is not None}
    with pytest.raises(Refused) as refused:
        read_document({**document(), "bodies": {"box": shape}}, folder=tmp_path)
    assert any(words in fault for fault in refused.value.faults), refused.value.faults


@pytest.mark.ci
@pytest.mark.slow
def test_no_file_makes_a_traceback(tmp_path):
    """A thousand damaged files: the readers say what is wrong, or read something."""
    rng, said = np.random.default_rng(3), 0
    for name, content in FILES.items():
        for _ in range(250):
            damaged = bytearray(content)
            for at in rng.integers(0, len(content), 3):
                damaged[at] = rng.integers(256)
            (tmp_path / name).write_bytes(bytes(damaged[: rng.integers(len(damaged) // 2, len(damaged) + 1)]))
            try:
                with np.errstate(all="ignore"):
                    enclosed(triangles(tmp_path / name))
            except ValueError:
                said += 1
    assert said > 500

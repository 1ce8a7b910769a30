"""Shapes of rigid bodies: mass and inertia against textbooks, quadrature and trimesh; what is refused."""

from __future__ import annotations

import logging
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES, SOLID_NUMBERS, distance_from_solid, refused

import exunet
from exunet.base.errors import InputError, MissingExtra
from exunet.bodies.distance import goes_through_itself, overlap
from exunet.bodies.mass_properties import (
    MassDistribution,
    of_mesh,
    of_solid,
    point_mass,
    principal,
    sum_of,
    volume_of,
)
from exunet.bodies.mesh import closed, read_mesh
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import SOLIDS, Shape, Solid, TriangleMesh, core_of, farthest_of_core
from exunet.bodies.touched import core_as_solid, grooves
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare, prepare_case
from reference_impl import mesh_files

CASE = CASES / "verification" / "snap.toml"
# Corners and triangles of the unit cube, anticlockwise from outside.
CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def body(*keys: str) -> exunet.Case:
    return exunet.load(CASE, [f"bodies.target.{key}" for key in keys])


def made(*keys: str) -> Any:
    """The body and its state at the start."""
    start = prepare_case(body(*keys))
    return start.system.bodies[0], start.state.bodies


def solid_of(name: str) -> Solid:
    return Solid(name, SOLID_NUMBERS[name])  # type: ignore[arg-type]


def test_moments_of_solids_of_mass_one() -> None:
    """Textbook forms: a box (b2 + c2)/12, a cylinder r2/2 and (3 r2 + h2)/12, a ball 2 r2/5."""
    expected = {
        "box": (6.0, [13.0 / 12.0, 10.0 / 12.0, 5.0 / 12.0]),
        "cylinder": (0.5 * math.pi, [(0.75 + 4.0) / 12.0, (0.75 + 4.0) / 12.0, 0.125]),
        "sphere": (4.0 / 3.0 * math.pi * 0.343, [0.4 * 0.49] * 3),
    }
    for name, (volume, moments) in expected.items():
        found = of_solid(solid_of(name))
        assert found.mass == pytest.approx(volume, rel=1e-15)
        np.testing.assert_allclose(found.inertia / found.mass, np.diag(moments), rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "pieces"),
    [
        ("cylinder", [(-1.0, 1.0, lambda z: 0.5 + 0.0 * z)]),
        ("sphere", [(-0.7, 0.7, lambda z: np.sqrt(0.49 - z * z))]),
        ("frustum", [(-0.5, 0.5, lambda z: 0.4 - 0.4 * z)]),
        (
            "capsule",
            [
                (-1.05, -0.75, lambda z: np.sqrt(0.09 - (z + 0.75) ** 2)),
                (-0.75, 0.75, lambda z: 0.3 + 0.0 * z),
                (0.75, 1.05, lambda z: np.sqrt(0.09 - (z - 0.75) ** 2)),
            ],
        ),
    ],
)
def test_solids_of_revolution_against_their_discs(name: str, pieces: Any) -> None:
    """Gauss quadrature over discs of radius r(z), piece by piece: exact for these polynomials."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    sums = np.zeros(4)  # of 1, z, z2 + r2 / 4, r2 / 2 over the volume
    for low, high, outline in pieces:
        z = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        square = outline(z) ** 2
        area = math.pi * square * 0.5 * (high - low) * weights
        sums += [area.sum(), area @ z, area @ (z * z + 0.25 * square), area @ (0.5 * square)]
    found = of_solid(solid_of(name))
    assert found.mass == pytest.approx(sums[0], rel=1e-14)
    np.testing.assert_allclose(found.centre, [0.0, 0.0, sums[1] / sums[0]], atol=1e-15)
    across = sums[2] - sums[1] ** 2 / sums[0]
    np.testing.assert_allclose(found.inertia, np.diag([across, across, sums[3]]), rtol=1e-13)


def test_parts_add_up_to_the_whole() -> None:
    """A box of 2 x 2 x 2 m cut in two, one half turned by a quarter about x, is the box again."""
    whole, _ = made("shape=box", "size=[2, 2, 2]", "density=10")
    parts = (
        "parts.low={shape='box', size=[2, 2, 1], position=[0, 0, -0.5]}",
        "parts.high={shape='box', size=[2, 1, 2], position=[0, 0, 0.5], axis=[1, 0, 0]}",
        f"parts.high.angle={math.pi / 2}",
    )
    both, _ = made("density=10", *parts)
    assert both.mass == pytest.approx(whole.mass, rel=1e-15)
    np.testing.assert_allclose(both.inertia, whole.inertia, rtol=1e-14)
    np.testing.assert_allclose(both.centre, np.zeros(3), atol=1e-15)
    assert both.is_along_frame


def of_points(mass: Any, points: Any) -> MassDistribution:
    """Of masses (n,) at points (n, 3), as the integrals are written."""
    centre = mass @ points / mass.sum()
    arm = points - centre
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(mass, arm, strict=True))
    return MassDistribution(float(mass.sum()), centre, np.asarray(inertia))


def same(one: MassDistribution, other: MassDistribution) -> None:
    assert one.mass == pytest.approx(other.mass, rel=1e-14)
    np.testing.assert_allclose(one.centre, other.centre, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(one.inertia, other.inertia, rtol=0.0, atol=1e-13)


def test_distributions_of_points_are_put_together_turned_and_placed() -> None:
    """Three groups of points in one are all the points; a group goes where its points go."""
    rng = np.random.default_rng(7)
    mass, points = rng.uniform(0.1, 1.0, 12), rng.normal(size=(12, 3))
    whole = of_points(mass, points)
    parts = [of_points(mass[some], points[some]) for some in (slice(3), slice(3, 8), slice(8, 12))]
    same(sum_of(parts), whole)
    same(sum_of([*parts[:2], *(point_mass(mass[k], points[k]) for k in range(8, 12))]), whole)
    assert sum_of([whole]) is whole
    attitude, place = rng.normal(size=4), rng.normal(size=3)
    turn = rotation_matrix(attitude / np.linalg.norm(attitude))
    same(whole.placed(turn, place), of_points(mass, points @ turn.T + place))
    same(whole.times(2.5), of_points(2.5 * mass, points))


def test_the_volume_of_a_mesh_is_negative_inside_out() -> None:
    cube = 1.5 * CORNERS + [3.0, -1.0, 2.0]
    for faces, sign in ((FACES, 1.0), (FACES[:, ::-1], -1.0)):
        assert volume_of(TriangleMesh(cube, faces)) == pytest.approx(sign * 3.375, rel=1e-14)


def test_a_mesh_of_a_cube_anywhere() -> None:
    """Volume 8, moments m a2 / 6 = 16/3, far from the origin too; one that is inside out is turned."""
    for faces in (FACES, FACES[:, ::-1]):
        mesh = closed(2.0 * CORNERS + [1000.0, 0.0, 0.0], faces, "cube")
        found = of_mesh(mesh)
        assert found.mass == pytest.approx(8.0, rel=1e-12)
        np.testing.assert_allclose(found.centre, [1001.0, 1.0, 1.0], rtol=1e-14)
        np.testing.assert_allclose(found.inertia, 16.0 / 3.0 * np.eye(3), rtol=1e-12, atol=1e-12)


def test_meshes_as_trimesh_integrates_them() -> None:
    trimesh = pytest.importorskip("trimesh")
    rng = np.random.default_rng(1)
    rough = trimesh.creation.icosphere(subdivisions=2)
    rough.vertices *= rng.uniform(0.5, 1.5, (len(rough.vertices), 1)) * [1.0, 2.0, 3.0]
    found = of_mesh(closed(np.array(rough.vertices), np.array(rough.faces), "rough"))
    assert found.mass == pytest.approx(rough.volume, rel=1e-12)
    np.testing.assert_allclose(found.centre, rough.center_mass, atol=1e-12)
    np.testing.assert_allclose(found.inertia, rough.moment_inertia, atol=1e-11)


@pytest.mark.parametrize(
    ("faces"),
    [
        (FACES[1:]),
        (np.concatenate([FACES, FACES[:1]])),
        (np.concatenate([FACES[:1, ::-1], FACES[1:]])),
        (FACES[:0]),
        (np.concatenate([FACES[:1], FACES[:1, ::-1]])),
    ],
)
def test_meshes_that_enclose_nothing_are_refused(faces: Any) -> None:
    with pytest.raises(InputError, match="cube: "):
        closed(CORNERS, faces, "cube")


def test_principal_axes_of_a_turned_body() -> None:
    """The axes turned by 0.3 rad about (1, 2, 2)/3: those nearest to the frame's are found."""
    half = 0.15
    turned = np.array([math.cos(half), *(math.sin(half) * np.array([1.0, 2.0, 2.0]) / 3.0)])
    turn = rotation_matrix(turned)
    moments, axes = principal(turn @ np.diag([3.0, 2.0, 4.0]) @ turn.T)
    np.testing.assert_allclose(moments, [3.0, 2.0, 4.0], rtol=1e-14)
    np.testing.assert_allclose(axes, turned, atol=1e-14)
    for same in ([2.0, 2.0, 1.0], [1.0, 1.0, 1.0]):
        np.testing.assert_array_equal(principal(np.diag(same))[1], [1.0, 0.0, 0.0, 0.0])


def test_a_start_is_of_the_frame_and_its_result_too() -> None:
    """A body whose principal axes and centre are not those of its frame, turned by a quarter about z."""
    keys = [
        "mass=2", "inertia=[3, 2, 4]", "products_of_inertia=[0.5, 0, 0.1]", "centre_of_mass=[1, 0, 0]",
        "position=[3, 0, 0]", "velocity=[0, 0, 1]", "axis=[0, 0, 2]", f"angle={math.pi / 2}",
        "angular_velocity=[0, 0.2, 0.1]", "angular_velocity_frame=scene",
    ]  # fmt: skip
    target, state = made(*keys)
    inertia = np.array([[3.0, 0.5, 0.0], [0.5, 2.0, 0.1], [0.0, 0.1, 4.0]])
    np.testing.assert_allclose(target.inertia_in_frame, inertia, atol=1e-14)
    np.testing.assert_allclose(state.position[0], [3.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_array_equal(state.velocity[0], [0.0, 0.0, 1.0])
    turn = rotation_matrix(state.attitude[0])
    np.testing.assert_allclose(turn @ state.angular_velocity[0], [0.0, 0.2, 0.1], atol=1e-15)
    result = exunet.run(body(*keys))
    found = result.bodies["target"]
    quarter = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    np.testing.assert_allclose(found.attitude[0], quarter, atol=1e-15)
    np.testing.assert_allclose(found.angular_velocity[0], [0.2, 0.0, 0.1], atol=1e-15)
    np.testing.assert_allclose(found.inertia, inertia, atol=1e-14)
    spin = rotation_matrix(np.array(quarter)) @ inertia @ [0.2, 0.0, 0.1]
    last = rotation_matrix(found.attitude[-1]) @ inertia @ found.angular_velocity[-1]
    np.testing.assert_allclose(last, spin, atol=1e-9)
    np.testing.assert_allclose(exunet.Simulation(body(*keys)).bodies["target"].attitude, quarter, atol=1e-15)


def stl(path: Path, faces: Any = FACES) -> str:
    """The unit cube as a binary STL; keys of a body of it."""
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", len(faces)))
        for face in faces:
            file.write(struct.pack("<12fH", 0.0, 0.0, 0.0, *CORNERS[face].ravel(), 0))
    return f"bodies.target={{shape='mesh', file='{path}', unit='cm', density=1000.0}}"


def test_a_mesh_from_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cube of 1 cm of 1000 kg/m3: 1 g, moments m a2 / 6; its centre is half an edge from its corner."""
    trimesh = pytest.importorskip("trimesh")
    keys = stl(tmp_path / "cube.stl")
    (target,) = prepare_case(exunet.load(CASE, [keys])).system.bodies
    assert target.mass == pytest.approx(1e-3, rel=1e-12)
    np.testing.assert_allclose(target.inertia, [1e-7 / 6.0] * 3, rtol=1e-12)
    np.testing.assert_allclose(target.centre, [5e-3] * 3, rtol=1e-12)
    assert refused(CASE, stl(tmp_path / "open.stl", FACES[1:])) == ["bodies.target.file"]
    for ending in ("obj", "glb"):
        path = tmp_path / f"cube.{ending}"
        trimesh.Trimesh(CORNERS, FACES).export(path)
        assert of_mesh(read_mesh(path, "m")).mass == pytest.approx(1.0, rel=1e-6)  # GLB: single precision
        path.write_text("nothing")
        with pytest.raises(InputError, match=f"cube.{ending}"):
            read_mesh(path, "m")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtra):
        read_mesh(tmp_path / "cube.stl", "m")


SLIVERS = "v 0 0 0\nv 0 0 1\nv 0 1 0\nv 0 1 1\nv 0.5 0 1\nv 1 0 0\nv 1 0 1\nv 1 1 0\nv 1 1 1\n" + "".join(
    f"f {n // 100} {n // 10 % 10} {n % 10}\n"
    for n in (254, 594, 579, 186, 138, 167, 172, 275, 689, 697, 834, 849, 312, 324)
)  # the unit cube; triangle 2 7 5 has its corners in one line
OUTLINE = ((2, 0), (2, 1), (1, 2), (0, 2), (0, 1), (0, 0))  # of a square of 2 without a corner of 1 x 1 / 2
PRISM = "".join(f"v {x}\t{y} {z} # corner\r" for z in (0, 0.5) for x, y in OUTLINE) + (
    "f 6 5 4 3 2 1 # in one line: 6, 5, 4\rf 7 8 9 10 11 12\r"
    "f 1 2 8 7\rf 2 3 9 8\rf 3 4 10 9\rf 4 5 11 10\rf 5 6 12 11\rf 6 1 7 12\r"
)


@pytest.mark.parametrize(
    ("text", "volume", "centre"),
    [(SLIVERS, 1.0, (0.5, 0.5, 0.5)), (PRISM, 1.75, (19.0 / 21.0, 19.0 / 21.0, 0.25))],
)
def test_corners_in_one_line_comments_and_line_ends(
    tmp_path: Path, text: str, volume: float, centre: tuple[float, ...]
) -> None:
    """A square of area 4 without a triangle of 1/2, whose centre is at 5/3: (4 - 5/6) / 3.5 = 19/21."""
    pytest.importorskip("trimesh")
    (tmp_path / "body.obj").write_bytes(text.encode())
    mesh = read_mesh(tmp_path / "body.obj", "m")
    found = of_mesh(mesh)
    assert found.mass == pytest.approx(volume, rel=1e-12)
    np.testing.assert_allclose(found.centre, centre, rtol=1e-12)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0.1
    six = np.linalg.det(mesh_files.triangles(tmp_path / "body.obj")).sum()  # as the reference reads it
    assert six / 6.0 == pytest.approx(volume, rel=1e-12)


def test_edges_divided_on_one_side_stay_closed() -> None:
    """Edges of a cube, in three for one of their two triangles; slivers close it."""
    generator = np.random.default_rng(5)
    for _ in range(10):
        vertices, faces, slivers = list(CORNERS), FACES.tolist(), []
        for _ in range(12):
            a, b, c = faces.pop(int(generator.integers(len(faces))))
            t, m, side = generator.uniform(0.2, 0.4), len(vertices), vertices[b] - vertices[a]
            vertices += [vertices[a] + t * side, vertices[a] + 2.0 * t * side]
            faces += [[a, m, c], [m, m + 1, c], [m + 1, b, c]]
            slivers += [[a, b, m + 1], [a, m + 1, m]]
        mesh = closed(np.array(vertices), np.array(slivers + faces), "cube")
        assert volume_of(mesh) == pytest.approx(1.0, rel=1e-12)
        assert not goes_through_itself(mesh)


def test_what_a_library_logs_and_what_rounding_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Normals that are no numbers are read without a word; corners one float apart name what merges them."""
    pytest.importorskip("trimesh")
    monkeypatch.setattr(logging.getLogger(), "handlers", [])  # those of pytest
    corners = [" ".join(map(str, corner)) for corner in CORNERS]
    text = "".join(
        "facet normal 1.#IND 1.#IND 1.#IND\nouter loop\n"
        + "".join(f"vertex {corners[k]}\n" for k in face)
        + "endloop\nendfacet\n"
        for face in FACES
    )
    (tmp_path / "ind.stl").write_text(f"solid cube\n{text}endsolid\n")
    assert of_mesh(read_mesh(tmp_path / "ind.stl", "m")).mass == pytest.approx(1.0, rel=1e-12)
    assert capsys.readouterr().err == ""
    apart = np.nextafter(CORNERS[FACES].astype(np.float32), np.float32(2.0))[::2]
    vertices = np.concatenate([apart, CORNERS[FACES][1::2]]).reshape(-1, 3).astype(float)
    with pytest.raises(InputError, match="1e-06 m"):
        closed(vertices, np.arange(36).reshape(-1, 3), "cube")


def test_odd_mesh_files_are_read_or_refused_by_line(tmp_path: Path) -> None:
    """Both codes pass over bytes behind a binary STL and a byte order mark, and refuse vertex 0 of an OBJ."""
    pytest.importorskip("trimesh")
    stl(tmp_path / "more.stl")
    with (tmp_path / "more.stl").open("ab") as file:
        file.write(b"\xff" * 7)
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    for first, name in ((1, "mark"), (0, "zero")):
        faces = "".join(f"f {a + first} {b + first} {c + first}\n" for a, b, c in FACES)
        (tmp_path / f"{name}.obj").write_text(vertices + faces, encoding="utf-8-sig")
    for name in ("more.stl", "mark.obj"):
        assert of_mesh(read_mesh(tmp_path / name, "m")).mass == pytest.approx(1.0, rel=1e-6)
        assert len(mesh_files.triangles(tmp_path / name)) == len(FACES)
    with pytest.raises(InputError, match=r"zero\.obj:\d+"):
        read_mesh(tmp_path / "zero.obj", "m")
    with pytest.raises(ValueError, match=r"zero\.obj"):
        mesh_files.triangles(tmp_path / "zero.obj")


FRUSTUM = ("shape=frustum", "radii=[0.5, 0.3]", "length=2", "density=100")


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        (("mass=1",), ".inertia"),
        (("inertia=[1, 1, 1]",), ""),
        (("density=1", "inertia=[1, 1, 1]"), ".density"),
        ((*FRUSTUM, "mass=1"), ".mass"),
        ((*FRUSTUM, "inertia=[1, 1, 1]"), ".inertia"),
        ((*FRUSTUM, "radius=1"), ".radius"),
        ((*FRUSTUM, "radii=[0, 0]"), ".radii"),
        ((*FRUSTUM, "length="), ".length"),
        ((*FRUSTUM, "edge_radius=0.5"), ".edge_radius"),
        ((*FRUSTUM, "centre_of_mass=[0, 0, 0]"), ".centre_of_mass"),
        ((*FRUSTUM, "parts.a={shape='sphere', radius=1}"), ".parts"),
        ((*FRUSTUM, "axis=[0, 0, 1]"), ".axis"),
        ((*FRUSTUM, "axis=[0, 0, 0]", "angle=1"), ".axis"),
        ((*FRUSTUM, "axis=[0, 0, 1]", "angle=1", "attitude=[1, 0, 0, 0]"), ".axis"),
        (("mass=1", "shape=sphere", "radius=1", "edge_radius=0.1"), ".edge_radius"),
        (("density=1", "parts.a={shape='mesh'}"), ".parts.a.shape"),
        (("mass=1", "shape=cone"), ".shape"),
        (("mass=1", "shape=mesh", "file=x.stl", "unit=ft"), ".unit"),
        (("mass=1", "inertia=[1, 1, 1]", "products_of_inertia=[0.6, 0, 0]"), ".products_of_inertia"),
        (("mass=1", "inertia=[1e3, 1e3, 5e-12]"), ""),  # round-off beside the others
        (("density=1", "shape=box", "size=[1, 1, 1e300]"), ".size[2]"),
        (("mass=1", "shape=mesh", "file=x.step", "unit=m"), ".file"),
    ],
)
def test_wrong_keys_are_refused(keys: tuple[str, ...], key: str) -> None:
    assert refused(CASE, *(f"bodies.target.{item}" for item in keys)) == [f"bodies.target{key}"]


def test_bodies_that_overlap_or_have_one_name_are_refused() -> None:
    keys = "shape='box', size=[1, 1, 1], density=10"
    beside = [f"bodies.a={{{keys}}}", f"bodies.b={{{keys}, position=[1.0, 0, 0]}}"]
    prepare_case(exunet.load(CASE, beside))
    assert refused(CASE, *beside, "bodies.b.position=[0.9, 0, 0]") == ["bodies.b.position"]
    capital = f"bodies.A={{{keys}, position=[0, 9, 0]}}"  # HDF5 distinguishes them, some file systems do not
    assert refused(CASE, *beside, capital) == ["bodies.A"]


def pose(*place: float, attitude: Any = (1.0, 0.0, 0.0, 0.0)) -> Any:
    return np.array([[*place, *attitude]])


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_that_touch_do_not_overlap(name: str) -> None:
    """Two of one kind side by side along x, as far apart as they are wide: 1e-6 decides."""
    solid = solid_of(name)
    shape, way = Shape((solid,)), np.array([1.0, 0.0, 0.0])
    width = 2.0 * solid.farthest(way)[0]
    here = pose(0.0, 0.0, 0.0)
    assert overlap(shape, here, shape, pose(width - 1e-6, 0.0, 0.0))
    assert not overlap(shape, here, shape, pose(width, 0.0, 0.0))
    assert not overlap(shape, here, shape, pose(width + 1e-6, 0.0, 0.0))


MORE_SOLIDS = [*SOLID_NUMBERS.items(), ("frustum", (0.2, 0.9, 0.5)), ("box", (1.2, 0.7, 1.9))]


@pytest.mark.parametrize(("name", "numbers"), MORE_SOLIDS)
def test_distances_of_points_from_a_solid_that_is_turned_and_placed(name: Any, numbers: Any) -> None:
    """By its axis, or by its outline in the plane of the axis; 0 and a depth below 0 inside."""
    rng = np.random.default_rng(8)
    own, attitude = rng.normal(size=(400, 3)) * 0.6, rng.normal(size=4)
    solid = Solid(name, numbers, (0.3, -0.7, 1.1), tuple((attitude / np.linalg.norm(attitude)).tolist()))
    points = own @ solid.rotation.T + solid.position
    known = distance_from_solid(Solid(name, numbers), own)
    np.testing.assert_allclose(solid.distance(points), known, rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(solid.depth(points) < 0.0, known == 0.0)
    assert 0.05 < (known == 0.0).mean() < 0.8
    np.testing.assert_allclose(solid.place_of(0.7), solid.rotation @ [0.0, 0.0, 0.7] + solid.position)


@pytest.mark.parametrize(
    ("name", "point", "depth"),
    [
        ("box", (0.4, -0.3, 0.2), -0.1),
        ("box", (0.1, -0.95, 0.2), -0.05),
        ("box", (0.1, 0.2, -1.47), -0.03),
        ("box", (-0.9, 0.2, 1.6), 0.4),
        ("sphere", (0.3, -0.4, 0.0), -0.2),
        ("capsule", (0.06, 0.08, 0.2), -0.2),
        ("capsule", (0.06, 0.08, -0.75), -0.2),
        ("capsule", (0.08, 0.06, 0.75 + 0.24), 0.26 - 0.3),
        ("cylinder", (0.24, 0.32, 0.6), -0.1),
        ("cylinder", (0.24, 0.32, -0.97), -0.03),
        ("frustum", (0.18, 0.24, 0.1), 0.3 - 0.36),  # of the radius there, across the axis
        ("frustum", (0.06, 0.08, -0.45), -0.05),
    ],
)
def test_depths_in_solids(name: Any, point: Any, depth: float) -> None:
    assert Solid(name, SOLID_NUMBERS[name]).depth(np.array([point])) == pytest.approx([depth], abs=1e-15)


@pytest.mark.parametrize(
    ("name", "numbers", "least"),
    [
        ("box", (2.0, 0.7, 3.0), 0.7),
        ("sphere", (0.7, 0.0, 0.0), 1.4),
        ("capsule", (0.3, 0.1, 0.0), 0.6),
        ("cylinder", (0.3, 2.0, 0.0), 0.6),
        ("cylinder", (0.3, 0.4, 0.0), 0.4),
        ("frustum", (0.6, 0.2, 1.3), 0.8),  # mean width
        ("frustum", (0.5, 0.6, 0.3), 0.3),
        ("frustum", (0.15, 1.5, 1.8), 1.5),  # a ball on the wide end, of slope 3/4: 2 1.5 (5/4 - 3/4)
        ("frustum", (1.5, 0.15, 1.8), 1.5),
    ],
)
def test_least_dimensions(name: Any, numbers: Any, least: float) -> None:
    assert Solid(name, numbers).least == pytest.approx(least, rel=1e-15)


@pytest.mark.parametrize(("name", "numbers"), MORE_SOLIDS)
def test_a_core_reaches_as_far_as_its_farthest_point(name: Any, numbers: Any) -> None:
    """Of 3000 random directions; along the axis of a round one too, where it has no direction across."""
    radius, reach = core_of(name, numbers)
    ways = np.random.default_rng(6).normal(size=(3000, 3))
    assert np.linalg.norm(farthest_of_core(name, numbers, ways), axis=1).max() == pytest.approx(reach)
    solid = Solid(name, numbers, (0.3, -0.7, 1.1))
    length = numbers[1] if name in ("sphere", "capsule", "cylinder") else numbers[2]
    for sign in (1.0, -1.0):
        end = solid.farthest(np.array([0.0, 0.0, sign]))
        assert end[2] == pytest.approx(1.1 + sign * (0.5 * length + radius), rel=1e-15)
        assert np.linalg.norm(end - solid.position) <= (reach + radius) * (1.0 + 1e-15)


@pytest.mark.parametrize("overlap", [0.0, 0.02, 0.049])
def test_parts_that_abut_leave_the_groove_that_is_reported(overlap: float) -> None:
    """Two flush boxes: along their seam, the surface is where both cores are at the rounding's distance."""
    edge, size = 0.05, (1.0, 1.0, 1.0)
    boxes = Solid("box", size), Solid("box", size, (1.0 - overlap, 0.0, 0.0))
    ((first, second, depth),) = grooves(Shape(boxes, edge_radius=edge))
    assert (first, second) == (0, 1)
    on_seam = np.array([[0.5 * (1.0 - overlap), 0.0, 0.5 - depth]])
    for box in boxes:
        core, rounding = core_as_solid(box, edge)
        assert core.distance(on_seam)[0] == pytest.approx(rounding, abs=1e-9)


def test_parts_apart_round_parts_and_overlaps_by_the_rounding_have_no_groove() -> None:
    box = Solid("box", (1.0, 1.0, 1.0))
    others = [
        *(replace(box, position=(x, 0.0, 0.0)) for x in (0.95, 1.001, 0.2)),
        Solid("sphere", (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)),
    ]
    assert not [found for other in others for found in grooves(Shape((box, other), edge_radius=0.05))]


def test_a_case_names_parts_that_leave_a_groove() -> None:
    """The satellite's panel overlaps its arm by the rounding; moved by that, it abuts."""
    name, key = CASES / "capture" / "satellite.toml", "bodies.satellite.parts.panel.position"
    notes = [
        [note for note in prepare(load(name, changes)).plan.notes if "parts arm and panel" in note]
        for changes in ([], [f"{key}=[14.9, 0.0, 0.0]"])
    ]
    assert [len(found) for found in notes] == [0, 1]

"""Whether bodies of triangles overlap: by distances of convex ones, by hand, and of bodies with hollows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.bodies.distance import distances
from exunet.bodies.mass_properties import of_mesh, of_solid
from exunet.bodies.mesh import closed
from exunet.bodies.overlap import AROUND, goes_through_itself, normals_of, overlap, polyhedron
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import SOLIDS, Shape, Solid, TriangleMesh
from exunet.simulation.preparation import prepare_case

CASE = Path(__file__).parents[1] / "cases" / "verification" / "snap.toml"
HERE = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
SOLID = {
    "box": Solid("box", (1.0, 2.0, 3.0), (0.3, 0.1, 0.0)),
    "cylinder": Solid("cylinder", (0.5, 2.0, 0.0)),
    "sphere": Solid("sphere", (0.7, 0.0, 0.0)),
    "capsule": Solid("capsule", (0.5, 2.0, 0.0)),
    "frustum": Solid("frustum", (0.5, 0.0, 2.0)),
}


def box(*edges: float) -> Shape:
    return Shape(mesh=polyhedron(Solid("box", edges)))  # type: ignore[arg-type]


def at(*place: float) -> Any:
    return HERE + np.array([*place, 0.0, 0.0, 0.0, 0.0])


def both(one: Shape, other: Shape, pose: Any) -> bool:
    """Whichever comes first."""
    (found,) = overlap(one, HERE, other, pose)
    (same,) = overlap(other, pose, one, HERE)
    assert found == same
    return bool(found)


def joined(*meshes: TriangleMesh) -> Shape:
    """One mesh of several pieces."""
    shift = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = [one.triangles + k for one, k in zip(meshes, shift, strict=False)]
    return Shape(
        mesh=TriangleMesh(np.concatenate([item.vertices for item in meshes]), np.concatenate(triangles))
    )


def test_polyhedra_are_inside_their_solids() -> None:
    """Closed, with the volume of the solid but for 1 %."""
    for name in SOLIDS:
        solid = SOLID[name]
        mesh = polyhedron(solid)
        assert (closed(mesh.vertices, mesh.triangles, name).triangles.shape) == mesh.triangles.shape
        assert solid.depth(mesh.vertices).max() < 1e-12
        part = of_mesh(mesh).mass / of_solid(solid).mass
        assert 0.99 < part < 1.0 + 1e-12


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((0.0, 0.0, 0.0), True),  # all faces in one plane
        ((0.5, 0.0, 0.0), True),  # four of them
        ((0.999, 0.999, 0.0), True),
        ((0.5, 0.5, 0.5), True),
        ((1.0 - 1e-6, 0.0, 0.0), True),
        ((1.0, 0.0, 0.0), False),  # touch
        ((1.0, 0.5, 0.5), False),
        ((1.0, 1.0, 0.0), False),
        ((1.0, 1.0, 1.0), False),
        ((1.0 + 1e-6, 0.0, 0.0), False),
    ],
)
@pytest.mark.parametrize("far", [0.0, 1000.0])
def test_two_cubes(place: tuple[float, ...], expected: bool, far: float) -> None:
    """Those that touch do not overlap; those with faces in one plane do, if they share points."""
    cube, origin = box(1.0, 1.0, 1.0), at(far, 0.0, 0.0)
    assert bool(overlap(cube, origin, cube, origin + at(*place) - HERE)[0]) == expected


@pytest.mark.parametrize(("depth", "expected"), [(2.9e-9, False), (3.1e-9, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_cubes_share_points_from_three_hairs_on(depth: float, expected: bool, sign: float) -> None:
    """Faces are drawn in by 1e-9 and 2e-9 m: a hair is sqrt(3) 1e-9 m, along the diagonals of the corners."""
    cube = box(1.0, 1.0, 1.0)
    assert both(cube, cube, at(sign * (1.0 - depth), 0.0, 0.0)) == expected


def test_a_small_body_is_in_a_tetrahedron_or_is_not() -> None:
    """By the weights of its middle in the corners; where no edge goes through a face."""
    corners = np.array([[0.0, 0.0, 0.0], [3.0, 0.2, -0.1], [0.4, 2.0, 0.3], [-0.5, 0.3, 1.5]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    whole, small = Shape(mesh=closed(corners, faces, "tetrahedron")), box(1e-3, 2e-3, 1e-3)
    middles = np.random.default_rng(4).uniform(corners.min(axis=0), corners.max(axis=0), (60, 3))
    weights = np.linalg.solve((corners[1:] - corners[0]).T, (middles - corners[0]).T).T
    least = np.minimum(weights.min(axis=1), 1.0 - weights.sum(axis=1))
    middles, known = middles[np.abs(least) > 0.02], least[np.abs(least) > 0.02] > 0.0
    here = np.repeat(HERE, len(middles), axis=0)
    there = np.concatenate([middles, here[:, 3:]], axis=1)
    np.testing.assert_array_equal(overlap(whole, here, small, there), known)
    np.testing.assert_array_equal(overlap(small, there, whole, here), known)
    assert 0.05 < known.mean() < 0.5


def test_normals_of_vertices_are_means_by_angles() -> None:
    """Of a tetrahedron without any symmetry."""
    corners = np.array([[0.0, 0.0, 0.0], [3.0, 0.2, -0.1], [0.4, 2.0, 0.3], [-0.5, 0.3, 1.5]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    known = np.zeros((4, 3))
    for face in faces:
        normal = np.cross(corners[face[1]] - corners[face[0]], corners[face[2]] - corners[face[0]])
        for k in range(3):
            one, other = (corners[face[(k + way) % 3]] - corners[face[k]] for way in (1, 2))
            angle = np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))
            known[face[k]] += angle * normal / np.linalg.norm(normal)
    known /= np.linalg.norm(known, axis=1, keepdims=True)
    np.testing.assert_allclose(normals_of(TriangleMesh(corners, faces)), known, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["sphere", "capsule"])
def test_meridians_are_divided_as_circles_are(name: str) -> None:
    """From pole to pole, in steps of a circle's."""
    a, b, _ = SOLID[name].numbers
    angles = np.linspace(0.0, 0.5 * np.pi, AROUND // 4 + 1)
    known = np.unique(np.round(np.outer([1.0, -1.0], a * np.sin(angles) + 0.5 * b), 12))
    heights = np.unique(np.round(polyhedron(SOLID[name]).vertices[:, 2], 12))
    np.testing.assert_allclose(heights, known, rtol=0.0, atol=2e-12)


def test_one_in_the_other() -> None:
    cube, small = box(1.0, 1.0, 1.0), box(0.1, 0.1, 0.1)
    assert both(cube, small, HERE)
    assert both(cube, small, at(0.45, 0.0, 0.0))  # touches from inside
    assert not both(cube, small, at(0.55, 0.0, 0.0))


def test_bodies_with_hollows_and_of_several_pieces() -> None:
    """A shell, in whose hollow a ball is beside it; of two pieces the second counts too."""
    outer, inner = box(2.0, 2.0, 2.0).mesh, box(1.0, 1.0, 1.0).mesh
    assert outer is not None
    assert inner is not None
    shell = joined(outer, TriangleMesh(inner.vertices, inner.triangles[:, ::-1]))
    small = box(0.2, 0.2, 0.2)
    assert not both(shell, small, HERE)
    assert both(shell, small, at(0.45, 0.0, 0.0))  # through the wall of the hollow
    assert both(shell, small, at(0.75, 0.0, 0.0))  # within the wall
    second = polyhedron(Solid("box", (0.2, 0.2, 0.2), (9.0, 0.0, 0.0)))
    assert small.mesh is not None
    two = joined(small.mesh, second)
    assert not both(box(1.0, 1.0, 1.0), two, at(-3.0, 0.0, 0.0))
    assert both(box(1.0, 1.0, 1.0), two, at(-9.0, 0.0, 0.0))


@pytest.mark.ci
@pytest.mark.slow
def test_convex_meshes_overlap_where_they_have_no_distance() -> None:
    """Hulls of random points, at random poses: by the distance of convex bodies, known within 1e-10."""
    rng = np.random.default_rng(0)
    names = [name for name in SOLIDS if name != "sphere"]
    meshes = [Shape(mesh=polyhedron(SOLID[name])) for name in names]
    answers = []
    for _ in range(60):
        one, other = (meshes[k] for k in rng.integers(len(meshes), size=2))
        poses = rng.normal(size=(2, 1, 7))
        poses[..., :3] *= 0.7
        poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
        (apart,) = distances(one, poses[0], other, poses[1])
        (found,) = overlap(one, poses[0], other, poses[1])
        assert found == (apart == 0.0)
        answers.append(bool(found))
    assert 0.3 < np.mean(answers) < 0.95


def test_a_mesh_and_solids() -> None:
    """Of neither a vertex is in the other: a rod through a cube, and a ball and a compound within it."""
    cube = box(1.0, 1.0, 1.0)
    rod, ball = Solid("cylinder", (0.05, 5.0, 0.0)), Solid("sphere", (0.1, 0.0, 0.0))
    assert both(cube, Shape((rod,)), at(0.2, 0.1, 0.0))
    assert not both(cube, Shape((rod,)), at(0.56, 0.1, 0.0))
    assert both(cube, Shape((ball,)), HERE)
    assert not both(cube, Shape((ball,)), at(0.61, 0.0, 0.0))
    far = Solid("box", (0.1, 0.1, 0.1), (5.0, 0.0, 0.0))
    assert both(cube, Shape((far, ball)), HERE)
    assert both(cube, Shape((ball, far)), at(-5.0, 0.0, 0.0))


def rough_ball(count: int) -> Shape:
    """A ball of 2 n - 4 triangles whose corners are on a spiral, bumpy but for round-off convex."""
    from scipy.spatial import ConvexHull

    k = np.arange(count) + 0.5
    across, turn = np.arccos(1.0 - 2.0 * k / count), np.pi * (1.0 + 5.0**0.5) * k
    sine = np.sin(across)
    points = np.stack([np.cos(turn) * sine, np.sin(turn) * sine, np.cos(across)], axis=1)
    hull = ConvexHull(points)
    triangles = hull.simplices.astype(np.int64)
    one, other, third = np.moveaxis(points[triangles], 1, 0)
    outwards = np.einsum("ma,ma->m", np.cross(other - one, third - one), hull.equations[:, :3])
    triangles[outwards < 0.0] = triangles[outwards < 0.0, ::-1]
    return Shape(mesh=closed(points, triangles, "ball"))


@pytest.mark.ci
@pytest.mark.slow
def test_ten_thousand_triangles_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few of the 1e8 pairs are looked at: of balls that meet in a circle, and of one that just does not."""
    from exunet.bodies import overlap

    ball, looked = rough_ball(5000), []
    assert ball.mesh is not None
    assert len(ball.mesh.triangles) > 9900
    meet = overlap._meet

    def counted(one: Any, other: Any) -> Any:
        looked.append(len(one))
        return meet(one, other)

    monkeypatch.setattr(overlap, "_meet", counted)
    turn = np.array([0.9, 0.3, -0.2, 0.1])
    turned = np.append(np.zeros(3), turn / np.linalg.norm(turn))
    assert rotation_matrix(turned[3:])[0, 0] < 0.95
    for x, expected in ((1.0, True), (1.999, True), (2.001, False)):
        assert both(ball, ball, (turned + np.append([x, 0.0, 0.0], np.zeros(4)))[None]) == expected
    assert sum(looked) < 2e5


def cubes(*placed: tuple[float, float]) -> TriangleMesh:
    """Cubes of these edges about places along x; of a negative edge: inside out, as a hollow is."""
    vertices, triangles = [], []
    for x, edge in placed:
        one = polyhedron(Solid("box", (abs(edge), abs(edge), abs(edge)), (x, 0.0, 0.0)))
        triangles.append(one.triangles[:, :: int(np.sign(edge))] + 8 * len(vertices))
        vertices.append(one.vertices)
    return TriangleMesh(np.concatenate(vertices), np.concatenate(triangles))


@pytest.mark.parametrize(
    ("placed", "expected"),
    [
        (((0.0, 2.0),), False),
        (((0.0, 2.0), (3.0, 2.0)), False),  # beside each other
        (((0.0, 2.0), (2.0, 2.0)), False),  # face to face
        (((0.0, 2.0), (1.5, 1.0)), False),  # a face on part of a face
        (((0.0, 2.0), (1.5, 2.0)), True),  # with faces in one plane
        (((0.0, 2.0), (1.2, 1.0)), True),  # pushed in
        (((0.0, 2.0), (0.0, 1.0)), True),  # one inside the other
        (((0.0, 2.0), (0.0, -1.0)), False),  # hollow
        (((0.0, 2.0), (0.0, -1.5), (0.0, 1.0)), False),  # with a piece in the hollow
        (((0.0, 2.0), (5.0, -1.0)), True),  # a hollow in nothing
    ],
)
def test_a_mesh_that_goes_through_itself(placed: Any, expected: bool) -> None:
    assert goes_through_itself(cubes(*placed)) == expected


@pytest.mark.parametrize(("part", "expected"), [(0.95, False), (1.05, True)])
def test_pieces_of_a_mesh_go_through_each_other_from_two_and_a_half_hairs_on(
    part: float, expected: bool
) -> None:
    """A hair is 1e-9 of the diagonal of all, 2 sqrt(6) m, along the diagonals of the corners of the cubes."""
    depth = part * 2.5e-9 * 2.0 * np.sqrt(6.0) / np.sqrt(3.0)
    assert goes_through_itself(cubes((0.0, 2.0), (2.0 - depth, 2.0))) == expected


def test_octahedra_beside_each_other_do_not_go_through_themselves() -> None:
    """Their vectors inwards are along the axes."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [
        (x, y, z) if (x < 3) ^ (y < 3) ^ (z < 3) else (x, z, y)
        for x in (0, 3)
        for y in (1, 4)
        for z in (2, 5)
    ]
    one = closed(corners, np.array(faces), "octahedron")
    other = TriangleMesh(one.vertices + np.array([2.5, 0.3, 0.1]), one.triangles)
    mesh = joined(one, other).mesh
    assert mesh is not None
    assert not goes_through_itself(mesh)


def test_a_surface_in_one_piece_that_goes_through_itself() -> None:
    """A corner of a cube that is pulled through the opposite faces; pulled out or dented it is sound."""
    cube = cubes((0.0, 2.0))
    corner = int(np.flatnonzero((cube.vertices == 1.0).all(axis=1))[0])
    for pulled, expected in ((1.5, False), (0.2, False), (-1.5, True)):
        vertices = cube.vertices.copy()
        vertices[corner] = pulled
        assert goes_through_itself(TriangleMesh(vertices, cube.triangles)) == expected


# A prism of 1 m on an L of 3 m2, of which the corners 1 and 4 see all others; each cap is one face.
ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def ell(bottom: str, top: str) -> str:
    vertices = "".join(f"v {x} {y} {z}\n" for z in (0, 1) for x, y in ELL)
    sides = "".join(f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}\n" for k in range(6))
    return f"# caps\n{vertices}f {bottom}\nf {top}\n{sides}"


def test_a_concave_face_is_refused_unless_its_first_corner_sees_all_others(tmp_path: Path) -> None:
    """Its triangles have the volume of the prism, but partly lie beside it, one on the other."""
    pytest.importorskip("trimesh")
    case = tmp_path / "case.toml"
    text = "[bodies.target]\nshape = 'mesh'\nfile = 'ell.obj'\nunit = 'm'\ndensity = 100.0\n"
    case.write_text(CASE.read_text() + text)
    for bottom, top, line in (
        ("6 5 4 3 2 1", "7 8 9 10 11 12", 14),  # from corner 6
        ("1 6 5 4 3 2", "-4 -3 -2 -1 -6 -5", 15),  # from corner 9
        ("6 5 4 \\\n 3 2 1", "7 8 9 10 11 12", 14),
        ("1 6 5 4 3 2", "9 10 11 12 \\\n 7 8", 15),
    ):
        (tmp_path / "ell.obj").write_text(ell(bottom, top))
        words = rf"case\.toml:\d+: bodies\.target\.file: .*ell\.obj:{line}: the face of 6 corners is concave"
        with pytest.raises(exunet.CaseError, match=words):
            prepare_case(exunet.load(case))
    for bottom, top in (("1 6 5 4 3 2", "7 8 9 10 11 12"), ("4 3 2 1 6 5", "10/1/2 11/1/2 12/1/2 7 8 9")):
        (tmp_path / "ell.obj").write_text(ell(bottom, top))
        (target,) = prepare_case(exunet.load(case)).system.bodies
        assert target.mass == pytest.approx(300.0, rel=1e-12)


def test_a_mesh_file_that_goes_through_itself_is_refused(tmp_path: Path) -> None:
    """Two boxes of 1 x 2 x 3 m, shifted by half a metre, as one file: 12 m3 where there are 9."""
    trimesh = pytest.importorskip("trimesh")
    one, other = (trimesh.creation.box([1.0, 2.0, 3.0]) for _ in range(2))
    other.apply_translation([0.5, 0.0, 0.0])
    trimesh.util.concatenate([one, other]).export(tmp_path / "two.stl")
    case = tmp_path / "case.toml"
    text = "[bodies.target]\nshape = 'mesh'\nfile = 'two.stl'\nunit = 'm'\ndensity = 100.0\n"
    case.write_text(CASE.read_text() + text)
    with pytest.raises(
        exunet.CaseError, match=r"case\.toml:\d+: bodies\.target\.file: .*goes through itself"
    ):
        prepare_case(exunet.load(case))
    other.apply_translation([0.6, 0.0, 0.0])  # 0.1 m apart
    trimesh.util.concatenate([one, other]).export(tmp_path / "two.stl")
    (target,) = prepare_case(exunet.load(case)).system.bodies
    assert target.mass == pytest.approx(1200.0, rel=1e-6)  # of an STL's 32 bits


@pytest.mark.parametrize("ending", ["stl", "obj"])
def test_bodies_of_mesh_files_that_overlap_are_refused(tmp_path: Path, ending: str) -> None:
    """With file and line."""
    trimesh = pytest.importorskip("trimesh")
    mesh = box(1.0, 1.0, 1.0).mesh
    assert mesh is not None
    trimesh.Trimesh(mesh.vertices, mesh.triangles).export(tmp_path / f"cube.{ending}")
    text = CASE.read_text()
    for name, x in (("one", 0.0), ("two", 0.9)):
        text += f'\n[bodies.{name}]\nshape = "mesh"\nfile = "cube.{ending}"\nunit = "m"\ndensity = 10.0\n'
        text += f"position = [{x}, 9.0, 0.0]\n"
    path = tmp_path / "case.toml"
    path.write_text(text)
    line = len(text.splitlines())
    with pytest.raises(exunet.CaseError) as caught:
        prepare_case(exunet.load(path))
    expected = f"{path}:{line}: bodies.two.position: the body overlaps one at the start"
    assert str(caught.value) == expected
    prepare_case(exunet.load(path, ["bodies.two.position=[1.0, 9.0, 0.0]"]))

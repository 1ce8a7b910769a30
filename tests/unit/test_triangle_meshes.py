"""Bodies of triangles: distances, overlap, and meshes that go through themselves."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES, OUTLINE, extruded, refused

import exunet
from exunet.bodies import mesh_core
from exunet.bodies.distance import distances, goes_through_itself, normals_of, overlap, polyhedron, tree_of
from exunet.bodies.mass_properties import of_mesh, of_solid
from exunet.bodies.mesh import closed
from exunet.bodies.mesh_core import (
    fill_bricks,
    find_balls,
    find_distances,
    find_level,
    nearest,
    nearest_of_triangle,
    signed_distance,
)
from exunet.bodies.shapes import SOLIDS, Shape, Solid, TriangleMesh
from exunet.simulation.preparation import prepare_case

Floats = np.ndarray


TILTED = Solid("box", (0.6, 1.0, 0.4), (0.1, -0.2, 0.3), (0.8, 0.0, 0.6, 0.0))


def tree_and_normals(mesh: TriangleMesh) -> tuple[Any, Floats]:
    """The tree of a mesh, and the normals of faces, edges and corners."""
    corners = mesh.vertices[mesh.triangles]
    leaves, low, high = tree_of(corners)
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    normals = np.empty((len(corners), 7, 3))
    normals[:, 0], normals[:, 4:] = face, normals_of(mesh)[mesh.triangles]
    for m, one in enumerate(mesh.triangles):
        for k in range(3):
            pair = {one[k], one[(k + 1) % 3]}
            normals[m, 1 + k] = sum(face[n] for n, other in enumerate(mesh.triangles) if pair <= {*other})
    return (np.concatenate(low), np.concatenate(high), leaves, corners), normals


def by_parts(corners: Floats, place: Floats) -> tuple[float, Floats, int]:
    """Distance of a place from a triangle, the point there and on what it is: of face, edges and corners."""
    a, b, c = corners
    s, t = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), place - a, rcond=None)[0]
    found = []
    if min(s, t, 1.0 - s - t) > 0.0:
        found.append((a + s * (b - a) + t * (c - a), 0))
    for k in range(3):
        way = corners[(k + 1) % 3] - corners[k]
        part = (place - corners[k]) @ way / (way @ way)
        if 0.0 < part < 1.0:
            found.append((corners[k] + part * way, 1 + k))
        found.append((corners[k], 4 + k))
    return min(
        ((float(np.linalg.norm(place - foot)), foot, on) for foot, on in found), key=lambda item: item[0]
    )


def test_the_nearest_point_of_a_triangle() -> None:
    """Over its face and beside edges and corners, of blunt and of sharp triangles."""
    random, seen = np.random.default_rng(1), []
    for _ in range(400):
        corners = random.normal(size=(3, 3))
        place = corners.mean(axis=0) + random.normal(size=3)
        known, foot, on = by_parts(corners, place)
        square, *point, which = nearest_of_triangle(corners, *place)
        assert square == pytest.approx(known**2, rel=1e-9)
        np.testing.assert_allclose(point, foot, rtol=0.0, atol=1e-9)
        assert which == on
        seen.append(which)
    assert min(np.bincount(seen, minlength=7)) > 15


def test_the_nearest_of_many_triangles_is_found_by_its_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a cylinder of 224, few of which are computed; beyond a bound no triangle is found."""
    mesh = polyhedron(Solid("cylinder", (0.5, 1.3, 0.0), (0.1, 0.2, 0.3), (0.8, 0.0, 0.6, 0.0)))
    tree, _ = tree_and_normals(mesh)
    corners, random, stack = tree[3], np.random.default_rng(2), np.zeros(128, dtype=np.int64)
    looked = []

    def counted(one: Floats, *place: float) -> Any:
        looked.append(1)
        return nearest_of_triangle(one, *place)

    for _ in range(15):
        place = random.normal(size=3) * 0.5
        of_each = [nearest_of_triangle(corner, *place)[0] for corner in corners]
        least = min(of_each)
        with monkeypatch.context() as patch:
            patch.setattr(mesh_core, "nearest_of_triangle", counted)
            square, *point, on, which = nearest(tree, *place, np.inf, stack)
        assert square == least == of_each[which]
        assert (square, *point, on) == nearest_of_triangle(corners[which], *place)
        assert nearest(tree, *place, least, stack)[5] == -1
        assert nearest(tree, *place, least * (1.0 + 1e-12), stack)[5] >= 0
    assert len(looked) / 15 < 0.2 * len(corners)


def solid_distance(solid: Solid, place: Floats) -> float:
    """Of a box: the distance outside, that of the nearest face inside."""
    return float(solid.distance(place[None])[0] or solid.depth(place[None])[0])


def test_signed_distances_one_after_the_other() -> None:
    """From a box at random places, and along a line over one point of a face and back on it."""
    tree, normals = tree_and_normals(polyhedron(TILTED))
    random = np.random.default_rng(3)
    turn = TILTED.rotation
    line = np.array([[0.1, 0.2, 0.2 + h] for h in (0.3, 0.1, 0.0, 0.0, 1e-9, 0.3)]) @ turn.T + TILTED.position
    places = np.concatenate([random.normal(size=(100, 3)) * 0.5, line])
    found, feet = np.empty(len(places)), np.empty((len(places), 3))
    find_distances(tree, normals, places, found, feet)
    known = [solid_distance(TILTED, place) for place in places]
    np.testing.assert_allclose(found, known, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(places - feet, axis=1), np.abs(known), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(TILTED.depth(feet), 0.0, atol=1e-14)
    assert 5 < (found < 0.0).sum() < 90


def test_the_outside_of_a_surface_with_an_inner_edge() -> None:
    """Of an L, whose depth is the least of two boxes'; beside its edges and corners too."""
    mesh = extruded(OUTLINE, 0.15)
    tree, normals = tree_and_normals(mesh)
    legs = [
        Solid("box", (0.2, 0.5, 0.3), (-0.15, 0.0, 0.0)),
        Solid("box", (0.5, 0.2, 0.3), (0.0, -0.15, 0.0)),
    ]
    random, stack = np.random.default_rng(4), np.zeros(128, dtype=np.int64)
    for _ in range(200):
        place = random.uniform(-0.35, 0.35, 3)
        found = signed_distance(tree, normals, *place, np.inf, stack)[0]
        outside = min(float(leg.distance(place[None])[0]) for leg in legs)
        assert (found > 0.0) == (outside > 0.0)
        if outside > 0.0:
            assert found == pytest.approx(outside, abs=1e-14)


def test_places_where_the_distance_has_a_level() -> None:
    """On lines of a cell across the surface that is 0.1 m outside a box, round at edges and corners."""
    tree, normals = tree_and_normals(polyhedron(TILTED))
    random, level, cell = np.random.default_rng(5), 0.1, 0.25
    begin, axis, ends = [], [], []
    while len(begin) < 60:
        place, along = random.normal(size=3) * 0.5, int(random.integers(3))
        end = place + cell * np.eye(3)[along]
        both = [solid_distance(TILTED, item) - level for item in (place, end)]
        if both[0] * both[1] < 0.0:
            begin.append(place)
            axis.append(along)
            ends.append(both)
    places = np.empty((60, 6))
    find_level(tree, normals, level, np.array(begin), np.array(axis), cell, np.array(ends), places)
    for at, along, place in zip(begin, axis, places, strict=True):
        assert solid_distance(TILTED, place[:3]) == pytest.approx(level, abs=1e-13)
        way = place[:3] - at
        assert 0.0 < way[along] < cell
        np.testing.assert_array_equal(np.delete(way, along), 0.0)
        steps = 1e-6 * np.eye(3)
        known = [
            solid_distance(TILTED, place[:3] + step) - solid_distance(TILTED, place[:3] - step)
            for step in steps
        ]
        np.testing.assert_allclose(place[3:], np.array(known) / 2e-6, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_bricks_beside_a_box_along_the_grid(shift: float) -> None:
    """With grid points on its faces, and off them: two beside a face are just a cell from each other."""
    inner, outer = (Solid("box", edges) for edges in ((0.5, 1.0, 0.25), (0.75, 1.25, 0.5)))
    (core, _), (tree, normals) = tree_and_normals(polyhedron(inner)), tree_and_normals(polyhedron(outer))
    corner, samples = np.array([0.0, -0.375, 0.125]) + shift, np.empty((1, 7, 7, 7))
    fill_bricks(core, tree, normals, -0.125, corner, 0.125, np.array([[-1, 0, 0]]), samples)
    for place in np.ndindex(7, 7, 7):
        at = corner + 0.125 * (np.array([-4.0, 0.0, 0.0]) + place - 1.0)
        assert samples[0][place] == pytest.approx(solid_distance(inner, at), abs=1e-15)
    assert (samples == 0.0).any() == (shift == 0.0)
    assert (samples[..., 0] < 0.0).any()  # lines that begin inside


@pytest.mark.parametrize(("degrees", "finite"), [(40.0, True), (50.0, True), (75.0, False), (100.0, False)])
def test_balls_in_a_wedge(degrees: float, finite: bool) -> None:
    """Touching one side at a way from the edge; they touch the other at that, times tan of half the angle."""
    angle = math.radians(degrees)
    outline = [(0.0, 0.0), (3.0, 0.0), (3.0 * math.cos(angle), 3.0 * math.sin(angle))]
    mesh = extruded(outline, 2.0)
    attitude = Solid("box", (1.0, 1.0, 1.0), attitude=(0.8, 0.2, 0.4, 0.4)).rotation
    tree, normals = tree_and_normals(closed(mesh.vertices @ attitude.T, mesh.triangles, "wedge"))
    ways = np.array([0.1, 0.2, 0.3])
    feet = np.stack([ways, 0.0 * ways, [0.1, -0.4, 0.5]], axis=1) @ attitude.T
    inwards = np.tile(attitude[:, 1], (3, 1))
    radii = np.full(3, 2.5)
    find_balls(tree, normals, feet, inwards, radii)
    known = ways * math.tan(0.5 * angle) if finite else np.full(3, np.inf)
    np.testing.assert_allclose(radii, known, rtol=0.01)


CASE = CASES / "verification" / "snap.toml"
HERE = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
SOLID = {
    "box": Solid("box", (1.0, 2.0, 3.0), (0.3, 0.1, 0.0)),
    "cylinder": Solid("cylinder", (0.5, 2.0, 0.0)),
    "sphere": Solid("sphere", (0.7, 0.0, 0.0)),
    "capsule": Solid("capsule", (0.5, 2.0, 0.0)),
    "frustum": Solid("frustum", (0.5, 0.0, 2.0)),
}


TETRAHEDRON = (
    np.array([[0.0, 0.0, 0.0], [3.0, 0.2, -0.1], [0.4, 2.0, 0.3], [-0.5, 0.3, 1.5]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


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


def test_a_small_body_is_in_a_tetrahedron_or_is_not() -> None:
    """By the weights of its middle in the corners; where no edge goes through a face."""
    corners, faces = TETRAHEDRON
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
    corners, faces = TETRAHEDRON
    known = np.zeros((4, 3))
    for face in faces:
        normal = np.cross(corners[face[1]] - corners[face[0]], corners[face[2]] - corners[face[0]])
        for k in range(3):
            one, other = (corners[face[(k + way) % 3]] - corners[face[k]] for way in (1, 2))
            angle = np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))
            known[face[k]] += angle * normal / np.linalg.norm(normal)
    known /= np.linalg.norm(known, axis=1, keepdims=True)
    np.testing.assert_allclose(normals_of(TriangleMesh(corners, faces)), known, rtol=0.0, atol=1e-14)


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


def test_a_ball_in_the_notch_of_an_angle() -> None:
    """It shares points with the hull of the L; 0.15 m from its faces, 0.212 m from the inner edge."""
    angle = Shape(mesh=extruded(OUTLINE, 0.05))
    for radius, shares in ((0.14, False), (0.16, True)):
        assert both(angle, Shape((Solid("sphere", (radius, 0.0, 0.0)),)), at(0.1, 0.1, 0.0)) == shares


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


def target(path: Path) -> str:
    return f"bodies.target={{shape='mesh', file='{path}', unit='m', density=100.0}}"


def mass_of(path: Path) -> float:
    (body,) = prepare_case(exunet.load(CASE, [target(path)])).system.bodies
    return body.mass


def test_a_concave_face_is_refused_unless_its_first_corner_sees_all_others(tmp_path: Path) -> None:
    """Its triangles have the volume of the prism, but partly lie beside it, one on the other."""
    pytest.importorskip("trimesh")
    path = tmp_path / "ell.obj"
    for bottom, top in (
        ("6 5 4 3 2 1", "7 8 9 10 11 12"),  # from corner 6
        ("1 6 5 4 3 2", "-4 -3 -2 -1 -6 -5"),  # from corner 9
        ("1 6 5 4 3 2", "9 10 11 12 \\\n 7 8"),
    ):
        path.write_text(ell(bottom, top))
        assert refused(CASE, target(path)) == ["bodies.target.file"]
    for bottom, top in (("1 6 5 4 3 2", "7 8 9 10 11 12"), ("4 3 2 1 6 5", "10/1/2 11/1/2 12/1/2 7 8 9")):
        path.write_text(ell(bottom, top))
        assert mass_of(path) == pytest.approx(300.0, rel=1e-12)


def test_a_mesh_file_that_goes_through_itself_is_refused(tmp_path: Path) -> None:
    """Two boxes of 1 x 2 x 3 m, shifted by half a metre, in a file: 12 m3 where there are 9; then apart."""
    trimesh = pytest.importorskip("trimesh")
    first, other = (trimesh.creation.box([1.0, 2.0, 3.0]) for _ in range(2))
    path = tmp_path / "two.stl"
    trimesh.util.concatenate([first, other.apply_translation([0.5, 0.0, 0.0])]).export(path)
    assert refused(CASE, target(path)) == ["bodies.target.file"]
    trimesh.util.concatenate([first, other.apply_translation([0.6, 0.0, 0.0])]).export(path)  # 0.1 m apart
    assert mass_of(path) == pytest.approx(1200.0, rel=1e-6)  # of an STL's 32 bits
    beside = target(path).replace("target", "beside").replace("}", ", position=[0.5, 2.0, 0.0]}")
    prepare_case(exunet.load(CASE, [target(path), beside]))
    assert refused(CASE, target(path), beside, "bodies.beside.position=[0.5, 1.9, 0.0]") == [
        "bodies.beside.position"
    ]

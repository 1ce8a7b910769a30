"""Distances from closed surfaces of triangles: the loops as plain Python, against other routes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from meshes import OUTLINE, extruded

from exunet.bodies import triangle_loops
from exunet.bodies.mesh import closed
from exunet.bodies.overlap import normals_of, polyhedron, tree_of
from exunet.bodies.shapes import Solid, TriangleMesh
from exunet.bodies.triangle_loops import (
    fill_bricks,
    find_balls,
    find_distances,
    find_level,
    nearest,
    nearest_of_triangle,
    signed_distance,
)

Floats = np.ndarray
BOX = Solid("box", (0.6, 1.0, 0.4), (0.1, -0.2, 0.3), (0.8, 0.0, 0.6, 0.0))


def of_mesh(mesh: TriangleMesh) -> tuple[Any, Floats]:
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


@pytest.mark.parametrize(
    ("place", "foot", "on"),
    [
        ((0, 0), (0, 0), 4), ((2, 0), (2, 0), 5), ((0, 1), (0, 1), 6),
        ((1, 0), (1, 0), 1), ((1, 0.5), (1, 0.5), 2), ((0, 0.5), (0, 0.5), 3),
        ((0, -1), (0, 0), 4), ((-1, 0), (0, 0), 4), ((2, -1), (2, 0), 5), ((3, 2), (2, 0), 5),
        ((1, 3), (0, 1), 6), ((-1, 1), (0, 1), 6),
    ],
)  # fmt: skip
def test_places_over_corners_and_edges_are_on_them(place: Any, foot: Any, on: int) -> None:
    """Of a triangle whose numbers have no round-off; where two parts are as near, a corner comes first."""
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    square = float((place[0] - foot[0]) ** 2 + (place[1] - foot[1]) ** 2) + 0.25
    assert nearest_of_triangle(corners, *map(float, place), 0.5) == (square, *foot, 0.0, on)


def test_the_nearest_triangle_of_many_and_few_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball of 224 triangles; beyond a bound there is none, and the bound itself is beyond."""
    mesh = polyhedron(Solid("cylinder", (0.5, 1.3, 0.0), (0.1, 0.2, 0.3), (0.8, 0.0, 0.6, 0.0)))
    tree, _ = of_mesh(mesh)
    corners, random, stack = tree[3], np.random.default_rng(2), np.zeros(128, dtype=np.int64)
    looked = []

    def counted(one: Floats, *place: float) -> Any:
        looked.append(1)
        return nearest_of_triangle(one, *place)

    for _ in range(40):
        place = random.normal(size=3) * 0.5
        of_each = [nearest_of_triangle(corner, *place)[0] for corner in corners]
        least = min(of_each)
        with monkeypatch.context() as patch:
            patch.setattr(triangle_loops, "nearest_of_triangle", counted)
            square, *point, on, which = nearest(tree, *place, np.inf, stack)
        assert square == least == of_each[which]
        assert (square, *point, on) == nearest_of_triangle(corners[which], *place)
        assert nearest(tree, *place, least, stack)[5] == -1
        assert nearest(tree, *place, least * (1.0 + 1e-12), stack)[5] >= 0
    assert len(looked) / 40 < 0.2 * len(corners)


def solid_distance(solid: Solid, place: Floats) -> float:
    """Of a box: the distance outside, that of the nearest face inside."""
    return float(solid.distance(place[None])[0] or solid.depth(place[None])[0])


def test_signed_distances_one_after_the_other() -> None:
    """From a box at random places, and along a line over one point of a face and back on it."""
    tree, normals = of_mesh(polyhedron(BOX))
    random = np.random.default_rng(3)
    turn = BOX.rotation
    line = np.array([[0.1, 0.2, 0.2 + h] for h in (0.3, 0.1, 0.0, 0.0, 1e-9, 0.3)]) @ turn.T + BOX.position
    places = np.concatenate([random.normal(size=(100, 3)) * 0.5, line])
    found, feet = np.empty(len(places)), np.empty((len(places), 3))
    find_distances(tree, normals, places, found, feet)
    known = [solid_distance(BOX, place) for place in places]
    np.testing.assert_allclose(found, known, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(places - feet, axis=1), np.abs(known), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(BOX.depth(feet), 0.0, atol=1e-14)
    assert 5 < (found < 0.0).sum() < 90


def test_the_distance_after_one_of_a_place_on_the_surface() -> None:
    """Of the middle, 0.2 m below a face, after its foot: nothing was found nearer than that, then 0 m."""
    solid = Solid("box", (0.6, 1.0, 0.4), attitude=BOX.attitude)
    tree, normals = of_mesh(polyhedron(solid))
    places = np.array([[0.15, 0.2, 0.3], [0.15, 0.2, 0.2], [0.0, 0.0, 0.0]]) @ solid.rotation.T
    found, feet = np.empty(3), np.empty((3, 3))
    find_distances(tree, normals, places, found, feet)
    np.testing.assert_allclose(found, [0.1, 0.0, -0.2], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(feet[1], places[1], rtol=0.0, atol=1e-15)
    corner = polyhedron(solid).vertices[3]
    places = np.array([corner, corner, 0.0 * corner])  # where there is no round-off, and nothing is nearer
    find_distances(tree, normals, places, found, feet)
    np.testing.assert_allclose(found, [0.0, 0.0, -0.2], rtol=0.0, atol=1e-15)


def test_the_outside_of_a_surface_with_an_inner_edge() -> None:
    """Of an L, whose depth is the least of two boxes'; beside its edges and corners too."""
    mesh = extruded(OUTLINE, 0.15)
    tree, normals = of_mesh(mesh)
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
    tree, normals = of_mesh(polyhedron(BOX))
    random, level, cell = np.random.default_rng(5), 0.1, 0.25
    begin, axis, ends = [], [], []
    while len(begin) < 60:
        place, along = random.normal(size=3) * 0.5, int(random.integers(3))
        end = place + cell * np.eye(3)[along]
        both = [solid_distance(BOX, item) - level for item in (place, end)]
        if both[0] * both[1] < 0.0:
            begin.append(place)
            axis.append(along)
            ends.append(both)
    places = np.empty((60, 6))
    find_level(tree, normals, level, np.array(begin), np.array(axis), cell, np.array(ends), places)
    for at, along, place in zip(begin, axis, places, strict=True):
        assert solid_distance(BOX, place[:3]) == pytest.approx(level, abs=1e-13)
        way = place[:3] - at
        assert 0.0 < way[along] < cell
        np.testing.assert_array_equal(np.delete(way, along), 0.0)
        steps = 1e-6 * np.eye(3)
        known = [
            solid_distance(BOX, place[:3] + step) - solid_distance(BOX, place[:3] - step) for step in steps
        ]
        np.testing.assert_allclose(place[3:], np.array(known) / 2e-6, rtol=0.0, atol=1e-8)


def test_bricks_of_distances_from_an_inner_surface() -> None:
    """Of a box that is 0.05 m inside another: below 0 inside of the inner one."""
    inner = Solid("box", (0.5, 0.9, 0.3), BOX.position, BOX.attitude)
    (core, _), (tree, normals) = of_mesh(polyhedron(inner)), of_mesh(polyhedron(BOX))
    corner, cell = np.array([-0.35, -0.7, -0.1]), 0.11
    bricks = np.array([[0, 0, 0], [1, 2, 0], [0, 1, 1]])
    samples = np.empty((3, 5, 5, 5))
    fill_bricks(core, tree, normals, -0.05, corner, cell, bricks, samples)
    for brick, values in zip(bricks, samples, strict=True):
        for place in np.ndindex(5, 5, 5):
            at = corner + cell * (2.0 * brick + place - 1.0)
            assert values[place] == pytest.approx(solid_distance(inner, at), abs=1e-14)
    assert 10 < (samples < 0.0).sum() < 250


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_bricks_beside_a_box_along_the_grid(shift: float) -> None:
    """With grid points on its faces, and off them: two beside a face are just a cell from each other."""
    inner, outer = (Solid("box", edges) for edges in ((0.5, 1.0, 0.25), (0.75, 1.25, 0.5)))
    (core, _), (tree, normals) = of_mesh(polyhedron(inner)), of_mesh(polyhedron(outer))
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
    tree, normals = of_mesh(closed(mesh.vertices @ attitude.T, mesh.triangles, "wedge"))
    ways = np.array([0.1, 0.2, 0.3])
    feet = np.stack([ways, 0.0 * ways, [0.1, -0.4, 0.5]], axis=1) @ attitude.T
    inwards = np.tile(attitude[:, 1], (3, 1))
    radii = np.full(3, 2.5)
    find_balls(tree, normals, feet, inwards, radii)
    known = ways * math.tan(0.5 * angle) if finite else np.full(3, np.inf)
    np.testing.assert_allclose(radii, known, rtol=0.01)


def test_balls_between_two_faces_and_beside_an_edge() -> None:
    """Of a box of 0.4 m: half of that; where a side is nearer, a quarter of a turn away, none."""
    feet = np.array([[0.05, 0.1, 0.2], [-0.02, -0.1, 0.2], [0.2, 0.1, 0.2]]) @ BOX.rotation.T + BOX.position
    radii = np.full(3, 5.0)
    find_balls(*of_mesh(polyhedron(BOX)), feet, np.tile(-BOX.rotation[:, 2], (3, 1)), radii)
    np.testing.assert_allclose(radii, [0.2, 0.2, np.inf], rtol=0.01)

"""The core of a mesh and the distance from it on a grid, and the force of a thread on it, in plain Python."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from meshes import OUTLINE, extruded
from touched_solids import body_of, contact_of

from exunet.base.errors import CaseError
from exunet.bodies.overlap import polyhedron
from exunet.bodies.shapes import Shape, Solid, TriangleMesh
from exunet.bodies.touched import SampledCore, surface_of, surface_of_mesh
from exunet.forces.contact.segment_surface import find_pieces, find_spans, touch, touch_pieces
from exunet.forces.contact.signed_distance import any_core_gradient, sampled_distance
from exunet.forces.cores import BRICK, STENCIL, Samples, Surface, no_samples
from exunet.model import mesh_core
from exunet.model.mesh_core import core_of_mesh
from exunet.results.touching import touch_mesh

Floats = np.ndarray
EDGE, THICK = 0.08, 0.01  # m
BOX = Solid("box", (0.6, 1.0, 0.4))
REST = (0.0, 0.0, 0.0)


def ball(radius: float, subdivisions: int) -> TriangleMesh:
    made = pytest.importorskip("trimesh").creation.icosphere(subdivisions=subdivisions, radius=radius)
    return TriangleMesh(np.array(made.vertices), np.array(made.faces, dtype=np.int64))


def meshed(mesh: TriangleMesh, spacing: float | None = None, edge: float = EDGE) -> Surface:
    """The surface of a body with the axes of `body_of`."""
    shape = Shape(mesh=mesh, edge_radius=edge, grid_spacing=spacing)
    body = body_of(())
    body = type(body)(body.name, body.mass, body.inertia, body.centre, body.axes, shape)
    return surface_of_mesh(body, core_of_mesh("b", shape, THICK), np.zeros(0, dtype=np.int64))


def places(known: Surface, number: int, low: float, high: float) -> Floats:
    """(n, 3) in principal axes, at distances from the core between these [m]."""
    random, found = np.random.default_rng(5), []
    while len(found) < number:
        place = random.uniform(-0.8, 0.8, 3)
        if low < any_core_gradient(known.cores, 0, *place)[0] < high:
            found.append(place)
    return np.array(found)


def differences(known: Surface, found: Surface, where: Floats) -> tuple[float, float]:
    """Largest one of distances [m], and mean one of gradients."""
    sides = [[any_core_gradient(own.cores, 0, *place) for place in where] for own in (known, found)]
    apart = np.array(sides[0]) - sides[1]
    return float(np.abs(apart[:, 0]).max()), float(np.linalg.norm(apart[:, 1:], axis=1).mean())


def on_thread(c: Any, a: Floats, b: Floats, v: Any = REST, w: Any = REST) -> Floats:
    """(12,) what `touch_pieces` finds."""
    a, b = tuple(a.tolist()), tuple(b.tolist())
    m, _ = find_pieces(c, 0, a, b)
    c.sums[:] = 0.0
    if m:
        touch_pieces(c, 0, v, w, m, c.sums)
    return c.sums.copy()


def pieces_of(touched: Surface, length: float, **keys: Any) -> Any:
    return contact_of(touched, pieces=int(np.ceil(length / touched.cores.cell)), **keys)


@pytest.mark.slow
def test_the_distance_from_a_box_converges_to_that_of_the_solid() -> None:
    """Beside faces it is exact to round-off; round edges it is of second order and better."""
    known = surface_of(body_of((BOX,), EDGE))
    assert known is not None
    where = places(known, 600, 0.5 * EDGE, EDGE + THICK)
    errors = []
    for part in (2.0, 4.0, 8.0):
        found = meshed(polyhedron(BOX), EDGE / part)
        errors.append(differences(known, found, where))
        assert found.least == pytest.approx(known.least, rel=1e-9)
        assert found.allowed == known.allowed
        assert found.bends == 0.0  # it has no inner edge
    far, slope = np.array(errors).T
    assert far[0] < 0.04 * EDGE
    assert (far[1:] < 0.36 * far[:-1]).all()  # 2.4e-2, 6.1e-3 and 1.6e-3 of the edge radius
    assert (slope[1:] < 0.6 * slope[:-1]).all()
    inner = np.array([[x, y, 0.2 + 0.2 * THICK] for x in (-0.1, 0.05) for y in (-0.2, 0.0, 0.3)])
    body = body_of((BOX,), EDGE)
    beside = (inner - body.centre) @ body.rotation
    assert max(differences(known, found, beside)) < 1e-12


def test_the_error_is_that_of_all_that_is_touched() -> None:
    """By something as thick as the edge radius too; beside that of the solid, which the mesh is to be."""
    shape = Shape(mesh=polyhedron(BOX), edge_radius=EDGE, grid_spacing=0.5 * EDGE)
    core, known = core_of_mesh("b", shape, EDGE), surface_of(body_of((BOX,), EDGE))
    assert known is not None
    found = surface_of_mesh(replace(body_of(()), shape=shape), core, np.zeros(0, dtype=np.int64))
    where = places(known, 80, 0.25 * EDGE, 2.0 * EDGE)
    assert core.error == pytest.approx(differences(known, found, where)[0], rel=0.5)  # 2.0 and 1.6 mm


def test_what_is_thin_may_be_entered_by_half_of_its_least_dimension() -> None:
    """Of half a thickness of 0.12 m, with edges of 0.08 m: 0.06 m."""
    body = replace(body_of(()), shape=Shape(mesh=polyhedron(BOX), edge_radius=EDGE))
    core = SampledCore(Samples(*no_samples()), 0.12, 0.0, 0.0)
    found = surface_of_mesh(body, core, np.zeros(0, dtype=np.int64))
    assert (found.allowed, found.least) == (0.06, 0.12)


@pytest.mark.slow
def test_a_ball_of_triangles_is_touched_as_a_ball() -> None:
    """But for its facets, whose middles are up to 0.45 mm inside: 0.5 m (1 - cos 0.042)."""
    known = surface_of(body_of((Solid("sphere", (0.5, 0.0, 0.0)),)))
    assert known is not None
    found = meshed(ball(0.5, 4))
    random = np.random.default_rng(2)
    body = body_of((BOX,))
    ways = random.normal(size=(200, 3))
    ways *= random.uniform(0.46, 0.5 + THICK, (200, 1)) / np.linalg.norm(ways, axis=1, keepdims=True)
    for place in (ways - body.centre) @ body.rotation:
        d, *gradient = any_core_gradient(found.cores, 0, *place)
        e, *outwards = any_core_gradient(known.cores, 0, *place)
        assert -1e-5 < (d - EDGE) - (e - 0.5) < 5e-4  # depths are EDGE - d and 0.5 - e
        assert np.abs(np.array(gradient) - outwards).max() < 0.02


@pytest.mark.slow
def test_force_and_moment_on_a_thread_converge_to_those_of_the_solid() -> None:
    known = surface_of(body_of((BOX,), EDGE))
    assert known is not None
    random, body = np.random.default_rng(8), body_of((BOX,), EDGE)
    solid = contact_of(known, damping=0.4, thick=THICK)
    finds: list[list[Floats]] = [[] for _ in range(4)]
    grids = [meshed(polyhedron(BOX), EDGE / part) for part in (2.0, 4.0, 8.0)]
    while len(finds[0]) < 30:
        middle = random.uniform(-0.6, 0.6, 3)
        a, b = (middle + sign * random.normal(size=3) * 0.15 for sign in (1.0, -1.0))
        a, b = ((entry - body.centre) @ body.rotation for entry in (a, b))
        v, w = (tuple(random.normal(size=3)) for _ in range(2))
        m, _ = find_spans(solid, THICK, tuple(a), tuple(b))
        if not m or not touch(solid, THICK, v, w, m, solid.sums) or not 0.01 < solid.sums[10] < 0.05:
            continue
        finds[0].append(solid.sums.copy())
        for own, grid in zip(finds[1:], grids, strict=True):
            c = pieces_of(grid, float(np.linalg.norm(b - a)), damping=0.4, thick=THICK)
            own.append(on_thread(c, a, b, v, w))
    exact, *found = (np.array(find)[:, :10] for find in finds)
    errors = [float(np.linalg.norm(item - exact) / np.linalg.norm(exact)) for item in found]
    assert errors[0] < 0.02  # 1.1e-2, 2.4e-3 and 5.5e-4
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 0.4 * errors[1]


@pytest.mark.ci_for("over an inner edge")
@pytest.mark.slow
@pytest.mark.parametrize("what", ["over an outer edge", "over an inner edge"])
def test_the_force_is_continuous_and_has_a_potential(what: str) -> None:
    """Along a way over an edge no step of 1e-6 m changes it by more than a few times stiffness times that."""
    touched = meshed(extruded(OUTLINE, 0.15), 0.005, 0.02)
    c = pieces_of(touched, 0.2, thick=THICK)
    body = body_of((BOX,))
    outer = what == "over an outer edge"
    corner = np.array([0.245, -0.055, 0.0] if outer else [-0.047, -0.047, 0.0])
    along, across = np.array([0.02, 0.02, 0.2]), np.array([1.0, -1.0, 0.1]) / np.sqrt(2.01)

    def at(way: float) -> Floats:
        middle = corner + way * across
        a, b = ((middle + sign * 0.5 * along - body.centre) @ body.rotation for sign in (-1.0, 1.0))
        return on_thread(c, a, b)

    ways = np.linspace(-0.015, 0.015, 61)
    for way in ways:
        here, there = at(way), at(way + 1e-6)
        assert np.abs(there[:6] - here[:6]).max() < 12.0 * 3.0 * 1e-6
    turned = across @ body.rotation
    differs = False
    for way in ways[::6]:
        slope = (at(way + 1e-6)[9] - at(way - 1e-6)[9]) / 2e-6
        push = at(way)[:3] @ turned
        differs = differs or abs(push) > 1e-3
        assert slope == pytest.approx(-push, abs=1e-7)
    assert differs


@pytest.mark.slow
def test_pieces_that_are_left_out_do_not_touch() -> None:
    """Force and energy of random threads, by all of their places, looked at one by one."""
    touched = meshed(extruded(OUTLINE, 0.15), 0.008, 0.02)
    random, number = np.random.default_rng(3), 0
    body = body_of((BOX,))
    for _ in range(60):
        middle = random.uniform(-0.3, 0.3, 3)
        ends = [middle + random.normal(size=3) * random.choice([0.02, 0.1, 0.4]) for _ in range(2)]
        a, b = ((end - body.centre) @ body.rotation for end in ends)
        c = pieces_of(touched, float(np.linalg.norm(b - a)), thick=THICK)
        some = on_thread(c, a, b)
        m, clear = find_pieces(c, 0, tuple(a), tuple(b))
        pieces, push, stored, nearest = int(c.pieces[0]), np.zeros(3), 0.0, np.inf
        for s in ((item + place) / pieces for item in range(pieces) for place in c.rule[0, :2]):
            d, *gradient = any_core_gradient(touched.cores, 0, *(a + s * (b - a)))
            p, nearest = max(0.02 + THICK - d, 0.0), min(nearest, d - 0.02 - THICK)
            push += 3.0 * p * np.array(gradient) * 0.5 / pieces
            stored += 1.5 * p * p * 0.5 / pieces
        assert (m > 0) == (nearest < 0.0)
        assert clear <= max(nearest, 0.0) or nearest > 0.016  # beyond two cells it is a lower bound only
        np.testing.assert_allclose(some[:3], push, rtol=0.0, atol=1e-12)
        assert some[9] == pytest.approx(stored, abs=1e-12)
        number += m > 0
    assert 10 < number < 50


def test_an_inner_edge_makes_contact_steeper() -> None:
    """There the direction turns within a cell or two; the bound is what a second difference finds."""
    touched = meshed(extruded(OUTLINE, 0.15), 0.01, 0.02)
    assert 0.5 / 0.01 < touched.bends < 8.0 / 0.01
    assert touched.least == pytest.approx(0.1)
    assert touched.allowed == 0.02


def test_lines_that_touch_are_found_in_results() -> None:
    shape = Shape(mesh=extruded(OUTLINE, 0.15), edge_radius=0.02, grid_spacing=0.01)
    core = core_of_mesh("b", shape, THICK)
    ends = {  # from where to where, and whether that comes nearer than 1 cm
        ((-0.4, -0.1, 0.155), (0.4, -0.1, 0.155)): True,
        ((-0.4, -0.1, 0.165), (0.4, -0.1, 0.165)): False,
        ((0.1, 0.1, -1.0), (0.1, 0.1, 1.0)): False,  # in front of the inner edge
        ((0.1, -0.045, -1.0), (0.1, -0.045, 1.0)): True,
        ((3.0, 3.0, 3.0), (4.0, 3.0, 3.0)): False,
    }
    start, end = np.array(list(ends)).swapaxes(0, 1)
    reach = np.full(len(ends), 0.02 + THICK)
    assert touch_mesh(core, reach, start, end).tolist() == list(ends.values())


def test_lines_that_touch_by_all_of_their_places() -> None:
    """Long and short, each of its own radius; places are half a cell apart, so a little is left open."""
    shape = Shape(mesh=extruded(OUTLINE, 0.15), edge_radius=0.02, grid_spacing=0.01)
    core, rng = core_of_mesh("b", shape, THICK), np.random.default_rng(11)
    middle = rng.uniform(-0.35, 0.35, (28, 3))
    way = rng.normal(size=(28, 3)) * rng.choice([0.02, 0.1, 0.4], 28)[:, None]
    start, end, reach = middle - 0.7 * way, middle + way, 0.02 + rng.uniform(0.0, THICK, 28)
    parts = np.linspace(0.0, 1.0, 41)[:, None]
    least = [
        min(sampled_distance(core.samples, *part)[0] for part in (a + parts * (b - a)).tolist())
        for a, b in zip(start, end, strict=True)
    ]
    clear = np.array(least) - reach
    sure = (clear > 1e-4) | (clear < -0.005)
    found = touch_mesh(core, reach, start, end)
    np.testing.assert_array_equal(found[sure], clear[sure] < 0.0)
    assert 5 < found.sum() < 23
    assert sure.sum() > 23


COARSE = Shape(mesh=extruded(OUTLINE, 0.15), edge_radius=0.05, grid_spacing=0.03)


def test_the_grid_round_a_mesh() -> None:
    """Bricks of whole cells round the mesh, with what touches it and three cells on either side."""
    samples = core_of_mesh("grid", COARSE, THICK).samples
    assert COARSE.mesh is not None
    low, high = COARSE.mesh.vertices.min(axis=0), COARSE.mesh.vertices.max(axis=0)
    room, brick = THICK + 3.0 * 0.03, BRICK * 0.03
    number = np.ceil((high - low + 2.0 * room) / brick)
    assert samples.bricks.shape == tuple(number.astype(int))
    assert (samples.cell, samples.beyond) == (0.03, pytest.approx(0.05 + THICK + 2.0 * 0.03, rel=1e-15))
    np.testing.assert_allclose(samples.corner + 0.5 * number * brick, 0.5 * (low + high), atol=1e-15)
    where = np.stack(np.nonzero(samples.bricks >= 0), axis=1)
    # Of bricks without samples the sign and a lower bound of the distance are known.
    middles = samples.corner + brick * (where + 0.5)
    assert len(middles) == samples.values.size // STENCIL**3
    assert sorted(samples.bricks[samples.bricks >= 0].tolist()) == list(range(len(middles)))


def test_samples_that_take_too_much_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """8 bytes each; the grid itself, of 16 bytes a brick, is refused before it is made."""
    samples = core_of_mesh("grid", COARSE, THICK).samples
    size, grid = samples.values.nbytes, samples.bricks.size * 16
    assert grid < size
    monkeypatch.setattr(mesh_core, "MOST_BYTES", size)
    assert core_of_mesh("enough", COARSE, THICK).samples.values.nbytes == size
    for most, words in ((size - 1, f"which takes {size / 1024**2:.0f} MB"), (grid - 1, "of the distance")):
        monkeypatch.setattr(mesh_core, "MOST_BYTES", most)
        with pytest.raises(CaseError, match=words) as caught:
            core_of_mesh(f"less than {most}", COARSE, THICK)
        assert caught.value.faults[0].key == f"bodies.less than {most}.edge_radius"
    monkeypatch.setattr(mesh_core, "MOST_BYTES", grid)
    with pytest.raises(CaseError, match="which takes"):
        core_of_mesh("grid only", COARSE, THICK)


def test_a_mesh_beyond_the_memory_is_refused_by_a_division_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A grid of 2 mm around a box: the bound from its volume suffices, no distance is computed."""
    monkeypatch.setattr(mesh_core, "_outer", lambda mesh: pytest.fail("distances were prepared"))
    shape = Shape(mesh=polyhedron(BOX), edge_radius=EDGE, grid_spacing=0.002)
    monkeypatch.setattr(mesh_core, "MOST_BYTES", 64 * 1024**2)
    with pytest.raises(CaseError, match=r"bodies\.block\.edge_radius"):
        core_of_mesh("block", shape, 0.05)


@pytest.mark.parametrize("reach", [0.0, 0.05])
def test_the_bound_of_samples_is_below_their_number(reach: float) -> None:
    """By the Brunn-Minkowski inequality: useful for a compact body, weak for one with an inner edge."""
    for mesh, useful in ((polyhedron(BOX), 0.2), (extruded(OUTLINE, 0.15), 0.05)):
        core = core_of_mesh("block", Shape(mesh=mesh, edge_radius=0.05, grid_spacing=0.02), reach)
        bricks = int((core.samples.bricks >= 0).sum())
        assert useful * bricks < mesh_core._min_samples(mesh, 0.05, 0.02, reach) < bricks

"""Contact of threads with meshes, as plain Python: the sampled distance from the core, and forces."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import OUTLINE, body_of, contact_of, extruded, surface
from scipy.optimize import nnls

from exunet.base.errors import CaseError
from exunet.bodies import mesh_core
from exunet.bodies.distance import polyhedron
from exunet.bodies.mesh_core import core_of_mesh
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Shape, Solid, TriangleMesh
from exunet.bodies.touched import SampledCore, surface_of_mesh
from exunet.forces.contact.segment_surface import (
    find_pieces,
    moved_since,
    touch_pieces,
)
from exunet.forces.contact.signed_distance import any_core_gradient, convex_distance, sampled_distance
from exunet.forces.cores import BLOCK, BRICK, SAMPLED, STENCIL, Cores, Surface, no_samples
from exunet.results.penetration import touch_mesh

Floats = NDArray[np.float64]

CELL, CORNER, BEYOND = 0.07, np.array([-0.4, 0.3, -0.9]), 0.11  # m
SHAPE = (3, 2, 4)  # bricks
EMPTY = {(1, 1, 2): 0.6, (2, 0, 3): -0.5}  # bricks without points, and the distance in their middle [m]
ENDS = CORNER + CELL * BRICK * np.array(SHAPE)
SLOPE = np.array([0.3, -0.7, 0.5])
BEND = np.array([[0.9, 0.2, -0.3], [0.2, -0.6, 0.4], [-0.3, 0.4, 0.8]])


def quadratic(place: Floats) -> Any:
    """A function (...,) of spots (..., 3), for which the interpolation is exact; not a distance."""
    return 0.2 + place @ SLOPE + 0.5 * np.einsum("...i,ij,...j", place, BEND, place)


def plane(place: Floats) -> Any:
    """Distance (...,) from a plane through the grid."""
    return (place - 0.5 * (CORNER + ENDS)) @ SLOPE / np.linalg.norm(SLOPE) + 0.3


def sampled_core(function: Any) -> Cores:
    """A core whose distance is this function, in axes that are turned and moved; of one block."""
    random = np.random.default_rng(8)
    full = [item for item in np.ndindex(*SHAPE) if item not in EMPTY]
    values = np.zeros((len(full), STENCIL, STENCIL, STENCIL))
    bricks, apart = np.full((1, *[BLOCK] * 3), -1, dtype=np.int32), np.zeros((1, *[BLOCK] * 3), np.float32)
    for number, one in zip(random.permutation(len(full)), full, strict=True):
        bricks[(0, *one)] = number
        points = np.stack(np.meshgrid(*[np.arange(STENCIL) - 1.0] * 3, indexing="ij"), axis=-1)
        values[number] = function(CORNER + CELL * (points + BRICK * np.array(one)))
    for one, distance in EMPTY.items():
        apart[(0, *one)] = distance
    turn = rotation_matrix(np.array([0.5, -0.1, 0.7, 0.5]))
    place = np.array([0.2, -0.5, 0.4])
    boxes = np.concatenate([place - 2.0, place + 2.0])
    samples = no_samples()._replace(
        corner=CORNER, cell=CELL, ends=BRICK * np.array(SHAPE, dtype=float), beyond=BEYOND,
        blocks=np.zeros((1, 1, 1), dtype=np.int64), far=np.zeros((1, 1, 1)), bricks=bricks.reshape(1, -1),
        apart=apart.reshape(1, -1), convex=np.full(len(full), -1, np.int32),
        points=np.arange(len(full), dtype=np.int32), values=values.ravel(),
    )  # fmt: skip
    return Cores(
        np.array([SAMPLED]), np.zeros((1, 3)), place[None], turn[None], np.array([0.05]), boxes[None], samples
    )


QUADRATIC, PLANE = sampled_core(quadratic), sampled_core(plane)


def brick_of(place: Floats) -> tuple[int, ...]:
    return tuple(((place - CORNER) / (CELL * BRICK)).astype(int).tolist())


def test_a_quadratic_is_exact_between_grid_points() -> None:
    """Values and gradients, in all bricks and all cells of them."""
    random, cells = np.random.default_rng(9), set()
    for place in random.uniform(CORNER, ENDS, (400, 3)):
        if brick_of(place) in EMPTY:
            continue
        cells.add(tuple((np.floor((place - CORNER) / CELL) % BRICK).astype(int).tolist()))
        d, *gradient = sampled_distance(QUADRATIC.samples, *place)
        assert d == pytest.approx(quadratic(place), abs=1e-12)
        np.testing.assert_allclose(gradient, SLOPE + BEND @ place, atol=1e-11)
    assert len(cells) > 200


def test_the_gradient_is_that_of_the_interpolation() -> None:
    """Of any values at the grid's points: central differences, error 1e-12 / 0.07^2 of values of 1."""
    values = np.random.default_rng(3).normal(size=QUADRATIC.samples.values.size)
    rough = QUADRATIC.samples._replace(values=values)
    for part in np.random.default_rng(4).uniform(0.1, 0.9, (30, 3)):
        place = CORNER + CELL * (np.array([3.0, 9.0, 5.0]) + part)
        _, *gradient = sampled_distance(rough, *place)
        steps = 1e-6 * np.eye(3)
        known = [
            (sampled_distance(rough, *(place + step))[0] - sampled_distance(rough, *(place - step))[0]) / 2e-6
            for step in steps
        ]
        np.testing.assert_allclose(gradient, known, atol=1e-5)


def test_a_distance_without_samples_is_a_bound() -> None:
    """In a brick without samples from its middle, beyond all bricks from their box."""
    random = np.random.default_rng(10)
    for brick, distance in EMPTY.items():
        middle = CORNER + CELL * BRICK * (np.array(brick) + 0.5)
        for place in middle + CELL * random.uniform(-4.0, 4.0, (20, 3)):
            known = float(np.float32(distance)) - np.sign(distance) * np.linalg.norm(place - middle)
            assert sampled_distance(QUADRATIC.samples, *place) == pytest.approx(
                (known, 0.0, 0.0, 0.0), rel=1e-12
            )
    sides = set()
    for place in random.uniform(CORNER - 1.0, ENDS + 1.0, (300, 3)):
        apart = place - np.clip(place, CORNER, ENDS)
        if apart.any():
            sides.add(tuple(np.sign(apart).tolist()))
            known = BEYOND + np.linalg.norm(apart)
            assert sampled_distance(QUADRATIC.samples, *place) == pytest.approx(
                (known, 0.0, 0.0, 0.0), rel=1e-12
            )
    assert len(sides) == 26


def test_a_core_has_axes_of_its_own() -> None:
    random = np.random.default_rng(12)
    place, turn = QUADRATIC.place[0], QUADRATIC.turn[0]
    for own in random.uniform(CORNER, ENDS, (20, 3)):
        if brick_of(own) in EMPTY:
            continue
        d, *gradient = any_core_gradient(QUADRATIC, 0, *(place + turn @ own))
        assert d == pytest.approx(quadratic(own), abs=1e-11)
        np.testing.assert_allclose(gradient, turn @ (SLOPE + BEND @ own), atol=1e-10)


# Threads over a plane: its distance is exact between grid points.

REACH = 0.05 + 0.01  # m, of rounding and thread


def threads(number: int) -> Any:
    """Ends in the core's axes, in a part of the grid where all bricks have points; how many pieces."""
    random = np.random.default_rng(13)
    low, high = CORNER, CORNER + CELL * BRICK * np.array([1, 2, 4])
    for _ in range(number):
        a, b = random.uniform(low + 1e-3, high - 1e-3, (2, 3))
        if random.uniform() < 0.3:
            b = a + random.normal(size=3) * 0.02
            b = np.clip(b, low + 1e-3, high - 1e-3)
        yield a, b, int(random.integers(1, 40))


def prepared(a: Floats, b: Floats, pieces: int, damping: float = 0.0) -> tuple[Any, Any, Any]:
    """What the loops ask for, and the ends in principal axes."""
    c = contact_of(SimpleNamespace(cores=PLANE), damping=damping, pieces=pieces)  # type: ignore[arg-type]
    one, other = (tuple((PLANE.place[0] + PLANE.turn[0] @ end).tolist()) for end in (a, b))
    return c, one, other


def test_pieces_are_those_that_touch_at_a_place_of_the_rule() -> None:
    """And how far a thread is from touching: a bound from below, of no less than half of what is free."""
    touching = clear_ones = 0
    for a, b, pieces in threads(100):
        c, one, other = prepared(a, b, pieces)
        m, clear = find_pieces(c, 0, one, other), c.near.clear[0]
        s = (np.arange(pieces)[:, None] + c.work.rule[0, :2]) / pieces
        d = plane(a + s[..., None] * (b - a))
        known = np.flatnonzero((d < REACH).any(axis=1))
        assert c.work.splits[:m].tolist() == known.tolist()
        np.testing.assert_allclose(c.work.found[:m, [0, 4]], d[known], atol=1e-12)
        gradient = np.tile(SLOPE / np.linalg.norm(SLOPE), (m, 1))
        np.testing.assert_allclose(c.work.found[:m, 1:4], gradient, atol=1e-11)
        np.testing.assert_allclose(c.work.found[:m, 5:], gradient, atol=1e-11)
        nearest = max(min(plane(a), plane(b)) - REACH, 0.0)
        width = np.linalg.norm(b - a) / pieces
        free = d[:, 0].min() - REACH - 0.5 * CELL - c.work.rule[0, 1] * width
        least = 0.5 * free if free > c.near.skin else 0.0
        assert least - 2e-9 <= clear <= max(nearest, c.near.skin)
        touching += m > 0
        clear_ones += clear > c.near.skin
    assert touching > 20
    assert clear_ones > 20


def test_pieces_that_were_listed_before_are_those_of_a_new_list() -> None:
    """To the last bit, while no end has moved as far as the list is right for, on distances of any slopes."""
    random, moved_on, found = np.random.default_rng(15), 0, 0
    samples = PLANE.samples._replace(
        values=PLANE.samples.values + 0.02 * random.uniform(-CELL, CELL, PLANE.samples.values.size)
    )
    surface = SimpleNamespace(cores=PLANE._replace(samples=samples))
    for a, b, pieces in threads(40):
        kept = contact_of(surface, pieces=pieces)  # type: ignore[arg-type]
        for _ in range(3):
            ends = [PLANE.place[0] + PLANE.turn[0] @ end for end in (a, b)]
            one, other = (tuple(end.tolist()) for end in ends)
            new = contact_of(surface, pieces=pieces)  # type: ignore[arg-type]
            m = find_pieces(new, 0, one, other)
            moved_on += kept.near.clear[0] > 0.0 and moved_since(kept, 0, one, other) < kept.near.clear[0]
            assert find_pieces(kept, 0, one, other) == m
            np.testing.assert_array_equal(kept.work.splits[:m], new.work.splits[:m])
            np.testing.assert_array_equal(kept.work.found[:m], new.work.found[:m])
            found += m > 0
            way = random.normal(size=(2, 3))
            way *= 0.6 * kept.near.clear[0] / np.linalg.norm(way, axis=1, keepdims=True)
            a, b = a + way[0], b + way[1]
    assert found > 20
    assert moved_on > 20


def test_forces_and_moments_of_pieces_are_sums_over_their_places() -> None:
    """All twelve, with ends that move; some spots leave so fast that they do not push."""
    random, cut_off = np.random.default_rng(14), 0
    turn = PLANE.turn[0]
    for a, b, pieces in threads(60):
        c, one, other = prepared(a, b, pieces, damping=0.8)
        m = find_pieces(c, 0, one, other)
        v, w = random.normal(size=(2, 3))
        found = touch_pieces(c, 0, tuple(v), tuple(w), m, c.work.sums)
        s = ((np.arange(pieces)[:, None] + c.work.rule[0, :2]) / pieces).ravel()
        weight = np.tile(c.work.rule[1, :2], pieces) / pieces
        depth = np.maximum(REACH - plane(a + s[:, None] * (b - a)), 0.0)
        n = turn @ SLOPE / np.linalg.norm(SLOPE)
        rate = -(v + s[:, None] * (w - v)) @ n
        elastic = 3.0 * depth
        f = elastic * np.maximum(1.0 + 0.8 * rate, 0.0)
        cut_off += bool(((f == 0.0) & (depth > 0.0)).any() and f.any())
        sums = [
            weight @ f,
            weight @ (s * f),
            weight @ ((f - elastic) * rate),
            0.5 * weight @ (elastic * depth),
        ]
        known = [
            *(n * sums[0]),
            *(n * sums[1]),
            *sums,
            depth.max(),
            s[depth.argmax()] if depth.any() else 0.0,
        ]
        np.testing.assert_allclose(c.work.sums, known, atol=1e-11)
        assert found == bool(depth.any())
    assert cut_off > 3


EDGE, THICK = 0.08, 0.01  # m
BOX = Solid("box", (0.6, 1.0, 0.4))
REST = (0.0, 0.0, 0.0)
principal = body_of(()).in_principal_axes


def meshed(mesh: TriangleMesh, spacing: float | None = None, edge: float = EDGE) -> Surface:
    """The surface of a body with the axes of `body_of`."""
    shape = Shape(mesh=mesh, edge_radius=edge, grid_spacing=spacing)
    body = replace(body_of(()), shape=shape)
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
    m = find_pieces(c, 0, a, b)
    c.work.sums[:] = 0.0
    if m:
        touch_pieces(c, 0, v, w, m, c.work.sums)
    return c.work.sums.copy()


def pieces_of(touched: Surface, length: float, **keys: Any) -> Any:
    return contact_of(touched, pieces=int(np.ceil(length / touched.cores.samples.cell)), **keys)


def test_the_distance_from_a_box_is_that_of_the_solid() -> None:
    """To round-off, beside faces, edges and corners: a convex core needs no grid points."""
    known = surface((BOX,))
    where = places(known, 200, -0.5 * EDGE, EDGE + THICK)
    for part in (2.0, 4.0):
        found = meshed(polyhedron(BOX), EDGE / part)
        assert max(differences(known, found, where)) < 1e-12
        assert found.least == pytest.approx(known.least, rel=1e-9)
        assert (found.allowed, found.bends, found.error) == (known.allowed, 0.0, 0.0)
        assert found.cores.samples.values.size == 0


def test_thin_panels_at_an_angle_need_little_memory() -> None:
    """2.5 cm thick, where points in all bricks would take 0.4 GB; exact on both sides and at edges."""
    panel = Solid("box", (3.0, 1.0, 0.025), attitude=(0.8, 0.2, 0.4, 0.4))
    known, found = surface((panel,), 0.01), meshed(polyhedron(panel), edge=0.01)
    samples = found.cores.samples
    assert samples.size < 30e6
    assert len(samples.convex) * 8 * STENCIL**3 > 3e8
    random, edges = np.random.default_rng(6), np.array(panel.numbers) - 0.02
    own = np.clip(random.uniform(-0.6, 0.6, (300, 3)) * panel.numbers, -0.5 * edges, 0.5 * edges)
    own += random.uniform(-0.01, 0.01, own.shape)
    where = np.array([principal(place) for place in own @ panel.rotation.T])
    assert max(differences(known, found, where)) < 1e-10


def test_the_nearest_point_behind_planes() -> None:
    """Against least distance programming by non-negative least squares (Lawson, Hanson, 1974, chapter 23)."""
    random, on = np.random.default_rng(7), set()
    for _ in range(300):
        number = int(random.integers(1, 7))
        planes = np.column_stack([random.normal(size=(number, 3)), random.uniform(0.1, 0.5, number)])
        planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
        place = random.uniform(-2.0, 2.0, 3)
        d, *gradient = convex_distance(planes, np.arange(number), number, *place)
        height = planes[:, :3] @ place - planes[:, 3]
        if (height <= 0.0).all():
            assert d == pytest.approx(height.max(), abs=1e-14)
            continue
        rows = np.vstack([-planes[:, :3].T, height])
        multipliers, _ = nnls(rows, np.array([0.0, 0.0, 0.0, 1.0]))
        rest = rows @ multipliers - [0.0, 0.0, 0.0, 1.0]
        way = rest[:3] / rest[3]
        assert d == pytest.approx(np.linalg.norm(way), abs=1e-10)
        np.testing.assert_allclose(np.array(gradient) * d, way, atol=1e-9)
        on.add(int((multipliers > 1e-12).sum()))
    assert on == {1, 2, 3}


def test_the_distance_and_its_gradient_are_continuous_between_bricks() -> None:
    """From bricks with planes over those with both to those with points, within reach of an L."""
    found = meshed(extruded(OUTLINE, 0.15), 0.01, 0.02).cores.samples
    both = (found.convex >= 0) & (found.points >= 0)
    assert min(both.sum(), (found.convex < 0).sum(), (found.points < 0).sum()) > 50
    assert not (found.weight[both] == 1).all(axis=1).any()
    block, place = np.nonzero(np.isin(found.bricks, np.flatnonzero(both)))
    first = BLOCK * np.argwhere(found.blocks >= 0)[block] + np.stack(np.unravel_index(place, [BLOCK] * 3), 1)
    random, seen = np.random.default_rng(16), 0
    for corner in random.choice(first, 1000):
        part, axis = random.uniform(size=3), random.integers(3)
        part[axis] = random.integers(2)
        at = found.corner + BRICK * found.cell * (corner + part)
        step = 1e-9 * np.eye(3)[axis]
        here, there = (np.array(sampled_distance(found, *(at + way))) for way in (-step, step))
        if 0.0 < here[0] < 0.03 and here[1:].any() and there[1:].any():
            np.testing.assert_allclose(here, there, rtol=0.0, atol=1e-6)
            seen += 1
    assert seen > 100


def test_what_is_thin_may_be_entered_by_half_of_its_least_dimension() -> None:
    """Of half a thickness of 0.12 m, with edges of 0.08 m: 0.06 m."""
    body = replace(body_of(()), shape=Shape(mesh=polyhedron(BOX), edge_radius=EDGE))
    core = SampledCore(no_samples(), 0.12, 0.0, 0.0)
    found = surface_of_mesh(body, core, np.zeros(0, dtype=np.int64))
    assert (found.allowed, found.least) == (0.06, 0.12)


@pytest.mark.ci_for("over an inner edge")
@pytest.mark.slow
@pytest.mark.parametrize("what", ["over an outer edge", "over an inner edge"])
def test_the_force_is_continuous_and_has_a_potential(what: str) -> None:
    """Along a way over an edge no step of 1e-6 m changes it by more than a few times stiffness times that."""
    touched = meshed(extruded(OUTLINE, 0.15), 0.005, 0.02)
    c = pieces_of(touched, 0.2, thick=THICK)
    outer = what == "over an outer edge"
    corner = np.array([0.245, -0.055, 0.0] if outer else [-0.047, -0.047, 0.0])
    along, across = np.array([0.02, 0.02, 0.2]), np.array([1.0, -1.0, 0.1]) / np.sqrt(2.01)

    def at(way: float) -> Floats:
        middle = corner + way * across
        a, b = (principal(middle + sign * 0.5 * along) for sign in (-1.0, 1.0))
        return on_thread(c, a, b)

    ways = np.linspace(-0.015, 0.015, 61)
    for way in ways:
        here, there = at(way), at(way + 1e-6)
        assert np.abs(there[:6] - here[:6]).max() < 12.0 * 3.0 * 1e-6
    turned = across @ body_of(()).rotation
    differs = False
    for way in ways[::6]:
        slope = (at(way + 1e-6)[9] - at(way - 1e-6)[9]) / 2e-6
        push = at(way)[:3] @ turned
        differs = differs or abs(push) > 1e-3
        assert slope == pytest.approx(-push, abs=1e-7)
    assert differs


def test_an_inner_edge_makes_contact_steeper() -> None:
    """There the direction turns within a cell or two; the bound is what a second difference finds."""
    touched = meshed(extruded(OUTLINE, 0.15), 0.01, 0.02)
    assert 0.5 / 0.01 < touched.bends < 8.0 / 0.01
    assert touched.least == pytest.approx(0.1)
    assert touched.allowed == 0.02


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
    found = ~np.isnan(touch_mesh(core, reach, start, end))
    np.testing.assert_array_equal(found[sure], clear[sure] < 0.0)
    assert 5 < found.sum() < 23
    assert sure.sum() > 23


def test_distances_beyond_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fine grid by a bound from the volume alone, before any distance is computed."""

    def core(spacing: float, reach: float) -> SampledCore:
        mesh = extruded(OUTLINE, 0.15)
        return core_of_mesh("block", Shape(mesh=mesh, edge_radius=EDGE, grid_spacing=spacing), reach)

    size = core(0.04, 0.05).samples.values.nbytes
    assert size > 0
    monkeypatch.setattr(mesh_core, "MOST_BYTES", size)
    with pytest.raises(CaseError) as refused:
        core(0.04, 0.051)
    assert refused.value.faults[0].key == "bodies.block.edge_radius"
    monkeypatch.setattr(mesh_core, "_outer", lambda mesh: pytest.fail("distances were prepared"))
    with pytest.raises(CaseError):
        core(0.0005, 0.05)


def test_bodies_of_one_mesh_share_its_distances() -> None:
    shape = Shape(mesh=extruded(OUTLINE, 0.15), edge_radius=0.02, grid_spacing=0.01)
    one, other = core_of_mesh("one", shape, THICK), core_of_mesh("other", shape, THICK)
    assert one.samples.bricks is other.samples.bricks

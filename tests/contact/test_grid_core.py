"""Distances on a grid, made up so that all is known by hand, and threads on them; plain Python."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from touched_solids import contact_of

from exunet.bodies.rotations import rotation_matrix
from exunet.forces.contact.segment_surface import find_pieces, touch_pieces, touches_sampled
from exunet.forces.contact.signed_distance import any_core_gradient, sampled_distance
from exunet.forces.cores import BRICK, SAMPLED, STENCIL, Cores

Floats = NDArray[np.float64]

CELL, CORNER, BEYOND = 0.07, np.array([-0.4, 0.3, -0.9]), 0.11  # m
SHAPE = (3, 2, 4)  # bricks
EMPTY = {(1, 1, 2): 0.6, (2, 0, 3): -0.5}  # bricks without points, and the distance in their middle [m]
ENDS = CORNER + CELL * BRICK * np.array(SHAPE)
SLOPE = np.array([0.3, -0.7, 0.5])
BEND = np.array([[0.9, 0.2, -0.3], [0.2, -0.6, 0.4], [-0.3, 0.4, 0.8]])


def quadratic(place: Floats) -> Any:
    """A function (...,) of places (..., 3), for which the interpolation is exact; not a distance."""
    return 0.2 + place @ SLOPE + 0.5 * np.einsum("...i,ij,...j", place, BEND, place)


def plane(place: Floats) -> Any:
    """Distance (...,) from a plane through the grid."""
    return (place - 0.5 * (CORNER + ENDS)) @ SLOPE / np.linalg.norm(SLOPE) + 0.3


def core(function: Any) -> Cores:
    """A core whose distance is this function, in axes of its own, turned and moved."""
    random = np.random.default_rng(8)
    bricks = np.full(SHAPE, -1, dtype=np.int64)
    far = np.zeros(SHAPE)
    full = [item for item in np.ndindex(*SHAPE) if item not in EMPTY]
    values = np.zeros((len(full), STENCIL, STENCIL, STENCIL))
    for number, one in zip(random.permutation(len(full)), full, strict=True):
        bricks[one] = number
        points = np.stack(np.meshgrid(*[np.arange(STENCIL) - 1.0] * 3, indexing="ij"), axis=-1)
        values[number] = function(CORNER + CELL * (points + BRICK * np.array(one)))
    for one, distance in EMPTY.items():
        far[one] = distance
    turn = rotation_matrix(np.array([0.5, -0.1, 0.7, 0.5]))
    place = np.array([0.2, -0.5, 0.4])
    boxes = np.concatenate([place - 2.0, place + 2.0])
    return Cores(
        np.array([SAMPLED]), np.zeros((1, 3)), place[None], turn[None], np.array([0.05]), boxes[None],
        CORNER, CELL, BEYOND, bricks, far, values.ravel(),
    )  # fmt: skip


QUADRATIC, PLANE = core(quadratic), core(plane)


def brick_of(place: Floats) -> tuple[int, ...]:
    return tuple(((place - CORNER) / (CELL * BRICK)).astype(int).tolist())


def test_between_grid_points_all_of_second_degree_is_exact() -> None:
    """Values and gradients, in all bricks and all cells of them."""
    random, cells = np.random.default_rng(9), set()
    for place in random.uniform(CORNER, ENDS, (400, 3)):
        if brick_of(place) in EMPTY:
            continue
        cells.add(tuple((np.floor((place - CORNER) / CELL) % BRICK).astype(int).tolist()))
        d, *gradient = sampled_distance(QUADRATIC, *place)
        assert d == pytest.approx(quadratic(place), abs=1e-12)
        np.testing.assert_allclose(gradient, SLOPE + BEND @ place, atol=1e-11)
    assert len(cells) > 200


def test_the_gradient_is_that_of_what_is_between_grid_points() -> None:
    """Of any values at the grid's points: central differences, error 1e-12 / 0.07^2 of values of 1."""
    values = np.random.default_rng(3).normal(size=QUADRATIC.values.size)
    rough = QUADRATIC._replace(values=values)
    for part in np.random.default_rng(4).uniform(0.1, 0.9, (30, 3)):
        place = CORNER + CELL * (np.array([3.0, 9.0, 5.0]) + part)
        _, *gradient = sampled_distance(rough, *place)
        steps = 1e-6 * np.eye(3)
        known = [
            (sampled_distance(rough, *(place + step))[0] - sampled_distance(rough, *(place - step))[0]) / 2e-6
            for step in steps
        ]
        np.testing.assert_allclose(gradient, known, atol=1e-5)


def test_far_from_the_surface_it_is_a_bound_from_the_middle_of_a_brick() -> None:
    random = np.random.default_rng(10)
    for one, distance in EMPTY.items():
        middle = CORNER + CELL * BRICK * (np.array(one) + 0.5)
        for place in middle + CELL * random.uniform(-4.0, 4.0, (20, 3)):
            apart = np.linalg.norm(place - middle)
            known = distance - apart if distance > 0.0 else distance + apart
            assert sampled_distance(QUADRATIC, *place) == pytest.approx((known, 0.0, 0.0, 0.0), rel=1e-12)


def test_beyond_all_bricks_it_is_a_bound_from_their_box() -> None:
    random, sides = np.random.default_rng(11), set()
    for place in random.uniform(CORNER - 1.0, ENDS + 1.0, (200, 3)):
        apart = place - np.clip(place, CORNER, ENDS)
        if apart.any():
            sides.add(tuple(np.sign(apart).tolist()))
            known = BEYOND + np.linalg.norm(apart)
            assert sampled_distance(QUADRATIC, *place) == pytest.approx((known, 0.0, 0.0, 0.0), rel=1e-12)
    assert len(sides) == 26


def test_the_box_of_all_bricks_has_its_beginning_and_not_its_end() -> None:
    """With cells of 1 m that begin at 0, exact: what is inside it has a gradient."""
    whole = QUADRATIC._replace(corner=np.zeros(3), cell=1.0)
    for axis in range(3):
        for at, inside in ((0.0, True), (8.0 * SHAPE[axis], False)):
            place = np.full(3, 3.5)
            place[axis] = at
            found = sampled_distance(whole, *place)
            assert (found[1:] != (0.0, 0.0, 0.0)) == inside
            if not inside:
                assert found[0] == BEYOND


def test_a_core_is_asked_in_its_own_axes() -> None:
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
        m, clear = find_pieces(c, 0, one, other)
        s = (np.arange(pieces)[:, None] + c.rule[0, :2]) / pieces
        d = plane(a + s[..., None] * (b - a))
        known = np.flatnonzero((d < REACH).any(axis=1))
        assert c.splits[:m].tolist() == known.tolist()
        np.testing.assert_allclose(c.found[:m, [0, 4]], d[known], atol=1e-12)
        gradient = np.tile(SLOPE / np.linalg.norm(SLOPE), (m, 1))
        np.testing.assert_allclose(c.found[:m, 1:4], gradient, atol=1e-11)
        np.testing.assert_allclose(c.found[:m, 5:], gradient, atol=1e-11)
        nearest = min(plane(a), plane(b)) - REACH
        width = np.linalg.norm(b - a) / pieces
        free = d[:, 0].min() - REACH - 0.5 * CELL - c.rule[0, 1] * width
        assert 0.5 * max(free, 0.0) - 1e-12 <= clear <= max(nearest, 0.0) + 1e-12
        touching += m > 0
        clear_ones += clear > 0.0
    assert touching > 20
    assert clear_ones > 20


def test_a_thread_out_of_the_box_is_as_far_as_that() -> None:
    c, _, _ = prepared(CORNER, ENDS, 3)
    low = PLANE.boxes[0, 0] - 0.01
    assert find_pieces(c, 0, (low - 0.3, 0.0, 0.0), (low - 0.2, 0.1, 0.0)) == (0, pytest.approx(0.2))


def test_forces_and_moments_of_pieces_are_sums_over_their_places() -> None:
    """All twelve, with ends that move; some places leave so fast that they do not push."""
    random, cut_off = np.random.default_rng(14), 0
    turn = PLANE.turn[0]
    for a, b, pieces in threads(60):
        c, one, other = prepared(a, b, pieces, damping=0.8)
        m, _ = find_pieces(c, 0, one, other)
        v, w = random.normal(size=(2, 3))
        found = touch_pieces(c, 0, tuple(v), tuple(w), m, c.sums)
        s = ((np.arange(pieces)[:, None] + c.rule[0, :2]) / pieces).ravel()
        weight = np.tile(c.rule[1, :2], pieces) / pieces
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
        np.testing.assert_allclose(c.sums, known, atol=1e-11)
        assert found == bool(depth.any())
    assert cut_off > 3


def test_an_anchor_holds_where_its_place_of_the_thread_touches() -> None:
    for a, b, pieces in threads(20):
        c, one, other = prepared(a, b, pieces)
        find_pieces(c, 0, one, other)
        for s in (0.1, 0.5, 0.8):
            assert touches_sampled(c, 0, s) == (plane(a + s * (b - a)) < REACH)

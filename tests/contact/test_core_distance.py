"""Distances from cores, as plain Python, against projections by least distance programming."""

from __future__ import annotations

import numpy as np
import pytest
from touched_solids import (
    COMPOUNDS,
    EDGE,
    SOLIDS,
    body_of,
    core_projection,
    from_core,
    half_planes,
    in_solid,
    rounding_of,
    surface,
    to_principal,
)

from exunet.forces.contact.signed_distance import box_distance, core_gradient

Floats = np.ndarray


def places(seed: int, number: int) -> Floats:
    """(number, 3) around a solid, most of them outside."""
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (number, 3))


def tried(name: str, place: Floats) -> tuple[float, Floats]:
    """Distance and gradient by the loops."""
    d, *gradient = core_gradient(surface((SOLIDS[name],)).cores, 0, *place)
    return d, np.array(gradient)


@pytest.mark.parametrize("name", SOLIDS)
def test_distances_are_those_of_projections(name: str) -> None:
    outside = 0
    for place in places(1, 300):
        own = in_solid(SOLIDS[name], place)
        known = core_projection(SOLIDS[name], EDGE, own)
        found, _ = tried(name, place)
        if found > 0.0:
            outside += 1
            assert found == pytest.approx(known, abs=1e-13)
            assert from_core(SOLIDS[name], EDGE, own[None])[0][0] == pytest.approx(known, abs=1e-13)
        else:
            assert not 1e-13 < known < np.inf
    assert outside > 200


@pytest.mark.parametrize("name", [name for name in SOLIDS if name not in ("sphere", "capsule")])
def test_inside_it_is_the_way_out_through_the_nearest_face(name: str) -> None:
    """Below zero; and the direction is that face's. What has no inside is a point or a line."""
    solid, inside = SOLIDS[name], 0
    for place in 0.4 * places(6, 800):
        own = in_solid(solid, place)
        if solid.kind == "box":
            faces = np.vstack([np.eye(3), -np.eye(3)])
            limits = np.tile(0.5 * np.array(solid.numbers) - EDGE, 2)
        else:
            flat, limits = half_planes(solid, EDGE)
            around = own[:2] / np.hypot(*own[:2])
            faces = np.column_stack([flat[:, :1] * around, flat[:, 1]])
        beyond = faces @ own - limits
        if beyond.max() < 0.0:
            inside += 1
            found, gradient = tried(name, place)
            assert found == pytest.approx(beyond.max(), abs=1e-14)
            known = to_principal(solid, faces[beyond.argmax()])
            np.testing.assert_allclose(gradient, known, atol=1e-14)
    assert inside > 5


@pytest.mark.parametrize("name", SOLIDS)
def test_the_surface_is_that_of_the_solid(name: str) -> None:
    """Along rays from its middle: rounded edges are inside of the sharp solid, and nothing is outside."""
    solid = SOLIDS[name]
    cores = surface((solid,)).cores
    assert cores.rounding[0] == rounding_of(solid, EDGE)
    random = np.random.default_rng(2)
    for way in random.normal(size=(100, 3)):
        way /= np.linalg.norm(way)
        assert tried(name, 3.0 * way)[0] > cores.rounding[0]
        low, high = 0.0, 3.0
        middle = np.array(cores.place[0])
        for _ in range(60):
            at = 0.5 * (low + high)
            low, high = (at, high) if tried(name, middle + at * way)[0] < cores.rounding[0] else (low, at)
        assert solid.depth(in_solid(solid, (middle + low * way)[None]))[0] < 1e-12


def test_a_ball_around_a_compound() -> None:
    """About the middle of the balls around its boxes, of 0.6 x 1 x 0.4 m at 0.3 m to both sides."""
    solids = COMPOUNDS["two boxes side by side"]
    found, around = surface(solids), 0.5 * np.linalg.norm([0.6, 1.0, 0.4])
    np.testing.assert_allclose(found.middle, body_of(solids).in_principal_axes((0.0, 0.0, 0.0)), atol=1e-15)
    assert found.radius == pytest.approx(0.3 + around, rel=1e-14)


@pytest.mark.parametrize("name", SOLIDS)
def test_gradients_are_unit_vectors_and_derivatives(name: str) -> None:
    """Central differences with 1e-6 m: error 1e-12 / d^2 of a curvature 1/d, and round-off of 1e-10."""
    looked_at = 0
    for place in places(3, 100):
        d, gradient = tried(name, place)
        assert np.linalg.norm(gradient) == pytest.approx(1.0, abs=1e-14)
        if abs(d) < 0.02:
            continue
        steps = 1e-6 * np.eye(3)
        known = [(tried(name, place + step)[0] - tried(name, place - step)[0]) / 2e-6 for step in steps]
        if d > 0.0:
            looked_at += 1
            np.testing.assert_allclose(gradient, known, atol=1e-8)
    assert looked_at > 50


@pytest.mark.parametrize("name", SOLIDS)
def test_distances_are_convex(name: str) -> None:
    """Inside too: between two places it is never above the line, and the tangent is never above it."""
    for one, other in zip(places(4, 300), places(5, 300), strict=True):
        d, gradient = tried(name, one)
        e, _ = tried(name, other)
        s = 0.3
        assert tried(name, one + s * (other - one))[0] <= (1.0 - s) * d + s * e + 1e-14
        assert e >= d + gradient @ (other - one) - 1e-14


@pytest.mark.parametrize("axis", range(3))
def test_places_as_far_beyond_two_faces_or_three_are_at_an_edge_or_a_corner(axis: int) -> None:
    """Of a box with half edges 1, 2 and 3 m: exact ways of 3-4-5 and 1-2-2, turned to all axes and signs."""
    half = np.array([1.0, 2.0, 3.0])
    for way in ((2.0, 2.0, 1.0), (3.0, 3.0, 0.0), (3.0, 4.0, 0.0), (3.0, 0.0, 0.0), (2.0, 2.0, 2.0)):
        for sign in (1.0, -1.0):
            beyond = np.roll(way, axis) * np.where(np.arange(3) == axis, sign, 1.0)
            place = np.copysign(half, beyond) + beyond
            place -= np.where(beyond == 0.0, 0.5 * half, 0.0)  # beside a face or an edge
            size = float(np.linalg.norm(beyond))
            found = box_distance(1.0, 2.0, 3.0, *place.tolist())
            assert found == pytest.approx((size, *(beyond / size)), rel=1e-15)

"""Outlines to which nets are cut: nearest points, insides and crossings, by complex numbers and halving."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from exunet.net.cut import Circle, Outline, OutlineShape, Polygon, corner_count, outline_of, side_length

SIZE = 3.0
FIRST = {
    "square": (4, 45.0),
    "hexagon": (6, 0.0),
    "octagon": (8, 22.5),
    "circle": (7, 0.0),
}  # docs/theory.md


def made(shape: str) -> Outline:
    return outline_of(OutlineShape(shape), SIZE, 7 if shape == "circle" else None)


def by_hand(shape: str) -> list[complex]:
    """The corners."""
    number, first = FIRST[shape]
    reach = SIZE / 2 / (1.0 if shape == "circle" else math.cos(math.pi / number))
    return [cmath.rect(reach, math.radians(first + 360.0 / number * k)) for k in range(number)]


def nearest(shape: str, z: complex) -> complex:
    if shape == "circle":
        return z / abs(z) * SIZE / 2
    corners, feet = by_hand(shape), []
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        t = ((z - a) * (b - a).conjugate()).real / abs(b - a) ** 2
        feet.append(a + min(1.0, max(0.0, t)) * (b - a))
    return min(feet, key=lambda foot: abs(foot - z))


def inside(shape: str, z: complex) -> bool:
    if shape == "circle":
        return abs(z) <= SIZE / 2
    corners = by_hand(shape)
    return all(
        ((b - a).conjugate() * (z - a)).imag >= 0.0
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    )


def points(seed: int, number: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5 * SIZE, 1.5 * SIZE, (number, 2))


@pytest.mark.parametrize("shape", FIRST)
def test_corners_and_sides(shape: str) -> None:
    corners = by_hand(shape)
    np.testing.assert_allclose(made(shape).corners @ [1.0, 1j], corners, rtol=1e-14)
    outline = made(shape)
    if isinstance(outline, Polygon):
        middles = 0.5 * (outline.corners + np.roll(outline.corners, -1, axis=0))
        np.testing.assert_allclose(outline.normals * SIZE / 2, middles, atol=1e-14)  # of the side after each
    assert corner_count(OutlineShape(shape), 7) == len(corners)
    assert side_length(OutlineShape(shape), SIZE, len(corners)) == pytest.approx(abs(corners[1] - corners[0]))


def test_corners_of_a_square_are_whole_numbers() -> None:
    """To the last bit; of a circle with eight strings, sqrt(1/2) of the radius."""
    square = outline_of(OutlineShape.SQUARE, SIZE, None)
    assert square.corners.tolist() == [[1.5, 1.5], [-1.5, 1.5], [-1.5, -1.5], [1.5, -1.5]]
    circle = outline_of(OutlineShape.CIRCLE, 2.0, 8)
    assert abs(circle.corners[1::2]).tolist() == [[math.sqrt(0.5)] * 2] * 4


@pytest.mark.parametrize("shape", FIRST)
def test_the_nearest_point_of_an_outline(shape: str) -> None:
    """Of points all round, near corners and near the middle."""
    at = np.concatenate([points(3, 300), 0.3 * points(4, 100)])
    places, distance = made(shape).nearest(at)
    known = np.array([nearest(shape, complex(*item)) for item in at])
    np.testing.assert_allclose(places @ [1.0, 1j], known, atol=1e-12)
    np.testing.assert_allclose(distance, abs(known - at @ [1.0, 1j]), rtol=1e-12)
    np.testing.assert_array_equal(made(shape).contains(at), [inside(shape, complex(*entry)) for entry in at])


@pytest.mark.parametrize("shape", FIRST)
def test_what_lies_on_it_is_inside(shape: str) -> None:
    """The point to the right, to the last bit: of a hexagon the middle of its upper side."""
    on = np.array([[0.0, SIZE / 2]] if shape == "hexagon" else [[SIZE / 2, 0.0]])
    assert made(shape).contains(on).all()
    assert not made(shape).contains(on * (1.0 + 1e-15)).any()


@pytest.mark.parametrize("shape", FIRST)
def test_where_lines_leave_it(shape: str) -> None:
    """By halving the way; some begin near the middle of it, some at its edge."""
    outline, at = made(shape), np.concatenate([points(5, 400), 0.45 * points(6, 200)])
    within = outline.contains(at)
    many = min(within.sum(), (~within).sum())
    begin, end = at[within][:many], at[~within][:many]
    found = outline.crossing(begin, end) @ [1.0, 1j]
    assert many > 100
    for a, b, place in zip(begin @ [1.0, 1j], end @ [1.0, 1j], found, strict=True):
        low, high = 0.0, 1.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if inside(shape, a + middle * (b - a)) else (low, middle)
        assert abs(a + low * (b - a) - place) < 1e-12
    assert isinstance(outline, Circle) == (shape == "circle")

"""Distances of bodies, of threads, and of points from the outline of a net, against known answers."""

from __future__ import annotations

import cmath
import itertools
import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from result_samples import net
from scenes import CASES, SOLID_NUMBERS, distance_from_solid, values_of
from scipy.optimize import lsq_linear

import exunet
from exunet.bodies.distance import distances
from exunet.bodies.mesh import closed
from exunet.bodies.rotations import product, quaternion_of, rotation_matrix
from exunet.bodies.shapes import SOLIDS, Shape, Solid
from exunet.net.arrays import Net
from exunet.net.cut import Circle, Outline, OutlineShape, outline_of
from exunet.net.weave import between_segments, nearest


def shape(kind: Any, numbers: Any = None, **more: Any) -> Shape:
    return Shape((Solid(kind, numbers or SOLID_NUMBERS[kind], **more),))


def poses(*place: float, turn: Any = (0.0, 0.0, 0.0)) -> Any:
    """Of one instant; turn: rotation vector."""
    return np.array([[*place, *quaternion_of(np.array(turn, dtype=float))]])


def random_poses(rng: Any, count: int, spread: float = 2.0) -> Any:
    attitude = rng.normal(size=(count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return np.concatenate([rng.normal(size=(count, 3)) * spread, attitude], axis=1)


QUARTER, EIGHTH = math.pi / 2, math.pi / 4
HERE = poses(0, 0, 0)
KNOWN = {
    "two spheres": ("sphere", HERE, "sphere", poses(1, 2, 2), 3.0 - 1.4),
    "sphere over a face": ("sphere", poses(0.2, -0.4, 4.0), "box", HERE, 4.0 - 1.5 - 0.7),
    "sphere at a corner": ("sphere", poses(1.5, 3.0, 3.5), "box", HERE, 3.0 - 0.7),
    # Edge along y at x = sqrt(10)/2 from the centre, to the face of the other box at x = 4.5.
    "edge to face": (
        "box", poses(0, 0, 0, turn=(0, math.atan2(3.0, 1.0), 0)), "box", poses(5, 0, 0),
        4.5 - 0.5 * math.sqrt(10.0),
    ),
    "capsules side by side": ("capsule", HERE, "capsule", poses(2, 0, 0.5), 2.0 - 0.6),
    "capsules end to end": ("capsule", HERE, "capsule", poses(0, 0, 4), 4.0 - 1.5 - 0.6),
    "capsules crosswise": ("capsule", HERE, "capsule", poses(0.1, 3, 0.2, turn=(0, QUARTER, 0)), 3.0 - 0.6),
    "cylinders end to end": ("cylinder", HERE, "cylinder", poses(0.3, 0, 5), 3.0),
    "cylinders crosswise": ("cylinder", HERE, "cylinder", poses(0, 3, 0, turn=(0, 1, 0)), 2.0),
    "cylinder upright on a box": (
        "cylinder", poses(0, 0, 4), "box", poses(0, 0, 0, turn=(0, 0, 0.3)), 4.0 - 1.0 - 1.5,
    ),
    "frustum and sphere": ("frustum", HERE, "sphere", poses(0, 0, 3), 3.0 - 0.5 - 0.7),
    "one inside the other": ("sphere", poses(0, 0, 0.2), "box", poses(0, 0, 0, turn=(1, 2, 3)), 0.0),
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_known_answers(name: str) -> None:
    """As they are, and with both turned and shifted together; to 1e-9 m."""
    one, a, other, b, expected = KNOWN[name]
    rng = np.random.default_rng(5)
    for turn in (np.zeros(3), rng.normal(size=3), rng.normal(size=3)):
        moved = []
        for pose in (a, b):
            whole = quaternion_of(turn)
            place = rotation_matrix(whole) @ pose[0, :3] + 3.0 * turn
            moved.append(np.concatenate([place, product(whole, pose[0, 3:])])[None])
        found = distances(shape(one), moved[0], shape(other), moved[1])
        assert found == pytest.approx([expected], abs=1e-9)


def test_two_boxes_edge_to_edge() -> None:
    """Cubes with crossing edges, one turned by 45 degrees about y, the other about z."""
    cube = shape("box", (1.0, 1.0, 1.0))
    a, b = poses(0, 0, 0, turn=(0, EIGHTH, 0)), poses(2, 0.1, -0.2, turn=(0, 0, EIGHTH))
    # Edges along y (at x = sqrt(2)/2, z = 0) and along z (at x = 2 - sqrt(2)/2, y = 0.1), crosswise.
    assert distances(cube, a, cube, b) == pytest.approx([2.0 - math.sqrt(2.0)], abs=1e-12)


@pytest.mark.parametrize("name", SOLIDS)
def test_a_point_and_a_solid(name: str) -> None:
    """A ball of 1e-9 m is a point, which is so much farther away than the ball."""
    places = random_poses(np.random.default_rng(7), 500, 1.2)
    ball, here = shape("sphere", (1e-9, 0.0, 0.0)), np.repeat(poses(0, 0, 0), 500, axis=0)
    found = distances(ball, places, shape(name), here)
    expected = distance_from_solid(Solid(name, SOLID_NUMBERS[name]), places[:, :3])
    np.testing.assert_allclose(found, np.maximum(expected - 1e-9, 0.0), rtol=0.0, atol=1e-9)
    assert 0.01 < (found == 0.0).mean() < 0.7


@pytest.mark.parametrize(("one", "other"), [*itertools.combinations_with_replacement(SOLIDS, 2)])
def test_the_same_seen_from_either_side(one: str, other: str) -> None:
    """Within 1e-9 m by two searches that go different ways; in many poses, a third of them overlapping."""
    rng = np.random.default_rng(11)
    a, b = random_poses(rng, 150, 0.9), random_poses(rng, 150, 0.9)
    found = distances(shape(one), a, shape(other), b)
    np.testing.assert_allclose(distances(shape(other), b, shape(one), a), found, rtol=0.0, atol=1e-9)
    assert 0.02 < (found == 0.0).mean() < 0.98


@pytest.mark.parametrize("sizes", [((1, 2, 3), (2, 1, 0.5)), ((1e-3, 10, 4), (1e-3, 10, 4))])
def test_boxes_against_bounded_least_squares(sizes: Any) -> None:
    """Points of two boxes are linear in six bounded numbers; plates of a millimetre too."""
    rng = np.random.default_rng(1)
    a, b = random_poses(rng, 60, 4.0), random_poses(rng, 60, 4.0)
    found = distances(shape("box", sizes[0]), a, shape("box", sizes[1]), b)
    for k in range(60):
        edges = [rotation_matrix(p[k, 3:]) * np.array(s) / 2 for p, s in zip((a, b), sizes, strict=True)]
        between = np.hstack([edges[0], -edges[1]])
        best = lsq_linear(between, b[k, :3] - a[k, :3], (-1.0, 1.0), method="bvls", tol=1e-14)
        assert found[k] == pytest.approx(math.sqrt(2.0 * best.cost), abs=1e-12)


def test_the_nearest_of_the_parts() -> None:
    """Of two balls 4 m apart the nearer one, whichever it is."""
    dumbbell = Shape((Solid("sphere", (0.5, 0, 0), (0, 0, -2.0)), Solid("sphere", (0.25, 0, 0), (0, 0, 2.0))))
    here, there = poses(0, 0, 0), [poses(0, 0, 5), poses(0, 0, -5), poses(5, 0, -2)]
    found = distances(dumbbell, np.repeat(here, 3, axis=0), shape("sphere"), np.concatenate(there))
    assert found == pytest.approx([3.0 - 0.95, 3.0 - 1.2, 5.0 - 1.2], abs=1e-12)
    for known, pose in zip(found, there, strict=True):  # whichever part comes first
        assert distances(dumbbell, here, shape("sphere"), pose) == known
        assert distances(shape("sphere"), pose, dumbbell, here) == pytest.approx(known, abs=1e-12)


def test_a_mesh_counts_as_its_hull() -> None:
    """A tetrahedron is convex: its distance is exact."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Shape(mesh=closed(corners, faces, "tetrahedron"))
    at = np.concatenate([poses(1, 1, 1), poses(-2, 0.1, 0.2)])
    found = distances(mesh, np.repeat(poses(0, 0, 0), 2, axis=0), shape("sphere"), at)
    assert found == pytest.approx([2.0 / math.sqrt(3.0) - 0.7, 2.0 - 0.7], abs=1e-12)


@pytest.mark.parametrize("output_step", [0.25, 2.0])
def test_the_least_distance_of_a_run(output_step: float, tmp_path: Path) -> None:
    """A ball of 0.5 m flies past a turning box of 2 x 2 x 2 m, 3 m beside its centre: it is nearest to the
    face at 1 s, also where only start and end are stored; from a file too.
    """
    bodies = (
        "bodies={chaser={shape='sphere', radius=0.5, mass=1.0, position=[-2, 3, 5], velocity=[2, 0, 0]},"
        "target={shape='box', size=[2, 2, 2], mass=8.0, position=[0, 0, 5], angular_velocity=[0, 1, 0]}}"
    )
    times = f"time={{end=2, output_step={output_step}}}"
    scene = CASES / "verification" / "bodies" / "free_bodies.toml"
    flown = exunet.run(exunet.load(scene, ["engine.backend=exudyn", bodies, times]))
    exunet.save(flown, tmp_path / "flown.h5")
    for result in (flown, exunet.load_result(tmp_path / "flown.h5")):
        found = exunet.clearance(result, "target", "chaser")
        assert found[0] == pytest.approx(math.hypot(1.0, 2.0) - 0.5, abs=1e-9)
        assert output_step == 2.0 or found[4] == pytest.approx(2.0 - 0.5, abs=1e-9)
        least = values_of(result)["bodies_chaser+target_least_distance_m"]
        assert least == pytest.approx(1.5, abs=1e-6)


Floats = np.ndarray


def segment_distance(one: Floats, other: Floats) -> float:
    """Least distance of two pieces (2, 3): of |r + s d - t e| over 0 <= s, t <= 1."""
    ways = np.stack([one[1] - one[0], other[0] - other[1]], axis=1)
    found = lsq_linear(ways, other[0] - one[0], (0.0, 1.0), method="bvls", tol=1e-15)
    return float(np.sqrt(2.0 * found.cost))


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e4])
def test_distances_of_pieces(scale: float) -> None:
    """Nearest within both, at an end of one and at ends of both, and pieces that are parallel."""
    rng = np.random.default_rng(5)
    one, other = rng.normal(size=(2, 120, 2, 3))
    other[:40] += rng.normal(size=(40, 1, 3)) * 3.0
    along = (one[80:, 1] - one[80:, 0])[:, None]
    other[80:] = one[80:] + rng.normal(size=(40, 1, 1)) * along + rng.normal(size=(40, 1, 3))
    other[100:, 1] = other[100:, 0] - 0.7 * along[20:, 0]
    known = [segment_distance(*pair) for pair in zip(one, other, strict=True)]
    for pair in ((one, other), (other, one)):
        found = between_segments(*(scale * part for part in pair))
        np.testing.assert_allclose(found / scale, known, rtol=1e-6, atol=1e-9)


def tangle(number: int, seed: int) -> Net:
    """Separate pieces and chains of two."""
    rng = np.random.default_rng(seed)
    begin = rng.uniform(-1.0, 1.0, (number, 3)) * (1.0, 2.0, 0.3)
    ends = begin + rng.normal(size=(number, 3)) * 0.3
    chained = [(number + k, k + 1) for k in range(0, number - 1, 3)]
    of = net(np.concatenate([begin, ends]), [*((k, number + k) for k in range(number)), *chained])
    of.is_string[1::4] = True
    return of


@pytest.mark.parametrize(
    ("seed", "shift", "strings"), [(1, (-7.0, -5.0, -3.0), True), (2, (1.2, -2.3, 40.0), False)]
)
def test_the_nearest_threads_that_share_no_node(
    seed: int, shift: tuple[float, float, float], strings: bool
) -> None:
    of = tangle(24, seed)
    position, every = of.reference_position + shift, of.element_nodes
    rows = [k for k in range(len(every)) if strings or not of.is_string[k]]
    known = {
        (a, b): segment_distance(position[every[a]], position[every[b]])
        for a, b in combinations(rows, 2)
        if not set(every[a]) & set(every[b])
    }
    least = min(known.values())
    assert nearest(of, position, least * (1.0 - 1e-6), strings=strings) is None
    for within in (least * (1.0 + 1e-6), 3.0 * least, 10.0):
        found = nearest(of, position, within, strings=strings)
        assert found is not None
        assert found.distance == pytest.approx(least, rel=1e-9)
        assert known[tuple(found.elements.tolist())] == pytest.approx(least, rel=1e-9)
        point = np.tile(found.place, (2, 1))
        point[1, 2] += 1e-12
        for element in found.elements:
            assert segment_distance(position[every[element]], point) == pytest.approx(0.5 * least, rel=1e-6)


@pytest.mark.parametrize("pair", [(3, 2100), (2050, 2100), (2047, 2048)])
def test_among_thousands(pair: tuple[int, int]) -> None:
    """Pieces 0.1 m long in a row, 1 m from each other; one has been put 1 cm beside another."""
    x = np.arange(2200.0)
    ends = np.stack(
        [np.stack([x, 0.0 * x, 0.0 * x], axis=1), np.stack([x + 0.1, 0.0 * x, 0.0 * x], axis=1)], axis=1
    )
    ends[pair[1]] = ends[pair[0]] + (0.0, 0.01, 0.0)
    of = net(ends.reshape(-1, 3), np.arange(4400).reshape(-1, 2))
    found = nearest(of, of.reference_position, 0.5)
    assert found is not None
    assert found.elements.tolist() == list(pair)
    assert found.distance == pytest.approx(0.01, rel=1e-12)


SIZE = 3.0
FIRST = {
    "square": (4, 45.0),
    "hexagon": (6, 0.0),
    "octagon": (8, 22.5),
    "circle": (7, 0.0),
}  # docs/explanation/theory.md


def made(shape: str) -> Outline:
    return outline_of(OutlineShape(shape), SIZE, 7 if shape == "circle" else None)


def by_hand(shape: str) -> list[complex]:
    """The corners."""
    number, first = FIRST[shape]
    reach = SIZE / 2 / (1.0 if shape == "circle" else math.cos(math.pi / number))
    return [cmath.rect(reach, math.radians(first + 360.0 / number * k)) for k in range(number)]


def nearest_by_hand(shape: str, z: complex) -> complex:
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


def points_around(seed: int, number: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5 * SIZE, 1.5 * SIZE, (number, 2))


@pytest.mark.parametrize("shape", FIRST)
def test_the_nearest_point_of_an_outline(shape: str) -> None:
    """Of points_around all round, near corners and near the middle."""
    at = np.concatenate([points_around(3, 300), 0.3 * points_around(4, 100)])
    places, distance = made(shape).nearest(at)
    known = np.array([nearest_by_hand(shape, complex(*item)) for item in at])
    np.testing.assert_allclose(places @ [1.0, 1j], known, atol=1e-12)
    np.testing.assert_allclose(distance, abs(known - at @ [1.0, 1j]), rtol=1e-12)
    np.testing.assert_array_equal(made(shape).contains(at), [inside(shape, complex(*entry)) for entry in at])


@pytest.mark.parametrize("shape", FIRST)
def test_where_lines_leave_it(shape: str) -> None:
    """By halving the way; some begin near the middle of it, some at its edge."""
    outline, at = made(shape), np.concatenate([points_around(5, 400), 0.45 * points_around(6, 200)])
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

"""Distances of bodies, surface to surface, against known answers."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from solid_numbers import SOLID_NUMBERS, of_point

import exunet
from exunet.bodies.distance import distances
from exunet.bodies.mesh import closed
from exunet.bodies.rotations import product, quaternion_of, rotation_matrix
from exunet.bodies.shapes import SOLIDS, Shape, Solid
from exunet.results.clearance import pairs_of
from exunet.results.course import course_of
from exunet.results.headlines import headline, headlines_of
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case
from exunet.studies.spread import spread_of

CASES = Path(__file__).parents[1] / "cases"
SNAP = CASES / "bodies" / "snap.toml"
QUICK = ("engine.backend=compiled",)
CONNECTORS = ("engine.backend=exudyn",)  # compiles nothing


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
KNOWN = {
    "two spheres": ("sphere", poses(0, 0, 0), "sphere", poses(1, 2, 2), 3.0 - 1.4),
    "sphere over a face": ("sphere", poses(0.2, -0.4, 4.0), "box", poses(0, 0, 0), 4.0 - 1.5 - 0.7),
    "sphere at a corner": ("sphere", poses(1.5, 3.0, 3.5), "box", poses(0, 0, 0), 3.0 - 0.7),
    # Edge along y at x = sqrt(10)/2 from the centre, to the face of the other box at x = 4.5.
    "edge to face": (
        "box",
        poses(0, 0, 0, turn=(0, math.atan2(3.0, 1.0), 0)),
        "box",
        poses(5, 0, 0),
        4.5 - 0.5 * math.sqrt(10.0),
    ),
    "capsules side by side": ("capsule", poses(0, 0, 0), "capsule", poses(2, 0, 0.5), 2.0 - 0.6),
    "capsules end to end": ("capsule", poses(0, 0, 0), "capsule", poses(0, 0, 4), 4.0 - 1.5 - 0.6),
    "capsules crosswise": (
        "capsule",
        poses(0, 0, 0),
        "capsule",
        poses(0.1, 3, 0.2, turn=(0, QUARTER, 0)),
        3.0 - 0.6,
    ),
    "cylinders end to end": ("cylinder", poses(0, 0, 0), "cylinder", poses(0.3, 0, 5), 3.0),
    "cylinders crosswise": ("cylinder", poses(0, 0, 0), "cylinder", poses(0, 3, 0, turn=(0, 1, 0)), 2.0),
    "cylinder upright on a box": (
        "cylinder",
        poses(0, 0, 4),
        "box",
        poses(0, 0, 0, turn=(0, 0, 0.3)),
        4.0 - 1.0 - 1.5,
    ),
    "frustum and sphere": ("frustum", poses(0, 0, 0), "sphere", poses(0, 0, 3), 3.0 - 0.5 - 0.7),
    "one inside the other": ("sphere", poses(0, 0, 0.2), "box", poses(0, 0, 0, turn=(1, 2, 3)), 0.0),
}


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
    expected = np.array([of_point(name, SOLID_NUMBERS[name], place) for place in places[:, :3]])
    np.testing.assert_allclose(found, np.maximum(expected - 1e-9, 0.0), rtol=0.0, atol=1e-9)
    assert 0.01 < (found == 0.0).mean() < 0.7


@pytest.mark.parametrize("one", SOLIDS)
@pytest.mark.parametrize("other", SOLIDS)
def test_the_same_seen_from_either_side(one: str, other: str) -> None:
    """Within 1e-9 m of two searches that go different ways; in many poses, a third of them overlapping."""
    rng = np.random.default_rng(11)
    a, b = random_poses(rng, 300, 0.9), random_poses(rng, 300, 0.9)
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


def test_far_away_and_very_small() -> None:
    """Balls of a millimetre, 3 m apart, a million metres off the origin."""
    ball = shape("sphere", (1e-3, 0.0, 0.0))
    found = distances(ball, poses(1e6, 0, 0), ball, poses(1e6, 3.0, 0))
    assert found == pytest.approx([3.0 - 2e-3], abs=1e-12)


def test_pairs_begin_with_chaser_and_target() -> None:
    found = pairs_of(["a", "target", "b", "chaser"])
    assert found[0] == ("chaser", "target")
    assert len(found) == len({frozenset(pair) for pair in found}) == 6
    assert pairs_of(["upper", "lower"]) == [("lower", "upper")]  # as of a file, whatever a case begins with


def fly_past(output_step: float) -> exunet.Result:
    """A ball of 0.5 m that flies past a turning box of 2 x 2 x 2 m, 3 m beside its centre."""
    bodies = (
        "bodies={chaser={shape='sphere', radius=0.5, mass=1.0, position=[-2, 3, 5], velocity=[2, 0, 0]},"
        "target={shape='box', size=[2, 2, 2], mass=8.0, position=[0, 0, 5], angular_velocity=[0, 1, 0]}}"
    )
    case = (
        CASES / "verification" / "bodies" / "free_bodies.toml",
        [*CONNECTORS, bodies, f"time={{end=2, output_step={output_step}}}"],
    )
    return exunet.run(exunet.load(*case))


@pytest.fixture(scope="module")
def flown() -> exunet.Result:
    return fly_past(0.25)


def test_of_a_run(flown: exunet.Result, tmp_path: Path) -> None:
    """The ball is nearest when it is abreast of the box, over its face; from file too."""
    found = exunet.clearance(flown, "target", "chaser")
    assert found[0] == pytest.approx(math.hypot(1.0, 2.0) - 0.5, abs=1e-9)
    assert found[4] == pytest.approx(2.0 - 0.5, abs=1e-9)  # at 1 s
    exunet.save(flown, tmp_path / "flown.h5")
    loaded = exunet.load_result(tmp_path / "flown.h5")
    assert exunet.clearance(loaded, "target", "chaser").tobytes() == found.tobytes()
    assert headlines_of(course_of(loaded))["bodies_chaser+target_least_distance_m"] == pytest.approx(
        1.5, abs=1e-9
    )


def test_of_a_run_that_stores_start_and_end_alone() -> None:
    """The ball is as near to the face halfway, where nothing is stored."""
    found = headlines_of(course_of(fly_past(2.0)))
    assert found["bodies_chaser+target_least_distance_m"] == pytest.approx(1.5, abs=1e-6)


@pytest.mark.slow
def test_headlines_in_table_and_spread(flown: exunet.Result) -> None:
    headlines = summarise(flown)["headlines"]
    assert headlines["bodies_chaser+target_least_distance_m"]["this_run"] == pytest.approx(1.5, abs=1e-9)
    table = dict(rows(summarise(flown)))
    assert table["least distance of chaser and target"].startswith("1.500 m")
    spread = spread_of(prepare_case(exunet.load(SNAP, [*QUICK])), 2)
    judged = spread.judged["bodies_chaser+target_least_distance_m"]
    assert judged.predictable
    result = exunet.run(exunet.load(SNAP, [*QUICK]))
    assert judged.value == pytest.approx(exunet.clearance(result, "chaser", "target").min(), abs=1e-6)


@pytest.mark.parametrize(
    "key",
    ["bodies_a_b+c-d_least_distance_m", "bodies_a_b+c-d_time_of_least_distance_s"],
)
def test_a_headline_of_its_key(key: str) -> None:
    assert headline(key).key == key


def test_no_shape_no_distance(flown: exunet.Result) -> None:
    bare = {name: replace(body, solids=None) for name, body in flown.bodies.items()}
    older = replace(flown, bodies=bare)
    assert course_of(older).pairs == ()
    with pytest.raises(exunet.InputError, match="no body 'target' with a shape"):
        exunet.clearance(older, "target", "chaser")


def test_damaged_shapes_are_refused(flown: exunet.Result, tmp_path: Path) -> None:
    """A kind of solid that there is not."""
    solids = flown.bodies["target"].solids
    assert solids is not None
    wrong = solids.copy()
    wrong[0, 0] = 77.0
    bodies = {**flown.bodies, "target": replace(flown.bodies["target"], solids=wrong)}
    exunet.save(replace(flown, bodies=bodies), tmp_path / "wrong.h5")
    with pytest.raises(exunet.InputError, match="solid"):
        exunet.load_result(tmp_path / "wrong.h5")

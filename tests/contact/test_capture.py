"""Measures of a capture against what is known of simple hulls, and what became of a target."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import THROWN
from result_samples import square_net
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import exunet
from exunet.bodies.shapes import Shape, Solid
from exunet.cli.ensemble import rows
from exunet.net.areas import achievable_area, rim_area
from exunet.net.arrays import Net
from exunet.results.capture import Measures, capture, target_of
from exunet.results.capture_headlines import _with_unit, outcomes
from exunet.results.course import course_of
from exunet.results.headlines import headlines_of
from exunet.results.table import _CONDITIONS
from exunet.results.verdict import Outcome, conditions, found
from exunet.scene.capture import CONDITIONS, CaptureCriterion
from exunet.simulation.preparation import prepare_case
from exunet.studies.spread import spread_of

Floats = np.ndarray
CORNERS = [list(item) for item in itertools.product((-1.0, 1.0), repeat=3)]  # of a cube with edges of 2 m
EDGES = [
    [a, b]
    for a, b in itertools.combinations(range(8), 2)
    if np.abs(np.subtract(CORNERS[a], CORNERS[b])).sum() == 2.0
]
REST = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6))
SCENE = f"""
format = 1
title = "a cube of threads"
time = {{ end = 1.0, output_step = 0.5 }}
initial.packing = 1.0
net.topology = "explicit"
net.nodes = {CORNERS}
net.elements = {EDGES}
net.node_masses = {[1.0] * 8}
net.cable = {{ diameter = 1e-3, density = 1e-3, youngs_modulus = 1e6 }}
bodies.box = {{ shape = "box", size = [1.0, 1.0, 1.0], mass = 1.0, position = [0.0, 0.0, 5.0] }}
"""


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Net:
    path = tmp_path_factory.mktemp("cube") / "case.toml"
    path.write_text(SCENE)
    return prepare_case(exunet.load(path)).net


def rule(**keys: Any) -> CaptureCriterion:
    return CaptureCriterion.model_validate({"target": "box", "duration": 0.0, "enclosed": 0.5, **keys})


def box(a: float, b: float, c: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Shape:
    return Shape((Solid("box", (a, b, c), at),))


def measured(net: Net, shape: Shape, x: Floats, v: Floats | None = None, **keys: Any) -> Measures:
    points = np.asarray(x, dtype=float)[None], np.zeros((1, 8, 3)) if v is None else v[None]
    return capture(net, rule(**keys), target_of(shape), points, REST)


def test_half_a_box_in_a_cube_is_enclosed(cube: Net) -> None:
    """A box of 1 x 1 x 2 m that begins in the middle of a cube of 2 m and ends 1 m beyond it."""
    now = measured(cube, box(1.0, 1.0, 2.0, (0.0, 0.0, 1.0)), CORNERS, length=4.0)
    assert now.enclosed[0] == pytest.approx(0.5, abs=2e-3)
    # V 8 and 2 m3, S 24 and 10 m2; the frame is the centre of mass here.
    assert now.cqi[0] == pytest.approx(0.1 * 3.0 + 0.1 * 1.4, rel=1e-12)
    corner = math.sqrt(0.5)  # from an edge of the box to a corner of the cube 0.5 m away along x and y
    below = math.sqrt(0.5 + 1.0)
    assert now.mcqi[0] == pytest.approx(
        ((1.0 - now.enclosed[0]) + 0.5 * (corner + below) / 4.0) / 3.0, rel=1e-12
    )
    assert now.mouth[0] == 0.0
    assert measured(cube, box(1.0, 1.0, 1.0, (0.4, 0.0, 0.4)), CORNERS).enclosed[0] == 1.0
    assert measured(cube, box(1.0, 1.0, 1.0, (0.0, 1.6, 0.0)), CORNERS).enclosed[0] == 0.0
    assert measured(cube, box(1.0, 1.0, 1.0, (0.75, 0.0, 0.0)), CORNERS).enclosed[0] == pytest.approx(
        0.75, abs=2e-3
    )


def test_the_offset_is_from_the_centre_of_mass_of_the_target(cube: Net) -> None:
    target = target_of(box(1.0, 1.0, 1.0), (0.3, 0.0, 0.0))
    points = np.array(CORNERS)[None], np.zeros((1, 8, 3))
    now = capture(cube, rule(cqi_weights=[0.0, 0.0, 1.0], length=2.0), target, points, REST)
    assert now.cqi[0] == pytest.approx(0.15, rel=1e-12)


def test_a_flat_net_encloses_nothing(cube: Net) -> None:
    flat = np.array(CORNERS) * [1.0, 1.0, 0.0]
    now = measured(cube, box(1.0, 1.0, 1.0), flat, cqi_weights=[1.0, 1.0, 0.0])
    assert now.enclosed[0] == 0.0
    assert now.cqi[0] == pytest.approx(1.0 + abs(8.0 / 6.0 - 1.0), rel=1e-12)  # V = 0, both sides of 4 m2


def test_a_net_in_line_has_no_surface(cube: Net) -> None:
    line = np.array(CORNERS) * [1.0, 0.0, 0.0]
    now = measured(cube, box(1.0, 1.0, 1.0), line, cqi_weights=[1.0, 1.0, 0.0])
    assert now.cqi[0] == pytest.approx(2.0, rel=1e-12)
    assert np.isfinite(now).all()


def test_the_net_turns_as_a_whole(cube: Net) -> None:
    spin, speed = np.array([0.3, -0.2, 0.7]), np.array([0.1, 0.0, -0.4])
    v = speed + np.cross(spin, np.array(CORNERS))
    now = measured(cube, box(1.0, 1.0, 1.0), CORNERS, v)
    assert now.relative_speed[0] == pytest.approx(float(np.linalg.norm(speed)), rel=1e-12)
    assert now.relative_spin[0] == pytest.approx(float(np.linalg.norm(spin)), rel=1e-12)


def test_the_spin_of_a_net_that_flies_fast(cube: Net) -> None:
    """To round-off of what it turns with, not of the speed of 2^26 m/s; all numbers are exact."""
    v = np.cross([0.5, -0.25, 0.75], np.array(CORNERS)) + 2.0**26
    now = measured(cube, box(1.0, 1.0, 1.0), np.array(CORNERS) + 4.0, v)
    assert now.relative_spin[0] == pytest.approx(math.sqrt(0.875), rel=1e-12)


@pytest.mark.parametrize("seed", [1, 2])
def test_measures_do_not_hang_on_the_axes_of_the_scene(seed: int) -> None:
    """A net with a mouth and a box, then the same at another place, turned, flying and turning along."""
    rng = np.random.default_rng(seed)
    of, keys = square_net(cells=2, size=4.0), {"length": 3.0, "cqi_weights": [0.3, 0.5, 0.7]}
    x = 0.5 * of.reference_position + rng.normal(size=(9, 3)) * 0.3
    x[:4, 2] -= 2.0
    v = rng.normal(size=(9, 3))
    target = target_of(box(1.0, 1.5, 0.8, (0.2, 0.0, 0.1)), (0.3, -0.1, 0.2))
    turn, own = (Rotation.from_rotvec(rng.normal(size=3)) for _ in range(2))
    place, speed, spin = rng.normal(size=(3, 3))
    shift, flight = rng.normal(size=(2, 3)) * 3.0

    def pose(at: Floats, attitude: Rotation) -> Floats:
        return np.concatenate([at, attitude.as_quat(scalar_first=True)])[None]

    by = rule(**keys)
    first = capture(
        of, by, target, (x[None], v[None]), (pose(place, own), np.concatenate([speed, spin])[None])
    )
    # The centre of the target is not that of the frame.
    known = np.linalg.norm(of.mass @ v / of.mass.sum() - speed)
    assert first.relative_speed[0] == pytest.approx(known, rel=1e-12)
    moved = turn.apply(x) + shift, turn.apply(v) + flight
    body = (
        pose(turn.apply(place) + shift, turn * own),
        np.concatenate([turn.apply(speed) + flight, spin])[None],
    )
    second = capture(of, by, target, (moved[0][None], moved[1][None]), body)
    np.testing.assert_allclose(np.array(second), np.array(first), rtol=1e-9)
    offset = of.mass @ x / of.mass.sum() - place - own.apply([0.3, -0.1, 0.2])
    hull = ConvexHull(x)
    volume, surface = abs(hull.volume / 1.2 - 1.0), abs(hull.area / 7.0 - 1.0)
    cqi = 0.3 * volume + 0.5 * surface + 0.7 * np.linalg.norm(offset) / 3.0
    assert first.cqi[0] == pytest.approx(cqi, rel=1e-9)
    local = own.inv().apply(x - place)
    apart = np.linalg.norm(np.maximum(abs(local - [0.2, 0.0, 0.1]) - [0.5, 0.75, 0.4], 0.0), axis=1).mean()
    opened = min(1.0, float(rim_area(of, x)) / achievable_area(of))
    weights = by.mcqi_weights
    mcqi = weights[0] * (1.0 - first.enclosed[0]) + weights[1] * apart / 3.0 + weights[2] * opened
    assert first.mcqi[0] == pytest.approx(mcqi, rel=1e-9)
    assert 0.0 < opened < 1.0


def test_the_spin_of_the_target_is_in_its_own_axes(cube: Net) -> None:
    """A quarter turn about z takes its x to the scene's y, about which the net turns too."""
    quarter = np.array([[0.0, 0.0, 0.0, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]])
    v = np.cross([0.0, 1.5, 0.0], np.array(CORNERS))
    points = np.array(CORNERS)[None], v[None]
    body = quarter, np.array([[0.0, 0.0, 0.0, 1.5, 0.0, 0.0]])
    now = capture(cube, rule(), target_of(box(1.0, 1.0, 1.0)), points, body)
    assert now.relative_spin[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("kind", "numbers", "points", "known"),
    [
        ("cylinder", (1, 2, 0), [(3, 0, 0), (0, 0, 3), (4, 0, 5), (0.2, 0, 0.9)], [2.0, 2.0, 5.0, 0.0]),
        ("capsule", (1, 2, 0), [(3, 0, 0.5), (0, 0, 3), (3, 0, 5)], [2.0, 1.0, 4.0]),
        # Its side goes from (2, -1) to (1, 1): a normal at its middle is (2, 1) / sqrt(5).
        ("frustum", (2, 1, 2), [(3.5, 0, 1), (1, 0, 2.5), (5, 0, -5)], [math.sqrt(5.0), 1.5, 5.0]),
    ],
)
def test_distances_from_solids(kind: Any, numbers: Any, points: Any, known: list[float]) -> None:
    np.testing.assert_allclose(Solid(kind, numbers).distance(np.array(points)), known, rtol=1e-14)


# By hand: at 0, 1, ... s the target is enclosed as asked, and slow enough, where there is a 1.
@pytest.mark.parametrize(
    ("enclosed", "slow", "duration", "touched", "known", "since"),
    [
        ("001111", "111111", 3.0, True, Outcome.CAPTURED, 2.0),
        ("001111", "111111", 3.5, True, Outcome.TOUCHED, 2.0),  # not for long enough yet
        ("000001", "111111", 0.0, True, Outcome.CAPTURED, 5.0),
        ("011100", "111111", 2.0, True, Outcome.ESCAPED, None),
        ("011100", "000000", 2.0, True, Outcome.ESCAPED, None),  # enclosed once, never slow
        ("111111", "111000", 2.0, True, Outcome.ESCAPED, None),  # held, and slipping now
        ("111111", "000000", 2.0, True, Outcome.TOUCHED, None),
        ("111011", "111111", 2.0, True, Outcome.ESCAPED, 4.0),
        ("010000", "111111", 2.0, True, Outcome.ESCAPED, None),  # enclosed once, however short
        ("101111", "000000", 2.0, True, Outcome.TOUCHED, None),
        ("000000", "111111", 0.0, True, Outcome.TOUCHED, None),
        ("000000", "111111", 0.0, False, Outcome.MISSED, None),
    ],
)
def test_what_became_of_it(
    enclosed: str, slow: str, duration: float, touched: bool, known: Outcome, since: float | None
) -> None:
    parts, speeds = (
        np.array([float(item) for item in enclosed]),
        np.array([1.0 - float(entry) for entry in slow]),
    )
    nothing = np.zeros(len(parts))
    measures = Measures(parts, nothing, nothing, nothing, speeds, nothing)
    by = rule(duration=duration, relative_speed=0.5)
    one = found(by, np.arange(len(parts), dtype=float), measures, nothing, touched=touched)
    assert (one.outcome, one.since) == (known, since)


def test_a_mouth_that_must_be_narrow() -> None:
    """All that holds but for the mouth, 0.4 m wide at first: from when on it is 0.3 m."""
    nothing = np.zeros(4)
    mouth = np.array([0.4, 0.4, 0.3, 0.2])
    measures = Measures(nothing + 1.0, nothing, nothing, mouth, nothing, nothing)
    one = found(rule(duration=1.0, mouth=0.3), np.arange(4.0), measures, nothing, touched=True)
    assert (one.outcome, one.since) == (Outcome.CAPTURED, 2.0)
    one = found(rule(duration=1.0, mouth=0.25), np.arange(4.0), measures, nothing, touched=True)
    assert one.outcome == Outcome.TOUCHED


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (
            'target = "ball"\nduration = 1.0\nenclosed = 0.5',
            "unknown body 'ball' (bodies of the case:",
        ),
        ('target = "box"\nduration = 1.0', "capture: "),
        ('target = "box"\nduration = -1.0\nenclosed = 0.5', "duration"),
        ('target = "box"\nduration = 1.0\nenclosed = 1.5', "enclosed"),
        ('target = "box"\nduration = 1.0\ntouching = 1', "touching"),
        ('target = "box"\nduration = 1.0\ncqi = 1.0\ncqi_weights = [0.0, 0.0, 0.0]', "cqi_weights"),
        ('target = "box"\nenclosed = 0.5', "duration"),
        ('target = "box"\nduration = 1.0\nmouth = 0.0', "mouth"),
        ('target = "box"\nduration = 1.0\nmouth = 0.5', "mouth"),
    ],
)
def test_a_rule_that_cannot_be_is_refused_with_its_line(lines: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(f"{SCENE}[capture]\n{lines}\n")
    with pytest.raises(exunet.CaseError, match=r"case\.toml:1[2-6]: capture") as refused:
        exunet.load(path)
    assert words in str(refused.value)


def test_a_target_of_parts_has_a_shape() -> None:
    case = exunet.load(Path(__file__).parents[2] / "cases" / "capture" / "rocket.toml")
    assert case.scene.capture is not None
    assert case.scene.capture.target == "rocket"


@pytest.mark.slow
def test_moved_starts_tell_the_same_of_a_capture_before_the_horizon(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(f'{THROWN}[capture]\ntarget = "box"\nduration = 0.01\nenclosed = 0.01\ntouching = 1\n')
    case = exunet.load(path, ["time.end=0.04"])
    spread, course = spread_of(prepare_case(case), 2), course_of(exunet.run(case))
    ours, theirs = headlines_of(course), headlines_of(spread.plain)
    for key in ("contact_box_first_s", "contact_box_deepest_m"):
        assert theirs[key] == pytest.approx(ours[key], rel=1e-9)
    assert course.contact["contact_box/threads_touching"][0] == 0.0
    assert course.contact["contact_box/threads_force"].max() > 0.0
    for key in ("capture_enclosed", "capture_cqi", "capture_mcqi", "capture_relative_speed_m_s"):
        assert theirs[key] == pytest.approx(ours[key], rel=1e-9)
    assert sum(outcomes(spread.courses).values()) == 2
    many = exunet.ensemble(case, 3)
    assert many.provenance["outcomes"] == {"touched": 3}  # too late to hold on
    assert ("capture", "of 3 runs: 3 touched") in rows(many)
    assert set(outcomes(spread.courses)) == {"touched"}
    result, kept = exunet.run(case), spread.as_ensemble()
    for name in ("contacts", "capture"):
        for size in (None, (85.0, 80.0)):
            drawn = exunet.figure(result, name, spread=kept, size=size)
            assert len(drawn.axes) == 2
            assert all(axes.get_ylabel() and axes.get_lines() for axes in drawn.axes)


def test_every_condition_has_words_and_a_key() -> None:
    """In the table that a run prints, and in summary.json."""
    assert {_with_unit(name) for name in CONDITIONS} == set(_CONDITIONS)


def test_a_bound_of_a_condition_itself_holds() -> None:
    """Of each: what is enclosed and how many threads touch at least, all else at most."""
    bounds = {"relative_speed": 0.5, "relative_spin": 0.2, "cqi": 0.3, "mcqi": 0.4, "mouth": 0.1}
    by = rule(enclosed=0.5, touching=3, **bounds)
    beyond = np.array([1.0, 1.0 - 1e-9, 1.0 + 1e-9])
    of = {name: value * beyond for name, value in ({"enclosed": 0.5} | bounds).items()}
    held = conditions(by, Measures(**of), np.array([3.0, 2.0, 4.0]))
    assert sorted(held) == sorted([*of, "touching"])
    for name, one in held.items():
        assert one.tolist() == [True, name in bounds, name not in bounds]
    assert conditions(rule(), Measures(**of), np.zeros(3)).keys() == {"enclosed"}

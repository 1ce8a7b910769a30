"""The largest area that a mouth can have, and that no state of any topology exceeds it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from result_samples import net, square_net
from scenes import CABLE, thrown
from scipy.spatial.distance import pdist

from exunet.net.areas import (
    achievable_area,
    border_lengths,
    largest_polygon,
    mouth_against,
    mouth_diameter,
)
from exunet.results import measures as metrics
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

sides = st.lists(st.floats(0.01, 10.0), min_size=3, max_size=9)


def regular(corners: int, side: float) -> float:
    return corners * side**2 / (4 * math.tan(math.pi / corners))


@pytest.mark.parametrize(
    ("lengths", "area"),
    [
        ([3.0, 4.0, 5.0], 6.0),  # right-angled: the centre of the circle lies on the longest side
        ([2.0, 2.0, 2.0], math.sqrt(3.0)),
        ([2.0, 3.0, 2.0, 3.0], 6.0),
        ([3.0, 2.0, 2.0, 3.0], 6.0),  # the order of the sides does not matter
        ([7.0, 15.0, 20.0, 24.0], 234.0),  # Brahmagupta, with two right angles: 7^2 + 24^2 = 15^2 + 20^2
        ([1.0] * 6, regular(6, 1.0)),
        ([0.3] * 1000, regular(1000, 0.3)),
        ([1.0, 1.0, 1.99], 0.5),  # the third side hangs slack at sqrt(2): at 1.99 m only 0.1 m2 were left
        ([1.0, 1.0, 50.0], 0.5),  # longer than the others together
        ([1.0, 1.0, 1.0, 50.0], 3 * math.sqrt(3) / 4),  # half of a regular hexagon
        ([1.0, 1.0, math.inf], 0.5),
        ([1.0, 1.0, 1e-12], 0.5e-12),  # to 1e-12 of the longest side squared
        ([1.0, 1.0, 1e-3], 0.5e-3 * math.sqrt(1 - 0.25e-6)),
        ([1.0, 2.0], 0.0),
        ([1.0, 2.0, 0.0], 0.0),
        ([], 0.0),
    ],
)
def test_largest_polygons_that_are_known(lengths, area):
    assert largest_polygon(np.array(lengths)) == pytest.approx(area, rel=1e-12, abs=1e-12)


def test_nothing_bounds_a_polygon_with_two_free_sides():
    assert largest_polygon(np.array([1.0, math.inf, math.inf])) == math.inf


@given(st.tuples(*[st.floats(0.1, 1.0)] * 4))
def test_quadrilaterals_have_brahmaguptas_area(four):
    half = sum(four) / 2
    area = math.sqrt(max(0.0, math.prod(half - side for side in four)))
    found = largest_polygon(np.array(four))
    if sum(side**2 for side in four) >= 2 * max(four) ** 2 + 1e-6:
        known = pytest.approx(area, rel=1e-9)
        assert found == known or found >= area  # or the longest side is slack
    else:
        assert found >= area


@given(sides, st.integers(0, 2**32 - 1))
def test_longer_threads_never_bound_a_smaller_area(lengths, seed):
    lengths = np.array(lengths)
    longer = lengths * np.random.default_rng(seed).uniform(1.0, 2.0, len(lengths))
    assert largest_polygon(longer) >= largest_polygon(lengths) * (1 - 1e-12)


@pytest.mark.ci
@pytest.mark.slow
@settings(max_examples=300)
@given(st.integers(3, 12), st.floats(0.0, 3.0), st.integers(0, 2**32 - 1))
def test_no_loop_in_space_has_more_area_than_the_flat_one(corners, depth, seed):
    """Corners at random, from flat to deep: the fan from their mean against the sides that they have."""
    rng = np.random.default_rng(seed)
    loop = rng.normal(size=(corners, 3)) * (1.0, 1.0, depth)
    of = net(loop, [(k, (k + 1) % corners) for k in range(corners)], mouth=tuple(range(corners)))
    assert metrics.mouth_area(of, loop) <= achievable_area(of) * (1 + 1e-12)


def test_the_largest_polygon_is_reached():
    """Regular loops, deformed along their circle, come as near as one likes: the bound is no other number."""
    angles = np.sort(np.random.default_rng(3).uniform(0, 2 * np.pi, 9))
    loop = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(9)])
    of = net(loop, [(k, (k + 1) % 9) for k in range(9)], mouth=tuple(range(9)))
    ahead = np.append(np.diff(angles), 2 * np.pi + angles[0] - angles[-1])
    assert ahead.max() < np.pi  # the centre is inside
    assert achievable_area(of) == pytest.approx(0.5 * np.sin(ahead).sum(), rel=1e-12)


def test_a_border_is_the_shortest_way_along_the_threads():
    """A loop with a detour beside each direct thread, and two threads between the same knots."""
    at = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, -1, 0)]
    of = net(at, [(0, 1), (1, 2), (2, 1), (2, 3), (3, 0), (0, 4), (4, 1)], mouth=(0, 1, 2, 3))
    np.testing.assert_allclose(border_lengths(of), 1.0, rtol=1e-15)
    assert achievable_area(of) == pytest.approx(1.0, rel=1e-14)


def test_a_mouth_that_threads_do_not_hold_has_no_measures():
    of = net([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1), (2, 3)], mouth=(0, 1, 2, 3))
    assert achievable_area(of) == math.inf
    assert metrics.deployment_of(of, np.zeros(1), of.reference_position[None]) is None
    assert achievable_area(net([(0, 0, 0), (1, 0, 0)], [(0, 1)])) == 0.0
    assert achievable_area(square_net(cells=4, strings=True)) == pytest.approx(1.0, rel=1e-14)


STRINGS = {**CABLE, "diameter": 0.004, "length": 1.0}
TOPOLOGIES = {
    "square": ({"topology": "square", "size": 2.0, "mesh": 0.5}, 4.0),
    "square, divided": ({"topology": "square", "size": 2.0, "mesh": 1.0, "divisions": 3}, 4.0),
    "rectangular": ({"topology": "rectangular", "size": [3.0, 1.0], "mesh": [1.0, 0.5]}, 3.0),
    "radial": ({"topology": "radial", "radius": 1.5, "spokes": 5, "rings": 3}, None),
    "radial, three": ({"topology": "radial", "radius": 1.5, "spokes": 3, "rings": 2, "divisions": 2}, None),
    "one cell": ({"topology": "hexagonal", "mesh": 0.7, "rings": 0}, 1.5 * math.sqrt(3) * 0.49),
    # Twelve sides: six of 0.3 m at the corner cells, six zigzags of 2 x 2 threads between those.
    "hexagonal": ({"topology": "hexagonal", "mesh": 0.3, "rings": 2}, None),
    "cut": (  # an octagon of width 2 m
        {"topology": "cut", "outline": "octagon", "size": 2.0, "mesh_shape": "triangle", "mesh": 0.4}
        | {"border": CABLE},
        8.0 * math.tan(math.pi / 8.0),
    ),
    "hexagonal, divided": ({"topology": "hexagonal", "mesh": 0.3, "rings": 2, "divisions": 2}, None),
}


@pytest.mark.parametrize("name", TOPOLOGIES)
def test_borders_of_the_topologies(name):
    keys, area = TOPOLOGIES[name]
    of = prepare(thrown({}, net={"cable": CABLE, "strings": STRINGS, "bullets": {"mass": 0.5}, **keys})).net
    border, reference = border_lengths(of), float(metrics.mouth_area(of, of.reference_position))
    if keys["topology"] == "hexagonal" and keys["rings"]:
        rings, side = keys["rings"], keys["mesh"]
        np.testing.assert_allclose(border, [side, 2 * rings * side] * 6, rtol=1e-12)
        known = largest_polygon(np.tile([side, 2 * rings * side], 6))
        assert achievable_area(of) == pytest.approx(known, rel=1e-12)
        assert achievable_area(of) > 1.1 * reference  # straight zigzags make room
    else:
        corners = of.reference_position[list(of.mouth)]
        apart = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        np.testing.assert_allclose(border, apart, rtol=1e-12)
        assert achievable_area(of) == pytest.approx(reference, rel=1e-12)
    if area is not None:
        assert achievable_area(of) == pytest.approx(area, rel=1e-12)


LONG = "hexagonal, divided"  # the net with the most elements


@pytest.mark.ci_for("cut")
@pytest.mark.slow_for("cut", "one cell", "hexagonal", "square, divided", "hexagonal, divided")
@pytest.mark.parametrize(
    "name", [*sorted(TOPOLOGIES.keys() - {LONG}), pytest.param(LONG, marks=pytest.mark.slow)]
)
def test_no_thrown_net_opens_beyond_its_achievable_area(name):
    """Thrown so hard that its threads strain: the area exceeds the bound by their stretch at most."""
    keys, _ = TOPOLOGIES[name]
    of = {"cable": CABLE, "strings": STRINGS, "bullets": {"mass": 0.5}, **keys}
    changes = {"net": of, "launch": {"radial_speed": 15.0, "axial_speed": 3.0}, "initial": {"packing": 0.6}}
    run = simulate(prepare(thrown({}, end=0.4, engine={"backend": "compiled"}, **changes)))
    area = metrics.mouth_area(run.net, run.position)
    stretch = np.sqrt(1 + 2 * np.maximum(run.strain.max(axis=1), 0.0))  # eq. (6): L / L0
    assert 1.0 < stretch.max() < 1.08
    largest = float(area.max()) / achievable_area(run.net)
    assert largest > 0.7  # the bound is near what a net reaches
    assert np.all(area <= stretch**2 * achievable_area(run.net) * (1 + 1e-12))
    found = metrics.deployment(run)
    assert found is not None
    assert found.relative_area == largest
    assert largest <= float(stretch.max()) ** 2


@pytest.mark.parametrize("seed", range(3))
def test_a_mouth_against_a_width(seed):
    """Of states that follow each other: the sign of the diameter less the width, and no more than that.

    Where two nodes that are far apart in the first state tell, their distance; where a ball that is smaller
    does, its diameter; else all pairs are compared. A width that one diameter has is among those asked.
    """
    rng = np.random.default_rng(seed)
    loop = rng.normal(size=(7, 3))
    of = net(loop, [(k, (k + 1) % 7) for k in range(7)], faces=(tuple(range(7)),), mouth=(0, 2, 4))
    states = loop * rng.uniform(0.2, 1.5, (40, 1, 1)) + rng.normal(size=(40, 7, 3)) * 0.4
    known = np.array([pdist(state).max() for state in states])
    np.testing.assert_allclose(mouth_diameter(of, states), known, rtol=1e-14)
    exact = 0
    for width in (
        *np.quantile(known, [0.05, 0.3, 0.5, 0.8]).tolist(),
        float(known[7]),
        float(known.max()) * 3.0,
    ):
        found = mouth_against(of, states, width)
        apart = known - width
        near = abs(apart) < 1e-12
        np.testing.assert_array_equal(found[~near] > 0.0, apart[~near] > 0.0)
        assert abs(found[near]).max(initial=0.0) < 1e-12
        assert (abs(found) <= abs(apart) + 1e-12).all()
        exact += int((abs(found - apart) < 1e-12).sum())
    assert exact > 10
    bare = net(loop, [(0, 1)])
    assert mouth_against(bare, states[:2], 0.5).tolist() == [-0.5, -0.5]
    assert mouth_diameter(bare, states[:2]).tolist() == [0.0, 0.0]

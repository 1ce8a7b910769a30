"""Areas, the four measures, and the energy balance against values worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from result_samples import net, result, square_net, unfolding
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from exunet.net import areas
from exunet.results import measures as metrics


def scaled(of, factors, time=None):
    """The reference configuration times each factor, at times 0, 1, 2, ..."""
    factors = np.array(factors, float)
    position = factors[:, None, None] * of.reference_position
    return result(of, np.arange(len(factors)) if time is None else time, position)


def test_unit_square_mouth():
    of = square_net()
    assert metrics.mouth_area(of, of.reference_position) == 1.0  # 1 m x 1 m
    assert metrics.mesh_area(of, of.reference_position) == 1.0  # its only opening


def test_areas_of_many_states_at_once():
    of = square_net(cells=3)
    many = np.array([0.5, 1.0, 2.0])[:, None, None] * of.reference_position
    np.testing.assert_allclose(
        metrics.mouth_area(of, many), [0.25, 1, 4], rtol=1e-15
    )  # squares of the factors
    np.testing.assert_allclose(metrics.mesh_area(of, many[:, None]), [[0.25], [1], [4]], rtol=1e-14)


def test_mouth_folded_by_a_right_angle_about_its_diagonal():
    """Unit square, one diagonal along the fold: two corners in two planes at right angles.

    With h = sqrt(1/2), those corners stand at (h, 0, 0) and (0, 0, h), the ends of the fold at (0, +-h, 0);
    the mean of the four is (h, 0, h) / 4. Seen from it the first corner is at a = (3, 0, -1) h / 4 and a fold
    end at b = (-1, 4, -1) h / 4: a x b = (1, 1, 3) h^2 / 4, so each of the four equal triangles has the area
    |a x b| / 2 = sqrt(11) / 16.
    """
    of = square_net()
    h = np.sqrt(0.5)
    folded = np.array([(h, 0, 0), (0, h, 0), (0, -h, 0), (0, 0, h)])  # the mouth is the loop 0, 1, 3, 2
    assert metrics.mouth_area(of, folded) == pytest.approx(4 * np.sqrt(11) / 16, rel=1e-14)


def test_a_mouth_is_as_wide_as_its_whole_rim():
    """Three cells beside each other: eight nodes on the rim, four of them corners.

    With the corners in one place the others still gape: (1, -2) and (2, 2) are sqrt(17) m apart. From
    the corners the mouth would have no width. What the rim spans: a flat polygon of 8 nodes, four of
    them at the origin, is the triangles of the origin with (1, -2), (2, -2) and with (2, 2), (1, 2), of 1 m2
    each; its fan from the mean, (0.75, 0), is not smaller.
    """
    flat = [(x, y, 0) for y in (0, 1) for x in range(4)]
    sides = [(k, k + 1) for k in (0, 1, 2, 4, 5, 6)] + [(k, k + 4) for k in range(4)]
    faces = tuple((k, k + 1, k + 5, k + 4) for k in range(3))
    of = net(flat, sides, faces=faces, mouth=(0, 3, 7, 4))
    assert of.rim == (0, 1, 2, 3, 7, 6, 5, 4)
    met = np.zeros((8, 3))
    met[[1, 2, 5, 6], :2] = [(1, -2), (2, -2), (1, 2), (2, 2)]
    assert metrics.mouth_area(of, met) == 0.0
    assert areas.rim_area(of, met) >= 2.0
    assert areas.rim_area(of, of.reference_position) == pytest.approx(3.0, rel=1e-14)
    widths = areas.mouth_diameter(of, np.array([met, of.reference_position]))
    np.testing.assert_allclose(widths, [np.hypot(1, 4), np.sqrt(10)], rtol=1e-15)


def test_the_width_of_any_rim():
    """Against the largest of all distances, of 200 states, flat, folded and narrow as it happens."""
    draw = np.random.default_rng(5)
    of = square_net(cells=6)
    shapes = draw.normal(size=(200, 1, 3)) * draw.normal(size=(200, of.n_nodes, 3)).cumsum(axis=1)
    expected = [pdist(shape[list(of.rim)]).max() for shape in shapes]
    np.testing.assert_allclose(areas.mouth_diameter(of, shapes), expected, rtol=1e-14)


def test_whether_a_rim_is_wider_than_a_width():
    """The sign of what scripts compare, over widths that two far nodes, a ball, or only all pairs tell; and
    what it is at least.
    """
    draw = np.random.default_rng(6)
    of = square_net(cells=6)
    shapes = draw.normal(size=(of.n_nodes, 3)) + draw.normal(size=(100, of.n_nodes, 3)).cumsum(axis=0) / 20.0
    exact = areas.mouth_diameter(of, shapes)
    for width in (0.0, 0.7 * exact.min(), *exact, np.nextafter(exact[7], 9.0), 1.9 * exact.max()):
        found = areas.mouth_against(of, shapes, width)
        assert (np.sign(found) == np.sign(exact - width)).all()
        assert (np.abs(found) <= np.abs(exact - width) + 1e-12).all()
    string = net([(0, 0, 0), (1, 0, 0)], [(0, 1)])
    assert areas.mouth_against(string, np.zeros((3, 2, 3)), 0.5).tolist() == [-0.5] * 3


def test_a_net_without_meshes_has_the_rim_of_its_corners():
    assert net([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1), (1, 2)], mouth=(0, 1, 2)).rim == (0, 1, 2)
    assert net([(0, 0, 0), (1, 0, 0)], [(0, 1)]).rim == ()


def test_mesh_area_counts_folds_twice_and_the_mouth_does_not():
    """Two unit cells, one folded flat on the other: two layers, and corners that coincide in pairs."""
    flat = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)]
    sides = [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)]
    of = net(flat, sides, faces=((0, 1, 4, 3), (1, 2, 5, 4)), mouth=(0, 2, 5, 3))
    folded = np.array(flat, float)
    folded[[2, 5], 0] = 0.0
    assert metrics.mesh_area(of, of.reference_position) == 2.0
    assert metrics.mesh_area(of, folded) == 2.0
    assert metrics.mouth_area(of, folded) == 0.0


def test_openings_with_different_numbers_of_corners():
    """A unit square and a triangle of area 1/2 on its side, the square with one side divided."""
    at = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (0.5, 0, 0)]
    sides = [(0, 5), (5, 1), (1, 2), (2, 3), (3, 0), (1, 4), (4, 2)]
    of = net(at, sides, faces=((0, 5, 1, 2, 3), (1, 4, 2)))
    assert metrics.mesh_area(of, of.reference_position) == pytest.approx(1.5, rel=1e-15)


def test_time_above_a_level_on_a_ramp():
    """0 to 1 within 10 s passes 0.8 at 8 s; down again in 5 s, it stays above for one second more."""
    assert metrics.time_above(np.array([0.0, 10.0]), np.array([0.0, 1.0]), 0.8) == pytest.approx(2.0)
    assert metrics.time_above(np.array([0.0, 10, 15]), np.array([0.0, 1, 0]), 0.8) == pytest.approx(3.0)
    assert metrics.time_above(np.array([0.0, 10, 15]), np.array([0.8, 0.8, 0.8]), 0.8) == 0.0  # never exceeds
    assert metrics.time_above(np.array([0.0, 2]), np.array([0.9, 0.9]), 0.8) == 2.0
    assert metrics.time_above(np.array([3.0]), np.array([0.9]), 0.8) == 0.0


def test_four_measures():
    """Areas 0, 1, 0.6 (reference 1) at 0, 2, 4 s: above 0.8 from 1.6 s to 3 s; moved by (0, 3, 4) m."""
    states = scaled(square_net(), np.sqrt([0, 1, 0.6]), time=[0, 2, 4])
    moved = states.position + np.array([(0, 0, 0), (0, 3, 4), (9, 9, 9)])[:, None]
    found = metrics.deployment(replace(states, position=moved))
    assert found is not None
    assert found.largest_area == pytest.approx(1.0, rel=1e-12)
    assert found.relative_area == pytest.approx(1.0, rel=1e-12)
    assert found.achievable_area == pytest.approx(1.0, rel=1e-15)
    assert found.time_of_largest == 2.0
    assert found.distance == pytest.approx(5.0, rel=1e-14)  # 3-4-5 triangle
    assert found.time_open == pytest.approx(1.4, rel=1e-12)
    assert not found.at_end


def test_largest_area_at_the_end_is_said_so():
    still_opening = metrics.deployment(scaled(square_net(), [0.1, 0.5, 0.9]))
    assert still_opening is not None
    assert still_opening.at_end
    assert still_opening.largest_area == pytest.approx(0.81, rel=1e-14)  # 0.9 squared


def test_incomplete_result_and_single_time_have_measures():
    stopped = replace(scaled(square_net(), [0.5]), complete=False, verdict="stopped")
    found = metrics.deployment(stopped)
    assert found is not None
    assert (found.largest_area, found.time_open, found.distance, found.at_end) == (0.25, 0.0, 0.0, True)


def test_net_without_mouth_has_no_measures():
    line = net([(0, 0, 0), (1, 0, 0)], [(0, 1)])
    assert metrics.deployment(scaled(line, [1, 1])) is None
    assert metrics.mesh_area(line, line.reference_position) == 0.0


def test_centre_of_mass_and_bullet_speeds():
    """A cable of 7.8 g from a free node to a bullet of 500 g at x = 2 m: centre at 2 (503.9 / 507.8) m."""
    of = net([(0, 0, 0), (1, 0, 0)], [(0, 1)], bullets=(1,))
    moved = result(of, [0], 2 * of.reference_position[None], [[(0, 0, 0), (1, 2, 2)]])
    mass_of_cable = 7800.0 * 1e-6 * 1.0  # density, area, length of the sample; half on each node, eq. (9)
    at = 2 * (0.5 + mass_of_cable / 2) / (0.5 + mass_of_cable)
    np.testing.assert_allclose(metrics.centre_of_mass(moved), [(at, 0, 0)], rtol=1e-15)
    np.testing.assert_array_equal(metrics.bullet_speeds(moved), [[3.0]])  # |(1, 2, 2)|


@pytest.mark.parametrize(
    ("kinetic", "elastic", "potential", "dissipated", "error"),
    [
        ([4, 2], [0, 1], [0, 0], [0, 1], 0.0),  # closes
        ([4, 2], [0, 1], [0, 0], [0, 0], 1 / 4),  # 1 J of 4 J lost
        ([0, 6], [0, 0], [90, 82], [0, 0], 2 / 8),  # falls 8 J from rest, 2 J lost: the origin of V drops out
        ([0, 0], [0, 0], [7, 7], [0, 0], 0.0),  # at rest
        ([0, 3], [0, 0], [0, 0], [0, 0], 1.0),  # 3 J from nothing
    ],
)
def test_energy_balance(kinetic, elastic, potential, dissipated, error):
    names = {"kinetic": kinetic, "elastic": elastic, "potential": potential, "dissipated": dissipated}
    states = replace(scaled(square_net(), [1, 1]), **{k: np.array(v, float) for k, v in names.items()})
    assert metrics.energy_balance(states) == pytest.approx(error, abs=1e-15)


numbers = st.floats(-10, 10)


@settings(max_examples=40)
@given(st.tuples(numbers, numbers, numbers), st.tuples(numbers, numbers, numbers), st.integers(0, 2**32 - 1))
def test_measures_do_not_change_when_the_net_is_moved_and_turned(vector, shift, seed):
    """Rotations keep areas and distances: rounding of coordinates up to some 20 m leaves about 1e-14."""
    of = square_net(cells=2)
    crumpled = unfolding(of, lift=0.5).position
    crumpled = crumpled + np.random.default_rng(seed).normal(0, 0.1, crumpled.shape)
    turned = Rotation.from_rotvec(vector).apply(crumpled.reshape(-1, 3)).reshape(crumpled.shape) + shift
    time = np.linspace(0, 1, len(crumpled))
    before, after = (metrics.deployment(result(of, time, x)) for x in (crumpled, turned))
    assert before is not None
    assert after is not None
    assert after.largest_area == pytest.approx(before.largest_area, rel=1e-11)
    assert after.distance == pytest.approx(before.distance, abs=1e-12)
    assert after.time_open == pytest.approx(before.time_open, abs=1e-9)
    np.testing.assert_allclose(metrics.mesh_area(of, turned), metrics.mesh_area(of, crumpled), rtol=1e-10)

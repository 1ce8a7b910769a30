"""Mass properties of solids in reference_impl against the closed forms of textbooks, and compounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl.bodies import rotation
from reference_impl.solids import box, capsule, cylinder, frustum, moments, sphere, union

TURN = rotation((1.0, 2.0, -1.0, 0.5))


def cone(radius, length):
    """Volume; height of the centroid over the base; Ixx, Izz about it over the mass."""
    across = 3.0 / 20.0 * radius**2 + 3.0 / 80.0 * length**2
    return math.pi * radius**2 * length / 3.0, length / 4.0, across, 0.3 * radius**2


def test_box():
    volume, centroid, inertia = moments(box((2.0, 3.0, 5.0)))
    assert volume == pytest.approx(30.0, rel=1e-15)
    assert not centroid.any()
    assert inertia == pytest.approx(np.diag([34.0, 29.0, 13.0]) / 12.0, rel=1e-14)


def test_cylinder():
    volume, centroid, inertia = moments(cylinder(0.5, 3.0))
    assert volume == pytest.approx(0.75 * math.pi, rel=1e-15)
    assert not centroid.any()
    across = (3.0 * 0.25 + 9.0) / 12.0
    assert inertia == pytest.approx(np.diag([across, across, 0.125]), rel=1e-14)


def test_sphere():
    volume, centroid, inertia = moments(sphere(3.0))
    assert volume == pytest.approx(36.0 * math.pi, rel=1e-15)
    assert not centroid.any()
    assert inertia == pytest.approx(3.6 * np.eye(3), rel=1e-14)


def test_capsule():
    """Cylinder and two half-spheres, each 3/8 r above its face, with 2/5 r^2 about the ball's centre."""
    r, h = 0.7, 1.9
    tube, balls = math.pi * r**2 * h, 4.0 / 3.0 * math.pi * r**3
    volume, centroid, inertia = moments(capsule(r, h))
    assert volume == pytest.approx(tube + balls, rel=1e-15)
    assert not centroid.any()
    along = tube * r**2 / 2.0 + balls * 0.4 * r**2
    about_face = balls * (0.4 * r**2 + h**2 / 4.0 + 3.0 / 8.0 * h * r)
    across = tube * (3.0 * r**2 + h**2) / 12.0 + about_face
    assert inertia * volume == pytest.approx(np.diag([across, across, along]), rel=1e-14)


def test_cone_points_up_or_down():
    volume, height, across, along = cone(1.5, 2.0)
    for radii, place in (((1.5, 0.0), height - 1.0), ((0.0, 1.5), 1.0 - height)):
        found, centroid, inertia = moments(frustum(radii, 2.0))
        assert found == pytest.approx(volume, rel=1e-14)
        assert centroid == pytest.approx([0.0, 0.0, place], rel=1e-14)
        assert inertia == pytest.approx(np.diag([across, across, along]), rel=1e-14)


def test_frustum_is_a_cone_less_its_tip():
    """Radii 2 and 1 over 3 m: the cone of 6 m less one of 3 m."""
    whole, tip = cone(2.0, 6.0), cone(1.0, 3.0)
    volume, centroid, inertia = moments(frustum((2.0, 1.0), 3.0))
    assert volume == pytest.approx(whole[0] - tip[0], rel=1e-14)
    height = (whole[0] * whole[1] - tip[0] * (3.0 + tip[1])) / volume
    assert centroid == pytest.approx([0.0, 0.0, height - 1.5], rel=1e-14)
    across = whole[0] * (whole[2] + (whole[1] - height) ** 2)
    across -= tip[0] * (tip[2] + (3.0 + tip[1] - height) ** 2)
    along = whole[0] * whole[3] - tip[0] * tip[3]
    assert inertia * volume == pytest.approx(np.diag([across, across, along]), rel=1e-13)


@pytest.mark.parametrize(
    "solid",
    [box((1.0, 2.0, 3.0)), capsule(0.4, 1.0), frustum((1.0, 0.3), 2.0)],
    ids=["box", "capsule", "frustum"],
)
def test_moved_solids_carry_their_moments_along(solid):
    volume, centroid, inertia = moments(solid)
    shift = np.array([3.0, -1.0, 2.0])
    other, place, turned = moments(solid.moved(TURN, shift))
    assert other == pytest.approx(volume, rel=1e-15)
    assert place == pytest.approx(TURN @ centroid + shift, rel=1e-14)
    assert turned == pytest.approx(TURN @ inertia @ TURN.T, abs=1e-14)


def test_moments_far_from_the_origin_lose_only_what_the_places_lose():
    inertia = moments(box((1.0, 2.0, 3.0)).moved(np.eye(3), np.array([1e6, 0.0, -1e6])))[2]
    assert inertia == pytest.approx(np.diag([13.0, 10.0, 5.0]) / 12.0, abs=1e-8)


def test_thin_solids_keep_their_least_moment():
    """A rod of 1 um by 1 m: Izz is 1e-12 of Ixx, and not the difference of two that are as large."""
    inertia = moments(cylinder(1e-6, 1.0))[2]
    assert inertia[2, 2] == pytest.approx(5e-13, rel=1e-14)
    assert moments(box((1e-9, 1e-9, 1.0)))[2][2, 2] == pytest.approx(1e-18 / 6.0, rel=1e-14)


def test_halves_of_a_box_are_the_box():
    half = box((1.0, 2.0, 1.5))
    up, down = (half.moved(np.eye(3), np.array([0.0, 0.0, z])) for z in (0.75, -0.75))
    volume, centroid, inertia = moments(union([up, down]))
    expected = moments(box((1.0, 2.0, 3.0)))
    assert volume == pytest.approx(expected[0], rel=1e-15)
    assert not centroid.any()
    assert inertia == pytest.approx(expected[2], rel=1e-14)


def test_a_solid_twice_in_one_place_weighs_twice():
    one, two = (moments(union([sphere(1.0)] * n)) for n in (1, 2))
    assert two[0] == pytest.approx(2.0 * one[0], rel=1e-15)
    assert two[2] == pytest.approx(one[2], rel=1e-15)


def test_dumbbell_by_hand():
    """Spheres of 1 m and 2 m, 9 m apart along (1, 1, 0): 1 to 8 in mass, centroid 8 m from the small one."""
    axis = np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)
    volume, centroid, inertia = moments(union([sphere(1.0), sphere(2.0).moved(np.eye(3), 9.0 * axis)]))
    unit = 4.0 / 3.0 * math.pi
    assert volume == pytest.approx(9.0 * unit, rel=1e-15)
    assert centroid == pytest.approx(8.0 * axis, rel=1e-14)
    own, apart = 0.4 * (1.0 + 8.0 * 4.0), 1.0 * 64.0 + 8.0 * 1.0
    expected = (own * np.eye(3) + apart * (np.eye(3) - np.outer(axis, axis))) * unit
    assert inertia * volume == pytest.approx(expected, rel=1e-13, abs=1e-12)


def test_least_widths():
    assert box((3.0, 2.0, 4.0)).extent == 2.0
    assert cylinder(1.0, 1.5).extent == 1.5
    assert cylinder(0.5, 1.5).extent == 1.0
    assert sphere(2.0).extent == 4.0
    assert capsule(1.0, 0.5).extent == 2.0
    assert frustum((0.0, 2.0), 5.0).extent == 4.0
    assert union([sphere(1.0), box((1.0, 2.0, 3.0))]).extent == 1.0

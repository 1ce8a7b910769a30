"""Bodies between instants: where they are, how near they come, what meets that is apart at both ends."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from exunet.bodies.distance import Mover, Path, approach, distances, seen_from
from exunet.bodies.rotations import quaternion_of, rotation_matrix, rotation_vector
from exunet.bodies.shapes import Shape, Solid
from exunet.results.clearance import nearest

FIRST = np.array([0, 0, 0])


def path(time: Any, angle: Any = None, axis: Any = (0.0, 0.0, 1.0), spin: Any = 0.0, **line: Any) -> Path:
    """Along coefficients `line` of a cubic (4, 3), turning evenly about an axis by angles (t,)."""
    t = np.array(time, dtype=float)
    c = np.array(line.get("line", np.zeros((4, 3))), dtype=float)
    place = c[0] + t[:, None] * (c[1] + t[:, None] * (c[2] + t[:, None] * c[3]))
    velocity = c[1] + t[:, None] * (2.0 * c[2] + 3.0 * t[:, None] * c[3])
    angles = np.zeros(len(t)) if angle is None else np.array(angle, dtype=float)
    attitude = quaternion_of(angles[:, None] * np.array(axis))
    return Path(t, place, velocity, attitude, np.tile(spin * np.array(axis), (len(t), 1)))


def ball(radius: float, **more: Any) -> Shape:
    return Shape((Solid("sphere", (radius, 0.0, 0.0)),), **more)


def test_places_are_those_of_a_cubic() -> None:
    """Which Hermite's interpolation gives back, at any time and at both ends."""
    line = np.random.default_rng(5).normal(size=(4, 3))
    through, between = path([0.0, 0.7, 1.0], line=line), np.array([0.0, 0.1, 0.5, 0.7, 0.95, 1.0])
    np.testing.assert_allclose(through.when(between)[:, :3], path(between, line=line).place, atol=1e-14)


def random_path(number: int) -> Path:
    """From any state to any other."""
    rng = np.random.default_rng(number)
    place, velocity, spin = rng.normal(size=(3, number, 3))
    attitude = rng.normal(size=(number, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return Path(np.cumsum(rng.uniform(0.1, 0.6, number)), place, velocity, attitude, spin)


def test_each_step_has_a_cubic_of_its_own_and_velocities_that_bound_its_rate() -> None:
    """By scipy's; a rate between is the mean of the three, weighted by Bernstein's polynomials."""
    through, part = random_path(5), np.linspace(0.0, 1.0, 9)
    known = CubicHermiteSpline(through.time, through.place, through.velocity)
    for k in range(4):
        at = through.time[k] + part * through.step[k]
        np.testing.assert_allclose(through.when(at)[:, :3], known(at), atol=1e-14)
        weights = np.stack([(1.0 - part) ** 2, 2.0 * part * (1.0 - part), part**2], axis=1)
        mean = weights @ through.velocities[:, k]
        np.testing.assert_allclose(mean, known.derivative()(at), atol=1e-12)
    turned = rotation_matrix(through.when(through.time)[:, 3:])
    np.testing.assert_allclose(turned, rotation_matrix(through.attitude), atol=1e-14)


def test_the_fastest_turn_is_hardly_more_than_that_of_an_even_one() -> None:
    """Of 1.3 rad/s through 0.52 rad: by the shortest quaternion that there may be, and less than 1 %."""
    time = np.array([0.0, 0.4, 0.8])
    even = path(time, 1.3 * time, np.array([2.0, -1.0, 2.0]) / 3.0, 1.3)
    assert ((even.fastest_turn >= 1.3 / 0.9) & (even.fastest_turn < 1.01 * 1.3 / 0.9)).all()


def test_half_a_turn_goes_the_way_that_its_signs_tell() -> None:
    """Where no way is shorter; about z at pi rad/s, for a second."""
    spin, attitude = np.array([0.0, 0.0, math.pi]), np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    half = Path(np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 3)), attitude, np.stack([spin, spin]))
    middle = half.when(np.array([0.5]))[0, 3:]
    np.testing.assert_allclose(middle, [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)], atol=1e-15)


@pytest.mark.parametrize(("number", "rows"), [(1, [0]), (4, [1, 3]), (5, [0, 2, 4])])
def test_every_second_instant_has_the_last_one(number: int, rows: list[int]) -> None:
    whole = random_path(number)
    np.testing.assert_array_equal(whole.every_second().time, whole.time[rows])
    np.testing.assert_array_equal(whole.every_second().poses, whole.poses[rows])


def test_points_seen_from_bodies() -> None:
    """Turned and shifted back they are where they were."""
    poses, points = random_path(7).poses, np.random.default_rng(1).normal(size=(7, 3))
    own = seen_from(poses, points)
    back = poses[:, :3] + np.einsum("nij,nj->ni", rotation_matrix(poses[:, 3:]), own)
    np.testing.assert_allclose(back, points, atol=1e-14)


def test_attitudes_are_exact_to_the_fourth_order() -> None:
    """Of an even turn by 1.6 rad and by half of it; at 0.3 of the step, where symmetry does not help."""
    axis, errors = np.array([2.0, -1.0, 2.0]) / 3.0, []
    for turn in (1.6, 0.8):
        found = path([0.0, 1.0], [0.2, 0.2 + turn], axis, turn).when(np.array([0.3]))[:, 3:]
        errors.append(float(np.linalg.norm(rotation_vector(found) - (0.2 + 0.3 * turn) * axis)))
    assert errors[0] < 0.01
    assert errors[0] / errors[1] == pytest.approx(2.0**5, rel=0.1)  # of one step: order 4 and one more


def test_the_sign_of_a_quaternion_means_nothing() -> None:
    time = np.linspace(0.0, 1.0, 5)
    one = path(time, 2.0 * time, spin=2.0)
    sign = np.array([1.0, -1.0, -1.0, 1.0, -1.0])[:, None]
    other = Path(one.time, one.place, one.velocity, sign * one.attitude, one.spin)
    at = np.linspace(0.0, 1.0, 17)
    turned = [rotation_vector(of.when(at)[:, 3:]) for of in (one, other)]
    np.testing.assert_allclose(*turned, atol=1e-12)


def test_balls_that_pass_each_other() -> None:
    """At 20 m/s, 1.3 m from middle to middle when they are abreast, 0.23 s after the first instant."""
    flying = Mover(path([0.0, 0.5, 1.0], line=[[-4.6, 1.3, 0.0], [20.0, 0, 0], FIRST, FIRST]), ball(0.5))
    resting = Mover(path([0.0, 0.5, 1.0]), ball(0.3))
    found = nearest(flying, resting)
    assert found.distance == pytest.approx(0.5, abs=1e-8)
    assert found.time == pytest.approx(0.23, abs=3e-6)  # FINE of 0.6 m, at 20 m/s
    assert found.largest == pytest.approx(math.hypot(15.4, 1.3) - 0.8, abs=1e-12)


def test_balls_that_fly_through_each_other() -> None:
    """The same in line: they touch at 3.8 m and have parted at 5.4 m, at 20 m/s."""
    flying = Mover(path([0.0, 0.5, 1.0], line=[[-4.6, 0.0, 0.0], [20.0, 0, 0], FIRST, FIRST]), ball(0.5))
    resting = Mover(path([0.0, 0.5, 1.0]), ball(0.3))
    assert nearest(flying, resting).distance == 0.0
    assert nearest(flying, resting).time == pytest.approx(0.19, abs=4e-6)

    def measure(a: Any, b: Any) -> Any:
        return distances(flying.shape, a, resting.shape, b)

    time, found = approach(flying, resting, measure, touching=True)
    together = time[found == 0.0]
    assert (together[0], together[-1]) == pytest.approx((0.19, 0.27), abs=4e-6)


def test_a_rod_that_turns_past_a_ball() -> None:
    """Nearest as a corner of it points at the ball, (2, 0.05) m from its middle, to both sides of halfway."""
    rod = Mover(path([0.0, 1.0], [-1.0, 1.0], spin=2.0), Shape((Solid("box", (4.0, 0.1, 0.1)),)))
    resting = Mover(path([0.0, 1.0], line=[[2.3, 0.0, 0.0], FIRST, FIRST, FIRST]), ball(0.1))
    found = nearest(rod, resting)
    assert found.distance == pytest.approx(2.3 - math.hypot(2.0, 0.05) - 0.1, abs=1e-8)
    assert abs(found.time - 0.5) == pytest.approx(math.atan(0.025) / 2.0, abs=1e-3)  # of the interpolation


def test_bodies_that_are_far_apart_are_not_looked_at_closer() -> None:
    """No pose between the instants is measured, if no ball can come within the other's reach."""
    flying = Mover(path([0.0, 0.5, 1.0], line=[[-30.0, 0.0, 0.0], [20.0, 0, 0], FIRST, FIRST]), ball(0.5))
    resting, asked = Mover(path([0.0, 0.5, 1.0]), ball(0.3)), []

    def measure(a: Any, b: Any) -> Any:
        asked.append(len(a))
        return distances(flying.shape, a, resting.shape, b)

    approach(flying, resting, measure, touching=True)
    assert asked == [3]

"""Bodies between stored times: how near they come; what went through what in scenes without contact."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from result_samples import net as net_of
from result_samples import result as result_of
from scenes import CASES, SOLID_NUMBERS
from scipy.interpolate import CubicHermiteSpline

import exunet
from exunet.bodies.distance import TOUCH, Mover, Path, approach, crossing, distances
from exunet.bodies.mesh import closed
from exunet.bodies.rotations import quaternion_of, rotation_matrix, rotation_vector
from exunet.bodies.shapes import SOLIDS, Shape, Solid, packed
from exunet.results import penetration as module
from exunet.results.clearance import nearest
from exunet.results.penetration import overlaps, threads_inside
from exunet.results.result import BodyStates, StoredRows

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


@pytest.mark.parametrize("kind", SOLIDS)
def test_segments_against_their_points(kind: Any) -> None:
    """A thousand points along each of many segments, of a solid that is turned and off its origin."""
    rng = np.random.default_rng(3)
    turn = quaternion_of(rng.normal(size=3))
    solid = Solid(kind, SOLID_NUMBERS[kind], (0.2, -0.1, 0.3), tuple(turn.tolist()))
    start, end = rng.normal(size=(2, 300, 3)) * 1.5
    part = np.linspace(0.0, 1.0, 1001)[:, None, None]
    along = (start + part * (end - start)).reshape(-1, 3)
    least = solid.depth(along).reshape(1001, 300).min(axis=0)
    clear = np.abs(least) > 0.005  # more than what the steps along a segment leave open
    found = crossing(Shape((solid,)), start, end)
    assert (found == (least < 0.0))[clear].all()
    assert 0.05 < found.mean() < 0.5


def test_what_touches_a_solid_is_not_inside() -> None:
    """A thread along the face of a box, and at half and twice the depth that counts."""
    box = Shape((Solid("box", (1.0, 1.0, 1.0)),))
    deep = np.array([0.0, 0.5 * TOUCH, 2.0 * TOUCH])
    start = np.stack([np.full(3, -2.0), np.zeros(3), 0.5 - deep], axis=1)
    end = start * [-1.0, 1.0, 1.0]
    assert crossing(box, start, end).tolist() == [False, False, True]


def test_a_short_way_through_a_corner() -> None:
    """0.02 m of a segment of 40 m are inside."""
    box = Shape((Solid("box", (2.0, 2.0, 2.0)),))
    for depth, expected in ((0.01, True), (-0.01, False)):
        middle, way = np.array([1.0 - depth, 1.0 - depth, 0.3]), np.array([1.0, -1.0, 0.0])
        assert crossing(box, (middle - 13.0 * way)[None], (middle + 15.0 * way)[None]) == [expected]


def test_a_mesh_is_crossed_where_its_surface_is() -> None:
    """Like the box of the same size, but for segments that are inside as a whole."""
    mesh, rng = Shape(mesh=closed(CUBE, FACES, "cube")), np.random.default_rng(4)
    start, end = rng.normal(size=(2, 400, 3)) * 0.7
    inside = (np.abs(start) < 0.5).all(axis=1) & (np.abs(end) < 0.5).all(axis=1)
    assert inside.any()
    box = crossing(Shape((Solid("box", (1.0, 1.0, 1.0)),)), start, end)
    assert (crossing(mesh, start, end) == (box & ~inside)).all()


def body(shape: Shape, places: Any, nodes: Any = None) -> BodyStates:
    """At rest in its attitude, at places (n_times, 3)."""
    places = np.array(places, dtype=float)
    still = np.zeros_like(places)
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(places), 1))
    fixed = None if nodes is None else np.array(nodes)
    return BodyStates(
        1.0, np.eye(3), places, still, attitude, still, nodes=fixed, **packed(shape, np.zeros(3))
    )


def falling(**bodies: BodyStates) -> exunet.Result:
    """Three threads in a row along x, 6 m long, that come down by 1 m in each of six seconds from z = 3 m."""
    places = np.array([[x, 0.0, 0.0] for x in (-3.0, -1.0, 1.0, 3.0)])
    net = net_of(places, [(0, 1), (1, 2), (2, 3)])
    time = np.arange(7.0)
    position = places + np.array([0.0, 0.0, 3.0]) - time[:, None, None] * [0.0, 0.0, 1.0]
    velocity = np.broadcast_to([0.0, 0.0, -1.0], position.shape)
    return result_of(net, time, position, velocity, bodies=bodies)


BALL = Shape((Solid("sphere", (1.2, 0.0, 0.0)),))


def at(*place: float) -> Any:
    """The same at each of the seven times."""
    return np.tile(np.array(place), (7, 1))


REST = at(0.0, 0.0, 0.0)


def test_threads_that_pass_a_ball() -> None:
    """The middle one is in it from 1.8 s to 4.2 s, as the ball reaches up to 1.2 m; in between the others."""
    (found,) = threads_inside(falling(ball=body(BALL, REST)))
    assert (found.body, found.elements, found.element) == ("ball", 3, 1)
    assert found.time == pytest.approx(1.8, abs=5e-4)  # 1e-4 of 2.4 m, at a bound of 1 m/s; and a TOUCH
    assert found.time > 1.8


def test_threads_that_fly_through_a_ball_between_stored_times() -> None:
    """At 50 times the speed: above it at one stored time, far below at the next."""
    slow = falling(ball=body(BALL, REST))
    fast = replace(slow, position=slow.position * [1, 1, 50] + [0, 0, 40], velocity=slow.velocity * 50.0)
    (found,) = threads_inside(fast)
    assert found.elements == 3
    assert found.time == pytest.approx((190.0 - 1.2) / 50.0, abs=1e-5)
    assert (
        threads_inside(replace(fast, position=fast.position + np.array([0.0, 1.3, 0.0]))) == []
    )  # 0.1 m beside it


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize(("second", "metre"), [(0.1, 1.0), (7.0, 1.0), (1.0, 0.01), (3.0, 40.0)])
def test_threads_inside_in_other_units(second: float, metre: float, fast: bool) -> None:
    """Of time and length: the same thread, at the same time."""
    ball = Shape((Solid("sphere", (1.2 * metre, 0.0, 0.0)),))
    one = falling(ball=body(ball, REST))
    size, shift = ([1, 1, 50], [0, 0, 40]) if fast else ([1, 1, 1], [0, 0, 0])
    other = replace(
        one,
        time=one.time * second,
        position=(one.position * size + shift) * metre,
        velocity=one.velocity * size * metre / second,
    )
    (found,) = threads_inside(other)
    assert (found.elements, found.element) == (3, 1)
    known = (190.0 - 1.2) / 50.0 if fast else 1.8
    assert found.time == pytest.approx(known * second, abs=5e-4 * second)


def test_a_thread_that_a_turning_body_strikes() -> None:
    """A rod of 4 m that turns by 2 rad in the second between the stored times strikes a thread at rest.

    Its corner, 2 m along and 0.05 m across, comes to the thread, 1.9 m out along x, when it has 1 rad less
    asin(0.05 / 1.9) behind it.
    """
    net = net_of([[1.9, 0.0, -1.0], [1.9, 0.0, 1.0]], [(0, 1)])
    angle, still = np.array([-1.0, 1.0]), np.zeros((2, 3))
    attitude = quaternion_of(angle[:, None] * [0.0, 0.0, 1.0])
    rod = Shape((Solid("box", (4.0, 0.1, 0.1)),))
    turning = BodyStates(
        1.0, np.eye(3), still, still, attitude, still + np.array([0.0, 0.0, 2.0]), **packed(rod, np.zeros(3))
    )
    whole = result_of(net, [0.0, 1.0], [net.reference_position] * 2, bodies={"rod": turning})
    (found,) = threads_inside(whole)
    assert found.time == pytest.approx(0.5 * (1.0 - math.asin(0.05 / 1.9)), abs=5e-3)  # of the interpolation


def test_elements_that_are_tied_to_the_body_do_not_count() -> None:
    """Node 1 is fixed to it: only the last element is left."""
    (found,) = threads_inside(falling(ball=body(BALL, REST, nodes=[1])))
    assert (found.elements, found.element) == (
        1,
        2,
    )  # whose end, 1 m beside, goes in at 0.66 m above the middle
    assert found.time == pytest.approx(3.0 - math.sqrt(1.2**2 - 1.0), abs=5e-4)
    assert threads_inside(falling(ball=body(BALL, at(0.0, 2.0, 0.0)))) == []


def test_a_large_result_gives_the_same_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two states at a time and the one before them, of positions that stay in a file."""
    whole = falling(ball=body(BALL, REST))
    expected, read = threads_inside(whole), []

    def rows_of(start: int, stop: int) -> Any:
        read.append(stop - start)
        return whole.position[start:stop]

    monkeypatch.setattr(module, "_VALUES", 18)
    assert threads_inside(replace(whole, position=StoredRows(rows_of, whole.position.shape))) == expected
    assert set(read) == {2, 3}


def test_bodies_that_overlap() -> None:
    """A ball goes through a box and back; balls that pass at a distance do not.

    At rest at each second, it goes from one z to the next as 3 s^2 - 2 s^3 does from 0 to 1. It touches at
    2.2 m: for 0.8 of the way in the second second, and for 0.1 / 6.9 of it in the last.
    """
    box = Shape((Solid("box", (2.0, 2.0, 2.0)),))
    z = [9.0, 3.0, 2.0, 1.0, 3.0, -2.1, -9.0]
    way = np.stack([np.zeros(7), np.zeros(7), z], axis=1)
    result = falling(
        target=body(box, at(0, 9, 0)),
        chaser=body(BALL, way + at(0, 9, 0)),
        far=body(BALL, way + at(9, 9, 9)),
    )
    (found,) = overlaps(result)
    first, last = (float(np.roots([-2.0, 3.0, 0.0, -part])[1]) for part in (0.8, 0.1 / 6.9))
    assert (found.bodies, found.times) == (("chaser", "target"), 2)
    assert (found.start, found.end) == pytest.approx((1.0 + first, 5.0 + last), abs=2e-4)


def test_bodies_that_fly_through_each_other_between_stored_times() -> None:
    """At 20 m/s, both of 1.2 m: 30 m apart at 1 s, so that they touch at 2.38 s and part at 2.62 s."""
    z = 50.0 - 20.0 * np.arange(7.0)[:, None]
    moving = replace(body(BALL, z * [0, 0, 1]), velocity=np.tile([0.0, 0.0, -20.0], (7, 1)))
    (found,) = overlaps(falling(chaser=moving, target=body(BALL, REST)))
    assert found.times == 1
    assert (found.start, found.end) == pytest.approx((2.5 - 0.12, 2.5 + 0.12), abs=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frame", "snap"])
def test_shipped_scenes_pass_through_nothing(name: str) -> None:
    """Threads that are tied to a body, and lie along it."""
    case = exunet.load(CASES / "bodies" / f"{name}.toml", ["engine.backend=compiled", "time.end=0.2"])
    result = exunet.run(case)
    assert (overlaps(result), threads_inside(result)) == ([], [])


def test_a_net_that_flies_through_a_target() -> None:
    """From the case to the warning: a ball in the way of a thrown net."""
    ball = "bodies.target={shape='sphere', radius=0.3, mass=5.0, position=[0.0, 0.0, 1.0]}"
    case = exunet.load(CASES / "bodies" / "tumbling.toml", [ball, "engine.backend=compiled", "time.end=1.0"])
    result = exunet.run(case)
    (found,) = threads_inside(result)
    assert found.body == "target"
    near = np.linalg.norm(result.position - [0.0, 0.0, 1.0], axis=-1).min(axis=1) < 0.3
    assert found.time <= result.time[near.argmax()]  # a node is not inside before its elements
    assert found.time > result.time[1]


# Between instants

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


def test_half_a_turn_goes_the_way_that_its_signs_tell() -> None:
    """Where no way is shorter; about z at pi rad/s, for a second."""
    spin, attitude = np.array([0.0, 0.0, math.pi]), np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    half = Path(np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 3)), attitude, np.stack([spin, spin]))
    middle = half.when(np.array([0.5]))[0, 3:]
    np.testing.assert_allclose(middle, [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)], atol=1e-15)


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

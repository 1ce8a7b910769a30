"""Motion of ports between two states, loads on them, balances, and what change of pose is a jump."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from coupled import some_state

from exunet import FrameState, InputError
from exunet.bodies.port import (
    INSIDE,
    FrameOf,
    Piece,
    PrescribedMotion,
    PrincipalState,
    difference,
    frames_of,
    jump_of,
    mean_place,
    quaternion_of,
    rate_of,
    rows_of,
    spin_of,
    times,
    turning_between,
    way_between,
)
from exunet.bodies.rotations import rotation_matrix
from exunet.coupling import net_system as ports
from exunet.coupling.net_system import LOOPS, OWN, PREDICTED, PortArrays
from exunet.kernels.compile import compiled_module, interpreted_module
from exunet.kernels.source import hold, loops_source

Floats = np.ndarray
H, SPEED = 0.01, 0.8  # s, m/s or rad/s: 8 mm, or 8 mrad, in a step


def piece_between(time: float, duration: float, begin: FrameState, end: FrameState) -> Piece:
    (a, b), (c, d) = way_between(duration, begin, end)
    position = np.array([a, b, begin.velocity, begin.position])
    turning = np.array([c, d, begin.angular_velocity, (0.0, 0.0, 0.0)])
    return Piece(time, position, np.array(begin.attitude), turning)


def guide_of(piece: Piece) -> PrescribedMotion:
    parts = (part[None] for part in (piece.position, piece.attitude, piece.turning))
    return PrescribedMotion(np.array([piece.time]), *parts, np.zeros(3))


def some_rows(seed: int, number: int = 2) -> Floats:
    random = np.random.default_rng(seed)
    return rows_of(some_state(random) for _ in range(number))


def test_a_piece_has_the_states_of_both_ends_and_the_mean_position() -> None:
    """By the prescribed motion that computes the same motion on whole arrays; attitudes up to their sign."""
    random = np.random.default_rng(0)
    begin, end = some_state(random), some_state(random)
    piece = piece_between(2.0, 0.3, begin, end)
    found = guide_of(piece).at(np.array([2.0, 2.3]))
    for k, state in enumerate((begin, end)):
        for known, values in zip(state, found.parts(), strict=True):
            sign = np.sign(values[k] @ np.array(known)) if len(known) == 4 else 1.0
            np.testing.assert_allclose(sign * values[k], known, atol=1e-11)
    mean = 0.3 ** np.array([3, 2, 1, 0]) / [4.0, 3.0, 2.0, 1.0] @ piece.position  # of the cubic
    np.testing.assert_allclose(mean_place(0.3, begin, end), mean, atol=1e-12)


def test_a_frame_after_a_time() -> None:
    """A turn about z at 2 rad/s that grows by 1 rad/s2, for 0.1 s: 0.205 rad; x = 1 + 0.3 + 0.02."""
    state = FrameState((1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    after = state.after(0.1, (4.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert after.position == pytest.approx((1.32, 0.0, 0.0))
    assert after.velocity == pytest.approx((3.4, 0.0, 0.0))
    assert after.attitude == pytest.approx((np.cos(0.1025), 0.0, 0.0, np.sin(0.1025)))
    assert after.angular_velocity == pytest.approx((0.0, 0.0, 2.1))


def test_the_integral_of_the_angular_velocity() -> None:
    """Against 400 parts of the same motion; Simpson's rule: order 5 in a step, the rotation vector less."""
    begin = some_state(np.random.default_rng(8))
    errors, of_vector = [], []
    for duration in (0.4, 0.2):
        end = begin.after(duration, (0.0, 0.0, 0.0), (1.0, -2.0, 0.5))
        parts = (np.arange(400) + 0.5) * duration / 400
        motion = guide_of(piece_between(0.0, duration, begin, end)).at(parts)
        pairs = zip(motion.attitude, motion.angular_velocity, strict=True)
        known = duration / 400 * sum(rotation_matrix(attitude) @ spin for attitude, spin in pairs)
        errors.append(np.linalg.norm(turning_between(duration, begin, end) - known))
        turn = rotation_matrix(np.array(begin.attitude)) @ difference(begin.attitude, end.attitude)
        of_vector.append(np.linalg.norm(turn - known))
    assert errors[0] > 20.0 * errors[1]
    assert of_vector[1] > 10.0 * errors[1]


@pytest.mark.parametrize("size", [0.9e-4, 1.9e-4, 2.1e-4, 0.009, 0.011, 0.4, 2.9])
def test_rotation_vectors(size: float) -> None:
    """Quaternions and rates there and back, to the last digits on both sides of each change of formula.

    Rates by twice the vector part of q* q'. Two terms of a series leave 1e-13 at 0.01 rad.
    """
    random = np.random.default_rng(14)
    for _ in range(3):
        angle, rate = random.normal(size=(2, 3))
        angle, rate = angle * size / np.linalg.norm(angle), rate / np.linalg.norm(rate)
        found = np.array(quaternion_of(tuple(angle)))
        known = [np.cos(0.5 * size), *(np.sin(0.5 * size) / size * angle)]
        np.testing.assert_allclose(found, known, rtol=3e-16, atol=0.0)
        begin = some_state(random).attitude
        for sign in (1.0, -1.0):  # of the quaternion, which has no meaning
            end = tuple(sign * part for part in times(begin, tuple(found)))
            np.testing.assert_allclose(difference(begin, end), angle, rtol=0.0, atol=2e-15)
        half, of_size = 0.5 * size, angle @ rate / size
        real, ratio = np.cos(half), np.sin(half) / size
        imaginary, of_real = ratio * angle, -0.5 * np.sin(half) * of_size
        of_imaginary = (0.5 * real - ratio) * of_size / size * angle + ratio * rate
        spin = 2.0 * (real * of_imaginary - of_real * imaginary - np.cross(imaginary, of_imaginary))
        np.testing.assert_allclose(spin_of(tuple(angle), tuple(rate)), spin, rtol=0.0, atol=2e-13)
        np.testing.assert_allclose(rate_of(tuple(angle), tuple(spin)), rate, rtol=0.0, atol=4e-13)
    half_a_turn = difference((1.0, 0.0, 0.0, 0.0), (0.0, 0.6, 0.0, 0.8))  # no sign is shorter
    assert half_a_turn == pytest.approx((0.6 * np.pi, 0.0, 0.8 * np.pi), rel=1e-15)


@pytest.mark.parametrize("centre", [(0.0, 0.2, 0.0), (0.1, -0.2, 0.3)])
@pytest.mark.parametrize("axes", [(1.0, 0.0, 0.0, 0.0), (0.8, 0.2, 0.4, 0.4)])
def test_states_of_frames_and_of_centres_of_mass(centre: Any, axes: Any) -> None:
    """Position and velocity of the centre, axes and angular velocity, by rotation matrices; and back."""
    frame, of = some_state(np.random.default_rng(16)), FrameOf(centre, axes)
    turn, own = rotation_matrix(np.array(frame.attitude)), rotation_matrix(np.array(axes))
    found = of.principal(frame)
    np.testing.assert_allclose(found.position, frame.position + turn @ centre, atol=1e-15)
    speed = frame.velocity + turn @ np.cross(frame.angular_velocity, centre)
    np.testing.assert_allclose(found.velocity, speed, atol=1e-15)
    np.testing.assert_allclose(rotation_matrix(np.array(found.attitude)), turn @ own, atol=1e-15)
    np.testing.assert_allclose(found.angular_velocity, np.array(frame.angular_velocity) @ own, atol=1e-15)
    for values, known in zip(of.frame(found), frame, strict=True):
        np.testing.assert_allclose(values, known, rtol=0.0, atol=1e-15)


def test_rows_of_states_are_extrapolated_at_the_mean_acceleration_since() -> None:
    now, before, found = some_rows(1), some_rows(2), np.empty((2, 13))
    for since in (0.2, 0.0):
        ports.extrapolate(now, before, since, 0.1, found)
        rates = (now - before) / since if since else np.zeros((2, 13))
        for p, frame in enumerate(frames_of("ab", now).values()):
            known = frame.after(0.1, tuple(rates[p, 3:6]), tuple(rates[p, 10:]))
            np.testing.assert_allclose(found[p], np.concatenate(known), rtol=0.0, atol=1e-15)


AXES = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.2, 0.4, 0.4]])


@pytest.fixture
def arrays(monkeypatch: pytest.MonkeyPatch) -> PortArrays:
    """Arrays of three bodies, of which the last and the first are ports."""
    monkeypatch.setattr(ports, "borrowed", lambda value: value, raising=False)
    random, rows = np.random.default_rng(3), some_rows(3, number=3)
    parts = rows[:, :3], rows[:, 3:6], rows[:, 6:10], rows[:, 10:]
    own = np.array([2, 0]), np.array([8, 0]), random.normal(size=(2, 3)), AXES
    return PortArrays(*parts, random.normal(size=15), *own, *(np.zeros((2, n)) for n in (13, 7, 13, 13)))


def test_ports_move_to_their_target_states(arrays: PortArrays) -> None:
    """Frames and centres of mass at both ends, the piece between, and the largest rotation."""
    target, step = some_rows(5), 0.3
    position, attitude, turning = np.zeros((2, 4, 3)), np.zeros((2, 4)), np.zeros((2, 4, 3))
    held = SimpleNamespace(value=arrays)
    largest = ports.plan_motion(step, target, position, attitude, turning, held)
    spins = []
    for p, (number, end) in enumerate(zip((2, 0), frames_of("ab", target).values(), strict=True)):
        of = FrameOf(tuple(arrays.centre[p]), tuple(arrays.axes[p]))
        parts = arrays.position, arrays.velocity, arrays.attitude, arrays.angular_velocity
        begin = PrincipalState(*(tuple(part[number].tolist()) for part in parts))
        last = of.principal(end)
        np.testing.assert_array_equal(arrays.begin[p], np.concatenate(begin))
        np.testing.assert_allclose(arrays.end[p], np.concatenate(last), rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(arrays.frames[p], np.concatenate(of.frame(begin)), rtol=0.0, atol=1e-15)
        np.testing.assert_array_equal(arrays.given[p], arrays.first_order[(8, 0)[p] :][:7])
        piece = piece_between(0.0, step, begin, last)
        for found, known in zip((position, attitude, turning), piece[1:], strict=True):
            np.testing.assert_allclose(found[p], known, rtol=1e-13, atol=1e-13)
        spins.append(max(np.linalg.norm(item.angular_velocity) for item in (begin, last)))
    assert largest == (int(np.argmax(spins)), pytest.approx(step * max(spins), rel=1e-14))


def test_loads_of_a_step(arrays: PortArrays) -> None:
    """Impulse and work; mean force, and mean torque about the mean position of the frame's origin."""
    target, step = some_rows(5), 0.3
    arrays.frames[:], arrays.given[:] = some_rows(4), np.random.default_rng(18).normal(size=(2, 7))
    impulses, wrenches = np.empty((2, 7)), np.empty((2, 6))
    ports.collect_loads(step, target, impulses, wrenches, SimpleNamespace(value=arrays))
    for p, entry in enumerate((8, 0)):
        known = arrays.given[p] - arrays.first_order[entry : entry + 7]
        np.testing.assert_allclose(impulses[p], known, rtol=1e-14)
        (begin,), (end,) = (frames_of("a", rows[p : p + 1]).values() for rows in (arrays.frames, target))
        about = np.array(mean_place(step, begin, end))
        np.testing.assert_allclose(wrenches[p, :3], known[:3] / step, rtol=1e-14)
        torque = (known[3:6] - np.cross(about, known[:3])) / step
        np.testing.assert_allclose(wrenches[p, 3:], torque, rtol=0.0, atol=1e-13)


def test_balances_of_ports() -> None:
    """Sums of impulses, of errors and of absolute work; smallest, largest; an ejection's error by itself."""
    random, steps, recoils = np.random.default_rng(19), np.array([0.1, 0.2]), np.array([False, True])
    applied, impulses = random.normal(size=(2, 1, 6)), random.normal(size=(2, 1, 7))
    begin, end = (np.stack([some_rows(seed)[:1], some_rows(seed + 1)[:1]]) for seed in (6, 8))
    balances = random.normal(size=(1, 13))
    known = balances[0].copy()
    for k in range(2):
        (one,), (other,) = (frames_of("a", rows[k]).values() for rows in (begin, end))
        work = applied[k, 0, :3] @ (np.array(other.position) - one.position)
        error = work + applied[k, 0, 3:] @ turning_between(steps[k], one, other) - impulses[k, 0, 6]
        known[:7] += impulses[k, 0]
        known[9] += abs(impulses[k, 0, 6])
        known[11], known[12] = min(known[11], known[6]), max(known[12], known[6])
        if recoils[k]:
            known[10] += error
        else:
            known[7], known[8] = known[7] + error, max(known[8], abs(error))
    ports.add_to_balances(steps, recoils, applied, impulses, begin, end, balances)
    np.testing.assert_allclose(balances[0], known, rtol=0.0, atol=1e-13)


@pytest.mark.ci
@pytest.mark.slow  # it compiles them
def test_compiled_loops_are_those_of_python_bitwise() -> None:
    """The second of two frames hardly turns, where series hold."""
    random, source = np.random.default_rng(11), loops_source((hold, *LOOPS), INSIDE)
    before, now = some_rows(11), some_rows(12)
    before[1, 10:] = now[1, 10:] = 1e-6, -2e-6, 3e-6
    after = rows_of(state.after(0.01) for state in frames_of(("a", "b"), now).values())
    parts = (slice(3), slice(3, 6), slice(6, 10), slice(10, 13))
    bodies = tuple(np.ascontiguousarray(now[:, part]) for part in parts)
    of = np.arange(2), np.array([0, 7]), np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.3]]), AXES
    first_order, outputs = random.normal(size=14), random.normal(size=(2, 18))
    found = []
    for module in (compiled_module(source), interpreted_module(source)):
        way = [np.zeros(shape) for shape in ((2, 4, 3), (2, 4), (2, 4, 3))]
        numbers = first_order.copy()
        space = [np.zeros((2, n)) for n in (13, 7, 13, 13)]
        held = module.hold(PortArrays(*bodies, numbers, *of, *space))
        target, frames, impulses, wrenches = (np.zeros((2, n)) for n in (13, 13, 7, 6))
        balances = np.ones((2, 13))
        results = [module.read_markers(outputs, frames)]
        results += [*module.find_jump(0.01, now, frames, before, 0.02, 0.5, 1.0)]
        results += [*module.find_jump(0.01, now, after, before, 0.02, 0.5, 1.0)]
        module.extrapolate(now, before, 0.02, 0.01, target)
        results += module.plan_motion(0.01, target, *way, held)
        numbers += 0.1
        module.collect_loads(0.01, target, impulses, wrenches, held)
        twice = (np.stack([entry, entry]) for entry in (wrenches, impulses, now, after))
        module.add_to_balances(np.array([0.01, 0.01]), np.array([False, True]), *twice, balances)
        found.append([np.array(results), target, frames, *way, *space, impulses, wrenches, balances])
    for compiled, interpreted in zip(*found, strict=True):
        np.testing.assert_array_equal(compiled, interpreted)


# Jumps


def moving(place: float, speed: float, turns: bool) -> FrameState:
    """On the x axis, or about it."""
    if turns:
        return FrameState((0.0,) * 3, (0.0,) * 3, quaternion_of((place, 0.0, 0.0)), (speed, 0.0, 0.0))
    return FrameState((place, 0.0, 0.0), (speed, 0.0, 0.0))


def passes(way: float, begin: float, end: float, turns: bool, last: float = 0.0, part: float = OWN) -> bool:
    """True if a way over the step with velocities at both ends, and an acceleration before, is not a jump."""
    states = moving(0.3, begin, turns), moving(0.3 + way, end, turns)
    kind, _, _ = jump_of(H, *states, last, last, part, 1.0)
    return bool(kind < 0)


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize(
    ("begin", "end"), [(SPEED, SPEED), (SPEED, 3.0 * SPEED), (SPEED, -SPEED), (0.0, SPEED), (SPEED, 0.0)]
)
def test_integrators_of_first_order_and_better_pass(begin: float, end: float, turns: bool) -> None:
    """By the first velocity, the last, the mean, and a bounce anywhere in the step; 3 steps off do not."""
    for place in np.linspace(0.0, 1.0, 11):
        way = H * (place * begin + (1.0 - place) * end)
        assert passes(way, begin, end, turns)
        off = 3.0 * H * max(abs(begin), abs(end))
        assert not passes(way + off, begin, end, turns)
        assert not passes(way - off, begin, end, turns)


@pytest.mark.parametrize("turns", [False, True])
def test_what_velocities_explain(turns: bool) -> None:
    """Steady motion a tenth of its way; a swing of a radian a step in any phase, 2.4 with the step before."""
    for part, allowed in ((0.09, True), (0.11, False), (1.0, False), (2.5, False)):
        for sign in (1.0, -1.0):
            assert passes((1.0 + sign * part) * H * SPEED, SPEED, SPEED, turns) == allowed
    assert not passes(1e-6, 0.0, 0.0, turns)  # at rest
    for swing, known in ((1.0, False), (2.4, True)):
        rate = swing / H
        for phase in np.linspace(0.0, 2.0 * math.pi, 181):
            place = [1e-3 * math.sin(phase + k * swing) for k in range(3)]
            speed = [1e-3 * rate * math.cos(phase + k * swing) for k in range(3)]
            last = abs(speed[1] - speed[0]) / H if known else 0.0
            assert passes(place[2] - place[1], speed[1], speed[2], turns, last)
    # at constant velocity, of a symplectic Euler host that a force meets: off by 3/2 of what it changes
    before, after = SPEED, SPEED + 0.4
    way = 2.0 * H * after - H * before
    assert passes(way, before, after, turns, part=PREDICTED)
    assert not passes(way, before, after, turns, part=OWN)
    assert not passes(way + 0.2 * H * after, before, after, turns, part=PREDICTED)


def test_how_far_a_way_is_off_and_may_be() -> None:
    """Of the position, then of the rotation vector; what is allowed grows with change and rate."""
    random, step = np.random.default_rng(17), 0.1
    begin, end = some_state(random), some_state(random)
    (v, w), (a, b) = np.array([begin.velocity, end.velocity]), np.array([begin.position, end.position])
    angle = np.array(difference(begin.attitude, end.attitude))
    p, q = np.array(begin.angular_velocity), np.array(rate_of(tuple(angle), end.angular_velocity))
    near = end._replace(position=tuple((a + 0.05 * (v + w)).tolist()))
    for kind, state, way, first, last, more in ((0, end, b - a, v, w, 0.07), (1, near, angle, p, q, 0.09)):
        found, off, allowed = jump_of(step, begin, state, 0.7, 0.9, 0.4, 1.0)
        assert found == kind
        assert off == pytest.approx(np.linalg.norm(way - 0.05 * (first + last)), rel=1e-14)
        fastest = max(np.linalg.norm(first), np.linalg.norm(last))
        known = step * (0.4 * (np.linalg.norm(last - first) + more) + 0.1 * fastest)
        assert allowed == pytest.approx(known, rel=1e-14)
    sideways = moving(H * SPEED, SPEED, False)._replace(position=(0.008, 0.008, 0.0))
    kind, off, _ = jump_of(H, moving(0.0, SPEED, False), sideways, 0.0, 0.0, OWN, 1.0)
    assert (kind, off) == (0, pytest.approx(0.008))


def test_the_row_that_rotates_most_and_the_first_that_jumps() -> None:
    begin = rows_of([FrameState((0.0,) * 3, angular_velocity=(0.0, 0.3, 0.4)) for _ in range(3)])
    end = begin.copy()
    end[1, 10:] = 0.0, 1.2, 0.5
    assert ports.max_rotation(0.1, begin, end) == (1, pytest.approx(0.13))
    end = rows_of(frame.after(0.1) for frame in frames_of("abc", begin).values())
    assert ports.find_jump(0.1, begin, end, begin, 0.0, 0.5, 1.0)[:2] == (-1, -1)
    end[1, 1] += 0.02
    assert ports.find_jump(0.1, begin, end, begin, 0.0, 0.5, 1.0)[:3] == (1, 0, pytest.approx(0.02))
    before = begin.copy()
    before[1, 3:6] = 1.0, -2.0, 2.0  # slowed down at 3 m/s in 0.2 s: half of that in 0.1 s is explained
    assert ports.find_jump(0.1, begin, end, before, 0.2, 0.5, 1.0)[0] == -1
    assert ports.find_jump(0.1, begin, end + 0.2 * (end != begin), before, 0.2, 0.5, 1.0)[0] >= 0


def test_what_is_not_a_state_of_a_frame() -> None:
    good = FrameState((0.0, 0.0, 0.0))
    for wrong in (
        FrameState((1.0, 2.0)),  # type: ignore[arg-type]
        FrameState("abc"),  # type: ignore[arg-type]
        FrameState(None),  # type: ignore[arg-type]
        ((0.0, 0.0), 1.0),
        good._replace(velocity=(np.nan, 0.0, 0.0)),
        good._replace(attitude=(1.0, 1.0, 0.0, 0.0)),
    ):
        with pytest.raises(InputError, match="body b"):
            FrameState.of(wrong, "body b")  # type: ignore[arg-type]

"""Ports without a net: the way between two states of a frame, states that are none, momentum in transit."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from coupled import Scene

import exunet
from exunet import InputError
from exunet.bodies.guide import Guide
from exunet.bodies.port import (
    INSIDE,
    FrameOf,
    FrameState,
    Piece,
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
from exunet.bodies.rigid import RigidBody
from exunet.bodies.rotations import rotation_matrix
from exunet.cli.check import describe
from exunet.coupling import port_loops
from exunet.coupling.exudyn_state import Handover, Weights
from exunet.coupling.port_loops import CALLED, PortRoom
from exunet.coupling.prediction import Predictor
from exunet.coupling.rollback import Undo
from exunet.kernels.compile import compiled_module, interpreted_module
from exunet.kernels.source import hold, loops_source

Floats = np.ndarray
SOURCE = loops_source((hold, *CALLED), INSIDE)


def some_state(random: np.random.Generator) -> FrameState:
    attitude = random.normal(size=4)
    parts = random.normal(size=3), random.normal(size=3), attitude / np.linalg.norm(attitude)
    return FrameState.of((*parts, random.normal(size=3)), "a test")


def piece_between(time: float, duration: float, begin: FrameState, end: FrameState) -> Piece:
    (a, b), (c, d) = way_between(duration, begin, end)
    position = np.array([a, b, begin.velocity, begin.position])
    turning = np.array([c, d, begin.angular_velocity, (0.0, 0.0, 0.0)])
    return Piece(time, position, np.array(begin.attitude), turning)


@pytest.mark.parametrize("seed", range(5))
def test_a_piece_has_the_states_of_both_ends(seed: int) -> None:
    """By the guide that states the same motion on whole arrays; attitudes up to their sign."""
    random = np.random.default_rng(seed)
    begin, end = (some_state(random) for _ in range(2))
    piece = piece_between(2.0, 0.3, begin, end)
    parts = (part[None] for part in (piece.position, piece.attitude, piece.turning))
    found = Guide(np.array([2.0]), *parts, np.zeros(3)).at(np.array([2.0, 2.3]))
    for k, state in enumerate((begin, end)):
        for known, values in zip(state, found.parts(), strict=True):
            sign = np.sign(values[k] @ np.array(known)) if len(known) == 4 else 1.0
            np.testing.assert_allclose(sign * values[k], known, atol=1e-11)
    again = Piece.of_numbers(piece.numbers())
    np.testing.assert_array_equal(again.numbers(), piece.numbers())


def test_the_mean_place_is_that_of_the_way() -> None:
    random = np.random.default_rng(6)
    begin, end = some_state(random), some_state(random)
    piece = piece_between(0.0, 0.4, begin, end)
    c0, c1, c2, c3 = piece.position
    mean = (
        c0 * 0.4**3 / 4.0 + c1 * 0.4**2 / 3.0 + c2 * 0.4 / 2.0 + c3
    )  # integral of the cubic over its length
    np.testing.assert_allclose(mean_place(0.4, begin, end), mean, atol=1e-12)


def test_frames_and_principal_axes_are_of_one_body() -> None:
    """A point of the body is at the same place and has the same velocity by both."""
    random = np.random.default_rng(7)
    attitude = np.array([0.8, 0.0, 0.6, 0.0])
    body = RigidBody("b", 2.0, (1.0, 2.0, 2.5), (0.1, -0.2, 0.3), tuple(attitude))
    frame = some_state(random)
    of = FrameOf.body(body)
    principal = of.principal(frame)
    point = np.array([0.4, 0.5, -0.6])
    found = []
    for state, arm in ((frame, point), (principal, body.in_principal_axes(point))):
        turn = rotation_matrix(np.array(state.attitude))
        found.append(state.position + turn @ arm)
        found.append(state.velocity + turn @ np.cross(state.angular_velocity, arm))
    np.testing.assert_allclose(found[:2], found[2:], atol=1e-14)
    for one, other in zip(of.frame(principal), frame, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-14)


def test_a_frame_goes_on() -> None:
    """A turn about z at 2 rad/s that grows by 1 rad/s2, for 0.1 s: 0.205 rad; x = 1 + 0.3 + 0.02."""
    state = FrameState((1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    after = state.after(0.1, (4.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert after.position == pytest.approx((1.32, 0.0, 0.0))
    assert after.velocity == pytest.approx((3.4, 0.0, 0.0))
    assert after.attitude == pytest.approx((np.cos(0.1025), 0.0, 0.0, np.sin(0.1025)))
    assert after.angular_velocity == pytest.approx((0.0, 0.0, 2.1))


def test_momentum_in_transit_of_the_generalised_alpha_method() -> None:
    """Of spectral radius 1: (a + b) / 2 = (F + E) / 2 and the mean of a and b, as the module writes it.

    By hand, m = f = g = 1/2, forces 1, 0 handed over for the same: a = 1, 0; applied 1/2, 1/2: in transit
    1/2, then nothing. Of the trapezoidal rule half of the last impulse is in transit, of RK44 nothing.
    """
    alpha = Handover(np.zeros(1), Weights(0.5, 0.5, 0.5))
    for force, known in ((1.0, 0.5), (0.0, 0.0)):
        mean = np.array([force])
        assert alpha.take(mean, mean, 1.0, jumps=False) == pytest.approx([0.5], abs=1e-15)
        assert alpha.in_transit[0] == pytest.approx(known, abs=1e-15)
    rule = Handover(np.zeros(1), Weights())
    for force in (3.0, 1.0):
        mean = np.array([force])
        rule.take(mean, mean, 0.1, jumps=False)
        assert rule.in_transit[0] == pytest.approx(0.05 * force)
    whole, mean = Handover(np.zeros(2)), np.array([1.0, 2.0])
    assert (whole.handed(mean, 0.1, jumps=False) == mean).all()
    assert (whole.take(mean, mean, 0.1, jumps=False) == mean).all()
    assert not whole.in_transit.any()


def test_the_angular_velocity_sums_up_to_what_turning_gives() -> None:
    """Against 400 parts of the same motion, by the guide of `Piece`; Simpson's rule: order 5 in a step."""
    random = np.random.default_rng(8)
    begin = some_state(random)
    errors, of_vector = [], []
    for duration in (0.4, 0.2):
        end = begin.after(duration, (0.0, 0.0, 0.0), (1.0, -2.0, 0.5))
        piece = piece_between(0.0, duration, begin, end)
        parts = [part[None] for part in (piece.position, piece.attitude, piece.turning)]
        times = (np.arange(400) + 0.5) * duration / 400
        along = Guide(np.zeros(1), *parts, np.zeros(3)).at(times)
        known = np.zeros(3)
        for attitude, spin in zip(along.attitude, along.angular_velocity, strict=True):
            known += duration / 400 * rotation_matrix(attitude) @ spin
        errors.append(np.linalg.norm(turning_between(duration, begin, end) - known))
        turn = rotation_matrix(np.array(begin.attitude)) @ difference(begin.attitude, end.attitude)
        of_vector.append(np.linalg.norm(turn - known))
    assert errors[0] > 20.0 * errors[1]
    assert of_vector[1] > 10.0 * errors[1]


def vectors(random: np.random.Generator, size: float) -> tuple[Floats, Floats]:
    """A rotation vector of a size, and a unit vector."""
    angle, other = random.normal(size=(2, 3))
    return angle * size / np.linalg.norm(angle), other / np.linalg.norm(other)


SIZES = (0.9e-4, 1.9e-4, 2.1e-4, 0.009, 0.011, 0.4, 2.9)


@pytest.mark.parametrize("size", SIZES)
def test_rotation_vectors_and_quaternions(size: float) -> None:
    """There and back, to the last digits on both sides of each change of formula."""
    random = np.random.default_rng(14)
    for _ in range(5):
        angle, _ = vectors(random, size)
        found = np.array(quaternion_of(tuple(angle)))
        known = [np.cos(0.5 * size), *(np.sin(0.5 * size) / size * angle)]
        np.testing.assert_allclose(found, known, rtol=3e-16, atol=0.0)
        begin = some_state(random).attitude
        for sign in (1.0, -1.0):  # of the quaternion, which means nothing
            end = tuple(sign * part for part in times(begin, tuple(found)))
            np.testing.assert_allclose(difference(begin, end), angle, rtol=0.0, atol=2e-15)
        np.testing.assert_allclose(
            difference((1.0, 0.0, 0.0, 0.0), tuple(found)), angle, rtol=1e-12 if size > 2.0 else 2e-15
        )


def test_half_a_turn_goes_the_way_of_its_quaternion() -> None:
    """Whose real part is zero, and no sign is shorter."""
    assert difference((1.0, 0.0, 0.0, 0.0), (0.0, 0.6, 0.0, 0.8)) == pytest.approx(
        (0.6 * np.pi, 0.0, 0.8 * np.pi), rel=1e-15
    )


@pytest.mark.parametrize("size", SIZES)
def test_angular_velocities_and_rates_of_rotation_vectors(size: float) -> None:
    """By twice the vector part of q* q'; back again. Two terms of a series leave 1e-13 at 0.01 rad."""
    random = np.random.default_rng(15)
    for _ in range(5):
        angle, rate = vectors(random, size)
        half, of_size = 0.5 * size, angle @ rate / size
        real, ratio = np.cos(half), np.sin(half) / size
        imaginary, of_real = ratio * angle, -0.5 * np.sin(half) * of_size
        of_imaginary = (0.5 * real - ratio) * of_size / size * angle + ratio * rate
        known = 2.0 * (real * of_imaginary - of_real * imaginary - np.cross(imaginary, of_imaginary))
        np.testing.assert_allclose(spin_of(tuple(angle), tuple(rate)), known, rtol=0.0, atol=2e-13)
        np.testing.assert_allclose(rate_of(tuple(angle), tuple(known)), rate, rtol=0.0, atol=4e-13)


@pytest.mark.parametrize("centre", [(0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, -0.3), (0.1, -0.2, 0.3)])
@pytest.mark.parametrize("axes", [(1.0, 0.0, 0.0, 0.0), (0.8, 0.2, 0.4, 0.4)])
def test_states_of_frames_and_of_centres_of_mass(centre: Any, axes: Any) -> None:
    """Place and velocity of the centre, axes and spin, by rotation matrices; and back."""
    frame, of = some_state(np.random.default_rng(16)), FrameOf(centre, axes)
    turn, own = rotation_matrix(np.array(frame.attitude)), rotation_matrix(np.array(axes))
    found = of.principal(frame)
    np.testing.assert_allclose(found.position, frame.position + turn @ centre, atol=1e-15)
    speed = frame.velocity + turn @ np.cross(frame.angular_velocity, centre)
    np.testing.assert_allclose(found.velocity, speed, atol=1e-15)
    np.testing.assert_allclose(rotation_matrix(np.array(found.attitude)), turn @ own, atol=1e-15)
    np.testing.assert_allclose(found.angular_velocity, np.array(frame.angular_velocity) @ own, atol=1e-15)
    for one, other in zip(of.frame(found), frame, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-15)


def test_how_far_a_way_is_from_the_mean_of_the_rates() -> None:
    """Of the place, then of the rotation vector; what is allowed grows with change and rate."""
    random, step = np.random.default_rng(17), 0.1
    begin, end = some_state(random), some_state(random)
    (v, w), (a, b) = np.array([begin.velocity, end.velocity]), np.array([begin.position, end.position])
    kind, off, allowed = jump_of(step, begin, end, 0.7, 0.9, 0.4, 1.0)
    assert kind == 0
    assert off == pytest.approx(np.linalg.norm(b - a - 0.05 * (v + w)), rel=1e-14)
    fastest = max(np.linalg.norm(v), np.linalg.norm(w))
    assert allowed == pytest.approx(step * (0.4 * (np.linalg.norm(w - v) + 0.07) + 0.1 * fastest), rel=1e-14)
    near = end._replace(position=tuple((a + 0.05 * (v + w)).tolist()))
    kind, off, allowed = jump_of(step, begin, near, 0.7, 0.9, 0.4, 1.0)
    assert kind == 1
    angle = np.array(difference(begin.attitude, end.attitude))
    first, last = np.array(begin.angular_velocity), np.array(rate_of(tuple(angle), end.angular_velocity))
    assert off == pytest.approx(np.linalg.norm(angle - 0.05 * (first + last)), rel=1e-14)
    fastest = max(np.linalg.norm(first), np.linalg.norm(last))
    known = step * (0.4 * (np.linalg.norm(last - first) + 0.09) + 0.1 * fastest)
    assert allowed == pytest.approx(known, rel=1e-14)


def two_rows(seed: int) -> Floats:
    random = np.random.default_rng(seed)
    return rows_of([some_state(random), some_state(random)])


def test_rows_of_states_go_on_at_the_mean_acceleration_since() -> None:
    now, before, told = two_rows(1), two_rows(2), np.empty((2, 13))
    for since in (0.2, 0.0):
        port_loops.go_on(now, before, since, 0.1, told)
        rates = (now - before) / since if since else np.zeros((2, 13))
        for p, frame in enumerate(frames_of("ab", now).values()):
            known = frame.after(0.1, tuple(rates[p, 3:6]), tuple(rates[p, 10:]))
            np.testing.assert_allclose(told[p], np.concatenate(known), rtol=0.0, atol=1e-15)


AXES = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.2, 0.4, 0.4]])


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> PortRoom:
    """Of three bodies, of which the last and the first are ports; what the loops borrow is what it is."""
    monkeypatch.setattr(port_loops, "borrowed", lambda value: value, raising=False)
    random = np.random.default_rng(3)
    rows = rows_of(some_state(random) for _ in range(3))
    parts = rows[:, :3], rows[:, 3:6], rows[:, 6:10], rows[:, 10:]
    ports = np.array([2, 0]), np.array([8, 0]), random.normal(size=(2, 3)), AXES
    return PortRoom(*parts, random.normal(size=15), *ports, *(np.zeros((2, n)) for n in (13, 7, 13, 13)))


def test_the_step_before_is_the_one_that_began_earlier() -> None:
    """A step that is taken again begins when the one that was kept did: none was before it."""
    predictor, now, before = Predictor(), two_rows(1), two_rows(2)
    predictor.keep(1.0, before)
    for begin, since, states in ((1.25, 0.25, before), (1.0, 0.0, now), (0.5, 0.0, now)):
        found, of = predictor.earlier(begin, now)
        assert of == since
        np.testing.assert_array_equal(found, states)


class Counted:
    """As much of a net as going back asks for; how many snapshots were taken."""

    def __init__(self) -> None:
        self.time, self.snapshots = 0.0, 0
        self.simulation: Any = self
        self.acting = None

    def finish(self) -> None:
        pass

    def snapshot(self) -> Any:
        self.snapshots += 1
        return SimpleNamespace(time=self.time)

    def follow(self, until: float, told: Any) -> None:
        self.time = until

    def restore(self, kept: Any) -> None:
        self.time = kept.time


def test_few_steps_have_a_snapshot_unless_one_was_taken_back() -> None:
    """One in 512; once a step was taken back, at the next, and then after 8, 16 and 32 more."""
    net = Counted()
    undo = Undo(net)  # type: ignore[arg-type]
    for k in range(100):
        undo.step(k + 1.0, np.zeros((1, 13)))
    assert net.snapshots == 1
    undo.back()
    assert net.time == undo.begin + 1.0 == 99.0
    taken = []
    for k in range(100):
        before = net.snapshots
        undo.step(100.0 + k, np.zeros((1, 13)))
        if net.snapshots > before:
            taken.append(k)
    assert taken == [0, 8, 24, 56]


def test_all_numbers_of_bodies_in_a_row(room: PortRoom) -> None:
    row = np.zeros(15 + 39)
    port_loops.stand(SimpleNamespace(value=room), row)
    moving = [(room.position[b], room.velocity[b], room.angular_velocity[b]) for b in range(3)]
    known = [room.first_order, *(part for body in moving for part in body), *room.attitude]
    np.testing.assert_array_equal(row, np.concatenate(known))


def test_ports_set_out_to_where_they_are_told(room: PortRoom) -> None:
    """Frames and centres of mass at both ends, and the piece between; the most that one turns."""
    told, step = two_rows(5), 0.3
    position, attitude, turning = np.zeros((2, 4, 3)), np.zeros((2, 4)), np.zeros((2, 4, 3))
    most = port_loops.set_out(step, told, position, attitude, turning, SimpleNamespace(value=room))
    spins = []
    for p, (number, end) in enumerate(zip((2, 0), frames_of("ab", told).values(), strict=True)):
        of = FrameOf(tuple(room.centre[p]), tuple(room.axes[p]))
        parts = room.position, room.velocity, room.attitude, room.angular_velocity
        begin = PrincipalState(*(tuple(part[number].tolist()) for part in parts))
        last = of.principal(end)
        np.testing.assert_array_equal(room.begin[p], np.concatenate(begin))
        np.testing.assert_allclose(room.end[p], np.concatenate(last), rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(room.frames[p], np.concatenate(of.frame(begin)), rtol=0.0, atol=1e-15)
        np.testing.assert_array_equal(room.given[p], room.first_order[(8, 0)[p] :][:7])
        piece = piece_between(0.0, step, begin, last)
        for found, known in zip((position, attitude, turning), piece[1:], strict=True):
            np.testing.assert_allclose(found[p], known, rtol=1e-13, atol=1e-13)
        spins.append(max(np.linalg.norm(item.angular_velocity) for item in (begin, last)))
    assert most == (int(np.argmax(spins)), pytest.approx(step * max(spins), rel=1e-14))


def test_what_ports_are_given_is_taken_from_the_net(room: PortRoom) -> None:
    """Mean force, and mean torque about where the frame's origin is in the mean."""
    told, step = two_rows(5), 0.3
    room.frames[:], room.given[:] = two_rows(4), np.random.default_rng(18).normal(size=(2, 7))
    taken, wrenches, row = np.empty((2, 7)), np.empty((2, 6)), np.zeros(15 + 39)
    port_loops.share(step, told, taken, wrenches, row, SimpleNamespace(value=room))
    for p, entry in enumerate((8, 0)):
        known = room.given[p] - room.first_order[entry : entry + 7]
        np.testing.assert_allclose(taken[p], known, rtol=1e-14)
        (begin,), (end,) = (frames_of("a", rows[p : p + 1]).values() for rows in (room.frames, told))
        about = np.array(mean_place(step, begin, end))
        np.testing.assert_allclose(wrenches[p, :3], known[:3] / step, rtol=1e-14)
        torque = (known[3:6] - np.cross(about, known[:3])) / step
        np.testing.assert_allclose(wrenches[p, 3:], torque, rtol=0.0, atol=1e-13)
    np.testing.assert_array_equal(row[:15], room.first_order)


def test_books_of_ports() -> None:
    """Sums of what was taken, of errors and of absolute work; least, largest; a throw's error by itself."""
    random, steps, recoils = np.random.default_rng(19), np.array([0.1, 0.2]), np.array([False, True])
    applied, taken = random.normal(size=(2, 1, 6)), random.normal(size=(2, 1, 7))
    begin, end = np.stack([two_rows(6)[:1], two_rows(7)[:1]]), np.stack([two_rows(8)[:1], two_rows(9)[:1]])
    books = random.normal(size=(1, 13))
    known = books[0].copy()
    for k in range(2):
        (one,), (other,) = (frames_of("a", rows[k]).values() for rows in (begin, end))
        work = applied[k, 0, :3] @ (np.array(other.position) - one.position)
        error = work + applied[k, 0, 3:] @ turning_between(steps[k], one, other) - taken[k, 0, 6]
        known[:7] += taken[k, 0]
        known[9] += abs(taken[k, 0, 6])
        known[11], known[12] = min(known[11], known[6]), max(known[12], known[6])
        if recoils[k]:
            known[10] += error
        else:
            known[7], known[8] = known[7] + error, max(known[8], abs(error))
    port_loops.enter(steps, recoils, applied, taken, begin, end, books)
    np.testing.assert_allclose(books[0], known, rtol=0.0, atol=1e-13)


def test_the_row_that_turns_most_and_the_first_that_jumps() -> None:
    begin = rows_of([FrameState((0.0,) * 3, angular_velocity=(0.0, 0.3, 0.4)) for _ in range(3)])
    end = begin.copy()
    end[1, 10:] = 0.0, 1.2, 0.5
    assert port_loops.most_turned(0.1, begin, end) == (1, pytest.approx(0.13))
    end = rows_of(frame.after(0.1) for frame in frames_of("abc", begin).values())
    assert port_loops.find_jump(0.1, begin, end, begin, 0.0, 0.5, 1.0)[:2] == (-1, -1)
    end[1, 1] += 0.02
    assert port_loops.find_jump(0.1, begin, end, begin, 0.0, 0.5, 1.0)[:3] == (1, 0, pytest.approx(0.02))
    before = begin.copy()
    before[1, 3:6] = 1.0, -2.0, 2.0  # slowed down at 3 m/s in 0.2 s: half of that in 0.1 s is explained
    found = port_loops.find_jump(0.1, begin, end + 0.2 * (end != begin), before, 0.2, 0.5, 1.0)
    assert found[0] >= 0
    number, *_ = port_loops.find_jump(0.1, begin, end, before, 0.2, 0.5, 1.0)
    assert number == -1


def test_what_a_case_with_a_port_says(tmp_path: Path) -> None:
    """`check` describes it; a run, an ensemble and the study of cost refuse it, each with the line."""
    scene = Scene(tmp_path)
    rows = dict(describe(exunet.load(scene.net)))
    assert rows["body second"].startswith("3.1")  # kg, with its node
    assert "port" in rows["body second"]
    words = r"net\.toml:\d+: bodies\.second\.motion: motion = \"port\" requires a host"
    with pytest.raises(exunet.CaseError, match=words):
        exunet.run(exunet.load(scene.net))
    with pytest.raises(exunet.CaseError, match=words):
        exunet.ensemble(exunet.load(scene.net), runs=2)
    with pytest.raises(InputError, match=r"b: a frame has position \(3\)"):
        FrameState.of(((0.0, 0.0), 1.0), "b")  # type: ignore[arg-type]


def random_rows(random: np.random.Generator) -> Floats:
    """Of two frames; the second hardly turns, as series hold near no turn."""
    states = [some_state(random), some_state(random)]
    states[1] = states[1]._replace(angular_velocity=(1e-6, -2e-6, 3e-6))
    return rows_of(states)


@pytest.mark.slow  # it compiles them
def test_compiled_loops_are_those_of_python_to_the_last_bit() -> None:
    random = np.random.default_rng(11)
    before, now = random_rows(random), random_rows(random)
    after = rows_of(state.after(0.01) for state in frames_of(("a", "b"), now).values())
    bodies = tuple(
        np.ascontiguousarray(now[:, part]) for part in (slice(3), slice(3, 6), slice(6, 10), slice(10, 13))
    )
    axes = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.0, 0.6, 0.0]])
    of = np.arange(2), np.array([0, 7]), np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.3]]), axes
    first_order, seen = random.normal(size=14), random.normal(size=(2, 18))
    found = []
    for module in (compiled_module(SOURCE), interpreted_module(SOURCE)):
        way = [np.zeros(shape) for shape in ((2, 4, 3), (2, 4), (2, 4, 3))]
        numbers = first_order.copy()
        space = [np.zeros(shape) for shape in ((2, 13), (2, 7), (2, 13), (2, 13))]
        held = module.hold(PortRoom(*bodies, numbers, *of, *space))
        told, gone, frames, taken, wrenches = (np.zeros((2, n)) for n in (13, 13, 13, 7, 6))
        rows, books = np.zeros((2, 14 + 26)), np.ones((2, 13))
        wrong, jump = module.see_ended(seen, frames, 0.01, now, before, 0.02, 0.5, 1.0)
        assert wrong == module.see(seen, frames)
        assert jump == module.find_jump(0.01, now, frames, before, 0.02, 0.5, 1.0)
        results = [wrong, *jump, *module.find_jump(0.01, now, after, before, 0.02, 0.5, 1.0)]
        results += module.most_turned(0.01, now, after)
        module.go_on(now, before, 0.02, 0.01, told)
        module.stand(held, rows[0])
        results += module.set_out(0.01, told, *way, held)
        ways = [item.copy() for item in way]
        assert tuple(results[-2:]) == module.go_out(now, before, 0.02, 0.01, gone, *way, held)
        numbers += 0.1
        module.share(0.01, told, taken, wrenches, rows[1], held)
        steps, recoils = np.array([0.01, 0.01]), np.array([False, True])
        twice = (np.stack([entry, entry]) for entry in (wrenches, taken, now, after))
        module.enter(steps, recoils, *twice, books)
        found.append([np.array(results), told, frames, rows, *way, *space, taken, wrenches, books])
        for one, other in zip([told, *ways], [gone, *way], strict=True):
            np.testing.assert_array_equal(one, other)
    for compiled, interpreted in zip(*found, strict=True):
        np.testing.assert_array_equal(compiled, interpreted)

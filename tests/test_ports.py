"""Ports without a net: the way between two states of a frame, states that are none, momentum in transit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coupled import Scene

import exunet
from exunet import InputError
from exunet.bodies.body import RigidBody
from exunet.bodies.guide import Guide
from exunet.bodies.port import FrameOf, FrameState, Piece, frames_of, rows_of
from exunet.bodies.port_motion import INSIDE, difference, mean_place, turning_between, way_between
from exunet.bodies.rigid import rotation_matrix
from exunet.codegen.compile import compiled_module, interpreted_module
from exunet.codegen.drivers import hold
from exunet.codegen.generate import loops_source
from exunet.coupling.handover import Handover, Weights
from exunet.coupling.port_loops import CALLED, PortRoom
from exunet.interfaces.commands.check import describe

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


def test_what_a_case_with_a_port_says(tmp_path: Path) -> None:
    """`check` describes it; a run, an ensemble and the study of cost refuse it, each with the line."""
    scene = Scene(tmp_path)
    rows = dict(describe(exunet.load(scene.net)))
    assert rows["body second"].startswith("3.1")  # kg, with its node
    assert "port" in rows["body second"]
    words = r"net\.toml:\d+: bodies\.second\.motion: a host moves a body of motion = \"port\""
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
        ways = [one.copy() for one in way]
        assert tuple(results[-2:]) == module.go_out(now, before, 0.02, 0.01, gone, *way, held)
        numbers += 0.1
        module.share(0.01, told, taken, wrenches, rows[1], held)
        steps, recoils = np.array([0.01, 0.01]), np.array([False, True])
        twice = (np.stack([one, one]) for one in (wrenches, taken, now, after))
        module.enter(steps, recoils, *twice, books)
        found.append([np.array(results), told, frames, rows, *way, *space, taken, wrenches, books])
        for one, other in zip([told, *ways], [gone, *way], strict=True):
            np.testing.assert_array_equal(one, other)
    for compiled, interpreted in zip(*found, strict=True):
        np.testing.assert_array_equal(compiled, interpreted)

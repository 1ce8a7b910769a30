"""Ports without a net: the way between two states of a frame, states that are none, momentum in transit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coupled import Scene

import exunet
from exunet import FrameState, InputError
from exunet.bodies.body import RigidBody
from exunet.bodies.guide import Guide
from exunet.bodies.port import (
    FrameOf,
    Piece,
    PrincipalState,
    difference,
    mean_place,
    piece_between,
    turning_between,
)
from exunet.bodies.rigid import rotation_matrix
from exunet.coupling.handover import Handover, Weights
from exunet.interfaces.commands.check import describe

Floats = np.ndarray


def some_state(random: np.random.Generator) -> FrameState:
    attitude = random.normal(size=4)
    parts = random.normal(size=3), random.normal(size=3), attitude / np.linalg.norm(attitude)
    return FrameState.of((*parts, random.normal(size=3)), "a test")


@pytest.mark.parametrize("seed", range(5))
def test_a_piece_has_the_states_of_both_ends(seed: int) -> None:
    """By the guide that states the same motion on whole arrays; attitudes up to their sign."""
    random = np.random.default_rng(seed)
    begin, end = (PrincipalState(*some_state(random)) for _ in range(2))
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
    piece = piece_between(0.0, 0.4, PrincipalState(*begin), PrincipalState(*end))
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
        piece = piece_between(0.0, duration, PrincipalState(*begin), PrincipalState(*end))
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

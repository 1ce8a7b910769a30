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
from exunet.bodies.port import FrameOf, Piece, PrincipalState, mean_place, piece_between
from exunet.bodies.rigid import rotation_matrix
from exunet.coupling.in_transit import of_method
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
    """With spectral radius 1 the method is the trapezoidal rule but for its algorithmic acceleration.

    By hand, m = f = g = 1/2, forces 1, 0: a = 1, 0; shown 1/2, 1/2: in transit 1/2, then nothing.
    """
    alpha = of_method("GeneralizedAlpha", 1, spectral_radius=1.0, newmark=False)
    for force, known in ((1.0, 0.5), (0.0, 0.0)):
        alpha.take(np.array([force]), 1.0)
        assert alpha.impulse[0] == pytest.approx(known, abs=1e-15)
    rule = of_method("TrapezoidalIndex2", 1, spectral_radius=0.9, newmark=True)
    for force in (3.0, 1.0):
        rule.take(np.array([force]), 0.1)
        assert rule.impulse[0] == pytest.approx(0.05 * force)  # half of the last impulse
    whole = of_method("RK44", 2, spectral_radius=0.9, newmark=False)
    whole.take(np.array([1.0, 2.0]), 0.1)
    assert not whole.impulse.any()


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

"""Rung 8, bodies: that it holds, that it can fail, and its closed forms against other ways to the same."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from exunet.studies.both_codes import read_both
from exunet.verification.answers import BODY_ANSWERS
from exunet.verification.answers.turning import FreeRotation
from exunet.verification.balances import changes, converged, energies, momenta
from exunet.verification.bodies import BODY_CASES, body_scenes, motions, one_step, placed
from exunet.verification.check import Check, shipped
from exunet.verification.horizon import MOVE, ROUND_OFF, growth
from exunet.verification.ladder import Ladder
from exunet.verification.states import measures, random_instants
from exunet.verification.tolerances import ANGULAR, ENERGY, MOMENTUM
from reference_impl import body_forces, state
from reference_impl.attachments import Levers

SCENES = {scene.name: scene for scene in body_scenes([])}
CASES = shipped("bodies")


def failing(checks):
    return [f"{check.name}: {check.measured} ({check.worst})" for check in checks if not check.holds]


@pytest.mark.slow  # the whole ladder, which .ci/run climbs, has more states
@pytest.mark.parametrize("name", SCENES)
def test_states_of_a_scene_agree(name):
    checks = list(SCENES[name].at_states(5))
    assert failing(checks) == []
    assert len(checks) > 12


@pytest.mark.ci
@pytest.mark.slow
def test_powers_that_cancel_are_none():
    """What the guide and the drum put in, taken off the power of all forces, leaves no round-off."""
    case, left = SCENES["led_winch"].case, []
    for kind in ("packed", "coincident", "crumpled"):
        for instant in random_instants(case.start, kind, 100, np.random.default_rng(1)):
            response = case.reference_response(instant)[1]
            left.append(response.power + response.given[:, 6].sum() + response.reeling[1].sum())
            assert case.reference_motion(instant)[1] == 0.0
    assert any(left)


@pytest.mark.slow  # as above
@pytest.mark.parametrize(("name", "answer"), BODY_ANSWERS)
def test_all_codes_give_the_known_answer(name, answer):
    checks = [
        finding for finding in answer(read_both(shipped(BODY_CASES)[name])) if isinstance(finding, Check)
    ]
    assert failing(checks) == []
    for code in ("Exudyn", "reference"):
        assert any(code in check.name for check in checks)


def test_every_case_is_known_and_every_answer_has_its_case():
    assert {name for name, _ in BODY_ANSWERS} == set(shipped(BODY_CASES))
    assert {f"bodies_{name}" for name in CASES} | set(shipped(BODY_CASES)) == set(SCENES)


@pytest.mark.parametrize("name", ["snap", "launch"])
def test_a_case_whose_bodies_are_pulled_goes_to_rung_8(name):
    """Once, under its own name, and into none of the rungs that look at points alone."""
    ladder = Ladder([read_both(CASES[name])], quick=True, paper=False)
    steps = [*ladder.nets(), *ladder.later()]
    of_bodies = [step.subject for step in steps if step.rung == 8]
    assert of_bodies.count(name) == 1
    assert f"bodies_{name}" not in of_bodies
    assert {step.rung for step in steps if step.subject.startswith(f"{name},")} == {8}  # forms of a case
    assert {step.rung for step in steps if step.subject == name} - {6} == {1, 8}


def test_a_case_with_a_free_body_climbs_all_rungs():
    case = read_both(CASES["tumbling"])
    assert not case.moves_bodies
    ladder = Ladder([case], quick=True, paper=False)
    assert {step.rung for step in ladder.nets()} == {1}
    assert {step.rung for step in ladder._states()} == {2, 3, 4}


def test_random_states_of_a_net_without_elements():
    """As of a scene of bodies alone."""
    case = read_both(shipped(BODY_CASES)["free_bodies"])
    assert case.start.net.n_elements == 0
    assert failing(measures(case, 2)) == []


def test_a_wrong_torque_is_named(monkeypatch):
    right = Levers.wrench
    monkeypatch.setattr(Levers, "wrench", lambda *given: (right(*given)[0], 1.001 * right(*given)[1]))
    found = failing(motions(read_both(CASES["snap"]), 3))
    assert found
    assert all(words.startswith("angular acceleration, ") for words in found)
    assert all(re.search(r"state \d, body \d, [xyz]: .* rad/s2", words) for words in found)


@pytest.mark.slow
def test_a_weak_torque_shows_beside_strong_ones(monkeypatch):
    """Of the gravity gradient, 1e-6 rad/s2: in the states where tethers are slack."""
    right = body_forces.torques
    monkeypatch.setattr(body_forces, "torques", lambda *given: 0.999 * right(*given))
    assert failing(motions(read_both(shipped(BODY_CASES)["librations"]), 3))


def test_points_that_are_put_elsewhere_are_seen(monkeypatch):
    monkeypatch.setattr(
        Levers, "places", lambda self, centre, lever: centre[..., self.body, :] + 1.001 * lever
    )
    found = failing(placed(read_both(CASES["snap"]), 2))
    assert found
    assert all(words.startswith("place of attached nodes") for words in found)


def test_a_step_of_bodies_that_turn_too_fast_is_seen(monkeypatch):
    right = state.attitude_rate
    monkeypatch.setattr(state, "attitude_rate", lambda *given: (1.0 + 1e-8) * right(*given))
    assert len(failing(one_step(read_both(shipped(BODY_CASES)["free_bodies"])))) == 4


@pytest.mark.slow
def test_the_balances_of_a_run_hold_and_can_fail(monkeypatch):
    """With torques that are no longer those of the forces, momentum is kept, and nothing else."""
    case = read_both(CASES["snap"], ["time.end=1.3"])
    grown = growth(case, None, (ROUND_OFF, MOVE))
    checks = [finding for finding in converged(case, grown) if isinstance(finding, Check)]
    assert failing(checks) == []
    of_balances = {check.name for check in checks if check.name.endswith("relative change")}
    assert len(of_balances) == 6
    right = Levers.wrench
    monkeypatch.setattr(Levers, "wrench", lambda *given: (right(*given)[0], 1.001 * right(*given)[1]))
    wrong = case.run_reference(grown.time, rtol=1e-9, atol=1e-11)
    kept = [*momenta(case, wrong, MOMENTUM, ANGULAR), energies(case, wrong, ENERGY)]
    found = failing(changes(kept, wrong.time, "reference"))
    assert {words.partition(",")[0] for words in found} == {"angular momentum", "energy"}


INERTIA = np.array([[2.1, 0.3, -0.1], [0.3, 3.0, 0.2], [-0.1, 0.2, 4.2]])


@pytest.mark.parametrize("spin", [[0.1, 1.0, 1.5], [-0.2, -1.0, -1.4], [0.4, -0.1, 2.0]])
def test_the_closed_form_is_the_solution_of_eulers_equations(spin):
    """DOP853 on the rotation matrix and the angular momentum in the scene's axes."""
    angle = 0.4
    turn = np.array(
        [[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]]
    )
    known = FreeRotation(INERTIA, np.array(spin), turn)
    momentum = turn @ INERTIA @ spin

    def rate(_t, y):
        now = y.reshape(3, 3)
        omega = now @ np.linalg.solve(INERTIA, now.T @ momentum)
        return np.cross(omega, now.T).T.ravel()

    times = np.linspace(0.0, 12.0, 13)
    found = solve_ivp(rate, (0.0, 12.0), turn.ravel(), "DOP853", times, rtol=1e-12, atol=1e-13)
    turned = found.y.T.reshape(-1, 3, 3)
    np.testing.assert_allclose(known.attitudes(times), turned, atol=1e-9)
    omega = np.linalg.solve(INERTIA, (np.swapaxes(turned, 1, 2) @ momentum).T).T
    np.testing.assert_allclose(known.rates(times), omega @ known.axes, atol=1e-9)


def test_flips_are_zeros_of_the_middle_rate():
    known = FreeRotation(np.diag([2.0, 3.0, 4.0]), np.array([0.01, 2.0, 0.02]), np.eye(3))
    flips = known.flips(100.0)
    assert np.abs(known.rates(flips)[:, 1]).max() < 1e-12
    np.testing.assert_allclose(np.diff(flips), known.flip_period, rtol=1e-12)


def test_a_rotation_about_the_axis_of_the_least_moment_is_refused():
    with pytest.raises(ValueError, match="largest moment"):
        FreeRotation(np.diag([2.0, 3.0, 4.0]), np.array([2.0, 0.1, 0.1]), np.eye(3))


def test_points_of_bodies_go_with_them_to_another_start():
    case = read_both(CASES["snap"])
    bodies, at = case.start.state.bodies, case.start.system.kinematics.point
    shifted = replace(bodies, position=bodies.position + 1.0, velocity=bodies.velocity + 2.0)
    there = case.from_state(case.start.position, case.start.velocity, shifted).start
    np.testing.assert_allclose(there.position[at], case.start.position[at] + 1.0, atol=1e-13)
    np.testing.assert_allclose(there.velocity[at], case.start.velocity[at] + 2.0, atol=1e-13)

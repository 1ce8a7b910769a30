"""What separates the bullets of the paper's net: round-off, told by mirrored arithmetic."""

import math
from dataclasses import replace

import numpy as np
import pytest

from exunet.studies.both_codes import BothCodes, Trajectory, read_both
from exunet.verification import matrices
from exunet.verification.check import shipped
from exunet.verification.horizon import ROUND_OFF, nearby
from exunet.verification.matrices import bullet_spread, separation

CASES = shipped()
TIMES = np.linspace(0.0, 2.0, 401)


def flying(case: BothCodes, last: float) -> Trajectory:
    """Bullets that fly along x at 2 m/s; the speed of the last one is another [m/s] from 1 s on."""
    velocity = np.zeros((len(TIMES), case.start.net.n_nodes, 3))
    velocity[:, case.start.net.bullet_nodes, 0] = 2.0
    velocity[TIMES >= 1.0, case.start.net.bullet_nodes[-1], 0] = last
    return Trajectory(TIMES, np.zeros_like(velocity), velocity, seen=None, steps=1, reels=None, drawn=None)


def test_separation_is_the_first_time_of_a_visible_spread():
    """1 % of the launch speed of 2.5 m/s is 0.025 m/s."""
    case = read_both(CASES["planar_deployment"])
    assert separation(case, flying(case, 2.03)) == pytest.approx(1.0)
    assert separation(case, flying(case, 2.02)) == math.inf
    assert bullet_spread(case, flying(case, 2.02))[-1] == pytest.approx(0.02)


@pytest.mark.parametrize("wrong", [np.nextafter(2.0, 3.0), float("nan")])
def test_any_spread_in_mirrored_arithmetic_fails(wrong, monkeypatch):
    """The last bit counts, and a run that holds NaN is not a symmetric one."""
    case = read_both(CASES["planar_deployment"])
    runs = iter([flying(case, 2.0), flying(case, wrong), flying(case, 3.0)])
    monkeypatch.setattr(matrices, "_run", lambda *of_which: next(runs))
    equal, separated = matrices.symmetry(case)
    assert not equal.holds
    assert equal.worst.startswith("tolerance 1e-11: t = 1 s")
    assert separated.measured == pytest.approx(1.0)


@pytest.mark.slow
def test_mirrored_arithmetic_keeps_the_bullets_together_and_ordinary_does_not():
    equal, separated = matrices.symmetry(read_both(CASES["planar_deployment"]))
    assert equal.measured == 0.0
    assert separated.measured < 2.0


def in_the_papers_setting(case: BothCodes, states: int = 400) -> Trajectory:
    """ode45's pair at its default tolerances, with assembled matrices."""
    theirs = replace(case.theirs, system=replace(case.theirs.system, assembled=True))
    times = np.linspace(0.0, 2.0, states + 1)
    return replace(case, theirs=theirs).run_reference(times, method="RK45", rtol=1e-3, atol=1e-6)


@pytest.mark.slow
def test_the_papers_own_setting_separates_at_the_papers_instant():
    """reference_impl/README.md: 1.75 s (0.05 m/s apart), with the last bits moved 1.56 s and more."""
    case = read_both(CASES["planar_deployment"])
    assert separation(case, in_the_papers_setting(case), 0.02) == pytest.approx(1.75, abs=0.006)
    near = nearby(case, ROUND_OFF, 1)
    assert 1.3 < separation(near, in_the_papers_setting(near)) < 1.9


@pytest.mark.slow
def test_the_other_packing_separates_in_the_papers_setting_too():
    """reference_impl/README.md: 1.705 s, stored every 0.005 s or 0.001 s."""
    case = read_both(CASES["planar_deployment_006"])
    for states in (400, 2000):
        assert separation(case, in_the_papers_setting(case, states), 0.02) == pytest.approx(1.705, abs=0.006)

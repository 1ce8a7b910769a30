"""Rungs 4, 5 and 7 on whole runs: growth of differences, converged trajectories, the symmetric solution."""

import math
from dataclasses import replace

import numpy as np
import pytest

from exunet.base.errors import InputError
from exunet.studies.both_codes import Motion, Pair, pair_of_text, read_pair
from exunet.verification.answers import orders
from exunet.verification.check import Check
from exunet.verification.converged import converged
from exunet.verification.ensemble import COMPILED, EXUDYN, RUNS, ensemble, in_parallel, our_code
from exunet.verification.growth import LONE, ROUND_OFF, boosted, distance, grid, growth, perturbed
from exunet.verification.growth import VISIBLE as VISIBLE_DIFFERENCE
from exunet.verification.horizon import after_it, sensitivity
from exunet.verification.ladder import PAPER as PAPERS
from exunet.verification.ladder import Ladder, answers, read_cases, shipped
from exunet.verification.report import verdict
from exunet.verification.separation_runs import run_one
from exunet.verification.separation_text import PAPER, VISIBLE
from exunet.verification.stepping import same_scheme

CASES = {path.stem: path for path in shipped() + shipped("verification/trajectories")}


CASE_FILES = CASES["planar_deployment"].parent


def holds(findings):
    checks = [finding for finding in findings if isinstance(finding, Check)]
    assert checks
    for check in checks:
        assert check.holds, f"{check.name}: {check.measured} ({check.worst})"
    return checks


JUMPS = {0.3: 1e3, 0.5: 1e5, 0.7: 1e2, 0.9: 1e4}  # growth at snaps; nothing grows between them


def test_horizon_of_a_growth_by_jumps_is_the_jump_that_reaches_it(monkeypatch):
    """1e-16 m times 1e3 1e5 1e2 1e4 passes 1e-3 m at the last jump, 0.9 s.

    A mean rate of what 1e-12 m shows up to 1e-3 m (a factor 1e9, reached at 0.7 s) would say 0.99 s.
    """
    pair = read_pair(CASES["planar_undamped"])
    pair = replace(pair, start=replace(pair.start, position=np.zeros_like(pair.start.position)))

    def flight(self, times, plan=None):
        factor = np.prod([np.where(times >= t, by, 1.0) for t, by in JUMPS.items()], axis=0)
        place = factor[:, None, None] * self.start.position
        return Motion(times, place, np.zeros_like(place), 1)

    monkeypatch.setattr(Pair, "engine", flight)
    grown = growth(pair, 1.0, (1e-16, 1e-12))
    assert grown.reaches(1e-12) == pytest.approx(0.7, abs=0.003)
    assert grown.horizon == pytest.approx(0.9, abs=0.003)
    assert grown.reaches(1e-16, 1e3) == math.inf


def test_horizon_is_where_starts_of_other_seeds_part_too():
    """1e-16 m has become 1e-3 m at 1.29 s with all seeds tried (jumps at 1.18 and 1.26 s lie before it)."""
    pair = read_pair(CASES["planar_undamped"])
    grown = growth(pair, amplitudes=(ROUND_OFF,))
    times, plan = grid(pair)
    fast = pair.fastest()
    base = fast.engine(times, plan)
    for seed in (1, 2):
        apart = distance(base, perturbed(fast, ROUND_OFF, seed).engine(times, plan))
        assert times[np.argmax(apart > VISIBLE_DIFFERENCE)] == pytest.approx(grown.horizon, abs=0.03)


def test_the_last_bit_of_a_large_coordinate_moves_too():
    """Near 1e3 m neighbouring numbers are 1.1e-13 m apart, so 1e-16 m would vanish."""
    pair = read_pair(CASES["planar_undamped"])
    far = replace(pair, start=replace(pair.start, position=pair.start.position + 1e3))
    assert (perturbed(far, ROUND_OFF).start.position != far.start.position).all()


def test_perturbed_start_keeps_velocities_and_is_repeatable():
    pair = read_pair(CASES["planar_undamped"])
    moved = perturbed(pair, 1e-8, seed=3)
    shift = moved.start.position - pair.start.position
    assert 0 < np.abs(shift).max() <= 1e-8
    assert np.array_equal(moved.start.velocity, pair.start.velocity)
    assert np.array_equal(moved.start.position, perturbed(pair, 1e-8, seed=3).start.position)


def test_short_runs_agree():
    """Up to 0.8 s, past the first snaps at about 0.57 s."""
    pair = read_pair(CASES["planar_deployment"])
    grown = growth(pair, 0.8, (ROUND_OFF, LONE))
    holds(same_scheme(pair, grown))
    rows = holds(converged(pair, grown))
    assert any("boosted" in row.subject for row in rows)


@pytest.mark.slow
def test_a_moving_frame_changes_no_verdict():
    """1.29 s is the horizon of the undamped net, whoever looks at it; the codes part there and not before."""
    pair = read_pair(CASES["planar_undamped"])
    moving = boosted(pair)
    grown, seen = growth(pair), growth(moving)
    assert seen.horizon == pytest.approx(grown.horizon, abs=0.1)
    holds(same_scheme(moving, seen))
    rows = holds(converged(moving, seen))
    assert not any("left out" in row.name for row in rows)  # more than half of the time


def test_a_net_with_supports_cannot_move_along():
    assert boosted(read_pair(answers()["hanging"])) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["thrown", "planar_fine_undamped"])
def test_trajectories_agree_up_to_the_horizon(name):
    pair = read_pair(CASES[name])
    grown = growth(pair)
    holds(converged(pair, grown))
    holds(sensitivity(pair, grown))


@pytest.mark.slow
def test_the_paper_s_net_loses_its_prediction_at_about_its_separation():
    """Starts 1e-16 m apart are 1e-3 m apart at 1.36 to 1.38 s (three other seeds); statistics still agree."""
    pair = read_pair(CASES["planar_deployment"])
    grown = growth(pair)
    assert grown.horizon == pytest.approx(1.37, abs=0.03)
    assert grown.horizon < PAPER
    holds(after_it(pair, grown, True))


IN_REACH = ("mass_damping", "orbit", "orbit_two_body", "parabolic_flight")  # and material_damping, below


def climbed(pair):
    """Rungs 1 to 5 and 7 over one case, all forms; checks only."""
    ladder = Ladder([pair], quick=False, study=False)
    steps = [step for step in ladder._states() if step.title != "random nets"]
    found = [finding for step in steps for finding in step.run()]
    found += [finding for step in ladder._runs() for finding in step.run()]
    for grown in ladder._grown.values():
        found += sensitivity(pair, grown)
    return holds(found)


def test_material_damping_has_no_proportional_growth_and_says_so():
    """Its stress jumps where the thread becomes taut: two starts part by step x jump, near or far alike."""
    pair = read_pair(CASE_FILES / "effects" / "material_damping.toml")
    rows = climbed(pair)
    assert [row.rung for row in rows if row.left_out and row.name == "growth in proportion"] == [7]
    assert {row.rung for row in rows if row.left_out and "half slack" in row.name} == {3, 4}


def test_a_net_that_cannot_move_is_no_defect():
    text = (CASE_FILES / "verification" / "hanging.toml").read_text()
    pair = pair_of_text("held", text.replace("fixed = [0, 10]", f"fixed = {list(range(11))}"))
    assert len(pair.start.net.fixed_nodes) == pair.start.net.n_nodes
    found = holds(list(sensitivity(pair, growth(pair, 0.05))))
    assert any(row.left_out for row in found)


@pytest.mark.slow
def test_a_string_that_no_code_resolves_better_than_the_codes_agree_is_left_out():
    """A plucked string of taut threads: each code changes by 5e-5 sizes with its tolerance; no horizon."""
    pair = read_pair(CASE_FILES / "hard" / "taut_string.toml")
    rows = holds(converged(pair, growth(pair, amplitudes=(ROUND_OFF,))))
    assert any(row.left_out and "own errors together" in row.worst for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_REACH)
def test_effects_in_reach_hold(name):
    climbed(read_pair(CASE_FILES / "effects" / f"{name}.toml"))


@pytest.mark.slow
@pytest.mark.ci
def test_mirrored_arithmetic_keeps_the_bullets_together_and_ordinary_does_not():
    pair = read_pair(CASES["planar_deployment"])
    mirrored = run_one(pair, "reference", 1e-10, 2.5, True)
    assert not mirrored.spread.any()
    nudged = run_one(perturbed(pair, 1e-15), "reference", 1e-10, 2.0, False)
    assert math.isfinite(nudged.separates(np.linspace(0, 2, 401), VISIBLE * pair.speed))


def test_work_in_parallel_keeps_its_order():
    assert in_parallel(pow, [(2, k) for k in range(5)]) == [1, 2, 4, 8, 16]


@pytest.mark.slow
def test_an_ensemble_before_the_first_snap_has_no_spread():
    pair = read_pair(CASES["planar_undamped"], {"time.end": "0.4"})
    found = ensemble(pair, EXUDYN, runs=4)
    assert found.speed.std(axis=0).max() < 1e-9
    assert 0 < found.area.std(axis=0).max() < 1e-6  # the starts differ by 1e-6 m in 5 m


@pytest.mark.slow
def test_the_engine_and_the_compiled_loop_give_the_same_ensemble():
    """From the same starts, up to 1 s: until then a difference of tolerances has not grown to be seen."""
    pytest.importorskip("numba")
    assert our_code() == COMPILED
    assert RUNS[COMPILED] >= 64
    pair = read_pair(CASES["planar_deployment"], {"time.end": "1.0"})
    loop, engine = (ensemble(pair, code, runs=3) for code in (COMPILED, EXUDYN))
    for name in ("area", "energy", "speed"):
        assert getattr(loop, name) == pytest.approx(getattr(engine, name), abs=1e-5)


def test_two_cases_of_one_name_are_refused(tmp_path):
    other = tmp_path / "planar_deployment.toml"
    other.write_text(CASES["planar_deployment"].read_text())
    with pytest.raises(InputError, match=r"two cases are called planar_deployment, .*rename one"):
        read_cases([CASES["planar_deployment"], other])


def test_quick_says_what_it_leaves_out(monkeypatch):
    """One case is followed, not to its end; the verdict tells the rest together."""
    monkeypatch.setattr("exunet.verification.ladder.QUICK_END", 0.1)
    ladder = Ladder(read_cases([CASES[name] for name in PAPERS]), quick=True, study=True)
    first, *others = (list(step.run()) for step in ladder._runs())
    rows = [row for row in first if isinstance(row, Check) and row.left_out]
    assert "whole runs from t = 0.1 s on, of 2 s" in rows[0].name
    assert all(row.left_out for found in others for row in found)
    told = verdict([*rows, *(row for found in others for row in found)], interrupted=False)
    assert "planar_undamped, planar_deployment_006: whole runs and horizon" in told
    assert any(row.left_out for step in ladder._horizons() for row in step.run() if isinstance(row, Check))


def test_a_run_that_costs_too_much_says_from_when_on_it_is_left_out(monkeypatch):
    monkeypatch.setattr("exunet.verification.growth.MOST_WORK", 100_000)
    ladder = Ladder(read_cases([CASES["planar_undamped"]]), quick=False, study=False)
    (step,) = ladder._runs()
    row = next(finding for finding in step.run() if isinstance(finding, Check))
    assert row.left_out
    assert "of 2 s: rungs 4, 5 and 7" in row.name
    (grown,) = ladder._grown.values()
    noted = [row for row in sensitivity(read_pair(CASES["planar_undamped"]), grown) if isinstance(row, Check)]
    assert noted[-1].worst == "followed no further"


@pytest.mark.slow
def test_rows_name_what_was_measured_and_the_node():
    (order, *_) = orders.smooth(read_pair(answers()["smooth"]))
    assert order.name.endswith(": off by")
    assert "at node" in order.worst

"""What a run is said to take: number of right-hand sides, memory, disk, what is left; refusals beforehand."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import command

import reference_impl as reference
from exunet.base.errors import InputError
from exunet.case.casefile import load
from exunet.interfaces.commands import ensemble as ensembles
from exunet.interfaces.commands import estimates
from exunet.interfaces.commands.check import describe
from exunet.interfaces.commands.estimates import (
    Expected,
    duration,
    estimated,
    expected_spread,
    not_counted,
    refuse_beyond,
    size,
)
from exunet.interfaces.commands.progress import Lines, remaining, told_runs
from exunet.simulation import trial as trials
from exunet.simulation.expected_cost import (
    COMPILING,
    COUNTED,
    EXACT,
    EXTRAPOLATED,
    GUESSED,
    cost_of_a_course,
    expected_check,
    expected_cost,
    in_the_compiled_loop,
)
from exunet.simulation.pace import Pace
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import run_into, simulate
from exunet.simulation.trial import Trial, try_out
from exunet.studies.spread import start_of_runs

CASES = Path(__file__).parent.parent / "cases"
PLANAR = CASES / "planar_deployment.toml"
RATES = json.loads((Path(__file__).parent / "data" / "step_rates.json").read_text())
FOLDED = ("nets/accordion", "nets/star", "hard/folded")  # in bursts, or slackening from the start on
EARLY = ("time.end=0.7", "time.output_step=0.01")  # beyond the first snaps at 0.57 s


def started(*overrides: str, case: Path = PLANAR) -> Start:
    return prepare_case(load(case, overrides))


@pytest.mark.parametrize("loop", ["exudyn", "compiled"])
@pytest.mark.parametrize(("method", "step"), [("RK44", 1e-4), ("VelocityVerlet", 3e-5)])
def test_the_right_hand_sides_of_equal_steps_are_exact(loop, method, step):
    """But for one at the start. 3e-5 s does not divide the 0.01 s between stored times."""
    start = started(*EARLY[1:], "time.end=0.02", f"solver.method={method}", f"solver.step={step}",
                    f"engine.loop={loop}")  # fmt: skip
    told = expected_cost(start).right_hand_sides
    assert simulate(start).provenance["right_hand_sides"] == pytest.approx(told, abs=1)


def test_a_trial_counts_the_right_hand_sides_of_a_run():
    """Before the net is chaotic they are the same steps in both loops."""
    start = started(*EARLY)
    trial = try_out(start, budget=60.0)
    assert trial is not None
    assert trial.complete
    cost = expected_cost(start, trial)
    assert cost.factor == COUNTED
    assert simulate(start).provenance["right_hand_sides"] == pytest.approx(cost.right_hand_sides, rel=0.05)


def test_a_trial_of_another_method_counts_as_many():
    """ODE23, which the compiled loop has not: at the same accuracy DOPRI5 takes about as many."""
    start = started(*EARLY, "solver.method=auto")
    assert start.plan.method == "ODE23"
    trial = try_out(start, budget=60.0)
    assert trial is not None
    assert trial.start.plan.method == "DOPRI5"
    told = expected_cost(start, trial).right_hand_sides
    assert simulate(start).provenance["right_hand_sides"] == pytest.approx(told, rel=0.4)


def test_a_trial_without_time_is_extrapolated_and_says_so():
    start = started()
    trial = try_out(start, budget=0.0)
    assert trial is None or not trial.complete
    cost = expected_cost(start, Trial(start, False, 0.5, 1e5, 1e-6))
    assert (cost.factor, cost.known) == (EXTRAPOLATED, None)
    assert "by a trial to 0.5 s" in cost.counted


@pytest.mark.parametrize(("loop", "runs"), [("exudyn", 32), ("compiled", 8)])
def test_the_number_of_moved_starts_depends_on_no_clock(monkeypatch, loop, runs):
    """Nor on cores, a trial, or what is compiled: a run printed 17, `check` 25, as the machine was busy."""
    start = started(f"engine.loop={loop}")
    for cores, seconds_each in ((1, 1e-3), (2, 1e-6), (64, 1e-9)):
        trial = Trial(start, True, 2.0, 1e5 / cores, seconds_each)
        monkeypatch.setattr(estimates, "try_out", lambda *_, found=trial: found)
        monkeypatch.setattr(estimates, "is_compiled", lambda _, known=cores > 1: known)
        monkeypatch.setattr(estimates.os, "cpu_count", lambda number=cores: number)
        assert estimated(start, thorough=True).spread.runs == runs
        assert estimates.expected_spread(start, None, None).runs == runs  # as `exunet resume` has it


def test_many_moved_starts_that_take_long_are_told_with_what_is_cheaper():
    """100000 runs of a case of 0.01 s: some minutes, and gigabytes."""
    start = started("time.end=0.01")
    found = dict(estimated(start, spread=100_000).rows())
    assert "GB" in found["memory"]
    assert found["cheaper"].startswith("--spread 32 takes about ")
    assert "94 %" in found["cheaper"]
    for few in (None, 0, 8, 32, 40):
        assert "cheaper" not in dict(estimated(start, spread=few).rows())


def test_runs_are_told_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    """Every 10 s at most; nothing if quiet. 5 runs in the 26 s since the first, so 21 s for the last 4."""
    monkeypatch.setattr(estimates.os, "cpu_count", lambda: 2)
    for quiet in (False, True):
        times = iter([0.0, 4.0, 12.0, 15.0, 30.0])
        with told_runs("spread: ", 10, quiet=quiet, clock=lambda times=times: next(times)) as progress:
            for done in (1, 2, 3, 6):
                progress(done)
        lines = capsys.readouterr().err.splitlines()
        told = ["spread: 2 of 10 runs", "spread: 6 of 10 runs, about 21 s left"]
        assert lines == ([] if quiet else told)


@pytest.mark.parametrize(
    ("case", "micros"),  # of a right-hand side over the whole run, as in benchmarks/estimates.md
    [
        ("capture/box", 50.4),
        ("capture/fixed_sphere", 22.0),
        ("capture/free_sphere", 24.4),
        ("capture/l_shape", 31.0),
        ("capture/rocket", 36.2),
        ("missions/closed_box", 8.4),
        ("missions/throw_close_tow", 11.2),
        ("hard/colliding_bodies", 1.4),
    ],
)
def test_the_time_of_contact_is_counted(case: str, micros: float):
    """It was that of a free net: a third to a fortieth of what these took."""
    start = started("engine.loop=compiled", case=CASES / f"{case}.toml")
    course = cost_of_a_course(start, None)
    each = course.seconds / course.right_hand_sides
    assert 1.0 / 1.8 < each / (micros * 1e-6) < 1.8
    told = expected_cost(start)
    assert told.factor == COUNTED
    assert told.counted == "equal steps, with contact; less where that comes late or never"
    assert told.known is not None
    of_spread = expected_spread(start, None, 8)
    least, most = (duration(of_spread.seconds * factor) for factor in (1.0 / COUNTED, COUNTED))
    assert f"about {duration(of_spread.seconds)} ({least} to {most})" in of_spread.words()


@pytest.mark.parametrize(
    ("case", "micros", "changes"),  # of a right-hand side, measured over half a second or more
    [
        ("bodies/tow", 4.9, ["solver.tolerance="]),  # was told 0.22 us
        ("bodies/tow", 0.31, ["solver.tolerance=", "tethers.tow.reel="]),
        ("verification/bodies/reel_nodes", 6.0, ["solver.tolerance="]),
        ("verification/bodies/reel_force", 3.5, ["solver.tolerance="]),
        ("verification/trajectories/breaking", 6.1, []),
        ("bodies/snap", 0.28, []),
    ],
)
def test_the_time_of_bodies_reels_and_breaks_is_counted(case: str, micros: float, changes: list[str]):
    start = started("engine.loop=compiled", "solver.method=RK44", *changes, case=CASES / f"{case}.toml")
    told, course = expected_cost(start), cost_of_a_course(start, None)
    each = course.seconds / course.right_hand_sides
    assert 1.0 / 2.0 < each / (micros * 1e-6) < 2.0
    looked_at = micros > 1.0
    assert told.factor == (COUNTED if looked_at else EXACT)
    assert told.counted == ("equal steps, each looked at" if looked_at else "equal steps")


def test_the_time_of_moved_starts_does_not_count_the_stored_states_of_the_run(monkeypatch):
    """The run takes a step for each state, stored each 1e-5 s; moved starts have 401 instants."""

    def counted(start: Start, _: float) -> Trial:
        return Trial(start, True, 0.7, 7.0 * len(start.scene.time.stored_times), 1e-6)

    for module in (estimates, ensembles):
        monkeypatch.setattr(module, "try_out", counted)
    monkeypatch.setattr(estimates, "is_compiled", lambda _: True)
    start = started("time.end=0.7", "time.output_step=1e-5")
    found = estimated(start, thorough=True, spread=8)
    assert found.run.right_hand_sides > 7.0 * 70_000
    stored = cost_of_a_course(start, counted(start_of_runs(start), 0.0)).seconds
    assert stored < 0.1
    assert found.spread.seconds == expected_spread(start, counted(start_of_runs(start), 0.0), 8).seconds
    assert ensembles.time_of_runs(start, 2 * (os.cpu_count() or 1), 1.0).startswith(
        f"about {duration(2.0 * stored)} ("
    )


def test_equal_steps_need_no_trial():
    assert try_out(started("solver.method=RK44"), budget=1.0) is None


def test_disk_is_a_bound_that_is_not_far(tmp_path):
    start = started("time.end=0.2", "time.output_step=0.0002")
    cost = expected_cost(start)
    run_into(tmp_path, load(PLANAR, ["time.end=0.2", "time.output_step=0.0002"]))
    kept = (tmp_path / "result.h5").stat().st_size
    assert cost.states == 1001
    assert kept < cost.kept < 10 * kept + (8 << 20)
    assert cost.kept < cost.disk


# The command, which tells the largest memory that it had: what `os.wait4` tells begins with that of the
# process that started it.
_MEASURED = """
import atexit, sys
from pathlib import Path
from exunet.__main__ import main

told = Path(sys.argv.pop(1))

def tell():
    (line,) = (one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM"))
    told.write_text(line.split()[1])

atexit.register(tell)
main()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the largest memory of a process from /proc")
def test_memory_is_a_bound_of_the_whole_command(tmp_path):
    """Reading, stepping, moved starts and figures of bodies, the last of which take the most."""
    case, told, out = PLANAR.parent / "bodies" / "release.toml", tmp_path / "told", tmp_path / "out"
    program = [
        sys.executable,
        "-c",
        _MEASURED,
        told,
        "run",
        case,
        "--overwrite",
        "--spread",
        "8",
        "--out",
        out,
    ]
    for _ in range(2):  # the first one compiles what is not yet
        subprocess.run(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    expected = estimated(prepare_case(load(case)), spread=8)
    taken = int(told.read_text()) * 1024
    assert 0.5 * expected.memory < taken < expected.memory + expected.spread.memory


def test_what_is_to_be_compiled_counts_as_memory(monkeypatch):
    start, found = started(), []
    for known in (True, False):
        monkeypatch.setattr(estimates, "is_compiled", lambda _, known=known: known)
        monkeypatch.setattr(estimates, "try_out", lambda *_: None)
        found.append(estimated(start, spread=0).memory)
    assert found[1] - found[0] == COMPILING


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("disk_left", ("on disk, and 1 kB are free", "time.output_step", "--out")),
        ("memory_left", ("of memory, and 1 kB are free", "64 elements")),
    ],
)
def test_a_run_beyond_the_machine_is_refused_before_it_begins(tmp_path, monkeypatch, name, words):
    monkeypatch.setattr(estimates, name, lambda *_: 1000)
    done = command("run", PLANAR, "--set", "time.end=0.02", "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    for word in words:
        assert word in done.told
    assert list(tmp_path.iterdir()) == []


def test_a_system_that_does_not_say_refuses_nothing(tmp_path, monkeypatch):
    for name in ("disk_left", "memory_left"):
        monkeypatch.setattr(estimates, name, lambda *_: None)
    start = started()
    refuse_beyond(Expected(expected_cost(start)), start, tmp_path)
    monkeypatch.setattr(estimates, "disk_left", lambda *_: 0)
    with pytest.raises(InputError, match="0 kB are free"):
        refuse_beyond(Expected(expected_cost(start)), start, tmp_path)


def test_a_long_run_says_what_the_compiled_loop_would_take():
    start = started("solver.method=RK44", "solver.step=1e-7")
    found = dict(estimated(start).rows())
    assert "engine.loop" in found["faster"]
    assert in_the_compiled_loop(started("engine.loop=compiled"), None) is None
    assert "faster" not in dict(estimated(started("time.end=0.1")).rows())


def test_what_the_time_leaves_out_is_told():
    assert not_counted(error=False) == []
    ((name, words),) = not_counted(error=True)
    assert name == "error"
    assert "not in this time" in words
    assert len(f"{name:8s}{words}") <= 80


def test_the_time_of_a_check_is_told_with_that_of_both() -> None:
    start = started(*EARLY)
    found = estimated(start, check=True)
    assert found.check is not None
    words = dict(found.rows())["check"]
    assert words.startswith(f"about {duration(found.check.seconds)} (")
    assert f"about {duration(max(found.check.seconds, found.run.seconds))} for both" in words
    assert "check" not in dict(estimated(start).rows())
    assert "check of a run" in dict(describe(load(PLANAR, ["time.end=0.1"])))


def test_no_time_is_told_for_a_check_that_the_reference_refuses():
    case = load(PLANAR.parent / "missions" / "throw_close_tow.toml")
    assert dict(describe(case))["check of a run"].startswith("none: the reference refuses the case: ")


@pytest.mark.parametrize(
    ("case", "millis", "changes"),
    [
        ("planar_deployment", 0.045, "time.end=0.7"),
        ("nets/cut", 0.066, "time.end=0.3"),
        ("bodies/snap", 0.15, "time.end=0.2 solver.method=DOPRI5 solver.step="),
        ("hard/one_element", 0.043, "time.end=0.05"),
    ],
)
def test_the_reference_takes_what_is_told(case: str, millis: float, changes: str) -> None:
    """Its right-hand sides, counted here, each for the time that benchmarks/reference_rate.md has of it."""
    given = ("time.output_step=0.01", *changes.split())
    path = CASES / f"{case}.toml"
    start = started(*given, case=path)
    trial = try_out(start, budget=60.0)
    assert trial is not None
    assert trial.complete
    told = expected_check(start, trial)
    overrides = dict(reference.parse_override(one) for one in given if one[-1] != "=")
    counted = reference.prepare(reference.read(path, overrides)).integrate().n_rhs
    assert told.right_hand_sides / 3.0 < counted < told.right_hand_sides * 3.0  # 1.7 stands for 0.9 to 5
    each = (told.seconds - 1.0) / told.right_hand_sides  # a second for its start
    assert each / 2.0 < 1e-3 * millis < each * 2.0
    assert told.seconds / told.factor < 1.0 + 1e-3 * millis * counted < told.seconds * told.factor


@pytest.mark.parametrize(
    ("case", "millis", "end"),
    [("bodies/snap", 0.15, "0.5"), ("capture/miss", 0.46, "1.2"), ("bodies/dumbbell", 0.32, "360.0")],
)
def test_the_reference_takes_what_is_told_beside_equal_steps(case: str, millis: float, end: str) -> None:
    """Its steps are not equal: it was told 20 to 700 times what it took, from the highest frequency.

    Its right-hand sides are counted, each for the time that benchmarks/reference_rate.md has of it.
    """
    path = CASES / f"{case}.toml"
    told = estimated(started(f"time.end={end}", case=path), thorough=True, spread=0, check=True).check
    assert told is not None
    scene = reference.prepare(reference.read(path, dict([reference.parse_override(f"time.end={end}")])))
    taken = 1.0 + 1e-3 * millis * scene.integrate().n_rhs  # a second for its start
    assert told.seconds / told.factor < taken < told.seconds * told.factor
    assert told.seconds < 12.0 * taken


def test_a_trial_with_adaptive_steps_that_did_not_end_leaves_the_guess():
    """Steps concentrate where the net snaps: what a trial says that did not come so far is far too little."""
    start = started("solver.method=RK44", "solver.step=1e-4")
    assert expected_check(start, Trial(start, False, 0.1, 10.0, 1e-6)) == expected_check(start)
    assert expected_check(start, Trial(start, True, 2.0, 10.0, 1e-6)).factor == EXTRAPOLATED


def test_a_trial_whose_steps_become_far_too_short_is_cut_short_and_says_so(monkeypatch):
    # With this tolerance steps of taut threads are 1e-9 s: until the next look they had no bound.
    monkeypatch.setattr(trials, "_CUT", 0.1)
    monkeypatch.setattr(trials, "_FIRST", 1.0)  # as far as the first stored time
    start = started("solver.tolerance=1e-25", case=CASES / "verification" / "hanging.toml")
    trial = try_out(start, budget=0.1)
    assert trial is not None
    assert not trial.complete
    assert trial.least is not None
    assert trial.least < trial.right_hand_sides
    cost = expected_cost(start, trial)
    assert (cost.factor, cost.known) == (GUESSED, None)
    time = dict(Expected(cost).rows())["time"]
    assert time.startswith("at least ")
    assert f"more is not known: a trial to {trial.until:.3g} s was cut short; if the run goes on" in time
    assert "not known how long" in expected_spread(start, trial, 8).words()
    assert expected_check(start, trial) == expected_check(start)


def test_a_trial_that_did_not_leave_the_start_says_what_is_known():
    start = started()
    cost = expected_cost(start, Trial(start, False, 0.0, math.inf, 1e-6, 1e5))
    time = dict(Expected(cost, spread=expected_spread(start, None, 8)).rows())["time"]
    assert time.startswith("at least ")
    assert time.endswith("more is not known: a trial to 0 s was cut short")


def test_a_guess_says_that_it_is_one():
    cost = expected_cost(started())
    assert (cost.factor, cost.known) == (GUESSED, None)
    assert "frequencies" in dict(Expected(cost).rows())["time"]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.123, "0.12 s"), (9.99, "10 s"), (59.0, "59 s"), (119.0, "120 s"), (600.0, "10 min"),
     (7200.0, "2 h"), (3e5, "3.5 days"), (1e9, "32 years")],
)  # fmt: skip
def test_times_in_words(seconds, words):
    assert duration(seconds) == words


@pytest.mark.parametrize(("count", "words"), [(10, "0.01 kB"), (2.5e6, "2.5 MB"), (1.2e10, "12 GB")])
def test_sizes_in_words(count, words):
    assert size(count) == words


def test_the_pace_of_equal_steps_leaves_what_is_left():
    pace = Pace(10.0)
    assert pace.left() is None
    for k in range(6):
        pace.look(2.0 * k, float(k), 100 * k)
    low, likely, high = pace.left()
    assert low < 10.0 < high < 6.0 * 10.0
    assert low < likely < high


def test_steps_that_concentrate_late_are_learned():
    """Right-hand sides as the cube of time: half-way in time, seven times as many are left."""
    pace = Pace(10.0)
    for k in range(51):
        time = 0.1 * k
        pace.look(time**3, time, int(1e4 * time**3))
    low, likely, high = pace.left()
    assert likely > 1.5 * 125.0
    assert low < 875.0 < high


def told_of(case: str) -> list[tuple[float, float, float]]:
    """At each recorded time: the part of its right-hand sides that is done; the least and the most that are
    told, over what is left. A right-hand side takes 0.1 ms.
    """
    counts = RATES[case]["right_hand_sides"]
    pace, found = Pace(RATES[case]["end"]), []
    for time, count in zip(np.linspace(0.0, RATES[case]["end"], len(counts))[:-1], counts[:-1], strict=True):
        pace.look(1e-4 * count, float(time), count)
        if (told := pace.left()) is not None:
            left = 1e-4 * (counts[-1] - count)
            found.append((count / counts[-1], told.least / left, told.most / left))
    return found


@pytest.mark.parametrize("case", [name for name in RATES if name != "about"])
def test_what_is_left_of_recorded_runs_is_within_what_is_told(case: str) -> None:
    """The least always; the most after a quarter of its right-hand sides. Of folded nets it may be far more:
    hard/folded takes 58 % of them in the first eighth of its time, and nobody knows that it will slacken.
    """
    told = told_of(case)
    assert all(least < 1.0 for _, least, _ in told)
    for part in (0.25, 0.5, 0.75):
        _, _, most = next(one for one in told if one[0] >= part)
        assert 1.0 < most < (60.0 if case in FOLDED else 8.0)


def test_the_least_is_not_nothing() -> None:
    """A bound that is met by all would be 0: of runs of these nets it comes to what is left within a half."""
    largest = {case: max(least for _, least, _ in told_of(case)) for case in FOLDED}
    assert max(largest.values()) > 0.5


def test_a_number_that_is_known_leaves_its_rest():
    pace = Pace(10.0, expected=1000.0)
    pace.look(0.0, 0.0, 0)
    pace.look(3.0, 5.0, 250)
    assert pace.left() == pytest.approx((9.0, 9.0, 9.0), rel=0.02)
    pace.look(12.0, 9.0, 1000)  # it was wrong: the pace takes over
    low, likely, high = pace.left()
    assert 0.0 < low < likely < high


def test_near_the_end_of_time_the_pace_counts_more_than_what_was_expected():
    pace = Pace(10.0, expected=1e6)
    for k in range(100):
        pace.look(0.1 * k, 0.1 * k, 1000 * k)
    assert pace.left().most < 1.0  # 0.1 s is left, of 90 that were expected


def test_looks_are_thinned_and_the_first_and_last_stay():
    pace = Pace(1e4)
    for k in range(5000):
        pace.look(float(k), float(k), k)
    assert pace.left() == pytest.approx((5001.0 / 10.0, 1.8 * 5001.0, 5001.0 * 5.0), rel=0.02)


def told(seconds: float, phase: str = "") -> list[str]:
    """The lines of a run of that wall time, linear in a simulated time of 10 s."""
    said: list[str] = []
    now = [0.0]
    lines = Lines(10.0, Pace(10.0), said.append, lambda: now[0])
    for k in range(1001):
        now[0] = seconds * k / 1000.0
        lines(k / 100.0, k, phase)
    lines.end()
    lines.end()
    return said


def test_lines_come_at_the_start_now_and_then_and_at_the_end():
    assert told(5.0) == ["simulating 10 s", "simulated in 5 s"]
    assert len(told(50.0)) == 2 + 4  # each 10 s: more than a tenth
    assert len(told(300.0)) == 2 + 9  # each tenth
    assert len(told(3000.0)) in range(2 + 45, 2 + 52)  # each minute at least
    assert "left" in told(50.0)[1]
    assert told(50.0, "close")[1] == told(50.0)[1] + ', after "close"'
    assert all(len(line) <= 80 for line in told(3000.0))


def test_what_is_left_in_words():
    pace = Pace(10.0, expected=1000.0)
    assert remaining(pace) == ""
    pace.look(0.0, 0.0, 0)
    pace.look(3.0, 5.0, 250)
    assert remaining(pace) == "about 9 s left"
    pace.look(3.9, 9.9, 850)
    assert remaining(pace) == "less than 1 s left"

"""Runs of a case whose script ends them, from moved starts: each at another time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import command
from scripts import FALL, case_of, entry, when_range_is

import exunet
from exunet.results.course import course_of, instants
from exunet.results.endings import words_of_endings
from exunet.results.headlines import headlines_of
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case
from exunet.studies.ensemble import run_ensemble
from exunet.studies.spread import spread_of, start_of_runs

# Near at some 0.583 s, sooner or later as the start is moved; over at a time in the middle of these.
LATE = 1e-4 * round(1e4 * when_range_is(1.3))
STOPS = entry("near", when="range < 1.3", do="stop", verdict="near")
STOPS += entry("late", at=LATE, do="stop", verdict="over")
FAR = entry("near", when="range < 0.392", do="stop", verdict="near")  # of some it never comes true


@pytest.mark.ci
@pytest.mark.slow
def test_each_run_ends_at_its_own_time() -> None:
    """A run of the ensemble is the run: the same end, the same headlines."""
    start = start_of_runs(prepare_case(case_of(STOPS, scene=FALL)))
    moved = start.position + 0.02 * np.array([0.0, 0.0, 1.0])  # nearer later
    found = run_ensemble(start, np.stack([start.position - [0.0, 0.0, 0.02], moved]))
    sooner, over = found.course(0, 0.0), found.course(1, 0.0)
    assert (sooner.stopped, over.stopped) == ("near", "over")
    assert over.time[-1] == LATE
    assert sooner.time[-1] == found.ended[0] < LATE
    before = instants(1.0)
    assert np.array_equal(sooner.time[:-1], before[before < sooner.time[-1]])
    assert len(sooner.centre) == len(sooner.time)
    height = 2.98 - 0.5 * 9.81 * sooner.time**2
    np.testing.assert_allclose(sooner.centre[:, 2], height, atol=1e-9)
    assert np.hypot(0.5 * sooner.time[-1], height[-1]) == pytest.approx(1.3, abs=1e-5)
    case = case_of(STOPS, "initial.node_positions=[[0.0, 0.0, 2.98]]", scene=FALL)
    alone = course_of(exunet.run(case))
    assert alone.stopped == "near"
    assert alone.time[-1] == pytest.approx(sooner.time[-1], abs=3e-7)
    theirs = headlines_of(alone)
    for key, value in headlines_of(sooner).items():
        assert value is None or value == pytest.approx(theirs[key], rel=1e-5, abs=1e-5), key


@pytest.mark.slow
def test_an_ensemble_tells_how_many_ended_how() -> None:
    """Quantiles over time are of those that still go on; no number is none."""
    result = exunet.ensemble(case_of(STOPS, scene=FALL), runs=12, perturb=0.02)
    ways = {item["verdict"]: item for item in result.provenance["endings"]}
    assert set(ways) == {"near", "over"}
    assert sum(way["runs"] for way in ways.values()) == 12
    assert ways["over"]["earliest_s"] == ways["over"]["latest_s"] == LATE
    assert ways["near"]["earliest_s"] < ways["near"]["latest_s"] < LATE
    assert result.time[-1] < LATE
    for name, values in result.quantiles.items():
        assert values.shape == (7, len(result.time)), name
        assert np.isfinite(values).all(), name
    for key, values in result.headlines.items():  # `near` comes in those runs alone that it ends
        some = key == "script_near_first_s"
        assert np.isfinite(values).sum() == (ways["near"]["runs"] if some else 12), key
    words = words_of_endings(result.provenance["endings"])
    assert f'by the script ("over") at {LATE:.4g} s' in words
    assert words.endswith("headlines are of each run until its own end")


@pytest.mark.slow
def test_some_runs_end_at_their_time() -> None:
    """The least distance is some 0.387 m; where it is above 0.392 m, no script ends the run."""
    result = exunet.ensemble(case_of(FAR, scene=FALL), runs=16, perturb=0.02)
    ways = {item["verdict"]: item["runs"] for item in result.provenance["endings"]}
    assert set(ways) == {"near", None}
    assert sum(ways.values()) == 16
    assert result.time[-1] == 1.0
    kinetic = result.quantiles["kinetic"]
    assert np.isfinite(kinetic).all()
    assert (np.diff(kinetic[3]) > 0.0).all()  # all fall, those that are left too


@pytest.mark.ci
@pytest.mark.slow
def test_a_spread_tells_how_its_runs_ended() -> None:
    case = case_of(STOPS, scene=FALL)
    spread = spread_of(prepare_case(case), 8, move=0.02)
    assert {ending["verdict"] for ending in spread.endings} == {"near", "over"}
    summary = summarise(exunet.run(case), None, spread)
    assert summary["spread"]["endings"] == spread.endings
    told = [words for name, words in rows(summary, spread) if name == "spread"]
    assert told[1].startswith("of 8 moved starts ended ")
    free = spread_of(prepare_case(case_of("", scene=FALL)), 8, move=0.02)
    assert free.endings == []
    assert free.ends() == ""


@pytest.mark.slow
def test_runs_that_end_at_once_have_headlines() -> None:
    """One state each, so that nothing has changed."""
    case = case_of(entry("now", at=0.0, do="stop", verdict="at once"), scene=FALL)
    result = exunet.ensemble(case, runs=2)
    assert result.time.tolist() == [0.0]
    assert result.provenance["endings"][0]["latest_s"] == 0.0
    assert not result.headlines["body_left_displacement_m"].any()
    spread = spread_of(prepare_case(case), 8)
    assert spread.judged["body_left_displacement_m"].median == 0.0


@pytest.mark.slow
def test_the_commands_run_such_cases(tmp_path: Path) -> None:
    """Ensemble with figures, and a run with its spread."""
    (tmp_path / "ends.toml").write_text(FALL + STOPS, encoding="utf-8")
    every = command("ensemble", "ends.toml", "--runs", 8, "--perturb", 0.02, "--out", "e", folder=tmp_path)
    assert every.returncode == 0
    assert 'by the script ("near")' in every.stdout
    one = command("run", "ends.toml", "--spread", 8, "--out", "r", folder=tmp_path)
    assert one.returncode == 0
    assert "of 8 moved starts ended" in " ".join(one.stdout.split())

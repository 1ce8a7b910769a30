"""What closes a mouth, toggled: the case without it, and what that changes beside the spread."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_script import FALL, case_of, entry, when_range_is

import exunet
from exunet.case.cross_checks import cross_checks
from exunet.interfaces.effects import lines_of
from exunet.studies.ablation import CLOSING, ablate, of_closing, toggled

MISSIONS = Path(__file__).parents[1] / "cases" / "missions"


def test_a_mission_without_its_line() -> None:
    """What acts on the line does nothing any more, at the same moments; all else is as it was."""
    scene = exunet.load(MISSIONS / "throw_close_tow.toml").scene
    (found,) = of_closing(scene)
    other = toggled(scene, found)
    assert other.closing is None
    assert not list(cross_checks(other))
    pairs = list(zip(scene.script, other.script, strict=True))
    changed = {one.name: now.do for one, now in pairs if one != now}
    assert changed
    assert set(changed.values()) == {"note"}
    assert all(one.drive == CLOSING for one in scene.script if one.name in changed)
    triggers = [(one.at, one.after, one.delay, one.when, one.unless) for one in other.script]
    assert triggers == [(one.at, one.after, one.delay, one.when, one.unless) for one in scene.script]
    assert of_closing(other) == []


def test_the_line_is_measured_beside_the_spread() -> None:
    """Until 0.3 s, 0.1 s after its winch has begun: the mouth is narrower with it than in any moved start."""
    short = ["time.end=0.3", "solver.step=2e-4", "verdict.duration=0.05"]
    scene = exunet.load(MISSIONS / "closed_box.toml", short).scene
    (found,) = ablate(scene, (CLOSING,))
    assert found.measured > 0.0
    changes = {one.name: one for one in found.measures}
    mouth = changes["capture_mouth_m"]
    assert mouth.told_apart
    assert mouth.value < 0.0
    assert sum(found.outcomes.values()) == 9
    lines = lines_of(found)
    assert lines[0].startswith("closing           on  until 0.3 s: ")
    assert "estimate" not in " ".join(lines)
    assert any(line.startswith("  the target, of 9 runs: ") and "without it: " in line for line in lines)


def test_runs_that_a_script_ends_are_compared_until_then() -> None:
    """The weight toggled: without it the net never comes near, and the run goes on to its time."""
    stops = entry("near", when="range < 1.3", do="stop", verdict="near")
    (found,) = ablate(case_of(stops, scene=FALL).scene, ("gravity",))
    assert not found.failure
    assert found.until == pytest.approx(0.05 * int(when_range_is(1.3) / 0.05))
    # The net alone is the node; it falls by g t^2 / 2, of a size of 1 m.
    assert found.measured * 1.0 == pytest.approx(0.5 * 9.81 * found.until**2, rel=0.5)

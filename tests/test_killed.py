"""A run killed at any moment: its result is absent, whole, or a sound beginning marked as incomplete."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import PATIENCE, WRITING_OFTEN, process, states_stored, wait_until

import exunet
from exunet.base.errors import InputError
from exunet.base.files import replacing, sweep
from exunet.simulation.checkpoint import Checkpoints
from exunet.simulation.run import run_into

CASE = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
KILLS = 6
ENDLESS = ("--set", "time.end=1000", "--set", "time.output_step=0.02")
SHORT = ("--set", "time.end=0.4", "--set", "time.output_step=0.02")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")


def started(folder: Path, *overrides: str) -> subprocess.Popen[str]:
    """A run that writes at each stored time, so that many kills hit a file half written."""
    # What a kill before has left is put aside.
    arguments = ("run", CASE, *overrides, "--out", folder, "--overwrite")
    return process(*arguments, folder=folder.parent, program=WRITING_OFTEN)


def finished(folder: Path, *overrides: str) -> int:
    """Exit code of such a run that is left alone."""
    running = started(folder, *overrides)
    running.communicate(timeout=PATIENCE)
    return running.returncode


def killed(running: subprocess.Popen[str], when: Callable[[], bool]) -> None:
    """Kill it as soon as that is so, or find it at its end."""
    wait_until(lambda: when() or running.poll() is not None, running)
    running.kill()
    running.communicate()


def writes_seen(path: Path) -> Callable[[], int]:
    """Counts how often a file has been replaced since now, as far as it is asked in between."""
    seen = {path.stat().st_mtime_ns} if path.exists() else set()
    first = len(seen)

    def count() -> int:
        if path.exists():
            seen.add(path.stat().st_mtime_ns)
        return len(seen) - first

    return count


def parts(folder: Path) -> list[Path]:
    return list(folder.glob(".exunet-*.part"))


def check(folder: Path, end: float) -> str:
    """What is left of a killed run: "absent", "part" or "whole"."""
    assert len(parts(folder)) <= 1
    if not folder.exists():
        return "absent"
    if not (folder / "result.h5").exists():
        try:
            result = exunet.load_result(folder)
        except InputError as error:
            if "neither a result.h5" in str(error) or "not stored a state yet" in str(error):
                return "absent"
            raise
        assert not result.complete
        assert result.verdict.startswith("unfinished")
        assert not (folder / "summary.json").exists()
    else:
        result = exunet.load_result(folder / "result.h5")
        assert result.complete
        assert result.time[-1] == end
    assert np.isfinite(result.position).all()
    assert np.array_equal(result.time, 0.02 * np.arange(len(result.time)))
    return "whole" if result.complete else "part"


@pytest.mark.ci
@pytest.mark.slow
def test_every_part_that_is_stored_is_a_beginning_of_the_result(tmp_path, monkeypatch):
    """Bit for bit; what another process could read after every fifth of the checkpoints.

    States are stored when the guards have looked at them, which they do 256 steps at a time.
    """
    parts_seen = []
    checkpoint = Checkpoints.__call__

    def look(self):
        checkpoint(self)
        if round(self._simulation.time / 2e-4) % 50 == 0:
            parts_seen.append(exunet.load_result(tmp_path))

    monkeypatch.setattr(Checkpoints, "__call__", look)
    case = exunet.load(CASE, ["time.end=0.12", "time.output_step=2e-4"])
    whole = run_into(tmp_path, case, checkpoint_every=0.002)
    assert whole.complete
    sizes = [len(part.time) for part in parts_seen]
    assert len(sizes) == 12
    assert sizes == sorted(sizes)
    assert len(set(sizes)) == 3  # the start; 256 and 512 steps, one to a stored time
    assert 601 - sizes[-1] <= 256
    for part in parts_seen:
        assert not part.complete
        assert part.verdict.startswith("unfinished")
        for name in ("time", "position", "velocity", "tension", "dissipated", "largest_elastic"):
            ours, theirs = (np.asarray(getattr(item, name)) for item in (part, whole))
            assert np.array_equal(ours, theirs[: len(ours)]), name


@pytest.mark.slow
def test_kill_minus_9_in_a_loop(tmp_path):
    """At once, or when states have been written for the n-th time; over and over in one folder."""
    random = np.random.default_rng(20210616)
    seen, folder = [], tmp_path / "endless"
    for number in range(KILLS):
        writes, enough = writes_seen(folder / "unfinished.sqlite-wal"), int(random.integers(0, 12))
        killed(started(folder, *ENDLESS), lambda: writes() >= enough * (number > 0))  # noqa: B023
        seen.append(check(folder, 0.4))
    assert seen[0] == "absent"
    assert seen.count("part") >= KILLS // 3
    assert finished(folder, *SHORT) == 0
    assert parts(folder) == []
    assert check(folder, 0.4) == "whole"


@pytest.mark.slow
def test_a_killed_run_leaves_its_beginning(tmp_path):
    """tests/test_nothing_lost.py has what becomes of an earlier result."""
    killed(started(tmp_path / "run", *ENDLESS), lambda: states_stored(tmp_path / "run") > 0)
    assert not (tmp_path / "run" / "result.h5").exists()
    assert check(tmp_path / "run", 0.4) == "part"


def test_what_a_dead_process_left_is_swept_and_what_a_living_one_writes_is_not(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    stale = tmp_path / f".exunet-{dead.pid}-00000000.part"
    stale.write_bytes(b"half a file")
    other = tmp_path / ".exunet-notes.part"
    other.write_text("not ours to judge")
    with replacing(tmp_path / "result.h5") as part:
        part.write_text("being written")
        sweep(tmp_path)
        assert part.exists()
    assert not stale.exists()
    assert other.exists()


@pytest.mark.slow
def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    """What a kill leaves of a part, if somebody gives it the name of a result."""
    assert finished(tmp_path / "here", *SHORT) == 0
    whole = (tmp_path / "here" / "result.h5").read_bytes()
    cut = tmp_path / "cut.h5"
    for length in np.linspace(0, len(whole) - 1, 40).astype(int).tolist():
        cut.write_bytes(whole[:length])
        with pytest.raises(InputError):
            exunet.load_result(cut)

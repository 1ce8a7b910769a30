"""A run killed at any moment: its result is absent, or whole and marked as incomplete."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.base.errors import InputError
from exunet.base.files import replacing, sweep

CASE = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
KILLS = 24
# The command, with a part written at each stored time, so that many kills hit a file half written.
COMMAND = """
import exunet.simulation.run as loop
loop.KEEP_EVERY, loop.KEEP_PART = 0.0, 1e9
from exunet.interfaces.cli import main
main()
"""
ENDLESS = ("--set", "time.end=1000", "--set", "time.output_step=0.02")
SHORT = ("--set", "time.end=0.4", "--set", "time.output_step=0.02")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")


def started(folder: Path, *overrides: str) -> subprocess.Popen[bytes]:
    arguments = [sys.executable, "-c", COMMAND, "run", str(CASE), *overrides, "--out", str(folder)]
    return subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def parts(folder: Path) -> list[Path]:
    return list(folder.glob(".exunet-*.part")) if folder.exists() else []


def check(folder: Path, end: float) -> str:
    """What is left of a killed run: "absent", "part" or "whole"."""
    assert len(parts(folder)) <= 1
    path = folder / "result.h5"
    if not path.exists():
        return "absent"
    result = exunet.load_result(path)
    assert np.isfinite(result.position).all()
    if result.complete:
        assert result.time[-1] == end
        return "whole"
    assert result.verdict.startswith("unfinished")
    assert not (folder / "summary.json").exists()
    return "part"


@pytest.mark.slow
@pytest.mark.ci
def test_kill_minus_9_in_a_loop(tmp_path):
    random = np.random.default_rng(20210616)
    seen = []
    for number in range(KILLS):
        short = number % 3 == 2
        # The endless ones over and over in one folder, on what the kill before has left.
        folder = tmp_path / (f"short{number}" if short else "endless")
        process = started(folder, *(SHORT if short else ENDLESS))
        time.sleep(float(random.uniform(0.2, 2.4)))
        process.kill()
        process.wait()
        seen.append(check(folder, 0.4))
    assert "absent" in seen
    assert seen.count("part") >= KILLS // 3
    assert started(tmp_path / "endless", *SHORT).wait() == 0
    assert parts(tmp_path / "endless") == []
    assert check(tmp_path / "endless", 0.4) == "whole"


def test_a_killed_run_leaves_its_beginning(tmp_path):
    """Also: it takes the place of an earlier, complete result, which would pass for its own."""
    assert started(tmp_path, *SHORT).wait() == 0
    assert exunet.load_result(tmp_path / "result.h5").complete
    process = started(tmp_path, *ENDLESS)
    until = time.monotonic() + 60.0
    while exunet.load_result(tmp_path / "result.h5").complete and time.monotonic() < until:
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert check(tmp_path, 0.4) == "part"


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


def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    """What a kill leaves of a part, if somebody gives it the name of a result."""
    assert started(tmp_path / "here", *SHORT).wait() == 0
    whole = (tmp_path / "here" / "result.h5").read_bytes()
    cut = tmp_path / "cut.h5"
    for length in np.linspace(0, len(whole) - 1, 40).astype(int).tolist():
        cut.write_bytes(whole[:length])
        with pytest.raises(InputError):
            exunet.load_result(cut)

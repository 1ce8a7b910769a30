"""The reference run beside the engine (`exunet run --check`): its process does not outlive the parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from exunet.scene.casefile import load
from exunet.verification.reference_run import ReferenceRun

PLANAR = Path(__file__).parents[2] / "cases" / "planar_undamped.toml"
PARENT = """
import sys, time
from exunet.scene.casefile import load
from exunet.verification.reference_run import ReferenceRun
run = ReferenceRun(load(sys.argv[1], ["time.end=1e4", "time.output_step=1.0"]))
print(run._process.pid, flush=True)
time.sleep(600)
"""
DEADLINE = 60.0  # [s]; the parent's run would take a day


def ended(pid: int) -> bool:
    """No such process, or one that only waits to be collected by whoever inherited it."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state in "ZX"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for the process in /proc")
def test_the_reference_ends_with_a_parent_that_was_killed(tmp_path):
    command, own = [sys.executable, "-c", PARENT, str(PLANAR)], os.environ | {"TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=own) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert not ended(child)
        assert len(list(tmp_path.iterdir())) == 1  # its files
        os.kill(parent.pid, signal.SIGKILL)
    until = time.monotonic() + DEADLINE
    while not ended(child):
        assert time.monotonic() < until, "the reference runs on without its parent"
        time.sleep(0.01)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.ci
@pytest.mark.slow
def test_the_reference_runs_to_its_end_beside_a_living_parent():
    """The pipe stays open while it runs: it would end it with exit code 1."""
    with ReferenceRun(load(PLANAR, ["time.end=0.02", "time.output_step=0.01"])) as run:
        assert run._process.stderr is not None
        assert run._process.stderr.read() == ""
        assert run._process.wait(DEADLINE) == 0


@pytest.mark.ci
@pytest.mark.slow
def test_the_reference_reports_its_simulated_time() -> None:
    case = load(PLANAR, ["time.end=0.02"])
    with ReferenceRun(case) as reference:
        assert reference.refusal() == ""
        deadline = time.monotonic() + DEADLINE
        while reference.simulated < 0.02 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert reference.simulated == 0.02

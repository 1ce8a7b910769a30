"""A million stored states of the paper's net, run by the command: below 500 MB to the last figure."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from exunet.results.io import load_result

CASE = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
STATES = 10**6
MEMORY = 500.0  # MB, the bound that was set for such a run

PROGRAM = """
import json, sys
from pathlib import Path
import exunet
from exunet.cli.run import RunOptions, run_case
from exunet.simulation import run as runs

memory, real = {}, runs.write_rows

def reached(what):  # getrusage would begin with the peak of the process that started this one
    (line,) = (one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM"))
    memory[what] = int(line.split()[1]) / 1024

def write_rows(*arguments, **more):
    reached("run")
    real(*arguments, **more)
    reached("joined")

runs.write_rows = write_rows
overrides = ["engine.backend=compiled", "time.output_step=2e-6"]
stopped = run_case(exunet.load(sys.argv[1], overrides), RunOptions(Path(sys.argv[2])))
assert stopped is None
reached("described")
Path(sys.argv[3]).write_text(json.dumps(memory))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the largest memory of a process from /proc")
def test_a_run_with_a_million_stored_states_stays_below_the_bound(tmp_path: Path) -> None:
    """Two seconds of flight, stored every 2 microseconds: some minutes, and 3 GB on the disk twice over."""
    folder, told = tmp_path / "run", tmp_path / "memory.json"
    command = [sys.executable, "-c", PROGRAM, str(CASE), str(folder), str(told)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        assert done.returncode == 0, done.stderr
        result = load_result(folder)
        assert result.complete
        assert len(result.time) == STATES + 1
        assert (folder / "summary.json").is_file()
        assert not list(folder.glob("unfinished.sqlite*"))
    finally:
        (folder / "result.h5").unlink(missing_ok=True)
    memory = json.loads(told.read_text())
    print(memory)  # noqa: T201 - what it needed, with -s
    assert max(memory.values()) < MEMORY, memory

"""A million stored states of the paper's net: written, joined, read, measured and drawn in 500 MB."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

CASE = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
STATES = 10**6
MEMORY = 500.0  # MB, the bound that was set for such a result

# Each bullet flies on a circle of its own, so that the net opens and closes; the numbers of all columns are
# full floating-point numbers, as those of a run. One element pulls 1000 N in one state, and one speed peaks.
PROGRAM = """
import json, sys
from pathlib import Path
import numpy as np
import exunet
from exunet.results.columns import PATHS, declare
from exunet.results.comparison import ComparedRun, compare
from exunet.results.measures import bullet_speeds, energy_balance
from exunet.results.io import load_result, open_unfinished
from exunet.results.store import STORE_FILE, FileStore
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.results.io import head_of, write_rows
from exunet.net import weave
from exunet.plots.registry import save_figures

case, folder, states = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
net = weave(exunet.load(case).scene.net)
memory = {}

def reached(what):  # getrusage would begin with the peak of the process that started this one
    (line,) = (one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM"))
    memory[what] = int(line.split()[1]) / 1024

columns = declare(net.n_nodes, net.n_elements, {})
provenance = {
    "title": "Large", "energy_scale_J": 1.0, "method": "DOPRI5", "tolerance": 1e-9, "steps": states,
    "rejected_steps": 0, "right_hand_sides": 6, "build_seconds": 0.0, "integration_seconds": 1.0,
}
store = FileStore.create(folder / STORE_FILE, columns, head_of(net, {}, provenance), {})
reached("start")
random = np.random.default_rng(0)
for first in range(0, states, 1000):
    time = 1e-5 * np.arange(first, first + 1000)
    one = np.sin(time)
    position = (0.5 + 0.4 * np.cos(time))[:, None, None] * net.reference_position
    strain = 0.01 * one[:, None] * random.random(net.n_elements)
    values = {
        "time": time, "position": position, "velocity": 0.1 * position, "strain": strain,
        "tension": np.abs(strain), "kinetic": one**2, "elastic": 1.0 - one**2, "potential": 0 * one,
        "dissipated": 0 * one, "momentum": position[:, 0], "angular_momentum": position[:, 1],
        "largest_elastic": 1.1 - one**2, "least_kinetic": 0.9 * one**2,
    }
    if first == states // 2:
        values["tension"][321, 5] = 1000.0
        values["velocity"][321, net.bullet_nodes[1]] = (0.0, 0.0, 50.0)
    store.append({PATHS[name]: array for name, array in values.items()})
reached("stored")
write_rows(store, folder / "result.h5", net, {}, provenance, "ok", True)
reached("joined")
unfinished = open_unfinished(folder)
assert len(unfinished.time) == states
del unfinished
store.discard()
result = load_result(folder)
reached("read")
summary = summarise(result)
rows(summary)
assert summary["headlines"]["largest_tension_N"]["this_run"] == 1000.0
assert bullet_speeds(result)[:, 1].max() == 50.0
assert energy_balance(result) < 1e-12
reached("summarised")
agreement = compare(ComparedRun.of(result), ComparedRun.of(result))
assert agreement.agrees_until is None
reached("compared")
save_figures(result, folder, agreement)
reached("drawn")
assert sum(len(part.time) for part in result.parts(5_000)) == states
reached("in parts")
print(json.dumps(memory))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the largest memory of a process from /proc")
def test_a_million_states_stay_below_the_bound(tmp_path):
    """3 GB of numbers, about as much on the disk while the run goes on and again as a file: some minutes."""
    command = [sys.executable, "-c", PROGRAM, str(CASE), str(tmp_path), str(STATES)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    (tmp_path / "result.h5").unlink(missing_ok=True)
    assert done.returncode == 0, done.stderr
    memory = json.loads(done.stdout)
    print(memory)  # noqa: T201 - what it needed, with -s
    assert max(memory.values()) < MEMORY, memory

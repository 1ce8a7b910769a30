"""Simulations that are cut in two, for tests; as a program, it continues those whose snapshots it is told.

    python restarts.py < jobs.json > told.json

It restores each snapshot, in a process that has computed nothing before, and tells how the simulation ends.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.errors import RunStopped
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Action = Sequence[Any]  # ["to", time], ["force", node or name, three numbers], or ["look"]


@dataclass(frozen=True)
class Job:
    """A case, what is done with it, and after how many actions it is cut in two."""

    case: str
    overrides: Sequence[str]
    actions: Sequence[Action]
    cut: int


def begun(job: Job) -> Simulation:
    """The simulation at its start."""
    return Simulation(job.case, job.overrides)


def act(sim: Simulation, actions: Sequence[Action]) -> str:
    """Do what is asked for; returns the words with which it stopped, if it did."""
    try:
        for what, *how in actions:
            if what == "to":
                sim.advance_to(*how)
            elif what == "force":
                sim.set_force(*how)
            else:
                assert what == "look"
                assert np.isfinite(sim.energy.total)
    except RunStopped as stop:
        return str(stop)
    return ""


def told(sim: Simulation, words: str) -> dict[str, Any]:
    """All that the simulation depends on, and all that it shows: digests of arrays, numbers as written."""
    here = sim.snapshot()  # before anybody looks: with what the guards have not seen
    words = words or act(sim, [("look",)])
    found: dict[str, Any] = {"words": words, "header": here.header}
    found |= {f"snapshot {name}": digest(values) for name, values in here.arrays.items()}
    if not words:
        found["energy"] = list(sim.energy)
        found |= {name: digest(values) for name, values in sim.state.arrays().items()}
        found["tension"] = digest(sim.net.tension)
    found["largest_tension"] = sim.largest_tension if not words else None
    found["counts"] = asdict(sim.counts)
    return dict(json.loads(json.dumps(found)))  # as it comes out of the other process


def digest(values: Any) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def whole(job: Job) -> dict[str, Any]:
    """How the simulation ends that is not cut."""
    sim = begun(job)
    return told(sim, act(sim, job.actions))


def first_half(job: Job, path: Path) -> Simulation:
    """The simulation until the cut, with its snapshot in a file."""
    sim = begun(job)
    act(sim, job.actions[: job.cut])
    sim.snapshot().save(path)
    return sim


def continued(jobs: Mapping[str, Job], paths: Mapping[str, Path]) -> dict[str, dict[str, Any]]:
    """How the second halves end in a process of their own."""
    lines = {name: asdict(job) | {"path": str(paths[name])} for name, job in jobs.items()}
    done = subprocess.run(
        [sys.executable, __file__], input=json.dumps(lines), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def main() -> None:
    """Continue each, and tell."""
    found = {}
    for name, line in json.load(sys.stdin).items():
        path = line.pop("path")
        job = Job(**line)
        sim = begun(job)
        sim.restore(Snapshot.load(path))
        found[name] = told(sim, act(sim, job.actions[job.cut :]))
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()

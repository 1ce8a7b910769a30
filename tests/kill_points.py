"""Runs that kill themselves at a chosen call of a low-level function, and are resumed: a program for tests.

    python kill_points.py '{"case": ..., "overrides": [...], "every": 0.02, "folder": ..., "kills": 6, ...}'

The process forks one child for each run or resumption; it itself only imports and compiles. It prints one
line of JSON: how often each function is called in a whole run, and what happened at each kill.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.errors import InputError, RunStopped
from exunet.case.casefile import load
from exunet.results import segments, writing
from exunet.results.segments import SegmentStore, is_store
from exunet.simulation.run import resume, run_into
from exunet.simulation.simulation import Simulation

# Where a run may be between two of these does not matter: nothing that survives the process is changed.
POINTS: dict[str, tuple[Any, str]] = {
    "stretch": (Simulation, "attempt"),
    "retry": (Simulation, "_retry"),
    "snapshot": (Simulation, "snapshot"),
    "rows": (SegmentStore, "append"),
    "flush": (SegmentStore, "flush"),
    "drop": (SegmentStore, "drop_after"),
    "synchronise": (os, "fsync"),
    "rename": (os, "replace"),
    "remove": (Path, "unlink"),
    "remove folder": (Path, "rmdir"),
    "join": (writing._Sink, "write"),
}
Kill = tuple[str, int, bool]  # at which call of which function, after it or before


def patched(kill: Kill | None, counts: Counter[str]) -> None:
    """Count the calls of all points, and end the process at one of them."""
    for point, (owner, name) in POINTS.items():
        setattr(owner, name, _counting(point, getattr(owner, name), kill, counts))


def _counting(
    point: str, function: Callable[..., Any], kill: Kill | None, counts: Counter[str]
) -> Callable[..., Any]:
    def call(*arguments: Any, **more: Any) -> Any:
        counts[point] += 1
        here = kill is not None and (point, counts[point]) == kill[:2]
        if here and kill is not None and not kill[2]:
            os.kill(os.getpid(), signal.SIGKILL)
        try:
            return function(*arguments, **more)
        finally:
            if here:
                os.kill(os.getpid(), signal.SIGKILL)

    return call


def in_a_child(task: Callable[[], None], kill: Kill | None = None, told: Path | None = None) -> bool:
    """Run a task in a forked process; False if it was killed, AssertionError if it failed.

    told : file for the number of calls of each point
    """
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        counts: Counter[str] = Counter()
        try:
            patched(kill, counts)
            with suppress(RunStopped):  # which leaves a result like any other
                task()
            if told is not None:
                told.write_text(json.dumps(counts))
        except BaseException:  # noqa: BLE001 - told, and told to the parent
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return False
    assert os.waitstatus_to_exitcode(status) == 0, "a run failed"
    return True


def drawn(random: np.random.Generator, calls: dict[str, int], part: float = 1.0) -> Kill:
    """A point, all of them as likely, and a call of it within the first part."""
    point = str(random.choice(sorted(calls)))
    return point, int(random.integers(1, max(2, int(part * calls[point]) + 1))), bool(random.random() < 0.5)


def main(job: dict[str, Any]) -> None:
    """Do what is asked for."""
    segments.SEGMENT_BYTES = job.get("segment_bytes", 1 << 14)  # some rows each
    folder = Path(job["folder"])
    case = load(job["case"], job["overrides"])
    Simulation(case).advance(1e-9)  # compiles

    def begin(into: Path) -> Callable[[], None]:
        into.mkdir(exist_ok=True)
        return lambda: void(run_into(into, case, checkpoint_every=job["every"]))

    whole = folder / "whole"
    assert in_a_child(begin(whole), told=folder / "calls.json")
    calls = json.loads((folder / "calls.json").read_text())
    if "without" in job:
        (folder / "without").mkdir()
        assert in_a_child(lambda: void(run_into(folder / "without", case)))
    random, stories = np.random.default_rng(job["seed"]), []
    for number in range(job["kills"]):
        into, story = folder / f"kill{number}", []
        task = begin(into)
        kills: list[Kill | None] = [drawn(random, calls)]
        kills += [drawn(random, calls, 0.5) for _ in range(int(random.integers(0, job["again"] + 1)))]
        for kill in (*kills, None):
            if in_a_child(task, kill):
                story.append("finished")
                break
            assert kill is not None
            story.append(f"killed {'after' if kill[2] else 'before'} call {kill[1]} of {kill[0]}")
            if is_store(into / "unfinished"):
                story.append(f"resumed from {segments.Segments(into / 'unfinished').checkpoint}")
                task = lambda: void(resume(into))  # noqa: B023, E731 - called at once
            elif (into / "result.h5").exists():
                story.append("was whole")
                break
            else:
                story.append("run again")
                task = begin(into)
        stories.append(story)
    sys.stdout.write(json.dumps({"calls": calls, "stories": stories}) + "\n")


def void(_result: object) -> None:
    """Nothing is done with a result here."""


if __name__ == "__main__":
    try:
        main(json.loads(sys.argv[1]))
    except InputError as error:
        sys.exit(f"refused: {error}")

"""Runs that kill themselves at given calls, and are resumed: a program for tests.

    python kill_points.py '{"case": ..., "overrides": [...], "every": 0.02, "folder": ..., "kills": [...]}'

A kill is [point, number of the call, after it or before]. The process forks a child for each run or
resumption; it itself only imports and compiles. It prints, for each kill, what followed.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from exunet.base.errors import RunStopped
from exunet.results import io
from exunet.results.run_folder import has_result, has_unfinished
from exunet.results.store import FileStore
from exunet.scene.casefile import load
from exunet.simulation import recorder
from exunet.simulation.run import resume, run_into
from exunet.simulation.simulation import Simulation

# Anywhere else nothing changes that survives the process.
POINTS: dict[str, tuple[Any, str]] = {
    "attempt": (Simulation, "attempt"),
    "retry": (Simulation, "_retry"),
    "append": (FileStore, "append"),
    "drop": (FileStore, "drop_after"),
    "checkpoint": (FileStore, "keep_checkpoint"),
    "rename": (os, "replace"),
    "discard": (FileStore, "discard"),
    "remove": (Path, "unlink"),
    "write": (io._Sink, "write"),
}
Kill = tuple[str, int, bool]


def patch(kill: Kill) -> None:
    """Let this process end at a call."""
    point, number, after = kill
    owner, name = POINTS[point]
    function, calls = getattr(owner, name), 0

    def call(*arguments: Any, **more: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == number and not after:
            os.kill(os.getpid(), signal.SIGKILL)
        try:
            return function(*arguments, **more)
        finally:
            if calls == number:
                os.kill(os.getpid(), signal.SIGKILL)

    setattr(owner, name, call)


def in_a_child(task: Callable[[], Any], kill: Kill | None = None) -> bool:
    """Run a task in a forked process; False if it was killed, AssertionError if it failed."""
    child = os.fork()
    if child == 0:
        try:
            if kill is not None:
                patch(kill)
            with suppress(RunStopped):  # which leaves a result like any other
                task()
        except BaseException:  # noqa: BLE001 - reported by the parent
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return False
    assert os.waitstatus_to_exitcode(status) == 0, "a run failed"
    return True


def main(job: dict[str, Any]) -> list[str]:
    """Return what followed each kill."""
    recorder._BATCH = 4  # several batches a run
    folder, case, found = Path(job["folder"]), load(job["case"], job["overrides"]), []
    Simulation(case).advance(1e-9)  # compiles

    def begin(into: Path) -> Any:
        into.mkdir(exist_ok=True)
        return run_into(into, case, checkpoint_every=job["every"])

    assert in_a_child(lambda: begin(folder / "whole"))
    for number, kill in enumerate(job["kills"]):
        into = folder / f"kill{number}"
        if in_a_child(lambda: begin(into), kill):  # noqa: B023 - called at once
            found.append("finished")
        elif has_unfinished(into):
            store = FileStore(into / "unfinished.sqlite", read_only=True)
            found.append("resumed from its start" if store.checkpoint is None else "resumed")
            store.close()
            assert in_a_child(lambda: resume(into))  # noqa: B023
        elif has_result(into):
            found.append("was whole")
        else:
            found.append("run again")
            assert in_a_child(lambda: begin(into))  # noqa: B023
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(json.loads(sys.argv[1]))))

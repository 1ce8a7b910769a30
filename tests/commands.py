"""The `exunet` command for tests: in this process, or in one of its own where that is what is tested."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from exunet.base.errors import InputError
from exunet.cli.main import main
from exunet.plots import registry
from exunet.results.io import load_result
from exunet.results.store import STORE_FILE
from exunet.scene.casefile import Case
from exunet.simulation import run as runs

CASES = Path(__file__).parents[1] / "cases"
PLANAR = CASES / "planar_deployment.toml"
SHORT = ("--set", "time.end=0.02", "--set", "time.output_step=0.01")  # free flight of the bullets
PATIENCE = 120.0  # [s] for what takes a second or two on an idle machine

# The command, with a checkpoint at each stored time, and not only every half a minute.
WRITING_OFTEN = """
import exunet.simulation.run as checkpoints
checkpoints.WALL_TIME, checkpoints.WALL_PART = 0.0, 1e9
from exunet.cli.main import main
from exunet.plots import registry
main()
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended, and what it wrote to its two streams."""

    returncode: int
    stdout: str
    stderr: str


def content(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by its relative path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def without_ensemble(arguments: tuple[object, ...]) -> list[str]:
    """The arguments; a run does not have perturbed runs, which take time, unless they are requested."""
    given = [str(argument) for argument in arguments]
    adds = given[:1] in (["run"], ["resume"]) and "--ensemble" not in given
    return [*given, "--ensemble", "0"] if adds else given


def command(*arguments: object, folder: Path, figures: Sequence[str] = ("area",)) -> Ended:
    """`exunet ...` with `folder` as the working directory; a warning of the arithmetic is an error.

    figures : those of a result that are drawn, of those that apply; all take longer than a short run
    """
    out, err = StringIO(), StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(out),
        redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("error", RuntimeWarning)
        patch.setattr(registry, "FIGURES", {name: registry.FIGURES[name] for name in figures})
        patch.chdir(folder)
        patch.setattr(sys, "argv", ["exunet", *without_ensemble(arguments)])
        with pytest.raises(SystemExit) as end:
            main()
    code = end.value.code
    assert code is None or isinstance(code, int)
    return Ended(code or 0, out.getvalue(), err.getvalue())


def process(*arguments: object, folder: Path, program: str = "") -> subprocess.Popen[str]:
    """Start `exunet ...` in a new process; program : Python that runs the command, if not `-m exunet`."""
    start = ["-c", program] if program else ["-m", "exunet"]
    return subprocess.Popen(
        [sys.executable, *start, *without_ensemble(arguments)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(running: subprocess.Popen[str]) -> Ended:
    """Wait for the end of a process."""
    out, err = running.communicate(timeout=PATIENCE)
    return Ended(running.returncode, out, err)


def wait_until(reached: Callable[[], bool], running: subprocess.Popen[str]) -> None:
    """Wait until a running process has reached a condition; fails if it ends before."""
    until = time.monotonic() + PATIENCE
    while not reached():
        if running.poll() is not None:
            assert reached(), f"ended before: {running.communicate()}"
            return
        assert time.monotonic() < until, f"not reached within {PATIENCE} s"
        time.sleep(0.01)


def states_stored(folder: Path) -> int:
    """Number of stored times of the run that goes on in a folder; 0 before the first can be read."""
    try:
        result = load_result(folder)
    except InputError:  # or a file was replaced while it was read
        return 0
    return 0 if result.complete else len(result.time)


class KilledError(BaseException):
    """Stands for the end of a process."""


def cut_short(folder: Path, case: Case, at: float, every: float | None = None) -> None:
    """Run a case into a folder until a stored time [s], and leave there what a kill leaves then."""
    real, files = runs.drive, folder / "as it was"
    files.mkdir(parents=True)

    def drive(simulation: Any, recorder: Any, progress: Any, checkpoint: Any) -> None:
        def after_each_time() -> None:
            checkpoint()
            if simulation.time >= at:
                for path in folder.glob(f"{STORE_FILE}*"):
                    shutil.copy(path, files)
                raise KilledError

        real(simulation, recorder, progress, after_each_time)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "drive", drive)
        with pytest.raises(KilledError):
            runs.run_into(folder, case, checkpoint_every=every)
    for path in folder.glob(f"{STORE_FILE}*"):
        path.unlink()
    for path in files.iterdir():
        path.rename(folder / path.name)
    files.rmdir()

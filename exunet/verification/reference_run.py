"""Run reference_impl on the same case in a separate process, and compare."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from exunet.base.errors import InputError
from exunet.model.effect_survey import without_choice
from exunet.model.initial import places_of_fold
from exunet.results.comparison import Agreement, ComparedRun, compare, read_reference
from exunet.results.result import Result
from exunet.scene.casefile import Case, files_of
from exunet.scene.scene import Scene

# Ends the reference with the process that started it, however that died: its end of the pipe closes then,
# and nobody else removes the folder.
_CHILD = """
import os, runpy, shutil, sys, threading
folder = os.path.dirname(sys.argv[2])
def end_with_parent():
    os.read(0, 1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
threading.Thread(target=end_with_parent, daemon=True).start()
runpy.run_module("reference_impl", run_name="__main__", alter_sys=True)
"""


class ReferenceRun:
    """The reference on one case, started at once so that it runs beside the engine.

    resolved : the scene of the case once its effects are chosen, where the case leaves that to exunet
    simulated : time that the reference has reached [s]

    A context manager: leaving it ends the process and removes its files. The reference is never imported.
    """

    def __init__(self, case: Case, resolved: Scene | None = None) -> None:
        self._words = ""
        self.simulated = 0.0
        self._folder = tempfile.TemporaryDirectory(prefix="exunet-check-")
        self._output = Path(self._folder.name) / "reference.npz"
        # -P: what lies in the working directory must not stand in for a module.
        path, files = _as_read(case, Path(self._folder.name))
        command = [sys.executable, "-P", "-c", _CHILD, str(path), str(self._output)]
        if places := places_of_fold(resolved or case.scene):
            path = Path(self._folder.name) / "places.npz"
            np.savez(path, reference_position=places[0], place=places[1])
            command += ["--places", str(path)]
        for override in (*case.overrides, *files, *without_choice(case.scene, resolved or case.scene)):
            command += ["--set", override]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([_home(), *_python_path()])},
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe:
                pipe.close()
        self._folder.cleanup()

    def refusal(self) -> str:
        """Return the reason why the reference rejects a case, once it has read it; empty: it accepts."""
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        if self._process.stdout.readline():
            threading.Thread(target=self._listen, daemon=True).start()
            return ""
        self._words = self._process.stderr.read()
        return _brief(self._words)

    def _listen(self) -> None:
        """Take the reports until it ends; a full pipe would stop it."""
        assert self._process.stdout is not None
        with suppress(OSError, ValueError):  # closed, when the run is left
            for line in self._process.stdout:
                self.simulated = float(line)

    @property
    def at_work(self) -> bool:
        """True as long as it has not ended."""
        return self._process.poll() is None

    def agreement(self, result: Result) -> Agreement:
        """Wait for the reference and compare; raises InputError with its words if it refused or failed."""
        assert self._process.stderr is not None
        words = (
            self._words + self._process.stderr.read()
        )  # to its end; `communicate` would close stdin, and end it
        if self._process.wait() not in (0, 3):
            raise InputError(f"the reference cannot check this case: {_brief(words)}")
        return compare(ComparedRun.of(result), read_reference(self._output))


def _as_read(case: Case, folder: Path) -> tuple[Path, list[str]]:
    """A file with the text of the case, and overrides for the files that it names.

    That is its own file, or if that is gone or was changed since, as it may be when a run is resumed, a copy
    in `folder`.
    """
    with suppress(OSError):
        if case.path.read_bytes() == case.text.encode():
            return case.path.absolute(), []
    copy = folder / case.path.name
    copy.write_bytes(case.text.encode())
    named = files_of(case.scene) | {"initial.restart": case.scene.initial.restart}
    placed = {key: str(Path(file).absolute()) for key, file in named.items() if file is not None}
    return copy, [f"{key}={json.dumps(file, ensure_ascii=False)}" for key, file in placed.items()]


def _home() -> str:
    """The folder that holds the package reference_impl, found without importing it."""
    found = importlib.util.find_spec("reference_impl")
    if found is None or found.origin is None:
        raise InputError("--check: the package reference_impl is not installed")
    return str(Path(found.origin).parent.parent)


def _python_path() -> list[str]:
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


def _brief(words: str) -> str:
    lines = [line.removeprefix("reference_impl: ") for line in words.splitlines() if line.strip()]
    return "; ".join(lines[:5]) if lines else "it ended without a message"

"""A process that has all but exunet imported already and runs pytest in forks of itself, each as a new one.

    python tests/mutations/forked_pytest.py

Reads a line of JSON for each run from its input: the list of pytest's arguments, and after how long a run is
ended [s]. Answers with a line: the exit code (null: ended by the limit), and the file with the output. It
runs in the folder where it was started, which PYTHONPATH names too.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

# What exunet and its tests import; none of it knows the folder that the tests are of.
_BEFORE = (
    "numpy", "scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.sparse.csgraph",
    "scipy.sparse.linalg", "scipy.spatial", "scipy.special", "scipy.stats", "pydantic", "h5py", "numba",
    "matplotlib", "hypothesis", "typer.testing", "_pytest.assertion.rewrite", "trimesh", "exudyn",
)  # fmt: skip
_LOOK = 0.02  # [s] between two looks at a run


def run(arguments: list[str], limit: float, output: Path) -> int | None:
    """One run of pytest in a fork; its exit code, or None if it was ended by the limit [s]."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        os.setsid()
        file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for number in (1, 2):
            os.dup2(file, number)
        code = 70
        try:
            code = int(pytest.main(arguments))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    ends = time.monotonic() + limit
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > ends:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(_LOOK)


def main() -> None:
    """Answer one line after the other."""
    for name in _BEFORE:
        with suppress(ImportError):  # an extra that is not there
            importlib.import_module(name)
    output = Path.cwd().parent / "output.txt"
    for line in sys.stdin:
        arguments, limit = json.loads(line)
        answer = json.dumps([run(arguments, limit, output), str(output)])
        sys.stdout.write(answer + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

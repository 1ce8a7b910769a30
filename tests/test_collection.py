"""The tests themselves: found from any folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_all_tests_are_found_from_another_folder(tmp_path):
    """Modules that open files of the project when they are imported must not ask the working directory.

    What tests do when they run is seen to by the fixture in conftest.py.
    """
    mine = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--collect-only", "-m", "", str(Path(__file__).parent)],
        cwd=tmp_path, env=mine, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:]
    names = [line.partition("tests/")[2] for line in done.stdout.splitlines() if "::" in line]
    assert any(name.startswith("test_compare.py") for name in names)
    assert list(tmp_path.iterdir()) == []

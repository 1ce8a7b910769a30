"""The code of extending.md and write_a_metric.md in a copy of the package, and its tests there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NAMES = ("extending", "write_a_metric")
PAGE = "\n".join((ROOT / "docs" / "how_to" / f"{name}.md").read_text(encoding="utf-8") for name in NAMES)
FILES = re.findall(r"^```python\n# (\S+)\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
CHANGES = re.findall(r"^```diff\n--- (\S+)\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


def stands_for(text: str, line: str) -> bool:
    """A text that ends with "..." stands for the line that begins so."""
    return line.startswith(text.removesuffix("...")) if text.endswith("...") else line == text


def only_line(name: str, lines: list[str], text: str) -> int:
    """The number of the one line that a text stands for."""
    found = [k for k, line in enumerate(lines) if stands_for(text, line)]
    there = f"in {name} {len(found)} times, not once" if found else f"not in {name}"
    assert len(found) == 1, f"docs/how_to names a line that is {there}: {text!r}"
    return found[0]


def changed(name: str, lines: list[str], change: str) -> list[str]:
    """The lines of a file after a change. Each of its lines that begins with " " or "-" must be there once.

    What it adds goes below the line that is named before, or above the next if no line is before.
    """
    lines, at, waiting = list(lines), None, []
    for sign, text in ((line[0], line[1:]) for line in change.splitlines()):
        if sign == "+" and at is None:
            waiting.append(text)
        elif sign == "+":
            lines.insert(at, text)
            at += 1
        else:
            found = only_line(name, lines, text)
            if sign == "-":
                del lines[found]
            lines[found:found] = waiting
            at = found + len(waiting) + (sign != "-")
            waiting = []
    return lines


def extended(folder: Path) -> None:
    """A copy of the package with all that the page adds."""
    for name in ("exunet", "reference_impl", "cases", "docs"):
        skipped = shutil.ignore_patterns("__pycache__", "*.pyc")
        shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=skipped)
    for name in ("physics", "unit"):
        (folder / "tests" / name).mkdir(parents=True)
    for name, text in FILES:
        assert not (folder / name).exists(), f"docs/how_to adds a file that is there already: {name}"
        (folder / name).write_text(text, encoding="utf-8")
    for name, change in CHANGES:
        path = folder / name
        lines = changed(name, path.read_text(encoding="utf-8").splitlines(), change)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def test_the_changes_fit_the_package(tmp_path):
    """Each line that they refer to is there, once."""
    extended(tmp_path)
    assert len(FILES) == 7
    assert '    "gust",\n' in (tmp_path / "exunet/forces/effects/__init__.py").read_text()


@pytest.mark.slow
def test_the_examples_pass_their_tests(tmp_path):
    extended(tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    done = subprocess.run(tests, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 passed" in done.stdout
    where = [sys.executable, "-c", "import exunet.net.ring as ring; print(ring.__file__)"]
    found = subprocess.run(where, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert found.stdout.startswith(str(tmp_path))

"""Writes the documentation into docs/_build/html: python docs/build_site.py [--quick]

Requires `pip install '.[docs]'`. Generates the reference and the gallery, executes the notebooks that are not
in their cache, and fails on any warning of Sphinx. With --quick the gallery has six cases.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
BUILD = DOCS / "_build"
REFERENCE = ("build_keys.py", "build_api.py", "build_commands.py")
GALLERY = DOCS / "build_gallery.py"


def main() -> int:
    """Build, and return the exit code."""
    parser = argparse.ArgumentParser(description="Write the documentation into docs/_build/html.")
    parser.add_argument("--quick", action="store_true", help="six cases in the gallery")
    quick = ["--quick"] if parser.parse_args().quick else []
    commands = [[DOCS / name] for name in REFERENCE]
    if GALLERY.exists():
        commands.append([GALLERY, *quick])
    shutil.rmtree(BUILD / "html", ignore_errors=True)  # pages of files that are not there any more
    strict = ("-n", "-W", "--keep-going", "-q", "-j", "auto")
    commands.append(["-m", "sphinx", *strict, "-d", BUILD / "doctrees", DOCS, BUILD / "html"])
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))  # of exunet, in notebooks
    environment = os.environ | {"PATH": path, "COLUMNS": "100"}  # as wide as a page
    for command in commands:
        run = subprocess.run([sys.executable, *command], env=environment, check=False)
        if code := run.returncode:
            shutil.rmtree(
                BUILD / "doctrees", ignore_errors=True
            )  # so that pages with warnings are read again
            return code
    for notebook in (BUILD / "notebooks").rglob("*.ipynb"):
        if "Traceback (most recent call last)" in notebook.read_text(encoding="utf-8"):
            shutil.rmtree(BUILD / "notebooks")
            print(f"{notebook}: a cell prints a traceback", file=sys.stderr)
            return 1
    print(BUILD / "html" / "index.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())

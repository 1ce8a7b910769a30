"""What is installed without the source tree: all that `exunet verify` and `exunet fmu` need."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LOOK = """
import exunet
from exunet.verification.ladder import read_cases
from exunet.verification.check import shipped
print(exunet.__file__)
print(len(read_cases([])), len(shipped("verification")), len(shipped("hard")))
from importlib.resources import files
print(len([one for one in (files("exunet.coupling.fmu") / "c").iterdir() if one.name.endswith(".c")]))
"""


@pytest.mark.slow
def test_the_cases_of_the_ladder_and_of_the_gallery_come_with_the_wheel(tmp_path):
    """From an empty folder. Building takes setuptools from the package index, as installing does."""
    wheel = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps"]
    subprocess.run([*wheel, "-w", str(tmp_path), str(ROOT)], check=True)
    (built,) = tmp_path.glob("*.whl")
    installed, empty = tmp_path / "installed", tmp_path / "empty"
    with zipfile.ZipFile(built) as file:
        file.extractall(installed)
    empty.mkdir()
    found = subprocess.run(
        [sys.executable, "-P", "-c", LOOK],
        cwd=empty, env=os.environ | {"PYTHONPATH": str(installed)}, check=True, text=True,
        stdout=subprocess.PIPE,
    ).stdout.split()  # fmt: skip
    assert Path(found[0]) == installed / "exunet" / "__init__.py"
    cases = ROOT / "cases"
    folders = (cases / "verification", cases / "hard")
    named = len(list(cases.glob("*.toml"))) + len(list((cases / "verification/trajectories").glob("*.toml")))
    sources = len(list((ROOT / "exunet" / "coupling" / "fmu" / "c").glob("*.c")))
    counts = [named, *(len(list(f.glob("*.toml"))) for f in folders), sources]
    assert [int(number) for number in found[1:]] == counts

"""Killed at any call that leaves something on the disk, and resumed: the whole run's result, bit for bit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import pytest

HERE = Path(__file__).parent
CASES = HERE.parent / "cases"
WALL_TIMES = {"build_seconds", "integration_seconds"}
# The net of small_nets.thrown, which snaps at 0.16 s and 0.24 s, as overrides of the paper's.
SMALL = [
    "net.size=2.0",
    "net.strings.length=1.0",
    "initial.packing=0.5",
    "launch.radial_speed=5.0",
    "time={end=0.26, output_step=0.005}",
]
RETRIES = [*SMALL, "effects.rayleigh_damping.beta=0.0", "solver={method='RK44', step=2.3e-4}"]
BACKENDS = {
    "exudyn": ["engine.backend=exudyn"],
    "compiled": ["engine.backend=compiled"],
}
# name: case, overrides, form, [s] between checkpoints, kills and what follows each
SCENES: dict[str, tuple[str, list[str], str, float, list[tuple[str, int, bool, str]]]] = {
    "snaps": ("planar_deployment", SMALL, "compiled", 0.04, [
        ("rename", 1, False, "run again"), ("attempt", 4, False, "resumed from its start"),
        ("checkpoint", 2, True, "resumed"), ("append", 2, True, "resumed"),
        ("append", 1, False, "resumed from its start"),
        ("write", 5, False, "resumed"), ("rename", 2, True, "resumed"), ("discard", 1, True, "was whole"),
    ]),
    "retries": ("planar_deployment", RETRIES, "exudyn", 0.04, [
        ("retry", 1, True, "resumed"), ("drop", 1, False, "resumed"), ("drop", 1, True, "resumed"),
    ]),
    "breaks": ("effects/breaking", [], "exudyn", 0.002, [("checkpoint", 2, True, "resumed")]),
    "launched": ("effects/launch_force", [], "compiled", 0.05, [("append", 2, True, "resumed")]),
}  # fmt: skip

pytestmark = pytest.mark.skipif(os.name != "posix", reason="forks, and sends SIGKILL")


def content(path: Path) -> dict[str, Any]:
    """All that is in a result file, the datasets as bytes; of the provenance all but the wall times."""
    found: dict[str, Any] = {}

    def take(name: str, one: Any) -> None:
        found[name] = {key: value for key, value in one.attrs.items()}  # noqa: C416 - h5py's are no mapping
        if isinstance(one, h5py.Dataset):
            found[name] |= {"shape": one.shape, "bytes": one[()].tobytes()}

    with h5py.File(path) as file:
        found["/"] = {key: value for key, value in file.attrs.items() if key != "provenance"}
        found["provenance"] = json.loads(file.attrs["provenance"])
        file.visititems(take)
    for name in WALL_TIMES:
        del found["provenance"][name]
    return found


@pytest.mark.ci_for("snaps")
@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_killed_runs_are_resumed_to_the_same_bits(tmp_path: Path, scene: str) -> None:
    case, overrides, form, every, kills = SCENES[scene]
    job = {
        "case": str(CASES / f"{case}.toml"),
        "overrides": [*overrides, *BACKENDS[form]],
        "every": every,
        "folder": str(tmp_path),
        "kills": [kill[:3] for kill in kills],
    }
    command = [sys.executable, str(HERE / "kill_points.py"), json.dumps(job)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [follows for *_, follows in kills]
    whole = content(tmp_path / "whole" / "result.h5")
    for number, kill in enumerate(kills):
        ours = content(tmp_path / f"kill{number}" / "result.h5")
        assert set(ours) == set(whole), kill
        assert [name for name in whole if ours[name] != whole[name]] == [], kill

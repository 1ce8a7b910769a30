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
FORMS = {
    "connectors": ["engine.net=connectors"],
    "fused": ["engine.net=fused"],
    "compiled": ["engine.loop=compiled"],
}
# name: case, overrides, [s] between checkpoints
SCENES: dict[str, tuple[str, list[str], float]] = {
    "snaps": ("planar_deployment", SMALL, 0.04),
    "retries": (
        "planar_deployment",
        [*SMALL, "effects.rayleigh_damping.beta=0.0", "solver={method='RK44', step=2.3e-4}"],
        0.04,
    ),
    "breaks": ("effects/breaking", [], 0.002),
    "viscous": ("effects/material_damping", [], 0.002),
    "launched": ("effects/launch_force", [], 0.05),
    "diverges": (
        "planar_deployment",
        [*SMALL, "solver={method='RK44', step=4e-3, force=true, retry=0}"],
        0.01,
    ),
}

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
    assert set(found["provenance"]) >= WALL_TIMES
    for name in WALL_TIMES:
        del found["provenance"][name]
    return found


def killed_and_resumed(
    folder: Path, scene: str, form: str, kills: int, *, again: int = 1, seed: int = 1, **more: Any
) -> dict[str, Any]:
    """Kill runs, resume them, compare; returns what `kill_points` tells.

    again : resumptions that are killed too, at most
    """
    case, overrides, every = SCENES[scene]
    job = {
        "case": str(CASES / f"{case}.toml"),
        "overrides": [*overrides, *FORMS[form]],
        "every": every,
        "folder": str(folder),
        "kills": kills,
        "again": again,
        "seed": seed,
        **more,
    }
    done = subprocess.run(
        [sys.executable, str(HERE / "kill_points.py"), json.dumps(job)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    whole = content(folder / "whole" / "result.h5")
    if "without" in job:
        assert content(folder / "without" / "result.h5") == whole
    for number, story in enumerate(told["stories"]):
        ours = content(folder / f"kill{number}" / "result.h5")
        assert set(ours) == set(whole), story
        assert [name for name in whole if ours[name] != whole[name]] == [], story
    return told


def resumed(told: dict[str, Any]) -> int:
    """Runs that went on from a checkpoint."""
    return sum(any("checkpoint-" in words for words in story) for story in told["stories"])


@pytest.mark.slow
@pytest.mark.parametrize("form", ["compiled", "fused"])
def test_killed_runs_are_resumed_to_the_same_bits(tmp_path: Path, form: str) -> None:
    """Also: checkpoints change nothing."""
    told = killed_and_resumed(tmp_path, "snaps", form, kills=6, without=True)
    assert resumed(told) >= 2


@pytest.mark.slow
def test_fifty_kills(tmp_path: Path) -> None:
    """At all points, half of them again while they are resumed."""
    told = killed_and_resumed(tmp_path, "snaps", "compiled", kills=50, again=3, seed=50)
    words = [words for story in told["stories"] for words in story]
    for point in ("rename", "remove", "synchronise", "join", "rows", "flush", "snapshot", "stretch"):
        assert any(f"of {point}" in one for one in words), point
    assert resumed(told) >= 20


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("form", FORMS)
def test_kills_of_every_scene_in_every_form(tmp_path: Path, scene: str, form: str) -> None:
    told = killed_and_resumed(tmp_path, scene, form, kills=12, again=2, seed=12, without=True)
    assert resumed(told) >= 3
    if scene == "retries":
        assert told["calls"]["retry"] >= 1

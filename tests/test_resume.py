"""A killed run is continued from its files; what cannot be continued is refused in one line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import pytest
from commands import command

import exunet
from exunet.simulation import run as runs

PLANAR = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
SHORT = ("--set", "time.end=0.3", "--set", "time.output_step=0.02")
CHECKPOINTS = ("--checkpoint-every", "0.1")
IMPLICIT = ("--set", "solver.method=GeneralizedAlpha", "--set", "solver.step=1e-3")


class KilledError(BaseException):
    """Stands for the end of a process."""


def cut_short(folder: Path, at: float, monkeypatch) -> None:
    """A run with checkpoints that ends after a stored time [s] and leaves its files as a kill does."""
    real = runs.drive

    def drive(simulation, recorder, progress, checkpoint):
        def after_each_time():
            checkpoint()
            if simulation.time >= at:
                shutil.copytree(folder / "unfinished", folder / "as it was")
                raise KilledError

        real(simulation, recorder, progress, after_each_time)

    monkeypatch.setattr(runs, "drive", drive)
    with pytest.raises(KilledError):
        runs.run_into(folder, exunet.load(PLANAR, SHORT[1::2]), checkpoint_every=0.1)
    monkeypatch.setattr(runs, "drive", real)
    shutil.rmtree(folder / "unfinished")
    (folder / "as it was").rename(folder / "unfinished")


def datasets(path: Path) -> dict[str, bytes]:
    """The bytes of every dataset of a result."""
    found: dict[str, bytes] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, one: found.update({name: one[()].tobytes()}) if hasattr(one, "shape") else None
        )
    return found


@pytest.mark.parametrize("at", [0.04, 0.2], ids=["before the first checkpoint", "after two"])
def test_the_command_finishes_what_was_cut_short(tmp_path, monkeypatch, at):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert command("run", PLANAR, *SHORT, *CHECKPOINTS, "--out", whole, folder=tmp_path).returncode == 0
    cut.mkdir()
    cut_short(cut, at, monkeypatch)
    done = command("resume", cut, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in cut.iterdir()} == {path.name for path in whole.iterdir()}
    assert datasets(cut / "result.h5") == datasets(whole / "result.h5")
    steps = [json.loads((folder / "summary.json").read_text())["engine"]["steps"] for folder in (whole, cut)]
    assert steps[0] == steps[1]
    again = command("resume", cut, folder=tmp_path)
    assert again.returncode == 2
    assert again.stderr == f"{cut}: there is no unfinished run in this folder\n"


def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path, monkeypatch):
    cut_short(tmp_path, 0.2, monkeypatch)
    (checkpoint,) = (tmp_path / "unfinished").glob("checkpoint-*.exu")
    content = bytearray(checkpoint.read_bytes())
    content[len(content) // 2] ^= 1
    checkpoint.write_bytes(content)
    done = command("resume", tmp_path, folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"{checkpoint}: damaged or cut short")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--checkpoint-every", "0"), "must be positive and finite, got 0 s"),
        (("--checkpoint-every", "-1"), "must be positive and finite, got -1 s"),
        (("--checkpoint-every", "nan"), "must be positive and finite, got nan s"),
        (("--checkpoint-every", "inf"), "must be positive and finite, got inf s"),
        ((*CHECKPOINTS, *IMPLICIT), "GeneralizedAlpha of Exudyn cannot restart exactly"),
    ],
)
def test_checkpoints_that_cannot_be_made_leave_an_earlier_result(tmp_path, arguments, words):
    (tmp_path / "result.h5").write_text("of an earlier run")
    done = command("run", PLANAR, *SHORT, *arguments, "--out", tmp_path, folder=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["result.h5"]


def test_there_is_nothing_to_resume(tmp_path):
    for folder in (tmp_path, tmp_path / "absent"):
        done = command("resume", folder, folder=tmp_path)
        assert done.returncode == 2
        assert done.stderr == f"{folder}: there is no unfinished run in this folder\n"

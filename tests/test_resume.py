"""A killed run is continued from its files; what cannot be continued is refused in one line."""

from __future__ import annotations

import json
import shutil
import sqlite3
from pathlib import Path

import h5py
import pytest
from commands import KilledError, command, cut_short

import exunet
from exunet.base.errors import InputError, UnsoundStates
from exunet.cli import run as command_run
from exunet.results.store import STORE_FILE
from exunet.simulation import run as runs

PLANAR = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
SHORT = ("--set", "time.end=0.3", "--set", "time.output_step=0.02")
CHECKPOINTS = ("--checkpoint-every", "0.1")
CASE = exunet.load(PLANAR, SHORT[1::2])
IMPLICIT = ("--set", "solver.method=GeneralizedAlpha", "--set", "solver.step=1e-3")


def datasets(path: Path) -> dict[str, bytes]:
    """The bytes of every dataset of a result."""
    found: dict[str, bytes] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, one: found.update({name: one[()].tobytes()}) if hasattr(one, "shape") else None
        )
    return found


@pytest.mark.slow
@pytest.mark.parametrize("at", [
    pytest.param(0.04, id="before the first checkpoint", marks=pytest.mark.slow),
    pytest.param(0.2, id="after two"),
])  # fmt: skip
def test_the_command_finishes_what_was_cut_short(tmp_path, at):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert command("run", PLANAR, *SHORT, *CHECKPOINTS, "--out", whole, folder=tmp_path).returncode == 0
    cut_short(cut, CASE, at, every=0.1)
    done = command("resume", cut, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in cut.iterdir()} == {path.name for path in whole.iterdir()}
    assert datasets(cut / "result.h5") == datasets(whole / "result.h5")
    steps = [json.loads((folder / "summary.json").read_text())["cost"]["steps"] for folder in (whole, cut)]
    assert steps[0] == steps[1]
    assert command("resume", cut, folder=tmp_path).returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize(("stored", "asked", "runs_after_it"), [(0, None, 0), (9, None, 9), (9, 0, 0)])
def test_a_resumed_run_has_the_moved_starts_of_the_run(tmp_path, monkeypatch, stored, asked, runs_after_it):
    """Unless `resume` asks for another number."""
    made = []

    def killed(*_: object) -> None:
        raise KilledError

    def moved_starts(_start: object, runs: int, **_: object) -> None:
        made.append(runs)
        raise InputError("not run in this test")

    arguments = ("run", PLANAR, "--set", "time.end=0.02", "--out", "here", "--quiet", "--spread", stored)
    with monkeypatch.context() as patch:
        patch.setattr(runs, "drive", killed)
        with pytest.raises(KilledError):
            command(*arguments, folder=tmp_path)
    monkeypatch.setattr(command_run, "spread_of", moved_starts)
    assert command_run.resume_run(tmp_path / "here", quiet=True, spread=asked) is None
    assert made == [runs_after_it] * (runs_after_it > 0)


@pytest.mark.ci_for("True")
@pytest.mark.slow
@pytest.mark.parametrize("changed", [False, True])
def test_a_resumed_run_has_the_check_and_the_estimate_of_the_run(tmp_path, monkeypatch, capsys, changed):
    """Both were left out without a word. The case is that of the run, whatever became of its file since."""

    def killed(*_: object) -> None:
        raise KilledError

    case = tmp_path / "own.toml"
    shutil.copy(PLANAR, case)
    asked = ("--check", "--estimate-error", "--spread", 0)
    with monkeypatch.context() as patch:
        patch.setattr(runs, "drive", killed)
        with pytest.raises(KilledError):
            command("run", case, *SHORT, *asked, "--out", "here", "--quiet", folder=tmp_path)
    if changed:
        case.write_text("damaged", encoding="utf-8")
    assert command_run.resume_run(tmp_path / "here") is None
    assert "estimated error" in capsys.readouterr().out
    summary = json.loads((tmp_path / "here" / "summary.json").read_text())
    assert summary["check"]["compared_until_s"] == 0.3
    assert summary["check"]["apart_from_s"] is None
    assert summary["error_estimate"]["of"] == "bullets"


def test_a_damaged_checkpoint_is_refused(tmp_path):
    cut_short(tmp_path, CASE, 0.2, every=0.1)
    with sqlite3.connect(tmp_path / STORE_FILE) as db:
        db.execute("UPDATE checkpoint SET crc = crc + 1")
    db.close()
    done = command("resume", tmp_path, folder=tmp_path)
    assert done.returncode == 2
    assert f"{tmp_path / STORE_FILE}: damaged" in done.stderr


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
        assert command("resume", folder, folder=tmp_path).returncode == 2


@pytest.mark.slow
def test_a_run_that_leaves_no_result_gives_the_earlier_one_back(tmp_path, monkeypatch):
    """Whatever fails when the rows are joined; what cannot become a result is not kept to be resumed."""
    arguments = ("run", PLANAR, *SHORT, "--out", "here")
    assert command(*arguments, folder=tmp_path).returncode == 0
    here = tmp_path / "here"
    before = {path.name: path.read_bytes() for path in here.iterdir()}

    def fails(*_: object) -> None:
        raise error

    monkeypatch.setattr(runs, "write_rows", fails)
    for error, left in ((UnsoundStates("NaN"), set()), (InputError("the disk is full"), {STORE_FILE})):
        done = command(*arguments, "--overwrite", folder=tmp_path)
        assert done.returncode == 2
        assert str(error) in done.stderr
        assert {path.name for path in here.iterdir()} == set(before) | left
        assert all((here / name).read_bytes() == content for name, content in before.items())
    monkeypatch.undo()
    assert command("resume", "here", folder=tmp_path).returncode == 0
    assert {path.name for path in here.iterdir()} == set(before)


@pytest.mark.ci
@pytest.mark.slow
def test_a_killed_run_keeps_the_earlier_result_until_it_is_resumed(tmp_path):
    cut_short(tmp_path, CASE, 0.2, every=0.1)
    (tmp_path / "result.h5").write_text("of an earlier run")
    with sqlite3.connect(tmp_path / STORE_FILE) as db:
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")  # all is in the file
    db.close()
    content = (tmp_path / STORE_FILE).read_bytes()
    (tmp_path / STORE_FILE).write_bytes(b"damaged" + content[7:])
    assert command("resume", tmp_path, folder=tmp_path).returncode == 2
    assert (tmp_path / "result.h5").read_text() == "of an earlier run"
    (tmp_path / STORE_FILE).write_bytes(content)
    assert command("resume", tmp_path, folder=tmp_path).returncode == 0
    assert exunet.load_result(tmp_path).complete
    assert not list(tmp_path.glob(f"{STORE_FILE}*"))

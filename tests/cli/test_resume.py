"""A killed run: what its folder has, what is resumed and what refused; resumed results agree bitwise."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from commands import (
    PATIENCE,
    PLANAR,
    WRITING_OFTEN,
    KilledError,
    command,
    content,
    cut_short,
    process,
    wait_until,
)
from restarts import KILLED_SCENES, in_new_process, killed_and_resumed

import exunet
from exunet.base.errors import InputError, UnsoundStates
from exunet.base.files import replacing, sweep
from exunet.cli import run as command_run
from exunet.results.store import STORE_FILE
from exunet.simulation import run as runs
from exunet.simulation.run import Checkpoints, run_into

SETTINGS = ("--set", "time.end=0.3", "--set", "time.output_step=0.02")
CASE = exunet.load(PLANAR, SETTINGS[1::2])
posix = pytest.mark.skipif(os.name != "posix", reason="forks, and sends SIGKILL")


def values(path: Path) -> dict[str, Any]:
    """All that is in a result file, the datasets as bytes; of the record all but the wall times."""
    found: dict[str, Any] = {}

    def take(name: str, item: Any) -> None:
        found[name] = {key: value for key, value in item.attrs.items()}  # noqa: C416 - h5py's are no mapping
        if isinstance(item, h5py.Dataset):
            found[name] |= {"shape": item.shape, "bytes": item[()].tobytes()}

    with h5py.File(path) as file:
        found["/"] = {key: value for key, value in file.attrs.items() if key != "run"}
        found["run"] = json.loads(file.attrs["run"])
        file.visititems(take)
    for name in ("build_seconds", "integration_seconds"):
        del found["run"]["cost"][name]
    return found


@posix
@pytest.mark.ci_for("snaps")
@pytest.mark.slow
@pytest.mark.parametrize("scene", KILLED_SCENES)
def test_killed_runs_are_resumed_to_the_same_bits(tmp_path: Path, scene: str) -> None:
    """Killed at any call that leaves something on the disk: in a process without threads, which may fork."""
    kills = KILLED_SCENES[scene].kills
    assert in_new_process(killed_and_resumed, scene, tmp_path) == [follows for *_, follows in kills]
    whole = values(tmp_path / "whole" / "result.h5")
    for number, kill in enumerate(kills):
        ours = values(tmp_path / f"kill{number}" / "result.h5")
        assert set(ours) == set(whole), kill
        assert [name for name in whole if ours[name] != whole[name]] == [], kill


@pytest.mark.slow
def test_every_part_that_is_stored_is_a_beginning_of_the_result(tmp_path, monkeypatch):
    """Bit for bit; what another process could read after every fifth of the checkpoints.

    States are stored when the guards have looked at them, which they do 256 steps at a time.
    """
    parts = []
    checkpoint = Checkpoints.__call__

    def look(self):
        checkpoint(self)
        if round(self._simulation.time / 2e-4) % 50 == 0:
            parts.append(exunet.load_result(tmp_path))

    monkeypatch.setattr(Checkpoints, "__call__", look)
    whole = run_into(
        tmp_path, exunet.load(PLANAR, ["time.end=0.12", "time.output_step=2e-4"]), checkpoint_every=0.002
    )
    assert whole.complete
    sizes = [len(part.time) for part in parts]
    assert len(sizes) == 12
    assert sizes == sorted(sizes)
    assert len(set(sizes)) == 3  # the start; 256 and 512 steps, one to a stored time
    assert 601 - sizes[-1] <= 256
    for part in parts:
        assert not part.complete
        for name in ("time", "position", "velocity", "tension", "dissipated", "largest_elastic"):
            ours, theirs = (np.asarray(getattr(item, name)) for item in (part, whole))
            assert np.array_equal(ours, theirs[: len(ours)]), name


def left_by_a_kill(folder: Path) -> str:
    """What a killed run has left: "absent" or "part"."""
    assert len(list(folder.glob(".exunet-*.part"))) <= 1
    assert not (folder / "result.h5").exists()
    assert not (folder / "summary.json").exists()
    try:
        result = exunet.load_result(folder)
    except InputError:  # not a state yet
        return "absent"
    assert not result.complete
    assert np.isfinite(result.position).all()
    assert np.array_equal(result.time, 0.02 * np.arange(len(result.time)))
    return "part"


@posix
@pytest.mark.slow
def test_kill_minus_9_in_a_loop(tmp_path):
    """At once, or when states have been written for the n-th time; over and over in one folder."""
    random, kills = np.random.default_rng(20210616), 6
    folder, wal = tmp_path / "run", tmp_path / "run" / f"{STORE_FILE}-wal"
    left = []

    def started(end: float) -> subprocess.Popen[str]:
        settings = ("--set", f"time.end={end}", "--set", "time.output_step=0.02")
        arguments = ("run", PLANAR, *settings, "--out", folder, "--overwrite")
        return process(*arguments, folder=tmp_path, program=WRITING_OFTEN)

    for number in range(kills):
        enough, seen = int(random.integers(1, 12)) * (number > 0), set()
        running = started(1000.0)

        def written() -> bool:
            with suppress(OSError):
                seen.add(wal.stat().st_mtime_ns)  # noqa: B023 - called at once
            return len(seen) > enough or running.poll() is not None  # noqa: B023

        if number:
            wait_until(written, running)
        running.kill()
        running.communicate()
        left.append(left_by_a_kill(folder))
    assert left[0] == "absent"
    assert left.count("part") >= kills // 3
    last = started(0.4)
    last.communicate(timeout=PATIENCE)
    assert last.returncode == 0
    assert list(folder.glob(".exunet-*.part")) == []
    result = exunet.load_result(folder)
    assert result.complete
    assert np.array_equal(result.time, 0.02 * np.arange(21))


def test_what_a_dead_process_left_is_swept_and_what_a_living_one_writes_is_not(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    stale = tmp_path / f".exunet-{dead.pid}-00000000.part"
    stale.write_bytes(b"half a file")
    other = tmp_path / ".exunet-notes.part"
    other.write_text("not a part of ours")
    with replacing(tmp_path / "result.h5") as part:
        part.write_text("being written")
        sweep(tmp_path)
        assert part.exists()
    assert not stale.exists()
    assert other.exists()


# The command


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.04, 0.2], ids=["before the first checkpoint", "after two"])
def test_the_command_finishes_what_was_cut_short(tmp_path, at):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    done = command("run", PLANAR, *SETTINGS, "--checkpoint-every", 0.1, "--out", whole, folder=tmp_path)
    assert done.returncode == 0
    cut_short(cut, CASE, at, every=0.1)
    done = command("resume", cut, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert set(content(cut)) == set(content(whole))
    assert values(cut / "result.h5") == values(whole / "result.h5")
    assert command("resume", cut, folder=tmp_path).returncode == 2


@pytest.mark.parametrize(
    ("arguments", "code"), [(["show", "cut"], 2), (["compare", "cut", "cut"], 2), (["plot", "cut"], 0)]
)
def test_a_killed_run_is_called_unfinished(tmp_path, arguments, code):
    cut_short(tmp_path / "cut", CASE, 0.04, every=0.02)
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == code
    assert "unfinished run" in done.stderr
    assert "exunet resume cut" in done.stderr


def begun(tmp_path: Path, *arguments: object) -> Path:
    """Folder of a run with these options that is killed at its start."""

    def killed(*_: object) -> None:
        raise KilledError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "drive", killed)
        with pytest.raises(KilledError):
            command("run", *arguments, *SETTINGS, "--out", "here", "--quiet", folder=tmp_path)
    return tmp_path / "here"


@pytest.mark.slow
@pytest.mark.parametrize(("stored", "requested", "perturbed"), [(0, None, []), (9, None, [9]), (9, 0, [])])
def test_a_resumed_run_has_the_perturbed_runs_of_the_run(tmp_path, monkeypatch, stored, requested, perturbed):
    """Unless `resume` has another number."""
    made = []

    def perturbed_runs(_start: object, runs: int, **_: object) -> None:
        made.append(runs)
        raise InputError("not run in this test")

    here = begun(tmp_path, PLANAR, "--ensemble", stored)
    monkeypatch.setattr(command_run, "perturbed_runs", perturbed_runs)
    assert command_run.resume_run(here, quiet=True, runs=requested) is None
    assert made == perturbed


@pytest.mark.slow
def test_a_resumed_run_has_the_check_and_the_estimate_of_the_run(tmp_path):
    """Of the case that the run was started with, whatever its file has become."""
    case = tmp_path / "own.toml"
    shutil.copy(PLANAR, case)
    here = begun(tmp_path, case, "--check", "--estimate-error", "--ensemble", 0)
    case.write_text("damaged", encoding="utf-8")
    assert command_run.resume_run(here, quiet=True) is None
    summary = json.loads((here / "summary.json").read_text())
    assert summary["check"]["compared_until_s"] == 0.3
    assert summary["check"]["apart_from_s"] is None
    assert summary["error_estimate"]["of"] == "bullets"


@pytest.mark.slow
def test_a_damaged_run_keeps_the_earlier_result_until_it_is_mended_and_resumed(tmp_path):
    cut_short(tmp_path, CASE, 0.2, every=0.1)
    (tmp_path / "result.h5").write_text("of an earlier run")
    path = tmp_path / STORE_FILE
    with sqlite3.connect(path) as db:
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")  # all is in the file
    db.close()
    sound = path.read_bytes()
    with sqlite3.connect(path) as db:
        db.execute("UPDATE checkpoint SET crc = crc + 1")
    db.close()
    for damaged in (path.read_bytes(), b"damaged" + sound[7:], sound[: len(sound) // 2]):
        path.write_bytes(damaged)
        assert command("resume", tmp_path, folder=tmp_path).returncode == 2
        assert (tmp_path / "result.h5").read_text() == "of an earlier run"
    path.write_bytes(sound)
    assert command("resume", tmp_path, folder=tmp_path).returncode == 0
    assert exunet.load_result(tmp_path).complete
    assert not list(tmp_path.glob(f"{STORE_FILE}*"))


@pytest.mark.parametrize(
    "arguments",
    [
        ("--checkpoint-every", "0"),
        ("--checkpoint-every", "nan"),
        ("--checkpoint-every", "0.1", "--set", "solver={method='GeneralizedAlpha', step=1e-3}"),
    ],
)
def test_checkpoints_that_cannot_be_made_leave_an_earlier_result(tmp_path, arguments):
    (tmp_path / "result.h5").write_text("of an earlier run")
    done = command("run", PLANAR, *SETTINGS, *arguments, "--out", tmp_path, folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("--checkpoint-every: ")
    assert content(tmp_path) == {"result.h5": b"of an earlier run"}


def test_there_is_nothing_to_resume(tmp_path):
    for folder in (tmp_path, tmp_path / "absent"):
        assert command("resume", folder, folder=tmp_path).returncode == 2


@pytest.mark.slow
def test_a_run_that_leaves_no_result_gives_the_earlier_one_back(tmp_path, monkeypatch):
    """Whatever fails when the rows are joined; states that are not finite are not kept to be resumed."""
    arguments, here = ("run", PLANAR, *SETTINGS, "--out", "here"), tmp_path / "here"
    assert command(*arguments, folder=tmp_path).returncode == 0
    before = content(here)

    for error, left in ((UnsoundStates("NaN"), set()), (InputError("the disk is full"), {STORE_FILE})):

        def fails(*_: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(runs, "write_rows", fails)
        assert command(*arguments, "--overwrite", folder=tmp_path).returncode == 2
        now = content(here)
        assert set(now) == set(before) | left
        assert {name: now[name] for name in before} == before
    monkeypatch.undo()
    assert command("resume", "here", folder=tmp_path).returncode == 0
    assert set(content(here)) == set(before)

"""Messages about wrong input name the file, key or option that is wrong, once, and advise what helps."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from commands import command
from result_samples import square_net, unfolding

import exunet
from exunet.simulation import expected_time

CASES = Path(__file__).parent.parent / "cases"
PLANAR = CASES / "planar_deployment.toml"
SHORT = ("--set", "time.end=0.02", "--set", "time.output_step=0.01")
BODIES = CASES / "bodies"


@pytest.mark.parametrize(
    ("case", "override", "key", "words"),
    [
        ("bodies/tow.toml", "tethers.tow.divisions=1000000000", "tethers.tow.divisions", "at most 1,000,000"),
        ("planar_deployment.toml", "time.end=1e18", "time.end", "1e+21 states; at most 10,000,000"),
        ("planar_deployment.toml", "time.output_step=1e-12", "time.output_step", "2e+12 states"),
        ("planar_deployment.toml", "solver.tolerance=1e-20", "solver.tolerance",
         "1e-20 is below the round-off 6e-16 m/s of initial speeds up to 2.5 m/s"),
        ("nets/accordion.toml", "initial.packing=0.5", "initial.packing", "exactly one of packing"),
        ("bodies/tow.toml", "bodies.chaser.position=[1e300,0.0,0.0]", "bodies.chaser.position[0]",
         "not realistic"),
        ("bodies/frame.toml", "bodies.frame.position=[0.0,1e300,0.0]", "bodies.frame.position[1]",
         "not realistic"),
        ("bodies/ejection.toml", "bodies.chaser.position=[1e20,0.0,0.0]", "bodies.chaser.position",
         "1e+20 m"),
        ("planar_deployment.toml", "bodies.one={mass=1.0,shape='mesh',file='absent.stl',unit='m'}",
         "bodies.one.file", "absent.stl: no such file"),
    ],
)  # fmt: skip
def test_the_key_that_was_changed_is_named_once(tmp_path, case, override, key, words):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = command("check", CASES / case, "--set", override, folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("--set ")
    assert f": {key}: " in done.stderr
    assert words in done.stderr


def test_of_two_keys_that_contradict_each_other_the_last_is_named(tmp_path):
    text = (CASES / "nets" / "accordion.toml").read_text()
    (tmp_path / "case.toml").write_text(
        text.replace("[initial.fold]", "[initial]\npacking = 0.5\n[initial.fold]")
    )
    done = command("check", "case.toml", folder=tmp_path)
    line = next(n for n, words in enumerate(text.splitlines(), 2) if words == "[initial.fold]") + 1
    assert done.stderr.startswith(f"case.toml:{line}: initial.fold: ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", PLANAR, *SHORT, "--checkpoint-every", 0), "--checkpoint-every: the simulated time between"),
        (("ensemble", PLANAR, *SHORT, "-n", 0), "--runs: must be a whole number, 1 or more, got 0"),
        (("ensemble", PLANAR, *SHORT, "--perturb", 10), "give 0.55 m or less"),
        (("ensemble", PLANAR, *SHORT, "--seed", -1), "--seed: must be a whole number"),
        (("effects", PLANAR, "--accuracy", "nan"), "--accuracy"),
        (("effects", PLANAR, "--accuracy", "inf"), "--accuracy"),
        (("effects", PLANAR, "--accuracy", -1), "--accuracy"),
        (("cost", PLANAR, "--budget", -1), "--budget"),
        (("cost", PLANAR, "--runs", 0), "--runs"),
        (("verify", PLANAR, "--processes", 0), "--processes"),
        (("run", PLANAR, *SHORT, "--spread", 3), "must be 0, or from 8 to 100000"),
        (("fmu", PLANAR, "--fmi", 4), "--fmi: must be 2 or 3, got 4"),
        (("animate", ".", "--fps", 0), "--fps: must be above 0 and at most 50 for .gif, got 0"),
    ],
)
def test_the_option_that_is_wrong_is_named(tmp_path, arguments, words):
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("animate", "result.h5", "--from", 2.0), "--from, --until: no stored time"),
        (("plot", "result.h5", "--format", "gif"), "--format: must be one of pdf, svg, png, got 'gif'"),
        (("plot", "result.h5", "--width", 3), "--width: must be"),
        (("plot", "result.h5", "--figure", "speeds"), "--figure: 'speeds' is not one of"),
        (("plot", "absent: x.h5"), "absent: x.h5: cannot be read"),
    ],
)
def test_of_a_result_too(tmp_path, arguments, words):
    """They named the argument of the function in Python."""
    exunet.save(unfolding(square_net()), tmp_path / "result.h5")
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(words)
    assert [path.name for path in tmp_path.iterdir()] == ["result.h5"]


@pytest.mark.parametrize("name", ["run", "ensemble", "cost"])
def test_a_file_in_place_of_a_folder_is_told_as_such(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    done = command(name, PLANAR, *SHORT, "--out", "file", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "file: cannot be written: there is a file of that name, where a folder is needed\n"
    done = command(name, PLANAR, *SHORT, "--out", "file/more", folder=tmp_path)
    assert done.stderr == "file/more: cannot be written: a part of this path is a file, and no folder\n"


@pytest.mark.ci
@pytest.mark.slow
def test_the_file_of_a_spread_is_not_taken_for_a_foreign_one(tmp_path):
    assert command("ensemble", PLANAR, *SHORT, "-n", 8, "--out", "here", folder=tmp_path).returncode == 0
    done = command("plot", "here/ensemble.h5", folder=tmp_path)
    assert done.returncode == 2
    assert "has the runs of an ensemble, or of the spread beside a result.h5" in done.stderr


def test_a_spread_beyond_the_memory_is_refused_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(expected_time, "memory_left", lambda: 10**9)
    done = command("run", PLANAR, *SHORT, "--spread", 50_000, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("--spread: ")
    assert list(tmp_path.iterdir()) == []

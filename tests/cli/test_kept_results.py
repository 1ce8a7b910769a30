"""A finished result is not overwritten unless requested; a second run that fails leaves it bit for bit."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from commands import PLANAR, SHORT, WRITING_OFTEN, command, content, ended, process, wait_until

import exunet
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.files import cannot_write
from exunet.cli.output import folder_of
from exunet.results import run_folder
from exunet.results.run_folder import has_unfinished, held, new_folder
from exunet.results.store import STORE_FILE, FileStore
from exunet.scene.casefile import load
from exunet.simulation import run as runs
from exunet.simulation.run import resume, run_into

VALUES = SHORT[1::2]
STOPS = ("--set", "solver={method='RK44', step=2.5e-2, force=true}", "--set", "time.output_step=0.1",
         "--set", "time.end=1.0")  # fmt: skip
FULL = OSError(28, "No space left on device")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a finished run in "here"."""
    folder = tmp_path_factory.mktemp("finished")
    assert command("run", PLANAR, *SHORT, "--out", "here", folder=folder).returncode == 0
    return folder


@pytest.fixture
def first(finished: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    (tmp_path / "here").mkdir()
    for name, data in content(finished / "here").items():
        (tmp_path / "here" / name).write_bytes(data)
    return tmp_path


def unfinished(folder: Path, *, overwrite: bool = False) -> None:
    """A run in a folder that ends as by a kill, before its first step."""

    def killed(*_: object) -> None:
        raise MemoryError  # not an error of exunet: nothing is tidied up

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "drive", killed)
        with pytest.raises(MemoryError):
            run_into(folder, load(PLANAR, VALUES), overwrite=overwrite)
    assert has_unfinished(folder)


# Folders


@pytest.mark.slow
def test_a_second_run_gets_its_own_folder(tmp_path):
    (tmp_path / "results").mkdir()
    name = folder_of(load(PLANAR, VALUES)).name
    (tmp_path / "results" / f"{name}-2").write_text("a file")
    for expected in ("", "-3"):
        assert command("run", PLANAR, *SHORT, folder=tmp_path).returncode == 0
        assert exunet.load_result(tmp_path / "results" / f"{name}{expected}").complete
    assert (tmp_path / "results" / f"{name}-2").read_text() == "a file"
    assert command("run", PLANAR, *SHORT, "--overwrite", folder=tmp_path).returncode == 0
    names = {path.name for path in (tmp_path / "results").iterdir()}
    assert names == {name, f"{name}-2", f"{name}-3"}


def test_two_runs_at_once_never_choose_the_same_folder(tmp_path):
    made = {new_folder(tmp_path / "results" / "case").name for _ in range(3)}
    assert made == {"case", "case-2", "case-3"}


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ((), "planar_deployment"),
        (("time.end=0.5", "solver.method='ODE23'"), "planar_deployment--time.end=0.5--solver.method=ODE23"),
        (("effects.rayleigh_damping=",), "planar_deployment--effects.rayleigh_damping="),
    ],
)
def test_variants_have_different_names(overrides, name):
    assert folder_of(load(PLANAR, overrides)) == Path("results") / name


def test_names_of_variants_are_safe_and_short():
    awkward = [f"title='{'../' * 20}{letter}'" for letter in "ab"]
    names = [folder_of(load(PLANAR, [item])).name for item in awkward]
    assert names[0] != names[1]
    assert all("/" not in name and len(name) < 80 for name in names)
    many = [f"net.cable.diameter=0.00{k}" for k in range(1, 10)] * 3
    assert len(folder_of(load(PLANAR, many)).name.encode()) < 180
    assert folder_of(load(PLANAR, many)) != folder_of(load(PLANAR, many[:-1]))


# What is refused


@pytest.mark.parametrize("target", ["result.h5", STORE_FILE])
def test_a_folder_that_would_lose_something_is_refused(tmp_path, target):
    path = tmp_path / "here" / target
    path.parent.mkdir(parents=True)
    path.write_text("of an earlier run")
    done = command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("here: ")
    assert ("exunet resume here" in done.stderr) == (target == STORE_FILE)
    assert content(tmp_path) == {f"here/{target}": b"of an earlier run"}


@pytest.mark.parametrize(
    ("arguments", "name"),
    [(("run",), "area.png"), (("run",), "summary.json"), (("ensemble", "-n", 8), "bands.png")],
)
def test_a_run_replaces_no_file_that_it_did_not_write(tmp_path, arguments, name):
    """Figures that `plot` drew of another result, or files that are not exunet's."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / name).write_text("mine")
    done = command(*arguments, PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"here: {name}")
    assert content(tmp_path) == {f"here/{name}": b"mine"}


@pytest.mark.slow
def test_figures_are_drawn_over_those_of_the_same_result_only(first):
    """In the folder of the result they are its own; anywhere else they may show another."""
    here, there = first / "here", first / "there"
    names = ("area.png", "energies.png")
    there.mkdir()
    (there / "area.png").write_text("mine")
    assert command("plot", "here", "--out", "there", folder=first).returncode == 2
    assert content(there) == {"area.png": b"mine"}
    for name in names:
        (here / name).write_text("older")
    for arguments in (("here",), ("here/result.h5", "--out", "there", "--overwrite")):
        assert command("plot", *arguments, folder=first).returncode == 0
    for name in names:
        assert (there / name).read_bytes() == (here / name).read_bytes() != b"older"
    (here / "result.h5").rename(here / "other.h5")  # beside figures of an unknown result
    assert command("plot", "here/other.h5", folder=first).returncode == 2
    assert command("plot", "here/other.h5", "--out", "new", folder=first).returncode == 0


@pytest.mark.slow
def test_a_refused_run_leaves_an_earlier_result(first):
    before = content(first)
    for override in ("net.bullets.mass=1e308", "launch.radial_speed=1e200"):
        arguments = ("run", PLANAR, *SHORT, "--out", "here", "--overwrite", "--set", override)
        assert command(*arguments, folder=first).returncode == 2
    assert content(first) == before


def test_run_into_and_save_follow_the_same_rule(tmp_path):
    result = run_into(tmp_path, load(PLANAR, VALUES))
    before = content(tmp_path)
    with pytest.raises(InputError, match="there is a result"):
        run_into(tmp_path, load(PLANAR, VALUES))
    with pytest.raises(InputError, match="overwrite=True"):
        exunet.save(result, tmp_path / "result.h5")
    assert content(tmp_path) == before
    case = load(PLANAR, [*VALUES, "title=other"])
    assert run_into(tmp_path, case, overwrite=True).run.title == "other"
    exunet.save(result, tmp_path / "result.h5", overwrite=True)
    assert exunet.load_result(tmp_path).run.title == result.run.title


def test_a_folder_is_for_one_run_until_its_last_file_is_written(tmp_path):
    """Also while the figures are drawn, when no more states are stored."""
    refused = []

    def describe(_result: object, _place: Path) -> None:
        with pytest.raises(InputError, match="another process"):
            run_into(tmp_path, load(PLANAR, VALUES), overwrite=True)
        refused.append(True)

    run_into(tmp_path, load(PLANAR, VALUES), describe=describe)
    assert refused
    with held(tmp_path):  # and is free then
        pass


# A second run that replaces, stops, is killed, or meets a full disk


@pytest.mark.slow
def test_overwrite_replaces_result_and_what_described_it(first):
    (first / "here" / "agreement.png").write_text("of the first run's check")
    (first / "here" / "notes.txt").write_text("mine")
    arguments = ("run", PLANAR, *SHORT, "--set", "title=other", "--out", "here", "--overwrite")
    assert command(*arguments, folder=first).returncode == 0
    assert exunet.load_result(first / "here").run.title == "other"
    assert not (first / "here" / "agreement.png").exists()
    assert (first / "here" / "notes.txt").read_text() == "mine"
    assert [path.name for path in first.iterdir()] == ["here"]
    assert not has_unfinished(first / "here")


@pytest.mark.ci
@pytest.mark.slow
def test_a_second_run_that_stops_leaves_the_first(first):
    before = content(first / "here")
    done = command("run", PLANAR, *STOPS, "--out", "here", "--overwrite", folder=first)
    assert done.returncode == 3
    assert content(first / "here") == before
    assert "here-2" in done.stderr
    assert exunet.load_result(first / "here-2").verdict.startswith("diverged")
    assert (first / "here-2" / "summary.json").exists()


@pytest.mark.slow_for("run.drive")
@pytest.mark.parametrize("target", ["run.drive", "run.perturbed_runs", "run.ReferenceRun.agreement"])
def test_ctrl_c_in_a_second_run_leaves_the_first(first, monkeypatch, target):
    """While it runs, and while its perturbed runs and its check are made."""
    runs_itself = target == "run.drive"

    def interrupted(*_: object, **__: object) -> None:
        raise Interrupted("interrupted after t = 0 s") if runs_itself else KeyboardInterrupt

    before = content(first / "here")
    monkeypatch.setattr(f"exunet.{'simulation' if runs_itself else 'cli'}.{target}", interrupted)
    more = {"run.perturbed_runs": ("--ensemble", 8), "run.ReferenceRun.agreement": ("--check",)}.get(
        target, ()
    )
    done = command("run", PLANAR, *SHORT, "--out", "here", "--overwrite", *more, folder=first)
    assert done.returncode == 130
    assert content(first / "here") == before
    assert exunet.load_result(first / "here-2").complete == (not runs_itself)
    assert not has_unfinished(first / "here")


def test_a_stopped_run_raises_its_error_with_the_place(tmp_path):
    with pytest.raises(RunStopped, match="what was computed is in") as stopped:
        run_into(tmp_path, load(PLANAR, STOPS[1::2]))
    assert not stopped.value.result.complete
    assert not has_unfinished(tmp_path)


@pytest.mark.parametrize("target", ["exunet.cli.run.write_summary", "exunet.plots.registry.save_run_figures"])
def test_a_disk_that_is_full_when_a_result_is_described_costs_no_result(first, monkeypatch, target):
    def full(*_: object, **__: object) -> None:
        raise cannot_write("that file", FULL)

    monkeypatch.setattr(target, full)
    before = content(first / "here")
    for out, place in (("here", "here-2"), ("there", "there")):
        done = command("run", PLANAR, *SHORT, "--out", out, "--overwrite", folder=first)
        assert done.returncode == 2
        assert f"what was computed is in {place}" in done.stderr
        assert exunet.load_result(first / place).complete
    assert content(first / "here") == before


@pytest.mark.parametrize("every", [None, 0.01])
def test_a_run_on_a_full_disk_can_be_resumed(tmp_path, monkeypatch, every):
    def full(self: FileStore, rows: dict) -> None:
        if len(self) + len(rows["time"]) > 4:
            raise cannot_write(self.path, FULL)
        append(self, rows)

    append = FileStore.append
    case = load(PLANAR, ["time.end=0.03", "time.output_step=0.005"])
    with monkeypatch.context() as patch:
        patch.setattr(FileStore, "append", full)
        with pytest.raises(InputError, match="No space left on device"):
            run_into(tmp_path, case, checkpoint_every=every)
    store = FileStore(tmp_path / STORE_FILE, read_only=True)
    assert (store.checkpoint is None) == (every is None)
    store.close()
    assert len(resume(tmp_path).time) == 7


@pytest.mark.slow
def test_a_full_disk_leaves_the_first_result(first):
    """The system refuses files above a size: no states, no result can be written."""
    before, program = content(first / "here"), (
        "import resource, signal\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, resource.RLIM_INFINITY))\n"
        "from exunet.cli.main import main\nmain()\n"
    )  # fmt: skip
    many = ("--set", "time.end=0.02", "--set", "time.output_step=0.0001")
    arguments = ("run", PLANAR, *many, "--out", "here", "--overwrite")
    done = ended(process(*arguments, folder=first, program=program))
    assert done.returncode == 2
    assert "exunet resume here" in done.stderr
    now = content(first / "here")
    assert {name: now[name] for name in before} == before
    assert command("resume", "here", folder=first).returncode == 0
    assert len(exunet.load_result(first / "here").time) == 201


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")
def test_a_killed_second_run_leaves_the_first_and_can_be_resumed(first):
    before = content(first / "here")
    settings = ("--set", "time.end=1000", "--set", "time.output_step=0.05", "--out", "here")
    arguments = ("run", PLANAR, *settings, "--overwrite")
    running = process(*arguments, folder=first, program=WRITING_OFTEN)
    wait_until(lambda: has_unfinished(first / "here"), running)
    again = command(*arguments, folder=first)
    assert again.returncode == 2
    assert again.stderr.startswith("here: another process")  # and nothing is moved
    running.send_signal(signal.SIGKILL)
    running.communicate()
    now = content(first / "here")
    assert {name: now[name] for name in before} == before
    refused = command("run", PLANAR, *SHORT, "--out", "here", folder=first)
    assert refused.returncode == 2
    assert "exunet resume here" in refused.stderr


@pytest.mark.slow
def test_an_unfinished_run_is_moved_to_where_it_can_be_resumed(tmp_path):
    (tmp_path / "here").mkdir()
    unfinished(tmp_path / "here")
    done = command("run", PLANAR, *SHORT, "--out", "here", "--overwrite", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert exunet.load_result(tmp_path / "here").complete
    assert command("resume", "here-2", folder=tmp_path).returncode == 0
    assert exunet.load_result(tmp_path / "here-2").complete


@pytest.mark.slow
def test_what_waited_when_a_process_died_is_not_taken_for_the_result(first):
    """Killed between the new result and its place: resumed, it takes the place of the first."""
    unfinished(first / "here", overwrite=True)
    waiting = first / "here" / run_folder.REPLACEMENT
    waiting.mkdir()
    (waiting / "result.h5").write_text("half of it")
    assert command("resume", "here", folder=first).returncode == 0
    assert exunet.load_result(first / "here").complete
    assert not has_unfinished(first / "here")
    assert not waiting.exists()

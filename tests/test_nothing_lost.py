"""A finished result is never overwritten unasked; a second run that fails leaves the first bit for bit."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from commands import WRITING_OFTEN, command, ended, process, wait_until
from test_files_of_cases import CABLE

import exunet
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.files import cannot_write
from exunet.cli import run as command_run
from exunet.cli.folders import folder_of
from exunet.results import run_folder
from exunet.results.run_folder import has_unfinished, held, new_folder
from exunet.results.store import STORE_FILE, FileStore
from exunet.scene.casefile import load, parse_case
from exunet.simulation import run as runs
from exunet.simulation.run import resume, run_into

PLANAR = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"
SHORT = ("--set", "time.end=0.02", "--set", "time.output_step=0.01")
VALUES = SHORT[1::2]
STOPS = ("--set", "solver.method=RK44", "--set", "solver.step=2.5e-2", "--set", "solver.force=true",
         "--set", "time.output_step=0.1", "--set", "time.end=1.0")  # fmt: skip


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a finished run in "here"."""
    folder = tmp_path_factory.mktemp("finished")
    assert command("run", PLANAR, *SHORT, "--out", "here", folder=folder).returncode == 0
    return folder


@pytest.fixture
def first(finished: Path, tmp_path: Path) -> Path:
    """The same, for this test alone."""
    (tmp_path / "here").mkdir()
    for name, data in content(finished / "here").items():
        (tmp_path / "here" / name).write_bytes(data)
    return tmp_path


def unfinished(folder: Path, monkeypatch: pytest.MonkeyPatch, *, overwrite: bool = False) -> None:
    """A run in a folder that ends as by a kill, before its first step."""

    def killed(*_: object) -> None:
        raise MemoryError  # not one of exunet's own: nothing is tidied up

    with monkeypatch.context() as patch:
        patch.setattr(runs, "drive", killed)
        with pytest.raises(MemoryError):
            run_into(folder, load(PLANAR, VALUES), overwrite=overwrite)
    assert has_unfinished(folder)


@pytest.mark.slow
def test_a_second_run_gets_a_folder_of_its_own(tmp_path):
    (tmp_path / "results").mkdir()
    name = folder_of(load(PLANAR, VALUES)).name
    (tmp_path / "results" / f"{name}-2").write_text("a file")
    for expected in ("", "-3"):
        done = command("run", PLANAR, *SHORT, folder=tmp_path)
        assert done.returncode == 0, done.stderr
        assert exunet.load_result(tmp_path / "results" / f"{name}{expected}").complete
    assert f"results/{name} has a result; this run goes to results/{name}-3" in done.stderr
    assert f"results/{name}-3/" in "".join(done.stdout.split())  # folded
    assert (tmp_path / "results" / f"{name}-2").read_text() == "a file"


def test_two_runs_at_once_never_choose_the_same_folder(tmp_path):
    """Each looks, and makes its folder, before the other does: what is made is what nobody had."""
    made = {new_folder(tmp_path / "results" / "case") for _ in range(5)}
    assert {path.name for path in made} == {"case", "case-2", "case-3", "case-4", "case-5"}


@pytest.mark.parametrize("target", ["result.h5", STORE_FILE])
def test_an_explicit_folder_that_would_lose_something_is_refused(tmp_path, target):
    path = tmp_path / "here" / target
    path.parent.mkdir(parents=True)
    path.write_text("of an earlier run")
    before = content(tmp_path)
    done = command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("here: there is ")
    assert "--overwrite" in done.stderr
    assert ("exunet resume here" in done.stderr) == (target == STORE_FILE)
    assert len(done.stderr.splitlines()) == 1
    assert content(tmp_path) == before


@pytest.mark.parametrize("name", ["area.png", "summary.json"])
def test_a_run_replaces_no_file_that_it_did_not_write(tmp_path, name):
    """Figures that `plot` drew of another result, or files that are not exunet's at all."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / name).write_text("mine")
    done = command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert f"here: {name} in this folder would be replaced" in done.stderr
    assert "--overwrite" in done.stderr
    assert content(tmp_path) == {f"here/{name}": b"mine"}
    with pytest.raises(InputError, match="would be replaced"):
        run_into(tmp_path / "here", load(PLANAR, VALUES))


def test_an_ensemble_replaces_no_file_that_it_did_not_write(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "bands.png").write_text("mine")
    done = command("ensemble", PLANAR, *SHORT, "-n", 8, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert "here: bands.png in this folder would be replaced" in done.stderr
    assert content(tmp_path) == {"here/bands.png": b"mine"}


@pytest.mark.slow
def test_figures_are_drawn_over_those_of_the_same_result_only(first):
    """In the folder of the result they are its own; anywhere else they may show another."""
    figures_of_first = [first / "here" / f"{name}.png" for name in ("area", "energies")]
    (first / "there").mkdir()
    (first / "there" / "area.png").write_text("mine")
    before = content(first / "there")
    done = command("plot", "here", "--out", "there", folder=first)
    assert done.returncode == 2
    assert "there: area.png in this folder would be replaced" in done.stderr
    assert "--overwrite" in done.stderr
    assert content(first / "there") == before
    for path in figures_of_first:
        path.write_text("older")
    for arguments in (("here",), ("here/result.h5", "--out", "there", "--overwrite")):
        assert command("plot", *arguments, folder=first).returncode == 0
    for path in figures_of_first:
        assert (first / "there" / path.name).read_bytes() == path.read_bytes() != b"older"
    (first / "here" / "result.h5").rename(first / "here" / "other.h5")  # beside figures of whatever result
    assert command("plot", "here/other.h5", folder=first).returncode == 2
    assert command("plot", "here/other.h5", "--out", "new", folder=first).returncode == 0


@pytest.mark.slow
def test_overwrite_replaces_result_and_what_described_it(first):
    (first / "here" / "agreement.png").write_text("of the first run's check")
    (first / "here" / "notes.txt").write_text("mine")
    done = command(
        "run", PLANAR, *SHORT, "--set", "title=other", "--out", "here", "--overwrite", folder=first
    )
    assert done.returncode == 0, done.stderr
    assert exunet.load_result(first / "here").provenance["title"] == "other"
    assert not (first / "here" / "agreement.png").exists()
    assert (first / "here" / "notes.txt").read_text() == "mine"
    assert [path.name for path in first.iterdir()] == ["here"]
    assert not has_unfinished(first / "here")


@pytest.mark.slow
def test_overwrite_without_out_replaces_the_first_of_its_name(tmp_path):
    name = folder_of(load(PLANAR, VALUES))
    for _ in range(2):
        assert command("run", PLANAR, *SHORT, "--overwrite", folder=tmp_path).returncode == 0
    assert [path.name for path in (tmp_path / "results").iterdir()] == [name.name]


@pytest.mark.slow
def test_a_second_run_that_stops_leaves_the_first_and_says_where_its_part_is(first):
    before = content(first / "here")
    done = command("run", PLANAR, *STOPS, "--out", "here", "--overwrite", folder=first)
    assert done.returncode == 3
    assert content(first / "here") == before
    assert "what was computed is in here-2; here is as it was" in done.stderr
    part = exunet.load_result(first / "here-2")
    assert part.verdict.startswith("diverged")
    assert (first / "here-2" / "summary.json").exists()


@pytest.mark.slow
def test_ctrl_c_in_a_second_run_leaves_the_first(first, monkeypatch):
    def interrupted(*_: object) -> None:
        raise Interrupted("interrupted after t = 0 s")

    before = content(first / "here")
    monkeypatch.setattr(runs, "drive", interrupted)
    done = command("run", PLANAR, *SHORT, "--out", "here", "--overwrite", folder=first)
    assert done.returncode == 130
    assert content(first / "here") == before
    assert not exunet.load_result(first / "here-2").complete


@pytest.mark.slow
def test_ctrl_c_while_the_result_is_written_keeps_the_states(first, monkeypatch):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    before = content(first / "here")
    monkeypatch.setattr(runs, "write_rows", interrupted)
    done = command("run", PLANAR, *SHORT, "--out", "here", "--overwrite", folder=first)
    assert done.returncode == 130
    assert "exunet resume here" in done.stderr
    assert {name: content(first / "here")[name] for name in before} == before
    monkeypatch.undo()
    assert command("resume", "here", folder=first).returncode == 0
    assert not has_unfinished(first / "here")


@pytest.mark.parametrize(
    ("what", "options", "words"),
    [
        ("spread_of", ("--spread", 8), "interrupted during the perturbed runs"),
        ("ReferenceRun.agreement", ("--spread", 0, "--check"), "interrupted while waiting for the reference"),
        ("estimate_error", ("--spread", 0, "--estimate-error"), "interrupted"),
    ],
)
def test_ctrl_c_while_a_second_run_is_described_leaves_the_first(first, monkeypatch, what, options, words):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    before = content(first / "here")
    monkeypatch.setattr(f"{command_run.__name__}.{what}", interrupted)
    done = command("run", PLANAR, *SHORT, *options, "--out", "here", "--overwrite", folder=first)
    assert done.returncode == 130
    assert content(first / "here") == before
    assert words in done.stderr
    assert "what was computed is in here-2; here is as it was" in done.stderr
    assert exunet.load_result(first / "here-2").complete
    assert not has_unfinished(first / "here")


@pytest.mark.slow_for("True-summary")
@pytest.mark.parametrize("what", ["summary", "figures"])
@pytest.mark.parametrize("overwrite", [True, False])
def test_a_disk_that_is_full_when_a_result_is_described_costs_no_result(first, monkeypatch, what, overwrite):
    def full(*arguments: object, **keywords: object) -> None:
        raise cannot_write("that file", OSError(28, "No space left on device"))

    name = {
        "summary": "exunet.cli.run.write_summary",
        "figures": "exunet.plots.registry.save_figures",
    }
    monkeypatch.setattr(name[what], full)
    before = content(first / "here")
    out = "here" if overwrite else "there"
    done = command("run", PLANAR, *SHORT, "--out", out, *(["--overwrite"] if overwrite else []), folder=first)
    assert done.returncode == 2
    assert "No space left on device" in done.stderr
    assert content(first / "here") == before
    place = "here-2" if overwrite else "there"
    assert f"what was computed is in {place}" in done.stderr
    assert exunet.load_result(first / place).complete


@pytest.mark.parametrize(("every", "whence"), [(None, "from its start"), (0.04, "from the last checkpoint")])
def test_a_run_on_a_full_disk_can_be_resumed(tmp_path, monkeypatch, every, whence):
    def full(self: FileStore, rows: dict) -> None:
        if len(self) + len(rows["time"]) > 4:
            raise cannot_write(self.path, OSError(28, "No space left on device"))
        append(self, rows)

    append = FileStore.append
    case = parse_case(CABLE, tmp_path / "cable.toml", ["time.output_step=0.02"])
    with monkeypatch.context() as patch:
        patch.setattr(FileStore, "append", full)
        with pytest.raises(InputError, match=f"No space left on device; to go on {whence}: exunet resume"):
            run_into(tmp_path, case, checkpoint_every=every)
    assert len(resume(tmp_path).time) == 6


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
    last = done.stderr.splitlines()[-1]
    assert "exunet resume here" in last
    now = content(first / "here")
    assert {name: now[name] for name in before} == before
    done = command("resume", "here", folder=first)
    assert done.returncode == 0, done.stderr
    assert len(exunet.load_result(first / "here").time) == 201


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")
def test_a_killed_second_run_leaves_the_first_and_can_be_resumed(first):
    before = content(first / "here")
    arguments = ("run", PLANAR, "--set", "time.end=1000", "--set", "time.output_step=0.05", "--out", "here")
    running = process(*arguments, "--overwrite", folder=first, program=WRITING_OFTEN)
    wait_until(lambda: has_unfinished(first / "here"), running)
    again = command(*arguments, "--overwrite", folder=first)
    assert again.returncode == 2
    assert again.stderr.startswith("here: another process is writing there")  # and nothing is put aside
    running.send_signal(signal.SIGKILL)
    running.communicate()
    now = content(first / "here")
    assert {name: now[name] for name in before} == before
    refused = command("run", PLANAR, *SHORT, "--out", "here", folder=first)
    assert refused.returncode == 2
    assert "exunet resume here" in refused.stderr


@pytest.mark.slow
def test_an_unfinished_run_is_put_aside_where_it_can_be_resumed(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    unfinished(tmp_path / "here", monkeypatch)
    done = command("run", PLANAR, *SHORT, "--out", "here", "--overwrite", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "moved into a folder beside" in done.stderr
    assert exunet.load_result(tmp_path / "here").complete
    assert command("resume", "here-2", folder=tmp_path).returncode == 0
    assert exunet.load_result(tmp_path / "here-2").complete


@pytest.mark.slow
def test_what_waited_when_a_process_died_is_not_taken_for_the_result(first, monkeypatch):
    """Killed between the new result and its place: resumed, it takes the place of the first."""
    unfinished(first / "here", monkeypatch, overwrite=True)
    waiting = first / "here" / run_folder.REPLACEMENT
    waiting.mkdir()
    (waiting / "result.h5").write_text("half of it")
    assert command("resume", "here", folder=first).returncode == 0
    assert exunet.load_result(first / "here").complete
    assert not has_unfinished(first / "here")
    assert not waiting.exists()


def test_a_folder_is_for_one_run_until_its_last_file_is_there(tmp_path):
    """Also while the figures are drawn, when no states are stored any more."""
    refused = []

    def describe(_result: object, _place: Path) -> None:
        with pytest.raises(InputError, match="another process is writing there"):
            run_into(tmp_path, load(PLANAR, VALUES), overwrite=True)
        refused.append(True)

    run_into(tmp_path, load(PLANAR, VALUES), describe=describe)
    assert refused
    with held(tmp_path):  # and is free then
        pass


def test_run_into_and_save_follow_the_same_rule(tmp_path):
    result = run_into(tmp_path, load(PLANAR, VALUES))
    before = content(tmp_path)
    with pytest.raises(InputError, match="there is a result"):
        run_into(tmp_path, load(PLANAR, VALUES))
    with pytest.raises(InputError, match="overwrite=True"):
        exunet.save(result, tmp_path / "result.h5")
    assert content(tmp_path) == before
    case = load(PLANAR, [*VALUES, "title=other"])
    assert run_into(tmp_path, case, overwrite=True).provenance["title"] == "other"
    exunet.save(result, tmp_path / "result.h5", overwrite=True)
    assert exunet.load_result(tmp_path).provenance["title"] == result.provenance["title"]


def test_a_stopped_run_raises_its_own_error_with_the_place(tmp_path):
    with pytest.raises(RunStopped, match="what was computed is in") as stopped:
        run_into(tmp_path, load(PLANAR, STOPS[1::2]))
    assert not stopped.value.result.complete
    assert not has_unfinished(tmp_path)


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ((), "planar_deployment"),
        (("time.end=0.5",), "planar_deployment--time.end=0.5"),
        (("time.end=0.5", "solver.method='ODE23'"), "planar_deployment--time.end=0.5--solver.method=ODE23"),
        (("effects.rayleigh_damping=",), "planar_deployment--effects.rayleigh_damping="),
    ],
)
def test_variants_have_names_of_their_own(overrides, name):
    assert folder_of(load(PLANAR, overrides)) == Path("results") / name


def test_names_of_variants_are_safe_and_short():
    awkward = [f"title='{'../' * 20}{letter}'" for letter in "ab"]
    found = [folder_of(load(PLANAR, [item])).name for item in awkward]
    assert found[0] != found[1]
    for name in found:
        assert "/" not in name
        assert len(name) < 80
    many = [f"net.cable.diameter=0.00{k}" for k in range(1, 10)] * 3
    assert len(folder_of(load(PLANAR, many)).name.encode()) < 180
    assert folder_of(load(PLANAR, many)) != folder_of(load(PLANAR, many[:-1]))

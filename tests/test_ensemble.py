"""`exunet ensemble` and `exunet.ensemble`: many runs from moved starts, their file, table and figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import command

import exunet
from exunet.cli.ensemble import rows
from exunet.plots.registry import ENSEMBLE_FIGURES
from exunet.results.course import INTERVALS
from exunet.results.ensemble_result import LEVELS, EnsembleResult
from exunet.studies import perturbed_runs

PLANAR = Path(__file__).parent.parent / "cases" / "planar_undamped.toml"
SHORT = ("solver={tolerance=1e-5, method='DOPRI5'}", "time.end=0.7")  # snaps from 0.5 s on
SET = tuple(word for item in SHORT for word in ("--set", item))


def made(runs: int = 5, **arguments: Any) -> EnsembleResult:
    return exunet.ensemble(exunet.load(PLANAR, SHORT), runs, **arguments)


@pytest.mark.ci
@pytest.mark.slow
def test_an_ensemble_has_headlines_and_quantiles() -> None:
    found = made(5, perturb=1e-6)
    peaks = found.headlines["largest_tension_N"]
    assert (found.runs, len(peaks), found.complete, found.verdict) == (5, 5, True, "ok")
    assert len(set(peaks.tolist())) == 5
    assert found.quantile("largest_tension_N", 0.5) == np.median(peaks)
    assert found.quantiles["area"].shape == (len(LEVELS), INTERVALS + 1)
    assert (np.diff(found.quantiles["area"], axis=0) >= 0.0).all()
    assert found.provenance["seed"] == 0
    assert found.provenance["move_m"] == 1e-6
    frame = found.to_frame()
    assert frame["largest_tension_N"].tolist() == peaks.tolist()
    assert frame["element"].tolist() == found.elements.tolist()
    with pytest.raises(exunet.InputError, match="largest_tension_N"):
        found.quantile("tension", 0.5)


@pytest.mark.ci
@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits(monkeypatch: Any) -> None:
    """In whatever portions the runs are made; and the first runs are the same, however many follow."""
    one = made(5)
    monkeypatch.setattr(perturbed_runs, "PORTION", 2)
    again, more, other = made(5), made(7), made(5, seed=1)
    for key, values in one.headlines.items():
        assert np.array_equal(values, again.headlines[key]), key
        assert np.array_equal(values, more.headlines[key][:5]), key
    assert not np.array_equal(one.headlines["largest_tension_N"], other.headlines["largest_tension_N"])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"runs": 0}, "runs: must be a whole number, 1 or more"),
        ({"runs": 2.5}, "runs: must be a whole number"),
        ({"runs": 10**12}, "runs: there is memory for"),
        ({"perturb": -1e-9}, "perturb: must be a finite number of metres"),
        ({"perturb": float("nan")}, "perturb: must be a finite number of metres"),
        ({"perturb": "1e-9"}, "perturb: must be a finite number of metres"),
        ({"seed": -1}, "seed: must be a whole number, 0 or more"),
    ],
)
def test_what_cannot_be_meant_is_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(exunet.InputError, match=words):
        made(**given)


def test_a_method_that_the_compiled_loop_has_not_is_refused() -> None:
    case = exunet.load(PLANAR, ["solver={method='RK67', step=1e-4}"])
    with pytest.raises(exunet.InputError, match="runs by DOPRI5, RK44, VelocityVerlet, or auto, not by RK67"):
        exunet.ensemble(case, 2)


@pytest.mark.parametrize(
    ("solver", "perturb", "least"),
    [
        ("solver={method='VelocityVerlet', step=5e-5}", 1e-9, "9.8e-05"),  # 1.4e-5 of 7 m with strings
        ("solver={method='RK44', step=1e-4}", 9e-5, "9.8e-05"),
        ("solver={accuracy_of='measures'}", 1e-9, "1.4e-05"),  # 2e-6 of them
        ("solver={method='VelocityVerlet', step=5e-5}", 1e-4, ""),
        ("solver={accuracy_of='measures'}", 1.4e-5, ""),
        (SHORT[0], 1e-9, ""),
    ],
)
def test_moves_below_the_errors_of_a_cheap_setting_are_named(solver: str, perturb: float, least: str) -> None:
    """benchmarks/ensemble.md: equal steps shift headlines from 1e-9 m, not from 1e-4 m."""
    found = exunet.ensemble(exunet.load(PLANAR, [solver, "time.end=0.05"]), 1, perturb)
    notes = found.provenance["notes"]
    assert (len(notes) == 1) == bool(least)
    assert all(f"give --perturb {least} or more" in words for words in notes)
    assert [words for name, words in rows(found) if name == "note"][:-1] == notes  # the last: of one run


def test_an_ensemble_is_the_same_after_a_file(tmp_path: Path) -> None:
    found = made(3)
    exunet.save_ensemble(found, tmp_path / "ensemble.h5")
    with pytest.raises(exunet.InputError, match="there is a file of that name"):
        exunet.save_ensemble(found, tmp_path / "ensemble.h5")
    read = exunet.load_ensemble(tmp_path)
    for name in ("headlines", "quantiles"):
        for key, values in getattr(found, name).items():
            assert np.array_equal(values, getattr(read, name)[key]), key
    assert np.array_equal(found.elements, read.elements)
    assert read.provenance == found.provenance
    with pytest.raises(exunet.InputError, match="not a result file of exunet"):
        exunet.load_result(tmp_path / "ensemble.h5")
    (tmp_path / "other.h5").write_bytes((tmp_path / "ensemble.h5").read_bytes()[:3000])
    with pytest.raises(exunet.InputError, match=r"other\.h5"):
        exunet.load_ensemble(tmp_path / "other.h5")


def test_an_interrupt_keeps_the_portions_that_are_complete(monkeypatch: Any) -> None:
    monkeypatch.setattr(perturbed_runs, "PORTION", 2)

    def press_ctrl_c(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(exunet.Interrupted, match="after 2 of 6 runs") as stop:
        made(6, progress=press_ctrl_c)
    assert stop.value.result.runs == 2
    assert not stop.value.result.complete


@pytest.mark.slow
def test_the_command_writes_file_and_figures_and_overwrites_nothing(tmp_path: Path) -> None:
    """The default folder, then the next free one; in a given one only with --overwrite."""
    arguments = ("ensemble", PLANAR, "-n", 8, "--perturb", 1e-6, *SET)
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    (folder,) = (tmp_path / "results").iterdir()
    assert folder.name.endswith("--ensemble")
    assert {path.name for path in folder.iterdir()} == {
        "ensemble.h5",
        *(f"{name}.png" for name in ENSEMBLE_FIGURES),
    }
    assert "8 perturbed by up to 1e-06 m (seed 0)" in " ".join(done.stdout.split())
    assert done.stderr.startswith("time    about")
    first = (folder / "ensemble.h5").read_bytes()
    refused = command(*arguments, "--out", folder, folder=tmp_path)
    assert refused.returncode == 2
    assert "there is an ensemble in this folder" in refused.stderr
    assert (folder / "ensemble.h5").read_bytes() == first
    of_case = ("--set", "seed=1")
    done = command(*arguments, *of_case, "--out", folder, "--overwrite", "--quiet", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert exunet.load_ensemble(folder).provenance["seed"] == 1


@pytest.mark.slow
def test_the_command_names_moves_that_are_too_small_before_it_runs(tmp_path: Path) -> None:
    """And again in its table, which tells what is in the file."""
    steps = ("--set", "solver={method='VelocityVerlet', step=5e-5}", "--set", "time.end=0.05")
    done = command("ensemble", PLANAR, "-n", 2, *steps, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    words = "perturbations of up to 1e-09 m are less than the errors of fixed steps of VelocityVerlet"
    assert words in " ".join(done.stderr.split())
    assert words in " ".join(done.stdout.split())
    assert all(len(line) <= 80 or line.startswith("  results/") for line in done.stdout.splitlines())


@pytest.mark.parametrize(
    "given", [("-n", 0), ("-n", "x"), ("--perturb=-1",), ("--perturb", "nan"), ("--seed=-1",)]
)
def test_bad_options_end_with_2_and_write_nothing(tmp_path: Path, given: tuple[object, ...]) -> None:
    done = command("ensemble", PLANAR, *SET, *given, folder=tmp_path)
    assert done.returncode == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("values", "move", "words", "note"),
    [
        ([875.04], 1e-9, "875.0 N", "1 run: "),
        ([841.6] * 3, 0.0, "841.6 N", "no start is perturbed"),
        ([841.6] * 8, 0.0, "841.6 N", "no start is perturbed"),
        ([841.6] * 3, 1e-9, "841.6 N in all 3 runs", "3 runs: "),
        (
            [652.1, 870.0, 700.0],
            1e-9,
            "652.1 to 870.0 N, least to largest of 3 runs",
            "3 runs: ",
        ),
        (
            [652.1, 870.0, 700.0, np.nan],
            1e-9,
            "652.1 to 870.0 N, least to largest of 3 runs; not in 1 of the runs",
            "4 runs: ",
        ),
        (
            list(range(600, 609)),
            1e-9,
            "median 604.0 N, 5 % to 95 %: 600.4 to 607.6 N, all: 600.0 to 608.0 N",
            "",
        ),
        ([841.6] * 8, 1e-9, "841.6 N in all 8 runs", ""),
    ],
)
def test_few_runs_have_no_quantiles_and_one_says_that_it_is_one(
    values: list[float], move: float, words: str, note: str
) -> None:
    found = EnsembleResult(
        headlines={"largest_tension_N": np.array(values, dtype=float)},
        elements=np.zeros(len(values), dtype=int),
        time=np.array([0.0, 1.0]),
        levels=np.array(LEVELS),
        quantiles={},
        provenance={"tolerance": 1e-9, "method": "DOPRI5", "move_m": move, "seed": 0, "seconds": 1.0},
    )
    table = rows(found)
    assert dict(table)["largest tension"] == words
    notes = [told for name, told in table if name == "note"]
    assert len(notes) == bool(note)
    assert all(note in told for told in notes)


def test_what_is_one_of_many_stands_in_the_file_alone() -> None:
    """A body with 40 attached nodes had 160 rows of single ones, beside those of the largest."""
    keys = ["body_ship_attachment_largest_force_N"]
    keys += [f"attachment_ship_{node}_largest_force_N" for node in range(40)]
    found = EnsembleResult(
        headlines={key: np.ones(8) for key in keys},
        elements=np.zeros(8, dtype=int),
        time=np.array([0.0, 1.0]),
        levels=np.array(LEVELS),
        quantiles={},
        provenance={"tolerance": 1e-9, "method": "DOPRI5", "move_m": 1e-9, "seed": 0, "seconds": 1.0},
    )
    table = rows(found)
    assert [name for name, _ in table if "force" in name] == ["largest force at an attachment of ship"]
    assert table[-1] == ("note", "ensemble.h5 has 40 more metrics, of single bodies, elements and nodes")


def test_one_figure_belongs_to_its_caller() -> None:
    found = made(4, perturb=1e-6)
    assert len(exunet.figure(found, "bands").axes) >= 5
    assert len(exunet.figure(found, "histograms").axes) >= 2
    with pytest.raises(exunet.InputError, match="is not one of histograms, bands"):
        exunet.figure(found, "area")

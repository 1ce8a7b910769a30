"""Studies: draws, designs, rows that equal single runs, refusals, and what survives kills and errors."""

from __future__ import annotations

import html
import importlib
import os
import re
import signal
import subprocess
import sys
import time
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from commands import CASES, PATIENCE, PLANAR, command, ended, process, wait_until
from scipy import stats

import exunet
from exunet.base.errors import CaseError, InputError, Interrupted
from exunet.studies import estimates, executor, study
from exunet.studies.inputs import InputConfig, Samples, StudyConfig
from exunet.studies.report import study_data
from exunet.studies.rows import RowFile
from exunet.studies.study import Study, StudyTable

SHORT = ["time.end=0.05", "time.output_step=0.01", "engine.backend=compiled"]
SPEED = {"launch.radial_speed": {"normal": [2.5, 0.1]}}


def planar(inputs: dict[str, Any] = SPEED, **more: Any) -> Study:
    more = {"set": SHORT, "runs": 6, "seed": 1} | more
    if more["runs"] is None:
        del more["runs"]
    return Study(PLANAR, inputs=inputs, **more)


def contents(table: StudyTable) -> dict[str, list[Any]]:
    """All columns but seconds; NaN, which is not equal to itself, as text."""
    frame = table.to_pandas().drop(columns="seconds")
    return {name: [str(value) for value in frame[name]] for name in sorted(frame)}


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> StudyTable:
    """Six planar throws by one worker."""
    return planar().run(tmp_path_factory.mktemp("alone"), workers=1)


# Draws


def drawn(runs: int = 2000, design: str = "random", **inputs: Any) -> dict[str, np.ndarray]:
    config = StudyConfig.model_validate({"case": "", "design": design, "runs": runs, "inputs": inputs})
    rows = Samples(config, {}).of_runs(range(runs))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


LAWS = {
    "uniform": ({"uniform": [1.0, 3.0]}, stats.uniform(1.0, 2.0)),
    "normal": ({"normal": [2.0, 0.5]}, stats.norm(2.0, 0.5)),
    "truncated": ({"normal": [2.0, 0.5], "bounds": [1.5, 2.1]}, stats.truncnorm(-1.0, 0.2, 2.0, 0.5)),
    "log_uniform": ({"log_uniform": [1e-5, 1e-3]}, stats.loguniform(1e-5, 1e-3)),
    "log_normal": ({"log_normal": [2.0, 3.0]}, stats.lognorm(np.log(3.0), scale=2.0)),
    "triangular": ({"triangular": [1.0, 2.0, 4.0]}, stats.triang(1 / 3, 1.0, 3.0)),
    "frozen": (stats.gamma(2.0, scale=0.5), stats.gamma(2.0, scale=0.5)),
}


@pytest.mark.parametrize("design", ["random", "lhs"])
@pytest.mark.parametrize("law", LAWS)
def test_samples_have_their_distribution(law: str, design: str) -> None:
    """By Kolmogorov and Smirnov; a wrong scale or parameter is far below 1e-4 with 2000 samples."""
    given, expected = LAWS[law]
    assert stats.kstest(drawn(design=design, x=given)["x"], expected.cdf).pvalue > 1e-4


def test_whole_numbers_and_choices_are_equally_likely() -> None:
    found = drawn(6000, n={"integer": [3, 5]}, word={"choice": ["a", 2, 0.5]})
    assert set(found["n"].tolist()) == {3, 4, 5}
    for values in found.values():
        counts = np.unique(values, return_counts=True)[1]
        assert stats.chisquare(counts).pvalue > 1e-4


def test_vectors_have_any_direction_and_attitudes_tilt_about_both_axes() -> None:
    found = drawn(v={"isotropic": [0.8, 1.3]}, q={"tilt": 0.12})
    vectors = np.stack([found[f"v[{k}]"] for k in range(3)])
    lengths = np.linalg.norm(vectors, axis=0)
    assert stats.kstest(lengths, stats.uniform(0.8, 0.5).cdf).pvalue > 1e-4
    for part in vectors / lengths:  # Archimedes: each direction cosine is uniform
        assert stats.kstest(part, stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-4
    w, x, y, z = (found[f"q[{k}]"] for k in range(4))
    assert np.hypot.reduce([w, x, y, z]) == pytest.approx(1.0)
    assert np.abs(z).max() == 0.0
    for part in (x, y):  # rotation vector: 2 arccos(w) along (x, y)
        angle = 2.0 * np.arccos(w) * part / np.hypot(x, y)
        assert stats.kstest(angle, stats.norm(0.0, 0.12).cdf).pvalue > 1e-4


@pytest.mark.parametrize("design", ["random", "lhs"])
def test_draws_do_not_depend_on_other_inputs_or_on_the_number_of_runs(design: str) -> None:
    one, two = {"normal": [0.0, 1.0]}, {"uniform": [0.0, 1.0]}
    few = drawn(100, design, a=one)["a"]
    assert np.array_equal(few, drawn(100, design, b=two, a=one)["a"])
    assert np.array_equal(few, drawn(5000, a=one)["a"][:100]) == (design == "random")
    together = drawn(2000, design, a=two, b=two)
    assert abs(np.corrcoef(together["a"], together["b"])[0, 1]) < 4.0 / np.sqrt(2000)


def test_a_latin_hypercube_has_one_sample_in_each_part() -> None:
    found = drawn(64, "lhs", a={"uniform": [0.0, 64.0]})["a"]
    assert sorted(found.astype(int).tolist()) == list(range(64))


def test_saltelli_replaces_one_input_of_a_by_that_of_b() -> None:
    inputs = {"a": {"uniform": [0.0, 1.0]}, "v": {"isotropic": [1.0, 2.0]}, "c": {"uniform": [0.0, 1.0]}}
    config = StudyConfig.model_validate({"case": "", "design": "saltelli", "runs": 8, "inputs": inputs})
    samples, columns = Samples(config, {}), {key: item.columns(key) for key, item in config.inputs.items()}
    assert config.number_of_rows == 8 * (3 + 3)
    for point in range(8):
        places = [samples.place(6 * point + k) for k in range(6)]
        assert [place[1] for place in places] == [0, 0, 0, 0, 0, 1]
        assert places[5][0] == places[0][0]  # the dummy
        a, b, *mixed = samples.of_runs([place[0] for place in places[:5]])
        for changed, row in zip(columns, mixed, strict=True):
            for key, names in columns.items():
                assert all(row[name] == (b if key == changed else a)[name] != a[name]
                           or key != changed for name in names)  # fmt: skip
                assert all(row[name] == (b if key == changed else a)[name] for name in names)
    whole = np.array([row["a"] for row in samples.of_runs([5 * k for k in range(8)])])
    assert sorted((8 * whole).astype(int).tolist()) == list(range(8))  # a Sobol' sequence is balanced


def test_a_tilt_is_that_of_the_cases_attitude() -> None:
    """A net that is turned by 0.3 rad about x stays so on average; the tilt is about its own axes."""
    box = CASES / "missions" / "throw_close_tow.toml"
    key, turned = "initial.frame.attitude", "initial.frame.attitude=[0.9887710779, 0.1494381325, 0.0, 0.0]"
    tilted = Study(box, runs=1, inputs={key: {"tilt": 1e-9}}, set=[turned])
    attitude = tilted.case(0).scene.initial.frame
    assert attitude is not None
    assert attitude.attitude == pytest.approx((0.9887710779, 0.1494381325, 0.0, 0.0), abs=1e-8)


# Rows


def test_a_row_is_a_run_of_its_case(alone: StudyTable) -> None:
    assert alone.complete
    for run in (0, 5):
        row = alone.row(run)
        measured = exunet.metrics(exunet.run(alone.case(run)))
        assert {key: metric.value for key, metric in measured.items()} == {
            key: row[key] for key in alone.metrics
        }
        assert alone.case(run).scene.launch.radial_speed == row["launch.radial_speed"]  # type: ignore[union-attr]


@pytest.mark.slow
@pytest.mark.ci
def test_two_workers_have_the_same_table(alone: StudyTable, tmp_path: Path) -> None:
    assert contents(planar().run(tmp_path, workers=2)) == contents(alone)


def test_shards_and_resumed_studies_have_the_same_table(alone: StudyTable, tmp_path: Path) -> None:
    for k in (1, 0):
        parts = planar().run(tmp_path / "shards", workers=1, shard=(k, 2))
    assert contents(parts) == contents(alone)
    assert len(list((tmp_path / "shards").glob("*.sqlite"))) == 2
    assert len(planar(runs=2).run(tmp_path / "more", workers=1)) == 2
    assert contents(planar().run(tmp_path / "more", workers=1)) == contents(alone)


def test_interrupted_rows_stay_and_the_same_command_goes_on(
    alone: StudyTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = executor.run_job

    def run_job(work: Any, job: Any, *more: Any) -> Any:
        if job.row == 3:
            raise KeyboardInterrupt
        return real(work, job, *more)

    monkeypatch.setattr(executor, "PORTION", 0.0)
    monkeypatch.setattr(executor, "run_job", run_job)
    with pytest.raises(Interrupted):
        planar().run(tmp_path, workers=1)
    assert StudyTable(tmp_path).numbers.tolist() == [0, 1, 2]
    monkeypatch.setattr(executor, "run_job", real)
    assert contents(planar().run(tmp_path, workers=1)) == contents(alone)


def test_replicates_of_a_grid_start_as_ensembles_do(tmp_path: Path) -> None:
    table = planar({"launch.radial_speed": [2.0, 2.5]}, design="grid", replicates=2, runs=None,
                   designs=[{"name": "light", "set": ["net.bullets.mass=0.4"]}, {"name": "paper"}],
                   ).run(tmp_path, workers=1)  # fmt: skip
    assert table.column("launch.radial_speed").tolist() == [2.0] * 4 + [2.5] * 4
    assert table.column("design").tolist() == ["light", "light", "paper", "paper"] * 2
    case = exunet.load(PLANAR, [*SHORT, "launch.radial_speed=2.5"])
    start = exunet.prepare(case)
    moved = start.moved(exunet.perturbed_positions(start, 1, 1e-9, case.scene.seed)[0])
    for replicate, single in enumerate((case, moved)):
        metrics = exunet.metrics(exunet.run(single))
        assert table.row(3, replicate)["bullet_speed_at_end_m_s"] == metrics["bullet_speed_at_end_m_s"].value
        assert np.array_equal(table.start(3, 1).position, moved.position)
    assert np.array_equal(table.of_design("paper"), np.tile([False, False, True, True], 2))


def test_errors_of_runs_are_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step of 0.02 s diverges, a negative speed makes no valid case, and a defect leaves its traceback."""
    monkeypatch.setattr(study, "CHECKED", 0)
    forced = ["solver.method=RK44", "solver.force=true", "solver.accuracy=", "time.end=1.0"]
    inputs = {"solver.step": [1e-4, 0.02], "net.bullets.mass": [0.5, 0.25, -1.0]}
    real = executor.run

    def run(case: Any, *more: Any) -> Any:
        if case.scene.net.bullets.mass == 0.25:
            raise ZeroDivisionError
        return real(case, *more)

    monkeypatch.setattr(executor, "run", run)
    keep = {"keep": "undetermined"}
    table = planar(inputs, design="grid", runs=None, set=[*SHORT, *forced], outputs=keep).run(
        tmp_path, workers=1
    )
    assert table.status.tolist() == ["ok", "failed", "invalid", "stopped", "failed", "invalid"]
    assert table.outcome.tolist() == ["", "", "", "undetermined", "", ""]
    assert table.undetermined.tolist() == [False, True, True, True, True, True]
    assert "ZeroDivisionError" in table.row(1)["note"]
    assert np.isnan(table.column("largest_tension_N")).tolist() == [False] + [True] * 5
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["3.h5"]
    assert not exunet.load_result(tmp_path / "runs" / "3.h5").complete


def test_a_run_beyond_its_time_limit_has_failed(tmp_path: Path) -> None:
    table = planar(runs=1, time_limit=1e-9).run(tmp_path, workers=1)
    assert table.status.tolist() == ["failed"]


def test_a_full_disk_leaves_complete_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, sizes = RowFile.add, []

    def add(rows: RowFile, new: Any, about: Any) -> None:
        if sizes:  # of a disk on which the file cannot grow
            rows._db.execute("PRAGMA max_page_count=1")
            new = [row | {"note": "x" * 1_000_000} for row in new]
        sizes.append(len(new))
        real(rows, new, about)

    monkeypatch.setattr(executor, "PORTION", 0.0)
    monkeypatch.setattr(RowFile, "add", add)
    with pytest.raises(InputError) as error:
        planar().run(tmp_path, workers=1)
    assert error.value.exit_code == 2
    assert StudyTable(tmp_path).numbers.tolist() == [0]


def test_another_case_or_study_does_not_go_on(tmp_path: Path) -> None:
    case = tmp_path / "case.toml"
    text = PLANAR.read_text(encoding="utf-8")
    case.write_text(text, encoding="utf-8")

    def run(**more: Any) -> StudyTable:
        given = {"inputs": SPEED, "runs": 2, "set": SHORT} | more
        return Study(case, **given).run(tmp_path / "out", workers=1)

    table = run()
    for other in ({"seed": 2}, {"set": SHORT[:2]}, {"design": "lhs"}):
        with pytest.raises(InputError):
            run(**other)
    case.write_text(text.replace("mass = 0.5", "mass = 0.6"), encoding="utf-8")
    with pytest.raises(InputError):
        run()
    assert table.case(1).scene.net.bullets.mass == 0.5  # type: ignore[union-attr]
    assert len(run(set=SHORT, title="x", outputs={}) if case.write_text(text, encoding="utf-8") else []) == 2


def test_probability_widens_by_runs_without_an_outcome(tmp_path: Path) -> None:
    table = rows_of_captures(tmp_path, ["captured"] * 15 + ["missed"] * 3 + ["undetermined", None])
    found = table.probability("captured")
    assert (found.value, found.runs, found.undetermined) == (0.75, 20, 2)
    assert found.low == pytest.approx(stats.beta.ppf(0.025, 15, 6))  # Clopper and Pearson: 15 of 20
    assert found.high == pytest.approx(stats.beta.ppf(0.975, 18, 3))  # and 17 of 20
    with pytest.raises(InputError):
        table.probability("caught")


def rows_of_captures(
    folder: Path, outcomes: list[str | None], columns: int = 0, designs: tuple[str, ...] = ("",), **more: Any
) -> StudyTable:
    """Rows as a study of a capture leaves them, without runs; None: failed. Metric k is 1.5 + 2 k row^2."""
    inputs = {"initial.packing": {"uniform": [0.5, 0.6]}, "net.bullets.mass": {"normal": [0.02, 0.001]}}
    more |= {"designs": [{"name": name} for name in designs]} if designs[0] else {}
    own = Study(CASES / "capture" / "miss.toml", inputs=inputs, runs=len(outcomes) // len(designs), **more)
    folder.mkdir(exist_ok=True)
    rows = RowFile.create(folder / "study.sqlite", own._about(), own._types())
    about = {f"metric_{k}": ("m", "") for k in range(columns)}
    status = ("ok" if outcome else "failed" for outcome in outcomes)
    new = (
        {"id": k, "run": k, "replicate": 0, "status": word, "outcome": outcome, "seconds": 1.0}
        | {
            "design": designs[k % len(designs)],
            **(own.samples.of_runs([k])[0] if len(outcomes) < 1000 else {}),
        }
        | {f"metric_{m}": 1.5 + 2.0 * m * k**2 for m in range(columns)}
        for k, (word, outcome) in enumerate(zip(status, outcomes, strict=True))
    )
    while portion := list(islice(new, 256)):
        rows.add(portion, about)
    rows.close()
    return StudyTable(folder)


PAIRS = (
    [("captured", "captured")] * 10
    + [("missed", "captured")] * 6
    + [("captured", "missed"), ("missed", None)]
)


def test_designs_are_compared_by_pairs_of_the_same_sample(tmp_path: Path) -> None:
    outcomes = [outcome for pair in PAIRS for outcome in pair]
    table = rows_of_captures(tmp_path / "both", outcomes, 2, ("a", "b"))
    found = table.paired("captured", "a", "b")
    assert isinstance(found, estimates.PairedOutcome)
    assert (found.gained, found.lost, found.pairs) == (6, 1, 18)
    assert found.p == pytest.approx(2 * stats.binom.cdf(1, 7, 0.5))
    assert found.low < 5 / 18 < found.high
    metric = table.paired("metric_1", "a", "b")
    assert isinstance(metric, estimates.PairedMetric)
    assert metric.median == 2.0 * np.median([2 * (2 * k) + 1 for k in range(18)])  # (n + 1)^2 - n^2
    sides = [rows_of_captures(tmp_path / str(k), [pair[k] for pair in PAIRS]) for k in (0, 1)]
    assert sides[0].paired("captured", None, None, sides[1]) == found
    other = rows_of_captures(tmp_path / "other", [pair[1] for pair in PAIRS], seed=7)
    with pytest.raises(InputError):
        sides[0].paired("captured", None, None, other)
    compared = [
        command("compare", sides[0].folder, b.folder, folder=tmp_path).stdout for b in (sides[1], other)
    ]
    assert [str(found) in text for text in compared] == [True, False]
    shown = command("show", table.folder, folder=tmp_path).stdout
    assert str(found) in shown


def test_figures_show_what_a_study_has(tmp_path: Path) -> None:
    """Outcomes by packing alone: it is the strongest input, beyond the level of an input without effect."""
    outcomes: list[str | None] = ["missed"] * 60
    packing = rows_of_captures(tmp_path / "draws", outcomes).column("initial.packing")
    outcomes = ["captured" if value < 0.57 else "missed" for value in packing]
    table = rows_of_captures(tmp_path / "a", outcomes, 2, outputs={"print": ["metric_1"]})
    data = study_data(table)
    assert list(data.inputs) == ["packing", "mass"]
    (index, level, sign), (other, beyond, _) = (data.drivers["captured"][name] for name in data.inputs)
    assert (index > level, other > beyond, sign) == (True, False, -1)
    files = exunet.save_figures(data, tmp_path / "figures")
    assert [path.stem for path in files] == ["distributions", "map", "drivers"]
    both = rows_of_captures(tmp_path / "b", [o for o in outcomes for _ in "ab"], designs=("a", "b"))
    estimate = both.probability("captured", "b")
    assert study_data(both).estimates["probability of capture, 95\N{NO-BREAK SPACE}%", ""]["b"] == (
        estimate.value, estimate.low, estimate.high
    )  # fmt: skip
    drawn = command("plot", both.folder, "--figure", "designs", "--format", "svg", folder=tmp_path)
    assert (drawn.returncode, (both.folder / "figures" / "designs.svg").is_file()) == (0, True)


STUDIES = sorted((CASES / "studies").glob("*.toml"))


@pytest.mark.slow
@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_rows_of_a_shipped_study_are_single_runs(path: Path, tmp_path: Path) -> None:
    own = Study.read(path)
    own.validate()
    table = own.run(tmp_path, workers=1, shard=(0, own.config.number_of_rows // 3))
    assert len(table) >= 3
    for run, replicate in zip(table.column("run").tolist(), table.column("replicate").tolist(), strict=True):
        row, metrics = table.row(run, replicate), exunet.metrics(exunet.run(table.start(run, replicate)))
        assert {key: metric.value for key, metric in metrics.items()} == {key: row[key] for key in metrics}


# Refusals

STUDY = f"""\
format = 1
case = "{PLANAR}"
design = "random"
runs = 4
set = ["solver.accuracy=", "time.end=0.05", "time.output_step=0.01"]
[inputs]
"launch.radial_speed" = {{ normal = [2.5, 0.1] }}
[outputs]
print = ["largest_tension_N"]
"""
WRONG = {
    "unknown key of a study": ("runs = 4", "run = 4", 4),
    "unknown key of the case": ("radial_speed", "radial_sped", 7),
    "no number": ("launch.radial_speed", "net.topology", 7),
    "negative mass": ('launch.radial_speed" = { normal = [2.5', 'net.bullets.mass" = { normal = [0.1', 7),
    "no power of 2": ('"random"\nruns = 4', '"saltelli"\nruns = 6', 4),
    "too many runs": ("runs = 4", "runs = 1_000_001", 4),
    "no runs": ("runs = 4", "", 1),
    "no distribution": ("normal = [2.5, 0.1]", "normal = [2.5, -0.1]", 7),
    "list": ("{ normal = [2.5, 0.1] }", "[2.0, 3.0]", 7),
    "two distributions": ("normal = [2.5, 0.1]", "normal = [2.5, 0.1], uniform = [2.0, 3.0]", 7),
    "samples that cannot be prepared": (
        'step=0.01"]\n[inputs]\n"launch.radial_speed" = { normal = [2.5, 0.1] }',
        'step=0.01", "solver.method=RK44"]\n[inputs]\n"solver.step" = { uniform = [1e-6, 1e-2] }', 7,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_study_is_refused_with_its_line_before_any_run(name: str, tmp_path: Path) -> None:
    old, new, line = WRONG[name]
    assert old in STUDY
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace(old, new), encoding="utf-8")
    with pytest.raises(CaseError) as error:
        Study.read(path).run(tmp_path / "out", workers=1)
    assert f"{path}:{line}" in [fault.place for fault in error.value.faults]
    assert not (tmp_path / "out").exists()


def test_an_unknown_output_is_refused_after_the_first_run(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("largest_tension_N", "largest_tension"), encoding="utf-8")
    with pytest.raises(CaseError) as error:
        Study.read(path).run(tmp_path / "out", workers=1)
    assert error.value.faults[0].place == f"{path}:9"
    assert len(StudyTable(tmp_path / "out")) == 1


def test_a_fixed_step_that_samples_forbid_names_its_remedy() -> None:
    """Damping of 3e-4 s lowers the stable step below the 0.1 ms that the case fixes."""
    box = CASES / "missions" / "throw_close_tow.toml"
    damping = {"effects.material_damping.relaxation_time": [1e-4, 3e-4]}
    with pytest.raises(CaseError) as error:
        Study(box, design="grid", inputs=damping).validate()
    assert 'set = ["solver="]' in str(error.value)
    Study(box, design="grid", inputs=damping, set=["solver="]).validate()


def test_the_part_outside_of_the_bounds_is_that_of_the_distribution() -> None:
    item = InputConfig.model_validate({"normal": [0.1, 0.1]})
    assert item.outside(0.0, np.inf) == pytest.approx(stats.norm.cdf(-1.0))
    cut = InputConfig.model_validate({"normal": [0.1, 0.1], "bounds": [0.0, 1.0]})
    assert cut.outside(0.0, np.inf) == 0.0


# Commands


def test_commands_print_a_study_and_go_on(tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    path.write_text(STUDY, encoding="utf-8")
    dry = command("study", path, "--dry", folder=tmp_path)
    assert (dry.returncode, len(dry.stdout.splitlines())) == (0, 4)
    assert not (tmp_path / "results").exists()
    done = command("study", path, "--workers", 1, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) <= 20
    folder = tmp_path / "results" / "short"
    assert (folder / "table.csv").read_text(encoding="utf-8").count("\n") == 5
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") == len(list((folder / "figures").iterdir())) > 0
    assert html.escape(STUDY) in page
    more = command("study", path, "--workers", 1, "--runs", 5, folder=tmp_path)
    assert more.returncode == 0
    shown = command("show", "results/short", folder=tmp_path)
    assert (shown.stdout, len(StudyTable(folder))) == (more.stdout, 5)
    assert command("resume", folder, folder=tmp_path).returncode == 0
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert command("study", path, "--out", "file/x", folder=tmp_path).returncode == 2


# Kills, clusters, size


def killed_study(folder: Path) -> tuple[subprocess.Popen[str], Path]:
    """Start a study of 400 planar throws of 0.05 s in two processes, and wait for its first rows."""
    path = folder / "long.toml"
    path.write_text(STUDY.replace("runs = 4", "runs = 400"), encoding="utf-8")
    running = process("study", path, "--out", folder / "out", "--workers", 2, "--quiet", folder=folder)
    out = folder / "out"
    wait_until(lambda: (out / "study.sqlite").is_file() and len(StudyTable(out)) > 20, running)
    return running, out


def children_of(number: int) -> list[int]:
    """Worker processes of a process, without the tracker of its resources."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int(re.sub(r".*\) ", "", (folder / "stat").read_text()).split()[1])
            if parent == number and "spawn_main" in (folder / "cmdline").read_text():
                found.append(int(folder.name))
        except OSError:
            continue
    return found


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_killed_studies_and_workers(tmp_path: Path) -> None:
    """A killed worker is replaced; a killed study leaves its rows, its workers end, and it goes on."""
    running, out = killed_study(tmp_path)
    os.kill(children_of(running.pid)[0], signal.SIGKILL)
    before = len(StudyTable(out))
    wait_until(lambda: len(StudyTable(out)) > before + 100, running)
    workers = children_of(running.pid)
    assert len(workers) == 2
    running.kill()
    running.wait()
    time.sleep(5.0)
    assert not [number for number in workers if Path(f"/proc/{number}").exists()]
    left = len(StudyTable(out))
    assert 100 < left < 400
    assert ended(process("resume", out, folder=tmp_path)).returncode == 0
    table = StudyTable(out)
    assert table.status.tolist() == ["ok"] * 400
    single = exunet.metrics(exunet.run(table.case(399)))
    assert table.row(399)["bullet_speed_at_end_m_s"] == single["bullet_speed_at_end_m_s"].value


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_ctrl_c_ends_a_study_with_130(tmp_path: Path) -> None:
    running, out = killed_study(tmp_path)
    running.send_signal(signal.SIGINT)
    done = ended(running)
    assert done.returncode == 130
    assert len(done.stderr.strip().splitlines()) == 1
    assert len(StudyTable(out)) > 20


DEADLY = """
import os, sys
sys.path.insert(0, {folder!r})
from exunet.studies import executor
import deadly
executor.run_portion = deadly.run_portion
from exunet.studies.study import Study
table = Study({case!r}, inputs={{"launch.radial_speed": {{"normal": [2.5, 0.1]}}}}, runs=12, set={set!r}).run(
    "out", workers=2
)
print(table.status.tolist())
"""


@pytest.mark.slow
def test_a_run_that_kills_its_process_twice_has_failed(tmp_path: Path) -> None:
    """Also from a script without a guard, which processes do not import."""
    (tmp_path / "deadly.py").write_text(
        "import os\nfrom exunet.studies import executor\nreal = executor.run_portion\n"
        "def run_portion(work, jobs, *more):\n"
        "    if any(job.row == 7 for job in jobs):\n        os._exit(1)\n    return real(work, jobs, *more)\n"
    )
    script = tmp_path / "script.py"
    script.write_text(DEADLY.format(folder=str(tmp_path), case=str(PLANAR), set=SHORT))
    run = subprocess.run(
        [sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == str(["ok"] * 7 + ["failed"] + ["ok"] * 4)


@pytest.mark.slow
def test_there_are_no_more_workers_than_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXUNET_MEMORY", "5e7")
    notes: list[str] = []
    assert planar().run(tmp_path, workers=3, note=notes.append).complete
    assert len(notes) == 1


@pytest.mark.slow
@pytest.mark.ci
def test_dask_computes_the_same_table(alone: StudyTable, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "dashboard_address": None, "host": "127.0.0.1"}
    with (
        distributed.LocalCluster(threads_per_worker=1, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert contents(planar().run(tmp_path / "out", client=client)) == contents(alone)
    with (
        distributed.LocalCluster(threads_per_worker=2, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        with pytest.raises(InputError) as error:
            planar().run(tmp_path / "refused", client=client)
        assert "--nthreads 1" in str(error.value)


MEASURED = """
import resource, sys
from exunet.studies.study import StudyTable
table = StudyTable(sys.argv[1])
table.probability("captured")
for name in table.metrics:
    table.column(name)
table.study.samples.of_runs(range(1000))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


@pytest.mark.slow
def test_statistics_of_1e5_rows_take_400_mb_at_most(tmp_path: Path) -> None:
    rows_of_captures(tmp_path, ["captured", "missed"] * 50_000, columns=100)
    run = subprocess.run(
        [sys.executable, "-c", MEASURED, tmp_path], capture_output=True, text=True, check=True
    )
    assert int(run.stdout) < 400e6


def test_one_key_has_one_input() -> None:
    """Two inputs that set a key, or a vector and its component, would store a value that no run had."""
    uniform = {"uniform": [2.0, 3.0]}
    for other in ({"launch.axial_speed": uniform | {"also": ["launch.radial_speed"]}},
                  {"launch": {"choice": [{"radial_speed": 2.0, "axial_speed": 0.0}]}}):  # fmt: skip
        with pytest.raises(CaseError, match="radial_speed"):
            Study(PLANAR, design="random", runs=2, inputs={"launch.radial_speed": uniform} | other)


def test_rows_are_of_the_compiled_loop_unless_set_names_a_backend() -> None:
    """Though the planar case names Exudyn."""
    inputs = {"launch.radial_speed": {"uniform": [2.0, 3.0]}}
    for given, backend in (((), "auto"), (("engine.backend=exudyn",), "exudyn")):
        study = Study(PLANAR, design="random", runs=2, set=given, inputs=inputs)
        assert study.case(0).scene.engine.backend == backend


# Scenes from Python


def throw(speed: float, mass: float = 0.5) -> exunet.Scene:
    changes = {"launch.radial_speed": speed, "net.bullets.mass": mass}
    return exunet.Scene.load(PLANAR, SHORT).replace(changes)


def blown(wind: float) -> exunet.Start:
    """A force of one's own on the first node, which no scene has."""
    term = exunet.KernelTerm("nodes", add_wind, Wind(wind))
    return exunet.prepare(exunet.Scene.load(PLANAR, SHORT)).with_forces(lambda blocks: [term])


class Wind(NamedTuple):
    force: float  # N


def add_wind(t: float, x: Any, v: Any, wind: Any, force: Any) -> None:
    force[2] += wind.force


@pytest.mark.parametrize(("build", "name"), [(throw, "speed"), (blown, "wind")])
def test_rows_of_a_function_are_runs_of_what_it_returns(build: Any, name: str, tmp_path: Path) -> None:
    inputs = {name: {"uniform": [2.0, 3.0]}}
    for runs in (2, 3):  # the same function goes on
        table = Study(build=build, inputs=inputs, runs=runs).run(tmp_path, workers=1)
    assert len(table) == 3
    row = table.row(2)
    for case in (build(row[name]), table.case(2)):
        measured = exunet.metrics(exunet.run(case))
        assert {key: metric.value for key, metric in measured.items()} == {
            key: row[key] for key in table.metrics
        }
    with pytest.raises(InputError, match="build"):  # another source
        Study(build=lambda **values: build(**values), inputs=inputs, runs=3).run(tmp_path, workers=1)
    for refused in (lambda: StudyTable(tmp_path).case(0), lambda: Study.of_folder(tmp_path)):
        with pytest.raises(InputError, match=build.__name__):
            refused()


def test_functions_that_build_nothing_are_refused(tmp_path: Path) -> None:
    inputs = {"speed": {"uniform": [2.0, 3.0]}}
    refused: list[tuple[Any, dict[str, Any], type[Exception]]] = [
        (lambda speed: {}, {}, InputError),
        (lambda speed: 1 / 0, {}, InputError),
        (lambda speed: throw(speed, mass=-1.0), {}, CaseError),
        (lambda sped: throw(sped), {}, CaseError),
        (lambda speed, other: throw(speed), {}, CaseError),
        (lambda speed: blown(speed), {"set": ["time.end=0.1"]}, InputError),
        (lambda speed: throw(speed), {"workers": 2}, InputError),  # which no other process can import
        (throw, {"case": PLANAR}, InputError),
        (3, {}, InputError),
    ]
    for build, more, kind in refused:
        workers = more.pop("workers", 1)
        with pytest.raises(kind):
            Study(build=build, inputs=inputs, runs=2, **more).run(tmp_path, workers=workers)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_workers_import_the_module_of_a_function(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "module_of_throws.py"
    path.write_text(
        f"import exunet\n\n\ndef throw(speed):\n    scene = exunet.Scene.load({str(PLANAR)!r}, {SHORT!r})\n"
        "    return scene.replace({'launch.radial_speed': speed})\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    build = importlib.import_module(path.stem).throw
    study = Study(build=build, inputs={"speed": {"uniform": [2.0, 3.0]}}, runs=4)
    one, two = (study.run(tmp_path / str(workers), workers=workers) for workers in (1, 2))
    assert contents(one) == contents(two)
    path.unlink()
    with pytest.raises(InputError, match="module"):
        study.run(tmp_path / "without", workers=2)


def test_a_study_of_a_scene_is_that_of_its_file(alone: StudyTable, tmp_path: Path) -> None:
    scene = exunet.Scene.load(PLANAR, SHORT)
    Study(scene, inputs=SPEED, runs=3, seed=1).run(tmp_path, workers=1)
    found = Study(scene, inputs=SPEED, runs=6, seed=1).run(tmp_path, workers=1)
    assert contents(found) == contents(alone)
    assert contents(Study.of_folder(tmp_path).run(tmp_path, workers=1)) == contents(alone)


def test_each_bullet_has_a_draw_of_its_own(tmp_path: Path) -> None:
    """Factors begin at 1 and tilts at 0 where the case has none; each entry is an input like any other."""
    factor, angle = {"normal": [1.0, 0.02]}, {"normal": [0.0, 0.02]}
    each = {"launch.speed_factors[*]": factor, "launch.tilts[*][1]": angle}
    single = {f"launch.speed_factors[{k}]": factor for k in range(4)}
    single |= {f"launch.tilts[{k}][1]": angle for k in range(4)}
    bare = ["launch.speed_factors=[1,1,1,1]", "launch.tilts=[[0,0],[0,0],[0,0],[0,0]]"]
    table = planar(each, runs=2).run(tmp_path / "each", workers=1)
    other = planar(single, runs=2, set=[*SHORT, *bare]).run(tmp_path / "single", workers=1)
    assert contents(table) == contents(other)
    launch = table.case(1).scene.launch
    assert launch is not None
    assert launch.speed_factors == tuple(table.row(1)[f"launch.speed_factors[{k}]"] for k in range(4))
    assert len(set(launch.speed_factors)) == 4
    assert [tilt[0] for tilt in launch.tilts or ()] == [0.0] * 4
    for wrong in ({"launch.radial_speed[*]": factor}, each | {"launch.speed_factors[2]": factor}):
        with pytest.raises(CaseError, match="launch"):
            planar(wrong)

"""`exunet run` and `exunet ensemble`: metrics with their ranges in summary.json, table, files and figures."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import command
from result_samples import square_net, unfolding
from scenes import CASES, thrown

import exunet
from exunet.cli import run as run_command
from exunet.plots.registry import ENSEMBLE_FIGURES
from exunet.results.ensemble import Ensemble, Member, ensemble_of, member_of
from exunet.results.io import SPREAD_FILE
from exunet.results.metrics import Metric
from exunet.results.summary import summarise
from exunet.results.table import rows

PLANAR = CASES / "planar_deployment.toml"
SHORT = (PLANAR, "--set", "time.end=0.02", "--out", "here")
COMPILED = {"engine": {"backend": "compiled"}}


@pytest.fixture(scope="module")
def run() -> exunet.Result:
    return exunet.run(thrown({}, end=0.4, **COMPILED))


def scattered(result: exunet.Result, **values: Any) -> Ensemble:
    """Perturbed runs like a run, but for some metrics; None: a run does not have it."""
    own = member_of(result)
    members = []
    for k in range(len(next(iter(values.values())))):
        changed = {key: replace(own.metrics[key], value=of_runs[k]) for key, of_runs in values.items()
                   if of_runs[k] is not None}  # fmt: skip
        kept = {key: metric for key, metric in own.metrics.items() if key not in values}
        members.append(replace(own, metrics=kept | changed))
    return ensemble_of(members, provenance={"move_m": 1e-9, "seed": 0})


def test_metrics_have_their_ranges_in_summary_and_table(run: exunet.Result) -> None:
    """Beyond the printed digits as a range, below as a value; those that some runs do not have say so."""
    many = scattered(
        run, largest_tension_N=[90.0, 99.0, 95.0], time_of_largest_tension_s=[0.3, None, 0.5],
        largest_area_m2=[3.0, 3.0, 3.0],
    )  # fmt: skip
    summary, metrics = summarise(run, None, many), exunet.metrics(run)
    found = summary["metrics"]["largest_tension_N"]
    assert found["value"] == metrics["largest_tension_N"].value
    assert found["range"] == {"runs": 3, "median": 95.0, "low": 90.0, "high": 99.0}
    assert summary["ensemble"]["runs"] == 3
    table = dict(rows(summary, metrics, many))
    assert table["largest tension"].startswith("95.00 N (90.00 to 99.00)")
    assert "in 2 of 3 runs" in table["time of largest tension"]
    assert table["largest area"].startswith("3.000 m2")
    assert "to" not in table["largest area"].split("(")[0]
    assert "numerical sensitivity" in table["ranges"]


def test_a_metric_of_this_run_or_of_perturbed_runs_only(run: exunet.Result) -> None:
    metrics = exunet.metrics(run)
    none = scattered(run, time_of_largest_tension_s=[None, None])
    table = dict(rows(summarise(run, None, none), metrics, none))
    assert "of this run only" in table["time of largest tension"]
    some = scattered(run, time_of_largest_tension_s=[0.3, 0.5])
    slack = {key: metric for key, metric in metrics.items() if key != "time_of_largest_tension_s"}
    table = dict(rows(summarise(run, None, some), slack, some))
    assert "not available for this run" in table["time of largest tension"]


def test_vectors_have_one_row(run: exunet.Result) -> None:
    """Three components, each a value or one of them a range; many details only in the file."""
    parts = {f"v_{axis}": Metric(f"v_{axis}", f"v, {axis}", "", value, size=5.0, row="v")
             for axis, value in zip("xyz", (3.0, 0.0, 4.0), strict=True)}  # fmt: skip
    detail = Metric("one", "one of many", "N", 1.0, detail=True)
    table = dict(rows(summarise(run), {**parts, "one": detail}))
    assert table["v"].startswith("(3.000, 0, 4.000)")
    assert "one of many" not in table
    time = np.array([0.0, 1.0])
    members = [Member(time, parts | {"v_z": replace(parts["v_z"], value=z)}, {}, {}) for z in (4.0, 5.0)]
    many = ensemble_of(members, provenance={"move_m": 1e-9, "seed": 0})
    assert "z: 4.500 (4.000 to 5.000)" in dict(rows(summarise(run, None, many), parts, many))["v"]


def test_peaks_of_stored_times_say_so() -> None:
    of = unfolding(square_net(cells=2, strings=True), times=5)
    of.tension[3, 2] = 17.0
    found = exunet.metrics(of)["largest_tension_N"]
    assert (found.value, found.time, found.place) == (17.0, 0.75, "element 2")
    assert "stored times" in found.remark


@pytest.mark.ci
@pytest.mark.slow
def test_no_number_is_stored_twice() -> None:
    """Of a run with snaps and a common flight, in which no two quantities happen to be equal."""
    flying = thrown({}, end=0.4, launch={"radial_speed": 5.0, "axial_speed": 2.0})
    damped = flying.model_copy(update={"effects": exunet.load(PLANAR).scene.effects})
    summary = summarise(exunet.run(damped))
    numbers = re.findall(r"-?\d+\.\d{9,}(?:e-?\d+)?", json.dumps({
        key: value for key, value in summary.items() if key != "metrics"
    } | {"metrics": {key: one["value"] for key, one in summary["metrics"].items()}}))  # fmt: skip
    assert len(numbers) > 8
    assert len(numbers) == len(set(numbers)), sorted(numbers)


# Commands


@pytest.mark.ci
@pytest.mark.slow
def test_a_run_keeps_its_perturbed_runs(tmp_path: Path) -> None:
    """To 0.02 s nothing is taut: no range exceeds the printed digits. Then a run without, in its place."""
    done = command("run", *SHORT, "--spread", 8, "--overwrite", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "here/summary.json").read_text())
    assert summary["ensemble"]["runs"] == 8
    speed = summary["metrics"]["bullet_speed_at_end_m_s"]
    assert speed["value"] == pytest.approx(2.499, abs=1e-3)
    assert speed["range"]["high"] - speed["range"]["low"] < 1e-4
    kept = exunet.load_ensemble(tmp_path / "here" / SPREAD_FILE)
    assert kept.runs == 8
    assert kept.quantile("bullet_speed_at_end_m_s", 0.5) == speed["range"]["median"]
    plotted = command("plot", "here", "--out", "there", folder=tmp_path)
    assert plotted.returncode == 0, plotted.stderr
    assert (tmp_path / "here/area.png").read_bytes() == (tmp_path / "there/area.png").read_bytes()
    done = command("run", *SHORT, "--spread", 0, "--overwrite", folder=tmp_path)
    assert "a single run" in " ".join(done.stdout.split())
    assert not (tmp_path / "here" / SPREAD_FILE).exists()
    for number in (-1, 3, 100_001):
        assert command("run", *SHORT, "--spread", number, folder=tmp_path).returncode == 2


@pytest.mark.slow
def test_ctrl_c_during_the_perturbed_runs_keeps_the_result(tmp_path: Path, monkeypatch: Any) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run_command, "perturbed_runs", interrupt)
    done = command("run", *SHORT, "--spread", 8, folder=tmp_path)
    assert done.returncode == 130
    assert exunet.load_result(tmp_path / "here").complete
    summary = json.loads((tmp_path / "here/summary.json").read_text())
    assert "interrupted" in summary["ensemble"]["refused"]


@pytest.mark.slow
def test_without_numba_a_run_has_no_perturbed_runs(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(run_command, "numba_installed", lambda: False)
    done = command("run", *SHORT, "--spread", 8, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "here/summary.json").read_text())
    assert "Numba" in summary["ensemble"]["refused"]


@pytest.mark.slow
def test_exunet_ensemble_writes_file_and_figures_and_overwrites_nothing(tmp_path: Path) -> None:
    """The default folder, then the next free one; in a given one only with --overwrite."""
    settings = ("solver={tolerance=1e-5, method='DOPRI5'}", "time.end=0.7")
    arguments = ("ensemble", CASES / "planar_undamped.toml", "-n", 8, "--perturb", 1e-6)
    arguments += tuple(word for setting in settings for word in ("--set", setting))
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    (folder,) = (tmp_path / "results").iterdir()
    assert {path.name for path in folder.iterdir()} == {
        "ensemble.h5",
        *(f"{name}.png" for name in ENSEMBLE_FIGURES),
    }
    first = (folder / "ensemble.h5").read_bytes()
    refused = command(*arguments, "--out", folder, folder=tmp_path)
    assert refused.returncode == 2
    assert (folder / "ensemble.h5").read_bytes() == first
    of_case = ("--set", "seed=1")
    done = command(*arguments, *of_case, "--out", folder, "--overwrite", "--quiet", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert exunet.load_ensemble(folder).provenance["seed"] == 1


@pytest.mark.parametrize(
    "given", [("-n", 0), ("-n", "x"), ("--perturb=-1",), ("--perturb", "nan"), ("--seed=-1",)]
)
def test_bad_options_of_an_ensemble_end_with_2_and_write_nothing(
    tmp_path: Path, given: tuple[object, ...]
) -> None:
    assert command("ensemble", PLANAR, *given, folder=tmp_path).returncode == 2
    assert not list(tmp_path.iterdir())


def test_only_the_result_of_a_folder_has_its_perturbed_runs(tmp_path: Path, run: exunet.Result) -> None:
    """Another result that lies in the folder of a run is not what the file beside describes."""
    exunet.save_ensemble(scattered(run, largest_tension_N=[90.0, 99.0]), tmp_path / SPREAD_FILE)
    for name in ("result.h5", "other.h5"):
        exunet.save(run, tmp_path / name)
    assert exunet.load_result(tmp_path / "result.h5").spread_file == tmp_path / SPREAD_FILE
    assert exunet.load_result(tmp_path / "other.h5").spread_file is None

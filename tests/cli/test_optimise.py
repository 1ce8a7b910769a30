"""Optimised studies: the search, constraints, fresh samples, and going on."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import PLANAR, command

from exunet.base.errors import CaseError, MissingExtra
from exunet.studies import optimise as optimisation
from exunet.studies.inputs import InputConfig, Statistic
from exunet.studies.optimise import Optimum, Trial, best_of, gain, optimise, search
from exunet.studies.study import Study, StudyTable

OVER = {name: InputConfig.model_validate({"uniform": [-1.0, 1.0]}) for name in "xy"}
NOISE = 0.1  # standard deviation, of the range of the quadratic
RANGE = 1.3**2 + 1.4**2  # from the optimum (0.3, -0.4) to the farthest corner (-1, 1)


def below(values: dict[str, Any]) -> float:
    """How far the quadratic is below its optimum, as a part of its range."""
    return float((values["x"] - 0.3) ** 2 + (values["y"] + 0.4) ** 2) / RANGE


def found_by(seed: int, designs: int = 40) -> list[Trial]:
    pytest.importorskip("optuna")
    noise = np.random.default_rng(seed).normal(0.0, NOISE, designs)

    def score(first: int, values: Sequence[dict[str, Any]]) -> list[Any]:
        return [((noise[first + k] - below(item),), ()) for k, item in enumerate(values)]

    return search(OVER, 1, designs, seed, score)


def test_the_search_comes_within_a_tenth_of_the_range_of_a_noisy_quadratic() -> None:
    near = 0
    for seed in range(10):
        trials = found_by(seed)
        near += below(trials[best_of(trials)[0]].values) < 0.1
    assert near >= 8
    assert [trial.values for trial in found_by(9, 16)] == [trial.values for trial in trials[:16]]


def test_a_design_that_breaks_a_constraint_is_not_the_best() -> None:
    """x >= 0.6 moves the optimum; a design without a score is not the best either."""
    pytest.importorskip("optuna")

    def score(first: int, values: Sequence[dict[str, Any]]) -> list[Any]:
        return [((-below(v) if v["x"] > -0.9 else -np.inf,), (v["x"] - 0.6,)) for v in values]

    trials = search(OVER, 1, 40, 1, score)
    best = trials[best_of(trials)[0]]
    assert 0.6 <= best.values["x"] < 0.8
    assert abs(best.values["y"] + 0.4) < 0.3


def test_two_objectives_give_a_front() -> None:
    scores = [(0.0, 3.0), (1.0, 2.0), (0.5, 2.0), (2.0, 1.0), (2.0, 1.0), (3.0, 0.0)]
    trials = [Trial({}, both, (-1.0,) if both == (3.0, 0.0) else (1.0,)) for both in scores]
    assert best_of(trials) == [0, 1, 3]  # 2 is dominated, 4 is the same as 3, 5 is not feasible


@pytest.mark.parametrize(
    ("text", "bounded", "expected"),
    [
        ("probability(captured)", False, 1 / 4),  # a run without an outcome is a miss
        ("-probability(captured)", False, -2 / 4),  # or a hit, where hits are bad
        ("quantile(force, 0.75)", False, 0.25),  # of -inf, 0, 0, 1
        ("-quantile(force, 0.25)", False, 0.0),  # -1 times that of 0, 0, 1, inf
        ("median(force) <= 20", True, -0.5),
    ],
)
def test_runs_without_a_value_count_as_the_worst(text: str, bounded: bool, expected: float) -> None:
    quantity = Statistic.parse(text, bounded=bounded)
    assert quantity.value(np.array([1.0, 0.0, 0.0, np.nan])) == pytest.approx(expected)
    assert quantity.bound == (-20.0 if bounded else None)


def test_a_gain_has_the_interval_of_pairs() -> None:
    """Values of large scatter, all better by 0.1: only pairs show it."""
    first = np.random.default_rng(1).normal(0.0, 10.0, 200)
    quantity = Statistic.parse("-median(force)", bounded=False)
    found = gain(quantity, first, first - 0.1, 1)
    assert (found.value, found.low, found.high) == pytest.approx((0.1, 0.1, 0.1))


STUDY = f"""\
format = 1
case = "{PLANAR}"
design = "random"
runs = 2
set = ["time.end=0.05", "time.output_step=0.01", "engine.backend=compiled"]
[inputs]
"initial.packing" = {{ uniform = [0.08, 0.12] }}
[optimise]
maximise = "-median(bullet_speed_at_end_m_s)"
constraints = ["quantile(bullet_speed_at_end_m_s, 0.9) >= 1.0"]
designs = 9
[optimise.over]
"launch.radial_speed" = {{ uniform = [2.0, 3.0] }}
"""


def test_an_optimised_study_goes_on_with_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In free flight bullets keep their speed: the slowest launch of nine is the best."""
    pytest.importorskip("optuna")
    monkeypatch.setattr(optimisation, "FRESH", 3)
    path, folder = tmp_path / "best.toml", tmp_path / "out"
    path.write_text(STUDY, encoding="utf-8")
    done = command("study", path, "--out", folder, "--workers", 1, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    found = Optimum.of(StudyTable(folder))
    assert found is not None
    assert found.fresh is not None
    speeds = [trial.values["launch.radial_speed"] for trial in found.trials]
    assert found.best == [int(np.argmin(speeds))]
    fresh = StudyTable(folder / found.fresh)
    slow = fresh.case(1).scene.launch
    assert slow is not None
    assert slow.radial_speed == min(speeds)
    assert len(fresh) == 2 * 3
    before = {place: place.stat().st_mtime_ns for place in (folder / "designs").rglob("*.sqlite")}
    seconds = fresh.seconds.tolist()
    optimise(Study.read(path), folder, workers=1)
    assert Optimum.of(StudyTable(folder)) == found
    assert StudyTable(folder / found.fresh).seconds.tolist() == seconds
    assert len(before) == 2


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("-median(bullet", "-mean(bullet", 9),
        (">= 1.0", "> 1.0", 10),
        ("launch.radial_speed", "launch.radial_sped", 12),
        ("uniform = [2.0, 3.0]", "normal = [2.0, 3.0]", 13),
        ("launch.radial_speed", "initial.packing", 13),
    ],
)
def test_a_wrong_search_is_refused_before_any_run(old: str, new: str, line: int, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace(old, new), encoding="utf-8")
    with pytest.raises(CaseError) as error:
        Study.read(path).validate()
    assert f"{path}:{line}" in [fault.place for fault in error.value.faults]


def test_without_optuna_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    with pytest.raises(MissingExtra):
        optimise(Study.read(path), tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()

"""Runs side by side: each has the bits that it has alone, whoever its neighbours are."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scenes import STRONG, text_of, thrown

import exunet
from exunet.integrators.compiled.vectorised_runs import side_by_side_kernel
from exunet.kernels.compile import WIDTH
from exunet.kernels.kernel import Kernel
from exunet.methods.method import Method
from exunet.simulation.preparation import Start, prepare
from exunet.studies import ensemble, measured_runs
from exunet.studies.ensemble import Ensemble, kernel_of_many, perturbed_positions, run_ensemble

DAMPED: dict[str, Any] = {"effects": {"rayleigh_damping": {"alpha": 0.3, "beta": 1e-6}}}


def compiles(test: Any) -> Any:
    """It compiles kernels that no other test has, some ten seconds each."""
    return pytest.mark.slow(test)


def start(method: str = "VelocityVerlet", step: float = 5e-5, end: float = 0.3, **tables: Any) -> Start:
    return prepare(thrown({"method": method, "step": step}, end=end, **tables))


def moved(begin: Start, runs: int) -> Any:
    return perturbed_positions(begin, runs, 1e-6, seed=7)


def same(one: Ensemble, other: Ensemble) -> None:
    for field in fields(Ensemble):
        a, b = getattr(one, field.name), getattr(other, field.name)
        same = a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b
        assert same, field.name


@pytest.mark.ci_for("RK44")
@pytest.mark.slow
@compiles
@pytest.mark.parametrize(
    ("method", "tables"),
    [
        pytest.param("VelocityVerlet", DAMPED, id="VelocityVerlet-damped"),
        pytest.param("VelocityVerlet", {}, id="VelocityVerlet"),
        pytest.param("RK44", DAMPED, id="RK44-damped"),
        pytest.param(
            "VelocityVerlet",
            {"effects": {name: STRONG[name] for name in ("gravity", "thermal_strain", "rayleigh_damping")}},
            id="VelocityVerlet-loads",
        ),
    ],
)
def test_each_run_has_the_bits_that_it_has_alone(method: str, tables: dict[str, Any]) -> None:
    begin = start(method, **tables)
    places = moved(begin, 3)
    together = run_ensemble(begin, places, together=True)
    assert together.tension.max() > 0.0
    assert len(set(together.largest_tension.tolist())) == 3
    same(together, run_ensemble(begin, places, together=False))


@pytest.mark.ci
@pytest.mark.slow
@compiles
def test_neither_the_place_among_others_nor_the_workers_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = start(**DAMPED)
    places = moved(begin, WIDTH + 3)
    found = run_ensemble(begin, places, together=True)
    same(found, run_ensemble(begin, places, together=True, workers=3))
    back = run_ensemble(begin, places[::-1], together=True)
    assert np.array_equal(found.time, back.time)
    for field in fields(Ensemble):
        one, other = getattr(found, field.name), getattr(back, field.name)
        if isinstance(one, np.ndarray) and field.name != "time":
            assert np.array_equal(one, other[::-1]), field.name
    for limit in ("_MOST_VALUES", "_MOST_WORK"):  # as many times in one go as there must be
        with monkeypatch.context() as less:
            less.setattr(measured_runs, limit, 1)
            same(found, run_ensemble(begin, places, together=True))


@pytest.mark.slow
@compiles
def test_a_run_that_stops_among_others_is_named_and_may_begin_anew() -> None:
    """In the words, and with the finer steps, that it has alone; the others are not disturbed."""
    begin = start(step=1e-4, end=0.2, **DAMPED)
    places = moved(begin, 4)
    speeds = np.stack([begin.velocity] * 4)
    speeds[2] *= 40.0  # too fast for the step
    words = []
    for together in (True, False):
        with pytest.raises(exunet.RunStopped, match="run 12 of the ensemble diverged") as stop:
            run_ensemble(begin, places, speeds, together=together, first=10)
        words.append(str(stop.value))
    assert words[0] == words[1]
    found = run_ensemble(begin, places, speeds, together=True, retries=6)
    assert found.right_hand_sides[2] > found.right_hand_sides[0]
    same(found, run_ensemble(begin, places, speeds, together=False, retries=6))


@pytest.mark.slow
@compiles
def test_an_interrupt_ends_runs_side_by_side() -> None:
    begin = start(end=0.2, **DAMPED)

    def press_ctrl_c(done: int) -> None:
        if done == WIDTH + 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_ensemble(begin, moved(begin, 5 * WIDTH), together=True, progress=press_ctrl_c)


@pytest.mark.ci
@pytest.mark.slow
@compiles
def test_an_ensemble_of_a_case_is_the_same_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = start(end=0.2, **DAMPED)
    found = []
    for pays in (0.0, np.inf):
        monkeypatch.setattr(Kernel, "compiled_before", False)
        monkeypatch.setattr(ensemble, "_PAYS", pays)
        found.append(exunet.ensemble(begin, 10, perturb=1e-6))
    for key, values in found[0].headlines.items():
        assert values.tobytes() == found[1].headlines[key].tobytes(), key
    for key, values in found[0].quantiles.items():
        assert values.tobytes() == found[1].quantiles[key].tobytes(), key


@pytest.mark.parametrize(
    ("method", "tables"),
    [
        ("VelocityVerlet", {"effects": {"material_damping": {"relaxation_time": 1e-7}}}),
        ("VelocityVerlet", {"effects": {"breaking": {"strain": 0.1}}}),
        ("VelocityVerlet", {"effects": {"air_drag": STRONG["air_drag"]}}),
        ("VelocityVerlet", {"bodies": {"wheel": {"mass": 2.0, "inertia": [0.2, 0.3, 0.4]}}}),
    ],
    ids=["viscous", "breaking", "air", "body"],
)
def test_scenes_that_cannot_go_side_by_side(method: str, tables: dict[str, Any]) -> None:
    begin = start(method, **tables)
    assert side_by_side_kernel(begin.system, begin.plan) is None
    assert kernel_of_many(begin, 10**6, together=True) is None


def test_steps_that_each_run_chooses_cannot_go_side_by_side() -> None:
    begin = prepare(thrown({"method": "DOPRI5", "tolerance": 1e-6}))
    assert side_by_side_kernel(begin.system, begin.plan) is None


def test_what_pays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel that is compiled already always does; another one for many runs."""
    begin = start()
    monkeypatch.setattr(Kernel, "compiled_before", False)
    assert kernel_of_many(begin, 2) is None
    assert kernel_of_many(begin, 10**6) is not None
    assert kernel_of_many(begin, 10**6, together=False) is None
    monkeypatch.setattr(Kernel, "compiled_before", True)
    assert kernel_of_many(begin, 2) is not None


def test_one_text_for_all_numbers() -> None:
    """Another step, another coefficient or another method is no other kernel; another effect is."""
    kernels = []
    for alpha, step in ((0.3, 1e-4), (0.1, 5e-5)):
        effects = {"rayleigh_damping": {"alpha": alpha, "beta": 1e-6}}
        begin = start(step=step, effects=effects)
        kernels.append(side_by_side_kernel(begin.system, begin.plan))
    plan = replace(begin.plan, method=Method.RK44)
    assert kernels[0] is not None
    assert kernels[1] is not None
    assert text_of(kernels[0]) == text_of(kernels[1])
    by_other_steps = side_by_side_kernel(begin.system, plan)
    assert by_other_steps is not None
    assert text_of(by_other_steps) == text_of(kernels[0])
    undamped = start(effects={})
    other = side_by_side_kernel(undamped.system, undamped.plan)
    assert other is not None
    assert text_of(other) != text_of(kernels[0])

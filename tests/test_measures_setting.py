"""solver.accuracy_of = "measures": what it chooses, what it says, and that measures are not shifted."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

import exunet
from exunet.base.errors import CaseError
from exunet.cli.check import describe
from exunet.cli.run import rows_on_measures
from exunet.methods.method import Method
from exunet.model.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.simulation import auto
from exunet.simulation.preparation import Start, prepare
from exunet.studies.spread import spread_of

ROOT = Path(__file__).parent.parent
PLANAR = ROOT / "cases" / "planar_undamped.toml"
ASKED = 'solver={accuracy_of="measures"}'
LARGE = "net.mesh=0.5"  # 224 elements


def start(*overrides: str) -> Start:
    return prepare(exunet.load(PLANAR, [ASKED, *overrides]).scene)


def test_the_trajectory_is_the_default() -> None:
    plain, named = (
        prepare(exunet.load(PLANAR, [f"solver={keys}"]).scene).plan
        for keys in ("{}", '{accuracy_of="trajectory"}')
    )
    assert plain == named


def test_small_nets_take_the_tolerance_of_measures() -> None:
    plan = start().plan
    assert plan.method == Method.DOPRI5
    assert plan.tolerance == 2.5 * auto.measure_settings().tolerance  # 2.5 m/s: the launch speed
    assert any("fewer than 200 elements" in note for note in plan.notes)


def test_large_nets_take_a_part_of_the_stable_step() -> None:
    found = start(LARGE)
    limit = stable_step(
        Method.VELOCITY_VERLET, largest_frequency(found.system), largest_damping_rate(found.system)
    )
    assert found.net.n_elements == 224
    assert found.plan.method == Method.VELOCITY_VERLET
    assert found.plan.step == pytest.approx(auto.measure_settings().step * limit, rel=1e-12)
    assert found.plan == start(LARGE).plan


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("effects.rayleigh_damping={alpha=0.0,beta=1e-4}", "damping is strong"),
        ("effects.thrust={bullets=[0],time=[0.0,1.0],force=[[0,0,1],[0,0,1]]}", "change at events"),
        ("bodies.debris={mass=1.0,inertia=[1.0,1.0,1.0]}", "bodies rotate"),
    ],
)
def test_where_velocity_verlet_was_not_measured_another_method_stands_in(change: str, why: str) -> None:
    plan = start(LARGE, change).plan
    assert plan.method == Method.DOPRI5
    assert any(why in note for note in plan.notes)


def test_a_named_method_gets_its_setting_and_no_promise_where_it_has_none() -> None:
    named = start("solver.method=VelocityVerlet").plan
    assert named.method == Method.VELOCITY_VERLET
    assert any("accuracy of the measures unknown" in note for note in named.notes)
    assert start(LARGE, "solver.method=DOPRI5").plan.method == Method.DOPRI5


@pytest.mark.parametrize("change", [(), (LARGE,)])
def test_check_tells_method_setting_reason_and_promise(change: tuple[str, ...]) -> None:
    rows = describe(exunet.load(PLANAR, [ASKED, *change]))
    told = " ".join(words for name, words in rows if name in ("method", "note"))
    for words in ("measures:", "within a third of their spread", "not the trajectory", "beyond the horizon"):
        assert words in told


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("accuracy = 1e-3", "accuracy:"),
        ("tolerance = 1e-3", "tolerance:"),
        ('method = "VelocityVerlet"\nstep = 1e-5', "step:"),
        ('method = "RK44"', "accuracy_of:"),
    ],
)
def test_settings_beside_it_are_refused_with_file_and_line(tmp_path: Path, line: str, words: str) -> None:
    path = tmp_path / "case.toml"
    text = PLANAR.read_text(encoding="utf-8")
    head, rest = text.split("[solver]\n")[0], text[text.index("[net]") :]
    path.write_text(f'{head}[solver]\naccuracy_of = "measures"\n{line}\n{rest}', encoding="utf-8")
    with pytest.raises(CaseError) as found:
        exunet.load(path)
    number = head.count("\n") + (2 if "accuracy_of:" in words else 2 + len(line.splitlines()))
    assert f"{path}:{number}: solver.{words}" in str(found.value)


def test_another_word_is_refused() -> None:
    with pytest.raises(CaseError, match=r'solver\.accuracy_of: must be one of "trajectory", "measures"'):
        exunet.load(PLANAR, ["solver.accuracy_of=speed"])


@pytest.mark.slow
def test_beyond_the_horizon_a_run_tells_what_measures_would_cost() -> None:
    """The paper's net: its horizon lies at 1.6 s, tests/cross_code/reference/."""
    late, early = (exunet.load(PLANAR, ["engine.backend=compiled", f"time.end={end}"]) for end in (2.0, 0.6))
    ((name, words),) = rows_on_measures(late.scene, spread_of(prepare(late.scene), 8))
    assert name == "measures"
    assert 'accuracy_of="measures"' in words
    assert rows_on_measures(early.scene, spread_of(prepare(early.scene), 8)) == []


@pytest.mark.slow
def test_before_the_horizon_large_nets_are_told_to_take_the_trajectory() -> None:
    early = exunet.load(PLANAR, [ASKED, "engine.backend=compiled", LARGE, "time.end=0.9"])
    spread = spread_of(prepare(early.scene), 8)
    errors = [item.error for item in spread.judged.values() if item.headline.name == "largest_area"]
    rows = rows_on_measures(early.scene, spread)
    assert bool(rows) == (errors[0] is not None and errors[0] > 1e-3 * spread.judged["largest_area_m2"].value)


def benchmark() -> Any:
    """benchmarks/measures.py, which is no package."""
    spec = importlib.util.spec_from_file_location("measures_benchmark", ROOT / "benchmarks" / "measures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclasses
    spec.loader.exec_module(module)
    return module


def test_there_are_sixteen_scenes() -> None:
    found = benchmark()
    assert len(found.SCENES) == 16
    told = (ROOT / "benchmarks" / "measures.md").read_text(encoding="utf-8")
    assert all(f"| {name} |" in told for name in found.SCENES)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rectangular", "gravity", "soft threads"])
def test_measures_are_not_shifted(name: str) -> None:
    """Two one-sided tests at 5 %, of scenes of benchmarks/measures.md: rectangular, forced, and soft."""
    found = benchmark().study(name)
    for measure, shift in found.shifts.items():
        assert shift is None or shift.shown, (measure, shift)

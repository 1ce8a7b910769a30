"""solver.accuracy_of = "measures": what it chooses, what it says, and that measures are not shifted."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import exunet
from exunet.base.errors import CaseError, InputError
from exunet.methods.method import Method
from exunet.model.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.simulation import auto
from exunet.simulation import expected_time as module
from exunet.simulation.expected_time import expected_time, stored_bytes, validate_disk
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.simulation import Simulation

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "cases" / "planar_undamped.toml"
ASKED = 'solver={accuracy_of="measures"}'
LARGE = "net.mesh=0.5"  # 224 elements


def start(*overrides: str) -> Start:
    return prepare(exunet.load(PLANAR, [ASKED, *overrides]).scene)


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


def benchmark() -> Any:
    """benchmarks/measures.py, which is no package."""
    spec = importlib.util.spec_from_file_location("measures_benchmark", ROOT / "benchmarks" / "measures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclasses
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rectangular", "gravity", "soft threads"])
def test_measures_are_not_shifted(name: str) -> None:
    """Two one-sided tests at 5 %, of scenes of benchmarks/measures.md: rectangular, forced, and soft."""
    found = benchmark().study(name)
    for measure, shift in found.shifts.items():
        assert shift is None or shift.shown, (measure, shift)


# Expected wall time

DEPLOYMENT = ROOT / "cases" / "planar_deployment.toml"


def timed_start(*overrides: str) -> Start:
    return prepare(exunet.load(DEPLOYMENT, ["engine.backend=compiled", *overrides]).scene)


def test_the_pace_of_the_first_steps_is_multiplied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal steps of 1e-4 s over 2 s are 20,000; each takes 1 ms of a clock that counts steps."""
    made: list[Simulation] = []

    def counted(given: Start) -> Simulation:
        made.append(Simulation(given))
        return made[-1]

    monkeypatch.setattr(module, "Simulation", counted)
    clock = SimpleNamespace(perf_counter=lambda: 1e-3 * made[0].counts.steps)
    monkeypatch.setattr(module, "clock", clock)
    seconds = expected_time(timed_start("solver={method='RK44', step=1e-4}"))
    assert seconds == pytest.approx(20.0, rel=0.05)  # stops between the steps shorten some
    assert 300 < made[0].counts.steps < 1000


def test_states_beyond_the_disk_or_memory_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begin = timed_start("time.end=0.01")
    validate_disk(begin, tmp_path)
    monkeypatch.setattr(module, "disk_left", lambda _folder: 2 * stored_bytes(begin) - 1)
    with pytest.raises(InputError, match=r"11 stored states .* of disk"):
        validate_disk(begin, tmp_path)
    monkeypatch.setattr(module, "memory_left", lambda: stored_bytes(begin) - 1)
    with pytest.raises(InputError, match="of memory"):
        exunet.run(begin)

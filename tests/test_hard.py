"""The gallery of hard cases (cases/hard), in each form of the engine and in the reference."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import reference_impl as reference
from exunet.base.errors import InputError, RunStopped
from exunet.methods.method import Backend
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.verification import hard
from exunet.verification.check import Check
from exunet.verification.hard import GALLERY, ITEMS, Hard
from exunet.verification.one_step import Step
from exunet.verification.tolerances import Tolerance

CASES = Path(__file__).parent.parent / "cases" / "hard"
SLOW_IN_LOOP = {"long_undamped", "mesh_50x50", "every_step", "odd_times"} | {
    entry.case
    for entry in GALLERY
    if entry.item == 11  # kernels of their own
}
IDS = {"ids": lambda value: value.case if isinstance(value, Hard) else str(value)}
QUICK = [item for item in GALLERY if item.case not in SLOW_IN_LOOP]


def hold(checks: list[Check]) -> None:
    assert checks
    failed = [f"{c.name}: {c.measured:.3g} {c.verdict} {c.worst}" for c in checks if not c.holds]
    assert failed == []


def test_every_file_of_the_gallery_is_in_its_table_and_every_item_has_one():
    assert {path.stem for path in CASES.glob("*.toml")} == {item.case for item in GALLERY} | {"implicit"}
    assert {entry.item for entry in GALLERY} | {5} == set(ITEMS)


@pytest.mark.ci_for("spinning")
@pytest.mark.slow_for("spinning", "near_limit", "taut_string", "heavy_bullets", "strong_damping")
@pytest.mark.parametrize("one", QUICK, **IDS)
def test_in_the_compiled_loop(one):
    hold(list(hard.on_backend(one, Backend.COMPILED)))


@pytest.mark.slow
@pytest.mark.parametrize("one", [item for item in GALLERY if item not in QUICK], **IDS)
def test_in_the_compiled_loop_at_length(one):
    hold(list(hard.on_backend(one, Backend.COMPILED)))


@pytest.mark.slow
@pytest.mark.parametrize("one", GALLERY, **IDS)
def test_in_exudyn(one):
    hold(list(hard.on_backend(one, Backend.EXUDYN)))


@pytest.mark.slow
def test_shorter_cases_in_exudyn():
    short = {"all_in_one_point", "folded", "slack", "overstretched", "soft_threads", "one_element", "tether"}
    for item in GALLERY:
        if item.case in short:
            hold(list(hard.on_backend(item, Backend.EXUDYN)))


@pytest.mark.slow
@pytest.mark.parametrize("one", GALLERY, **IDS)
def test_in_the_reference(one):
    checks = list(hard.of_reference(one))
    assert checks[0].left_out == isinstance(one.reference, str)
    hold(checks)


@pytest.mark.slow
def test_a_case_of_contact_in_the_compiled_loop():
    hold(
        list(
            hard.on_backend(
                next(item for item in GALLERY if item.case == "starts_in_contact"), Backend.COMPILED
            )
        )
    )


@pytest.mark.parametrize(
    ("case", "why"), [("near_limit", "quarter of an hour"), ("fast_bullet", "has no contact")]
)
def test_what_the_gallery_leaves_out_is_told(case, why):
    (row,) = hard.of_reference(next(item for item in GALLERY if item.case == case))
    assert row.left_out
    assert why in row.worst


@pytest.mark.ci
@pytest.mark.slow
def test_momenta_are_checked_in_the_reference():
    one = next(item for item in GALLERY if item.case == "one_element")
    names = [check.name for check in hard.of_reference(one)]
    assert names == ["energy balance", "linear momentum", "angular momentum"]


def test_the_turns_of_the_spinning_net_are_counted_in_the_reference():
    """One revolution a second (spin 2 pi): after 2 s it lacks 98 of 100."""
    from exunet.verification.hard import _turns

    one = next(item for item in GALLERY if item.case == "spinning")
    assert one.of_both is _turns
    short = reference.load(hard.case_path("spinning"), {"time.end": 2.0, "time.output_step": 0.02})
    run = short.integrate(method="EM", step=0.02)
    found = {check.name: check.measured for check in _turns(hard.states_of(short, run), None)}
    assert found["100 revolutions, turned"] == pytest.approx(98.0, abs=0.01)
    assert found["slack elements"] == 0.0


@pytest.mark.parametrize("backend", list(Backend))
def test_a_step_above_the_stable_one_is_refused_or_caught(backend):
    checks = list(hard.above(backend))
    hold(checks)
    assert [check.name.split(": ")[1] for check in checks] == ["refused", "stopped"]


@pytest.mark.slow
def test_implicit_methods_keep_their_bound_or_are_stopped():
    """The names of the checks tell which: at these steps, and on these snaps, the guards stop them all."""
    checks = list(hard.implicit())
    hold(checks)
    assert len(checks) == 8
    assert all("stopped at" in check.name or "ran to the end" in check.name for check in checks)


@pytest.mark.ci
@pytest.mark.slow
def test_an_implicit_run_must_be_stopped_by_a_guard():
    """A stop of another kind, however small the energy of the part that is kept, does not hold."""
    settings = ("solver.step=1e-3", "time.end=0.6", "engine.backend=exudyn")
    with pytest.raises(RunStopped) as stop:
        simulate(prepare(load(hard.case_path("implicit"), settings).scene))
    told = hard.stopped("GeneralizedAlpha", stop.value)
    assert told.holds
    assert re.fullmatch(r"GeneralizedAlpha: stopped at 0\.\d+ s, energy \+0\.\d+ J", told.name)
    other = RunStopped("the engine stopped after t = 0.5 s: Newton did not converge", stop.value.result)
    assert not hard.stopped("GeneralizedAlpha", other).holds


@pytest.mark.slow
def test_the_energy_momentum_method_is_exact_at_any_step():
    hold(list(hard.energy_momentum()))


def test_a_bound_that_is_broken_is_told():
    """7e-8 of the energy is what one snap costs at this tolerance."""
    from dataclasses import replace

    from exunet.verification.tolerances import HARD_FIXED

    one = next(item for item in GALLERY if item.case == "one_element")
    tight = replace(HARD_FIXED, value=1e-12)
    failed = [
        check.name
        for check in hard.on_backend(replace(one, energy=tight), Backend.COMPILED)
        if not check.holds
    ]
    assert failed == ["energy balance"]


@pytest.mark.parametrize(("measured", "code"), [(0.5, 0), (2.0, 1), (None, 130)])
def test_the_gallery_writes_its_report(monkeypatch, tmp_path, capsys, measured, code):
    """All hold: 0; one fails: 1; Ctrl-C: 130, and what was done is in the report."""
    from exunet.cli import verify as command

    def checks() -> Iterator[Check]:
        yield Check("one thing", 0.25, Tolerance(1.0, "a reason", "x"))
        if measured is None:
            raise KeyboardInterrupt
        yield Check("another thing", measured, Tolerance(1.0, "a reason", "x"))

    monkeypatch.setattr(hard, "steps", lambda quick: iter([Step(6, "a net", checks)]))
    assert command.verify_hard(tmp_path / "deep" / "hard", quick=True, processes=1) == code
    report = (tmp_path / "deep" / "hard" / "hard.md").read_text(encoding="utf-8")
    assert "| a net | one thing | 0.25 x | 1 x | holds |" in report
    assert ("INCOMPLETE" in report) == (code == 130)
    assert ("## What fails" in report) == (code == 1)
    assert "HARD_GROWTH" in report
    assert "SNAP" not in report
    assert "hard.md" in capsys.readouterr().out


def test_a_folder_that_cannot_be_written_is_told_before_anything_runs(monkeypatch, tmp_path):
    from exunet.cli import verify as command

    (tmp_path / "file").write_text("")
    monkeypatch.setattr(hard, "steps", lambda quick: iter([Step(1, "a net", lambda: pytest.fail("ran"))]))
    with pytest.raises(InputError):
        command.verify_hard(tmp_path / "file" / "hard", quick=True)


def test_ctrl_c_is_no_finding(monkeypatch):
    """A run's `Interrupted` is a RunStopped too: taken for one, the gallery would go on and tell a fault."""
    from exunet.base.errors import Interrupted

    def interrupted(_start):
        raise Interrupted("interrupted after t = 0.1 s")

    monkeypatch.setattr("exunet.verification.hard.simulate", interrupted)
    subjects = (f"{GALLERY[0].case}, compiled", "implicit, exudyn")
    chosen = [step for step in hard.steps() if step.subject in subjects]
    for step in (*chosen, Step(6, "near_limit, compiled", lambda: hard.above(Backend.COMPILED))):
        with pytest.raises(KeyboardInterrupt):
            list(step.run())
    assert len(chosen) == 2

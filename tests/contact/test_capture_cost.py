"""`exunet cost` on a capture: distributions over perturbed starts compared with the finest setting."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from contact_scenes import THROWN

import exunet
from exunet.base.errors import ExunetError, InputError
from exunet.cli.cost import cost
from exunet.integrators.protocol import StepCounts
from exunet.methods.method import Backend, Method
from exunet.results.course import course_of
from exunet.results.headline import Headline
from exunet.scene.casefile import Case
from exunet.simulation.preparation import prepare_case
from exunet.simulation.run import simulate
from exunet.studies.cost import study as studies
from exunet.studies.cost.report import figure_of, recommendation, write_csv
from exunet.studies.cost.runs import Run, Sample, Subject, quantities_of, sample_of
from exunet.studies.cost.settings import Setting, Varied, settings_of_distribution
from exunet.studies.cost.study import (
    Comparison,
    Row,
    Status,
    Study,
    Verdict,
    compare,
    compare_distributions,
    run_study,
    study_of,
)

RULE = '[capture]\ntarget = "box"\nenclosed = 0.5\ntouching = 1\nduration = 0.01\n'
SHORT = ("time.end=0.04", "solver.step=4e-5")  # the net touches the box from 20 ms on


@pytest.fixture
def case(tmp_path: Path) -> Case:
    path = tmp_path / "thrown.toml"
    path.write_text(f"{THROWN}\n{RULE}")
    return exunet.load(path, SHORT)


def ran(case: Case, budget: float = 200.0) -> Study:
    """Study without the engine's backends, which take long."""
    study = study_of(case, runs=2)
    study.rows = [row for row in study.rows if row.setting.varied != Varied.BACKEND]
    left = iter([budget] * 10**6)
    run_study(study, lambda: next(left), lambda words: None)
    return study


def test_each_setting_differs_from_the_case_in_one_thing(case: Case) -> None:
    settings = settings_of_distribution(case)
    found = {setting.name: setting for setting in settings}
    steps = [item.size / 4e-5 for item in settings if item.varied == Varied.SIZE]
    assert steps == [1.0, 0.25, 4.0, 2.0, 0.5]  # the case and the finest first
    assert len([element for element in settings if element.backend == Backend.COMPILED]) == 8
    stiff, soft = found["contact stiffness x 2"], found["contact stiffness x 1/2"]
    assert (stiff.size, soft.size) == (2e-5, 4e-5)
    assert stiff.changes == ("effects.contact.stiffness=20000.0", "effects.contact.bullet_stiffness=2000.0")
    fine = found["divisions x 2"]
    assert fine.changes == ("net.divisions=8", "net.strings.divisions=2")
    subject = Subject.of(case)
    elements = [subject.prepare(entry).net.n_elements for entry in (fine, found["step x 1"])]
    assert elements[0] == 2 * elements[1]
    coarse = settings_of_distribution(exunet.load(case.path, ["time.end=0.04", "solver.step=6e-4"]))
    # The stable step of RK44 is 1.47e-3 s here: `exunet check`.
    assert max(one.size for one in coarse if one.varied == Varied.SIZE) == 1.2e-3


def test_a_tolerance_is_varied_where_steps_are_adaptive(case: Case) -> None:
    free = exunet.load(case.path, ["time.end=0.04", 'solver={method="DOPRI5",tolerance=1e-6}'])
    found = {item.name: item for item in settings_of_distribution(free)}
    assert found["tolerance x 1/100"].size == pytest.approx(1e-8)
    assert found["contact stiffness x 2"].size == 1e-6  # steps follow by themselves
    assert Subject.of(free).prepare(found["tolerance x 10"]).plan.tolerance == pytest.approx(1e-5)


@pytest.mark.ci
@pytest.mark.slow
def test_a_whole_study(case: Case, tmp_path: Path) -> None:
    """Files, a row for each setting, and a recommendation that can be run."""
    out = tmp_path / "out"
    assert cost(case, out, budget=200.0, runs=3) == 0
    assert {path.name for path in out.iterdir()} == {"cost.csv", "cost.md", "cost.png", "cost.pdf"}
    assert (out / "cost.png").stat().st_size > 10_000
    with (out / "cost.csv").open(encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert len(rows) == len(settings_of_distribution(case))
    own = rows["step x 1"]
    result = exunet.run(case)
    body = result.bodies["box"]
    gained = np.linalg.norm(body.mass * (body.velocity[-1] - body.velocity[0]))
    assert float(own["momentum_box_N_s"]) == pytest.approx(gained, rel=1e-3)
    first = min(float(one.values[-1, 0]) for name, one in result.states.items() if name.endswith("_first"))
    assert float(own["contact_box_first_s"]) == pytest.approx(first, abs=1e-4)
    assert own["outcomes"] == "touched 3"
    assert all(row["right_hand_sides"] for row in rows.values())
    assert rows["step x 1/4"]["momentum_box_N_s_shift"] == ""  # the finest
    text = (out / "cost.md").read_text(encoding="utf-8")
    (option,) = [line for line in text.splitlines() if "--set 'solver=" in line]
    chosen = option.partition("--set '")[2].rpartition("'")[0]
    assert exunet.load(case.path, ["time.end=0.04", chosen]).scene.solver.step is not None


def own_setting(case: Case) -> Any:
    return course_of(simulate(Subject.of(case).prepare(settings_of_distribution(case)[0])))


def test_a_scene_without_a_criterion_is_compared_by_what_it_touches(case: Case) -> None:
    course = own_setting(exunet.load(case.path, [*SHORT, "capture="]))
    assert [quantity.key for quantity in quantities_of(course)] == ["momentum_box_N_s", "contact_box_first_s"]
    assert sample_of(course).outcome == "touched"


def test_the_momentum_of_a_prescribed_body_is_what_the_net_lost(case: Case) -> None:
    held = ['bodies.box.motion="fixed"', "bodies.box.velocity=", "bodies.box.angular_velocity="]
    case = exunet.load(case.path, [*SHORT, *held])
    result = simulate(Subject.of(case).prepare(settings_of_distribution(case)[0]))
    lost = np.linalg.norm(result.net.mass @ (result.velocity[-1] - result.velocity[0]))
    assert sample_of(course_of(result)).measures["momentum_box_N_s"] == pytest.approx(lost, rel=1e-9)
    assert lost > 1e-4


@pytest.mark.slow
def test_a_setting_that_stops_has_its_reason_and_the_others_go_on(case: Case) -> None:
    # Threads of 3.1 g/m sink in at 1 m/s until they are stopped: 2.1 cm is too deep.
    soft = exunet.load(case.path, ["time.end=0.07", "solver.step=4e-5", "effects.contact.stiffness=14.0"])
    study = ran(soft)
    (failed,) = [row for row in study.rows if row.status == Status.FAILED]
    assert failed.setting.name == "contact stiffness x 1/2"
    assert "is deeper than" in failed.reason
    assert "\n" not in failed.reason
    assert study.recommended not in (None, failed)


def test_what_exceeds_the_budget_is_left_out(case: Case) -> None:
    study = study_of(case, runs=8)
    left = iter(range(12, -(10**6), -1))  # each look at the clock takes a second
    run_study(study, lambda: float(next(left)), lambda words: None)
    assert Status.NOT_RUN in {row.status for row in study.rows}
    assert "budget" in study.rows[0].reason or study.rows[0].status == Status.RAN
    assert dict(recommendation(study))["recommended"].startswith("no two settings")


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_done(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After two of four perturbed runs of the third setting."""
    calls: list[int] = []
    original = studies.perturbed_runs
    monkeypatch.setattr(studies.os, "cpu_count", lambda: 2)

    def pressed(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return original(*arguments)

    monkeypatch.setattr(studies, "perturbed_runs", pressed)
    assert cost(case, tmp_path / "out", budget=200.0, runs=4) == 130
    assert "INCOMPLETE" in (tmp_path / "out" / "cost.md").read_text(encoding="utf-8")
    with (tmp_path / "out" / "cost.csv").open(encoding="utf-8") as file:
        assert {row["perturbed_runs"] for row in csv.DictReader(file)} == {"4", "2", "0"}


def test_a_script_that_may_end_a_run_is_refused(case: Case) -> None:
    with pytest.raises(ExunetError, match="script"):
        study_of(exunet.load(case.path, [*SHORT, 'script=[{name="near",when="range < 1.3",do="stop"}]']))


# Comparison of made-up numbers: normal ones, of a deviation of 1 about 10.

NUMBER = Headline("number", "number", "N s", lambda course: None, digits=6)
FINEST = 10.0 + np.random.default_rng(0).normal(size=16)


def test_a_shift_matters_from_a_third_of_the_range_on() -> None:
    width = float(np.ptp(FINEST))
    for part, matters in ((0.30, False), (0.36, True), (-0.36, True)):
        found = compare(NUMBER, FINEST + part * width, FINEST)
        assert found.shift == pytest.approx(part * width)
        assert found.matters == matters
        assert found.low < found.shift < found.high


def test_a_shift_within_the_range_is_not_significant() -> None:
    """Sixteen of the same distribution; the same, three deviations away; and single runs."""
    same = 10.0 + np.random.default_rng(1).normal(size=16)
    values = (same, same + 3.0, np.array([11.0]), np.array([16.0]))
    assert [compare(NUMBER, value, FINEST).significant for value in values] == [False, True, False, True]
    assert not compare(NUMBER, np.array([16.0]), FINEST).shown_equal  # a single run has no interval


def test_the_printed_digits_decide_where_nothing_is_spread() -> None:
    tight = 10.0 + 1e-9 * np.arange(8)
    for off, matters in ((0.9e-4, False), (1.1e-4, True)):  # the sixth digit of 10 counts 1e-4
        found = compare(NUMBER, tight + off, tight)
        assert (found.matters, found.significant, found.shown_equal) == (matters, matters, not matters)


def test_enough_runs_show_that_a_shift_is_small() -> None:
    """Two one-sided tests at 5 %: of 6 and of 200 of one distribution, a third of whose range is some 1."""
    draw = np.random.default_rng(2)
    few, many = (compare(NUMBER, draw.normal(size=n), draw.normal(size=n)).shown_equal for n in (6, 200))
    assert (few, many) == (False, True)


def made(
    case: Case, *rows: tuple[str, float, float, float], outcomes: tuple[str, ...] = ("touched",)
) -> Study:
    """Study of (name, step, seconds, shift), each of 8 runs in a range of 2; outcomes of all but the last."""
    found = []
    for name, step, seconds, shift in rows:
        varied = Varied.STIFFNESS if name.startswith("contact") else Varied.SIZE
        names = ("touched",) if (name, step, seconds, shift) == rows[-1] else outcomes
        samples = [
            Sample({"number_N_s": 10.0 + shift + x}, (NUMBER,), names[k % len(names)])
            for k, x in enumerate(np.linspace(-1.0, 1.0, 8))
        ]
        setting = Setting(varied, name, Method.RK44, Backend.COMPILED, step=step)
        run = Run(seconds, StepCounts(100, right_hand_sides=400))
        found.append(Row(setting, Status.RAN, "", run, [seconds], samples=samples))
    study = Study(Subject(case, prepare_case(case)), found, None, 8, 1e-9)
    compare_distributions(study)
    return study


def test_the_cheapest_that_holds_is_recommended(case: Case) -> None:
    """Of a range of 2, shifts from 2/3 on matter. Another stiffness is another model, not a setting."""
    study = made(
        case,
        ("step x 8", 8e-5, 0.5, 3.0),
        ("step x 4", 4e-5, 1.0, 0.7),
        ("step x 2", 2e-5, 2.0, 0.1),
        ("contact stiffness x 1/2", 1e-5, 0.1, 0.0),
        ("step x 1/2", 5e-6, 8.0, 0.0),
    )
    assert study.finest is study.rows[4]
    assert study.recommended is study.rows[2]
    verdicts = [row.verdict for row in study.rows[:4]]
    assert verdicts == [Verdict.FAILS, Verdict.OPEN, Verdict.HOLDS, Verdict.HOLDS]
    assert "not shown" in dict(recommendation(study))
    study.rows[2].samples.clear()
    assert study.recommended is study.rows[4]


def test_an_outcome_is_the_same_where_its_share_does_not_differ(case: Case) -> None:
    """Of 8 runs each: one of another kind is chance, four are not (rank test: 0.03)."""
    rows = ("step x 1", 1e-5, 1.0, 0.0), ("step x 1/2", 5e-6, 2.0, 0.0)
    cases = (("touched",) * 7 + ("missed",), True), (("touched", "missed"), False), (("captured",), False)
    for outcomes, same in cases:
        assert made(case, *rows, outcomes=outcomes).rows[0].same_outcome == same


def test_the_figure_shows_medians_with_their_ranges(case: Case, tmp_path: Path) -> None:
    study = made(case, ("step x 1", 1e-5, 1.0, 0.5), ("step x 1/2", 5e-6, 2.0, 0.0))
    setting = Setting(Varied.BACKEND, "backend exudyn", Method.RK44, Backend.EXUDYN, step=1e-5)
    single = Run(30.0, StepCounts(100), sample=study.rows[0].samples[0])
    study.rows.append(Row(setting, Status.RAN, "", single, [30.0]))
    compare_distributions(study)
    figure = figure_of(study)
    assert figure is not None
    axes, _ = figure.axes
    steps, backend = axes.containers
    np.testing.assert_allclose(cast(Any, steps).lines[0].get_xydata(), [[1.0, 10.5], [2.0, 10.0]])
    (bars,) = cast(Any, steps).lines[2]
    np.testing.assert_allclose(bars.get_segments()[1][:, 1], [9.0, 11.0])
    np.testing.assert_allclose(cast(Any, backend).lines[0].get_xydata(), [[30.0, 9.5]])
    write_csv(study, tmp_path / "cost.csv")
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        assert [row["number_N_s_shift"] for row in csv.DictReader(file)] == ["0.5", "", "-0.5"]
    assert figure_of(Study(study.subject, [])) is None


def test_a_comparison_without_a_finest_has_no_shift() -> None:
    found = compare(NUMBER, FINEST, np.zeros(0))
    assert isinstance(found, Comparison)
    assert math.isnan(found.shift)
    assert not found.matters


@pytest.mark.parametrize("until", [1.0, 0.0])
def test_an_end_outside_the_case_is_refused(case: Case, tmp_path: Path, until: float) -> None:
    with pytest.raises(InputError, match="--until"):
        cost(case, tmp_path / "out", until)
    assert not (tmp_path / "out").exists()

"""`exunet cost` on a capture: settings judged by what became of the target, against moved starts."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from contact_scenes import THROWN

import exunet
from exunet.base.errors import InputError, RunStopped
from exunet.case.casefile import Case
from exunet.interfaces.commands.cost import AskedCost, cost
from exunet.methods.method import Form
from exunet.results.course import course_of
from exunet.results.headline import Headline
from exunet.simulation.run import simulate
from exunet.studies.capture_cost import study as studies
from exunet.studies.capture_cost.figure import capture_cost
from exunet.studies.capture_cost.judging import Verdicts, _bias, biases, quantities_of, verdicts
from exunet.studies.capture_cost.rows import recommendation, remark, table, words, write_csv
from exunet.studies.capture_cost.settings import CaptureSetting, Knob, settings_of, the_case
from exunet.studies.capture_cost.study import (
    CaptureRow,
    CaptureStudy,
    CaptureStudyOptions,
    CaptureStudyPlan,
    begun,
    run,
)

RULE = '[verdict]\ntarget = "box"\nenclosed = 0.5\ntouching = 1\nduration = 0.01\n'
SHORT = ("time.end=0.04", "solver.step=4e-5")  # the net touches the box from 20 ms on
COMPILED = 8  # settings of this case in the compiled loop: five steps, two stiffnesses, divisions


@pytest.fixture
def case(tmp_path: Path) -> Case:
    path = tmp_path / "thrown.toml"
    path.write_text(f"{THROWN}\n{RULE}")
    return exunet.load(path, SHORT)


def ran(
    case: Case, asked: CaptureStudyOptions, **more: Any
) -> tuple[CaptureStudy, list[CaptureStudyPlan], list[str]]:
    """The study without forms of Exudyn's, which take long."""
    study, expected, said = begun(case, asked), list[CaptureStudyPlan](), list[str]()
    study.rows = [row for row in study.rows if not row.setting.alone]
    run(study, asked, said.append, expected.append, **more)
    return study, expected, said


def test_the_settings_of_a_capture(case: Case) -> None:
    """Each in one thing; steps follow a stiffer contact, and are none that is above the stable one."""
    found = {one.name: one for one in settings_of(case)}
    steps = [one for one in found.values() if one.knob == Knob.SIZE]
    assert [one.size / 4e-5 for one in steps] == [4.0, 2.0, 1.0, 0.5, 0.25]
    assert the_case(list(found.values())) is found["step x 1"]
    assert len([one for one in found.values() if not one.alone]) == COMPILED
    stiff, soft = found["contact x 2"], found["contact x 1/2"]
    assert (stiff.size, soft.size) == (2e-5, 4e-5)
    assert stiff.changes == ("effects.contact.stiffness=20000.0", "effects.contact.bullet_stiffness=2000.0")
    fine = found["divisions x 2"]
    assert fine.changes == ("net.divisions=8", "net.strings.divisions=2")
    assert fine.start(case).net.n_elements == 2 * found["step x 1"].start(case).net.n_elements
    assert found["fused"].start(case).scene.engine.net == "fused"
    coarse = settings_of(exunet.load(case.path, ["time.end=0.04", "solver.step=6e-4"]))
    # The stable step of RK44 is 1.47e-3 s here: `exunet check`.
    assert max(one.size for one in coarse if one.knob == Knob.SIZE) == 1.2e-3


def test_what_is_chosen_is_a_tolerance_where_steps_are_the_methods_own(case: Case) -> None:
    free = exunet.load(case.path, ["time.end=0.04", 'solver={method="DOPRI5",tolerance=1e-6}'])
    found = {one.name: one for one in settings_of(free)}
    assert found["tolerance x 1/100"].size == pytest.approx(1e-8)
    assert found["contact x 2"].size == 1e-6  # steps follow by themselves
    plan = found["tolerance x 10"].start(free).plan
    assert plan.tolerance == pytest.approx(1e-5)


def test_a_whole_study(case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Files, estimate beforehand, one row for each setting, and what is recommended can be run."""
    out = tmp_path / "out"
    assert cost(case, AskedCost(out, budget=200.0, runs=3, perturb=1e-9)) == 0
    told = capsys.readouterr()
    assert "time    the case as it is first" in told.err
    assert "10 settings, 3 moved starts each" in told.err
    assert "less than the errors of equal steps" in " ".join(told.out.split())
    assert {path.name for path in out.iterdir()} == {
        "cost.csv", "cost.md", "capture_cost.png", "capture_cost.pdf",
    }  # fmt: skip
    assert (out / "capture_cost.png").stat().st_size > 10_000
    with (out / "cost.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    settings = {row["setting"] for row in rows}
    assert len(settings) == COMPILED + 2
    own = {row["quantity"]: row for row in rows if row["setting"] == "step x 1"}
    result = exunet.run(case)
    body = result.bodies["box"]
    gained = np.linalg.norm(body.mass * (body.velocity[-1] - body.velocity[0]))
    assert float(own["momentum_box_N_s"]["median"]) == pytest.approx(gained, rel=1e-4)
    first = min(float(one.values[-1, 0]) for name, one in result.states.items() if name.endswith("_first"))
    assert float(own["contact_box_first_s"]["median"]) == pytest.approx(first, abs=1e-4)
    assert own["momentum_box_N_s"]["verdict"] == "touched 3 of 3"
    assert all(row["right_hand_sides"] for row in rows)
    text = (out / "cost.md").read_text(encoding="utf-8")
    assert "the finest: ranges of its runs" in text
    assert "not told apart" in text
    assert "recommended: step x" in text
    (option,) = [line.strip() for line in text.splitlines() if "--set 'solver=" in line]
    chosen = option.partition("--set '")[2].rstrip("'` ")
    assert exunet.load(case.path, ["time.end=0.04", chosen]).scene.solver.step is not None


def test_a_scene_without_a_rule_is_judged_by_what_it_touches(case: Case) -> None:
    plain = exunet.load(case.path, [*SHORT, "verdict="])
    course = course_of(simulate(the_case(settings_of(plain)).start(plain)))
    assert [one.key for one in quantities_of(course)] == ["momentum_box_N_s", "contact_box_first_s"]
    assert verdicts([course], [course]) == Verdicts({"touched": 1}, same=True)


def test_a_body_of_given_motion_tells_what_it_took(case: Case) -> None:
    """The same net on a box that is held: the net loses what the box gets."""
    held = exunet.load(
        case.path,
        [*SHORT, 'bodies.box.motion="fixed"', "bodies.box.velocity=", "bodies.box.angular_velocity="],
    )
    result = simulate(the_case(settings_of(held)).start(held))
    lost = result.net.mass @ (result.velocity[-1] - result.velocity[0])
    (momentum, *_) = biases([course_of(result)], [], 0.0)
    assert momentum.median == pytest.approx(np.linalg.norm(lost), rel=1e-9)
    assert momentum.median > 1e-4


def test_a_setting_that_stops_is_told_in_a_line_and_the_others_go_on(case: Case) -> None:
    # Threads of 3.1 g/m sink in at 1 m/s until they are stopped: 2.1 cm is too deep.
    soft = exunet.load(case.path, ["time.end=0.07", "solver.step=4e-5", "effects.contact.stiffness=14.0"])
    study, _, _ = ran(soft, CaptureStudyOptions(200.0, 2))
    found = {row.setting.name: row for row in study.rows}
    failed = found["contact x 1/2"]
    assert failed.failed
    assert "\n" not in failed.reason
    assert "is deeper than" in failed.reason
    assert remark(study, failed).startswith("failed: ")
    assert study.recommended is not None
    assert study.recommended is not failed
    assert any("failed" in line for line in table(study))


def test_what_does_not_fit_is_left_out_and_told(case: Case) -> None:
    """A clock that runs ten seconds a look: only what is due first is run."""
    now = iter(range(0, 10**6, 10))
    study, (expected,), _ = ran(case, CaptureStudyOptions(35.0), now=lambda: float(next(now)))
    assert expected.runs >= 8
    assert any("left out" in row.reason for row in study.rows)
    assert study.finest is None
    assert [name for name, _ in recommendation(study)] == ["recommended"]
    assert recommendation(study)[0][1].startswith("nothing")


def test_a_budget_that_one_run_exceeds_is_refused(case: Case, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--budget: one run of the case takes some"):
        cost(case, AskedCost(tmp_path / "out", budget=1e-3))
    assert not (tmp_path / "out").exists()


def test_an_interrupt_keeps_what_is_done(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the third setting that has moved starts, after two of four of them."""
    calls: list[int] = []
    original = studies.run_ensemble
    monkeypatch.setattr(studies, "_cores", lambda: 2)

    def pressed(*arguments: Any, **keys: Any) -> Any:
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return original(*arguments, **keys)

    monkeypatch.setattr(studies, "run_ensemble", pressed)
    assert cost(case, AskedCost(tmp_path, budget=200.0, runs=4, overwrite=True)) == 130
    assert "INCOMPLETE" in capsys.readouterr().out
    text = (tmp_path / "cost.md").read_text(encoding="utf-8")
    assert "INCOMPLETE" in text
    assert "only 2 of 4 moved starts" in text
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        assert {row["runs"] for row in csv.DictReader(file) if row["runs"]} == {"4", "2"}


@pytest.mark.parametrize(
    ("overrides", "asked", "said"),
    [
        ((), {"until": 1.0}, "--until: must be in"),
        ((), {"perturb": -1.0}, "--perturb: must be a finite number"),
        ((), {"perturb": 10.0}, "--perturb: moves of up to 10 m may stretch element"),
        ((), {"runs": 10**9}, "--runs: there is memory for"),
        (("verdict=", "effects.contact="), {"runs": 8}, "--runs: is for captures"),
        (("verdict=", "effects.contact="), {"perturb": 1e-6}, "--perturb: is for captures"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    case: Case, overrides: tuple[str, ...], asked: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        cost(exunet.load(case.path, [*SHORT, *overrides]), AskedCost(tmp_path / "out", **asked))
    assert not (tmp_path / "out").exists()


# How settings are judged, on made-up numbers: normal ones, of a deviation of 1 about 10.

NUMBER = Headline("number", "number", "N s", lambda course: cast(Any, course).number, digits=6)
FINEST = 10.0 + np.random.default_rng(0).normal(size=16)


def judged(values: np.ndarray) -> Any:
    return _bias(NUMBER, values, FINEST, 0.0, 0.05)


def test_a_bias_matters_from_a_third_of_the_range_on() -> None:
    width = float(np.ptp(FINEST))
    for part, matters in ((0.30, False), (0.36, True), (-0.36, True)):
        found = judged(FINEST + part * width)
        assert found.bias == pytest.approx(part * width)
        assert found.matters == matters
        assert found.low < found.bias < found.high


def test_a_difference_within_the_spread_is_not_told_apart() -> None:
    """Sixteen of the same distribution; the same, three deviations away; and one alone."""
    same = 10.0 + np.random.default_rng(1).normal(size=16)
    assert not judged(same).told_apart
    assert judged(same + 3.0).told_apart
    assert not judged(np.array([11.0])).told_apart
    assert judged(np.array([16.0])).told_apart
    assert not judged(np.array([16.0])).shown  # of one run there is no interval


def test_where_nothing_is_spread_the_digits_are_asked_for() -> None:
    tight = 10.0 + 1e-9 * np.arange(8)
    for off, matters in ((0.9e-4, False), (1.1e-4, True)):  # the sixth digit of 10 counts 1e-4
        found = _bias(NUMBER, tight + off, tight, 0.0, 0.05)
        assert (found.matters, found.told_apart, found.shown) == (matters, matters, not matters)


def test_enough_moved_starts_show_that_a_bias_is_small() -> None:
    """Two one-sided tests at 5 %: of 6 and of 200 of one distribution, a third of whose range is some 1."""
    draw = np.random.default_rng(2)
    few, many = (_bias(NUMBER, draw.normal(size=n), draw.normal(size=n), 0.0, 0.05).shown for n in (6, 200))
    assert (few, many) == (False, True)


def courses(*names: str) -> Any:
    return [SimpleNamespace(name=name) for name in names]


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exunet.studies.capture_cost.judging.verdict_of", lambda course: course.name)


@pytest.mark.usefixtures("named")
def test_a_verdict_is_the_same_where_its_share_is_not_told_apart() -> None:
    finest = courses(*["captured"] * 20)
    assert verdicts(courses(*["captured"] * 20), finest).same
    assert verdicts(courses(*["captured"] * 19, "touched"), finest).same
    often = verdicts(courses(*["captured"] * 12, *["touched"] * 8), finest)
    assert often.words == "captured 12, touched 8 of 20"
    assert not often.same  # Fisher's exact test: 0.003
    assert not verdicts(courses(*["touched"] * 20), finest).same
    assert verdicts(courses("touched"), courses("captured", "captured", "touched")).same  # one run
    assert not verdicts(courses("escaped"), courses("captured", "captured", "touched")).same


def made(monkeypatch: pytest.MonkeyPatch, *rows: tuple[str, float, float, float]) -> CaptureStudy:
    """A study of name, size, seconds, and the number that its runs have, beside that of the finest."""
    shape = np.linspace(-1.0, 1.0, 8)
    found = []
    for name, size, seconds, off in rows:
        knob = Knob.STIFFNESS if name.startswith("contact") else Knob.SIZE
        setting = CaptureSetting(knob, name, solver=f"step={size}", size=size)
        runs = [SimpleNamespace(number=10.0 + off + one, name="touched") for one in shape]
        found.append(CaptureRow(setting, seconds, 100, size, cast(Any, runs[0]), cast(Any, runs)))
    judging: Callable[[Any], Any] = lambda course: (NUMBER,)  # noqa: E731
    monkeypatch.setattr("exunet.studies.capture_cost.judging.quantities_of", judging)
    monkeypatch.setattr("exunet.studies.capture_cost.rows.quantities_of", judging)
    return CaptureStudy(cast(Any, None), 8, 1e-9, found)


@pytest.mark.usefixtures("named")
def test_the_cheapest_that_holds_is_recommended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a range of 2: biases from 2/3 on matter. A softer contact that is as dear is not taken."""
    study = made(
        monkeypatch,
        ("step x 8", 8e-5, 0.5, 3.0),
        ("step x 4", 4e-5, 1.0, 0.7),
        ("step x 2", 2e-5, 2.0, 0.1),
        ("step x 1/2", 5e-6, 8.0, 0.0),
        ("contact x 1/2", 1e-5, 1.9, 0.0),
    )
    assert study.finest is study.rows[3]
    assert study.recommended is study.rows[2]
    study.rows[4].seconds = 1.7
    assert study.recommended is study.rows[4]
    study.rows[4].moved.pop()
    assert study.recommended is study.rows[2]
    lines = dict(words(study))
    assert lines["step x 8 (8e-05 s)"].endswith("number 13.0000 N s (+3.0000)*!; does not hold")
    assert lines["step x 4 (4e-05 s)"].endswith("number 10.7000 N s (+0.7000)!; open: more --runs would tell")
    assert "the finest" in lines["step x 1/2 (5e-06 s)"]
    assert "only 7 of 8 moved starts" in lines["contact x 1/2 (1e-05 s)"]
    told = dict(recommendation(study))
    assert told["not shown"].startswith("of number: 8 moved starts are too few")
    assert told["may hold too"].startswith("step x 4 (1 s a run): not told apart")


@pytest.mark.usefixtures("named")
def test_where_nothing_coarser_holds_the_finest_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    study = made(monkeypatch, ("step x 1", 1e-5, 1.0, 3.0), ("step x 1/2", 5e-6, 2.0, 0.0))
    assert study.recommended is study.rows[1]
    assert "the finest that ran" in recommendation(study)[0][1]


@pytest.mark.usefixtures("named")
def test_the_figure_shows_medians_with_their_ranges(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    study = made(monkeypatch, ("step x 1", 1e-5, 1.0, 0.5), ("step x 1/2", 5e-6, 2.0, 0.0))
    study.rows.append(
        CaptureRow(
            CaptureSetting(Knob.FORM, "fused", form=Form.FUSED), 30.0, 100, 1e-5, study.rows[0].moved[0]
        )
    )
    figure = capture_cost(study)
    assert figure is not None
    (axes,) = figure.axes
    steps, form = axes.containers
    np.testing.assert_allclose(steps.lines[0].get_xydata(), [[1.0, 10.5], [2.0, 10.0]])
    (bars,) = steps.lines[2]
    np.testing.assert_allclose(bars.get_segments()[1][:, 1], [9.0, 11.0])
    np.testing.assert_allclose(form.lines[0].get_xydata(), [[30.0, 9.5]])
    write_csv(study, tmp_path / "cost.csv")
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["bias"] for row in rows] == ["0.5", "", "-0.5"]
    assert capture_cost(CaptureStudy(cast(Any, None), 8, 1e-9, [])) is None


def test_a_run_that_stops_at_once_leaves_no_study(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise RunStopped("stopped: diverged\nmore")

    monkeypatch.setattr(studies, "simulate", stop)
    study, expected, _ = ran(case, CaptureStudyOptions(100.0))
    assert expected == []
    assert [row.reason for row in study.rows if row.reason] == ["stopped: diverged"]
    assert dict(recommendation(study))["recommended"].startswith("nothing")

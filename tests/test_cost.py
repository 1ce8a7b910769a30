"""`exunet cost`: the ladder on a case, its converged solution, Pareto front, budget, interruption."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.backends.protocol import StepCounts
from exunet.base.errors import InputError
from exunet.interfaces.commands import cost as command
from exunet.interfaces.commands.cost import AskedCost
from exunet.methods.method import METHODS, Form, Kind, Method
from exunet.results.measures import Deployment
from exunet.simulation.preparation import prepare
from exunet.studies.both_codes import both_of
from exunet.studies.cost import study as studies
from exunet.studies.cost.converged import Converged, converge
from exunet.studies.cost.ranking import (
    LEVELS,
    answer_rows,
    cheapest,
    evaluations,
    measure_rows,
    pareto,
    reliable,
    runnable_rows,
    write_csv,
)
from exunet.studies.cost.runners import RunMeasures, StudyEntry, Subject, run
from exunet.studies.cost.settings import ReferenceMethod, Setting, base, ladders
from exunet.studies.cost.study import Study, all_rungs, climb, untried
from exunet.studies.cost.tracked import tracked

PLANAR = Path(__file__).parent.parent / "cases" / "planar_undamped.toml"
SURE = Converged(np.array([1.0]), 1e-9, 1e-9, None, ())


def subject(end: float, *overrides: str) -> Subject:
    case = exunet.load(PLANAR, overrides)
    return Subject(prepare(case.scene), both_of(case), (0.0, end))


def alone(name: str, end: float, *overrides: str) -> Subject:
    """A case that the reference does not know."""
    case = exunet.load(PLANAR.parent / f"{name}.toml", overrides)
    return Subject(prepare(case.scene), None, (0.0, end))


def opened(area: float) -> Deployment:
    return Deployment(area, 1.7, 0.0, 0.3, 1.0, area, at_end=False)


def measured(error: float, deployment: Deployment | None = None) -> RunMeasures:
    return RunMeasures(np.array([1.0]), error, None, deployment)


def entry(
    method: Method | ReferenceMethod,
    tolerance: float,
    seconds: float,
    error: float,
    form: Form | None = Form.FUSED,
) -> StudyEntry:
    setting = Setting(form, method, tolerance=tolerance)
    return StudyEntry(setting, [seconds], StepCounts(1, right_hand_sides=7), measured(error), error)


def test_the_converged_solution_is_the_known_one():
    found = converge(subject(1.0), compiled=True)
    # reference_impl/README.md: digits that two tolerances of its DOP853 share.
    assert found.speeds == pytest.approx(2.2318743323, abs=1e-8)
    assert found.uncertainty < 1e-8
    assert found.predicts
    assert found.horizon is None
    assert any("both codes" in words for words in found.words)


def test_every_code_and_kind_of_method_runs_and_errs_little():
    scene = subject(0.6)
    exact = converge(scene, compiled=True).speeds
    settings = [
        Setting(Form.CONNECTORS, Method.DOPRI5, tolerance=1e-7),
        Setting(Form.FUSED, Method.DOPRI5, tolerance=1e-7),
        Setting(Form.COMPILED, Method.DOPRI5, tolerance=1e-7), Setting(Form.COMPILED, Method.RK44, step=2e-5),
        Setting(None, ReferenceMethod.RK45, tolerance=1e-7), Setting(None, ReferenceMethod.VERLET, step=1e-4),
        Setting(None, ReferenceMethod.EM, step=1e-3), Setting(Form.FUSED, Method.VELOCITY_VERLET, step=1e-4),
    ]  # fmt: skip
    for setting in settings:
        trial = run(scene, setting)
        assert trial.measures is not None, (setting.name, trial.reason)
        assert trial.work is not None
        assert trial.work.steps > 0
        bound = 1e-5 if setting.tolerance else 0.02
        assert np.abs(trial.measures.speeds - exact).max() / 2.5 < bound, setting.name
        assert trial.measures.momentum is not None
        assert trial.measures.momentum < 1e-12
    assert trial.measures.deployment is not None


@pytest.mark.parametrize("setting", [
    Setting(Form.COMPILED, Method.RK44, step=5e-5), Setting(None, ReferenceMethod.RK4, step=1e-4),
], ids=lambda one: one.code)  # fmt: skip
def test_the_error_of_the_energy_is_the_same_in_flight(setting):
    """The energy of the common flight at 10 m/s is 19 times that of the launch at 2.5 m/s; it is not in play.

    To 0.7 s, after the first snaps at 0.57 s: a fixed step errs by 1e-7 and more there, far above round-off.
    """
    errors = []
    for overrides in ((), ("initial.velocity=[0.0, 0.0, 10.0]",)):
        trial = run(subject(0.7, *overrides), setting)
        assert trial.measures is not None, trial.reason
        errors.append(trial.measures.energy)
    assert errors[0] > 1e-8
    assert errors[1] == pytest.approx(errors[0], rel=0.03)


ALONG = np.eye(3)
BODY = "bodies.target={mass=1.0,inertia=[1.0,2.0,2.5],angular_velocity=[1.0,2.0,3.0],velocity=[1.0,0.0,0.0]}"


@pytest.mark.parametrize(("name", "overrides", "end"), [
    ("effects/launch_force", (), 0.02),
    ("planar_undamped", (BODY,), 0.02),
    ("effects/breaking", (), 0.02),
], ids=("point mass", "rigid body", "broken element"))  # fmt: skip
def test_the_energy_is_that_of_every_block(name, overrides, end):
    """A point mass, a rigid body and a broken element are in the balance, and none in the net's measures."""
    scene = alone(name, end, *overrides)
    found = converge(scene.at((0.0, end)), compiled=True)
    assert len(found.deployments) in (0, 4)
    for form in (Form.CONNECTORS, Form.COMPILED):
        trial = run(scene, Setting(form, Method.DOPRI5, tolerance=1e-9))
        assert trial.measures is not None, trial.reason
        assert trial.measures.energy < 2e-3  # breaking: 1e-3 of what breaks off, with an adaptive method
        assert np.abs(trial.measures.speeds - found.speeds).max() < 1e-2 * scene.speed
        assert trial.measures.momentum is None or trial.measures.momentum < 1e-12


def test_a_body_counts_by_what_its_motion_moves():
    """An angle of 1e-3 rad moves the ends of arms by their radius of gyration times that; so does a spin."""
    system = alone("planar_undamped", 0.1, BODY).start.system
    (body,) = system.bodies
    arm = math.sqrt(max(body.inertia) / body.mass)
    velocity, none = np.zeros((1, system.net.n_nodes, 3)), (np.zeros((1, 0, 3)), np.zeros((1, 0, 3)))
    turned = np.array([[1.0, -1e-3, 0.0], [1e-3, 1.0, 0.0], [0.0, 0.0, 1.0]])  # to first order

    def found(place=0.0, speed=0.0, turn=ALONG, spin=0.0):
        motion = (
            np.full((1, 1, 3), place),
            np.full((1, 1, 3), speed),
            turn[None, None],
            np.array([[[0.0, 0.0, spin]]]),
        )
        return tracked(system, velocity, none, motion, 4.0)

    def error(**changes):
        return np.abs(found(**changes) - found()).max()

    assert found().shape == (1, 4 + 4 * 6)
    assert error(place=1.0) == pytest.approx(1.0 / 4.0)
    assert error(speed=1.0) == pytest.approx(1.0)
    assert error(turn=turned) == pytest.approx(1e-3 * arm / 4.0)
    assert error(spin=0.5) == pytest.approx(0.5 * arm)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["snap", "tumbling", "launch"])
def test_both_codes_agree_on_bodies(name):
    """Tethers, free flight and a net thrown from a body: the converged solutions, and errors against them."""
    case, end = exunet.load(PLANAR.parent / "bodies" / f"{name}.toml"), 0.3
    scene = Subject(prepare(case.scene), both_of(case), (0.0, end))
    found = converge(scene, compiled=True)
    assert found.uncertainty < 1e-7
    trials = [
        run(scene, Setting(form, Method.DOPRI5, tolerance=1e-6)) for form in (Form.COMPILED, Form.FUSED)
    ]
    trials.append(run(scene, Setting(None, ReferenceMethod.RK45, tolerance=1e-6)))
    for trial in trials:
        assert trial.measures is not None, trial.reason
        assert np.abs(trial.measures.speeds - found.speeds).max() / scene.speed < 1e-3
        assert trial.measures.energy < 1e-3


@pytest.mark.slow
def test_the_reference_has_the_energy_of_bodies_that_forces_act_on():
    """A body that turns in the gradient of an orbit, far from the net: its potential changes as it moves."""
    body = "bodies.target={mass=5.0,inertia=[1.0,2.0,2.5],position=[90.0,0.0,0.0],velocity=[9.0,0.0,0.0]}"
    case = exunet.load(PLANAR.parent / "effects" / "orbit.toml", [body])
    scene = Subject(prepare(case.scene), both_of(case), (0.0, 0.5 * case.scene.time.end))
    trial = run(scene, Setting(None, ReferenceMethod.DOP853, tolerance=1e-9))
    assert trial.measures is not None, trial.reason
    ours = run(scene, Setting(Form.COMPILED, Method.DOPRI5, tolerance=1e-9))
    assert ours.measures is not None, ours.reason
    assert trial.measures.energy < 1e-6
    assert ours.measures.energy < 1e-6
    assert np.abs(trial.measures.speeds - ours.measures.speeds).max() < 1e-4 * scene.speed


def test_methods_that_cannot_move_bodies_are_not_tried():
    """No implicit method where a tether pulls a body; all where a body flies alone."""
    implicit = {name for name, method in METHODS.items() if method.kind == Kind.IMPLICIT}
    for name, expected in (("snap", set()), ("tumbling", implicit)):
        case = exunet.load(PLANAR.parent / "bodies" / f"{name}.toml")
        scene = Subject(prepare(case.scene), None, (0.0, case.scene.time.end))
        tried = {ladder[0].method for ladder in all_rungs(scene, compiled=True)}
        assert tried & implicit == expected
        assert Method.DOPRI5 in tried


def test_what_is_not_tried_is_told_with_its_reason():
    """Methods of the engine, and of the reference, that cannot run bodies which nodes are fixed to."""
    scene = exunet.load(PLANAR.parent / "bodies" / "frame.toml")
    frame = Subject(prepare(scene.scene), both_of(scene), (0.0, 0.1))
    found = untried(frame, compiled=True)
    assert found["a force that acts on frame"] == ["GeneralizedAlpha", "TrapezoidalIndex2"]
    ((reason, names),) = [(words, names) for words, names in found.items() if "EM" in names[0]]
    assert names == ["EM (reference)"]
    assert "nodes that are points of bodies" in reason
    rows = dict.fromkeys(name for name, _ in command._untried(frame, compiled=True))
    assert list(rows) == ["not tried", "note"]
    assert any(
        "first order for turning bodies" in words for _, words in command._untried(frame, compiled=True)
    )
    assert untried(subject(0.1), compiled=True) == {}
    assert command._untried(subject(0.1), compiled=True) == []


def test_what_is_recommended_can_be_run():
    """The options that a row gives are those of the setting, its tolerance in m/s; once for each setting."""
    loose = entry(Method.DOPRI5, 1e-6, 1.0, 1e-4, Form.COMPILED)
    tight = entry(Method.RK44, 1e-9, 3.0, 1e-7)
    fixed = StudyEntry(
        Setting(Form.FUSED, Method.RK44, step=2e-4), tight.seconds, tight.work, tight.measures, 1e-7
    )
    rows = runnable_rows(Study(SURE, [loose, fixed]), speed=2.5)
    options = [words for name, words in rows if name in ("  to run it", "")]
    assert [name for name, _ in rows].index("  to run it") == 3  # after 1e-2, 1e-3 and 1e-4
    assert options == [
        "--set 'solver={method=\"DOPRI5\",tolerance=2.5e-06}'",
        "--set 'engine={loop=\"compiled\"}'",
        "--set 'solver={method=\"RK44\",step=0.0002}'",
        "--set 'engine={net=\"fused\"}'",
    ]
    first, second = ([one.split("'")[1] for one in options[k : k + 2]] for k in (0, 2))
    scenes = [exunet.load(PLANAR, keys).scene for keys in (first, second)]
    assert [one.solver.method for one in scenes] == [Method.DOPRI5, Method.RK44]
    assert (scenes[0].solver.tolerance, scenes[1].solver.step) == (2.5e-6, 2e-4)
    assert (scenes[0].engine.loop, scenes[1].engine.net) == ("compiled", "fused")


def test_only_methods_that_the_effects_allow_are_tried():
    ladder = all_rungs(alone("effects/breaking", 0.02), compiled=True)
    tried = {setting.method for rungs in ladder for setting in rungs}
    refused = {method for method, facts in METHODS.items() if facts.remembers_acceleration}
    assert refused == {Method.VELOCITY_VERLET, Method.GENERALIZED_ALPHA, Method.TRAPEZOIDAL_INDEX2}
    assert tried == set(METHODS) - refused


def test_a_method_that_blows_up_stays_with_its_reason():
    trial = run(subject(0.6), Setting(Form.CONNECTORS, Method.RK44, step=5e-3))  # stable: 2.5e-4 s
    assert trial.measures is None
    assert "diverged" in trial.reason


def test_the_ladders_hold_every_method():
    stable = dict.fromkeys(METHODS, 1e-4)
    found = ladders(stable, 1.0, compiled=True, reference=(ReferenceMethod.RK45, ReferenceMethod.EM))
    names = {setting.name for ladder in found for setting in ladder}
    assert {f"{method} ({form})" for method in METHODS for form in ("connectors", "fused")} <= names
    assert {"DOPRI5 (compiled loop)", "RK45 (reference)", "EM (reference)"} <= names
    for ladder in found:
        knobs = [setting.tolerance or setting.step for setting in ladder]
        assert knobs == sorted(knobs, reverse=True)
    without = ladders(stable, 1.0, compiled=False, reference=())
    assert {setting.code for ladder in without for setting in ladder} == {"connectors"}


def test_the_front_and_the_cheapest():
    good = [
        entry(Method.DOPRI5, 1e-5, 1.0, 1e-3),
        entry(Method.DOPRI5, 1e-7, 2.0, 1e-5),
        entry(Method.DOPRI5, 1e-9, 4.0, 1e-7),
    ]
    worse = entry(Method.ODE23, 1e-7, 3.0, 2e-5)
    lucky = [
        entry(ReferenceMethod.RK45, 1e-5, 0.5, 1e-6),
        entry(ReferenceMethod.RK45, 1e-7, 1.5, 1e-2),
    ]  # right by chance
    study = Study(SURE, [*good, worse, *lucky])
    assert pareto(study) == [lucky[0], good[2]]
    assert cheapest(study, 1e-4) is good[1]
    assert cheapest(study, 1e-2) is lucky[0]
    assert cheapest(study, 1e-8) is None
    assert len(answer_rows(study)) == len(LEVELS) == 7


def test_an_error_below_the_solutions_own_cannot_be_told():
    unsure = Converged(np.array([1.0]), 1e-5, 1e-5, None, ())
    rows = dict(answer_rows(Study(unsure, [entry(Method.DOPRI5, 1e-9, 1.0, 1e-6)])))
    assert "not resolved" in rows["error <= 1e-06"]
    assert "DOPRI5" in rows["error <= 1e-04"]


def test_no_setting_is_told_to_be_better_than_the_solution():
    """The tightest rung of the converged solution's own method would differ from it by nothing."""
    same = [entry(Method.DOPRI5, 1e-10, 1.0, 2e-10), entry(Method.DOPRI5, 1e-11, 2.0, 0.0)]
    study = Study(Converged(np.array([1.0]), 3e-9, 1e-9, None, ()), same)
    assert [study.error(one) for one in same] == [3e-9, 3e-9]
    assert pareto(study) == [same[0]]
    row = dict(answer_rows(study))["error <= 1e-08"]
    assert "tolerance 1e-10" in row
    assert "at most the 3.0e-09 by which the converged solutions differ" in row


def test_a_tighter_setting_that_fails_makes_its_method_unreliable():
    good = StudyEntry(Setting(Form.FUSED, Method.RK44, step=1e-3), [0.1], StepCounts(1), measured(0.0), 1e-7)
    failed = StudyEntry(Setting(Form.FUSED, Method.RK44, step=5e-4), [0.2], reason="diverged", failed=True)
    left_out = StudyEntry(Setting(Form.FUSED, Method.RK44, step=2e-4), reason="left out")
    assert not reliable(Study(SURE, [good, failed, left_out]), good, 1e-6)
    assert cheapest(Study(SURE, [good, failed, left_out]), 1e-6) is None
    alone = dict(answer_rows(Study(SURE, [good, left_out])))["error <= 1e-06"]
    assert "unconfirmed: no tighter setting ran" in alone
    sure = [entry(Method.DOPRI5, 1e-8, 1.0, 1e-7), entry(Method.DOPRI5, 1e-9, 2.0, 1e-8)]
    assert "unconfirmed" not in dict(answer_rows(Study(SURE, sure)))["error <= 1e-06"]


def test_after_the_horizon_conserving_methods_are_not_ranked():
    lost = Converged(np.array([1.0]), 0.1, 0.1, 1.6, (), (opened(0.91), opened(0.93)))
    honest, exact = entry(Method.DOPRI5, 1e-7, 1.0, 1e-5), entry(ReferenceMethod.EM, 1e-2, 0.1, 2e-13, None)
    lost = replace(lost, deployments=tuple(replace(one, distance=1e-17) for one in lost.deployments))
    for one, area in ((honest, 0.92), (exact, 0.955)):
        one.measures = measured(one.speed_error, opened(area))
    study = Study(lost, [honest, exact])
    assert pareto(study) == pareto(study, evaluations) == [honest]
    assert cheapest(study, 1e-4) is honest
    rows = measure_rows(study)
    assert ("largest area", "0.91 to 0.93 of the achievable area, of 2 converged solutions") in rows
    words = {name: value for name, value in rows if "EM" in value or "DOPRI5" in value}
    assert ("distance", "0 to 0 m, of 2 converged solutions") in rows
    assert "largest area 0.92 of the achievable area," in words["on the front"]
    assert "(outside)" not in words["on the front"]  # by no more than round-off, in the distance
    assert "largest area 0.955 of the achievable area (outside)" in words["not ranked"]


def test_the_base_is_run_whatever_the_budget():
    study = Study(SURE)
    rungs = all_rungs(subject(0.02), compiled=True)
    climb(study, subject(0.02), rungs, lambda: 0.0, lambda words: None, base(compiled=True))
    ran = [one.setting for one in study.entries if one.work is not None]
    assert ran == base(compiled=True)
    assert {one.code for one in ran} == {"compiled loop"}
    assert sum(len(ladder) for ladder in rungs) == len(study.entries)


def test_evaluations_of_the_conserving_method_are_counted():
    trial = run(subject(0.02), Setting(None, ReferenceMethod.EM, step=1e-3))
    assert trial.work is not None
    assert trial.work.right_hand_sides >= trial.work.newton_iterations + trial.work.steps


def test_a_budget_leaves_out_what_costs_too_much(monkeypatch, tmp_path):
    clock = [0.0]

    def pretend(_subject: Subject, setting: Setting, until: float | None = None) -> StudyEntry:
        seconds = 0.0 if until else 1e-3 / float(setting.step or 1.0)
        clock[0] += seconds
        shown = RunMeasures(np.array([1.0 + seconds * 1e-6]), 0.0)
        return StudyEntry(setting, [seconds], StepCounts(1, right_hand_sides=1000), shown)

    monkeypatch.setattr(studies, "run", pretend)
    ladder = [Setting(Form.FUSED, Method.RK44, step=10.0**-k) for k in (3, 4, 5, 6)]
    study = Study(SURE)
    climb(study, subject(0.01), [ladder], lambda: 30.0 - clock[0], lambda words: None)
    assert [len(one.seconds) for one in study.entries] == [3, 2, 0, 0]  # 1 s, 10 s; 100 s; again
    assert [one.reason.split()[3] for one in study.entries[2:]] == ["1e+02", "1e+03"]  # expected [s]
    write_csv(study, tmp_path / "cost.csv")
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["repeats"] for row in rows] == ["3", "2", "0", "0"]
    assert rows[0]["noise"] == "0.000"


@pytest.mark.slow
def test_an_interrupt_keeps_what_was_measured(monkeypatch, tmp_path):
    runs = []

    def stop_at_the_fifth(scene: Subject, setting: Setting, until: float | None = None) -> StudyEntry:
        runs.append(setting)
        if len(runs) == 5:
            raise KeyboardInterrupt
        return run(scene, setting, until)

    monkeypatch.setattr(studies, "run", stop_at_the_fifth)
    code = command.cost(exunet.load(PLANAR), AskedCost(tmp_path, 0.02, 60.0))
    assert code == 130
    assert "INCOMPLETE" in (tmp_path / "cost.md").read_text(encoding="utf-8")
    assert (tmp_path / "work_precision.png").stat().st_size > 10_000
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        assert 1 <= len(list(csv.DictReader(file))) < 5


@pytest.mark.parametrize("until", [0.0, -1.0, 3.0, float("nan"), 1e-12])
def test_an_end_outside_the_case_is_refused(until, tmp_path):
    (tmp_path / "cost.csv").write_text("of an earlier study", encoding="utf-8")
    with pytest.raises(InputError, match="--until"):
        command.cost(exunet.load(PLANAR), AskedCost(tmp_path, until, 1.0))
    assert (tmp_path / "cost.csv").read_text(encoding="utf-8") == "of an earlier study"


def test_nothing_is_lost_before_there_is_something_to_write(monkeypatch, tmp_path):
    def press_ctrl_c(*_: object, **__: object) -> Converged:
        raise KeyboardInterrupt

    (tmp_path / "cost.csv").write_text("of an earlier study", encoding="utf-8")
    monkeypatch.setattr(command, "converge", press_ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        command.cost(exunet.load(PLANAR), AskedCost(tmp_path, 0.1, 1.0, overwrite=True))
    assert (tmp_path / "cost.csv").read_text(encoding="utf-8") == "of an earlier study"
    with pytest.raises(InputError, match=r"cost\.csv in this folder would be replaced.*--overwrite"):
        command.cost(exunet.load(PLANAR), AskedCost(tmp_path, 0.1, 1.0))
    assert [path.name for path in tmp_path.iterdir()] == ["cost.csv"]
    (tmp_path / "cost.md").mkdir()
    with pytest.raises(InputError, match=r"cost\.md: cannot be written"):
        command.cost(exunet.load(PLANAR), AskedCost(tmp_path, 0.1, 1.0))


@pytest.mark.slow
def test_the_whole_command(tmp_path):
    assert command.cost(exunet.load(PLANAR), AskedCost(tmp_path, 1.0, 60.0)) == 0
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["code"] for row in rows} == {"connectors", "fused", "compiled loop", "reference"}
    front = [(float(r["seconds"]), float(r["speed_error"])) for r in rows if r["pareto"]]
    assert sorted(front) == sorted(front, key=lambda one: -one[1])
    assert any("diverged" in row["outcome"] for row in rows)  # forward Euler, for one
    assert len(all_rungs(subject(1.0), compiled=True)) == 2 * len(METHODS) + 3 + 5


@pytest.mark.slow
def test_after_the_horizon_it_says_so(tmp_path):
    case = exunet.load(PLANAR.with_name("planar_deployment.toml"))
    assert command.cost(case, AskedCost(tmp_path, 2.0, 20.0)) == 0
    words = (tmp_path / "cost.md").read_text(encoding="utf-8")
    assert "after the horizon" in words  # field.md: round-off alone parts the curves before 2 s
    assert "Errors are those of the energy balance" in words
    assert "of 5 converged solutions" in words
    with (tmp_path / "cost.csv").open(encoding="utf-8") as file:
        ran = [row for row in csv.DictReader(file) if row["outcome"] == "ran"]
    assert all(row["time_above_80_s"] and row["largest_area"] and not row["speed_error"] for row in ran)
    assert not any(row["pareto"] for row in ran if row["method"] == "EM")

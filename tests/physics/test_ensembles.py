"""Ensembles: members are runs, bit by bit; quantiles by hand; endings, files, ranges, runs side by side."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from commands import command
from result_samples import square_net, unfolding
from scenes import CASES, STRONG, of_text, thrown, values_of
from scripts import FALL

import exunet
from exunet.integrators.compiled.vectorised_runs import side_by_side_kernel
from exunet.kernels.compile import WIDTH
from exunet.kernels.kernel import Kernel
from exunet.plots.registry import ENSEMBLE_FIGURES
from exunet.results.ensemble import (
    INTERVALS,
    LEVELS,
    Ensemble,
    Member,
    ensemble_of,
    member_of,
)
from exunet.results.io import ENSEMBLE_FILE
from exunet.results.metrics import COUNT, Metric
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.run_record import EnsembleRecord
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.scene.casefile import Case
from exunet.simulation.preparation import Start, prepare, prepare_case
from exunet.studies import ensemble as members
from exunet.studies import ensemble as studies
from exunet.studies.ensemble import (
    default_runs,
    kernel_of_many,
    perturbed_positions,
    perturbed_runs,
    run_ensemble,
    run_members,
    start_of_runs,
)

PLANAR = CASES / "planar_undamped.toml"
SHORT = ("solver={tolerance=1e-5, method='DOPRI5'}", "time.end=0.7")  # snaps from 0.5 s on


def made(runs: int = 5, **arguments: Any) -> Ensemble:
    return exunet.ensemble(exunet.load(PLANAR, SHORT), runs, **arguments)


def planar(*overrides: str) -> Start:
    return prepare(exunet.load(PLANAR, [SHORT[0], *overrides]).scene)


def same(one: Ensemble, other: Ensemble) -> None:
    for name in ("metrics", "quantiles"):
        ours, theirs = getattr(one, name), getattr(other, name)
        assert ours.keys() == theirs.keys()
        for key, values in ours.items():
            assert values.tobytes() == theirs[key].tobytes(), key


# Members are runs

EVERYTHING: dict[str, Any] = {
    "bodies": {
        "free": {
            "mass": 2.0,
            "inertia": [0.2, 0.3, 0.4],
            "position": [0.3, 0.0, 0.5],
            "shape": "sphere",
            "radius": 0.2,
            "angular_velocity": [0.1, 2.0, 0.3],
        },
        "held": {"mass": 1.0, "inertia": [0.2, 0.3, 0.4], "position": [0, 0, 5], "motion": "fixed"},
    },
    "effects": {"gravity": {"acceleration": [0.0, 0.0, -9.81]}},
    "closing": {"kind": "perimeter", "at": 0.01, "rate": 0.5, "part": 0.99},
}


BREAKING: dict[str, Any] = {"effects": {"breaking": {"strain": 0.3}}}  # not with an edge that becomes shorter


@pytest.mark.parametrize("tables", [BREAKING, EVERYTHING], ids=["breaking", "everything"])
def test_a_member_has_the_states_and_metrics_of_the_run(tables: dict[str, Any]) -> None:
    """Bit by bit, from the same start through the same times, to 0.15 s with the first snap at 0.1 s."""
    scene = thrown({}, end=0.15, engine={"backend": "compiled"}, **tables)
    start = prepare(scene)
    run = exunet.run(scene)
    (member,) = run_members(start, start.position[None], lambda result: result)
    for name in ("time", "position", "velocity", "tension", "kinetic", "potential", "dissipated", "momentum"):
        assert np.array_equal(getattr(member, name), getattr(run, name)), name
    of_member = {**member.states, **member.contacts}
    for key, state in (*run.states.items(), *run.contacts.items()):
        assert np.array_equal(of_member[key].values, state.values), key
    assert exunet.metrics(member) == exunet.metrics(run)
    assert len(exunet.metrics(run)) >= (8 if tables is BREAKING else 45)


def test_metrics_do_not_depend_on_stored_times_or_backend() -> None:
    one, other = (
        perturbed_runs(planar("time.end=0.7", f"time.output_step={step}", f"engine.backend={backend}"), 3)
        for step, backend in ((0.1, "exudyn"), (0.033, "compiled"))
    )
    assert len(one.time) == INTERVALS + 1
    same(one, other)
    assert one.metrics["largest_tension_N"].min() > 100.0  # snaps from 0.5 s on


def test_the_same_seed_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """In whatever portions and on however many cores; the first runs are the same, however many follow."""
    one = made(5)
    monkeypatch.setattr(studies, "PORTION", 2)
    again, more, other = made(5), made(7), made(5, seed=1)
    same(one, again)
    for key, values in one.metrics.items():
        assert np.array_equal(values, more.metrics[key][:5]), key
    assert not np.array_equal(one.metrics["largest_tension_N"], other.metrics["largest_tension_N"])
    start = planar("time.end=0.6")
    position = perturbed_positions(start, 5, 1e-9, seed=4)
    same(run_ensemble(start, position, workers=1), run_ensemble(start, position, workers=3))


def test_perturbed_runs_follow_the_seed_of_the_case() -> None:
    start = planar("time.end=0.6")
    other = replace(start, scene=start.scene.model_copy(update={"seed": 1}))
    ours, theirs = perturbed_runs(start, 2), perturbed_runs(other, 2)
    assert (ours.run.seed, theirs.run.seed) == (0, 1)
    assert not np.array_equal(ours.metrics["largest_tension_N"], theirs.metrics["largest_tension_N"])


def test_perturbed_runs_do_not_strain_a_net_that_starts_taut() -> None:
    """By 1e-9 m also where the method is chosen for metrics: EA / L is 55 kN/m for a side of 1 m."""
    start = prepare(exunet.load(PLANAR, ["solver=", "initial.packing=1.0", "time.end=0.002"]).scene)
    assert start.scene.solver.for_metrics
    assert (
        np.ptp(perturbed_runs(start, 8).metrics["largest_tension_N"]) < 1e-2
    )  # N; both ends of two runs: 2e-4


def test_settings_of_perturbed_runs() -> None:
    """A method that the compiled loop lacks becomes DOPRI5; 64 elements x 2 s / 1.8e-4 s are 7.1e5."""
    explicit = start_of_runs(planar("solver={method='RK67', step=1e-4}")).plan
    assert (explicit.method.value, explicit.step) == ("DOPRI5", None)
    kept = start_of_runs(planar("solver={method='RK44', step=1e-4}")).plan
    assert (kept.method.value, kept.step) == ("RK44", 1e-4)
    assert [default_runs(planar(f"time.end={end}")) for end in (2.0, 2.2)] == [32, 8]


def test_a_run_that_fails_because_of_its_steps_restarts_with_finer_ones() -> None:
    """RK44 at four times the stable step 2.5e-4 s of the case; half of it gives 2.34 m/s within 1 %."""
    start = planar("solver={method='RK44', step=1e-3, force=true}", "time.end=0.7")
    with pytest.raises(exunet.RunStopped, match="run 0 of the ensemble"):
        run_ensemble(start, start.position[None])
    found = run_ensemble(start, start.position[None], retries=3)
    assert found.metrics["bullet_speed_at_end_m_s"][0] == pytest.approx(2.3422, rel=0.02)  # by 1e-4 s


# Interrupts and wrong arguments


def test_an_interrupt_keeps_the_portions_that_are_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "PORTION", 2)
    running = threading.active_count()

    def press_ctrl_c(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(exunet.Interrupted) as stop:
        made(6, progress=press_ctrl_c)
    assert stop.value.result.runs == 2
    assert not stop.value.result.complete
    assert threading.active_count() == running


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"runs": 0}, "runs"),
        ({"runs": 10**12}, "runs"),  # beyond the memory
        ({"perturb": -1e-9}, "perturb"),
        ({"perturb": float("nan")}, "perturb"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_arguments(given: dict[str, Any], name: str) -> None:
    with pytest.raises(exunet.InputError, match=f"^{name}: "):
        made(**given)


def test_a_method_that_the_compiled_loop_lacks_is_refused() -> None:
    case = exunet.load(PLANAR, ["solver={method='RK67', step=1e-4}"])
    with pytest.raises(exunet.InputError, match=r"solver\.method"):
        exunet.ensemble(case, 2)


@pytest.mark.parametrize(
    ("solver", "perturb", "least"),
    [
        ("solver={method='VelocityVerlet', step=5e-5}", 1e-9, "9.8e-05"),  # 1.4e-5 of 7 m with strings
        ("solver={method='RK44', step=1e-4}", 9e-5, "9.8e-05"),
        ("solver={}", 1e-9, "9.8e-05"),
        ("solver={method='VelocityVerlet', step=5e-5}", 1e-4, ""),
        (SHORT[0], 1e-9, ""),
    ],
)
def test_perturbations_below_the_errors_of_a_cheap_setting_are_noted(
    solver: str, perturb: float, least: str
) -> None:
    """benchmarks/ensemble.md: fixed steps shift medians from 1e-9 m, not from 1e-4 m."""
    notes = exunet.ensemble(exunet.load(PLANAR, [solver, "time.end=0.05"]), 1, perturb).run.notes
    assert (len(notes) == 1) == bool(least)
    assert all(f"--perturb {least} or more" in note for note in notes)


# Tables and quantiles by hand


def scaled(size: float) -> Result:
    """A run in which all is in proportion to its size; what a unit spends, to the square of the time.

    A box beside a resting net gains momentum 5 t size along (0, 0.6, 0.8).
    """
    time = np.linspace(0.0, 2.0, 5)
    rising = (size * time)[:, None]
    still = np.zeros((5, 3))
    box = BodyStates(
        2.0,
        np.eye(3),
        still,
        2.5 * rising * [0.0, 0.6, 0.8],
        np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)),
        rising * [1.0, -1.0, 0.0],
    )
    keys = (exunet.ContactKey("box", "threads", name) for name in ("touching", "force", "deepest", "first"))
    states = {f"closing/{name}": 2.0 * rising for name in ("tension_start", "tension_end", "way")}
    states |= {"closing/wound_up": 3.0 * rising, "closing/work": rising}
    states |= {"control/spent": np.hstack([rising * time[:, None], 5.0 * rising]), "control/work": rising}
    stored = {name: TermStates("1", values) for name, values in states.items()}
    contacts = dict.fromkeys(keys, TermStates("1", rising))
    of = unfolding(square_net(), times=5, bodies={"box": box}, states=stored, contacts=contacts)
    still_net = np.zeros_like(np.asarray(of.position)) + of.net.reference_position
    return replace(of, time=time, position=still_net, velocity=0.0 * still_net)


def test_quantiles_by_hand() -> None:
    """Of sizes 1, 2 and 6 minimum, median and maximum, as each quantity goes with the size."""
    found, time = ensemble_of([member_of(scaled(size)) for size in (1.0, 2.0, 6.0)]), 0.5
    rates = np.array([0.5, 0.5, 1.5, 2.5, 3.5])  # since the instant before; at first of the first interval
    time = np.linspace(0.0, 2.0, 5)
    expected = {
        "contact_box/threads_touching": time,
        "contact_box/threads_force": time,
        "closing/tension_end": 2.0 * time,
        "closing/way": 2.0 * time,
        "closing/wound_up": 3.0 * time,
        "control/thrust_0": rates,
        "control/thrust_1": np.full(5, 5.0),
        "body_box/angular_velocity_x": time,
    }
    for name, values in expected.items():
        of_sizes = np.multiply.outer([1.0, 2.0, 6.0], values)
        np.testing.assert_allclose(found.quantiles[name][[0, 3, 6]], of_sizes, rtol=1e-14, err_msg=name)
    falling = found.quantiles["body_box/angular_velocity_y"]
    np.testing.assert_allclose(falling[[0, 6]], np.multiply.outer([-6.0, -1.0], time), rtol=1e-14)


def of_values(values: Any, **about: Any) -> Ensemble:
    """An ensemble of one metric."""
    metric = Metric("largest_tension", "largest tension", "N", 0.0, **about)
    known = [{} if np.isnan(value) else {metric.key: replace(metric, value=value)} for value in values]
    time = np.array([0.0, 1.0])
    return ensemble_of([Member(time, metrics, {}) for metrics in known], run=EnsembleRecord(move_m=1e-9))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([875.04], "875.0 N"),
        ([841.61, 841.64, 841.62], "841.6 N"),  # a range below the printed digits
        ([841.6, 841.8, 841.7], "841.7 N (841.6 to 841.8)"),
        ([652.1, 870.0, 700.0, np.nan], "700.0 N (652.1 to 870.0), in 3 of 4 runs"),
        (list(range(600, 619)), "609.0 N (600.0 to 618.0)"),  # 19 runs: minimum and maximum
        (list(range(600, 621)), "610.0 N (601.0 to 619.0)"),  # 21 runs: 5 % and 95 %
    ],
)
def test_a_range(values: list[float], words: str) -> None:
    assert str(of_values(values).range("largest_tension_N")) == words


def test_counts_that_differ_by_one_are_a_range() -> None:
    assert str(of_values([2.0, 2.0, 3.0], resolution=COUNT).range("largest_tension_N")) == "2 N (2 to 3)"
    assert str(of_values([2.0, 2.0, 2.0], resolution=COUNT).range("largest_tension_N")) == "2 N"


def test_the_table_of_an_ensemble(tmp_path: Path) -> None:
    """In memory, as a data frame, and after a file, with units."""
    found = made(5, perturb=1e-6)
    peaks = found.metrics["largest_tension_N"]
    assert (found.runs, found.complete, found.verdict) == (5, True, "ok")
    assert len(set(peaks.tolist())) == 5
    assert found.quantile("largest_tension_N", 0.5) == np.median(peaks)
    assert found.quantiles["area"].shape == (len(LEVELS), INTERVALS + 1)
    assert (np.diff(found.quantiles["area"], axis=0) >= 0.0).all()
    with pytest.raises(exunet.InputError, match="largest_tension_N"):
        found.quantile("tension", 0.5)
    assert found.to_pandas()["largest_tension_N"].tolist() == peaks.tolist()
    exunet.save_ensemble(found, tmp_path / "ensemble.h5")
    read = exunet.load_ensemble(tmp_path)
    same(replace(found, metrics=dict(sorted(found.metrics.items()))), replace(read, metrics=read.metrics))
    assert (read.run, read.about) == (found.run, found.about)
    with h5py.File(tmp_path / "ensemble.h5") as file:
        units = {"metrics/largest_area_m2": "m2", "quantiles/area": "m2", "metrics/relative_area": "1"}
        for name, unit in units.items():
            assert file[name].attrs["units"].decode() == unit
    (tmp_path / "cut.h5").write_bytes((tmp_path / "ensemble.h5").read_bytes()[:3000])
    with pytest.raises(exunet.InputError, match=r"cut\.h5"):
        exunet.load_ensemble(tmp_path / "cut.h5")


# Runs that a script ends, each at its own time


def falling(*entries: str, **changes: str) -> Case:
    script = [f"script=[{', '.join(entries)}]"] if entries else []
    return of_text(FALL, *script, *(f"{key}={value}" for key, value in changes.items()))


LATE = 0.5947  # s; the range is 1.3 m at some 0.5947 s, sooner or later as the start is perturbed
STOPS = (
    '{name="near", when="range < 1.3", do="stop", verdict="near"}',
    f'{{name="late", at={LATE}, do="stop", verdict="over"}}',
)


@pytest.mark.slow
def test_each_member_ends_at_its_own_time() -> None:
    start = start_of_runs(prepare_case(falling(*STOPS)))
    shift = np.array([0.0, 0.0, 0.02])
    sooner, over = run_members(start, np.stack([start.position - shift, start.position + shift]), member_of)
    assert (sooner.stopped, over.stopped, over.time[-1]) == ("near", "over", LATE)
    height = 2.98 - 0.5 * 9.81 * sooner.time[-1] ** 2
    assert np.hypot(0.5 * sooner.time[-1], height) == pytest.approx(1.3, abs=1e-5)
    run = exunet.run(of_text(FALL.replace("0.0, 3.0]]", "0.0, 2.98]]"), f"script=[{', '.join(STOPS)}]"))
    assert run.time[-1] == pytest.approx(sooner.time[-1], abs=3e-7)
    theirs = values_of(run)
    for key, metric in sooner.metrics.items():
        assert metric.value == pytest.approx(theirs[key], rel=1e-5, abs=1e-5), key


@pytest.mark.ci
@pytest.mark.slow
def test_an_ensemble_counts_how_its_runs_ended() -> None:
    """Quantiles over time are of those that still go on."""
    result = exunet.ensemble(falling(*STOPS), runs=12, perturb=0.02)
    ways = {item.verdict: item for item in result.run.endings}
    assert set(ways) == {"near", "over"}
    assert sum(way.runs for way in ways.values()) == 12
    assert ways["over"].earliest_s == ways["over"].latest_s == LATE
    assert ways["near"].earliest_s < ways["near"].latest_s < LATE
    assert result.time[-1] < LATE
    for name, values in result.quantiles.items():
        assert values.shape == (7, len(result.time)), name
        assert np.isfinite(values).all(), name
    for key, values in result.metrics.items():  # `near` comes only in the runs that it ends
        some = key == "script_near_first_s"
        assert np.isfinite(values).sum() == (ways["near"].runs if some else 12), key


@pytest.mark.ci
@pytest.mark.slow
def test_breaks_of_some_of_the_runs() -> None:
    """Beyond the horizon some starts break threads and others none."""
    start = planar("time.end=1.6", "effects.breaking={force=400.0}", "engine.backend='compiled'")
    found = perturbed_runs(start, 8)
    counts = found.metrics["elements_broken"]
    some = int((counts > 0).sum())
    assert 0 < some < 8
    assert counts.min() < counts.max()
    assert np.isfinite(found.metrics["first_break_s"]).sum() == some
    assert f", in {some} of 8 runs" in str(found.range("first_break_s"))


# Runs side by side

DAMPED: dict[str, Any] = {"effects": {"rayleigh_damping": {"alpha": 0.3, "beta": 1e-6}}}


def stepped(method: str = "VelocityVerlet", step: float = 5e-5, end: float = 0.3, **tables: Any) -> Start:
    return prepare(thrown({"method": method, "step": step}, end=end, **tables))


def moved(begin: Start, runs: int) -> Any:
    return perturbed_positions(begin, runs, 1e-6, seed=7)


def all_of(start: Start, position: Any, **options: Any) -> list[Result]:
    return run_members(start, position, lambda result: result, **options)


def alike(one: Result, other: Result) -> None:
    for name in ("position", "velocity", "tension", "kinetic", "elastic", "potential", "dissipated"):
        assert np.asarray(getattr(one, name)).tobytes() == np.asarray(getattr(other, name)).tobytes(), name
    assert exunet.metrics(one) == exunet.metrics(other)


@pytest.mark.ci_for("RK44")
@pytest.mark.slow
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
def test_runs_side_by_side_have_the_bits_that_they_have_alone(method: str, tables: dict[str, Any]) -> None:
    begin = stepped(method, **tables)
    places = moved(begin, 3)
    together, apart = (all_of(begin, places, together=way) for way in (True, False))
    assert len({result.run.largest_tension.tension for result in together}) == 3
    for one, other in zip(together, apart, strict=True):
        alike(one, other)


@pytest.mark.slow
def test_neither_the_place_among_others_nor_the_workers_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = stepped(**DAMPED)
    places = moved(begin, WIDTH + 3)
    found = all_of(begin, places, together=True)
    others = [
        all_of(begin, places, together=True, workers=3),
        all_of(begin, places[::-1], together=True)[::-1],
    ]
    for limit in ("_MAX_VALUES", "_MAX_WORK"):  # as many times in one go as there must be
        with monkeypatch.context() as less:
            less.setattr(members, limit, 1)
            others.append(all_of(begin, places, together=True))
    for other in others:
        for one, another in zip(found, other, strict=True):
            alike(one, another)


@pytest.mark.slow
def test_a_run_that_stops_among_others_is_named_and_may_restart() -> None:
    """With the message, and with the finer steps, that it has alone; the others are not disturbed."""
    begin = stepped(step=1e-4, end=0.2, **DAMPED)
    places = moved(begin, 4)
    speeds = np.stack([begin.velocity] * 4)
    speeds[2] *= 40.0  # too fast for the step
    words = []
    for together in (True, False):
        with pytest.raises(exunet.RunStopped, match="run 12 of the ensemble") as stop:
            all_of(begin, places, velocity=speeds, together=together, first=10)
        words.append(str(stop.value))
    assert words[0] == words[1]
    found, alone = (all_of(begin, places, velocity=speeds, together=way, retries=6) for way in (True, False))
    assert found[2].run.cost.right_hand_sides > found[0].run.cost.right_hand_sides
    for one, other in zip(found, alone, strict=True):
        alike(one, other)


@pytest.mark.ci
@pytest.mark.slow
def test_an_ensemble_of_a_case_is_the_same_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = stepped(end=0.2, **DAMPED)
    found = []
    for pays in (0.0, np.inf):
        monkeypatch.setattr(Kernel, "compiled_before", False)
        monkeypatch.setattr(studies, "_PAYS", pays)
        found.append(exunet.ensemble(begin, 10, perturb=1e-6))
    same(*found)


@pytest.mark.parametrize(
    ("method", "tables"),
    [
        ("VelocityVerlet", {"effects": {"material_damping": {"relaxation_time": 1e-7}}}),
        ("RK44", {"effects": {"breaking": {"strain": 0.1}}}),
        ("VelocityVerlet", {"effects": {"air_drag": STRONG["air_drag"]}}),
        ("VelocityVerlet", {"bodies": {"wheel": {"mass": 2.0, "inertia": [0.2, 0.3, 0.4]}}}),
    ],
    ids=["viscous", "breaking", "air", "body"],
)
def test_scenes_that_cannot_go_side_by_side(method: str, tables: dict[str, Any]) -> None:
    begin = stepped(method, **tables)
    assert kernel_of_many(begin, 10**6, together=True) is None
    adaptive = prepare(thrown({"method": "DOPRI5", "tolerance": 1e-6}))
    assert side_by_side_kernel(adaptive.system, adaptive.plan) is None


# Ranges beside a run, and the commands

DEPLOYMENT = CASES / "planar_deployment.toml"
BRIEF = (DEPLOYMENT, "--set", "time.end=0.02", "--out", "here")
COMPILED = {"engine": {"backend": "compiled"}}


@pytest.fixture(scope="module")
def run() -> exunet.Result:
    return exunet.run(thrown({}, end=0.4, **COMPILED))


def scattered(result: exunet.Result, largest_tension_N: list[float]) -> Ensemble:
    """Perturbed runs like a run, but for the largest tension."""
    own, key = member_of(result), "largest_tension_N"
    members = [
        replace(own, metrics=own.metrics | {key: replace(own.metrics[key], value=value)})
        for value in largest_tension_N
    ]
    return ensemble_of(members, run=EnsembleRecord(move_m=1e-9, seed=0))


def test_metrics_have_their_ranges_in_summary_and_table(run: exunet.Result) -> None:
    many = scattered(run, largest_tension_N=[90.0, 99.0, 95.0])
    summary, metrics = summarise(run, None, many), exunet.metrics(run)
    found = summary["metrics"]["largest_tension_N"]
    assert found["value"] == metrics["largest_tension_N"].value
    assert found["range"] == {"runs": 3, "median": 95.0, "low": 90.0, "high": 99.0}
    assert summary["ensemble"]["runs"] == 3
    assert found["text"] == "95.00 N (90.00 to 99.00)"
    assert found["text"] in dict(rows(summary))["Tension"]


def test_peaks_of_stored_times_say_so() -> None:
    of = unfolding(square_net(cells=2, strings=True), times=5)
    of.tension[3, 2] = 17.0
    found = exunet.metrics(of)["largest_tension_N"]
    assert (found.value, found.time, found.place) == (17.0, 0.75, "element 2")


# Commands


@pytest.mark.ci
@pytest.mark.slow
def test_a_run_keeps_its_perturbed_runs(tmp_path: Path) -> None:
    """To 0.02 s nothing is taut: no range exceeds the printed digits. Then a run without, in its place."""
    done = command("run", *BRIEF, "--ensemble", 8, "--overwrite", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "here/summary.json").read_text())
    assert summary["ensemble"]["runs"] == 8
    speed = summary["metrics"]["bullet_speed_at_end_m_s"]
    assert speed["value"] == pytest.approx(2.499, abs=1e-3)
    assert speed["range"]["high"] - speed["range"]["low"] < 1e-4
    kept = exunet.load_ensemble(tmp_path / "here" / ENSEMBLE_FILE)
    assert kept.runs == 8
    assert kept.quantile("bullet_speed_at_end_m_s", 0.5) == speed["range"]["median"]
    done = command("run", *BRIEF, "--ensemble", 0, "--overwrite", folder=tmp_path)
    assert not (tmp_path / "here" / ENSEMBLE_FILE).exists()
    for number in (-1, 3, 100_001):
        assert command("run", *BRIEF, "--ensemble", number, folder=tmp_path).returncode == 2


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
    assert exunet.load_ensemble(folder).run.seed == 1


def test_only_the_result_of_a_folder_has_its_perturbed_runs(tmp_path: Path, run: exunet.Result) -> None:
    """Another result that lies in the folder of a run is not what the file beside describes."""
    exunet.save_ensemble(scattered(run, largest_tension_N=[90.0, 99.0]), tmp_path / ENSEMBLE_FILE)
    for name in ("result.h5", "other.h5"):
        exunet.save(run, tmp_path / name)
    assert exunet.load_result(tmp_path / "result.h5").ensemble_file == tmp_path / ENSEMBLE_FILE
    assert exunet.load_result(tmp_path / "other.h5").ensemble_file is None

"""The compiled loop and ensembles: the engine's own steps, order, output times, guards, determinism."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import CASES, planar

import exunet
from exunet.base.errors import CaseError, InputError, Interrupted, RunStopped
from exunet.integrators.compiled.loop import CompiledIntegration, loop_kernel
from exunet.methods.method import Plan
from exunet.scene.casefile import load
from exunet.simulation import run as runs
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.studies.ensemble import perturbed_positions, run_ensemble

TAUT = ("initial.packing = 1.0005", "time = {end = 0.002, output_times = [1e-4]}")
COMPILED = 'engine.backend = "compiled"'


@pytest.mark.parametrize("method", ["RK44", "VelocityVerlet"])
def test_equal_steps_are_those_of_the_engine(method: str) -> None:
    """To 1e-12, Verlet's half-step velocity in the damping force included, until round-off grows.

    The loop adds to positions, the engine to displacements: a difference of 4e-16 m is one of 1e-8 m/s2 here.
    """
    solver = f'solver = {{method = "{method}", step = 5e-6}}'
    on = ("rayleigh_damping", "gravity")
    engine, loop = (
        simulate(planar(*TAUT, solver, form, on=on)) for form in ('engine.backend="exudyn"', COMPILED)
    )
    assert loop.provenance["steps"] == engine.provenance["steps"] == 400
    assert loop.provenance["items"] == {}
    difference = np.abs(loop.velocity - engine.velocity).max(axis=(1, 2)) / np.abs(engine.velocity).max()
    assert difference[1] < 1e-12
    assert difference[-1] < 1e-10
    assert np.abs(loop.position - engine.position).max() < 1e-12
    # Verlet in the loop takes the power at the half step's velocity, both else Simpson's rule.
    rel = 1e-4 if method == "VelocityVerlet" else 1e-9
    assert loop.dissipated[-1] == pytest.approx(engine.dissipated[-1], rel=rel)


def taut(plan: Plan, times: Any) -> Any:
    """States at `times` of a net that stays taut, so that its motion is smooth."""
    start = planar("initial.packing = 1.01", "launch.radial_speed = 0.0")
    state = start.state.at(start.position, 0.0 * start.velocity)
    batch = CompiledIntegration(start.system, state, plan, loop_kernel(start.system)).through(times)
    return batch.position, batch.velocity


def test_dormand_prince_has_order_5() -> None:
    """Equal steps through huge tolerance: halving them divides the error by 2^5."""
    times = np.array([0.0, 4e-5])  # less than a tenth of the fastest element's period: all stay taut
    exact = taut(Plan("DOPRI5", tolerance=1e-13, first_step=1e-7, least_step=1e-12), times)
    errors = []
    for number in (4, 8, 16):
        step = times[1] / number
        plan = Plan("DOPRI5", tolerance=1e9, first_step=step, longest_step=step, least_step=1e-12)
        errors.append(max(np.abs(a[-1] - b[-1]).max() for a, b in zip(taut(plan, times), exact, strict=True)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([5.0, 5.0], abs=0.5), errors


def test_a_tolerance_is_kept() -> None:
    """The error falls with the tolerance; at the end of 0.2 ms it is a small multiple of it."""
    times = np.array([0.0, 1e-4, 2e-4])
    exact = taut(Plan("DOPRI5", tolerance=1e-13, first_step=1e-7, least_step=1e-12), times)[1]
    for tolerance in (1e-4, 1e-6, 1e-8):
        found = taut(Plan("DOPRI5", tolerance=tolerance, first_step=1e-7, least_step=1e-12), times)[1]
        assert np.abs(found - exact).max() < 50.0 * tolerance


def test_output_times_are_hit_and_do_not_change_the_result() -> None:
    few, many = (
        simulate(
            planar(
                "initial.packing = 0.99",
                "time.end = 0.01",
                f"time.output_step = {step}",
                "solver.tolerance = 5e-11",
                COMPILED,
            )
        )
        for step in (0.01, 0.0003)
    )
    assert many.time[[1, -1]] == pytest.approx([0.0003, 0.01], abs=0.0)
    assert np.abs(few.velocity[-1] - many.velocity[-1]).max() < 1e-8


def test_the_engine_and_the_loop_agree_at_tight_tolerances() -> None:
    engine, loop = (
        simulate(planar("time.end = 0.8", "time.output_step = 0.4", "solver.accuracy = 1e-7", form))
        for form in ('engine.backend="exudyn"', COMPILED)
    )
    assert np.abs(engine.velocity - loop.velocity).max() < 1e-6
    assert loop.provenance["right_hand_sides"] < engine.provenance["right_hand_sides"]


@pytest.mark.parametrize("method", ["RK67", "ODE23", "GeneralizedAlpha"])
def test_other_methods_are_refused_by_name(method: str) -> None:
    solver = f'solver={{method="{method}"{", step=1e-4" if method == "GeneralizedAlpha" else ""}}}'
    with pytest.raises(CaseError, match=f"compiled loop has .*DOPRI5, RK44, VelocityVerlet, not .*{method}"):
        load(CASES / "planar_undamped.toml", [solver, COMPILED])


def test_a_diverging_run_is_stopped_with_its_good_part() -> None:
    start = planar(
        "time.end = 1.0", "solver = {method = 'RK44', step = 1e-3, force = true, retry = 0}", COMPILED
    )
    with pytest.raises(RunStopped, match="diverged at t = ") as stop:
        simulate(start)
    part = stop.value.result
    assert part is not None
    assert not part.complete
    assert 0.0 < part.time[-1] < 1.0
    assert np.isfinite(part.velocity).all()
    assert np.isfinite(part.kinetic).all()


def test_steps_that_collapse_are_told() -> None:
    start = planar("initial.packing = 1.0005", "solver.retry = 0", COMPILED)
    start = replace(start, plan=Plan("DOPRI5", tolerance=1e-25, first_step=1e-6, least_step=1e-7))
    with pytest.raises(RunStopped, match=r"steps collapsed to .* the tolerance 1e-25 cannot be met"):
        simulate(start)


def test_an_interrupt_keeps_what_was_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "_SHOWN", -1.0)  # progress at each stored time, however fast the machine is

    def press_ctrl_c(time: float, *_: object) -> None:
        if time > 0.1:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stop:
        simulate(planar(COMPILED), progress=press_ctrl_c)
    assert stop.value.result is not None
    assert 0.0 < stop.value.result.time[-1] < 2.0


SHORT = ("time.end = 1.0", "time.output_step = 0.1", "solver.accuracy = 1e-4")


def test_an_ensemble_does_not_depend_on_the_workers() -> None:
    start = planar(*SHORT)
    position = perturbed_positions(start, 5, 1e-9, seed=4)
    one, three = (run_ensemble(start, position, workers=workers) for workers in (1, 3))
    for name, value in vars(one).items():
        assert np.array_equal(value, vars(three)[name]), name
    assert one.bullet_speed.shape == (5, 11, 4)
    assert one.area.shape == (5, 11)
    assert len(set(one.right_hand_sides.tolist())) > 1


def test_runs_of_an_ensemble_are_single_runs() -> None:
    start = planar(*SHORT, COMPILED)
    position = perturbed_positions(start, 2, 1e-9, seed=4)
    found = run_ensemble(start, position)
    single = simulate(start.moved(position[1]))
    speeds = np.linalg.norm(single.velocity[:, start.net.bullet_nodes], axis=-1)
    assert np.array_equal(found.bullet_speed[1], speeds)
    assert np.array_equal(found.time, single.time)
    np.testing.assert_allclose(found.elastic[1], single.elastic, rtol=1e-12)


def test_what_an_ensemble_cannot_do_is_refused() -> None:
    start = planar(*SHORT[:2], 'solver.method = "RK67"')
    with pytest.raises(InputError, match="runs by DOPRI5, RK44, VelocityVerlet, not by RK67"):
        run_ensemble(start, start.position[None])
    with pytest.raises(InputError, match=r"initial states must be \(runs, 40, 3\)"):
        run_ensemble(planar(), np.zeros((1, 39, 3)))


@pytest.mark.parametrize(
    "given",
    [
        None, 3.0, [], [[1.0], [1.0, 2.0]], np.zeros((0, 40, 3)), np.zeros((40, 3)),
        np.zeros((2, 40, 3), complex), np.zeros((2, 40, 3), object),
        np.zeros((2, 40, 3)).astype(str), np.full((2, 40, 3), np.nan),
    ],
    ids=["None", "scalar", "empty", "ragged", "no-runs", "one-state", "complex", "object", "text", "nan"],
)  # fmt: skip
def test_states_that_are_none_are_refused(given: Any) -> None:
    start = planar(*SHORT)
    with pytest.raises(InputError, match="position: "):
        exunet.run_ensemble(start, given)
    if given is not None:  # the start's velocity
        with pytest.raises(InputError, match="velocity: "):
            exunet.run_ensemble(start, start.position[None], given)


@pytest.mark.parametrize("workers", [0, -1, 1.5, "2", True])
def test_workers_that_cannot_be_meant_are_refused(workers: Any) -> None:
    start = planar(*SHORT)
    with pytest.raises(InputError, match="workers: must be a whole number, 1 or more"):
        run_ensemble(start, start.position[None], workers=workers)


@pytest.mark.parametrize(
    ("given", "words"),
    [((-1, 1e-9, 1), "runs"), ((2.5, 1e-9, 1), "runs"), ((1, float("nan"), 1), "amplitude"),
     ((1, -1.0, 1), "amplitude"), ((1, 1e-9, -1), "seed")],
)  # fmt: skip
def test_perturbations_that_cannot_be_meant_are_refused(given: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        exunet.perturbed_positions(planar(*SHORT), *given)


def test_states_as_lists_or_single_precision_run() -> None:
    start = planar("time.end = 0.02", "time.output_step = 0.01")
    wanted = run_ensemble(start, start.position[None]).bullet_speed
    assert np.array_equal(run_ensemble(start, start.position[None].tolist()).bullet_speed, wanted)  # type: ignore[arg-type]
    single = start.position[None].astype(np.float32)
    np.testing.assert_allclose(run_ensemble(start, single).bullet_speed, wanted, rtol=1e-4)


def test_a_method_of_exudyn_alone_says_what_an_ensemble_needs() -> None:
    start = prepare(load(CASES / "planar_undamped.toml", ["solver={accuracy=1e-3}"]).scene)
    with pytest.raises(
        InputError, match=r"not by ODE23, which auto chose for Exudyn: set engine.backend = \"auto\""
    ):
        run_ensemble(start, start.position[None])


def test_perturbations_belong_to_their_run() -> None:
    start = planar(*SHORT)
    few, many = (perturbed_positions(start, runs, 1e-3, seed=1) for runs in (2, 4))
    assert np.array_equal(few, many[:2])
    assert 0.9e-3 < np.abs(few - start.position).max() <= 1e-3
    assert not np.array_equal(few[0], few[1])


def test_a_run_that_diverges_is_named() -> None:
    start = planar(*SHORT, "solver = {method = 'RK44', step = 1e-3, force = true}")
    with pytest.raises(RunStopped, match=r"run 0 of the ensemble diverged"):
        run_ensemble(start, perturbed_positions(start, 1, 1e-9, seed=1))


@pytest.mark.parametrize(("accuracy", "allowed"), [("1e-4", 0.01), ("1e-2", 0.05)])
def test_the_largest_tension_is_that_of_all_steps(accuracy: str, allowed: float) -> None:
    """A snap lasts half a millisecond: the loop, which keeps one state in 64, must not pass over its peak.

    The engine's run looks at each step; before the horizon both must see the same peak, to what its sampling
    leaves out: of half a sine of 0.5 ms, with steps of 0.1 ms one within 0.05 ms of its top, 1 - cos(0.1 pi)
    or 5 %. One state in 64 saw 0.55 to 0.7 of it.
    """
    settings = ["time.end=0.6", "time.output_step=0.1", f"solver.accuracy={accuracy}", "solver.method=DOPRI5"]
    case = str(CASES / "planar_undamped.toml")
    seen = [
        exunet.run(exunet.load(case, [*settings, f'engine.backend="{loop}"'])).provenance["largest_tension"]
        for loop in ("exudyn", "compiled")
    ]
    assert seen[1]["element"] == seen[0]["element"]
    assert seen[1]["time_s"] == pytest.approx(seen[0]["time_s"], abs=1e-4)  # a fifth of the snap
    assert seen[1]["tension_N"] == pytest.approx(seen[0]["tension_N"], rel=allowed)


@pytest.mark.slow_for("body", "thrust")
@pytest.mark.parametrize("effect", [
    pytest.param("thrust", marks=pytest.mark.slow), "breaking", pytest.param("body", marks=pytest.mark.slow),
])  # fmt: skip
def test_an_ensemble_goes_through_events_and_counts_bodies(effect: str) -> None:
    """As a run alone, whose books they are: knots of a thrust, a cable that breaks, a body that spins."""
    push = "effects.thrust={bullets=[0],time=[0.02,0.05],force=[[0,0,5.0],[0,0,1.0]]}"
    body = "bodies.target={mass=1.0,inertia=[1.0,1.0,1.0],velocity=[1.0,0,0],angular_velocity=[0,0,2.0]}"
    case, more = {
        "thrust": ("planar_undamped", [push, "time.end=0.1", "time.output_step=0.01"]),
        "breaking": ("effects/breaking", []),
        "body": ("planar_undamped", [body, "time.end=0.02", "time.output_step=0.01"]),
    }[effect]
    loaded = load(CASES / f"{case}.toml", ["engine.backend=compiled", *more])
    start = prepare(loaded.scene)
    found, single = run_ensemble(start, start.position[None]), exunet.run(loaded)
    for name in ("kinetic", "elastic", "potential", "dissipated"):
        np.testing.assert_array_equal(getattr(found, name)[0], getattr(single, name))
    assert abs(single.dissipated[-1]) > 1e-3 or effect == "body"
    assert single.kinetic[0] > 2.5 or effect != "body"  # J, of the body alone


def test_a_tolerance_that_cannot_be_met_ends():
    """Where nothing is taut yet, steps of the least length alternate with some that have no error at all."""
    start = prepare(exunet.load(CASES / "planar_deployment.toml", ['engine.backend="compiled"']).scene)
    with pytest.raises(exunet.RunStopped, match="the steps collapsed to"):
        exunet.run(replace(start, plan=replace(start.plan, tolerance=1e-30)))

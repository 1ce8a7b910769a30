"""Methods of integration: orders, costs, momentum, output times, both back ends, and the choice by "auto"."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import BACKENDS, CASES, every_backend, one_thread, planar, ran

import exunet
from exunet.base.errors import CaseError, InputError
from exunet.methods.method import METHODS, Method
from exunet.model.limits import largest_damping_rate, largest_frequency, stable_step
from exunet.results.measures import bullet_speeds, momentum_books
from exunet.results.result import Result
from exunet.scene.casefile import load
from exunet.scene.scene import Scene
from exunet.simulation import pilot, planning
from exunet.simulation.preparation import Start, prepare, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.divisions import estimate_error
from exunet.studies.ensemble import run_members

STEPS = {"ExplicitEuler": (100, 200), "RK67": (6, 12), "RK44": (10, 20), "RK33": (20, 40)}
FIXED = [name for name, method in METHODS.items() if method.kind != "adaptive"]


def taut(solver: dict[str, object], end: float = 0.5) -> Result:
    """Two masses on a soft cable that stays taut, spinning and stretching: smooth to all orders."""
    net = {"node_masses": [0.5, 0.5], "cable": {"area": 1e-4, "density": 10.0, "youngs_modulus": 1e5}}
    initial = {
        "node_positions": [[-0.6, 0.0, 0.0], [0.6, 0.0, 0.0]],
        "node_velocities": [[0.0, -2.0, 0.1], [0.0, 2.0, 0.0]],
    }
    return ran(
        one_thread(end, net=net, initial=initial)
        | {"solver": solver, "time": {"end": end, "output_step": end}}
    )


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    run = taut({"tolerance": 1e-12})
    assert run.strain.min() > 0.0  # never slack, so never a kink
    return run.position[-1]


@pytest.mark.parametrize("method", FIXED)
def test_observed_order_is_the_declared_one(method, exact):
    coarse, fine = STEPS.get(method, (100, 200))
    errors = [
        np.abs(taut({"method": method, "step": 0.5 / n}).position[-1] - exact).max() for n in (coarse, fine)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(METHODS[method].order, abs=0.35)


@pytest.mark.parametrize("method", FIXED)
def test_counts_of_fixed_steps(method):
    run = taut({"method": method, "step": 0.002}, end=0.1)
    assert run.run.cost.steps == 50
    assert run.run.cost.rejected_steps == 0
    if METHODS[method].kind == "explicit":
        assert run.run.cost.right_hand_sides == 50 * METHODS[method].stages
    else:
        assert run.run.cost.newton_iterations >= 50


@pytest.mark.parametrize("method", ["DOPRI5", "ODE23"])
def test_adaptive_error_follows_the_tolerance(method, exact):
    errors = [
        np.abs(taut({"method": method, "tolerance": tol}).position[-1] - exact).max() for tol in (1e-6, 1e-9)
    ]
    assert errors[1] < 0.02 * errors[0]
    assert errors[1] < 1e-6


@pytest.mark.parametrize("method", list(METHODS))
def test_every_method_keeps_momentum(method):
    solver = {"method": method} | ({} if METHODS[method].kind == "adaptive" else {"step": 1e-3})
    run = taut(solver)
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12


def test_output_times_are_hit_exactly_by_every_kind():
    times = (0.1, 0.123456789, 0.3, 0.5)
    flying = {"packing": 0.5, "velocity": [1.0, 2.0, 3.0]}
    run = ran(one_thread(0.5, initial=flying) | {"time": {"end": 0.5, "output_times": list(times)}})
    assert run.time.tolist() == [0.0, *times]
    moved = run.position - run.position[0]
    assert moved[:, 0] == pytest.approx(np.outer(run.time, [1.0, 2.0, 3.0]), abs=1e-13)  # free flight


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
    assert loop.run.cost.steps == engine.run.cost.steps == 400
    assert loop.run.items == {}
    difference = np.abs(loop.velocity - engine.velocity).max(axis=(1, 2)) / np.abs(engine.velocity).max()
    assert difference[1] < 1e-12
    assert difference[-1] < 1e-10
    assert np.abs(loop.position - engine.position).max() < 1e-12
    # Verlet in the loop takes the power at the half step's velocity, both else Simpson's rule.
    rel = 1e-4 if method == "VelocityVerlet" else 1e-9
    assert loop.dissipated[-1] == pytest.approx(engine.dissipated[-1], rel=rel)


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
        simulate(planar("time.end = 0.8", "time.output_step = 0.4", "solver.tolerance = 7.9e-11", form))
        for form in ('engine.backend="exudyn"', COMPILED)
    )
    assert np.abs(engine.velocity - loop.velocity).max() < 1e-6
    assert loop.run.cost.right_hand_sides < engine.run.cost.right_hand_sides


@pytest.mark.parametrize("method", ["RK67", "ODE23", "GeneralizedAlpha"])
def test_other_methods_are_refused_by_name(method: str) -> None:
    solver = f'solver={{method="{method}"{", step=1e-4" if method == "GeneralizedAlpha" else ""}}}'
    with pytest.raises(CaseError, match=method):
        load(CASES / "planar_undamped.toml", [solver, COMPILED])


SHORT = ("time.end = 1.0", "time.output_step = 0.1", "solver.accuracy = 1e-2")


@pytest.mark.parametrize(
    "given",
    [
        None,
        3.0,
        [[1.0], [1.0, 2.0]],
        np.zeros((40, 3)),
        np.zeros((2, 40, 3), complex),
        np.full((2, 40, 3), np.nan),
    ],
    ids=["None", "scalar", "ragged", "one-state", "complex", "nan"],
)
def test_initial_states_of_an_ensemble_are_validated(given: Any) -> None:
    start = planar(*SHORT)
    with pytest.raises(InputError, match="position: "):
        exunet.run_ensemble(start, given)


@pytest.mark.parametrize(("accuracy", "allowed"), [("1e-4", 0.01), ("1e-2", 0.05)])
def test_the_largest_tension_is_that_of_all_steps(accuracy: str, allowed: float) -> None:
    """A snap lasts half a millisecond: the loop, which keeps one state in 64, must not pass over its peak.

    The engine's run looks at each step; before the horizon both must see the same peak, to what its sampling
    leaves out: of half a sine of 0.5 ms, with steps of 0.1 ms one within 0.05 ms of its top, 1 - cos(0.1 pi)
    or 5 %. One state in 64 saw 0.55 to 0.7 of it.
    """
    settings = ["time.end=0.6", "time.output_step=0.1", f"solver.accuracy={accuracy}"]
    case = str(CASES / "planar_undamped.toml")
    seen = [
        exunet.run(exunet.load(case, [*settings, f'engine.backend="{loop}"'])).run.largest_tension
        for loop in ("exudyn", "compiled")
    ]
    assert seen[1].element == seen[0].element
    assert seen[1].time == pytest.approx(seen[0].time, abs=1e-4)  # a fifth of the snap
    assert seen[1].tension == pytest.approx(seen[0].tension, rel=allowed)


@pytest.mark.slow_for("body", "thrust")
@pytest.mark.parametrize("effect", ["thrust", "breaking", "body"])
def test_an_ensemble_goes_through_events_and_counts_bodies(effect: str) -> None:
    """As a single run: knots of a thrust, a cable that breaks, a body that spins."""
    push = "effects.thrust={bullets=[0],time=[0.02,0.05],force=[[0,0,5.0],[0,0,1.0]]}"
    body = "bodies.target={mass=1.0,inertia=[1.0,1.0,1.0],velocity=[1.0,0,0],angular_velocity=[0,0,2.0]}"
    case, more = {
        "thrust": ("planar_undamped", [push, "time.end=0.1", "time.output_step=0.01"]),
        "breaking": ("effects/breaking", []),
        "body": ("planar_undamped", [body, "time.end=0.02", "time.output_step=0.01"]),
    }[effect]
    loaded = load(CASES / f"{case}.toml", ["engine.backend=compiled", *more])
    start = prepare(loaded.scene)
    (found,), single = run_members(start, start.position[None], lambda result: result), exunet.run(loaded)
    for name in ("kinetic", "elastic", "potential", "dissipated"):
        np.testing.assert_array_equal(getattr(found, name), getattr(single, name))
    assert exunet.metrics(found) == exunet.metrics(single)
    assert abs(single.dissipated[-1]) > 1e-3 or effect == "body"
    assert single.kinetic[0] > 2.5 or effect != "body"  # J, of the body alone


def test_a_tolerance_that_cannot_be_met_ends():
    """Where nothing is taut yet, steps of the least length alternate with some that have no error at all."""
    start = prepare(exunet.load(CASES / "planar_deployment.toml", ['engine.backend="compiled"']).scene)
    with pytest.raises(exunet.RunStopped, match="the steps collapsed to"):
        exunet.run(replace(start, plan=replace(start.plan, tolerance=1e-30)))


# The step of RK44 in scenes with bodies, where the case gives none: the energy balance holds to 1e-5

WITH_BODIES = CASES / "bodies"
RK44 = "solver={method='RK44'}"
OWN = ("dumbbell", "frame", "snap")  # whose files give a step
ALL = ("dumbbell", "ejection", "frame", "launch", "release", "snap", "tow", "tumbling")


def prepared(name: str, *overrides: str) -> Start:
    return prepare_case(exunet.load(WITH_BODIES / f"{name}.toml", overrides))


@pytest.mark.ci_for("release-compiled")
@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("name", ALL)
def test_rk44_keeps_the_energy(name: str, backend: str) -> None:
    """Energy to 1e-5, linear momentum to 1e-10, angular momentum to 1e-8 of their scales.

    The tow takes Exudyn minutes (measured: it holds to the end); here over its first 4 s.
    """
    short = ["time.end=4.0"] if (name, backend) == ("tow", "exudyn") else []
    found = exunet.run(exunet.load(WITH_BODIES / f"{name}.toml", [RK44, BACKENDS[backend], *short]))
    assert found.complete
    assert exunet.energy_balance(found) < 1e-5
    for kind, bound in (("linear", 1e-10), ("angular", 1e-8)):
        book = momentum_books(found)[kind]
        assert book.residual < bound * book.size


@pytest.mark.parametrize("name", OWN)
def test_the_steps_of_the_files_keep_it_too(name: str) -> None:
    found = exunet.run(exunet.load(WITH_BODIES / f"{name}.toml", ["engine.backend=compiled"]))
    assert found.run.plan.method == "RK44"
    assert exunet.energy_balance(found) < 1e-5


def test_the_first_step_that_keeps_it_is_taken() -> None:
    """Twice the step does not: 1.7e-5 in release.toml."""
    step = prepared("release", RK44, "engine.backend=compiled").plan.step
    assert step is not None
    twice = f"solver={{method='RK44', step={2.0 * step!r}}}"
    case = exunet.load(WITH_BODIES / "release.toml", [twice, "engine.backend=compiled"])
    assert exunet.energy_balance(exunet.run(case)) > pilot.BOOK


def test_a_step_of_the_case_is_taken_as_it_is() -> None:
    assert prepared("release", "solver={method='RK44', step=1e-3}").plan.step == 1e-3


# solver.method = "auto"

PLANAR = CASES / "planar_undamped.toml"
CONVERGED = sorted(
    (Path(__file__).parents[1] / "data" / "auto").glob("*.toml")
)  # written by data/make_converged.py
QUICK = ("mesh_4", "out_of_plane")
AUTO = ["time.output_step=", "time.output_times=[]"]


def by_auto(*overrides: str) -> Start:
    return prepare(exunet.load(PLANAR, ["solver=", *overrides]).scene)


def error_of(path: Path, accuracy: float, *overrides: str) -> float:
    """Error of the bullet speeds at the end of a run by auto, over the launch speed."""
    known: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    solver = f"solver={{accuracy={accuracy}}}"
    changes = [solver, *known["changes"], f"time.end={known['end']}", *AUTO, *overrides]
    result = exunet.run(exunet.load(CASES / known["case"], changes))
    assert known["uncertainty"] < 0.1 * accuracy
    off = float(np.abs(bullet_speeds(result)[-1] - known["speeds"]).max())
    return off / float(known["launch_speed"])


@pytest.mark.ci_for("packing_0.85-0.0001-exudyn")
@pytest.mark.parametrize(
    ("path", "accuracy", "backend"),
    [
        pytest.param(path, accuracy, backend, id=f"{path.stem}-{accuracy}-{backend}", marks=marks)
        for accuracies, backends, marks in (
            ((1e-5,), ("exudyn",), ()),
            ((1e-3, 1e-4, 1e-6), BACKENDS, pytest.mark.slow),
        )
        for path in CONVERGED
        if marks or path.stem in QUICK
        for accuracy in accuracies
        for backend in backends
    ],
)
def test_the_promised_accuracy_is_met(path, accuracy, backend):
    assert error_of(path, accuracy, BACKENDS[backend]) <= accuracy


def test_the_tolerance_follows_from_the_accuracy_and_the_launch_speed():
    """2.5 m/s times (1e-10 x accuracy)^(3/4), by auto and by name."""
    for accuracy, relative in ((1e-2, 1e-9), (1e-4, 10**-10.5), (1e-12, 1e-12)):
        plan = by_auto(f"solver.accuracy={accuracy}").plan
        assert plan.method == Method.DOPRI5
        assert plan.tolerance == pytest.approx(2.5 * relative, rel=1e-12)
        named = by_auto(f"solver={{method='DOPRI5', accuracy={accuracy}}}").plan
        assert named.tolerance == plan.tolerance
    assert by_auto("solver.method=DOPRI5").plan.tolerance == by_auto("solver.accuracy=1e-2").plan.tolerance


@pytest.mark.parametrize(
    ("changes", "least", "most"),
    [
        ((), 0.2, 0.2),
        (("net.mesh=0.5",), 0.2, 0.2),
        (("effects.material_damping={relaxation_time=1e-5}",), 0.3, 0.4),
        (("effects.rayleigh_damping={alpha=0.0,beta=1e-5}",), 0.3, 0.4),
    ],
)
def test_without_an_accuracy_a_short_run_sets_the_part_of_the_stable_step(changes, least, most):
    """A fifth of it without damping, up to twice that where damping dissipates what snaps put in."""
    start = by_auto(*changes, "time.end=40.0")  # above the bound of finer steps
    rates = largest_frequency(start.system), largest_damping_rate(start.system)
    part = start.plan.step / stable_step(Method.VELOCITY_VERLET, *rates)
    assert start.plan.method == Method.VELOCITY_VERLET
    assert least - 1e-9 <= part <= most + 1e-9
    assert start.plan == by_auto(*changes, "time.end=40.0").plan


@pytest.mark.parametrize(
    ("changes", "numba", "backend"),
    [
        ((), True, "compiled"),
        (("time.end=2.2",), True, "compiled"),
        (("solver.method=RK67",), True, "exudyn"),  # a method that only Exudyn has
        ((), False, "exudyn"),
        (("engine.backend=exudyn",), True, "exudyn"),
        (("bodies.hand={motion='port',mass=1.0,inertia=[1.0,1.0,1.0]}",), False, "compiled"),
    ],
)
def test_auto_takes_the_compiled_loop_where_it_can(changes, numba, backend, monkeypatch):
    monkeypatch.setattr(planning, "numba_installed", lambda: numba)
    case = exunet.load(PLANAR, ["solver=", "engine=", *changes])
    assert prepare_case(case, hosted=True).plan.backend == backend


@pytest.mark.parametrize("key", ["solver.accuracy=1.01", "solver.accuracy=1e300", "solver.step=1e-4"])
def test_no_accuracy_beyond_the_launch_speed_and_no_step_without_a_method(key):
    with pytest.raises(CaseError) as caught:
        by_auto(key)
    assert [fault.key for fault in caught.value.faults] == [key.partition("=")[0]]


def test_the_estimated_error_is_the_error():
    (path,) = (path for path in CONVERGED if path.stem == "mesh_4")
    known = tomllib.loads(path.read_text(encoding="utf-8"))
    changes = [*known["changes"], "time.end=1.3", *AUTO, "solver.tolerance=1e-5"]
    case = exunet.load(PLANAR, changes)
    result = exunet.run(case)
    found = estimate_error(case.scene, result)
    true = float(np.abs(bullet_speeds(result)[-1] - known["speeds"]).max()) / known["launch_speed"]
    assert true / 10.0 < found.at_end < 10.0 * true  # the other run errs too, by a tenth or so
    assert found.of == "bullets"
    assert found.nodes_at_end >= found.at_end
    assert found.nodes_largest >= max(found.largest, found.nodes_at_end)


def test_an_error_that_is_small_at_the_end_has_exceeded_the_accuracy_before():
    """A spinning pair that swings along its cable; its errors against 1e-12 are largest at 2.55 s."""
    net = {"node_masses": [0.5, 0.5], "cable": {"area": 1e-4, "density": 10.0, "youngs_modulus": 1e5}}
    places, speeds = [[-0.6, 0.0, 0.0], [0.6, 0.0, 0.0]], [[-0.8, -2.0, 0.1], [0.8, 2.0, 0.0]]
    pair = one_thread(3.0, net=net, initial={"node_positions": places, "node_velocities": speeds})
    pair |= {"time": {"end": 3.0, "output_step": 0.05}, "engine": {"backend": "exudyn"}}
    coarse = pair | {"solver": {"method": "VelocityVerlet", "step": 0.05}}
    result, exact = ran(coarse), ran(pair | {"solver": {"tolerance": 1e-12}})
    found = estimate_error(Scene.model_validate(coarse), result)
    speed, true = (np.linalg.norm(run.velocity[:], axis=2) for run in (result, exact))
    off = np.abs(speed - true).max(axis=1) / np.linalg.norm(speeds[0])
    assert off[-1] < found.accuracy == 1e-2 < off.max()
    assert found.largest == pytest.approx(off.max(), rel=0.1)  # the other run has an eighth of the step
    assert found.time_of_largest_s == result.time[off.argmax()]
    assert found.lost_from_s == result.time[np.flatnonzero(off > found.accuracy)[0]]

"""Three steppers in one loop: events, going back, retries, snapshots, the record, a stop by a guard."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy_stepper import NumpyStepper
from restarts import COARSE, HOPELESS, engine, seen
from scenes import BACKENDS, thrown

import exunet
from exunet.base.errors import RunStopped
from exunet.model.system import State, System
from exunet.scene.scene import Scene
from exunet.simulation import simulation
from exunet.simulation.preparation import prepare
from exunet.simulation.simulation import Simulation

FINE: dict[str, Any] = {"method": "RK44", "step": 1e-4}


@pytest.fixture(params=[*BACKENDS, "numpy"])
def tables(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Tables of a scene whose simulations have one of the steppers."""
    if request.param in BACKENDS:
        return {"engine": engine(request.param)}

    def made(*given: Any, **_: Any) -> NumpyStepper:
        system, state, plan = given[-3:]
        assert isinstance(system, System)
        assert isinstance(state, State)
        return NumpyStepper(system, state, plan)

    monkeypatch.setattr(simulation, "stepper_of", made)
    return {"engine": engine("exudyn")}


def net(tables: dict[str, Any], solver: dict[str, Any], end: float = 0.3, **more: Any) -> Scene:
    return thrown(solver, end=end, **tables, **more)


def test_a_condition_is_located_within_a_step(tables: dict[str, Any]) -> None:
    """Where the largest distance of two knots reaches 2 m, between two steps of a run that stores each.

    Until then the same steps are taken; the one that is taken again, and what is left of it, count as more.
    """
    stop = {"name": "wide", "when": "mouth_diameter > 2.0", "do": "stop", "verdict": "done"}
    run = exunet.run(net(tables, FINE, end=0.14, script=[stop]))
    (event,) = run.run.script
    assert run.time[-1] == event.time_s
    whole = exunet.run(net(tables, FINE, end=0.14, time={"end": 0.14, "output_step": 1e-4}))
    knots = np.setdiff1d(np.arange(whole.net.n_nodes), whole.net.bullet_nodes)
    place = whole.position[:, knots]
    wide = np.linalg.norm(place[:, :, None] - place[:, None], axis=3).max(axis=(1, 2))
    row = int(np.argmax(wide > 2.0))
    crossed = np.interp(2.0, wide[row - 1 : row + 1], whole.time[row - 1 : row + 1])
    assert event.time_s == pytest.approx(crossed, abs=2e-6)  # located to 1e-6 s; 1e-8 s by interpolation
    np.testing.assert_allclose(run.position[:-1], whole.position[: row - 1 : 50], rtol=0.0, atol=1e-12)


def test_what_breaks_is_the_same(tables: dict[str, Any]) -> None:
    """Elements break at the ends of steps in the snap at 0.16 s; energy is lost with each."""
    run = exunet.run(net(tables, FINE, end=0.25, effects={"breaking": {"strain": 0.001}}))
    broken = run.run.breaks
    assert len(broken) == 8
    assert run.run.cost.steps == round(0.25 / FINE["step"])  # no time is stepped twice after an event
    assert run.dissipated[-1] == pytest.approx(sum(item.energy_J or 0.0 for item in broken), rel=1e-9)


def test_steps_that_fail_are_retried_from_a_safe_state(tables: dict[str, Any]) -> None:
    run = exunet.run(net(tables, COARSE, end=0.3))
    retries = run.run.retries
    assert retries[0].step_s == 0.5 * COARSE["step"]
    assert all(0.0 < retry.from_time_s < 0.3 for retry in retries)
    assert len(run.time) == 61
    total = run.kinetic + run.elastic + run.potential + run.dissipated
    assert np.abs(total - total[0]).max() < 0.05 * total[0]


def test_a_snapshot_goes_on_to_the_same_bits(tables: dict[str, Any]) -> None:
    """Between two reads, with a force that acts since then, in the same and in another simulation."""
    start = prepare(net(tables, FINE))
    one, other = Simulation(start), Simulation(start)
    one.advance_to(0.1)
    one.set_force(0, [0.0, 0.0, 2.0])
    one.advance(0.0123)
    here = one.snapshot()
    one.advance_to(0.2)
    first = seen(one)
    for item in (one, other):
        item.restore(here)
        item.advance_to(0.2)
        assert seen(item) == first


def test_states_are_observed_within_a_run_without_going_on(tables: dict[str, Any]) -> None:
    """A look at all states after a stop, as for a record of work, does not go through the stops to come."""
    run = Simulation(prepare(net(tables, FINE))).run
    times, reached = [0.01, 0.02, 0.03], []

    def look() -> None:
        run.settle()
        reached.append(run.stepper.time)

    run.go(times, look)
    assert reached == times


def test_a_guard_stops_the_run_at_its_last_stored_state(tables: dict[str, Any]) -> None:
    with pytest.raises(RunStopped, match="diverged") as stop:
        exunet.run(net(tables, {**HOPELESS, "retry": 0}))
    part = stop.value.result
    assert part is not None
    assert 0.0 < part.time[-1] < 0.3
    assert np.isfinite(part.position).all()
    assert part.run.largest_tensions["net"].time <= part.time[-1]
    last = float(part.time[-1])
    note = {"name": "here", "at": last, "do": "note"}  # an event of the last stored time is not lost
    with pytest.raises(RunStopped, match="diverged") as stop:
        exunet.run(net(tables, {**HOPELESS, "retry": 0}, script=[note]))
    part = stop.value.result
    assert part is not None
    assert [event.time_s for event in part.run.script] == [part.time[-1]] == [last]

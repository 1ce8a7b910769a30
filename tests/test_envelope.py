"""The energies between stored times: the snaps that stored states miss."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import CASES, pair_of_masses, planar, thrown

import exunet
from exunet.bodies.rigid import RigidStates
from exunet.integrators.protocol import Batch
from exunet.results.result import Result
from exunet.simulation.extremes import Envelope
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

Floats = NDArray[np.float64]

BACKENDS = {
    "exudyn": 'engine.backend="exudyn"',
    "compiled": 'engine.backend = "compiled"',
}
SOLVERS = {
    "DOPRI5": "solver.accuracy = 1e-4",
    "RK44": "solver = {method = 'RK44', step = 2e-5}",
    "VelocityVerlet": "solver = {method = 'VelocityVerlet', step = 2e-5}",
}


def extremes(run: Result) -> tuple[Floats, Floats]:
    """Largest elastic and least kinetic energy, which must lie around those of the stored states."""
    assert run.largest_elastic is not None
    assert run.least_kinetic is not None
    for ends in (slice(None), slice(1, None)):
        inner = slice(None, -1) if ends.start else slice(None)
        assert np.all(run.largest_elastic[ends] >= run.elastic[inner])
        assert np.all(run.least_kinetic[ends] <= run.kinetic[inner])
    return run.largest_elastic, run.least_kinetic


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("form", BACKENDS)
def test_the_snap_of_two_masses_turns_all_motion_into_tension(form: str, solver: str) -> None:
    """The case of the known snap: they stop in its middle, of 6.7 ms, which no stored state shows."""
    overrides = ["time.output_times=", "time.output_step=1.0", BACKENDS[form], SOLVERS[solver]]
    run = exunet.run(exunet.load(CASES / "verification" / "snap.toml", overrides))
    assert run.elastic.max() < 1e-6 * run.kinetic[0]
    largest, least = extremes(run)
    # Of a sine of 6.7 ms, steps of up to 0.2 ms miss at most 1 - cos^2(pi 0.1 / 6.7) = 2e-3 of the top.
    assert largest.tolist() == [run.elastic[0], pytest.approx(run.kinetic[0], rel=2e-3)]
    assert least[0] == run.kinetic[0]
    assert least[1] < 2e-3 * run.kinetic[0]


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow_for("exudyn")
@pytest.mark.parametrize("form", BACKENDS)
def test_the_first_snap_of_the_net_is_seen_whatever_is_stored(form: str) -> None:
    """At 0.511 s, in less than 1 ms; against a run that stores a state every 20 us meanwhile."""
    until, around = ("time.end = 0.55", BACKENDS[form]), np.arange(0.505, 0.52, 2e-5).round(6).tolist()
    coarse = simulate(planar(*until, "time.output_step = 0.05"))
    fine = simulate(planar(*until, "time.output_step=", f"time.output_times = {around}"))
    largest, least = extremes(coarse)
    assert coarse.elastic.max() < 1e-6 * fine.elastic.max()
    assert largest.max() == pytest.approx(fine.elastic.max(), rel=0.02)
    assert least.min() - fine.kinetic.min() == pytest.approx(0.0, abs=0.02 * fine.elastic.max())
    assert coarse.time[np.argmax(largest)] == pytest.approx(0.55)


@pytest.mark.ci_for("{'backend': 'exudyn'}")
@pytest.mark.slow
@pytest.mark.parametrize("engine", [
    {"backend": "exudyn"}, pytest.param({"backend": "compiled"}, marks=pytest.mark.slow),
], ids=str)  # fmt: skip
def test_it_is_the_energy_of_the_steps_with_material_damping_and_thermal_strain(
    engine: dict[str, str],
) -> None:
    """Interval by interval, against the same equal steps all stored."""
    effects = {
        "material_damping": {"relaxation_time": 1e-4},
        "thermal_strain": {"temperature_change": -100.0, "expansion_coefficient": 5e-5},
    }
    solver, time = {"method": "RK44", "step": 2e-5}, {"end": 0.11}
    few, all_steps = (
        simulate(prepare(thrown(solver, effects=effects, engine=engine, time={**time, "output_step": step})))
        for step in (5e-3, 2e-5)
    )
    assert few.elastic.max() == pytest.approx(0.0, abs=1e-12)  # the snap at 0.1 s falls between
    assert all_steps.elastic.max() > 0.1
    inside = np.arange(22)[:, None] * 250 + np.arange(251)
    largest, least = extremes(few)
    np.testing.assert_allclose(largest[1:], all_steps.elastic[inside].max(axis=1), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(least[1:], all_steps.kinetic[inside].min(axis=1), rtol=1e-6)


def test_a_state_counts_for_the_interval_that_it_ends() -> None:
    envelope = Envelope(np.array([0.0, 1.0, 2.0, 3.0]))
    envelope.look(
        np.array([0.0, 0.5, 1.0, 1.5, 2.5]), np.array([1.0, 5, 2, 7, 9]), np.array([9.0, 5, 8, 3, 1])
    )

    def of_stored(elastic: list[float], kinetic: list[float]) -> tuple[Floats, Floats]:
        # The state stored at the start stands for the one before it.
        return envelope.around(0, *(np.array([item[0], *item]) for item in (elastic, kinetic)))

    nothing, much = [0.0] * 4, [10.0] * 4
    largest, least = of_stored(nothing, much)
    assert largest.tolist() == [1.0, 5.0, 7.0, 9.0]
    assert least.tolist() == [9.0, 5.0, 3.0, 1.0]
    envelope.forget_after(1.0)  # a run that goes back there
    largest, least = of_stored(nothing, much)
    assert largest.tolist() == [1.0, 5.0, 0.0, 0.0]
    assert least.tolist() == [9.0, 5.0, 10.0, 10.0]
    largest, least = of_stored([0.0, 6.0, 0.0], [10.0, 2.0, 10.0])
    assert largest.tolist() == [1.0, 6.0, 6.0]  # both ends belong to an interval
    assert least.tolist() == [9.0, 2.0, 2.0]
    part = envelope.around(1, np.array([0.0, 6.0, 0.0]), np.array([10.0, 2.0, 10.0]))  # from the second on
    assert [item.tolist() for item in part] == [[6.0, 6.0], [2.0, 2.0]]


def test_a_monitor_that_goes_back_forgets_what_it_saw_later() -> None:
    start = prepare(pair_of_masses(initial={"packing": 1.0, "node_velocities": [[-1, 0, 0], [1, 0, 0]]}))
    envelope = Envelope(np.array([0.0, 1.0, 2.0]))
    monitor = Monitor(start.system, start.state, envelope=envelope)

    def pass_through(time: list[float], position: Floats) -> None:
        moving = np.repeat(start.velocity[None], 3, axis=0)
        bodies = RigidStates(*(np.repeat(part[None], 3, axis=0) for part in start.state.bodies.parts()))
        monitor.take(Batch(np.array(time), position, moving, bodies, np.zeros((3, 0))))

    def seen() -> float:
        return float(envelope.around(0, np.zeros(4), np.zeros(4))[0][2])

    monitor.mark(1.0)
    pass_through([0.0, 0.5, 1.0], np.repeat(start.position[None], 3, axis=0))
    pass_through([1.0, 1.2, 1.5], np.array([1.0, 1.0, 1.01])[:, None, None] * start.position)
    assert seen() == pytest.approx(0.5 * 10.0 * 0.01005**2)
    assert monitor.go_back().time == 1.0
    assert seen() == 0.0


def test_a_snapshot_holds_the_interval_that_it_cuts() -> None:
    """Steps to 0.5, 1.0 and 1.4 s of stored times 0, 1, 2, 3 s: the last belongs to that until 2 s."""
    times = np.arange(4.0)
    whole, again = Envelope(times), Envelope(times)
    whole.look(np.array([0.5, 1.0, 1.4]), np.array([2.0, 1.0, 7.0]), np.array([4.0, 6.0, 3.0]))
    again.restore(whole.arrays(1.4))
    for item in (whole, again):
        item.look(np.array([1.8, 2.5]), np.array([5.0, 0.5]), np.array([9.0, 8.0]))
        largest, least = item.around(1, np.zeros(4), np.full(4, 20.0))
        assert largest.tolist() == [2.0, 7.0, 0.5]
        assert least.tolist() == [4.0, 3.0, 8.0]

"""Retries: from the last good state, with finer steps, recorded, bounded, and the same every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from restarts import COARSE, engine
from scenes import every_backend, pair_of_masses, thrown

import exunet
from exunet.base.errors import RunStopped
from exunet.integrators.protocol import Batch
from exunet.methods.method import Plan
from exunet.results.summary import summarise
from exunet.simulation import rollback
from exunet.simulation.guards import ENERGY_BOUND
from exunet.simulation.monitor import GOOD_PART, Monitor
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.rollback import LEAST_TOLERANCE, finer
from exunet.simulation.run import simulate

DAMPED = {"rayleigh_damping": {"alpha": 1e-2, "beta": 1e-7}}


def stopped(*arguments, **tables) -> RunStopped:
    with pytest.raises(RunStopped) as stop:
        exunet.run(thrown(*arguments, **tables))
    return stop.value


def goes_on_as_a_run_from_there(run: exunet.Result, start: Start) -> None:
    """After its last retry, `run` is what a run of its own from there gives, here for four stored times.

    It stops a retry from another state, at another time, or with the steps that were too long.
    """
    last = run.provenance["retries"][-1]
    kept = int(np.searchsorted(run.time, last["from_time"] + 1e-9)) - 1
    plan = start.plan
    for _ in run.provenance["retries"]:
        finer_plan = finer(plan)
        assert finer_plan is not None
        plan = finer_plan
    few = start.scene.time.model_copy(update={"end": 0.02})  # 4 of the times that are stored every 0.005 s
    again = simulate(
        replace(start, scene=start.scene.model_copy(update={"time": few}), plan=plan).moved(
            run.position[kept], run.velocity[kept]
        )
    )
    assert again.complete
    for name in ("position", "velocity"):
        ours, theirs = (getattr(item, name) for item in (run, again))
        assert np.abs(ours[kept : kept + 5] - theirs).max() < 1e-10  # snaps multiply the round-off of t


@pytest.mark.slow
@every_backend
def test_a_retry_mends_what_coarse_steps_spoil(backend):
    scene = thrown(COARSE, end=1.5, engine=engine(backend), effects=DAMPED)
    run = exunet.run(scene)
    assert run.complete
    retries = run.provenance["retries"]
    assert 1 <= len(retries) <= 2
    assert [r["step"] for r in retries] == [2.3e-4 / 2, 2.3e-4 / 4][: len(retries)]
    goes_on_as_a_run_from_there(run, prepare(scene))
    assert np.all(np.diff(run.dissipated) >= 0.0)  # the ledger goes on from the state gone back to
    assert run.time.tolist() == pytest.approx(np.arange(301) * 0.005)

    first = stopped({**COARSE, "retry": 0}, end=1.5, engine=engine(backend), effects=DAMPED).result
    assert first is not None
    back = retries[0]["from_time"]
    assert 0 < back < first.time[-1]
    kept = int(np.searchsorted(run.time, back, side="right"))
    assert np.array_equal(run.position[:kept], first.position[:kept])  # what was good stays, bit for bit
    total = first.kinetic + first.elastic + first.dissipated
    off = np.abs(total - total[0]) / total[0]
    assert off[:kept].max() <= GOOD_PART * ENERGY_BOUND
    assert off[kept] > GOOD_PART * ENERGY_BOUND


@pytest.mark.slow
@every_backend
def test_the_same_case_retries_to_the_same_bits(backend):
    run, again = (exunet.run(thrown(COARSE, end=0.7, engine=engine(backend))) for _ in range(2))
    retries = run.provenance["retries"]
    assert retries
    assert np.array_equal(run.position, again.position)
    assert np.array_equal(run.velocity, again.velocity)
    summary = summarise(run)
    assert [item["from_time_s"] for item in summary["retries"]] == [item["from_time"] for item in retries]
    assert summary["method"]["step_s"] == retries[-1]["step"]


def test_retries_are_bounded_and_can_be_turned_off():
    hopeless = {"method": "RK44", "step": 4e-3, "force": True}
    off, default = (stopped({**hopeless, **keys}) for keys in ({"retry": 0}, {}))
    assert off.result is not None
    assert default.result is not None
    assert off.result.provenance["retries"] == []
    assert [r["step"] for r in default.result.provenance["retries"]] == [2e-3, 1e-3]


def test_a_loose_tolerance_is_tightened():
    run = exunet.run(thrown({"method": "DOPRI5", "tolerance": 0.1}, end=0.7))
    assert run.complete
    retries = run.provenance["retries"]
    assert [r["tolerance"] for r in retries] == pytest.approx([0.01, 0.001])
    assert 0.0 < retries[0]["from_time"] < retries[1]["from_time"]
    assert run.provenance["tolerance"] == retries[-1]["tolerance"]


def test_restarts_change_nothing_but_round_off():
    """A smooth motion, stopped by hand half way and continued with the same steps, is the same motion."""
    scene = pair_of_masses(
        solver={"method": "RK44", "step": 1e-3},
        initial={"packing": 1.0, "spin": [0.0, 0.0, 2.0]},
        effects={"mass_damping": {"alpha": 0.5}},
    )
    whole = exunet.run(scene)
    plans: list[Plan] = []

    def same(plan: Plan) -> Plan:
        plans.append(plan)
        return plan

    take, calls = Monitor.take, []

    def once(self: Monitor, batch: Batch) -> None:
        take(self, batch)
        if batch.time[-1] > 0.22 and not calls:
            calls.append(batch.time[-1])
            raise RunStopped("by hand", step_cause=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollback, "finer", same)
        patch.setattr(Monitor, "take", once)
        again = exunet.run(scene)
    assert len(plans) == len(calls) == 1
    assert 0.2 <= again.provenance["retries"][0]["from_time"] < 0.5  # the last stored state that was seen
    assert np.abs(again.position - whole.position).max() < 1e-14
    assert np.abs(again.dissipated - whole.dissipated).max() < 1e-14
    assert again.provenance["steps"] > whole.provenance["steps"]  # those of both attempts are counted


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@every_backend
def test_what_broke_after_the_state_gone_back_to_is_whole_again(backend):
    """Eight elements break in the second snap; the run is stopped by hand right after, and goes on as before.

    It stops elements that stay broken, break twice, are reported twice, or whose energy is counted twice.
    """
    scene = thrown(COARSE, end=0.25, engine=engine(backend), effects={"breaking": {"strain": 0.001}})
    whole = exunet.run(scene)
    assert whole.provenance["retries"] == []
    broken = whole.provenance["broken"]
    assert len(broken) == 8
    take, calls = Monitor.take, []

    def once(self: Monitor, batch: Batch) -> None:
        if self.events and not calls:
            calls.append([event["element"] for event in self.events])
            raise RunStopped("by hand", step_cause=True)
        take(self, batch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollback, "finer", lambda plan: plan)
        patch.setattr(Monitor, "take", once)
        again = exunet.run(scene)
    assert calls == [[element["element"] for element in broken]]
    assert again.provenance["retries"][0]["from_time"] < broken[0]["time_s"]
    breaks = again.provenance["broken"]
    assert [item["element"] for item in breaks] == calls[0]
    times = [item["time_s"] for item in broken]
    assert [item["time_s"] for item in breaks] == pytest.approx(times, abs=1e-12)
    assert again.dissipated[-1] == pytest.approx(sum(item["energy_J"] for item in broken), rel=1e-9)
    for name in ("position", "velocity", "tension", "dissipated"):
        ours, theirs = (np.asarray(getattr(run, name)) for run in (again, whole))
        assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max()  # round-off of t, in snaps


def test_finer_plans():
    assert finer(Plan("RK44", step=1e-3)) == Plan("RK44", step=5e-4)
    adaptive = finer(Plan("DOPRI5", tolerance=1e-6, first_step=1.0, longest_step=2.0, least_step=0.5))
    assert adaptive is not None
    assert adaptive.tolerance == pytest.approx(1e-7)
    assert (adaptive.first_step, adaptive.longest_step, adaptive.least_step) == (0.5, 1.0, 0.25)
    assert finer(Plan("DOPRI5", tolerance=LEAST_TOLERANCE)) is None

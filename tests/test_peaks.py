"""The largest tension between stored times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import pair_of_masses

import exunet
from exunet.base.errors import RunStopped
from exunet.integrators.protocol import Largest
from exunet.results.measures import peak_tensions
from exunet.results.result import Result
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.extremes import ElementPeaks, Peaks
from exunet.simulation.preparation import prepare, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.spread import spread_of

CASES = Path(__file__).parent.parent / "cases"


def test_keeps_the_largest_and_forgets_the_later_ones():
    peaks = Peaks({"net": range(2)})
    peaks.look(np.array([0.0, 1.0]), np.array([[0.0, 3.0], [1.0, 2.0]]))
    peaks.look(np.array([2.0]), np.array([[9.0, 4.0]]))
    assert peaks.provenance() == {"time_s": 2.0, "tension_N": 9.0, "element": 0}
    peaks.forget_after(1.5)
    assert peaks.provenance() == {"time_s": 0.0, "tension_N": 3.0, "element": 1}


def test_what_was_largest_until_a_state_to_go_back_to_is_kept() -> None:
    """In one batch: element 0 pulls 5 N before the state that is marked, element 1 9 N after it."""
    time, tension = np.arange(4.0), np.array([[1.0, 0.0], [5.0, 0.0], [2.0, 0.0], [0.0, 9.0]])
    peaks = Peaks({"net": range(2)})
    peaks.look(time, tension, [0, 2])
    assert peaks.provenance() == {"time_s": 3.0, "tension_N": 9.0, "element": 1}
    peaks.forget_after(2.0)
    assert peaks.provenance() == {"time_s": 1.0, "tension_N": 5.0, "element": 0}
    peaks.forget_after(0.0)
    assert peaks.provenance() == {"time_s": 0.0, "tension_N": 1.0, "element": 0}
    again = Peaks({"net": range(2)})
    again.look(time, tension, [1, 3])  # whose last state is marked
    again.forget_after(1.0)
    assert again.provenance() == {"time_s": 1.0, "tension_N": 5.0, "element": 0}


def test_of_equal_tensions_the_first_is_told() -> None:
    """In time, then by number."""
    peaks = Peaks({"net": range(3)})
    peaks.look(np.arange(3.0), np.array([[0.0, 1.0, 0.0], [0.0, 4.0, 4.0], [4.0, 0.0, 0.0]]))
    peaks.look(np.array([3.0]), np.array([[4.0, 0.0, 0.0]]))
    assert peaks.provenance() == {"time_s": 1.0, "tension_N": 4.0, "element": 1}


def test_each_group_has_its_own_and_comes_back_from_a_snapshot() -> None:
    """Two elements of a net and one of a tether, whose largest is the later, smaller one."""
    groups = {"net": range(2), "tether a": range(2, 3)}
    peaks = Peaks(groups)
    peaks.look(np.array([0.0]), np.array([[0.0, 3.0, 1.0]]))
    peaks.look(np.array([1.0]), np.array([[1.0, 2.0, 2.0]]))
    peaks.take([Largest(2.5, 2.0, 0), Largest(2.5, 2.0, 2)])
    told = peaks.of_groups()
    assert told["net"] == {"tension_N": 3.0, "time_s": 0.0, "element": 1}
    assert told["tether a"] == {"tension_N": 2.5, "time_s": 2.0, "element": 2}
    assert peaks.provenance() == told["net"]
    again = Peaks(groups)
    again.restore(peaks.arrays())
    again.forget_after(1.5)
    assert again.of_groups()["tether a"] == {"tension_N": 2.0, "time_s": 1.0, "element": 2}
    peaks.forget_after(0.5)
    assert peaks.of_groups()["tether a"] == {"tension_N": 1.0, "time_s": 0.0, "element": 2}


def test_the_peak_of_each_element_goes_back_with_the_run() -> None:
    """Stored times 0 to 4 s, safe until 1 s, stored until 3 s: a run goes back there, and nowhere else."""
    times = np.arange(5.0)

    def seen() -> ElementPeaks:
        peaks = ElementPeaks(times, 2)
        peaks.look(
            np.array([0.0, 0.4, 1.0, 1.2, 2.0]), np.array([[1, 0], [5, 0], [2, 1], [3, 6], [1, 1]], float)
        )
        peaks.settle(1.0, 2.0)
        peaks.take(3.0, np.array([7.0, 0.0]))
        peaks.settle(1.0, 3.0)
        peaks.take(4.0, np.array([0.0, 9.0]))
        again = ElementPeaks(times, 2)
        again.restore(peaks.arrays())
        assert again.largest.tolist() == peaks.largest.tolist()
        return again

    assert seen().largest.tolist() == [7.0, 9.0]
    (at_stored := seen()).forget_after(3.0)
    assert at_stored.largest.tolist() == [7.0, 6.0]
    (at_safe := seen()).forget_after(1.0)
    assert at_safe.largest.tolist() == [5.0, 1.0]
    at_safe.look(np.array([1.5, 2.0]), np.array([[0.0, 2.0], [0.0, 0.0]]))
    at_safe.settle(1.0, 2.0)
    at_safe.forget_after(2.0)  # the run ends there
    assert at_safe.largest.tolist() == [5.0, 2.0]
    at_safe.settle(2.0, 2.0)
    at_safe.forget_after(2.0)
    assert at_safe.largest.tolist() == [5.0, 2.0]


@pytest.mark.ci_for("compiled")
@pytest.mark.slow
@pytest.mark.parametrize("engine", ["exudyn", "compiled"])
def test_each_element_has_its_peak_of_all_steps(engine: str) -> None:
    """Stored at 0, 0.3 and 0.6 s, the peaks are those of the same steps with each of them stored."""
    step, end = 2e-4, 0.6
    settings = [f"time.end={end}", "solver={method='RK44', step=2e-4}", f"engine.backend={engine}"]
    coarse, fine = (
        exunet.run(exunet.load(CASES / "planar_deployment.toml", [*settings, f"time.output_step={each}"]))
        for each in (0.3, step)
    )
    assert len(fine.time) == round(end / step) + 1
    found = peak_tensions(coarse)
    np.testing.assert_allclose(found, fine.tension.max(axis=0), rtol=1e-9, atol=1e-9)
    assert coarse.tension.max() < 0.9 * found.max()
    assert found.max() == coarse.provenance["largest_tension"]["tension_N"]


def test_a_slack_net_never_pulled():
    peaks = Peaks({"net": range(3)})
    peaks.look(np.array([0.0]), np.zeros((1, 3)))
    assert peaks.provenance()["element"] == -1


def test_the_snap_of_two_masses_is_seen_between_stored_times():
    """field.md: 294.65036 N where the snap lasts 6.7 ms; stored times before and after it only."""
    case = exunet.load(CASES / "verification" / "snap.toml", ["time.output_times=", "time.output_step=1.0"])
    result = exunet.run(case)
    peak = result.provenance["largest_tension"]
    assert result.tension.max() < 0.5 * 294.65036
    assert peak["tension_N"] == pytest.approx(294.65036, rel=1e-3)


def pulled_apart(engine: dict[str, str], speed: float, step: float, end: float, packing: float) -> Result:
    """Two masses that fly apart at +-speed [m/s], by RK44, only the last state stored."""
    scene = pair_of_masses(
        initial={"packing": packing, "node_velocities": [[-speed, 0, 0], [speed, 0, 0]]},
        solver={"method": "RK44", "step": step, "force": True, "retry": 0},
        time={"end": end, "output_step": end},
        engine=engine,
    )
    return simulate(prepare(scene))


BACKENDS = [{"backend": "exudyn"}, {"backend": "compiled"}]


@pytest.mark.parametrize("engine", BACKENDS[1:], ids=str)
def test_a_tension_that_lasts_one_step_is_seen_where_it_is(engine: dict[str, str]) -> None:
    """Slack, taut and slack again in two steps of 0.3 s: 0.89 N after the first, in the engine's own net.

    Catches a step of the compiled loop that hands on the elastic energy of its start for that of its end:
    the loop then looked at the second step's end, and saw 0 N.
    """
    wanted, found = (
        pulled_apart(form, speed=0.3, step=0.3, end=0.6, packing=0.95).provenance["largest_tension"]
        for form in (BACKENDS[0], engine)
    )
    assert wanted["tension_N"] > 0.8
    assert found["tension_N"] == pytest.approx(wanted["tension_N"], rel=1e-12)
    assert found["time_s"] == pytest.approx(0.3, abs=1e-12)
    assert found["element"] == wanted["element"] == 0


@pytest.mark.parametrize("engine", BACKENDS, ids=str)
def test_a_stretch_beyond_the_laws_validity_that_lasts_one_step_stops_the_run(engine: dict[str, str]) -> None:
    """Energy: strain sqrt(12.0 J / 5 N m) = 1.55, so a length of 2.025 m of 1 m, for one or two steps."""
    with pytest.raises(RunStopped, match="an element is longer than") as stop:
        pulled_apart(engine, speed=4.9, step=0.025, end=0.5, packing=1.0)
    assert stop.value.result is not None
    assert stop.value.result.time[-1] == 0.0  # the last stored state that is good


SNAP = CASES / "bodies" / "snap.toml"


@pytest.mark.ci_for("{'backend': 'exudyn'}")
@pytest.mark.slow_for("{'backend': 'exudyn'}")
@pytest.mark.parametrize("engine", BACKENDS, ids=str)
def test_the_peak_of_a_tether_that_breaks_is_seen_between_stored_times(engine: dict[str, str]) -> None:
    """At 250 N, before its first stored time; nothing of it is left at the stored ones."""
    settings = ("time.end=0.8", "time.output_step=0.4", "solver.step=1e-3", "effects.breaking={force=250.0}")
    result = exunet.run(exunet.load(SNAP, [*settings, *(f"engine.{k}={v}" for k, v in engine.items())]))
    assert result.tension.max() == 0.0
    peak = result.provenance["largest_tensions"]["tether tow"]
    assert peak == result.provenance["largest_tension"]
    assert 250.0 < peak["tension_N"] < 255.0
    first = result.provenance["broken"][0]
    assert peak["time_s"] == first["time_s"]
    told = dict(rows(summary := summarise(result)))
    assert f"in element {peak['element']}" in told["largest tension of tether tow"]
    assert "stored" not in told["largest tension of tether tow"]
    assert told["time of largest tension of tether tow"] == f"{peak['time_s']:.4f} s"
    assert summary["largest_tensions"]["tether tow"] == {"element": peak["element"], "of": "all steps"}
    assert summary["margins"]["tether tow"]["of"] == "all steps"
    assert summary["largest_tensions"]["net"]["element"] is None  # which has no elements
    assert "largest tension of the net" not in told


@pytest.mark.ci_for("False")
@pytest.mark.slow
@pytest.mark.parametrize("viscous", [False, True])
def test_the_outlet_of_a_locked_reel_is_seen_at_every_step(viscous: bool) -> None:
    """The tether is its own outlet: the same snap as without a drum, of which no state is handed over."""
    settings = ["time.end=1.3", "time.output_step=1.3", "tethers.tow.divisions=1", "engine.backend=compiled"]
    settings += ["effects.material_damping={relaxation_time=1e-3}"] if viscous else []
    wanted, found = (
        exunet.run(exunet.load(SNAP, [*settings, *reel])).provenance["largest_tensions"]["tether tow"]
        for reel in ((), ("tethers.tow.reel={paid_out=8.0}",))
    )
    assert wanted["tension_N"] > 200.0
    assert found["tension_N"] == pytest.approx(wanted["tension_N"], rel=1e-9)
    assert (found["time_s"], found["element"]) == (wanted["time_s"], wanted["element"])


@pytest.mark.slow
def test_the_spread_of_a_tether_has_its_element_and_time() -> None:
    """Over all steps of the moved starts too; the margin is then as sure as the tension."""
    settings = (
        "time.end=0.8",
        "solver.step=1e-3",
        "engine.backend=compiled",
        "effects.breaking={force=250.0}",
    )
    found = spread_of(prepare_case(exunet.load(SNAP, settings)), 2).judged
    tension, time = found["tether_tow_largest_tension_N"], found["tether_tow_time_of_largest_tension_s"]
    assert tension.value == found["largest_tension_N"].value
    assert tension.places == found["largest_tension_N"].places
    assert time.value == found["time_of_largest_tension_s"].value
    assert found["tether_tow_margin"].predictable

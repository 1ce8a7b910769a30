"""The largest tension between stored times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_nets import pair_of_masses

import exunet
from exunet.base.errors import RunStopped
from exunet.results.result import Result
from exunet.simulation.peaks import Peaks
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

CASES = Path(__file__).parent.parent / "cases"


def test_keeps_the_largest_and_forgets_the_later_ones():
    peaks = Peaks()
    peaks.look(np.array([0.0, 1.0]), np.array([[0.0, 3.0], [1.0, 2.0]]))
    peaks.look(np.array([2.0]), np.array([[9.0, 4.0]]))
    assert peaks.provenance() == {"time_s": 2.0, "tension_N": 9.0, "element": 0}
    peaks.forget_after(1.5)
    assert peaks.provenance() == {"time_s": 0.0, "tension_N": 3.0, "element": 1}


def test_a_slack_net_never_pulled():
    peaks = Peaks()
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


FORMS = [{"net": "connectors"}, {"net": "fused"}, {"loop": "compiled"}]


@pytest.mark.parametrize("engine", FORMS[1:], ids=str)
def test_a_tension_that_lasts_one_step_is_seen_where_it_is(engine: dict[str, str]) -> None:
    """Slack, taut and slack again in two steps of 0.3 s: 0.89 N after the first, in the engine's own net.

    Catches a step of the compiled loop that hands on the elastic energy of its start for that of its end:
    the loop then looked at the second step's end, and saw 0 N.
    """
    wanted, found = (
        pulled_apart(form, speed=0.3, step=0.3, end=0.6, packing=0.95).provenance["largest_tension"]
        for form in (FORMS[0], engine)
    )
    assert wanted["tension_N"] > 0.8
    assert found["tension_N"] == pytest.approx(wanted["tension_N"], rel=1e-12)
    assert found["time_s"] == pytest.approx(0.3, abs=1e-12)
    assert found["element"] == wanted["element"] == 0


@pytest.mark.parametrize("engine", FORMS, ids=str)
def test_a_stretch_beyond_the_laws_validity_that_lasts_one_step_stops_the_run(engine: dict[str, str]) -> None:
    """Energy: strain sqrt(12.0 J / 5 N m) = 1.55, so a length of 2.025 m of 1 m, for one or two steps."""
    with pytest.raises(RunStopped, match="an element is longer than") as stop:
        pulled_apart(engine, speed=4.9, step=0.025, end=0.5, packing=1.0)
    assert stop.value.result is not None
    assert stop.value.result.time[-1] == 0.0  # the last stored state that is good

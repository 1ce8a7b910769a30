"""The largest tension between stored times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.simulation.peaks import Peaks

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

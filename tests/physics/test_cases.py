"""The cases of the paper's net, up to their first snap, whose moment and motion are known by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.results.measures import bullet_speeds, energy_balance

CASES = Path(__file__).parents[2] / "cases"


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_case_flies_until_its_strings_snap(path):
    """Bullets leave at 2.5 m/s along the diagonals; the strings of sqrt(2) m, packed to a part p of that, are
    taut when they have gone sqrt(2) (1 - p) m. Without damping they fly freely, and the net lies still.

    Eq. (13) damps with alpha, and along the slack strings too, with up to beta EA / (L m) = 0.0124 / s: it
    slows the bullets and drags the light corners after them, so the strings snap later. Catches a launch, a
    packing, a damping or stored times that are not those of the case.
    """
    case = exunet.load(path, ["time.end=0.6", "time.output_step=0.05"])
    run = exunet.run(case)
    assert run.complete
    assert run.time == pytest.approx(0.05 * np.arange(13), abs=1e-12)
    snap = math.sqrt(2.0) * (1.0 - case.scene.initial.packing) / 2.5
    before = run.time < snap
    assert before.sum() == 11  # 0.50912 s and 0.53174 s, by packing
    assert not run.tension[before].any()

    damping = case.scene.effects.rayleigh_damping
    alpha, beta = (damping.alpha, damping.beta) if damping else (0.0, 0.0)
    rate = beta * 70e9 * math.pi / 4 * 0.004**2 / math.sqrt(2.0) / 0.5
    speeds = bullet_speeds(run)[before].T
    assert np.all(speeds <= 2.5 * np.exp(-alpha * run.time[before]) + 1e-9)
    assert np.all(speeds >= 2.5 * np.exp(-(alpha + rate) * run.time[before]) - 1e-9)
    knots = np.setdiff1d(np.arange(run.net.n_nodes), run.net.bullet_nodes)
    if not damping:
        assert np.abs(run.position[before][:, knots] - run.position[0, knots]).max() < 1e-12
    else:
        assert speeds[0, -1] < 2.5 * np.exp(-alpha * 0.5) - 1e-4

    peak = run.provenance["largest_tension"]
    assert run.net.is_string[peak["element"]]
    assert snap < peak["time_s"] < (0.6 if damping else snap + 5e-4)  # the snap lasts half a millisecond
    assert np.abs(run.velocity[-1, knots]).max() > 1.0  # 6 g a knot take much of a snap of 0.5 kg at 2.5 m/s
    assert energy_balance(run) < 1e-5
    assert np.abs(run.momentum).max() < 1e-9  # four bullets that mirror each other

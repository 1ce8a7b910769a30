"""Headlines of pulls of threads on bodies, of times of conditions in scripts, and of single corner units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripts import END, FALL, TOWED, case_of, entry
from test_loads import carrying, towed, units

import exunet
from exunet.plots.page import Source
from exunet.plots.registry import figure
from exunet.plots.tensions import loads_on_bodies
from exunet.results.course import course_of
from exunet.results.headlines import headline, headlines_for, headlines_of
from exunet.results.judged import Judged
from exunet.results.spread import names_of
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.scene.casefile import Case
from exunet.simulation.preparation import prepare_case
from exunet.studies.ensemble import run_ensemble
from exunet.studies.spread import spread_of

CASES = Path(__file__).parents[1] / "cases" / "bodies"
NEAR = entry("near", when="range < 2.9", do="note") + entry("later", after="near", delay=0.1, do="note")
BOTH = NEAR + entry("given", at=0.5, do="note") + entry("never", when="range > 1e3", do="note")


def test_the_largest_pull_on_a_body_where_and_when() -> None:
    """5 N at the first time, 30 N at the second, at node 4, which is 1 m beside the ship's centre.

    The torque of 30 N along (0, -4, -5) about a centre 1 m below: 30 x 4 / sqrt(41) N m.
    """
    found = headlines_of(course_of(towed((3,))))
    for key in ("body_ship_attachment_", "attachment_ship_4_"):
        assert found[f"{key}largest_force_N"] == pytest.approx(30.0, rel=1e-14)
        assert found[f"{key}time_of_largest_force_s"] == 1.0
        assert found[f"{key}largest_torque_N_m"] == pytest.approx(120.0 / np.sqrt(41.0), rel=1e-14)
        assert found[f"{key}time_of_largest_torque_s"] == 1.0
    assert "attachment_ship_packed_largest_force_N" not in found
    whole = towed((3,))
    told = {"step": 0.1, "steps": 1, "build_seconds": 0.0, "integration_seconds": 0.0}
    table = dict(rows(summarise(replace(whole, provenance={**whole.provenance, **told}))))
    assert table["largest force at an attachment of ship"].startswith("30.00 N at node 4 (of threads")
    assert not any("on ship at node" in name for name in table)


def test_the_pull_by_a_packed_net_is_about_the_centre_of_mass() -> None:
    """As that of nodes: at (0.5, 0.5, 0), from which the pulled nodes are (0.5, -0.5, 0) and (0.5, 1.5, 0).

    The first pulls with 4 N along -x, the second with 6 N along (0, 2, 1); both at 1 s.
    """
    first, second = np.array([-4.0, 0.0, 0.0]), 6.0 * np.array([0.0, 2.0, 1.0]) / np.sqrt(5.0)
    torque = np.cross([0.5, -0.5, 0.0], first) + np.cross([0.5, 1.5, 0.0], second)
    found = headlines_of(course_of(carrying()))
    for key in ("body_ship_attachment_", "attachment_ship_packed_"):
        assert found[f"{key}largest_force_N"] == pytest.approx(np.linalg.norm(first + second), rel=1e-14)
        assert found[f"{key}largest_torque_N_m"] == pytest.approx(np.linalg.norm(torque), rel=1e-14)
        assert found[f"{key}time_of_largest_torque_s"] == 1.0


def test_the_figure_of_loads_shows_a_packed_net_that_is_pulled() -> None:
    """By its torque about the centre of mass, 0 once it is let go; not where nothing pulls on it."""
    whole = carrying()
    made = figure(whole, "loads")
    assert made.axes[0].get_lines()[0].get_label() == "ship, packed net"
    (line,) = made.axes[1].get_lines()
    largest = headlines_of(course_of(whole))["attachment_ship_packed_largest_torque_N_m"]
    assert largest is not None
    np.testing.assert_allclose(line.get_ydata(), [0.5 * largest, largest, 0.0], rtol=1e-14)
    assert loads_on_bodies(Source(replace(whole, tension=np.zeros_like(whole.tension)))) is None


def test_what_stands_in_the_summary_alone_is_told_as_such() -> None:
    """Of any kind: impulses of single corner units were told as of attachments."""
    judged = [
        Judged(headline(key), 8, 1.0, 0.5, 2.0)
        for key in ("impulse_of_units_N_s", "unit_0_impulse_N_s", "unit_1_impulse_N_s")
    ]
    assert names_of(judged) == "impulse of the corner units, 2 more in summary.json alone"


def released() -> Case:
    return case_of(END, "engine.backend=compiled", "time.end=0.6", "solver.step=4e-4", scene=TOWED)


CASES_WITH_PULLS = {
    "frame": lambda: exunet.load(CASES / "frame.toml", ["engine.backend=compiled", "time.end=0.1"]),
    "carried": lambda: exunet.load(CASES / "release.toml", ["engine.backend=compiled", "time.end=0.45"]),
    "released": released,
}


@pytest.mark.parametrize("case", CASES_WITH_PULLS.values(), ids=CASES_WITH_PULLS)
def test_moved_starts_keep_the_pulls_that_a_result_has(case: Callable[[], Case]) -> None:
    """The same steps: at the same times the same sizes but for round-off; nothing after a release."""
    start = prepare_case(case())
    ours = course_of(exunet.run(case()))
    theirs = run_ensemble(start, start.position[None], together=False).course(0, 4.0)
    assert ours.pulled == theirs.pulled
    assert ours.pull.shape == (len(ours.time), len(ours.pulled), 2)
    assert ours.pull[..., 0].max() > 0.1
    np.testing.assert_allclose(theirs.pull, ours.pull, rtol=1e-7, atol=1e-9 * ours.pull.max())
    for item in headlines_for(ours):
        assert headline(item.key).key == item.key
        assert headline(item.key).words == item.words


def test_the_pull_on_a_body_has_its_spread() -> None:
    """Of each place in the summary, of the largest in the table."""
    case = CASES_WITH_PULLS["frame"]()
    spread = spread_of(prepare_case(case), 2)
    summary = summarise(exunet.run(case), spread=spread)
    places = summary["attachments"]["frame"]
    assert len(places) == 4  # the corners of the net
    for place in places:
        found = summary["headlines"][f"{place['headlines']}_largest_force_N"]
        assert found["value"] is not None or found["median"] is not None
    table = dict(rows(summary, spread))
    assert "at node" in table["largest force at an attachment of frame"]
    assert not any("on frame at node" in name for name in table)


def test_conditions_have_times_with_a_spread() -> None:
    """Not what the case gives. What is never reached has no time, but a number of times.

    The table says where the ranges are, or that there are none.
    """
    case = case_of(BOTH, scene=FALL)
    result, spread = exunet.run(case), spread_of(prepare_case(case), 2)
    summary = summarise(result, spread=spread)
    happened = {item["entry"]: item["time_s"] for item in result.provenance["script"]}
    for name in ("near", "later"):
        found = summary["headlines"][f"script_{name}_first_s"]
        assert found["this_run"] == happened[name]
        assert found["value"] == pytest.approx(happened[name], abs=1e-5)  # located to 1e-6 s
        assert summary["headlines"][f"script_{name}_times"]["value"] == 1.0
    assert "script_given_first_s" not in summary["headlines"]
    assert "script_never_first_s" not in summary["headlines"]
    assert summary["headlines"]["script_never_times"]["value"] == 0.0
    alone = "times that the case does not give are of this run only"
    told = [words for name, words in rows(summarise(result)) if name == "script"]
    assert f"{alone}: other runs of it may have others" in told


def test_each_unit_has_its_impulse() -> None:
    """2 and 0.4 N s, by their places in the summary."""
    found = units(3)
    summary = summarise(found)
    for unit, value in zip(summary["control"]["units"], (2.0, 0.4), strict=True):
        assert (
            summary["headlines"][f"{unit['headlines']}_impulse_N_s"]["this_run"]
            == value
            == unit["impulse_N_s"]
        )

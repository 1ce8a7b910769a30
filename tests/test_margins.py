"""Margins of threads, strings and tethers to their strength."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from result_samples import square_net, unfolding

import exunet
from exunet.cli.ensemble import rows as table_of
from exunet.results.course import course_of
from exunet.results.headlines import headline, headlines_of
from exunet.results.margins import Groups, Peak
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.simulation.preparation import prepare_case
from exunet.studies.spread import spread_of

CASES = Path(__file__).parents[1] / "cases"
SNAP, PLANAR = CASES / "bodies" / "snap.toml", CASES / "planar_undamped.toml"
COUNTS = ("step", "steps", "rejected_steps", "build_seconds", "integration_seconds")
QUICK = ("engine.backend=compiled",)


@pytest.fixture(scope="module")
def snapped() -> exunet.Result:
    """A tether that snaps, said to bear 5000 N."""
    return exunet.run(exunet.load(SNAP, [*QUICK, "tethers.tow.strength=5000.0"]))


def test_a_tether(snapped: exunet.Result) -> None:
    """The largest tension of all steps is known of the group that has it."""
    worst = exunet.margins(snapped)["tether tow"]
    peak = snapped.provenance["largest_tension"]
    assert (worst.element, worst.time, worst.of) == (peak["element"], peak["time_s"], "all steps")
    assert worst.margin == pytest.approx(5000.0 / peak["tension_N"] - 1.0, rel=1e-12)
    assert worst.tension == pytest.approx(peak["tension_N"], rel=1e-12)
    assert list(exunet.margins(snapped)) == ["tether tow"]  # the cable of the net states no strength


def test_of_the_elements_at_a_body(snapped: exunet.Result) -> None:
    """The last element of the tether ends at the target, over the stored times."""
    last = snapped.net.n_elements - 1
    found = exunet.loads(snapped, "target").margins["tether tow"]
    assert (found.element, found.of) == (last, "stored times")
    assert found.margin == pytest.approx(5000.0 / snapped.tension[:, last].max() - 1.0, rel=1e-12)


@pytest.mark.ci
@pytest.mark.slow
def test_in_summary_table_file_and_spread(snapped: exunet.Result, tmp_path: Path) -> None:
    summary = summarise(snapped)
    found = summary["margins"]["tether tow"]
    margin = summary["headlines"]["tether_tow_margin"]["this_run"]
    assert margin == exunet.margins(snapped)["tether tow"].margin
    told = dict(rows(summary))["margin of tether tow"]
    assert f"in element {found['element']} at t = {found['time_s']:.6g} s" in told
    assert "strength / largest tension - 1" in told
    exunet.save(snapped, tmp_path / "snap.h5")
    assert exunet.margins(exunet.load_result(tmp_path / "snap.h5")) == exunet.margins(snapped)
    spread = spread_of(prepare_case(exunet.load(SNAP, [*QUICK, "tethers.tow.strength=5000.0"])), 2)
    judged = spread.judged["tether_tow_margin"]
    assert judged.predictable
    assert judged.value == pytest.approx(margin, rel=1e-3)
    assert "at t = " in dict(rows(summarise(snapped, None, spread), spread))["margin of tether tow"]


@pytest.mark.parametrize("key", ["margin_of_threads", "margin_of_strings", "tether_a-b_margin"])
def test_a_headline_of_its_key(key: str) -> None:
    assert headline(key).key == key


def test_the_worst_of_each_group() -> None:
    """Elements of their own strengths: the worst is not where the largest tension is."""
    result = unfolding(square_net(2))
    net = result.net
    tension = np.zeros_like(np.asarray(result.tension))
    strength = np.full(net.n_elements, 100.0)
    tension[1, 0], tension[2, 1], strength[1], strength[2] = 50.0, 40.0, 60.0, 0.0
    tension[2, 2] = 1e9  # of which no strength is known
    given = replace(result, net=replace(net, strength=strength), tension=tension, provenance={})
    found = exunet.margins(given)["threads"]
    assert (found.element, found.time, found.strength) == (1, result.time[2], 60.0)
    assert found.margin == pytest.approx(0.5)
    assert headlines_of(course_of(given))["margin_of_threads"] == found.margin


def test_none_without_strength_or_tension() -> None:
    result = unfolding(square_net(2))
    assert result.net.strength is None
    assert exunet.margins(result) == {}
    assert summarise(result)["margins"] == {}
    slack = replace(
        result,
        net=replace(result.net, strength=np.ones(result.net.n_elements)),
        tension=0.0 * np.asarray(result.tension),
        provenance=dict.fromkeys(COUNTS, 1),
    )
    assert exunet.margins(slack) == {}
    assert headlines_of(course_of(slack))["margin_of_threads"] is None
    assert "margin of threads" not in dict(rows(summarise(slack)))


def test_not_of_all_of_the_group_all_steps_are_known() -> None:
    """Then another element may have had less margin between stored times, which is said."""
    net = replace(square_net(), strength=np.linspace(10.0, 20.0, square_net().n_elements))
    groups = Groups.of(net)
    assert groups is not None
    tension, last = np.ones((1, net.n_elements)), net.n_elements - 1
    known = {f"net from element {last}": Peak(50.0, 0.25, last)}
    found = groups.least(0, np.zeros(1), *groups.loaded(tension), known)
    assert found is not None
    assert (found.element, found.time, found.of) == (last, 0.25, "stored times")
    assert found.margin == pytest.approx(20.0 / 50.0 - 1.0)
    slack = {name: Peak(0.0, 0.0, -1) for name in net.spans}
    found = groups.least(0, np.zeros(1), *groups.loaded(tension), slack | known)
    assert found is not None
    assert (found.element, found.of) == (last, "all steps")


@pytest.mark.parametrize("form", ["engine.backend=compiled", "engine.backend=exudyn"])
def test_margins_are_of_all_steps_where_strings_bear_more(form: str) -> None:
    """Stored at four times only: peaks are between them, of threads and of strings. By each element's largest
    tension of all steps, which is looked for apart; the spread's runs look for the same.
    """
    given = [form, "time.end=1.2", "time.output_step=0.3", "net.strings.strength=900.0"]
    case = exunet.load(PLANAR, [*given, "net.cable.strength=300.0", "solver.tolerance=1e-7"])
    result = exunet.run(case)
    peaks, strings = exunet.peak_tensions(result), result.net.is_string
    found = exunet.margins(result)
    for name, own, strength in (("threads", ~strings, 300.0), ("strings", strings, 900.0)):
        one = found[name]
        assert one.of == "all steps"
        assert one.margin == pytest.approx(strength / peaks[own].max() - 1.0, rel=1e-12)
        assert one.element == np.flatnonzero(own)[peaks[own].argmax()]
        stored = np.asarray(result.tension)[:, own].max()
        assert stored < 0.9 * one.tension
        assert not np.isclose(result.time, one.time, atol=1e-6).any()
    peak = result.provenance["largest_tension"]
    largest = max(item.tension for item in found.values())
    assert peak["tension_N"] == pytest.approx(largest, rel=1e-15)  # in Exudyn: two formulas of NumPy


def test_the_limit_of_breaking_where_none_is_stated() -> None:
    """A strain e breaks at EA e sqrt(1 + 2 e); a stated strength stands before it."""
    given = [*QUICK, "time.end=0.01", "effects.breaking.strain=0.02", "net.strings.strength=77.0"]
    net = prepare_case(exunet.load(PLANAR, given)).net
    assert net.strength is not None
    assert set(net.strength[net.is_string]) == {77.0}
    threads = ~net.is_string
    limit = net.axial_stiffness[threads] * 0.02 * math.sqrt(1.04)
    assert net.strength[threads] == pytest.approx(limit, rel=1e-14)
    forced = prepare_case(exunet.load(PLANAR, ["effects.breaking.force=300.0"])).net
    assert forced.strength is not None
    assert set(forced.strength) == {300.0}


def test_warm_threads_break_at_their_strain() -> None:
    """The limit is the law's force at that strain beside the free one."""
    warm = "effects.thermal_strain={temperature_change=100.0, expansion_coefficient=1e-4}"
    start = prepare_case(exunet.load(PLANAR, [warm, "effects.breaking.strain=0.02"]))
    law, net = start.system.forces.cable.law, start.net
    free = 0.5 * (1.01**2 - 1.0)
    length = net.reference_length * math.sqrt(1.0 + 2.0 * (0.02 + free))
    strain = 0.5 * ((length / law.natural_length) ** 2 - 1.0)
    force = law.stiffness * strain * length / law.natural_length
    assert net.strength == pytest.approx(force, rel=1e-12)


def test_a_margin_of_an_ensemble_has_no_unit(tmp_path: Path) -> None:
    """Neither in its row, nor in its file beyond "1"; and its histogram is drawn."""
    given = [*QUICK, "time.end=1.5", "net.strings.strength=500.0", "solver.tolerance=1e-7"]
    found = exunet.ensemble(exunet.load(PLANAR, given), runs=8, perturb=1e-3, seed=0)
    words = dict(table_of(found))["margin of strings"]
    assert re.fullmatch(r"median \S+, 5 % to 95 %: \S+ to \S+, all: \S+ to \S+", words), words
    exunet.save_ensemble(found, tmp_path / "ensemble.h5")
    loaded = exunet.load_ensemble(tmp_path / "ensemble.h5")
    assert loaded.headlines["margin_of_strings"].tolist() == found.headlines["margin_of_strings"].tolist()
    titles = [axes.get_title(loc="left") for axes in exunet.figure(found, "histograms").axes]
    assert "margin of strings [1]" in titles


def test_bad_strength_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    text = SNAP.read_text(encoding="utf-8").replace("divisions = 4", "divisions = 4\nstrength = -1.0")
    path.write_text(text, encoding="utf-8")
    line = text.splitlines().index("strength = -1.0") + 1
    with pytest.raises(exunet.CaseError, match=rf"case.toml:{line}: tethers.tow.strength"):
        exunet.load(path)

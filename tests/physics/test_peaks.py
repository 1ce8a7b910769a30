"""Extremes of all steps, which stored states miss: largest tensions, margins, energies."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from result_samples import square_net, unfolding
from scenes import BACKENDS, CASES, every_backend, pair_of_masses, thrown, values_of

import exunet
from exunet.base.errors import RunStopped
from exunet.integrators.protocol import Extremes
from exunet.model.states import States
from exunet.results.measures import peak_tensions
from exunet.results.result import Result
from exunet.results.run_record import Peak, RunRecord
from exunet.simulation.block import Observed
from exunet.simulation.observers import RunningExtremes
from exunet.simulation.preparation import prepare, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.ensemble import perturbed_runs


def observed(tension: list[float], elastic: list[float], marks: list[int], later: Extremes) -> Observed:
    """States of a net every 0.5 s; tensions [N] of its first element, elastic energies [J]."""
    start = prepare(thrown({"method": "DOPRI5"}))
    x, v = (np.tile(part, (len(tension), 1)) for part in start.system.layout.pack(start.state.moving))
    states = States(start.system, 0.5 * np.arange(len(tension)), x, v, start.state.discrete)
    pull = np.zeros((len(tension), start.net.n_elements))
    pull[:, 0] = tension
    energies = np.array(elastic, dtype=float)
    states.__dict__.update(tension=pull, elastic=energies, kinetic=10.0 - energies)
    between: list[Extremes | None] = [None] * (len(marks) - 1)
    return Observed(states, marks, [{}] * len(marks), [*between, later], np.zeros(len(tension)))


def test_extremes_of_all_steps_go_back_with_the_run() -> None:
    """Stored at 0, 1, 2 s; between two states of the second interval element 1 pulls 9 N, with 3 J."""
    each = np.zeros(prepare(thrown({"method": "DOPRI5"})).net.n_elements)
    each[1] = 9.0
    later = Extremes(np.array([3.0, 6.0]), np.array([[9.0, 1.7, 1.0]]), each)
    steps = observed([1.0, 5.0, 2.0, 1.0, 0.0], [1.0, 5.0, 2.0, 1.0, 0.0], [0, 2, 4], later)
    extremes = RunningExtremes(steps.states.system, stores=True)
    extremes.observe(steps.between(0, 2))
    assert extremes.intervals.tolist() == [[1.0, 9.0], [5.0, 5.0]]
    safe = extremes.save()
    for _ in range(2):
        assert extremes.of_groups() == {"net": Peak(5.0, 0.5, 0)}
        extremes.observe(steps.between(2, 4))
        assert extremes.of_groups() == {"net": Peak(9.0, 1.7, 1)}
        assert extremes.elements[:3].tolist() == [5.0, 9.0, 0.0]
        assert extremes.intervals.tolist() == [[3.0, 6.0]]
        extremes.load(safe)


@pytest.mark.ci_for("compiled")
@pytest.mark.slow
@every_backend
def test_each_element_has_its_peak_of_all_steps(backend: str) -> None:
    """Stored at 0, 0.3 and 0.6 s, the peaks are those of the same steps with each of them stored."""
    step, end = 2e-4, 0.6
    settings = [f"time.end={end}", "solver={method='RK44', step=2e-4}", BACKENDS[backend]]
    coarse, fine = (
        exunet.run(exunet.load(CASES / "planar_deployment.toml", [*settings, f"time.output_step={each}"]))
        for each in (0.3, step)
    )
    assert len(fine.time) == round(end / step) + 1
    found = peak_tensions(coarse)
    np.testing.assert_allclose(found, fine.tension.max(axis=0), rtol=1e-9, atol=1e-9)
    assert coarse.tension.max() < 0.9 * found.max()
    assert found.max() == coarse.run.largest_tension.tension


def test_the_snap_of_two_masses_is_seen_between_stored_times():
    """294.65036 N by the closed form, where the snap lasts 6.7 ms; stored times before and after it only."""
    coarse = ["time.output_times=", "time.output_step=1.0", BACKENDS["exudyn"]]
    case = exunet.load(CASES / "verification" / "snap.toml", coarse)
    result = exunet.run(case)
    peak = result.run.largest_tension
    assert result.tension.max() < 0.5 * 294.65036
    assert peak.tension == pytest.approx(294.65036, rel=1e-3)


def pulled_apart(backend: str, speed: float, step: float, end: float, packing: float) -> Result:
    """Two masses that fly apart at +-speed [m/s], by RK44, only the last state stored."""
    scene = pair_of_masses(
        initial={"packing": packing, "node_velocities": [[-speed, 0, 0], [speed, 0, 0]]},
        solver={"method": "RK44", "step": step, "force": True, "retry": 0},
        time={"end": end, "output_step": end},
        engine={"backend": backend},
    )
    return simulate(prepare(scene))


def test_a_tension_that_lasts_one_step_is_seen_where_it_is() -> None:
    """Slack, taut and slack again in two steps of 0.3 s: 0.89 N after the first, in the engine's own net.

    Catches a step of the compiled loop that hands on the elastic energy of its start for that of its end:
    the loop then looked at the second step's end, and saw 0 N.
    """
    wanted, found = (
        pulled_apart(backend, speed=0.3, step=0.3, end=0.6, packing=0.95).run.largest_tension
        for backend in ("exudyn", "compiled")
    )
    assert wanted.tension > 0.8
    assert found.tension == pytest.approx(wanted.tension, rel=1e-12)
    assert found.time == pytest.approx(0.3, abs=1e-12)
    assert found.element == wanted.element == 0


@every_backend
def test_a_stretch_beyond_the_laws_validity_that_lasts_one_step_stops_the_run(backend: str) -> None:
    """Energy: strain sqrt(12.0 J / 5 N m) = 1.55, so a length of 2.025 m of 1 m, for one or two steps."""
    with pytest.raises(RunStopped, match="an element is longer than") as stop:
        pulled_apart(backend, speed=4.9, step=0.025, end=0.5, packing=1.0)
    assert stop.value.result is not None
    assert stop.value.result.time[-1] == 0.0  # the last stored state that is good


SNAP = CASES / "bodies" / "snap.toml"


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow_for("exudyn")
@every_backend
def test_the_peak_of_a_tether_that_breaks_is_seen_between_stored_times(backend: str) -> None:
    """At 250 N, before its first stored time; nothing of it is left at the stored ones."""
    settings = ("time.end=0.8", "time.output_step=0.4", "solver.step=1e-3", "effects.breaking={force=250.0}")
    result = exunet.run(exunet.load(SNAP, [*settings, BACKENDS[backend]]))
    assert result.tension.max() == 0.0
    peak = result.run.largest_tensions["tether tow"]
    assert peak == result.run.largest_tension
    assert 250.0 < peak.tension < 255.0
    first = result.run.breaks[0]
    assert peak.time == first.time_s
    found = exunet.metrics(result)
    assert found["tether_tow_largest_tension_N"].place == f"element {peak.element}"
    assert found["tether_tow_time_of_largest_tension_s"].value == peak.time
    assert exunet.margins(result)["tether tow"].of == "all steps"
    assert "net_largest_tension_N" not in found  # the net has no elements


@pytest.mark.ci_for("False")
@pytest.mark.slow
@pytest.mark.parametrize("viscous", [False, True])
def test_the_outlet_of_a_locked_reel_is_seen_at_every_step(viscous: bool) -> None:
    """The tether is its own outlet: the same snap as without a drum and its states."""
    settings = ["time.end=1.3", "time.output_step=1.3", "tethers.tow.divisions=1", "engine.backend=compiled"]
    settings += ["effects.material_damping={relaxation_time=1e-3}"] if viscous else []
    wanted, found = (
        exunet.run(exunet.load(SNAP, [*settings, *reel])).run.largest_tensions["tether tow"]
        for reel in ((), ("tethers.tow.reel={paid_out=8.0}",))
    )
    assert wanted.tension > 200.0
    assert found.tension == pytest.approx(wanted.tension, rel=1e-9)
    assert (found.time, found.element) == (wanted.time, wanted.element)


# Margins to the strength

PLANAR = CASES / "planar_undamped.toml"
QUICK = ("engine.backend=compiled",)


@pytest.fixture(scope="module")
def snapped() -> exunet.Result:
    """A tether that snaps, said to bear 5000 N."""
    return exunet.run(exunet.load(SNAP, [*QUICK, "tethers.tow.strength=5000.0"]))


def test_a_tether(snapped: exunet.Result) -> None:
    """The largest tension of all steps is known of the group that has it."""
    worst = exunet.margins(snapped)["tether tow"]
    peak = snapped.run.largest_tension
    assert (worst.element, worst.time, worst.of) == (peak.element, peak.time, "all steps")
    assert worst.margin == pytest.approx(5000.0 / peak.tension - 1.0, rel=1e-12)
    assert worst.tension == pytest.approx(peak.tension, rel=1e-12)
    assert list(exunet.margins(snapped)) == ["tether tow"]  # the cable of the net states no strength


def test_of_the_elements_at_a_body(snapped: exunet.Result) -> None:
    """The last element of the tether ends at the target, over the stored times."""
    last = snapped.net.n_elements - 1
    found = exunet.loads(snapped, "target").margins["tether tow"]
    assert (found.element, found.of) == (last, "stored times")
    assert found.margin == pytest.approx(5000.0 / snapped.tension[:, last].max() - 1.0, rel=1e-12)


def test_margins_of_perturbed_runs(snapped: exunet.Result) -> None:
    found = exunet.metrics(snapped)["tether_tow_margin"]
    worst = exunet.margins(snapped)["tether tow"]
    assert (found.value, found.time, found.place) == (worst.margin, worst.time, f"element {worst.element}")
    many = perturbed_runs(prepare_case(exunet.load(SNAP, [*QUICK, "tethers.tow.strength=5000.0"])), 2)
    assert many.metrics["tether_tow_margin"] == pytest.approx(worst.margin, rel=1e-3)


def test_the_worst_of_each_group() -> None:
    """Elements of their own strengths: the worst is not where the largest tension is."""
    result = unfolding(square_net(2))
    net = result.net
    tension = np.zeros_like(np.asarray(result.tension))
    strength = np.full(net.n_elements, 100.0)
    tension[1, 0], tension[2, 1], strength[1], strength[2] = 50.0, 40.0, 60.0, 0.0
    tension[2, 2] = 1e9  # of which no strength is known
    given = replace(result, net=replace(net, strength=strength), tension=tension, run=RunRecord())
    found = exunet.margins(given)["threads"]
    assert (found.element, found.time, found.strength) == (1, result.time[2], 60.0)
    assert found.margin == pytest.approx(0.5)
    assert values_of(given)["margin_of_threads"] == found.margin


def test_none_without_strength_or_tension() -> None:
    result = unfolding(square_net(2))
    assert result.net.strength is None
    assert exunet.margins(result) == {}
    slack = replace(
        result,
        net=replace(result.net, strength=np.ones(result.net.n_elements)),
        tension=0.0 * np.asarray(result.tension),
    )
    assert exunet.margins(slack) == {}
    assert "margin_of_threads" not in values_of(slack)


def test_not_of_all_of_the_group_all_steps_are_known() -> None:
    """Then another element may have had less margin between stored times, and the margin has a remark."""
    net = square_net()
    net = replace(net, strength=np.linspace(10.0, 20.0, net.n_elements))
    last = net.n_elements - 1
    whole = replace(unfolding(net), net=net)
    whole = replace(whole, tension=np.ones_like(whole.tension))
    peak = {f"net from element {last}": Peak(50.0, 0.25, last)}
    found = exunet.margins(replace(whole, run=RunRecord(largest_tensions=peak)))["threads"]
    assert (found.element, found.time, found.of) == (last, 0.25, "stored times")
    assert found.margin == pytest.approx(20.0 / 50.0 - 1.0)
    slack = {name: Peak(0.0, 0.0, -1) for name in net.spans}
    found = exunet.margins(replace(whole, run=RunRecord(largest_tensions=slack | peak)))["threads"]
    assert (found.element, found.of) == (last, "all steps")


@every_backend
def test_margins_are_of_all_steps_where_strings_bear_more(backend: str) -> None:
    """Stored at four times only: peaks are between them, of threads and of strings. By each element's largest
    tension of all steps, which is looked for apart; the spread's runs look for the same.
    """
    given = [BACKENDS[backend], "time.end=1.2", "time.output_step=0.3", "net.strings.strength=900.0"]
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
    peak = result.run.largest_tension
    largest = max(item.tension for item in found.values())
    assert peak.tension == pytest.approx(largest, rel=1e-15)  # in Exudyn: two formulas of NumPy


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


# Energies between stored times

Floats = NDArray[np.float64]
SOLVERS = {
    "DOPRI5": "solver.accuracy = 1e-2",
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
@every_backend
def test_the_snap_of_two_masses_turns_all_motion_into_tension(backend: str, solver: str) -> None:
    """The case of the known snap: they stop in its middle, of 6.7 ms, which no stored state shows."""
    overrides = ["time.output_times=", "time.output_step=1.0", BACKENDS[backend], SOLVERS[solver]]
    run = exunet.run(exunet.load(CASES / "verification" / "snap.toml", overrides))
    assert run.elastic.max() < 1e-6 * run.kinetic[0]
    largest, least = extremes(run)
    # Of a sine of 6.7 ms, steps of up to 0.2 ms miss at most 1 - cos^2(pi 0.1 / 6.7) = 2e-3 of the top.
    assert largest.tolist() == [run.elastic[0], pytest.approx(run.kinetic[0], rel=2e-3)]
    assert least[0] == run.kinetic[0]
    assert least[1] < 2e-3 * run.kinetic[0]


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@every_backend
def test_it_is_the_energy_of_the_steps_with_material_damping_and_thermal_strain(backend: str) -> None:
    """Interval by interval, against the same equal steps all stored."""
    effects = {
        "material_damping": {"relaxation_time": 1e-4},
        "thermal_strain": {"temperature_change": -100.0, "expansion_coefficient": 5e-5},
    }
    tables = {"effects": effects, "engine": {"backend": backend}}
    solver, time = {"method": "RK44", "step": 2e-5}, {"end": 0.11}
    few, all_steps = (
        simulate(prepare(thrown(solver, **tables, time={**time, "output_step": step})))
        for step in (5e-3, 2e-5)
    )
    assert few.elastic.max() == pytest.approx(0.0, abs=1e-12)  # the snap at 0.1 s falls between
    assert all_steps.elastic.max() > 0.1
    inside = np.arange(22)[:, None] * 250 + np.arange(251)
    largest, least = extremes(few)
    np.testing.assert_allclose(largest[1:], all_steps.elastic[inside].max(axis=1), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(least[1:], all_steps.kinetic[inside].min(axis=1), rtol=1e-6)

"""What is not a number fails the ladder, wherever among numbers it stands."""

import dataclasses

import numpy as np
import pytest

from exunet.studies.both_codes import BothCodes, Trajectory, read_both
from exunet.studies.perturbation import MOVE
from exunet.verification import horizon, topology
from exunet.verification.balances import _compared
from exunet.verification.check import Check, difference, shipped, worst_of
from exunet.verification.horizon import (
    AMPLITUDE,
    AMPLITUDES,
    COMPILED,
    REFERENCE,
    ROUND_OFF,
    Growth,
    Statistics,
    growth,
    sensitivity,
)
from exunet.verification.one_step import one_step, same_scheme
from exunet.verification.states import forces
from exunet.verification.tolerances import FORCES
from reference_impl import forces as formulas

CASE = shipped()["planar_deployment"]
NAN = float("nan")


def fails(findings):
    """The only check that does not hold, of those among the findings."""
    (check,) = (found for found in findings if isinstance(found, Check) and not found.holds)
    return check


@pytest.mark.parametrize("measured", [(NAN, 1.0), (1.0, NAN), (0.0, NAN, 2.0)])
def test_the_worst_of_some_measurements_is_the_one_that_is_nan(measured):
    checks = [Check(f"{k}", value, FORCES) for k, value in enumerate(measured)]
    assert np.isnan(worst_of("all", checks).measured)


@pytest.mark.parametrize("wrong", [NAN, np.inf])
@pytest.mark.parametrize("both", [False, True])
def test_a_difference_with_an_entry_that_is_not_finite_fails(wrong, both):
    a = np.arange(12.0).reshape(4, 3)
    b = a.copy()
    a[2, 1] = wrong
    b[2, 1] = wrong if both else b[2, 1]
    with np.errstate(invalid="ignore"):
        found = difference("name", a, b, FORCES, ("node", "xyz"), "m")
    assert not found.holds
    assert found.worst.startswith(f"node 2, y: {wrong} and ")


@pytest.mark.parametrize("state", [0, 4, 9])
def test_one_state_of_many_without_accelerations_fails_rung_2(state, monkeypatch):
    right, seen = formulas.response, []

    def wrong(*state_of_motion):
        seen.append(1)
        found, factor = right(*state_of_motion), NAN if len(seen) == state + 1 else 1.0
        return dataclasses.replace(found, acceleration=factor * found.acceleration)

    monkeypatch.setattr(formulas, "response", wrong)
    check = fails(forces(read_both(CASE), 10))
    assert np.isnan(check.measured)
    assert f"packed: state {state}, " in check.worst


def test_one_mass_that_is_no_number_fails_rung_1():
    case = read_both(CASE)
    mass = case.start.net.mass.copy()
    mass[3] = NAN
    net = dataclasses.replace(case.start.net, mass=mass)
    blocks = dataclasses.replace(case.start.system.blocks, net=net)
    system = dataclasses.replace(case.start.system, blocks=blocks)
    start = dataclasses.replace(case.start, system=system)
    check = fails(topology.topology(dataclasses.replace(case, start=start)))
    assert check.worst.startswith("mass: node 3: nan and")


def test_one_such_net_among_random_ones_fails_rung_1(monkeypatch):
    right, seen = topology.both_of_text, []

    def wrong(name, text):
        seen.append(1)
        case = right(name, text)
        if len(seen) == 3:
            net = dataclasses.replace(case.theirs.net, mass=np.full_like(case.theirs.net.mass, NAN))
            case = dataclasses.replace(case, theirs=dataclasses.replace(case.theirs, net=net))
        return case

    monkeypatch.setattr(topology, "both_of_text", wrong)
    counted, widest = topology.random_topologies(5)
    assert counted.measured == 1
    assert not widest.holds
    assert "random-2-" in widest.worst


def test_a_velocity_that_is_no_number_after_one_step_fails_rung_4(monkeypatch):
    right = BothCodes.run_reference_in_steps

    def wrong(self, times, step):
        motion = right(self, times, step)
        motion.velocity[1, 7, 1] = NAN
        return motion

    monkeypatch.setattr(BothCodes, "run_reference_in_steps", wrong)
    for check in one_step(read_both(CASE)):
        assert not check.holds
        assert "velocity: node 7, y: " in check.worst


@pytest.mark.ci
@pytest.mark.slow
def test_a_growth_that_is_no_number_does_not_end_the_comparison_of_rung_4():
    case = read_both(CASE)
    grown = growth(case, 0.02, (ROUND_OFF, MOVE))
    grown.difference[1, 300] = NAN
    check = next(same_scheme(case, grown))
    assert not check.holds
    assert check.worst.startswith(f"t = {grown.time[300]:.4g} s")


def grown(spoilt=False, factor=1.0):
    """All amplitudes grow at 20/s for 2 s; `spoilt` (amplitude, time) says where that is NaN."""
    time, moved = np.linspace(0.0, 2.0, 401), np.array(AMPLITUDES)
    apart = factor * np.outer(moved, np.exp(20.0 * time))
    apart = np.where(spoilt and spoilt(moved[:, None], time), NAN, apart)
    return Growth(time, moved, apart, np.zeros(apart.shape, int), np.full(len(moved), NAN))


@pytest.mark.parametrize(
    ("spoilt", "count"),
    [
        (lambda moved, time: time >= 0.0 * moved, 4 * 401),
        (lambda moved, time: time > 0.5 + 0.0 * moved, 4 * 300),
        (lambda moved, time: (moved == ROUND_OFF) & (time >= 0.0), 401),
        (lambda moved, time: (moved == AMPLITUDE) & (time == 2.0), 1),
    ],
)
def test_a_growth_that_is_no_number_fails_rung_7(spoilt, count):
    (check,) = sensitivity(read_both(CASE), grown(spoilt))
    assert not check.holds
    assert check.measured == count


def test_differences_that_are_never_small_are_not_compared():
    """1e-10 m times 1e3 is 1e-7 m from the start, above the 1e-8 m below which growth is in proportion."""
    row = next(iter(sensitivity(read_both(CASE), grown(factor=1e3))))
    assert row.left_out
    assert "above 1e-08 m from the start" in row.worst


def runs(count, spoilt=None):
    """Made-up runs of one code, scattered by 10 %; `spoilt` is one run that has a value that is NaN."""
    values = 1.0 + 0.1 * np.random.default_rng(count).normal(size=(count, 50))
    if spoilt is not None:
        values[spoilt, 40] = NAN
    return Statistics(f"code of {count}", np.linspace(0.0, 2.0, 50), values, values, values)


@pytest.mark.parametrize(("ours", "theirs", "code"), [(3, None, 128), (None, 3, 16), (0, 15, 128)])
def test_one_run_without_a_number_fails_the_statistics(ours, theirs, code, monkeypatch):
    made = {COMPILED: runs(128, ours), REFERENCE: runs(16, theirs)}
    monkeypatch.setattr(horizon, "our_code", lambda: COMPILED)
    monkeypatch.setattr(horizon, "statistics", lambda case, which: made[which])
    rows = [row for row in horizon.after_it(read_both(CASE), grown(), True) if isinstance(row, Check)]
    assert [row.holds for row in rows] == [False] * 3
    assert all(f"(code of {code})" in row.name for row in rows)
    alone = [row for row in horizon.after_it(read_both(CASE), grown(), False) if isinstance(row, Check)]
    assert [row.holds for row in alone] == ([] if ours is None else [False] * 3)


def test_statistics_without_an_area_are_equal():
    """A net without a mouth has the area 0 in all runs."""
    ours, theirs = (dataclasses.replace(some, area=0.0 * some.area) for some in (runs(128), runs(16)))
    assert horizon._same_mean("area", ours, theirs).measured == 0.0
    assert horizon._same_mean("speed", ours, theirs).holds


INSTANTS = np.linspace(0.0, 0.3, 49)


def compared(own, apart=0.0, end=0.3):
    """Rows of rung 5 where own (codes, what, t) are the codes' errors and `apart` (t,) parts them [sizes]."""
    case = read_both(CASE)
    place = np.broadcast_to(case.start.position, (len(INSTANTS), *case.start.position.shape))
    shift = case.size * np.broadcast_to(apart, INSTANTS.shape)[:, None, None] * np.array([1.0, 0.0, 0.0])
    flight = [
        Trajectory(INSTANTS, where, np.zeros_like(place), None, 1, None, None)
        for where in (place, place + shift)
    ]
    return list(_compared(case, own, *flight, end))


@pytest.mark.parametrize("code", [0, 1])
@pytest.mark.parametrize("first", [0, 20, 48])
def test_an_own_error_that_is_no_number_fails_rung_5(code, first):
    own = np.zeros((2, 2, 49))
    own[code, :, first:] = NAN
    wrong = [row for row in compared(own) if not row.holds and np.isnan(row.measured)]
    assert [row.name for row in wrong] == [
        f"{of}: a code's own error" for of in ("positions", "bullet speeds")
    ]
    assert all(row.worst == f"t = {INSTANTS[first]:.4g} s" for row in wrong)


def test_an_own_error_at_the_start_fails_rung_5():
    assert [row.holds for row in compared(np.ones((2, 2, 49)))] == [False, False]


def own_errors():
    """Both codes converge until 0.125 s, instant 20; then each changes by 5e-5 sizes with its tolerance."""
    own = np.zeros((2, 2, 49))
    own[:, 0, 20:] = 5e-5
    return own


def test_codes_that_do_not_converge_where_nothing_grows_are_left_out():
    """0.6 of the time, but the codes differ by 8e-5 sizes, less than 5e-5 and 5e-5 together."""
    apart = np.where(INSTANTS > 0.2, 8e-5, 0.0)
    row = compared(own_errors(), apart, np.inf)[0]
    assert row.left_out
    assert "no more than their own errors together" in row.worst
    assert "8e-05 and 0.0001" in row.worst


@pytest.mark.parametrize(("apart", "end"), [(1.2e-4, np.inf), (NAN, np.inf), (8e-5, 0.3)])
def test_codes_further_apart_than_their_errors_or_with_a_horizon_still_fail(apart, end):
    rows = compared(own_errors(), np.where(INSTANTS > 0.2, apart, 0.0), end)
    check = fails(rows)
    assert "positions: part left out" in check.name
    assert check.measured == pytest.approx(1.0 - 19 / 48)
    assert ("differ by more than" in check.worst) == (end == np.inf)

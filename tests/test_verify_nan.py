"""What is not a number fails the ladder, wherever among numbers it stands."""

import dataclasses

import numpy as np
import pytest

import reference_impl as reference
from exunet.verify import separation, topology
from exunet.verify.check import Check, worst_first
from exunet.verify.forces import forces
from exunet.verify.growth import LONE, ROUND_OFF, growth
from exunet.verify.ladder import shipped
from exunet.verify.pair import Pair, read_pair
from exunet.verify.stepping import one_step, same_scheme

CASE = next(path for path in shipped() if path.stem == "planar_deployment")
NAN = float("nan")


def fails(findings):
    """The only check that does not hold, of those among the findings."""
    (check,) = (found for found in findings if isinstance(found, Check) and not found.holds)
    return check


@pytest.mark.parametrize("measured", [(NAN, 1.0), (1.0, NAN), (0.0, NAN, 2.0)])
def test_the_worst_of_some_numbers_is_the_one_that_is_none(measured):
    assert np.isnan(max(measured, key=worst_first))


@pytest.mark.parametrize("state", [0, 4, 9])
def test_one_state_of_many_without_accelerations_fails_rung_2(state, monkeypatch):
    right, seen = reference.acceleration, []

    def wrong(*state_of_motion):
        seen.append(1)
        return right(*state_of_motion) * (NAN if len(seen) == state + 1 else 1.0)

    monkeypatch.setattr(reference, "acceleration", wrong)
    check = fails(forces(read_pair(CASE), 10))
    assert np.isnan(check.measured)
    assert f"packed: state {state}, " in check.worst


def test_one_mass_that_is_no_number_fails_rung_1():
    pair = read_pair(CASE)
    mass = pair.start.net.mass.copy()
    mass[3] = NAN
    start = dataclasses.replace(pair.start, net=dataclasses.replace(pair.start.net, mass=mass))
    check = fails(topology.topology(dataclasses.replace(pair, start=start)))
    assert check.worst.startswith("mass: node 3: nan and")


def test_one_such_net_among_random_ones_fails_rung_1(monkeypatch):
    right, seen = topology.pair_of_text, []

    def wrong(name, text):
        seen.append(1)
        pair = right(name, text)
        if len(seen) == 3:
            net = dataclasses.replace(pair.net, mass=np.full_like(pair.net.mass, NAN))
            pair = dataclasses.replace(pair, net=net)
        return pair

    monkeypatch.setattr(topology, "pair_of_text", wrong)
    counted, widest = topology.random_topologies(5)
    assert counted.measured == 1
    assert not widest.holds
    assert "random-2-" in widest.worst


def test_a_velocity_that_is_no_number_after_one_step_fails_rung_4(monkeypatch):
    right = Pair.march

    def wrong(self, times, symmetric=False, **how):
        motion = right(self, times, symmetric, **how)
        motion.velocity[1, 7, 1] = NAN
        return motion

    monkeypatch.setattr(Pair, "march", wrong)
    for check in one_step(read_pair(CASE)):
        assert not check.holds
        assert "velocity of node" in check.worst


def test_a_growth_that_is_no_number_does_not_end_the_comparison_of_rung_4():
    pair = read_pair(CASE)
    grown = growth(pair, 0.02, (ROUND_OFF, LONE))
    grown.difference[1, 300] = NAN
    check = next(same_scheme(pair, grown))
    assert not check.holds
    assert check.worst.startswith(f"t = {grown.time[300]:.4g} s")


def test_one_mirrored_run_that_stopped_fails_rung_7(monkeypatch):
    longer = np.linspace(0.0, separation.BEYOND, 6)
    still = np.zeros((len(longer), 4))
    curves = [
        separation.Curve(tolerance, speeds)
        for tolerance, speeds in zip(separation.MIRRORED, (still, still + NAN), strict=True)
    ]
    study = separation.Study(longer, longer, {}, {}, {"damped": curves}, {})
    monkeypatch.setattr(separation, "study", lambda pairs: study)
    pair = read_pair(CASE)
    monkeypatch.setattr(separation, "families", lambda *of: None)
    found = []
    for finding in separation.separation(pair, pair, pair):
        found.append(finding)
        if isinstance(finding, Check):
            break
    assert np.isnan(fails(found).measured)

"""Pulls of threads on bodies, impulses of units and shares of momenta, of small results by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from result_samples import net, result, square_net

import exunet
from exunet.forces.corner_units import NAME, SPENT, WORK
from exunet.net.arrays import Tether
from exunet.results.corner_units import mean_thrust, spent, told, units_over_time
from exunet.results.measures import deployment_of_course, shares_of
from exunet.results.result import BodyStates, Result, TermStates


def towed(nodes: tuple[int, ...]) -> Result:
    """A tether from node 1 of a thread to node 4, where a ship is, in three elements; two times.

    At the second time nodes 2 and 3, or those at its other end, lie at the drum.
    """
    places = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 2.0, 0.0), (1.0, 4.0, 1.0), (1.0, 6.0, 5.0)]
    of = replace(net(places, [(0, 1), (1, 2), (2, 3), (3, 4)]), tethers=(Tether("tow", 2, (1, 2, 3, 4)),))
    position = np.array([places, places])
    position[1, list(nodes)] = places[4]
    ship = BodyStates(2.0, None, np.array([[1.0, 6.0, 4.0]] * 2), np.zeros((2, 3)), nodes=np.array([4]))
    tension = np.array([[1.0, 2.0, 3.0, 5.0], [1.0, 20.0, 30.0, 0.0]])
    return result(of, [0.0, 1.0], position, tension=tension, bodies={"ship": ship})


def test_a_tether_pulls_at_its_end_whatever_lies_on_the_drum() -> None:
    """5 N along the last element, and then, of nodes on the drum, those of the elements that leave it."""
    found = exunet.loads(towed((3,)), "ship")
    first = 5.0 * np.array([0.0, -2.0, -4.0]) / np.sqrt(20.0)
    second = 30.0 * np.array([0.0, -4.0, -5.0]) / np.sqrt(41.0)
    np.testing.assert_allclose(found.force[:, 0], [first, second], rtol=1e-14)
    np.testing.assert_allclose(found.torque[:, 0], np.cross([0.0, 0.0, 1.0], [first, second]), rtol=1e-14)
    np.testing.assert_allclose(found.size[:, 0], [5.0, 30.0], rtol=1e-14)
    both = exunet.loads(towed((2, 3)), "ship")
    third = 20.0 * np.array([0.0, -6.0, -5.0]) / np.sqrt(61.0)
    np.testing.assert_allclose(both.force[:, 0], [first, third], rtol=1e-14)
    np.testing.assert_allclose(both.total[0], both.force[:, 0], rtol=1e-15)


def test_a_drum_at_the_start_of_a_tether() -> None:
    """The same tether listed the other way round."""
    for nodes in ((3,), (2, 3)):
        one = towed(nodes)
        order = [0, 3, 2, 1]
        turned = replace(
            one.net,
            element_nodes=one.net.element_nodes[order][:, ::-1].copy(),
            tethers=(Tether("tow", 2, (4, 3, 2, 1)),),
        )
        other = replace(one, net=turned, tension=np.asarray(one.tension)[:, order])
        np.testing.assert_allclose(
            exunet.loads(other, "ship").force, exunet.loads(one, "ship").force, rtol=1e-14
        )


def units(times: int) -> Result:
    """Two units that have spent 1 and 0.2 N s after 0.5 s, and twice as much after 0.75 s."""
    time = np.array([0.0, 0.5, 0.75])[:times]
    values = np.array([[0.0, 0.0], [1.0, 0.2], [2.0, 0.4]])[:times]
    states = {
        SPENT: TermStates("N s", values),
        WORK: TermStates("J", np.array([[0.0], [0.7], [0.9]])[:times]),
    }
    about = {"kind": "table", "period": 0.1, "bullets": [1, 3], "specific_impulse": 120.0}
    of = square_net()
    position = np.tile(of.reference_position, (times, 1, 1))
    return result(of, time, position, states=states, provenance={NAME: about})


def test_what_units_have_spent() -> None:
    """Propellant is the impulse over 9.80665 m/s2 times 120 s; a thrust is the impulse over the time."""
    found = told(units(3))
    assert found is not None
    assert [entry["impulse_N_s"] for entry in found["units"]] == [2.0, 0.4]
    propellant = [item["propellant_kg"] for item in found["units"]]
    assert propellant == pytest.approx([2.0 / 1176.798, 0.4 / 1176.798], rel=1e-12)
    assert found["propellant_kg"] == pytest.approx(2.4 / 1176.798, rel=1e-12)
    assert (found["impulse_N_s"], found["work_J"]) == (pytest.approx(2.4, rel=1e-15), 0.9)
    np.testing.assert_allclose(mean_thrust(units(3)), [[2.0, 0.4], [4.0, 0.8]], rtol=1e-15)
    np.testing.assert_allclose(mean_thrust(units(2)), [[2.0, 0.4]], rtol=1e-15)
    assert mean_thrust(units(1)) is None
    np.testing.assert_array_equal(units_over_time(units(2)), [[0.0, 0.0, 0.0], [1.0, 0.2, 0.7]])
    bare = replace(units(2), states={})
    assert (spent(bare), mean_thrust(bare), told(bare)) == (None, None, None)
    assert units_over_time(bare).shape == (2, 0)


def test_shares_of_momenta() -> None:
    """Two points of 2 and 3 kg: of |m v| and |m x x v|, so nothing cancels."""
    position = np.array([[(1.0, 0.0, 0.0), (0.0, 2.0, 0.0)]])
    velocity = np.array([[(0.0, 3.0, 4.0), (0.0, -1.0, 2.0)]])
    linear, angular = shares_of(np.array([2.0, 3.0]), position, velocity)
    np.testing.assert_allclose(linear, [2.0 * 5.0 + 3.0 * np.sqrt(5.0)], rtol=1e-15)
    np.testing.assert_allclose(angular, [2.0 * 5.0 + 3.0 * 4.0], rtol=1e-15)


def carrying() -> Result:
    """A ship that holds nodes 1 and 2 as a packed net until 1.5 s; two elements have one end in it.

    The net's origin is 1 m along x of the ship that a quarter turn about z takes to y.
    """
    one = towed(())
    half = np.sqrt(0.5)
    attitude = np.array([[half, 0.0, 0.0, half]] * 3)
    place = np.array([[0.5, 0.5, 0.0]] * 3)
    ship = BodyStates(2.0, None, place, np.zeros((3, 3)), attitude, np.zeros((3, 3)))
    position = np.array([*np.asarray(one.position), one.net.reference_position])
    tension = np.array([[2.0, 0.0, 3.0, 1.0], [4.0, 0.0, 6.0, 1.0], [8.0, 0.0, 9.0, 1.0]])
    story = {"body": "ship", "nodes": [1, 2], "origin_m": [1.0, 0.0, 0.0], "until_s": 1.5}
    return result(
        one.net,
        [0.0, 1.0, 2.0],
        position,
        tension=tension,
        bodies={"ship": ship},
        provenance={"carried": story},
    )


def test_pulls_on_a_packed_net_that_a_body_holds() -> None:
    """Until it lets go: of elements with one end in it, about the net's origin, which turns along."""
    whole = carrying()
    found = exunet.loads(whole, "ship").carried
    assert found is not None
    np.testing.assert_allclose(found.origin, [[0.5, 1.5, 0.0]] * 3, atol=1e-15)
    first, second = np.array([-2.0, 0.0, 0.0]), 3.0 * np.array([0.0, 2.0, 1.0]) / np.sqrt(5.0)
    torque = np.cross([0.5, -1.5, 0.0], first) + np.cross([0.5, 0.5, 0.0], second)
    np.testing.assert_allclose(found.force, np.outer([1.0, 2.0, 0.0], first + second), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found.torque, np.outer([1.0, 2.0, 0.0], torque), rtol=1e-14, atol=1e-15)
    assert found.until == 1.5
    assert exunet.loads(replace(whole, provenance={}), "ship").carried is None


def test_how_a_net_opened() -> None:
    """4 m2 at most can be had: 3.9 at 3 s, 3 m from where it began; open above 0.8 of 4."""
    time, area = np.array([0.0, 1.0, 3.0, 5.0]), np.array([0.2, 2.6, 3.9, 3.3])
    centre = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, -2.0], [9.0, 9.0, 9.0]])
    found = deployment_of_course(time, area, centre, 4.0)
    assert found is not None
    assert (found.largest_area, found.time_of_largest, found.at_end, found.constant) == (
        3.9,
        3.0,
        False,
        False,
    )
    assert (found.distance, found.relative_area) == (pytest.approx(3.0), pytest.approx(0.975))
    assert found.time_open == pytest.approx(2.0 * 0.7 / 1.3 + 2.0, rel=1e-12)
    for none in (0.0, np.inf):
        assert deployment_of_course(time, area, centre, none) is None

"""Areas, the four measures, and the energy balance against values worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from result_samples import net, result, square_net, unfolding
from scenes import values_of
from scipy.spatial.transform import Rotation

import exunet
from exunet.base.run_events import ElementBreak, ScriptEvent
from exunet.forces.corner_units import SPENT, WORK
from exunet.net import areas
from exunet.net.arrays import TetherNodes
from exunet.results import measures
from exunet.results.measures import shares_of
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.run_record import Carried, EntryRecord, Peak, RunRecord, UnitSettings
from exunet.results.summary import summarise


def scaled(of, factors, time=None):
    """The reference configuration times each factor, at times 0, 1, 2, ..."""
    factors = np.array(factors, float)
    position = factors[:, None, None] * of.reference_position
    return result(of, np.arange(len(factors)) if time is None else time, position)


def test_areas_of_many_states_at_once():
    of = square_net(cells=3)
    many = np.array([0.5, 1.0, 2.0])[:, None, None] * of.reference_position
    np.testing.assert_allclose(measures.mouth_area(of, many), [0.25, 1, 4], rtol=1e-15)
    np.testing.assert_allclose(measures.mesh_area(of, many[:, None]), [[0.25], [1], [4]], rtol=1e-14)


def test_mouth_folded_by_a_right_angle_about_its_diagonal():
    """Unit square, one diagonal along the fold: two corners in two planes at right angles.

    With h = sqrt(1/2), those corners stand at (h, 0, 0) and (0, 0, h), the ends of the fold at (0, +-h, 0);
    the mean of the four is (h, 0, h) / 4. Seen from it the first corner is at a = (3, 0, -1) h / 4 and a fold
    end at b = (-1, 4, -1) h / 4: a x b = (1, 1, 3) h^2 / 4, so each of the four equal triangles has the area
    |a x b| / 2 = sqrt(11) / 16.
    """
    of = square_net()
    h = np.sqrt(0.5)
    folded = np.array([(h, 0, 0), (0, h, 0), (0, -h, 0), (0, 0, h)])  # the mouth is the loop 0, 1, 3, 2
    assert measures.mouth_area(of, folded) == pytest.approx(4 * np.sqrt(11) / 16, rel=1e-14)


def test_a_mouth_is_as_wide_as_its_whole_rim():
    """Three cells beside each other: eight nodes on the rim, four of them corners.

    With the corners in one place the others still gape: (1, -2) and (2, 2) are sqrt(17) m apart. From
    the corners the mouth would have no width. What the rim spans: a flat polygon of 8 nodes, four of
    them at the origin, is the triangles of the origin with (1, -2), (2, -2) and with (2, 2), (1, 2), of 1 m2
    each; its fan from the mean, (0.75, 0), is not smaller.
    """
    flat = [(x, y, 0) for y in (0, 1) for x in range(4)]
    sides = [(k, k + 1) for k in (0, 1, 2, 4, 5, 6)] + [(k, k + 4) for k in range(4)]
    faces = tuple((k, k + 1, k + 5, k + 4) for k in range(3))
    of = net(flat, sides, faces=faces, mouth=(0, 3, 7, 4))
    assert of.rim == (0, 1, 2, 3, 7, 6, 5, 4)
    met = np.zeros((8, 3))
    met[[1, 2, 5, 6], :2] = [(1, -2), (2, -2), (1, 2), (2, 2)]
    assert measures.mouth_area(of, met) == 0.0
    assert areas.rim_area(of, met) >= 2.0
    assert areas.rim_area(of, of.reference_position) == pytest.approx(3.0, rel=1e-14)
    widths = areas.mouth_diameter(of, np.array([met, of.reference_position]))
    np.testing.assert_allclose(widths, [np.hypot(1, 4), np.sqrt(10)], rtol=1e-15)


def test_nets_without_meshes_or_mouth():
    assert net([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1), (1, 2)], mouth=(0, 1, 2)).rim == (0, 1, 2)
    assert measures.deployment(scaled(net([(0, 0, 0), (1, 0, 0)], [(0, 1)]), [1, 1])) is None


def test_mesh_area_counts_folds_twice_and_the_mouth_does_not():
    """Two unit cells, one folded flat on the other: two layers, and corners that coincide in pairs."""
    flat = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)]
    sides = [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)]
    of = net(flat, sides, faces=((0, 1, 4, 3), (1, 2, 5, 4)), mouth=(0, 2, 5, 3))
    folded = np.array(flat, float)
    folded[[2, 5], 0] = 0.0
    assert measures.mesh_area(of, of.reference_position) == 2.0
    assert measures.mesh_area(of, folded) == 2.0
    assert measures.mouth_area(of, folded) == 0.0


def test_openings_with_different_numbers_of_corners():
    """A unit square and a triangle of area 1/2 on its side, the square with one side divided."""
    at = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (0.5, 0, 0)]
    sides = [(0, 5), (5, 1), (1, 2), (2, 3), (3, 0), (1, 4), (4, 2)]
    of = net(at, sides, faces=((0, 5, 1, 2, 3), (1, 4, 2)))
    assert measures.mesh_area(of, of.reference_position) == pytest.approx(1.5, rel=1e-15)


def test_time_above_a_level_on_a_ramp():
    """0 to 1 within 10 s passes 0.8 at 8 s; down again in 5 s, it stays above for one second more."""
    assert measures.time_above(np.array([0.0, 10.0]), np.array([0.0, 1.0]), 0.8) == pytest.approx(2.0)
    assert measures.time_above(np.array([0.0, 10, 15]), np.array([0.0, 1, 0]), 0.8) == pytest.approx(3.0)
    assert measures.time_above(np.array([0.0, 10]), np.array([0.8, 0.8]), 0.8) == 0.0  # never exceeds
    assert measures.time_above(np.array([0.0, 2]), np.array([0.9, 0.9]), 0.8) == 2.0
    assert measures.time_above(np.array([3.0]), np.array([0.9]), 0.8) == 0.0


def test_four_measures():
    """Areas 0, 1, 0.6 (reference 1) at 0, 2, 4 s: above 0.8 from 1.6 s to 3 s; moved by (0, 3, 4) m."""
    states = scaled(square_net(), np.sqrt([0, 1, 0.6]), time=[0, 2, 4])
    moved = states.position + np.array([(0, 0, 0), (0, 3, 4), (9, 9, 9)])[:, None]
    found = measures.deployment(replace(states, position=moved))
    assert found is not None
    assert found.largest_area == pytest.approx(1.0, rel=1e-12)
    assert found.relative_area == pytest.approx(1.0, rel=1e-12)
    assert found.achievable_area == pytest.approx(1.0, rel=1e-15)
    assert found.time_of_largest == 2.0
    assert found.distance == pytest.approx(5.0, rel=1e-14)  # 3-4-5 triangle
    assert found.time_open == pytest.approx(1.4, rel=1e-12)
    assert not found.at_end


def test_incomplete_result_and_single_time_have_measures():
    stopped = replace(scaled(square_net(), [0.5]), run=RunRecord(verdict="stopped"))
    found = measures.deployment(stopped)
    assert found is not None
    assert (found.largest_area, found.time_open, found.distance, found.at_end) == (0.25, 0.0, 0.0, True)


def test_centre_of_mass_and_bullet_speeds():
    """A cable of 7.8 g from a free node to a bullet of 500 g at x = 2 m: centre at 2 (503.9 / 507.8) m."""
    of = net([(0, 0, 0), (1, 0, 0)], [(0, 1)], bullets=(1,))
    moved = result(of, [0], 2 * of.reference_position[None], [[(0, 0, 0), (1, 2, 2)]])
    mass_of_cable = 7800.0 * 1e-6 * 1.0  # density, area, length of the sample; half on each node, eq. (9)
    at = 2 * (0.5 + mass_of_cable / 2) / (0.5 + mass_of_cable)
    np.testing.assert_allclose(measures.centre_of_mass(moved), [(at, 0, 0)], rtol=1e-15)
    np.testing.assert_array_equal(measures.bullet_speeds(moved), [[3.0]])  # |(1, 2, 2)|


@pytest.mark.parametrize(
    ("kinetic", "elastic", "potential", "dissipated", "error"),
    [
        ([4, 2], [0, 1], [0, 0], [0, 1], 0.0),  # closes
        ([4, 2], [0, 1], [0, 0], [0, 0], 1 / 4),  # 1 J of 4 J lost
        ([0, 6], [0, 0], [90, 82], [0, 0], 2 / 8),  # falls 8 J from rest, 2 J lost: the origin of V drops out
        ([0, 0], [0, 0], [7, 7], [0, 0], 0.0),  # at rest
        ([0, 3], [0, 0], [0, 0], [0, 0], 1.0),  # 3 J from nothing
    ],
)
def test_energy_balance(kinetic, elastic, potential, dissipated, error):
    names = {"kinetic": kinetic, "elastic": elastic, "potential": potential, "dissipated": dissipated}
    states = replace(scaled(square_net(), [1, 1]), **{k: np.array(v, float) for k, v in names.items()})
    assert measures.energy_balance(states) == pytest.approx(error, abs=1e-15)


numbers = st.floats(-10, 10)


@settings(max_examples=40)
@given(st.tuples(numbers, numbers, numbers), st.tuples(numbers, numbers, numbers), st.integers(0, 2**32 - 1))
def test_measures_do_not_change_when_the_net_is_moved_and_turned(vector, shift, seed):
    """Rotations keep areas and distances: rounding of coordinates up to some 20 m leaves about 1e-14."""
    of = square_net(cells=2)
    crumpled = unfolding(of, lift=0.5).position
    crumpled = crumpled + np.random.default_rng(seed).normal(0, 0.1, crumpled.shape)
    turned = Rotation.from_rotvec(vector).apply(crumpled.reshape(-1, 3)).reshape(crumpled.shape) + shift
    time = np.linspace(0, 1, len(crumpled))
    before, after = (measures.deployment(result(of, time, x)) for x in (crumpled, turned))
    assert before is not None
    assert after is not None
    assert after.largest_area == pytest.approx(before.largest_area, rel=1e-11)
    assert after.distance == pytest.approx(before.distance, abs=1e-12)
    assert after.time_open == pytest.approx(before.time_open, abs=1e-9)
    np.testing.assert_allclose(measures.mesh_area(of, turned), measures.mesh_area(of, crumpled), rtol=1e-10)


# Loads on bodies, corner units, and metrics of small results


def towed(nodes: tuple[int, ...]) -> Result:
    """A tether from node 1 of a thread to node 4, where a ship is, in three elements; two times.

    At the second time nodes 2 and 3, or those at its other end, lie at the drum.
    """
    places = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 2.0, 0.0), (1.0, 4.0, 1.0), (1.0, 6.0, 5.0)]
    of = replace(
        net(places, [(0, 1), (1, 2), (2, 3), (3, 4)]), tethers=(TetherNodes("tow", 2, (1, 2, 3, 4)),)
    )
    position = np.array([places, places])
    position[1, list(nodes)] = places[4]
    place, still, upright = (
        np.array([[1.0, 6.0, 4.0]] * 2),
        np.zeros((2, 3)),
        np.array([[1.0, 0.0, 0.0, 0.0]] * 2),
    )
    ship = BodyStates(2.0, np.eye(3), place, still, upright, still, nodes=np.array([4]))
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
    np.testing.assert_allclose(both.force.sum(axis=1), both.force[:, 0], rtol=1e-15)


def test_a_drum_at_the_start_of_a_tether() -> None:
    """The same tether listed the other way round."""
    for nodes in ((3,), (2, 3)):
        one = towed(nodes)
        order = [0, 3, 2, 1]
        turned = replace(
            one.net,
            element_nodes=one.net.element_nodes[order][:, ::-1].copy(),
            tethers=(TetherNodes("tow", 2, (4, 3, 2, 1)),),
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
    of = square_net()
    position = np.tile(of.reference_position, (times, 1, 1))
    return result(
        of, time, position, states=states, run=RunRecord(units=UnitSettings("table", (1, 3), 0.1, 120.0))
    )


def test_what_corner_units_have_spent() -> None:
    """Propellant is the impulse over 9.80665 m/s2 times 120 s; each unit is a metric."""
    summary, values = summarise(units(3)), values_of(units(3))
    found = summary["control"]
    assert [entry["impulse_N_s"] for entry in found["units"]] == [2.0, 0.4]
    propellant = [entry["propellant_kg"] for entry in found["units"]]
    assert propellant == pytest.approx([2.0 / 1176.798, 0.4 / 1176.798], rel=1e-12)
    assert found["propellant_kg"] == pytest.approx(2.4 / 1176.798, rel=1e-12)
    assert (found["impulse_N_s"], found["work_J"]) == (pytest.approx(2.4, rel=1e-15), 0.9)
    assert [values[f"{entry['metrics']}_impulse_N_s"] for entry in found["units"]] == [2.0, 0.4]
    assert values["impulse_of_units_N_s"] == found["impulse_N_s"]
    assert summarise(replace(units(2), states={}))["control"] is None


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
    ship = BodyStates(2.0, np.eye(3), place, np.zeros((3, 3)), attitude, np.zeros((3, 3)))
    position = np.array([*np.asarray(one.position), one.net.reference_position])
    tension = np.array([[2.0, 0.0, 3.0, 1.0], [4.0, 0.0, 6.0, 1.0], [8.0, 0.0, 9.0, 1.0]])
    return result(
        one.net,
        [0.0, 1.0, 2.0],
        position,
        tension=tension,
        bodies={"ship": ship},
        run=RunRecord(carried=Carried("ship", 1.5, [1.0, 0.0, 0.0], [1, 2])),
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
    assert exunet.loads(replace(whole, run=RunRecord()), "ship").carried is None


def test_the_largest_pull_on_a_body_where_and_when() -> None:
    """5 N at the first time, 30 N at the second, at node 4, which is 1 m beside the ship's centre.

    The torque of 30 N along (0, -4, -5) about a centre 1 m below: 30 x 4 / sqrt(41) N m.
    """
    found = exunet.metrics(towed((3,)))
    for key in ("body_ship_attachment_", "attachment_ship_4_"):
        force, torque = (found[f"{key}largest_{name}"] for name in ("force_N", "torque_N_m"))
        assert (force.value, force.time) == (pytest.approx(30.0, rel=1e-14), 1.0)
        assert force.place == "end of tether tow"
        assert torque.value == pytest.approx(120.0 / np.sqrt(41.0), rel=1e-14)
        assert found[f"{key}time_of_largest_torque_s"].value == 1.0
        assert force.detail == (key != "body_ship_attachment_")  # the table has the largest of a body alone
    assert "attachment_ship_packed_largest_force_N" not in found


def test_the_pull_by_a_packed_net_is_about_the_centre_of_mass() -> None:
    """As that of nodes: at (0.5, 0.5, 0), from which the pulled nodes are (0.5, -0.5, 0) and (0.5, 1.5, 0).

    The first pulls with 4 N along -x, the second with 6 N along (0, 2, 1); both at 1 s.
    """
    first, second = np.array([-4.0, 0.0, 0.0]), 6.0 * np.array([0.0, 2.0, 1.0]) / np.sqrt(5.0)
    torque = np.cross([0.5, -0.5, 0.0], first) + np.cross([0.5, 1.5, 0.0], second)
    found = values_of(carrying())
    for key in ("body_ship_attachment_", "attachment_ship_packed_"):
        assert found[f"{key}largest_force_N"] == pytest.approx(np.linalg.norm(first + second), rel=1e-14)
        assert found[f"{key}largest_torque_N_m"] == pytest.approx(np.linalg.norm(torque), rel=1e-14)
        assert found[f"{key}time_of_largest_torque_s"] == 1.0


def opening(top: float = 4.0, peak: float = 100.0) -> Result:
    """A mouth of at most 5 m2 that opens to `top` m2 at 1 s, half way; speeds 2 and 4 m/s at the end."""
    of = square_net(size=np.sqrt(5.0))
    time = np.linspace(0.0, 2.0, 5)
    part = np.sqrt(np.array([1e-9, 0.5, 1.0, 0.5, 1e-9]) * top / 5.0)
    position = part[:, None, None] * of.reference_position + np.outer(time, [0.0, 0.0, 3.0])[:, None]
    velocity = np.zeros_like(position)
    velocity[-1, of.bullet_nodes, 0] = [2.0, 4.0, 2.0, 4.0]
    known = RunRecord(largest_tensions={"net": Peak(peak, 0.7, 3)})
    whole = result(of, time, position, velocity, dissipated=np.linspace(0.0, 0.5, 5))
    return replace(whole, tension=0.0 * whole.tension, run=known)


def test_metrics_of_a_deployment_by_hand() -> None:
    """4 m2 at 1 s, after 3 m; above 80 % of 5 m2 only at its top: for no time."""
    found = exunet.metrics(opening())
    expected = {
        "largest_tension_N": 100.0,
        "time_of_largest_tension_s": 0.7,
        "element_of_largest_tension": 3.0,
        "largest_area_m2": 4.0,
        "relative_area": 0.8,
        "time_of_largest_area_s": 1.0,
        "distance_m": 3.0,
        "time_above_80_percent_s": 0.0,
        "bullet_speed_at_end_m_s": 3.0,
        "dissipated_energy_J": 0.5,
    }
    assert {key: metric.value for key, metric in found.items()} == pytest.approx(expected, abs=1e-12)
    assert (found["largest_tension_N"].time, found["largest_tension_N"].place) == (0.7, "element 3")
    # 4.5 m2 at the top of straight sides of 4.5 m2/s: above 4 m2 for 2 x 0.5 / 4.5 s.
    assert values_of(opening(4.5))["time_above_80_percent_s"] == pytest.approx(1.0 / 4.5)


def test_what_has_no_meaning_is_no_metric() -> None:
    """The time of the largest of what stays the same to round-off, or is largest at the start."""
    of = square_net()
    factors = np.sqrt(1.0 + 1e-14 * np.array([0.0, 1.0, 2.0, 1.0, 3.0]))
    slack = RunRecord(largest_tensions={"net": Peak(0.0, 0.0, -1)})
    still = replace(scaled(of, factors), run=slack)
    found = values_of(replace(still, tension=0.0 * still.tension))
    for key in ("time_of_largest_area_s", "distance_m", "time_of_largest_tension_s", "first_break_s"):
        assert key not in found
    assert found["largest_area_m2"] == pytest.approx(1.0)
    assert "time_of_largest_area_s" not in values_of(scaled(of, [1.0, 0.7, 0.4]))
    taut = np.full_like(still.tension, 4.0)
    even = replace(still, tension=taut, run=RunRecord(largest_tensions={"net": Peak(4.0, 0.7, 3)}))
    assert "time_of_largest_tension_s" not in values_of(even)
    snapped = RunRecord(largest_tensions={"net": Peak(9.0, 0.7, 3)})  # between stored times
    assert values_of(replace(even, run=snapped))["time_of_largest_tension_s"] == 0.7


def test_breaks_where_elements_can_break() -> None:
    broken = tuple(ElementBreak(element=k, time_s=time) for k, time in ((1, 0.5), (2, 0.3)))
    found = values_of(replace(opening(), run=RunRecord(events=broken, can_break=True)))
    assert (found["elements_broken"], found["first_break_s"]) == (2.0, 0.3)
    none = values_of(replace(opening(), run=RunRecord(can_break=True)))
    assert none["elements_broken"] == 0.0
    assert "first_break_s" not in none


def test_times_of_script_entries_that_wait_for_the_run() -> None:
    """Not what the case gives. What is never reached has no time, but a number of times."""
    entries = [EntryRecord(name, "", "", awaited=name != "given") for name in ("near", "given", "never")]
    done = (("near", 0.2), ("near", 0.4), ("given", 0.5))
    events = tuple(ScriptEvent(entry=name, time_s=at, cause="", event="", done=True) for name, at in done)
    found = values_of(replace(opening(), run=RunRecord(script_entries=entries, events=events)))
    times = {key: value for key, value in found.items() if key.startswith("script_")}
    assert times == {"script_near_first_s": 0.2, "script_near_times": 2.0, "script_never_times": 0.0}

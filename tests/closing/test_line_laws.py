"""The loops of a closing line: forces, energy, work of the winch, rings that meet.

The functions run here as Python; `test_closing_line.py` runs them compiled, in all forms of the engine.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from laid_lines import RING, ZIGZAG, flat, line, line_of, turns

from exunet.forces import closing
from exunet.forces.closing import Drawstring, WinchCommands, elastic_once_slid, too_long, way_of
from exunet.net.closing import ClosingLine
from exunet.net.drive import Drive

Floats = np.ndarray


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("near", [1.0, 0.5, 1e-3, 0.0])
def test_forces_and_torques_sum_to_zero(friction: float, near: float) -> None:
    """Whatever the distance of two rings, in their diameters: pieces pull along the line between nodes."""
    places = ZIGZAG.copy()
    places[2] = places[1] + near * RING * np.array([0.6, 0.0, 0.8])
    data, blocks = line(places, friction=friction, length=1.2)
    force = np.zeros(blocks.n_force)
    rubs = friction > 0.0
    add = closing.add_rubbing_line if rubs else closing.add_line
    add(0.0, flat(places, 0.1, 0.0, 0.0, 0.0), np.zeros(blocks.n_v), data, force)
    pulls = force[: 3 * len(places)].reshape(-1, 3)
    assert np.abs(pulls).max() > 10.0
    assert np.abs(pulls.sum(axis=0)).max() < 1e-12 * np.abs(pulls).max()
    assert np.abs(np.cross(places, pulls).sum(axis=0)).max() < 1e-12 * np.abs(pulls).max()


def test_one_tension_along_the_line() -> None:
    """N of the whole way, at both ends, and 2 N sin(phi / 2) at each ring, by which the line turns by phi."""
    length = float(way_of(line_of(5), ZIGZAG).sum()) / 1.1
    data, blocks = line(ZIGZAG, length=length)
    force = np.zeros(blocks.n_force)
    closing.add_line(0.0, flat(ZIGZAG, 0.0, 0.0), np.zeros(blocks.n_v), data, force)
    pulls = np.linalg.norm(force[:15].reshape(-1, 3), axis=1)
    tension = 250.0 * (1.1**3 - 1.1)
    np.testing.assert_allclose(pulls[[0, -1]], tension, rtol=1e-12)
    np.testing.assert_allclose(pulls[1:-1], 2.0 * tension * np.sin(0.5 * turns(ZIGZAG)), rtol=1e-12)


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("ratio", [1.0, 1.02])
def test_what_is_known_at_the_start(friction: float, ratio: float) -> None:
    """Way, tension E1A e lambda at both ends and stretch of a line that starts stretched by a tenth.

    A part of it is wound up; a warm one is free of stress at another length, with EA of the reference length.
    """
    way, tension = float(way_of(line_of(5), ZIGZAG).sum()), 250.0 * ratio**3 * (1.1**3 - 1.1)
    given = {"length": way / (1.1 * ratio) + 0.3, "wound": 0.3, "friction": friction, "ratio": ratio}
    data, blocks = line(ZIGZAG, strength=1e3, times=(0.0, 0.5), drives=(Drive(),) * 3, **given)
    status = closing.LineStatus(*data.kept[: closing.STATUS])
    assert status == pytest.approx((1.0, tension, tension, way, tension, 0.0, tension / 1e3, 1.1), rel=1e-12)
    x = flat(ZIGZAG, *blocks.initial_states)
    energy = 500.0 * ratio**3 * (0.5 * (1.1**2 - 1.0)) ** 2 / 2.0 * way / 1.1
    if friction:
        assert data.kept[closing.STATUS :].sum() == pytest.approx(way / 1.1, rel=1e-12)
        assert closing.rubbing_potential(x, data) == pytest.approx(energy, rel=1e-12)
        assert elastic_once_slid(x, data, 0.3) == pytest.approx(energy, rel=1e-12)
        np.testing.assert_allclose(data.tension, tension, rtol=1e-11)
    else:
        assert closing.line_potential(x, data) == pytest.approx(energy, rel=1e-12)


def test_what_a_line_keeps() -> None:
    """States, and what of them energy was given by or taken out; series; limits of the winch."""
    for friction, time, names, gives in (
        (0.0, 0.0, ["wound_up", "work"], [0.0, 1.0]),
        (0.0, 0.1, ["wound_up", "work", "viscosity"], [0.0, 1.0, -1.0]),
        (0.3, 0.0, ["wound_up", "work", "friction", "elastic"], [0.0, 1.0, -1.0, 0.0]),
    ):
        data, blocks = line(ZIGZAG, friction=friction, time=time, ratio=1.02, winch_at_end=True)
        assert [state.name for state in blocks.states] == [f"closing/{name}" for name in names]
        assert [item.gives for item in blocks.states] == gives
        assert (data.longest_wound, data.slows, data.winch) == (1.5, 0.02, 3)
        assert (data.whole, data.stiffness) == pytest.approx((2.04, 500.0 * 1.02**3), rel=1e-14)
        assert data.node.tolist() == [0, 3, 6, 9, 12]
        for strength in (None, 40.0):
            drawn = dataclasses.replace(line_of(5), friction=friction, strength=strength, length=2.0)
            series = {entry.name: entry.place for entry in Drawstring(drawn, blocks).memory.series}
            kept = ["tension_start", "tension_end", "way", "largest", "largest_time"]
            kept += ["load"] if strength else []
            assert series == {f"closing/{name}": k for k, name in enumerate(kept, 1)}


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_line_that_starts_slack_holds_nothing(friction: float) -> None:
    """A load has no meaning without a strength, and a slack line has no tension and no energy."""
    way = float(way_of(line_of(5), ZIGZAG).sum())
    data, blocks = line(ZIGZAG, length=1.2 * way, friction=friction)
    status = closing.LineStatus(*data.kept[: closing.STATUS])
    assert status == pytest.approx((0.0, 0.0, 0.0, way, 0.0, 0.0, 0.0, 1.0 / 1.2), rel=1e-12)
    assert not blocks.initial_states.any()


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_bounds_for_the_step_by_hand(friction: float) -> None:
    """EA over the least length, times 1, 4, 4, 4, 1 over the masses; with friction 4 of the lightest, each
    piece by itself. Across, 6 times 1 % of EA over the ring. The drive that gives most, and viscosity."""
    given = {"path": (0, 1, 2, 3, 4), "length": 3.0, "stiffness": 500.0, "linear_density": 0.0}
    winch = {"shortest": 0.5, "damping": 100.0, "drives": (Drive(0.1, 2.0, 0.003), Drive(0.2, 2.0, 0.001))}
    mass = np.array([0.5, 0.25, 2.0, 1.0, 0.125])
    _, blocks = line(ZIGZAG)
    net = dataclasses.replace(blocks.net, fixed_nodes=np.array([4]))
    free = dataclasses.replace(blocks, mass=mass, net=net)
    for has_winch, least in ((True, 0.5), (False, 3.0)):
        drawn = ClosingLine(**given, **winch, ring_diameter=0.02, friction=friction, has_winch=has_winch)
        stiffness, damping = Drawstring(drawn, free, 1.1, 0.04).rates
        slope = 500.0 / (1.1 * least)
        along = slope * (2.0 + 16.0 + 2.0 + 4.0)
        if friction:
            slope *= 4.0
            along = slope * 16.0
        across = 6.0 * 0.01 * 500.0 / 0.02 * 4.0
        assert stiffness == pytest.approx(2.0 * along + across, rel=1e-12)
        # Without commands in the case, a script may ask for a brake: 1 / (100 N s/m).
        assert damping == pytest.approx(slope * (0.01 if has_winch else 0.003) + 0.08 * along, rel=1e-12)


def test_commands_of_the_winch_count_once_each() -> None:
    switch, nothing = WinchCommands(dataclasses.replace(line_of(3), times=(0.1, 0.3))), np.zeros(0)
    memory, told = np.array([0.0, 7.0]), []
    assert switch.crossed(0.0999, nothing, nothing, memory).tolist() == []
    for time in switch.times:
        assert switch.crossed(time, nothing, nothing, memory).tolist() == [0]
        change = switch.change(time, nothing, nothing, memory, np.zeros(1, dtype=np.int64), {})
        memory = change.memory
        told.append((memory.tolist(), change.events[0]))
        assert switch.crossed(time, nothing, nothing, memory).tolist() == []
    assert told == [
        ([1.0, 7.0], {"time_s": 0.1, "event": "command 1"}),
        ([2.0, 7.0], {"time_s": 0.3, "event": "command 2"}),
    ]


def test_a_line_stops_the_run_beyond_twice_its_length() -> None:
    """And not at twice."""
    status = closing.LineStatus(*np.zeros(7), stretch=2.0)
    assert too_long(np.array(status)) == ""
    assert "2 times as long" in too_long(np.array(status._replace(stretch=np.nextafter(2.0, 3.0))))


def test_a_slack_line_that_slides_takes_nothing() -> None:
    """It was taut and slid through all rings; now it is slack, and has no tension and no power."""
    data, blocks = line(ZIGZAG, friction=0.3, length=5.0)
    first = closing.STATUS
    data.kept[first + 4 : first + 7] = [1.0, -1.0, 1.0]
    v, force = np.random.default_rng(3).normal(size=blocks.n_v), np.zeros(blocks.n_force)
    with np.errstate(all="raise"):
        closing.add_rubbing_line(0.0, flat(ZIGZAG, 0.0, 0.0, 0.0, 0.0), v, data, force)
    assert not force.any()


def test_a_slack_line_does_not_pull_however_fast_it_lengthens() -> None:
    data, blocks = line(ZIGZAG, time=0.5, length=5.0)
    v = np.array([[0.0], [1.0], [0.0], [1.0], [2.0]]) * [3.0, 5.0, 1.0]
    force = np.zeros(blocks.n_force)
    closing.add_line(0.0, flat(ZIGZAG, 0.0, 0.0, 0.0), v.ravel(), data, force)
    assert closing.growth_of_way(v.ravel(), data) > 1.0
    assert not force.any()


def test_a_sum_has_all_its_numbers_whatever_their_number() -> None:
    values = np.random.default_rng(6).normal(size=13)
    for n in range(14):
        assert closing.total_of(values[:n]) == pytest.approx(values[:n].sum(), rel=1e-13)


def test_what_is_remembered() -> None:
    """Tensions, way and stretch of now; the largest tension so far, when first, its part of the strength."""
    for friction in (0.0, 0.3):
        data, blocks = line(ZIGZAG, friction=friction, length=1.9, strength=40.0)
        rubs = friction > 0.0
        add = closing.add_rubbing_line if rubs else closing.add_line
        remember = closing.remember_rubbing if rubs else closing.remember_line
        data.kept[4] = 0.0
        for time, wound in ((0.1, 1.1), (0.2, 1.3), (0.25, 1.3), (0.3, 1.2)):
            x = flat(ZIGZAG, wound, 0.0, 0.0, 0.0)[: blocks.n_x]
            add(time, x, np.zeros(blocks.n_v), data, np.zeros(blocks.n_force))
            remember(time, x, np.zeros(blocks.n_v), data)
            way = float(way_of(line_of(5), ZIGZAG).sum())
            stretch = data.way / data.material if rubs else np.full(4, way / (1.9 - wound))
            pulls = 250.0 * (stretch**3 - stretch)
            if wound == 1.3:
                most = pulls.max()
            np.testing.assert_allclose(data.kept[1:4], [pulls[0], pulls[-1], way], rtol=1e-10)
            assert data.kept[7] == pytest.approx(stretch.max(), rel=1e-10)
            if rubs:
                np.testing.assert_allclose(data.kept[8:12], data.material, rtol=1e-13)
                np.testing.assert_array_equal(data.kept[12:15], data.slides[:3])
        np.testing.assert_allclose(data.kept[4:7], [most, 0.2, most / 40.0], rtol=1e-10)


@pytest.mark.parametrize("time", [0.0, 0.01])
@pytest.mark.parametrize("near", [30.0, 0.7])
def test_force_work_and_energy(time: float, near: float) -> None:
    """-dU/dx on the nodes, dU/ds at the winch, by differences; what is left is what viscosity takes out."""
    places = ZIGZAG.copy()
    places[3] = places[2] + near * RING * np.array([0.6, 0.0, 0.8])
    drives = (Drive(0.4, 5.0, 0.01),)
    length = float(way_of(line_of(5), places).sum()) / (1.05 * 1.02) + 0.3
    data, blocks = line(places, time=time, length=length, drives=drives, ratio=1.02)
    rng = np.random.default_rng(5)
    x = flat(places, 0.3, *np.zeros(blocks.n_x - blocks.n_v - 1))
    v = rng.normal(scale=0.3, size=blocks.n_v)
    force, n = np.zeros(blocks.n_force), blocks.n_v
    closing.add_line(0.0, x, v, data, force)
    slope = np.zeros(n + 1)
    for k in range(n + 1):
        step = 1e-6 * np.eye(blocks.n_x)[k]
        ends = [closing.line_potential(x + sign * step, data) for sign in (1.0, -1.0)]
        slope[k] = (ends[0] - ends[1]) / 2e-6
    if time == 0.0:
        np.testing.assert_allclose(force[:n], -slope[:n], rtol=1e-6, atol=1e-6)
        assert force[n + 1] == pytest.approx(slope[n] * force[n], rel=1e-7)
    balance = force[n + 1] - force[:n] @ v - slope[:n] @ v - slope[n] * force[n]
    taken = force[n + 2] if time else 0.0
    assert taken == pytest.approx(balance, rel=1e-6, abs=1e-6)
    strain = []
    for h in (0.0, 1e-6, -1e-6):
        way = closing.lay_line(x[: n + 1] + h * np.append(v, force[n]), data)
        stretch = way / (1.02 * (length - 0.3 - h * force[n]))
        strain.append(0.5 * (stretch**2 - 1.0))
    whole = strain[0] + time * (strain[1] - strain[2]) / 2e-6
    assert data.reported[:2] == pytest.approx(
        500.0 * 1.02**3 * whole * math.sqrt(1.0 + 2.0 * strain[0]), rel=1e-6
    )


def test_the_pull_of_rings_that_meet_has_no_jump() -> None:
    """Way, slope and curvature go on smoothly at the diameter, and at the ring itself the slope is 0."""
    distance = RING * np.array([1e-9, 0.5, 1.0 - 1e-7, 1.0 + 1e-7, 2.0])
    way = np.array([way_of(line_of_two(d), np.array([[0.0, 0, 0], [d, 0, 0]]))[0] for d in distance])
    assert way[0] == pytest.approx(0.375 * RING)  # the formula at u = 0
    np.testing.assert_allclose(way[2:], distance[2:], rtol=1e-13)
    for d, slope in zip(distance, [0.0, 0.6875, 1.0, 1.0, 1.0], strict=True):  # 3/2 u - u^3/2
        data, _ = line(np.array([[0.0, 0, 0], [d, 0, 0]]))
        closing.lay_line(np.array([0.0, 0, 0, d, 0, 0, 0, 0]), data)
        assert d * data.pull[0] == pytest.approx(slope, abs=1e-8)
        assert data.way[0] == way_of(line_of_two(d), np.array([[0.0, 0, 0], [d, 0, 0]]))[0]


def line_of_two(_: float) -> ClosingLine:
    return ClosingLine((0, 1), 1.0, 1.0, 0.0, RING, 0.0)


def test_the_bounds_for_the_step_hold() -> None:
    """Against the eigenvalues of -dF/dx / m by differences, with rings apart and with rings that meet."""
    for near in (50.0, 1.0, 0.1):
        places = ZIGZAG.copy()
        places[2] = places[1] + near * RING * np.array([0.0, -0.8, 0.6])
        length = float(way_of(line_of(5), places).sum()) / math.sqrt(1.02)  # a strain of 1 %
        data, blocks = line(places, length=length, has_winch=False)
        drawn = ClosingLine(tuple(range(5)), length, 500.0, 0.0, RING, 0.0)
        bound = Drawstring(drawn, blocks).rates[0]
        n, matrix = blocks.n_v, np.zeros((blocks.n_v, blocks.n_v))
        for k in range(n):
            both = []
            for sign in (1.0, -1.0):
                force = np.zeros(blocks.n_force)
                x = flat(places, 0.0, 0.0) + sign * 1e-6 * np.eye(n + 2)[k]
                closing.add_line(0.0, x, np.zeros(n), data, force)
                both.append(force[:n])
            matrix[k] = -(both[0] - both[1]) / 2e-6
        largest = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1]  # masses of 1 kg
        assert 0.05 * bound < largest <= bound

"""The loops of a closing line: forces, energy, capstan ratio, work of the winch, rings that meet.

The functions run here as Python; `test_closing_line.py` runs them compiled, in all forms of the engine.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from exunet.forces import closing_loops, rubbing_loops
from exunet.forces.blocks import Blocks
from exunet.forces.closing import (
    Drawstring,
    WinchCommands,
    elastic_once_slid,
    states_of,
    too_long,
    way_of,
)
from exunet.net.arrays import Net
from exunet.net.closing import ClosingLine
from exunet.net.drive import Drive

Floats = np.ndarray

RING = 0.01


def line(places: Floats, **given: Any) -> tuple[closing_loops.Line, Blocks]:
    """A line from the first of some places through rings at the others to the last; EA = 500 N."""
    n = len(places)
    none, nothing = np.zeros(0), np.zeros(0, dtype=np.int64)
    ends = np.zeros((0, 2), dtype=np.int64)
    net = Net(places, np.ones(n), ends, none, none, none, none, none.astype(bool), nothing, nothing)
    numbers: dict[str, Any] = {"path": tuple(range(n)), "length": 2.0, "stiffness": 500.0, "friction": 0.0}
    numbers |= {"linear_density": 0.0, "ring_diameter": RING}
    numbers |= {"shortest": 0.5, "largest_rate": 5.0, "has_winch": True}
    time, ratio = given.pop("time", 0.0), given.pop("ratio", 1.0)
    drawn = ClosingLine(**(numbers | given))
    blocks = Blocks.of(net, places, (), (), states_of(drawn, places, ratio, time))
    string = Drawstring(drawn, blocks, ratio, time)
    return string.data(string.at_start), blocks


ZIGZAG = np.array([[0.0, 0.0, 0.0], [0.7, 0.4, 0.1], [0.9, -0.5, 0.2], [1.6, 0.1, -0.2], [2.0, 0.6, 0.3]])


def flat(places: Floats, *states: float) -> Floats:
    return np.concatenate([places.ravel(), states])


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("near", [1.0, 0.5, 1e-3, 0.0])
def test_forces_and_torques_sum_to_zero(friction: float, near: float) -> None:
    """Whatever the distance of two rings, in their diameters: pieces pull along the line between nodes."""
    places = ZIGZAG.copy()
    places[2] = places[1] + near * RING * np.array([0.6, 0.0, 0.8])
    data, blocks = line(places, friction=friction, length=1.2)
    force = np.zeros(blocks.n_force)
    rubs = friction > 0.0
    add = rubbing_loops.add_rubbing_line if rubs else closing_loops.add_line
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
    closing_loops.add_line(0.0, flat(ZIGZAG, 0.0, 0.0), np.zeros(blocks.n_v), data, force)
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
    status = closing_loops.LineStatus(*data.kept[: closing_loops.STATUS])
    assert status == pytest.approx((1.0, tension, tension, way, tension, 0.0, tension / 1e3, 1.1), rel=1e-12)
    x = flat(ZIGZAG, *blocks.initial_states)
    energy = 500.0 * ratio**3 * (0.5 * (1.1**2 - 1.0)) ** 2 / 2.0 * way / 1.1
    if friction:
        assert data.kept[closing_loops.STATUS :].sum() == pytest.approx(way / 1.1, rel=1e-12)
        assert rubbing_loops.rubbing_potential(x, data) == pytest.approx(energy, rel=1e-12)
        assert elastic_once_slid(x, data, 0.3) == pytest.approx(energy, rel=1e-12)
        np.testing.assert_allclose(data.tension, tension, rtol=1e-11)
    else:
        assert closing_loops.line_potential(x, data) == pytest.approx(energy, rel=1e-12)


def test_what_a_line_keeps() -> None:
    """States, and what of them energy was given by or taken out; series; limits of the winch."""
    for friction, time, names, gives in (
        (0.0, 0.0, ["wound_up", "work"], [0.0, 1.0]),
        (0.0, 0.1, ["wound_up", "work", "viscosity"], [0.0, 1.0, -1.0]),
        (0.3, 0.0, ["wound_up", "work", "friction", "elastic"], [0.0, 1.0, -1.0, 0.0]),
    ):
        data, blocks = line(ZIGZAG, friction=friction, time=time, ratio=1.02, winch_at_end=True)
        assert [one.name for one in blocks.states] == [f"closing/{name}" for name in names]
        assert [one.gives for one in blocks.states] == gives
        assert (data.longest_wound, data.slows, data.winch) == (1.5, 0.02, 3)
        assert (data.whole, data.stiffness) == pytest.approx((2.04, 500.0 * 1.02**3), rel=1e-14)
        assert data.node.tolist() == [0, 3, 6, 9, 12]
        for strength in (None, 40.0):
            drawn = dataclasses.replace(line_of(5), friction=friction, strength=strength, length=2.0)
            series = {one.name: one.place for one in Drawstring(drawn, blocks).memory.series}
            kept = ["tension_start", "tension_end", "way", "largest", "largest_time"]
            kept += ["load"] if strength else []
            assert series == {f"closing/{name}": k for k, name in enumerate(kept, 1)}


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_line_that_starts_slack_holds_nothing(friction: float) -> None:
    """A load has no meaning without a strength, and a slack line has no tension and no energy."""
    way = float(way_of(line_of(5), ZIGZAG).sum())
    data, blocks = line(ZIGZAG, length=1.2 * way, friction=friction)
    status = closing_loops.LineStatus(*data.kept[: closing_loops.STATUS])
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
    status = closing_loops.LineStatus(*np.zeros(7), stretch=2.0)
    assert too_long(np.array(status)) == ""
    assert "2 times as long" in too_long(np.array(status._replace(stretch=np.nextafter(2.0, 3.0))))


def test_a_slack_line_that_slides_takes_nothing() -> None:
    """It was taut and slid through all rings; now it is slack, and has no tension and no power."""
    data, blocks = line(ZIGZAG, friction=0.3, length=5.0)
    first = closing_loops.STATUS
    data.kept[first + 4 : first + 7] = [1.0, -1.0, 1.0]
    v, force = np.random.default_rng(3).normal(size=blocks.n_v), np.zeros(blocks.n_force)
    with np.errstate(all="raise"):
        rubbing_loops.add_rubbing_line(0.0, flat(ZIGZAG, 0.0, 0.0, 0.0, 0.0), v, data, force)
    assert not force.any()


def test_a_slack_line_does_not_pull_however_fast_it_lengthens() -> None:
    data, blocks = line(ZIGZAG, time=0.5, length=5.0)
    v = np.array([[0.0], [1.0], [0.0], [1.0], [2.0]]) * [3.0, 5.0, 1.0]
    force = np.zeros(blocks.n_force)
    closing_loops.add_line(0.0, flat(ZIGZAG, 0.0, 0.0, 0.0), v.ravel(), data, force)
    assert closing_loops.growth_of_way(v.ravel(), data) > 1.0
    assert not force.any()


def test_a_sum_has_all_its_numbers_whatever_their_number() -> None:
    values = np.random.default_rng(6).normal(size=13)
    for n in range(14):
        assert closing_loops.total_of(values[:n]) == pytest.approx(values[:n].sum(), rel=1e-13)


def test_what_is_remembered() -> None:
    """Tensions, way and stretch of now; the largest tension so far, when first, its part of the strength."""
    for friction in (0.0, 0.3):
        data, blocks = line(ZIGZAG, friction=friction, length=1.9, strength=40.0)
        rubs = friction > 0.0
        add = rubbing_loops.add_rubbing_line if rubs else closing_loops.add_line
        remember = rubbing_loops.remember_rubbing if rubs else closing_loops.remember_line
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


def turns(places: Floats) -> Floats:
    """Angles [rad] by which a polygon turns at its inner corners."""
    ways = np.diff(places, axis=0)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.arccos(np.einsum("ka,ka->k", ways[1:], ways[:-1]))


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
    closing_loops.add_line(0.0, x, v, data, force)
    slope = np.zeros(n + 1)
    for k in range(n + 1):
        step = 1e-6 * np.eye(blocks.n_x)[k]
        ends = [closing_loops.line_potential(x + sign * step, data) for sign in (1.0, -1.0)]
        slope[k] = (ends[0] - ends[1]) / 2e-6
    if time == 0.0:
        np.testing.assert_allclose(force[:n], -slope[:n], rtol=1e-6, atol=1e-6)
        assert force[n + 1] == pytest.approx(slope[n] * force[n], rel=1e-7)
    balance = force[n + 1] - force[:n] @ v - slope[:n] @ v - slope[n] * force[n]
    taken = force[n + 2] if time else 0.0
    assert taken == pytest.approx(balance, rel=1e-6, abs=1e-6)
    strain = []
    for h in (0.0, 1e-6, -1e-6):
        way = closing_loops.lay_line(x[: n + 1] + h * np.append(v, force[n]), data)
        stretch = way / (1.02 * (length - 0.3 - h * force[n]))
        strain.append(0.5 * (stretch**2 - 1.0))
    whole = strain[0] + time * (strain[1] - strain[2]) / 2e-6
    assert data.told[:2] == pytest.approx(
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
        closing_loops.lay_line(np.array([0.0, 0, 0, d, 0, 0, 0, 0]), data)
        assert d * data.pull[0] == pytest.approx(slope, abs=1e-8)
        assert data.way[0] == way_of(line_of_two(d), np.array([[0.0, 0, 0], [d, 0, 0]]))[0]


def line_of_two(_: float) -> ClosingLine:
    return ClosingLine((0, 1), 1.0, 1.0, 0.0, RING, 0.0)


def slid(places: Floats, wound: float, friction: float, **given: Any) -> closing_loops.Line:
    """A line of one tension, none unless stretched, from which a length was wound up at its start."""
    length = float(way_of(line_of(len(places)), places).sum()) / given.pop("stretched", 1.0)
    data, _ = line(places, length=length, friction=friction, **given)
    rubbing_loops.settle_line(flat(places, wound, 0.0, 0.0, 0.0), data)
    return data


def line_of(n: int) -> ClosingLine:
    return ClosingLine(tuple(range(n)), 1.0, 1.0, 0.0, RING, 0.0)


@pytest.mark.parametrize("at_end", [False, True])
def test_the_capstan_ratio(at_end: bool) -> None:
    """e^(mu phi) at each ring, Euler and Eytelwein; the line in all pieces is what was not wound up."""
    data = slid(ZIGZAG, 0.1, 0.3, winch_at_end=at_end)
    phi = turns(ZIGZAG)
    assert phi.min() > 0.5
    falls = data.tension[1:] / data.tension[:-1]
    np.testing.assert_allclose(falls, np.exp((0.3 if at_end else -0.3) * phi), rtol=1e-10)
    assert data.material.sum() == pytest.approx(data.whole - 0.1, rel=1e-13)
    stretch = data.way / data.material
    np.testing.assert_allclose(data.tension, 250.0 * (stretch**3 - stretch), rtol=1e-10)  # EA e lambda


def test_far_from_the_winch_it_may_not_slide_at_all() -> None:
    """Where all is taut before, what is not pulled keeps its line: each ring holds what it can."""
    data = slid(ZIGZAG, 0.02, 0.3, stretched=1.01)
    falls = data.tension[1:] / np.maximum(data.tension[:-1], 1e-300)
    sticks = data.slides[:-1] == 0.0
    assert sticks.any()
    assert not sticks.all()
    np.testing.assert_allclose(falls[~sticks], np.exp(-data.limit[:-1][~sticks]), rtol=1e-10)
    assert (falls[sticks] >= np.exp(-data.limit[:-1][sticks])).all()
    np.testing.assert_allclose(data.material[-1], data.old[-1], rtol=1e-13)


@pytest.mark.parametrize("seed", range(8))
def test_what_slides_is_the_least(seed: int) -> None:
    """Random lines and memories: no ratio is exceeded, line slides to higher tension, none is lost."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(12, 3))
    places[5] = places[4] + 0.3 * RING  # two rings that touch
    data, _ = line(places, length=float(way_of(line_of(12), places).sum()) * 0.99, friction=0.2)
    first = closing_loops.STATUS
    data.kept[first : first + 11] *= rng.uniform(0.9, 1.1, size=11)
    whole = data.kept[first : first + 11].sum()
    wound = data.whole - whole + rng.uniform(-0.2, 0.2)
    rubbing_loops.settle_line(flat(places, wound, 0.0, 0.0, 0.0), data)
    holds = np.exp(data.limit[:-1]) * (1.0 + 1e-9)
    assert (data.tension[1:] <= data.tension[:-1] * holds + 1e-9).all()
    assert (data.tension[:-1] <= data.tension[1:] * holds + 1e-9).all()
    slide = np.cumsum(data.old - data.material)[:-1]
    assert data.material.sum() == pytest.approx(data.whole - wound, rel=1e-12)
    taut = np.minimum(data.tension[1:], data.tension[:-1]) > 0.0
    moved = taut & (np.abs(slide) > 1e-9)
    assert moved.any() or not taut.any()
    assert (slide * (data.tension[1:] - data.tension[:-1]))[moved].min(initial=1.0) >= 0.0


def test_hardly_any_friction_is_none() -> None:
    """mu = 1e-13: the forces of the line with one tension, which are written apart."""
    given = {"length": 1.9, "drives": (Drive(0.4, 5.0, 0.01),)}
    smooth, blocks = line(ZIGZAG, **given)
    rubbing, more = line(ZIGZAG, friction=1e-13, **given)
    rng = np.random.default_rng(2)
    v, n = rng.normal(size=blocks.n_v), blocks.n_v
    one, other = np.zeros(blocks.n_force), np.zeros(more.n_force)
    closing_loops.add_line(0.0, flat(ZIGZAG, 0.2, 0.0), v, smooth, one)
    rubbing_loops.add_rubbing_line(0.0, flat(ZIGZAG, 0.2, 0.0, 0.0, 0.0), v, rubbing, other)
    np.testing.assert_allclose(other[: n + 2], one, rtol=1e-9, atol=1e-9)
    assert other[n + 2] == pytest.approx(0.0, abs=1e-9)


def test_a_piece_from_which_nearly_all_line_was_wound_up() -> None:
    """EA (s^3 - s) / 2 down to a thousandth of its way; 1000 EA below that: it takes some of others."""
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    for left, tension in ((1e-3, 250.0 * (500.0**3 - 500.0)), (4e-4, 500.0 * 1e3)):
        data, _ = line(places, friction=0.3, length=1.0)
        rubbing_loops.settle_line(flat(places, 1.0 - left, 0.0, 0.0, 0.0), data)
        assert data.tension[0] == pytest.approx(tension, rel=1e-9)


@pytest.mark.parametrize(("first", "second"), [(40.0, 30.0), (0.7, 30.0), (40.0, 0.6), (0.7, 0.6)])
def test_the_rate_of_a_turn(first: float, second: float) -> None:
    """phi h h' by differences, with rings apart, one that meets its neighbour, and one that meets both."""
    places = np.array([[0.0, 0.1, 0.2]] * 3)
    places[1] += first * RING * np.array([0.6, 0.0, 0.8])
    places[2] = places[1] + second * RING * np.array([0.48, 0.64, -0.6])
    data, blocks = line(places, friction=0.3)
    v = np.random.default_rng(9).normal(scale=0.1, size=blocks.n_v)
    x, turn = flat(places, 0.0, 0.0, 0.0, 0.0), []
    for h in (1e-6, -1e-6):
        closing_loops.lay_line(x + h * np.append(v, np.zeros(4)), data)
        turn.append(rubbing_loops.turn_of(data, 0))
    closing_loops.lay_line(x, data)
    assert rubbing_loops.rate_of_turn(v, data, 0) == pytest.approx((turn[0] - turn[1]) / 2e-6, rel=1e-6)
    slopes = [1.0 if u >= 1.0 else 1.5 * u - 0.5 * u**3 for u in (first, second)]
    angle = math.acos(0.6 * 0.48 - 0.8 * 0.6)
    assert rubbing_loops.turn_of(data, 0) == pytest.approx(angle * slopes[0] * slopes[1], rel=1e-12)


def test_a_turn_has_no_rate_where_it_has_no_direction() -> None:
    """Where two rings are at one place, and where the line runs straight on."""
    v = np.random.default_rng(9).normal(size=9)
    for places in (
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
    ):
        data, _ = line(np.array(places), friction=0.3)
        with np.errstate(invalid="ignore"):
            closing_loops.lay_line(flat(np.array(places), 0.0, 0.0, 0.0, 0.0), data)
        assert rubbing_loops.rate_of_turn(v, data, 0) == 0.0


@pytest.mark.parametrize("near", [40.0, 0.6])
def test_what_friction_takes(near: float) -> None:
    """The rate of the elastic energy, of which the power of nodes and winch is left, by differences.

    The line slides through all rings, backwards through two of them, while the nodes move.
    """
    places = ZIGZAG.copy()
    places[2] = places[1] + near * RING * np.array([0.0, -0.8, 0.6])
    length = float(way_of(line_of(5), places).sum())
    data, blocks = line(places, length=length, friction=0.3, winch_at_end=True, drives=(Drive(0.5),))
    v = np.random.default_rng(1).normal(scale=0.2, size=blocks.n_v)
    x, n, force = flat(places, 0.1, 0.0, 0.0, 0.0), blocks.n_v, np.zeros(blocks.n_force)
    rubbing_loops.add_rubbing_line(0.0, x, v, data, force)
    assert (data.slides[:-1] != 0.0).all()

    def elastic(h: float) -> float:
        moved = x + h * np.concatenate([v, [force[n], 0.0, 0.0, 0.0]])
        rubbing_loops.settle_line(moved, data)
        stretch = data.way / data.material
        return float((250.0 * (0.5 * (stretch**2 - 1.0)) ** 2 * data.material).sum())

    rate = (elastic(1e-6) - elastic(-1e-6)) / 2e-6
    taken = force[n + 1] - force[:n] @ v - rate
    assert force[n + 2] == pytest.approx(taken, rel=1e-6)
    assert force[n + 3] == pytest.approx(rate, rel=1e-6)
    assert taken > 0.1
    # Once it has been remembered where the line slid to, it is about to slide on in the same way.
    rubbing_loops.remember_rubbing(0.0, x, v, data)
    again = np.zeros(blocks.n_force)
    rubbing_loops.add_rubbing_line(0.0, x, v, data, again)
    np.testing.assert_allclose(again, force, rtol=1e-9, atol=1e-9)


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
                closing_loops.add_line(0.0, x, np.zeros(n), data, force)
                both.append(force[:n])
            matrix[k] = -(both[0] - both[1]) / 2e-6
        largest = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1]  # masses of 1 kg
        assert 0.05 * bound < largest <= bound

"""Drawstring lines and edges that become shorter, as plain Python: forces, friction, energy, bounds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from exunet.forces import closing, perimeter
from exunet.forces.blocks import Blocks
from exunet.forces.cable import AxialLaw
from exunet.forces.closing import Drawstring, elastic_once_slid, states_of, too_long, way_of
from exunet.net.arrays import Net
from exunet.net.closing import LineThroughRings, ShortenedEdge
from exunet.net.drive import Drive

Floats = np.ndarray

RING = 0.01


def line(places: Floats, **given: Any) -> tuple[closing.Line, Blocks]:
    """A line from the first of some places through rings at the others to the last; EA = 500 N."""
    n = len(places)
    none, nothing = np.zeros(0), np.zeros(0, dtype=np.int64)
    ends = np.zeros((0, 2), dtype=np.int64)
    net = Net(places, np.ones(n), ends, none, none, none, none, none.astype(bool), nothing, nothing)
    numbers: dict[str, Any] = {"path": tuple(range(n)), "length": 2.0, "stiffness": 500.0, "friction": 0.0}
    numbers |= {"linear_density": 0.0, "ring_diameter": RING}
    numbers |= {"shortest": 0.5, "largest_rate": 5.0, "has_winch": True}
    time, ratio = given.pop("time", 0.0), given.pop("ratio", 1.0)
    drawn = LineThroughRings(**(numbers | given))
    blocks = Blocks(net, places, (), states_of(drawn, places, ratio, time))
    string = Drawstring(drawn, blocks, ratio, time)
    return string.data(string.at_start), blocks


ZIGZAG = np.array([[0.0, 0.0, 0.0], [0.7, 0.4, 0.1], [0.9, -0.5, 0.2], [1.6, 0.1, -0.2], [2.0, 0.6, 0.3]])


def flat(places: Floats, *states: float) -> Floats:
    return np.concatenate([places.ravel(), states])


def turns(places: Floats) -> Floats:
    """Angles [rad] by which a polygon turns at its inner corners."""
    ways = np.diff(places, axis=0)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return np.arccos(np.einsum("ka,ka->k", ways[1:], ways[:-1]))


def slid(places: Floats, wound: float, friction: float, **given: Any) -> closing.Line:
    """A line of one tension, none unless stretched, from which a length was wound up at its start."""
    length = float(way_of(line_of(len(places)), places).sum()) / given.pop("stretched", 1.0)
    data, _ = line(places, length=length, friction=friction, **given)
    closing.settle_line(flat(places, wound, 0.0, 0.0, 0.0), data)
    return data


def line_of(n: int) -> LineThroughRings:
    return LineThroughRings(tuple(range(n)), 1.0, 1.0, 0.0, RING, 0.0)


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
def test_a_line_that_starts_taut(friction: float, ratio: float) -> None:
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


def test_a_line_stops_the_run_beyond_twice_its_length() -> None:
    """And not at twice."""
    status = closing.LineStatus(*np.zeros(7), stretch=2.0)
    assert too_long(np.array(status)) == ""
    assert "2 times as long" in too_long(np.array(status._replace(stretch=np.nextafter(2.0, 3.0))))


def test_status_of_a_line() -> None:
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
    """Length, slope and curvature go on smoothly at the diameter, and at the ring itself the slope is 0."""
    distance = RING * np.array([1e-9, 0.5, 1.0 - 1e-7, 1.0 + 1e-7, 2.0])
    two = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    length = np.array([way_of(line_of(2), d * two)[0] for d in distance])
    assert length[0] == pytest.approx(0.375 * RING)  # the formula at u = 0
    np.testing.assert_allclose(length[2:], distance[2:], rtol=1e-13)
    for d, slope, known in zip(distance, [0.0, 0.6875, 1.0, 1.0, 1.0], length, strict=True):  # 3/2 u - u^3/2
        data, _ = line(d * two)
        closing.lay_line(flat(d * two, 0.0, 0.0), data)
        assert d * data.pull[0] == pytest.approx(slope, abs=1e-8)
        assert data.way[0] == known


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_slack_line_does_not_pull(friction: float) -> None:
    """However fast it lengthens, and wherever it slid while it was taut."""
    data, blocks = line(ZIGZAG, time=0.0 if friction else 0.5, length=5.0, friction=friction)
    assert not blocks.initial_states.any()
    if friction:
        data.kept[closing.STATUS + 4 : closing.STATUS + 7] = [1.0, -1.0, 1.0]
    add = closing.add_rubbing_line if friction else closing.add_line
    v, force = np.array([[0.0], [1.0], [0.0], [1.0], [2.0]]) * [3.0, 5.0, 1.0], np.zeros(blocks.n_force)
    with np.errstate(all="raise"):
        add(0.0, flat(ZIGZAG, 0.0, 0.0, 0.0, 0.0)[: blocks.n_x], v.ravel(), data, force)
    assert not force.any()


def test_the_bounds_for_the_step_hold() -> None:
    """Against the eigenvalues of -dF/dx / m by differences, with rings apart and with rings that meet."""
    for near in (50.0, 1.0, 0.1):
        places = ZIGZAG.copy()
        places[2] = places[1] + near * RING * np.array([0.0, -0.8, 0.6])
        length = float(way_of(line_of(5), places).sum()) / math.sqrt(1.02)  # a strain of 1 %
        data, blocks = line(places, length=length, has_winch=False)
        drawn = LineThroughRings(tuple(range(5)), length, 500.0, 0.0, RING, 0.0)
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


@pytest.mark.parametrize("seed", range(4))
def test_a_line_slides_no_farther_than_it_must(seed: int) -> None:
    """Random lines and discrete states: no ratio is exceeded, line slides to higher tension, none is lost."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(12, 3))
    places[5] = places[4] + 0.3 * RING  # two rings that touch
    data, _ = line(places, length=float(way_of(line_of(12), places).sum()) * 0.99, friction=0.2)
    first = closing.STATUS
    data.kept[first : first + 11] *= rng.uniform(0.9, 1.1, size=11)
    whole = data.kept[first : first + 11].sum()
    wound = data.whole - whole + rng.uniform(-0.2, 0.2)
    closing.settle_line(flat(places, wound, 0.0, 0.0, 0.0), data)
    holds = np.exp(data.limit[:-1]) * (1.0 + 1e-9)
    assert (data.tension[1:] <= data.tension[:-1] * holds + 1e-9).all()
    assert (data.tension[:-1] <= data.tension[1:] * holds + 1e-9).all()
    slide = np.cumsum(data.old - data.material)[:-1]
    assert data.material.sum() == pytest.approx(data.whole - wound, rel=1e-12)
    taut = np.minimum(data.tension[1:], data.tension[:-1]) > 0.0
    moved = taut & (np.abs(slide) > 1e-9)
    assert moved.any() or not taut.any()
    assert (slide * (data.tension[1:] - data.tension[:-1]))[moved].min(initial=1.0) >= 0.0


def test_the_limit_of_no_friction() -> None:
    """mu = 1e-13: the forces of the line with one tension, which are written apart."""
    given = {"length": 1.9, "drives": (Drive(0.4, 5.0, 0.01),)}
    smooth, blocks = line(ZIGZAG, **given)
    rubbing, more = line(ZIGZAG, friction=1e-13, **given)
    rng = np.random.default_rng(2)
    v, n = rng.normal(size=blocks.n_v), blocks.n_v
    one, other = np.zeros(blocks.n_force), np.zeros(more.n_force)
    closing.add_line(0.0, flat(ZIGZAG, 0.2, 0.0), v, smooth, one)
    closing.add_rubbing_line(0.0, flat(ZIGZAG, 0.2, 0.0, 0.0, 0.0), v, rubbing, other)
    np.testing.assert_allclose(other[: n + 2], one, rtol=1e-9, atol=1e-9)
    assert other[n + 2] == pytest.approx(0.0, abs=1e-9)


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
        closing.lay_line(x + h * np.append(v, np.zeros(4)), data)
        turn.append(closing.turn_of(data, 0))
    closing.lay_line(x, data)
    assert closing.rate_of_turn(v, data, 0) == pytest.approx((turn[0] - turn[1]) / 2e-6, rel=1e-6)
    slopes = [1.0 if u >= 1.0 else 1.5 * u - 0.5 * u**3 for u in (first, second)]
    angle = math.acos(0.6 * 0.48 - 0.8 * 0.6)
    assert closing.turn_of(data, 0) == pytest.approx(angle * slopes[0] * slopes[1], rel=1e-12)


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
    closing.add_rubbing_line(0.0, x, v, data, force)
    assert (data.slides[:-1] != 0.0).all()

    def elastic(h: float) -> float:
        moved = x + h * np.concatenate([v, [force[n], 0.0, 0.0, 0.0]])
        closing.settle_line(moved, data)
        stretch = data.way / data.material
        return float((250.0 * (0.5 * (stretch**2 - 1.0)) ** 2 * data.material).sum())

    rate = (elastic(1e-6) - elastic(-1e-6)) / 2e-6
    taken = force[n + 1] - force[:n] @ v - rate
    assert force[n + 2] == pytest.approx(taken, rel=1e-6)
    assert force[n + 3] == pytest.approx(rate, rel=1e-6)
    assert taken > 0.1
    # Once it has been remembered where the line slid to, it is about to slide on in the same way.
    closing.remember_rubbing(0.0, x, v, data)
    again = np.zeros(blocks.n_force)
    closing.add_rubbing_line(0.0, x, v, data, again)
    np.testing.assert_allclose(again, force, rtol=1e-9, atol=1e-9)


ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
LENGTH = np.array([0.8, 0.9, 1.1, 1.3, 1.0])
STIFFNESS = np.array([30.0, 50.0, 70.0, 20.0, 40.0])


def edge(
    mass: Floats, law: AxialLaw, elements: tuple[int, ...] = (3, 0, 1), **given: float
) -> perimeter.Shortening:
    """Some elements of a small net, which begin to become shorter at 0.1 s, by 2 / s, down to 0.6."""
    n = len(mass)
    nothing = np.zeros(0, dtype=np.int64)
    net = Net(np.zeros((n, 3)), mass, ENDS, LENGTH, STIFFNESS, STIFFNESS, STIFFNESS,
              np.zeros(5, dtype=bool), nothing, nothing)  # fmt: skip
    one = ShortenedEdge(elements, **({"at": 0.1, "rate": 2.0, "part": 0.6} | given))
    return perimeter.Shortening(one, Blocks(net, np.zeros((n, 3)), (), perimeter.states_of(one)), law)


@pytest.mark.parametrize("time", [None, 0.02])
def test_force_work_and_energy_of_threads(time: float | None) -> None:
    """-dU/dx on the nodes, the power of what shortens, by differences; what is left is what viscosity takes.

    Each thread pulls by EA (e + tau de/dt) lambda, and not at all where it is slack.
    """
    random = np.random.default_rng(4)
    law = AxialLaw(LENGTH, STIFFNESS, None if time is None else np.full(5, time))
    one = edge(np.full(4, 0.5), law)
    assert one.elements == (3, 0, 1)
    data, taut = one.data(np.ones(1)), 0
    assert one.data(np.zeros(1)).falls == one.data(np.full(1, 2.0)).falls == 0.0
    for _ in range(4):
        x = np.append(random.normal(scale=0.5, size=12), [0.8, 0.0])
        v, force = random.normal(scale=0.4, size=12), np.zeros(14)
        perimeter.add_threads(0.0, x, v, data, force)
        assert force[12] == -2.0
        pulls = np.zeros((4, 3))
        moved = [x + sign * 1e-6 * np.append(v, [-2.0, 0.0]) for sign in (1.0, -1.0)]
        for e in one.elements:
            (i, j), strain = ENDS[e], []
            for y in (x, *moved):
                span, natural = y[3 * j : 3 * j + 3] - y[3 * i : 3 * i + 3], y[12] * LENGTH[e]
                strain.append(0.5 * (span @ span / natural**2 - 1.0))
            span, natural = x[3 * j : 3 * j + 3] - x[3 * i : 3 * i + 3], x[12] * LENGTH[e]
            whole = strain[0] + (time or 0.0) * (strain[1] - strain[2]) / 2e-6
            pull = STIFFNESS[e] * max(whole, 0.0) * span / natural if strain[0] > 0.0 else 0.0 * span
            taut += strain[0] > 0.0
            pulls[i] += pull
            pulls[j] -= pull
        np.testing.assert_allclose(force[:12], pulls.ravel(), rtol=1e-7, atol=1e-7)
        slope = np.zeros(13)
        for k in range(13):
            step = 1e-6 * np.eye(14)[k]
            ends = [perimeter.energy_of_threads(x + sign * step, data) for sign in (1.0, -1.0)]
            slope[k] = (ends[0] - ends[1]) / 2e-6
        if time is None:
            np.testing.assert_allclose(force[:12], -slope[:12], rtol=1e-6, atol=1e-6)
            assert force[13] == pytest.approx(-2.0 * slope[12], rel=1e-6)
        # The power of what shortens goes into the nodes, into the elastic energy, and into viscosity.
        balance = force[13] - force[:12] @ v - slope[:12] @ v + 2.0 * slope[12]
        assert perimeter.power_in_threads(0.0, x, v, data) == pytest.approx(balance, rel=1e-6, abs=1e-6)
    assert 4 < taut < 12


def test_threads_whose_ends_meet_do_not_pull() -> None:
    one = edge(np.full(4, 0.5), AxialLaw(LENGTH, STIFFNESS, np.full(5, 0.02)))
    x, force = np.append(np.full(12, 0.3), [0.7, 0.0]), np.zeros(14)
    perimeter.add_threads(0.0, x, np.ones(12), one.data(np.ones(1)), force)
    assert force.tolist() == [0.0] * 12 + [-2.0, 0.0]

"""Strings of a folded net, by hand: straight, to and fro, of a bridle, and round what is in the way."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from result_samples import net
from test_meeting import apart

from exunet.net.arrays import Net
from exunet.net.folding import with_strings
from exunet.net.mesh_checks import between_segments

THREAD = 0.01
CORNER = np.array([0.4, -0.3, 0.2])
FLAT = np.array([2.0, 1.0, 0.5])  # of the corner
LENGTH = 0.6  # of an element of a string
WAY = np.array([2.0, -1.0, 2.0]) / 3.0  # to the bullet in the flat net
FORWARD = np.array([1.0, -1.0, 1.0])  # so that y is turned round


def hung(divisions: int, threads: list[np.ndarray]) -> tuple[Net, np.ndarray, np.ndarray]:
    """A string from bullet 0 to corner 1, and threads (2, 3) that it shares no node with; places, forward."""
    inner = [FLAT + WAY * LENGTH * (divisions - k) for k in range(1, divisions)]
    nodes = [FLAT + WAY * LENGTH * divisions, FLAT, *inner, *(end for thread in threads for end in thread)]
    chain = [0, *range(2, divisions + 1), 1]
    first = divisions + 1
    own = [(first + 2 * k, first + 2 * k + 1) for k in range(len(threads))]
    elements = [*own, (1, first), *pairwise(chain)]
    of = net(nodes, elements, strings=tuple(range(len(own) + 1, len(elements))))
    place = np.array(nodes)
    place[1] = CORNER
    place[0], place[2:first] = np.nan, np.nan
    return of, place, np.tile(FORWARD, (len(nodes), 1))


AWAY = [np.array([(-5.0, 0.0, 0.0), (-6.0, 0.0, 0.0)])]
OUTWARD = WAY * FORWARD


def test_a_string_of_one_element_is_straight() -> None:
    """0.95 of its length, outward as in the flat net by the way that the corner's pleat runs."""
    of, place, forward = hung(1, AWAY)
    found = with_strings(of, place, forward, THREAD)
    np.testing.assert_allclose(found[0], CORNER + 0.95 * LENGTH * OUTWARD, rtol=1e-14)
    np.testing.assert_array_equal(found[1:], place[1:])


@pytest.mark.parametrize("divisions", [2, 5])
@pytest.mark.parametrize("thread", [THREAD, 0.004])
def test_a_divided_string_lies_to_and_fro(divisions: int, thread: float) -> None:
    """From the corner on: a node far outward and one beside the corner in turn, each a thread further aside.

    Elements keep the mean of 0.95 and 1 of their length; beside the corner is 3 threads outward, at most 0.04
    of an element.
    """
    of, place, forward = hung(divisions, AWAY)
    found = with_strings(of, place, forward, thread)
    aside = np.array([-OUTWARD[1], OUTWARD[0], 0.0]) / math.hypot(OUTWARD[0], OUTWARD[1])
    chain = [1, *range(divisions, 1, -1), 0]
    far, near = math.sqrt((0.975 * LENGTH) ** 2 - thread**2), min(3.0 * thread, 0.04 * LENGTH)
    for k, node in enumerate(chain):
        out = 0.0 if k == 0 else far if k % 2 else near
        np.testing.assert_allclose(found[node], CORNER + out * OUTWARD + k * thread * aside, atol=1e-14)


def test_a_string_along_the_axis_goes_aside_along_x() -> None:
    of = net(
        [(0.0, 0.0, 3.0), (0.0, 0.0, 2.0), (0.0, 0.0, 1.0), (5.0, 0.0, 1.0)],
        [(2, 3), (0, 1), (1, 2)],
        strings=(1, 2),
    )
    found = with_strings(of, of.reference_position, np.ones((4, 3)), THREAD)
    far = math.sqrt(0.975**2 - THREAD**2)
    np.testing.assert_allclose(found[1], [THREAD, 0.0, 1.0 + far], atol=1e-14)
    np.testing.assert_allclose(found[0], [2 * THREAD, 0.0, 1.0 + 3 * THREAD], atol=1e-14)


@pytest.mark.parametrize("divisions", [1, 3])
def test_a_bridle_is_in_the_plane_of_its_corners(divisions: int) -> None:
    """Its bullet is as far from both, on the side that is outward in the flat net."""
    flat = np.array([(1.0, -0.4, 0.0), (1.0, 0.4, 0.0)])
    bullet = np.array([3.0, 0.0, 0.5])
    there = np.array([(0.2, 0.1, 0.3), (0.5, 0.7, 0.1)])
    nodes, elements = [bullet, *flat, np.array([-5.0, 0.0, 0.0])], [(1, 3), (2, 3)]
    strings = []
    for corner in (1, 2):
        parts = [bullet + (nodes[corner] - bullet) * k / divisions for k in range(1, divisions)]
        chain = [0, *range(len(nodes), len(nodes) + len(parts)), corner]
        nodes += parts
        strings += pairwise(chain)
    of = net(nodes, elements + strings, strings=tuple(range(2, 2 + len(strings))))
    place = np.array(nodes)
    place[1:3] = there
    found = with_strings(of, place, np.ones((len(nodes), 3)), THREAD)
    string = 0.95 * float(np.linalg.norm(flat[0] - bullet))
    outward = (bullet - (1.0, 0.0, 0.0)) / np.linalg.norm(bullet - (1.0, 0.0, 0.0))
    half = 0.5 * (there[1] - there[0])
    across = half / np.linalg.norm(half)
    way = outward - (outward @ across) * across
    way /= np.linalg.norm(way)
    apex = there.mean(axis=0) + math.sqrt(string**2 - half @ half) * way
    np.testing.assert_allclose(found[0], apex, rtol=1e-13)
    for k, corner in enumerate((1, 2)):
        for part in range(1, divisions):
            node = 3 + k * (divisions - 1) + part
            known = apex + (there[corner - 1] - apex) * part / divisions
            np.testing.assert_allclose(found[node], known, rtol=1e-13)


def ways() -> list[np.ndarray]:
    """Outward, and then turned away from it by 5 degrees more each time, all round in steps of 15."""
    across = np.cross(OUTWARD, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    up = np.cross(across, OUTWARD)
    found = [OUTWARD]
    for turn in range(5, 95, 5):
        for around in range(0, 360, 15):
            t, a = math.radians(turn), math.radians(around)
            found.append(math.cos(t) * OUTWARD + math.sin(t) * (math.cos(a) * across + math.sin(a) * up))
    return found


def around(outward: np.ndarray, away: float, rng: np.random.Generator) -> np.ndarray:
    """A thread (2, 3) of 0.4 m, normal to a way from the corner, at some distance on it."""
    way = np.cross(outward, rng.normal(size=3))
    return CORNER + away * outward + np.outer([-0.15, 0.25], way / np.linalg.norm(way))


@pytest.mark.parametrize("divisions", [1, 2])
@pytest.mark.parametrize("part", [0.3, 0.9])
@pytest.mark.parametrize("thread", [THREAD, 0.06])
def test_a_string_goes_round_what_is_in_its_way(divisions: int, part: float, thread: float) -> None:
    """The first way on which no thread that shares no node with it comes nearer than one."""
    rng = np.random.default_rng(7)
    threads = [around(OUTWARD, part * LENGTH, rng) for _ in range(3)]
    of, place, forward = hung(divisions, [*AWAY, *threads])
    found = with_strings(of, place, forward, thread)
    chosen = clear_way(divisions, threads, thread)
    assert chosen is not None
    assert chosen > 0
    np.testing.assert_allclose(
        found[[0, *range(2, divisions + 1)]],
        pieces(divisions, ways()[chosen], thread)[::-1][:divisions],
        atol=1e-13,
    )


def test_where_no_way_is_clear_the_clearest_is_taken() -> None:
    """Threads on all sides."""
    rng = np.random.default_rng(3)
    sides = [item / np.linalg.norm(item) for item in rng.normal(size=(25, 3))]
    threads = [around(side, rng.uniform(0.2, 0.4), rng) for side in sides]
    of, place, forward = hung(1, [*AWAY, *threads])
    found = with_strings(of, place, forward, 0.19)
    clear = [clearance(pieces(1, way, 0.19), threads) for way in ways()]
    assert max(clear) < 0.19
    best = int(np.argmax(clear))
    assert 0 < best < len(clear) - 1
    np.testing.assert_allclose(found[0], CORNER + 0.95 * LENGTH * ways()[best], atol=1e-13)


def pieces(divisions: int, way: np.ndarray, thread: float) -> np.ndarray:
    """(divisions + 1, 3) from the corner on."""
    if divisions == 1:
        return np.array([CORNER, CORNER + 0.95 * LENGTH * way])
    aside = np.array([-way[1], way[0], 0.0]) / math.hypot(way[0], way[1])
    far, near = math.sqrt((0.975 * LENGTH) ** 2 - thread**2), min(3.0 * thread, 0.04 * LENGTH)
    return np.array([CORNER, CORNER + far * way + thread * aside, CORNER + near * way + 2.0 * thread * aside])


def clearance(line: np.ndarray, threads: list[np.ndarray]) -> float:
    own = np.stack([line[:-1], line[1:]], axis=1)
    pairs = np.repeat(own, len(threads), axis=0), np.tile(np.array(threads), (len(own), 1, 1))
    return float(between_segments(*pairs).min())


def clear_way(divisions: int, threads: list[np.ndarray], thread: float) -> int | None:
    for k, way in enumerate(ways()):
        if clearance(pieces(divisions, way, thread), threads) >= thread * (1.0 - 1e-6):
            return k
    return None


def test_strings_go_round_each_other() -> None:
    """Two corners whose strings would cross: the second turns away from the first."""
    flat = np.array([(1.0, 0.1, 0.0), (1.0, -0.1, 0.0)])
    bullets = flat + np.array([(0.6, 0.8, 0.0), (0.6, -0.8, 0.0)])
    of = net([*bullets, *flat, (-5.0, 0.0, 0.0)], [(2, 4), (3, 4), (0, 2), (1, 3)], strings=(2, 3))
    place = of.reference_position.copy()
    place[2:4] = place[3:1:-1]
    found = with_strings(of, place, np.ones((5, 3)), THREAD)
    first = np.array([place[2], place[2] + 0.95 * (bullets[0] - flat[0])])
    np.testing.assert_allclose(found[0], first[1], rtol=1e-14)
    second = np.array([place[3], found[1]])
    assert apart(first, np.array([place[3], place[3] + 0.95 * (bullets[1] - flat[1])])) < 1e-9
    assert apart(first, second) >= THREAD * (1.0 - 1e-6)
    turned = (second[1] - second[0]) @ (bullets[1] - flat[1]) / 0.95
    assert turned == pytest.approx(math.cos(math.radians(5.0)), rel=1e-12)

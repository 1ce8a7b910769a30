"""What a script looks at, by hand: of numbers of discrete states, of points, of the centre of the net."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scripts import NET, case_of
from test_reels import command, start_of

from exunet.model.script import (
    VALUES,
    EndStates,
    Sources,
    centre_weights,
    has_touched,
    observed_entries,
)
from exunet.model.states import States
from exunet.simulation.preparation import Start, prepare_case

NOTHING: Any = None


def test_numbers_of_discrete_states() -> None:
    """The larger of two tensions; pairs of two contacts, which add; the first touch of either, 0 s too."""
    told = np.array([
        [3.0, 2.0, 1.0, 4.0, -1.0, -1.0],
        [1.0, 2.5, 0.0, 0.0, -1.0, 0.0],
        [0.0, 0.0, 2.0, 0.0, 0.3, -1.0],
        [9.0, 8.0, 7.0, 6.0, 0.3, 0.4],
    ])  # fmt: skip
    sight = Sources(NOTHING, None, (("line", 0), ("line", 1)), (("a", 2), ("b", 2)), (("a", 3), ("b", 3)))
    look = EndStates(lambda: NOTHING, told)
    assert VALUES["closing_tension"](sight, look).tolist() == [3.0, 2.5, 0.0, 9.0]
    assert VALUES["touching"](sight, look).tolist() == [5.0, 0.0, 2.0, 13.0]
    assert has_touched(sight, told).tolist() == [False, True, True, True]
    alone = Sources(NOTHING, None, (), (("a", 2),), (("a", 3),))
    assert has_touched(alone, np.array([[4.0, -1.0], [-1.0, 0.5]])).tolist() == [False, True]
    assert sight.reports == (("line", 0), ("line", 1), ("a", 2), ("b", 2), ("a", 3), ("b", 3))


def test_the_centre_of_a_net_from_a_target() -> None:
    """From all states, and from means of the loop; what a mouth of three corners spans."""
    start = prepare_case(case_of("", scene=NET))
    system, rng = start.system, np.random.default_rng(2)
    x, v = (np.tile(part, (3, 1)) for part in system.layout.pack(start.state.moving))
    x[:, :15], v[:, :15] = rng.normal(size=(2, 3, 15))
    time = np.array([0.1, 0.2, 0.3])
    states = States(system, time, x, v, system.discrete)
    sight, look = Sources.of(system, "target"), EndStates(lambda: states, np.zeros((3, 0)))
    sides = 2.0, 2.0 * math.sqrt(3.0)  # half of each is at either end
    mass = np.array([3.0 * sides[0], *[sides[0] + 2.0 * sides[1]] * 3])
    x, v = (part[:, :15].reshape(3, 5, 3) for part in (x, v))
    place, speed = (np.einsum("n,kna->ka", mass / mass.sum(), part[:, :4]) for part in (x, v))
    for mean in (None, np.concatenate([place, speed], axis=1)):
        one = EndStates(lambda: states, np.zeros((3, 0)), mean)
        apart = np.linalg.norm(place - x[:, 4], axis=1)
        np.testing.assert_allclose(VALUES["range"](sight, one), apart, rtol=1e-13)
        against = np.linalg.norm(speed - v[:, 4], axis=1)
        np.testing.assert_allclose(VALUES["relative_speed"](sight, one), against, rtol=1e-13)
    a, b, c = (x[:, k] for k in (1, 2, 3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    np.testing.assert_allclose(VALUES["area"](sight, look), area, rtol=1e-12)
    widest = np.max([np.linalg.norm(item, axis=1) for item in (a - b, b - c, c - a)], axis=0)
    np.testing.assert_allclose(VALUES["mouth_diameter"](sight, look), widest, rtol=1e-12)
    assert VALUES["time"](sight, look).tolist() == time.tolist()


def test_entries_that_are_looked_at() -> None:
    """Of x those of the points that a quantity needs, and all beyond; of v those where velocities count."""
    start = prepare_case(case_of("", scene=NET))
    system, sight = start.system, Sources.of(start.system, "target")
    body, turns = list(range(12, system.blocks.n_x)), list(range(12, system.blocks.n_v))
    for names, points in (({"area"}, range(3, 12)), ({"mouth_diameter"}, range(3, 12)), ({"time"}, range(0))):
        found = observed_entries(sight, names)
        assert [item.tolist() for item in found] == [[*points, *body], turns]
    assert centre_weights(sight, {"area"}).size == 0
    np.testing.assert_allclose(centre_weights(sight, {"range"}), system.net.mass / system.net.mass.sum())
    assert [entry.tolist() for entry in observed_entries(sight, {"range"})] == [body, turns]


def test_the_tension_of_a_tether() -> None:
    """EA (e^2 - 1) e / 2 of an element that is e times as long: of all but those on the drum.

    1.1 m of 4 m are wound up: elements 0 and 1 lie on the drum, 0.4 m of element 2 are out.
    """
    start: Start = start_of(commands=command(0.5, "lock"))
    system = start.system
    (tether,) = start.net.tethers
    for stretched, e in ((0, 1.03), (3, 1.02), (5, 1.01)):
        state = States.of(system, start.state)
        place = np.array(state.position)
        along = np.cumsum([0.0, 0.0, 0.0, 0.38, *[0.48] * 5])
        grown = np.zeros(9)
        first = 3 if stretched == 0 else 3 + stretched - 1
        grown[first:] = (0.4 if stretched == 0 else 0.5) * e - (0.38 if stretched == 0 else 0.48)
        place[0, list(tether.nodes)] = place[0, tether.nodes[0]] + np.outer(along + grown, [0.0, 0.6, 0.8])
        x, _ = system.layout.pack(state.moving._replace(position=place))
        moved = States(system, state.time, x, state.v, state.discrete)
        found = VALUES["tether_tension"](
            Sources.of(system, None), EndStates(lambda s=moved: s, np.zeros((1, 0)))
        )
        assert found[0] == pytest.approx(1e3 * e * (e * e - 1.0) / 2.0, rel=1e-9)

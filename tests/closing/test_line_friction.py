"""The loops of a closing line with friction at its rings: where it slides, and what that takes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from laid_lines import RING, ZIGZAG, flat, line, line_of, slid, turns

from exunet.forces import closing
from exunet.forces.closing import way_of
from exunet.net.drive import Drive

Floats = np.ndarray


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


def test_hardly_any_friction_is_none() -> None:
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


def test_a_piece_from_which_nearly_all_line_was_wound_up() -> None:
    """EA (s^3 - s) / 2 down to a thousandth of its way; 1000 EA below that: it takes some of others."""
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    for left, tension in ((1e-3, 250.0 * (500.0**3 - 500.0)), (4e-4, 500.0 * 1e3)):
        data, _ = line(places, friction=0.3, length=1.0)
        closing.settle_line(flat(places, 1.0 - left, 0.0, 0.0, 0.0), data)
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
        closing.lay_line(x + h * np.append(v, np.zeros(4)), data)
        turn.append(closing.turn_of(data, 0))
    closing.lay_line(x, data)
    assert closing.rate_of_turn(v, data, 0) == pytest.approx((turn[0] - turn[1]) / 2e-6, rel=1e-6)
    slopes = [1.0 if u >= 1.0 else 1.5 * u - 0.5 * u**3 for u in (first, second)]
    angle = math.acos(0.6 * 0.48 - 0.8 * 0.6)
    assert closing.turn_of(data, 0) == pytest.approx(angle * slopes[0] * slopes[1], rel=1e-12)


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
            closing.lay_line(flat(np.array(places), 0.0, 0.0, 0.0, 0.0), data)
        assert closing.rate_of_turn(v, data, 0) == 0.0


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

"""The star by its rules, knot by knot, in complex numbers and by every choice of lengths."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from exunet.base.errors import CaseError
from exunet.net import AnyNetConfig, weave
from exunet.net.folding import Fold, Folded, folded

THREAD = 1e-3
CABLE = {"diameter": THREAD, "density": 1390.0, "youngs_modulus": 7e10}
KEYS = TypeAdapter(AnyNetConfig)
LEVELS = [0.99 - 0.005 * k for k in range(18)]  # of their lengths that a ring's side and a spoke may keep
WEBS = {"eight": (8, 10, 2.5), "four": (4, 5, 2.0), "six": (6, 7, 2.5), "twelve": (12, 8, 2.5)}


def outer_meeting(one: complex, its: float, other: complex, others: float) -> complex | None:
    """Of the points at two distances from two places that with the larger real part."""
    apart = abs(other - one)
    if not abs(its - others) <= apart <= its + others:
        return None
    cosine = (apart**2 + its**2 - others**2) / (2.0 * apart * its)
    way = (other - one) / apart * its
    aside = 1j * math.sqrt(max(0.0, 1.0 - cosine**2))
    return max((one + way * (cosine + aside), one + way * (cosine - aside)), key=lambda z: z.real)


def profile(web: tuple[int, int, float], per_pleat: int, layer: float) -> tuple[list[complex], list[complex]]:
    """Of the knots at the axis and at the tips, ring by ring: distance from the axis + i times height."""
    spokes, rings, radius = web
    turn, step = 2.0 * math.pi / spokes, radius / rings
    axis, tips = [0j], [0j]
    for ring in range(1, rings + 1):
        pleat, within = divmod(ring - 1, per_pleat)
        on_crease = within == per_pleat - 1 and ring < rings
        away = (0.5 + pleat + 0.5 * on_crease) * layer / math.sin(turn)
        rise = math.sqrt((0.99 * step) ** 2 - (away - axis[-1].real) ** 2)
        axis.append(complex(away, axis[-1].imag - rise * (-1) ** pleat))
        chord, beside = 2.0 * math.sin(turn / 2) * step * ring, away * math.sin(turn)
        found = {}
        for a in LEVELS:
            for b in LEVELS:
                if (square := (a * chord) ** 2 - beside**2) > 0.0:
                    centre = complex(away * math.cos(turn), axis[-1].imag)
                    met = outer_meeting(tips[-1], b * step, centre, math.sqrt(square))
                    if met is not None and met.real > tips[-1].real - 1e-9:
                        found[round(min(a, b), 6), round(a + b, 6), a] = met
        tips.append(found[max(found)])
    return axis, tips


def fold(web: tuple[int, int, float], others: Any = (), **how: Any) -> Folded:
    spokes, rings, radius = web
    table = {"topology": "radial", "radius": radius, "spokes": spokes, "rings": rings, "cable": CABLE}
    keys = KEYS.validate_python(table | dict(others))
    return folded(weave(keys), keys, Fold.model_validate({"pattern": "star"} | how))


CHOSEN = [("eight", 3.0, 10), ("eight", 2.3, 9), ("eight", 0.8, 3), ("four", 2.1, 5), ("six", 3.0, 7)]
CHOSEN += [("six", 2.3, 6), ("twelve", 0.35, 1), ("twelve", 3.0, 8), ("twelve", 0.7, 2)]


@pytest.mark.parametrize(("name", "height", "per_pleat"), CHOSEN)
def test_every_knot_of_a_star(name: str, height: float, per_pleat: int) -> None:
    """Of the longest pleats that are no higher than the box; the first knot tells how far layers lie apart.

    Spokes keep 0.99 of their lengths at the axis, so a pleat of k rings is about 0.99 k steps high.
    """
    spokes, rings, _ = web = WEBS[name]
    found = fold(web, box=[9.0, 9.0, height])
    assert found.pleats == f"{spokes // 2} arms, {math.ceil(rings / per_pleat)} pleats along the axis"
    assert found.layers == math.ceil(rings / per_pleat)
    position, turn = found.position[1:].reshape(rings, spokes, 3), 2.0 * math.pi / spokes
    layer = position[0, 0, 0] * math.sin(turn) / (0.5 if per_pleat > 1 else 1.0)
    assert layer > THREAD * (1.0 - 1e-9)
    axis, tips = profile(web, per_pleat, layer)
    heights = [tip.imag for tip in (*axis, *tips)]
    middle = 0.5 * (max(heights) + min(heights))
    np.testing.assert_allclose(found.position[0], [0.0, 0.0, -middle], atol=1e-12)
    for first, line in ((0, axis), (1, tips)):
        own, ring = position[:, first::2], np.array(line[1:])
        turns = np.exp(1j * turn * np.arange(first, spokes, 2))
        np.testing.assert_allclose(own @ [1.0, 1j, 0.0], ring.real[:, None] * turns, atol=1e-12)
        np.testing.assert_allclose(own[..., 2] - ring.imag[:, None], -middle, atol=1e-12)
    across = 2.0 * max(item.real for item in (*axis, *tips)) + THREAD
    known = [across, across, max(heights) - min(heights) + THREAD]
    np.testing.assert_allclose(found.size, known, rtol=1e-12)
    again = fold(web, box=[9.0, 9.0, known[2] * (1.0 - 5e-10)])  # to round-off it fits
    # With layers a thread apart some are a little higher; then one of those that fit at once is taken.
    same = np.array_equal(again.position, found.position)
    assert same == (layer < 1.001 * THREAD)


def test_a_star_that_fits_nowhere_is_told_by_the_nearest_to_it() -> None:
    """Of all numbers of rings in a pleat; in a box, and in a cylinder of the radius that it needs."""
    room, (_, rings, radius) = (0.3, 0.25), WEBS["twelve"]
    heights = [radius / rings * (k + 0.2) for k in range(1, rings + 1)]
    stars = [fold(WEBS["twelve"], box=[9.0, 9.0, height]).size for height in heights]
    nearest = min(range(rings), key=lambda k: max(stars[k][0] / room[0], stars[k][2] / room[1]))
    assert 0 < nearest < rings - 1
    size = stars[nearest]
    with pytest.raises(CaseError) as caught:
        fold(WEBS["twelve"], box=[room[0], *room])
    told = re.findall(r"takes ([\d.]+) m across and ([\d.]+) m along the axis; box", str(caught.value))[0]
    np.testing.assert_allclose([float(item) for item in told], size[[0, 2]], rtol=1e-3)
    with pytest.raises(CaseError) as caught:
        fold(WEBS["twelve"], cylinder=[0.5 * room[0], room[1]])
    told = re.findall(r"cylinder = \[([\d.]+), ([\d.]+)\]", str(caught.value))[0]
    np.testing.assert_allclose([float(entry) for entry in told], [size[0] / 2, size[2]], rtol=2e-3)


def test_threads_are_straight_between_the_knots_of_a_star() -> None:
    """One ring in a pleat, each thread divided into three; bullets come first, knots, inner nodes."""
    spokes, rings, radius = web = WEBS["twelve"]
    more = {"divisions": 3, "strings": CABLE | {"length": 1.0}, "bullets": {"mass": 0.5}}
    position = fold(web, more, box=[9.0, 9.0, 0.35]).position
    number = 1 + spokes * rings
    knots = position[spokes : spokes + number]
    angles = 2.0 * math.pi / spokes * np.arange(spokes)
    ways = knots[1:].reshape(rings, spokes, 3) @ [1.0, 1j, 0.0]
    np.testing.assert_allclose(ways * np.exp(-1j * angles), abs(ways), rtol=1e-12)
    assert (np.diff(abs(ways), axis=0) > 0.0).all()
    table = {"topology": "radial", "radius": radius, "spokes": spokes, "rings": rings, "cable": CABLE}
    i, j = weave(KEYS.validate_python(table)).element_nodes.T  # one element a thread
    inner = position[spokes + number :].reshape(len(i), 2, 3)
    np.testing.assert_allclose(inner[:, 0], (2.0 * knots[i] + knots[j]) / 3.0, atol=1e-14)
    np.testing.assert_allclose(inner[:, 1], (knots[i] + 2.0 * knots[j]) / 3.0, atol=1e-14)

"""Round numbers at an axis of given length: as many as have room, and never fewer than two."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from exunet.figures.page import text_width
from exunet.figures.style import SMALL

Floats = NDArray[np.float64]

MOST = 7
_BESIDE, _ABOVE = 5.0, 6.0  # points kept free between two numbers


def ticks(low: float, high: float, side: float, horizontal: bool, beyond: float = 0.0) -> tuple[Floats, bool]:
    """Two to seven multiples of 1, 2 or 5 times a power of ten from `low` to `high`, and if they have room.

    side       : length of the axis [inch]
    horizontal : whether the numbers stand beside each other, or above
    beyond     : how far the outer numbers may reach past the ends of the axis [inch]

    Where no two have room, they are the outer ones of the broadest step that has two.
    """
    scale = 72.0 * side / (high - low)
    outer, pair, most = None, None, None
    for step, at in _multiples(low, high):
        outer = at[[0, -1]] if outer is None else outer
        sizes = np.array([_size(value, step, horizontal) for value in at])
        inside = np.minimum(at - low, high - at) * scale + 72.0 * beyond >= sizes / 2
        at, sizes = at[inside], sizes[inside]
        if 2 <= len(at) <= MOST and _apart(at * scale, sizes, horizontal):
            most = at
        elif pair is None and len(at) >= 2 and _apart(at[[0, -1]] * scale, sizes[[0, -1]], horizontal):
            pair = at[[0, -1]]
    roomy = pair if most is None else most
    assert outer is not None  # half of the broadest step has two
    return (outer, False) if roomy is None else (roomy, True)


def _multiples(low: float, high: float) -> Iterator[tuple[float, Floats]]:
    """Steps from broad to fine, with their multiples within the limits, of two to some more than seven."""
    power = math.ceil(math.log10(high - low))
    for down in range(3):
        for factor in (5, 2, 1):
            step = factor * 10.0 ** (power - down)
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            at = step * np.arange(first, last + 1, dtype=np.float64)
            if 2 <= len(at) <= 2 * MOST:
                yield step, at


def _apart(places: Floats, sizes: Floats, horizontal: bool) -> bool:
    between = np.diff(places) - (sizes[1:] + sizes[:-1]) / 2
    return bool(between.min() >= (_BESIDE if horizontal else _ABOVE))


def _size(value: float, step: float, horizontal: bool) -> float:
    """Length of a number along the axis [points]."""
    if not horizontal:
        return SMALL
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    words = f"{value:.{decimals}f}" if abs(value) < 1e6 else f"{value:.3g}"
    return text_width(words.replace("-", "\N{MINUS SIGN}"), SMALL)

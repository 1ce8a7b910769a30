"""Integrals along many pieces at once, by Gauss and Legendre's rule on ever shorter halves.

A piece is done when the rule on its two halves agrees with that on the whole within _ALIKE of a measure of
its line; what the halves are wrong by then is about the square of that, as the rule converges geometrically.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.rounded import Pieces

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(12)
_ALIKE = 1e-11
_HALVINGS = 30

Density = Callable[[Ints, Floats], Floats]


def integrals(density: Density, pieces: Pieces, lines: int, measure: Ints, blur: Floats) -> Floats:
    """Integrals (lines, c) of density(line (q,), s (q, g)) -> (q, g, c) over the pieces of each line.

    measure (c,): which of the c components, all positive, measures how large an integral can be.
    blur (lines,): round-off of the density, over its measure times the greatest of it.
    """

    def rule(line: Ints, begin: Floats, end: Floats) -> Floats:
        half = 0.5 * (end - begin)
        s = 0.5 * (begin + end)[:, None] + half[:, None] * _NODE
        return np.asarray(half[:, None] * np.einsum("g,qgc->qc", _WEIGHT, density(line, s)))

    line, begin, end = pieces.line, pieces.begin, pieces.end
    total, size = np.zeros((2, lines, len(measure)))
    whole = rule(line, begin, end)
    np.add.at(size, line, whole)
    wrong = np.maximum(_ALIKE, blur)[:, None] * size[:, measure]
    for _ in range(_HALVINGS):
        if not len(line):
            break
        middle = 0.5 * (begin + end)
        halves = rule(line, begin, middle), rule(line, middle, end)
        both = halves[0] + halves[1]
        rest = np.any(np.abs(both - whole) > wrong[line], axis=1)
        np.add.at(total, line[~rest], both[~rest])
        line = np.tile(line[rest], 2)
        begin, end = (
            np.concatenate((begin[rest], middle[rest])),
            np.concatenate((middle[rest], end[rest])),
        )
        whole = np.concatenate((halves[0][rest], halves[1][rest]))
    np.add.at(total, line, whole)
    return total


def split(value: Callable[[Ints, Floats], Floats], pieces: Pieces) -> Pieces:
    """The pieces, divided where value(line (q,), s (q, g)) -> (q, g) is zero.

    Zeros are enclosed between 17 looks at each piece; two of them between two looks stay unseen, and are
    left to the halving of `integrals`.
    """
    look = np.linspace(0.0, 1.0, 17)
    s = pieces.begin[:, None] + (pieces.end - pieces.begin)[:, None] * look
    above = value(pieces.line, s) > 0.0
    row, column = np.nonzero(above[:, 1:] != above[:, :-1])
    if not len(row):
        return pieces
    line, low, high, rising = pieces.line[row], s[row, column], s[row, column + 1], above[row, column + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        later = (value(line, middle[:, None])[:, 0] > 0.0) == rising
        low, high = np.where(later, low, middle), np.where(later, middle, high)
    kept = np.concatenate((np.arange(len(pieces.line)), np.arange(len(pieces.line)), row, row))
    mark = np.concatenate((pieces.begin, pieces.end, 0.5 * (low + high), 0.5 * (low + high)))
    order = np.lexsort((mark, kept))
    marks, owner = mark[order].reshape(-1, 2), kept[order].reshape(-1, 2)[:, 0]
    return Pieces(pieces.line[owner], marks[:, 0], marks[:, 1])

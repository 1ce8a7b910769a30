"""Arithmetic that keeps mirror symmetries exactly: the order in which a node adds the forces of its elements.

Floating-point addition commutes but does not associate.  Sums at mirrored nodes agree to the last bit if the
tree of their additions looks the same after the mirror has permuted its leaves.  Here each element end gets a
leaf by the direction in which the element leaves the node in the reference configuration: directions that the
mirrors x -> -x, y -> -y, x <-> y carry into one another form a class of eight leaves,
[steep][crossed][left], with

    left    : it points to x < 0,
    crossed : it points to xy < 0,
    steep   : |y| > |x|;

each mirror maps pairs of leaves to pairs, and pairs of pairs likewise, so adding along the last axis, then
the next, then the next, then class after class, commutes with all of them.  A node need not know where the
mirrors' lines are.
"""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.net import Net

_EQUAL = 1e-9  # directions (unit vectors) closer than this are the same


def leaves(net: Net) -> Ints:
    """(classes, 2, 2, 2, n): the contribution on each leaf of each node's tree of additions.

    Contribution e < m is that of element e to its end j, m + e that to its end i, 2m is zero.
    """
    m, n = len(net.reference_length), len(net.mass)
    i, j = net.element_nodes.T
    along = net.direction
    node = np.concatenate((j, i)).tolist()
    classes: list[dict[tuple[float, ...], Ints]] = [{} for _ in range(n)]
    for contribution, (x, y, z) in enumerate(np.concatenate((-along, along)).tolist()):
        left, crossed = int(x < -_EQUAL), int(x < -_EQUAL) ^ int(y < -_EQUAL)
        steep = int(abs(y) > abs(x) + _EQUAL)
        kind = (round(max(abs(x), abs(y)), 8), round(min(abs(x), abs(y)), 8), round(z, 8))
        trees, twin = classes[node[contribution]], 0
        while True:  # elements laid twice share a direction; each copy gets a tree of its own
            tree = trees.setdefault((*kind, twin), np.full((2, 2, 2), 2 * m, dtype=np.intp))
            if tree[steep, crossed, left] == 2 * m:
                break
            twin += 1
        tree[steep, crossed, left] = contribution
    result = np.full((max(map(len, classes), default=0), 2, 2, 2, n), 2 * m, dtype=np.intp)
    for number, trees in enumerate(classes):
        for place, kind_key in enumerate(sorted(trees)):
            result[place, ..., number] = trees[kind_key]
    return result


def gather(at_end: Floats, at_begin: Floats, leaf: Ints) -> Floats:
    """Nodal sums (n, 3) of forces (m, 3) on the ends j and the ends i of the elements."""
    terms = np.concatenate((at_end, at_begin, np.zeros((1, 3))))[leaf]
    for _ in range(3):
        terms = terms[:, ..., 0, :, :] + terms[:, ..., 1, :, :]
    total: Floats = terms[0]
    for further in terms[1:]:
        total = total + further
    return total

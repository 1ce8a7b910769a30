"""Divides sides into elements, and lumps the masses of elements in their nodes: eqs. (9), (11)."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from reference_impl.arrays import Floats, Ints


def divide(knots: int, sides: Ints, pieces: Ints) -> tuple[Ints, Ints, Floats]:
    """Cuts sides (s, 2) into `pieces` (s,) elements each: element_nodes, parents, shares of Net.

    The pieces lie loose at first, each with two ends of its own; ends at the same place of a side are glued,
    and those at its ends to the knots.  What hangs together is one node.
    """
    side = np.repeat(np.arange(len(sides)), pieces)
    place = np.concatenate([np.arange(d) for d in pieces.tolist()] or [np.empty(0)]).astype(np.intp)
    count, whole = len(side), pieces[side]
    tail = knots + 2 * np.arange(count)
    head = tail + 1
    first, last = place == 0, place + 1 == whole
    one = np.concatenate((head[~last], tail[first], head[last]))
    other = np.concatenate((tail[~first], sides[side[first], 0], sides[side[last], 1]))
    size = knots + 2 * count
    glue = coo_array((np.ones(len(one)), (one, other)), shape=(size, size))
    label = connected_components(glue, directed=False)[1]
    _, member, node = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(member)  # by their first member: knots first
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    node = rank[node]
    parents = np.repeat(np.arange(knots)[:, None], 2, axis=1)
    shares = np.tile([1.0, 0.0], (knots, 1))
    inner = member[order][knots:] - knots  # every other node is first met as the head of a piece
    piece = inner // 2
    reached = place[piece] + 1
    far = np.column_stack((whole[piece] - reached, reached)) / whole[piece][:, None]
    return (
        np.column_stack((node[tail], node[head])),
        np.concatenate((parents, sides[side[piece]])),
        np.concatenate((shares, far)),
    )


def lump(n: int, element_nodes: Ints, element_mass: Floats, extra: Floats) -> Floats:
    """Lumped masses (n,) [kg], eqs. (9), (11): half of each element to either end, plus `extra` (n,).

    Correctly rounded sums: the masses of mirrored nodes agree to the last bit whatever the elements' order.
    """
    shares: list[list[float]] = [[float(m)] for m in extra]
    for (i, j), half in zip(element_nodes.tolist(), (0.5 * element_mass).tolist(), strict=True):
        shares[i].append(half)
        shares[j].append(half)
    return np.array([math.fsum(share) for share in shares])

"""The record of a net: what `weave` builds and the mechanics reads."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from reference_impl.arrays import Bools, Floats, Ints
from reference_impl.attachments import Anchors


@dataclass(frozen=True, eq=False)
class Net:
    """n nodes, m elements, k bullets, f fixed nodes.

    Bullets run anticlockwise from the smallest polar angle of their reference position in [-pi, pi), so those
    of a square net are lower left, lower right, upper right, upper left.  Nodes: knots (and bullets) first,
    then inner nodes of divided sides, side by side; an explicit net keeps its listed nodes first, as listed.
    Nodes and elements of tethers come last: first ends on bodies, then inner nodes, tether by tether.  Their
    reference position is their place at time 0, for they have none in the plane of the net.
    """

    reference_position: Floats  # (n, 3) [m]
    element_nodes: Ints  # (m, 2)
    reference_length: Floats  # (m,) [m]
    area: Floats  # (m,) [m2]
    youngs_modulus: Floats  # (m,) [Pa]
    density: Floats  # (m,) [kg/m3]
    mass: Floats  # (n,) [kg] lumped, eq. (9), with bullets and node masses
    bullet_nodes: Ints  # (k,)
    fixed_nodes: Ints  # (f,)
    of_string: Bools  # (m,) true for elements of strings, false for those of cables
    numbered_bullets: Ints  # (k,) node of each bullet as the case format numbers them (`weave`)
    parents: Ints  # (n, 2) the knots between which a node lies; a knot is both of its own
    shares: Floats  # (n, 2) its barycentric coordinates between them
    direction: Floats  # (m, 3) unit vectors from i to j in the reference configuration
    tether: Ints  # (m,) number of the tether that an element is of, -1 for cables and strings
    woven: int  # how many of the nodes are the net's own; those of tethers follow
    numbered_nodes: Ints  # the nodes that the case format numbers, in its order (`weave`)
    corners: Ints  # of the mouth, the first one first; empty without a mouth
    anchors: Anchors  # nodes that are points of bodies, which are numbered as `Case.bodies` lists them
    law: Ints  # (m,) which of `curves` the tension of an element follows, -1: eq. (8)
    curves: tuple[Floats, ...]  # points (q, 2): strain (stretch less 1), tension over E A

    @cached_property
    def own_mass(self) -> Floats:
        """Masses (n,) [kg] of the nodes themselves; that of a point of a body is the body's."""
        if not len(self.anchors):
            return self.mass
        own = self.mass.copy()
        own[self.anchors.node] = 0.0
        return own


def between(values: Floats, parents: Ints, shares: Floats) -> Floats:
    """Values (n, 3) at all nodes, from those of the knots: their mean, weighted by the shares."""
    one, two = values[parents[:, 0]], values[parents[:, 1]]
    return np.asarray(one * shares[:, :1] + two * shares[:, 1:])


def diameter(net: Net) -> Floats:
    """Diameter (m,) [m] of a circle of each element's area."""
    return np.asarray(np.sqrt(4.0 / math.pi * net.area))


def exposed(net: Net, bullet_area: float) -> Floats:
    """Area (n,) [m2] that free-molecular flow and sunlight see of each node, and the bullet's.

    A cylinder that tumbles at random shows the mean area pi/4 d L of its side (a quarter of its surface
    pi d L, by Cauchy's theorem on mean projections), half of which belongs to either end.
    Correctly rounded sums, so that mirrored nodes agree to the last bit.
    """
    shares: list[list[float]] = [[] for _ in net.mass]
    halves = (0.5 * math.pi / 4.0 * diameter(net) * net.reference_length).tolist()
    for (i, j), half in zip(net.element_nodes.tolist(), halves, strict=True):
        shares[i].append(half)
        shares[j].append(half)
    for node in net.bullet_nodes.tolist():
        shares[node].append(bullet_area)
    return np.array([math.fsum(share) for share in shares])


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

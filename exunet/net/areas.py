"""Areas of a net: of its mouth, of its mesh openings, and the largest one that its mouth can have.

Two areas of a net are distinguished:

- the **mouth area** is the area of the closed polygon through the net's corner knots. When its corners do
  not lie in a plane, it is triangulated as a fan from the mean of its corners, and the area is the sum of the
  areas of the triangles. It says how much a net has opened; the four measures of deployment use it. The
  **rim area** is that of the closed polygon through all nodes of the rim, for what must not gape anywhere.
- the **mesh area** is the sum over all mesh openings of the opening's area, each triangulated in the same way
  from the mean of its nodes. Each opening counts as positive, so where the net is folded, layers that lie on
  each other count twice.

Both areas are unsigned and do not change when the net is moved or turned. They are exact for flat polygons
that are seen whole from the mean of their corners (all convex ones); others come out too large.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arguments import shown, takes
from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.net.arrays import Net

_AT_ONCE = 2**12  # loops times states, for arrays that stay in the processor's cache
_STATES = 64  # of which diameters are found at once: nodes that are far apart in one are so in the others
_DISTANCES = 2**22  # from corners to nodes, for one call of the search


@takes(net=Net)
def mouth_area(net: Net, position: Floats) -> Floats:
    """Area of the net's mouth [m2]; position (..., n_nodes, 3) [m] -> (...).

    The mouth is the closed polygon through the net's corner knots, triangulated as a fan from the mean of its
    corners; its area is the sum of the areas of the triangles. Zero for a net without a mouth.
    """
    _refuse_other(position, net)
    return _loops_area((net.mouth,), position)


def rim_area(net: Net, position: Floats) -> Floats:
    """Area [m2] that the whole rim of the mouth spans, as `mouth_area` that its corners span.

    Where corners have met and the rim between them gapes, this is not zero; folds of the rim count twice.
    """
    return _loops_area((net.rim,), position)


def mouth_diameter(net: Net, position: Floats) -> Floats:
    """Largest distance of two nodes of its rim [m]; (k, n_points, 3) [m] -> (k,); zero without a mouth.

    The diameter of a closed polygon is the largest distance of two of its corners, so nothing of a straight
    thread between neighbouring nodes of the rim is farther away.
    """
    rim, found = list(net.rim), np.zeros(len(position))
    for at in range(0, len(position) if rim else 0, _STATES):
        points = np.ascontiguousarray(
            position[at : at + _STATES, rim].T
        )  # (3, n, k), as sums over k are fast
        found[at : at + _STATES] = _diameter(points)
    return found


def mouth_against(net: Net, position: Floats, width: float) -> Floats:
    """Numbers of the sign of `mouth_diameter` less a width [m]; (k, n_points, 3) [m] -> (k,) [m].

    Cheap for states that follow each other: where two nodes that are far apart in the first are still farther
    apart than the width, or all are in a ball that is smaller, no others are compared. So a number says how
    much the mouth is wider at least, or narrower at least; where neither decides, exactly.
    """
    rim = list(net.rim)
    if not rim:
        return np.full(len(position), -width)
    first = position[0, rim].T
    one = int(_squares(first - first[:, :1]).argmax())
    other = int(_squares(first - first[:, one, None]).argmax())
    ends = position[:, rim[one]].T, position[:, rim[other]].T
    beside = np.sqrt(_squares(ends[1] - ends[0])) - width
    open_ = np.flatnonzero(beside <= 0.0)
    if len(open_):
        points, middle = position[open_][:, rim].T, 0.5 * (ends[0] + ends[1])[:, open_]
        reach = np.sqrt(_squares(points - middle[:, None]).max(axis=0))
        beside[open_] = 2.0 * reach * (1.0 + 1e-12) - width  # a ball's diameter, and what rounding may take
        open_ = open_[beside[open_] >= 0.0]
        beside[open_] = mouth_diameter(net, position[open_]) - width
    return beside


def _diameter(points: Floats) -> Floats:
    """(k,) largest distance of two of the points (3, n, k).

    Two points are no farther apart than both are from any place, so points near the middle of two that are
    far apart need not be compared with others.
    """
    states = np.arange(points.shape[2])
    ends = [points[:, 0]]
    for _ in range(2):
        farthest = _squares(points - ends[-1][:, None]).argmax(axis=0)
        ends.append(points[:, farthest, states])
    least = np.sqrt(_squares(ends[2] - ends[1]))
    away = np.sqrt(_squares(points - 0.5 * (ends[1] + ends[2])[:, None]))
    kept = points[:, (away + away.max(axis=0) >= least * (1.0 - 1e-12)).any(axis=1)]
    square = np.zeros(len(states))
    for k in range(1, kept.shape[1]):
        np.maximum(square, _squares(kept[:, k:] - kept[:, k - 1 : k]).max(axis=0), out=square)
    return np.sqrt(square)


def _squares(vectors: Floats) -> Floats:
    """Their lengths squared; (3, ...) -> (...)."""
    x, y, z = vectors
    return np.asarray(x * x + y * y + z * z)


@takes(net=Net)
def mesh_area(net: Net, position: Floats) -> Floats:
    """Sum of the areas of the net's mesh openings [m2]; position (..., n_nodes, 3) [m] -> (...).

    Each opening is triangulated as a fan from the mean of its nodes and counts as positive: where the net is
    folded, layers that lie on each other count twice. Zero for a net without openings.
    """
    _refuse_other(position, net)
    return _loops_area(net.faces, position)


@takes(net=Net)
def achievable_area(net: Net) -> float:
    """The largest area [m2] that the mouth can have while no thread is longer than its reference length.

    Neighbouring corners of the mouth can be apart by at most the shortest way along the threads from one to
    the other, which is the net's border (`border_lengths`); the largest polygon with such sides is that of
    `largest_polygon`. No state exceeds it but by the strain of the border: with every thread of the border
    longer by at most a factor s, the mouth area is at most s^2 times this. That holds for corners out of a
    plane too: the fan from their mean is a cone of at least 2 pi, in which no polygon is larger than the flat
    one with the same sides (Reshetnyak, Sib. Math. J. 9, 1968, 683-689). Zero for a net without a mouth.
    """
    return largest_polygon(border_lengths(net))


def border_lengths(net: Net) -> Floats:
    """(n_corners,) reference length [m] of the border between each corner of the mouth and the next.

    It is the shortest way along the threads: straight sides in most nets, a zigzag in a honeycomb.
    """
    corners = np.array(net.mouth, dtype=np.int64)
    if len(corners) < 2:
        return np.zeros(len(corners))
    graph = _threads(net)
    following = np.roll(corners, -1)
    found = []
    many = max(1, _DISTANCES // net.n_nodes)
    for at in range(0, len(corners), many):
        ways = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=corners[at : at + many])
        found.append(ways[np.arange(len(ways)), following[at : at + many]])
    return np.concatenate(found)


def _threads(net: Net) -> scipy.sparse.csr_array:
    """(n_nodes, n_nodes) reference lengths [m]; of several elements between two nodes the shortest."""
    ends = np.sort(net.element_nodes, axis=1)
    order = np.lexsort((net.reference_length, ends[:, 1], ends[:, 0]))
    _, first = np.unique(ends[order], axis=0, return_index=True)
    chosen = order[first]
    places = (ends[chosen, 0], ends[chosen, 1])
    return scipy.sparse.csr_array((net.reference_length[chosen], places), shape=(net.n_nodes, net.n_nodes))


def largest_polygon(lengths: Floats) -> float:
    """The largest area [m2] of a polygon whose sides are at most `lengths` (n,) [m], in any order.

    Of all polygons with given sides, the one inscribed in a circle is the largest; its radius is unique
    (I. Pinelis, "Cyclic polygons with given edge lengths: existence and uniqueness", J. Geom. 82, 2005,
    156-171). A side longer than the diameter of the half circle that the others span would only cost area:
    it is then that diameter. Infinite lengths are sides that nothing holds. Zero for fewer than three sides
    with a length.
    """
    sides = np.sort(lengths[lengths > 0.0])
    if len(sides) < 3:
        return 0.0
    *_, longest = sides
    others = sides[:-1]
    if not np.isfinite(others[-1]):
        return float("inf")
    # With the curvature c = 1 / diameter, a side of length s spans half the angle asin(s c) at the centre.
    half_circle = _curvature(others, 1.0 / others[-1], np.pi / 2)
    if longest * half_circle >= 1.0:
        angles = np.arcsin(np.minimum(others * half_circle, 1.0))
        return float(np.sin(2.0 * angles).sum() / (8.0 * half_circle**2))
    curvature = _curvature(sides, 1.0 / longest, np.pi)
    angles = np.arcsin(np.minimum(others * curvature, 1.0))
    angles = np.append(angles, np.pi - angles.sum())
    return float(np.sin(2.0 * angles).sum() / (8.0 * curvature**2))


def _curvature(sides: Floats, most: float, angle: float) -> float:
    """1 / diameter [1/m], up to `most`, of the circle in which sides (n,) [m] span half the angle `angle`."""

    def excess(part: float) -> float:
        return float(np.arcsin(np.minimum(sides * (part * most), 1.0)).sum()) - angle

    if excess(1.0) <= 0.0:  # by round-off
        return most
    low, high = 0.0, 1.0
    while low < (middle := 0.5 * (low + high)) < high:  # to the last bit
        low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
    return most * high


def _refuse_other(position: object, net: Net) -> None:
    """Raise InputError for what is no array of places of all nodes of a net."""
    shape, kind = getattr(position, "shape", None), getattr(position, "dtype", np.dtype(object))
    fits = isinstance(shape, tuple) and len(shape) > 1 and shape[-1] == 3 and shape[-2] >= net.n_net_nodes
    if not fits or kind.kind not in "iuf":
        got = shown(position) if shape is None else f"an array of {shape}" + (f" of {kind}" if fits else "")
        raise InputError(
            f"position: needs an array (..., {net.n_nodes}, 3) of the places of nodes [m], got {got}"
        )


def _loops_area(loops: Sequence[tuple[int, ...]], position: Floats) -> Floats:
    """Sum of the areas of closed loops of nodes, each a fan of triangles from the mean of its nodes."""
    groups: dict[int, list[tuple[int, ...]]] = {}
    for loop in loops:
        groups.setdefault(len(loop), []).append(loop)
    axes = np.moveaxis(position, -1, 0).reshape(3, -1, position.shape[-2])  # (3, n_states, n_nodes)
    area = np.zeros(axes.shape[1])
    for length, group in groups.items():
        if length > 2:
            nodes = np.array(group)
            many = max(1, _AT_ONCE // len(nodes))
            for at in range(0, len(area), many):
                area[at : at + many] += _fans(axes[:, at : at + many], nodes)
    return area.reshape(position.shape[:-2])


def _fans(axes: Floats, nodes: NDArray[np.int64]) -> Floats:
    """(n_states,) areas of loops, summed; axes (3, n_states, n_nodes) [m], nodes (n_loops, n_corners)."""
    corners = [axes[:, :, nodes[:, k]] for k in range(nodes.shape[1])]
    mean = sum(corners[1:], corners[0]) / len(corners)
    spokes = [corner - mean for corner in corners]
    doubled = np.zeros(axes.shape[1])
    for (ax, ay, az), (bx, by, bz) in zip(spokes, spokes[1:] + spokes[:1], strict=True):
        across = (ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2
        doubled += np.sqrt(across).sum(axis=-1)
    return 0.5 * doubled

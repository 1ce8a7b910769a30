"""Threads of a net that meet: every pair of elements is looked at, in every state.

A pair stores U = L L' K/(3 pi R^2) times the integral of (R^2 - d^2)^(3/2) over the places s, t of both
elements that are nearer than R, where d is the distance of x(s) from y(t).  Along the second element, t in a
chord of half-width w, the places are t = t0 + w sin(phi), in which the integrands are smooth; along the first
the rule halves its pieces until they agree (`quadrature`), with s = 3 z^2 - 2 z^3 on each piece at first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from reference_impl.arrays import Bools, Floats, Ints, dot
from reference_impl.case import Case
from reference_impl.net import Net, diameter
from reference_impl.quadrature import integrals
from reference_impl.rounded import Pieces

_PHI, _OF_PHI = np.polynomial.legendre.leggauss(20)
_POINT = 1e-9  # of R: an element that is shorter is a point
_MEASURE = np.full(10, 9, dtype=np.intp)  # of the integrals only that of the energy is nowhere negative
_STEPS, _SAME = 100, 1e-15  # of Newton's method, and a negligible change of s
GIVES_WAY = 1.0 / math.sqrt(3.0)  # of R: nearer axes of parallel threads push less and less


@dataclass(frozen=True, eq=False)
class Meeting:
    """The q pairs of elements that may touch."""

    one: Ints  # (q,) elements
    other: Ints
    ends: Ints  # (q, 4) nodes: i, j of the first, i, j of the second
    reach: Floats  # R (q,) [m]
    watched: Bools  # (q,) whether a run stops where they come too near
    size: Floats  # L L' K/(pi R^2) (q,) [N/m2]
    damping: float  # a [s/m]

    def places(self, rows: Ints, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Begin and way of the first and of the second element, (q, 3) each, from x (n, 3)."""
        a, b, c, d = (x[self.ends[rows, k]] for k in range(4))
        return a, b - a, c, d - c


@dataclass(frozen=True, eq=False)
class Met:
    """What the pairs that touch do."""

    on_nodes: Floats  # (n, 3) [N]
    taken: float  # [W] by damping
    stored: float  # [J]


def meeting(case: Case, net: Net, x0: Floats) -> Meeting | None:
    """The pairs of a case whose nodes start at x0 (n, 3) [m]; None where threads do not touch.

    A pair that starts nearer than R has its distance there for R; one that crosses there never touches.
    """
    law = case.effects.self_contact
    if law is None:
        return None
    woven = np.flatnonzero(net.tether < 0)
    i, j = net.element_nodes[woven].T
    length = net.reference_length[woven]
    radius = 0.5 * diameter(net)[woven] if law.radius is None else np.full(len(woven), law.radius)
    one, other = np.triu_indices(len(woven), 1)
    reach = radius[one] + radius[other]
    apart = _ways(len(net.mass), i, j, length, one, other) > 0.5 * math.pi * reach
    one, other, reach = one[apart], other[apart], reach[apart]
    ends = np.stack((i[one], j[one], i[other], j[other]), axis=1)
    gap = closest(
        x0[ends[:, 0]], x0[ends[:, 1]] - x0[ends[:, 0]], x0[ends[:, 2]], x0[ends[:, 3]] - x0[ends[:, 2]]
    )
    watched = gap >= 0.5 * reach
    reach = np.minimum(reach, gap)
    kept = np.flatnonzero(reach > 0.0)
    size = law.stiffness / (math.pi * reach[kept] ** 2) * (length[one] * length[other])[kept]
    number = woven[one[kept]], woven[other[kept]]
    return Meeting(*number, ends[kept], reach[kept], watched[kept], size, law.damping)


def _ways(nodes: int, i: Ints, j: Ints, length: Floats, one: Ints, other: Ints) -> Floats:
    """Shortest ways (q,) [m] along threads between the ends of elements, 0 of those with a common node."""
    graph = csr_array((length, (i, j)), shape=(nodes, nodes))
    way = shortest_path(graph, directed=False)
    return np.asarray(np.min([way[a[one], b[other]] for a in (i, j) for b in (i, j)], axis=0))


def closest(a: Floats, u: Floats, b: Floats, w: Floats) -> Floats:
    """Least distances (q,) of the lines a + s u and b + t w, s and t in [0, 1]; all (q, 3).

    The square of the distance is convex in (s, t): its least is where its slope is zero inside the square,
    or else the least along one of the four sides, at whose ends the corners are.
    """

    def apart(s: Floats, t: Floats) -> Floats:
        d = a - b + s[:, None] * u - t[:, None] * w
        return np.asarray(np.sqrt(dot(d, d)))

    uu, ww, uw, r = dot(u, u), dot(w, w), dot(u, w), a - b
    ur, wr = dot(u, r), dot(w, r)
    sides = np.zeros(len(a)), np.ones(len(a))
    found = [apart(np.clip(_over(t * uw - ur, uu), 0.0, 1.0), t) for t in sides]
    found += [apart(s, np.clip(_over(s * uw + wr, ww), 0.0, 1.0)) for s in sides]
    area = uu * ww - uw * uw
    s, t = _over(uw * wr - ww * ur, area), _over(uu * wr - uw * ur, area)
    inside = (area > 1e-14 * uu * ww) & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    found.append(np.where(inside, apart(np.where(inside, s, 0.0), np.where(inside, t, 0.0)), np.inf))
    return np.asarray(np.min(found, axis=0))


def _over(a: Floats, b: Floats) -> Floats:
    """a/b, 0 where b is."""
    return np.asarray(np.divide(a, b, out=np.zeros_like(a), where=b != 0.0))


def near(pairs: Meeting, x: Floats) -> tuple[Ints, Floats]:
    """Which pairs touch, and how far apart their axes are [m]."""
    a, u, b, w = pairs.places(np.arange(len(pairs.reach)), x)
    between = a + 0.5 * u - b - 0.5 * w
    bound = 0.5 * (np.sqrt(dot(u, u)) + np.sqrt(dot(w, w))) + pairs.reach
    rows = np.flatnonzero(dot(between, between) < bound**2)
    gap = closest(*(part[rows] for part in (a, u, b, w)))
    touch = gap < pairs.reach[rows]
    return rows[touch], gap[touch]


def met(pairs: Meeting, x: Floats, v: Floats) -> Met:
    """Forces of all pairs, nodes at x (n, 3) [m] moving with v (n, 3) [m/s]."""
    rows, _ = near(pairs, x)
    force = np.zeros_like(x)
    if not len(rows):
        return Met(force, 0.0, 0.0)
    size = pairs.size[rows]
    total = size[:, None] * _pressed(pairs, rows, x)
    whole, on_j, on_l = total[:, :3], total[:, 3:6], total[:, 6:9]
    each = np.stack((whole - on_j, on_j, on_l - whole, -on_l), axis=1)  # (q, 4, 3)
    push = np.sqrt(dot(whole, whole))
    rate = -_over(np.einsum("qkc,qkc->q", each, v[pairs.ends[rows]]), push)
    factor = np.maximum(1.0 + pairs.damping * rate, 0.0)
    np.add.at(force, pairs.ends[rows], factor[:, None, None] * each)
    taken = float(np.sum((factor - 1.0) * push * rate))
    return Met(force, taken, float(np.sum(total[:, 9])) / 3.0)


def stored(pairs: Meeting, x: Floats) -> Floats:
    """Energy (...) [J] of states x (..., n, 3)."""
    states = x.reshape(-1, *x.shape[-2:])
    return np.array([met(pairs, state, np.zeros_like(state)).stored for state in states]).reshape(
        x.shape[:-2]
    )


def too_near(pairs: Meeting, x: Floats) -> str:
    """The pair that is nearer than contact bears, in words; empty if none is."""
    rows, gap = near(pairs, x)
    over = np.where(pairs.watched[rows], GIVES_WAY * pairs.reach[rows] - gap, -np.inf)
    if not np.any(over > 0.0):
        return ""
    row = rows[np.argmax(over)]
    nearest = GIVES_WAY * pairs.reach[row]
    return f"the axes of elements {pairs.one[row]} and {pairs.other[row]} are nearer than {nearest:.6g} m"


def _pressed(pairs: Meeting, rows: Ints, x: Floats) -> Floats:
    """Integrals (q, 10) of g e, s g e, t g e and g^3, with e = x(s) - y(t) and g = (R^2 - e^2)^(1/2)."""
    a, u, b, w = pairs.places(rows, x)
    squared, reach = dot(w, w), pairs.reach[rows]
    point = squared <= (_POINT * reach) ** 2

    def seen(line: Ints, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Places from b, t of the foot on the other line, and the square of the half-width of the chord."""
        from_b = (a - b)[line, None] + s[..., None] * u[line, None]
        t = _over(dot(from_b, w[line, None]), np.broadcast_to(squared[line, None], s.shape))
        t = np.where(point[line, None], 0.5, t)
        across = from_b - t[..., None] * w[line, None]
        return from_b, t, reach[line, None] ** 2 - dot(across, across)

    def density(line: Ints, s: Floats) -> Floats:
        from_b, foot, rest = seen(line, s)
        thin, rest = point[line, None], np.maximum(rest, 0.0)
        half = np.where(thin, 1.0, np.sqrt(_over(rest, np.broadcast_to(squared[line, None], s.shape))))
        begin, end = (np.arcsin(np.clip(_over(limit - foot, half), -1.0, 1.0)) for limit in (0.0, 1.0))
        phi = 0.5 * (begin + end)[..., None] + 0.5 * (end - begin)[..., None] * _PHI
        t = foot[..., None] + half[..., None] * np.sin(phi)
        weight = 0.5 * (end - begin)[..., None] * _OF_PHI * half[..., None] * np.cos(phi)
        g = np.sqrt(rest)[..., None] * np.cos(phi)
        if np.any(thin):
            t = np.where(thin[..., None], 0.5, t)
            weight = np.where(thin[..., None], 0.5 * _OF_PHI, weight)
            g = np.where(thin[..., None], np.sqrt(rest)[..., None], g)
        e = from_b[..., None, :] - t[..., None] * w[line, None, None]
        push = np.einsum("qgp,qgpc->qgc", weight * g, e)
        lever = np.einsum("qgp,qgpc->qgc", weight * g * t, e)
        stored = np.einsum("qgp,qgp->qg", weight, g**3)
        return np.concatenate((push, s[..., None] * push, lever, stored[..., None]), axis=-1)

    marks = _marks(a, u, b, w, reach)

    def smooth(line: Ints, z: Floats) -> Floats:
        """The density, s = 3 f^2 - 2 f^3 of piece k, f = z - k: without square roots at its ends."""
        piece = z.astype(np.intp)
        f, begin = z - piece, marks[line[:, None], piece]
        width = marks[line[:, None], piece + 1] - begin
        s = begin + width * f * f * (3.0 - 2.0 * f)
        return (6.0 * width * f * (1.0 - f))[..., None] * density(line, s)

    line, piece = (part.ravel() for part in np.indices((len(rows), marks.shape[1] - 1)))
    pieces = Pieces(line, piece.astype(float), piece + 1.0)
    return integrals(smooth, pieces, len(rows), _MEASURE, np.zeros(len(rows)))


def _marks(a: Floats, u: Floats, b: Floats, w: Floats, reach: Floats) -> Floats:
    """Places s (q, 6) on the first elements: where they become near, where ends of the other do, in order.

    The distance of a + s u from an element is convex in s: Newton's steps from an end of the element that is
    not near go towards the place where it becomes near, and not beyond.
    """
    marks = [_edge(a, u, b, w, reach, end) for end in (0.0, 1.0)]
    uu = dot(u, u)
    for end in (b, b + w):
        foot = _over(dot(end - a, u), uu)
        off = a + foot[:, None] * u - end
        wide = np.sqrt(_over(np.maximum(reach**2 - dot(off, off), 0.0), uu))
        marks += [np.clip(foot + sign * wide, marks[0], marks[1]) for sign in (-1.0, 1.0)]
    return np.sort(np.stack(marks, axis=1), axis=1)


def _edge(a: Floats, u: Floats, b: Floats, w: Floats, reach: Floats, end: float) -> Floats:
    """Where a + s u becomes near, coming from an end of the element; this end where it is near."""
    s = np.full(len(a), end)
    for _ in range(_STEPS):
        d = a + s[:, None] * u - b
        d = d - np.clip(_over(dot(d, w), dot(w, w)), 0.0, 1.0)[:, None] * w
        distance = np.sqrt(dot(d, d))
        step = np.where(distance > reach, _over((distance - reach) * distance, dot(d, u)), 0.0)
        if not np.any(np.abs(step) > _SAME):
            break
        s = np.clip(s - step, 0.0, 1.0)
    return s

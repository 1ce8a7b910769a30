"""Measures of a capture over time: how far a net encloses its target, and how both move.

The net is its knots, strings and bullets without tethers. What it encloses is its convex hull, so a net that
hangs around a target like a bowl encloses it before its mouth is closed; the modified index and the diameter
of the mouth distinguish the two. Of a net in pieces the largest piece is measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.bodies.distance import distances_to, polyhedron
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Shape
from exunet.net.areas import achievable_area, mouth_diameter, rim_area
from exunet.net.arrays import Net
from exunet.results.clearance import shapes_of
from exunet.results.loads import broken_at
from exunet.results.result import Result, row_ranges
from exunet.scene.capture import Capture

_ROWS = 256  # states that are looked at in one go
# Scrambled Halton points in a target, which are counted for the enclosed part: a part of a box that a plane
# cuts off is known to 8.4e-4 (rms) and at worst 2.6e-3 over 150 random planes.
POINTS, SEED = 8192, 1


class Measures(NamedTuple):
    """Over times (t,), or at one.

    enclosed       : part of the target's volume in the convex hull of the net
    cqi            : capture quality index w1 |V_n - V_t| / V_t + w2 |S_n - S_t| / S_t + w3 |q| / L, with the
                     volumes V and surfaces S of the convex hulls of net and target, the distance |q| of their
                     centres of mass, and the length L of the target. Less is better
    mcqi           : modified index w1 (1 - enclosed) + w2 d / L + w3 A / A_max, with the mean distance d of
                     the net's nodes from the target, and the area A that the rim of the mouth spans, at most
                     A_max
    mouth          : largest distance of two nodes of the mouth's rim [m]; 0 without one
    relative_speed : of the centres of mass [m/s]
    relative_spin  : of the mean angular velocity of the net, J^-1 H about its centre, less the
                     target's [rad/s]
    distance       : least distance of the net's nodes from the target [m]; 0: one is inside
    """

    enclosed: Floats
    cqi: Floats
    mcqi: Floats
    mouth: Floats
    relative_speed: Floats
    relative_spin: Floats
    distance: Floats


@dataclass(frozen=True, eq=False)
class Target:
    """Target of a capture, from its centre of mass.

    points  : (m, 3) spread evenly inside [m]
    corners : (k, 3) of its convex hull, round edges by `exunet.bodies.distance.AROUND` corners [m]
    volume, surface : of this hull [m3], [m2]
    length  : its longest diagonal [m]
    """

    shape: Shape
    points: Floats
    corners: Floats
    volume: float
    surface: float
    length: float


@lru_cache(maxsize=16)
def target_of(shape: Shape) -> Target:
    """A target of a shape in the axes of the body; of a mesh it is the convex hull."""
    meshes = [polyhedron(item) for item in shape.solids] + ([] if shape.mesh is None else [shape.mesh])
    hulls = [scipy.spatial.ConvexHull(mesh.vertices) for mesh in meshes]
    whole = scipy.spatial.ConvexHull(np.concatenate([hull.points[hull.vertices] for hull in hulls]))
    corners = whole.points[whole.vertices]
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    chosen, drawn = np.zeros((0, 3)), 0
    while len(chosen) < POINTS:
        points = low + size * halton(drawn, POINTS, SEED)
        drawn += POINTS
        inside = np.zeros(len(points), dtype=bool)
        for solid in shape.solids:
            inside |= solid.contains(points)
        if shape.mesh is not None:
            inside |= _inside(hulls[-1].equations, points)
        chosen = np.concatenate([chosen, points[inside]])
    length = float(scipy.spatial.distance.pdist(corners).max())
    return Target(
        shape,
        np.asfortranarray(chosen[:POINTS]),
        corners,
        float(whole.volume),
        float(whole.area),
        length,
    )


def halton(first: int, count: int, seed: int) -> Floats:
    """Compute points (count, 3) of the scrambled Halton sequence in the unit cube, from number `first` on.

    A coordinate is the radical inverse of the number in base 2, 3 or 5, its k-th digit permuted by the k-th
    random permutation (Owen, A randomized Halton algorithm in R, 2017, arXiv:1706.02808). They are the
    points of `scipy.stats.qmc.Halton(3, seed=seed)`, whose package takes 0.3 s to import.
    """
    draw = np.random.default_rng(seed)
    points = np.zeros((3, count))
    for row, base in zip(points, (2, 3, 5), strict=True):
        permutations = np.tile(np.arange(base), (math.ceil(54 / math.log2(base)) - 1, 1))
        for permutation in permutations:
            draw.shuffle(permutation)
        rest, value = np.arange(first, first + count), 1.0 / base
        for permutation in permutations:
            rest, digit = np.divmod(rest, base)
            row += permutation[digit] * value
            value /= base
    return points.T


def capture_of(result: Result, rule: Capture, rows: Sequence[int] | None = None) -> Measures:
    """The measures of a result at its stored times, or at those with some indices."""
    chosen = np.arange(len(result.time)) if rows is None else np.asarray(rows)
    body = result.bodies[rule.target]
    poses = np.concatenate([body.position[chosen], body.attitude[chosen]], axis=1)
    twists = np.concatenate([body.velocity[chosen], body.angular_velocity[chosen]], axis=1)
    target, found = target_of(shapes_of(result)[rule.target]), []
    for first, last, piece in _of_pieces(result, chosen):
        k = chosen[first:last]
        points = np.asarray(result.position[k]), np.asarray(result.velocity[k])
        body_states = poses[first:last], twists[first:last]
        found.append(capture(result.net, rule, target, points, body_states, piece))
    return Measures(*(np.concatenate(item) for item in zip(*found, strict=True)))


def centres_of(result: Result) -> tuple[Floats, Floats]:
    """Return the centre of mass of the net's largest piece and its velocity, (t, 3) each [m], [m/s]."""
    found = []
    for first, last, piece in _of_pieces(result, np.arange(len(result.time))):
        share = result.net.mass[piece] / result.net.mass[piece].sum()
        states = (np.asarray(values[first:last])[:, piece] for values in (result.position, result.velocity))
        found.append([np.einsum("n,tnk->tk", share, values) for values in states])
    position, velocity = (np.concatenate(item) for item in zip(*found, strict=True))
    return position, velocity


def _of_pieces(result: Result, rows: NDArray[np.int64]) -> Iterator[tuple[int, int, Ints]]:
    """Yield first and last of increasing stored times that are looked at in one go, and the largest piece."""
    broke = np.sort([at for e, at in broken_at(result).items() if e < result.net.n_net_elements])
    count = np.searchsorted(broke, result.time[rows], side="right")
    for start, stop in pairwise([0, *(np.flatnonzero(np.diff(count)) + 1).tolist(), len(rows)]):
        piece = pieces_at(result, float(result.time[rows[start]]))[0]
        yield from ((start + a, start + b, piece) for a, b in row_ranges(stop - start, _ROWS))


def pieces_at(result: Result, time: float) -> list[Ints]:
    """Return the nodes of each piece of a net at a time [s], that with most thread first."""
    net, nodes = result.net, nodes_of_net(result.net)
    broken = [element for element, at in broken_at(result).items() if at <= time]
    kept = np.setdiff1d(np.arange(net.n_net_elements), broken)
    if len(kept) == net.n_net_elements:
        return [nodes]
    ends = net.element_nodes[kept]
    graph = scipy.sparse.coo_array((np.ones(len(kept)), ends.T), shape=(net.n_nodes, net.n_nodes))
    label = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    own = np.unique(label[nodes])
    length = np.bincount(label[ends[:, 0]], net.reference_length[kept], len(label))[own]
    return [np.flatnonzero(label == piece) for piece in own[np.argsort(-length, kind="stable")]]


def capture(
    net: Net,
    rule: Capture,
    target: Target,
    points: tuple[Floats, Floats],
    body: tuple[Floats, Floats],
    piece: Ints | None = None,
) -> Measures:
    """The measures of states.

    piece  : nodes that are measured; None: the whole net
    points : positions and velocities of the nodes, (t, n_nodes, 3) each [m], [m/s]
    body   : of the target, (t, 7) place [m] and attitude of its frame, (t, 6) velocity of its centre of mass
             [m/s] and angular velocity in its own axes [rad/s]
    """
    nodes = nodes_of_net(net) if piece is None else piece
    mass = net.mass[nodes]
    x, v = (values[:, nodes] for values in points)
    pose, twist = body
    turn = rotation_matrix(pose[:, 3:])
    centre, speed = (np.einsum("n,tnk->tk", mass, values) / mass.sum() for values in (x, v))
    spin = _spin(mass, x - centre[:, None], v - speed[:, None])
    length = rule.length or target.length
    most = achievable_area(net)
    rim, place = np.array(net.rim, dtype=np.int64), points[0]
    if not (own := np.isin(rim, nodes)).all():  # a lost node of the rim is where the one before is
        before = np.maximum.accumulate(np.where(own, np.arange(len(rim)), -1))
        place = place.copy()
        place[:, rim] = place[:, rim[np.where(before < 0, before[-1], before)]]
    area = rim_area(net, place)
    opened = np.minimum(area / most, 1.0) if 0.0 < most < np.inf else np.zeros(len(x))
    hulls = [_of_hull(target, *item) for item in zip(x, pose[:, :3], turn, strict=True)]
    enclosed, volume, surface, apart, distance = np.array(hulls).reshape(-1, 5).T
    offset = np.linalg.norm(centre - pose[:, :3], axis=1)
    terms = [abs(volume / target.volume - 1.0), abs(surface / target.surface - 1.0), offset / length]
    modified = [1.0 - enclosed, apart / length, opened]
    return Measures(
        enclosed,
        sum((w * one for w, one in zip(rule.cqi_weights, terms, strict=True)), np.zeros(len(x))),
        sum((w * one for w, one in zip(rule.mcqi_weights, modified, strict=True)), np.zeros(len(x))),
        mouth_diameter(net, place),
        np.linalg.norm(speed - twist[:, :3], axis=1),
        np.linalg.norm(spin - np.einsum("tij,tj->ti", turn, twist[:, 3:]), axis=1),
        distance,
    )


def nodes_of_net(net: Net) -> Ints:
    """Return the nodes of the net without tethers; of a net without elements all."""
    nodes = np.unique(net.element_nodes[: net.n_net_elements])
    return nodes if len(nodes) else np.arange(net.n_nodes)


def _spin(mass: Floats, x: Floats, v: Floats) -> Floats:
    """(t, 3) mean angular velocity [rad/s] of points about their centre; the least, of points in line."""
    moment = np.einsum("n,tnk->tk", mass, np.cross(x, v))
    square = np.einsum("n,tni,tnj->tij", mass, x, x)
    inertia = np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) - square
    return np.einsum("tij,tj->ti", np.linalg.pinv(inertia, rcond=1e-12, hermitian=True), moment)


def _of_hull(target: Target, x: Floats, place: Floats, turn: Floats) -> tuple[float, ...]:
    """Return enclosed part, volume, surface of the hull of points (n, 3), their mean and least distance."""
    distances = distances_to(target.shape, (x - place) @ turn)
    apart = float(distances.mean()), float(distances.min())
    try:
        hull = scipy.spatial.ConvexHull(x)
    except scipy.spatial.QhullError:  # flat
        return 0.0, 0.0, _flat(x), *apart
    return _enclosed(target, hull, place, turn), float(hull.volume), float(hull.area), *apart


def _enclosed(target: Target, hull: scipy.spatial.ConvexHull, place: Floats, turn: Floats) -> float:
    """Return the part of a target's volume in a convex hull; points are counted where it is cut."""
    corners = target.corners @ turn.T + place
    if (corners.max(axis=0) < hull.min_bound).any() or (corners.min(axis=0) > hull.max_bound).any():
        return 0.0
    beyond = corners @ hull.equations[:, :3].T + hull.equations[:, 3] > 0.0
    cuts = hull.equations[beyond.any(axis=0)]  # all points are inside the other planes, as the corners are
    if not len(cuts):
        return 1.0
    local = np.column_stack([cuts[:, :3] @ turn, cuts[:, :3] @ place + cuts[:, 3]])  # in the target's frame
    return np.count_nonzero(_inside(local, target.points)) / POINTS


def _flat(x: Floats) -> float:
    """Both sides [m2] of what points (n, 3) in a plane span; 0 of points in line."""
    if len(x) < 3:
        return 0.0
    middle = x.mean(axis=0)
    axes = np.linalg.svd(x - middle, full_matrices=False)[2][:2]
    try:
        return 2.0 * float(scipy.spatial.ConvexHull((x - middle) @ axes.T).volume)
    except scipy.spatial.QhullError:
        return 0.0


def _inside(equations: Floats, points: Floats) -> NDArray[np.bool_]:
    """(m,) True for points inside all half spaces (f, 4) n . x + d <= 0."""
    inside = np.ones(len(points), dtype=bool)
    for *normal, offset in equations:  # one after the other: a matrix (m, f) leaves the cache
        inside &= points @ normal <= -offset
    return inside

"""Distances of straight lines and points from rounded bodies, along pieces on which they are square roots.

The nearest point of a core (`blocks`) lies, along a line, by turns on a face, an edge or a corner: it changes
where the line crosses the planes of the core's faces.  In between the vector from it is linear in the place s
on the line, and the squared distance quadratic, so that all pieces that are nearer than a given distance come
from quadratic equations; nothing is searched for.  Depths of several parts are joined as a norm of order 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Bools, Floats, Ints, dot
from reference_impl.solids import Block

ORDER = 8  # of the norm that joins the depths of parts


@dataclass(frozen=True, eq=False)
class Part:
    """A core: half-widths (3,) [m] along its axes, the columns of (3, 3), about a centre (3,) [m]."""

    half: Floats
    axes: Floats
    centre: Floats
    rounding: float

    @property
    def girth(self) -> float:
        """Radius [m] of a ball round the core."""
        return float(np.linalg.norm(self.half))

    def beyond(self, place: Floats) -> Floats:
        """Vectors (..., 3) [m] from the nearest points of the core to places (..., 3)."""
        own = (place - self.centre) @ self.axes
        return np.asarray((own - np.clip(own, -self.half, self.half)) @ self.axes.T)


def part(block: Block, edge_radius: float, origin: Floats) -> Part:
    """The core of a block, from an origin (3,) [m] in the body's frame."""
    rounding = block.rounding(edge_radius)
    return Part(np.maximum(block.half - rounding, 0.0), block.axes, block.centre - origin, rounding)


@dataclass(frozen=True, eq=False)
class Stretches:
    """Lines (q,) past one core, in 7 intervals each; s from 0 to 1 along a line."""

    cuts: Floats  # (q, 8) from 0 to 1: where the intervals meet
    begin: Floats  # (q, 7) of the part of each interval that is near enough
    end: Floats  # (q, 7) not above `begin` where none is
    nearest: Floats  # (q,) least distance [m]
    at: Floats  # (q,) s there


def stretches(core: Part, begin: Floats, way: Floats, reach: Floats) -> Stretches:
    """Where lines from `begin` along `way` (q, 3) [m] are within distances `reach` (q,) [m] of a core."""
    own, along = (begin - core.centre) @ core.axes, way @ core.axes
    with np.errstate(all="ignore"):
        planes = np.concatenate([(side * core.half - own) / along for side in (-1.0, 1.0)], axis=1)
    planes = np.where(np.isfinite(planes) & (np.tile(core.half, 2) > 0.0), np.clip(planes, 0.0, 1.0), 0.0)
    ends = np.zeros((len(own), 1)), np.ones((len(own), 1))
    cuts = np.sort(np.concatenate((ends[0], planes, ends[1]), axis=1), axis=1)
    low, high = cuts[:, :-1], cuts[:, 1:]
    middle = own[:, None] + (0.5 * (low + high))[..., None] * along[:, None]
    side = (middle > core.half).astype(float) - (middle < -core.half)
    outside = (side != 0.0) | (core.half == 0.0)
    slope = np.where(outside, along[:, None], 0.0)
    offset = np.where(outside, own[:, None] - side * core.half, 0.0)
    steep = dot(slope, slope)
    with np.errstate(all="ignore"):
        foot = np.where(steep > 0.0, -dot(offset, slope) / steep, low)
        foot = np.clip(np.where(np.isfinite(foot), foot, low), low, high)
        near = offset + foot[..., None] * slope
        distance = np.sqrt(dot(near, near))
        # |near + t slope| = reach: the root that does not cancel, and the other one from their product
        rising, lack = dot(near, slope), (distance - reach[:, None]) * (distance + reach[:, None])
        root = np.sqrt(np.maximum(rising * rising - steep * lack, 0.0))
        sure = -(rising + np.copysign(root, rising))
        roots = np.stack((sure / steep, lack / sure))
        before, after = np.nan_to_num(np.min(roots, axis=0), nan=-np.inf), np.max(roots, axis=0)
        before = np.where(steep > 0.0, before, -np.inf)
        after = np.where(steep > 0.0, np.nan_to_num(after, nan=np.inf), np.inf)
    within = lack < 0.0
    best = np.argmin(distance, axis=1)[:, None]
    return Stretches(
        cuts,
        np.where(within, np.maximum(low, foot + before), low),
        np.where(within, np.minimum(high, foot + after), low),
        np.take_along_axis(distance, best, axis=1)[:, 0],
        np.take_along_axis(foot, best, axis=1)[:, 0],
    )


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth p and how it grows at places of threads, nodes or bullets."""

    p: Floats  # (...) [m], 0 outside
    rate: Floats  # p' (...) [m/s]
    outwards: Floats  # (..., 3) direction in which a force across the surface acts, summed over parts


def depth(parts: tuple[Part, ...], radius: Floats, place: Floats, w: Floats) -> Depth:
    """p at places (..., 3) [m] of threads or points of radii (...) [m], which pass the body with w (..., 3).

    Inside a core no direction leads out: there is a depth, but no force.
    """
    depths, normals = [], []
    for core in parts:
        beyond = core.beyond(place)
        distance = np.sqrt(dot(beyond, beyond))
        depths.append(np.maximum(core.rounding + radius - distance, 0.0))
        normals.append(beyond / np.where(distance > 0.0, distance, np.inf)[..., None])
    p, n = depths[0], normals[0]
    if len(parts) > 1:
        each = np.stack(depths)
        p = joined(each)
        share = (each / np.where(p > 0.0, p, np.inf)) ** (ORDER - 1)
        n = np.sum(share[..., None] * np.stack(normals), axis=0)
    return Depth(p, -dot(n, w), n)


def signed(parts: tuple[Part, ...], radius: Floats, place: Floats) -> Floats:
    """Depth (...) [m] at places (..., 3), below zero where they are apart."""
    beyond = [core.beyond(place) for core in parts]
    gaps = [core.rounding + radius - np.sqrt(dot(b, b)) for core, b in zip(parts, beyond, strict=True)]
    return joined(np.stack(gaps))


def joined(depths: Floats) -> Floats:
    """The depth (...) [m] of depths (parts, ...); where none is above zero, the greatest."""
    top = np.max(depths, axis=0)
    ratio = np.maximum(depths, 0.0) / np.where(top > 0.0, top, np.inf)
    return np.asarray(np.where(top > 0.0, top * np.sum(ratio**ORDER, axis=0) ** (1.0 / ORDER), top))


@dataclass(frozen=True, eq=False)
class Pieces:
    """q pieces of lines that touch: on which line, from which s to which."""

    line: Ints
    begin: Floats
    end: Floats

    def some(self, rows: Bools) -> Pieces:
        """Those of these rows."""
        return Pieces(self.line[rows], self.begin[rows], self.end[rows])

    def joined(self, other: Pieces) -> Pieces:
        """These and others."""
        both = zip((self.line, self.begin, self.end), (other.line, other.begin, other.end), strict=True)
        return Pieces(*(np.concatenate(pair) for pair in both))


def touching(parts: tuple[Part, ...], radius: Floats, begin: Floats, way: Floats) -> Pieces:
    """The pieces of lines (q,) that touch, on each of which the distance from every part is one root."""
    found = [stretches(core, begin, way, core.rounding + radius) for core in parts]
    if len(found) == 1:
        low, high = found[0].begin, found[0].end
    else:
        marks = [mark for each in found for mark in (each.cuts, each.begin, each.end)]
        edges = np.sort(np.concatenate(marks, axis=1), axis=1)
        low, high = edges[:, :-1], edges[:, 1:]
        place = begin[:, None] + (0.5 * (low + high))[..., None] * way[:, None]
        here = depth(parts, radius[:, None], place, np.zeros_like(place)).p
        high = np.where(here > 0.0, high, low)
    line, column = np.nonzero(high > low)
    return Pieces(line, low[line, column], high[line, column])


_LOOKS = np.linspace(0.0, 1.0, 33)


def deepest(parts: tuple[Part, ...], radius: Floats, begin: Floats, way: Floats) -> tuple[Floats, Floats]:
    """The greatest depth (q,) [m] on each line, negative where it is apart; and s (q,) there.

    Exact for one part.  Of several, that of looks along the line, drawn together three times round the best.
    """
    found = [stretches(core, begin, way, core.rounding + radius) for core in parts]
    if len(parts) == 1:
        return parts[0].rounding + radius - found[0].nearest, found[0].at
    low, high = np.zeros(len(begin)), np.ones(len(begin))
    starts = np.stack([each.at for each in found], axis=1)
    best = best_at = np.empty(0)
    for _ in range(4):
        s = np.concatenate((low[:, None] + (high - low)[:, None] * _LOOKS, starts), axis=1)
        place = begin[:, None] + s[..., None] * way[:, None]
        here = signed(parts, radius[:, None], place)
        k = np.argmax(here, axis=1)[:, None]
        best, best_at = (np.take_along_axis(values, k, axis=1)[:, 0] for values in (here, s))
        span = (high - low) / (len(_LOOKS) - 1)
        low, high = np.maximum(best_at - span, 0.0), np.minimum(best_at + span, 1.0)
    return best, best_at

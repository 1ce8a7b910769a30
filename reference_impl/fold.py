"""`[initial.fold]`: the net in its canister, with strings and bullets outside."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from reference_impl.accordion import accordion
from reference_impl.arrays import Floats, Ints
from reference_impl.canister import Fold, Places
from reference_impl.case import Case, Refused
from reference_impl.launch import unit_outwards
from reference_impl.net import Net, between
from reference_impl.shape import Hexagonal, Radial
from reference_impl.spread import spread
from reference_impl.star import star

_OF_STRING = 0.95  # distance of a string's ends over its length
_LEAST, _ROUND_OFF = 0.9, 1e-9  # chord of an element over its length; of lengths


def folded(case: Case, net: Net) -> Floats:
    """Places (n, 3) [m] at time 0 of the net's own nodes, in its axes."""
    fold, own = case.start.fold, net.tether < 0
    assert fold is not None
    ends, length, of_string = net.element_nodes[own], net.reference_length[own], net.of_string[own]
    d = 2.0 * float(np.sqrt(net.area[own].max() / np.pi))
    meshed = np.unique(ends[~of_string])
    if fold.places is not None:
        return _given(net, fold, fold.places, d, meshed)
    place = net.reference_position[: net.woven].copy()
    if fold.pattern == "star":
        place = _starred(case, net, fold, d, meshed)
    else:
        among = np.searchsorted(meshed, ends[~of_string])
        found, extent = accordion(
            place[meshed], among, length[~of_string], d, fold.prism - d, lambda at: fold.holds(at, d)
        )
        if found is None:
            raise _refused(fold, extent)
        place[meshed] = found
    _lead_strings(case, net, place, d)
    return place


def with_places(case: Case, reference_position: Floats, place: Floats) -> Case:
    """The case with its folded net where another program puts it: (n, 3) of all its nodes, in its axes [m].

    The format leaves places open, so that two folds by its rules differ. Raises Refused without a fold.
    """
    given = Places(np.asarray(reference_position, dtype=float), np.asarray(place, dtype=float))
    if case.start.fold is None:
        raise Refused(["places are for a net that is folded: the case has no initial.fold"])
    if given.place.shape != given.reference_position.shape or given.place.shape[1:] != (3,):
        raise Refused(["places: give a reference position and a place (n, 3) of each node"])
    return replace(case, start=replace(case.start, fold=replace(case.start.fold, places=given)))


def _given(net: Net, fold: Fold, places: Places, d: float, meshed: Ints) -> Floats:
    """Given places in this net's order, if they are those of a fold of it by the rules of the format."""
    flat = net.reference_position[: net.woven]
    if len(places.place) != len(flat):
        raise Refused([f"places: {len(places.place)} nodes are given, the net has {len(flat)}"])
    away, row = cKDTree(places.reference_position).query(flat)
    if away.max() > _ROUND_OFF * np.ptp(flat) or len(np.unique(row)) < len(row):
        raise Refused([f"places: none is given of the node at {flat[away.argmax()]} m"])
    place = np.asarray(places.place[row])
    if not np.isfinite(place).all():
        raise Refused(["places: they must be finite numbers"])
    if not fold.holds(place[meshed] * (1.0 - _ROUND_OFF), d):
        raise Refused(["places: the net is not inside its canister"])
    own = net.tether < 0
    chord = np.linalg.norm(np.diff(place[net.element_nodes[own]], axis=1)[:, 0], axis=1)
    part = chord / net.reference_length[own]
    worst = int(np.argmax(np.maximum(_LEAST - part, part - 1.0)))
    if not _LEAST - _ROUND_OFF <= part[worst] <= 1.0 + _ROUND_OFF:
        raise Refused([f"places: element {worst} has {part[worst]:.4f} of its length, not 0.9 to 1"])
    return place


def _refused(fold: Fold, extent: Floats) -> Refused:
    """What does not fit, with the extent (3,) [m] of what was found, NaN if nothing was."""
    would = "no creases were found that keep its elements at 90 to 100 % of their lengths"
    if not np.isnan(extent).any():
        would = "a box of {:.4g} x {:.4g} x {:.4g} m would hold it".format(*extent)
    return Refused([f"initial.fold: the net does not fit into its canister ({fold.pattern}): {would}"])


def _starred(case: Case, net: Net, fold: Fold, d: float, meshed: Ints) -> Floats:
    """Places (n, 3) [m] of a radial net, from wide pleats to narrow ones; strings still where they were."""
    shape, first = case.shape, np.full(3, np.nan)
    assert isinstance(shape, Radial)
    flat = net.reference_position[: net.woven]
    radius, angle = np.hypot(flat[:, 0], flat[:, 1]), np.arctan2(flat[:, 1], flat[:, 0])
    ring = np.rint(radius / shape.radius * shape.rings).astype(np.intp)
    spoke = np.rint(angle / (2.0 * np.pi) * shape.spokes).astype(np.intp) % shape.spokes
    knot = np.isin(np.arange(net.woven), meshed) & (net.parents[: net.woven, 0] == np.arange(net.woven))
    inner = np.setdiff1d(meshed, np.flatnonzero(knot))

    def laid(per_pleat: int, layer: float) -> Floats | None:
        knots = star(shape, per_pleat, layer)
        if knots is None:
            return None
        place = flat.copy()
        place[knot] = knots[ring[knot], spoke[knot]]
        place[knot, 2] -= 0.5 * (knots[..., 2].min() + knots[..., 2].max())
        place[inner] = between(place, net.parents[inner], net.shares[inner])
        return place

    ends = net.element_nodes[(net.tether < 0) & ~net.of_string]
    for per_pleat in range(shape.rings, 0, -1):
        place = laid(per_pleat, d)
        if place is None:
            continue
        if np.isnan(first).any():
            first = np.ptp(place[meshed], axis=0) + d
        if not fold.holds(place[meshed], d):
            continue
        place = spread(partial(laid, per_pleat), ends, d)
        if place is not None and fold.holds(place[meshed], d):
            return place
    raise _refused(fold, first)


def _lead_strings(case: Case, net: Net, place: Floats, d: float) -> None:
    """Puts the nodes of strings outside the net, whose own nodes in `place` (n, 3) [m] are folded already.

    An undivided string leaves its corner as in the flat net.  Two that hold one bullet put it at the same
    distance from both corners, outwards.  The nodes of a divided one are by turns near and far, each d
    farther aside.
    """
    if case.strings is None:
        return
    chains = net.element_nodes[net.of_string].reshape(-1, case.strings.divisions, 2)
    feet, tips = chains[:, 0, 0], chains[:, -1, 1]
    outward = unit_outwards(net.reference_position[tips])
    part = _OF_STRING * case.strings.length / case.strings.divisions
    if isinstance(case.shape, Hexagonal):
        _lead_bridles(chains, place, outward, part)
        return
    for k in range(case.strings.divisions):
        far, aside = (k + 1) % 2, np.column_stack((-outward[:, 1], outward[:, 0], np.zeros(len(feet))))
        shift = (k + 1) * d if case.strings.divisions > 1 else 0.0
        place[chains[:, k, 1]] = place[feet] + far * part * outward + shift * aside


def _lead_bridles(chains: Ints, place: Floats, outward: Floats, part: float) -> None:
    """Strings (q, divisions, 2) of bridles: straight, the bullet as far from the one foot as the other."""
    feet, tips = chains[:, 0, 0], chains[:, -1, 1]
    divisions = chains.shape[1]
    for tip in np.unique(tips):
        two = np.flatnonzero(tips == tip)
        one, other = place[feet[two]]
        gap, away = other - one, outward[two[0]]
        if np.any(gap):
            along = gap / np.linalg.norm(gap)
            away = away - np.dot(away, along) * along
            away = away / np.linalg.norm(away)
        aside = (part * divisions) ** 2 - 0.25 * np.dot(gap, gap)
        if aside < 0.0:
            raise Refused(["initial.fold: the strings of a bridle are too short for the place of its feet"])
        place[tip] = 0.5 * (one + other) + np.sqrt(aside) * away
        for string in two:
            ways = np.arange(1, divisions)[:, None] / divisions
            place[chains[string, :-1, 1]] = place[feet[string]] + ways * (place[tip] - place[feet[string]])

"""Strings and bullets of a folded net: outward from the folded corners, straight or to and fro.

A corner may lie where layers go round each other, so that threads of other layers are in the way; the string
then leaves it in the direction, nearest to outward, that is clear of them, or where none is, clearest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from exunet.net.arrays import Floats, Ints, Net
from exunet.net.canister import THREAD_ROUND_OFF
from exunet.net.meeting import between_segments

STRAIGHT = 0.95  # of a string's length, between its ends
_ASIDE = 3.0  # threads outward of its corner: where a string that lies to and fro turns beside it
_AT_MOST = 0.04  # of an element's length: the same
_TURNS = np.radians(np.arange(5.0, 95.0, 5.0))  # away from outward
_AROUND = np.radians(np.arange(0.0, 360.0, 15.0))


def with_strings(net: Net, position: Floats, forward: Floats, thread: float) -> Floats:
    """Positions (n_nodes, 3) with the strings in place, which leave the corners as they do in the flat net.

    A string of one element is straight, as are those of a bridle, in the plane of its bullet's two; one that
    is divided lies to and fro, its elements a thread apart.

    position : (n_nodes, 3) of the folded net [m]; what it says of strings is not used
    forward  : (n_nodes, 3) 1 or -1 by which an axis of the flat net runs, in the pleat of a corner
    """
    position = position.copy()
    strings = net.element_nodes[net.is_string]
    if not len(strings):
        return position
    chains = _chains(net)
    length = net.reference_length[net.is_string][0]
    order, starts = np.unique(chains[:, 0], return_index=True)
    number = np.bincount(chains[:, 0], minlength=order.max() + 1)[order]
    divisions = chains.shape[1] - 1
    placed = net.element_nodes[~net.is_string]
    for bullet, first, count in zip(order.tolist(), starts.tolist(), number.tolist(), strict=True):
        own = chains[first : first + count]
        corners = own[:, -1]
        outward = _outward(net, bullet, corners, forward)
        pieces = np.stack([own[:, :-1], own[:, 1:]], axis=-1).reshape(-1, 2)
        reach = position[corners[0]] + length * divisions * np.array([[-1.0], [1.0]])
        low, high = position[placed].min(axis=1), position[placed].max(axis=1)
        others = placed[((low < reach[1]) & (high > reach[0])).all(axis=1)]
        strange = (pieces[:, None, :, None] != others[:, None, :]).all(axis=(2, 3))
        clearest, best = -1.0, position
        for way in _ways(outward):
            if count == 1 and divisions > 1:
                position[own[0, ::-1]] = _to_and_fro(position[corners[0]], way, divisions, length, thread)
            else:
                end = _apex(position[corners], way, STRAIGHT * length * divisions)
                part = np.arange(divisions + 1)[:, None] / divisions
                for chain in own:
                    position[chain] = (1.0 - part) * end + part * position[chain[-1]]
            clear = _clear(position[pieces], position[others], strange)
            if clear > clearest:
                clearest, best = clear, position[own]
            if clear >= thread * (1.0 - THREAD_ROUND_OFF):
                break
        position[own] = best
        placed = np.concatenate([placed, pieces])
    return position


def _ways(outward: Floats) -> Iterator[Floats]:
    """Unit vectors (3,): outward, and others round it, the nearest first."""
    yield outward
    across = np.cross(outward, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, outward)
    for turn, around in product(_TURNS, _AROUND):
        aside = np.cos(around) * across + np.sin(around) * up
        yield np.cos(turn) * outward + np.sin(turn) * aside


def _clear(pieces: Floats, others: Floats, strange: np.ndarray) -> float:
    """How near pieces of a string (n, 2, 3) come to those threads (m, 2, 3) that are `strange` (n, m) [m]."""
    one, other = np.nonzero(strange)
    return float(between_segments(pieces[one], others[other]).min(initial=np.inf))


def _chains(net: Net) -> Ints:
    """(n_strings, divisions + 1) nodes from the bullet or free end to the corner, bullet by bullet."""
    ends = net.element_nodes[net.is_string]
    begins = np.flatnonzero(np.concatenate([[True], ends[1:, 0] != ends[:-1, 1]]))
    divisions = len(ends) // len(begins)
    chains = np.concatenate([ends[begins, :1], ends[:, 1].reshape(len(begins), divisions)], axis=1)
    return chains[np.argsort(chains[:, 0], kind="stable")]


def _outward(net: Net, bullet: int, corners: Ints, forward: Floats) -> Floats:
    """(3,) unit vector from the corners to the bullet in the flat net, turned as the corners' pleat is."""
    way = net.reference_position[bullet] - net.reference_position[corners].mean(axis=0)
    way = way * forward[corners[0]]
    return np.asarray(way / np.linalg.norm(way))


def _to_and_fro(corner: Floats, outward: Floats, divisions: int, length: float, thread: float) -> Floats:
    """(divisions + 1, 3) from the corner on: outward and back, moved on sideways by a thread each.

    It does not come back to the corner itself, where other threads leave it.
    """
    sideways = np.array([-outward[1], outward[0], 0.0])
    sideways = sideways / math.hypot(*outward[:2]) if sideways.any() else np.array([1.0, 0.0, 0.0])
    chord = 0.5 * (1.0 + STRAIGHT) * length
    reach = math.sqrt(max(chord * chord - thread * thread, 0.0))
    k = np.arange(divisions + 1)[:, None]
    aside = min(_ASIDE * thread, _AT_MOST * length) * (k > 0)
    return np.asarray(corner + np.where(k % 2, reach, aside) * outward + k * thread * sideways)


def _apex(corners: Floats, outward: Floats, length: float) -> Floats:
    """(3,) where strings of a length from one or two corners (n, 3) meet, outward of them."""
    middle = corners.mean(axis=0)
    half = corners[-1] - middle
    across = float(np.linalg.norm(half))
    if across > 0.0:
        outward = outward - (outward @ half) / across**2 * half
        outward = outward / np.linalg.norm(outward)
    height = math.sqrt(max(length * length - across * across, 0.0))
    return np.asarray(middle + height * outward)

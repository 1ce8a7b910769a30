"""Largest tensions of groups of elements, and their margins to the strength of the threads.

The margin of an element is strength / largest tension - 1: 0 where the tension reaches the strength, negative
beyond. The strength is what the case states for its cable or, where it states none, the limit of the effect
`breaking` (`Net.strength`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import shown, takes
from exunet.base.errors import InputError
from exunet.net.arrays import TETHER, Net
from exunet.results.result import Result, blocks, over_blocks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ALL_STEPS, STORED_TIMES = "all steps", "stored times"  # of which a largest tension is


@dataclass(frozen=True)
class Peak:
    """The largest tension of a group [N], when [s], and in which element (-1: none was ever taut).

    of : "all steps", or "stored times": a peak between two of these is not in it
    """

    tension: float
    time: float
    element: int
    of: str = ALL_STEPS


@dataclass(frozen=True)
class Margin:
    """The least margin of a group of elements.

    margin   : strength / tension - 1
    element  : which has it
    time     : when [s]
    tension  : its tension then [N]
    strength : of it [N]
    of       : "all steps", or "stored times": a peak between two of these is not in it
    """

    margin: float
    element: int
    time: float
    tension: float
    strength: float
    of: str


@takes(result=Result)
def margins(result: Result, among: NDArray[np.bool_] | None = None) -> dict[str, Margin]:
    """Compute the least margin to the strength of threads, of strings and of each tether.

    By "threads", "strings" and "tether NAME": of those whose strength the case states, or that can break, and
    that were ever taut.

    among : (n_elements,) True for the elements that count; None: all
    """
    if among is not None and np.shape(among) != (result.net.n_elements,):
        raise InputError(f"margins: among: needs {result.net.n_elements} True or False, got {shown(among)}")
    peaks = peaks_of_all_steps(result)
    found = {name: _least(result, own, peaks) for name, own in _groups(result.net, among).items()}
    return {name: margin for name, margin in found.items() if margin is not None}


def _groups(net: Net, among: NDArray[np.bool_] | None) -> dict[str, Ints]:
    """Elements whose strength is known, by the name of their group; no empty groups."""
    if net.strength is None:
        return {}
    known = net.strength > 0.0 if among is None else among & (net.strength > 0.0)
    own = np.arange(net.n_elements) < net.n_net_elements
    groups = {
        "threads": np.flatnonzero(known & own & ~net.is_string),
        "strings": np.flatnonzero(known & own & net.is_string),
        **{TETHER + name: np.array(run)[known[run]] for name, run in net.tether_elements.items()},
    }
    return {name: elements for name, elements in groups.items() if len(elements)}


def _least(result: Result, own: Ints, peaks: Mapping[str, Peak]) -> Margin | None:
    """Least margin of some elements; None if none of them was ever taut.

    peaks : the largest tension of all steps of each of `Net.spans`, as far as they are known. That of a span
            is the worst of it, whose elements bear the same; unless its element is not one of `own`
    """
    net = result.net
    assert net.strength is not None
    worst, which, when, first = 0.0, -1, 0.0, 0
    for block in blocks(result.tension):
        parts = block[:, own] / net.strength[own]
        row, column = np.unravel_index(int(parts.argmax()), parts.shape)
        if parts[row, column] > worst:
            worst, which, when = float(parts[row, column]), int(own[column]), float(result.time[first + row])
        first += len(block)
    known = 0  # elements of which all steps are
    for name, peak in peaks.items():
        mine = own[np.isin(own, net.spans[name])]
        if peak.of != ALL_STEPS or not len(mine):
            continue
        if peak.element in mine:
            bears = float(net.strength[peak.element])
            if peak.tension >= worst * bears:
                worst, which, when = peak.tension / bears, peak.element, peak.time
        if peak.element in mine or peak.element < 0:
            known += len(mine)
    if worst <= 0.0:
        return None
    of, bears = ALL_STEPS if known == len(own) else STORED_TIMES, float(net.strength[which])
    return Margin(1.0 / worst - 1.0, which, when, worst * bears, bears, of)


def peaks_of_all_steps(result: Result) -> dict[str, Peak]:
    """Return the largest tension of all steps of each of `Net.spans`, as far as the run records it."""
    spans, every = result.net.spans, result.provenance.get("largest_tensions", {})
    if not every and (whole := result.provenance.get("largest_tension")):
        every = {name: whole for name, own in spans.items() if whole["element"] in own or len(spans) == 1}
    return {name: Peak(one["tension_N"], one["time_s"], one["element"]) for name, one in every.items()}


def peaks_of(result: Result) -> dict[str, Peak]:
    """Return the largest tension of each of `Net.spans`; of the stored times where the run has no other."""
    known, spans = peaks_of_all_steps(result), result.net.spans
    return {name: known.get(name) or _at_stored_times(result, own) for name, own in spans.items()}


def _at_stored_times(result: Result, own: range) -> Peak:
    largest = over_blocks(lambda part: part[:, own.start : own.stop].max(axis=1, initial=0.0), result.tension)
    at = int(np.argmax(largest))
    element = -1
    if largest[at] > 0.0:
        element = own.start + int(np.argmax(result.tension[at][own.start : own.stop]))
    return Peak(float(largest[at]), float(result.time[at]), element, STORED_TIMES)

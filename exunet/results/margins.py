"""Margins: how far the largest tensions stay below what the threads are said to bear.

The margin of an element is strength / largest tension - 1: 0 where the tension reaches the strength, negative
beyond. The strength is what the case states for its cable or, where it states none, the limit of the effect
`breaking` (`Net.strength`). Margins are told of groups: the threads of the net, its strings, each tether.
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

THREADS, STRINGS = "threads", "strings"
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


@dataclass(frozen=True, eq=False)
class Groups:
    """The elements whose strength is known, in groups.

    names    : "threads", "strings", and "tether NAME" of each tether
    elements : of each group
    strength : (n_elements,) [N]; 0: not known
    spans    : `Net.spans`
    """

    names: tuple[str, ...]
    elements: tuple[Ints, ...]
    strength: Floats
    spans: Mapping[str, range]

    @classmethod
    def of(cls, net: Net, among: NDArray[np.bool_] | None = None) -> Groups | None:
        """The groups that are not empty; None if no strength is known. among: only of these elements."""
        if net.strength is None:
            return None
        known = net.strength > 0.0 if among is None else among & (net.strength > 0.0)
        own = np.arange(net.n_elements) < net.n_net_elements
        tethers = {TETHER + name: np.array(run) for name, run in net.tether_elements.items()}
        found = {
            THREADS: np.flatnonzero(known & own & ~net.is_string),
            STRINGS: np.flatnonzero(known & own & net.is_string),
            **{name: run[known[run]] for name, run in tethers.items()},
        }
        found = {name: elements for name, elements in found.items() if len(elements)}
        return cls(tuple(found), tuple(found.values()), net.strength, net.spans) if found else None

    def loaded(self, tension: Floats) -> tuple[Floats, Ints]:
        """(t, groups) largest tension / strength in each group, and in which element; tension (t, n) [N]."""
        shape = (len(tension), len(self.names))
        part, element = np.zeros(shape), np.zeros(shape, dtype=np.int64)
        for k, own in enumerate(self.elements):
            parts = tension[:, own] / self.strength[own]
            at = parts.argmax(axis=1)
            part[:, k], element[:, k] = parts[np.arange(len(parts)), at], own[at]
        return part, element

    def least(
        self, number: int, time: Floats, part: Floats, element: Ints, peaks: Mapping[str, Peak]
    ) -> Margin | None:
        """Of a group over times (t,) [s], from what `loaded` gave; None if none of it was ever taut.

        peaks : the largest tension of all steps of each of `spans`, as far as they are known. That of a span
                is the worst of it, whose elements bear the same; unless its element is not looked at
        """
        own, at = self.elements[number], int(part[:, number].argmax())
        worst, which, when = float(part[at, number]), int(element[at, number]), float(time[at])
        known = 0  # elements of which all steps are
        for name, peak in peaks.items():
            mine = own[np.isin(own, self.spans[name])]
            if peak.of != ALL_STEPS or not len(mine):
                continue
            if peak.element in mine:
                bears = float(self.strength[peak.element])
                if peak.tension >= worst * bears:
                    worst, which, when = peak.tension / bears, peak.element, peak.time
            if peak.element in mine or peak.element < 0:
                known += len(mine)
        of = ALL_STEPS if known == len(own) else STORED_TIMES
        if worst <= 0.0:
            return None
        bears = float(self.strength[which])
        return Margin(1.0 / worst - 1.0, which, when, worst * bears, bears, of)


def loaded_over_blocks(groups: Groups | None, tension: Floats) -> tuple[Floats, Ints]:
    """`Groups.loaded` of stored tensions that may be larger than memory; (t, 0) without groups."""
    if groups is None:
        return np.zeros((len(tension), 0)), np.zeros((len(tension), 0), dtype=np.int64)
    found = [groups.loaded(block) for block in blocks(tension)]
    return np.concatenate([part for part, _ in found]), np.concatenate([element for _, element in found])


@takes(result=Result)
def margins(result: Result, among: NDArray[np.bool_] | None = None) -> dict[str, Margin]:
    """The least margin to the strength of threads, of strings and of each tether, by "threads", "strings" and
    "tether NAME": of those whose strength the case states, or that can break, and that were ever taut.

    among : (n_elements,) True for the elements that are looked at; None: all
    """
    if among is not None and np.shape(among) != (result.net.n_elements,):
        raise InputError(f"margins: among: needs {result.net.n_elements} True or False, got {shown(among)}")
    groups = Groups.of(result.net, among)
    part, element = loaded_over_blocks(groups, result.tension)
    peaks = peaks_of_all_steps(result)
    names = () if groups is None else groups.names
    found = {}
    for k, name in enumerate(names):
        assert groups is not None
        if (one := groups.least(k, result.time, part, element, peaks)) is not None:
            found[name] = one
    return found


def peaks_of_all_steps(result: Result) -> dict[str, Peak]:
    """The largest tension of all steps of each of `Net.spans`, of those of which the run tells it."""
    spans, every = result.net.spans, result.provenance.get("largest_tensions", {})
    if not every and (whole := result.provenance.get("largest_tension")):
        every = {name: whole for name, own in spans.items() if whole["element"] in own or len(spans) == 1}
    return {name: Peak(one["tension_N"], one["time_s"], one["element"]) for name, one in every.items()}


def peaks_of(result: Result) -> dict[str, Peak]:
    """The largest tension of each of `Net.spans`; of the stored times where the run tells no other."""
    known, spans = peaks_of_all_steps(result), result.net.spans
    return {name: known.get(name) or _at_stored_times(result, own) for name, own in spans.items()}


def _at_stored_times(result: Result, own: range) -> Peak:
    largest = over_blocks(lambda part: part[:, own.start : own.stop].max(axis=1, initial=0.0), result.tension)
    at = int(np.argmax(largest))
    element = -1
    if largest[at] > 0.0:
        element = own.start + int(np.argmax(result.tension[at][own.start : own.stop]))
    return Peak(float(largest[at]), float(result.time[at]), element, STORED_TIMES)

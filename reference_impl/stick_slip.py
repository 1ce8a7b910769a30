"""When lines begin to touch, to slide and to stick, in adaptive methods; see `friction` for the law.

Margins that reach zero from below, at which steps end: of a line that is apart its depth; of one that sticks
|T*| - mu N, and how far s_m is outside; of one that slides -lambda.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Ints, dot
from reference_impl.contact_forces import View
from reference_impl.contacts import Contacts, Group, Pressed, depths
from reference_impl.forces import seen
from reference_impl.friction import (
    APART,
    DELAY,
    HELD,
    LOOK_AHEAD,
    SLIDING,
    SLOPE,
    Bristles,
    Memory,
    across,
    bristles,
)
from reference_impl.rounded import depth
from reference_impl.state import Layout

_FINITE = 1e-12  # [s] a line that starts to touch at a speed has slid for less


@dataclass(frozen=True, eq=False)
class Slide:
    """How t sliding lines go on: e' (t, 3) [1/s] and lambda (t,) [m/s], inf where they come off."""

    turning: Floats
    rate: Floats


@dataclass(frozen=True, eq=False)
class Adhesion:
    """The changes of what friction remembers of a system."""

    layout: Layout
    contacts: Contacts

    def views(self, y: Floats) -> list[View]:
        """What may touch in a state."""
        packed = bool(np.any(self.layout.packed(y)))
        return seen(self.layout.system, self.layout.whole(y), packed)

    def turning(self, y: Floats, rate: Floats, memory: Memory) -> Floats:
        """e' (3 P,) of the bristles that slide, in a state of the rate dy/dt."""
        result = np.zeros((self.contacts.pairs, 3))
        if np.any(memory.law == SLIDING):
            for group, rows, slide in self._slides(y, rate, memory):
                result[group.first + rows] = slide.turning
        return result.ravel()

    def _slides(self, y: Floats, rate: Floats, memory: Memory) -> list[tuple[Group, Ints, Slide]]:
        """Of each group the lines that slide, and how."""
        e, found = self.layout.bristles(y), []
        later = [self.views(y + k * LOOK_AHEAD * rate) for k in (1, 2, 3)]
        for k, view in enumerate(self.views(y)):
            group = view.group
            rows = view.rows[memory.law[group.first + view.rows] == SLIDING]
            if len(rows):
                instants = [view, *(views[k] for views in later)]
                found.append((group, rows, self._slide(group, rows, instants, e[group.first + rows])))
        return found

    def _slide(self, group: Group, rows: Ints, instants: list[View], e: Floats) -> Slide:
        lines, law = group.some(rows), self.contacts.law
        pressed = [self.contacts.press(group, view.x, view.w, rows) for view in instants]
        reach = [
            law.friction * _spread(rows, each, each.normal) / lines.stiffness for each in pressed
        ]  # (t,) each; NaN where nothing presses
        m = [_spread(rows, each, each.direction) for each in pressed]
        s0, s1 = (_spread(rows, each, each.s) for each in pressed[:2])
        now = np.isfinite(s0)  # a line that starts to touch may press in an instant only
        s, normal = np.where(now, s0, s1), np.where(now[:, None], m[0], m[1])
        slips = [across(n, lines.at(s, view.w)) for n, view in zip(m[1:], instants[1:], strict=True)]
        change = np.einsum("k,ktc->tc", SLOPE, np.stack(slips))
        stays = np.isfinite(change[:, 0]) & np.isfinite(s)
        moving = across(normal, lines.at(s, instants[0].w))
        moving = moving + lines.lag[:, None] * np.where(stays[:, None], across(normal, change), 0.0)
        along = across(normal, e)
        size = np.sqrt(dot(along, along))
        along = along / np.where(size > 0.0, size, np.inf)[:, None]
        slip = dot(along, moving)
        way = np.where(now, reach[0], 0.0) + DELAY * np.sqrt(dot(moving, moving))
        turn = (moving - slip[:, None] * along) / np.where(way > 0.0, way, np.inf)[:, None]
        growth = np.einsum("k,kt->t", SLOPE, np.stack(reach[1:]))
        return Slide(np.where(now[:, None], np.nan_to_num(turn), 0.0), np.where(stays, slip - growth, np.inf))

    def margins(self, y: Floats, rate: Floats, memory: Memory) -> Floats:
        """(P, 2) in a state of the rate dy/dt; -inf where there is nothing to wait for."""
        result = np.full((self.contacts.pairs, 2), -np.inf)
        for view in self.views(y):
            group = view.group
            law = memory.law[group.first + view.rows]
            apart = view.rows[law == APART]
            result[group.first + apart, 0] = depths(group, view.x, apart)[0][apart]
            held = view.rows[law == HELD]
            if len(held):
                these = self._bristles(view, held, memory)
                result[group.first + held, 0] = 0.0  # of what presses no more
                result[group.first + these.found.row, 0] = these.excess()
                result[group.first + these.found.row, 1] = -these.depth()
        if np.any(memory.law == SLIDING):
            for group, rows, slide in self._slides(y, rate, memory):
                result[group.first + rows, 0] = -slide.rate
        return result

    def _bristles(self, view: View, rows: Ints, memory: Memory) -> Bristles:
        found = self.contacts.press(view.group, view.x, view.w, rows)
        return bristles(self.contacts.law, view.group, found, memory, view.x, view.w)

    def settle(self, y: Floats, rate: Floats, memory: Memory) -> tuple[Floats, Memory, bool]:
        """State and memory after what is due in a state of the rate dy/dt, and whether any of it was."""
        after, y = memory.copy(), y.copy()
        e = self.layout.bristles(y)
        for view in self.views(y):
            self._begin_and_end(view, memory, after, e)
            self._let_slide(view, memory, after, e)
        if np.any(after.law == SLIDING):
            views = {view.group.first: view for view in self.views(y)}
            for group, rows, slide in self._slides(y, rate, after):
                before = memory.law[group.first + rows]
                rows = rows[(slide.rate <= 0.0) & (before != HELD)]  # what begins to slide now does so
                self._hold(views[group.first], rows, after, e)
        e[after.law != SLIDING] = 0.0
        length = np.sqrt(dot(e, e))[:, None]
        e /= np.where(length > 0.0, length, 1.0)
        changed = not all(np.array_equal(a, b) for a, b in ((after.law, memory.law), (after.b, memory.b)))
        return y, after, changed

    def _begin_and_end(self, view: View, memory: Memory, after: Memory, e: Floats) -> None:
        """Forgets what has ceased to touch, and remembers what now touches."""
        group, x, w = view.group, view.x, view.w
        deep, at = depths(group, x, view.rows)
        law = memory.law[group.first : group.first + len(deep)]
        after.put(group, np.flatnonzero((law != APART) & (deep < 0.0)), APART)
        rows = np.flatnonzero((law == APART) & (deep >= 0.0))
        if not len(rows):
            return
        lines, s = group.some(rows), at[rows]
        m = depth(lines.parts, lines.radius, lines.at(s, x), lines.at(s, w)).outwards
        reach = np.zeros(len(rows))
        found = self.contacts.press(group, x, w, rows)
        there = np.searchsorted(rows, found.row)
        pressing = found.normal > 0.0
        s[there[pressing]], m[there[pressing]] = found.s[pressing], found.direction[pressing]
        reach[there] = self.contacts.law.friction * found.normal / lines.stiffness[there]
        slip = across(m, lines.at(s, w))
        speed = np.sqrt(dot(slip, slip))
        sticks = (reach > _FINITE * speed) & (lines.lag * speed <= reach)
        after.put(group, rows, SLIDING, s, lines.at(s, x))
        after.put(group, rows[sticks], HELD)
        e[group.first + rows] = slip / np.where(speed > 0.0, speed, np.inf)[:, None]

    def _let_slide(self, view: View, memory: Memory, after: Memory, e: Floats) -> None:
        """What is pulled too hard slides; what sticks at a place that touches no more sticks at another."""
        group = view.group
        here = group.first + view.rows
        rows = view.rows[(memory.law[here] == HELD) & (after.law[here] == HELD)]
        these = self._bristles(view, rows, memory)
        slides = these.excess() >= 0.0
        row, z = these.found.row[slides], these.stretched()[slides]
        after.put(group, row, SLIDING)
        e[group.first + row] = z / np.maximum(np.sqrt(dot(z, z)), np.finfo(float).tiny)[:, None]
        moved = ~slides & (these.depth() <= 0.0)
        after.put(
            group,
            these.found.row[moved],
            HELD,
            these.found.s[moved],
            these.anchored(these.stretched())[moved],
        )

    def _hold(self, view: View, rows: Ints, after: Memory, e: Floats) -> None:
        """Lines that slid stick with the bristle that they have."""
        group = view.group
        these = self._bristles(view, rows, after)
        row = these.found.row
        along = across(these.found.direction, e[group.first + row])
        b = these.anchored(these.reach[:, None] * along)
        after.put(group, row, HELD, these.found.s, b)


def _spread(rows: Ints, found: Pressed, values: Floats) -> Floats:
    """Values (t, ...) of all `rows`, NaN of those that nothing presses."""
    result = np.full((len(rows), *values.shape[1:]), np.nan)
    pressing = found.normal > 0.0
    result[np.searchsorted(rows, found.row[pressing])] = values[pressing]
    return result

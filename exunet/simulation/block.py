"""Blocks of accepted states, with marks at stops: while they grow, and as observers see them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces.terms import Change, Memories
from exunet.integrators.protocol import Arrays, Extremes
from exunet.model.states import States
from exunet.model.system import System


class Observed(NamedTuple):
    """Accepted states, in order of time; the first is the last that observers have seen before.

    states     : with the same discrete states, but for those that steps change
    marks      : rows of the states at the times that a run stops at, which are stored
    memories   : at each of these, the discrete states that steps change
    extremes   : at each, of the steps since the one before that are not among the states; None: all are
    dissipated : (k,) energy dissipated until each state [J]; empty without an energy balance
    """

    states: States
    marks: list[int]
    memories: list[Memories]
    extremes: list[Extremes | None]
    dissipated: Floats

    def between(self, first: int, last: int) -> Observed:
        """Select the states from row `first` to row `last`, whose mark it has; that of the first is seen."""
        begin = 0 if first == 0 else int(np.searchsorted(self.marks, first, side="right"))
        kept = slice(begin, int(np.searchsorted(self.marks, last, side="right")))
        rows = slice(first, last + 1)
        marks = [mark - first for mark in self.marks[kept]]
        return Observed(
            self.states[rows], marks, self.memories[kept], self.extremes[kept], self.dissipated[rows]
        )


_ROWS = 256  # states that observers get in one go: enough to be fast, few enough to come soon
_NUMBERS = 2**19  # of one array; bounds memory


class Block:
    """Accepted states that observers have not seen, behind the last that they have."""

    def __init__(self, system: System, time: float, x: Floats, v: Floats, least: int) -> None:
        self._system = system
        self.room = max(least, min(_ROWS, _NUMBERS // max(1, v.size)))
        self._time, self._taken = np.empty(self.room), np.zeros(self.room)
        self._x, self._v = np.empty((self.room, x.size)), np.empty((self.room, v.size))
        self._sums = False  # the stepper sums the energy that is taken
        self.rows = 0
        self.put(time, x, v)
        self._clear()

    def _clear(self) -> None:
        self._marks: list[int] = []
        self._memories: list[Memories] = []
        self._extremes: list[Extremes | None] = []
        self._since: Extremes | None = None  # since the last mark

    def put(self, time: float, x: Floats, v: Floats) -> None:
        """Add a state."""
        row = self.rows
        self._time[row], self._x[row], self._v[row] = time, x, v
        self._taken[row] = self._taken[row - 1] if row else 0.0
        self.rows = row + 1

    def add(self, states: States, first: int) -> int:
        """Add states from row `first` on while there is room; return the number of the next."""
        number = min(states.time.size - first, self.room - self.rows)
        here, there = slice(self.rows, self.rows + number), slice(first, first + number)
        self._time[here], self._x[here], self._v[here] = states.time[there], states.x[there], states.v[there]
        if states.taken is not None:
            self._sums, self._taken[here] = True, states.taken[there]
        self.rows += number
        return first + number

    def gather(self, extremes: Extremes | None) -> None:
        """Take extremes of steps that are not among the states."""
        before = self._since
        if extremes is not None and before is not None:
            (elastic, kinetic), (largest, least) = before.energies.tolist(), extremes.energies.tolist()
            energies = np.array([max(elastic, largest), min(kinetic, least)])
            extremes = extremes._replace(energies=energies)
        self._since = extremes or before

    def mark(self, memory: Memories, first: int | None = None) -> None:
        """Mark the last state, or those from row `first` on, with the discrete states that steps change."""
        new = list(range(self.rows - 1 if first is None else first, self.rows))
        self._marks += new
        self._memories += [memory] * len(new)
        self._extremes += [*[None] * (len(new) - 1), self._since]
        self._since = None

    def remember(self, memory: Memories) -> bool:
        """Replace the discrete states of the last state if it is marked."""
        marked = bool(self._marks) and self._marks[-1] == self.rows - 1
        if marked:
            self._memories[-1] = memory
        return marked

    @property
    def time(self) -> float:
        """Time of the last state [s]."""
        return float(self._time[self.rows - 1])

    @property
    def finite(self) -> bool:
        """True if the last state is; the squares of the largest numbers may be said not to be."""
        x, v = self._x[self.rows - 1], self._v[self.rows - 1]
        return math.isfinite(np.vdot(x, x)) and math.isfinite(np.vdot(v, v))  # which do not warn

    def changed(self, change: Change) -> None:
        """Let an event change the only state."""
        self._taken[0] += change.energy_lost or 0.0
        if change.x is not None:
            self._x[0] = change.x
        if change.v is not None:
            self._v[0] = change.v

    def take(self, memory: Memories) -> Observed | None:
        """Return the states, and keep the last as the first; None without a new state or mark."""
        rows = self.rows
        if rows < 2 and not self._marks:
            return None
        every = self._time, self._x, self._v, self._taken
        time, x, v, taken = (part[:rows] for part in every)
        if 2 * rows > self.room:  # then new arrays take less time than copies
            self._time, self._taken = np.empty(self.room), np.zeros(self.room)
            self._x, self._v = np.empty((self.room, x.shape[1])), np.empty((self.room, v.shape[1]))
        else:
            time, x, v, taken = time.copy(), x.copy(), v.copy(), taken.copy()
        for part, own in zip((self._time, self._x, self._v, self._taken), (time, x, v, taken), strict=True):
            part[0] = own[-1]
        states = States(self._system, time, x, v, memory, taken if self._sums else None).completed()
        found = Observed(states, self._marks, self._memories, self._extremes, np.zeros(0))
        self.rows, since = 1, self._since
        self._clear()
        self._since = since
        return found

    def save(self) -> dict[str, NDArray[Any]]:
        """Return copies of all."""
        rows = slice(self.rows)
        arrays = {
            "time": self._time[rows],
            "x": self._x[rows],
            "v": self._v[rows],
            "taken": self._taken[rows],
        }
        arrays |= {"marks": np.array(self._marks, dtype=np.int64), "sums": np.array([self._sums])}
        found = {name: np.array(values) for name, values in arrays.items()}
        for name in self._memories[0] if self._memories else {}:
            found[f"memory/{name}"] = np.array([memory[name] for memory in self._memories])
        for what, seen in (("marks", self._extremes), ("since", [self._since])):
            known = [extremes for extremes in seen if extremes is not None]
            for name in Extremes._fields:
                found[f"{what}/{name}"] = np.array([getattr(extremes, name) for extremes in known])
        return found

    def load(self, arrays: Arrays) -> None:
        """Go back to what `save` returned."""
        self.rows = len(arrays["time"])
        for name, part in (("time", self._time), ("x", self._x), ("v", self._v), ("taken", self._taken)):
            part[: self.rows] = arrays[name]
        self._marks, self._sums = arrays["marks"].tolist(), bool(arrays["sums"][0])
        names = [name for name in arrays if name.startswith("memory/")]
        self._memories = [{name[7:]: arrays[name][k] for name in names} for k in range(len(self._marks))]
        self._extremes = _unpacked("marks", arrays) or [None] * len(self._marks)
        (self._since,) = _unpacked("since", arrays) or [None]


def _unpacked(group: str, arrays: Arrays) -> list[Extremes | None]:
    """Return the extremes that `Block.save` packed: of every mark, or none."""
    parts = (np.array(arrays[f"{group}/{name}"]) for name in Extremes._fields)
    return [Extremes(*rows) for rows in zip(*parts, strict=True)]

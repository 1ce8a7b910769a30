"""Blocks of accepted states, with marks at stops: while they grow, and as observers see them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.files import group_of, grouped
from exunet.forces.terms import Change, DiscreteStates
from exunet.integrators.protocol import Arrays, Extremes
from exunet.model.states import States
from exunet.model.system import System


class Observed(NamedTuple):
    """Accepted states, in order of time; the first is the last that observers have seen before.

    states          : with the same discrete states, but for those that steps change
    marks           : rows of the states at the times that a run stops at, which are stored
    discrete_states : at each of these, the discrete states that steps change
    extremes        : at each, of the steps since the one before that are not among the states; None: all are
    dissipated      : (k,) energy dissipated until each state [J]; empty without an energy balance
    """

    states: States
    marks: list[int]
    discrete_states: list[DiscreteStates]
    extremes: list[Extremes | None]
    dissipated: Floats

    def between(self, first: int, last: int) -> Observed:
        """Select the states from row `first` to row `last`, whose mark it has; that of the first is seen."""
        begin = 0 if first == 0 else int(np.searchsorted(self.marks, first, side="right"))
        kept = slice(begin, int(np.searchsorted(self.marks, last, side="right")))
        rows = slice(first, last + 1)
        marks = [mark - first for mark in self.marks[kept]]
        return Observed(
            self.states[rows], marks, self.discrete_states[kept], self.extremes[kept], self.dissipated[rows]
        )


_ROWS = 256  # states that observers get in one go: enough to be fast, few enough to come soon
_NUMBERS = 2**19  # of one array; bounds memory


class Block:
    """Accepted states that observers have not seen, behind the last that they have."""

    def __init__(self, system: System, time: float, x: Floats, v: Floats, least: int) -> None:
        self._system = system
        self.room = max(least, min(_ROWS, _NUMBERS // max(1, v.size)))
        self._shapes = {"time": (), "x": x.shape, "v": v.shape, "taken": ()}
        self._since: Extremes | None = None  # since the last mark
        self._sums = False  # the stepper sums the energy that is taken
        self.rows = 0
        self._clear()
        self._make()
        self.put(time, x, v)

    def _clear(self) -> None:
        self._marks: list[int] = []
        self._discrete_states: list[DiscreteStates] = []
        self._extremes: list[Extremes | None] = []

    def _make(self) -> None:
        self._parts = {name: np.empty((self.room, *shape)) for name, shape in self._shapes.items()}

    def put(self, time: float, x: Floats, v: Floats) -> None:
        """Add a state."""
        row, taken = self.rows, self._parts["taken"]
        for name, value in (("time", time), ("x", x), ("v", v), ("taken", taken[row - 1] if row else 0.0)):
            self._parts[name][row] = value
        self.rows = row + 1

    def add(self, states: States, first: int) -> int:
        """Add states from row `first` on while there is room; return the number of the next."""
        number = min(states.time.size - first, self.room - self.rows)
        here, there = slice(self.rows, self.rows + number), slice(first, first + number)
        parts, self._sums = self._parts, states.taken is not None
        parts["time"][here], parts["x"][here] = states.time[there], states.x[there]
        parts["v"][here], parts["taken"][here] = (
            states.v[there],
            0.0 if states.taken is None else states.taken[there],
        )
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

    def mark(self, discrete: DiscreteStates, first: int | None = None) -> None:
        """Mark the last state, or those from row `first` on, with the discrete states that steps change."""
        new = list(range(self.rows - 1 if first is None else first, self.rows))
        self._marks += new
        self._discrete_states += [discrete] * len(new)
        self._extremes += [*[None] * (len(new) - 1), self._since]
        self._since = None

    def replace_marked(self, discrete: DiscreteStates) -> bool:
        """Replace the discrete states of the last state if it is marked; True if it is."""
        marked = bool(self._marks) and self._marks[-1] == self.rows - 1
        if marked:
            self._discrete_states[-1] = discrete
        return marked

    @property
    def time(self) -> float:
        """Time of the last state [s]."""
        return float(self._parts["time"][self.rows - 1])

    @property
    def finite(self) -> bool:
        """True if the last state is; the squares of the largest numbers may be said not to be."""
        x, v = self._parts["x"][self.rows - 1], self._parts["v"][self.rows - 1]
        return math.isfinite(np.vdot(x, x)) and math.isfinite(np.vdot(v, v))  # which do not warn

    def changed(self, change: Change) -> None:
        """Let an event change the only state."""
        self._parts["taken"][0] += change.energy_lost or 0.0
        for name, new in (("x", change.x), ("v", change.v)):
            if new is not None:
                self._parts[name][0] = new

    def take(self, discrete: DiscreteStates) -> Observed | None:
        """Return the states, and keep the last as the first; None without a new state or mark."""
        rows = self.rows
        if rows < 2 and not self._marks:
            return None
        own = {name: part[:rows] for name, part in self._parts.items()}
        if 2 * rows > self.room:  # then new arrays take less time than copies
            self._make()
        else:
            own = {name: part.copy() for name, part in own.items()}
        for name, part in own.items():
            self._parts[name][0] = part[-1]
        taken = own["taken"] if self._sums else None
        states = States(self._system, own["time"], own["x"], own["v"], discrete, taken).completed()
        found = Observed(states, self._marks, self._discrete_states, self._extremes, np.zeros(0))
        self.rows = 1
        self._clear()
        return found

    def save(self) -> dict[str, NDArray[Any]]:
        """Return copies of all."""
        found: dict[str, NDArray[Any]] = {
            name: part[: self.rows].copy() for name, part in self._parts.items()
        }
        found |= {"marks": np.array(self._marks, dtype=np.int64), "sums": np.array([self._sums])}
        names = self._discrete_states[0] if self._discrete_states else {}
        discrete = {name: np.array([at[name] for at in self._discrete_states]) for name in names}
        found |= grouped("discrete", discrete)
        for what, seen in (("marks", self._extremes), ("since", [self._since])):
            known = [extremes for extremes in seen if extremes is not None]
            for name in Extremes._fields:
                found[f"{what}/{name}"] = np.array([getattr(extremes, name) for extremes in known])
        return found

    def load(self, arrays: Arrays) -> None:
        """Go back to what `save` returned."""
        self.rows = len(arrays["time"])
        for name, part in self._parts.items():
            part[: self.rows] = arrays[name]
        self._marks, self._sums = arrays["marks"].tolist(), bool(arrays["sums"][0])
        discrete = group_of("discrete", arrays)
        self._discrete_states = [
            {name: values[k] for name, values in discrete.items()} for k in range(len(self._marks))
        ]
        self._extremes = _unpacked("marks", arrays) or [None] * len(self._marks)
        (self._since,) = _unpacked("since", arrays) or [None]


def _unpacked(group: str, arrays: Arrays) -> list[Extremes | None]:
    """Return the extremes that `Block.save` packed: of every mark, or none."""
    parts = (np.array(arrays[f"{group}/{name}"]) for name in Extremes._fields)
    return [Extremes(*rows) for rows in zip(*parts, strict=True)]

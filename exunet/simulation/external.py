"""External forces and inputs of a simulation: one vector, and the times until which each acted."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.arguments import finite_vector, shown, whole_number
from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.model.system import System


class Stops:
    """Times [s] to which a simulation was advanced, each with the external forces and inputs until there."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._forces: list[Floats] = []

    def next(self, after: float, last: float, number: int) -> tuple[list[float], Floats] | None:
        """Return the next times, at most so many, and the vector until the first; None if that is later."""
        first = self.after(after)
        times = self._times[first : first + number]
        return (times, self._forces[first]) if times and times[0] <= last else None

    def add(self, times: Sequence[float], force: Floats) -> None:
        """Add later times; equal vectors are stored once, without a copy."""
        last = self._forces[-1] if self._forces else force
        self._times += times
        self._forces += [last if force is last or np.array_equal(force, last) else force] * len(times)

    def after(self, time: float) -> int:
        """Return the number of the first stop after a time [s]."""
        return bisect_right(self._times, time)

    def forget_until(self, time: float) -> None:
        """Drop the stops until a time [s]."""
        first = self.after(time)
        del self._times[:first], self._forces[:first]

    def forget_after(self, time: float) -> None:
        """Drop the stops after a time [s]."""
        first = self.after(time)
        del self._times[first:], self._forces[first:]

    def save(self, after: float, until: float) -> dict[str, NDArray[Any]]:
        """Return the stops between two times [s]; each distinct vector once."""
        own = slice(self.after(after), self.after(until))
        times, forces = self._times[own], self._forces[own]
        distinct = {id(force): force for force in forces}
        number = {key: k for k, key in enumerate(distinct)}
        return {
            "times": np.array(times, dtype=float),
            "force": np.array([number[id(force)] for force in forces], dtype=np.int64),
            "forces": np.array(list(distinct.values()), dtype=float),
        }

    def load(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `save` returned."""
        forces = [np.array(force) for force in arrays["forces"]]
        self._times = arrays["times"].tolist()
        self._forces = [forces[k] for k in arrays["force"].tolist()]


class ExternalInputs:
    """Layout of the vector of external forces (3 n_points,) [N] and inputs.

    at_start : vector at time 0
    """

    def __init__(self, system: System) -> None:
        self._blocks, self._scripted = system.blocks, system.scripted
        inputs = {name: value for name, value in system.inputs.items() if name not in system.scripted}
        parts = [np.zeros(3 * system.blocks.n_points), *(value.initial for value in inputs.values())]
        self.at_start: Floats = np.concatenate(parts)
        ends = np.cumsum([len(part) for part in parts])
        self._where = {
            name: slice(start, end) for name, start, end in zip(inputs, ends[:-1], ends[1:], strict=True)
        }

    def forces(self, vector: Floats) -> Floats:
        """Return the forces (n_points, 3) [N]."""
        return vector[: 3 * self._blocks.n_points].reshape(-1, 3)

    def inputs(self, vector: Floats) -> dict[str, Floats]:
        """Return the values of each input, by name."""
        return {name: vector[where] for name, where in self._where.items()}

    def with_force(self, vector: Floats, on: int | str, force: ArrayLike) -> Floats:
        """Return a new vector with another force (3,) [N] on a node.

        Raises InputError for an unknown node, and for a force that is not three finite numbers.
        """
        blocks = self._blocks
        number = None if isinstance(on, str) else whole_number(on)
        if isinstance(on, str):
            with suppress(ValueError):
                number = blocks.net.node(on)
        if number is None or not (isinstance(on, str) or 0 <= number < blocks.net.n_nodes):
            nodes = ", ".join(filter(None, (f"0 to {blocks.net.n_nodes - 1}", blocks.net.node_names)))
            raise InputError(f"set_force: unknown node {on!r} (nodes: {nodes})")
        values = finite_vector(force, 3)
        if values is None:
            raise InputError(f"set_force: force must be three finite numbers, got {force!r}")
        changed = vector.copy()
        changed[3 * number : 3 * number + 3] = values
        return changed

    def with_input(self, vector: Floats, name: str, values: ArrayLike) -> Floats:
        """Return a new vector with other values of an input; raise InputError if they are not valid."""
        where = self._where.get(name) if isinstance(name, str) else None
        if where is None and isinstance(name, str) and name in self._scripted:
            raise InputError(f"set_input: {name!r} is set by the script of the case")
        if where is None:
            words = ", ".join(self._where) or "none"
            raise InputError(f"set_input: unknown input {name!r} (inputs: {words})")
        number = where.stop - where.start
        new = finite_vector(values, number)
        if new is None:
            numbers = "a finite number" if number == 1 else f"{number} finite numbers"
            raise InputError(f"set_input: {name} must be {numbers}, got {values!r}")
        changed = vector.copy()
        changed[where] = new
        return changed

    def with_changes(self, vector: Floats, then: Floats, now: Floats) -> Floats:
        """Return a new vector with the forces and inputs of `now` that differ from those of `then`.

        Raises InputError for arrays of another shape.
        """
        for given in (then, now):
            if not isinstance(given, np.ndarray) or given.shape != vector.shape:
                words = f"needs two arrays of `acting`, ({len(vector)},), got {shown(given)}"
                raise InputError(f"repeat_changes: {words}")
        changed = vector.copy()
        of_a_point = [slice(k, k + 3) for k in range(0, 3 * self._blocks.n_points, 3)]
        for where in (*of_a_point, *self._where.values()):
            if not np.array_equal(then[where], now[where]):
                changed[where] = now[where]
        return changed

"""What acts from outside: forces on points and values of inputs, as one vector that a retry goes through."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.errors import InputError
from exunet.simulation.arguments import finite_vector, whole_number
from exunet.system.system import System

Floats = NDArray[np.float64]


class Outside:
    """Which entries of the vector are what: forces (3 n_points,) [N], then the values of the inputs.

    at_start : the vector at time 0
    """

    def __init__(self, system: System) -> None:
        self._blocks, self._scripted = system.blocks, system.scripted
        inputs = {name: one for name, one in system.inputs.items() if name not in system.scripted}
        parts = [np.zeros(3 * system.blocks.n_points), *(one.initial for one in inputs.values())]
        self.at_start: Floats = np.concatenate(parts)
        ends = np.cumsum([len(part) for part in parts])
        self._where = {
            name: slice(start, end) for name, start, end in zip(inputs, ends[:-1], ends[1:], strict=True)
        }

    def forces(self, vector: Floats) -> Floats:
        """(n_points, 3) [N]."""
        return vector[: 3 * self._blocks.n_points].reshape(-1, 3)

    def inputs(self, vector: Floats) -> dict[str, Floats]:
        """The values of each input by name."""
        return {name: vector[where] for name, where in self._where.items()}

    def with_force(self, vector: Floats, on: int | str, force: ArrayLike) -> Floats:
        """A new vector, with another force (3,) [N] on a node, or on a point mass by name.

        Raises InputError if there is none, or if the force is not three finite numbers.
        """
        blocks = self._blocks
        number = blocks.body.get(on) if isinstance(on, str) else whole_number(on)
        if number is None or not (isinstance(on, str) or 0 <= number < blocks.net.n_nodes):
            names = ", ".join(blocks.body) or "none"
            words = f"nodes are 0 to {blocks.net.n_nodes - 1}, point masses: {names}"
            raise InputError(f"set_force: there is no node or point mass {on!r}: {words}")
        found = finite_vector(force, 3)
        if found is None:
            raise InputError(f"set_force: a force is three finite numbers, got {force!r}")
        changed = vector.copy()
        changed[3 * number : 3 * number + 3] = found
        return changed

    def with_input(self, vector: Floats, name: str, values: ArrayLike) -> Floats:
        """A new vector, with other values of an input; raises InputError for a wrong name, size or value."""
        where = self._where.get(name) if isinstance(name, str) else None
        if where is None and isinstance(name, str) and name in self._scripted:
            raise InputError(f"set_input: the script of the case gives {name!r}")
        if where is None:
            words = ", ".join(self._where) or "there are none"
            raise InputError(f"set_input: there is no input {name!r}: {words}")
        number = where.stop - where.start
        found = finite_vector(values, number)
        if found is None:
            numbers = "a finite number" if number == 1 else f"{number} finite numbers"
            raise InputError(f"set_input: {name} is {numbers}, got {values!r}")
        changed = vector.copy()
        changed[where] = found
        return changed

    def with_changes(self, vector: Floats, then: Floats, now: Floats) -> Floats:
        """A new vector, with those forces and inputs of `now` that are not as they were `then`.

        Raises InputError for what are no such vectors.
        """
        if not all(isinstance(one, np.ndarray) and one.shape == vector.shape for one in (then, now)):
            raise InputError(f"repeat_changes: needs two arrays ({len(vector)},), as `acting` gives them")
        changed = vector.copy()
        of_a_point = [slice(k, k + 3) for k in range(0, 3 * self._blocks.n_points, 3)]
        for where in (*of_a_point, *self._where.values()):
            if not np.array_equal(then[where], now[where]):
                changed[where] = now[where]
        return changed

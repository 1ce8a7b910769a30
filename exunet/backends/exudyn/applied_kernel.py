"""A kernel as forces on the blocks of an engine's model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.backends.exudyn.model import Jacobian, Model
from exunet.codegen.drivers import Place
from exunet.codegen.kernel import Kernel
from exunet.codegen.linearised import Linearised
from exunet.forces.loops import Index
from exunet.system.system import System

Floats = NDArray[np.float64]

X, V, PUSH, FORCE, REFERENCE = range(ROWS := 5)  # the rows of `Place.values`


class AppliedKernel:
    """The forces of a kernel on the points of `model`, on its bodies, and constant ones from outside.

    bodies : True if a term of the kernel acts on a rigid body
    Where the coordinates stand is only known once the model is assembled, so it is looked up at first use.
    """

    def __init__(
        self, model: Model, kernel: Kernel, memory: Mapping[str, Floats], system: System, *, bodies: bool
    ) -> None:
        self._model, self._kernel, self._bodies = model, kernel, bodies
        self._system, self._blocks = system, (blocks := system.blocks)
        self._table = kernel.table(memory)
        self._moving = system.moving(memory)
        self._run: Callable[..., None] = kernel.module.engine_forces
        self._states = slice(blocks.n_x - blocks.n_states, blocks.n_x)
        self._place: Place | None = None
        self._held: Any = None  # data and place, for the compiled code
        self._push = np.zeros(blocks.n_force)

    @property
    def remembered(self) -> Mapping[str, Floats]:
        """The memories that compiled code changes itself, by name; not copies."""
        return self._table.kept

    def evaluate(self, t: float, q: Floats, q_t: Floats, out: Floats) -> None:
        """Forces on free coordinates of points, and on bodies, into out; see `Model.applied_forces`."""
        place = self._place
        if place is None or self._held is None:
            place = self._hold()
        if self._blocks.states:
            place.values[X, self._states] = self._model.first_order()
        self._run(t, q, q_t, self._held, out)
        if self._moving is not None:  # what sleeps is at rest, and stays so without a force
            free = place.where[1]
            out[: len(free)] *= self._moving[free // 3]

    def _hold(self) -> Place:
        place = self._where() if self._place is None else self._place
        self._place, self._held = place, self._kernel.module.hold((self._table.rows, place))
        return place

    def rates(self, t: float, q: Floats, q_t: Floats, out: Floats) -> Floats:
        """(n_states,) rates of the first-order states; out as for `evaluate`."""
        self.evaluate(t, q, q_t, out)
        assert self._place is not None
        return self._place.values[FORCE, self._blocks.n_v : self._blocks.n_force]

    def jacobian(self, linearised: Linearised | None) -> Jacobian | None:
        """The kernel's derivatives as `Model.applied_forces` takes them."""
        if linearised is None:
            return None

        def compute(t: float, q: Floats, q_t: Floats, of_position: float, of_velocity: float) -> csr_array:
            assert self._place is not None
            (column, free), values = self._place.where, self._place.values
            values[X, free] = values[REFERENCE, : len(free)] + q[column]
            values[V, free] = q_t[column]
            points = 3 * self._blocks.n_points
            return linearised(t, values[X, :points], values[V, :points], of_position, of_velocity)

        return compute

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._push[: force.size] = force.ravel()
        if self._place is not None:
            self._place.values[PUSH, : len(self._push)] = self._push

    def accepted(self, t: float, q: Floats, q_t: Floats) -> None:
        """Let the terms remember the accepted step that ends at t [s] with these coordinates."""
        place = self._place
        if place is None or self._held is None:
            place = self._hold()
        if self._blocks.states:
            place.values[X, self._states] = self._model.first_order()
        self._kernel.module.engine_remembers(t, q, q_t, self._held)

    def remember(self, memory: Mapping[str, Floats]) -> None:
        """Take all memories as they are now."""
        self._table = self._kernel.table(memory)
        self._moving = self._system.moving(memory)
        self._held = None

    def _where(self) -> Place:
        model, blocks = self._model, self._blocks
        free = np.flatnonzero(np.repeat(model.free, 3))
        values = np.zeros((ROWS, max(blocks.n_x, blocks.n_force)))
        values[X, : 3 * blocks.n_points] = model.reference.ravel()
        values[PUSH, : blocks.n_force] = self._push
        values[REFERENCE, : len(free)] = values[X, free]
        return Place(
            where=np.stack([model.columns(), free]).astype(Index),
            body=(model.columns_of_bodies() if self._bodies else np.zeros(0)).astype(Index),
            centre=3 * blocks.n_points,
            spin=blocks.centres,
            values=values,
        )

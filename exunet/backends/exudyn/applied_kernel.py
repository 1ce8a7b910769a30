"""A kernel as forces on the points of an engine's model."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.backends.exudyn.model import Jacobian, Model
from exunet.codegen.drivers import Place
from exunet.codegen.kernel import Kernel
from exunet.codegen.linearised import Linearised
from exunet.forces.loops import Index

Floats = NDArray[np.float64]


class AppliedKernel:
    """The forces of a kernel on the points of `model`, and constant ones from outside.

    Where the coordinates stand is only known once the model is assembled, so it is looked up at first use.
    """

    def __init__(self, model: Model, kernel: Kernel, memory: Mapping[str, Floats]) -> None:
        self._model, self._kernel = model, kernel
        self._data = kernel.data(memory)
        self._run: Callable[..., None] = kernel.module.engine_forces
        self._place: Place | None = None
        self._push = np.zeros(3 * model.n_points)

    def evaluate(self, t: float, q: Floats, q_t: Floats, out: Floats) -> None:
        """Forces [N] on the free coordinates of the points into out; see `Model.applied_forces`."""
        if self._place is None:
            self._place = _place(self._model, self._push)
        self._run(t, q, q_t, self._data, self._place, out)

    def jacobian(self, linearised: Linearised | None) -> Jacobian | None:
        """The kernel's derivatives as `Model.applied_forces` takes them."""
        if linearised is None:
            return None

        def compute(t: float, q: Floats, q_t: Floats, of_position: float, of_velocity: float) -> csr_array:
            assert self._place is not None
            place = self._place
            place.x[place.free] = place.reference + q[place.column]
            place.v[place.free] = q_t[place.column]
            return linearised(t, place.x, place.v, of_position, of_velocity)

        return compute

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._push[:] = force.ravel()

    def remember(self, memory: Mapping[str, Floats]) -> None:
        """Take other values of memories."""
        self._kernel.remember(self._data, memory)


def _place(model: Model, push: Floats) -> Place:
    free = np.flatnonzero(np.repeat(model.free, 3))
    x = model.reference.ravel().copy()
    column = model.columns().astype(Index)
    return Place(column, free.astype(Index), x[free], x, np.zeros_like(x), push, np.zeros_like(x))

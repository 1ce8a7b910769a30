"""A kernel as forces on the points of an engine's model."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.backends.exudyn.model import Model
from exunet.codegen.kernel import Index, Kernel
from exunet.codegen.linearised import Linearised

Floats = NDArray[np.float64]


def apply(
    model: Model, kernel: Kernel, linearised: Linearised | None = None, mass: Floats | None = None
) -> None:
    """Let a kernel push the points of `model`, which are a net's nodes; mass as for `Model.applied_forces`.

    linearised : the kernel's derivatives, for implicit methods
    Where the coordinates stand is only known once the model is assembled, so it is looked up at first use.
    """
    place: list[Any] = []

    def evaluate(t: float, q: Floats, q_t: Floats, out: Floats) -> None:
        if not place:
            place.append(_place(model))
        column, free, reference, x, v, force = place[0]
        run(t, q, q_t, column, free, reference, data, x, v, force, out)

    def jacobian(t: float, q: Floats, q_t: Floats, of_position: float, of_velocity: float) -> csr_array:
        column, free, reference, x, v, _ = place[0]
        x[free] = reference + q[column]
        v[free] = q_t[column]
        assert linearised is not None
        return linearised(t, x, v, of_position, of_velocity)

    run, data = kernel.module.engine_forces, kernel.data
    model.applied_forces(evaluate, jacobian if linearised else None, mass)


def _place(model: Model) -> tuple[Any, ...]:
    """Column and node coordinate of each free coordinate, its reference, and work space."""
    nothing = np.zeros(model.n_coordinates)
    reference, _ = model.unpack(nothing, nothing)
    free = np.flatnonzero(np.repeat(model.free, 3))
    x = reference.ravel().copy()
    return (
        model.columns().astype(Index),
        free.astype(Index),
        x[free],
        x,
        np.zeros_like(x),
        np.zeros_like(x),
    )

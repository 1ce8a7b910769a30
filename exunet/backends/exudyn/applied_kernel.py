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
from exunet.forces.blocks import Blocks
from exunet.forces.loops import Index
from exunet.system.system import System

Floats = NDArray[np.float64]


class AppliedKernel:
    """The forces of a kernel on the points of `model`, on its bodies, and constant ones from outside.

    bodies : True if a term of the kernel acts on a rigid body
    halfway : see `Place`; not where forces depend on first-order states
    kernel, table : what computes them, and on what now
    Where the coordinates stand is only known once the model is assembled, so it is looked up at first use.
    """

    def __init__(
        self,
        model: Model,
        kernel: Kernel,
        memory: Mapping[str, Floats],
        system: System,
        *,
        bodies: bool,
        halfway: bool,
    ) -> None:
        self.kernel, self._model, self._bodies = kernel, model, bodies
        self._system, self._blocks = system, (blocks := system.blocks)
        self._halfway = halfway and all(one.gives != 0.0 for one in blocks.states)
        self.table = kernel.table(memory)
        self._moving = system.moving(memory)
        self._forces: Callable[..., None] = kernel.module.engine_forces
        self._rates: Callable[..., None] = kernel.module.engine_rates
        self._place: Place | None = None
        self._held: Any = None  # data and place, for the compiled code
        self._push = np.zeros(blocks.n_force)

    @property
    def remembered(self) -> Mapping[str, Floats]:
        """The memories that compiled code changes itself, by name; not copies."""
        return self.table.kept

    def evaluate(self, t: float, q: Floats, q_t: Floats, out: Floats) -> None:
        """Forces on free coordinates of points, and on bodies, into out; see `Model.applied_forces`."""
        if self._held is None:
            self._hold()
        self._forces(t, q, q_t, self._model.coordinates_in_call().y, self._held, out)
        self._let_sleep(out)

    def _let_sleep(self, out: Floats) -> None:
        if self._moving is not None:  # what sleeps is at rest, and stays so without a force
            assert self._place is not None
            free = self._place.where[1]
            out[: len(free)] *= self._moving[free // 3]

    @property
    def place(self) -> Place:
        """Where the blocks stand in the coordinates of the model, which is assembled."""
        if self._place is None:
            self._place = place_in(self._model, self._blocks, bodies=self._bodies, halfway=self._halfway)
            self._place.push[: len(self._push)] = self._push
        return self._place

    def _hold(self) -> None:
        self.place.asked[0] = np.nan
        self._held = self.kernel.module.hold((self.table.rows, self.place))

    def rates(self, t: float, q: Floats, q_t: Floats) -> Floats:
        """(n_states,) rates of the first-order states; a view."""
        if self._held is None:
            self._hold()
        self._rates(t, q, q_t, self._model.coordinates_in_call().y, self._held)
        assert self._place is not None
        return self._place.force[self._blocks.n_v : self._blocks.n_force]

    def jacobian(self, linearised: Linearised | None) -> Jacobian | None:
        """The kernel's derivatives as `Model.applied_forces` takes them."""
        if linearised is None:
            return None

        def compute(t: float, q: Floats, q_t: Floats, of_position: float, of_velocity: float) -> csr_array:
            assert self._place is not None
            (column, free), x, v = self._place.where, self._place.x, self._place.v
            self._place.asked[0] = np.nan
            x[free] = self._place.reference[: len(free)] + q[column]
            v[free] = q_t[column]
            points = 3 * self._blocks.n_points
            return linearised(t, x[:points], v[:points], of_position, of_velocity)

        return compute

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._push[: force.size] = force.ravel()
        if self._place is not None:
            self._place.push[: len(self._push)] = self._push
            self._place.asked[0] = np.nan

    def accepted(self, t: float, q: Floats, q_t: Floats) -> None:
        """Let the terms remember the accepted step that ends at t [s] with these coordinates."""
        if self._held is None:
            self._hold()
        self.kernel.module.engine_remembers(t, q, q_t, self._model.coordinates_in_call().y, self._held)

    def remember(self, memory: Mapping[str, Floats]) -> None:
        """Take all memories as they are now."""
        self.table = self.kernel.table(memory)
        self._moving = self._system.moving(memory)
        self._held = None


def place_in(model: Model, blocks: Blocks, *, bodies: bool, halfway: bool) -> Place:
    """Where the blocks stand in the coordinates of an assembled model, and work space; bodies: theirs too."""
    free = np.flatnonzero(np.repeat(model.free, 3))
    felt = [one.gives == 0.0 for one in blocks.states for _ in one.initial]
    x, v, push, force, reference = (np.zeros(max(blocks.n_x, blocks.n_force)) for _ in range(5))
    x[: 3 * blocks.n_points] = model.reference.ravel()
    reference[: len(free)] = x[free]
    return Place(
        where=np.stack([model.columns(), free]).astype(Index),
        body=(model.columns_of_bodies() if bodies else np.zeros(0)).astype(Index),
        centre=3 * blocks.n_points,
        spin=blocks.centres,
        states=blocks.n_x - blocks.n_states,
        felt=np.flatnonzero(felt).astype(Index),
        asked=np.full(1 + 2 * model.n_coordinates + np.count_nonzero(felt), np.nan),
        told=np.zeros(2),
        halfway=halfway,
        x=x,
        v=v,
        push=push,
        force=force,
        reference=reference,
    )

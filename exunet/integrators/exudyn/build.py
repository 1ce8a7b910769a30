"""Build the engine's model of a system, with the forces of a kernel and their Jacobian."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.base.arrays import Floats, Ints
from exunet.forces.blocks import Blocks
from exunet.forces.cable_term import SomeElements
from exunet.forces.from_outside import FIXED_NODES, effects_of
from exunet.forces.loops import Index
from exunet.forces.terms import DiscreteStates, KernelTerm
from exunet.forces.total import Forces
from exunet.integrators.exudyn.model import Jacobian, Model
from exunet.kernels.kernel import Kernel, term_kernel
from exunet.kernels.source import EngineCoordinates
from exunet.methods.method import METHODS, Kind, MethodFacts, Plan
from exunet.model.system import State, System

_DIFFERENCE = 1e-4  # of the net's size, and of its speed: the step of the differences of kernel terms


class Linearised:
    """-(a df/dx + b df/dv) of kernel terms over the free coordinates of the points, for any a and b, as csr.

    Terms are differenced; each couples the points that it declares (`KernelTerm.couples`), and points whose
    columns share no row are displaced together.
    """

    def __init__(self, blocks: Blocks, forces: Forces) -> None:
        self._n = blocks.n_points
        # What only counts has no room for what it counts in forces of the points alone.
        self._kernels = tuple(term for term in forces.kernels if not term.only_states)
        self._size = blocks.net.size
        self._pairs = _coupled(self._kernels, self._n)
        self._groups = _groups(self._pairs, self._n)
        free = np.ones(self._n, dtype=bool)
        free[blocks.net.fixed_nodes] = False
        self._number = np.where(np.repeat(free, 3), np.cumsum(np.repeat(free, 3)) - 1, -1)
        (i, j), axis = 3 * self._pairs.T, np.arange(3)
        shape = (len(self._pairs), 3, 3)
        rows = np.broadcast_to(i[:, None, None] + axis[:, None], shape).ravel()
        columns = np.broadcast_to(j[:, None, None] + axis, shape).ravel()
        self._keep = (self._number[rows] >= 0) & (self._number[columns] >= 0)
        self._lay(self._number[rows[self._keep]], self._number[columns[self._keep]])

    def _lay(self, rows: Ints, columns: Ints) -> None:
        n = int(self._number.max(initial=-1)) + 1
        cells, self._cell = np.unique(rows * n + columns, return_inverse=True)
        starts = np.searchsorted(cells, np.arange(n + 1) * n)
        self._matrix = csr_array((np.zeros(len(cells)), cells % max(n, 1), starts), shape=(n, n))

    def __call__(
        self, time: float, x: Floats, v: Floats, of_position: float, of_velocity: float
    ) -> csr_array:
        """The matrix at positions x and velocities v, (3 n_points,); the next call uses its arrays again."""
        values = self._of_kernels(time, x, v, of_position, of_velocity).ravel()[self._keep]
        self._matrix.data[:] = np.bincount(self._cell, values, len(self._matrix.data))
        return self._matrix

    def _of_kernels(self, time: float, x: Floats, v: Floats, a: float, b: float) -> Floats:
        """(n_pairs, 3, 3) blocks of the kernel terms: rows of the first point, columns of the second."""
        blocks = np.zeros((len(self._pairs), 3, 3))
        if not self._kernels:
            return blocks
        kernel = term_kernel(self._kernels)
        place, speed = x.reshape(-1, 3), v.reshape(-1, 3)
        steps = (_DIFFERENCE * self._size, _DIFFERENCE * (float(np.abs(v).max(initial=0.0)) or 1.0))
        row, column = self._pairs.T
        for group in range(int(self._groups.max(initial=-1)) + 1):
            members = self._groups == group
            own = members[column]
            for axis in range(3):
                for factor, external, moves in ((a, steps[0], 1.0), (b, steps[1], 0.0)):
                    off = np.zeros((self._n, 3))
                    off[members, axis] = external
                    ahead, behind = (
                        kernel.forces(time, place + sign * moves * off, speed + sign * (1.0 - moves) * off)
                        for sign in (1.0, -1.0)
                    )
                    change = factor * (ahead - behind) / (2.0 * external)
                    blocks[own, :, axis] -= change[row[own]]
        return blocks


def _coupled(kernels: tuple[KernelTerm, ...], n: int) -> Ints:
    """(m, 2) pairs of points whose force (the first) kernel terms couple to the state of the second."""
    own = np.arange(n)
    found = [np.stack([own, own], axis=1)]
    for term in kernels:
        if term.couples is not None:
            sets = np.asarray(term.couples, dtype=np.int64)
            width = sets.shape[1]
            found.append(
                np.stack([np.repeat(sets, width, axis=1), np.tile(sets, (1, width))], -1).reshape(-1, 2)
            )
    return np.unique(np.concatenate(found), axis=0)


def _groups(pairs: Ints, n: int) -> Ints:
    """(n,) numbers such that two points of one number share no row, by greedy colouring.

    Curtis, Powell and Reid, J. Inst. Math. Appl. 13 (1974) 117, doi 10.1093/imamat/13.1.117.
    """
    pattern = csr_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    shared = csr_array(pattern.T @ pattern)
    group = np.full(n, -1, dtype=np.int64)
    for point in range(n):
        taken = set(group[shared.indices[shared.indptr[point] : shared.indptr[point + 1]]].tolist())
        group[point] = next(k for k in range(n) if k not in taken)
    return group


class AppliedKernel:
    """The forces of a kernel on the points of `model`, on its bodies, and constant ones from outside.

    bodies : True if a term of the kernel acts on a rigid body
    halfway : see `EngineCoordinates`; not where forces depend on first-order states
    kernel, table : what computes them, and on what now
    Where the coordinates stand is only known once the model is assembled, so it is looked up at first use.
    """

    def __init__(
        self,
        model: Model,
        kernel: Kernel,
        discrete: Mapping[str, Floats],
        system: System,
        *,
        bodies: bool,
        halfway: bool,
    ) -> None:
        self.kernel, self._model, self._bodies = kernel, model, bodies
        self._system, self._blocks = system, (blocks := system.blocks)
        self._halfway = halfway and all(state.gives != 0.0 for state in blocks.states)
        self.table = kernel.table(discrete)
        self._moving = system.moving(discrete)
        self._forces: Callable[..., None] = kernel.module.engine_forces
        self._rates: Callable[..., None] = kernel.module.engine_rates
        self._place: EngineCoordinates | None = None
        self._held: Any = None  # data and place, for the compiled code
        self._external = np.zeros(blocks.n_force)

    @property
    def remembered(self) -> Mapping[str, Floats]:
        """The discrete states that compiled code changes itself, by name; not copies."""
        return self.table.kept

    def evaluate(self, t: float, q: Floats, q_t: Floats, out: Floats) -> None:
        """Forces on free coordinates of points, and on bodies, into out; see `Model.applied_forces`."""
        if self._held is None:
            self._hold()
        self._forces(t, q, q_t, self._model.coordinates_in_call().y, self._held, out)
        self._stop_inactive(out)

    def _stop_inactive(self, out: Floats) -> None:
        if self._moving is not None:  # inactive points rest, and stay so without a force
            assert self._place is not None
            free = self._place.where[1]
            out[: len(free)] *= self._moving[free // 3]

    @property
    def place(self) -> EngineCoordinates:
        """Where the blocks stand in the coordinates of the model, which is assembled."""
        if self._place is None:
            self._place = place_in(self._model, self._blocks, bodies=self._bodies, halfway=self._halfway)
            self._place.external[: len(self._external)] = self._external
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

    def set_external_force(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._external[: force.size] = force.ravel()
        if self._place is not None:
            self._place.external[: len(self._external)] = self._external
            self._place.asked[0] = np.nan

    def accepted(self, t: float, q: Floats, q_t: Floats) -> None:
        """Let the terms remember the accepted step that ends at t [s] with these coordinates."""
        if self._held is None:
            self._hold()
        self.kernel.module.engine_accepts(t, q, q_t, self._model.coordinates_in_call().y, self._held)

    def remember(self, discrete: Mapping[str, Floats]) -> None:
        """Take all discrete states as they are now."""
        self.table = self.kernel.table(discrete)
        self._moving = self._system.moving(discrete)
        self._held = None


def place_in(model: Model, blocks: Blocks, *, bodies: bool, halfway: bool) -> EngineCoordinates:
    """Where the blocks stand in the coordinates of an assembled model, and work space; bodies: theirs too."""
    free = np.flatnonzero(np.repeat(model.free, 3))
    felt = [state.gives == 0.0 for state in blocks.states for _ in state.initial]
    x, v, external, force, reference = (np.zeros(max(blocks.n_x, blocks.n_force)) for _ in range(5))
    x[: 3 * blocks.n_points] = model.reference.ravel()
    reference[: len(free)] = x[free]
    return EngineCoordinates(
        where=np.stack([model.columns(), free]).astype(Index),
        body=(model.columns_of_bodies() if bodies else np.zeros(0)).astype(Index),
        centre=3 * blocks.n_points,
        spin=blocks.centres,
        states=blocks.n_x - blocks.n_states,
        felt=np.flatnonzero(felt).astype(Index),
        asked=np.full(1 + 2 * model.n_coordinates + np.count_nonzero(felt), np.nan),
        reported=np.zeros(2),
        halfway=halfway,
        x=x,
        v=v,
        external=external,
        force=force,
        reference=reference,
    )


def build(system: System, state: State, plan: Plan, *, has_external: bool = False) -> Model:
    """Fill and assemble the engine's model at a state.

    Each free point is a mass point, each element that the engine can hold (`_native`) a connector with the
    user-defined law. One generic object computes the other forces, if there are any.

    has_external : with room for external forces
    """
    model, forces, method = Model(), system.forces, METHODS[plan.method]
    native = _native(system)
    with _collector_paused():
        _points(model, system, state)
        _bodies(model, system, state)
        _connectors(model, system, native)
        if _all_in_one(system, native):
            kernel = Kernel((SomeElements(forces.cable, ~native), *list(forces)[1:]))
            _apply(model, system, kernel, state, method)
        else:
            if forces.linear is not None:
                model.linear_terms(forces.linear.on_velocity, forces.linear.stiffness, forces.linear.load)
            if forces.kernels or has_external or system.blocks.states:
                _apply(model, system, term_kernel(forces.kernels), state, method)
    model.ballast()
    model.assemble(system.kinematics)
    return model


@contextmanager
def _collector_paused() -> Iterator[None]:
    """The engine's items are made of many short-lived objects, none of which is part of a circle.

    Python's collector would look at all objects of the process again and again: a fifth of the time.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def remember(model: Model, system: System, discrete: DiscreteStates) -> None:
    """Let a model's forces take all discrete states as they are now."""
    if model.applied is not None:
        model.applied.remember(discrete)
    carrying = system.forces.cable.carrying(discrete)
    if carrying is not None:
        model.carry(carrying)


def expected_items(system: System) -> dict[str, int]:
    """How many objects of each kind `build` would make, without making them."""
    forces, native = system.forces, _native(system)
    free, one = int(system.free.sum()), _all_in_one(system, native)
    applied = (forces.kernels or one or system.blocks.states) and (free or system.driven.any())
    counts = {
        "MassPoint": free,
        "ObjectConnectorSpringDamper": int(native.sum()),
        "ObjectGenericODE2": int(forces.linear is not None and not one and free > 0) + (2 if applied else 0),
        "ObjectRigidBody": int(system.moves_freely.sum()),
        "ObjectGenericODE1": int(bool(system.blocks.states)),
    }
    return {kind: number for kind, number in counts.items() if number}


def _connectors(model: Model, system: System, native: NDArray[np.bool_]) -> None:
    net, law = system.net, system.forces.cable.law
    times = law.relaxation_time if law.relaxation_time is not None else [None] * net.n_elements
    numbers = [0] * net.n_elements if law.number is None else law.number.tolist()
    for element in np.flatnonzero(native).tolist():
        i, j = net.element_nodes[element].tolist()
        model.cable_element(
            element,
            i,
            j,
            law.natural_length[element],
            law.stiffness[element],
            times[element],
            numbers[element],
        )


def _native(system: System) -> NDArray[np.bool_]:
    """(n_elements,) True for elements between points that the engine knows.

    It does not know where a body holds a point for a while: what joins such a point to one that is not held
    is left to the kernel. Within a packed net distances stay; on a drum elements carry nothing. Nor does it
    report what holds fixed nodes: where that is stored, the kernel has the elements that end there. A
    connector would move a point that rests: where points may rest, the kernel has all elements. It also has
    the elements whose law is a table.
    """
    ends, kinematics = system.net.element_nodes, system.kinematics
    if system.blocks.active is not None:
        return np.zeros(len(ends), dtype=bool)
    native = ~np.isin(ends, kinematics.point).any(axis=1)
    if system.net.law_number is not None:
        native &= system.net.law_number < 2
    if FIXED_NODES in effects_of(state.name for state in system.blocks.states):
        native &= ~np.isin(ends, system.net.fixed_nodes).any(axis=1)
    for held in kinematics.held:
        native &= np.isin(ends, held.points).sum(axis=1) != 1
    return np.asarray(native)


def _all_in_one(system: System, native: NDArray[np.bool_]) -> bool:
    """True if one kernel has all forces but those of connectors, the constant ones too.

    The engine's items know neither points on bodies nor bodies without coordinates.
    """
    return system.forces.constraint is not None or not native.all()


def _apply(model: Model, system: System, kernel: Kernel, state: State, method: MethodFacts) -> None:
    """Let a kernel act on the points and bodies."""
    linearised = Linearised(system.blocks, system.forces) if method.kind == Kind.IMPLICIT else None
    bodies = bool(system.driven.any())
    applied = AppliedKernel(
        model, kernel, dict(state.discrete), system, bodies=bodies, halfway=method.asks_halfway
    )
    model.applied_forces(applied.evaluate, applied.jacobian(linearised), bodies=bodies)
    if system.blocks.states:
        model.first_order_states(state.first_order, applied.rates)
    model.applied = applied


def _bodies(model: Model, system: System, state: State) -> None:
    for k in np.flatnonzero(system.moves_freely).tolist():
        model.rigid_body(system.bodies[k], state.bodies[k])


def _points(model: Model, system: System, state: State) -> None:
    reference = system.net.reference_position
    for k in range(system.blocks.n_points):
        if system.free[k]:
            model.point(system.mass[k], reference[k], state.position[k], state.velocity[k])
        else:
            model.fixed_point(state.position[k])

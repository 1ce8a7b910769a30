"""From a system to the engine's model, in the form that a case asks for."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.applied_kernel import AppliedKernel
from exunet.backends.exudyn.model import Model
from exunet.backends.exudyn.seen_steps import seeing_kernel
from exunet.codegen.compile import require_numba
from exunet.codegen.kernel import Kernel, term_kernel
from exunet.codegen.linearised import Linearised
from exunet.forces.cable_term import SomeElements
from exunet.forces.from_outside import FIXED_NODES, effects_of
from exunet.forces.terms import Memories
from exunet.forces.total import Forces
from exunet.methods.method import METHODS, Kind, MethodFacts
from exunet.methods.plan import Plan
from exunet.system.system import State, System

Floats = NDArray[np.float64]


def build(system: System, state: State, plan: Plan, *, fused: bool, pushed: bool = False) -> Model:
    """Fill and assemble the engine's model at a state.

    fused  : the points, and the forces and masses of all of them at once; raises MissingExtra without Numba.
             Else a mass point a point, a connector an element, and the other terms if there are any
    pushed : with room for forces from outside (the fused form always has it)
    """
    model = Model()
    method = METHODS[plan.method]
    forces = system.forces
    with _collector_paused():
        if fused:
            require_numba('engine.net = "fused"')
            _points(model, system, state, add=model.point_together)
            model.join_points()
            _bodies(model, system, state)
            _apply(model, system, seeing_kernel(forces, system), state, massive=True, method=method)
        else:
            _connectors(model, system, forces, state, method=method, pushed=pushed)
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


def remember(model: Model, system: System, memory: Memories) -> None:
    """Let a model's forces take all memories as they are now."""
    if model.applied is not None:
        model.applied.remember(memory)
    carrying = system.forces.cable.carrying(memory)
    if carrying is not None and not model.elements_applied:
        model.carry(carrying)


def expected_items(system: System, *, fused: bool) -> dict[str, int]:
    """How many objects of each kind `build` would make, without making them."""
    forces = system.forces
    free = int(system.free.sum())
    if fused:
        counts = {"ObjectGenericODE2": 2 if free or system.driven.any() else 0}
    else:
        constrained = forces.constraint is not None
        linear = forces.linear is not None and not constrained and free > 0
        applied = (forces.kernels or constrained or system.blocks.states) and (free or system.driven.any())
        generic = linear + (2 if applied else 0)
        counts = {
            "MassPoint": free,
            "ObjectConnectorSpringDamper": int(_native(system).sum()),
            "ObjectGenericODE2": generic,
        }
    counts["ObjectRigidBody"] = int(system.moves_freely.sum())
    counts["ObjectGenericODE1"] = int(bool(system.blocks.states))
    return {kind: number for kind, number in counts.items() if number}


def _connectors(
    model: Model, system: System, forces: Forces, state: State, *, method: MethodFacts, pushed: bool
) -> None:
    net = system.net
    _points(model, system, state)
    _bodies(model, system, state)
    law = forces.cable.law
    times = law.relaxation_time if law.relaxation_time is not None else [None] * net.n_elements
    native = _native(system)
    for element in np.flatnonzero(native).tolist():
        i, j = net.element_nodes[element].tolist()
        model.cable_element(
            element, i, j, law.natural_length[element], law.stiffness[element], times[element]
        )
    if forces.constraint is not None:
        # The engine's items know neither points on bodies nor bodies without coordinates.
        others = SomeElements(forces.cable, ~native)
        kernel = Kernel((others, *list(forces)[1:]))
        _apply(model, system, kernel, state, massive=False, method=method)
        return
    if forces.linear is not None:
        model.linear_terms(forces.linear.on_velocity, forces.linear.stiffness, forces.linear.load)
    if forces.kernels or pushed or system.blocks.states:
        _apply(model, system, term_kernel(forces.kernels), state, massive=False, method=method)


def _native(system: System) -> NDArray[np.bool_]:
    """(n_elements,) True for elements between points that the engine knows.

    It does not know where a body holds a point for a while: what joins such a point to one that is not held
    is left to the kernel. Within a packed net distances stay; on a drum elements carry nothing. Nor does it
    tell what holds fixed nodes: where that is kept, the kernel has the elements that end there.
    """
    ends, kinematics = system.net.element_nodes, system.kinematics
    native = ~np.isin(ends, kinematics.point).any(axis=1)
    if FIXED_NODES in effects_of(one.name for one in system.blocks.states):
        native &= ~np.isin(ends, system.net.fixed_nodes).any(axis=1)
    for held in kinematics.held:
        native &= np.isin(ends, held.points).sum(axis=1) != 1
    return np.asarray(native)


def _apply(
    model: Model, system: System, kernel: Kernel, state: State, *, massive: bool, method: MethodFacts
) -> None:
    """Let a kernel push the points; massive: it brings their masses, and the elements' forces too."""
    implicit, halfway = method.kind == Kind.IMPLICIT, method.asks_halfway
    linearised = Linearised(system.blocks, system.forces, elements=massive) if implicit else None
    bodies = bool(system.driven.any())
    applied = AppliedKernel(model, kernel, dict(state.memory), system, bodies=bodies, halfway=halfway)
    mass = system.mass if massive else None
    model.applied_forces(applied.evaluate, applied.jacobian(linearised), mass, bodies=bodies)
    if system.blocks.states:
        model.first_order_states(state.first_order, applied.rates)
    model.applied = applied
    model.elements_applied = massive


def _bodies(model: Model, system: System, state: State) -> None:
    for k in np.flatnonzero(system.moves_freely).tolist():
        body = system.bodies[k]
        model.rigid_body(body, state.bodies[k])


def _points(
    model: Model, system: System, state: State, add: Callable[[Floats, Floats, Floats], object] | None = None
) -> None:
    """All points; add : what adds a free one without its mass, see `Model.node`; None: with it."""
    reference = system.blocks.position.copy()  # of point masses: where they start
    reference[: system.net.n_nodes] = system.net.reference_position
    for k in range(system.blocks.n_points):
        if not system.free[k]:
            model.fixed_point(state.position[k])
        elif add is None:
            model.point(system.mass[k], reference[k], state.position[k], state.velocity[k])
        else:
            add(reference[k], state.position[k], state.velocity[k])

"""Build the engine's model of a system."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.applied_kernel import AppliedKernel
from exunet.backends.exudyn.model import Model
from exunet.codegen.kernel import Kernel, term_kernel
from exunet.codegen.linearised import Linearised
from exunet.forces.cable_term import SomeElements
from exunet.forces.from_outside import FIXED_NODES, effects_of
from exunet.forces.terms import Memories
from exunet.methods.method import METHODS, Kind, MethodFacts
from exunet.methods.plan import Plan
from exunet.system.system import State, System

Floats = NDArray[np.float64]


def build(system: System, state: State, plan: Plan, *, pushed: bool = False) -> Model:
    """Fill and assemble the engine's model at a state.

    Each free point is a mass point, each element that the engine can hold (`_native`) a connector with the
    user-defined law. One generic object computes the other forces, if there are any.

    pushed : with room for forces from outside
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
            if forces.kernels or pushed or system.blocks.states:
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


def remember(model: Model, system: System, memory: Memories) -> None:
    """Let a model's forces take all memories as they are now."""
    if model.applied is not None:
        model.applied.remember(memory)
    carrying = system.forces.cable.carrying(memory)
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
    for element in np.flatnonzero(native).tolist():
        i, j = net.element_nodes[element].tolist()
        model.cable_element(
            element, i, j, law.natural_length[element], law.stiffness[element], times[element]
        )


def _native(system: System) -> NDArray[np.bool_]:
    """(n_elements,) True for elements between points that the engine knows.

    It does not know where a body holds a point for a while: what joins such a point to one that is not held
    is left to the kernel. Within a packed net distances stay; on a drum elements carry nothing. Nor does it
    report what holds fixed nodes: where that is stored, the kernel has the elements that end there. A
    connector would move a point that rests: where points may rest, the kernel has all elements.
    """
    ends, kinematics = system.net.element_nodes, system.kinematics
    if system.blocks.awake is not None:
        return np.zeros(len(ends), dtype=bool)
    native = ~np.isin(ends, kinematics.point).any(axis=1)
    if FIXED_NODES in effects_of(one.name for one in system.blocks.states):
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
    """Let a kernel push the points and bodies."""
    linearised = Linearised(system.blocks, system.forces) if method.kind == Kind.IMPLICIT else None
    bodies = bool(system.driven.any())
    applied = AppliedKernel(
        model, kernel, dict(state.memory), system, bodies=bodies, halfway=method.asks_halfway
    )
    model.applied_forces(applied.evaluate, applied.jacobian(linearised), bodies=bodies)
    if system.blocks.states:
        model.first_order_states(state.first_order, applied.rates)
    model.applied = applied


def _bodies(model: Model, system: System, state: State) -> None:
    for k in np.flatnonzero(system.moves_freely).tolist():
        model.rigid_body(system.bodies[k], state.bodies[k])


def _points(model: Model, system: System, state: State) -> None:
    reference = system.blocks.position.copy()  # of point masses: where they start
    reference[: system.net.n_nodes] = system.net.reference_position
    for k in range(system.blocks.n_points):
        if system.free[k]:
            model.point(system.mass[k], reference[k], state.position[k], state.velocity[k])
        else:
            model.fixed_point(state.position[k])

"""From a scene to the engine: net, terms of the effects, initial state, plan, and the filled model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.model import Model
from exunet.base.errors import BeyondFloats, Fault
from exunet.base.faults import collected
from exunet.case.casefile import Case
from exunet.case.fault_location import located_faults
from exunet.case.scene import Scene
from exunet.forces.effects import extended, total_terms
from exunet.forces.terms import Terms
from exunet.methods.method import METHODS, Kind, NetForm
from exunet.methods.plan import Plan
from exunet.net import weave
from exunet.net.arrays import Net
from exunet.simulation.planning import make_plan, with_forms
from exunet.system import energy
from exunet.system.effect_survey import chosen
from exunet.system.initial import initial_state
from exunet.system.limits import start_faults, step_faults, within_floats

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """All that a run begins from, before any engine: plain values that a script can print or change.

    position, velocity : (n_nodes, 3) initial state [m], [m/s]
    """

    scene: Scene
    net: Net
    terms: Terms
    position: Floats
    velocity: Floats
    plan: Plan


def prepare(scene: Scene) -> Start:
    """Choose the effects, weave the net, set the initial state, sum the terms and plan the integration."""
    scene, notes = chosen(scene)
    net = extended(scene.effects, weave(scene.net))
    position, velocity = initial_state(scene, net)
    terms = total_terms(scene.effects, net, position)
    _refuse_overflow(net, terms, position, velocity)
    with collected() as faults:
        faults += start_faults(scene, net, terms, position, velocity)
        with within_floats(net):
            plan, wrong_steps = make_plan(scene, net, terms, velocity)
        faults += wrong_steps + step_faults(scene, net, plan)
    scene, plan = with_forms(scene, net, plan)
    return Start(scene, net, terms, position, velocity, replace(plan, notes=plan.notes + notes))


def prepare_case(case: Case) -> Start:
    """`prepare` for a case's scene; its faults name the line of the file or the override."""
    with located_faults(case):
        return prepare(case.scene)


def _refuse_overflow(net: Net, terms: Terms, position: Floats, velocity: Floats) -> None:
    with np.errstate(all="ignore"):
        energies = {
            "kinetic energy": (energy.kinetic(net, velocity), "initial"),
            "elastic energy": (energy.elastic(net, terms, position), "initial.packing"),
        }
    faults = [
        Fault(where, f"the {name} at the start is outside the range of floating-point numbers")
        for name, (value, where) in energies.items()
        if not np.isfinite(value)
    ]
    if faults:
        raise BeyondFloats(faults)


def build(start: Start) -> Model:
    """Fill and assemble the engine's model in the form that `engine.net` asks for.

    "connectors": a point a node, a connector an element, terms if there are any. "fused": the nodes, and the
    forces and masses of the whole net at once; raises MissingExtra without Numba.
    """
    model = Model()
    if start.scene.engine.net == NetForm.FUSED:
        _fused(model, start)
    else:
        _connectors(model, start)
    model.assemble()
    return model


def _connectors(model: Model, start: Start) -> None:
    net, terms = start.net, start.terms
    _points(model, start, massive=True)
    law = terms.law(net)
    times = law.relaxation_time if law.relaxation_time is not None else [None] * net.n_elements
    for (i, j), length, stiffness, time in zip(
        net.element_nodes.tolist(), law.natural_length, law.stiffness, times, strict=True
    ):
        model.cable_element(i, j, length, stiffness, time)
    model.linear_terms(terms.on_velocity, terms.stiffness, terms.load)
    if terms.kernels:
        from exunet.backends.exudyn.applied_kernel import apply
        from exunet.codegen.kernel import term_kernel
        from exunet.codegen.linearised import Linearised

        only = Terms(kernels=terms.kernels)
        implicit = METHODS[start.plan.method].kind == Kind.IMPLICIT
        linearised = Linearised(net, only, elements=False) if implicit else None
        apply(model, term_kernel(terms.kernels), linearised)


def _fused(model: Model, start: Start) -> None:
    from exunet.backends.exudyn.applied_kernel import apply
    from exunet.codegen.compile import require_numba
    from exunet.codegen.kernel import net_kernel, sever
    from exunet.codegen.linearised import Linearised

    require_numba('engine.net = "fused"')
    _points(model, start, massive=False)
    net, terms = start.net, start.terms
    linearised = Linearised(net, terms) if METHODS[start.plan.method].kind == Kind.IMPLICIT else None
    kernel = net_kernel(net, terms)
    model.sever = partial(sever, kernel)
    apply(model, kernel, linearised, net.mass)


def _points(model: Model, start: Start, *, massive: bool) -> None:
    net = start.net
    fixed = np.zeros(net.n_nodes, dtype=bool)
    fixed[net.fixed_nodes] = True
    for node in range(net.n_nodes):
        reference, position, velocity = (
            a[node] for a in (net.reference_position, start.position, start.velocity)
        )
        if fixed[node]:
            model.fixed_point(position)
        elif massive:
            model.point(net.mass[node], reference, position, velocity)
        else:
            model.node(reference, position, velocity)

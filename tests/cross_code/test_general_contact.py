"""Frictionless knots and bullets on a ball: exunet's contact against Exudyn's own GeneralContact."""

from __future__ import annotations

from typing import cast

import exudyn
import numpy as np
from exudyn.itemInterface import MarkerBodyRigid, MarkerNodePosition

from exunet.base.cases import shipped
from exunet.forces.contact.sphere_contact import SphereContact
from exunet.integrators.exudyn.model import Model
from exunet.integrators.exudyn.probe import Probe
from exunet.integrators.exudyn.stepper import settings_for
from exunet.simulation.preparation import Start
from exunet.simulation.simulation import Simulation
from exunet.studies.both_codes import read_both
from exunet.verification.random_states import in_contact

NODES = shipped("verification/contact")["nodes"]
STEP, STEPS = 1e-4, 600  # s; bullets touch from 26 ms on, nodes too from 43 ms on


def with_general_contact(start: Start) -> Model:
    """Build the net and the ball of a start, with contact of the engine: two springs in series, no dashpot.

    Each term becomes one GeneralContact, so that the net does not touch itself; the ball's sphere has the
    radii of both.
    """
    system, state, law = start.system, start.state, start.system.forces.cable.law
    model = Model()
    for k in range(system.blocks.n_points):
        model.point(system.mass[k], state.position[k], state.position[k], state.velocity[k])
    ball = model.rigid_body(system.bodies[0], state.bodies[0])
    for element, (i, j) in enumerate(system.net.element_nodes.tolist()):
        model.cable_element(element, i, j, law.natural_length[element], law.stiffness[element])
    for term in system.forces.kernels:
        data = cast(SphereContact, term.data)
        general = model.system.AddGeneralContact()
        general.verboseMode = 0
        general.SetFrictionPairings(np.zeros((1, 1)))
        nodes = [model.nodes[point] for point in (data.spheres.node // 3).tolist()]
        center = MarkerBodyRigid(bodyNumber=ball, localPosition=data.cores.place[0].tolist())
        spheres = [(center, float(data.cores.rounding[0] + data.spheres.thick))]
        spheres += [(MarkerNodePosition(nodeNumber=node), 0.0) for node in nodes]
        for marker, radius in spheres:
            general.AddSphereWithMarker(
                model.system.AddMarker(marker),
                radius=radius,
                contactStiffness=2.0 * data.law.stiffness,
                contactDamping=0.0,
                frictionMaterialIndex=0,
            )
    model.assemble(system.kinematics)
    return model


def test_both_give_the_same_accelerations() -> None:
    case = read_both(NODES)
    probes = (case.probe(), Probe(with_general_contact(case.start)))
    states = list(in_contact(case.start, 3, np.random.default_rng(20261123)))
    # The engine has no state that sums the work of contact.
    theirs = [state.moving._replace(first_order=np.zeros(0)) for state in states]
    sides = [[state.moving for state in states], theirs]
    found = [[probe.motion(moving) for moving in side] for probe, side in zip(probes, sides, strict=True)]
    for k in range(2):  # of the points, of the ball
        a, b = (np.array([motion[k] for motion in side]) for side in found)
        # Of the largest; the engine's own sums of the same law: 2e-15 seen.
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.abs(a).max())


def test_both_give_the_same_motion() -> None:
    simulation = Simulation(str(NODES), [f"solver.step={STEP}", "engine.backend=exudyn"])
    start = simulation.start
    model = with_general_contact(start)
    settings = settings_for(model, start.plan, 0.0)
    settings.timeIntegration.endTime = STEP * STEPS
    settings.timeIntegration.numberOfSteps = STEPS
    assert model.system.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.RK44)
    simulation.advance_to(STEP * STEPS)
    ours = simulation.state
    theirs = model.places.unpack(model.coordinates(), STEP * STEPS, {})
    assert np.abs(ours.velocity - start.velocity).max() > 0.5  # m/s: they have touched
    assert np.abs(ours.position - theirs.position).max() < 1e-12  # m
    assert np.abs(ours.bodies.position - theirs.bodies.position).max() < 1e-12

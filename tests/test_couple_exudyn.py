"""A net coupled to a user's own Exudyn system, and added to one as native items."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import Scene, momenta
from exudyn.itemInterface import (
    MarkerBodyPosition,
    MarkerBodyRigid,
    NodeRigidBodyRotVecLG,
    ObjectConnectorSpringDamper,
    ObjectGround,
    ObjectRigidBody,
)

import exunet
from exunet import InputError, NetSystem
from exunet.bodies.rigid import rotation_matrix, rotation_vector

# Each compiles kernels of its own.
pytestmark = [pytest.mark.slow, pytest.mark.ci]

END = 0.24
VELOCITY = exu.OutputVariableType.Velocity


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("coupled"))


class Host:
    """A user's system: the second body with the mass of its node, and a marker at the origin of its frame.

    The node is the centre of mass: the engine keeps the momentum of a body to round-off there only.
    in_frame : the node is the origin of the frame
    """

    def __init__(self, scene: Scene, *, spring: float = 0.0, in_frame: bool = False) -> None:
        start = exunet.prepare(exunet.load(scene.whole).scene)
        self.body = body = start.system.bodies[1]
        place, speed, attitude, spin = (part[0] for part in start.state.bodies.of_body(1).parts())
        self.container = exu.SystemContainer()
        self.mbs: Any = self.container.AddSystem()
        pose, spin = body.frame_poses(place, attitude), body.rotation @ spin
        centre = np.array(body.centre) * in_frame
        inertia = body.inertia_in_frame + body.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        if in_frame:
            place, speed = pose[:3], speed - rotation_matrix(pose[3:]) @ np.cross(spin, centre)
        self.node = self.mbs.AddNode(
            NodeRigidBodyRotVecLG(
                referenceCoordinates=[0.0] * 6,
                initialCoordinates=[*place, *rotation_vector(pose[3:])],
                initialVelocities=[*speed, *spin],
            )
        )
        six = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))]
        self.object = self.mbs.AddObject(
            ObjectRigidBody(mass=body.mass, inertia=six, centerOfMass=centre, nodeNumber=self.node)
        )
        self.marker, self.centre = (
            self.mbs.AddMarker(MarkerBodyRigid(bodyNumber=self.object, localPosition=point))
            for point in (centre - body.centre, centre)
        )
        if spring:
            ground = self.mbs.AddObject(ObjectGround())
            ends = [self.mbs.AddMarker(MarkerBodyPosition(bodyNumber=n)) for n in (ground, self.object)]
            connector = ObjectConnectorSpringDamper(markerNumbers=ends, referenceLength=2.0, stiffness=spring)
            self.mbs.AddObject(connector)

    def solve(self, method: str, steps: int, **settings: Any) -> None:
        simulation = exu.SimulationSettings()
        simulation.solution.file.write = False
        integration = simulation.timeIntegration
        integration.numberOfSteps, integration.endTime = steps, END
        integration.explicit.useLieGroupIntegration = True
        integration.newton.useModifiedNewton = False
        for name, value in settings.items():
            setattr(integration, name, value)
        self.mbs.SolveDynamic(simulation, solverType=getattr(exu.DynamicSolverType, method))

    def of_centre(self, what: Any) -> np.ndarray:
        return np.array(self.mbs.GetMarkerOutput(self.centre, what))


# Method, steps, and the error of place at the end that half the steps may have at most four times, or twice.
@pytest.mark.parametrize(
    ("method", "order"),
    [("RK44", 2), ("VelocityVerlet", 1), ("TrapezoidalIndex2", 1), ("GeneralizedAlpha", 1)],
)
def test_the_motion_is_that_of_one_system(scene: Scene, method: str, order: int) -> None:
    """And momentum is kept, with what is in transit."""
    whole = scene.in_one(END)
    known, before = whole.state.bodies.position[1], momenta(exunet.Simulation(scene.whole))[0]
    errors = []
    for steps in (60, 120):
        host, net = Host(scene), NetSystem(scene.net)
        coupling = exunet.couple(host.mbs, net, {"second": host.marker})
        host.solve(method, steps)
        report = coupling.report()
        errors.append(float(np.linalg.norm(host.of_centre(exu.OutputVariableType.Position) - known)))
        momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
        momentum = momentum + coupling.in_transit["second"]
        assert np.abs(momentum - before).max() < 1e-12 * 1.8  # of the momentum of the second body [N s]
        assert (report.steps, report.repeated) == (steps, 0)
    assert errors[0] / errors[1] > 0.8 * 2.0**order, errors
    assert errors[1] < {2: 1e-5, 1: 1e-3}[order]  # of a way of 0.15 m


def test_steps_that_the_host_rejects_are_taken_back(scene: Scene) -> None:
    """An adaptive host on a stiff spring gets what the net has given, step by accepted step."""
    host, net = Host(scene, spring=2e4), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    chosen = {"automaticStepSize": True, "adaptiveStep": True, "relativeTolerance": 0.0}
    host.solve("DOPRI5", 10, **chosen, absoluteTolerance=1e-7, initialStepSize=0.024)
    report = coupling.report()
    assert report.repeated > 0
    assert net.time == pytest.approx(END, abs=1e-9)
    given = net.simulation.view.first_order[:3]
    np.testing.assert_allclose(report.ports["second"].impulse, -given, atol=1e-13)

    accepted = Host(scene, spring=2e4), NetSystem(scene.net)
    again = exunet.couple(accepted[0].mbs, accepted[1], {"second": accepted[0].marker})
    steps = report.steps
    accepted[0].solve("RK44", 8 * steps)
    ends = [one.of_centre(exu.OutputVariableType.Position) for one in (host, accepted[0])]
    assert again.report().repeated == 0
    np.testing.assert_allclose(*ends, atol=1e-4)  # m; the host's steps are of 2 ms, those of RK44 shorter


def test_the_users_own_pre_step_function_goes_on(scene: Scene) -> None:
    host, net, seen = Host(scene), NetSystem(scene.net), []

    def mine(mbs: Any, t: float) -> bool:
        seen.append(t)
        return True

    host.mbs.SetPreStepUserFunction(mine)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 40)
    assert len(seen) == 40
    coupling.detach()
    coupling.detach()
    free = host.of_centre(VELOCITY)
    host.solve("RK44", 40)  # from its start again, without the net
    assert len(seen) == 80
    assert net.time == pytest.approx(END)
    assert np.linalg.norm(host.of_centre(VELOCITY) - free) > 0.01  # m/s that the net had changed
    np.testing.assert_allclose(host.of_centre(VELOCITY), [0.5, 0.0, 0.3], atol=1e-9)


def test_what_does_not_fit_is_refused(scene: Scene) -> None:
    host, net = Host(scene), NetSystem(scene.net)
    point = host.mbs.AddMarker(MarkerBodyPosition(bodyNumber=host.object, localPosition=[0.0] * 3))
    for ports, words in (
        ({}, "no marker is given for port second"),
        ({"third": host.marker}, "there is no port 'third': second"),
        ({"second": 99}, "there is no marker 99: the system has"),
        ({"second": "x"}, "there is no marker 'x'"),
        ({"second": host.centre}, "its position at the start in the case and that in the host"),
        ({"second": point}, "has no attitude: use a marker of a rigid frame"),
    ):
        with pytest.raises(InputError, match=words):
            exunet.couple(Host(scene).mbs if not ports else host.mbs, net, ports)
    with pytest.raises(InputError, match=r"longest must be positive, got -1\.0"):
        exunet.couple(host.mbs, net, {"second": host.marker}, longest=-1.0)
    whole = exunet.load(scene.whole)
    with pytest.raises(InputError, match="the net has no port"):
        exunet.couple(host.mbs, NetSystem(whole), {})


def test_faults_on_the_way_are_told_by_name(scene: Scene) -> None:
    host, net = Host(scene), NetSystem(scene.net)
    exunet.couple(host.mbs, net, {"second": host.marker}, longest=1e-3)
    with pytest.raises(exu.ModelError, match=r"the host's step of 0\.006 s at t = 0 s is beyond") as told:
        host.solve("RK44", 40)
    assert isinstance(told.value.__cause__, InputError)

    host, net = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 40)
    with pytest.raises(exu.ModelError, match="restore or reset the net, and couple anew"):
        host.solve("RK44", 40)  # from its start, where the net is not
    coupling.detach()
    net.reset()
    exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 40)


def test_native_items_move_as_one_system(scene: Scene) -> None:
    known = scene.in_one(END).state
    host = Host(scene, in_frame=True)
    items = exunet.add_to(host.mbs, scene.net, {"second": host.object})
    assert items.items == {"ObjectRigidBody": 1, "MassPoint": 1, "ObjectConnectorSpringDamper": 2}
    assert list(items.bodies) == ["first"]
    assert (items.nodes >= 0).tolist() == [False, True, False]
    host.mbs.Assemble()
    host.solve("RK44", 24000)
    place = host.mbs.GetNodeOutput(int(items.nodes[1]), exu.OutputVariableType.Position)
    # The kink of the law leaves second order: 1e-5 s squared times 1e3 m/s3 is 1e-7 m.
    np.testing.assert_allclose(place, known.position[1], atol=1e-7)
    np.testing.assert_allclose(
        host.of_centre(exu.OutputVariableType.Position), known.bodies.position[1], atol=1e-7
    )


def test_what_has_no_items_is_refused(scene: Scene, tmp_path: Path) -> None:
    host = Host(scene)
    for overrides, words in (
        (["bodies.first.motion=fixed", "bodies.first.velocity=[0,0,0]"], "fixed|is not for"),
        (["effects.breaking={strain=0.5}"], "events: breaks"),
        (["effects.air_drag={density=1.0, drag_coefficient=1.0}"], "a nonlinear force|air_drag"),
    ):
        with pytest.raises(exunet.ExunetError, match=words):
            exunet.add_to(host.mbs, scene.net, {"second": host.object}, overrides)
    for ports, words in (
        ({}, "no body is given for port second"),
        ({"second": 99}, "there is no object 99"),
        ({"second": host.object, "x": 0}, "there is no port 'x'"),
    ):
        with pytest.raises(InputError, match=words):
            exunet.add_to(host.mbs, scene.net, ports)

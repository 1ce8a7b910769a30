"""A net coupled to a user's own Exudyn system, and added to one as native items."""

from __future__ import annotations

import math
import sys
from itertools import combinations, pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from coupled import Scene, momenta, spring
from exudyn.itemInterface import (
    LoadForceVector,
    MarkerBodyPosition,
    MarkerBodyRigid,
    MarkerSuperElementRigid,
    NodePoint,
    NodeRigidBodyRotVecLG,
    ObjectConnectorSpringDamper,
    ObjectGenericODE2,
    ObjectGround,
    ObjectRigidBody,
)
from exudyn.rigidBodyUtilities import InertiaCuboid

import exunet
from exunet import InputError, NetSystem
from exunet.bodies.rotations import rotation_matrix, rotation_vector
from exunet.coupling.exudyn_state import Handover

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

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

    def solve(self, method: str, steps: int, *, on: bool = False, **settings: Any) -> None:
        """Until `END`, or the setting endTime; on: from where the run before has ended."""
        simulation = exu.SimulationSettings()
        simulation.solution.file.write = False
        integration = simulation.timeIntegration
        integration.numberOfSteps, integration.endTime = steps, END
        integration.explicit.useLieGroupIntegration = True
        integration.newton.useModifiedNewton = False
        for name, value in settings.items():
            setattr(integration, name, value)
        if on:
            state = self.mbs.systemData.GetSystemState()
            self.mbs.systemData.SetSystemState(state, exu.ConfigurationType.Initial)
        self.mbs.SolveDynamic(simulation, solverType=getattr(exu.DynamicSolverType, method))

    @property
    def energy(self) -> float:
        """Kinetic [J]."""
        speed = self.of_centre(VELOCITY)
        spin = np.array(self.mbs.GetMarkerOutput(self.centre, exu.OutputVariableType.AngularVelocityLocal))
        return float(0.5 * self.body.mass * speed @ speed + 0.5 * spin @ self.body.inertia_in_frame @ spin)

    def of_centre(self, what: Any) -> np.ndarray:
        return np.array(self.mbs.GetMarkerOutput(self.centre, what))


METHODS = ("RK44", "VelocityVerlet", "TrapezoidalIndex2", "GeneralizedAlpha")


@pytest.mark.ci_for("RK44")
@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_motion_is_that_of_one_system(scene: Scene, method: str) -> None:
    """Of second order; and momentum is kept, with what is in transit."""
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
    # The engine's velocity Verlet is of first order for bodies that turn.
    order = 1 if method == "VelocityVerlet" else 2
    assert errors[0] / errors[1] > 0.8 * 2.0**order, errors
    assert errors[1] < (1e-4 if method == "VelocityVerlet" else 2e-5)  # of a way of 0.15 m


@pytest.mark.ci
@pytest.mark.slow
def test_forces_are_handed_over_for_the_length_of_each_step(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not for the time of its end."""
    asked, handed = [], Handover.handed

    def noted(self: Handover, mean: np.ndarray, step: float, *, jumps: bool) -> np.ndarray:
        asked.append(step)
        return handed(self, mean, step, jumps=jumps)

    monkeypatch.setattr(Handover, "handed", noted)
    host = Host(scene)
    exunet.couple(host.mbs, NetSystem(scene.net), {"second": host.marker})
    host.solve("GeneralizedAlpha", 4, endTime=0.016)
    assert asked == pytest.approx([0.004] * 4, rel=1e-9)


def drifted(scene: Scene, method: str, steps: int) -> tuple[float, float, float]:
    """Energy [J] that host and net gain until `END`, the residual, and what the host's method adds by itself.

    The last is what the body's kinetic energy gains beyond the work of the loads on it.
    """
    host, net = Host(scene), NetSystem(scene.net)
    start = exunet.Simulation(scene.whole)
    body, own = start.start.system.bodies[1], start.state.bodies.of_body(1)
    speed, spin = own.velocity[0], own.angular_velocity[0]
    kinetic = 0.5 * (body.mass * speed @ speed + (spin * body.inertia) @ spin)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve(method, steps)
    book = coupling.report().ports["second"]
    drift = host.energy + momenta(net.simulation)[2] - sum(momenta(start)[2:])
    return drift, book.residual, host.energy - kinetic - (book.work + book.residual)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_residual_is_the_drift_of_the_energy(scene: Scene, method: str) -> None:
    """Within a factor of 5 at all steps, and nearly 1; of velocity Verlet less what it adds by itself.

    The engine's velocity Verlet turns bodies at first order, with or without a net, so that what it adds
    falls with the step; the residual falls with its square. Of a drift of both the residual was 1/1.6 at
    30 steps, 1/8.3 at 480 and 1/30 at 1920.
    """
    added = []
    for steps in (30, 120, 480):
        drift, residual, by_itself = drifted(scene, method, steps)
        assert abs(drift) > 1e-7  # J, far above round-off of the 7 J that there are
        if method == "VelocityVerlet":
            drift -= by_itself
            added.append(by_itself)
        assert drift / residual == pytest.approx(1.0, abs=0.2)
    if method == "VelocityVerlet":
        np.testing.assert_allclose(
            np.divide(added[:-1], added[1:]), 4.0, rtol=0.1
        )  # in steps 4 times as short


@pytest.mark.slow
def test_velocity_verlet_adds_energy_to_a_turning_body_without_a_net(scene: Scene) -> None:
    """So that it is no part of what a coupling adds: of first order in the step."""
    added = []
    for steps in (120, 480):
        host = Host(scene)
        host.mbs.Assemble()
        begin = host.mbs.systemData.GetODE2Coordinates_t()
        host.solve("VelocityVerlet", steps)
        speed, spin = np.array(begin[:3]), np.array(begin[3:])
        inertia = host.body.inertia_in_frame
        added.append(host.energy - 0.5 * (host.body.mass * speed @ speed + spin @ inertia @ spin))
    assert added[0] > 1e-6  # J
    assert added[0] / added[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
def test_steps_that_the_host_rejects_are_as_if_they_had_not_been(scene: Scene) -> None:
    """An adaptive host on a stiff spring, and one that takes those steps alone, one solver for each."""
    host, net, seen = Host(scene, spring=2e4), NetSystem(scene.net), []

    def mine(mbs: Any, t: float) -> bool:
        seen.append(t)
        return True

    host.mbs.SetPreStepUserFunction(mine)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("DOPRI5", 10, relativeTolerance=0.0, absoluteTolerance=1e-7, initialStepSize=0.024)
    report = coupling.report()
    ends = [time for time, after in pairwise([*seen, np.inf]) if after > time]
    assert report.repeated == len(seen) - len(ends) > 0
    given = net.simulation.view.first_order[:3]
    np.testing.assert_allclose(report.ports["second"].impulse, -given, atol=1e-13)

    other, own = Host(scene, spring=2e4), NetSystem(scene.net)
    again = exunet.couple(other.mbs, own, {"second": other.marker})
    for begin, end in pairwise([0.0, *ends]):
        times = {"startTime": begin, "endTime": end}
        other.solve("DOPRI5", 1, on=begin > 0.0, relativeTolerance=0.0, absoluteTolerance=1e9, **times)
    assert (again.report().repeated, again.report().steps) == (0, report.steps)
    position = exu.OutputVariableType.Position
    np.testing.assert_allclose(other.of_centre(position), host.of_centre(position), atol=1e-12)
    both = (item.report().ports["second"].impulse for item in (coupling, again))
    np.testing.assert_allclose(*both, atol=4e-12)  # of 4 N s


@pytest.mark.slow
@pytest.mark.parametrize("methods", [*pairwise(METHODS[::-1]), *((method, method) for method in METHODS)])
def test_a_run_goes_on_with_another_method(scene: Scene, methods: tuple[str, str]) -> None:
    """And what one has left in transit the other gives, so that momentum is kept."""
    before = momenta(exunet.Simulation(scene.whole))[0]
    host, net = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve(methods[0], 30, endTime=0.12)
    host.solve(methods[1], 30, on=True, startTime=0.12)
    momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
    assert np.abs(momentum + coupling.in_transit["second"] - before).max() < 1e-12 * 1.8


@pytest.mark.slow
def test_loads_and_markers_may_be_deleted_but_for_the_coupling_s_own(scene: Scene) -> None:
    """The others get other numbers; the coupling follows its own."""
    before = momenta(exunet.Simulation(scene.whole))[0]
    host, net = Host(scene), NetSystem(scene.net)
    spare = host.mbs.AddMarker(MarkerBodyRigid(bodyNumber=host.object, localPosition=[0.05, 0.0, 0.0]))
    centre = [0.0 - float(item) for item in host.body.centre]
    port = host.mbs.AddMarker(MarkerBodyRigid(bodyNumber=host.object, localPosition=centre))
    first = host.mbs.AddLoad(LoadForceVector(markerNumber=host.centre, loadVector=[0.0] * 3))
    coupling = exunet.couple(host.mbs, net, {"second": port})
    host.mbs.AddMarker(MarkerBodyRigid(bodyNumber=host.object, localPosition=[0.0, 0.05, 0.0]))
    host.mbs.AddLoad(LoadForceVector(markerNumber=host.centre, loadVector=[0.0] * 3))
    host.mbs.DeleteLoad(first, False)
    host.mbs.DeleteMarker(spare)
    host.mbs.Assemble()
    host.solve("RK44", 30, endTime=0.12)
    momentum = momenta(net.simulation)[0] + host.body.mass * host.of_centre(VELOCITY)
    assert np.abs(momentum - before).max() < 1e-12 * 1.8
    host.mbs.DeleteLoad(0, False)
    host.mbs.Assemble()
    with pytest.raises(exu.ModelError, match="port second: a load that the coupling has added was deleted"):
        host.solve("RK44", 30, on=True, startTime=0.12)
    coupling.detach()


@pytest.mark.ci_for("1")
@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 20])
def test_an_explicit_host_is_set_back(scene: Scene, iterations: int) -> None:
    """Of second order, with momentum at any step; what is repeated repeats to the last bit."""
    whole, errors = scene.in_one(END), []
    known, before = whole.state.bodies.position[1], momenta(exunet.Simulation(scene.whole))[0]
    for step in (8e-3, 4e-3):
        own, net = Host(scene), NetSystem(scene.net)
        host = exunet.ExudynHost(own.mbs, {"second": own.marker}, step=1e-3)
        both = exunet.Cosimulation(net, host, step=step, iterations=iterations)
        both.advance_to(END)
        momentum = momenta(net.simulation)[0] + own.body.mass * own.of_centre(VELOCITY)
        assert np.abs(momentum - before).max() < 1e-12 * 1.8
        errors.append(np.linalg.norm(own.of_centre(exu.OutputVariableType.Position) - known))
    assert errors[0] / errors[1] > 0.8 * 4.0, errors
    assert errors[1] < 2e-5  # m, of a way of 0.15 m
    assert (both.books.repeated > 0) == (iterations > 1)
    loads, here = net.step(END + 4e-3, {"second": net.frame("second").after(4e-3)}), host.snapshot()
    ends: list[Any] = []
    steps: list[float] = []
    own.mbs.SetPreStepUserFunction(lambda mbs, t: steps.append(t) is None)
    for _ in range(2):
        host.restore(here)
        assert host.time == END
        host.step(END + 4e-3, loads)
        ends.append(host.frames()["second"])
    assert ends[0] == ends[1]
    assert len(steps) == 2 * 4  # of 1e-3 s


@pytest.mark.slow
def test_ports_at_markers_of_one_body_are_known(scene: Scene) -> None:
    own, other = Host(scene), {"referencePosition": [9.0, 0.0, 0.0], "inertia": InertiaCuboid(1.0, [1.0] * 3)}
    far = own.mbs.AddMarker(MarkerBodyRigid(bodyNumber=own.mbs.CreateRigidBody(**other)))
    ports = {"a": own.marker, "b": far, "c": own.centre}
    host = exunet.ExudynHost(own.mbs, ports, step=1e-3)
    assert sorted(host.shared()) == [("a", "c"), ("b",)]


@pytest.mark.slow
def test_hosts_that_cannot_be_set_back_are_refused(scene: Scene) -> None:
    own = Host(scene)
    for arguments, words in (
        (
            {"method": "VelocityVerlet"},
            "VelocityVerlet' cannot be set back to the last bit: ExplicitMidpoint",
        ),
        ({"method": "GeneralizedAlpha"}, "any other with exunet.couple, which repeats no steps"),
        ({"step": 0.0}, r"step must be positive and finite, got 0\.0"),
    ):
        with pytest.raises(InputError, match=words):
            exunet.ExudynHost(own.mbs, {"second": own.marker}, **({"step": 1e-3} | arguments))
    with pytest.raises(InputError, match="ExudynHost: port second: there is no marker 99"):
        exunet.ExudynHost(own.mbs, {"second": 99}, step=1e-3)
    assert own.mbs.systemData.NumberOfLoads() == 0


@pytest.mark.slow
def test_a_flexible_body_at_the_mean_frame_of_its_nodes(tmp_path: Path) -> None:
    """Four masses on springs in an ObjectGenericODE2: what the net gives is what they get."""
    net, _ = spring(tmp_path)
    mass = 0.05 + net.carried_mass("b")
    offsets = np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    offsets -= offsets.mean(axis=0)
    mbs = exu.SystemContainer().AddSystem()
    start = {"initialVelocities": [0.01, 0.0, 0.0]}
    nodes = [
        mbs.AddNode(NodePoint(referenceCoordinates=[1.01 + x, y, z], **start)) for x, y, z in offsets.tolist()
    ]
    stiffness = np.zeros((12, 12))
    for i, j in combinations(range(4), 2):
        way = (offsets[j] - offsets[i]) / np.linalg.norm(offsets[j] - offsets[i])
        both = np.zeros((12, 12))
        both[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = both[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] = 1.0
        both[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = both[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = -1.0
        stiffness += 1e3 * both * np.tile(np.outer(way, way), (4, 4))
    body = ObjectGenericODE2(nodeNumbers=nodes, massMatrix=np.eye(12) * mass / 4.0, stiffnessMatrix=stiffness)
    weights = {"meshNodeNumbers": [0, 1, 2, 3], "weightingFactors": [0.25] * 4}
    marker = mbs.AddMarker(MarkerSuperElementRigid(bodyNumber=mbs.AddObject(body), **weights))
    coupling = exunet.couple(mbs, net, {"b": marker})
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 100, 0.1
    mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.GeneralizedAlpha)
    speeds = [np.array(mbs.GetNodeOutput(node, VELOCITY)) for node in nodes]
    given = coupling.report().ports["b"].impulse
    assert np.abs(given).max() > mass * 0.01  # N s, as much as it had
    gained = mass * (np.mean(speeds, axis=0) - [0.01, 0.0, 0.0])
    np.testing.assert_allclose(gained + coupling.in_transit["b"], given, atol=1e-12 * np.abs(given).max())


@pytest.mark.slow
def test_the_users_own_pre_step_function_goes_on(scene: Scene) -> None:
    host, net, seen = Host(scene), NetSystem(scene.net), []

    def mine(mbs: Any, t: float) -> bool:
        seen.append(t)
        return True

    host.mbs.SetPreStepUserFunction(mine)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 40)
    assert len(seen) == 40
    report = str(coupling.report())

    def later(mbs: Any, t: float) -> bool:
        seen.append(-t)
        return chained(mbs, t)

    chained = host.mbs.GetPreStepUserFunction()["function"]
    host.mbs.SetPreStepUserFunction(later)
    coupling.detach()
    coupling.detach()
    free = host.of_centre(VELOCITY)
    host.solve("RK44", 40)  # from its start again, without the net
    assert len(seen) == 120  # by `mine` in both runs, by `later` in the second
    assert str(coupling.report()) == report  # what the host does alone is not in it
    assert net.time == pytest.approx(END)
    assert np.linalg.norm(host.of_centre(VELOCITY) - free) > 0.01  # m/s that the net had changed
    np.testing.assert_allclose(host.of_centre(VELOCITY), [0.5, 0.0, 0.3], atol=1e-9)


@pytest.mark.slow
def test_a_step_calls_few_functions_of_python(scene: Scene) -> None:
    """What a step costs beside net and host, as a number that no other program changes: 51 calls of functions
    of the coupling, 10 of which are the engine's, for two loads. It was 135, and 158 us a step."""
    calls = []

    def count(frame: FrameType, event: str, _: Any) -> None:
        names = ("coupling", "bodies")
        calls[-1] += event == "call" and Path(frame.f_code.co_filename).parent.name in names

    for steps in (20, 60):
        host, net = Host(scene), NetSystem(scene.net)
        exunet.couple(host.mbs, net, {"second": host.marker})
        calls.append(0)
        sys.setprofile(count)
        try:
            host.solve("RK44", steps, endTime=steps * 1e-3)
        finally:
            sys.setprofile(None)
    assert 20 < (calls[1] - calls[0]) / 40 < 55


@pytest.mark.slow
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
    for arguments, words in (
        ((None, net, {}), "mbs: a system of Exudyn, got NoneType"),
        ((host.mbs, "net.toml", {}), "net: an exunet.NetSystem, got str"),
        (
            (host.mbs, net, [host.marker]),
            r"ports: the number of a marker by the name of each port, got \[0\]",
        ),
    ):
        with pytest.raises(InputError, match=words):
            exunet.couple(*arguments)  # type: ignore[arg-type]
    assert host.mbs.systemData.NumberOfLoads() == 0
    for longest in (-1.0, 0, True, math.nan, "1"):
        with pytest.raises(InputError, match=f"longest must be positive, got {longest!r}"):
            exunet.couple(host.mbs, net, {"second": host.marker}, longest=longest)  # type: ignore[arg-type]
    whole = exunet.load(scene.whole)
    with pytest.raises(InputError, match="the net has no port"):
        exunet.couple(host.mbs, NetSystem(whole), {})


@pytest.mark.ci
@pytest.mark.slow
def test_faults_on_the_way_are_told_by_name(scene: Scene) -> None:
    host, net = Host(scene), NetSystem(scene.net)
    exunet.couple(host.mbs, net, {"second": host.marker}, longest=1e-3)
    with pytest.raises(exu.ModelError, match=r"the host's step of 0\.006 s at t = 0 s is beyond") as told:
        host.solve("RK44", 40)
    assert isinstance(told.value.__cause__, InputError)

    host, net = Host(scene), NetSystem(scene.net)
    coupling = exunet.couple(host.mbs, net, {"second": host.marker})
    with pytest.raises(InputError, match="the net is in a coupling already: detach that one first"):
        exunet.couple(host.mbs, net, {"second": host.marker})
    with pytest.raises(exu.ModelError, match="the host starts at t = 5 s, the net is at 0 s"):
        host.solve("RK44", 40, startTime=5.0, endTime=5.24)
    host.solve("RK44", 40)
    with pytest.raises(
        exu.ModelError, match="restore a snapshot of the coupling, or reset the net and couple anew"
    ):
        host.solve("RK44", 40)  # from its start, where the net is not
    coupling.detach()
    net.reset()
    exunet.couple(host.mbs, net, {"second": host.marker})
    host.solve("RK44", 40)


@pytest.mark.ci
@pytest.mark.slow
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


@pytest.mark.ci
@pytest.mark.slow
def test_what_has_no_items_is_refused(scene: Scene, tmp_path: Path) -> None:
    host = Host(scene)
    for overrides, words in (
        (["bodies.first.motion=fixed", "bodies.first.velocity=[0,0,0]"], "fixed|is not for"),
        (["effects.breaking={strain=0.5}"], "events: breaks"),
        (["effects.air_drag={density=1.0, drag_coefficient=1.0}"], "a nonlinear force|air_drag"),
        (
            ["effects.rayleigh_damping={alpha=0.1, beta=1e-4}"],
            "add_to: .* a damping or an orbit that couples",
        ),
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
    launch = Path(__file__).parents[1] / "cases/bodies/launch.toml"
    with pytest.raises(InputError, match=r"the recoil of a throw from port chaser \(initial\.frame\.body\)"):
        exunet.add_to(
            host.mbs,
            launch,
            {"chaser": host.object},
            ["engine.backend=compiled", "bodies.chaser.motion=port"],
        )
    apart = Host(scene)  # whose node is the centre of mass, and not the origin of the frame
    point = apart.mbs.AddObject(ObjectGround())
    for number, words in (
        (
            apart.object,
            "add_to: port second: its position at the start in the case and that in the host differ",
        ),
        (point, r"add_to: port second: object 1 \(Ground\) has no frame of its own: use a rigid body"),
    ):
        with pytest.raises(InputError, match=words):
            exunet.add_to(apart.mbs, scene.net, {"second": number})

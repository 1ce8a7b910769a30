"""Scenes of coupled nets: two bodies on a cable that snaps taut, and a body between two stretched cables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import exudyn as exu
import numpy as np
from exudyn.itemInterface import (
    LoadMassProportional,
    MarkerBodyMass,
    MarkerBodyPosition,
    MarkerBodyRigid,
    NodeRigidBodyRotVecLG,
    ObjectConnectorSpringDamper,
    ObjectGround,
    ObjectRigidBody,
)

import exunet
from exunet import BodiesHost, Coupler, FrameState, NetSystem, Simulation
from exunet.bodies.rotations import rotation_matrix, rotation_vector
from exunet.model.states import States

# A cable of two elements, 1 m and 55 N each, between two bodies; the first element is taut at the start, the
# second snaps taut at some 0.1 s.
CHAIN = """
format = 1
title = "Two bodies on a cable"
time = { end = 0.4, output_step = 0.05 }
solver = { method = "DOPRI5", tolerance = 1e-11 }
engine.backend = "compiled"
initial.packing = 1.0
initial.node_positions = [[0.0, 0.0, 0.0], [1.05, 0.0, 0.0], [2.0, 0.0, 0.0]]
initial.node_velocities = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [0.0, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
net.elements = [[0, 1], [1, 2]]
net.node_masses = [0.1, 0.5, 0.1]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }

[bodies.first]
mass = 2.0
inertia = [0.2, 0.3, 0.4]
position = [-0.5, 0.2, 0.1]
velocity = [-0.3, 0.0, 0.2]
angular_velocity = [1.0, 2.0, -1.5]
attachments.x = { point = [0.3, 0.1, -0.2], node = 0 }
"""
SECOND = """
[bodies.second]
mass = 3.0
inertia = [0.2, 0.3, 0.4]
products_of_inertia = [0.05, 0.02, 0.01]
centre_of_mass = [0.1, 0.2, 0.3]
position = [2.2, 0.1, 0.0]
velocity = [0.5, 0.0, 0.3]
attitude = [0.9, 0.1, 0.3, 0.2]
angular_velocity = [0.1, 2.0, 0.0]
attachments.x = { point = [-0.1, 0.1, 0.2], node = 2 }
"""
LUMP = 1390.0 * math.pi * 0.0005**2 / 2.0  # half an element [kg]
MOMENTUM = 1.8  # of the second body [N s], to which round-off of momenta is compared
METHODS = ("RK44", "ExplicitMidpoint", "TrapezoidalIndex2", "GeneralizedAlpha")
POSITION, VELOCITY = exu.OutputVariableType.Position, exu.OutputVariableType.Velocity


class Scene:
    """Case files of the scene in a folder: all in one system, and with the second body as a port."""

    def __init__(self, folder: Path, *changes: tuple[str, str]) -> None:
        text = CHAIN + SECOND
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        self.whole, self.net = folder / "whole.toml", folder / "net.toml"
        self.whole.write_text(text)
        self.net.write_text(text.replace("mass = 3.0", 'mass = 3.0\nmotion = "port"'))

    def in_one(self, until: float) -> Simulation:
        """Both in one system, at a time [s]."""
        sim = Simulation(self.whole)
        sim.advance_to(until)
        return sim

    def both(self) -> tuple[NetSystem, BodiesHost]:
        """Net and host at the start."""
        net = NetSystem(self.net)
        return net, BodiesHost.of_ports(net)

    def coupled(self, method: str, step: float, iterations: int = 1) -> tuple[ExudynBody, NetSystem, Coupler]:
        """Body in Exudyn, net and coupling by macro steps [s]."""
        body, net = ExudynBody.second(self), NetSystem(self.net)
        host = exunet.ExudynHost(body.mbs, {"second": body.marker}, step=1e-3, method=method)
        return body, net, Coupler(net, host, step=step, iterations=iterations)

    def lost(self, net: NetSystem, host: ExudynBody | BodiesHost) -> float:
        """Momentum [N s] that net and host have lost since the start."""
        now = momenta(net.simulation)[0] - momenta(Simulation(self.whole))[0]
        if isinstance(host, BodiesHost):
            now += momenta(host.simulation)[0]
        else:
            now += host.mass * host.at_centre(VELOCITY)
        return float(np.abs(now).max())


def momenta(sim: Simulation) -> tuple[np.ndarray, np.ndarray, float]:
    """Momentum [N s], angular momentum about the origin [N m s] and energy [J] of what moves freely."""
    now = States.of(sim.start.system, sim.state)
    return now.momentum[0], now.angular_momentum[0], sim.energy.kinetic + sim.energy.elastic


def sums(net: NetSystem, host: BodiesHost) -> list[np.ndarray]:
    """Momentum, angular momentum and energy of both."""
    pairs = zip(momenta(net.simulation), momenta(host.simulation), strict=True)
    return [np.add(*pair) for pair in pairs]


def energy_of(net: NetSystem, host: BodiesHost | None = None) -> float:
    """Energy of what moves freely, and of the net [J]."""
    return momenta(net.simulation)[2] + (momenta(host.simulation)[2] if host is not None else 0.0)


def centre(host: BodiesHost) -> np.ndarray:
    """Position of the first body's centre of mass [m]."""
    return host.simulation.state.bodies.position[0]


def everything(net: NetSystem, coupler: Coupler, host: Any) -> dict[str, Any]:
    """Every number of net, host and coupling."""
    arrays = {name: part.tobytes() for name, part in net.simulation.state.arrays().items()}
    return {**arrays, "host": host.frames(), "ledger": coupler.ledger.as_array().tobytes()}


def assert_same_bits(one: NetSystem, other: NetSystem) -> None:
    """Two nets are in the same state, with the same inputs."""
    for sim in (one.simulation, other.simulation):
        sim.settle()
    known = {**one.simulation.state.arrays(), **one.simulation.inputs}
    for name, values in {**other.simulation.state.arrays(), **other.simulation.inputs}.items():
        np.testing.assert_array_equal(known[name], values, err_msg=name)


def spring(folder: Path, stretch: float = 1.01, speed: float = 0.01) -> tuple[NetSystem, BodiesHost]:
    """A body of 0.05 kg in the middle of two stretched cables of 1 m, and its host; in spring.toml."""
    file = folder / "spring.toml"
    file.write_text(f"""
format = 1
title = "A spring"
time = {{ end = 9.0, output_step = 1.0 }}
solver = {{ method = "DOPRI5", tolerance = 1e-11 }}
engine.backend = "compiled"
initial.packing = 1.0
net.topology = "explicit"
net.cable = {{ diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }}
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
net.fixed = [0, 2]
net.elements = [[0, 1], [1, 2]]
net.node_masses = [0.0, 1e-3, 0.0]
initial.node_positions = [[0.0, 0.0, 0.0], [{stretch}, 0.0, 0.0], [{2.0 * stretch}, 0.0, 0.0]]
[bodies.b]
motion = "port"
mass = 0.05
inertia = [1.0, 1.0, 1.0]
position = [{stretch}, 0.0, 0.0]
velocity = [{speed}, 0.0, 0.0]
attachments.x = {{ point = [0.0, 0.0, 0.0], node = 1 }}
""")
    net = NetSystem(file)
    return net, BodiesHost.of_ports(net)


def stiffness(stretch: float = 1.01) -> float:
    """Stiffness of the spring [N/m]: of eq. (3), N = EA (s^3 - s) / 2, two tangents at a stretch s."""
    return 2.0 * 70e6 * math.pi * 0.0005**2 * (1.5 * stretch**2 - 0.5)


def settings(begin: float, end: float, steps: int, **integration: Any) -> exu.SimulationSettings:
    """Settings of a run of Exudyn; integration : of timeIntegration, its newton or its generalizedAlpha."""
    made = exu.SimulationSettings()
    made.solution.file.write = False
    time = made.timeIntegration
    time.startTime, time.endTime, time.numberOfSteps = begin, end, steps
    time.explicit.useLieGroupIntegration = True
    time.newton.useModifiedNewton = False
    for name, value in integration.items():
        tables = (time, time.newton, time.generalizedAlpha)
        setattr(next(table for table in tables if hasattr(table, name)), name, value)
    return made


class ExudynBody:
    """A rigid body in Exudyn, with a marker at the origin of its frame.

    mass, inertia : about the node (xx, yy, zz, yz, xz, xy)
    position      : of the node and its rotation vector (6,); moves : velocity and local angular velocity (6,)
    frame, centre : (3,) of the frame's origin and of the centre of mass, from the node, in the body's axes
                    [m]
    """

    def __init__(
        self,
        mass: float,
        inertia: Any,
        position: Any,
        moves: Any,
        *,
        frame: Any = (0.0, 0.0, 0.0),
        centre: Any = (0.0, 0.0, 0.0),
        gravity: float = 0.0,
    ) -> None:
        self.mass, self.mbs = mass, exu.SystemContainer().AddSystem()
        turns = {"initialCoordinates": [*position], "initialVelocities": [*moves]}
        node = self.mbs.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[0.0] * 6, **turns))
        body = ObjectRigidBody(mass=mass, inertia=[*inertia], centerOfMass=[*centre], nodeNumber=node)
        self.object = self.mbs.AddObject(body)
        self.marker, self.centre = (
            self.mbs.AddMarker(MarkerBodyRigid(bodyNumber=self.object, localPosition=[*point]))
            for point in (frame, centre)
        )
        if gravity:
            weight = self.mbs.AddMarker(MarkerBodyMass(bodyNumber=self.object))
            self.mbs.AddLoad(LoadMassProportional(markerNumber=weight, loadVector=[0.0, 0.0, -gravity]))

    @classmethod
    def second(cls, scene: Scene, *, in_frame: bool = False) -> ExudynBody:
        """The second body with the mass of its node.

        The node is the centre of mass, for which the engine keeps the momentum to round-off; in_frame : it is
        the origin of the frame.
        """
        start = exunet.prepare(exunet.load(scene.whole).scene)
        body = start.system.bodies[1]
        place, speed, attitude, spin = (part[0] for part in start.state.bodies.of_body(1).parts())
        pose, spin = body.frame_poses(place, attitude), body.rotation @ spin
        arm = np.array(body.centre) * in_frame
        inertia = body.inertia_in_frame + body.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        if in_frame:
            place, speed = pose[:3], speed - rotation_matrix(pose[3:]) @ np.cross(spin, arm)
        six = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))]
        turn = rotation_vector(pose[3:])
        frame = arm - body.centre
        made = cls(body.mass, six, [*place, *turn], [*speed, *spin], frame=frame, centre=arm)
        made.inertia = body.inertia_in_frame
        return made

    def on_spring(self, stiffness: float, force: Any = None) -> ExudynBody:
        """Tie the node to the ground by a spring of 2 m."""
        ground = self.mbs.AddObject(ObjectGround())
        ends = [self.mbs.AddMarker(MarkerBodyPosition(bodyNumber=n)) for n in (ground, self.object)]
        connector = ObjectConnectorSpringDamper(markerNumbers=ends, referenceLength=2.0, stiffness=stiffness)
        if force is not None:
            connector.springForceUserFunction = force
        self.mbs.AddObject(connector)
        return self

    def solve(
        self, method: str, steps: int, end: float, begin: float = 0.0, *, on: bool = False, **changes: Any
    ) -> None:
        """Run until a time [s]; on : from where the run before has ended."""
        if on:
            state = self.mbs.systemData.GetSystemState()
            self.mbs.systemData.SetSystemState(state, exu.ConfigurationType.Initial)
        kind = getattr(exu.DynamicSolverType, method)
        self.mbs.SolveDynamic(settings(begin, end, steps, **changes), solverType=kind)

    def at_centre(self, what: Any) -> np.ndarray:
        """Output of the marker at the centre of mass."""
        return np.array(self.mbs.GetMarkerOutput(self.centre, what))

    @property
    def energy(self) -> float:
        """Kinetic energy [J]."""
        speed = self.at_centre(VELOCITY)
        spin = np.array(self.mbs.GetMarkerOutput(self.centre, exu.OutputVariableType.AngularVelocityLocal))
        return float(0.5 * self.mass * speed @ speed + 0.5 * spin @ self.inertia @ spin)


def ahead(net: NetSystem, duration: float, port: str = "second") -> np.ndarray:
    """State (1, 13) of a port after a time [s] at constant velocity."""
    return np.array([np.concatenate(net.frame(port).after(duration))])


def some_state(random: np.random.Generator) -> FrameState:
    """A random state of a frame."""
    attitude = random.normal(size=4)
    parts = random.normal(size=3), random.normal(size=3), attitude / np.linalg.norm(attitude)
    return FrameState.of((*parts, random.normal(size=3)), "a test")

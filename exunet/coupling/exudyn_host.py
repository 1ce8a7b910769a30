"""Exudyn systems as hosts: ports at markers, and a host that Exudyn's own solvers step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.arguments import ShortRepr, finite_number
from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError
from exunet.bodies.port import PER_FRAME, FrameOf, FrameState, frames_of, quaternion_of_matrix
from exunet.coupling.host import Host, grouped_by_owner
from exunet.coupling.net_system import (
    PortLoad,
    port_loops,
    validate_ports,
    validate_same_start,
    validated_number,
)
from exunet.integrators.exudyn.engine import exudyn, exudyn_items
from exunet.integrators.exudyn.model import Model
from exunet.model.system import System
from exunet.scene.casefile import Case, case_of
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare_case

# Methods whose runs depend on coordinates, velocities, data and time only, which the engine gives and sets.
EXPLICIT = ("ExplicitMidpoint", "RK33", "RK44", "RK67")
IMPLICIT = ("GeneralizedAlpha", "TrapezoidalIndex2")  # a run begins with new accelerations
SAME_TIME = 1e-9  # [s], or relative to the time: the engine's times are sums of steps
_WHO = "ExudynHost"
_PARTS = ("ODE2", "ODE2_t", "ODE1", "AE", "data")  # of the engine's list
_counted = count(1)


def validate_system(who: str, mbs: Any) -> None:
    """Raise InputError for another object than a system of Exudyn."""
    if not hasattr(mbs, "systemData"):
        raise InputError(f"{who}: mbs: must be a system of Exudyn, got {type(mbs).__name__}")


class MarkedPorts:
    """Ports at markers of an Exudyn system: states of their frames, and a force and a torque at each.

    markers : number of a marker with position and attitude, by the name of the port
    Raises InputError for another kind of marker; the system is unchanged until `add_loads`.
    """

    def __init__(self, mbs: Any, markers: Mapping[str, int]) -> None:
        validate_system(_WHO, mbs)
        names = tuple(markers) if isinstance(markers, Mapping) else ()
        validate_ports(_WHO, markers, names, "the number of a marker")
        self._mbs = mbs
        self._markers = {name: self._validated(name, number) for name, number in markers.items()}
        self._loads: dict[str, tuple[str, str]] = {}  # the user may delete items, which renumbers others
        self._acts: list[list[float]] = []  # force and torque of each port
        what, kinds = exudyn(quiet=False).OutputVariableType, exudyn(quiet=False).ConfigurationType
        self._outputs = what.Position, what.Velocity, what.RotationMatrix, what.AngularVelocityLocal
        self._current, self._output = kinds.Current, mbs.GetMarkerOutput
        self._values = np.empty((len(markers), 18))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the ports."""
        return tuple(self._markers)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """Return groups of ports at markers of one body, or one node."""
        return grouped_by_owner({name: self._owner(marker) for name, marker in self._markers.items()})

    def _owner(self, marker: int) -> tuple[str, int]:
        """Return the engine's key and number of the item that a marker is on."""
        item = self._mbs.GetMarker(marker)
        key = next((key for key in ("bodyNumber", "nodeNumber") if key in item), "")
        return (key, int(item[key])) if key else ("marker", marker)

    def add_loads(self) -> None:
        """Add a force and a torque of zero at each marker, and assemble the system."""
        items, own = exudyn_items(), next(_counted)
        for port, marker in self._markers.items():
            force, torque = (f"exunet {own}: {what} of {port}" for what in ("force", "torque"))
            for name, kind in {force: items.LoadForceVector, torque: items.LoadTorqueVector}.items():
                acting = partial(self._acting, len(self._acts))
                self._acts.append([0.0, 0.0, 0.0])
                self._mbs.AddLoad(kind(name=name, markerNumber=marker, loadVectorUserFunction=acting))
            self._loads[port] = force, torque
        self._mbs.Assemble()

    def _acting(self, number: int, _: Any, __: float, ___: list[float]) -> list[float]:
        """User function of a load."""
        return self._acts[number]

    def apply(self, wrenches: Floats) -> None:
        """Apply forces [N] and torques [N m], six numbers a port, from now on."""
        self._acts = wrenches.reshape(-1, 3).tolist()

    def look_up(self) -> None:
        """Look up the markers' numbers; raises InputError for a deleted load or marker of the coupling."""
        for port, names in self._loads.items():
            force, torque = (int(self._mbs.GetLoadNumber(name)) for name in names)
            marker = -1
            if force >= 0 and torque >= 0:
                marker = int(self._mbs.GetLoadParameter(force, "markerNumber"))
            if marker < 0:
                what = "a load that the coupling has added" if min(force, torque) < 0 else "its marker"
                raise InputError(f"{_WHO}: port {port}: {what} was deleted: make a new coupling")
            self._markers[port] = marker

    def _validated(self, name: str, given: int) -> int:
        number = validated_number(_WHO, name, "marker", given, self._mbs.systemData.NumberOfMarkers())
        kind = str(self._mbs.GetMarker(number)["markerType"])
        if "Rigid" not in kind:
            raise InputError(
                f"{_WHO}: port {name}: marker {number} ({kind}) does not have an attitude: use a marker "
                "of a rigid frame such as MarkerBodyRigid"
            )
        return number

    def now(self) -> Floats:
        """(n, 13) present states of the markers' frames."""
        output, (place, speed, turn, spin) = self._output, self._outputs
        for row, (name, marker) in zip(self._values, self._markers.items(), strict=True):
            try:
                row[:3] = output(marker, place, self._current)
                row[3:6] = output(marker, speed, self._current)
                row[6:15] = output(marker, turn, self._current)
                row[15:] = output(marker, spin, self._current)
            except Exception as error:
                words = f"marker {marker} cannot be read: {str(error).strip().partition(chr(10))[0]}"
                if self._owner(marker)[1] < 0:
                    words = f"the body of its marker {marker} was deleted: make a new coupling"
                raise InputError(f"{_WHO}: port {name}: {words}") from error
        frames = np.empty((len(self._markers), PER_FRAME))
        if (wrong := port_loops().read_markers(self._values, frames)) >= 0:
            name, marker = list(self._markers.items())[wrong]
            raise InputError(
                f"{_WHO}: port {name}: marker {marker} contains NaN or infinity: the host diverged"
            )
        return frames


class ExudynHost(Host):
    """Exudyn system that Exudyn's solvers step, as a host of `Coupler`, also with repeats.

        host = exunet.ExudynHost(mbs, {"chaser": marker}, step=1e-3)
        coupler = exunet.Coupler(net, host, step=0.01, iterations=20)

    Parameters
    ----------
    mbs : exudyn.MainSystem
        User's system. A force and a torque are added at each marker, and the system is assembled.
    ports : mapping of str to int
        Number of a marker with position and attitude (MarkerBodyRigid, MarkerNodeRigid, ...) for each port.
        The body's mass must include the nodes that are fixed to the port (`NetSystem.carried_mass`).
    step : float
        The host's own largest step [s].
    method : str
        "RK44", "RK33", "RK67" or "ExplicitMidpoint"; with constraints "GeneralizedAlpha" or
        "TrapezoidalIndex2".
    settings : exudyn.SimulationSettings, optional
        Tolerances, linear solver and output of the runs; the times, and the number of steps, are replaced.

    Raises
    ------
    InputError
        For invalid arguments; the system is then unchanged.

    Notes
    -----
    Each macro step is a run of the solver, at whose start it computes accelerations with the force of that
    step. So implicit methods apply the whole impulse in its step, and each run depends on the state only. A
    pre-step function of the user must depend on state and time only where steps are repeated.
    """

    def __init__(
        self, mbs: Any, ports: Mapping[str, int], *, step: float, method: str = "RK44", settings: Any = None
    ) -> None:
        self._ports = MarkedPorts(mbs, ports)
        if method not in EXPLICIT + IMPLICIT:
            known = ", ".join(EXPLICIT + IMPLICIT)
            raise InputError(f"ExudynHost: method: {method!r} does not restart from a state: use {known}")
        number = finite_number(step)
        if number is None or not number > 0.0:
            raise InputError(f"ExudynHost: step must be positive and finite, got {step!r}")
        self._mbs, self._step, engine = mbs, number, exudyn(quiet=False)
        if settings is not None and not isinstance(settings, engine.SimulationSettings):
            raise InputError(f"ExudynHost: settings: must be exudyn.SimulationSettings, got {settings!r}")
        self._ports.add_loads()
        if settings is None:
            settings = engine.SimulationSettings()
            settings.solution.file.write = False
            settings.timeIntegration.verboseMode = 0
            settings.timeIntegration.explicit.useLieGroupIntegration = True
        self._settings, self._method = settings, getattr(engine.DynamicSolverType, method)
        self._time = 0.0
        start = mbs.systemData.GetSystemState(engine.ConfigurationType.Initial)
        mbs.systemData.SetSystemState(start, engine.ConfigurationType.Current)

    @property
    def time(self) -> float:
        return self._time

    def frames(self) -> dict[str, FrameState]:
        self._ports.look_up()
        return frames_of(self._ports.names, self._ports.now())

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        self._ports.look_up()
        self._ports.apply(np.array([[*loads[name].force, *loads[name].torque] for name in self._ports.names]))
        integration = self._settings.timeIntegration
        integration.startTime, integration.endTime = self._time, until
        integration.numberOfSteps = max(1, math.ceil((until - self._time) / self._step * (1.0 - 1e-9)))
        self._mbs.SolveDynamic(self._settings, solverType=self._method, updateInitialValues=True)
        self._time = float(self._mbs.systemData.GetTime())
        if abs(self._time - until) > SAME_TIME * max(1.0, until):
            raise InputError(
                f"ExudynHost: the run to t = {until:.6g} s ended at {self._time:.6g} s: a pre-step function "
                "of the system has ended it"
            )
        self._time = until

    def snapshot(self) -> dict[str, Floats]:
        state = self._mbs.systemData.GetSystemState()
        parts = {name: np.array(part, dtype=float) for name, part in zip(_PARTS, state, strict=True)}
        return {"time": np.array([self._time]), **parts}

    def restore(self, snapshot: Any) -> None:
        own = {name: part.shape for name, part in self.snapshot().items()}
        if not isinstance(snapshot, Mapping) or own != {name: np.shape(v) for name, v in snapshot.items()}:
            raise InputError("ExudynHost: restore: the state is not of this system: it has other coordinates")
        kinds, data = exudyn(quiet=False).ConfigurationType, self._mbs.systemData
        self._time = float(snapshot["time"][0])
        for kind in (kinds.Initial, kinds.Current):
            data.SetSystemState([snapshot[name] for name in _PARTS], kind)
            data.SetTime(self._time, kind)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        return self._ports.shared()


@dataclass(frozen=True, eq=False, repr=False)
class NativeItems(ShortRepr):
    """Numbers of the items that `add_to` has added to a system.

    nodes      : (n_nodes,) of the nodes of the net; -1 for those that are fixed to bodies
    connectors : (n_elements,) of the objects of the elements
    bodies     : of the objects of the case's free bodies, by name
    items      : number of objects of each kind
    """

    nodes: Ints
    connectors: Ints
    bodies: Mapping[str, int]
    items: Mapping[str, int]


def add_to(
    mbs: Any, case: str | Path | Case | Scene, ports: Mapping[str, int], overrides: Sequence[str] = ()
) -> NativeItems:
    """Add a net to an Exudyn system: mass points and connectors, as in exunet's own model.

        items = exunet.add_to(mbs, "net.toml", {"chaser": body})
        mbs.Assemble()
        mbs.SolveDynamic(settings)

    Parameters
    ----------
    mbs : exudyn.MainSystem
        User's system that can be assembled; the user assembles and solves it with the added items.
    case : str, Path, Case or Scene
        Name of a case file, the result of `exunet.load`, or a scene.
    ports : mapping of str to int
        Number of the object for each body of motion = "port"; its frame is that of the case, so that an
        attached node is a point of it. Its mass must include the nodes that are fixed to it.

    Raises
    ------
    CaseError
        For a case that cannot be simulated.
    InputError
        For missing or unknown ports, for objects that are not rigid bodies or do not start where the ports
        do, and for effects without items of Exudyn: all except gravity, linear orbits and dampings, also
        events (breaks, reels, ejections), an ejection from a port, and bodies of prescribed motion.

    Notes
    -----
    Step, accuracy and the check of the result are the user's: exunet's guards do not check it.
    """
    validate_system("add_to", mbs)
    start = prepare_case(case_of(case, "add_to", overrides), hosted=True)
    _validate_effects(start)
    hosts = _objects_of(mbs, start.system, ports)
    _validate_same_start(mbs, start, hosts)
    model = Model(mbs)
    free = np.flatnonzero(start.system.moves_freely).tolist()
    own = {k: model.rigid_body(start.system.bodies[k], start.state.bodies[k]) for k in free}
    _add_points(model, start, hosts | own)
    connectors = _add_elements(model, start.system)
    linear = start.system.forces.linear
    if linear is not None:
        model.linear_terms(linear.on_velocity, linear.stiffness, linear.load)
    nodes = np.array(model.nodes[: start.net.n_nodes], dtype=np.int64)
    rigid = start.system.blocks.rigid
    return NativeItems(nodes, connectors, {rigid[k]: number for k, number in own.items()}, model.items())


def _validate_effects(start: Start) -> None:
    """Raise InputError for effects without items of the engine."""
    system, words = start.system, []
    forces, kinematics = system.forces, system.kinematics
    prescribed = range(kinematics.n_free, len(system.bodies))
    moved = [system.blocks.rigid[k] for k in prescribed if k not in kinematics.ports]
    if moved:
        words.append(f"bodies that are fixed or prescribed ({', '.join(moved)})")
    if forces.switches or kinematics.held:
        words.append("events: breaks, reels, ejections, thrusts, corner units")
    throw = system.ejection
    if throw is not None and throw.body in kinematics.ports:
        carrier = system.blocks.rigid[throw.body]
        words.append(
            f"the recoil of an ejection from port {carrier} (initial.frame.body), which is the host's"
        )
    if forces.kernels:
        words.append(f"a nonlinear force (effects on: {', '.join(start.scene.effects.on)})")
    if forces.linear is not None and _couples_attached(system):
        words.append("a damping or an orbit that couples nodes fixed to bodies with others")
    if words:
        raise InputError(f"add_to: there are no items of Exudyn for {'; '.join(words)}: use exunet.Coupler")


def _couples_attached(system: System) -> bool:
    """Return True if a constant matrix has entries between attached nodes and free ones."""
    linear, columns = system.forces.linear, np.repeat(~system.free, 3)
    matrices = (linear.damping, linear.gyroscopic, linear.stiffness) if linear is not None else ()
    attached = np.zeros_like(columns)
    attached[(3 * system.kinematics.point[:, None] + np.arange(3)).ravel()] = True
    return any(abs(matrix[:, attached]).sum() > 0.0 for matrix in matrices if matrix is not None)


def _objects_of(mbs: Any, system: System, ports: Mapping[str, int]) -> dict[int, int]:
    """Return the number of the user's object by that of the body."""
    known = {system.blocks.rigid[k]: k for k in system.kinematics.ports}
    validate_ports("add_to", ports, tuple(known), "the number of an object")
    count = mbs.systemData.NumberOfObjects()
    return {known[name]: validated_number("add_to", name, "object", k, count) for name, k in ports.items()}


def _validate_same_start(mbs: Any, start: Start, objects: Mapping[int, int]) -> None:
    """Raise InputError unless the user's bodies are rigid and start where the ports do."""
    engine, rigid = exudyn(quiet=False), start.system.blocks.rigid
    what, initial = engine.OutputVariableType, engine.ConfigurationType.Initial
    read = (what.Position, what.Velocity, what.RotationMatrix, what.AngularVelocityLocal)
    mbs.Assemble()
    for number, k in objects.items():
        kind = str(mbs.GetObject(k)["objectType"])
        if "RigidBody" not in kind:
            raise InputError(
                f"add_to: port {rigid[number]}: object {k} ({kind}) does not have a frame: use a rigid body"
            )
        output = [mbs.GetObjectOutputBody(k, item, [0.0] * 3, initial) for item in read]
        place, speed, turn, spin = (np.asarray(entry, dtype=float).ravel().tolist() for entry in output)
        host = FrameState(tuple(place), tuple(speed), quaternion_of_matrix(turn), tuple(spin))
        port = FrameOf.body(start.system.bodies[number]).frame_in(start.state.bodies, number)
        validate_same_start("add_to", rigid[number], port, host, start.net.size)


def _add_points(model: Model, start: Start, objects: Mapping[int, int]) -> None:
    system, kinematics = start.system, start.system.kinematics
    on = dict(zip(kinematics.point.tolist(), range(len(kinematics.point)), strict=True))
    for k in range(system.blocks.n_points):
        place, speed = start.position[k], start.velocity[k]
        if k in on:
            number, arm = int(kinematics.body[on[k]]), kinematics.arm[on[k]]
            body = system.bodies[number]
            # The case's own bodies are in their principal axes, the user's in the frame of the case.
            local = body.rotation @ arm + body.centre if number in kinematics.ports else arm
            model.point_of_body(objects[number], np.asarray(local), place)
        elif system.free[k]:
            model.point(system.mass[k], system.blocks.position[k], place, speed)
        else:
            model.fixed_point(place)


def _add_elements(model: Model, system: System) -> Ints:
    law = system.forces.cable.law
    times = law.relaxation_time if law.relaxation_time is not None else [None] * system.net.n_elements
    numbers = [
        model.cable_element(e, i, j, law.natural_length[e], law.stiffness[e], times[e])
        for e, (i, j) in enumerate(system.net.element_nodes.tolist())
    ]
    return np.array(numbers, dtype=np.int64)

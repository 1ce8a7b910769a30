"""The net as items of a user's own Exudyn system, for one solver over all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.base.files import path_of
from exunet.base.short_repr import ShortRepr
from exunet.bodies.port import FrameOf, FrameState, PrincipalState, quaternion_of_matrix
from exunet.coupling.exudyn_host import validate_system
from exunet.coupling.ports import validate_ports, validate_same_start, validated_number
from exunet.forces.effects import switched_on
from exunet.integrators.exudyn.engine import exudyn
from exunet.integrators.exudyn.model import Model
from exunet.model.system import System
from exunet.scene.casefile import Case, load
from exunet.simulation.preparation import Start, prepare_case

Ints = NDArray[np.int64]


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
    mbs: Any, case: str | Path | Case, ports: Mapping[str, int], overrides: Sequence[str] = ()
) -> NativeItems:
    """Add a net to an Exudyn system: mass points and connectors, as in exunet's own model.

        items = exunet.add_to(mbs, "net.toml", {"chaser": body})
        mbs.Assemble()
        mbs.SolveDynamic(settings)

    Parameters
    ----------
    mbs : exudyn.MainSystem
        User's system that can be assembled; the user assembles and solves it with the added items.
    case : str, Path or Case
        Name of a case file, or the result of `exunet.load`.
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
    found = case if isinstance(case, Case) else load(path_of(case, "add_to"), overrides)
    start = prepare_case(found, hosted=True)
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
    guided = range(kinematics.n_free, len(system.bodies))
    moved = [system.blocks.rigid[k] for k in guided if k not in kinematics.ports]
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
        words.append(f"a nonlinear force (effects on: {', '.join(switched_on(start.scene.effects))})")
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
        parts = (tuple(part[number].tolist()) for part in start.state.bodies.parts())
        port = FrameOf.body(start.system.bodies[number]).frame(PrincipalState(*parts))
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

"""Build the model of a scene and its initial state: net, bodies, degrees of freedom, forces."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import LARGEST, CaseError, Fault
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.touched import surface_of, surface_of_mesh
from exunet.forces import corner_units
from exunet.forces.blocks import Blocks, Inertia, Poses, Speeds
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.closing import Drawstring, way_of
from exunet.forces.closing import states_of as states_of_line
from exunet.forces.cores import Surface
from exunet.forces.effects import (
    breaking_limits,
    first_order_states,
    forces_of,
    from_outside,
    largest_touching_radius,
    point_masses,
    thrust,
    touched_bodies,
)
from exunet.forces.from_outside import FIXED_NODES, with_reactions
from exunet.forces.from_outside import states_of as impulses_of
from exunet.forces.perimeter import Shortening
from exunet.forces.perimeter import states_of as states_of_perimeter
from exunet.forces.reel import Winding, reel_term, states_of
from exunet.forces.terms import KernelTerm, Memories
from exunet.methods.method import METHODS, Kind
from exunet.model.bodies import BodiesAtStart, bodies_at_start
from exunet.model.drum import Drum
from exunet.model.ejection import eject_at_start, ejecting, holding, in_frame, net_axes, with_energy
from exunet.model.initial import (
    Restart,
    along_tethers,
    beyond_shortest,
    common_velocity,
    kicks,
    packed_state,
)
from exunet.model.mesh_core import core_of_mesh
from exunet.model.script import script_of, with_inputs
from exunet.model.system import Layout, State, System
from exunet.net import weave
from exunet.net.arrays import Net
from exunet.net.closing import NAME as CLOSING
from exunet.net.closing import ClosingLine, Perimeter, closing_of, with_mass_of
from exunet.net.reel import Reel
from exunet.net.tether import reels_of, with_tethers
from exunet.scene.scene import Scene
from exunet.scene.script import begins_a_thrust, begins_control, ejects, released

Floats = NDArray[np.float64]


def system_of(scene: Scene, faults: list[Fault], restart: Restart | None = None) -> tuple[System, State]:
    """Build the system of a scene and its state at t = 0.

    Parameters
    ----------
    scene : Scene
        Net, tethers, bodies, closing, effects and script of a case.
    faults : list of Fault
        Receives faults of bodies and effects that do not prevent the build.
    restart : Restart, optional
        State of another run, in which the case starts.

    Returns
    -------
    System, State

    Raises
    ------
    CaseError
        For a scene without a net, or a start that is not valid.
    """
    woven = weave(scene.net)
    net, tied = with_tethers(woven, scene.tethers)
    if restart is not None:
        checks = restart.faults_of_net(net), restart.faults_of_bodies(scene), restart.faults_of_reels(scene)
        if differences := [fault for check in checks for fault in check]:
            raise CaseError(differences)
        scene = restart.with_wound_up(scene)
    net = _with_strength(net, scene)
    closing = None if scene.closing is None else closing_of(net, scene.closing)
    line = closing if isinstance(closing, ClosingLine) else None
    net = net if line is None else with_mass_of(net, line)
    line = line if line is None or restart is None else _wound_up(line, restart.wound(CLOSING))
    reels = reels_of(net, scene.tethers)
    releases = dict.fromkeys(released(scene.script), False) | (
        {} if restart is None else dict(restart.releases)
    )
    rigid = bodies_at_start(scene, net, tied, reels, faults, restart, releases)
    axes = net_axes(scene.initial.frame, rigid)
    packed, speed = packed_state(scene, woven) if restart is None else restart.nodes(slice(woven.n_nodes))
    position, velocity, added = packed, speed, kicks(scene, woven)
    if axes.body is not None:  # which gives the net all that it gets beside its own motion
        (position, velocity), added = in_frame(axes, rigid, net, packed), speed + added
    later = scene.initial.frame.eject_at if scene.initial.frame is not None else 0.0
    later = math.inf if ejects(scene.script) else later
    if later > 0.0:
        rigid = holding(axes, rigid, net, position)
    room = np.zeros((net.n_nodes - woven.n_nodes, 3))
    others = (room, room) if restart is None else restart.nodes(slice(woven.n_nodes, None))
    position, velocity = (np.concatenate(pair) for pair in zip((position, velocity), others, strict=True))
    kinematics, begin = rigid.kinematics, np.array(0.0)
    position, velocity, _ = kinematics.completed(begin, position, velocity, rigid.states, {})
    misplaced = (
        along_tethers(net, reels, position, velocity)
        if restart is None
        else restart.faults_of_places(position)
    )
    faults += misplaced
    ejection, before, held = None, velocity, rigid
    if later == 0.0:  # inner nodes of tethers stay as they are
        gained, rigid, ejection = eject_at_start(axes, held, net, position, added)
        velocity = np.concatenate([velocity[: woven.n_nodes] + gained, velocity[woven.n_nodes :]])
    position, velocity, _ = kinematics.completed(begin, position, velocity, rigid.states, {})
    ejection = with_energy(ejection, held, rigid, net, position, (before, velocity))
    names = tuple(body.name for body in rigid.bodies)
    of_reels = (state for reel in reels for state in states_of(reel))
    lines = _with_lines(scene, net)
    given = (state for name in lines for state in impulses_of(name))
    of_line = () if line is None else states_of_line(line, position, *_stress_of_line(scene, line))
    of_line = states_of_perimeter(closing) if isinstance(closing, Perimeter) else of_line
    of_units = () if scene.control is None else corner_units.states_of(scene.control)
    states = (*rigid.given, *of_reels, *of_line, *first_order_states(scene.effects), *of_units, *given)
    states = states if restart is None else tuple(restart.continued(state) for state in states)
    inertia = Inertia(*rigid.free_inertia, rigid.kinematics.point)
    poses = Poses(rigid.states.position, rotation_matrix(rigid.states.attitude), axes.turn)
    blocks = Blocks.of(net, position, point_masses(scene.effects), names, states, inertia, poses)
    surfaces = _surfaces(scene, net, rigid, reels)
    carrier = "" if axes.body is None else names[axes.body]
    places = blocks.position[net.n_nodes :]
    velocity = np.concatenate([velocity, common_velocity(scene.initial, places)])
    moving = velocity.copy()
    if later > 0.0:
        moving[: len(added)] += added @ axes.turn.T
    speeds = Speeds(moving, rigid.states.velocity, rigid.states.angular_velocity)
    blocks = replace(blocks, surfaces=surfaces, carrier=carrier, speeds=speeds)
    words = "an effect brings a point mass of this name (launch_force: chaser): name the body otherwise"
    faults += [Fault(f"bodies.{name}", words) for name in scene.bodies if name in blocks.body]
    constraint = kinematics.term(blocks)
    if later > 0.0:
        constraint = ejecting(constraint, later, axes, rigid, blocks, added)
    if FIXED_NODES in lines:
        constraint = with_reactions(constraint, blocks)
    forces = replace(forces_of(scene.effects, blocks, faults), constraint=constraint)
    if reels:
        windings = tuple(Winding(reel, blocks, forces.cable.law) for reel in reels)
        terms = (reel_term(winding, Drum(winding, kinematics)) for winding in windings)
        cable = replace(forces.cable, reels=windings)
        forces = replace(forces, cable=cable, kernels=(*forces.kernels, *terms))
    if begins_a_thrust(scene.script):
        kernels = (thrust.waiting(term) if _is_thrust(term) else term for term in forces.kernels)
        forces = replace(forces, kernels=tuple(kernels))
    if any(entry.do == "cut" for entry in scene.script):
        forces = replace(forces, cable=replace(forces.cable, may_be_cut=True))
    if restart is not None:
        forces = replace(forces, cable=replace(forces.cable, broken=restart.broken))
    if isinstance(closing, Perimeter):
        shortening = Shortening(closing, blocks, forces.cable.law)
        cable = replace(forces.cable, shortening=shortening)
        forces = replace(forces, cable=cable, kernels=(*forces.kernels, shortening.term()))
    if line is not None:
        drawn = _drawn(line, blocks, scene, faults)
        forces = replace(forces, kernels=(*forces.kernels, *drawn))
    units = _units(scene, blocks, rigid, corner_units.NAME in lines)
    forces = replace(forces, kernels=(*forces.kernels, *units))
    forces = with_inputs(forces, scene.script)
    system = System(blocks, forces, rigid.bodies, kinematics, ejection, line)
    if scene.script:
        target = None if scene.capture is None else scene.capture.target
        script = script_of(scene.script, system, target)
        system = replace(system, forces=replace(forces, script=script))
    memory = dict(system.memory)
    return system, State(0.0, blocks.position, velocity, rigid.states, memory, blocks.initial_states)


def _is_thrust(term: KernelTerm) -> bool:
    return term.memory is not None and term.memory.name == thrust.MEMORY


def _free_ratio(scene: Scene) -> float:
    """Return the stress-free length of a cable over that in the reference configuration."""
    warm = getattr(scene.effects, "thermal_strain", None)
    return 1.0 if warm is None else float(np.sqrt(1.0 + 2.0 * warm.free_strain))


def _stress_of_line(scene: Scene, line: ClosingLine) -> tuple[float, float]:
    """Return `Drawstring.ratio` and `time` of a closing line, as of all cables."""
    damped = getattr(scene.effects, "material_damping", None)
    rubs = line.friction > 0.0
    return _free_ratio(scene), 0.0 if damped is None or rubs else float(damped.relaxation_time)


def _wound_up(line: ClosingLine, wound: float) -> ClosingLine:
    """Return a closing line with a length wound up in the state that a case starts from [m]."""
    if wound >= line.length:
        words = f"must be greater than the {wound:.6g} m wound up in the state of initial.restart"
        raise CaseError([Fault("closing.length", words)])
    if beyond_shortest(line.length - wound, line.shortest):
        words = f"is above the {line.length - wound:.6g} m outside in the state of initial.restart: reduce it"
        raise CaseError([Fault("closing.winch.shortest", words)])
    return replace(line, wound=wound)


def _too_short(line: ClosingLine, path: float, ratio: float) -> str:
    """Describe a closing line that is too short for its path through the rings [m]."""
    stretch = path / (ratio * line.length_at_start)
    words = f"its path through the rings of {path:.6g} m at the start requires a stretch of {stretch:.4g}"
    words += f" ({line.wound:.6g} m are wound up)" if line.wound > 0.0 else ""
    return f"{words}, above {STRETCH_BOUND:g}, the limit of the cable law: use a longer line"


def _drawn(line: ClosingLine, blocks: Blocks, scene: Scene, faults: list[Fault]) -> tuple[KernelTerm, ...]:
    """Return the term of the closing line, with free strain and viscous stress as of all cables.

    Empty for numbers outside the range of floating point, with a fault.
    """
    ratio, time = _stress_of_line(scene, line)
    path = float(way_of(line, blocks.position).sum())
    if not path <= STRETCH_BOUND * ratio * line.length_at_start:
        faults.append(Fault("closing.length", _too_short(line, path, ratio)))
    drawstring = Drawstring(line, blocks, ratio, time)
    if not max(drawstring.rates) <= LARGEST:
        words = "leads to numbers outside the range of floating-point: use realistic values"
        faults.append(Fault("closing", words, beyond_floats=True))
        return ()
    return (drawstring.term(),)


def _units(scene: Scene, blocks: Blocks, rigid: BodiesAtStart, counted: bool) -> tuple[KernelTerm, ...]:
    """Return the term of the corner units; counted : integrate their impulses."""
    if scene.control is None:
        return ()
    layout, kinematics = Layout(blocks), rigid.kinematics

    def completed(time: float, x: Floats, v: Floats, memory: Memories) -> tuple[Floats, Floats]:
        if not kinematics:
            return x, v
        return layout.pack(layout.unpack(x, v).completed(kinematics, time, memory))

    waits = begins_control(scene.script)
    return (corner_units.term_of(scene.control, blocks, completed, waits=waits, counted=counted),)


def _surfaces(scene: Scene, net: Net, rigid: BodiesAtStart, reels: tuple[Reel, ...]) -> dict[str, Surface]:
    """Return the surfaces of the bodies in contact."""
    named = touched_bodies(scene.effects)
    reach = largest_touching_radius(scene.effects, net)
    surfaces = {}
    for number, body in enumerate(rigid.bodies):
        if body.name not in named:
            continue
        attached = rigid.kinematics.tied[rigid.kinematics.tied_to == number]
        wound = tuple(reel.elements for reel in reels if reel.body == body.name)
        surface = surface_of(body, attached, wound)
        if body.shape is not None and body.shape.mesh is not None and body.shape.edge_radius > 0.0:
            core = core_of_mesh(body.name, body.shape, reach)
            surface = surface_of_mesh(body, core, attached, wound)
        if surface is not None:
            surfaces[body.name] = surface
    return surfaces


def _with_lines(scene: Scene, net: Net) -> tuple[str, ...]:
    """Return the sources of external impulses that are integrated: effects, corner units, fixed nodes.

    In scenes with bodies, by explicit methods, which have first-order states.
    """
    method = scene.solver.method
    implicit = method != "auto" and METHODS[method].kind == Kind.IMPLICIT
    if not scene.bodies or implicit:
        return ()
    units = () if scene.control is None else (corner_units.NAME,)
    return (*from_outside(scene.effects), *units, *((FIXED_NODES,) if len(net.fixed_nodes) else ()))


def _with_strength(net: Net, scene: Scene) -> Net:
    """Return the net with the breaking forces of its elements, where the case does not give a strength."""
    limits = breaking_limits(scene.effects, net)
    if limits is None:
        return net
    strength = limits if net.strength is None else np.where(net.strength > 0.0, net.strength, limits)
    strength.flags.writeable = False
    return replace(net, strength=strength)

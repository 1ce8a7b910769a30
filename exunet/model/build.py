"""Build the model of a scene and its initial state: net, bodies, degrees of freedom, forces.

The stages: threads, bodies, places at time 0, numbering of the degrees of freedom, forces of the effects,
components. A new effect is a file of `exunet.forces.effects`; another part of a scene is a component of
`exunet.model.components`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import CaseError, Fault
from exunet.bodies.mesh_core import core_of_mesh
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.touched import surface_of, surface_of_mesh
from exunet.forces import corner_units
from exunet.forces.blocks import Blocks, FirstOrder, Inertia, Poses, Speeds
from exunet.forces.cores import Surface
from exunet.forces.effects import forces_of
from exunet.forces.from_outside import FIXED_NODES, with_reactions
from exunet.forces.from_outside import states_of as impulses_of
from exunet.methods.method import METHODS, Kind
from exunet.model.components import (
    BodyThrusts,
    Component,
    CornerUnits,
    DrawnLine,
    Reels,
    ScriptedForces,
    ShorterEdge,
)
from exunet.model.ejection import (
    NetAxes,
    eject_at_start,
    ejecting,
    holding,
    in_frame,
    net_axes,
    with_energy,
)
from exunet.model.initial import (
    BodiesAtStart,
    Restart,
    along_tethers,
    bodies_at_start,
    kicks,
    packed_state,
)
from exunet.model.script import script_of
from exunet.model.system import InitialEjection, State, System
from exunet.net import weave
from exunet.net.arrays import Net
from exunet.net.closing import LineThroughRings, ShortenedEdge, closing_of, with_mass_of
from exunet.net.tether import ReeledTether, TiedPoint, reels_of, with_tethers
from exunet.scene.scene import Scene
from exunet.scene.script import ejects, released, thrust_bodies


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
    threads = threads_of(scene, restart)
    scene = scene if restart is None else restart.with_wound_up(scene)
    rigid = _bodies(scene, threads, faults, restart)
    start = places_at_start(scene, threads, rigid, faults, restart)
    components = components_of(scene, threads, start)
    blocks = _blocks(scene, threads, start, components, restart)
    constraint = start.rigid.kinematics.term(blocks)
    if start.eject_at > 0.0:
        constraint = ejecting(constraint, start.eject_at, start.axes, start.rigid, blocks, start.added)
    if FIXED_NODES in _outside(scene, blocks.net):
        constraint = with_reactions(constraint, blocks)
    forces = replace(forces_of(scene.effects, blocks, faults), constraint=constraint)
    if restart is not None:
        forces = replace(forces, cable=replace(forces.cable, broken=restart.broken))
    for component in components:
        forces = component.add(forces, blocks, faults)
    bodies = start.rigid
    system = System(blocks, forces, bodies.bodies, bodies.kinematics, start.ejection, threads.line)
    if scene.script:
        target = None if scene.capture is None else scene.capture.target
        script = script_of(scene.script, system, target)
        system = replace(system, forces=replace(forces, script=script))
    discrete = dict(system.discrete)
    return system, State(0.0, start.position, start.velocity, bodies.states, discrete, blocks.initial_states)


@dataclass(frozen=True, eq=False)
class Threads:
    """Threads of a scene.

    woven   : net without tethers
    net     : net with tethers, the mass of the closing line and the strength of its elements
    tied    : ends of tethers on bodies
    reels   : reels of tethers
    closing : closing line or shortened edge
    """

    woven: Net
    net: Net
    tied: tuple[TiedPoint, ...]
    reels: tuple[ReeledTether, ...]
    closing: LineThroughRings | ShortenedEdge | None

    @property
    def line(self) -> LineThroughRings | None:
        """Closing line, if any."""
        return self.closing if isinstance(self.closing, LineThroughRings) else None


def threads_of(scene: Scene, restart: Restart | None = None) -> Threads:
    """Weave the net, add tethers and the closing; raise CaseError if a restart does not fit."""
    woven = weave(scene.net)
    net, tied = with_tethers(woven, scene.tethers)
    if restart is not None:
        checks = restart.faults_of_net(net), restart.faults_of_bodies(scene), restart.faults_of_reels(scene)
        if differences := [fault for check in checks for fault in check]:
            raise CaseError(differences)
        scene = restart.with_wound_up(scene)
    net = _with_strength(net, scene)
    closing = None if scene.closing is None else closing_of(net, scene.closing)
    if isinstance(closing, LineThroughRings):
        net = with_mass_of(net, closing)
        closing = closing if restart is None else restart.with_wound_line(closing)
    return Threads(woven, net, tied, reels_of(net, scene.tethers), closing)


def _with_strength(net: Net, scene: Scene) -> Net:
    """Return the net with the breaking forces of its elements, where the case does not give a strength."""
    for effect in scene.effects.on.values():
        limits = effect.breaking_limits(net, scene.effects.free_strain)
        if limits is not None:
            strength = limits if net.strength is None else np.where(net.strength > 0.0, net.strength, limits)
            strength.flags.writeable = False
            net = replace(net, strength=strength)
    return net


def _bodies(scene: Scene, threads: Threads, faults: list[Fault], restart: Restart | None) -> BodiesAtStart:
    releases = dict.fromkeys(released(scene.script), False)
    releases |= {} if restart is None else dict(restart.releases)
    return bodies_at_start(scene, threads.net, threads.tied, threads.reels, faults, restart, releases)


@dataclass(frozen=True, eq=False)
class AtStart:
    """Net and bodies at time 0, after an ejection at this time.

    axes     : frame in which the net starts
    rigid    : rigid bodies
    position, velocity : (n_nodes, 3) in the scene's axes [m], [m/s]
    added    : (n_woven, 3) velocities added by launch and ejection, in the net's axes [m/s]
    eject_at : time of the ejection [s]; infinite: by the script
    ejection : ejection at time 0
    """

    axes: NetAxes
    rigid: BodiesAtStart
    position: Floats
    velocity: Floats
    added: Floats
    eject_at: float
    ejection: InitialEjection | None


def places_at_start(
    scene: Scene, threads: Threads, rigid: BodiesAtStart, faults: list[Fault], restart: Restart | None
) -> AtStart:
    """Place the nodes of net and tethers, and eject the net if it is ejected at time 0."""
    woven, net, axes = threads.woven, threads.net, net_axes(scene.initial.frame, rigid)
    packed, velocity = packed_state(scene, woven) if restart is None else restart.nodes(slice(woven.n_nodes))
    position, added = packed, kicks(scene, woven)
    if axes.body is not None:  # all velocities beside that of the body are relative to it
        added = velocity + added
        position, velocity = in_frame(axes, rigid, net, packed)
    eject_at = scene.initial.frame.eject_at if scene.initial.frame is not None else 0.0
    eject_at = math.inf if ejects(scene.script) else eject_at
    if eject_at > 0.0:
        rigid = holding(axes, rigid, net, position)
    room = np.zeros((net.n_nodes - woven.n_nodes, 3))
    others = (room, room) if restart is None else restart.nodes(slice(woven.n_nodes, None))
    position, velocity = (np.concatenate(pair) for pair in zip((position, velocity), others, strict=True))
    kinematics, begin = rigid.kinematics, np.array(0.0)
    position, velocity, _ = kinematics.completed(begin, position, velocity, rigid.states, {})
    if restart is None:
        faults += along_tethers(net, threads.reels, position, velocity)
    else:
        faults += restart.faults_of_places(position)
    ejection, before, held = None, velocity, rigid
    if eject_at == 0.0:  # inner nodes of tethers stay as they are
        gained, rigid, ejection = eject_at_start(axes, held, net, position, added)
        velocity = np.concatenate([velocity[: woven.n_nodes] + gained, velocity[woven.n_nodes :]])
    position, velocity, _ = kinematics.completed(begin, position, velocity, rigid.states, {})
    ejection = with_energy(ejection, held, rigid, net, position, (before, velocity))
    return AtStart(axes, rigid, position, velocity, added, eject_at, ejection)


def components_of(scene: Scene, threads: Threads, start: AtStart) -> tuple[Component, ...]:
    """Return the components of a scene, in the order in which a kernel adds their forces."""
    kinematics = start.rigid.kinematics
    found: list[Component] = []
    if threads.reels:
        found.append(Reels(threads.reels, kinematics))
    if isinstance(threads.closing, ShortenedEdge):
        found.append(ShorterEdge(threads.closing))
    if threads.line is not None:
        found.append(DrawnLine.of(threads.line, scene.effects, start.position))
    if scene.control is not None:
        counted = corner_units.NAME in _outside(scene, threads.net)
        found.append(CornerUnits(scene.control, kinematics, scene.script, counted))
    keys = {name: body.thrust for name, body in scene.bodies.items()}
    scripted = frozenset(thrust_bodies(scene.script))
    bodies = start.rigid.bodies
    pushed = tuple(
        item
        for item in bodies
        if item.name in scripted or getattr(keys[item.name], "times", None) is not None
    )
    if pushed:
        found.append(BodyThrusts(pushed, keys, scripted))
    return (*found, ScriptedForces(scene.script))


def _outside(scene: Scene, net: Net) -> tuple[str, ...]:
    """Return the sources of external impulses that are integrated: effects, corner units, fixed nodes.

    In scenes with bodies, by explicit methods, which have first-order states.
    """
    method = scene.solver.method
    implicit = method != "auto" and METHODS[method].kind == Kind.IMPLICIT
    if not scene.bodies or implicit:
        return ()
    units = () if scene.control is None else (corner_units.NAME,)
    outside = (name for name, effect in scene.effects.on.items() if not effect.INTERNAL)
    return (*outside, *units, *((FIXED_NODES,) if len(net.fixed_nodes) else ()))


def _states(
    scene: Scene, threads: Threads, start: AtStart, components: Iterable[Component]
) -> tuple[FirstOrder, ...]:
    """Return the first-order states: bodies, threads, effects, corner units, external impulses."""
    of_threads, of_units = list[FirstOrder](), list[FirstOrder]()
    for component in components:
        (of_units if isinstance(component, CornerUnits) else of_threads).extend(component.states)
    impulses = (state for name in _outside(scene, threads.net) for state in impulses_of(name))
    of_effects = (state for effect in scene.effects.on.values() for state in effect.first_order_states())
    return (*start.rigid.given, *of_threads, *of_effects, *of_units, *impulses)


def _blocks(
    scene: Scene,
    threads: Threads,
    start: AtStart,
    components: Iterable[Component],
    restart: Restart | None,
) -> Blocks:
    """Number the degrees of freedom, with the surfaces and speeds at time 0."""
    rigid, axes, states = start.rigid, start.axes, _states(scene, threads, start, components)
    if restart is not None:
        states = tuple(restart.continued(state) for state in states)
    names = tuple(body.name for body in rigid.bodies)
    inertia = Inertia(*rigid.free_inertia, rigid.kinematics.point)
    poses = Poses(rigid.states.position, rotation_matrix(rigid.states.attitude), axes.turn)
    moving = start.velocity.copy()
    if start.eject_at > 0.0:
        moving[: len(start.added)] += start.added @ axes.turn.T
    return Blocks(
        threads.net,
        start.position,
        names,
        states,
        inertia=inertia,
        poses=poses,
        surfaces=_surfaces(scene, threads, rigid),
        carrier="" if axes.body is None else names[axes.body],
        speeds=Speeds(moving, rigid.states.velocity, rigid.states.angular_velocity),
    )


def _surfaces(scene: Scene, threads: Threads, rigid: BodiesAtStart) -> dict[str, Surface]:
    """Return the surfaces of the bodies in contact."""
    effects = scene.effects.on.values()
    named = frozenset(name for effect in effects for name in effect.touched_bodies())
    reach = max((effect.largest_radius(threads.net) for effect in effects), default=0.0)
    surfaces = {}
    for number, body in enumerate(rigid.bodies):
        if body.name not in named:
            continue
        attached = rigid.kinematics.tied[rigid.kinematics.tied_to == number]
        wound = tuple(reel.elements for reel in threads.reels if reel.body == body.name)
        surface = surface_of(body, attached, wound)
        if body.shape is not None and body.shape.mesh is not None and body.shape.edge_radius > 0.0:
            core = core_of_mesh(body.name, body.shape, reach)
            surface = surface_of_mesh(body, core, attached, wound)
        if surface is not None:
            surfaces[body.name] = surface
    return surfaces

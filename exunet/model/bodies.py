"""Rigid bodies of a scene: mass properties, prescribed motion, and states at time 0."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import CaseError, Fault, joining
from exunet.bodies.config import BodyConfig
from exunet.bodies.guide import Guide
from exunet.bodies.kinematics import Kinematics, given_states
from exunet.bodies.mass_properties import point_mass
from exunet.bodies.overlap import overlap
from exunet.bodies.rigid import RigidBody, RigidStates, make_body
from exunet.bodies.rotations import product, rotation_matrix
from exunet.forces.blocks import FirstOrder
from exunet.forces.effects import touching_pairs
from exunet.forces.on_bodies import Held, tie_name
from exunet.forces.reel import memory_name
from exunet.model.initial import Restart
from exunet.net.arrays import Net
from exunet.net.reel import Reel
from exunet.net.tether import TiedPoint
from exunet.scene.scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_Start = tuple[Floats, Floats, Floats, Floats]


@dataclass(frozen=True, eq=False)
class BodiesAtStart:
    """Rigid bodies of a scene: free bodies first, otherwise in the order of the case.

    given : first-order states of the impulses and work of prescribed bodies
    """

    bodies: tuple[RigidBody, ...] = ()
    states: RigidStates = field(default_factory=RigidStates.none)
    kinematics: Kinematics = field(default_factory=Kinematics)
    given: tuple[FirstOrder, ...] = ()

    @property
    def free_inertia(self) -> tuple[Floats, Floats]:
        """Masses (n,) [kg] and principal moments (n, 3) [kg m2] of the free bodies."""
        free = self.bodies[: self.kinematics.n_free]
        masses = np.array([body.mass for body in free], dtype=float)
        return masses, np.array([body.inertia for body in free], dtype=float).reshape(-1, 3)


def bodies_at_start(
    scene: Scene,
    net: Net,
    tied: tuple[TiedPoint, ...],
    reels: tuple[Reel, ...],
    faults: list[Fault],
    restart: Restart | None = None,
    releases: Mapping[str, bool] | None = None,
) -> BodiesAtStart:
    """Make the rigid bodies of a scene, with the nodes of the net that are attached to them.

    Parameters
    ----------
    scene, net : Scene, Net
        Scene and its net, tethers included.
    tied : tuple of TiedPoint
        Nodes at ends of tethers.
    reels : tuple of Reel
        Reels, whose drums hold nodes of tethers.
    faults : list of Fault
        Receives the faults of overlapping bodies.
    restart : Restart, optional
        State of another run, in which the bodies start.
    releases : mapping of str to bool, optional
        Attachments and ends of tethers that a script releases, by name; True if released already.

    Raises
    ------
    CaseError
        For bodies that are not valid, and attachments to unknown nodes.
    """
    if not scene.bodies:
        return BodiesAtStart()
    bodies: list[RigidBody] = []
    attached, wrong = attached_points(scene, net, tied)
    releases = releases or {}
    as_given = _split(attached, () if restart is None else restart.releases)[0]
    attached, let_go = _split(attached, releases)
    whole_bodies: list[RigidBody] = []
    for name in sorted(scene.bodies, key=lambda name: scene.bodies[name].motion != "free"):
        with joining(wrong):
            keys = scene.bodies[name]
            bodies.append(_loaded(name, keys, net, attached[name]))
            same = len(as_given[name]) == len(attached[name])
            whole_bodies.append(bodies[-1] if same else _loaded(name, keys, net, as_given[name]))
    if restart is not None:
        wrong += [fault for body in whole_bodies for fault in restart.faults_of_body(body)]
    if wrong:
        raise CaseError(wrong)
    tables = [scene.bodies[body.name] for body in bodies]
    guides = tuple(
        _guide(body, keys, restart)
        for body, keys in zip(bodies, tables, strict=True)
        if keys.motion != "free"
    )
    states = [
        _without_released(_start_of(body, keys, restart), body, of, moved=restart is not None)
        for body, of, keys in zip(bodies, whole_bodies, tables, strict=True)
    ]
    whole = RigidStates(*(np.array(part) for part in zip(*states, strict=True)))
    held = (*_on_drums(bodies, net, tied, reels), *_until_released(bodies, net, let_go, releases))
    ports = tuple(k for k, keys in enumerate(tables) if keys.motion == "port")
    kinematics = Kinematics(len(bodies) - len(guides), guides, ports, *_attached(bodies, attached), held)
    whole = kinematics.all_bodies(np.array(0.0), whole)
    # Bodies in contact in another run may penetrate as far as contact allows, which it checks itself.
    touching = frozenset() if restart is None else touching_pairs(scene.effects)
    faults += _overlaps(bodies, whole, touching)
    given = tuple(state for body in bodies[kinematics.n_free :] for state in given_states(body.name))
    return BodiesAtStart(tuple(bodies), whole, kinematics, given)


def _without_released(start: _Start, body: RigidBody, whole: RigidBody, *, moved: bool) -> _Start:
    """Return the start of a body without the points that it releases later, from that of the whole.

    start : as of `_start_of`, with the velocity, and with `moved` the position, of the centre of the whole
    """
    if whole is body:
        return start
    place, velocity, attitude, spin = start
    turn = rotation_matrix(attitude)
    lever = (np.array(body.centre) - np.array(whole.centre)) @ body.rotation
    return place + turn @ lever * moved, velocity + turn @ np.cross(spin, lever), attitude, spin


def _loaded(name: str, keys: BodyConfig, net: Net, points: list[TiedPoint]) -> RigidBody:
    """Make a body with its attached nodes; a prescribed body keeps its own centre of mass.

    A port is the body that its host moves, attached nodes included.
    """
    carried = [point_mass(net.mass[point.node], point.point) for point in points]
    if keys.motion in ("free", "port"):
        return make_body(name, keys, carried)
    alone = make_body(name, keys)
    return replace(alone, mass=alone.mass + sum(mass.mass for mass in carried))


def attached_points(
    scene: Scene, net: Net, tied: tuple[TiedPoint, ...]
) -> tuple[dict[str, list[TiedPoint]], list[Fault]]:
    """Return the nodes attached to each body, those of tethers last, and their faults."""
    found: dict[str, list[TiedPoint]] = {name: [] for name in scene.bodies}
    owner: dict[int, str] = {}
    faults = []
    for name, keys in scene.bodies.items():
        for label, attachment in keys.attachments.items():
            key = f"bodies.{name}.attachments.{label}"
            where = f"{key}.{attachment.key}"
            try:
                node = attachment.node_of(net)
            except ValueError as error:
                faults.append(Fault(where, str(error)))
                continue
            if node in net.fixed_nodes:
                faults.append(Fault(where, f"node {node} is fixed by net.fixed: remove one"))
            if node in owner:
                faults.append(Fault(where, f"node {node} is attached by {owner[node]} too"))
            owner[node] = key
            found[name].append(TiedPoint(node, name, attachment.point, key))
    for point in tied:
        found[point.body].append(point)
    return found, faults


def _split(
    attached: Mapping[str, list[TiedPoint]], releases: Collection[str]
) -> tuple[dict[str, list[TiedPoint]], list[TiedPoint]]:
    """Split points into those that stay with each body, and those released, which keep their mass."""
    stay = {name: [tied for tied in points if tied.tie not in releases] for name, points in attached.items()}
    return stay, [point for points in attached.values() for point in points if point.tie in releases]


def _until_released(
    bodies: list[RigidBody], net: Net, points: list[TiedPoint], releases: Mapping[str, bool]
) -> Iterator[Held]:
    names = [body.name for body in bodies]
    for tied in points:
        number, node = names.index(tied.body), np.array([tied.node], dtype=np.int64)
        arm = bodies[number].in_principal_axes(tied.point)[None]
        start = 0 if releases[tied.tie] else 1
        yield Held(tie_name(tied.tie), start, node, number, arm, net.mass[node], tied.tie)


def _attached(bodies: list[RigidBody], attached: dict[str, list[TiedPoint]]) -> tuple[Ints, Ints, Floats]:
    """Return the attached points, the number of the body of each, and their lever arms."""
    every = [(k, body, tied) for k, body in enumerate(bodies) for tied in attached[body.name]]
    points = [tied.node for _, _, tied in every]
    arms = [body.in_principal_axes(tied.point) for _, body, tied in every]
    owners = np.array([k for k, _, _ in every], dtype=np.int64)
    return np.array(points, dtype=np.int64), owners, np.array(arms).reshape(-1, 3)


def _on_drums(
    bodies: list[RigidBody], net: Net, tied: tuple[TiedPoint, ...], reels: tuple[Reel, ...]
) -> tuple[Held, ...]:
    """Return the inner nodes of tethers on reels; on the drum, all are at one point."""
    found, names = [], [body.name for body in bodies]
    drums = {point.node: point.point for point in tied}
    for reel in reels:
        number, inner = names.index(reel.body), np.array(reel.nodes[1:-1], dtype=np.int64)
        arm = bodies[number].in_principal_axes(drums[reel.nodes[0]])
        arms = np.repeat(arm[None], len(inner), axis=0)
        found.append(Held(memory_name(reel), reel.on_drum, inner, number, arms, net.mass[inner]))
    return tuple(found)


def _start_of(body: RigidBody, keys: BodyConfig, restart: Restart | None) -> _Start:
    """Return position and velocity of the centre of mass, attitude and spin of the principal axes.

    A prescribed body starts where another run left it, with the velocities of the case.
    """
    if restart is not None and keys.motion == "free":
        return restart.of_body(body)
    if restart is not None:
        given = _start_of(body, keys, None)
        place, _, attitude, _ = restart.of_body(body)
        return place, given[1], attitude, given[3]
    position, velocity = np.array(keys.position), np.array(keys.velocity)
    frame, spin = np.array(keys.quaternion), np.array(keys.angular_velocity)
    if keys.angular_velocity_frame == "scene":
        spin = spin @ rotation_matrix(frame)
    if any(body.centre):
        position = position + rotation_matrix(frame) @ body.centre
    if body.is_along_frame:
        return position, velocity, frame, spin
    return position, velocity, product(frame, np.array(body.axes)), spin @ body.rotation


def _guide(body: RigidBody, keys: BodyConfig, restart: Restart | None) -> Guide:
    """Return the motion of a fixed or prescribed body, or of a port at the start."""
    if keys.pose_times is None:
        return Guide.steady(*_start_of(body, keys, restart))
    assert keys.pose_positions is not None
    frames = np.array(keys.pose_attitudes or [keys.quaternion] * len(keys.pose_times))
    attitudes = product(frames, np.array(body.axes))
    offset = -body.in_principal_axes((0.0, 0.0, 0.0))
    try:
        guide = Guide.through(np.array(keys.pose_times), np.array(keys.pose_positions), attitudes, offset)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        guide = None
    if guide is None or not guide.is_finite:
        words = "the motion through these poses exceeds the range of floating-point numbers"
        raise CaseError([Fault(f"bodies.{body.name}.pose_times", words, beyond_floats=True)])
    return guide


def _overlaps(
    bodies: list[RigidBody], states: RigidStates, touching: frozenset[frozenset[str]]
) -> Iterator[Fault]:
    poses = [body.frame_poses(states.position[k], states.attitude[k]) for k, body in enumerate(bodies)]
    for (k, body), (m, other) in combinations(enumerate(bodies), 2):
        if body.shape is None or other.shape is None or frozenset((body.name, other.name)) in touching:
            continue
        if overlap(body.shape, poses[k][None], other.shape, poses[m][None]).all():
            yield Fault(f"bodies.{other.name}.position", f"the body overlaps {body.name} at the start")

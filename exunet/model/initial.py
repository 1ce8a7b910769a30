"""State at time 0 of net and bodies: from the case, or from a stored state of another run."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import CaseError, Fault, joining
from exunet.bodies.config import Body, unit_quaternion
from exunet.bodies.distance import overlap
from exunet.bodies.kinematics import Kinematics, given_states
from exunet.bodies.mass_properties import point_mass
from exunet.bodies.port import PrescribedMotion
from exunet.bodies.rigid import RigidBody, RigidStates, make_body
from exunet.bodies.rotations import product, rotation_matrix
from exunet.forces.blocks import FirstOrder
from exunet.forces.on_bodies import Held
from exunet.forces.reel import discrete_name
from exunet.net import explicit, weave
from exunet.net.arrays import Ints, Net
from exunet.net.closing import NAME as CLOSING
from exunet.net.closing import LineThroughRings
from exunet.net.folding import folded
from exunet.net.tether import ReeledTether, TiedPoint
from exunet.net.weave import between
from exunet.scene.scene import Scene

KEY = "initial.restart"
_ROUND_OFF = 1e-9  # of a length, a mass or a moment of inertia


def initial_state(scene: Scene, net: Net) -> tuple[Floats, Floats]:
    """Return positions (n_nodes, 3) [m] and velocities [m/s] of a net at time 0; fixed nodes are at rest."""
    position, velocity = packed_state(scene, net)
    return position, velocity + kicks(scene, net)


def packed_state(scene: Scene, net: Net) -> tuple[Floats, Floats]:
    """Return positions and velocities of the net `weave(scene.net)` before a launch.

    Raises CaseError if a folded net does not fit into its canister.
    """
    initial = scene.initial
    if initial.fold is not None:
        position = folded(net, scene.net, initial.fold).position
    else:
        position = initial.deployed * net.reference_position
    if isinstance(scene.net, explicit.ExplicitNet) and initial.node_positions is not None:
        position = _of_all_nodes(initial.node_positions, scene.net)
    velocity = np.zeros_like(position)
    if initial.velocity:
        velocity += initial.velocity
    if initial.spin:
        velocity += np.cross(initial.spin, position)
    if isinstance(scene.net, explicit.ExplicitNet) and initial.node_velocities is not None:
        velocity += _of_all_nodes(initial.node_velocities, scene.net)
    velocity[net.fixed_nodes] = 0.0
    return position, velocity


def places_of_fold(scene: Scene) -> tuple[Floats, Floats] | None:
    """Return reference and folded positions (n, 3) [m] of a folded net, in its axes; None without a fold."""
    if scene.initial.fold is None:
        return None
    net = weave(scene.net)
    return net.reference_position, folded(net, scene.net, scene.initial.fold).position


def kicks(scene: Scene, net: Net) -> Floats:
    """Return (n_nodes, 3) velocities added by a launch [m/s]; zero at inner nodes of tethers."""
    velocity = np.zeros((net.n_nodes, 3))
    if scene.launch:
        velocity[net.bullet_nodes] = scene.launch.velocities(net.reference_position[net.bullet_nodes])
    velocity[net.fixed_nodes] = 0.0
    return velocity


def along_tethers(
    net: Net, reels: tuple[ReeledTether, ...], position: Floats, velocity: Floats
) -> Iterator[Fault]:
    """Set the inner nodes of tethers evenly between their ends, in place; yield a fault of each short tether.

    Nodes of a tether on a reel divide the distance as they divide the length outside.

    position, velocity : (n_nodes, 3) [m], [m/s], valid at the ends
    """
    on_reel = {reel.name: reel for reel in reels}
    for tether in net.tethers:
        chain, key = np.array(tether.nodes), "length"
        part = np.linspace(0.0, 1.0, len(chain))[1:-1, None]
        length = float(net.reference_length[net.tether_elements[tether.name]].sum())
        if (reel := on_reel.get(tether.name)) is not None:
            chain, length = np.array(reel.nodes), reel.length - reel.wound
            ways = (np.arange(1, len(chain) - 1) * reel.element_length - reel.wound) / length
            part, key = np.maximum(ways, 0.0)[:, None], "reel.paid_out" if reel.wound else "length"
            part[: reel.on_drum] = 0.0
        for values in (position, velocity):
            values[chain[1:-1]] = (1.0 - part) * values[chain[0]] + part * values[chain[-1]]
        distance = float(np.linalg.norm(position[chain[-1]] - position[chain[0]]))
        if distance > length * (1.0 + _ROUND_OFF):
            beyond = not np.isfinite(distance)
            span = "an infinite distance" if beyond else f"the distance of {distance:.6g} m"
            words = f"is shorter than {span} between its ends at the start"
            yield Fault(f"tethers.{tether.name}.{key}", words, beyond_floats=beyond)


def _of_all_nodes(listed: tuple[tuple[float, float, float], ...], keys: explicit.ExplicitNet) -> Floats:
    """Return values of listed nodes and, interpolated, of the inner nodes of divided elements."""
    values = np.array(listed, dtype=float)
    return np.concatenate([values, between(values, keys.listed.elements, keys.divisions)])


class RestartBody(NamedTuple):
    """Rigid body in another run.

    mass, inertia : [kg], (3, 3) [kg m2] in the axes of the frame, attached nodes included
    position, velocity : (3,) of the centre of mass [m], [m/s]
    attitude, angular_velocity : (4,) of the frame, (3,) in its axes [rad/s]
    """

    mass: float
    inertia: Floats
    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats


def beyond_shortest(outside: float, shortest: float) -> bool:
    """Return True if the length outside [m] is below that at which a drive stops winding up [m]."""
    return outside < shortest * (1.0 - _ROUND_OFF)


@dataclass(frozen=True, eq=False)
class Restart:
    """Stored state of another run, in which a case starts.

    source   : name of the result and time, for messages
    net      : net of the run, in its reference configuration
    position, velocity : (n_nodes, 3) [m], [m/s]
    bodies   : rigid bodies, by name
    states   : first-order states and stored discrete states, by name
    broken   : broken elements
    releases : attachments and ends of tethers in release entries of that run's script; True if released
    """

    source: str
    net: Net
    position: Floats
    velocity: Floats
    bodies: Mapping[str, RestartBody]
    states: Mapping[str, Floats]
    broken: tuple[int, ...] = ()
    releases: Mapping[str, bool] = field(default_factory=dict)

    def nodes(self, nodes: slice) -> tuple[Floats, Floats]:
        """Copy positions and velocities (n, 3) of nodes [m], [m/s]."""
        return self.position[nodes].copy(), self.velocity[nodes].copy()

    def faults_of_net(self, net: Net) -> Iterator[Fault]:
        """Yield differences of a net, tethers included, from the net of the run."""
        ours, theirs = net.element_nodes, self.net.element_nodes
        if net.n_nodes != self.net.n_nodes or ours.shape != theirs.shape:
            words = (
                f"has {self.net.n_nodes} nodes and {len(theirs)} elements, tethers included; this case has "
            )
            words += f"{net.n_nodes} and {len(ours)}: use the same [net] and [tethers]"
            yield Fault(KEY, f"{self.source} {words}")
            return
        if not np.array_equal(ours, theirs):
            words = "has elements between other nodes: use the same [net] and [tethers]"
            yield Fault(KEY, f"{self.source} {words}")
            return
        here, then = net.reference_length, self.net.reference_length
        differs = np.abs(here - then) > _ROUND_OFF * then
        if differs.any():
            e = int(np.argmax(differs))
            words = (
                f"element {e} has a length of {then[e]:.9g} m in {self.source} and of {here[e]:.9g} m here"
            )
            yield Fault(KEY, f"{words}: use the same [net] and [tethers]")

    def faults_of_places(self, position: Floats) -> Iterator[Fault]:
        """Yield a fault if attached nodes are elsewhere than in the run; position (n_nodes, 3) [m]."""
        distance = np.linalg.norm(position - self.position, axis=1)
        node = int(np.argmax(distance))
        if distance[node] > _ROUND_OFF * max(1.0, float(np.abs(position).max())):
            words = f"node {node} is attached {distance[node]:.3g} m from its position in {self.source}"
            yield Fault(KEY, f"{words}: use the same attachments and ends of tethers")

    def faults_of_bodies(self, scene: Scene) -> Iterator[Fault]:
        """Yield faults of bodies that are in only one of case and run, or that follow poses."""
        for name in scene.bodies:
            if name not in self.bodies:
                known = ", ".join(self.bodies) or "none"
                yield Fault(f"bodies.{name}", f"{self.source} does not have this body (bodies: {known})")
            elif scene.bodies[name].pose_times is not None:
                words = f"excludes {KEY}, which gives the position: use velocity and angular_velocity"
                yield Fault(f"bodies.{name}.pose_times", words)
        for name in self.bodies:
            if name not in scene.bodies:
                words = f"has a body {name!r}, which this case does not have: add [bodies.{name}]"
                yield Fault(KEY, f"{self.source} {words}")

    def faults_of_reels(self, scene: Scene) -> Iterator[Fault]:
        """Yield faults of missing reels, and of reels with more wound up than `shortest` allows."""
        for name, keys in scene.tethers.items():
            wound, reel = self.wound(name), keys.reel
            outside = keys.length - wound
            if reel is None and wound > 0.0:
                words = f"{wound:.6g} m of it are on a reel in {self.source}: add its reel"
                yield Fault(f"tethers.{name}", words)
            elif reel is not None and beyond_shortest(outside, reel.shortest or 0.0):
                words = f"is above the {outside:.6g} m outside in {self.source}: reduce it"
                yield Fault(f"tethers.{name}.reel.shortest", words)

    def faults_of_body(self, body: RigidBody) -> Iterator[Fault]:
        """Yield a fault if mass or inertia of a body differ, so that its centre of mass may be elsewhere."""
        then, inertia = self.bodies[body.name], body.inertia_in_frame
        moments = np.abs(inertia - then.inertia).max() > _ROUND_OFF * np.abs(then.inertia).max()
        if abs(body.mass - then.mass) > _ROUND_OFF * then.mass or moments:
            words = f"mass {body.mass:.9g} kg, attached nodes included, or inertia differ from {self.source} "
            words += f"({then.mass:.9g} kg): use the same shape, mass and attachments"
            yield Fault(f"bodies.{body.name}", words)

    def of_body(self, body: RigidBody) -> tuple[Floats, Floats, Floats, Floats]:
        """Return position and velocity of the centre of mass, attitude and spin of the principal axes."""
        then = self.bodies[body.name]
        attitude, spin = then.attitude, then.angular_velocity
        if not body.is_along_frame:
            attitude, spin = product(attitude, np.array(body.axes)), spin @ body.rotation
        return then.position, then.velocity, attitude, spin

    def wound(self, drive: str) -> float:
        """Return the length wound up by a reel, or by the winch of the closing line [m]."""
        wound = self.states.get(f"{drive}/wound_up")
        return 0.0 if wound is None else float(wound[0])

    def continued(self, state: FirstOrder) -> FirstOrder:
        """Return a first-order state with its value in the run, if it is a length; integrals start at 0."""
        value = self.states.get(state.name)
        is_length = state.name.endswith("/wound_up") or state.name == f"{CLOSING}/part"
        return replace(state, initial=tuple(value.tolist())) if is_length and value is not None else state

    def with_wound_line(self, line: LineThroughRings) -> LineThroughRings:
        """Return a closing line with the length that was wound up; raise CaseError if none is left."""
        wound = self.wound(CLOSING)
        if wound >= line.length:
            words = f"must be greater than the {wound:.6g} m wound up in the state of {KEY}"
            raise CaseError([Fault("closing.length", words)])
        if beyond_shortest(line.length - wound, line.shortest):
            words = f"is above the {line.length - wound:.6g} m outside in the state of {KEY}: reduce it"
            raise CaseError([Fault("closing.winch.shortest", words)])
        return replace(line, wound=wound)

    def with_wound_up(self, scene: Scene) -> Scene:
        """Return the scene with the lengths that were wound up on reels."""
        tethers = dict(scene.tethers)
        for name, keys in tethers.items():
            if keys.reel is not None and f"{name}/wound_up" in self.states:
                out = keys.reel.model_copy(update={"paid_out": keys.length - self.wound(name)})
                tethers[name] = keys.model_copy(update={"reel": out})
        return scene.model_copy(update={"tethers": tethers})


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
    reels: tuple[ReeledTether, ...],
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
    reels : tuple of ReeledTether
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
    motions = tuple(
        _prescribed_motion(body, keys, restart)
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
    kinematics = Kinematics(len(bodies) - len(motions), motions, ports, *_attached(bodies, attached), held)
    whole = kinematics.all_bodies(np.array(0.0), whole)
    # Bodies in contact in another run may penetrate as far as contact allows, which it checks itself.
    touching = frozenset() if restart is None else scene.effects.touching_pairs
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


def _loaded(name: str, keys: Body, net: Net, points: list[TiedPoint]) -> RigidBody:
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
        yield Held(f"{tied.tie}/held", start, node, number, arm, net.mass[node], tied.tie)


def _attached(bodies: list[RigidBody], attached: dict[str, list[TiedPoint]]) -> tuple[Ints, Ints, Floats]:
    """Return the attached points, the number of the body of each, and their lever arms."""
    every = [(k, body, tied) for k, body in enumerate(bodies) for tied in attached[body.name]]
    points = [tied.node for _, _, tied in every]
    arms = [body.in_principal_axes(tied.point) for _, body, tied in every]
    owners = np.array([k for k, _, _ in every], dtype=np.int64)
    return np.array(points, dtype=np.int64), owners, np.array(arms).reshape(-1, 3)


def _on_drums(
    bodies: list[RigidBody], net: Net, tied: tuple[TiedPoint, ...], reels: tuple[ReeledTether, ...]
) -> tuple[Held, ...]:
    """Return the inner nodes of tethers on reels; on the drum, all are at one point."""
    found, names = [], [body.name for body in bodies]
    drums = {point.node: point.point for point in tied}
    for reel in reels:
        number, inner = names.index(reel.body), np.array(reel.nodes[1:-1], dtype=np.int64)
        arm = bodies[number].in_principal_axes(drums[reel.nodes[0]])
        arms = np.repeat(arm[None], len(inner), axis=0)
        found.append(Held(discrete_name(reel), reel.on_drum, inner, number, arms, net.mass[inner]))
    return tuple(found)


def _start_of(body: RigidBody, keys: Body, restart: Restart | None) -> _Start:
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


def _prescribed_motion(body: RigidBody, keys: Body, restart: Restart | None) -> PrescribedMotion:
    """Return the motion of a fixed or prescribed body, or of a port at the start."""
    if keys.pose_times is None:
        return PrescribedMotion.steady(*_start_of(body, keys, restart))
    assert keys.pose_positions is not None
    turned = [unit_quaternion(attitude) for attitude in keys.pose_attitudes or ()]
    frames = np.array(turned or [keys.quaternion] * len(keys.pose_times))
    attitudes = product(frames, np.array(body.axes))
    offset = -body.in_principal_axes((0.0, 0.0, 0.0))
    try:
        motion = PrescribedMotion.through(
            np.array(keys.pose_times), np.array(keys.pose_positions), attitudes, offset
        )
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        motion = None
    if motion is None or not bool(np.isfinite(motion.position).all() and np.isfinite(motion.turning).all()):
        words = "the motion through these poses exceeds the range of floating-point numbers"
        raise CaseError([Fault(f"bodies.{body.name}.pose_times", words, beyond_floats=True)])
    return motion


def _overlaps(
    bodies: list[RigidBody], states: RigidStates, touching: frozenset[frozenset[str]]
) -> Iterator[Fault]:
    poses = [body.frame_poses(states.position[k], states.attitude[k]) for k, body in enumerate(bodies)]
    for (k, body), (m, other) in combinations(enumerate(bodies), 2):
        if body.shape is None or other.shape is None or frozenset((body.name, other.name)) in touching:
            continue
        if overlap(body.shape, poses[k][None], other.shape, poses[m][None]).all():
            yield Fault(f"bodies.{other.name}.position", f"the body overlaps {body.name} at the start")

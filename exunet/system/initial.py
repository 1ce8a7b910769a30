"""State at time 0: from the case, or from a stored state of another run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import Fault
from exunet.bodies.rigid import RigidBody
from exunet.bodies.rotations import product
from exunet.case.scene import Initial, Launch, Scene
from exunet.forces.blocks import FirstOrder
from exunet.net import explicit, weave
from exunet.net.arrays import Ints, Net
from exunet.net.closing import NAME as CLOSING
from exunet.net.folding import folded
from exunet.net.reel import Reel
from exunet.net.weave import between

Floats = NDArray[np.float64]

_ROUND_OFF = 1e-9  # of a length, a mass or a moment of inertia


def initial_state(scene: Scene, net: Net) -> tuple[Floats, Floats]:
    """Positions (n_nodes, 3) [m] and velocities (n_nodes, 3) [m/s] at time 0; fixed nodes are at rest."""
    position, velocity = packed_state(scene, net)
    return position, velocity + kicks(scene, net)


def packed_state(scene: Scene, net: Net) -> tuple[Floats, Floats]:
    """The same before a launch.

    `net` is what `weave(scene.net)` gives. Raises CaseError if it is to be folded and does not fit.
    """
    initial = scene.initial
    if initial.fold is not None:
        position = folded(net, scene.net, initial.fold).position
    else:
        position = initial.deployed * net.reference_position
    if isinstance(scene.net, explicit.Keys) and initial.node_positions is not None:
        position = _of_all_nodes(initial.node_positions, scene.net)
    velocity = common_velocity(initial, position)
    if isinstance(scene.net, explicit.Keys) and initial.node_velocities is not None:
        velocity += _of_all_nodes(initial.node_velocities, scene.net)
    velocity[net.fixed_nodes] = 0.0
    return position, velocity


def places_of_fold(scene: Scene) -> tuple[Floats, Floats] | None:
    """Reference positions and places (n, 3) [m] of a folded net's nodes, in its axes; None of another net.

    Another program cannot know them: the rules of a fold leave places open.
    """
    if scene.initial.fold is None:
        return None
    net = weave(scene.net)
    return net.reference_position, folded(net, scene.net, scene.initial.fold).position


def kicks(scene: Scene, net: Net) -> Floats:
    """(n_nodes, 3) what a launch adds to the velocities [m/s]; nothing at inner nodes of tethers."""
    found = np.zeros((net.n_nodes, 3))
    if scene.launch:
        found[net.bullet_nodes] = _launch_velocity(scene.launch, net)
    found[net.fixed_nodes] = 0.0
    return found


def along_tethers(net: Net, reels: tuple[Reel, ...], position: Floats, velocity: Floats) -> Iterator[Fault]:
    """Put the inner nodes of tethers evenly between their ends, in place; a fault for each that is too short.

    Of a tether on a reel, those outside divide the way as they divide the length outside.

    position, velocity : (n_nodes, 3) [m], [m/s], right at the ends
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
        apart = float(np.linalg.norm(position[chain[-1]] - position[chain[0]]))
        if apart > length * (1.0 + _ROUND_OFF):
            beyond = not np.isfinite(apart)
            way = f"the {apart:.6g} m" if not beyond else "the way, beyond floating-point numbers,"
            words = f"is shorter than {way} between its ends at the start"
            yield Fault(f"tethers.{tether.name}.{key}", words, beyond_floats=beyond)


def _of_all_nodes(listed: tuple[tuple[float, float, float], ...], keys: explicit.Keys) -> Floats:
    """Values of the listed nodes, and of the inner nodes of the divided elements between them."""
    values = np.array(listed, dtype=float)
    ends: Ints = np.array(keys.elements, dtype=np.int64).reshape(-1, 2)
    return np.concatenate([values, between(values, ends, keys.divisions)])


def common_velocity(initial: Initial, position: Floats) -> Floats:
    """(n, 3) initial.velocity + initial.spin x position [m/s]."""
    velocity = np.zeros_like(position)
    if initial.velocity:
        velocity += initial.velocity
    if initial.spin:
        velocity += np.cross(initial.spin, position)
    return velocity


def _launch_velocity(launch: Launch, net: Net) -> Floats:
    """(n_bullets, 3) [m/s]: radially away from the origin, and along +z."""
    outward = net.reference_position[net.bullet_nodes]
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    radial, axial = launch.radial_and_axial
    return radial * outward + np.array([0.0, 0.0, axial])


KEY = "initial.from"


class BodyBegun(NamedTuple):
    """A rigid body in another run.

    mass, inertia : [kg], (3, 3) [kg m2] in the axes of the frame, with what is attached
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
    """True if less is outside [m] than the length at which a drive stops winding up [m]."""
    return outside < shortest * (1.0 - _ROUND_OFF)


@dataclass(frozen=True, eq=False)
class Begun:
    """A stored state of another run.

    source   : in words, for messages
    net      : of the run, in its reference configuration
    position, velocity : (n_nodes, 3) [m], [m/s]
    bodies   : the rigid ones, by name
    states   : first-order states and what was stored of memories, by name
    broken   : elements that carried nothing any more
    releases : attachments and ends of tethers that a script of that run releases; True: it had done so
    """

    source: str
    net: Net
    position: Floats
    velocity: Floats
    bodies: Mapping[str, BodyBegun]
    states: Mapping[str, Floats]
    broken: tuple[int, ...] = ()
    releases: Mapping[str, bool] = field(default_factory=dict)

    def of_nodes(self, nodes: slice) -> tuple[Floats, Floats]:
        """Positions and velocities (n, 3) of some nodes [m], [m/s]; copies."""
        return self.position[nodes].copy(), self.velocity[nodes].copy()

    def faults_of_net(self, net: Net) -> Iterator[Fault]:
        """What is otherwise in a net, with its tethers, than in that of the run."""
        ours, theirs = net.element_nodes, self.net.element_nodes
        if net.n_nodes != self.net.n_nodes or ours.shape != theirs.shape:
            words = (
                f"has {self.net.n_nodes} nodes and {len(theirs)} elements, tethers included; this case has "
            )
            words += f"{net.n_nodes} and {len(ours)}: give the same [net] and [tethers]"
            yield Fault(KEY, f"{self.source} {words}")
            return
        if not np.array_equal(ours, theirs):
            words = "joins other nodes by its elements: give the same [net] and [tethers]"
            yield Fault(KEY, f"{self.source} {words}")
            return
        here, then = net.reference_length, self.net.reference_length
        apart = np.abs(here - then) > _ROUND_OFF * then
        if apart.any():
            e = int(np.argmax(apart))
            words = f"element {e} is {then[e]:.9g} m long in {self.source}, and {here[e]:.9g} m here"
            yield Fault(KEY, f"{words}: give the same [net] and [tethers]")

    def faults_of_places(self, position: Floats) -> Iterator[Fault]:
        """Nodes that bodies have elsewhere now; position (n_nodes, 3) [m] right where they have nodes."""
        apart = np.linalg.norm(position - self.position, axis=1)
        node = int(np.argmax(apart))
        if apart[node] > _ROUND_OFF * max(1.0, float(np.abs(position).max())):
            words = f"node {node} is fixed to a body {apart[node]:.3g} m from where it was in {self.source}"
            yield Fault(KEY, f"{words}: give the same attachments and ends of tethers")

    def faults_of_bodies(self, scene: Scene) -> Iterator[Fault]:
        """Bodies that one of both has alone, or that go through poses, which say where they are."""
        for name in scene.bodies:
            if name not in self.bodies:
                known = ", ".join(self.bodies) or "none"
                yield Fault(f"bodies.{name}", f"{self.source} has no body of this name (bodies: {known})")
            elif scene.bodies[name].pose_times is not None:
                words = f"excludes {KEY}, which says where the body is: give velocity and angular_velocity"
                yield Fault(f"bodies.{name}.pose_times", words)
        for name in self.bodies:
            if name not in scene.bodies:
                words = f"has a body {name!r}, which this case has not: add [bodies.{name}]"
                yield Fault(KEY, f"{self.source} {words}")

    def faults_of_reels(self, scene: Scene) -> Iterator[Fault]:
        """Reels that are missing here, where all that they hold would be outside at once, or wind too far."""
        for name, keys in scene.tethers.items():
            wound, reel = self.wound(name), keys.reel
            outside = keys.length - wound
            if reel is None and wound > 0.0:
                words = f"{wound:.6g} m of it are on a reel in {self.source}: add its reel, which holds them"
                yield Fault(f"tethers.{name}", words)
            elif reel is not None and beyond_shortest(outside, reel.shortest or 0.0):
                words = f"is above the {outside:.6g} m outside in {self.source}: winding would never begin"
                yield Fault(f"tethers.{name}.reel.shortest", words)

    def faults_of_body(self, body: RigidBody) -> Iterator[Fault]:
        """Whether the centre of mass of a body is where it was, which mass and inertia tell."""
        then, inertia = self.bodies[body.name], body.inertia_in_frame
        moments = np.abs(inertia - then.inertia).max() > _ROUND_OFF * np.abs(then.inertia).max()
        if abs(body.mass - then.mass) > _ROUND_OFF * then.mass or moments:
            words = f"its mass, {body.mass:.9g} kg with what is attached, or its inertia is not that of "
            words += f"{self.source}, {then.mass:.9g} kg: give the same shape, mass and attachments"
            yield Fault(f"bodies.{body.name}", words)

    def of_body(self, body: RigidBody) -> tuple[Floats, Floats, Floats, Floats]:
        """Place and velocity of the centre of mass, attitude and angular velocity of the principal axes."""
        then = self.bodies[body.name]
        attitude, spin = then.attitude, then.angular_velocity
        if not body.is_along_frame:
            attitude, spin = product(attitude, np.array(body.axes)), spin @ body.rotation
        return then.position, then.velocity, attitude, spin

    def wound(self, drive: str) -> float:
        """Length that a reel, or the winch of the closing line, had wound up [m]."""
        found = self.states.get(f"{drive}/wound_up")
        return 0.0 if found is None else float(found[0])

    def goes_on(self, state: FirstOrder) -> FirstOrder:
        """A first-order state as it was, if it says how long something is; books begin anew."""
        found = self.states.get(state.name)
        is_length = state.name.endswith("/wound_up") or state.name == f"{CLOSING}/part"
        return replace(state, initial=tuple(found.tolist())) if is_length and found is not None else state

    def wound_up_in(self, scene: Scene) -> Scene:
        """The scene with what was wound up on reels."""
        tethers = dict(scene.tethers)
        for name, keys in tethers.items():
            if keys.reel is not None and f"{name}/wound_up" in self.states:
                out = keys.reel.model_copy(update={"paid_out": keys.length - self.wound(name)})
                tethers[name] = keys.model_copy(update={"reel": out})
        return scene.model_copy(update={"tethers": tethers})

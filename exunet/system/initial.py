"""The state at time 0: of the net, and of the rigid bodies."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from exunet.base.errors import CaseError, Fault
from exunet.base.faults import joining
from exunet.bodies.body import RigidBody
from exunet.bodies.keys import BodyKeys
from exunet.bodies.making import make_body
from exunet.bodies.overlap import overlap
from exunet.bodies.rigid import RigidStates, product, rotation_matrix
from exunet.case.scene import Initial, Launch, Scene
from exunet.net import explicit
from exunet.net.arrays import Floats, Ints, Net
from exunet.net.weave import between


def initial_state(scene: Scene, net: Net) -> tuple[Floats, Floats]:
    """Positions (n_nodes, 3) [m] and velocities (n_nodes, 3) [m/s] at time 0; fixed nodes are at rest.

    `net` is what `weave(scene.net)` gives.
    """
    initial = scene.initial
    position = initial.packing * net.reference_position
    if isinstance(scene.net, explicit.Keys) and initial.node_positions is not None:
        position = _of_all_nodes(initial.node_positions, scene.net)
    velocity = common_velocity(initial, position)
    if isinstance(scene.net, explicit.Keys) and initial.node_velocities is not None:
        velocity += _of_all_nodes(initial.node_velocities, scene.net)
    if scene.launch:
        velocity[net.bullet_nodes] += _launch_velocity(scene.launch, net)
    velocity[net.fixed_nodes] = 0.0
    return position, velocity


def bodies_at_start(scene: Scene, faults: list[Fault]) -> tuple[tuple[RigidBody, ...], RigidStates]:
    """The rigid bodies of a scene, and their states; faults : takes those of bodies that overlap.

    Raises CaseError for bodies that cannot be made.
    """
    if not scene.bodies:
        return (), RigidStates.none()
    bodies: list[RigidBody] = []
    wrong: list[Fault] = []
    for name, keys in scene.bodies.items():
        with joining(wrong):
            bodies.append(make_body(name, keys))
    if wrong:
        raise CaseError(wrong)
    states = [_start_of(body, scene.bodies[body.name]) for body in bodies]
    faults += _overlaps(bodies, list(scene.bodies.values()))
    return tuple(bodies), RigidStates(*(np.array(part) for part in zip(*states, strict=True)))


def _start_of(body: RigidBody, keys: BodyKeys) -> tuple[Floats, Floats, Floats, Floats]:
    """Place and velocity of the centre of mass, attitude and angular velocity of the principal axes."""
    position, velocity = np.array(keys.position), np.array(keys.velocity)
    frame, spin = np.array(keys.quaternion), np.array(keys.angular_velocity)
    if keys.angular_velocity_frame == "scene":
        spin = spin @ rotation_matrix(frame)
    if any(body.centre):
        position = position + rotation_matrix(frame) @ body.centre
    if body.is_along_frame:
        return position, velocity, frame, spin
    return position, velocity, product(frame, np.array(body.axes)), spin @ body.rotation


def _overlaps(bodies: list[RigidBody], tables: list[BodyKeys]) -> Iterator[Fault]:
    poses = [np.array([*keys.position, *keys.quaternion]) for keys in tables]
    for (k, one), (m, other) in combinations(enumerate(bodies), 2):
        if one.shape is None or other.shape is None:
            continue
        if overlap(one.shape, poses[k], other.shape, poses[m]):
            yield Fault(f"bodies.{other.name}.position", f"the body overlaps {one.name} at the start")


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

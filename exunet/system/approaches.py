"""When a net comes to the bodies that it touches, in the nominal motion of `exunet.forces.estimate`.

Bodies move on as they start; those of given motion as they do at time 0. Threads are looked at in some places
of each element, and meshes as their convex hull.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from exunet.bodies.body import RigidBody
from exunet.bodies.crossing import reach_of
from exunet.bodies.rigid import rotation_matrix
from exunet.bodies.shapes import Shape
from exunet.bodies.surfaces import polyhedron
from exunet.forces.effects.contact import Keys
from exunet.forces.estimate import Approach, EstimateBasis
from exunet.system.system import State, System

Floats = NDArray[np.float64]

_PLACES = np.linspace(0.0, 1.0, 5)  # of an element, ends included
_STEPS = 2000  # in which the duration is gone through at most: contact is found to that
_BULLETS, _NODES, _THREADS = "bullets", "nodes", "threads"


def approaches(keys: Keys, basis: EstimateBasis, system: System, state: State) -> tuple[Approach, ...]:
    """Of each body that threads, nodes or bullets touch, what comes first.

    A body in whose canister the net starts is left out: nothing is known of how the net leaves it.
    """
    found: dict[str, list[Approach]] = {}
    names = {_THREADS: keys.threads, _NODES: keys.nodes, _BULLETS: keys.bullets}
    radius = {_NODES: keys.node_radius or 0.0, _BULLETS: keys.bullet_radius or 0.0}
    places = _Places(basis, system, state)
    for what, touched in names.items():
        for number, body in enumerate(system.bodies):
            if body.name in touched and body.name != system.blocks.carrier and body.shape is not None:
                one = places.approach(what, radius.get(what, 0.0), number, body)
                found.setdefault(body.name, []).append(one)
    return tuple(min(each, key=lambda one: (one.time, one.distance)) for each in found.values())


class _Places:
    """Threads, nodes and bullets in the nominal motion, seen from bodies."""

    def __init__(self, basis: EstimateBasis, system: System, state: State) -> None:
        net, blocks = basis.net, system.blocks
        self.basis, self.state, self.free = basis, state, system.moves_freely
        turn, nodes = blocks.poses.net, slice(net.n_nodes)
        self.position = np.asarray(state.position[nodes])
        motion = basis.motion @ turn.T
        self.carried = np.zeros_like(motion)
        if blocks.carrier:  # with the velocity of what carries the net, before or after the throw
            number = blocks.rigid.index(blocks.carrier)
            self.carried += state.bodies.velocity[number]
        mass = np.where(basis.free, net.mass, 0.0)
        common = (mass @ motion) / mass.sum() if mass.any() else np.zeros(3)
        self.opening, self.common = motion - common, common + self.carried
        self.threads = net.element_nodes[: net.n_net_elements]

    def approach(self, what: str, radius: float, number: int, body: RigidBody) -> Approach:
        """Of what touches a body, with spheres of a radius [m] where it is no thread."""
        assert body.shape is not None
        time, least, speed, touched = 0.0, np.inf, 0.0, False
        duration, reach = self.basis.duration, reach_of(body.shape)
        while True:
            own, speeds = self._seen(what, time, number, body)
            gap = _distance(body.shape, own) - radius
            nearest = int(gap.argmin())
            if gap[nearest] < least:
                least, speed = float(gap[nearest]), float(speeds[nearest])
            if touched := least <= 0.0:
                break
            if time >= duration:
                break
            fastest = float(speeds.max()) + self._spin(number) * reach
            step = max(float(gap[nearest]) / max(fastest, 1e-300), duration / _STEPS)
            time = min(duration, time + step)
        mass = body.mass if self.free[number] else np.inf
        when = time if touched else np.inf
        return Approach(body.name, what, when, speed, max(0.0, least), mass, self._touching(body.shape))

    def _spin(self, number: int) -> float:
        return float(np.linalg.norm(self.state.bodies.angular_velocity[number]))

    def _seen(self, what: str, time: float, number: int, body: RigidBody) -> tuple[Floats, Floats]:
        """Places (k, 3) in the frame of a body [m], and their speeds against it (k,) [m/s]."""
        opened = min(time, self.basis.opening_time)
        x = self.position + self.common * time + self.opening * opened
        v = self.common + (self.opening if time < self.basis.opening_time else 0.0)
        x, v = (self._of(what, one) for one in (x, np.broadcast_to(v, x.shape)))
        bodies = self.state.bodies
        turn = rotation_matrix(bodies.attitude[number])
        spin = bodies.angular_velocity[number]
        turn = turn @ Rotation.from_rotvec(spin * time).as_matrix()
        arm = x - (bodies.position[number] + bodies.velocity[number] * time)
        against = v - bodies.velocity[number] - np.cross(turn @ spin, arm)
        own = arm @ turn @ body.rotation.T + np.array(body.centre)
        return own, np.linalg.norm(against, axis=1)

    def _of(self, what: str, nodal: Floats) -> Floats:
        """(k, 3) of threads, nodes or bullets, from values of all nodes."""
        net = self.basis.net
        if what == _BULLETS:
            return np.asarray(nodal[net.bullet_nodes])
        if what == _NODES or not len(self.threads):
            return np.asarray(nodal[: net.n_net_nodes])
        ends = nodal[self.threads]
        parts = _PLACES[:, None, None]
        return np.asarray(((1.0 - parts) * ends[:, 0] + parts * ends[:, 1]).reshape(-1, 3))

    def _touching(self, shape: Shape) -> int:
        """How many threads lie on one side of a body, by the mean projected area of its hull.

        A quarter of the surface: Cauchy (1832); threads of the open net lie evenly.
        """
        net, count = self.basis.net, len(self.threads)
        if not count:
            return 0
        across = ConvexHull(np.concatenate(list(_corners(shape)))).area / 4.0
        each = float(net.reference_length[:count].mean())
        return min(
            count, round(float(net.reference_length[:count].sum()) * across / self.basis.size**2 / each)
        )


def _corners(shape: Shape) -> Iterator[Floats]:
    for solid in shape.solids:
        yield polyhedron(solid).vertices
    if shape.mesh is not None:
        yield shape.mesh.vertices


def _distance(shape: Shape, points: Floats) -> Floats:
    """(k,) from points (k, 3) in its frame to a shape [m]; 0 inside."""
    gap = np.full(len(points), np.inf)
    for solid in shape.solids:
        gap = np.minimum(gap, solid.distance(points))
    if shape.mesh is not None:
        equations = ConvexHull(shape.mesh.vertices).equations
        beyond = (points @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        gap = np.minimum(gap, np.maximum(beyond, 0.0))
    return gap

"""Initial state of a case: x(0) and v(0), eq. (17), and the bodies.

Packing is a homothety about the origin; the places of a folded net are given (`with_places`).  Velocity and
spin together are one twist (screw theory: Murray, Li & Sastry, A Mathematical Introduction to Robotic
Manipulation, 2.4).  Both are 4 x 4 matrices on (x, y, z, 1).  Points of bodies and tethers between them come
last: they follow from what they hang on.  A throw is what `[launch]` gives to bullets and, of a net that a
body carries, all that its nodes get beside the motion of the body: an impulse between them and the body.  So
the inner nodes of tethers get no part of it: they move with the ends of their tether as these were before.  A
net that is ejected later moves with the body that holds it, and gets nothing yet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from reference_impl.arrays import Floats, Ints, skew, turned
from reference_impl.bodies import Body, loaded
from reference_impl.case import BodyPoint, Case, Fold, Places
from reference_impl.net import Net, between
from reference_impl.reels import at_start, chain
from reference_impl.table import Refused

_LEAST, _ROUND_OFF = 0.9, 1e-9  # chord of a folded element over its length; of lengths


def initial_state(case: Case, net: Net) -> tuple[Floats, Floats]:
    """Positions (n, 3) [m] and velocities (n, 3) [m/s] at t = 0.  Fixed nodes start, and stay, at rest."""
    position, velocity, _ = _start(case, net)
    return position, velocity


def initial_bodies(case: Case, net: Net) -> tuple[Body, ...]:
    """The bodies of a case, with the mass of the nodes that are points of them."""
    return _start(case, net)[2]


def thrown(case: Case, net: Net) -> tuple[Floats, Floats]:
    """Places (n, 3) [m] and velocities (n, 3) [m/s] that `[initial]` and `[launch]` give, in the net's axes.

    Zero for nodes of tethers.
    """
    position, velocity = _cast(case, net)
    return position, velocity + _throw(case, net)


def net_axes(case: Case) -> Floats:
    """Rotation (3, 3) that takes the net's axes at time 0 to the scene's."""
    carrier = case.start.carrier
    if carrier is None:
        return np.eye(3)
    (body,) = (body for body in case.bodies if body.name == carrier.body)
    return np.asarray(body.attitude @ carrier.attitude)


def _start(case: Case, net: Net) -> tuple[Floats, Floats, tuple[Body, ...]]:
    """Positions, velocities (n, 3), and the bodies."""
    position, velocity, bodies, throw = _before(case, net)
    carrier = case.start.carrier
    if carrier is not None and carrier.eject_at:
        return position, velocity, bodies
    after = bodies
    if carrier is not None:
        number = [body.name for body in bodies].index(carrier.body)
        given = net.mass[:, None] * throw
        if bodies[number].drive is None and given.any():
            thrower = _recoil(bodies[number], _on_drums(case, net, carrier.body), position, given)
            after = (*bodies[:number], thrower, *bodies[number + 1 :])
    velocity = velocity + throw
    _hang(case, net, after, position, velocity)
    return position, velocity, after


def thrown_at_start(case: Case, net: Net) -> Floats | None:
    """What a net gets at time 0 (n, 3) [m/s] from the body that carries it; None: nothing, or later."""
    carrier = case.start.carrier
    if carrier is None or carrier.eject_at:
        return None
    throw = _before(case, net)[3]
    return throw if throw.any() else None


def before_throw(case: Case, net: Net) -> tuple[Floats, Floats, tuple[Body, ...]]:
    """Positions [m] and velocities [m/s] (n, 3), and the bodies, as a throw at time 0 finds them."""
    return _before(case, net)[:3]


def _before(case: Case, net: Net) -> tuple[Floats, Floats, tuple[Body, ...], Floats]:
    """Positions, velocities (n, 3) and the bodies before a throw, and the throw (n, 3) [m/s]."""
    position, velocity = _cast(case, net)
    throw = _throw(case, net)
    bodies = tuple(_with_nodes(body, net, number) for number, body in enumerate(case.bodies))
    if case.start.carrier is not None:
        throw = _carry(case, net, bodies, position, velocity, throw)
    _lead(net, bodies, position, velocity)
    for values in (position, velocity):
        values[net.woven :] = between(values, net.parents, net.shares)[net.woven :]
    _hang(case, net, bodies, position, velocity)
    return position, velocity, bodies, throw


def _hang(case: Case, net: Net, bodies: tuple[Body, ...], position: Floats, velocity: Floats) -> None:
    """Puts points of bodies, and nodes on drums, where they are and as they move, in both (n, 3) arrays."""
    _lead(net, bodies, position, velocity)
    for nodes in _wound_up(case, net):
        position[nodes], velocity[nodes] = position[nodes[0]], velocity[nodes[0]]


def _lead(net: Net, bodies: tuple[Body, ...], position: Floats, velocity: Floats) -> None:
    """Puts points of bodies where they are, in both (n, 3) arrays [m], [m/s]."""
    for node, number, point in zip(net.anchors.node, net.anchors.body, net.anchors.point, strict=True):
        position[node], velocity[node] = bodies[number].at(point)


def _with_nodes(body: Body, net: Net, number: int) -> Body:
    mine = np.flatnonzero(net.anchors.body == number)
    return loaded(body, net.mass[net.anchors.node[mine]], net.anchors.point[mine])


def _cast(case: Case, net: Net) -> tuple[Floats, Floats]:
    """Positions and velocities (n, 3) by `[initial]`, in the net's axes; zero for nodes of tethers."""
    start, position = case.start, np.zeros_like(net.reference_position)
    if start.fold is not None:
        packed = _folded(net, start.fold)
    elif start.node_positions is None:
        packed = _mapped(np.diag([start.packing] * 3 + [1.0]), net.reference_position[: net.woven])
    else:
        packed = _spread(net, start.node_positions)
    position[: net.woven] = packed
    velocity = np.zeros_like(position)
    moving = np.setdiff1d(np.arange(net.woven), net.fixed_nodes)
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = skew(np.array(start.spin)), start.velocity
    velocity[moving] = _mapped(twist, position[moving])
    if start.node_velocities is not None:
        velocity[moving] += _spread(net, start.node_velocities)[moving]
    return position, velocity


def _throw(case: Case, net: Net) -> Floats:
    """What `[launch]` adds to the velocities (n, 3) [m/s], of bullets; nothing to points of bodies."""
    throw = np.zeros_like(net.reference_position)
    if case.launch is not None:
        outward = outwards(net.reference_position[net.numbered_bullets])
        bullets = outward * case.launch.radial + np.array([0.0, 0.0, case.launch.axial])
        if case.launch.tilts is not None:
            bullets = _tilted(bullets, outward, np.array(case.launch.tilts))
        if case.launch.factors is not None:
            bullets = np.array(case.launch.factors)[:, None] * bullets
        throw[net.numbered_bullets] = bullets
    throw[net.anchors.node] = 0.0
    return throw


def _tilted(velocity: Floats, outward: Floats, tilt: Floats) -> Floats:
    """Velocities (k, 3) turned by tilts (k, 2) [rad]: about z x o, then about what is across both."""
    still = np.tile(np.eye(3), (len(velocity), 1, 1))
    aside = np.cross([0.0, 0.0, 1.0], outward)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    for axis in (0, 1):
        if axis:
            size = np.linalg.norm(velocity, axis=1, keepdims=True)
            aside = np.cross(velocity, aside) / np.where(size > 0.0, size, 1.0)
        velocity = (turned(still, tilt[:, axis, None] * aside) @ velocity[..., None])[..., 0]
    return velocity


def _carry(
    case: Case, net: Net, bodies: tuple[Body, ...], position: Floats, velocity: Floats, throw: Floats
) -> Floats:
    """Takes the net from its own axes, carried by a body, to those of the scene; changes both (n, 3) arrays.

    Afterwards it moves with the body.  Returns all that it gets beside, in the scene's axes (n, 3) [m/s].
    """
    carrier, nodes = case.start.carrier, slice(net.woven)
    assert carrier is not None
    (body,) = (body for body in bodies if body.name == carrier.body)
    axes, origin = net_axes(case), body.at(carrier.position)[0]
    position[nodes] = origin + position[nodes] @ axes.T
    turning = skew(body.attitude @ body.angular_velocity)
    carried = body.velocity + (position[nodes] - body.at(body.centre_of_mass)[0]) @ turning.T
    throw = (throw + velocity) @ axes.T
    throw[net.anchors.node] = 0.0
    velocity[nodes] = carried
    velocity[net.fixed_nodes] = 0.0
    return np.asarray(throw)


def _wound_up(case: Case, net: Net, name: str | None = None) -> Iterator[Ints]:
    """Of each reel, or of those on one body: the node at the drum's point, then the nodes on the drum."""
    for number, tether in enumerate(case.tethers):
        reel = tether.reel
        end = tether.start if reel is not None and reel.at_start else tether.end
        if reel is not None and isinstance(end, BodyPoint) and name in (None, end.body):
            _, held = at_start(tether.length, tether.divisions, reel.paid_out)
            nodes, _ = chain(net.element_nodes, net.tether, number, reel.at_start)
            yield nodes[: 1 + held]


def _on_drums(case: Case, net: Net, name: str) -> tuple[Floats, Floats]:
    """Masses (q,) [kg] of the nodes on drums of a body, and where they are (q, 3) [m] in its frame."""
    masses, points = [np.empty(0)], [np.empty((0, 3))]
    for nodes in _wound_up(case, net, name):
        masses.append(net.mass[nodes[1:]])
        (point,) = net.anchors.point[net.anchors.node == nodes[0]]
        points.append(np.tile(point, (len(masses[-1]), 1)))
    return np.concatenate(masses), np.concatenate(points)


def _recoil(body: Body, held: tuple[Floats, Floats], place: Floats, given: Floats) -> Body:
    """The body after it has given momenta (k, 3) [kg m/s] at places (k, 3) [m], with their moments.

    `held` masses at points of its frame give their part.
    """
    both = loaded(body, *held)
    centre, velocity = body.at(both.centre_of_mass)
    lost = np.cross(place - centre, given).sum(axis=0)
    slower = velocity - given.sum(axis=0) / both.mass
    turning = body.angular_velocity - np.linalg.solve(both.inertia, body.attitude.T @ lost)
    after = replace(both, velocity=slower, angular_velocity=turning)
    return replace(body, velocity=after.at(body.centre_of_mass)[1], angular_velocity=turning)


def _mapped(matrix: Floats, points: Floats) -> Floats:
    """The first three components (n, 3) of a matrix (4, 4) on points (n, 3) with a fourth component 1.

    Sums term by term, of which at most three are not zero: no order that depends on the place in the array.
    """
    terms = [points[:, c : c + 1] * matrix[:3, c] for c in range(3)]
    return np.asarray(((terms[0] + terms[1]) + terms[2]) + matrix[:3, 3])


def _spread(net: Net, listed: tuple[tuple[float, ...], ...]) -> Floats:
    """Values (n, 3) of the net's nodes from those of the listed ones; between these along divided sides."""
    return between(np.array(listed, dtype=float), net.parents[: net.woven], net.shares[: net.woven])


def outwards(place: Floats) -> Floats:
    """Unit vectors (k, 3) from the origin to the reference positions of bullets (k, 3)."""
    if place[:, 2].any():  # an explicit net off the plane of the origin
        return np.asarray(place / np.linalg.norm(place, axis=1)[:, None])
    return unit_outwards(place)


def unit_outwards(place: Floats) -> Floats:
    """Unit vectors (k, 3) from the origin to places (k, 3), in the net's plane.

    As in Givens' rotations (Golub & Van Loan, Matrix Computations, 5.1.8): the larger coordinate gives the
    cosine 1/sqrt(1 + slope^2), the smaller one the sine, slope times that.  Mirrored places, x <-> y among
    the mirrors, get mirrored vectors to the last bit.
    """
    x, y, _ = place.T
    steep = np.abs(y) > np.abs(x)
    longer, shorter = np.where(steep, y, x), np.where(steep, x, y)
    slope = shorter / longer
    along = np.copysign(np.sqrt(1.0 / (1.0 + slope * slope)), longer)
    across = slope * along
    return np.column_stack((np.where(steep, across, along), np.where(steep, along, across), np.zeros_like(x)))


def spread(net: Net, angle: float) -> Floats:
    """Unit vectors (k, 3) at an angle [rad] from +z, leaning outwards: sin outwards, cos along +z."""
    outward = outwards(net.reference_position[net.bullet_nodes])
    return np.asarray(math.sin(angle) * outward + math.cos(angle) * np.array([0.0, 0.0, 1.0]))


def with_places(case: Case, reference_position: Floats, place: Floats) -> Case:
    """The case with its folded net where another program puts it: (n, 3) of all its nodes, in its axes [m].

    The format leaves places open, so that two folds by its rules differ. Raises Refused without a fold.
    """
    given = Places(np.asarray(reference_position, dtype=float), np.asarray(place, dtype=float))
    if case.start.fold is None:
        raise Refused(["places are for a net that is folded: the case has no initial.fold"])
    if given.place.shape != given.reference_position.shape or given.place.shape[1:] != (3,):
        raise Refused(["places: give a reference position and a place (n, 3) of each node"])
    return replace(case, start=replace(case.start, fold=replace(case.start.fold, places=given)))


def _folded(net: Net, fold: Fold) -> Floats:
    """The given places in this net's order, if they are those of a fold of it by the rules of the format."""
    if (places := fold.places) is None:
        raise Refused(["initial.fold: the places of a folded net must be given (with_places)"])
    own = net.tether < 0
    d = 2.0 * float(np.sqrt(net.area[own].max() / np.pi))
    meshed = np.unique(net.element_nodes[own & ~net.of_string])
    flat = net.reference_position[: net.woven]
    if len(places.place) != len(flat):
        raise Refused([f"places: {len(places.place)} nodes are given, the net has {len(flat)}"])
    away, row = cKDTree(places.reference_position).query(flat)
    if away.max() > _ROUND_OFF * np.ptp(flat) or len(np.unique(row)) < len(row):
        raise Refused([f"places: none is given of the node at {flat[away.argmax()]} m"])
    place = np.asarray(places.place[row])
    if not np.isfinite(place).all():
        raise Refused(["places: they must be finite numbers"])
    if not fold.holds(place[meshed] * (1.0 - _ROUND_OFF), d):
        raise Refused(["places: the net is not inside its canister"])
    chord = np.linalg.norm(np.diff(place[net.element_nodes[own]], axis=1)[:, 0], axis=1)
    part = chord / net.reference_length[own]
    worst = int(np.argmax(np.maximum(_LEAST - part, part - 1.0)))
    if not _LEAST - _ROUND_OFF <= part[worst] <= 1.0 + _ROUND_OFF:
        raise Refused([f"places: element {worst} has {part[worst]:.4f} of its length, not 0.9 to 1"])
    return place

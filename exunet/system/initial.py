"""The state of the net at time 0."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.base.errors import Fault
from exunet.case.scene import Initial, Launch, Scene
from exunet.net import explicit, weave
from exunet.net.arrays import Floats, Ints, Net
from exunet.net.folding import folded
from exunet.net.reel import Reel
from exunet.net.weave import between

_ROUND_OFF = 1e-9  # of a tether's length


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

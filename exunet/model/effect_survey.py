"""Which effects matter in a scene: the estimate of each known effect, and advice.

Estimates are those of the effects' `magnitude`; effects that are off are estimated with the stated
assumptions of their `nominal`. With `effects.choose = "auto"` the same estimates switch effects on. For
contact, bodies continue their initial motion, threads are sampled at some points of each element, and meshes
are convex hulls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import scipy

from exunet.base.arrays import Floats
from exunet.base.errors import Fault, joining
from exunet.base.record import Record
from exunet.bodies.distance import reach_of
from exunet.bodies.rigid import RigidBody, make_body
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Shape
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.effects import EFFECTS, beyond_floats, terms_of
from exunet.forces.effects.contact import Contact
from exunet.forces.effects.launch_force import LaunchForce
from exunet.forces.effects.orbit import Orbit
from exunet.forces.estimate import Approach, Estimate, EstimateBasis, Meeting
from exunet.model.build import system_of
from exunet.model.initial import initial_state
from exunet.model.system import State, System
from exunet.net import weave
from exunet.scene.scene import Scene

_PLACES = np.linspace(0.0, 1.0, 5)  # of an element, ends included
_STEPS = 2000  # at most over the duration, the resolution of the time of contact
_BULLETS, _NODES, _THREADS = "bullets", "nodes", "threads"


def approaches(keys: Contact, basis: EstimateBasis, system: System, state: State) -> tuple[Approach, ...]:
    """Find the first approach of threads, nodes or bullets to each body in contact.

    A body whose canister holds the net is left out: how the net leaves it is not known.
    """
    found: dict[str, list[Approach]] = {}
    names = {_THREADS: keys.threads, _NODES: keys.nodes, _BULLETS: keys.bullets}
    radius = {_NODES: keys.node_radius or 0.0, _BULLETS: keys.bullet_radius or 0.0}
    places = _Places(basis, system, state)
    for what, touched in names.items():
        for number, body in enumerate(system.bodies):
            if body.name in touched and body.name != system.blocks.carrier and body.shape is not None:
                approach = places.approach(what, radius.get(what, 0.0), number, body)
                found.setdefault(body.name, []).append(approach)
    return tuple(min(each, key=lambda near: (near.time, near.distance)) for each in found.values())


class _Places:
    """Threads, nodes and bullets in the nominal motion, relative to bodies."""

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
        """Find the first approach to a body of threads, or of spheres of a radius [m]."""
        assert body.shape is not None
        time, least, speed, touched = 0.0, np.inf, 0.0, False
        duration, reach = self.basis.duration, reach_of(body.shape)
        while True:
            own, speeds = self._relative(what, time, number, body)
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
        return Approach(body.name, what, when, speed, max(0.0, least), mass)

    def _spin(self, number: int) -> float:
        return float(np.linalg.norm(self.state.bodies.angular_velocity[number]))

    def _relative(self, what: str, time: float, number: int, body: RigidBody) -> tuple[Floats, Floats]:
        """Return positions (k, 3) in the frame of a body [m], and speeds relative to it (k,) [m/s]."""
        opened = min(time, self.basis.opening_time)
        x = self.position + self.common * time + self.opening * opened
        v = self.common + (self.opening if time < self.basis.opening_time else 0.0)
        x, v = (self._of(what, nodal) for nodal in (x, np.broadcast_to(v, x.shape)))
        bodies = self.state.bodies
        turn = rotation_matrix(bodies.attitude[number])
        spin = bodies.angular_velocity[number]
        turn = turn @ scipy.spatial.transform.Rotation.from_rotvec(spin * time).as_matrix()
        arm = x - (bodies.position[number] + bodies.velocity[number] * time)
        against = v - bodies.velocity[number] - np.cross(turn @ spin, arm)
        own = arm @ turn @ body.rotation.T + np.array(body.centre)
        return own, np.linalg.norm(against, axis=1)

    def _of(self, what: str, nodal: Floats) -> Floats:
        """Return (k, 3) values of threads, nodes or bullets from those of all nodes."""
        net = self.basis.net
        if what == _BULLETS:
            return np.asarray(nodal[net.bullet_nodes])
        if what == _NODES or not len(self.threads):
            return np.asarray(nodal[: net.n_net_nodes])
        ends = nodal[self.threads]
        parts = _PLACES[:, None, None]
        return np.asarray(((1.0 - parts) * ends[:, 0] + parts * ends[:, 1]).reshape(-1, 3))


def _distance(shape: Shape, points: Floats) -> Floats:
    """Compute (k,) distances from points (k, 3) in its frame to a shape [m]; 0 inside."""
    gap = np.full(len(points), np.inf)
    for solid in shape.solids:
        gap = np.minimum(gap, solid.distance(points))
    if shape.mesh is not None:
        equations = scipy.spatial.ConvexHull(shape.mesh.vertices).equations
        beyond = (points @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        gap = np.minimum(gap, np.maximum(beyond, 0.0))
    return gap


ASKED = 0.01  # of the net's size: the accuracy that the advice is for, where the case states none


class Advice(StrEnum):
    """Advice on an effect of a scene."""

    KEEP = "keep"
    CONSIDER = "consider"
    NOT_NEEDED = "not needed"
    GROUND = "for tests on the ground"
    NUMERICAL = "numerical, not physics"
    CANDIDATE = "below effects.threshold"
    UNKNOWN = "not estimated"


@dataclass(frozen=True)
class Finding:
    """Estimate of one effect in one scene.

    on         : on in the case (with "auto": it has a table, and its estimate reaches the threshold)
    keys       : keys of the case, or assumed ones; None without an assumption for this scene
    assumption : assumption where the case does not have a table; "" if it has
    estimate   : None without keys
    relative   : estimated displacement over the size of the net
    """

    name: str
    on: bool
    keys: Record | None
    assumption: str
    estimate: Estimate | None
    relative: float

    def advice(self, accuracy: float) -> Advice:
        """Advise on the effect at an accuracy, as a fraction of the size of the net."""
        if not isinstance(self.keys, Effect) or self.estimate is None:
            return Advice.UNKNOWN
        if self.keys.NUMERICAL:
            return Advice.NUMERICAL
        if not self.on and not self.assumption:
            return Advice.CANDIDATE
        if not self.on and self.keys.ON_THE_GROUND:
            return Advice.GROUND
        if self.relative < accuracy:
            return Advice.NOT_NEEDED
        return Advice.KEEP if self.on else Advice.CONSIDER


def setting_of(scene: Scene, without: str = "", duration: float | None = None) -> EstimateBasis:
    """Return the basis of the estimates of a scene; bullets launched by a force have their final speed.

    without : effect that counts as off
    """
    net = weave(scene.net)
    position, velocity = initial_state(scene, net)
    launch = scene.effects.get(LaunchForce)
    if launch is not None and EFFECTS.get(without) is not LaunchForce:
        mass = net.mass[net.bullet_nodes]
        speed = np.sqrt(2.0 * launch.work / mass)
        velocity[net.bullet_nodes] += speed[:, None] * launch.barrels(net)
    lasts = scene.time.end if duration is None else duration
    return EstimateBasis(net, lasts, position, velocity, scene.effects.get(Orbit), _meetings(scene))


def _meetings(scene: Scene) -> tuple[Meeting, ...]:
    """Return the approaches of the pairs of bodies in contact, by the positions of their frames."""
    found = []
    for pair in sorted(sorted(names) for names in scene.effects.touching_pairs):
        tables = [scene.bodies[name] for name in pair]
        bodies = [make_body(name, keys) for name, keys in zip(pair, tables, strict=True)]
        mobility = sum(
            1.0 / body.mass if keys.motion == "free" else 0.0
            for body, keys in zip(bodies, tables, strict=True)
        )
        offset, relative = (
            np.subtract(*(getattr(keys, name) for keys in tables)) for name in ("position", "velocity")
        )
        distance = float(np.linalg.norm(offset))
        speed = -float(relative @ offset) / distance if distance > 0.0 else 0.0
        reach = sum(reach_of(body.shape) for body in bodies if body.shape is not None)
        mass = 1.0 / mobility if mobility > 0.0 else np.inf
        found.append(Meeting((pair[0], pair[1]), mass, speed, max(0.0, distance - reach)))
    return tuple(found)


def survey(scene: Scene) -> list[Finding]:
    """Estimate every known effect; effects that are on first, then by decreasing displacement."""
    findings = [finding(scene, name) for name in EFFECTS]
    return sorted(findings, key=lambda effect: (not effect.on, -effect.relative))


def finding(scene: Scene, name: str, duration: float | None = None) -> Finding:
    """Estimate one effect; raise CaseError if its numbers, or those of the scene, overflow."""
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are refused
            return _finding(scene, name, duration)
    except ArithmeticError:
        raise beyond_floats(name) from None


def _finding(scene: Scene, name: str, duration: float | None) -> Finding:
    basis = setting_of(scene, name, duration)
    keys, assumption = scene.effects.on.get(name), ""
    has_table = keys is not None
    if keys is None:
        assumed = EFFECTS[name].nominal(basis)
        if assumed is None:
            return Finding(name, False, None, "", None, 0.0)
        keys, assumption = assumed
    contact, masses, states = scene.effects.get(Contact), keys.point_masses(), keys.first_order_states()
    blocks = Blocks.of(basis.net, basis.position, masses, tuple(scene.bodies), states)
    if contact is not None and keys.COLLIDES:  # only the system knows where bodies are
        system, state = system_of(scene, [])
        basis = replace(basis, approaches=approaches(contact, basis, system, state))
        blocks = system.blocks if keys is contact else blocks
    terms_of(name, keys, blocks)  # refuses numbers that overflow
    estimate = keys.magnitude(basis)
    if not np.isfinite([estimate.acceleration, estimate.displacement]).all():
        raise beyond_floats(name)
    relative = estimate.displacement / basis.size
    threshold = scene.effects.threshold
    on = has_table and (threshold is None or relative >= threshold)
    return Finding(name, on, keys, assumption, estimate, relative)


def chosen(scene: Scene, faults: list[Fault]) -> tuple[Scene, tuple[str, ...]]:
    """Return the scene with the effects that matter, and notes on each candidate, with "auto".

    Another scene is returned unchanged.

    faults : receives faults of candidates whose numbers, or those of the scene, overflow; these stay on
    """
    choice = scene.effects
    if choice.threshold is None:
        return scene, ()
    off: dict[str, None] = {}
    notes = []
    for name in choice.on:
        one = None
        with joining(faults):
            one = finding(scene, name)
        if one is None:
            continue
        assert one.estimate is not None
        if not one.on:
            off[name] = None
        word, sign = ("on", ">=") if one.on else ("off", "<")
        notes.append(
            f"auto: {name} {word}: {one.relative:.1e} of the net's size {sign} {choice.threshold:g} "
            f"({one.estimate.source})"
        )
    return scene.model_copy(update={"effects": choice.model_copy(update=off)}), tuple(notes)


def without_choice(asked: Scene, resolved: Scene) -> tuple[str, ...]:
    """Return overrides that switch on the effects that `chosen` kept, for the reference."""
    if asked.effects.choose is None:
        return ()
    off = set(asked.effects.on) - set(resolved.effects.on)
    return tuple(f"effects.{name}=" for name in ("choose", "threshold", *sorted(off)))

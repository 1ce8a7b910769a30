"""Plausibility of a valid case: values far from those of any net, and missions that cannot work.

Each rule yields a warning at a key. Bounds are wide: they find wrong units and mistakes of a factor of a
hundred or more, and by hand calculation what would fail after minutes of simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import Fault
from exunet.base.times import reached
from exunet.bodies.config import Body, Dimensions
from exunet.bodies.distance import distances_to
from exunet.bodies.mass_properties import of_solid
from exunet.bodies.rigid import shape_of
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.contact.law import ImpactDampingConfig
from exunet.forces.effects.air_drag import AirDrag
from exunet.forces.effects.contact import Contact, LinearContact
from exunet.forces.effects.gravity import Gravity
from exunet.forces.effects.material_damping import MaterialDamping
from exunet.forces.effects.molecular_drag import MolecularDrag
from exunet.forces.effects.rayleigh_damping import RayleighDamping
from exunet.forces.environment import CircularOrbitConfig
from exunet.net import weave
from exunet.net.arrays import Net
from exunet.net.base import Cable, ThrownNetConfig
from exunet.net.closing import ClosingLine
from exunet.net.folding import folded
from exunet.net.tether import Reel, Tether
from exunet.scene.scene import Scene, cables
from exunet.scene.script import drive_of, timeline

# Materials: from rubber (1e6 Pa) to carbon fibre and graphite whiskers (1e12 Pa); from aerogels and foams to
# osmium (22,590 kg/m3); the strongest fibres break below 1e10 Pa, and a thread of one fibre is 10 um thick.
MODULUS, DENSITY, STRENGTH, THINNEST = (1e6, 1.1e12), (300.0, 2.3e4), 1e10, 5e-6
BODY_DENSITY = (1.0, 2.3e4)  # of a whole body [kg/m3]: from a balloon to a block of osmium
THICK = 0.1  # diameter of a thread as a part of the side between two knots
# Damping ratio of the first axial mode of a side: below it damps nothing, above it a thread is a dashpot.
DAMPING = (1e-3, 0.3)
# Damping ratio from which on tensions converge in the division. Measured on the paper's net with 1, 2 and 3
# elements a side: 415, 321 and 339 N with 0.11; 748, 654 and 419 N with 0.011 (medians of 8 perturbed runs).
CONVERGES = 0.1
FASTEST = 100.0  # [m/s]: nets were thrown at 2 to 30 m/s
RIM_SPEED = 10.0  # [m/s] of a body's corner: tumbling debris turns at some degrees, a spent stage at 1 rad/s
GRAVITY = 25.0  # [m/s2], that of Jupiter
AIR = 10.0  # [kg/m3], eight times that at sea level
ATMOSPHERE = 1e5  # [m]: no orbit is below it
# Mass of all bullets over that of the net and its strings: below it they hardly open it; thrown nets have 0.2
# to 20, and a factor of ten beyond is a mistake of units.
BULLETS = (0.02, 200.0)
LINE = 1.0  # [kg/m] of a closing line: a steel rope of 16 mm
# E / density of a line, from the softest and heaviest to the stiffest and lightest of the materials above.
SPECIFIC = (MODULUS[0] / DENSITY[1], MODULUS[1] / DENSITY[0])
# Strain at the strength: the stiffest carbon fibres break at 3e-3, rubber at 8.
STRAIN = (1e-3, 10.0)
FRICTION = 2.0  # coefficient: dry metals, plastics and fibres have 0.1 to 1, soft rubber up to 2
OFF_NAME = 0.1  # of a mesh: a named node that is farther from the place of its name is reported
STOPPED = 0.01  # of the launch speed: a net that is slower has stopped
SAME_PLACE = 1e-6  # of the size of a net: below it a node has not moved


class _Target(NamedTuple):
    """Body that a net is to reach: name, centre [m], velocity [m/s], radius around it [m]."""

    name: str
    centre: Floats
    velocity: Floats
    radius: float


class _Approach(NamedTuple):
    """Distance of the net's nodes from the target's surface [m], and their speed against it [m/s].

    time          : before which no node touches it in a straight flight [s]
    along, offset : way [m] to where the net is nearest to the target's centre, and the distance then
    """

    distance: float
    speed: float
    time: float
    along: float
    offset: float


@dataclass(frozen=True)
class _Mission:
    """A scene with what several rules need of it."""

    scene: Scene

    @cached_property
    def net(self) -> Net:
        return weave(self.scene.net)

    @cached_property
    def thrown(self) -> bool:
        """Whether the net's flight follows from [initial] and [launch]."""
        effects = self.scene.effects
        own = any(effect.REPLACES_LAUNCH for effect in effects.on.values())
        initial = self.scene.initial
        listed = not self.scene.net.has_mouth or initial.node_positions or initial.node_velocities
        return not (own or listed or initial.restart is not None or effects.get(Gravity))

    @cached_property
    def start(self) -> tuple[Floats, Floats, Floats]:
        """Position [m] and velocity [m/s] of the net's centre after its launch, and its axes (3, 3)."""
        initial, launch = self.scene.initial, self.scene.launch
        position, turn, speed = np.zeros(3), np.eye(3), np.zeros(3)
        if (frame := initial.frame) is not None:
            body = self.scene.bodies[frame.body]
            carrier = rotation_matrix(np.array(body.quaternion))
            position = np.array(body.position) + carrier @ np.array(frame.position)
            turn = carrier @ rotation_matrix(np.array(frame.quaternion))
            speed = np.array(body.velocity)
        own = np.array(initial.velocity or (0.0, 0.0, 0.0))
        if launch is not None:
            nodes, mass = self.net.bullet_nodes, self.net.mass
            own += mass[nodes] @ launch.velocities(self.net.reference_position[nodes]) / float(mass.sum())
        return position, speed + turn @ own, turn

    @cached_property
    def speed(self) -> float:
        """Speed of the net against the body that throws it, or the scene [m/s]."""
        frame = self.scene.initial.frame
        carrier = np.zeros(3) if frame is None else np.array(self.scene.bodies[frame.body].velocity)
        return float(np.linalg.norm(self.start[1] - carrier))

    @cached_property
    def eject(self) -> float | None:
        """Time of the launch [s]; None: a script's condition decides."""
        frame = self.scene.initial.frame
        times = [entry.at for entry in self.scene.script if entry.do == "eject"]
        return times[0] if times else 0.0 if frame is None else frame.eject_at

    @cached_property
    def target(self) -> _Target | None:
        """Body of [capture], if its motion is that of the start."""
        if self.scene.capture is None:
            return None
        name = self.scene.capture.target
        body = self.scene.bodies[name]
        if body.pose_times is not None or body.motion == "port":
            return None
        extent = extents(body)
        radius = 0.0 if extent is None else extent[1]
        return _Target(name, np.array(body.position), np.array(body.velocity), radius)

    @cached_property
    def approach(self) -> _Approach | None:
        """Straight flight of the net past the target; None: not known."""
        if self.target is None or not self.thrown:
            return None
        position, velocity, turn = self.start
        relative, rate = self.target.centre - position, velocity - self.target.velocity
        distance, speed = float(np.linalg.norm(relative)), float(np.linalg.norm(rate))
        body, initial = self.scene.bodies[self.target.name], self.scene.initial
        packed = initial.deployed * self.net.reference_position
        if initial.fold is not None:
            packed = folded(self.net, self.scene.net, initial.fold).position
        nodes = position + packed[: self.net.n_net_nodes] @ turn.T - self.target.centre
        shape = shape_of(self.target.name, body)
        assert shape is not None
        gap = float(distances_to(shape, nodes @ rotation_matrix(np.array(body.quaternion))).min())
        along = float(relative @ rate) / speed if speed else 0.0
        offset = math.sqrt(max(0.0, distance * distance - along * along))
        time = gap / speed if along > 0.0 else math.inf
        return _Approach(gap, speed, time, along, offset)


def extents(body: Body) -> tuple[float, float] | None:
    """Return the least half thickness and the radius about its origin of a body [m]; None of a mesh."""
    if body.parts:
        parts = [
            (_half(part), float(np.linalg.norm(np.array(part.position)))) for part in body.parts.values()
        ]
        return min(half[0] for half, _ in parts), max(half[1] + off for half, off in parts)
    return None if body.shape in (None, "mesh") else _half(body)


def _half(solid: Dimensions) -> tuple[float, float]:
    """Least half thickness, and radius of the ball around the centre [m]."""
    if solid.size is not None:
        return 0.5 * min(solid.size), 0.5 * math.hypot(*solid.size)
    radius = max(solid.radii) if solid.radii is not None else solid.radius or 0.0
    half = 0.5 * (solid.length or 0.0)
    if getattr(solid, "shape", None) == "capsule":
        return radius, half + radius
    return (min(radius, half), math.hypot(radius, half)) if half else (radius, radius)


def warnings(scene: Scene) -> list[Fault]:
    """Return what is implausible in a valid scene, each at the key to look at."""
    mission = _Mission(scene)
    with np.errstate(all="ignore"):  # numbers that overflow are errors of the preparation
        return [fault for rule in RULES for fault in rule(mission)]


def moved_nodes(before: Scene, after: Scene) -> Iterator[Fault]:
    """Yield a warning for each numbered node of the net that is at another place in a scene with another net.

    Places are compared in parts of the size of each net; a number that only the first net has is an error.
    """
    if not (keys := {key: node for key, node in _nodes(after) if isinstance(node, int)}):
        return
    old, new = weave(before.net), weave(after.net)
    for key, node in keys.items():
        if node >= min(old.n_nodes, new.n_nodes):
            continue
        places = [net.reference_position[node] / net.size for net in (old, new)]
        if np.abs(places[1] - places[0]).max() > SAME_PLACE:
            name = old.name_of(node)
            x, y, _ = new.reference_position[node]
            words = f"moves node {node} to ({x:.3g}, {y:.3g}) m of the net: "
            yield Fault(key, words + (f'give "{name}"' if name else 'give a name, such as "centre"'))


def place_notes(scene: Scene, net: Net) -> Iterator[str]:
    """Yield a note for each named node that is off the place of its name by more than `OFF_NAME`."""
    for key, name in _nodes(scene):
        if isinstance(name, str) and net.distance_from_name(name) > OFF_NAME * _shortest_side(
            net, scene.net.divisions
        ):
            words = f'the knot nearest to "{name}" is {net.distance_from_name(name):.3g} m off it'
            remedy = ": an even number of meshes has a knot there" if name == "centre" else ""
            yield f"{key}: {words} (node {net.node(name)}){remedy}"


def _nodes(scene: Scene) -> Iterator[tuple[str, int | str]]:
    """Yield the keys that name a node of the net, with its number or name."""
    ends: dict[str, object] = {}
    for name, keys in scene.tethers.items():
        ends |= {f"tethers.{name}.start.node": keys.start.node, f"tethers.{name}.end.node": keys.end.node}
    for name, body in scene.bodies.items():
        for label, item in body.attachments.items():
            ends[f"bodies.{name}.attachments.{label}.node"] = item.node
    if isinstance(line := scene.closing, ClosingLine):
        ends |= {f"closing.nodes[{k}]": node for k, node in enumerate(line.nodes or ())}
        for where, end in (("start", line.start), ("end", line.end)):
            ends[f"closing.{where}.node"] = None if end is None else end.node
    yield from ((key, node) for key, node in ends.items() if isinstance(node, int | str))


def _outside(key: str, words: str, value: float, bounds: tuple[float, float], unit: str) -> Iterator[Fault]:
    if not bounds[0] <= value <= bounds[1]:
        yield Fault(
            key, f"{words} of {value:.3g} {unit} is not between {bounds[0]:g} and {bounds[1]:g} {unit}"
        )


def materials(mission: _Mission) -> Iterator[Fault]:
    """Modulus, density, strength and thickness of each thread, and of the closing line."""
    scene, side = mission.scene, _shortest_side(mission.net, mission.scene.net.divisions)
    damping = scene.effects.get(MaterialDamping)
    for key, cable in cables(scene).items():
        length = float(getattr(cable, "length", side))
        yield from _outside(f"{key}.youngs_modulus", "modulus", cable.modulus, MODULUS, "Pa")
        yield from _outside(f"{key}.density", "density", cable.density, DENSITY, "kg/m3")
        diameter = math.sqrt(4.0 * cable.cross_section / math.pi)
        name = f"{key}.diameter" if cable.diameter is not None else f"{key}.area"
        if diameter > THICK * length:
            yield Fault(name, f"a thread {diameter:.3g} m thick is more than a tenth of its {length:g} m")
        if diameter < THINNEST:
            yield Fault(name, f"a thread {diameter:.3g} m thick is thinner than a single fibre")
        if cable.strength is not None and cable.strength / cable.cross_section > STRENGTH:
            stress = cable.strength / cable.cross_section
            yield Fault(f"{key}.strength", f"a stress of {stress:.3g} Pa is beyond any fibre")
        elif cable.strength is not None:
            strain = cable.strength / (cable.modulus * cable.cross_section)
            if strain < STRAIN[0]:
                yield Fault(
                    f"{key}.strength", f"is reached at a strain of {strain:.2g}, before any fibre breaks"
                )
        if not MODULUS[0] <= cable.modulus <= MODULUS[1]:
            continue  # damping follows from the modulus
        if damping is None or not damping.relaxation_time or key.startswith("tethers") or length == math.inf:
            continue
        whole = critical_time(cable, length)
        ratio = damping.relaxation_time / whole
        if not DAMPING[0] <= ratio <= DAMPING[1]:
            words = f"damps the first axial mode of {key} with {ratio:.2g} of the critical damping: "
            words += f"give {DAMPING[0] * whole:.1g} s to {DAMPING[1] * whole:.1g} s"
            yield Fault("effects.material_damping.relaxation_time", words)
    if isinstance(line := scene.closing, ClosingLine):
        if line.linear_density > LINE:
            words = f"{line.linear_density:g} kg/m are more than those of a steel rope of 16 mm"
            yield Fault("closing.linear_density", words)
        elif line.linear_density > 0.0:
            ratio = line.stiffness / line.linear_density
            yield from _outside("closing.stiffness", "a ratio to linear_density", ratio, SPECIFIC, "m2/s2")
        if line.strength is not None:
            strain = line.strength / line.stiffness
            yield from _outside("closing.strength", "a strain at the strength", strain, STRAIN, "m/m")


def cord_notes(scene: Scene) -> Iterator[str]:
    """Yield a note for each cable with values that follow from its material, with their sources."""
    yield from (f"{key}: {cable.assumed}" for key, cable in cables(scene).items() if cable.assumed)


def _shortest_side(net: Net, divisions: int) -> float:
    """Shortest side of a net, strings and tethers left out [m]; infinite without sides."""
    own = slice(net.n_net_elements)
    sides = net.reference_length[own][~net.is_string[own]]
    return divisions * float(sides.min(initial=math.inf))


def critical_time(cable: Cable, length: float) -> float:
    """Compute the relaxation time [s] that damps the first axial mode of a thread critically.

    Its angular frequency is w = pi c / length with c^2 = E / density, its damping ratio tau w / 2.
    """
    return 2.0 * length / (math.pi * math.sqrt(cable.modulus / cable.density))


def damping_note(scene: Scene, net: Net) -> str | None:
    """Return what too little damping of taut threads means, with the relaxation times that damp them.

    The stiffness-proportional part of Rayleigh damping damps taut threads as a relaxation time does.
    """
    damping, rayleigh = scene.effects.get(MaterialDamping), scene.effects.get(RayleighDamping)
    time = (damping.relaxation_time if damping else 0.0) + (rayleigh.beta if rayleigh else 0.0)
    side = _shortest_side(net, scene.net.divisions)
    whole = critical_time(scene.net.cable, side)
    if math.isinf(side) or time >= CONVERGES * whole:
        return None
    damped = f"damped with {time / whole:.2g} of the critical damping" if time else "undamped"
    bounds = f"{CONVERGES * whole:.2g} to {DAMPING[1] * whole:.2g} s"
    return (
        f"taut threads are {damped}: largest tensions depend on net.divisions; "
        f"effects.material_damping with a relaxation_time of {bounds} lowers that"
    )


def bodies(mission: _Mission) -> Iterator[Fault]:
    """Density of each body and speed of its corners."""
    for name, body in mission.scene.bodies.items():
        if (extent := extents(body)) is None:
            continue
        if body.mass is not None and body.motion == "free":
            solids = [part.solid for part in body.parts.values()] or [body.solid]
            density = body.mass / math.fsum(of_solid(solid).mass for solid in solids)
            yield from _outside(f"bodies.{name}.mass", "a mean density", density, BODY_DENSITY, "kg/m3")
        corner = extent[1] * math.hypot(*body.angular_velocity)
        if corner > RIM_SPEED:
            words = f"moves the corners of the body at {corner:.3g} m/s (degrees instead of radians?)"
            yield Fault(f"bodies.{name}.angular_velocity", words)


def environment(mission: _Mission) -> Iterator[Fault]:
    """Gravity, air and orbit."""
    effects = mission.scene.effects
    if (gravity := effects.get(Gravity)) is not None:
        size = math.hypot(*gravity.acceleration)
        if size > GRAVITY:
            yield Fault("effects.gravity.acceleration", f"{size:.4g} m/s2 is above that of any planet")
    if (air := effects.get(AirDrag)) is not None and air.density > AIR:
        yield Fault("effects.air_drag.density", f"{air.density:g} kg/m3 is denser than any air")
    for name, effect in effects.on.items():
        altitude = effect.altitude if isinstance(effect, CircularOrbitConfig | MolecularDrag) else None
        if altitude is not None and altitude < ATMOSPHERE:
            words = f"{altitude:g} m is within the atmosphere (kilometres instead of metres?)"
            yield Fault(f"effects.{name}.altitude", words)


def bullets(mission: _Mission) -> Iterator[Fault]:
    """Bullets against the net, and the radius with which they touch."""
    scene, net = mission.scene, mission.net
    if not isinstance(scene.net, ThrownNetConfig) or scene.net.bullets is None:
        return
    mass = scene.net.bullets.mass
    every = mass * len(net.bullet_nodes)
    own = float(net.mass[: net.n_net_nodes].sum()) - every
    words = f"all bullets have {every:.3g} kg, the net {own:.3g} kg"
    if every < BULLETS[0] * own:
        yield Fault("net.bullets.mass", f"{words}: they hardly open it")
    if every > BULLETS[1] * own:
        yield Fault("net.bullets.mass", f"{words} (grams instead of kilograms?)")


def contact(mission: _Mission) -> Iterator[Fault]:
    """Friction and damping, radii of what touches, and how deep it gets at the speed of the approach."""
    scene = mission.scene
    for name, law in scene.effects.on.items():
        speed = law.impact_speed or 0.0 if isinstance(law, ImpactDampingConfig) else 0.0
        if speed > FASTEST:
            words = f"{speed:g} m/s is faster than any net is thrown (mm/s instead of m/s?)"
            yield Fault(f"effects.{name}.impact_speed", words)
    keys = scene.effects.get(Contact)
    if keys is None:
        return
    if keys.friction is not None and keys.friction.coefficient > FRICTION:
        words = f"{keys.friction.coefficient:g} is more than that of soft rubber"
        yield Fault("effects.contact.friction.coefficient", words)
    for name in set(keys.bullets).difference(keys.threads, keys.nodes):
        words = f"are all that touches {name!r}: threads fly through it unless effects.contact.threads has it"
        yield Fault("effects.contact.bullets", words)
    for name in ("bullet_radius", "node_radius"):
        radius = getattr(keys, name)
        if radius is not None and radius > 0.1 * mission.net.size:
            yield Fault(f"effects.contact.{name}", f"{radius:g} m is more than a tenth of the net's size")
    if mission.approach is None or mission.target is None or not isinstance(keys, LinearContact):
        return
    extent = extents(scene.bodies[mission.target.name])
    speed, cable = mission.approach.speed, scene.net.cable
    if extent is None or speed <= 0.0:
        return
    depths = {}
    if mission.target.name in keys.threads:
        depths["stiffness"] = speed * math.sqrt(cable.density * cable.cross_section / keys.of_threads)
    if mission.target.name in keys.bullets and isinstance(scene.net, ThrownNetConfig) and scene.net.bullets:
        depths["bullet_stiffness"] = speed * math.sqrt(scene.net.bullets.mass / keys.of_bullets.stiffness)
    for name, depth in depths.items():
        if depth > 0.5 * extent[0]:
            words = f"at {speed:.3g} m/s lets what touches in by {depth:.3g} m, more than half of the "
            words += f"body's thickness of {2.0 * extent[0]:.3g} m"
            yield Fault(f"effects.contact.{name}", words)


def flight(mission: _Mission) -> Iterator[Fault]:
    """Whether a net that is thrown reaches the target before the end."""
    scene = mission.scene
    key = "launch" if scene.launch is not None else "initial.velocity"
    if mission.thrown and mission.speed > FASTEST:
        yield Fault(key, f"throws the net at {mission.speed:.4g} m/s")
    approach, target = mission.approach, mission.target
    if approach is None or target is None or scene.capture is None:
        return
    speed, away = approach.speed, f"the target, {approach.distance:.3g} m away"
    if scene.capture.duration >= scene.time.end:
        words = f"is not shorter than the run, {scene.time.end:g} s: nothing can be captured"
        yield Fault("capture.duration", words)
    arrival = (mission.eject or 0.0) + approach.time
    if speed == 0.0 or approach.along <= 0.0:
        yield Fault(key, f"the net does not approach {away}")
    elif target.radius and approach.offset > math.sqrt(0.5) * mission.net.size + target.radius:  # no mesh
        words = f"lets the net, {mission.net.size:g} m wide, pass {approach.offset:.3g} m beside the target"
        yield Fault(key, words)
    elif arrival > scene.time.end:
        yield Fault("time.end", f"is before the net reaches {away}, at {speed:.3g} m/s: {arrival:.3g} s")
    elif scene.capture.duration < scene.time.end < arrival + scene.capture.duration:
        words = f"the net reaches {away}, after {arrival:.3g} s: too late to hold it for capture.duration"
        yield Fault("time.end", words)
    if (extent := extents(scene.bodies[target.name])) is not None:
        if 2.0 * extent[0] > mission.net.size:
            words = f"is {2.0 * extent[0]:.3g} m wide at least, the net {mission.net.size:.3g} m"
            yield Fault(f"bodies.{target.name}", words)
        if scene.capture.mouth is not None and scene.capture.mouth > 2.0 * extent[1]:
            words = f"is wider than the whole target, {2.0 * extent[1]:.3g} m, which gets out of it"
            yield Fault("capture.mouth", words)


def tethers(mission: _Mission) -> Iterator[Fault]:
    """Tethers and reels that stop the net before the target."""
    scene = mission.scene
    if mission.approach is None or mission.target is None or mission.approach.along <= 0.0:
        return
    distance = mission.approach.along - mission.target.radius
    for name, keys in scene.tethers.items():
        body = next((end.body for end in (keys.start, keys.end) if end.body is not None), None)
        if body is None or (keys.start.body is not None and keys.end.body is not None):
            continue
        anchor = _anchor(scene, keys, body)
        need = float(np.linalg.norm(mission.target.centre - anchor)) - mission.target.radius
        key = f"tethers.{name}"
        if keys.length < need:
            yield Fault(f"{key}.length", f"{keys.length:g} m do not reach the target, {need:.3g} m away")
        if keys.reel is None:
            continue
        outside = keys.length if keys.reel.paid_out is None else keys.reel.paid_out
        slack = max(0.0, outside - float(np.linalg.norm(mission.start[0] - anchor)))
        yield from _brakes(mission, name, keys.reel, slack, distance)
        if any(entry.drive == name for entry in scene.script):
            continue
        if not keys.reel.commands and outside < need:
            yield Fault(
                f"{key}.reel", f"is locked with {outside:g} m outside: the target is {need:.3g} m away"
            )
        if outside + keys.reel.rate_limit * scene.time.end < need:
            words = f"pays out {keys.reel.rate_limit:.3g} m/s at most: the target is {need:.3g} m away"
            yield Fault(f"{key}.reel.largest_rate", words)


def _brakes(mission: _Mission, name: str, reel: Reel, slack: float, distance: float) -> Iterator[Fault]:
    """A brake that stops the net before the target; slack : way to where the tether becomes taut [m]."""
    commands, launch = list(_commands(mission.scene, name, reel)), mission.speed
    first = next((k for k, (_, _, force) in enumerate(commands) if force is not None), None)
    if first is None or reel.damping is None or not launch > 0.0:
        return
    keys, net = mission.scene.tethers[name], mission.net
    tied = net.reference_position[(keys.end if keys.end.body is None else keys.start).node_of(net)]
    own = net.reference_position[: net.n_net_nodes]
    reach = float(np.linalg.norm(own - tied, axis=1).max())  # of the net beyond the tether's end
    mass = float(net.mass[: net.n_net_nodes].sum())
    thrown = mission.eject or 0.0
    speed, taut = launch, thrown + slack / launch
    way = launch * (max(commands[first][1], taut) - thrown)
    for (key, start, force), (_, end, _) in pairwise([*commands[first:], ("", math.inf, None)]):
        if force is None or way >= distance - reach:
            return
        if (time := end - max(start, taut)) <= 0.0:
            continue
        pull, before = force + reel.damping * speed, speed
        braked, speed = _braked(mass, speed, force, reel.damping, time)
        way += braked
        if speed <= STOPPED * launch and way < distance - reach:
            words = f"pulls {pull:.3g} N (force + damping x speed) at {before:.3g} m/s and stops the net "
            words += f"after {way:.2g} m: the target is {distance:.3g} m away, the net reaches {reach:.2g} m"
            yield Fault(key, words)
            return


def _commands(scene: Scene, name: str, reel: Reel) -> Iterator[tuple[str, float, float | None]]:
    """Yield key, time [s] and, of a brake, force [N] of each command of a tether's reel at a known time."""
    for k, item in enumerate(reel.commands):
        yield f"tethers.{name}.reel.commands[{k}]", item.at, item.force if item.mode == "brake" else None
    for row in timeline(scene.script):
        if row.time is not None and row.entry.drive == name:
            brakes = row.entry.do in ("brake", "release")
            key = f"script[{scene.script.index(row.entry)}]"
            yield key, row.time, row.entry.drive_force or 0.0 if brakes else None


def _braked(mass: float, speed: float, force: float, damping: float, time: float) -> tuple[float, float]:
    """Compute the way [m] of a mass that a brake F + c v slows until a time, or stops, and its speed [m/s].

    From m v' = -F - c v: v + F / c decays with the rate c / m.
    """
    if force > 0.0:
        time = min(time, mass / damping * math.log1p(damping * speed / force))
    lost = -(speed + force / damping) * math.expm1(-damping * time / mass)
    return (mass * lost - (force and force * time)) / damping, speed - lost


def _anchor(scene: Scene, keys: Tether, body: str) -> Floats:
    """Return where a tether is tied to a body, at the start [m]."""
    end = keys.start if keys.start.body == body else keys.end
    config = scene.bodies[body]
    turn = rotation_matrix(np.array(config.quaternion))
    return np.asarray(np.array(config.position) + turn @ np.array(end.point or (0.0, 0.0, 0.0)))


def closing(mission: _Mission) -> Iterator[Fault]:
    """A winch that cannot close the mouth: too slow in its time, or to a line that stays too long."""
    scene, keys = mission.scene, mission.scene.closing
    if not isinstance(keys, ClosingLine) or keys.winch is None:
        return
    winch, capture = keys.winch, scene.capture
    if capture is not None and capture.mouth is not None and winch.shortest > math.pi * capture.mouth:
        width = winch.shortest / math.pi
        words = f"leaves the mouth {width:.2g} m wide: capture.mouth is {capture.mouth:g} m"
        yield Fault("closing.winch.shortest", words)
    drives = [drive for drive in winch.drives if drive.rate > 0.0]
    if winch.damping is not None:
        drives += [drive_of(entry, winch.damping) for entry in scene.script if entry.do == "close"]
    if not drives:
        return
    rate = max(min(drive.rate, drive.gives * drive.force or drive.rate) for drive in drives)
    rate, length = min(rate, winch.rate_limit), keys.length - winch.shortest
    if length > rate * scene.time.end:
        words = f"winds up {rate:.3g} m/s at most: {length:.3g} m take longer than the run"
        yield Fault("closing.winch", words)


def stored_times(mission: _Mission) -> Iterator[Fault]:
    """Stored times after the end."""
    time = mission.scene.time
    if time.output_step is not None and not reached(time.end, time.output_step):
        words = f"{time.output_step:g} s is longer than the run, {time.end:g} s: two states are stored"
        yield Fault("time.output_step", words)


def script(mission: _Mission) -> Iterator[Fault]:
    """Entries after the end of the run."""
    for k, entry in enumerate(mission.scene.script):
        if entry.at is not None and not reached(mission.scene.time.end, entry.at):
            yield Fault(f"script[{k}].at", f"is after time.end, {mission.scene.time.end:g} s")


RULES: tuple[Callable[[_Mission], Iterator[Fault]], ...] = (
    materials,
    bodies,
    environment,
    bullets,
    contact,
    flight,
    tethers,
    closing,
    stored_times,
    script,
)

"""Forces and accelerations of a system, eqs. (3), (10), (12), (13), (16), and the power that leaves it.

x is the array (n, 3) of nodal positions [m], v that of velocities [m/s]; d_e = x_j - x_i.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_array

from reference_impl import contact_forces, held, mirror
from reference_impl.arrays import Bools, Floats, dot
from reference_impl.bodies import BodyStates, turning, turning_rate
from reference_impl.body_forces import bear, give_where_touched, given_by_driven, on_bodies, press, propel
from reference_impl.closing import Closing, Edge, Line, order_at, pull, shrink
from reference_impl.effects.drag import bullet_drag, cable_drag, molecular_force
from reference_impl.effects.orbit import orbital_acceleration
from reference_impl.elements import (
    carried,
    damping,
    length,
    secant,
    span,
    strain,
    strain_of,
    stress,
    tangent,
    tangent_element,
    tension,
)
from reference_impl.launch import reaction
from reference_impl.reels import LOCKED, Outlets, Wound, pay
from reference_impl.self_contact import met
from reference_impl.state import BY_STATE, Mode, Response, Whole
from reference_impl.system import System, assemble


def gather(system: System, element_force: Floats) -> Floats:
    """Nodal sums (n, 3) of element forces (m, 3) acting with + on end j, - on end i."""
    if system.symmetric:
        return mirror.gather(element_force, -element_force, system.leaves)
    return np.asarray(system.incidence @ element_force)


def share(system: System, element_force: Floats) -> Floats:
    """Nodal sums (n, 3) of element forces (m, 3), half of each on either end."""
    half = 0.5 * element_force
    if system.symmetric:
        return mirror.gather(half, half, system.leaves)
    return np.asarray(system.touching @ half)


def elastic_forces(system: System, x: Floats) -> Floats:
    """Nodal forces S(x) x (n, 3) [N] of eqs. (10), (12), without forming the matrix."""
    d = span(system, x)
    per_length = system.axial_stiffness * carried(system, strain_of(system, d)).stress
    return gather(system, per_length[:, None] * d)


def _pull(system: System, d: Floats, v: Floats, mode: Mode, changing: list[Outlets]) -> tuple[Floats, float]:
    """S11 A/L of eq. (3) (m,) [N/m] with the viscous part of material_damping, and the power it takes [W].

    S11 = E max(E11 + tau dE11/dt, 0) where E11 > 0: a cable cannot push.  Broken elements carry nothing.
    Elements of `changing` lengths have their own; those on drums are slack, their ends coincide.
    """
    e11 = strain_of(system, d)
    if mode.intact is not None:
        e11 = np.where(mode.intact, e11, -1.0)
    pulled = carried(system, e11)
    elastic = system.axial_stiffness * pulled.stress
    tau = system.effects.relaxation_time
    if not tau:
        for some in changing:
            elastic[some.element] = some.per_length
        return np.asarray(elastic), 0.0
    rate = dot(d, span(system, v)) / system.squared_reference_length
    straining = np.where(elastic > 0.0, pulled.viscous * rate, 0.0)
    viscous = np.maximum(tau * system.axial_stiffness * straining, -elastic)
    taken = 0.0
    for some in changing:
        elastic[some.element], viscous[some.element] = some.per_length, 0.0
        taken += some.taken
    return np.asarray(elastic + viscous), taken + float(
        np.sum(viscous * rate * system.squared_reference_length)
    )


def _drag(system: System, v: Floats) -> tuple[Floats, float]:
    """Viscous element forces beta T_e(x_ref) v_e (m, 3) [N] and the power v^T beta T v they take [W]."""
    rate = dot(system.reference_direction, span(system, v))
    force = system.effects.beta * system.axial_stiffness * rate
    return np.asarray(force[:, None] * system.reference_direction), float(force @ rate)


def of_elements(
    system: System, x: Floats, v: Floats, mode: Mode, changing: list[Outlets]
) -> tuple[Floats, float]:
    """-S(x) x - D v (n, 3) [N] and the power taken [W]; elements of `changing` lengths have their own."""
    way = _assembled_forces if system.assembled else _element_forces
    return way(system, x, v, mode, changing)


def _element_forces(
    system: System, x: Floats, v: Floats, mode: Mode, changing: list[Outlets]
) -> tuple[Floats, float]:
    """-S(x) x - D v (n, 3) [N], element by element, and the power taken [W]."""
    d = span(system, x)
    per_length, power = _pull(system, d, v, mode, changing)
    element_force = per_length[:, None] * d
    if system.effects.bending is not None:
        element_force += system.hinges.pull(d)
    if system.effects.beta:
        viscous, taken = _drag(system, v)
        element_force += viscous
        power += taken
    push = -gather(system, element_force)
    if system.effects.alpha or system.effects.mass_damping:
        external = system.drag * v
        power += float(np.vdot(external, v))
        push -= external
    return push, power


def _assembled_forces(
    system: System, x: Floats, v: Floats, mode: Mode, changing: list[Outlets]
) -> tuple[Floats, float]:
    """The same with the matrices S(x) and D of eqs. (12), (13): other round-off, nothing else."""
    d = span(system, x)
    per_length, power = _pull(system, d, v, mode, changing)
    pattern, scatter = system.graph
    stiffness = csr_array((scatter @ per_length, pattern.indices, pattern.indptr), shape=pattern.shape)
    push = -(stiffness @ x)
    if system.effects.bending is not None:
        push -= gather(system, system.hinges.pull(d))
    if system.effects.alpha or system.effects.beta or system.effects.mass_damping:
        external = system.damping @ v.ravel()
        power += float(external @ v.ravel())
        push -= external.reshape(v.shape)
    return push, power


__all__ = [
    "Response",
    "System",
    "Whole",
    "acceleration",
    "assemble",
    "damping",
    "dot",
    "elastic_forces",
    "gather",
    "length",
    "motion",
    "response",
    "secant",
    "span",
    "strain",
    "stress",
    "tangent",
    "tangent_element",
    "tension",
]


def acceleration(
    system: System,
    t: float,
    x: Floats,
    v: Floats,
    bodies: BodyStates | None = None,
    intact: Bools | None = None,
    reels: Wound | None = None,
    gone: Bools | None = None,
    drawn: Floats | None = None,
) -> Floats:
    """dv/dt (n, 3) [m/s2], eq. (16), at any finite x, v (n, 3) [m, m/s]; zero at fixed nodes.

    `bodies` (b, ...) is needed where a body acts on the net (launch_force, points of bodies); these points
    are where it says, with their accelerations, and so is a net that a body holds at t.  Elements that are
    not `intact` (m,) carry no load.  `reels` (R,) is needed where there are any.  Bullets that are `gone`
    (k,) are not pushed by launch_force.  `drawn` (1,) is the amount of what closes the mouth
    (`closing.Drawn`), needed where something does.  Friction that sticks has nothing to remember here.
    Raises ValueError without the bodies, reels or amount that it needs.
    """
    n, levers = len(system.net.mass), system.levers
    if bodies is None:
        if system.effects.launch_force is not None:
            raise ValueError("launch_force acts between bullets and chaser: give the states of the bodies")
        if len(levers):
            raise ValueError("nodes are points of bodies: give the states of the bodies")
        if system.contacts is not None:
            raise ValueError("threads, nodes or bullets touch bodies: give the states of the bodies")
        if system.packs(t):
            raise ValueError("a body holds the net: give the states of the bodies")
        return motion(system, t, x, v, Mode(intact), drawn)[0][:n]
    attitude, own = bodies.attitude, bodies.angular_velocity
    spin = np.einsum("bij,bjk,bk->bi", attitude, system.bodies.inertia, own)
    w, lever = np.einsum("bij,bj->bi", attitude, own), levers.turned(attitude)
    x, v = np.concatenate((x, bodies.position)), np.concatenate((v, bodies.velocity))
    x[levers.node] = levers.places(bodies.position, lever)
    v[levers.node] = levers.velocities(bodies.velocity, w, lever)
    packed = held.load(system, None, system.packs(t))
    lever_of_packed = packed.turned(attitude)
    x[packed.node] = packed.places(bodies.position, lever_of_packed)
    v[packed.node] = packed.velocities(bodies.velocity, w, lever_of_packed)
    whole = Whole(x, v, attitude, spin, drawn=drawn)
    if reels is not None and system.reels is not None:
        whole = Whole(x, v, attitude, spin, reels.wound_up, reels.held, drawn=drawn)
        held.place(system, x, reels.held)
        held.place(system, v, reels.held)
    pushed = None
    if gone is not None and (launch := system.effects.launch_force) is not None:
        pushed = ~gone & (system.ways(x, attitude) < launch.stroke)
    found = response(system, t, whole, Mode(intact, pushed))
    given, turned = system.bodies.accelerations(t)
    free = system.bodies.free[:, None]
    linear = found.acceleration[n:] + given
    angular = turned + free * turning_rate(attitude, spin, found.torque, system.bodies)
    result = found.acceleration[:n].copy()
    result[levers.node] = levers.accelerations(linear, angular, w, lever)
    result[packed.node] = packed.accelerations(linear, angular, w, lever_of_packed)
    if whole.held is not None:
        held.place(system, result, whole.held)
    return result


def motion(
    system: System, t: float, x: Floats, v: Floats, mode: Mode = BY_STATE, drawn: Floats | None = None
) -> tuple[Floats, float]:
    """dv/dt of eq. (16) (N, 3) [m/s2] of nodes and bodies, and the power that leaves the system [W].

    x, v (N, 3) [m, m/s] are those of the n nodes and then of the bodies; without bodies, N = n.  Bodies
    are taken to rest in the scene's axes; `response` knows how they turn.
    """
    b = len(system.bodies.names)
    found = response(
        system, t, Whole(x, v, np.tile(np.eye(3), (b, 1, 1)), np.zeros((b, 3)), drawn=drawn), mode
    )
    return found.acceleration, found.power


def response(system: System, t: float, whole: Whole, mode: Mode = BY_STATE) -> Response:
    """What the forces of eq. (10) do to nodes and bodies in this state.

    The power is v^T D v of eq. (10), what the drags take, and, negative, what thrust puts in.  An absent
    effect takes a comparison.
    """
    x, v, n = whole.x, whole.v, len(system.net.mass)
    nodes, speeds = (x, v) if len(x) == n else (x[:n], v[:n])
    outlets, edge = _outlets(system, t, whole, mode), _shrinking(system, t, whole, mode)
    changing = [some for some in (outlets, edge) if some is not None]
    push, power = of_elements(system, nodes, speeds, mode, changing)
    drawing = np.empty(0)
    if edge is not None:
        drawing = np.array([_rate_of_part(system, t, mode), math.fsum(edge.power.tolist())])
        power -= float(drawing[1])
    elif isinstance(line := system.closing, Line):
        pulled = pull(system, line, _order(line, t, mode), nodes, speeds, _amount(whole))
        push += pulled.force
        power += pulled.taken - pulled.power
        drawing = np.array([pulled.rate, pulled.power])
    effects = system.effects
    if system.meeting is not None:
        found = met(system.meeting, nodes, speeds)
        push += found.on_nodes
        power += found.taken
    if any(effects.gravity):
        push += system.weight
    if effects.solar_pressure is not None:
        push += system.sunlight
    for force in _working(system, t, nodes, speeds, mode):
        force[system.led] = 0.0  # what acts on these from outside is taken up by what drives them
        push += force
        power -= float(np.vdot(force, speeds))
    beside, torque, thrown = np.zeros((len(x) - n, 3)), np.zeros_like(whole.spin), None
    if system.barrels is not None:
        thrown = _pushes(system, whole, mode)
        push[system.net.bullet_nodes] += thrown
        back, turn = reaction(thrown, system.bullets_from_chaser(x))
        beside[system.barrels.body] = back / system.bodies.mass[system.barrels.body]
        torque[system.barrels.body] = turn
    packed = system.packs(t) if whole.packed is None else bool(np.any(whole.packed))
    pressed = _touched(system, whole, mode, packed)
    for body, force in pressed.on_nodes:
        press(system, whole, body, force, push, beside, torque)
    if system.contacts is not None:
        power += float(np.sum(pressed.taken))
    result = system.compliance_of_inertia * push
    if effects.orbit is not None:
        orbital = orbital_acceleration(effects.orbit, nodes, speeds)
        if effects.j2 is not None:
            orbital = orbital + nodes @ system.oblate.T
        result += np.where(system.compliance_of_inertia > 0.0, orbital, 0.0)
    if system.propelled:
        power -= propel(system, t, whole, mode, beside, torque)
    torque, taken = on_bodies(system, whole, push, beside, torque)
    given = given_by_driven(system, whole, push, thrown)
    give_where_touched(system, whole, pressed.on_nodes, given)
    if packed or outlets is not None:
        carried = held.load(system, whole.held, packed)
        bear(system, t, whole, carried, result, beside, torque, given)
    power += taken - (float(np.sum(given[:, 6])) if len(given) else 0.0)
    if outlets is not None:
        power -= float(np.sum(outlets.power))
    reeling = np.empty((2, 0)) if outlets is None else np.stack((outlets.rate, outlets.power))
    accelerations = np.concatenate((result, beside)) if len(beside) else np.asarray(result)
    return Response(accelerations, torque, power, given, reeling, pressed.taken, drawing)


def _pushes(system: System, whole: Whole, mode: Mode) -> Floats:
    """Forces (k, 3) [N] of launch_force on the bullets."""
    launch, barrels = system.effects.launch_force, system.barrels
    assert launch is not None
    assert barrels is not None
    push = launch.push(system.ways(whole.x, whole.attitude), mode.pushed)
    return np.asarray(push[:, None] * barrels.directions(whole.attitude))


def _touched(system: System, whole: Whole, mode: Mode, packed: bool) -> contact_forces.Touched:
    """The forces where bodies are touched."""
    contacts = system.contacts
    if contacts is None:
        return contact_forces.Touched([], np.zeros(2))
    e = np.zeros((contacts.pairs, 3)) if whole.bristles is None else whole.bristles
    return contact_forces.touched(contacts, seen(system, whole, packed), whole.attitude, mode.memory, e)


def seen(system: System, whole: Whole, packed: bool) -> list[contact_forces.View]:
    """What may touch bodies, as these see it."""
    w = turning(whole.attitude, whole.spin, system.bodies.mobility)
    return contact_forces.views(system, whole.x, whole.v, whole.attitude, w, whole.held, packed)


def _outlets(system: System, t: float, whole: Whole, mode: Mode) -> Outlets | None:
    """The outlets of the system's reels; None without any."""
    reels = system.reels
    if reels is None:
        return None
    if whole.wound_up is None or whole.held is None:
        raise ValueError("a tether has a reel: give how much of it is wound up, and the nodes on the drum")
    orders = reels.orders(t) if mode.orders is None else mode.orders
    return pay(system, reels, orders, whole.x, whole.v, whole.wound_up, whole.held)


def _amount(whole: Whole) -> float:
    """What is drawn of what closes the mouth, see `closing.Drawn`."""
    if whole.drawn is None:
        raise ValueError("something closes the mouth: give how much of it is drawn")
    return float(whole.drawn[0])


def _order(closing: Closing, t: float, mode: Mode) -> int:
    """Its command, see `closing.order_at`."""
    return order_at(closing, t) if mode.closing is None else mode.closing


def _shrinking(system: System, t: float, whole: Whole, mode: Mode) -> Outlets | None:
    """The elements of an edge that shrinks; None without."""
    if not isinstance(edge := system.closing, Edge):
        return None
    return shrink(system, edge, _order(edge, t, mode), whole.x, whole.v, _amount(whole))


def _rate_of_part(system: System, t: float, mode: Mode) -> float:
    """dp/dt [1/s] of an edge."""
    edge = system.closing
    assert isinstance(edge, Edge)
    return 0.0 if _order(edge, t, mode) == LOCKED else -edge.rate


def _working(system: System, t: float, x: Floats, v: Floats, mode: Mode) -> list[Floats]:
    """Forces (n, 3) [N] whose work is booked as it is done: of the drags and of thrust."""
    effects, forces = system.effects, []
    if effects.molecular_drag is not None:
        forces.append(molecular_force(effects.molecular_drag, system.swept, v))
    if effects.air_drag is not None:
        i, j = system.ends
        mean = 0.5 * (v.take(i, axis=0) + v.take(j, axis=0))
        force = share(system, cable_drag(effects.air_drag, system.frontal, span(system, x), mean))
        bullets = system.net.bullet_nodes
        force[bullets] += bullet_drag(effects.air_drag, v[bullets])
        forces.append(force)
    if effects.thrust is not None:
        force = np.zeros_like(v)
        force[system.thrusters] = effects.thrust.at(t, mode.segment)
        forces.append(force)
    return forces

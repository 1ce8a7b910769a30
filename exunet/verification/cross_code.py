"""Both codes at the same random states of a scene: forces and quantities.

The reference has each law written a second time: its own weave, rotations, closest points, quadrature along
threads and paths of closing lines. Functions of contact and closing laws are called as they are written; the
backends compile them from their text.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.contact.self_contact import NAME as SELF_CONTACT
from exunet.forces.from_outside import IMPULSE, OUTSIDE, effects_of
from exunet.forces.terms import KernelTerm, copied
from exunet.integrators.compiled.loop import loop_kernel
from exunet.integrators.compiled.workspace import Stages, motion_of
from exunet.kernels.compile import numba_installed
from exunet.model import energy
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.net.closing import NAME as CLOSING_LINE
from exunet.studies.both_codes import BothCodes, Floats
from exunet.verification import tolerances as tol
from exunet.verification.check import Check, difference, skipped, worst_of
from exunet.verification.random_states import (
    KINDS,
    in_contact,
    kinds_of,
    moved,
    random_bodies,
    threads_in_contact,
)
from exunet.verification.tolerances import Tolerance
from reference_impl import closing as their_closing
from reference_impl import contact_forces
from reference_impl import energy as their_energy
from reference_impl import forces as formulas
from reference_impl.bodies import turning_rate
from reference_impl.friction import nothing
from reference_impl.self_contact import met

SEED = 20210614
STATES = 20  # of each kind
Values = dict[str, Floats]
Observer = Callable[[State], Values]


class ComparedQuantity(NamedTuple):
    """Quantity that both codes have at a state.

    Parameters
    ----------
    unit : str
    tolerance : Tolerance
        Of the largest value among the states of a kind.
    axes : tuple of str
        What each axis of its values counts.
    floor : str
        Quantity of the reference whose largest value is the smallest divisor.
    rare : bool
        Errors are parts of the largest value among the states of all kinds; no row if that is zero.
    """

    unit: str
    tolerance: Tolerance
    axes: tuple[str, ...] = ("number",)
    floor: str = ""
    rare: bool = False


QUANTITIES = {
    "acceleration of points": ComparedQuantity("m/s2", tol.FORCES, ("node", "xyz")),
    "acceleration of bodies": ComparedQuantity("m/s2", tol.FORCES, ("body", "xyz")),
    "angular acceleration": ComparedQuantity(
        "rad/s2", tol.FORCES, ("body", "xyz"), "square of angular velocity"
    ),
    "position of attached nodes": ComparedQuantity("m", tol.BODY_PLACES, ("number", "xyz")),
    "velocity of attached nodes": ComparedQuantity("m/s", tol.BODY_PLACES, ("number", "xyz")),
    "rate of momentum": ComparedQuantity("N", tol.FORCES, ("xyz",), "sum of forces"),
    "rate of angular momentum": ComparedQuantity("N m", tol.FORCES, ("xyz",), "sum of torques"),
    "kinetic energy": ComparedQuantity("J", tol.MEASURES),
    "elastic energy": ComparedQuantity("J", tol.MEASURES),
    # Small where its terms cancel.
    "potential energy": ComparedQuantity("J", tol.MEASURES, rare=True),
    "momentum": ComparedQuantity("kg m/s", tol.MEASURES, ("xyz",)),
    "angular momentum": ComparedQuantity("kg m2/s", tol.MEASURES, ("xyz",)),
    "strain": ComparedQuantity("", tol.MEASURES, ("element",)),
    "tension": ComparedQuantity("N", tol.MEASURES, ("element",)),
    "dissipated power": ComparedQuantity("W", tol.MEASURES, rare=True),
    "contact force on nodes": ComparedQuantity("N", tol.CONTACT, ("node", "xyz")),
    "contact force on the body": ComparedQuantity("N", tol.CONTACT, ("xyz",)),
    "contact torque on the body": ComparedQuantity("N m", tol.CONTACT, ("xyz",)),
    "power dissipated by contact": ComparedQuantity("W", tol.CONTACT),
    "energy stored by contact": ComparedQuantity("J", tol.CONTACT),
    "rate of the closing": ComparedQuantity("m/s or 1/s", tol.CLOSING),
    "power of the closing": ComparedQuantity("W", tol.CLOSING),
    "viscous power of the closing": ComparedQuantity("W", tol.CLOSING),
    "energy stored by the closing": ComparedQuantity("J", tol.CLOSING),
}


@dataclass(frozen=True)
class StateComparison:
    """States of a scene, and the codes that have quantities there.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of states.
    states : callable
        Draws states: ``states(kind, count, random)``.
    codes : dict
        Name -> quantities of a part of exunet at a state.
    reference : callable
        The same quantities of the reference.
    stored : str
        Energy that must be positive in ...
    everywhere : bool
        ... every state, else in one at least.
    """

    kinds: Sequence[str]
    states: Callable[[str, int, np.random.Generator], Iterator[State]]
    codes: Mapping[str, Observer]
    reference: Observer
    stored: str = ""
    everywhere: bool = False


def at_states(case: BothCodes, states: int = STATES, compiled: bool = True) -> Iterator[Check]:
    """Compare forces, energies, momenta and laws of a case at some random states of each kind.

    Scenes with contact are compared in contact: two surfaces of other random states seldom touch.
    """
    if case.touches_itself:
        ends = case.start.net.element_nodes
        if len(np.unique(ends)) < ends.size:
            yield skipped("random states", "self-contact is compared at states of self_contact/together.toml")
            return
        yield from compared(self_contact(case), states)
    elif case.in_contact:
        if len(case.start.system.blocks.surfaces) > 1:
            yield skipped("random states", "contact is compared at states of cases/verification/contact")
            return
        yield from compared(contact(case), states)
    else:
        yield from compared(motion(case, compiled and numba_installed()), states)
        yield from compared(measures(case), states)
        if case.closes:
            yield from compared(closing(case), states)


def compared(comparison: StateComparison, states: int) -> Iterator[Check]:
    """Yield for each quantity and code the kind of states with the largest error."""
    random = np.random.default_rng(SEED)
    pairs: dict[tuple[str, str], dict[str, list[tuple[Floats, Floats]]]] = defaultdict(dict)
    floors: dict[tuple[str, str], float] = defaultdict(float)
    for kind in comparison.kinds:
        for state in comparison.states(kind, states, random):
            known = comparison.reference(state)
            for name, values in known.items():
                if values.size:
                    floors[name, kind] = max(floors[name, kind], float(np.abs(values).max()))
            for code, observe in comparison.codes.items():
                for name, values in observe(state).items():
                    pairs[name, code].setdefault(kind, []).append((values, known[name]))
    for (name, code), kinds in pairs.items():
        quantity = QUANTITIES[name]
        arrays = {
            kind: [np.array(side) for side in zip(*found, strict=True)] for kind, found in kinds.items()
        }
        if not any(a.size for a, _ in arrays.values()):
            continue
        scale = None
        if quantity.rare:
            scale = max(float(np.abs(side).max()) for both in arrays.values() for side in both)
            if scale == 0.0:
                continue
        axes = ("state", *quantity.axes)
        checks = [
            difference(
                kind, a, b, quantity.tolerance, axes[: a.ndim], quantity.unit,
                floors[quantity.floor, kind], scale,
            )
            for kind, (a, b) in arrays.items()
        ]  # fmt: skip
        yield worst_of(f"{name}, {code}", checks)
    if comparison.stored:
        energies = [b for found in pairs[comparison.stored, "law"].values() for _, b in found]
        active = sum(float(stored.sum()) > 0.0 for stored in energies)
        missing = len(energies) - active if comparison.everywhere else float(active == 0)
        where = f"{active} of {len(energies)} states"
        yield Check(f"states without {comparison.stored}", missing, tol.ACTIVE, where)


# Accelerations


def motion(case: BothCodes, compiled: bool = True) -> StateComparison:
    """Accelerations of points and bodies of Exudyn and of the compiled loop; attached nodes."""
    codes: dict[str, Observer] = {"Exudyn": _motion_of_engine(case)}
    if compiled:
        codes["compiled loop"] = _motion_of_loop(case)
    if len(case.start.system.kinematics.point):
        codes["arrays"] = partial(_attached, case)
    kinds = kinds_of(case.start)
    return StateComparison(
        kinds, partial(random_bodies, case.start), codes, partial(_motion_of_reference, case)
    )


def _motion_of_engine(case: BothCodes) -> Observer:
    probe, system = case.probe(), case.start.system

    def observe(state: State) -> Values:
        if state.discrete:
            probe.remember(system, state.discrete)
        points, bodies = probe.motion(state.moving, state.time)
        return _accelerations(system, state.bodies, points, bodies[:, :3], bodies[:, 3:])

    return observe


def _motion_of_loop(case: BothCodes) -> Observer:
    """Observe the accelerations from which the compiled loop steps on, attached nodes and rates of momenta.

    The latter only of scenes with momentum balances of their own effects, and without points that a body
    holds for a while: the shares of these are not among the accelerations.
    """
    system = case.start.system
    blocks, kernel, point = system.blocks, loop_kernel(system), system.kinematics.point
    first = Stages._fields.index("a1")
    outside = effects_of(item.name for item in blocks.states)
    prescribed = [
        body.name for body, free in zip(system.bodies, system.moves_freely, strict=True) if not free
    ]
    lines = [*(OUTSIDE + name for name in outside), *prescribed]
    rates = [blocks.rate(f"{name}/{IMPULSE}") for name in lines]
    if not outside or system.kinematics.held or not len(system.bodies):
        rates = []

    def observe(state: State) -> Values:
        motion = motion_of(system, state, kernel.table(state.discrete))
        kernel.module.begin(state.time, False, motion)
        work = motion.work[first]
        parts = np.split(work[: blocks.n_v], (3 * blocks.n_points, blocks.centres))
        found = _accelerations(system, state.bodies, *(part.reshape(-1, 3) for part in parts))
        moving = system.layout.unpack(motion.x, motion.v)
        found["position of attached nodes"] = moving.position[point]
        found["velocity of attached nodes"] = moving.velocity[point]
        if rates:
            impulse = np.sum([work[at : at + 6] for at in rates], axis=0)
            found |= {"rate of momentum": impulse[:3], "rate of angular momentum": impulse[3:]}
        return found

    return observe


def _accelerations(
    system: System, bodies: RigidStates, points: Floats, centres: Floats, angular: Floats
) -> Values:
    """Return accelerations in the scene's axes; prescribed points and bodies have none.

    angular : (n_free, 3) or more, in principal axes
    """
    free = np.flatnonzero(system.moves_freely)
    turn = rotation_matrix(bodies.attitude[free])
    values = (points * system.free[:, None], centres[free], np.einsum("bij,bj->bi", turn, angular[free]))
    return dict(zip(tuple(QUANTITIES)[:3], values, strict=True))


def _attached(case: BothCodes, state: State) -> Values:
    """Return positions and velocities (n_attached, 3) by whole arrays, as the states of a result are made."""
    kinematics = case.start.system.kinematics
    moving, point = state.moving.completed(kinematics, state.time, state.discrete), kinematics.point
    return {
        "position of attached nodes": moving.position[point],
        "velocity of attached nodes": moving.velocity[point],
    }


def _motion_of_reference(case: BothCodes, state: State) -> Values:
    """Return accelerations, attached nodes by lever arms, and rates of momenta about the origin."""
    system, theirs = case.start.system, case.theirs.system
    whole, response = case.reference_response(state)
    bodies, n, free = theirs.bodies, system.blocks.n_points, np.flatnonzero(system.moves_freely)
    acceleration = response.acceleration[case.reference_particles]
    angular = turning_rate(whole.attitude, whole.spin, response.torque, bodies)
    attached = case.reference_nodes[system.kinematics.point]
    force = np.append(theirs.net.own_mass, bodies.free * bodies.mass)[:, None] * response.acceleration
    torque = np.cross(whole.x, force)
    turning = np.concatenate([torque, bodies.free[:, None] * response.torque])
    return {
        "acceleration of points": acceleration[:n] * system.free[:, None],
        "acceleration of bodies": acceleration[n:][free],
        "angular acceleration": angular[case.reference_bodies][free],
        "square of angular velocity": state.bodies.angular_velocity**2,
        "position of attached nodes": whole.x[attached],
        "velocity of attached nodes": whole.v[attached],
        "rate of momentum": force.sum(axis=0),
        "rate of angular momentum": turning.sum(axis=0),
        "sum of forces": np.linalg.norm(force, axis=1).sum(keepdims=True),
        "sum of torques": np.linalg.norm(turning, axis=1).sum(keepdims=True),
    }


# Energies, momenta, strains


def measures(case: BothCodes) -> StateComparison:
    """Energies, momenta, strains, tensions and dissipated power as results have them."""
    codes = {"results": partial(_measures, case)}
    return StateComparison(KINDS, partial(moved, case.start), codes, partial(_measures_of_reference, case))


def _seen(case: BothCodes, state: State) -> State:
    """Return the state with nodes on a drum where the drum holds them: elements there have no length."""
    kinematics = case.start.system.kinematics
    if not kinematics.held:
        return state
    moving = state.moving.completed(kinematics, state.time, state.discrete)
    return State.of(state.time, moving, state.discrete)


def _measures(case: BothCodes, state: State) -> Values:
    state = _seen(case, state)
    ours, viscous = States.of(case.start.system, state), "material_damping" in case.effects
    found = {
        "kinetic energy": ours.kinetic[0],
        "elastic energy": ours.elastic[0],
        "potential energy": ours.potential[0],
        "momentum": ours.momentum[0],
        "angular momentum": ours.angular_momentum[0],
        "strain": ours.strain[0],
    }
    # The reference has the elastic tension: with viscous stress both are equal at rest only.
    if not viscous or not state.velocity.any():
        found["tension"] = ours.tension[0]
    # The work of viscous stress is integrated over steps: see the trajectories.
    if not viscous:
        power = energy.power_taken(case.start.system.forces, ours.time, ours.x, ours.v, state.discrete)
        found["dissipated power"] = power[0]
    return found


def _measures_of_reference(case: BothCodes, state: State) -> Values:
    state = _seen(case, state)
    system, elements, theirs = case.theirs.system, case.reference_elements, case.theirs_at(state.moving)
    x, v, bodies = theirs.x, theirs.v, theirs.bodies
    intact, wound = case.intact_in_reference(state), case.wound_in_reference(state)
    drawn = case.drawn_in_reference(state.first_order)
    lengths = their_energy.lengths(system, wound, drawn)
    stored = their_energy.at_outlets(system, x, wound)[1] + their_energy.of_closing(system, x, drawn)[1]
    pulling = None if lengths is not None else intact  # outlets pull, though no element of the net does
    return {
        "kinetic energy": their_energy.kinetic(system, v, bodies),
        "elastic energy": their_energy.elastic(system, x, intact),
        "potential energy": their_energy.potential(system, x, bodies) + stored,
        "momentum": their_energy.momentum(system, v, bodies),
        "angular momentum": their_energy.angular_momentum(system, x, v, bodies),
        "strain": formulas.strain(system, x, lengths)[elements],
        "tension": formulas.tension(system, x, pulling, lengths)[elements],
        "dissipated power": np.asarray(case.reference_motion(state)[1]),
    }


# Contact of a net with a body


def _terms(system: System, name: str) -> list[KernelTerm]:
    """Return the terms whose discrete state begins with a name."""
    return [term for term in system.forces.kernels if term.discrete and term.discrete.name.startswith(name)]


def contact(case: BothCodes) -> StateComparison:
    """Contact of threads, nodes or bullets with a body: forces, torque, power, energy."""
    states = partial(_of_one_kind, in_contact, case)
    codes = {"law": partial(_contact, case)}
    reference, stored = partial(_contact_of_reference, case), "energy stored by contact"
    return StateComparison(("in contact",), states, codes, reference, stored, everywhere=True)


def _of_one_kind(
    draw: Callable[..., Iterator[State]], case: BothCodes, _kind: str, *how: Any
) -> Iterator[State]:
    return draw(case.start, *how)


def _contact(case: BothCodes, state: State) -> Values:
    system = case.start.system
    blocks, n = system.blocks, case.start.net.n_nodes
    x, v = system.layout.pack(state.moving)
    force, stored = np.zeros(blocks.n_force), 0.0
    (name,) = blocks.surfaces
    for term in _terms(system, "contact/"):
        data = copied(term.data)  # contains work space
        term.add(state.time, x, v, data, force)
        assert term.potential is not None
        stored += float(term.potential(x, data))
    centre, spin, power = blocks.centre(name), blocks.spin(name), blocks.rate("contact/damping")
    return {
        "contact force on nodes": force[: 3 * n].reshape(n, 3),
        "contact force on the body": force[centre : centre + 3],
        "contact torque on the body": rotation_matrix(state.bodies.attitude[0]) @ force[spin : spin + 3],
        "power dissipated by contact": force[power : power + 2],
        "energy stored by contact": np.array([stored]),
    }


def _contact_of_reference(case: BothCodes, state: State) -> Values:
    system, theirs = case.theirs.system, case.theirs_at(state.moving)
    contacts, bodies = system.contacts, theirs.bodies
    assert contacts is not None
    views = contact_forces.view_of_states(system, theirs.x, theirs.v, bodies, None, False)
    discrete = nothing(contacts.pairs) if contacts.law.sticks else None
    found = contact_forces.touched(contacts, views, bodies.attitude, discrete, np.zeros((contacts.pairs, 3)))
    force = sum((forces for _, forces in found.on_nodes), np.zeros_like(theirs.x))
    arm = theirs.x - bodies.position[0]
    return {
        "contact force on nodes": case.from_reference(force),
        "contact force on the body": -force.sum(axis=0),
        "contact torque on the body": -np.cross(arm, force).sum(axis=0),
        "power dissipated by contact": found.taken,
        "energy stored by contact": np.array([contact_forces.stored(contacts, views)]),
    }


# Threads in contact with each other: the reference tests every pair, halves pieces along one thread and has a
# rule in an angle along the other (`reference_impl.self_contact`).


def self_contact(case: BothCodes) -> StateComparison:
    """Contact of threads with each other: forces, power, energy."""
    states = partial(_of_one_kind, threads_in_contact, case)
    codes = {"law": partial(_self_contact, case)}
    reference, stored = partial(_self_contact_of_reference, case), "energy stored by contact"
    return StateComparison(("in contact",), states, codes, reference, stored, everywhere=True)


def _self_contact(case: BothCodes, state: State) -> Values:
    system, n = case.start.system, case.start.net.n_nodes
    x, v = system.layout.pack(state.moving)
    force = np.zeros(system.blocks.n_force)
    (term,) = (kernel for kernel in system.forces.kernels if kernel.remember is not None)
    data = copied(term.data)
    term.add(state.time, x, v, data, force)
    assert term.potential is not None
    power = system.blocks.rate(f"{SELF_CONTACT}/damping")
    return {
        "contact force on nodes": force[: 3 * n].reshape(n, 3),
        "power dissipated by contact": force[power : power + 1],
        "energy stored by contact": np.array([float(term.potential(x, data))]),
    }


def _self_contact_of_reference(case: BothCodes, state: State) -> Values:
    system, theirs = case.theirs.system, case.theirs_at(state.moving)
    assert system.meeting is not None
    found = met(system.meeting, theirs.x, theirs.v)
    return {
        "contact force on nodes": case.from_reference(found.on_nodes),
        "power dissipated by contact": np.array([found.taken]),
        "energy stored by contact": np.array([found.stored]),
    }


# What closes the mouth of a net: one energy of path and length in the reference, from which follow forces,
# tension and the work of the winch (`reference_impl.closing`). A line with friction is not in it.


def closing(case: BothCodes) -> StateComparison:
    """Closing line or shortened edge: rate, powers and energy."""
    kinds, states = kinds_of(case.start), partial(random_bodies, case.start)
    codes = {"law": partial(_closing, case)}
    reference = partial(_closing_of_reference, case)
    return StateComparison(kinds, states, codes, reference, "energy stored by the closing")


def _closing_values(rate: float, power: float, viscous: float, stored: float) -> Values:
    return dict(zip(list(QUANTITIES)[-4:], np.array([rate, power, viscous, stored])[:, None], strict=True))


def _closing(case: BothCodes, state: State) -> Values:
    system = case.start.system
    (term,) = _terms(system, f"{CLOSING_LINE}/")
    assert term.discrete is not None
    assert term.discrete.data is not None
    assert term.potential is not None
    data = copied(term.discrete.data(state.discrete[term.discrete.name]))  # contains work space
    x, v = system.layout.pack(state.moving)
    force = np.zeros(system.blocks.n_force)
    term.add(state.time, x, v, data, force)
    first = system.blocks.rate(f"{CLOSING_LINE}/{'wound_up' if system.line else 'part'}")
    viscous = 0.0 if term.power is None else float(term.power(state.time, x, v, data))
    if any(item.name == f"{CLOSING_LINE}/viscosity" for item in system.blocks.states):
        viscous = float(force[system.blocks.rate(f"{CLOSING_LINE}/viscosity")])
    return _closing_values(force[first], force[first + 1], viscous, float(term.potential(x, data)))


def _closing_of_reference(case: BothCodes, state: State) -> Values:
    system, theirs = case.theirs.system, case.theirs_at(state.moving)
    drawn = case.drawn_in_reference(state.first_order)
    closing, amount = system.closing, float(drawn.amount[0])
    assert closing is not None
    stored = float(their_energy.of_closing(system, theirs.x, drawn)[1])
    order = their_closing.order_at(closing, state.time)
    if isinstance(closing, their_closing.Line):
        pulled = their_closing.pull(system, closing, order, theirs.x, theirs.v, amount)
        return _closing_values(pulled.rate, pulled.power, pulled.taken, stored)
    threads = their_closing.shrink(system, closing, order, theirs.x, theirs.v, amount)
    rate = -closing.rate if threads.rate.any() else 0.0
    return _closing_values(rate, float(threads.power.sum()), threads.taken, stored)

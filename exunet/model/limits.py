"""Limits of a case, checked before the run: initial state, floating-point range, number of steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import LARGEST, CaseError, Fault
from exunet.bodies import rigid
from exunet.bodies.kinematics import given_states
from exunet.forces import cable
from exunet.forces.blocks import AWAKE
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.cable_term import INTACT
from exunet.forces.closing import MEMORY as LINE
from exunet.forces.terms import KernelTerm, copied
from exunet.methods.config import SHORTEST_STEP
from exunet.methods.method import METHODS, Kind, Plan
from exunet.model import energy
from exunet.model.stability import largest_damping_rate, largest_frequency
from exunet.model.system import State, System
from exunet.net.arrays import Net
from exunet.scene.scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RESOLUTION = 1e-3  # spacing of floating-point positions, of the shortest element
MOST_STEPS = 1e10  # of a run; at a microsecond each, three hours for the smallest net


def overflow_faults(system: System, start: State) -> list[Fault]:
    """Return faults of initial values above `LARGEST`, whose products may overflow."""
    blocks, moving = system.blocks, start.bodies
    with np.errstate(all="ignore"):
        found = [
            ("initial", "kinetic energy at the start", energy.kinetic(system.mass, start.velocity)),
            ("initial.packing", "elastic energy at the start", energy.elastic(system.forces, start.position)),
            ("net", "mass of a node", blocks.mass[: system.net.n_nodes]),
            ("net", "inverse of a node's mass", 1.0 / blocks.mass[: system.net.n_nodes]),
            ("net", "cube of an element's length", system.net.reference_length**3),
        ]
        found += [
            ("effects", f"{what} of {name}", value)
            for name, k in blocks.body.items()
            for what, value in (
                ("mass", blocks.mass[k]),
                ("inverse of the mass", 1.0 / blocks.mass[k]),
            )
        ]
        for k, body in enumerate(system.bodies):
            alone, name = moving.of_body(k), f"bodies.{body.name}"
            mass, inertia = np.array([body.mass]), np.array([body.inertia])
            spin = alone.angular_velocity
            found += [
                (f"{name}.mass", "mass", mass),
                (f"{name}.mass", "inverse of the mass", 1.0 / mass),
                (f"{name}.inertia", "inertia", inertia),
                (f"{name}.inertia", "inverse of the inertia", 1.0 / inertia),
                (name, "kinetic energy at the start", rigid.kinetic(mass, inertia, alone)),
                (name, "angular momentum at the start", rigid.angular_momentum(mass, inertia, alone)),
                (name, "angular acceleration at the start", np.cross(inertia * spin, spin) / inertia),
            ]
    return [
        Fault(
            where,
            f"the {name} is outside the range of floating-point numbers",
            beyond_floats=True,
        )
        for where, name, values in found
        if not np.abs(values).max(initial=0.0) <= LARGEST
    ]


def body_faults(scene: Scene, system: System, start: State, known: list[Fault]) -> list[Fault]:
    """Return faults of bodies that rotate too often, or fly too far for the resolution of positions.

    A step must not exceed the time of a rotation by a radian. Bodies with an overflow among the `known`
    faults are left out.
    """
    overflowing = {
        fault.key.split(".")[1] for fault in known if fault.beyond_floats and "bodies." in fault.key
    }
    net, end, faults = system.net, scene.time.end, []
    for k, body in enumerate(system.bodies):
        name, alone = f"bodies.{body.name}", start.bodies.of_body(k)
        if body.name in overflowing:
            continue
        angle = float(np.linalg.norm(alone.angular_velocity)) * end
        if not angle <= min(MOST_STEPS, end / SHORTEST_STEP):
            words = f"the body rotates by {angle:.3g} rad until time.end (allowed: {MOST_STEPS:g} rad, and a "
            words += f"radian in {SHORTEST_STEP:g} s): reduce it, or time.end"
            faults.append(Fault(f"{name}.angular_velocity", words))
        place, path = float(np.abs(alone.position).max()), float(np.abs(alone.velocity).max() * end)
        far, key = place + path, "position" if place > path else "velocity"
        if np.isfinite(far) and not np.spacing(far) <= RESOLUTION * net.size:
            words = (
                f"the body moves to {far:.3g} m until time.end, where floating-point numbers have a spacing "
                f"of {np.spacing(far):.2g} m; the net has {net.size:.3g} m: reduce speed or distance"
            )
            faults.append(Fault(f"{name}.{key}", words, beyond_floats=True))
    return faults


def start_faults(scene: Scene, system: System, start: State) -> list[Fault]:
    """Return faults of an initial state of the net.

    An element must not start longer than the cable law is valid for, nor may its nodes separate so fast that
    it is within the shortest step. Positions must resolve the net where it flies to.
    """
    net, position, velocity = system.net, start.position, start.velocity
    natural = system.forces.cable.law.natural_length
    if not len(natural):
        return []
    with np.errstate(all="ignore"):  # speeds outside the floating-point range are faults here too
        # Tethers are straight at the start: short ones have a fault already.
        stretch = (cable.lengths(net, position) / natural)[: net.n_net_elements]
        stretch *= start.memory.get(INTACT, np.ones(net.n_elements))[: net.n_net_elements]
        rate = np.linalg.norm(cable.spans(net, velocity), axis=-1) / natural
    longest, fastest = int(np.argmax(stretch)) if len(stretch) else -1, int(np.argmax(rate))
    faults = []
    if longest >= 0 and not stretch[longest] <= STRETCH_BOUND:
        keys = (
            key for key in ("node_positions", "fold", "packing", "restart") if scene.initial.is_given(key)
        )
        reason = (
            f"{_element(net, longest)} starts at {stretch[longest]:.4g} times its stress-free length, above "
            f"{STRETCH_BOUND:g}, the limit of the cable law: move its nodes closer"
        )
        key = _attachments(system, net.element_nodes[longest]) or f"initial.{next(keys)}"
        faults.append(Fault(key, reason))
    if not rate[fastest] * SHORTEST_STEP <= 1.0:
        launched = scene.launch and np.isin(net.element_nodes[fastest], net.bullet_nodes).any()
        reason = (
            f"the nodes of {_element(net, fastest)} separate at {rate[fastest]:.3g} lengths a second: a "
            f"step of {SHORTEST_STEP:g} s cannot resolve: reduce the speeds"
        )
        faults.append(Fault("launch" if launched else "initial", reason))
    far = float(np.abs(position).max() + np.abs(velocity).max() * scene.time.end)
    spacing, shortest = np.spacing(far), natural.min()
    if not faults and not spacing <= RESOLUTION * shortest:
        reason = (
            f"a node may move to {far:.3g} m until time.end, where floating-point numbers have a spacing of "
            f"{spacing:.2g} m; the shortest element has {shortest:.3g} m: reduce speed or distance"
        )
        faults.append(Fault("initial", reason, beyond_floats=True))
    return faults


def contact_faults(system: System, start: State) -> list[Fault]:
    """Return faults of contacts that would stop the run at once: nodes or threads inside a body."""
    faults = []
    x, v = system.layout.pack(start.moving)
    for term in system.forces.kernels:
        memory = term.memory
        if term.remember is None or memory is None or memory.wrong is None:
            continue
        data = copied(term.data)  # work arrays included
        term.add(start.time, x, v, data, np.zeros(system.blocks.n_force))
        term.remember(start.time, x, v, data)
        if words := memory.wrong(getattr(data, memory.kept_in)):
            where = words.partition(":")[0]  # without the remedy
            reason = f"invalid start: {where}: increase the distance of net and body"
            faults.append(Fault(f"effects.{memory.name.partition('/')[0]}", reason))
    return faults


def _attachments(system: System, ends: Ints) -> str:
    """Return the key of the attachments of an element's ends; "" without any."""
    on = system.kinematics.tied_to[np.isin(system.kinematics.tied, ends)]
    return f"bodies.{system.blocks.rigid[on[0]]}.attachments" if len(on) else ""


def explicit_only(system: System) -> list[str]:
    """Describe the parts of a system that implicit methods do not support."""
    words = [f"a force that acts on {name}" for name in sorted(system.forces.on_bodies)]
    guided = [name for name, moves in zip(system.blocks.rigid, system.moves_freely, strict=True) if not moves]
    own = {state.name for name in guided for state in given_states(name)}
    others = (state.name for state in system.blocks.states if state.name not in own)
    words += [f"a force that has first-order states ({name})" for name in others]
    words += ["points that sleep"] * (system.blocks.awake is not None)
    return words + [f"a body that is fixed or prescribed ({name})" for name in guided]


def method_faults(system: System, start: State, plan: Plan) -> list[Fault]:
    """Return faults of the method in a scene."""
    faults, method = [], plan.method
    if METHODS[method].kind == Kind.IMPLICIT:
        advice = "use an explicit method such as DOPRI5 or RK44"
        words = explicit_only(system)
        faults = [Fault("solver.method", f"{method} does not support {part}: {advice}") for part in words]
    awake = start.memory.get(AWAKE)
    if awake is not None and start.velocity[awake == 0.0].any():
        faults.append(Fault("initial", "a point that sleeps must be at rest"))
    return faults


@contextmanager
def within_floats(net: Net) -> Iterator[None]:
    """Raise CaseError if the frequencies of the net, or results of them, overflow."""
    fastest, rate = _fastest(net)
    words = f"the frequency of {fastest} is outside the range of floating-point numbers"
    if not np.isfinite(rate):
        raise CaseError([Fault("net", words, beyond_floats=True)])
    try:
        yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise CaseError([Fault("net", words, beyond_floats=True)]) from error


def step_faults(scene: Scene, system: System, plan: Plan) -> list[Fault]:
    """Return faults of steps that are too short, or too many."""
    step = plan.longest_step if plan.step is None else plan.step
    number = scene.time.end / step if step > 0.0 else np.inf
    if step >= SHORTEST_STEP and number <= MOST_STEPS:
        return []
    if scene.solver.step is not None:
        key, why = "solver.step", "increase it, or reduce time.end"
    else:
        key, fastest, advice = sets_the_step(system)
        why = f"the limit is {fastest}: {advice}, or reduce damping or time.end"
    words = f"{number:.3g} steps of {step:.3g} s (allowed: {MOST_STEPS:g}, of at least {SHORTEST_STEP:g} s)"
    return [Fault(key, f"{words}: {why}")]


def sets_the_step(system: System) -> tuple[str, str, str]:
    """Return what limits the stable step: its key in the case, its name, and a remedy.

    Terms of one kind (reels, contacts, the closing line) act together: the sum of their rates is compared
    with that of all the rest, and the one with the largest rate is named. A viscous stress adds relaxation
    time x stiffness rate to the damping rate.
    """
    frequency, damping = largest_frequency(system), largest_damping_rate(system)
    times = system.forces.cable.changes.relaxation_time
    time = 0.0 if times is None else float(times.max(initial=0.0))
    damped = damping > frequency

    def rate(term: KernelTerm) -> float:
        return term.damping_rate + time * term.stiffness_rate if damped else term.stiffness_rate

    kinds: dict[str, list[KernelTerm]] = {}
    for term in system.forces.kernels:
        if (source := _source(term)) is not None:
            kinds.setdefault(source[0].partition(".")[0], []).append(term)
    group = max(kinds.values(), key=lambda terms: sum(map(rate, terms)), default=[])
    total = damping if damped else frequency**2
    if not 2.0 * sum(map(rate, group)) > total:
        return "net", _fastest(system.net)[0], "use a longer, heavier or softer element"
    term = max(group, key=rate)
    key, name = _source(term) or ("", "")
    if damped and term.damping_rate > time * term.stiffness_rate:
        if _is_contact(term):
            name = f"damping between {term.acts_on} at the speed of the start"
            return key, name, f"give the restitution of {key} at that impact_speed, or reduce its damping"
        return key, f"the drive of {name}", "increase the damping of the drive, or use a softer line"
    if _is_contact(term):
        return key, name, f"reduce the stiffness of {key}, use heavier threads"
    return key, name, "use a softer line, longer elements or heavier nodes"


def _source(term: KernelTerm) -> tuple[str, str] | None:
    """Return key and name of a contact, a reel or the closing line; None of other terms."""
    if term.memory is None:
        return None
    heading, _, part = term.memory.name.partition("/")
    if _is_contact(term):
        return f"effects.{heading}", f"the contact between {term.acts_on}"
    if term.memory.name == LINE:
        return "closing", "the closing line"
    return (f"tethers.{heading}.reel", f"the reel of tether {heading}") if part == "reel" else None


def _is_contact(term: KernelTerm) -> bool:
    return term.memory is not None and term.memory.name.partition("/")[0] in ("contact", "self_contact")


def _fastest(net: Net) -> tuple[str, float]:
    """Return the element with the highest frequency of the net, and a lower bound of its square [1/s2].

    Rayleigh's quotient of a node that moves along the element is EA / (L0 m), or more with its neighbours.
    """
    if not net.n_elements:
        return "the net", 0.0
    free = np.ones(net.n_nodes)
    free[net.fixed_nodes] = 0.0
    with np.errstate(all="ignore"):
        mobility = (free / net.mass)[net.element_nodes].max(axis=1)
        squares = net.axial_stiffness / net.reference_length * mobility
    element = int(np.argmax(squares))
    return _element(net, element), float(squares[element])


def _element(net: Net, element: int) -> str:
    i, j = net.element_nodes[element]
    kind = "string element" if net.is_string[element] else "element"
    for name, own in net.tether_elements.items():
        kind = f"tether {name}'s element" if element in own else kind
    return f"{kind} {element} between nodes {i} and {j}"

"""What is refused before it runs: starts outside the cable law's validity; steps too small, or too many."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import LARGEST, CaseError, Fault
from exunet.bodies import rigid
from exunet.bodies.kinematics import given_states
from exunet.case.scene import Engine, Scene
from exunet.forces import cable
from exunet.forces.blocks import AWAKE
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.cable_term import INTACT
from exunet.forces.terms import KernelTerm, copied
from exunet.methods.keys import SHORTEST_STEP
from exunet.methods.method import METHODS, Kind, NetForm, TimeLoop
from exunet.methods.plan import Plan
from exunet.net.arrays import Net
from exunet.system import energy
from exunet.system.stability import largest_damping_rate, largest_frequency
from exunet.system.system import State, System

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RESOLUTION = 1e-3  # of the shortest element, by which positions may be apart
MOST_STEPS = 1e10  # of a run; at a microsecond each, three hours for the smallest net


def overflow_faults(system: System, start: State) -> list[Fault]:
    """What of a start is beyond `LARGEST`, so that products of it may overflow, block by block."""
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
            ("effects", f"{what} of {one}", value)
            for one, k in blocks.body.items()
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
    """What is wrong with bodies that no run can follow: that turn too often, or fly too far for positions.

    A step is to be no longer than the time in which a body turns by a radian. Nothing more is said of
    a body whose numbers overflow, as one of the `known` faults says.
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
            words = f"turns by {angle:.3g} rad until time.end, more than a run can follow (allowed: "
            words += (
                f"{MOST_STEPS:g} rad, and a radian in {SHORTEST_STEP:g} s). Let it turn slower, or give a "
            )
            words += "shorter time.end"
            faults.append(Fault(f"{name}.angular_velocity", words))
        place, way = float(np.abs(alone.position).max()), float(np.abs(alone.velocity).max() * end)
        far, key = place + way, "position" if place > way else "velocity"
        if np.isfinite(far) and not np.spacing(far) <= RESOLUTION * net.size:
            words = (
                f"gets {far:.3g} m away until time.end, where positions are {np.spacing(far):.2g} m apart; "
            )
            words += f"the net has {net.size:.3g} m. Start it slower, or nearer to the origin"
            faults.append(Fault(f"{name}.{key}", words, beyond_floats=True))
    return faults


def start_faults(scene: Scene, system: System, start: State) -> list[Fault]:
    """What is wrong with a start from which no run could continue.

    An element must not start longer than the law is valid for, nor may its nodes separate so fast that this
    happens within the shortest step; and where the net flies to, positions must still resolve its shape.
    """
    net, position, velocity = system.net, start.position, start.velocity
    natural = system.forces.cable.law.natural_length
    if not len(natural):
        return []
    with np.errstate(all="ignore"):  # speeds beyond floats are refused here too
        # Tethers are straight at the start: those that are too short have been told.
        stretch = (cable.lengths(net, position) / natural)[: net.n_net_elements]
        stretch *= start.memory.get(INTACT, np.ones(net.n_elements))[: net.n_net_elements]
        rate = np.linalg.norm(cable.spans(net, velocity), axis=-1) / natural
    longest, fastest = int(np.argmax(stretch)) if len(stretch) else -1, int(np.argmax(rate))
    faults = []
    if longest >= 0 and not stretch[longest] <= STRETCH_BOUND:
        keys = (key for key in ("node_positions", "fold", "packing", "from") if scene.initial.is_given(key))
        reason = (
            f"{_element(net, longest)} starts {stretch[longest]:.4g} times as long as when free of stress; "
            f"above {STRETCH_BOUND:g} it is outside the cable law's validity. Start it shorter"
        )
        key = _attachments(system, net.element_nodes[longest]) or f"initial.{next(keys)}"
        faults.append(Fault(key, reason))
    if not rate[fastest] * SHORTEST_STEP <= 1.0:
        launched = scene.launch and np.isin(net.element_nodes[fastest], net.bullet_nodes).any()
        reason = (
            f"the nodes of {_element(net, fastest)} separate at {rate[fastest]:.3g} times its length a "
            f"second, which no step of {SHORTEST_STEP:g} s or more can follow. Give smaller speeds"
        )
        faults.append(Fault("launch" if launched else "initial", reason))
    far = float(np.abs(position).max() + np.abs(velocity).max() * scene.time.end)
    apart, shortest = np.spacing(far), natural.min()
    if not faults and not apart <= RESOLUTION * shortest:
        reason = (
            f"until time.end a node may get {far:.3g} m away, where positions are {apart:.2g} m apart; "
            f"the shortest element has {shortest:.3g} m. Start slower, or nearer to the origin"
        )
        faults.append(Fault("initial", reason, beyond_floats=True))
    return faults


def contact_faults(system: System, start: State) -> list[Fault]:
    """What starts where its contact would stop a run at once: inside a body."""
    faults = []
    x, v = system.layout.pack(start.moving)
    for term in system.forces.kernels:
        memory = term.memory
        if term.remember is None or memory is None or memory.wrong is None:
            continue
        data = copied(term.data)  # which has work space
        term.add(start.time, x, v, data, np.zeros(system.blocks.n_force))
        term.remember(start.time, x, v, data)
        if words := memory.wrong(getattr(data, memory.kept_in)):
            where = words.partition(":")[0]  # without what a run could change
            reason = f"cannot start so: {where}. Give the net or the body another start, further apart"
            faults.append(Fault(f"effects.{memory.name.partition('/')[0]}", reason))
    return faults


def _attachments(system: System, ends: Ints) -> str:
    """The key of the attachments that put an end of an element where it starts; "" if none does."""
    on = system.kinematics.tied_to[np.isin(system.kinematics.tied, ends)]
    return f"bodies.{system.blocks.rigid[on[0]]}.attachments" if len(on) else ""


def explicit_only(system: System) -> list[str]:
    """What of a system no implicit method can run, in words."""
    words = [f"a force that acts on {name}" for name in sorted(system.forces.on_bodies)]
    guided = [name for name, moves in zip(system.blocks.rigid, system.moves_freely, strict=True) if not moves]
    own = {one.name for name in guided for one in given_states(name)}
    others = (one.name for one in system.blocks.states if one.name not in own)
    words += [f"a force that has first-order states ({name})" for name in others]
    words += ["points that sleep"] * (system.blocks.awake is not None)
    return words + [f"a body that is fixed or prescribed ({name})" for name in guided]


def form_faults(system: System, start: State, plan: Plan, engine: Engine) -> list[Fault]:
    """What the method or the form of the engine cannot do: implicit ones know points only, and all awake."""
    faults, sleeps, method = [], system.blocks.awake is not None, plan.method
    if METHODS[method].kind == Kind.IMPLICIT:
        advice = "use an explicit method such as DOPRI5 or RK44"
        words = explicit_only(system)
        faults = [Fault("solver.method", f"{method} cannot run {one}: {advice}") for one in words]
    if sleeps and engine.loop == TimeLoop.EXUDYN and engine.net == NetForm.CONNECTORS:
        reason = 'connectors pull points that sleep: use engine.net = "fused", or engine.loop = "compiled"'
        faults.append(Fault("engine.net", reason))
    awake = start.memory.get(AWAKE)
    if awake is not None and start.velocity[awake == 0.0].any():
        faults.append(Fault("initial", "a point that sleeps must be at rest"))
    return faults


@contextmanager
def within_floats(net: Net) -> Iterator[None]:
    """Raise CaseError where the frequencies of the net, or results of them, overflow."""
    fastest, rate = _fastest(net)
    words = f"the frequency of {fastest} is outside the range of floating-point numbers"
    if not np.isfinite(rate):
        raise CaseError([Fault("net", words, beyond_floats=True)])
    try:
        yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise CaseError([Fault("net", words, beyond_floats=True)]) from error


def step_faults(scene: Scene, system: System, plan: Plan) -> list[Fault]:
    """What is wrong with steps that are below the shortest one, or too many for a run to end."""
    step = plan.longest_step if plan.step is None else plan.step
    number = scene.time.end / step if step > 0.0 else np.inf
    if step >= SHORTEST_STEP and number <= MOST_STEPS:
        return []
    if scene.solver.step is not None:
        key, why = "solver.step", "Give a longer one, or a shorter time.end"
    else:
        key, fastest, advice = sets_the_step(system)
        why = f"Fastest is {fastest}: {advice}, damping weaker, or time.end shorter"
    words = f"steps of {step:.3g} s, {number:.3g} of them, are too small or too many (allowed: "
    return [Fault(key, f"{words}{SHORTEST_STEP:g} s, {MOST_STEPS:g}). {why}")]


def sets_the_step(system: System) -> tuple[str, str, str]:
    """What has the highest frequency, as the key of the case, in words, and what helps."""
    kernels = system.forces.kernels
    damped = max((term for term in kernels if _presses(term)), key=lambda one: one.damping_rate, default=None)
    others = largest_damping_rate(system) - (0.0 if damped is None else damped.damping_rate)
    if damped is not None and damped.damping_rate > max(others, largest_frequency(system)):
        key = f"effects.{_heading(damped)}"
        words = f"damping between {damped.acts_on} at the speed of the start"
        return key, words, f"state the restitution of {key} at that impact_speed, or make its damping less"
    of_net = largest_frequency(system) ** 2 - sum(term.stiffness_rate for term in kernels)
    terms = [term for term in kernels if term.memory is not None]
    term = max(terms, key=lambda one: one.stiffness_rate, default=None)
    if term is not None and term.stiffness_rate > of_net and _presses(term):
        key = f"effects.{_heading(term)}"
        return key, f"what presses between {term.acts_on}", f"make {key} softer, threads heavier"
    return "net", _fastest(system.net)[0], "make it longer, heavier or softer"


def _heading(term: KernelTerm) -> str:
    """The effect whose memory a term has; "": it has none."""
    return "" if term.memory is None else term.memory.name.partition("/")[0]


def _presses(term: KernelTerm) -> bool:
    """True of a contact."""
    return _heading(term) in ("contact", "self_contact")


def _fastest(net: Net) -> tuple[str, float]:
    """The element that sets the net's highest frequency, and a lower bound of it squared [1/s2].

    A node that moves along an element has EA / (L0 m) for Rayleigh's quotient, and more with the others.
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

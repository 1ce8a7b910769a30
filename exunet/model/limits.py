"""Limits of a case, before its run: step by the fastest mode, initial state, floating-point range, steps.

A slack element does not have stiffness, so the net with every element just taut (eq. (14) in the reference
configuration) has the highest frequencies it can reach, up to the factor (3 lambda^2 - 1)/2 by which a
stretch lambda stiffens an element. Tethers do not have a reference configuration: they pull in any direction
and turn the threads that they are tied to. Such an element has EA / L0 in all directions, since n n^T <= I:
the bound is independent of rotation, and is reached where all elements align.

A step that is stable for a taut net is not accurate for a net that snaps: at each snap the force has a kink,
and the error made there remains. `SAFETY` covers both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import LARGEST, CaseError, Fault
from exunet.bodies import rigid
from exunet.bodies.kinematics import given_states
from exunet.forces import cable
from exunet.forces.blocks import ACTIVE
from exunet.forces.cable import assemble_pairs, reference_blocks, reference_spans
from exunet.forces.cable_term import INTACT
from exunet.forces.closing import STATE_NAME as LINE
from exunet.forces.effects import EFFECTS
from exunet.forces.terms import KernelTerm, copied
from exunet.methods.config import SHORTEST_STEP
from exunet.methods.method import METHODS, Kind, Method, Plan
from exunet.model import energy
from exunet.model.system import State, System
from exunet.net.arrays import Net
from exunet.scene.scene import Scene

# Measured on the three planar cases to t = 2 s, 5 starts each, as the largest error of the energy balance:
# VelocityVerlet 1.1 at 0.8 of the stable step, 0.16 at 0.5, 0.05 at 0.3, 0.024 at 0.2; RK44 0.69, 0.25,
# 0.054, 0.016. The guards allow 0.05.
SAFETY = 0.2

# Growth of a mode in one step up to which weakly unstable methods run without being forced: at it a taut
# mode grows e-fold in 100 steps. On the undamped planar case to 2 s RK67 passes the guards at it (energy
# within 0.025) and not at twice that step; ExplicitMidpoint needs a third of it, ExplicitEuler far less.
WEAK_GROWTH = 0.01
_ROUND_OFF = 1e-9
_NEGLIGIBLE = 1e-12  # of the coefficients c_k: those below the order of the method
LARGE_FACTOR = 2.0  # by which a drive shortens the stable step, from which on it is reported
LARGE = 30_000  # coordinates, from which on the largest frequency is found to a hundredth only


def _symmetric(matrix: scipy.sparse.csr_array, mass: Floats) -> scipy.sparse.csr_array:
    """M^-1/2 A M^-1/2: the same eigenvalues as M^-1 A, but symmetric."""
    scale = scipy.sparse.diags_array(1.0 / np.sqrt(mass))
    return scipy.sparse.csr_array(scale @ matrix @ scale)


def _largest_eigenvalue(matrix: scipy.sparse.csr_array) -> float:
    """Compute the largest eigenvalue of a semi-definite matrix; Gershgorin bound if Lanczos fails."""
    bound = float(np.max(np.abs(matrix).sum(axis=1), initial=0.0))
    size = matrix.shape[0]
    if size <= 60:
        return float(np.linalg.eigvalsh(matrix.toarray())[-1]) if size else 0.0
    start = np.sin(np.arange(1.0, size + 1.0))  # fixed: the same case gives the same step
    # The largest eigenvalues of a large net lie close together: their digits cost time that no step needs.
    tolerance = 1e-6 if size <= LARGE else 1e-2
    try:
        found = scipy.sparse.linalg.eigsh(matrix, k=1, which="LA", v0=start, tol=tolerance)[0][0]
        return float(min(bound, found * (1.0 + tolerance)))
    except scipy.sparse.linalg.ArpackError:
        return bound


@lru_cache(maxsize=8)
def largest_frequency(system: System) -> float:
    """Compute the highest angular frequency [rad/s] of the just taut net.

    Square root of the largest eigenvalue of M^-1 (T + K), K the constant stiffness of effects such as
    bending; kernel terms add their bounds.
    """
    return math.sqrt(_taut_square(system.alone) + sum(term.stiffness_rate for term in system.forces.kernels))


@lru_cache(maxsize=8)
def _taut_square(system: System) -> float:
    """Compute the largest eigenvalue of M^-1 (T + K) [1/s2]."""
    free = _free_coordinates(system)
    stiffness = taut_stiffness(system)[free][:, free]
    return max(0.0, _largest_eigenvalue(_symmetric(stiffness, np.repeat(system.inert_mass, 3)[free])))


REST = 1e-6  # [m/s], below which a scene starts at rest: round-off of 7,500 m/s is 1e-12 m/s


def relative_speed(system: System, state: State) -> float:
    """Compute the scale of speeds [m/s] of a state, the unit of tolerances and of errors.

    The largest speed of nodes and bodies relative to the net's centre of mass, so that a velocity common to
    all does not change it (Galilean invariance). A net with fixed nodes has their frame. 1 m/s at rest.
    """
    nodes = state.velocity[: system.net.n_nodes]
    mass, origin = system.net.mass, np.zeros(3)
    if len(nodes) and not len(system.net.fixed_nodes) and mass.sum() > 0.0:
        origin = mass @ nodes / mass.sum()
    moving = np.concatenate([state.velocity, state.bodies.velocity]) - origin
    speed = float(np.linalg.norm(moving, axis=1).max(initial=0.0))
    return speed if speed > REST else 1.0


def taut_stiffness(system: System) -> scipy.sparse.csr_array:
    """Assemble T + K, (3 n_points, 3 n_points) [N/m]."""
    net = system.net
    blocks = reference_blocks(net, reference_spans(net, system.blocks.position, system.blocks.poses.net))
    steepest = system.forces.cable.law.steepest
    blocks *= steepest[:, None, None]
    tied = [node for tether in net.tethers for node in tether.nodes]
    any_direction = np.isin(net.element_nodes, tied).any(axis=1)
    stiffness = (steepest * net.axial_stiffness / net.reference_length)[any_direction]
    blocks[any_direction] = stiffness[:, None, None] * np.eye(3)
    stiffness, linear = assemble_pairs(net, blocks), system.forces.linear
    if linear is not None and linear.stiffness is not None:
        stiffness = scipy.sparse.csr_array(stiffness + linear.stiffness)
    return stiffness


@lru_cache(maxsize=8)
def largest_damping_rate(system: System) -> float:
    """Compute a bound [1/s] of the eigenvalues of M^-1 D, viscous stress and kernel terms included."""
    rate = sum(term.damping_rate for term in system.forces)
    linear = system.forces.linear
    if linear is not None and linear.damping is not None:
        free = _free_coordinates(system)
        damping = linear.damping[free][:, free]
        rate += max(0.0, _largest_eigenvalue(_symmetric(damping, np.repeat(system.inert_mass, 3)[free])))
    relaxation = system.forces.cable.changes.relaxation_time
    if relaxation is not None:  # of a taut net, tau T at most
        rate += float(relaxation.max(initial=0.0)) * largest_frequency(system) ** 2
    return rate


def _free_coordinates(system: System) -> NDArray[np.int64]:
    return np.flatnonzero(np.repeat(np.isfinite(system.inert_mass), 3))


def stable_step(method: Method, frequency: float, damping_rate: float = 0.0) -> float:
    """Compute the largest step [s] at which a method does not amplify a mode.

    Parameters
    ----------
    method : Method
        Integration method.
    frequency : float
        Angular frequency w of the undamped mode [rad/s].
    damping_rate : float
        c in x'' + c x' + w^2 x = 0 [1/s].

    Returns
    -------
    float
        Step [s]; 0 for a method that amplifies every such mode, infinity without a limit (implicit methods).
    """
    if METHODS[method].kind == Kind.IMPLICIT or (frequency == 0.0 and damping_rate == 0.0):
        return math.inf
    if method == Method.VELOCITY_VERLET:
        # Central differences with the damping force taken at the start of the step: 2/w (sqrt(1 + z^2) - z)
        # with z = c / 2w, written so that w may be zero.
        half = damping_rate / 2.0
        return 2.0 / (math.hypot(frequency, half) + half)
    return _explicit_limit(method, frequency, damping_rate, _ROUND_OFF)


def step_limit(method: Method, frequency: float, damping_rate: float = 0.0) -> float:
    """Compute the largest step [s] that is allowed without `solver.force`: the stable step.

    Of a weakly unstable method (`MethodFacts.weak`), the step at which a mode grows by WEAK_GROWTH a step.
    """
    limit = stable_step(method, frequency, damping_rate)
    if not METHODS[method].weak or math.isinf(limit):
        return limit
    return _explicit_limit(method, frequency, damping_rate, WEAK_GROWTH)


def _explicit_limit(method: Method, frequency: float, damping_rate: float, growth: float) -> float:
    half = damping_rate / 2.0
    root = complex(half**2 - frequency**2) ** 0.5
    return min(_polynomial_limit(method, z, growth) for z in {-half + root, -half - root} if z != 0)


def _polynomial_limit(method: Method, eigenvalue: complex, growth: float) -> float:
    """Find the largest h with |R(h z)| <= 1 + growth on the ray of an eigenvalue by bisection."""
    polynomial = np.polynomial.Polynomial(METHODS[method].stability_polynomial)
    direction = eigenvalue / abs(eigenvalue)

    def grows(radius: Floats | float) -> NDArray[np.bool_]:
        return np.abs(polynomial(radius * direction)) > 1.0 + growth

    radii = np.linspace(0.01, 8.0, 800)
    outside = np.flatnonzero(grows(radii))
    if outside[0] == 0:
        return 0.0
    low, high = radii[outside[0] - 1], radii[outside[0]]
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low / abs(eigenvalue))


class RotationError:
    """Error of the energy of rotating free bodies in fixed steps.

    Without torques, Euler's equations w1' = (I2 - I3) / I1 w2 w3 ... rotate the angular velocity about a
    principal axis at a rate of at most a |w|, a the largest |Ii - Ij| / Ik (0 of a sphere, 1 of a thin disc).
    A step h multiplies an oscillation at that rate by R(iz), z = a |w| h, R the stability polynomial of the
    method, and its energy by |R(iz)|^2 = 1 + sum of c_k z^(2k). The sum of |c_k| z^(2k) bounds the change in
    a step. Measured: of 300 free bodies of random shapes and spins over 300 rad, by four methods, energies
    that changed by less than a tenth changed by at most 0.78 of the bound (a thin rod about its axis).

    step       : [s]
    polynomial : coefficients of R from z^0 on (see `exunet.methods.method.turning_polynomial`)
    """

    def __init__(self, system: System, step: float, polynomial: tuple[float, ...]) -> None:
        self._step, self._change = step, _change(polynomial)
        free = system.moves_freely
        self.names = np.array(system.blocks.rigid)[free]
        self._free, self._uneven = free, _unevenness(system.body_inertia[free])

    def angle(self, spin: Floats) -> Floats:
        """Compute (k, n) rotations of free bodies in a step [rad]; spin: (k, n_bodies, 3) [rad/s]."""
        return np.asarray(np.linalg.norm(spin[:, self._free], axis=2) * self._step)

    def error(self, spin: Floats, elapsed: Floats) -> Floats:
        """Compute (k, n) bounds of the relative energy error of bodies with constant spin.

        elapsed : (k,) time since the start [s]
        """
        change = np.polynomial.polynomial.polyval(self._uneven * self.angle(spin), self._change)
        return np.asarray(change * elapsed[:, None] / self._step)


def rotation_step_limit(
    system: System, spin: Floats, polynomial: tuple[float, ...], end: float, allowed: float
) -> float:
    """Compute the step [s] at which the energy error of rotation is `allowed` at a time `end` [s].

    Infinite if no step reaches it.

    spin : (n_bodies, 3) angular velocities [rad/s]
    """

    def error(step: float) -> float:
        rotation = RotationError(system, step, polynomial)
        return float(rotation.error(spin[None], np.array([end])).max(initial=0.0))

    low, high = 0.0, end
    if not error(high) > allowed:
        return math.inf
    for _ in range(60):  # the error increases with the step: powers of 2 and more
        middle = 0.5 * (low + high)
        low, high = (low, middle) if error(middle) > allowed else (middle, high)
    return low


def _unevenness(inertia: Floats) -> Floats:
    """Compute (n,) largest |Ii - Ij| / Ik of principal moments (n, 3)."""
    differences = np.abs(np.roll(inertia, 1, axis=1) - np.roll(inertia, 2, axis=1))
    return np.asarray((differences / inertia).max(axis=1, initial=0.0))


def _change(polynomial: tuple[float, ...]) -> Floats:
    """Compute the coefficients |c_k| of z^0, z^1 ... in |R(iz)|^2 - 1, without round-off."""
    of_angle = np.array([value * 1j**k for k, value in enumerate(polynomial)])
    square = np.convolve(of_angle, of_angle.conj()).real
    square[0] -= 1.0
    return np.where(np.abs(square) > _NEGLIGIBLE, np.abs(square), 0.0)


def friction_warnings(system: System, plan: Plan) -> Iterator[str]:
    """Warn of a fixed step that does not resolve regularised friction in an impact at the initial speed.

    The friction force is linear in the sliding speed up to v_s, with slope mu N / v_s. Beyond the stability
    limit of its rate, sliding speeds oscillate with an amplitude of about mu N h / m: the motion stays right,
    but the dissipated energy is overestimated by up to (mu N)^2 h / m per second.
    """
    kernels = system.forces.kernels
    term = max(kernels, key=lambda kernel: kernel.friction_rate, default=None)
    if plan.step is None or term is None or not term.friction_rate > 0.0:
        return
    rate = largest_damping_rate(system) + sum(kernel.friction_rate for kernel in kernels)
    admissible = stable_step(plan.method, largest_frequency(system), min(rate, 1.0 / SHORTEST_STEP))
    if plan.step <= admissible:
        return
    speed = term.friction_rate * term.data.law.slip_speed * plan.step  # type: ignore[attr-defined]
    yield (
        f"step {plan.step:.3g} s does not resolve friction between {term.acts_on} at sliding speeds below "
        f"{speed:.2g} m/s, so its dissipation is overestimated: use a step of {admissible:.2g} s, "
        f'slip_speed = {speed:.2g} m/s, or friction.law = "sticking"'
    )


RESOLUTION = 1e-3  # spacing of floating-point positions, of the shortest element
MOST_STEPS = 1e10  # of a run; at a microsecond each, three hours for the smallest net


def overflow_faults(system: System, start: State) -> list[Fault]:
    """Return faults of initial values above `LARGEST`, whose products may overflow."""
    moving = start.bodies
    with np.errstate(all="ignore"):
        found = [
            ("initial", "kinetic energy at the start", energy.kinetic(system.mass, start.velocity)),
            ("initial.packing", "elastic energy at the start", energy.elastic(system.forces, start.position)),
            ("net", "mass of a node", system.net.mass),
            ("net", "inverse of a node's mass", 1.0 / system.net.mass),
            ("net", "cube of an element's length", system.net.reference_length**3),
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
    law = system.forces.cable.law
    natural = law.natural_length
    if not len(natural):
        return []
    with np.errstate(all="ignore"):  # speeds outside the floating-point range are faults here too
        # Tethers are straight at the start: short ones have a fault already.
        stretch = (cable.lengths(net, position) / natural)[: net.n_net_elements]
        bounds = law.longest / natural
        stretch *= start.discrete.get(INTACT, np.ones(net.n_elements))[: net.n_net_elements]
        rate = np.linalg.norm(cable.spans(net, velocity), axis=-1) / natural
    worst = stretch / bounds[: len(stretch)]
    longest, fastest = int(np.argmax(worst)) if len(worst) else -1, int(np.argmax(rate))
    faults = []
    if longest >= 0 and not stretch[longest] <= bounds[longest]:
        keys = (
            key for key in ("node_positions", "fold", "packing", "restart") if scene.initial.is_given(key)
        )
        reason = (
            f"{_element(net, longest)} starts at {stretch[longest]:.4g} times its stress-free length, above "
            f"{bounds[longest]:g}, the limit of the cable law: move its nodes closer"
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
        discrete = term.discrete
        if term.remember is None or discrete is None or discrete.wrong is None:
            continue
        if _out_of_reach(system, start, discrete.name.removeprefix("contact/threads/")):
            continue  # of a large net the loops below would take seconds, as they are interpreted
        data = copied(term.data)  # work arrays included
        term.add(start.time, x, v, data, np.zeros(system.blocks.n_force))
        term.remember(start.time, x, v, data)
        if words := discrete.wrong(getattr(data, discrete.kept_in)):
            where = words.partition(":")[0]  # without the remedy
            reason = f"invalid start: {where}: increase the distance of net and body"
            faults.append(Fault(f"effects.{discrete.name.partition('/')[0]}", reason))
    return faults


def _out_of_reach(system: System, start: State, name: str) -> bool:
    """Return True if no thread can touch the body of this name; False without such a body."""
    surface, net = system.blocks.surfaces.get(name), system.net
    if surface is None or not net.n_elements:
        return False
    centre = start.bodies.position[system.blocks.rigid.index(name)]
    away = np.linalg.norm(start.position[: net.n_nodes] - centre, axis=1).min()
    thick = math.sqrt(float(net.area.max()) / math.pi)
    longest = float(cable.lengths(net, start.position[: net.n_nodes]).max())
    return bool(away > np.linalg.norm(surface.middle) + surface.radius + 0.5 * longest + thick)


def _attachments(system: System, ends: Ints) -> str:
    """Return the key of the attachments of an element's ends; "" without any."""
    on = system.kinematics.tied_to[np.isin(system.kinematics.tied, ends)]
    return f"bodies.{system.blocks.rigid[on[0]]}.attachments" if len(on) else ""


def explicit_only(system: System) -> list[str]:
    """Describe the parts of a system that implicit methods do not support."""
    words = [f"a force that acts on {name}" for name in sorted(system.forces.on_bodies)]
    prescribed = [
        name for name, moves in zip(system.blocks.rigid, system.moves_freely, strict=True) if not moves
    ]
    own = {state.name for name in prescribed for state in given_states(name)}
    others = (state.name for state in system.blocks.states if state.name not in own)
    words += [f"a force that has first-order states ({name})" for name in others]
    words += ["inactive points"] * (system.blocks.active is not None)
    return words + [f"a body that is fixed or prescribed ({name})" for name in prescribed]


def method_faults(system: System, start: State, plan: Plan) -> list[Fault]:
    """Return faults of the method in a scene."""
    faults, method = [], plan.method
    if METHODS[method].kind == Kind.IMPLICIT:
        advice = "use an explicit method such as DOPRI5 or RK44"
        words = explicit_only(system)
        faults = [Fault("solver.method", f"{method} does not support {part}: {advice}") for part in words]
    active = start.discrete.get(ACTIVE)
    if active is not None and start.velocity[active == 0.0].any():
        faults.append(Fault("initial", "an inactive point must be at rest"))
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
    """Return what limits the stable step: its key in the case, its name, and what about doubles the step.

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
        remedy = (
            "halve the damping of its threads" if damped else "make it twice as long or four times softer"
        )
        return "net", _fastest(system.net)[0], remedy
    term = max(group, key=rate)
    key, name = _source(term) or ("", "")
    if damped and term.damping_rate > time * term.stiffness_rate:
        if _is_contact(term):
            name = f"damping between {term.acts_on} at the speed of the start"
            return key, name, "halve that damping, or give a restitution"
        return key, f"the drive of {name}", "double the damping of the drive, or make the line twice as soft"
    factor = "twice" if damped else "four times"
    if _is_contact(term):
        return key, name, f"make {key} {factor} softer, or the threads {factor} heavier"
    return key, name, f"make the line {factor} softer, or its nodes {factor} heavier"


def drive_factor(system: System) -> float:
    """Compute by how much the drive of a reel or winch that limits the stable step shortens it; 1 without."""
    key, name, _ = sets_the_step(system)
    if not name.startswith("the drive of"):
        return 1.0
    kind = key.partition(".")[0]
    kernels = tuple(
        replace(term, damping_rate=0.0) if (_source(term) or ("",))[0].partition(".")[0] == kind else term
        for term in system.forces.kernels
    )
    rest = replace(system, forces=replace(system.forces, kernels=kernels))
    whole, without = (
        stable_step(Method.VELOCITY_VERLET, largest_frequency(some), largest_damping_rate(some))
        for some in (system, rest)
    )
    return float(without / whole)


def describe_limit(system: System, method: Method) -> str:
    """Describe the stable step of the method, what limits it, and what would double it."""
    of = method if METHODS[method].kind == Kind.EXPLICIT else Method.VELOCITY_VERLET
    limit = step_limit(of, largest_frequency(system), largest_damping_rate(system))
    if math.isinf(limit):
        return "any: nothing in the scene oscillates or is damped"
    key, name, remedy = sets_the_step(system)
    if key.startswith("tethers.") and drive_factor(system) > LARGE_FACTOR:
        remedy += '; a free spool is cheaper as "pay_out" at the launch speed with a large damping'
    return f"stable up to {limit:.4g} s ({of}), limited by {name} ({key}): to double it, {remedy}"


def _source(term: KernelTerm) -> tuple[str, str] | None:
    """Return key and name of a contact, a reel or the closing line; None of other terms."""
    if term.discrete is None:
        return None
    heading, _, part = term.discrete.name.partition("/")
    if _is_contact(term):
        return f"effects.{heading}", f"the contact between {term.acts_on}"
    if term.discrete.name == LINE:
        return "closing", "the closing line"
    return (f"tethers.{heading}.reel", f"the reel of tether {heading}") if part == "reel" else None


def _is_contact(term: KernelTerm) -> bool:
    effect = None if term.discrete is None else EFFECTS.get(term.discrete.name.partition("/")[0])
    return effect is not None and effect.COLLIDES


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
        squares = cable.AxialLaw.of(net).steepest * net.axial_stiffness / net.reference_length * mobility
    element = int(np.argmax(squares))
    return _element(net, element), float(squares[element])


def _element(net: Net, element: int) -> str:
    i, j = net.element_nodes[element]
    kind = "string element" if net.is_string[element] else "element"
    for name, own in net.tether_elements.items():
        kind = f"tether {name}'s element" if element in own else kind
    return f"{kind} {element} between nodes {i} and {j}"

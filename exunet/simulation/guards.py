"""Guards of a run: energy scale, bounds of each state, and the message for a state that exceeds them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.corner_units import CountedThrusters, Thrusters
from exunet.forces.law import STRETCH_BOUND
from exunet.forces.linear_term import LinearTerm
from exunet.forces.terms import DiscreteStates, KernelTerm
from exunet.kernels.kernel import term_kernel
from exunet.methods.method import METHODS, Kind, Plan
from exunet.model import energy
from exunet.model.limits import RotationError
from exunet.model.states import States
from exunet.model.system import State, System

# The translation of a free part deforms nothing, but the energy balance has the errors of its integration:
# those of its kinetic energy, and those of the work that is summed over the steps.
TRANSLATION_PART = 1e-9
WORK_PART = 1e-5
MARGIN_OF_TOUCH = 0.1  # of the radius of a body, within which nodes count as touching it


class FreeParts(NamedTuple):
    """Connected parts of a system that are not held: points, then driven bodies.

    members : (m,) numbers of the points and bodies in a part
    part    : (m,) number of the part of each
    mass    : (n_parts,) [kg]
    mean    : (n_parts, n) weights of the centres of mass
    """

    members: NDArray[np.int64]
    part: NDArray[np.int64]
    mass: Floats
    mean: Floats


@lru_cache(maxsize=8)  # many runs of one system
def free_parts(system: System) -> FreeParts:
    """Find the connected parts of a system that are not held."""
    net, mass = system.net, np.append(system.mass, system.body_mass[system.driven])
    n = len(mass)
    path = np.array([] if system.line is None else system.line.path, dtype=np.int64)
    i, j = np.concatenate([net.element_nodes.T, np.stack([path[:-1], path[1:]])], axis=1)
    links = scipy.sparse.csr_array((np.ones(len(i)), (i, j)), shape=(n, n))
    part = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    # Inactive points hold their part too, and prescribed bodies stop what touches them.
    free_bodies = system.blocks.free_bodies
    stopped = any(name not in free_bodies for name in system.blocks.surfaces)
    held = part if stopped or system.blocks.active is not None else part[system.held]
    free = np.setdiff1d(part, held)
    if system.driven.any() and len(free):
        part[np.isin(part, free)] = free[0]
        free = free[:1]
    members = np.flatnonzero(np.isin(part, free))
    number = np.searchsorted(free, part[members])
    of_parts = np.bincount(number, mass[members], minlength=len(free)).astype(float)
    mean = np.zeros((len(free), n))
    mean[number, members] = mass[members] / of_parts[number]
    return FreeParts(members, number, of_parts, mean)


class EnergyScale:
    """Energy that can deform the net: at the start, and added later.

    By Koenig's theorem the kinetic energy of a free part is that of its centre of mass plus that in its
    centre-of-mass frame; only the latter can stretch a cable. The potential of the nodes gathered at their
    centre of mass goes with the former: all of it in a uniform field, none of it between parts
    (`KernelTerm.internal`). By the momentum theorem, the work of forces without a potential on the centre of
    mass is the change of its kinetic energy; the rest of their work counts.

    A drum that winds up a slack tether does no work, but the tether takes up its speed once taut: the
    tether's kinetic energy at the rate of the drum counts too. So does that of nodes that touch a prescribed
    body, or are tied to it, at its speed.

    A rigid body without a force term has a balance of its own (see `exunet.simulation.guards`). A body with
    a force term may meet every free part: all of these count as one part.

    start : one state; as an attribute the kinetic and elastic energy there [J]
    errors : part of it that allows for errors of a translation [J]
    """

    def __init__(self, start: States) -> None:
        system = start.system
        forces, self._layout, self._driven = system.forces, system.layout, system.driven
        self._outer = replace(forces, kernels=tuple(term for term in forces.kernels if not term.internal))
        self._gathers = self._outer.has_potential
        given = any(state.gives for state in system.blocks.states)
        self._gains = forces.has_potential or forces.dissipates or given
        self._free, self._before = free_parts(system), system.lost_at_start
        self._system = system
        self._rest = start.x[0]
        kinetic = energy.kinetic(system.mass, start.velocity[0]) + start.kinetic_of_bodies[0] @ system.driven
        self._common = self._of_centres(start)
        self._potential = float(start.potential[0])
        moving = float(self._common[0][0])
        self.errors = TRANSLATION_PART * moving
        self.start = float(kinetic + start.elastic[0]) - moving + self.errors

    def _of_centres(self, states: States) -> tuple[Floats, Floats]:
        """Compute the kinetic and potential energy [J] of the centres of mass of k states -> (k,) each."""
        position, velocity = states.position, states.velocity
        if self._driven.any():
            position = np.concatenate([position, states.bodies.position[:, self._driven]], axis=1)
            velocity = np.concatenate([velocity, states.bodies.velocity[:, self._driven]], axis=1)
        speeds = self._free.mean @ velocity
        kinetic = 0.5 * np.einsum("kpa,kpa,p->k", speeds, speeds, self._free.mass)
        if not self._gathers:
            return kinetic, np.zeros(len(position))
        flat = np.repeat(self._rest[None], len(position), axis=0)
        gathered = self._layout.unpack(flat, np.empty((len(position), self._layout.blocks.n_v)))
        centres = (self._free.mean @ position)[:, self._free.part]
        members, n_points = self._free.members, gathered.position.shape[1]
        points = members < n_points
        gathered.position[:, members[points]] = centres[:, points]
        bodies = np.flatnonzero(self._driven)[members[~points] - n_points]
        gathered.bodies.position[:, bodies] = centres[:, ~points]
        return kinetic, energy.potential(self._outer, flat, states.discrete)

    def gained(self, states: States, dissipated: Floats) -> Floats:
        """Compute (3, k) energies [J] added by potentials and forces since the start.

        To the scale; in total; the part of the first that allows for errors of a translation.

        dissipated : (k,) energy dissipated until these states [J], an ejection at time 0 included
        """
        if not self._gains:
            return np.zeros((3, len(states)))
        dissipated = dissipated - self._before
        kinetic, common = self._of_centres(states)
        common_change = common - self._common[1]
        change = states.potential - self._potential
        done = -dissipated - (kinetic - self._common[0]) - common_change
        errors = TRANSLATION_PART * np.abs(common_change) + WORK_PART * np.abs(dissipated)
        reels, first = self._system.forces.cable.reels, states.x[0]
        drawn = max((reel.drawn(states.discrete, first) for reel in reels), default=0.0)
        met = np.maximum(drawn, self._at_speed_of_bodies(states))
        own = np.maximum(np.maximum(np.abs(change - common_change), done), met) + errors
        return np.array([own, np.maximum(np.abs(change), -dissipated), errors])

    def _at_speed_of_bodies(self, states: States) -> Floats:
        """Compute the kinetic energy (k,) [J] of nodes at prescribed bodies, at the bodies' speed.

        Those of elements that are tied to a body, or whose box meets that of one of its solids.
        """
        system, bodies = self._system, states.bodies
        blocks, found = system.blocks, np.zeros(len(states))
        for body in np.flatnonzero(~system.moves_freely).tolist():
            speed, spin = bodies.velocity[:, body], bodies.angular_velocity[:, body]
            if not (speed.any() or spin.any()):
                continue
            i, j = system.net.element_nodes.T
            tied = system.kinematics.on_bodies(states.discrete)
            turn = rotation_matrix(bodies.attitude[:, body])
            arm = (states.position - bodies.position[:, body, None]) @ turn
            near = np.zeros(arm.shape[:2], dtype=bool)
            near[:, tied.point[tied.body == body]] = True
            meets = near[:, i] | near[:, j]
            if surface := blocks.surfaces.get(blocks.rigid[body]):
                low, high = np.minimum(arm[:, i], arm[:, j]), np.maximum(arm[:, i], arm[:, j])
                for box in surface.cores.boxes + MARGIN_OF_TOUCH * surface.radius * np.repeat([-1, 1], 3):
                    meets |= ((low <= box[3:]) & (high >= box[:3])).all(axis=2)
            row, element = np.nonzero(meets)
            near[row, i[element]] = near[row, j[element]] = True
            own = np.einsum("ka,kab->kb", speed, turn)[:, None] + np.cross(spin[:, None], arm)
            found += 0.5 * np.where(near, np.einsum("kna,kna->kn", own, own), 0.0) @ blocks.mass
        return found


# The sum of kinetic, elastic, potential and dissipated energy may change by this part of the energy scale,
# up or down: a method that loses energy is as wrong as one that gains it (RK44 at half its stable step loses
# a quarter of the energy of the paper's net). A converged run stays below 1e-5.
ENERGY_BOUND = 0.05
OF_STEPS = 0.1  # of that bound: above it, an error is due to the steps
# Largest speed over the sum of the fastest start, the wave speed sqrt(E / rho), and the speed by the energy
# from potentials and forces. An element stretched to the bound rebounds at 5 wave speeds.
SPEED_BOUND = 10.0
LOW_ORDER = 2  # up to which truncation errors of smooth forces in fixed steps exceed the other bounds
OF_ADAPTIVE = 1.0 / 60.0  # factor of truncation errors in adaptive steps, see `Guards.truncated`
LEAST_ENERGY = 1e-12  # [J], of a net at rest

# Round-off of the kinetic and the potential energy, which the balance subtracts: 4e6 steps of free fall lose
# 1e-10 of them.
ROUND_OFF = 1e-9


@dataclass(frozen=True)
class GuardValues:
    """Guarded values of states (k, ...).

    balance, allowed : (k,) change of the energy balance since the start, and its bound [J]
    stretch          : (k,) largest stretch of an element, over the limit of its law, times STRETCH_BOUND
    speed, allowed_speed : (k,) largest speed of a node, and its bound [m/s]
    of_bodies        : (k,) balance of the rigid bodies without a force term [J]
    allowed_of_bodies : bound of it [J]
    turned, angle, body : (k,) largest bound of the relative energy error of a free body in fixed steps (see
               `exunet.model.limits`), rotation of that body in a step [rad], its name
    round_off        : (k,) error of the balance by round-off [J]
    gained           : (4, k) see `EnergyScale.gained` [J], the largest until each state; truncation errors of
               the work of forces without a potential until each state, a bound [J]
    """

    finite: NDArray[np.bool_]
    balance: Floats
    allowed: Floats
    stretch: Floats
    speed: Floats
    allowed_speed: Floats
    round_off: Floats
    gained: Floats
    of_bodies: Floats
    allowed_of_bodies: float
    turned: Floats
    angle: Floats
    body: NDArray[np.str_]

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """(k,) True for a state that exceeds a bound."""
        inside = self.finite & (np.abs(self.balance) <= self.allowed)
        inside &= np.abs(self.of_bodies) <= self.allowed_of_bodies
        inside &= self.turned <= ENERGY_BOUND
        inside &= (self.stretch <= STRETCH_BOUND) & (self.speed <= self.allowed_speed)
        return ~inside

    def of_steps(self, k: int) -> bool:
        """Return True if state k has an error of its energy balance too, due to the steps."""
        return not (self.finite[k] and self.off[k] <= OF_STEPS)

    @property
    def off(self) -> Floats:
        """(k,) errors of the energy balances over their bounds."""
        bodies = np.abs(self.of_bodies) / self.allowed_of_bodies
        return np.maximum(np.abs(self.balance) / self.allowed, np.maximum(bodies, self.turned / ENERGY_BOUND))

    def turns_too_fast(self, k: int) -> bool:
        """Return True if state k exceeds the bound of rotation only."""
        others = abs(self.balance[k]) <= self.allowed[k] and self.stretch[k] <= STRETCH_BOUND
        return bool(self.finite[k] and others and not self.turned[k] <= ENERGY_BOUND)

    def words(self, k: int) -> str:
        """Describe the bound that state k exceeds."""
        if not self.finite[k]:
            return "the state is not finite"
        if self.stretch[k] > STRETCH_BOUND:
            return f"an element is longer than {STRETCH_BOUND:g} times its length, the limit of the cable law"
        if not abs(self.balance[k]) <= self.allowed[k]:
            change = "increased" if self.balance[k] > 0 else "decreased"
            words = f"the energy balance {change} by {abs(self.balance[k]):.3g} J"
            return f"{words} (allowed {self.allowed[k]:.3g} J)"
        if not abs(self.of_bodies[k]) <= self.allowed_of_bodies:
            words = f"the energy of the rigid bodies changed by {self.of_bodies[k]:.3g} J"
            return f"{words} (allowed {self.allowed_of_bodies:.3g} J)"
        if self.turns_too_fast(k):
            return (
                f"{self.body[k]} rotates by {self.angle[k]:.3g} rad a step, which may have changed its "
                f"energy by {self.turned[k]:.1%} (allowed {ENERGY_BOUND:.0%})"
            )
        return f"a node moves at {self.speed[k]:.3g} m/s (allowed {self.allowed_speed[k]:.3g} m/s)"


class ForceSizes:
    """Magnitudes of the forces of some terms, whose data are made anew for other discrete states."""

    def __init__(
        self, system: System, terms: tuple[KernelTerm | LinearTerm, ...], discrete: DiscreteStates
    ) -> None:
        kernel, self._number = term_kernel(terms), system.blocks.n_force
        self._kernel, self._forces = kernel, kernel.module.forces
        self._discrete, self._table = discrete, kernel.table(discrete)
        self._made_with = system, terms

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy without the compiled module."""
        return ForceSizes, (*self._made_with, self._discrete)

    def of(self, states: States) -> Floats:
        """Compute (k, n) forces on points [N], then forces on bodies, then torques [N m]."""
        if states.discrete is not self._discrete:
            self._discrete, self._table = states.discrete, self._kernel.table(states.discrete)
        force, rows = np.zeros((len(states), self._number)), self._table.rows
        for k, time in enumerate(states.time.tolist()):
            self._forces(time, states.x[k], states.v[k], rows, force[k])
        return np.linalg.norm(force[:, : states.v.shape[1]].reshape(len(states), -1, 3), axis=2)


class Guards:
    """Bounds of a run, from its initial state.

    gained : (4,) energies [J] so far, see `GuardValues.gained`
    """

    def __init__(self, system: System, start: State) -> None:
        now = States.of(system, start)
        self._scale = EnergyScale(now)
        mechanical, self._bodies = (float(part[0]) for part in _energies(now))
        self._start = mechanical + system.lost_at_start
        self.gained, self._step, self._tolerance = np.zeros(4), 0.0, 0.0
        net = system.net
        wave = np.sqrt((net.youngs_modulus / net.density).max(initial=0.0))  # of a just taut element
        self._speeds = float(np.linalg.norm(start.velocity, axis=1).max(initial=0.0) + wave)
        self._mass = float(system.blocks.mass.sum())
        self._system, self._began, self._discrete = system, start.time, start.discrete
        self._turning: RotationError | None = None

    def explain(self, plan: Plan, polynomial: tuple[float, ...]) -> None:
        """Set the plan, and the polynomial of rotation of its method; empty without."""
        step, self._tolerance = plan.step, plan.tolerance or 0.0
        self._step = 0.0 if step is None or METHODS[plan.method].order > LOW_ORDER else step
        forces, linear = self._system.forces, self._system.forces.linear
        terms = forces.nonpotential if self._step or self._tolerance else ()
        self._taking = ForceSizes(self._system, terms, self._discrete) if terms else None
        outer = (() if linear is None else (linear,)) + tuple(k for k in forces.kernels if not k.internal)
        self._pulling = ForceSizes(self._system, outer, self._discrete) if terms and self._tolerance else None
        rotates = step is not None and polynomial and self._system.moves_freely.any()
        self._turning = (
            RotationError(self._system, step, polynomial) if rotates and step is not None else None
        )

    @property
    def scale(self) -> float:
        """Energy scale so far [J], of which errors are a part; 0 if most of it allows for errors."""
        scale = float(self._scaled(self.gained))
        errors = self._scale.errors + self.gained[2] + self.gained[3] / ENERGY_BOUND
        return scale if errors < 0.5 * scale else 0.0

    def _scaled(self, gained: Floats) -> Floats:
        """Return the energy scale (...,) [J] with what was gained (4, ...)."""
        return np.asarray(self._scale.start + gained[0] + gained[3] / ENERGY_BOUND)

    def truncated(self, states: States, rows: NDArray[np.int64]) -> Floats:
        """Bound the truncation errors of work in steps, from the first state to each of these rows [J].

        In fixed steps, VelocityVerlet takes a force by the velocity half a step before: where that changes by
        dv in a step h, the work of drag F ~ v^2 has the error F h dv. The bound is twice that, and it adds
        up to 2 F h |Dv|, Dv the change of velocity between two states, unless velocities oscillate, by cables
        or contact, whose energy is in the scale.

        In adaptive steps, work is summed by Simpson's rule, of the order of the error estimate of DOPRI5.
        With linear damping of time constant T, and the speed u that the forces give in T, a step h = z T has
        the estimate u z^5 / 1200 <= tolerance, and its work an error of at most 14/2880 m u^2 z^5. Over time
        these add up to 14/2880 I u z^4, with the impulse I of drag and fields on the nodes that drag acts on.
        The bound is 3.4 times that, as u is the speed of the fastest node. Beside the tolerance, z is below
        the time between two states over T, and below 1. Cables and contact do not count.
        """
        system = self._system
        if self._taking is None:
            return np.zeros(len(rows))
        states = states[np.append(0, rows)]
        v, time, shape = states.v, np.diff(states.time), (len(states), -1, 3)
        size = self._taking.of(states)
        if self._pulling is not None:
            pull = size + self._pulling.of(states)
            impulse = 0.5 * time[:, None] * (pull[1:] + pull[:-1]) * (size.max(axis=0) > 0.0)
            mass, speed = np.zeros(size.shape[1]), np.linalg.norm(v.reshape(shape), axis=2)
            mass[: len(system.mass)] = system.mass
            rate, fast = size / (mass * speed), speed.max(axis=1, initial=0.0)
            fast = np.maximum(fast[1:], fast[:-1])
            longest = np.fmin(1.0, (1200.0 * self._tolerance / fast) ** 0.2)[:, None]
            z = np.fmin(longest, np.fmax(rate[1:], rate[:-1]) * time[:, None])
            return np.cumsum(OF_ADAPTIVE * fast * np.einsum("kn,kn->k", impulse, z**4))
        twice, change = size[1:] + size[:-1], np.linalg.norm(np.diff(v.reshape(shape), axis=0), axis=2)
        every = (term.data for term in system.forces.nonpotential if isinstance(term, KernelTerm))
        units: Any = (data for data in every if isinstance(data, Thrusters | CountedThrusters))
        for data in units:
            first = data.rate - system.blocks.n_v  # corner units, whose forces jump between these states
            spent = np.diff(states.first_order[:, first : first + len(data.bullets)], axis=0)
            twice[:, data.bullets // 3] += 2.0 * spent / np.maximum(time, 1e-300)[:, None]
        return np.cumsum(np.minimum(self._step, time) * np.einsum("kn,kn->k", twice, change))

    def look(self, states: States, dissipated: Floats, truncated: Floats | float = 0.0) -> GuardValues:
        """Evaluate the bounds of states with their dissipated energy (k,) [J].

        truncated : (k,) see `truncated`, since the last accepted state [J]
        """
        mechanical, of_bodies = _energies(states)
        balance = mechanical + dissipated - self._start
        truncated = np.broadcast_to(self.gained[3] + truncated, len(states))
        gained = np.vstack([self._scale.gained(states, dissipated), truncated])
        gained = np.fmax.accumulate(np.fmax(gained, self.gained[:, None]), axis=1)  # ignores NaN
        given = np.sqrt(2.0 * gained[1] / self._mass)
        round_off = ROUND_OFF * (np.abs(states.kinetic) + np.abs(states.potential))
        return GuardValues(
            finite=np.isfinite(balance) & states.finite,
            balance=balance,
            allowed=ENERGY_BOUND * self._scaled(gained) + LEAST_ENERGY + round_off,
            stretch=STRETCH_BOUND * (states.length / states.longest).max(axis=1, initial=0.0),
            speed=np.sqrt(states.squared_speed.max(axis=1, initial=0.0)),
            allowed_speed=SPEED_BOUND * (self._speeds + given),
            round_off=round_off,
            gained=gained,
            of_bodies=of_bodies - self._bodies,
            allowed_of_bodies=ENERGY_BOUND * self._bodies + LEAST_ENERGY,
            **self._turned(states),
        )

    def _turned(self, states: States) -> dict[str, NDArray[Any]]:
        if self._turning is None:
            nothing = np.zeros(len(states))
            return {"turned": nothing, "angle": nothing, "body": np.full(len(states), "")}
        spin = states.bodies.angular_velocity
        errors = self._turning.error(spin, states.time - self._began)
        worst = errors.argmax(axis=1)
        rows = np.arange(len(states))
        angle = self._turning.angle(spin)[rows, worst]
        return {"turned": errors[rows, worst], "angle": angle, "body": self._turning.names[worst]}


def _energies(states: States) -> tuple[Floats, Floats]:
    """Return the energy of everything with forces, and of the rigid bodies without, (k,) [J]."""
    alone = states.kinetic_of_bodies @ ~states.system.driven  # without prescribed bodies
    return states.kinetic - alone + states.elastic + states.potential, alone


def state_of_worst(system: System, state: State) -> str:
    """Describe the most stretched element and the fastest node of a finite state."""
    position, velocity = state.position, state.velocity
    node = int(np.argmax(np.abs(velocity).max(axis=1)))
    place = ", ".join(f"{x:.3g}" for x in position[node])
    return (
        f"at t = {state.time:.6g} s {_most_stretched(system, state)}the fastest node is {node} "
        f"at ({place}) m, {math.hypot(*velocity[node]):.3g} m/s"
    )


def _most_stretched(system: System, state: State) -> str:
    net, states = system.net, States.of(system, state)
    if not net.n_elements:
        return ""
    with np.errstate(over="ignore", invalid="ignore"):  # the largest finite numbers have no square
        stretches = states.length[0] / states.law.natural_length
        for elements, strain, _ in states.elsewhere:  # of a length that changes
            stretches[elements] = np.sqrt(np.maximum(1.0 + 2.0 * strain[0], 0.0))
        element = int(np.argmax(stretches * states.law.natural_length / states.law.longest))
        force = states.tension[0, element]
    i, j = net.element_nodes[element]
    words = f"the most stretched element is {element} between nodes {i} and {j}, "
    return f"{words}stretch {stretches[element]:.6g}, force {force:.3g} N; "


def beyond_table(states: States, row: int) -> str:
    """Return element, strain and remedy where a strain of a state exceeds its table most; "" if none does."""
    net, law = states.system.net, states.law
    bound = states.longest / law.natural_length
    ends = bound < STRETCH_BOUND
    stretch = states.length[row] / law.natural_length
    if law.number is None or not (stretch[ends] > bound[ends]).any():
        return ""
    element = int(np.argmax(np.where(ends, stretch / bound, 0.0)))
    strain, last = (f"{values[element] - 1.0:.6g}" for values in (stretch, bound))
    key = net.table_keys.get(int(law.number[element]), "table")
    return f"element {element}: the strain {strain} is beyond the last of its table, {last}: extend {key}"


SNAPPING, TURNING = "where cables snap taut", "for the rotation of a body"
TOUCHING, ACTING = "in contact", "for damping, drag, thrust or control"


def where_steps_fail(states: States) -> str:
    """Return what the steps to these states do not resolve: a snap requires a taut element; "" if unknown."""
    forces = states.system.forces
    contacts = tuple(term for term in forces.kernels if term.discrete and "contact/" in term.discrete.name)
    if (states.tension > 0.0).any():
        return SNAPPING
    if contacts and term_kernel(contacts).potential(states.x, states.discrete).any():
        return TOUCHING
    return ACTING if forces.nonpotential else ""


def step_advice(plan: Plan, where: str) -> str:
    """Return cause and remedy of an error due to the steps; where: see `where_steps_fail`, or `TURNING`."""
    where = f" {where}" if where else ""
    if plan.tolerance is not None:
        return (
            f"Likely cause: the tolerance {plan.tolerance:.2g} is too large{where}. "
            "Use a smaller solver.accuracy (or solver.tolerance)"
        )
    kind = "an adaptive method" if METHODS[plan.method].kind == Kind.EXPLICIT else "an explicit method"
    return (
        f"Likely cause: the step {plan.step:.3g} s is too long for {plan.method}{where}. "
        f"Use a smaller solver.step (`exunet check` shows the stable step) or {kind} (solver.method = DOPRI5)"
    )


LOAD_ADVICE = (
    "Likely cause: cables too soft for this motion; the energy balance holds, so not the steps. "
    "Change youngs_modulus, the diameters, the launch speeds, the masses or the forces"
)

COLLAPSE_ADVICE = (
    "Likely cause: a motion, a damping or a force too large for any step, or a tolerance below round-off. "
    "Change the launch speeds, initial, the damping or the external forces, or use a larger "
    "solver.accuracy (or solver.tolerance)"
)

"""Longest macro step of a coupling, by stiffness, damping and light nodes of the net at its ports.

The host's bodies are predicted at the mean acceleration of the step before. For a mass m on a spring k, a net
between the port and something heavy, the coupling without repeats then removes a little energy while H^2 k /
m is below a bound, and adds energy above; at constant velocity it would add energy at every step. The bounds
are where the spectral radius of the linear map from step to step passes 1; `tests/macro_maps.py` has
the maps. A damper c beside the spring makes it H^2 k / m + 2 H c / m. Repeats contract by H^2 k / (6 m) + H c
/ (2 m).

k and c are bounds: all elements at the port's nodes are taut and their other ends do not yield, and all
threads, bullets, corners and edges that may touch the body do so at once, as far from its centre of mass as
its surface reaches. The net can only be softer.

A mode of the net with frequency w responds to a motion of the port at its own frequency, and the port gets
the mean force of a step H in the next: half a period or more late if H w is large, which feeds the mode. Let
s be the square of the force on the port by the mode of unit mass, over the port's mass, [1/s4]; a light mass
n on elements k between a port of mass m and a fixed end is a mode with s = k^2 / (m n). Amplitudes grow by

    H^4 s g(H w)

in a step, to first order in s, with a g that is below zero up to some H w, and below `gain` and
`most` / (H w)^4 beyond. Relaxation by the time tau removes w^2 tau H / 2 in a step. A mode allows a step if

    slow    H^2 (w^2 / slow + k / (m spring)) <= 1: it is not fed. A line between where modes of light masses
            begin to gain, and the bound of a port on springs alone, for masses that are not light
    faint   H^4 s min(gain, most / (H w)^4) <= GROWTH
    damped  the same <= w^2 tau H / 8, a quarter of what relaxation removes

each of which holds for all shorter steps too. Contact is not part of the linear modes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, reduce
from typing import NamedTuple

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.coupling.net_system import LARGEST_TURN, NetSystem
from exunet.forces.cable_term import CableTerm
from exunet.forces.contact import body_contact, sphere_contact
from exunet.forces.contact.body_contact import BodyContact
from exunet.forces.contact.sphere_contact import SphereContact
from exunet.forces.contact.thread_contact import ThreadContact
from exunet.forces.effects.contact import Contact
from exunet.forces.law import STRETCH_BOUND, slope_at
from exunet.forces.on_bodies import held_by, mass_matrix
from exunet.forces.reel import discrete_name
from exunet.model.limits import taut_stiffness
from exunet.model.states import States
from exunet.model.system import State, System


class Feeding(NamedTuple):
    """slow: (H w)^2 up to which modes of light masses gain nothing; gain, most: of g beyond."""

    slow: float
    gain: float
    most: float


class Bound(NamedTuple):
    """Macro steps H are stable while H^2 k / m + damper * H c / m < spring, as far as modes allow."""

    spring: float
    damper: float
    modes: Feeding


STABLE = Bound(1.0, 2.0, Feeding(1.8, 0.11, 5.0))  # without repeats
CONTRACTING = Bound(6.0, 3.0, Feeding(9.0, 0.008, 3.5))  # with repeats
MARGIN = 0.95  # of the step at which amplitudes begin to grow, or repeats to diverge


class Ratios(NamedTuple):
    """k / m [1/s2] and c / m [1/s], sums over all that pulls at one body.

    cable, viscous : the parts of elements at rest: the tangent of their law grows with the stretch
    """

    spring: float = 0.0
    damper: float = 0.0
    cable: float = 0.0
    viscous: float = 0.0

    def plus(self, other: Ratios) -> Ratios:
        """Return the sum of both."""
        return Ratios(*(one + another for one, another in zip(self, other, strict=True)))

    def at(self, slope: float) -> Ratios:
        """Return the ratios with elements whose tangent is `slope` times that at rest; viscous grows less."""
        more = slope - 1.0
        cable, viscous = more * self.cable, more * self.viscous
        return self.plus(Ratios(cable, viscous, cable, viscous))


def ratios_of(net: NetSystem, port: str) -> Ratios:
    """Return the ratios of a port, by mass and inertia of its body in the case."""
    return _of_elements(net, port).plus(_of_contact(net, port))


def _of_elements(net: NetSystem, port: str) -> Ratios:
    """m resists a force at the port's nodes; k is the sum of EA / L, c that times the relaxation time."""
    system = net.simulation.start.system
    number, kinematics = system.blocks.rigid.index(port), system.kinematics
    on, law = kinematics.body == number, system.forces.cable.law
    ends = np.isin(system.net.element_nodes, kinematics.point[on]).any(axis=1)
    stiffness = (law.steepest * law.stiffness / min_lengths(system.forces.cable))[ends]
    damping = 0.0 if law.relaxation_time is None else float((stiffness * law.relaxation_time[ends]).sum())
    mobility = mobility_of(system, number)
    spring = float(stiffness.sum()) * mobility
    return Ratios(spring, damping * mobility, spring, damping * mobility)


def mobility_of(system: System, number: int) -> float:
    """Return the largest acceleration of a node of a body by a unit force there [1/kg]; 0 without nodes."""
    kinematics, body, most = system.kinematics, system.bodies[number], 0.0
    for arm in kinematics.arm[kinematics.body == number]:
        lever = np.cross(np.eye(3), arm)
        turns = lever @ np.diag(1.0 / np.array(body.inertia)) @ lever.T
        most = max(most, 1.0 / body.mass + float(np.linalg.eigvalsh(turns)[-1]))
    return most


def steepest_at_ports(net: NetSystem, ahead: float = 0.0) -> float:
    """Return the largest such tangent of elements at nodes of ports, a time [s] ahead as they move now."""
    system, seen = net.simulation.start.system, net.simulation.view
    kinematics, cable = system.kinematics, system.forces.cable
    nodes = kinematics.point[np.isin(kinematics.body, kinematics.ports)]
    chosen = np.asarray(np.isin(system.net.element_nodes, nodes).any(axis=1))
    carrying = cable.carrying(seen.discrete)
    direct = np.flatnonzero(chosen if carrying is None else chosen & (carrying > 0.0))
    moving = seen.moving.completed(kinematics, seen.time, seen.discrete)
    i, j = system.net.element_nodes[direct].T
    way, rate = (part[j] - part[i] for part in (moving.position, moving.velocity))
    grows = np.maximum(2.0 * ahead * (way * rate).sum(axis=1), 0.0)
    square = ((way * way).sum(axis=1) + grows) / cable.law.natural_length[direct] ** 2
    if cable.law.number is not None:
        square[cable.law.number[direct] > 0] = 1.0  # slopes beyond that of a just taut thread: in `Ratios`
    most = float(np.max(square, initial=1.0))
    if cable.leaves_some:
        for element, strain, _ in States.of(system, State.of(seen.time, moving, seen.discrete)).elsewhere:
            curved = cable.law.number is None or not np.any(cable.law.number[element])
            if curved and np.any(chosen[element]):
                most = max(most, 1.0 + 2.0 * float(np.max(strain)))
    return slope_at(most)


def min_lengths(cable: CableTerm) -> Floats:
    """(n_elements,) smallest natural length [m] of each; shorter than at the start for outlets of reels."""
    least = cable.law.natural_length.copy()
    for winding in cable.reels:
        reel = winding.reel
        # at the drum the outlet stands for the first element, and at the far end it may become the last
        of = [reel.elements[0]]
        if reel.most_on_drum == len(reel.elements) - 1:
            of.append(reel.elements[-1])
        least[of] = cable.law.natural_length[of] * reel.least_outlet / reel.element_length
    return least


def _of_contact(net: NetSystem, port: str) -> Ratios:
    """k is K L of threads and edges of length L, and that of bullets and corners at the largest penetration.

    The damping of Hunt and Crossley's law, a F, and of regularised friction, mu F / v_s, follow from the
    force F at the penetration of an impact of the body at the speed for which the restitution is given, else
    at 1 / a, else at the largest penetration.
    """
    start = net.simulation.start
    system, on = start.system, start.scene.effects.get(Contact)
    body, centre = system.bodies[system.blocks.rigid.index(port)], system.blocks.centre(port)
    total = Ratios()
    for term in system.forces.kernels:
        data = term.data
        if isinstance(data, BodyContact) and centre in (data.body.centre, data.pressing.centre):
            arm = data.body.reach if data.body.centre == centre else data.pressing.reach
            stiffness, depth = float(sum(item.sum() for item in body_contact.steepest(data))), data.allowed
            along, relaxation = data.springs.along, data.springs.relaxation
        elif isinstance(data, ThreadContact | SphereContact) and data.body.centre == centre:
            arm = float(np.linalg.norm(data.body.middle)) + data.body.radius
            touching = data.threads if isinstance(data, ThreadContact) else data.spheres
            depth = data.body.allowed + float(np.max(touching.thick, initial=0.0))
            along, relaxation = touching.spring, touching.relaxation
            if isinstance(data, ThreadContact):
                stiffness = data.law.stiffness * float(data.threads.length.sum())
            else:
                stiffness = sphere_contact.steepest(data) * len(data.spheres.node)
        else:
            continue
        assert on is not None
        law, mobility = data.law, 1.0 / body.mass + arm**2 / min(body.inertia)
        spring = stiffness * mobility
        if speed := on.impact_speed or (1.0 / law.damping if law.damping else 0.0):
            depth = min(depth, speed / math.sqrt(spring)) if spring else depth
        damper = spring * depth * law.damping
        if law.friction > 0.0 and law.slip_speed > 0.0:
            damper += spring * depth * law.friction / law.slip_speed
        elif law.friction > 0.0:
            damper += float((along * relaxation).sum()) * mobility
        total = total.plus(Ratios(spring, damper))
    return total


GROWTH = 2e-3  # of amplitudes in a macro step, that is ignored: by e in five hundred
_QUARTER = 0.25  # of what relaxation removes, that may be fed: no map of heavier masses exceeds it
_MAX_MODES = 240
_ROUND_OFF, _NOISE = 1e-10, 1e-26


class PortModes(NamedTuple):
    """Modes of a just taut net beside a port at rest.

    square     : (n,) squares of the frequencies [1/s2]
    strength   : (n,) s of each [1/s4], by the mobility of the port's nodes
    relaxation : smallest relaxation time of the net's elements [s]
    """

    square: Floats
    strength: Floats
    relaxation: float

    @classmethod
    def of(cls, net: NetSystem, port: str, together: int = 1) -> PortModes:
        """All nodes of the port move alike. The outlets of reels count with their smallest lengths.

        together : number of ports on the host's body
        """
        system = net.simulation.start.system
        cable, number = system.forces.cable, system.blocks.rigid.index(port)
        square, strength = _beside(system, number)
        shorter = float(np.max(cable.law.natural_length / min_lengths(cable), initial=1.0))
        times = cable.law.relaxation_time
        scale = together * mobility_of(system, number)
        relaxation = 0.0 if times is None else float(np.min(times, initial=math.inf))
        return cls(shorter * square, shorter**2 * scale * strength, relaxation)

    def longest(self, feeding: Feeding, spring: float, slope: float) -> float:
        """Return the longest step [s] that all modes allow, with elements of a slope, see `Ratios.at`.

        spring : k / m of the port at that slope, relative to the bound of a port on springs alone [1/s2]
        """
        square, strength = slope * self.square, slope**2 * self.strength
        slow = 1.0 / np.sqrt(square / feeding.slow + spring)
        fed = feeding.gain * strength
        faint = np.where(feeding.most * strength <= GROWTH * square**2, math.inf, (GROWTH / fed) ** 0.25)
        damped = np.cbrt(0.5 * _QUARTER * self.relaxation * square / fed)
        # beyond, the gain falls with the fourth power, and what relaxation removes grows
        damped[damped**4 * square**2 >= feeding.most / feeding.gain] = math.inf
        return float(np.min(np.maximum(slow, np.maximum(faint, damped)), initial=math.inf))


@lru_cache(maxsize=8)
def _beside(system: System, number: int) -> tuple[Floats, Floats]:
    """Squares of frequencies, and of forces on the nodes of a body, for modes of unit mass.

    For large nets in the space of forces that propagate from the port (block Lanczos): its modes have the
    same moments as all modes, so they represent what the port feels.
    """
    mass = np.repeat(system.inert_mass, 3)
    free = np.flatnonzero(np.isfinite(mass))
    scale, stiffness = 1.0 / np.sqrt(mass[free]), taut_stiffness(system)[free]
    nodes = system.kinematics.point[system.kinematics.body == number]
    force = np.zeros((len(free), 3))
    for node in nodes.tolist():
        force += scale[:, None] * stiffness[:, [3 * node, 3 * node + 1, 3 * node + 2]].toarray()
    own, basis, last = stiffness[:, free], np.zeros((len(free), 0)), force
    while basis.shape[1] < _MAX_MODES:
        for _ in range(2):  # once leaves round-off that grows
            last = last - basis @ (basis.T @ last)
        left, values, _ = np.linalg.svd(last, full_matrices=False)
        last = left[:, values > _ROUND_OFF * max(1.0, float(values.max(initial=0.0)))]
        if not last.size:
            break
        basis = np.hstack([basis, last])
        last = scale[:, None] * (own @ (scale[:, None] * last))
    small = basis.T @ (scale[:, None] * (own @ (scale[:, None] * basis)))
    square, vectors = np.linalg.eigh(0.5 * (small + small.T))
    strength = ((vectors.T @ (basis.T @ force)) ** 2).sum(axis=1)
    felt = square > _ROUND_OFF * float(square.max(initial=0.0))
    # small forces count: those of slow modes, whose masses are large
    felt &= strength > _NOISE * float(strength.max(initial=0.0))
    return square[felt], strength[felt]


class LongestStep:
    """Longest macro step [s], by the port with the largest stiffness for its mass; infinite without
    stiffness.

    The tangent of the elements' law grows with their stretch, so the longest step is that of the present
    stretch, `now`; `allows` is for a step that begins. A port that rotates at the start rotates by
    `LARGEST_TURN` in a step at most. `MARGIN` of what springs allow is used.

    shared : groups of ports that are one body of the host: what pulls at them adds up
    Raises InputError for a port that holds masses, such as a packed net or a drum's thread, which resist its
    acceleration more than its body does: no step is short enough.
    """

    def __init__(self, net: NetSystem, bound: Bound, shared: Sequence[Sequence[str]] = ()) -> None:
        for port in net.ports:
            _validate_held(net, port)
        own = {port: ratios_of(net, port) for port in net.ports}
        self._net, self._bound, self._turning = net, bound, math.inf
        self._totals: list[tuple[Ratios, PortModes]] = []
        for port in net.ports:
            of_body = next((group for group in shared if port in group), (port,))
            of_all = reduce(Ratios.plus, [own[item] for item in of_body])
            self._totals.append((of_all, PortModes.of(net, port, len(of_body))))
            if spin := math.hypot(*net.frame(port).angular_velocity):
                self._turning = min(self._turning, LARGEST_TURN / spin)
        self._always = self._at(slope_at(STRETCH_BOUND**2))

    def _at(self, slope: float) -> float:
        bound, longest = self._bound, self._turning
        for ratios, modes in self._totals:
            steep = ratios.at(slope)
            of_modes = modes.longest(bound.modes, steep.spring / bound.spring, slope)
            longest = min(longest, MARGIN * _longest_of(bound, steep), of_modes)
        return longest

    @property
    def now(self) -> float:
        """Longest step with the present stretch."""
        return self._at(steepest_at_ports(self._net))

    def allows(self, step: float) -> bool:
        """Return True for a step [s] that is not longer, with the stretch that elements approach in it."""
        most = step * (1.0 - 1e-9)
        return most <= self._always or most <= self._at(steepest_at_ports(self._net, step))


def longest_step(net: NetSystem, bound: Bound) -> float:
    """Return the longest macro step [s] now, see `LongestStep`."""
    return LongestStep(net, bound).now


def _longest_of(bound: Bound, ratios: Ratios) -> float:
    if not ratios.spring > 0.0:
        return math.inf
    half = 0.5 * bound.damper * ratios.damper
    # the root of spring H^2 + 2 half H = bound, in the form that loses no digits
    return bound.spring / (half + math.sqrt(half * half + ratios.spring * bound.spring))


def _validate_held(net: NetSystem, port: str) -> None:
    """Predicted from the acceleration before, a held inertia must be smaller than that of the body."""
    system = net.simulation.start.system
    number = system.blocks.rigid.index(port)
    body, nothing = system.bodies[number], (np.zeros(0), np.zeros((0, 3)))
    most = {
        discrete_name(reel.reel): np.array([reel.reel.most_on_drum]) for reel in system.forces.cable.reels
    }
    mass, arm = held_by(system.kinematics.held, number, {**net.simulation.start.state.discrete, **most})
    own = mass_matrix(body.mass, np.array(body.inertia), *nothing)
    held = mass_matrix(body.mass, np.array(body.inertia), mass, arm) - own
    if len(mass) and not np.abs(np.linalg.eigvals(np.linalg.solve(own, held))).max() < 1.0:
        raise InputError(
            f"port {port} holds {mass.sum():.4g} kg, too much for its body of {body.mass:.4g} kg: no macro "
            'step is stable. Give the body to the net\'s case (motion = "free", with a wrench from the host)'
        )

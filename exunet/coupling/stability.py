"""Stability of a coupling: stiffness and damping of the net at its ports, modes of light nodes beside them.

Both are bounds: all elements at the port's nodes are taut and their other ends do not yield, and all threads,
bullets, corners and edges that may touch the body do so at once, as far from its centre of mass as its
surface reaches. The net can only be softer.

A mode of the frequency w answers a motion of the port at its own frequency, and the port gets the mean force
of a step H in the next one: half a period or more late if H w is large, which feeds the mode. Let s be the
square of the force on the port by the mode of unit mass, over the port's mass, [1/s4]; a light mass n on
elements k between a port of mass m and a fixed end is a mode with s = k^2 / (m n). Amplitudes grow by

    H^4 s g(H w)

in a step, to first order in s, with a g that is below zero up to some H w, and below `gain` and
`most` / (H w)^4 beyond. Relaxation by the time tau takes w^2 tau H / 2 in a step. So a mode allows a step if

    slow    H^2 (w^2 / slow + k / (m spring)) <= 1: it is not fed. A line between where modes of light masses
            begin to gain, and the bound of a port on springs alone, for masses that are not light
    faint   H^4 s min(gain, most / (H w)^4) <= GROWTH
    damped  the same <= w^2 tau H / 8, a quarter of what relaxation takes

each of which holds for all shorter steps too. `tests/test_light_nodes.py` has the linear map from step to
step, by whose spectral radius the numbers are. Contact is not among what is linear here.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from exunet.coupling.net_system import NetSystem
from exunet.forces.cable_term import CableTerm
from exunet.forces.contact import body_contact, sphere_contact
from exunet.forces.contact.body_contact import BodyContact
from exunet.forces.contact.sphere_contact import SphereContact
from exunet.forces.contact.thread_contact import ThreadContact
from exunet.forces.effects import switched_on
from exunet.model.stability import taut_stiffness
from exunet.model.states import States
from exunet.model.system import State, System

Floats = NDArray[np.float64]


class Ratios(NamedTuple):
    """k / m [1/s2] and c / m [1/s], of which those of all that pulls at one body add up.

    cable, viscous : the parts of them that elements have at rest: their law's tangent grows with the stretch
    """

    spring: float = 0.0
    damper: float = 0.0
    cable: float = 0.0
    viscous: float = 0.0

    def plus(self, other: Ratios) -> Ratios:
        """Of both together."""
        return Ratios(*(one + another for one, another in zip(self, other, strict=True)))

    def at(self, slope: float) -> Ratios:
        """With elements whose tangent is so many times that at rest; viscous stress grows by less."""
        more = slope - 1.0
        cable, viscous = more * self.cable, more * self.viscous
        return self.plus(Ratios(cable, viscous, cable, viscous))


def ratios_of(net: NetSystem, port: str) -> Ratios:
    """Of a port, by mass and inertia that the case states of its body."""
    return _of_elements(net, port).plus(_of_contact(net, port))


def _of_elements(net: NetSystem, port: str) -> Ratios:
    """m resists a force at the port's nodes; k is the sum of EA / L, c that times the relaxation time."""
    system = net.simulation.start.system
    number, kinematics = system.blocks.rigid.index(port), system.kinematics
    on, law = kinematics.body == number, system.forces.cable.law
    ends = np.isin(system.net.element_nodes, kinematics.point[on]).any(axis=1)
    stiffness = (law.stiffness / least_lengths(system.forces.cable))[ends]
    damping = 0.0 if law.relaxation_time is None else float((stiffness * law.relaxation_time[ends]).sum())
    mobility = mobility_of(system, number)
    spring = float(stiffness.sum()) * mobility
    return Ratios(spring, damping * mobility, spring, damping * mobility)


def mobility_of(system: System, number: int) -> float:
    """The largest [1/kg] by which a force at a node of a body moves that node; zero without nodes."""
    kinematics, body, most = system.kinematics, system.bodies[number], 0.0
    for arm in kinematics.arm[kinematics.body == number]:
        lever = np.cross(np.eye(3), arm)
        turns = lever @ np.diag(1.0 / np.array(body.inertia)) @ lever.T
        most = max(most, 1.0 / body.mass + float(np.linalg.eigvalsh(turns)[-1]))
    return most


def slope_at(square: float) -> float:
    """The law's tangent in parts of that at rest, EA / L: of eq. (3) N = EA (s^3 - s) / 2, by s squared."""
    return max(1.0, 1.5 * square - 0.5)


def steepest_at_ports(net: NetSystem, ahead: float = 0.0) -> float:
    """The largest such tangent of the elements at the nodes of ports, a time [s] ahead as they move now."""
    system, seen = net.simulation.start.system, net.simulation.view
    kinematics, cable = system.kinematics, system.forces.cable
    nodes = kinematics.point[np.isin(kinematics.body, kinematics.ports)]
    chosen = np.asarray(np.isin(system.net.element_nodes, nodes).any(axis=1))
    carrying = cable.carrying(seen.memory)
    direct = np.flatnonzero(chosen if carrying is None else chosen & (carrying > 0.0))
    moving = seen.moving.completed(kinematics, seen.time, seen.memory)
    i, j = system.net.element_nodes[direct].T
    way, rate = (part[j] - part[i] for part in (moving.position, moving.velocity))
    grows = np.maximum(2.0 * ahead * (way * rate).sum(axis=1), 0.0)
    square = ((way * way).sum(axis=1) + grows) / cable.law.natural_length[direct] ** 2
    most = float(np.max(square, initial=1.0))
    if cable.leaves_some:
        for element, strain, _ in States.of(system, State.of(seen.time, moving, seen.memory)).elsewhere:
            if np.any(chosen[element]):
                most = max(most, 1.0 + 2.0 * float(np.max(strain)))
    return slope_at(most)


def least_lengths(cable: CableTerm) -> Floats:
    """(n_elements,) the least natural length each may come to [m]: less than now if it is an outlet."""
    least = cable.law.natural_length.copy()
    for winding in cable.reels:
        reel = winding.reel
        # at the drum the outlet stands for the first element, and at the far end it may come to be the last
        of = [reel.elements[0]]
        if reel.most_on_drum == len(reel.elements) - 1:
            of.append(reel.elements[-1])
        least[of] = cable.law.natural_length[of] * reel.least_outlet / reel.element_length
    return least


def _of_contact(net: NetSystem, port: str) -> Ratios:
    """k is that of threads and edges of length L all along, K L, and of bullets and corners at the largest
    depth that may be.

    The damping of Hunt and Crossley's law, a F, and of regularised friction, mu F / v_s, go by the force F:
    it is taken at the depth to which an impact of the body leads, at the speed for which the restitution is
    given, or 1 / a where that is not, and at the largest depth that may be where neither is.
    """
    start = net.simulation.start
    system, on = start.system, cast(Any, switched_on(start.scene.effects).get("contact"))
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


GROWTH = 2e-3  # of amplitudes in a macro step, that is not looked at: by e in five hundred
_QUARTER = 0.25  # of what relaxation takes, that may be fed: the least that no map of heavier masses exceeds
_MOST_MODES = 240
_ROUND_OFF, _NOISE = 1e-10, 1e-26


class Feeding(NamedTuple):
    """slow: (H w)^2 up to which modes of light masses gain nothing; gain, most: of g beyond."""

    slow: float
    gain: float
    most: float


class PortModes(NamedTuple):
    """Of a net beside a port that stands, just taut.

    square     : (n,) of the frequencies [1/s2]
    strength   : (n,) s of each [1/s4], by the mobility of the port's nodes
    relaxation : the least time of the net's elements [s]
    """

    square: Floats
    strength: Floats
    relaxation: float

    @classmethod
    def of(cls, net: NetSystem, port: str, together: int = 1) -> PortModes:
        """All nodes of the port are moved alike. The outlets of reels count with their least lengths.

        together : ports that are one body of the host's
        """
        system = net.simulation.start.system
        cable, number = system.forces.cable, system.blocks.rigid.index(port)
        square, strength = _beside(system, number)
        shorter = float(np.max(cable.law.natural_length / least_lengths(cable), initial=1.0))
        times = cable.law.relaxation_time
        scale = together * mobility_of(system, number)
        return cls(
            shorter * square,
            shorter**2 * scale * strength,
            0.0 if times is None else float(np.min(times, initial=math.inf)),
        )

    def longest(self, feeding: Feeding, spring: float, slope: float) -> float:
        """The longest step [s] that all modes allow, with elements of a slope, see `Ratios.at`.

        spring : k / m of the port at that slope, in parts of the bound of a port on springs alone [1/s2]
        """
        square, strength = slope * self.square, slope**2 * self.strength
        slow = 1.0 / np.sqrt(square / feeding.slow + spring)
        fed = feeding.gain * strength
        faint = np.where(feeding.most * strength <= GROWTH * square**2, math.inf, (GROWTH / fed) ** 0.25)
        damped = np.cbrt(0.5 * _QUARTER * self.relaxation * square / fed)
        # from there on the gain falls with the fourth power, and what the relaxation takes grows
        damped[damped**4 * square**2 >= feeding.most / feeding.gain] = math.inf
        return float(np.min(np.maximum(slow, np.maximum(faint, damped)), initial=math.inf))


@lru_cache(maxsize=8)
def _beside(system: System, number: int) -> tuple[Floats, Floats]:
    """Squares of frequencies and of forces on the nodes of a body, for modes of unit mass.

    Of large nets, by the space in which forces from the port come to act one after the other: its values have
    the same moments as those of all modes (block Lanczos), so it has what the port feels of them.
    """
    mass = np.repeat(system.inert_mass, 3)
    free = np.flatnonzero(np.isfinite(mass))
    scale, stiffness = 1.0 / np.sqrt(mass[free]), taut_stiffness(system)[free]
    nodes = system.kinematics.point[system.kinematics.body == number]
    force = np.zeros((len(free), 3))
    for node in nodes.tolist():
        force += scale[:, None] * stiffness[:, [3 * node, 3 * node + 1, 3 * node + 2]].toarray()
    own, basis, last = stiffness[:, free], np.zeros((len(free), 0)), force
    while basis.shape[1] < _MOST_MODES:
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

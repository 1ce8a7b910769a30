"""A system: a net with what acts on it and the bodies beside it, and the arithmetic that evaluates it.

The N = n + b particles of a system are the net's nodes and, after them, the bodies' centres of mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array

from reference_impl import mirror
from reference_impl.arrays import Floats, Ints
from reference_impl.attachments import Levers
from reference_impl.bodies import Bodies, collect
from reference_impl.case import Case
from reference_impl.closing import Closing, closed_by
from reference_impl.contacts import Contacts, pairs
from reference_impl.effects.bending import Hinges, hinges
from reference_impl.effects.breaking import limits
from reference_impl.effects.orbit import oblate_gradient
from reference_impl.effects.solar_pressure import solar_force
from reference_impl.elements import Elements, damping, mass_proportional
from reference_impl.launch import Barrels, Packed, aimed, packed
from reference_impl.net import Net, diameter, exposed
from reference_impl.reels import Reels, reeled
from reference_impl.self_contact import Meeting, meeting
from reference_impl.start import initial_bodies, initial_state
from reference_impl.thrusters import Thruster

ALONE = collect(())[0]


@dataclass(frozen=True, eq=False)
class Begun:
    """Books at time 0, after a body has thrown the net."""

    body: int  # which of the bodies
    given: Floats  # (7,) impulse, angular impulse about the origin, work [N s, N m s, J]
    left: float  # [J]


@dataclass(frozen=True, eq=False)
class System(Elements):
    """A net with what acts on it: eq. (10), and the arithmetic that evaluates it."""

    symmetric: bool = False  # exactly mirror-symmetric arithmetic, see `mirror`
    assembled: bool = False  # S(x) x + D v with assembled matrices, as eq. (16) is printed
    bodies: Bodies = ALONE
    barrels: Barrels | None = None  # of launch_force
    reels: Reels | None = None
    packed: Packed | None = None  # the net, until a body ejects it
    contacts: Contacts | None = None
    meeting: Meeting | None = None  # of threads of the net
    closing: Closing | None = None
    begun: Begun | None = None  # None: the balances are empty at time 0
    propelled: tuple[tuple[int, Thruster], ...] = ()  # which of the bodies, and by what

    def __post_init__(self) -> None:
        if self.symmetric and self.assembled:
            raise ValueError("the arithmetic must be symmetric or assembled, not both")

    @cached_property
    def compliance_of_inertia(self) -> Floats:
        """1/m of each node (n, 1) [1/kg]; zero for those with no motion of their own: fixed, or of a body."""
        inverse = 1.0 / self.net.mass
        inverse[self.net.fixed_nodes] = 0.0
        inverse[self.net.anchors.node] = 0.0
        return inverse[:, None]

    @cached_property
    def drag(self) -> Floats:
        """Mass-proportional damping of each node (n, 1) [N s/m]: of Rayleigh's kind and mass_damping."""
        return mass_proportional(self)

    @cached_property
    def weight(self) -> Floats:
        """Force of gravity (n, 3) [N]."""
        return np.asarray(self.net.own_mass[:, None] * np.array(self.effects.gravity))

    @cached_property
    def sunlight(self) -> Floats:
        """Force of solar_pressure (n, 3) [N]."""
        light = self.effects.solar_pressure
        assert light is not None
        force = solar_force(light, exposed(self.net, light.bullet_area))
        force[self.led] = 0.0
        return force

    @cached_property
    def oblate(self) -> Floats:
        """Gradient (3, 3) [1/s2] of the acceleration of j2."""
        assert self.effects.j2 is not None
        return oblate_gradient(self.effects.j2)

    @cached_property
    def frontal(self) -> Floats:
        """Area d L (m,) [m2] of each element, across it."""
        return diameter(self.net) * self.net.reference_length

    @cached_property
    def swept(self) -> Floats:
        """Area (n,) [m2] of each node in molecular_drag."""
        drag = self.effects.molecular_drag
        assert drag is not None
        return exposed(self.net, drag.bullet_area)

    @cached_property
    def hinges(self) -> Hinges:
        """Rotational springs of `bending`."""
        assert self.effects.bending is not None
        return hinges(self.effects.bending, self.net)

    @cached_property
    def limits(self) -> Floats:
        """Green-Lagrange strain (m,) [-] at which each element breaks."""
        assert self.effects.breaking is not None
        return limits(self.effects.breaking, self.net, self.free_strain)

    @cached_property
    def chaser(self) -> int:
        """Which particle the chaser of launch_force is."""
        assert self.barrels is not None
        return len(self.net.mass) + self.barrels.body

    @cached_property
    def levers(self) -> Levers:
        """The nodes that are points of bodies, from these bodies' centres of mass."""
        anchors, bodies = self.net.anchors, self.bodies
        arm = anchors.point - bodies.centre_of_mass[anchors.body]
        return Levers(anchors.node, anchors.body, arm, len(bodies.names))

    @cached_property
    def drums(self) -> Levers:
        """The drums (R,) of the reels, from their bodies' centres of mass."""
        assert self.reels is not None
        levers = self.levers
        row = np.array([np.flatnonzero(levers.node == node)[0] for node in self.reels.drum], dtype=np.intp)
        return levers.some(row)

    def bullets_from_chaser(self, x: Floats) -> Floats:
        """The bullets (..., k, 3) [m] from the chaser's centre of mass; x (..., N, 3) [m]."""
        return np.asarray(x.take(self.net.bullet_nodes, axis=-2) - x[..., self.chaser, None, :])

    def ways(self, x: Floats, attitude: Floats) -> Floats:
        """Path lengths s (..., k) [m] of the bullets along their barrels since the start.

        x (..., N, 3) [m] are positions of nodes and bodies, `attitude` R (..., b, 3, 3) of these.
        """
        assert self.barrels is not None
        return self.barrels.ways(self.bullets_from_chaser(x), attitude)

    def packs(self, t: float) -> bool:
        """Whether a body still holds the net packed at t [s]."""
        return self.packed is not None and self.packed.holds(t)

    @cached_property
    def led(self) -> Ints:
        """The nodes that are points of driven bodies: what acts on them from outside changes nothing else."""
        return self.levers.node[self.bodies.free[self.levers.body] == 0.0]

    @cached_property
    def thrusters(self) -> Ints:
        """Nodes of the bullets that `thrust` pushes."""
        assert self.effects.thrust is not None
        return self.net.numbered_bullets[np.array(self.effects.thrust.bullets, dtype=np.intp)]

    @cached_property
    def damping(self) -> csr_array:
        """The constant damping matrix, see the function of this name."""
        return damping(self)

    @cached_property
    def graph(self) -> tuple[csr_array, csr_array]:
        """Pattern (n, n) of the secant stiffness, and the map (nnz, m) from S11 A/L to its entries."""
        i, j = self.ends
        m, n = len(i), len(self.net.mass)
        slot = np.concatenate((i, j, i, j)) * n + np.concatenate((i, j, j, i))
        filled, place = np.unique(slot, return_inverse=True)
        sign, column = np.repeat([1.0, 1.0, -1.0, -1.0], m), np.tile(np.arange(m), 4)
        pattern = csr_array((np.ones(len(filled)), np.divmod(filled, n)), shape=(n, n))
        return pattern, csr_array(coo_array((sign, (place, column)), shape=(len(filled), m)))

    @cached_property
    def incidence(self) -> csr_array:
        """(n, m): +1 where an element ends, -1 where it begins; gathers element forces, eq. (12)."""
        i, j = self.ends
        m = len(i)
        sign, columns = np.repeat([1.0, -1.0], m), np.tile(np.arange(m), 2)
        return csr_array(coo_array((sign, (np.concatenate((j, i)), columns)), shape=(len(self.net.mass), m)))

    @cached_property
    def touching(self) -> csr_array:
        """(n, m): 1 where an element ends or begins."""
        return abs(self.incidence)

    @cached_property
    def leaves(self) -> Ints:
        """Order of additions of the symmetric arithmetic."""
        return mirror.leaves(self.net)


def assemble(case: Case, net: Net, symmetric: bool = False, assembled: bool = False) -> System:
    """The system of a case."""
    bodies, states = collect(initial_bodies(case, net))
    barrels, reels = aimed(case, net, bodies, states), reeled(case, net)
    held = packed(case, net, bodies)
    moving = (bodies, barrels, reels if len(reels) else None, held, pairs(case, net, bodies))
    meets = meeting(case, net, initial_state(case, net)[0])
    thrusters = tuple((bodies.names.index(name), thruster) for name, thruster in case.thrusters)
    closing = closed_by(case, net)
    return System(net, case.effects, symmetric, assembled, *moving, meets, closing, propelled=thrusters)

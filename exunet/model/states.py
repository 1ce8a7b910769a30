"""Batches of states: lengths, strains, tensions, energies and momenta, each computed at its first use.

The guards, the record, the extremes and the energy balance of a run share one batch.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.bodies import rigid
from exunet.bodies.rigid import RigidStates
from exunet.forces import cable
from exunet.forces.cable import AxialLaw
from exunet.forces.law import green_lagrange_strain
from exunet.model import energy
from exunet.model.system import DiscreteStates, Moving, State, System

Selection = slice | NDArray[np.int64]  # numbers in order


class States:
    """States of a system at times (k,) [s] with the same discrete states, in flat arrays.

    x, v   : (k, n_x), (k, n_v), see `exunet.forces.blocks`
    discrete : discrete states, by name
    taken  : (k,) energy [J] that terms without a potential have dissipated, where the stepper sums it
    """

    def __init__(
        self,
        system: System,
        time: Floats,
        x: Floats,
        v: Floats,
        discrete: DiscreteStates,
        taken: Floats | None = None,
    ) -> None:
        self.system, self.time, self.x, self.v = system, time, x, v
        self.discrete, self.taken = discrete, taken

    @classmethod
    def of(cls, system: System, state: State) -> States:
        """Make a batch of one state."""
        x, v = system.layout.pack(state.moving)
        return cls(system, np.array([state.time]), x[None], v[None], state.discrete)

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: Selection) -> States:
        """Select states, with the quantities that were computed of all."""
        if isinstance(rows, np.ndarray) and len(rows) and rows[-1] - rows[0] == len(rows) - 1:
            rows = slice(int(rows[0]), int(rows[-1]) + 1)  # views instead of copies
        taken = None if self.taken is None else self.taken[rows]
        part = States(self.system, self.time[rows], self.x[rows], self.v[rows], self.discrete, taken)
        for name, value in vars(self).items():
            if name in _SERIES:
                vars(part)[name] = value if name in _OF_ALL else value[rows]
        return part

    def copy(self) -> States:
        """Return the states with their own arrays."""
        taken = None if self.taken is None else self.taken.copy()
        return States(self.system, self.time.copy(), self.x.copy(), self.v.copy(), self.discrete, taken)

    def state(self, row: int) -> State:
        """Copy one of the states."""
        moving = self.system.layout.unpack(self.x[row].copy(), self.v[row].copy())
        return State.of(float(self.time[row]), moving, self.discrete)

    def completed(self) -> States:
        """Return the states with prescribed bodies and attached points set."""
        system = self.system
        if not system.kinematics:
            return self
        moving = self.moving.completed(system.kinematics, self.time, self.discrete)
        return States(system, self.time, *system.layout.pack(moving), self.discrete, self.taken)

    @cached_property
    def moving(self) -> Moving:
        """Points, bodies and first-order states, as views."""
        return self.system.layout.unpack(self.x, self.v)

    @cached_property
    def position(self) -> Floats:
        """(k, n_points, 3) [m]."""
        return self.moving.position

    @cached_property
    def velocity(self) -> Floats:
        """(k, n_points, 3) [m/s]."""
        return self.moving.velocity

    @property
    def bodies(self) -> RigidStates:
        """States of the rigid bodies, with k leading."""
        return self.moving.bodies

    @property
    def first_order(self) -> Floats:
        """(k, n_states) first-order states."""
        return self.moving.first_order

    @cached_property
    def law(self) -> AxialLaw:
        """Cable law of the intact elements."""
        return energy.law_of(self.system.forces, self.discrete)

    @cached_property
    def longest(self) -> Floats:
        """(n_elements,) largest lengths [m] for which the laws are meant; infinite of broken elements."""
        cable = self.system.forces.cable
        carrying = cable.carrying(self.discrete)
        return cable.law.longest if carrying is None else np.where(carrying, cable.law.longest, np.inf)

    @cached_property
    def length(self) -> Floats:
        """(k, n_elements) lengths [m], eq. (7)."""
        return cable.lengths(self.system.net, self.position)

    @cached_property
    def strain(self) -> Floats:
        """(k, n_elements) Green-Lagrange strain E11, eq. (6); -1/2 of elements on drums."""
        strain = green_lagrange_strain(self.length, self.system.net.reference_length)
        for element, own, _ in self.elsewhere:
            strain[:, element] = own
        return np.asarray(strain)

    @cached_property
    def tension(self) -> Floats:
        """(k, n_elements) axial forces [N]."""
        net = self.system.net
        tension = cable.element_tension(net, self.law, self.position, self.velocity, self.length)
        for element, _, own in self.elsewhere:
            tension[:, element] = own
        return tension

    @cached_property
    def elsewhere(self) -> list[tuple[Any, Floats, Floats]]:
        """Elements of other terms (outlets of reels, a shortened edge) with their strain and tension."""
        return list(self.system.forces.cable.seen_elsewhere(self.discrete, self.x, self.v))

    @cached_property
    def elastic(self) -> Floats:
        """(k,) U_el of eq. (19) [J]."""
        return cable.elastic_energy(self.law, self.length)

    @cached_property
    def potential(self) -> Floats:
        """(k,) potential energy of the terms [J]."""
        return energy.potential(self.system.forces, self.x, self.discrete)

    @cached_property
    def squared_speed(self) -> Floats:
        """(k, n_points) squared speeds [m2/s2]."""
        return np.einsum("kna,kna->kn", self.velocity, self.velocity)

    @cached_property
    def kinetic_of_bodies(self) -> Floats:
        """(k, n_bodies) kinetic energies of the rigid bodies [J]; zero for prescribed ones."""
        system = self.system
        return rigid.kinetic(system.body_mass, system.body_inertia, self.bodies) * system.moves_freely

    @cached_property
    def kinetic(self) -> Floats:
        """(k,) kinetic energy of points, K of eq. (18), and of rigid bodies [J]."""
        # Not `@`: its round-off depends on the number of states.
        points = 0.5 * np.einsum("kn,n->k", self.squared_speed, self.system.mass)
        return points + self.kinetic_of_bodies.sum(axis=1) if self.system.bodies else points

    @cached_property
    def momentum(self) -> Floats:
        """(k, 3) momentum of all but prescribed bodies [kg m/s]."""
        points, moves = energy.momentum(self.system.mass, self.velocity), self.system.moves_freely
        return points + energy.momentum(self.system.body_mass * moves, self.bodies.velocity)

    @cached_property
    def angular_momentum(self) -> Floats:
        """(k, 3) angular momentum of all but prescribed bodies, about the origin [kg m2/s]."""
        points = energy.angular_momentum(self.system.mass, self.position, self.velocity)
        moves = self.system.moves_freely
        mass, inertia = self.system.body_mass * moves, self.system.body_inertia * moves[:, None]
        return points + rigid.angular_momentum(mass, inertia, self.bodies)

    @cached_property
    def finite(self) -> NDArray[np.bool_]:
        """(k,) True where positions, attitudes and first-order states are finite."""
        return np.isfinite(self.x.sum(axis=1))

    def work_taken(self) -> Floats:
        """Compute (k - 1,) energies [J] dissipated by terms without a potential between the states."""
        if not self.system.forces.dissipates:
            return np.zeros(len(self) - 1)
        return energy.work_taken(self.system, self.time, self.x, self.v, self.discrete)

    @cached_property
    def given_work(self) -> Floats:
        """(k,) net energy input since the start [J], see `System.given_work`."""
        return self.system.given_work(self.first_order)


_OF_ALL = "law", "longest"
_VIEWS = "moving", "position", "velocity", "elsewhere"
_SERIES = tuple(
    name for name, value in vars(States).items() if isinstance(value, cached_property) and name not in _VIEWS
)

"""The scale of a run's energies: what can deform a net, without the motion of free parts as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from exunet.system import energy
from exunet.system.states import States
from exunet.system.system import State, System

Floats = NDArray[np.float64]

# The common translation of a free part deforms nothing, but the errors of its integration are in the books:
# those of its own energy, and those of the work that is summed over the steps.
TRANSLATION_PART = 1e-9
WORK_PART = 1e-5


class EnergyScale:
    """What energy can deform the net of a system that starts in a state, and what is added later.

    By Koenig's theorem the kinetic energy of a part that nothing holds is that of its centre of mass plus
    that in its centre-of-mass frame; only the latter can stretch a cable. Of a potential, the part that the
    nodes would have if all were at their centre of mass goes with the former: all of it in a uniform field,
    which leaves the motion in that frame alone. By the momentum theorem, what forces without a potential do
    to the centre of mass is the change of its energy; the rest of their work counts.

    A rigid body that no force acts on has a balance of its own (see `exunet.simulation.guards`).

    start : that energy at the start, kinetic and elastic [J]
    """

    def __init__(self, system: System, state: State) -> None:
        self._forces = system.forces
        self._rest = state.position
        self._parts(system)
        position, velocity = state.position, state.velocity
        kinetic = energy.kinetic(system.mass, velocity)
        elastic = energy.elastic(system.forces, position, state.memory)
        self._common = self._of_centres(position[None], velocity[None])
        self._potential = float(energy.potential(system.forces, position[None], state.memory)[0])
        moving = float(self._common[0][0])
        self.start = float(kinetic + elastic) - moving + TRANSLATION_PART * moving

    def _parts(self, system: System) -> None:
        """Which points hang together, and the averages over those that no fixed node holds."""
        net, mass, n = system.net, system.mass, system.points.n_points
        i, j = net.element_nodes.T
        links = csr_array((np.ones(len(i)), (i, j)), shape=(n, n))
        part = connected_components(links, directed=False)[1]
        free = np.setdiff1d(part, part[net.fixed_nodes])
        self._free = np.flatnonzero(np.isin(part, free))  # points
        self._part = np.searchsorted(free, part[self._free])
        self._mass = np.bincount(self._part, mass[self._free], minlength=len(free))
        self._mean = np.zeros((len(free), n))  # averages over the parts, by mass
        self._mean[self._part, self._free] = mass[self._free] / self._mass[self._part]

    def _of_centres(self, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Kinetic and potential energy [J] of the centres of mass; states (k, n_points, 3) -> (k,) each."""
        speeds = self._mean @ velocity
        kinetic = 0.5 * np.einsum("kpa,kpa,p->k", speeds, speeds, self._mass)
        if not self._forces.has_potential:
            return kinetic, np.zeros(len(position))
        gathered = np.repeat(self._rest[None], len(position), axis=0)
        gathered[:, self._free] = (self._mean @ position)[:, self._part]
        return kinetic, energy.potential(self._forces, gathered)

    def gained(self, states: States, dissipated: Floats) -> Floats:
        """(2, k) energy [J] that potentials and forces have added to that scale since the start, and in all.

        dissipated : (k,) energy taken out until these states [J]
        """
        if not (self._forces.has_potential or self._forces.dissipates):
            return np.zeros((2, len(states)))
        kinetic, common = self._of_centres(states.position, states.velocity)
        common_change = common - self._common[1]
        change = states.potential - self._potential
        done = -dissipated - (kinetic - self._common[0]) - common_change
        errors = TRANSLATION_PART * np.abs(common_change) + WORK_PART * np.abs(dissipated)
        own = np.maximum(np.abs(change - common_change), done) + errors
        return np.array([own, np.maximum(np.abs(change), -dissipated)])

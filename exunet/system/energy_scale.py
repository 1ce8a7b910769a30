"""The energy in play: what can deform a net, told apart from the motion of each free part as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from exunet.forces.terms import Terms
from exunet.net.arrays import Net
from exunet.system import energy

Floats = NDArray[np.float64]

# The common translation of a free part is no energy in play, but the errors of its integration are part of
# the ledger: those of its own energy, and those of the work that is summed over the steps.
TRANSLATION_PART = 1e-9
WORK_PART = 1e-5


class InPlay:
    """Counts from a start (position, velocity (n_nodes, 3)) what energy is, and comes, into play.

    By Koenig's theorem the kinetic energy of a part that nothing holds is that of its centre of mass plus
    that in its centre-of-mass frame; only the latter can stretch a cable. Of a potential, the part that the
    nodes would have if all were at their centre of mass goes with the former: all of it in a uniform field,
    which leaves the motion in that frame alone. By the momentum theorem, what forces without a potential do
    to the centre of mass is the change of its energy; the rest of their work is in play.

    start : kinetic and elastic energy in play at the start [J]
    """

    def __init__(self, net: Net, terms: Terms, position: Floats, velocity: Floats) -> None:
        self._terms = terms
        self._rest = position
        self._parts(net)
        kinetic, elastic = energy.kinetic(net, velocity), energy.elastic(net, terms, position)
        self._common = self._of_centres(position[None], velocity[None])
        self._potential = float(energy.potential(terms, position[None])[0])
        moving = float(self._common[0][0])
        self.start = float(kinetic + elastic) - moving + TRANSLATION_PART * moving

    def _parts(self, net: Net) -> None:
        """Which nodes hang together, and the averages over those that no fixed node holds."""
        i, j = net.element_nodes.T
        links = csr_array((np.ones(len(i)), (i, j)), shape=(net.n_nodes, net.n_nodes))
        part = connected_components(links, directed=False)[1]
        free = np.setdiff1d(part, part[net.fixed_nodes])
        self._free = np.flatnonzero(np.isin(part, free))  # nodes
        self._part = np.searchsorted(free, part[self._free])
        self._mass = np.bincount(self._part, net.mass[self._free], minlength=len(free))
        self._mean = np.zeros((len(free), net.n_nodes))  # averages over the parts, by mass
        self._mean[self._part, self._free] = net.mass[self._free] / self._mass[self._part]

    def _of_centres(self, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Kinetic and potential energy [J] of the centres of mass; states (k, n_nodes, 3) -> (k,) each."""
        speeds = self._mean @ velocity
        kinetic = 0.5 * np.einsum("kpa,kpa,p->k", speeds, speeds, self._mass)
        if not self._terms.has_potential:
            return kinetic, np.zeros(len(position))
        gathered = np.repeat(self._rest[None], len(position), axis=0)
        gathered[:, self._free] = (self._mean @ position)[:, self._part]
        return kinetic, energy.potential(self._terms, gathered)

    def gained(self, position: Floats, velocity: Floats, potential: Floats, dissipated: Floats) -> Floats:
        """(2, k) energy [J] that potentials and forces have brought into play since the start, and in all.

        position, velocity (k, n_nodes, 3); potential and dissipated energy (k,) [J] of these states
        """
        if not (self._terms.has_potential or self._terms.dissipates):
            return np.zeros((2, len(position)))
        kinetic, common = self._of_centres(position, velocity)
        common_change = common - self._common[1]
        change = potential - self._potential
        done = -dissipated - (kinetic - self._common[0]) - common_change
        errors = TRANSLATION_PART * np.abs(common_change) + WORK_PART * np.abs(dissipated)
        own = np.maximum(np.abs(change - common_change), done) + errors
        return np.array([own, np.maximum(np.abs(change), -dissipated)])

"""Scale of a run's energies: what can deform a net, without the rigid translation of free parts."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from exunet.model import energy
from exunet.model.states import States
from exunet.model.system import System

Floats = NDArray[np.float64]

# The translation of a free part deforms nothing, but the energy balance has the errors of its integration:
# those of its kinetic energy, and those of the work that is summed over the steps.
TRANSLATION_PART = 1e-9
WORK_PART = 1e-5


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
    links = csr_array((np.ones(len(i)), (i, j)), shape=(n, n))
    part = connected_components(links, directed=False)[1]
    # Points that sleep hold their part too, and prescribed bodies stop what touches them.
    free_bodies = system.blocks.free_bodies
    stopped = any(name not in free_bodies for name in system.blocks.surfaces)
    held = part if stopped or system.blocks.awake is not None else part[system.held]
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
    tether's kinetic energy at the rate of the drum counts too.

    A rigid body without a force term has a balance of its own (see `exunet.simulation.guards`). A body with
    a force term may meet every free part: all of these count as one part.

    start : one state; as an attribute the kinetic and elastic energy there [J]
    """

    def __init__(self, start: States) -> None:
        system = start.system
        self._forces, self._layout, self._driven = system.forces, system.layout, system.driven
        outer = tuple(term for term in system.forces.kernels if not term.internal)
        self._outer = replace(system.forces, kernels=outer)
        self._given = any(state.gives for state in system.blocks.states)
        self._free, self._before = free_parts(system), system.lost_at_start
        self._rest = start.flat[0][0]
        kinetic = energy.kinetic(system.mass, start.velocity[0]) + start.kinetic_of_bodies[0] @ system.driven
        self._common = self._of_centres(start)
        self._potential = float(start.potential[0])
        moving = float(self._common[0][0])
        self.start = float(kinetic + start.elastic[0]) - moving + TRANSLATION_PART * moving

    def _of_centres(self, states: States) -> tuple[Floats, Floats]:
        """Compute the kinetic and potential energy [J] of the centres of mass of k states -> (k,) each."""
        position, velocity = states.position, states.velocity
        if self._driven.any():
            position = np.concatenate([position, states.bodies.position[:, self._driven]], axis=1)
            velocity = np.concatenate([velocity, states.bodies.velocity[:, self._driven]], axis=1)
        speeds = self._free.mean @ velocity
        kinetic = 0.5 * np.einsum("kpa,kpa,p->k", speeds, speeds, self._free.mass)
        if not self._outer.has_potential:
            return kinetic, np.zeros(len(position))
        flat = np.repeat(self._rest[None], len(position), axis=0)
        gathered = self._layout.unpack(flat, np.empty((len(position), self._layout.blocks.n_v)))
        centres = (self._free.mean @ position)[:, self._free.part]
        members, n_points = self._free.members, gathered.position.shape[1]
        points = members < n_points
        gathered.position[:, members[points]] = centres[:, points]
        bodies = np.flatnonzero(self._driven)[members[~points] - n_points]
        gathered.bodies.position[:, bodies] = centres[:, ~points]
        return kinetic, energy.potential(self._outer, flat, states.memory)

    def gained(self, states: States, dissipated: Floats) -> Floats:
        """Compute (2, k) energies [J] added by potentials and forces since the start: to the scale, in total.

        dissipated : (k,) energy dissipated until these states [J], an ejection at time 0 included
        """
        if not (self._forces.has_potential or self._forces.dissipates or self._given):
            return np.zeros((2, len(states)))
        dissipated = dissipated - self._before
        kinetic, common = self._of_centres(states)
        common_change = common - self._common[1]
        change = states.potential - self._potential
        done = -dissipated - (kinetic - self._common[0]) - common_change
        errors = TRANSLATION_PART * np.abs(common_change) + WORK_PART * np.abs(dissipated)
        reels, first = self._forces.cable.reels, states.flat[0][0]
        drawn = max((reel.drawn(states.memory, first) for reel in reels), default=0.0)
        own = np.maximum(np.maximum(np.abs(change - common_change), done), drawn) + errors
        return np.array([own, np.maximum(np.abs(change), -dissipated)])

"""Orders of magnitude: what leaving an effect out would change, from the state in which a scene begins.

An estimate is a hand calculation on a *nominal motion*, not a simulation. The nominal motion keeps the
bullets at their initial velocity; the other nodes move with the centre of mass and open evenly, as if the net
grew from its initial to its reference configuration while the bullets fly the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces.blocks import Blocks
from exunet.forces.environment import CircularOrbitConfig
from exunet.net.arrays import Net


@dataclass(frozen=True)
class Estimate:
    """Estimated influence of an effect on a scene, as root mean squares over the mass of the free nodes.

    acceleration : [m/s2] that it gives
    displacement : [m] that it makes over the scene's duration
    source       : the formula, with its numbers
    """

    acceleration: float
    displacement: float
    source: str


@dataclass(frozen=True, eq=False)
class EstimateBasis:
    """Scene data available to an estimate.

    net      : the woven net
    duration : of the scene [s]
    position, velocity : (n_nodes, 3) initial state [m], [m/s]
    orbit    : of the case; None: it has none
    """

    net: Net
    duration: float
    position: Floats
    velocity: Floats
    orbit: CircularOrbitConfig | None = None

    @cached_property
    def blocks(self) -> Blocks:
        """Return the degrees of freedom that forces act on: the nodes alone."""
        return Blocks.of_net(self.net, self.position)

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(n_nodes,) False for nodes that are held still."""
        free = np.ones(self.net.n_nodes, dtype=bool)
        free[self.net.fixed_nodes] = False
        return free

    @cached_property
    def size(self) -> float:
        """Largest side of the box round the reference configuration [m]."""
        return self.net.size

    @cached_property
    def opening_time(self) -> float:
        """Time [s] in which the bullets would fly from their initial to their reference distance."""
        bullets = self.net.bullet_nodes
        if not len(bullets):
            return math.inf
        start, end = self.position[bullets], self.net.reference_position[bullets]
        outward = end / np.linalg.norm(end, axis=1, keepdims=True)
        speed = float(np.einsum("ba,ba->b", self.velocity[bullets], outward).mean())
        way = float((np.linalg.norm(end, axis=1) - np.linalg.norm(start, axis=1)).mean())
        return way / speed if speed > 0.0 and way > 0.0 else math.inf

    @cached_property
    def motion(self) -> Floats:
        """(n_nodes, 3) velocities of the nominal motion [m/s]."""
        bullets = self.net.bullet_nodes
        if not len(bullets):
            return np.where(self.free[:, None], self.velocity, 0.0)
        mass = np.where(self.free, self.net.mass, 0.0)
        common = mass @ self.velocity / mass.sum()
        motion = common + (self.net.reference_position - self.position) / self.opening_time
        motion[bullets] = self.velocity[bullets]
        return np.where(self.free[:, None], motion, 0.0)

    @cached_property
    def middle(self) -> Floats:
        """(n_nodes, 3) positions of the nominal motion half-way through the scene [m]."""
        return self.position + 0.5 * min(self.duration, self.opening_time) * self.motion

    @cached_property
    def speed(self) -> float:
        """Root mean square speed of the nominal motion [m/s]."""
        return self.rms(self.motion)

    def rms(self, nodal: Floats) -> float:
        """Root mean square over the free mass of vectors (n_nodes, 3)."""
        mass = np.where(self.free, self.net.mass, 0.0)
        if not mass.any():
            return 0.0
        return math.sqrt(float(mass @ np.einsum("na,na->n", nodal, nodal)) / float(mass.sum()))

    def of_force(self, force: Floats) -> float:
        """Root mean square acceleration [m/s2] under forces (n_nodes, 3) [N]."""
        return self.rms(force / self.net.mass[:, None])

    def ballistic(self, acceleration: float) -> float:
        """a T^2 / 2 [m]; a net that is held cannot move by more than its size."""
        return self.held(0.5 * acceleration * self.duration**2)

    def held(self, displacement: float) -> float:
        """The displacement, but for a net with fixed nodes not more than its size [m]."""
        return min(displacement, self.size) if len(self.net.fixed_nodes) else displacement

    def braked(self, rate: float) -> float:
        """Way [m] that a speed decaying at `rate` [1/s] falls behind: v (T - (1 - exp(-c T)) / c)."""
        lost = rate * self.duration
        if lost < 1e-4:
            return self.speed * self.duration * 0.5 * lost
        return self.speed * self.duration * (1.0 + math.expm1(-lost) / lost)


@dataclass(frozen=True)
class Snap:
    """The hardest snap that a scene's first jerk can make, of two masses through one element.

    speed     : closing speed [m/s]
    frequency : sqrt(EA / (L0 mu)) [rad/s], mu the reduced mass
    strain    : largest Green-Lagrange strain v sqrt(mu / (EA L0)), from the energy balance of the snap
    """

    speed: float
    frequency: float
    strain: float


def snap_of(basis: EstimateBasis) -> Snap:
    """The hardest snap that the parting of elements' ends at the start can lead to, by its strain."""
    net = basis.net
    i, j = net.element_nodes.T
    if not len(i):
        return Snap(0.0, 0.0, 0.0)
    parting = np.linalg.norm(basis.velocity[j] - basis.velocity[i], axis=1)
    inverse = np.where(basis.free, 1.0 / net.mass, 0.0)
    both = inverse[i] + inverse[j]
    with np.errstate(divide="ignore"):
        reduced = np.where(both > 0.0, 1.0 / both, 0.0)
    strain = parting * np.sqrt(reduced / (net.axial_stiffness * net.reference_length))
    worst = int(np.argmax(strain))
    mu = float(reduced[worst])
    frequency = math.sqrt(float(net.axial_stiffness[worst] / net.reference_length[worst]) / mu) if mu else 0.0
    return Snap(float(parting[worst]), frequency, float(strain[worst]))


def hardest_strain(basis: EstimateBasis) -> float:
    """Strain of the first snap, or if more, of a bullet stopped by one element of the softest cable."""
    net, first = basis.net, snap_of(basis).strain
    bullets = net.bullet_nodes
    if not len(bullets) or not net.n_elements:
        return first
    relative = basis.velocity[bullets] - basis.motion.mean(axis=0)
    energy = net.mass[bullets] * np.einsum("ba,ba->b", relative, relative)
    softest = float((net.axial_stiffness * net.reference_length).min())
    return max(first, math.sqrt(float(energy.max()) / softest))

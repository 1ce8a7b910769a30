"""What is measured on a run: speeds at its end, energy, momentum, the four measures of deployment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import RigidStates
from exunet.forces.terms import LinearTerm
from exunet.results.measures import Deployment, deployment_of
from exunet.simulation.preparation import Start
from exunet.studies.neighbours import bullet_speeds
from exunet.system import energy
from exunet.system.energy_scale import EnergyScale
from exunet.system.states import States

Floats = NDArray[np.float64]

# The four measures of deployment: name, unit.
FOUR = (
    ("largest area", "of the reference area"),
    ("time of largest area", "s"),
    ("distance", "m"),
    ("time above 80 %", "s"),
)


@dataclass(frozen=True)
class Measures:
    """Numbers of one run.

    speeds   : (k,) speeds at the end [m/s], of the bullets, or of all nodes if there are none
    energy   : largest error of the energy balance over the stored times, relative to the energy in play
    momentum : largest change of the linear momentum, relative to the sum of m |v| at the start; None where
               forces from outside change it
    deployment : over the stored times; None for a net without a mouth
    """

    speeds: Floats
    energy: float
    momentum: float | None = None
    deployment: Deployment | None = None


def four(found: Deployment) -> tuple[float, ...]:
    """The measures of deployment in the order and units of FOUR."""
    return found.relative_area, found.time_of_largest, found.distance, found.time_open


def measures(start: Start, time: Floats, position: Floats, velocity: Floats, dissipated: Floats) -> Measures:
    """Measures of a trajectory; time (t,) [s], position, velocity (t, n_points, 3), dissipated (t,) [J].

    The energy is relative to what the guards go by: the energy in play, without the common flight.
    """
    net, bodies = start.net, RigidStates.none(len(time))
    states = States(start.system, time, position, velocity, bodies, start.state.memory)
    total = states.kinetic + states.elastic + (states.potential - states.potential[0]) + dissipated
    scales = EnergyScale(start.system, start.state)
    gained = scales.gained(states, dissipated)[0]
    scale = scales.start + float(gained.max()) or float(states.kinetic.max()) or 1.0
    return Measures(
        speeds=bullet_speeds(net, velocity[-1]),
        energy=float(np.abs(total - total[0]).max()) / scale,
        momentum=_momentum(start, velocity),
        deployment=deployment_of(net, time, position[:, : net.n_nodes]),
    )


def _momentum(start: Start, velocity: Floats) -> float | None:
    net, mass, forces = start.net, start.system.mass, start.system.forces
    moved = energy.momentum(mass, velocity)
    scale = float(mass @ np.linalg.norm(velocity[0], axis=-1))
    linear = forces.linear or LinearTerm()
    outside = (linear.load, linear.stiffness, linear.gyroscopic)
    if any(term is not None for term in outside) or forces.kernels or len(net.fixed_nodes) or not scale:
        return None
    if linear.damping is not None and np.linalg.norm(moved[0]) > 1e-12 * scale:
        return None  # damping of the motion as a whole
    return float(np.linalg.norm(moved - moved[0], axis=-1).max()) / scale

"""What two runs of a scene are compared by: numbers in m/s, whose largest difference counts.

Of the net the speeds of its bullets, or of all nodes. Of each point mass and rigid body, in each coordinate,
velocities and places of points of it: of its centre and, of a rigid one, of the ends of three arms along its
axes, as long as its radius of gyration. So attitudes and angular velocities count as what they move. Places
are divided by the time of the run: a speed that errs all the time by as much gives such a difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.studies.both_trajectories import with_arms
from exunet.studies.neighbours import tracked_speeds
from exunet.system.system import System

Floats = NDArray[np.float64]
Motion = tuple[Floats, Floats, Floats, Floats]


def tracked(
    system: System, velocity: Floats, masses: tuple[Floats, Floats], bodies: Motion, duration: float
) -> Floats:
    """(t, k) numbers [m/s] of the states of a system, the speeds of the net first.

    velocity : (t, n_nodes, 3) [m/s]
    masses   : places and velocities (t, p, 3) of the point masses
    bodies   : of rigid bodies, in the order of the system: places and velocities (t, b, 3), attitudes of
               their frames (t, b, 3, 3), and angular velocities in these (t, b, 3)
    duration : of the run [s]
    """
    lengths = np.array([np.sqrt(max(body.inertia) / body.mass) for body in system.bodies])
    place, speed = with_arms(masses, bodies, lengths)
    count = len(velocity)
    parts = (
        tracked_speeds(system.net, velocity),
        speed.reshape(count, -1),
        place.reshape(count, -1) / duration,
    )
    return np.concatenate(parts, axis=1)

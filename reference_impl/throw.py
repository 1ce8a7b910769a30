"""What the books of a run hold at time 0, where a body throws the net that it carries.

The state at time 0 is the one after the throw.  The impulses P that the nodes get are given by points of the
body, which move as the nodes did before: they do the work sum of P.v on them.
"""

from __future__ import annotations

import numpy as np

from reference_impl import energy
from reference_impl.arrays import cross
from reference_impl.bodies import collect
from reference_impl.case import Case
from reference_impl.start import before_throw, initial_bodies, initial_state, thrown_at_start
from reference_impl.system import Begun, System


def begun(case: Case, system: System) -> Begun | None:
    """The books at time 0; None where they are empty."""
    net, carrier = system.net, case.start.carrier
    throw = thrown_at_start(case, net)
    if throw is None or carrier is None:
        return None
    x, v, bodies = before_throw(case, net)
    impulse = net.mass[:, None] * throw
    given = (impulse.sum(axis=0), cross(x, impulse).sum(axis=0), [np.sum(impulse * v)])
    had = energy.kinetic(system, v, collect(bodies)[1])
    has = energy.kinetic(system, initial_state(case, net)[1], collect(initial_bodies(case, net))[1])
    return Begun(system.bodies.names.index(carrier.body), np.concatenate(given), float(had - has))

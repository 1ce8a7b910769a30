"""Whole runs of scenes with bodies: trajectories of both codes until the horizon, and what these keep."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.studies.both_codes import BothCodes
from exunet.verification import tolerances as tol
from exunet.verification.answers.both import best
from exunet.verification.balances import energies, kept, momenta
from exunet.verification.check import Check, Evidence
from exunet.verification.growth import Growth, growth
from exunet.verification.horizon import sensitivity
from exunet.verification.trajectories import OWN, converged, tolerance_for

INSTANTS = 24
CLOSED = {
    "material_damping",
    "breaking",
    "bending",
    "thermal_strain",
}  # effects that push nothing from outside


def trajectories(case: BothCodes) -> Iterator[Evidence]:
    """Rungs 5 and 7 for a scene with bodies, and its balances until the horizon."""
    grown = growth(case)
    yield from sensitivity(case, grown)
    yield from converged(case, grown)
    yield from balances(case, grown)


def balances(case: BothCodes, grown: Growth) -> Iterator[Check]:
    """Energy, and where nothing acts from outside momentum and angular momentum, of each code's best run."""
    end = min(grown.horizon, float(grown.time[-1]))
    times = np.linspace(0.0, end, INSTANTS + 1)
    for code, motion in best(case, times, tolerance_for(case, OWN[1]), booked=True):
        found = [energies(case, motion, tol.BODY_ENERGY)]
        if case.effects <= CLOSED:
            found += momenta(case, motion, tol.MOMENTUM, tol.ANGULAR)
        yield from kept(found, times, code)

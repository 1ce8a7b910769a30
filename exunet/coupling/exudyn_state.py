"""The state of a user's Exudyn system, taken and put back to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn
from exunet.base.errors import InputError
from exunet.coupling.handover import Weights

Floats = NDArray[np.float64]

# Their steps depend on nothing but coordinates, velocities, data and time, which the engine gives and takes.
# Velocity Verlet, implicit and adaptive methods keep more.
EXACT = ("ExplicitMidpoint", "RK33", "RK44", "RK67")
# In parts of the largest: accelerations that are given, and one that follows from a difference of velocities.
_SAME_ACCELERATION, _NEARLY = 1e-10, 1e-4
_UNKNOWN = (
    "couple: the host has rejected a step, and what its generalised-alpha method goes on with is not known: "
    "set timeIntegration.generalizedAlpha.useNewmark, or use TrapezoidalIndex2: neither keeps an acceleration"
)
_PARTS = ("ODE2", "ODE2_t", "ODE1", "AE", "data")  # of the engine's list


def state_of(mbs: Any, time: float) -> dict[str, Floats]:
    """All that the engine gives, and the time (1,) [s]; copies."""
    state = mbs.systemData.GetSystemState()
    parts = {name: np.array(part, dtype=float) for name, part in zip(_PARTS, state, strict=True)}
    return {"time": np.array([time]), **parts}


def put_back(who: str, mbs: Any, state: Mapping[str, Floats]) -> float:
    """Put back what `state_of` gave, also as what the next run starts from; returns its time [s].

    Raises InputError for a state that is none, or is of a system with other coordinates.
    """
    own = state_of(mbs, 0.0)
    if not isinstance(state, Mapping) or {name: np.shape(part) for name, part in state.items()} != {
        name: part.shape for name, part in own.items()
    }:
        raise InputError(f"{who}: restore: the state is not of this system: it has other coordinates")
    kinds = exudyn(quiet=False).ConfigurationType
    for kind in (kinds.Initial, kinds.Current):
        mbs.systemData.SetSystemState([state[name] for name in _PARTS], kind)
        mbs.systemData.SetTime(float(state["time"][0]), kind)
    return float(state["time"][0])


class Attempt(NamedTuple):
    """At a step of which others were rejected, by generalised-alpha, which keeps an acceleration a.

    failures : how many of those have changed a
    kept     : a at the end of the step before
    now      : a with which this attempt begins; both (n,) of all coordinates
    velocity : (n,) at the beginning
    """

    failures: int
    kept: Floats
    now: Floats
    velocity: Floats


def begun(mbs: Any, solver: Any, weights: Weights, rejected: int) -> Attempt:
    """Where an attempt begins, after as many that were rejected.

    Before Newton's method begins the engine turns a into f / (1 - m) F - m / (1 - m) a, with the acceleration
    F of the last step. Where full Newton fails it goes on from there (1.13); where a post-Newton function
    asks for a shorter step, a is put back.
    Raises InputError if a is not what so many failures can lead to.
    """
    kept, now = solver.GetStartOfStepStateAAlgorithmic(), solver.GetAAlgorithmic()
    data, start = mbs.systemData, exudyn(quiet=False).ConfigurationType.StartOfStep
    given, velocity = data.GetODE2Coordinates_tt(start), data.GetODE2Coordinates_t(start)
    near = _SAME_ACCELERATION * max(np.abs(kept).max(), np.abs(given).max())
    for number in range(rejected + 1):
        led = weights.faded(kept, given, number) if number else kept
        if np.abs(now - led).max() <= near:
            return Attempt(number, kept, now, velocity)
    raise InputError(_UNKNOWN)


def ended(mbs: Any, solver: Any, weights: Weights, attempt: Attempt, step: float) -> int:
    """How many failures have changed the acceleration with which a step [s] was taken that has just ended.

    Modified Newton that starts anew within the attempt has put it back.
    """
    velocity, last = mbs.systemData.GetODE2Coordinates_t(), solver.GetAAlgorithmic()
    found = ((velocity - attempt.velocity) / step - weights.gamma * last) / (1.0 - weights.gamma)
    off = [float(np.abs(found - one).max()) for one in (attempt.now, attempt.kept)]
    if min(off) > _NEARLY * max(np.abs(attempt.kept).max(), np.abs(last).max()):
        raise InputError(_UNKNOWN)
    return attempt.failures if off[0] <= off[1] else 0

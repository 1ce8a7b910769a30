"""The state of a user's Exudyn system, taken and put back to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn
from exunet.base.errors import InputError

Floats = NDArray[np.float64]

# Their steps depend on nothing but coordinates, velocities, data and time, which the engine gives and takes.
# Velocity Verlet, implicit and adaptive methods keep more.
EXACT = ("ExplicitMidpoint", "RK33", "RK44", "RK67")
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

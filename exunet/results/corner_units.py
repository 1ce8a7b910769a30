"""What corner units have spent in a run: impulse of each and of all, and the propellant for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.forces.corner_units import NAME, SPENT, WORK
from exunet.results.result import Result
from exunet.results.script_story import THIS_RUN_ALONE

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665  # m/s2, by which a specific impulse in seconds is meant


def spent(result: Result) -> Floats | None:
    """(t, n) impulse that each unit has spent since the start [N s]; None of a case without units."""
    found = result.states.get(SPENT)
    return None if found is None else np.asarray(found.values[:])


def units_over_time(result: Result) -> Floats:
    """(t, n + 1) the same, and the work of all [J]; (t, 0) of a case without units."""
    found = spent(result)
    if found is None:
        return np.zeros((len(result.time), 0))
    return np.concatenate([found, np.asarray(result.states[WORK].values[:])], axis=1)


def mean_thrust(result: Result) -> Floats | None:
    """(t - 1, n) mean magnitude of each unit's thrust between stored times [N]; None as above, or of one."""
    found = spent(result)
    if found is None or len(result.time) < 2:
        return None
    return np.diff(found, axis=0) / np.diff(result.time)[:, None]


def told(result: Result, whose: str = THIS_RUN_ALONE) -> dict[str, Any] | None:
    """For the summary; None of a case without units.

    whose : what single units have spent here
    """
    about, found = result.provenance.get(NAME), spent(result)
    if about is None or found is None:
        return None
    of_units = [float(value) for value in found[-1]]
    return {
        "kind": about["kind"],
        "period_s": about["period"],
        "of": whose,
        "units": [
            {
                "bullet": bullet,
                "impulse_N_s": value,
                "propellant_kg": _propellant(about, value),
                "headlines": f"unit_{number}",
            }
            for number, (bullet, value) in enumerate(zip(about["bullets"], of_units, strict=True))
        ],
        "impulse_N_s": sum(of_units),
        "work_J": float(np.asarray(result.states[WORK].values[-1])[0]),
        "propellant_kg": _propellant(about, sum(of_units)),
    }


def _propellant(about: Mapping[str, Any], impulse: float) -> float | None:
    """[kg]; None without a specific impulse."""
    one = about["specific_impulse"]
    return None if one is None else impulse / (STANDARD_GRAVITY * one)


def rows(found: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """The row of the table that a run prints."""
    if found is None:
        return []
    each = ", ".join(f"{item['impulse_N_s']:.4g}" for item in found["units"])
    words = f"by {found['kind']}; units: {len(found['units'])}, which spent {each} N s in this run"
    if found["propellant_kg"] is not None:
        words += f"; propellant {found['propellant_kg']:.3g} kg in all, which stays in their mass"
    return [("control", words)]

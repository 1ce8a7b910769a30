"""Lines of the books of energy: what damping and friction of contacts and of a closing line have taken.

And what contacts store, which is part of the potential energy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from exunet.forces.contact.self_contact import NAME as SELF_CONTACT
from exunet.net.closing import NAME as LINE
from exunet.results.result import Result

Floats = NDArray[np.float64]

# First-order states [J] that count what is taken out, with words for it.
TAKEN = {
    "contact/damping": "damping of contact",
    "contact/friction": "friction of contact",
    f"{SELF_CONTACT}/damping": "damping between threads",
    f"{LINE}/viscosity": "viscosity of the closing line",
    f"{LINE}/friction": "friction of the closing line",
}


def taken_of(states: Iterable[str]) -> tuple[str, ...]:
    """Those of `TAKEN` that a scene has, by the names of all its states."""
    there = set(states)
    return tuple(name for name in TAKEN if name in there)


def taken_over_time(result: Result) -> Floats:
    """(t, n) of `taken_of` its states [J]."""
    every = [np.asarray(result.states[name].values[:]) for name in taken_of(result.states)]
    return np.concatenate([np.zeros((len(result.time), 0)), *every], axis=1)


def taken_from(first_order: Floats, names: Iterable[str], place: Callable[[str], int]) -> Floats:
    """(k, n) of `taken_of` names [J]; first_order: (k, n_states), in which `place` tells the column."""
    return np.asarray(first_order[:, [place(name) for name in taken_of(names)]])


STORED = "stored"  # ends the names of the series of the energy that a contact stores [J]


def stored_over_time(series: Mapping[str, Floats]) -> Floats | None:
    """(t,) energy [J] that all contacts store at the ends of steps; None: there is no contact.

    series : (t,) of all that is stored of contacts, by name
    """
    found = [one for name, one in series.items() if name.endswith(STORED)]
    return np.sum(found, axis=0) if found else None

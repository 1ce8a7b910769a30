"""The status of a contact: numbers behind the rows of its pairs in the memory; which of them are stored."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.terms import Memory, Series

Floats = NDArray[np.float64]


class Status(NamedTuple):
    """What is known of a contact at the end of an accepted step, in the order of the memory.

    depth, depth_time, depth_pair : largest depth so far [m], when [s], number of the pair
    first_touch : when something touched first [s]; -1.0: not yet
    wrong, wrong_time, wrong_pair : what has gone wrong (see `trouble`), when [s], with which pair
    most        : most pairs that touched at once
    time        : the end of the step [s]
    touching    : how many pairs touch
    force       : sum of the forces across the surface [N]
    stored      : energy that they store [J]
    """

    depth: float
    depth_time: float
    depth_pair: float
    first_touch: float
    wrong: float
    wrong_time: float
    wrong_pair: float
    most: float
    time: float
    touching: float
    force: float
    stored: float


OF_BODY = "body_"  # before the name of a body, in place of what else touches one
STATUS = len(Status._fields)
_SERIES = {  # fields of the status: name of the series, units
    "touching": ("touching", "1"),
    "force": ("force", "N"),
    "stored": ("stored", "J"),
    "depth": ("deepest", "m"),
    "first_touch": ("first", "s"),
}


def status_of(values: Floats) -> Status:
    """The status in a memory."""
    return Status(*values[-STATUS:].tolist())


def untouched(pairs: Floats) -> Floats:
    """A memory of these rows, before anything has touched."""
    status = Status(*np.zeros(STATUS))._replace(first_touch=-1.0)
    return np.concatenate([pairs.ravel(), status])


def memory_of(what: str, body: str, kept: Floats, wrong: Callable[[Floats], str]) -> Memory:
    """The memory of the contact of threads, of bullets, or of another body (`OF_BODY`), with a body."""
    series = series_of(f"contact_{body}/{what}_")
    return Memory(f"contact/{what}/{body}", kept, kept_in="kept", wrong=wrong, series=series)


def series_of(begin: str) -> tuple[Series, ...]:
    """What is stored of a status, under names that begin so."""
    places = {field: Status._fields.index(field) - STATUS for field in _SERIES}
    return tuple(Series(begin + name, units, places[field]) for field, (name, units) in _SERIES.items())

"""What the memory of a script has of each entry."""

from __future__ import annotations

from typing import NamedTuple

WAITING, ARMED, DONE, RESTING, BARRED = map(float, range(5))


class Row(NamedTuple):
    """What is known of an entry, in the order of the memory.

    state : WAITING for its time or for another entry; ARMED: its condition is looked at; DONE; RESTING: it
            is looked at again once its condition has been false; BARRED: it happens no more
    since : when it was armed, or has happened last [s]
    times : how often it has happened
    value : of its quantity when it happened last; of "largest_area" the largest area so far [m2]
    """

    state: float
    since: float
    times: float
    value: float


WIDTH = len(Row._fields)

"""Readers that several effects share: unit vectors, one of two keys, what belongs to bullets."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from reference_impl.table import Table, number, numbers

_UNIT = 1e-9  # how far a unit vector may be from length 1


def unit_vector(table: Table, key: str) -> Any:
    """Three numbers of length 1; None with a fault noted otherwise."""
    vector = table.need(key, numbers(3))
    if vector is not None and not abs(math.hypot(*vector) - 1.0) <= _UNIT:
        table.faults.append(f"{table.name(key)}: must be of length 1, not {math.hypot(*vector):.12g}")
    return vector


def one_of(table: Table, readers: dict[str, Callable[[Any], Any]]) -> dict[str, Any]:
    """The values of the keys in `readers`, None where absent; a fault unless exactly one is given."""
    values = {key: table.get(key, convert, None) for key, convert in readers.items()}
    if sum(key in table.seen for key in readers) != 1:
        table.faults.append(f"{table.path}: give exactly one of {' and '.join(map(table.name, readers))}")
    return values


def of_bullets(table: Table, key: str, bullets: bool) -> float:
    """A number >= 0 that must be given if there are bullets and must not if there are none (then 0)."""
    if bullets:
        return table.need(key, number(0.0))
    if key in table.values:
        table.seen.add(key)
        table.faults.append(f"{table.name(key)}: leave it out, this case has no net.bullets")
    return 0.0

"""`self_contact`: threads of a net touch each other; the record and its reader."""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.effects.contact import damping_of_bounce
from reference_impl.table import Table, number


@dataclass(frozen=True)
class SelfContact:
    """How threads push each other (SI units)."""

    stiffness: float  # K [N/m2]
    radius: float | None  # r [m]; None: each thread's own
    damping: float  # a [s/m]


def read_self_contact(table: Table) -> SelfContact | None:
    """The effect; None with faults noted where it cannot be read."""
    before = len(table.faults)
    stiffness = table.need("stiffness", number(above=0.0))
    radius = table.get("radius", number(above=0.0), None)
    damping = damping_of_bounce(table)
    if len(table.faults) > before or stiffness is None or damping is None:
        return None
    return SelfContact(stiffness, radius, damping)

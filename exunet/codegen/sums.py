"""The forces of a scene as sums over the rows of its `ForceTable`, in compiled code.

The text of these functions is copied into the modules that ask for the forces: what adds them up does not
depend on which forces there are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    from exunet.codegen.pointers import (
        call_add,
        call_place,
        call_potential,
        call_power,
        call_remember,
        call_told,
        call_work,
        zero_of,
    )


def add_forces(t: float, x: Any, v: Any, rows: Any, force: Any) -> Any:
    """First place what has no equations of motion, then add to the forces that are given.

    Returns the elastic energy [J] and the power [W] that is taken out, of the calls that tell theirs.
    """
    n = len(rows)
    for k in range(n):
        row = rows[n - 1 - k]
        if row["place"] != 0:
            call_place(row["place"], t, x, v, row["data"])
    held = zero_of(x)
    watts = zero_of(x)
    for k in range(n):
        row = rows[k]
        if row["elastic"] != 0:
            held += call_told(row["add"], t, x, v, row["data"], force)
        elif row["tells_power"] != 0:
            watts += call_told(row["add"], t, x, v, row["data"], force)
        else:
            call_add(row["add"], t, x, v, row["data"], force)
    return held, watts


def potential(x: Any, rows: Any) -> Any:
    """Potential energy [J] of the forces that have one."""
    total = zero_of(x)
    for k in range(len(rows)):
        row = rows[k]
        if row["potential"] != 0:
            total += call_potential(row["potential"], x, row["data"])
    return total


def power(t: float, x: Any, v: Any, rows: Any, scratch: Any) -> Any:
    """Power [W] that forces without a potential take out, but for those that tell their work in a step."""
    total = zero_of(x)
    for k in range(len(rows)):
        row = rows[k]
        if row["power"] != 0:
            total += call_power(row["power"], t, x, v, row["data"])
        elif row["works"] != 0:
            for c in range(scratch.size):
                scratch[c] = 0.0
            call_add(row["add"], t, x, v, row["data"], scratch)
            for c in range(v.size):
                total -= scratch[c] * v[c]
    return total


def has_power(rows: Any) -> bool:
    """True if `power` is not zero always."""
    found = False
    for k in range(len(rows)):
        row = rows[k]
        found = found or row["power"] != 0 or row["works"] != 0
    return found


def extra_work(h: float, begin: Any, end: Any, rows: Any) -> Any:
    """Work [J] taken out in a step of length h [s], of forces that tell it, from the states at its ends."""
    total = zero_of(begin[0])
    for k in range(len(rows)):
        row = rows[k]
        if row["work"] != 0:
            total += call_work(row["work"], h, begin[0], begin[1], end[0], end[1], row["data"])
    return total


def remember(t: float, x: Any, v: Any, rows: Any) -> None:
    """Let the forces remember the state at the end of an accepted step, with which they were asked last."""
    for k in range(len(rows)):
        row = rows[k]
        if row["remember"] != 0:
            call_remember(row["remember"], t, x, v, row["data"])


SUMS = (add_forces, potential, power, has_power, extra_work, remember)

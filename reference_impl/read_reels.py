"""Reads `[tethers.NAME.reel]`: the drum at an end of a tether, and what its drive is told to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from reference_impl.case import BodyPoint, Case, Command, Reel
from reference_impl.table import Table, number, refusal, text

_MODES = ("lock", "brake", "rate", "tension")


def read_reel(table: Table, length: float | None, divisions: int | None) -> Reel | None:
    """Reads and closes the reel of a tether of this length [m]; None where there is none, or with faults."""
    if not table:
        return None
    before = len(table.faults)
    within = _within(length, divisions)
    at = table.get("at", which_end, "start")
    paid_out = table.get("paid_out", within, length)
    quarter = None if length is None or divisions is None else 0.25 * length / divisions
    shortest = table.get("shortest", within, quarter)
    if shortest is not None and paid_out is not None and shortest > paid_out:
        table.faults.append(
            f"{table.name('shortest')}: is more than what is outside at first, {paid_out:g} m"
        )
    drive = read_drive(table)
    table.close()
    if len(table.faults) > before or paid_out is None or shortest is None:
        return None
    return Reel(at == "start", paid_out, shortest, *drive)


def read_drive(table: Table) -> tuple[float, float, tuple[Command, ...]]:
    """Largest rate [m/s], damping [N s/m], both infinite where they are absent, and commands of a drive."""
    largest_rate = table.get("largest_rate", number(above=0.0), math.inf)
    damping = table.get("damping", number(above=0.0), math.inf)
    commands = _commands(table)
    if "damping" not in table.values and any(command.force is not None for command in commands):
        table.faults.append(f"{table.name('damping')}: missing, a command has a force")
    return largest_rate, damping, commands


def _within(length: float | None, divisions: int | None) -> Callable[[Any], float]:
    """Reads a length outside [m]: from a quarter of an element to all of it."""
    if length is None or divisions is None:
        return number(above=0.0)
    return number(minimum=0.25 * length / divisions, maximum=length)


def which_end(value: Any) -> str:
    """Reads the name of an end."""
    if value not in ("start", "end"):
        raise ValueError(f'must be "start" or "end", not {value!r}')
    return str(value)


def _commands(table: Table) -> tuple[Command, ...]:
    """The commands that can be read; faults are noted."""
    listed = table.get("commands", _tables, ())
    made = []
    for row, values in enumerate(listed or ()):
        inner = Table(values, f"{table.name('commands')}[{row}]", table.faults)
        at, mode = inner.need("at", number(0.0)), inner.need("mode", text)
        if mode is not None and mode not in _MODES:
            what = f'{inner.name("mode")} = "{mode}"'
            inner.faults.append(refusal(what, f"it knows {', '.join(_MODES)}"))
            inner.ignore_rest()
            mode = None
        rate, force = _wanted(inner, mode)
        inner.close()
        if at is not None and mode is not None:
            made.append(Command(at, mode, rate, force))
    if any(later.at <= earlier.at for earlier, later in pairwise(made)):
        table.faults.append(f"{table.name('commands')}: their times must increase")
    return tuple(made)


def _wanted(table: Table, mode: str | None) -> tuple[float | None, float | None]:
    """Rate [m/s] and force [N] of a command, where its mode has them."""
    if mode is None:
        table.ignore_rest()
        return None, None
    for key, known in (("rate", mode == "rate"), ("force", mode != "lock")):
        if key in table.values and not known:
            table.seen.add(key)
            table.faults.append(f'{table.name(key)}: not with mode = "{mode}"')
    rate = force = None
    if mode == "rate":
        rate, force = table.need("rate", number()), table.get("force", number(0.0), None)
    elif mode != "lock":
        force = table.need("force", number(0.0))
    return rate, force


def _tables(value: Any) -> list[dict[str, Any]]:
    """Reads a list of tables."""
    if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
        raise ValueError("must be a list of tables")
    return value


def reel_faults(case: Case) -> list[str]:
    """Faults between reels and the rest of a case."""
    faults = []
    for tether in case.tethers:
        if tether.reel is None:
            continue
        path = f"tethers.{tether.name}.reel"
        end = tether.start if tether.reel.at_start else tether.end
        if not isinstance(end, BodyPoint):
            name = "start" if tether.reel.at_start else "end"
            faults.append(f"{path}.at: the {name} of the tether must be tied to a body, for the drum")
        against = {
            "effects.breaking": case.effects.breaking is not None,
            "effects.bending": case.effects.bending is not None,
            "effects.rayleigh_damping.beta": bool(case.effects.beta),
        }
        faults += [
            f"{path} and {key} contradict each other: leave one out" for key in against if against[key]
        ]
    return faults

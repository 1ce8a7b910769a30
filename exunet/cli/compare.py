"""`exunet compare`: differences of two runs at the times that both store."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exunet.cli.output import print_table
from exunet.results.comparison import ComparedBodies, ComparedBreaks, compare, read_states

Floats = NDArray[np.float64]

SHOWN = 20  # times in the table, evenly chosen, the last among them


def compare_runs(a: Path, b: Path) -> None:
    """Print the differences of run `b` from run `a`; raises InputError if their nets differ."""
    first, second = read_states(a), read_states(b)
    found = compare(first, second)
    rows = [("times in common", f"{len(found.time)}, {found.time[0]:g} s to {found.time[-1]:g} s")]
    rows += [(f"run {name}", "incomplete") for name, run in ((a, first), (b, second)) if not run.complete]
    if found.identical:
        print_table(
            f"{b} against {a}", [*rows, ("difference", "none: both have the same states, bit by bit")]
        )
        return
    shown = np.unique(np.linspace(0, len(found.time) - 1, SHOWN).round().astype(int))
    rows += [
        (
            f"t = {found.time[k]:.6g} s",
            f"positions {found.position_difference[k]:.3e} m, speeds {found.speed_difference[k]:.3e} m/s",
        )
        for k in shown
    ]
    rows += [
        ("largest", f"positions {_largest(found.position_difference, found.time, 'm')}"),
        ("", f"speeds {_largest(found.speed_difference, found.time, 'm/s')}"),
        ("speeds", f"those of the {found.speeds_of}"),
        ("allowed", f"positions {found.allowed_position:.3e} m, speeds {found.allowed:.3e} m/s"),
        ("first beyond that", _instant(found.agrees_until)),
        ("beyond it to the end", _instant(found.apart_from)),
        *_bodies(found.bodies, found.time),
        *[(f"body {name}", f"only in {a}") for name in found.bodies.only_a],
        *[(f"body {name}", f"only in {b}") for name in found.bodies.only_b],
        *_broken(found.broken, a, b),
    ]
    print_table(f"{b} against {a}", rows)


def _bodies(found: ComparedBodies, time: Floats) -> Iterator[tuple[str, str]]:
    """Return the largest differences of each body of both runs."""
    for name, body in found.both.items():
        yield f"body {name}", f"position {_largest(body.position, time, 'm')}"
        yield "", f"velocity {_largest(body.velocity, time, 'm/s')}"
        if body.attitude is not None and body.angular_velocity is not None:
            yield "", f"attitude {_largest(body.attitude, time, 'rad')}"
            yield "", f"angular velocity {_largest(body.angular_velocity, time, 'rad/s')}"
        allowed = f"position {body.allowed_position:.3e} m"
        allowed += "" if body.attitude is None else f", attitude {body.allowed_attitude:.3e} rad"
        yield "", f"allowed: {allowed}; first beyond that: {_instant(body.agrees_until)}"


def _broken(found: ComparedBreaks | None, a: Path, b: Path) -> Iterator[tuple[str, str]]:
    """Return which elements broke in both runs, and in one only."""
    if found is None:
        return
    yield "broken in both", f"{len(found.both)} element(s), times within {found.apart:.3e} s"
    for elements, where in ((found.only_a, a), (found.only_b, b)):
        if elements:
            yield "broken", f"only in {where}: {', '.join(map(str, elements))} (numbers of {a})"


def _largest(difference: Floats, time: Floats, unit: str) -> str:
    at = int(np.argmax(difference))
    return f"{difference[at]:.3e} {unit} at t = {time[at]:.6g} s"


def _instant(time: float | None) -> str:
    return "never" if time is None else f"t = {time:.6g} s"

"""What is wrong with the contents of a snapshot: numbers, types and sizes that no simulation writes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.protocol import StepCounts
from exunet.methods.method import METHODS, Kind
from exunet.methods.plan import Plan

Arrays = Mapping[str, NDArray[Any]]

# Arrays with a row for each state, mark, event or stop that there was, or no row: groups of one length.
_GROWING = (
    ("integrator:kept/",),
    ("integrator:rows/",),
    ("integrator:pushed",),
    ("monitor:peaks",),
    ("monitor:marks",),
    ("monitor:envelope:",),
    ("monitor:kept_at:",),
    ("monitor:series:",),
    ("monitor:element_peaks:intervals", "monitor:element_peaks:later"),
    ("stops:times", "stops:force"),
    ("stops:forces",),
)

# Limits and extremes, infinite where nothing limits and nothing was seen.
_MAY_BE_INFINITE = (
    *("integrator:seen/", "integrator:clock/", "monitor:envelope:"),
    "monitor:element_peaks:stored_until",
)

_OF_CONTROLLER = "control:own:"  # what a controller of the user's has told
_TIMES = ("integrator:time", "integrator:clock/time")


def header_faults(header: Mapping[str, Any]) -> list[str]:
    """What is wrong with the header of a snapshot, in words."""
    faults = [f"it lacks {name}" for name in _HEADER if name not in header and name not in _OF_RECORD]
    return faults + [
        f"{name} has a value or type that no simulation writes"
        for name, sound in _HEADER.items()
        if name in header and not sound(header[name])
    ]


def array_faults(arrays: Arrays, like: Arrays, time: float, room: int) -> list[str]:
    """What is wrong with the arrays beside those of another snapshot of the same simulation, in words.

    time : that the header tells [s]
    room : most rows of states that wait
    """
    faults = [f"it lacks {name}" for name in like if name not in arrays]
    if faults:
        return faults
    for name, wanted in like.items():
        found = arrays[name]
        grows = any(name in group or name.startswith(_folders(group)) for group in _GROWING)
        loose = name == "stops:forces"  # of no row, its width is unknown
        if name.startswith(_OF_CONTROLLER):  # a number is a number, and NaN what was not read yet
            if found.dtype.kind not in "biuf" or found.shape != wanted.shape:
                faults.append(f"{name} has shape {found.shape}, not {wanted.shape}, or no numbers")
        elif found.dtype.kind != wanted.dtype.kind:
            faults.append(f"{name} has values of type {found.dtype}, not {wanted.dtype}")
        elif found.ndim != wanted.ndim and not loose:
            faults.append(f"{name} has {found.ndim} dimensions, not {wanted.ndim}")
        elif found.shape[grows:] != wanted.shape[grows:] and not loose:
            faults.append(f"{name} has shape {found.shape}, not {wanted.shape}")
        elif found.dtype.kind == "f" and np.isnan(found).any():
            faults.append(f"{name} contains NaN")
        elif found.dtype.kind == "f" and not name.startswith(_MAY_BE_INFINITE) and np.isinf(found).any():
            faults.append(f"{name} contains infinity")
        elif name in _TIMES and found.item() != time:
            faults.append(f"{name} is not {time!r} s")
    groups = (set(one["monitor:peaks"][:, 0].tolist()) for one in (arrays, like))
    return faults or [*_of_lengths(arrays, room), *_of_groups(*groups)]


def _of_groups(found: set[float], wanted: set[float]) -> list[str]:
    return [] if found == wanted else ["monitor:peaks has not the groups of elements that there are"]


def _folders(group: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(one for one in group if one.endswith(("/", ":")))


def _of_lengths(arrays: Arrays, room: int) -> list[str]:
    faults = []
    for group in _GROWING:
        names = [name for name in arrays if name in group or name.startswith(_folders(group))]
        if len({len(arrays[name]) for name in names}) > 1:
            faults.append(f"{', '.join(names)} have different lengths")
        states = group[0] in ("integrator:kept/", "integrator:rows/")
        if states and names and not 1 <= len(arrays[names[0]]) <= room:
            faults.append(f"{names[0]} has {len(arrays[names[0]])} rows, not 1 to {room}")
    if not len(arrays["monitor:peaks"]):
        faults.append("monitor:peaks has no row")
    number, acting = arrays["stops:force"], arrays["stops:forces"]
    if number.size and not (number.min() >= 0 and number.max() < len(acting)):
        faults.append("stops:force has numbers that stops:forces does not have")
    if len(acting) and acting.shape[1:] != arrays["acting"].shape:
        faults.append(f"stops:forces has shape {acting.shape}")
    pushed = arrays.get("integrator:pushed")
    points = len(arrays["monitor:safe:position"])
    if pushed is not None and len(pushed) not in (0, points):
        faults.append(f"integrator:pushed has shape {pushed.shape}")
    return faults


def _number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _whole(value: Any) -> bool:
    return type(value) is int and value >= 0


def _plan(value: Any) -> bool:
    if not isinstance(value, dict) or set(value) != {one.name for one in fields(Plan)}:
        return False
    if value["method"] not in list(METHODS):
        return False
    chooses = METHODS[value["method"]].kind == Kind.ADAPTIVE
    given, absent = (value["tolerance"], value["step"])[:: 1 if chooses else -1]
    expected, longest, notes = value["expected_error"], value["longest_step"], value["notes"]
    return (
        (_number(given) and given > 0.0 and absent is None)
        and all(_number(value[name]) and value[name] >= 0.0 for name in ("first_step", "least_step"))
        and (longest is None or (_number(longest) and longest > 0.0))
        and (expected is None or _list(expected, _number, 2))
        and _list(notes, lambda one: isinstance(one, str))
    )


def _list(value: Any, sound: Callable[[Any], bool], number: int | None = None) -> bool:
    return (
        isinstance(value, list | tuple)
        and (number is None or len(value) == number)
        and all(map(sound, value))
    )


def _counts(value: Any) -> bool:
    names = {one.name for one in fields(StepCounts)}
    return isinstance(value, dict) and set(value) == names and all(map(_whole, value.values()))


def _event(value: Any) -> bool:
    return isinstance(value, dict) and isinstance(value.get("heading"), str) and _number(value.get("time_s"))


def _story(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and set(value) == {"retries", "notes", "tolerance", "step"}
        and _list(value["retries"], lambda one: isinstance(one, dict))
        and _list(value["notes"], lambda one: isinstance(one, str))
        and all(value[name] is None or _number(value[name]) for name in ("tolerance", "step"))
    )


_HEADER: Mapping[str, Callable[[Any], bool]] = {
    "of": lambda value: isinstance(value, Mapping),
    "time": _number,
    "plan": _plan,
    "retries": _whole,
    "spent": _counts,
    "events": lambda value: _list(value, _event),
    "rows": _whole,
    "story": _story,
}
_OF_RECORD = ("rows", "story")  # of runs that store

"""Reads the state that `initial.restart` names from the result of another run."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from exunet.base.errors import CaseError, Fault, InputError
from exunet.results.attached import RELEASES, released_at
from exunet.results.io import RESULT_FILE, load_result
from exunet.results.loads import CARRIED
from exunet.results.result import Result
from exunet.results.script_story import done
from exunet.system.initial import KEY, Restart, RestartBody

RESTART = "restart"  # heading of the provenance
_NAMED = re.compile(r"(.+?)(?:@(end|[-+0-9.eE]+))?", re.DOTALL)
_SAME = 1e-9  # [s]: a stored time that is asked for in decimal numbers


@dataclass(frozen=True, eq=False)
class Source:
    """Where a start comes from.

    story : for the provenance: file, stored time [s], hash of the file
    """

    restart: Restart
    story: dict[str, Any]


def load_restart(named: str) -> Source:
    """The state that "RESULT@TIME" names: a result file or the folder of a run, and a stored time.

    Without a time, or with "@end", the last one. Raises CaseError if there is no such state, or none that a
    case can start from.
    """
    parts = _NAMED.fullmatch(named)
    assert parts is not None
    path = Path(parts[1])
    try:
        if path.is_dir() and not (path / RESULT_FILE).is_file():
            _refuse(f"{path}: there is no {RESULT_FILE}: let the run end, or exunet resume it")
        result = load_result(path)
        file = path / RESULT_FILE if path.is_dir() else path
        with file.open("rb") as content:  # which may be larger than memory
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        row = _row(result, parts[2], path)
        restart = _state(result, row, path)
    except InputError as error:
        if isinstance(error, CaseError):
            raise
        _refuse(str(error))
    time = float(result.time[row])
    story: dict[str, Any] = {
        "result": str(file),
        "time_s": time,
        "sha256": digest,
    }
    return Source(restart, story | {"broken": list(restart.broken)})


def _refuse(words: str) -> NoReturn:
    raise CaseError([Fault(KEY, words)])


def _row(result: Result, asked: str | None, path: Path) -> int:
    """The number of a stored time."""
    if asked is None or asked == "end":
        return len(result.time) - 1
    try:
        time = float(asked)
    except ValueError:
        _refuse(f"{path}: after @ stands a stored time in seconds, or end; got {asked!r}")
    row = int(np.argmin(np.abs(result.time - time)))
    if abs(result.time[row] - time) > _SAME * max(1.0, abs(time)):
        words = f"there is no state of {time:g} s; the nearest stored one is of {result.time[row]:.9g} s"
        _refuse(f"{path}: {words}: ask for it, or store others (time.output_times)")
    return row


def _state(result: Result, row: int, path: Path) -> Restart:
    time, story = float(result.time[row]), result.provenance
    points = [name for name, body in result.bodies.items() if body.inertia is None]
    if points:
        words = f"has a point mass, {points[0]!r}, of [effects.launch_force]: start from a run without it"
        _refuse(f"{path}: {words}")
    if _is_held(story, time):
        _refuse(
            f"{path}: at {time:g} s a body still holds the packed net: start from a state after its ejection"
        )
    bodies = {}
    for name, body in result.bodies.items():
        parts = (getattr(body, one)[row : row + 1][0] for one in _OF_BODY)
        assert body.inertia is not None
        bodies[name] = RestartBody(body.mass, body.inertia, *(np.array(part) for part in parts))
    states = {name: np.array(one.values[row : row + 1][0]) for name, one in result.states.items()}
    where = f"{path} at {time:g} s"
    place, speed = (np.array(part[row : row + 1][0]) for part in (result.position, result.velocity))
    broken, releases = _broken(result, time), _releases(story, time)
    return Restart(where, result.net, place, speed, bodies, states, broken, releases)


_OF_BODY = ("position", "velocity", "attitude", "angular_velocity")


def _is_held(story: dict[str, Any], time: float) -> bool:
    """True if the net had not been ejected from its canister."""
    carried = story.get(CARRIED)
    return carried is not None and not any(one["time_s"] <= time for one in story.get("ejection", []))


def _releases(story: dict[str, Any], time: float) -> dict[str, bool]:
    """What a script of that run releases, and whether it had."""
    every = story.get(RELEASES, [])
    return {one["tie"]: not one["tied"] or released_at(story, one["tie"]) <= time for one in every}


def _broken(result: Result, time: float) -> tuple[int, ...]:
    """Elements that had broken, or had been cut, or that carried nothing at the start of that run already."""
    story, net = result.provenance, result.net
    found = {int(one["element"]) for one in story.get("broken") or () if one["time_s"] <= time}
    found |= {int(one["element"]) for one in done(story) if "element" in one and one["time_s"] <= time}
    found.update(story.get(RESTART, {}).get("broken", ()))
    return tuple(sorted(one for one in found if one < net.n_elements))

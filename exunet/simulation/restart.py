"""Restart from the result of another run: the stored state that `initial.restart` names."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from exunet.base.errors import CaseError, Fault, InputError
from exunet.model.initial import KEY, Restart, RestartBody
from exunet.results.attached import released_at
from exunet.results.io import RESULT_FILE, load_result
from exunet.results.provenance import RestartSource, SceneProvenance
from exunet.results.result import Result
from exunet.results.script_story import done

_NAMED = re.compile(r"(.+?)(?:@(end|[-+0-9.eE]+))?", re.DOTALL)
_SAME = 1e-9  # [s], round-off of a stored time in decimals


@dataclass(frozen=True, eq=False)
class Source:
    """Restart with its provenance.

    provenance : file, stored time [s], hash of the file
    """

    restart: Restart
    provenance: RestartSource


def load_restart(named: str) -> Source:
    """Read the state that "RESULT@TIME" names: a result file or the folder of a run, and a stored time.

    Without a time, or with "@end", the last state. Raises CaseError for an unknown state, or one from
    which a case cannot start.
    """
    parts = _NAMED.fullmatch(named)
    assert parts is not None
    path = Path(parts[1])
    try:
        if path.is_dir() and not (path / RESULT_FILE).is_file():
            _refuse(f"{path}: {RESULT_FILE} is missing: end the run with exunet resume")
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
    return Source(restart, RestartSource(str(file), time, digest, list(restart.broken)))


def _refuse(words: str) -> NoReturn:
    raise CaseError([Fault(KEY, words)])


def _row(result: Result, time_text: str | None, path: Path) -> int:
    """Return the number of a stored time."""
    if time_text is None or time_text == "end":
        return len(result.time) - 1
    try:
        time = float(time_text)
    except ValueError:
        _refuse(f"{path}: after @ must be a stored time in seconds, or end, got {time_text!r}")
    row = int(np.argmin(np.abs(result.time - time)))
    if abs(result.time[row] - time) > _SAME * max(1.0, abs(time)):
        words = f"no stored state at {time:g} s, the nearest is at {result.time[row]:.9g} s"
        _refuse(f"{path}: {words}: use it, or store other times (time.output_times)")
    return row


def _state(result: Result, row: int, path: Path) -> Restart:
    time, provenance = float(result.time[row]), result.provenance
    points = [name for name, body in result.bodies.items() if body.inertia is None]
    if points:
        words = f"has a point mass, {points[0]!r}, of [effects.launch_force]: start from a run without it"
        _refuse(f"{path}: {words}")
    if _is_held(provenance, time):
        _refuse(
            f"{path}: at {time:g} s a body still holds the packed net: start from a state after its ejection"
        )
    bodies = {}
    for name, body in result.bodies.items():
        parts = (getattr(body, name)[row : row + 1][0] for name in _OF_BODY)
        assert body.inertia is not None
        bodies[name] = RestartBody(body.mass, body.inertia, *(np.array(part) for part in parts))
    states = {name: np.array(state.values[row : row + 1][0]) for name, state in result.states.items()}
    where = f"{path} at {time:g} s"
    place, speed = (np.array(part[row : row + 1][0]) for part in (result.position, result.velocity))
    broken, releases = _broken(result, time), _releases(provenance, time)
    return Restart(where, result.net, place, speed, bodies, states, broken, releases)


_OF_BODY = ("position", "velocity", "attitude", "angular_velocity")


def _is_held(provenance: dict[str, Any], time: float) -> bool:
    """Return True if a body still held the packed net."""
    held = SceneProvenance.of(provenance).carried is not None
    return held and not any(event["time_s"] <= time for event in provenance.get("ejection", []))


def _releases(provenance: dict[str, Any], time: float) -> dict[str, bool]:
    """Return the attachments that a script of that run releases; True if released."""
    return {
        item.tie: not item.tied or released_at(provenance, item.tie) <= time
        for item in SceneProvenance.of(provenance).releases
    }


def _broken(result: Result, time: float) -> tuple[int, ...]:
    """Return the elements that were broken or cut, before that run too."""
    provenance, net = result.provenance, result.net
    events = [*(provenance.get("broken") or ()), *(event for event in done(provenance) if "element" in event)]
    broken = {int(event["element"]) for event in events if event["time_s"] <= time}
    before = SceneProvenance.of(provenance).restart
    broken.update(() if before is None else before.broken)
    return tuple(sorted(element for element in broken if element < net.n_elements))

"""What a run is asked for, kept with its states so that it can be resumed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exunet.base.arguments import finite_number
from exunet.base.errors import InputError
from exunet.case.casefile import Case, parse_case
from exunet.results.segments import Segments


@dataclass(frozen=True)
class Request:
    """What a run is asked for beside its case.

    checkpoint_every : [s] of simulated time; None: by wall time
    moved_starts     : how many are run after it; None: not told
    check            : the reference is to check it
    estimate         : its error is to be estimated
    """

    case: Case
    checkpoint_every: float | None = None
    moved_starts: int | None = None
    check: bool = False
    estimate: bool = False

    def story(self) -> dict[str, Any]:
        """What is kept of it beside the case."""
        return {
            "checkpoint_every": self.checkpoint_every,
            "moved_starts": self.moved_starts,
            "check": self.check,
            "estimate": self.estimate,
        }


def provenance(case: Case) -> dict[str, Any]:
    """What a result records of the case."""
    found = {"case": case.path.name, "text": case.text, "overrides": list(case.overrides)}
    files = case.scene.initial.begins_from or any(keys.file for keys in case.scene.bodies.values())
    return found | ({"folder": str(case.path.parent.resolve())} if files else {})  # to resume with them


def request_of_store(store: Segments) -> Request:
    """What a run that was killed was asked for; InputError if damaged."""
    story = store.provenance
    text, name, overrides = (story.get(key) for key in ("text", "case", "overrides"))
    every, moved = story.get("checkpoint_every"), story.get("moved_starts")
    check, estimate = story.get("check", False), story.get("estimate", False)
    listed = isinstance(overrides, list) and all(isinstance(one, str) for one in overrides)
    timed = every is None or (finite_number(every) or 0.0) > 0.0
    counted = moved is None or (type(moved) is int and moved >= 0)
    asked = isinstance(check, bool) and isinstance(estimate, bool)
    if not (isinstance(text, str) and isinstance(name, str) and listed and timed and counted and asked):
        raise InputError(f"{store.folder}: damaged: the case of its run is missing")
    case = parse_case(text, Path(str(story.get("folder", ""))) / name, overrides or ())
    return Request(case, every, moved, check, estimate)

"""Faults that show only when a case is prepared, reported as those of reading: with file and line."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from exunet.base.errors import CaseError, KeyPath
from exunet.case.casefile import Case, located
from exunet.case.scene import Scene

REALISTIC = 1e50  # no quantity of a net is larger in SI units, or smaller than its inverse


@contextmanager
def located_faults(case: Case) -> Iterator[None]:
    """Give the faults of a CaseError from inside the block their place in the case's file or overrides.

    Where numbers overflow, the values that no real net has are the cause, if there are any.
    """
    try:
        yield
    except CaseError as error:
        if any(fault.place for fault in error.faults):
            raise
        beyond = [fault for fault in error.faults if fault.beyond_floats]
        extreme = list(_extreme(case.scene)) if beyond else []
        told = [fault for fault in error.faults if not (extreme and fault.beyond_floats)]
        found = [(fault.paths, fault.reason) for fault in told]
        words = next((f"{fault.key}: {fault.reason}" for fault in beyond), "")
        found += [((path,), f"{value:g} is not realistic ({words})") for path, value in extreme]
        raise CaseError(located(found, case)) from None


def _extreme(scene: Scene) -> Iterator[tuple[KeyPath, float]]:
    """The numbers of a scene above `REALISTIC` or below its inverse, each with its key."""
    tables = ("time", "net", "initial", "launch", "bodies", "tethers", "effects")
    waiting: list[tuple[KeyPath, Any]] = [((), scene.model_dump(include=set(tables)))]
    while waiting:
        path, value = waiting.pop()
        if isinstance(value, dict):
            waiting.extend(((*path, key), inner) for key, inner in value.items())
        elif isinstance(value, tuple):
            waiting.extend(((*path, index), inner) for index, inner in enumerate(value))
        elif isinstance(value, float) and value and abs(math.log10(abs(value))) > math.log10(REALISTIC):
            yield path, value

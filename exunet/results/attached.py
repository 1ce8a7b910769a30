"""Nodes that are fixed to bodies in a result: for good, or until a script released them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.provenance import Release, SceneProvenance
from exunet.results.result import Result
from exunet.results.script_story import done

Ints = NDArray[np.int64]


def attached_nodes(result: Result, body: str) -> Ints:
    """(m,) nodes that are fixed to a body, or were: contact leaves out what ends there, all the time."""
    fixed = result.bodies[body].nodes
    parts = [np.zeros(0, dtype=np.int64) if fixed is None else fixed]
    parts += [np.array([item.node]) for item in _of(result.provenance, body)]
    return np.concatenate(parts)


def held_until(story: Mapping[str, Any], body: str) -> dict[int, float]:
    """Until when [s] nodes were fixed to a body that a script released from it; infinite: to the end."""
    return {item.node: released_at(story, item.tie) for item in _of(story, body) if item.tied}


def released_at(story: Mapping[str, Any], tie: str) -> float:
    """When a script released it [s]; infinite if it has not."""
    return next((float(item["time_s"]) for item in done(story) if item.get("tie") == tie), math.inf)


def _of(story: Mapping[str, Any], body: str) -> list[Release]:
    return [item for item in SceneProvenance.of(story).releases if item.body == body]

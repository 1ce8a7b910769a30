"""What effects need of the rest of a case, and which of them contradict each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from exunet.checks import Wrong
from exunet.record import Record


@dataclass(frozen=True)
class Surroundings:
    """What an effect's table can be held against.

    on          : the keys of every effect that has a table, by name
    has_bullets : the net has bullets
    has_launch  : the case has a table [launch]
    duration    : time.end [s]
    method      : solver.method
    """

    on: Mapping[str, Record]
    has_bullets: bool
    has_launch: bool
    duration: float
    method: str


def bullet_key(around: Surroundings, key: str, value: float | None) -> list[Wrong]:
    """A key of the bullets is given just when there are bullets."""
    if around.has_bullets and value is None:
        return [Wrong((), f"needs {key}, since the net has bullets")]
    if not around.has_bullets and value is not None:
        return [Wrong((key,), "there are no bullets: add [net.bullets] or remove this key", value)]
    return []


def excludes(around: Surroundings, other: str, reason: str) -> list[Wrong]:
    """A fault if the effect `other` is on too."""
    return [Wrong((), f"contradicts effects.{other}: {reason}")] if other in around.on else []

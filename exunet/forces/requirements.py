"""What effects need of the rest of a case, and which of them contradict each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from exunet.base.faults import Wrong
from exunet.base.incomplete import Unknown
from exunet.base.table import Table


@dataclass(frozen=True)
class Surroundings:
    """What an effect's table can be held against; what is not valid in the case raises Unknown.

    on    : the keys of every effect that has a table, by name
    scene : the case's Scene
    """

    on: Mapping[str, Table]
    scene: Any

    @property
    def has_bullets(self) -> bool:
        """The net has bullets."""
        net = self.scene.net
        return "bullets" in type(net).model_fields and net.bullets is not None

    @property
    def has_launch(self) -> bool:
        """The case has a table [launch]."""
        return self.scene.launch is not None

    @property
    def duration(self) -> float:
        """time.end [s]."""
        return float(self.scene.time.end)

    @property
    def method(self) -> str:
        """solver.method."""
        return str(self.scene.solver.method)


def bullet_key(around: Surroundings, keys: Table, key: str) -> Iterator[Wrong]:
    """A key of the bullets is given just when there are bullets."""
    with suppress(Unknown):
        if around.has_bullets and not keys.gives(key):
            yield Wrong((), f"needs {key}, since the net has bullets")
        if not around.has_bullets and keys.gives(key):
            yield Wrong((key,), "there are no bullets: add [net.bullets] or remove this key")


def excludes(around: Surroundings, other: str, reason: str) -> Iterator[Wrong]:
    """A fault if the effect `other` is on too."""
    if other in around.on:
        yield Wrong((), f"contradicts effects.{other}: {reason}")

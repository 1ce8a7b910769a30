"""Thrust: a given force over time on chosen bullets, as of small engines or of a test rig that pulls them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.faults import each
from exunet.base.table import FromArray, NonNegative, Table, Vector
from exunet.forces.requirements import RestOfCase

NEEDS_BULLETS = True


class Keys(Table):
    """A given force over time on chosen bullets."""

    bullets: Annotated[tuple[Annotated[int, Field(ge=0)], ...], FromArray] = Field(
        min_length=1, description="numbers of the bullets that it acts on, from 0", examples=[[0, 1]]
    )
    time: Annotated[tuple[NonNegative, ...], FromArray] = Field(
        min_length=2,
        description="times [s], increasing; the force is zero before the first and after the last",
        examples=[[0.0, 0.5]],
    )
    force: Annotated[tuple[Vector, ...], FromArray] = Field(
        min_length=2,
        description="on each of the bullets at these times [N], in the scene's axes; linear in between",
        examples=[[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]],
    )


def cross_checks(keys: Keys, rest: RestOfCase) -> Iterator[Fault]:
    """Bullets that the net has, each once; times that increase; a force for each."""
    yield from each(_bullets_exist(keys, rest), _each_once(keys), _increasing(keys), _one_force_a_time(keys))


# In these lists None stands for an item that is not valid.


def _bullets_exist(keys: Keys, rest: RestOfCase) -> Iterator[Fault]:
    number = rest.n_bullets
    for k, bullet in enumerate(keys.bullets):
        if number and bullet is not None and bullet >= number:
            reason = f"there is no bullet {bullet}: the {number} bullets are numbered from 0 to {number - 1}"
            yield Fault(f"bullets[{k}]", reason)


def _each_once(keys: Keys) -> Iterator[Fault]:
    for k, bullet in enumerate(keys.bullets):
        if bullet is not None and bullet in keys.bullets[:k]:
            yield Fault(f"bullets[{k}]", f"bullet {bullet} is listed twice")


def _increasing(keys: Keys) -> Iterator[Fault]:
    for k, (before, time) in enumerate(pairwise(keys.time), start=1):
        if before is not None and time is not None and time <= before:
            yield Fault(f"time[{k}]", f"must be greater than the time before it, {before:g} s, got {time:g}")


def _one_force_a_time(keys: Keys) -> Iterator[Fault]:
    if len(keys.force) != len(keys.time):
        yield Fault(
            "force", f"needs one vector for each of the {len(keys.time)} times, got {len(keys.force)}"
        )

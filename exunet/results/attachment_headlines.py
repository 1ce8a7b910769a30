"""Headlines of the threads' pull on bodies: the largest at all places of a body, and at each of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.results.course import Course
from exunet.results.headline import Headline
from exunet.results.pulls import PACKED, place_named

Floats = NDArray[np.float64]

_FORCE, _TORQUE = range(2)  # columns of `Course.pull`
ATTACHMENT = "_attachment_"  # in the keys of a body, between its name and the quantity
_LEAST = 1e-8  # [N], [N m]: what moves of 1e-9 m do themselves

Columns = Callable[[Course], list[int]]


def pulls_on_body(body: str) -> tuple[Headline, ...]:
    """The largest force [N] and torque [N m] of threads at one of the places of a body, and when [s]."""

    def columns(course: Course) -> list[int]:
        return [k for k, one in enumerate(course.pulled) if one.body == body]

    return _of(f"body_{body}{ATTACHMENT}", f"at an attachment of {body}", columns)


def pulls_at_place(name: str) -> tuple[Headline, ...]:
    """The same of a `PulledPlace` of this name, for the summary alone."""

    def columns(course: Course) -> list[int]:
        return [k for k, one in enumerate(course.pulled) if one.name == name]

    body, words = place_named(name)
    return _of(f"attachment_{name}_", f"on {body} {words}", columns, detail=True)


def _of(key: str, where: str, columns: Columns, *, detail: bool = False) -> tuple[Headline, ...]:
    found: list[Headline] = []
    for quantity, word, unit, remark in (
        (_FORCE, "force", "N", "of threads, at stored times, between which it may be larger"),
        (_TORQUE, "torque", "N m", "of that pull, about the body's centre of mass"),
    ):
        words = f"largest {word} {where}"
        pull = _Pull(columns, quantity)
        found += [
            Headline(
                f"{key}largest_{word}",
                words,
                unit,
                pull.largest,
                least=_LEAST,
                place=pull.node,
                place_is="at node",
                of_a_time=True,
                remark=remark,
                detail=detail,
            ),
            Headline(
                f"{key}time_of_largest_{word}",
                f"time of {words}",
                "s",
                pull.time,
                at_a_time=True,
                detail=detail,
            ),
        ]
    return tuple(found)


@dataclass(frozen=True)
class _Pull:
    """Sizes of forces or of torques at some places."""

    columns: Columns
    quantity: int

    def _sizes(self, course: Course) -> Floats:
        """(t, n) at all of them."""
        return np.asarray(course.pull[:, self.columns(course), self.quantity])

    def largest(self, course: Course) -> float | None:
        sizes = self._sizes(course)
        return float(sizes.max()) if sizes.shape[1] else None

    def time(self, course: Course) -> float | None:
        """When; None where threads never pull."""
        sizes = self._sizes(course)
        return float(course.time[sizes.max(axis=1).argmax()]) if sizes.any() else None

    def node(self, course: Course) -> int:
        """Where; -1: at none, or by the packed net."""
        sizes = self._sizes(course)
        if not sizes.any():
            return PACKED
        return course.pulled[self.columns(course)[int(sizes.max(axis=0).argmax())]].node

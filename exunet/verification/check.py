"""What a rung of the ladder yields: checks with verdicts, pictures, and words for the report."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from exunet.verification.tolerances import Tolerance

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Check:
    """One comparison.

    rung     : number of the rung
    subject  : the case (or what else) that was looked at
    name     : what was compared
    measured : the difference found, in `allowed.unit`
    allowed  : the tolerance, or None for a measurement that nothing is demanded of
    worst    : where the difference is largest: node or element, time, both values
    left_out : nothing was compared here; `name` says what, `worst` why
    """

    rung: int
    subject: str
    name: str
    measured: float
    allowed: Tolerance | None
    worst: str = ""
    left_out: bool = False

    @property
    def holds(self) -> bool:
        """False also where the measurement is not a number."""
        return self.allowed is None or self.measured <= self.allowed.value

    @property
    def verdict(self) -> str:
        if self.left_out:
            return "LEFT OUT"
        if self.allowed is None:
            return "noted"
        return "holds" if self.holds else "FAILS"


def left_out(rung: int, subject: str, what: str, why: str) -> Check:
    """A row that says what was not compared, and why; the verdict counts these."""
    return Check(rung, subject, what, 0.0, None, why, left_out=True)


def worst_first(measured: float) -> float:
    """A key for `max`: what is no number counts as infinite, where `max` alone would pass over it."""
    return math.inf if math.isnan(measured) else measured


def worst_of(name: str, checks: Iterable[Check]) -> Check:
    """The check that is closest to (or furthest beyond) its tolerance, under a common name.

    What it was called itself goes in front of its `worst`. The tolerances must be the same.
    """
    worst = max(checks, key=lambda check: worst_first(check.measured))
    return replace(worst, name=name, worst=f"{worst.name}: {worst.worst}")


@dataclass(frozen=True)
class Plate:
    """A figure for the report: file name without ending, figure, caption."""

    rung: int
    name: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class Text:
    """A paragraph (Markdown) for the report."""

    rung: int
    words: str


Finding = Check | Plate | Text

"""What a rung of the ladder yields: checks with verdicts, pictures, and words for the report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet.base.errors import InputError
from exunet.verification.tolerances import Tolerance

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Check:
    """One comparison.

    name     : what was compared
    measured : the difference found, in `allowed.unit`
    allowed  : the tolerance, or None for a measurement without a requirement
    worst    : where the difference is largest: node or element, time, both values
    subject  : the case (or what else) that was looked at; empty: that of its `Step`
    rung     : number of the rung, which its `Step` sets
    left_out : nothing was compared here; `name` says what, `worst` why
    """

    name: str
    measured: float
    allowed: Tolerance | None
    worst: str = ""
    subject: str = ""
    rung: int = 0
    left_out: bool = False

    @property
    def holds(self) -> bool:
        """False also where the measurement is NaN."""
        return self.allowed is None or self.measured <= self.allowed.value

    @property
    def verdict(self) -> str:
        if self.left_out:
            return "LEFT OUT"
        if self.allowed is None:
            return "noted"
        return "holds" if self.holds else "FAILS"


def left_out(what: str, why: str) -> Check:
    """A row that says what was not compared, and why; the verdict counts these."""
    return Check(what, 0.0, None, why, left_out=True)


def difference(
    name: str,
    a: Floats,
    b: Floats,
    allowed: Tolerance,
    axes: Sequence[str],
    unit: str = "",
    least: float = 0.0,
    scale: float | None = None,
) -> Check:
    """The largest |a - b| relative to the largest entry of both arrays, and where it is.

    axes  : what each axis of the arrays counts, such as ("state", "node", "xyz")
    unit  : of the entries
    least : the divisor is at least this
    scale : the divisor, if it is another one
    """
    gap = np.abs(a - b)
    if not gap.size:
        return Check(name, 0.0, allowed, "nothing to compare")
    at = np.unravel_index(int(np.argmax(gap)), gap.shape)
    largest = scale or max(float(np.abs(a).max()), float(np.abs(b).max()), least) or 1.0
    place = ", ".join("xyz"[k] if axis == "xyz" else f"{axis} {k}" for axis, k in zip(axes, at, strict=True))
    words = f"{place}: {a[at]:.16g} and {b[at]:.16g} {unit}".rstrip()
    return Check(name, float(gap[at]) / largest, allowed, words)


def worst_of(name: str, checks: Iterable[Check]) -> Check:
    """The check with the largest measurement (NaN counts as infinite), under a common name.

    What it was called itself goes in front of its `worst`. The tolerances must be the same.
    """
    worst = max(checks, key=lambda check: math.inf if math.isnan(check.measured) else check.measured)
    return replace(worst, name=name, worst=f"{worst.name}: {worst.worst}")


@dataclass(frozen=True)
class Plate:
    """A figure for the report: file name without ending, figure, caption."""

    name: str
    figure: Figure
    caption: str
    rung: int = 0


@dataclass(frozen=True)
class Text:
    """A paragraph (Markdown) for the report."""

    words: str
    rung: int = 0


Evidence = Check | Plate | Text


CASES = Path(exunet.__file__).parent / "cases"


def shipped(folder: str = "") -> dict[str, Path]:
    """Name -> file of the cases in cases/ or a folder in it; raises InputError if there are none."""
    paths = sorted((CASES / folder).glob("*.toml"))
    if not paths:
        raise InputError(f"{CASES / folder}: the cases that come with exunet are not there: install it again")
    return {path.stem: path for path in paths}


def shipped_case(folder: str, name: str) -> Path:
    """One of them; raises InputError if it is not there."""
    if (path := shipped(folder).get(name)) is None:
        raise InputError(f"{CASES / folder / name}.toml: this case comes with exunet and is not there")
    return path

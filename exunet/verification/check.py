"""Findings of the verification suite: checks with verdicts, and pictures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.verification.tolerances import Tolerance

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Check:
    """Comparison of a value with the expected value.

    Parameters
    ----------
    name : str
        What is compared.
    error : float
        Difference of both, in ``tolerance.unit``.
    tolerance : Tolerance or None
        Largest admissible error with its reason; None for a measurement without a requirement.
    where : str
        Node or element, time and unit of the largest difference, or the reason why nothing is compared.
    value, expected : float
        Both numbers at that place; NaN where the check is not about two numbers.
    subject : str
        Case, set by the item of the suite unless given.
    section : str
        Section of the report, set by the item of the suite unless given.
    skipped : bool
        Nothing is compared; ``name`` is what, ``where`` the reason.
    """

    name: str
    error: float
    tolerance: Tolerance | None
    where: str = ""
    value: float = math.nan
    expected: float = math.nan
    subject: str = ""
    section: str = ""
    skipped: bool = False

    @property
    def holds(self) -> bool:
        """True if the error is within the tolerance; False for NaN."""
        return self.tolerance is None or self.error <= self.tolerance.value

    @property
    def verdict(self) -> str:
        if self.skipped:
            return "not compared"
        if self.tolerance is None:
            return "measured"
        return "holds" if self.holds else "FAILS"

    @property
    def part(self) -> float:
        """Part of the tolerance that the error takes; 0 or infinite where the tolerance is zero."""
        if self.tolerance is None or self.skipped:
            return 0.0
        if math.isnan(self.error):
            return math.inf
        allowed = self.tolerance.value
        return self.error / allowed if allowed else (0.0 if self.error <= 0.0 else math.inf)


@dataclass(frozen=True)
class Picture:
    """Figure of the report as PNG, with its caption."""

    name: str
    png: bytes
    caption: str
    subject: str = ""
    section: str = ""


Finding = Check | Picture


def skipped(what: str, why: str) -> Check:
    """Return a row that names what is not compared, and why."""
    return Check(what, 0.0, None, why, skipped=True)


def difference(
    name: str,
    a: Floats,
    b: Floats,
    tolerance: Tolerance,
    axes: Sequence[str],
    unit: str = "",
    floor: float = 0.0,
    scale: float | None = None,
) -> Check:
    """Compare arrays: the largest \\|a - b\\| relative to the largest entry of both, and its place.

    Parameters
    ----------
    axes : sequence of str
        What each axis of the arrays counts, such as ("state", "node", "xyz").
    floor : float
        Smallest divisor.
    scale : float or None
        The divisor, if not the largest entry.
    """
    gap = np.abs(a - b)
    if not gap.size:
        return Check(name, 0.0, tolerance, "arrays without entries")
    at = np.unravel_index(int(np.argmax(gap)), gap.shape)
    divisor = scale or max(float(np.abs(a).max()), float(np.abs(b).max()), floor) or 1.0
    place = ", ".join("xyz"[k] if axis == "xyz" else f"{axis} {k}" for axis, k in zip(axes, at, strict=True))
    where = f"{place} [{unit}]" if unit else place
    return Check(name, float(gap[at]) / divisor, tolerance, where, float(a[at]), float(b[at]))


def against(name: str, value: float, expected: float, tolerance: Tolerance, unit: str) -> Check:
    """Compare a value with a known value, relative to the latter."""
    return Check(name, abs(value - expected) / abs(expected), tolerance, f"[{unit}]", value, expected)


def worst_of(name: str, checks: Iterable[Check]) -> Check:
    """Return the check with the largest error (NaN counts as infinite) under a common name.

    Its own name goes in front of the place. The tolerances must be the same.
    """
    worst = max(checks, key=lambda check: math.inf if math.isnan(check.error) else check.error)
    return replace(worst, name=name, where=f"{worst.name}: {worst.where}")

"""Metrics of a run by name: value, unit, printed digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.course import Course


def unit_of_last_digit(value: float, digits: int) -> float:
    """What the last of so many significant digits of a value counts; 0 for 0."""
    return 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1) if value else 0.0


def printed(value: float, unit_of_last: float) -> str:
    """A value down to a digit: 1234.6 with 0.1, 1200 with 100; without rounding where that is 0."""
    if unit_of_last <= 0.0 or not math.isfinite(unit_of_last):
        return f"{value:.4g}"
    if abs(value) < 0.5 * unit_of_last:
        return "0"
    decimals = -math.floor(math.log10(unit_of_last) + 1e-9)
    if abs(value) >= 1e7 or decimals > 7:
        digits = max(0, math.floor(math.log10(max(abs(value), unit_of_last))) + decimals)
        return f"{value:.{digits}e}"
    return f"{round(value, decimals):.{max(0, decimals)}f}"


Floats = NDArray[np.float64]

COUNT = 1.0 - 1e-9  # `Headline.least` of whole numbers: printed as such, of which any two differ


@dataclass(frozen=True)
class Headline:
    """One quantity that stands in the summary and in the table.

    name     : its key in summary.json, without the unit
    words    : its name in tables and figures
    unit     : "N", "m2", ...; "": none
    value    : from a course; None where it is not defined
    digits   : significant ones that are printed
    least    : differences up to this [unit] are those of round-off, or of the moves themselves
    place    : where a value was found, as the element of a tension; None: nowhere in particular
    place_is : what `place` numbers, such as "in element"
    nowhere  : what the table says where no run has a place
    at_a_time : it is one of the course's times, known no better than to half of their spacing
    of_a_time : it is a value at one of the course's times, which misses what is between them
    at_a_step : it is the end of a step, known no better than to half of it
    remark   : what the table says after the value
    group    : of elements, whose margin it is; "": of none
    peak_of  : the group of `Net.groups` whose largest tension it is; "": of none, or of all
    size     : from a course; what the digits are counted from, where that is more than the value: of a part
               of a vector the whole, of a difference what it is small against
    row      : of the table, which parts of a vector have in common; "": it has one of its own
    constant : from a course: words for what stays the same all the time, so that there is no such value; "":
               nothing does
    of_book  : it is an entry of the books of momentum and energy, for table and summary alone
    detail   : it stands in the summary and in files alone, as one of many of which the table has the largest
    """

    name: str
    words: str
    unit: str
    value: Callable[[Course], float | None]
    digits: int = 4
    least: float = 1e-12
    place: Callable[[Course], int] | None = None
    place_is: str = ""
    nowhere: str = ""
    at_a_time: bool = False
    of_a_time: bool = False
    at_a_step: bool = False
    remark: str = ""
    group: str = ""
    peak_of: str = ""
    size: Callable[[Course], float] | None = None
    row: str = ""
    constant: Callable[[Course], str] | None = None
    of_book: bool = False
    detail: bool = False

    @property
    def key(self) -> str:
        """Its key in summary.json: name and unit."""
        unit = self.unit.replace("/", "_").replace(" ", "_")
        return f"{self.name}_{unit}" if unit else self.name

    def last_digit(self, value: float, size: float = 0.0) -> float:
        """What the last digit of a value counts that is printed."""
        return max(unit_of_last_digit(max(abs(value), size), self.digits), self.least)


def of_vector(
    name: str,
    row: str,
    unit: str,
    vector: Callable[[Course], Floats | None],
    size: Callable[[Course], float] | None = None,
    **settings: Any,
) -> tuple[Headline, ...]:
    """Headlines of the parts x, y and z of a vector (3,) of a course, which share a row of the table.

    size     : what the vector is small against; None: nothing
    settings : further fields of each
    """

    def part(axis: int) -> Callable[[Course], float | None]:
        def value(course: Course) -> float | None:
            found = vector(course)
            return None if found is None else float(found[axis])

        return value

    def length(course: Course) -> float:
        found = vector(course)
        least = 0.0 if size is None else size(course)
        return least if found is None else max(least, float(np.linalg.norm(found)))

    return tuple(
        Headline(f"{name}_{axis}", f"{row}, {axis}", unit, part(k), size=length, row=row, **settings)
        for k, axis in enumerate("xyz")
    )


def shown(one: Headline, value: float) -> str:
    """A value to the digits that a headline has, with its unit."""
    return f"{printed(value, one.last_digit(value))} {one.unit}".rstrip()

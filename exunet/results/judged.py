"""One headline of many runs: a value with its error, or a median with a range, and how it is printed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from exunet.results.headline import Headline, printed, unit_of_last_digit

FINEST = 1e-3  # of the last digit that is printed without an error: no error shows finer ones
NOT_CONVERGED = "not converged"


@dataclass(frozen=True)
class Judged:
    """One headline of a spread.

    headline : which
    runs     : how many of the runs have it
    of_runs  : how many runs there are; 0: as many as have it
    median   : of the moved starts
    least, largest : of these, of the start as it is, and of the run itself
    value, error : of the converged run, where the range is small against the printed digits; else None
    places   : (place, number of runs) of a headline that has places, the most frequent first
    size     : what its digits are counted from, if that is more than the value
    spacing  : of the times [s] of which it is one: a range has no finer digits; 0: it is none
    converged : False if a finer setting gives another range
    """

    headline: Headline
    runs: int
    median: float
    least: float
    largest: float
    value: float | None = None
    error: float | None = None
    places: tuple[tuple[int, int], ...] = ()
    size: float = 0.0
    spacing: float = 0.0
    converged: bool = True
    of_runs: int = 0

    @property
    def predictable(self) -> bool:
        """True if it is a value with an error, False if it is a range."""
        return self.value is not None

    def words(self) -> str:
        """The value with its error, or the median with the range; units included."""
        unit = f" {self.headline.unit}" if self.headline.unit else ""
        if self.value is not None and self.error is not None:
            (value,), error = _rounded([self])
            return f"{value}{error}{unit}"
        last = max(self.last_digit(self.least), self.last_digit(self.largest), _power_above(self.spacing))
        low, middle, high = (printed(each, last) for each in (self.least, self.median, self.largest))
        remark = "" if self.converged else f", {NOT_CONVERGED}"
        remark += f", in {self.runs} of {self.of_runs} runs" if self.runs < self.of_runs else ""
        return f"median {middle}{unit}, {low} to {high}{unit}{remark}"

    def relative_to(self, scale: float) -> Judged:
        """The same as a part of a scale [unit]."""
        one, numbers = self.headline, ("median", "least", "largest", "value", "error", "size")
        parts: dict[str, Any] = {
            name: None if (of := getattr(self, name)) is None else of / scale for name in numbers
        }
        return replace(self, headline=replace(one, unit="", least=one.least / scale), **parts)

    def last_digit(self, value: float) -> float:
        """What the last digit of a value counts that is printed."""
        return self.headline.last_digit(value, self.size)


def _power_above(value: float) -> float:
    """The least power of ten that is not less; 0 for 0."""
    return 10.0 ** math.ceil(math.log10(value) - 1e-9) if value > 0.0 else 0.0


def words_of_vector(parts: Sequence[Judged]) -> str:
    """The values of its parts with the largest of their errors, or part by part if one of them is a range."""
    if not all(part.predictable for part in parts):
        return "; ".join(f"{item.headline.name[-1]}: {item.words()}" for item in parts)
    values, error = _rounded(parts)
    return f"({', '.join(values)}){error} {parts[0].headline.unit}"


def _rounded(parts: Sequence[Judged]) -> tuple[list[str], str]:
    """Values down to the digit of the error of all, and " ± " with it, rounding included; "" for none."""
    values = [part.value for part in parts if part.value is not None]
    error = max(item.error for item in parts if item.error is not None)
    last = max(one.last_digit(value) for one, value in zip(parts, values, strict=True))
    if error <= parts[0].headline.least:  # differences of round-off
        return [printed(value, last) for value in values], ""
    last = max(unit_of_last_digit(error, 1), last * FINEST)
    error += max(abs(value - round(value / last) * last) for value in values)
    last = max(last, unit_of_last_digit(error, 1))
    shown = math.ceil(error / last * (1.0 - 1e-9)) * last
    return [printed(value, last) for value in values], f" ± {printed(shown, last)}"

"""One table of a TOML file that notes which of its keys were asked for, so that the others can be refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any


def refusal(what: str, why: str) -> str:
    """The sentence with which an unknown thing is turned away."""
    return f"reference_impl does not know {what}: {why}"


class Table:
    """A TOML table at a dotted `path`; false if absent.  A faulty value is None, with a line in `faults`."""

    def __init__(self, values: Any, path: str, faults: list[str], present: bool = True) -> None:
        self.values: dict[str, Any] = values
        self.path = path
        self.faults = faults
        self.seen: set[str] = set()
        self.present = present

    def __bool__(self) -> bool:
        return self.present

    def name(self, key: str) -> str:
        """The key with its path."""
        return f"{self.path}.{key}" if self.path else key

    def need(self, key: str, convert: Callable[[Any], Any]) -> Any:
        """The converted value; its absence is a fault (unless the whole table is absent)."""
        if key not in self.values and self.present:
            self.faults.append(f"{self.name(key)}: missing")
        return self.get(key, convert, None)

    def get(self, key: str, convert: Callable[[Any], Any], default: Any) -> Any:
        """The converted value, or the default where the key is absent."""
        if key not in self.values:
            return default
        self.seen.add(key)
        try:
            return convert(self.values[key])
        except ValueError as error:
            self.faults.append(f"{self.name(key)}: {error}")
            return None

    def table(self, key: str, required: bool = True) -> Table:
        """The table under `key`; an absent or unusable one is false and empty."""
        self.seen.add(key)
        inner = self.values.get(key)
        if isinstance(inner, dict):
            return Table(inner, self.name(key), self.faults)
        if inner is not None:
            self.faults.append(f"{self.name(key)}: must be a table")
        elif required and self.present:
            self.faults.append(f"[{self.name(key)}]: missing")
        return Table({}, self.name(key), self.faults, present=False)

    def ignore_rest(self) -> None:
        """Counts all keys as known: for a table whose kind is unknown, one fault is enough."""
        self.seen.update(self.values)

    def close(self) -> None:
        """Refuses, by name, every key that nobody asked for."""
        for key in self.values:
            if key not in self.seen:
                self.faults.append(
                    refusal(self.name(key), "no such key in the part of case format 1 it reads")
                )


def text(value: Any) -> str:
    """A one-line string."""
    if not isinstance(value, str) or "\n" in value:
        raise ValueError("must be one line of text")
    return value


def texts(value: Any) -> tuple[str, ...]:
    """Reads a list of one-line strings, each once."""
    if not isinstance(value, list):
        raise ValueError("must be a list of texts")
    found = tuple(text(v) for v in value)
    if len(set(found)) < len(found):
        raise ValueError("must name each once")
    return found


def one_of_names(*known: str) -> Callable[[Any], str]:
    """Reads one of these names."""

    def convert(value: Any) -> str:
        if value not in known:
            raise ValueError(f"must be one of {', '.join(known)}, not {value!r}")
        return str(value)

    return convert


def number(
    minimum: float = -math.inf, above: float = -math.inf, maximum: float = math.inf
) -> Callable[[Any], float]:
    """Reads a finite number >= minimum, > above and <= maximum."""

    def convert(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"must be a number, not {value!r}")
        try:
            result = float(value)
        except OverflowError:
            result = math.inf
        if not math.isfinite(result):
            raise ValueError("must be finite")
        if result < minimum:
            raise ValueError(f"must be at least {minimum:g}, not {result:g}")
        if result <= above:
            raise ValueError(f"must be greater than {above:g}, not {result:g}")
        if result > maximum:
            raise ValueError(f"must be at most {maximum:.10g}, not {result:.10g}")
        return result

    return convert


def count(minimum: int) -> Callable[[Any], int]:
    """Reads a whole number >= minimum."""

    def convert(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(f"must be a whole number, not {value!r}")
        if not minimum <= value <= 10_000_000:
            raise ValueError(f"must be from {minimum} to 10000000, not {value}")
        return value

    return convert


def numbers(
    n: int | None, minimum: float = -math.inf, above: float = -math.inf
) -> Callable[[Any], tuple[float, ...]]:
    """Reads a list of n numbers (of any length where n is None)."""

    def convert(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or (n is not None and len(value) != n):
            raise ValueError("must be a list of numbers" if n is None else f"must be a list of {n} numbers")
        return tuple(number(minimum, above)(v) for v in value)

    return convert


def triples(value: Any) -> tuple[tuple[float, ...], ...]:
    """Reads a list of [x, y, z]."""
    if not isinstance(value, list):
        raise ValueError("must be a list of [x, y, z]")
    return tuple(numbers(3)(v) for v in value)


def counts(value: Any) -> tuple[int, ...]:
    """Reads a list of numbers of things, from 0."""
    if not isinstance(value, list):
        raise ValueError("must be a list of whole numbers")
    return tuple(count(0)(v) for v in value)

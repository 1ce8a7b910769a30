"""Tables of a case file that note which of their keys were read, so that the others can be refused.

Exunet checks bounds and contradictions of a case before the reference sees it.  What is checked here is that
all of the case is known: a case that is half understood would be a comparison of two different scenes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any


class Refused(ValueError):
    """A case that this program does not run; `faults` holds one line for each reason."""

    def __init__(self, faults: Sequence[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = tuple(faults)


def unknown(what: str, why: str) -> Refused:
    """The refusal of something that is not known here."""
    return Refused([f"reference_impl does not know {what}: {why}"])


class Table:
    """A TOML table at a dotted `path`; raises Refused for what cannot be read."""

    def __init__(self, values: dict[str, Any], path: str = "") -> None:
        self.values, self.path = values, path
        self.seen: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def name(self, key: str) -> str:
        """The key with its path."""
        return f"{self.path}.{key}" if self.path else key

    def need(self, key: str, convert: Callable[[Any], Any]) -> Any:
        """The converted value, which must be there."""
        if key not in self.values:
            raise Refused([f"{self.name(key)}: missing"])
        return self.get(key, convert, None)

    def get(self, key: str, convert: Callable[[Any], Any], default: Any) -> Any:
        """The converted value, or the default where the key is absent."""
        if key not in self.values:
            return default
        self.seen.add(key)
        try:
            return convert(self.values[key])
        except ValueError as error:
            raise Refused([f"{self.name(key)}: {error}"]) from error

    def choice(self, key: str, *known: str) -> str:
        """The text under `key`, which must be one of those known here."""
        kind = str(self.need(key, text))
        if kind not in known:
            raise unknown(f'{self.name(key)} = "{kind}"', f"it knows {', '.join(known)}")
        return kind

    def table(self, key: str) -> Table:
        """The table under `key`, which must be there."""
        return Table(self.need(key, mapping), self.name(key))

    def optional(self, key: str) -> Table | None:
        """The table under `key`; None where it is absent."""
        return self.table(key) if key in self.values else None

    def tables(self, key: str) -> dict[str, Table]:
        """The tables in the table under `key` by name; none where that is absent."""
        outer = self.optional(key)
        return {} if outer is None else {name: outer.table(name) for name in outer.values}

    def ignore(self, *keys: str) -> None:
        """Counts keys as read that mean nothing here."""
        self.seen.update(keys)

    def close(self) -> None:
        """Refuses every key that was not read."""
        for key in self.values:
            if key not in self.seen:
                raise unknown(self.name(key), "no such key in the part of case format 1 it reads")


def mapping(value: Any) -> dict[str, Any]:
    """A table."""
    if not isinstance(value, dict):
        raise ValueError("must be a table")
    return value


def text(value: Any) -> str:
    """A string."""
    if not isinstance(value, str):
        raise ValueError("must be a text")
    return value


def number(value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"must be a finite number, not {value!r}")
    return float(value)


def count(value: Any) -> int:
    """A whole number from 0 on."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"must be a whole number from 0 on, not {value!r}")
    return value


def list_of(convert: Callable[[Any], Any], size: int | None = None) -> Callable[[Any], tuple[Any, ...]]:
    """Reads a list of values, of this size where one is given."""

    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or (size is not None and len(value) != size):
            raise ValueError("must be a list" if size is None else f"must be a list of {size} values")
        return tuple(convert(item) for item in value)

    return read


numbers, counts, texts = list_of(number), list_of(count), list_of(text)
triple = list_of(number, 3)
triples = list_of(triple)

"""Paths of keys in a case: names, and indexes from 0 of items of lists, as in `script[2].force`.

One grammar for overrides, faults, comparisons and parameters: names are joined by dots; a name that is not
bare is in quotes.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

KeyPath = tuple[str | int, ...]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PART = re.compile(r"""\s*([A-Za-z0-9_-]+|"[^"\\\n]+"|'[^'\n]+')\s*((?:\[\s*\d{1,9}\s*\]\s*)*)(\.|$)""")
_LONGEST = 100  # characters of a path in a message


def key_path(text: str) -> KeyPath:
    """Return the parts of a path; raise ValueError if it is not valid."""
    parts: list[str | int] = []
    at, more = 0, "."
    while more and (match := _PART.match(text, at)):
        parts += [match[1].strip("\"'"), *map(int, re.findall(r"\d+", match[2]))]
        at, more = match.end(), match[3]
    if more or at != len(text):
        raise ValueError("must be of the form key.path=value, such as time.end=1.5 or script[0].at=2")
    return tuple(parts)


def dotted(path: KeyPath) -> str:
    """Return a path as `key_path` reads it, cut short."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += ("." if text else "") + (part if _BARE.fullmatch(part) else repr(part))
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the name that is most like another, or of which one is the beginning of the other."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    lower = name.lower()[:_LONGEST]
    found = difflib.get_close_matches(lower, by_lower, n=1)
    found += [one for one in by_lower if one.startswith(lower) or lower.startswith(one)]
    return by_lower[found[0]] if found and lower else None


def leaves(value: Any, path: KeyPath = (), *, vectors: int = 0) -> Iterator[tuple[KeyPath, Any]]:
    """Yield each value in nested tables and lists with its path.

    vectors : lists of up to so many values, none of them a table or a list, are not taken apart
    """
    if isinstance(value, dict):
        items: Iterable[tuple[str | int, Any]] = value.items()
    elif not isinstance(value, list | tuple) or (
        len(value) <= vectors and not any(isinstance(item, dict | list | tuple) for item in value)
    ):
        yield path, value
        return
    else:
        items = enumerate(value)
    for key, item in items:
        yield from leaves(item, (*path, key), vectors=vectors)


class Location(NamedTuple):
    """Where a value stands: `holder[key]`, and its path.

    new : path of the first table that was made for it; () if none was
    """

    holder: Any
    key: Any
    path: KeyPath
    new: KeyPath = ()


def place_of(document: dict[str, Any], path: KeyPath, *, make: bool) -> Location:
    """Find the place of a value, which need not be there with `make`: tables on the way to it are made.

    An index in a table of tables with chosen names counts these in their order. Raises ValueError for an
    index out of range, an unknown key on the way, and a value that is neither a table nor a list.
    """
    node: Any = document
    new: KeyPath = ()
    for k, part in enumerate(path):
        here, last = dotted(path[:k]), k == len(path) - 1
        if isinstance(part, int):
            named = isinstance(node, dict) and all(isinstance(item, dict) for item in node.values())
            if not named and not isinstance(node, list):
                raise ValueError(f"{here} is not a list")
            if part >= len(node):
                names = f" ({', '.join(node)})" if named else ""
                raise ValueError(f"{here} has {len(node)} items{names}, numbered from 0: there is no {part}")
            if named:
                path = (*path[:k], part := list(node)[part], *path[k + 1 :])
        elif isinstance(node, list):
            raise ValueError(f"{here} is a list, not a table: {here}[0] is its first item")
        elif not isinstance(node, dict):
            raise ValueError(f"{here} is not a table")
        elif part not in node and not (make and last):
            if not make or any(isinstance(later, int) for later in path[k:]):
                near = closest(part, node)
                hint = f"; did you mean {dotted((*path[:k], near))}?" if near else f" ({', '.join(node)})"
                raise ValueError(f"there is no {dotted(path[: k + 1])} in the case{hint}")
            new, node[part] = new or path[: k + 1], {}
        if last:
            break
        node = node[part]
    return Location(node, part, path, new)

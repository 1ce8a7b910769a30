"""On which line of a TOML text each key stands; `tomllib` does not tell."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any

from exunet.base.errors import KeyPath

_TOKEN = re.compile(
    r'''
      (?P<comment> \#[^\n]* )
    | (?P<string>  """ (?: [^\\] | \\. )*? "{3,5}  |  \'\'\' .*? '{3,5}
                 | " (?: [^"\\\n] | \\. )* "       |  ' [^'\n]* ' )
    | (?P<open>    [\[{] )
    | (?P<close>   [\]}] )
    | (?P<comma>   , )
    | (?P<newline> \n )
    | (?P<other>   [^\s\#"'\[\]{},]+ )
    ''',
    re.VERBOSE | re.DOTALL,
)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Line (from 1) of every key, table header and array item of a valid TOML text.

    A path holds keys and, for items of arrays and for tables in arrays of tables, indexes from 0. A table
    that has no header of its own is on the line of the first key that makes it.
    """
    text = text.replace("\r\n", "\n")  # as tomllib does with a whole text
    lines: dict[KeyPath, int] = {}
    latest: dict[KeyPath, int] = {}  # the last index in each array of tables
    prefix: KeyPath = ()
    for line, statement, items in _statements(text):
        content = tomllib.loads(statement)
        if statement.lstrip().startswith("["):
            prefix = _header(content, latest)
            _note(lines, prefix[:-1], line)
            lines[prefix] = line
        else:
            for path in _keys(content):
                _note(lines, prefix + path, line)
            if items:
                array = prefix + next(
                    path for path, value in _keys(content).items() if isinstance(value, list)
                )
                lines.update({array + indexes: item_line for indexes, item_line in items.items()})
    return lines


def _note(lines: dict[KeyPath, int], path: KeyPath, line: int) -> None:
    for length in range(1, len(path) + 1):
        lines.setdefault(path[:length], line)


def _header(content: dict[str, Any], latest: dict[KeyPath, int]) -> KeyPath:
    """The path that a table header opens, with the index of the current table in every array of tables."""
    path: KeyPath = ()
    node: Any = content
    while isinstance(node, dict) and node:
        ((key, node),) = node.items()
        path += (key,)
        if isinstance(node, list):
            latest[path] = latest.get(path, -1) + 1
        if path in latest:
            path += (latest[path],)
    return path


def _keys(content: dict[str, Any]) -> dict[KeyPath, Any]:
    """Every path in nested tables, with its value."""
    found: dict[KeyPath, Any] = {}
    waiting: list[tuple[KeyPath, Any]] = [((), content)]
    while waiting:
        path, value = waiting.pop()
        if path:
            found[path] = value
        if isinstance(value, dict):
            waiting.extend(((*path, key), inner) for key, inner in value.items())
    return found


def _statements(text: str) -> Iterator[tuple[int, str, dict[tuple[int, ...], int]]]:
    """(first line, text, lines of array items by index) of each key/value pair and table header.

    A statement ends with the first line break that is in no bracket and no string.
    """
    line, start, begin = 1, 0, 0
    items = _Items()
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup or ""
        if kind == "newline" and not items.open:
            if begin:
                yield begin, text[start : token.start()], items.lines
            start, begin, items = token.end(), 0, _Items()
        elif kind not in ("comment", "newline"):
            if not begin:
                begin = line
                items.in_header = kind == "open"
            items.take(kind, token.group(), line)
        line += token.group().count("\n")
    if begin:
        yield begin, text[start:], items.lines


class _Items:
    """Follows the brackets of one statement and notes the line where each array item begins."""

    def __init__(self) -> None:
        self.open: list[int | None] = []  # the index in each open array; None for an inline table
        self.lines: dict[tuple[int, ...], int] = {}
        self.in_header = False

    def take(self, kind: str, text: str, line: int) -> None:
        indexes = tuple(index for index in self.open if index is not None)
        if kind == "comma":
            if self.open and self.open[-1] is not None:
                self.open[-1] += 1
            return
        if kind == "close":
            self.open.pop()
            return
        if indexes and len(indexes) == len(self.open) and not self.in_header:
            self.lines.setdefault(indexes, line)
        if kind == "open":
            self.open.append(0 if text == "[" else None)

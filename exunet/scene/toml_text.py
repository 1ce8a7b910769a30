"""What `tomllib` does not report of a TOML text: the line of each key, and advice where it is not TOML."""

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


_POSITION = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_NUMBER = r"[+-]?\d[\d_]*(?:\.\d+)?(?:[eE][+-]?\d+)?"
_HEADER = "a table begins with a line of its name in brackets, such as [time]"
_STATEMENT = "a line is key = value, [table] or # comment"

# Beginnings of tomllib's messages; those of values are looked at below.
_ADVICE = {
    "Expected '=' after a key": _STATEMENT,
    "Invalid statement": _STATEMENT,
    "Invalid initial character": "keys consist of letters, digits, _ and -; put any other key in quotes",
    "Unterminated string": "close the text with the quote that it begins with",
    'Expected "': "close the text with the quote that it begins with",
    "Illegal character '\\n'": "close the text on its line with the quote that it begins with",
    "Unclosed array": "put commas between the items and ] at the end",
    "Unclosed inline table": "put commas between the keys and } at the end, all on one line",
    "Expected ']": _HEADER,
    "Unescaped": "write \\\\ for a backslash, or put the text in single quotes",
    "Invalid hex": "write \\\\ for a backslash, or put the text in single quotes",
    "Found invalid": "remove the invisible character",
    "Illegal": "remove the invisible character",
}  # fmt: skip

# What stands where a value should.
_VALUES = (
    (r"(#.*)?$", "a value is missing after ="),
    (r"(true|false)\b", "write true or false in small letters"),
    (r"(none|null|nil)\b", "leave the key out instead"),
    (r"[+-]?\.\d", "put a digit before the point, such as 0.5"),
    ("[\u201c\u201d\u2018\u2019`]", 'put text in plain quotes, such as "RK44"'),
    (r"[a-z_]", 'put text in quotes, such as "RK44"'),
    (r"\(", "put a list in brackets, such as [0.0, 0.0, 1.0]"),
    (r"=", "put one = between key and value"),
)
# What stands after the = where something after the value is wrong.
_REMAINDERS = (
    (r"[+-]?\d+,\d+\s*(#.*)?$", "a number has a point, not a comma"),
    (r"[+-]?\d+\.(?!\d)", "put a digit after the point, such as 5.0"),
    (r"[+-]?0\d", "remove the leading zeros of the number"),
    (rf"({_NUMBER})\s*(//|%|;(?!.*=))", "a comment begins with #"),
    (rf"({_NUMBER})\s*[*/^+-]", "write the number itself: formulas are not evaluated"),
    (rf"({_NUMBER})\s+\d", "a number has no blanks; 1_000 is a thousand"),
    (rf"({_NUMBER})\s*[a-z]", "a unit belongs in a comment, after #"),
)


def syntax_error(message: str, text: str) -> tuple[str, int | None]:
    """Words and line (from 1; None if not known) for what `tomllib.loads(text)` raised as `message`."""
    found = _POSITION.search(message)
    if found is None:
        return message, None
    lines = text.rstrip().split("\n")
    line = int(found[1]) if found[1] else len(lines)
    message = message[: found.start()]
    here = text.split("\n")[line - 1].strip()
    rest = text.split("\n")[line - 1][int(found[2]) - 1 :].strip() if found[2] else ""
    if name := _given_twice(message, here):
        first = _line_of(name, lines[: line - 1])
        where = f", first on line {first}" if first else ""
        return f"{name} is given twice{where}: keep one of them", line
    advice = _advice(message, here, rest)
    return (f"{message}: {advice}" if advice else message), line


def _given_twice(message: str, line: str) -> str:
    """The key or [table] that a line gives again; "" if that is not what is wrong."""
    if found := re.match(r"Duplicate inline table key '(.*)'$", message):
        return found[1]
    if not message.startswith("Cannot"):
        return ""
    header = re.match(r"\[+[^\]]*\]+", line)
    return header[0] if header else line.partition("=")[0].strip()


def _line_of(name: str, lines: list[str]) -> int | None:
    """On which of the lines before, from 1, a [table] is, or a key of the table that the last one is in."""
    for number in range(len(lines), 0, -1):
        line = lines[number - 1].strip()
        if line.startswith(name) if name.startswith("[") else line.partition("=")[0].strip() == name:
            return number
        if line.startswith("[") and not name.startswith("["):
            return None
    return None


def _advice(message: str, line: str, rest: str) -> str:
    if rest.startswith("//"):
        return "a comment begins with #"
    if message.startswith("Invalid initial") and rest.startswith("}"):
        return "remove the comma before }"
    if message.startswith("Expected '='") and rest.startswith(":"):
        return "put = between key and value, not :"
    if message == "Invalid value":
        words = 'a value is a number, "text", true, false, a [list] or a { key = value }'
        return _first(_VALUES, rest) or words
    if message.startswith("Expected newline"):
        if line.startswith("["):
            return _HEADER
        value = line.partition("=")[2].strip()
        return _first(_REMAINDERS, value) or "each key = value has a line of its own; a comment begins with #"
    return next((words for start, words in _ADVICE.items() if message.startswith(start)), "")


def _first(rules: tuple[tuple[str, str], ...], text: str) -> str:
    return next((words for pattern, words in rules if re.match(pattern, text, re.IGNORECASE)), "")

"""TOML documents of cases: read and write them, apply overrides, locate faults in their text."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from typing import Any

import tomli_w
from pydantic import BaseModel

from exunet.base.errors import CaseError, Fault, InputError
from exunet.base.key_path import KeyPath, closest, dotted, key_path, place_of
from exunet.base.validation import Located, is_chosen_name

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


def syntax_error(message: str, text: str) -> tuple[str, int | None]:
    """Return the error of `tomllib.loads(text)` with the text of its line, and the line, from 1, or None."""
    found = _POSITION.search(message)
    if found is None:
        return message, None
    lines = text.rstrip().split("\n")
    line = min(int(found[1]), len(lines)) if found[1] else len(lines)
    here = lines[line - 1].strip()
    remedy = "; write float(x) for a NumPy number" if "np." in here else ""
    return f"{message[: found.start()]} in {here!r}{remedy}", line


MAX_BYTES = 10_000_000
FILES_OF_NET = ("nodes_file", "elements_file")
MAX_FAULTS = 100  # more than anyone reads
WIDTH, INDENT = 100, 4  # of a list on one line, and of its items on lines of their own
# A list of numbers and texts as tomli_w has it, an item a line.
_LIST = re.compile(r"\[\n( +)((?:[^\n\[\]{}]+,\n)+) *\]")


# Reading and writing


def read_text(path: Path) -> str:
    """Return the text of a case file; raises InputError without the file, CaseError if it is not UTF-8."""
    return _decode(_read(path), path)


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, not a case file")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not an ordinary file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: has {size:,} bytes; a case file has at most {MAX_BYTES:,}")
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from None


def _decode(content: bytes, path: Path) -> str:
    if not content.strip():
        raise CaseError([Fault("", "the file is empty", place=f"{path}:1")])
    if content.startswith(b"\xef\xbb\xbf"):
        reason = "begins with a byte order mark; save it as UTF-8 without one"
        raise CaseError([Fault("", reason, place=f"{path}:1")])
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        reason = f"byte 0x{content[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise CaseError([Fault("", reason, place=f"{path}:{line}")]) from None


def parse(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise CaseError([Fault("", "values are nested too deeply", place=str(path))]) from None
    except ValueError as error:  # tomllib.TOMLDecodeError, and whole numbers of thousands of digits
        message, line = syntax_error(str(error), text)
        place = f"{path}:{line}" if line else str(path)
        raise CaseError([Fault("", f"not valid TOML: {message}", place=place)]) from None


def place_files(document: dict[str, Any], folder: Path) -> None:
    """Let the names of files, which are relative to a folder, be absolute."""
    for table, key in _files(document):
        table[key] = os.path.normpath(os.path.join(os.path.realpath(folder), table[key]))


def text_of(document: dict[str, Any], folder: Path) -> str:
    """Return a document as TOML; its names of files are absolute, and become relative to a folder."""
    for table, key in _files(document):
        table[key] = os.path.relpath(table[key], os.path.realpath(folder))
    return _LIST.sub(_one_line, tomli_w.dumps(document, indent=INDENT))


def _files(document: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """The tables and keys that name files: meshes, lists of a net, and a result to start from."""
    bodies = document.get("bodies")
    tables = [(table, "file") for table in bodies.values()] if isinstance(bodies, dict) else []
    tables += [(document.get("net"), key) for key in FILES_OF_NET]
    for table, key in [(document.get("initial"), "restart"), *tables]:
        if isinstance(table, dict) and isinstance(table.get(key), str) and table[key]:
            yield table, key


def _one_line(found: re.Match[str]) -> str:
    """Items of a list, each on its line, without line breaks, or wrapped where they are too long."""
    indent, items = found[1], map(str.strip, found[2].splitlines())
    line = " ".join(items).removesuffix(",")
    if len(indent) > INDENT or len(line) <= WIDTH or '"' in line:
        return f"[{line}]"
    lines = wrap(line, WIDTH, initial_indent=indent, subsequent_indent=indent)
    return "\n".join(["[", *lines, "]"])


# Overrides


@dataclass(frozen=True)
class Override:
    """One override: set the key at `path` to `value`, or remove it.

    misspelt : path of a table that it made, and words on the name that was probably meant
    dropped  : keys of a table that it replaced which the new one does not have; the key that it excludes
    """

    option: str
    path: KeyPath
    value: Any = None
    removes: bool = False
    misspelt: tuple[KeyPath, str] | None = None
    dropped: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        option = " ".join(self.option.split())
        return "--set " + (option if len(option) <= 60 else option[:57] + "...")

    def fault(self, reason: str) -> Fault:
        return Fault("", reason, place=self.place)


def _parse_overrides(overrides: Sequence[str]) -> list[Override]:
    changes, faults = [], []
    for option in overrides:
        if not isinstance(option, str):
            raise InputError(f'load: an override is a text "key.path=value", got {option!r}')
        try:
            changes.append(_parse_override(option))
        except ValueError as error:
            faults.append(Override(option, ()).fault(str(error)))
    if faults:
        raise CaseError(faults)
    return changes


def _parse_override(option: str) -> Override:
    key, equals, value = option.partition("=")
    if not equals:
        raise ValueError("must be of the form key.path=value")
    path = key_path(key)
    value = value.strip()
    if not value:
        return Override(option, path, removes=True)
    return Override(option, path, _value(value))


def _value(text: str) -> Any:
    """`text` as a TOML value; text that is not TOML, unless it looks like an attempt, is a string."""
    try:
        content = tomllib.loads(f"value = {text}")
        if list(content) == ["value"]:
            return content["value"]
    except RecursionError:
        raise ValueError("the value is nested too deeply") from None
    except ValueError as error:
        if text[0] in "[{\"'":
            words, _ = syntax_error(str(error), f"value = {text}")
            raise ValueError(f"the value is not valid TOML: {words}") from None
    if "\n" in text:
        raise ValueError("must set one key")
    return text


def overridden(
    text: str, path: Path, overrides: Sequence[str], root: type[BaseModel]
) -> tuple[dict[str, Any], list[Override]]:
    """The document of a text, whose record is `root`, with overrides, and these as they were applied."""
    document = parse(text, path)
    changes, faults = [], []
    for change in _parse_overrides(overrides):
        try:
            changes.append(applied(change, document, root))
        except ValueError as error:
            faults.append(change.fault(str(error)))
    if faults:
        raise CaseError(faults)
    return document, changes


def applied(change: Override, document: dict[str, Any], root: type[BaseModel]) -> Override:
    """Change a document of a record in place; raises ValueError."""
    holder, key, path, new = place_of(document, change.path, make=not change.removes)
    if change.removes:
        del holder[key]
        return replace(change, path=path)
    parts = path[:3] if path[0] == "bodies" and path[2:3] == ("parts",) and isinstance(holder, dict) else ()
    if len(path) == 4 and parts and not isinstance(change.value, dict):
        raise ValueError(f"{dotted(path)} is not a part: {_names_of_parts(parts, list(holder))}")
    before = holder.get(key) if isinstance(holder, dict) else holder[key]
    holder[key] = change.value
    dropped: tuple[str, ...] = ()
    if isinstance(before, dict) and isinstance(change.value, dict):
        kept = {known[:k] for known in _keys(change.value) for k in range(len(known) + 1)}
        lost = [known for known in _keys(before) if known not in kept and known[:-1] in (*kept, ())]
        dropped = tuple(map(dotted, lost))
    if (other := _INSTEAD.get(path)) is not None and holder.pop(other, None) is not None:
        dropped = (f"net.{other}",)
    misspelt: tuple[KeyPath, str] | None = None
    if new and is_chosen_name(new, root):
        others = [name for name in place_of(document, new, make=False).holder if name != new[-1]]
        if (near := closest(str(new[-1]), others)) is not None:
            misspelt = new, f"there is no such name in the case; did you mean '{near}'?"
        elif parts and new != parts and others:
            misspelt = new, f"there is no such part: {_names_of_parts(parts, others)}"
    return replace(change, path=path, misspelt=misspelt, dropped=dropped)


# Keys of the net that state the same: one that is set replaces the other.
_INSTEAD: dict[KeyPath, str] = {("net", "mesh"): "meshes", ("net", "meshes"): "mesh"}


def _names_of_parts(path: KeyPath, names: list[str]) -> str:
    known, first = ", ".join(names) or "none yet", (names or ["name"])[0]
    return f"parts have names ({known}), as in {dotted(path)}.{first}.radius"


def misspelt(found: list[Located], changes: list[Override]) -> list[Located]:
    """Faults without those in tables that overrides made where another name was probably meant."""
    for new, words in (change.misspelt for change in changes if change.misspelt is not None):
        others = [fault for fault in found if any(path[: len(new)] != new for path in fault[0])]
        if len(others) < len(found):
            found = [*others, ((new,), words)]
    return found


# Lines of faults


def located(found: list[Located], text: str, path: Path, changes: list[Override]) -> list[Fault]:
    """Faults in the order of the file, those from overrides last.

    Of several keys that do not go together, each of them valid, the one that is given last is named.
    """
    places: dict[KeyPath, tuple[int, str]] = {
        key: (line, f"{path}:{line}") for key, line in key_lines(text).items()
    }
    for number, change in enumerate(changes):
        place = (MAX_BYTES + number, change.place)
        for known in [known for known in places if known[: len(change.path)] == change.path]:
            del places[known]
        if change.removes and isinstance(change.path[-1], int):  # later items of the list move up
            places = {_moved_up(known, change.path): place for known, place in places.items()}
        for length in range(1, len(change.path)):
            places.setdefault(change.path[:length], place)
        places[change.path] = place

    def line_of(key: KeyPath) -> tuple[int, str]:
        prefixes = (key[:length] for length in range(len(key), 0, -1))
        return next((places[prefix] for prefix in prefixes if prefix in places), (1, f"{path}:1"))

    last = ((max(paths, key=lambda item: line_of(item)[0]), reason) for paths, reason in found)
    ordered = sorted({(*line_of(key), dotted(key), reason): None for key, reason in last}, key=lambda f: f[0])
    faults = [Fault(key, reason, place=place) for _, place, key, reason in ordered]
    if len(faults) > MAX_FAULTS:
        faults[MAX_FAULTS:] = [Fault("", f"and {len(faults) - MAX_FAULTS} more faults", place=str(path))]
    return faults


def _moved_up(path: KeyPath, removed: KeyPath) -> KeyPath:
    """The path of an item, or within it, once an item of a list is removed."""
    k = len(removed) - 1
    if len(path) > k and path[:k] == removed[:k] and path[k] > removed[k]:  # type: ignore[operator]
        return (*path[:k], path[k] - 1, *path[k + 1 :])  # type: ignore[operator]
    return path

"""Plain tables for the terminal, and the line that names what is running."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.text import Text

from exunet.interfaces.commands.lines import HANG, cells, folded, is_path, width_of


def console() -> Console:
    """For what a command prints: as wide as the terminal, of 80 columns where there is none."""
    return Console(markup=False, emoji=False, highlight=False, width=width_of(sys.stdout))


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """Print rows (name, value) under a title; what is too wide is folded, never cut."""
    out = console()
    names = _width_of_names(rows, out.width)
    for line in folded(title, out.width):
        out.print(Text(line, "italic"), soft_wrap=True)
    for name, value in rows:
        for left, right in _row(name, value, names, out.width):
            whole = Text.assemble((left, "bold"), right)
            whole.rstrip()
            out.print(whole, soft_wrap=True)


def _row(name: str, value: str, names: int, width: int) -> Iterator[tuple[str, str]]:
    """Lines of a row: what stands in the column of names, `names` wide, and beside it."""
    room = width - names - 1
    if _has_path(name, names) or _has_path(value, room):  # one below the other, where both have more room
        yield from ((line, "") for line in folded(name, width))
        yield from ((" " * HANG, line) for line in folded(value, width - HANG, hang=0))
        return
    left, right = folded(name, names, hang=0), folded(value, room, hang=0)
    for k in range(max(len(left), len(right))):
        first, second = (column[k] if k < len(column) else "" for column in (left, right))
        yield first + " " * (names - cells(first) + 1), second


def _has_path(text: str, width: int) -> bool:
    """True if a text has a path that is wider than its column."""
    return any(is_path(word) and cells(word) > width for word in text.split())


def _width_of_names(rows: list[tuple[str, str]], width: int) -> int:
    """Of the longest name, up to a third of the width."""
    return min(max((cells(name) for name, _ in rows), default=1), width // 3)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """A function that names the work in progress on stderr; it says nothing when that is no terminal."""
    if not sys.stderr.isatty():
        yield lambda words: None
        return
    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    with console.status("") as line:
        yield line.update

"""Plain tables for the terminal, and the line that names what is running."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.table import Table

WIDTH = 80  # of what does not go to a terminal


def console() -> Console:
    """For what a command prints: as wide as the terminal, of 80 columns where there is none."""
    plain = Console(markup=False, emoji=False, highlight=False)
    return plain if plain.is_terminal else Console(markup=False, emoji=False, highlight=False, width=WIDTH)


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """Print rows (name, value) under a title; what is too wide is folded, never cut."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    out = console()
    table.add_column(style="bold", overflow="fold", no_wrap=False, min_width=_width_of_names(rows, out.width))
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, value)
    out.print(table)


def _width_of_names(rows: list[tuple[str, str]], width: int) -> int:
    """Of the longest name, up to a third of the width."""
    return min(max((len(name) for name, _ in rows), default=1), width // 3)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """A function that names the work in progress on stderr; it says nothing when that is no terminal."""
    if not sys.stderr.isatty():
        yield lambda words: None
        return
    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    with console.status("") as line:
        yield line.update

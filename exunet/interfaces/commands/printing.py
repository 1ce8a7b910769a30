"""Plain two-column tables for the terminal, and the line that names what is running."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.table import Table


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """Print rows (name, value) under a title; narrow terminals wrap the values."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, value)
    console = Console(markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console = Console(markup=False, emoji=False, highlight=False, width=110)
    console.print(table)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """A function that names the work in progress on stderr; it says nothing when that is no terminal."""
    if not sys.stderr.isatty():
        yield lambda words: None
        return
    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    with console.status("") as line:
        yield line.update

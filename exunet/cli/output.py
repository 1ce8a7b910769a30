"""What commands print: tables on stdout; messages, and the progress of what is running, on stderr."""

from __future__ import annotations

import shutil
import sys
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Protocol, Self

import typer

if TYPE_CHECKING:  # the help of commands does without rich
    from rich.console import Console, RenderableType
    from rich.progress import Progress, ProgressColumn

INTERVAL = 30.0  # [s] between two lines of progress where there is no terminal


class Update(Protocol):
    """Show how much is done, with a remark."""

    def __call__(self, done: float, remark: str = "") -> None: ...


def console(*, stderr: bool = False) -> Console:
    """Return a console that prints text as it is."""
    from rich.console import Console

    width = None if (sys.stderr if stderr else sys.stdout).isatty() else terminal_width()
    return Console(stderr=stderr, width=width, markup=False, emoji=False, highlight=False)


def report(message: str) -> None:
    """Print a message in a line on stderr; a pipe that nobody reads any more does not end a run."""
    with suppress(BrokenPipeError):
        sys.stderr.write(f"{message}\n")
        sys.stderr.flush()


def silent(_message: str) -> None:
    """Print nothing, for a quiet command."""


def terminal_width() -> int:
    """Return the width of lines [characters]: that of the terminal, from 80 to 120; 110 elsewhere."""
    return max(80, min(120, shutil.get_terminal_size((110, 24)).columns))


def print_line(line: str) -> None:
    """Print a line on stdout, above what changes on the terminal (typer.echo would print into it)."""
    sys.stdout.write(f"{line}\n")


def print_rich(*renderables: RenderableType) -> None:
    """Print what rich lays out, without blanks at the ends of lines."""
    out = console()
    with out.capture() as printed:
        out.print(*renderables, sep="\n")
    typer.echo("\n".join(line.rstrip() for line in printed.get().splitlines()))


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """Print rows (name, value) under a title."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", max_width=console().width // 3)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(name), Text(value))
    print_rich(Text(title, "italic"), table)


def print_columns(
    header: Sequence[str], lines: Sequence[Sequence[str]], *, narrow: int | None = None
) -> None:
    """Print lines of a table under a header.

    narrow : number of columns that are not folded; None: the last two, and the first has 26 characters
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for k, name in enumerate(header):
        fixed = k >= len(header) - 2 if narrow is None else k < narrow
        table.add_column(name, no_wrap=fixed, min_width=26 if k == 0 and narrow is None else None)
    for line in lines:
        table.add_row(*line)
    print_rich(table)


def _live(*columns: ProgressColumn, quiet: bool) -> Progress:
    """Return a line on stderr that changes, if that is a terminal; what is printed meanwhile is above it."""
    from rich.progress import Progress

    err = console(stderr=True)
    disable = quiet or not err.is_terminal
    redirect = sys.stdout.isatty()  # else lines for a file would go to the terminal
    return Progress(*columns, console=err, transient=True, disable=disable, redirect_stdout=redirect)


@contextmanager
def status(message: str = "", *, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is running; yields the function that changes the message."""
    from rich.progress import SpinnerColumn, TextColumn

    with _live(SpinnerColumn(), TextColumn("{task.description}"), quiet=quiet) as line:
        number = line.add_task(message, total=None)

        def show(message: str) -> None:
            line.update(number, description=message)

        yield show


class ProgressBar:
    """Progress of what is running: a bar on a terminal, elsewhere a line now and then."""

    def __init__(self, *, quiet: bool = False) -> None:
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

        self._bar = _live(
            TextColumn("{task.fields[what]} {task.completed:.4g} of {task.total:.4g} {task.fields[unit]}"),
            BarColumn(bar_width=20),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            quiet=quiet,
        )
        self._lines = self._bar.disable and not quiet

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def begin(self, what: str, total: float, unit: str = "") -> Update:
        """Show another thing that is done, in place of the one before; returns the function that updates it.

        Parameters
        ----------
        what : str
            What is done, "simulated".
        total : float
            How much there is to do, in `unit`.
        """
        bar, reported = self._bar, clock.monotonic()
        for before in bar.task_ids:
            bar.remove_task(before)
        number = bar.add_task("", total=total, what=what, unit=unit, rate="")

        def update(done: float, remark: str = "") -> None:
            nonlocal reported
            task = bar.tasks[0]
            rate = f"{task.speed:.3g} {unit}/s" if task.speed else ""
            bar.update(number, completed=done, description=remark, rate=rate)
            if self._lines and clock.monotonic() - reported > INTERVAL:
                reported, left = clock.monotonic(), task.time_remaining
                known = "" if left is None else f", {duration(left)} left"
                report(f"{what} {done:.4g} of {total:.4g} {unit}{known} {remark}".rstrip())

        return update


def duration(seconds: float) -> str:
    """Return a time with two digits, in a suitable unit."""
    units = ((365.25 * 86400.0, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min"))
    size, unit = next(((size, unit) for size, unit in units if seconds >= 2.0 * size), (1.0, "s"))
    value = float(f"{seconds / size:.2g}")
    return f"{value:.0f} {unit}" if value >= 10.0 else f"{value:g} {unit}"

"""Shared parts of commands: options, folders, tables on stdout, messages and progress on stderr."""

from __future__ import annotations

import hashlib
import math
import re
import shutil
import sys
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Self

import typer

from exunet.base.cases import found
from exunet.base.errors import InputError
from exunet.base.times import duration
from exunet.methods.method import Backend

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.progress import Progress, ProgressColumn

    from exunet.scene.casefile import Case

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


def first_clause(message: str) -> str:
    """Return the first clause of a message whose whole is printed elsewhere."""
    return re.split(r"[:;,.] ", message, maxsplit=1)[0]


def silent(_message: str) -> None:
    """Print nothing, for a quiet command."""


def terminal_width() -> int:
    """Return the width of lines [characters]: that of the terminal, from 80 to 120; 110 elsewhere."""
    return max(80, min(120, shutil.get_terminal_size((110, 24)).columns))


def print_line(line: str) -> None:
    """Print a line on stdout, above what changes on the terminal (typer.echo would print into it)."""
    sys.stdout.write(f"{line}\n")


def print_rich(*renderables: RenderableType, most: int | None = None) -> None:
    """Print what rich lays out, without blanks at the ends of lines; most: lines, the rest is for --all."""
    out = console()
    with out.capture() as printed:
        out.print(*renderables, sep="\n")
    lines = [line.rstrip() for line in printed.get().splitlines()]
    if most is not None and len(lines) > most:
        lines[most - 1 :] = [f"{len(lines) - most + 1} lines more: --all"]
    typer.echo("\n".join(lines))


def print_table(title: str, rows: list[tuple[str, str]], *, most: int | None = None) -> None:
    """Print rows (name, value) under a title; most: lines, the rest is for --all."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", max_width=console().width // 3)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(name), Text(value))
    print_rich(Text(title, "italic"), table, most=most)


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
        least = max(len(line[k]) for line in (header, *lines)) if fixed else 26 if k == 0 else None
        table.add_column(name, no_wrap=fixed, min_width=least)
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
def status(message: str = "") -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is running; yields the function that changes the message."""
    from rich.progress import SpinnerColumn, TextColumn

    with _live(SpinnerColumn(), TextColumn("{task.description}"), quiet=False) as line:
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


MIN_RUNS, MAX_RUNS = 8, 100_000  # perturbed runs


def as_path(text: str | Path) -> Path:
    """Return a path; the readers of files report what is wrong with it."""
    if text == "":  # which Path takes for the working directory
        raise InputError("the name of a file or folder is empty: give a path ('.' is the working directory)")
    return Path(text)


def as_case(text: str | Path) -> Path:
    """Return the path of a case, which may be the name of a shipped case."""
    return found(as_path(text))


def _enough(runs: int | None) -> int | None:
    if runs and not MIN_RUNS <= runs <= MAX_RUNS:
        raise typer.BadParameter(f"must be 0, or from {MIN_RUNS} to {MAX_RUNS}, got {runs}")
    return runs


def finite(value: float | None) -> float | None:
    """Raise the error of the option for nan and infinity."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"must be finite, got {value:g}")
    return value


def out_option(default: str, what: str = "folder to write into", metavar: str = "DIR") -> Any:
    """Return the option for the folder or file to write; default: its place without the option."""
    return typer.Option("-o", "--out", help=f"{what} (default: {default})", metavar=metavar, parser=as_path)


def file_option(default: str) -> Any:
    """Return the option for the file to write."""
    return out_option(default, "file to write", "FILE")


def on_backend(overrides: list[str], backend: Backend | None) -> list[str]:
    """Return the overrides of a case with those of --backend."""
    return overrides if backend is None else [*overrides, f"engine.backend={backend}"]


def ensemble_option(default: str) -> Any:
    """Return the option for the perturbed runs; default: their number without it."""
    words = (
        "number of further runs, each perturbed by up to 1e-9 m, from which the ranges of the metrics follow"
    )
    return typer.Option(
        "--ensemble", metavar="N", callback=_enough, help=f"{words}; 0: none (default: {default})"
    )


@contextmanager
def as_options(*names: str) -> Iterator[None]:
    """Let an InputError that begins with names of arguments name the options instead.

    names : of the arguments, as in messages: "fps", "from, until"; none: each message begins with a name
    """
    try:
        yield
    except InputError as error:
        what, colon, words = str(error).partition(": ")
        if names and what not in names:
            raise
        options = ", ".join(f"--{name}" for name in what.split(", "))
        raise InputError(f"{options}{colon}{words}") from None


CasePath = Annotated[
    Path, typer.Argument(help="case file (TOML) or shipped case", metavar="CASE", parser=as_case)
]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="replace a value of the case, such as script[2].force=3, or remove it (KEY=); may be given "
        "several times",
    ),
]
BackendOption = Annotated[
    Backend | None, typer.Option("--backend", help="integrator, for engine.backend of the case")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="print errors only")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="replace existing files, once the new ones are complete")
]
ResultPath = Annotated[
    Path, typer.Argument(help="result.h5 of a run, or its folder", metavar="RESULT", parser=as_path)
]


RESULTS = Path("results")
_VALUE = 24  # characters of a value
_NAME = 150  # bytes of a name; file systems take 255, of which numbers and temporary names need some
_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")


def folder_of(case: Case, *more: str) -> Path:
    """Return results/CASE--net.size=2--solver.method=RK44, from the case and its overrides.

    more : further parts of the name, for what is not a run
    """
    name = "--".join([case.name, *map(_short, case.overrides), *more])
    code = name.encode("utf-8", "surrogateescape")
    if len(code) > _NAME:
        kept = code[:_NAME].decode("utf-8", "ignore")
        name = f"{kept}-{_hash(case.name, *case.overrides, *more)}"
    return RESULTS / name


def _short(override: str) -> str:
    """Return a key with its value; a value that is long or has special characters ends in a hash."""
    key, _, value = (part.strip() for part in override.partition("="))
    plain = value.strip("\"'")
    safe = _UNSAFE.sub("_", plain)
    if safe != plain or len(safe) > _VALUE:
        safe = f"{safe[:_VALUE]}-{_hash(value)}"
    return f"{_UNSAFE.sub('_', key)}={safe}"


def _hash(*text: str) -> str:
    return hashlib.sha256("\n".join(text).encode("utf-8", "surrogateescape")).hexdigest()[:8]


@contextmanager
def opened(wanted: Path, *, own: bool) -> Iterator[Path]:
    """Make the folder of a command: `wanted`, or if it is its `own` default the next that is free.

    New folders that are empty at the end of the block are removed.
    """
    from exunet.base.files import cannot_write

    try:
        missing = [parent for parent in wanted.parents if not parent.exists()]
        folder, made = wanted, own or not wanted.exists()
        if own:
            from exunet.results.run_folder import new_folder

            folder = new_folder(wanted)
        else:
            folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise cannot_write(wanted, error) from error
    try:
        yield folder
    finally:
        for empty in (folder, *missing) if made else ():
            with suppress(OSError):  # not empty: a part of the run is kept
                empty.rmdir()


def ready(folder: Path, names: Sequence[str]) -> None:
    """Raise InputError if files of these names cannot be written; existing files stay."""
    from exunet.base.files import cannot_write, sweep

    try:
        sweep(folder)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise cannot_write(folder, error) from error
    for name in names:
        if (folder / name).exists() and not (folder / name).is_file():
            raise InputError(f"{folder / name}: cannot be written: it is not an ordinary file")

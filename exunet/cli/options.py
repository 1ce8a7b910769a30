"""Arguments and options of the commands."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from exunet.base.errors import InputError
from exunet.methods.method import Backend

MIN_RUNS, MAX_RUNS = 8, 100_000  # perturbed runs


def as_path(text: str | Path) -> Path:
    """Return a path; the readers of files report what is wrong with it."""
    if text == "":  # which Path takes for the working directory
        raise InputError("the name of a file or folder is empty: give a path ('.' is the working directory)")
    return Path(text)


def _enough(runs: int | None) -> int | None:
    if runs and not MIN_RUNS <= runs <= MAX_RUNS:
        raise typer.BadParameter(f"must be 0, or from {MIN_RUNS} to {MAX_RUNS}, got {runs}")
    return runs


def finite(value: float | None) -> float | None:
    """Raise the error of the option for nan and infinity."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"must be finite, got {value:g}")
    return value


def out_option(default: str) -> Any:
    """Return the option for the folder; default: the folder without it."""
    words = f"folder to write into (default: {default})"
    return typer.Option("--out", help=words, metavar="DIR", parser=as_path)


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


CasePath = Annotated[Path, typer.Argument(help="case file (TOML)", metavar="CASE", parser=as_path)]
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

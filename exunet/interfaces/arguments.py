"""Arguments and options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from exunet.base.errors import InputError

MOST_MOVED = 100_000


def as_path(text: str | Path) -> Path:
    """A path as given; exunet's own readers say what is wrong with a file, in one line."""
    if text == "":  # which Path takes for the working directory
        raise InputError("the name of a file or folder is empty: give a path ('.' is the working directory)")
    return Path(text)


def _enough(moved: int | None) -> int | None:
    from exunet.results.spread import FEWEST

    if moved and not FEWEST <= moved <= MOST_MOVED:
        words = f"must be 0 for none, or from {FEWEST} to {MOST_MOVED} (fewer show no range)"
        raise typer.BadParameter(f"{words}, got {moved}")
    return moved


def at_least(least: float, *, finite: bool = False) -> Callable[[float | None], float | None]:
    """A callback that refuses numbers below `least`, nan, and infinity if it has to be finite."""

    def checked(given: float | None) -> float | None:
        if given is not None and not (given >= least and (math.isfinite(given) or not finite)):
            got = "nan, which is not a number" if math.isnan(given) else f"{given:g}"
            raise typer.BadParameter(f"must be {'finite, ' if finite else ''}{least:g} or more, got {got}")
        return given

    return checked


def out_option(default: str) -> Any:
    """The option of the folder; default: where a command writes without it."""
    words = f"folder to write into (default: {default})"
    return typer.Option("--out", help=words, metavar="DIR", parser=as_path)


def spread_option(default: str) -> Any:
    """The option of the moved starts; default: how many there are without it."""
    words = (
        "number of further runs, from starts moved by up to 1e-9 m (more with solver.accuracy_of = "
        '"measures"), which show how far each number is known'
    )
    return typer.Option(
        "--spread", metavar="N", callback=_enough, help=f"{words}; 0: none (default: {default})"
    )


CasePath = Annotated[Path, typer.Argument(help="case file (TOML)", metavar="CASE", parser=as_path)]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="replace a value of the case, or remove it (KEY=); may be given several times",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="print errors only")]

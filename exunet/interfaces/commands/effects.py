"""`exunet effects`: every known effect with its size, cost and advice; with --ablate also what it changes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.table import Table

from exunet.base.errors import Interrupted
from exunet.case.casefile import Case
from exunet.studies.ablation import ProgressOfRuns, Toggled, ablate
from exunet.system.effect_survey import ASKED, Finding, survey

WIDTH = 150  # of tables that do not go to a terminal


def show_effects(case: Case, *, asked: float | None, measure: bool) -> None:
    """Print the table of estimates, and with `measure` that of the ablation as it grows.

    asked : displacement that matters, as a part of the net's size; None: effects.threshold, or 0.01
    """
    choice = case.scene.effects
    limit = asked if asked is not None else getattr(choice, "threshold", None) or ASKED
    console = _console()
    console.print(f"{case.scene.title}: {case.scene.time.end:g} s, advice for {limit:g} of the net's size")
    console.print(_estimates(survey(case.scene), limit))
    if getattr(choice, "choose", None) == "auto":
        console.print('effects.choose = "auto": on are the tables whose estimate reaches effects.threshold')
    if measure:
        _ablation(case, console)


def _estimates(found: list[Finding], limit: float) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("effect", "", "m/s2", "moves", "of size", "cost", "advice", "how estimated"):
        table.add_column(name, overflow="fold", no_wrap=name in ("effect", "m/s2", "moves", "of size"))
    for one in found:
        if one.estimate is None:
            table.add_row(one.name, "off", "", "", "", "", one.advice(limit), "")
            continue
        assumed = f"{one.assumption}: " if one.assumption else ""
        table.add_row(
            one.name,
            "on" if one.on else "off",
            f"{one.estimate.acceleration:.1e}",
            f"{one.estimate.displacement:.1e} m",
            f"{one.relative:.1e}",
            f"{one.cost:+.0%}",
            one.advice(limit),
            assumed + one.estimate.source,
        )
    return table


def _ablation(case: Case, console: Console) -> None:
    """Runs of the scene with each effect toggled, one line each as it is done."""
    console.print(
        "\nMeasured, with each effect toggled: the displacement while it stands clear of the scene's noise, "
        "the estimate for the same time, what the effect (and noise alone) changes in the measures, wall time"
    )
    runs = len(survey(case.scene)) + 2
    try:
        with _progress(case.scene.time.end, runs) as progress:
            for one in ablate(case.scene, progress=progress):
                console.print(_line(one))
    except Interrupted:
        raise Interrupted("interrupted; the lines that are printed are complete") from None


def _line(one: Toggled) -> str:
    name = f"{one.found.name:17s} {'on ' if one.found.on else 'off'}"
    if one.failure:
        return f"{name} {one.failure}"
    if one.ratio is None:
        size = "not above the noise"
    else:
        size = (
            f"until {one.until:.3g} s: {one.measured:.1e} of the size, estimate {one.estimate:.1e} "
            f"(x {one.ratio:.2g})"
        )
    units = {"largest_area": "m2", "time_of_largest": "s", "distance": "m", "time_open": "s"}
    noise = dict(one.noise)
    changes = ", ".join(
        f"{key.replace('_', ' ')} {value:+.2g} {units[key]} (noise {noise[key]:+.1g})"
        for key, value in one.measures
    )
    cost = f"wall x {one.wall:.2f}, its forces estimated x {1.0 + one.found.cost:.2f}"
    return f"{name} {size}; {changes or 'no mouth'}; {cost}"


def _console() -> Console:
    console = Console(markup=False, emoji=False, highlight=False)
    if console.is_terminal:
        return console
    return Console(markup=False, emoji=False, highlight=False, width=WIDTH)


@contextmanager
def _progress(end: float, runs: int) -> Iterator[ProgressOfRuns | None]:
    """A bar over all runs on stderr; nothing when that is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=end * runs)
        begun: list[str] = []

        def tell(what: str, time: float) -> None:
            if what not in begun:
                begun.append(what)
            bar.update(task, completed=end * (len(begun) - 1) + time, description=what)

        yield tell

"""How far the numbers of a figure are known: words on headlines, which have no number without a spread."""

from __future__ import annotations

from matplotlib.axes import Axes

from exunet.results.ensemble_result import EnsembleResult
from exunet.results.judged import Judged
from exunet.results.spread import judged_in


def known(spread: EnsembleResult | None, key: str, relative_to: float = 1.0) -> Judged | None:
    """A headline as a part of a scale; None without a spread, or if it has not this headline."""
    found = None if spread is None else judged_in(spread, key)
    return found if found is None or relative_to == 1.0 else found.relative_to(relative_to)


def tell_alone(axes: Axes, spread: EnsembleResult | None) -> None:
    """Say in the legend of a figure without bands that moved starts go apart from the run that it shows."""
    judged = () if spread is None else (judged_in(spread, key) for key in spread.headlines)
    if any(one is not None and not one.predictable for one in judged):
        axes.plot([], [], " ", label="one run of a chaotic net")


def words_of_mark(what: str, value: Judged | None, when: Judged | None = None) -> str:
    """The label of a mark at what this run has: a value is told with its error, or its range in brackets."""
    if value is None:
        return f"{what} of this run"
    if not value.predictable:
        return f"{what} of this run ({value.words()})"
    at = f" at {when.words()}" if when is not None and when.predictable else ""
    return f"{what}: {value.words()}{at}"


def words_of_runs(value: Judged) -> str:
    """What moved starts say of a headline."""
    return f"{value.runs} moved starts: {value.words()}"

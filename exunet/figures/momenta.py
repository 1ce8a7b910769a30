"""Momentum books over time: what each part has got, and what was given from outside."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.bands import Panel, bands_behind
from exunet.figures.lines import curve
from exunet.figures.page import Page, finish
from exunet.figures.style import BLACK, MOST_CURVES, SMALL, curve_styles
from exunet.results.curves import momentum_name
from exunet.results.ensemble_result import ALONG, EnsembleResult
from exunet.results.momenta import KINDS, MomentumCourse, direction, gained_by_parts, given_impulses
from exunet.results.result import Result

Floats = NDArray[np.float64]

_KINDS = (
    ("linear", "momentum", "kg m/s"),
    ("angular", "angular momentum about the scene's origin", "kg m²/s"),
)
_LEFT = "parts less impulses"


def momentum(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Linear momentum above, angular momentum about the scene's origin below; None without bodies.

    Of each body and the net the change since the start, and impulses given by effects from outside and by
    bodies of given motion: the parts along one direction of the scene's axes, in which the largest change is.
    The changes less the impulses are errors. Of more than seven curves those that are largest. Behind them
    are their bands of moved starts, or one of all that are shown, where more than four could be seen; the
    direction is then that of the spread.
    """
    if not result.bodies:
        return None
    parts, given = gained_by_parts(result), given_impulses(result)
    every = parts | given
    largest = sorted(every, key=lambda name: -_share(every, name))[: MOST_CURVES - 1]
    shown = [name for name in every if name in largest]
    figure, axes = page.stacked_axes(result, "Momentum of the parts", (1.0, 1.0), 130.0)
    rest = _LEFT if given else "all parts"
    directions = _directions(every, spread)
    styles = dict(zip(shown, curve_styles(len(shown)), strict=True))
    panels: list[Panel] = []
    for (kind, words, unit), one in zip(_KINDS, axes, strict=True):
        changes = {name: getattr(course, kind) for name, course in every.items()}
        along = directions[kind]
        panels.append((one, {momentum_name(kind, name): style["color"] for name, style in styles.items()}))
        for place, (name, style) in enumerate(styles.items()):
            values = changes[name] @ along
            label = name if one is axes[0] else None  # of the legend, which is of both
            curve(one, result.time, values, place / len(shown), label=label, markersize=4.5, **style)
        left = sum((changes[name] for name in parts), np.zeros(3))
        left = left - sum((changes[name] for name in given), np.zeros(3))
        thin: dict[str, Any] = {"color": BLACK, "linewidth": 0.7, "linestyle": ":"}
        curve(one, result.time, left @ along, label=rest if one is axes[0] else None, **thin)
        told = ", ".join(f"{round(part, 2) + 0.0:g}".replace("-", "\N{MINUS SIGN}") for part in along)
        heading = f"{words},\nchange along ({told}) of the scene's axes"
        one.set_title(heading, loc="left", fontsize=SMALL, pad=3)
        one.set_ylabel(f"change [{unit}]")
    if len(every) > len(shown):
        axes[0].plot([], [], " ", label=f"{len(every) - len(shown)} more, which change less")
    axes[-1].set_xlabel("time [s]")
    bands_behind(panels, spread)
    finish(figure, *axes)
    return figure


def _directions(every: dict[str, MomentumCourse], spread: EnsembleResult | None) -> dict[str, Floats]:
    """(3,) of each kind: those of the spread, whose bands are along them, or else of the largest change."""
    told = {} if spread is None else spread.provenance.get(ALONG, {})
    return {
        kind: np.array(told[kind])
        if kind in told
        else direction({name: getattr(course, kind) for name, course in every.items()})
        for kind in KINDS
    }


def _share(every: dict[str, MomentumCourse], name: str) -> float:
    """The largest of its changes, each as a part of the largest of all."""
    shares = []
    for kind, *_ in _KINDS:
        sizes = {
            one: float(np.linalg.norm(getattr(course, kind), axis=1).max()) for one, course in every.items()
        }
        shares.append(sizes[name] / (max(sizes.values()) or 1.0))
    return max(shares)

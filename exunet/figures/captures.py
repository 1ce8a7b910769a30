"""Contacts and a capture over time."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.bands import bands_behind
from exunet.figures.lines import curve, from_zero, spread_band
from exunet.figures.page import Page, finish
from exunet.figures.style import BLACK, BLUE, MOST_CURVES, RED, curve_styles
from exunet.forces.contact.status import OF_BODY
from exunet.results.capture import capture_of, rule_of
from exunet.results.course import CONTACT, TOUCHING
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.result import Result

Floats = NDArray[np.float64]


def contacts(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """How many elements, nodes, bullets, and corners and edges of bodies touch each, and the force across it.

    None without contacts. Of more than eight pairs those with the largest forces. Behind them are their bands
    of moved starts, or one of all that are shown, where more than four could be seen.
    """
    pairs = [
        (body, what)
        for name in result.states
        if name.startswith(CONTACT) and name.endswith(_FORCE)
        for body, _, what in [name.removeprefix(CONTACT).removesuffix(_FORCE).rpartition("/")]
        if what in TOUCHING or what.startswith(OF_BODY)
    ]
    if not pairs:
        return None

    def name_of(pair: tuple[str, str], quantity: str) -> str:
        body, what = pair
        return f"{CONTACT}{body}/{what}_{quantity}"

    def over_time(pair: tuple[str, str], quantity: str) -> Floats:
        return np.asarray(result.states[name_of(pair, quantity)].values[:])[:, 0]

    shown = sorted(pairs, key=lambda pair: -float(over_time(pair, "force").max()))[:MOST_CURVES]
    figure, axes = page.stacked_axes(result, "Contacts", (1.0, 1.0), 125.0)
    styles = dict(zip(shown, curve_styles(len(shown)), strict=True))
    for one, (quantity, label) in zip(axes, _PANELS, strict=True):
        for place, (pair, style) in enumerate(styles.items()):
            named = f"{pair[1].removeprefix(OF_BODY)} on {pair[0]}" if one is axes[0] else None
            values = over_time(pair, quantity)
            curve(one, result.time, values, place / len(shown), label=named, markersize=4.5, **style)
        one.set_ylabel(label)
    if len(pairs) > len(shown):
        axes[0].plot([], [], " ", label=f"{len(pairs) - len(shown)} more, with smaller forces")
    axes[-1].set_xlabel("stored time [s]")
    quantities = [quantity for quantity, _ in _PANELS]
    panels = [{name_of(pair, each): styles[pair]["color"] for pair in shown} for each in quantities]
    tops = bands_behind(list(zip(axes, panels, strict=True)), spread)
    for one, quantity, top in zip(axes, quantities, tops, strict=True):
        from_zero(one, max(top, *(float(over_time(pair, quantity).max()) for pair in shown)))
    finish(figure, *axes)
    return figure


_FORCE = "_force"
_PANELS = (("touching", "number that touch"), ("force", "force across the\nsurface [N]"))


def capture(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """What is enclosed and both indices above, relative speed and mouth below; None without [capture].

    Dotted lines are bounds of the rule.
    """
    rule = rule_of(result)
    if rule is None:
        return None
    found = capture_of(result, rule)
    figure, axes = page.stacked_axes(result, "Capture", (1.0, 1.0), 130.0)
    for one, lines in zip(axes, _LINES, strict=True):
        top = 0.0
        for name, words, color, style in lines:
            values = getattr(found, name)
            curve(one, result.time, values, label=words, color=color, linestyle=style, linewidth=1.4)
            top = max(top, float(values.max()))
            if spread is not None and name in spread.quantiles:
                spread_band(one, spread, spread.band(name), color, None)
                top = max(top, float(spread.band(name)[1].max()))
            if (bound := getattr(rule, name, None)) is not None:
                one.axhline(bound, color=color, linewidth=0.8, linestyle=":", zorder=1)
                top = max(top, bound if math.isfinite(bound) else 0.0)
        from_zero(one, top)
    axes[0].set_ylabel("part, index")
    axes[1].set_ylabel("[m/s], [m]")
    if spread is not None:
        spread_band(axes[0], spread, None, BLACK, f"ranges of {spread.runs} moved starts")
    axes[1].legend(loc="upper right", frameon=False)
    axes[-1].set_xlabel("time [s]")
    finish(figure, *axes)
    return figure


_LINES = (
    (
        ("enclosed", "part of the target enclosed", BLUE, "-"),
        ("cqi", "capture quality index", RED, "--"),
        ("mcqi", "modified index", BLACK, "-."),
    ),
    (
        ("relative_speed", "relative speed of the centres [m/s]", BLUE, "-"),
        ("mouth", "diameter of the mouth [m]", RED, "--"),
    ),
)

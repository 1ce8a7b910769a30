"""Contacts, the closing of the mouth, and the capture over time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from exunet.base.arrays import Floats
from exunet.forces.contact.status import ContactKey
from exunet.plots.style import BLACK, BLUE, MAX_CURVES, RED, YELLOW, FigureData, curve_styles
from exunet.plots.time_axes import curve, draw_bands, finish, from_zero, stacked_axes
from exunet.results.observables import EDGE, LINE

Line = tuple[str | None, str, str]  # label, colour and style

_CONTACT = (("touching", "number of contacts [1]"), ("force", "normal force [N]"))
_CAPTURE = (
    (
        "part, index [1]",
        (
            ("enclosed", "part of the target enclosed", BLUE, "-"),
            ("cqi", "capture quality index", RED, "--"),
            ("mcqi", "modified index", YELLOW, "-."),
        ),
    ),
    ("relative speed of\nthe centres [m/s]", (("relative_speed", None, BLACK, "-"),)),
    ("diameter of\nthe mouth [m]", (("mouth", None, BLACK, "-"),)),
)


def contacts(source: FigureData) -> Figure | None:
    """Number of elements, nodes, bullets, and corners and edges of bodies that touch each body; their forces.

    Of more than eight pairs those with the largest forces.
    """
    result = source.result
    forces = [key for key in result.contacts if key.quantity == "force"]

    def over_time(key: ContactKey, quantity: str) -> Floats:
        return source.run.contact(replace(key, quantity=quantity))

    touching = [key for key in forces if any(np.any(over_time(key, quantity)) for quantity, _ in _CONTACT)]
    if not touching:
        return None
    shown = sorted(touching, key=lambda key: -float(over_time(key, "force").max()))[:MAX_CURVES]
    styles = dict(zip(shown, curve_styles(len(shown)), strict=True))
    figure, panels = stacked_axes(source, [label for _, label in _CONTACT], 115.0)
    for axes, (quantity, _) in zip(panels, _CONTACT, strict=True):
        for place, (key, style) in enumerate(styles.items()):
            label = f"{key.other} on {key.body}" if axes is panels[0] else None
            curve(axes, result.time, over_time(key, quantity), place / len(shown), label=label, **style)
        colors = {str(replace(key, quantity=quantity)): style["color"] for key, style in styles.items()}
        draw_bands(axes, source.ensemble, colors)
        from_zero(axes)
    more = len(touching) - len(shown)
    return finish(source, figure, [f"{more} more, with smaller forces"] if more else [])


def capture(source: FigureData) -> Figure | None:
    """Enclosed part and capture indices, relative speed, diameter of the mouth; bounds of the criterion."""
    rule, measures = source.run.criterion, source.run.capture
    if rule is None or measures is None:
        return None
    figure, panels = stacked_axes(source, [label for label, _ in _CAPTURE], 135.0, (1.4, 1.0, 1.0))
    for axes, (_, lines) in zip(panels, _CAPTURE, strict=True):
        for name, label, color, style in lines:
            values = getattr(measures, name)
            curve(axes, source.result.time, values, label=label, color=color, linestyle=style, linewidth=1.4)
            draw_bands(axes, source.ensemble, {name: color})
            bound = getattr(rule, name, None)
            if bound is not None and math.isfinite(bound):
                label = "bound of the criterion"
                axes.axhline(bound, label=label, color=color, linewidth=0.8, linestyle=":", zorder=1)
        from_zero(axes)
    return finish(source, figure)


def closing(source: FigureData) -> Figure | None:
    """Tension and length of a closing line, or the part left of an edge; below, the diameter of the mouth."""
    run, result, time = source.run, source.result, source.result.time
    panels: list[tuple[str, dict[str, Line]]]
    if EDGE in result.states:
        panels = [("part of the edge's\nlength left [1]", {EDGE: (None, BLUE, "-")})]
    elif f"{LINE}way" in result.states:
        tension: dict[str, Line] = {
            f"{LINE}tension_start": ("tension at the start of the line", BLUE, "-"),
            f"{LINE}tension_end": ("tension at its end", RED, "--"),
        }
        lengths: dict[str, Line] = {
            f"{LINE}way": ("path length through the rings", YELLOW, "-"),
            f"{LINE}wound_up": ("length wound up", BLACK, "--"),
        }
        panels = [("tension of\nthe line [N]", tension), ("length [m]", lengths)]
    else:
        return None
    values = {name: run.state(name)[:, 0] for _, curves in panels for name in curves}
    if not any(np.ptp(series) for series in values.values()):
        return None
    if len(result.net.mouth) > 1 and run.mouth is not None:
        panels.append(("diameter of\nthe mouth [m]", {"mouth": (None, BLACK, "-")}))
        values["mouth"] = run.mouth
    start, end = values.get(f"{LINE}tension_start"), values.get(f"{LINE}tension_end")
    if start is not None and end is not None and np.array_equal(start, end):  # without friction
        panels[0] = (panels[0][0], {f"{LINE}tension_start": ("tension of the line", BLUE, "-")})
    figure, axes = stacked_axes(source, [label for label, _ in panels], 50.0 + 35.0 * len(panels))
    for panel, (_, curves) in zip(axes, panels, strict=True):
        for place, (name, (label, color, style)) in enumerate(curves.items()):
            curve(panel, time, values[name], 0.5 * place, label=label, color=color, linestyle=style)
        draw_bands(panel, source.ensemble, {name: color for name, (_, color, _) in curves.items()})
        from_zero(panel)
    return finish(source, figure)

"""The work-precision diagram: error against wall time and against right-hand sides, Pareto front marked.

At most eight curves are drawn in full, those that come nearest to the front; the rest is pale. The form of
the net (or the code) shows in marker and line, the method in the colour.
"""

from __future__ import annotations

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exunet.figures.page import INCH, legend_above
from exunet.figures.style import MOST_CURVES, blank, curve_styles
from exunet.methods.method import Form
from exunet.studies.cost.ranking import Effort, evaluations, pareto, wall_time
from exunet.studies.cost.runners import StudyEntry
from exunet.studies.cost.study import Study

# Marker and line of each form; of the reference: None.
_FORMS: dict[Form | None, dict[str, Any]] = {
    Form.CONNECTORS: {"marker": "o", "linestyle": "-"},
    Form.FUSED: {"marker": "s", "linestyle": "--"},
    Form.COMPILED: {"marker": "^", "linestyle": "-."},
    None: {"marker": "x", "linestyle": ":"},
}
_PALE: dict[str, Any] = {"color": "0.82", "linewidth": 0.6, "marker": ".", "markersize": 2.5, "zorder": 1}
_LEAST = 1e-13  # errors below this are drawn here
WIDTH, HEIGHT = 170.0, 100.0  # mm


def work_precision(study: Study) -> Figure:
    """Two panels that share the error axis; failed settings are not drawn, the table has them."""
    figure = blank(WIDTH / INCH, HEIGHT / INCH)
    figure.set_layout_engine("constrained")
    if study.interrupted:
        figure.suptitle("INCOMPLETE: interrupted")
    left, right = figure.subplots(1, 2, sharey=True)
    shown = _styles(study)
    _panel(left, study, shown, "wall time of the stepping, median [s]", wall_time)
    _panel(right, study, shown, "evaluations of the forces", evaluations)
    predicts = study.converged.predicts
    left.set_ylabel("speed error / launch speed" if predicts else "error of the energy balance")
    resolved = study.converged.uncertainty
    if predicts and resolved > _LEAST:
        for axes in (left, right):
            axes.axhspan(_LEAST, resolved, color="0.93", zorder=0, label="not resolved")
    drawn = [_drawn(study, entry) for entry in study.measured] or [_LEAST]
    left.set_ylim(min(drawn) / 5, 5.0 * max(drawn))
    if min(drawn) == _LEAST:
        for axes in (left, right):
            axes.axhline(
                _LEAST, color="0.5", linewidth=0.6, linestyle=":", zorder=1, label="$10^{-13}$ or less"
            )
    legend_above(figure, *left.get_legend_handles_labels())
    return figure


def _styles(study: Study) -> dict[str, dict[str, Any]]:
    """By name of the setting: how the at most eight are drawn that come nearest to the front in wall time."""
    nearest = sorted({entry.setting.name for entry in study.measured}, key=lambda name: _behind(study, name))
    forms = list(_FORMS)
    settings = {entry.setting.name: entry.setting for entry in study.measured}
    chosen = sorted(
        (settings[name] for name in nearest[:MOST_CURVES]), key=lambda s: (s.method, forms.index(s.form))
    )
    methods = list(dict.fromkeys(setting.method for setting in chosen))
    colors = dict(zip(methods, curve_styles(len(methods)), strict=True))
    return {
        setting.name: {
            "color": colors[setting.method]["color"],
            "linewidth": 1.3,
            "markersize": 4.0,
            "zorder": 3,
            **_FORMS[setting.form],
        }
        for setting in chosen
    }


def _behind(study: Study, name: str) -> tuple[float, str]:
    """How far the settings of a name stay behind the front: the least ratio of wall times at equal error.

    What is not ranked comes after all others; equals come by name.
    """
    front = pareto(study)
    ratios = [
        entry.median / min(one.median for one in front if study.error(one) <= study.error(entry))
        for entry in study.ranked
        if entry.setting.name == name
    ]
    return min(ratios, default=math.inf), name


def _drawn(study: Study, entry: StudyEntry) -> float:
    return max(study.error(entry), _LEAST)


def _panel(axes: Axes, study: Study, shown: dict[str, dict[str, Any]], label: str, effort: Effort) -> None:
    def draw(entries: list[StudyEntry], **style: Any) -> None:
        axes.loglog(
            [effort(entry) for entry in entries], [_drawn(study, entry) for entry in entries], **style
        )

    front = {"color": "0.7", "linewidth": 5, "zorder": 2, "marker": "o", "markersize": 7}
    draw(pareto(study, effort), label="Pareto front", **front)
    names = [*shown, *sorted({entry.setting.name for entry in study.measured} - set(shown))]
    for k, name in enumerate(names):
        ladder = [entry for entry in study.measured if entry.setting.name == name]
        ladder.sort(key=lambda entry: -entry.setting.size)
        if name in shown:
            note = "" if ladder[0] in study.ranked else ": not ranked"
            draw(ladder, label=name + note, **shown[name])
        else:
            left_over = "1 other" if len(names) == k + 1 else f"{len(names) - k} others"
            draw(ladder, label=left_over if k == len(shown) else None, **_PALE)
    axes.set_xlabel(label)
    axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)

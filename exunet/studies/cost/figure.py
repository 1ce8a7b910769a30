"""The work-precision diagram: error against wall time and against right-hand sides, Pareto front marked."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exunet.figures.style import BLACK, BLUE, GREY, RED, YELLOW, blank
from exunet.methods.method import Form, Method
from exunet.studies.cost.ranking import Effort, evaluations, pareto, wall_time
from exunet.studies.cost.runners import Entry
from exunet.studies.cost.settings import ReferenceMethod
from exunet.studies.cost.study import Study

_COLOURS = {Form.CONNECTORS: BLUE, Form.FUSED: RED, Form.COMPILED: BLACK, None: YELLOW}
# One marker for a kind of method, the same in all codes.
_MARKERS: dict[str, str] = dict(zip(Method, "ov12<s>^x+", strict=True))
_MARKERS |= zip(ReferenceMethod, "oDs^*", strict=True)
_LEAST = 1e-13  # errors below this are drawn here


def work_precision(study: Study, title: str) -> Figure:
    """Two panels that share the error axis; failed settings are not drawn, the table has them."""
    figure = blank(10.5, 5.4)
    left, right = figure.subplots(1, 2, sharey=True)
    _panel(left, study, "wall time of the stepping, median [s]", wall_time)
    _panel(right, study, "evaluations of the forces", evaluations)
    predicts = study.converged.predicts
    left.set_ylabel("speed error / launch speed" if predicts else "error of the energy balance")
    if predicts:
        resolved = max(study.converged.uncertainty, _LEAST)
        for axes in (left, right):
            axes.axhspan(_LEAST, resolved, color="0.92", zorder=-1, label="not resolved")
    least = min((_drawn(study, entry) for entry in study.measured), default=_LEAST)
    left.set_ylim(_LEAST / 3 if least < 1e-11 else least / 5, 3.0)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="center left", bbox_to_anchor=(0.76, 0.5), frameon=False, fontsize=7)
    note = "" if predicts else " (after the horizon: speeds cannot be predicted)"
    stopped = "\nINCOMPLETE: interrupted" if study.interrupted else ""
    figure.suptitle(title + note + stopped, fontsize=10, parse_math=False)
    figure.subplots_adjust(left=0.075, right=0.75, bottom=0.1, top=0.9, wspace=0.06)
    return figure


def _drawn(study: Study, entry: Entry) -> float:
    return max(study.error(entry), _LEAST)


def _panel(axes: Axes, study: Study, label: str, effort: Effort) -> None:
    def draw(entries: list[Entry], **style: Any) -> None:
        axes.loglog(
            [effort(entry) for entry in entries], [_drawn(study, entry) for entry in entries], **style
        )

    settings = {entry.setting.name: entry.setting for entry in study.measured}.values()
    for setting in sorted(settings, key=lambda one: (list(_COLOURS).index(one.form), one.name)):
        ladder = [entry for entry in study.measured if entry.setting.name == setting.name]
        ladder.sort(key=lambda entry: -entry.setting.size)
        ranked = ladder[0] in study.ranked
        draw(
            ladder, color=_COLOURS[setting.form], marker=_MARKERS[setting.method], markersize=4.5,
            linewidth=0.9, linestyle="-" if ranked else ":",
            label=setting.name if ranked else f"{setting.name}: not ranked",
        )  # fmt: skip
    front = {"color": GREY, "linewidth": 6, "zorder": 0, "solid_joinstyle": "round"}
    draw(pareto(study, effort), label="Pareto front", **front)
    axes.set_xlabel(label)
    axes.grid(visible=True, which="major", color="0.9", linewidth=0.6)

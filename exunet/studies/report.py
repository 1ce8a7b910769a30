"""Figures and page of a study."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.arrays import Ints
from exunet.base.files import replacing
from exunet.plots.studies import StudyData
from exunet.results.outcome import Outcome
from exunet.studies import estimates
from exunet.studies.inputs import as_toml
from exunet.studies.study import StudyTable

REPORT, FIGURES = "report.html", "figures"
CAPTURED = Outcome.CAPTURED.value
_RESPONSES = 4  # whose drivers are estimated
_STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #111; }
pre { font-size: 12px; white-space: pre-wrap; border-left: 3px solid #ccc; padding-left: 0.8em; }
td { padding: 0 1em 0 0; vertical-align: top; font-size: 13px; } img { width: 100%; }
figure { margin: 1em 0; break-inside: avoid; } h2 { break-after: avoid; }
"""


def short(value: Any) -> str:
    """Return the value of an input for tables."""
    return f"{value:.4g}" if isinstance(value, float) else as_toml(value)


def labels_of(keys: Sequence[str]) -> dict[str, str]:
    """Return keys by their last parts, or by themselves where these are not unique."""
    labels = {key.rpartition(".")[2]: key for key in keys}
    return labels if len(labels) == len(keys) else {key: key for key in keys}


@lru_cache(maxsize=4)
def drivers_of(table: StudyTable) -> dict[str, list[estimates.Driver]]:
    """Return first-order effects on the capture and on metrics that are printed; by response."""
    rows, found = _independent(table), dict[str, list[estimates.Driver]]()
    columns = {label: table.column(key)[rows] for label, key in labels_of(table.inputs).items()}
    for name in (CAPTURED, *table.config.outputs.named) if table.config.design != "grid" else ():
        effects = estimates.drivers(columns, table.responses(name)[rows], table.config.seed)
        found |= {name: effects} if effects and len(found) < _RESPONSES else {}
    return found


def _independent(table: StudyTable) -> Ints:
    names: list[str | None] = [item.name for item in table.config.designs] or [None]
    return np.flatnonzero(np.any([table.of_design(name) for name in names], axis=0))


def study_data(table: StudyTable) -> StudyData:
    """Return what the figures of a study show, for `exunet.figure` and `exunet.save_figures`."""
    config, rows, strongest = table.config, _independent(table), drivers_of(table)
    order = [item.name for item in next(iter(strongest.values()), [])]
    labels = labels_of(table.inputs)
    inputs = {name: table.column(labels[name])[rows] for name in (*order, *(labels.keys() - set(order)))}
    names = [name for name in config.outputs.named if name in table.metrics]
    design = table.column("design")[rows] if config.designs else np.full(len(rows), "", object)
    groups, about = design, "median, 5\N{NO-BREAK SPACE}% to 95\N{NO-BREAK SPACE}%"
    if config.design == "grid":
        values = [[short(item) for item in table.column(key)[rows].tolist()] for key in labels.values()]
        groups = np.array(
            [", ".join(filter(None, parts)) for parts in zip(*values, design, strict=True)], object
        )
        about = "median and range"
    found: dict[tuple[str, str], dict[str, tuple[float, float, float]]] = {}
    captured, undetermined = table.responses(CAPTURED)[rows], table.undetermined[rows]
    for group in dict.fromkeys(groups.tolist()):
        mine = groups == group
        if np.nansum(captured):
            hits, lost = int(np.nansum(captured[mine])), int((undetermined & np.isnan(captured))[mine].sum())
            one = estimates.probability(hits, int(mine.sum()), lost)
            found.setdefault(("probability of capture, 95\N{NO-BREAK SPACE}%", ""), {})[group] = (
                one.value,
                one.low,
                one.high,
            )
        for name in names:
            known = table.responses(name)[rows][mine]
            known, (words, unit) = known[~np.isnan(known)], table.about[name]
            if len(known):
                levels = (0.5, 0.0, 1.0) if config.design == "grid" else (0.5, 0.05, 0.95)
                middle, low, high = np.quantile(known, levels).tolist()
                found.setdefault((f"{words}, {about}", unit), {})[group] = (middle, low, high)
    return StudyData(
        inputs, table.outcome[rows],
        {table.about[name]: table.column(name)[rows] for name in names}, design,
        {table.about[name]: limit for name, limit in config.outputs.limits.items() if name in names},
        {table.about[name][0] if name in names else name:
         {item.name: (item.index, item.level, item.sign) for item in effects}
         for name, effects in strongest.items()},
        found,
    )  # fmt: skip


def write_report(table: StudyTable, answer: Sequence[str], figures: Sequence[Path], path: Path) -> None:
    """Write a page that contains the answer, the figures (PNG), the study's text and its provenance."""
    with replacing(path) as part:
        part.write_text("\n".join(_page(table, answer, figures)) + "\n", encoding="utf-8")


def _page(table: StudyTable, answer: Sequence[str], figures: Sequence[Path]) -> Iterator[str]:
    title, stored = escape(table.study.title), table.files.about("study")
    yield f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{title}</title>"
    yield f"<style>{_STYLE}</style></head><body><h1>{title}</h1>"
    yield f"<pre>{escape(chr(10).join(answer))}</pre>"
    for figure in figures:
        data = base64.b64encode(figure.read_bytes()).decode("ascii")
        yield f"<figure><img src='data:image/png;base64,{data}' alt='{escape(figure.stem)}'></figure>"
    text = stored["text"] or json.dumps(stored["config"], indent=2, ensure_ascii=False)
    yield f"<h2>Study</h2><pre>{escape(text)}</pre><h2>Provenance</h2><table>"
    identity, paths = table.files.about("identity"), table.files.about("cases")
    rows = [(f"case {path}", identity[f"case {k}"]) for k, (_, path) in enumerate(paths)]
    rows += [(key, value) for key, value in identity.items() if ".file " in key]
    for name, value in (*rows, *identity["versions"].items()):
        yield f"<tr><td>{escape(name)}</td><td>{escape(str(value))}</td></tr>"
    yield "</table></body></html>"

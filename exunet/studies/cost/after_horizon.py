"""After the horizon no speed can be predicted: the measures of deployment and how far they are spread."""

from __future__ import annotations

from collections.abc import Iterator

from exunet.studies.cost.measure import FOUR, four
from exunet.studies.cost.study import Entry, Study
from exunet.studies.cost.table import pareto

_ROUND_OFF = 1e-9  # in the units of the measures


def spread(study: Study) -> list[tuple[float, float]]:
    """Least and largest of each measure among the converged solutions; empty without a mouth."""
    found = [four(one) for one in study.converged.deployments]
    return [(min(column), max(column)) for column in zip(*found, strict=True)]


def measure_rows(study: Study) -> list[tuple[str, str]]:
    """Rows (name, value): the spread of each measure; the measures of what is on the front or not ranked."""
    bounds = spread(study)
    if not bounds:
        return []
    number = len(study.converged.deployments)
    rows = [
        (name, f"{_shown(low)} to {_shown(high)} {unit}, of {number} converged solutions")
        for (name, unit), (low, high) in zip(FOUR, bounds, strict=True)
    ]
    # That one of n + 1 equal draws is the least or the largest.
    often = f"{2 / (number + 1):.0%}"
    rows.append(("(outside)", f"not between these, as each measure of a further good run is in some {often}"))
    front = pareto(study)
    unranked = [entry for entry in study.measured if entry not in study.ranked]
    rows += [("on the front", _words(entry, bounds)) for entry in front]
    rows += [("not ranked", f"{_words(entry, bounds)}; conserves energy at any step") for entry in unranked]
    return rows


def _words(entry: Entry, bounds: list[tuple[float, float]]) -> str:
    assert entry.measures is not None
    head = f"{entry.setting.name}, {entry.setting.value}: "
    if entry.measures.deployment is None:
        return head + "no measures"
    return head + ", ".join(_against(four(entry.measures.deployment), bounds))


def _against(found: tuple[float, ...], bounds: list[tuple[float, float]]) -> Iterator[str]:
    for (name, unit), value, (low, high) in zip(FOUR, found, bounds, strict=True):
        inside = low - _ROUND_OFF <= value <= high + _ROUND_OFF
        yield f"{name} {_shown(value)} {unit}" + ("" if inside else " (outside)")


def _shown(value: float) -> str:
    return f"{value if abs(value) > _ROUND_OFF else 0.0:.4g}"

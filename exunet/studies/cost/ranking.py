"""The study as rows: Pareto front, cheapest setting for each error, measures of deployment, CSV."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path

from exunet.base.files import replacing
from exunet.studies.cost.runners import FOUR, StudyEntry, four
from exunet.studies.cost.study import Study

_ROUND_OFF = 1e-9  # in the units of the measures of deployment
LEVELS = tuple(10.0**-k for k in range(2, 9))
_RESOLVED = 3.0  # an error must be this many times the converged solution's own uncertainty to be listed

Effort = Callable[[StudyEntry], float]


wall_time: Effort = attrgetter("median")  # of the stepping [s]


def evaluations(entry: StudyEntry) -> float:
    """Evaluations of the forces."""
    assert entry.work is not None
    return float(max(entry.work.right_hand_sides, 1))


def pareto(study: Study, effort: Effort = wall_time) -> list[StudyEntry]:
    """The entries that no other one beats in both effort and error, cheapest first."""
    front: list[StudyEntry] = []
    best = float("inf")
    for entry in sorted(study.ranked, key=lambda one: (effort(one), study.error(one))):
        if study.error(entry) < best:
            front.append(entry)
            best = study.error(entry)
    return front


def reliable(study: Study, entry: StudyEntry, level: float) -> bool:
    """True if this entry and every tighter one of its ladder stay within `level`: no lucky crossing.

    A tighter one that failed did not.
    """
    floor = _RESOLVED * study.converged.uncertainty if study.converged.predicts else 0.0
    ladder = [entry, *_tighter(study, entry)]
    return all(not other.failed and study.error(other) <= max(level, floor) for other in ladder)


def _tighter(study: Study, entry: StudyEntry) -> list[StudyEntry]:
    """Those that were run."""
    return [
        other
        for other in study.entries
        if other.setting.name == entry.setting.name
        and other.setting.size < entry.setting.size
        and (other.failed or other.measures is not None)
    ]


def cheapest(study: Study, level: float) -> StudyEntry | None:
    """The fastest entry that a case can ask for, with its error and those of tighter ones within `level`."""
    able = [
        one
        for one in study.ranked
        if one.setting.in_a_case and study.error(one) <= level and reliable(study, one, level)
    ]
    return min(able, key=wall_time, default=None)


def failed_rows(study: Study) -> list[tuple[str, str]]:
    """A row (name, value) for all settings that failed: how many of each method."""
    counts = Counter(entry.setting.name for entry in study.entries if entry.failed)
    if not counts:
        return []
    names = ", ".join(f"{name} {number}" for name, number in counts.items())
    words = f"{counts.total()} of {len(study.entries)} settings: {names}; reasons in cost.md"
    return [("failed", words)]


def answer_rows(study: Study) -> list[tuple[str, str]]:
    """Rows (error level, cheapest method with setting and time)."""
    rows = []
    for level in LEVELS:
        if _unresolved(study, level):
            words = f"not resolved: the converged solutions differ by {study.converged.uncertainty:.1e}"
        elif (entry := cheapest(study, level)) is None:
            words = "no setting that was run"
        else:
            noise = "" if entry.noise is None else f" ± {entry.noise:.0%}"
            words = f"{entry.setting}: {entry.median:.3g} s{noise}, error {_told(study, entry)}"
            if all(other.measures is None for other in _tighter(study, entry)):
                words += "; unconfirmed: no tighter setting ran"
        rows.append((f"error <= {level:.0e}", words))
    return rows


def runnable_rows(study: Study, speed: float) -> list[tuple[str, str]]:
    """`answer_rows`, and after the last one of a setting the options that run it.

    speed : [m/s], of which tolerances are parts
    """
    best = [None if _unresolved(study, level) else cheapest(study, level) for level in LEVELS]
    rows = []
    for row, entry, after in zip(answer_rows(study), best, [*best[1:], None], strict=True):
        rows.append(row)
        if entry is not None and entry is not after:
            solver, engine = entry.setting.overrides(speed)
            rows += [("  to run it", f"--set '{solver}'"), ("", f"--set '{engine}'")]
    return rows


def _unresolved(study: Study, level: float) -> bool:
    return study.converged.predicts and level < study.converged.uncertainty


def _told(study: Study, entry: StudyEntry) -> str:
    if study.converged.predicts and entry.speed_error <= study.converged.uncertainty:
        return f"at most the {study.converged.uncertainty:.1e} by which the converged solutions differ"
    return f"{study.error(entry):.1e}"


def write_csv(study: Study, path: Path) -> None:
    """All entries, one row each; empty cells where nothing was measured."""
    front = pareto(study)
    rows = [_cells(study, entry) | {"pareto": "yes" if entry in front else ""} for entry in study.entries]
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)


def _cells(study: Study, entry: StudyEntry) -> dict[str, object]:
    setting, found, work = entry.setting, entry.measures, entry.work
    opening = four(found.deployment) if found and found.deployment else ("",) * 4
    names = "largest_area", "time_of_largest_s", "distance_m", "time_above_80_s"
    return {
        "code": setting.code,
        "method": setting.method,
        "tolerance": setting.tolerance or "",
        "step_s": _digits(setting.step, "6g"),
        "speed_error": f"{study.error(entry):.3e}" if found and study.converged.predicts else "",
        "energy_error": _digits(found.energy if found else None, "3e"),
        "momentum_error": _digits(found.momentum if found else None, "3e"),
        **dict(zip(names, opening, strict=True)),
        "seconds": _digits(entry.median if entry.seconds else None, "6g"),
        "noise": _digits(entry.noise, "3f"),
        "repeats": len(entry.seconds),
        "steps": work.steps if work else "",
        "rejected_steps": work.rejected if work else "",
        "right_hand_sides": work.right_hand_sides if work else "",
        "newton_iterations": work.newton_iterations if work else "",
        "outcome": entry.reason or "ran",
    }


def _digits(value: float | None, digits: str) -> str:
    return "" if value is None else f"{value:.{digits}}"


def measure_rows(study: Study) -> list[tuple[str, str]]:
    """Rows (name, value): the spread of each measure; the measures of what is on the front or not ranked.

    None without a mouth.
    """
    known = [four(one) for one in study.converged.deployments]
    if not known:
        return []
    bounds = [(min(column), max(column)) for column in zip(*known, strict=True)]
    rows = [
        (name, f"{_shown(low)} to {_shown(high)} {unit}, of {len(known)} converged solutions")
        for (name, unit), (low, high) in zip(FOUR.items(), bounds, strict=True)
    ]
    # That one of n + 1 equal draws is the least or the largest.
    often = f"{2 / (len(known) + 1):.0%}"
    rows.append(("(outside)", f"not between these, as each measure of a further good run is in some {often}"))
    unranked = [entry for entry in study.measured if entry not in study.ranked]
    rows += [("on the front", _opening(entry, bounds)) for entry in pareto(study)]
    rows += [("not ranked", f"{_opening(entry, bounds)}; conserves energy at any step") for entry in unranked]
    return rows


def _opening(entry: StudyEntry, bounds: list[tuple[float, float]]) -> str:
    """Its measures of deployment in words; those outside the bounds are marked."""
    assert entry.measures is not None
    assert entry.measures.deployment is not None  # as the converged solutions of the same net have them
    words = []
    for name, value, (low, high) in zip(FOUR, four(entry.measures.deployment), bounds, strict=True):
        outside = "" if low - _ROUND_OFF <= value <= high + _ROUND_OFF else " (outside)"
        words.append(f"{name} {_shown(value)} {FOUR[name]}{outside}")
    return f"{entry.setting}: {', '.join(words)}"


def _shown(value: float) -> str:
    return f"{value if abs(value) > _ROUND_OFF else 0.0:.4g}"

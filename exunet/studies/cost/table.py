"""The study as rows: Pareto front, cheapest setting for each error, CSV."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

from exunet.base.files import replacing
from exunet.studies.cost.measure import four
from exunet.studies.cost.study import Entry, Study

LEVELS = tuple(10.0**-k for k in range(2, 9))
_RESOLVED = 3.0  # an error must be this many times the converged solution's own uncertainty to be told

Effort = Callable[[Entry], float]


def wall_time(entry: Entry) -> float:
    """Median wall time of the stepping [s]."""
    return entry.median


def evaluations(entry: Entry) -> float:
    """Evaluations of the forces."""
    assert entry.work is not None
    return float(max(entry.work.right_hand_sides, 1))


def pareto(study: Study, effort: Effort = wall_time) -> list[Entry]:
    """The entries that no other one beats in both effort and error, cheapest first."""
    front: list[Entry] = []
    best = float("inf")
    for entry in sorted(study.ranked, key=lambda one: (effort(one), study.error(one))):
        if study.error(entry) < best:
            front.append(entry)
            best = study.error(entry)
    return front


def reliable(study: Study, entry: Entry, level: float) -> bool:
    """True if this entry and every tighter one of its ladder stay within `level`: no lucky crossing.

    A tighter one that failed did not.
    """
    floor = _RESOLVED * study.converged.uncertainty if study.converged.predicts else 0.0
    return all(
        not other.failed and study.error(other) <= max(level, floor)
        for other in [entry, *_tighter(study, entry)]
    )


def confirmed(study: Study, entry: Entry) -> bool:
    """True if a tighter setting of the same ladder was measured too."""
    return any(other.measures is not None for other in _tighter(study, entry))


def _tighter(study: Study, entry: Entry) -> list[Entry]:
    """Those that were run."""
    return [
        other
        for other in study.entries
        if other.setting.name == entry.setting.name
        and other.setting.size < entry.setting.size
        and (other.failed or other.measures is not None)
    ]


def cheapest(study: Study, level: float) -> Entry | None:
    """The fastest entry whose error is within `level`, and is so at all tighter settings of its method."""
    able = [one for one in study.ranked if study.error(one) <= level and reliable(study, one, level)]
    return min(able, key=wall_time, default=None)


def answer_rows(study: Study) -> list[tuple[str, str]]:
    """Rows (error level, cheapest method with setting and time)."""
    rows = []
    for level in LEVELS:
        if study.converged.predicts and level < study.converged.uncertainty:
            words = f"cannot be told: the converged solutions differ by {study.converged.uncertainty:.1e}"
        elif (entry := cheapest(study, level)) is None:
            words = "no setting that was run"
        else:
            words = f"{entry.setting.name}, {entry.setting.value}: {seconds(entry)}"
            words += f", error {_told(study, entry)}"
            words += "" if confirmed(study, entry) else "; unconfirmed: no tighter setting ran"
        rows.append((f"error <= {level:.0e}", words))
    return rows


def _told(study: Study, entry: Entry) -> str:
    if study.converged.predicts and entry.speed_error <= study.converged.uncertainty:
        return f"at most the {study.converged.uncertainty:.1e} by which the converged solutions differ"
    return f"{study.error(entry):.1e}"


def seconds(entry: Entry) -> str:
    """Median wall time with its noise."""
    digits = f"{entry.median:.3g} s"
    return digits if entry.noise is None else f"{digits} ± {entry.noise:.0%}"


COLUMNS = (
    "code", "method", "tolerance", "step_s", "speed_error", "energy_error", "momentum_error",
    "largest_area", "time_of_largest_s", "distance_m", "time_above_80_s",
    "seconds", "noise", "repeats", "steps", "rejected_steps", "right_hand_sides", "newton_iterations",
    "pareto", "outcome",
)  # fmt: skip


def write_csv(study: Study, path: Path) -> None:
    """All entries, one row each; empty cells where nothing was measured."""
    front = pareto(study)
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(_cells(study, entry, entry in front) for entry in study.entries)


def _cells(study: Study, entry: Entry, on_front: bool) -> Sequence[object]:
    setting, found, work = entry.setting, entry.measures, entry.work
    measures: Sequence[object] = ("",) * 7
    if found is not None:
        speed = f"{study.error(entry):.3e}" if study.converged.predicts else ""
        momentum = "" if found.momentum is None else f"{found.momentum:.3e}"
        opening = [f"{value:.8g}" for value in four(found.deployment)] if found.deployment else [""] * 4
        measures = (speed, f"{found.energy:.3e}", momentum, *opening)
    noise = "" if entry.noise is None else f"{entry.noise:.3f}"
    return (
        setting.code,
        setting.method,
        "" if setting.tolerance is None else f"{setting.tolerance:g}",
        "" if setting.step is None else f"{setting.step:.6g}",
        *measures,
        *((f"{entry.median:.6g}", noise, len(entry.seconds)) if entry.seconds else ("", "", 0)),
        *((work.steps, work.rejected, work.right_hand_sides, work.newton) if work else [""] * 4),
        "yes" if on_front else "",
        entry.reason or "ran",
    )

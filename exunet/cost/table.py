"""The study as rows: Pareto front, cheapest setting for each error, CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from exunet.cost.study import Entry, Study
from exunet.files import replacing

LEVELS = tuple(10.0**-k for k in range(2, 9))
_RESOLVED = 3.0  # an error must be this many times the converged solution's own uncertainty to be told


def pareto(study: Study) -> list[Entry]:
    """The entries that no other one beats in both time and error, cheapest first."""
    front: list[Entry] = []
    best = float("inf")
    for entry in sorted(study.measured, key=lambda one: (one.median, study.error(one))):
        if study.error(entry) < best:
            front.append(entry)
            best = study.error(entry)
    return front


def reliable(study: Study, entry: Entry, level: float) -> bool:
    """True if this entry and every tighter one of its ladder stay within `level`: no lucky crossing."""
    ladder = [other for other in study.measured if other.setting.name == entry.setting.name]
    tighter = [other for other in ladder if _knob(other) <= _knob(entry)]
    floor = _RESOLVED * study.converged.uncertainty if study.converged.predicts else 0.0
    return all(study.error(other) <= max(level, floor) for other in tighter)


def _knob(entry: Entry) -> float:
    return float(entry.setting.tolerance or entry.setting.step or 0.0)


def cheapest(study: Study, level: float) -> Entry | None:
    """The fastest entry whose error is within `level`, and is so at all tighter settings of its method."""
    able = [
        entry for entry in study.measured if study.error(entry) <= level and reliable(study, entry, level)
    ]
    return min(able, key=lambda entry: entry.median, default=None)


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
            words += f", error {study.error(entry):.1e}"
        rows.append((f"error <= {level:.0e}", words))
    return rows


def seconds(entry: Entry) -> str:
    """Median wall time with its noise."""
    digits = f"{entry.median:.3g} s"
    return digits if entry.noise is None else f"{digits} ± {entry.noise:.0%}"


COLUMNS = (
    "code", "method", "tolerance", "step_s", "speed_error", "energy_error", "momentum_error", "largest_area",
    "seconds", "noise", "repeats", "steps", "rejected_steps", "right_hand_sides", "newton_iterations",
    "pareto", "outcome",
)  # fmt: skip


def write_csv(study: Study, path: Path) -> None:
    """All entries, one row each; empty cells where nothing was measured."""
    front = pareto(study)
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(_cells(entry, entry in front) for entry in study.entries)


def _cells(entry: Entry, on_front: bool) -> Sequence[object]:
    setting, errors, counts = entry.setting, entry.errors, entry.counts
    found: Sequence[object] = ("", "", "", "")
    if errors is not None:
        momentum = "" if errors.momentum is None else f"{errors.momentum:.3e}"
        area = "" if errors.area is None else f"{errors.area:.8f}"
        found = (f"{errors.speed:.3e}", f"{errors.energy:.3e}", momentum, area)
    work: Sequence[object] = ("", "", "", "")
    if counts is not None:
        work = (counts.steps, counts.rejected, counts.right_hand_sides, counts.newton)
    timing: Sequence[object] = ("", "", 0)
    if entry.seconds:
        noise = "" if entry.noise is None else f"{entry.noise:.3f}"
        timing = (f"{entry.median:.6g}", noise, len(entry.seconds))
    return (
        setting.code,
        setting.method,
        "" if setting.tolerance is None else f"{setting.tolerance:g}",
        "" if setting.step is None else f"{setting.step:.6g}",
        *found,
        *timing,
        *work,
        "yes" if on_front else "",
        entry.reason or "ran",
    )

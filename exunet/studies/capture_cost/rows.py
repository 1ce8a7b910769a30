"""The study of a capture as rows: a table in Markdown, the same in words, CSV, and what is recommended."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

from exunet.base.files import replacing
from exunet.base.markdown import markdown_table
from exunet.results.digits import printed
from exunet.results.headline import Headline
from exunet.results.spread import FEWEST
from exunet.studies.capture_cost.judging import Bias, quantities_of
from exunet.studies.capture_cost.study import CaptureRow, CaptureStudy, Judgement

_NONE = "—"
LEGEND = (
    "median of the moved starts, and in brackets its bias against the finest. *: told apart from it by more "
    "than chance, else not told apart; !: a third of the range of the finest runs or more, so that it "
    "matters if it is told apart, and leaves the setting open if not. A form of Exudyn's has one run, of the "
    "start as it is; seconds and right-hand sides are of one"
)


def quantities(study: CaptureStudy) -> tuple[Headline, ...]:
    """Those that a run of the study has."""
    known = {
        one.name: one
        for row in study.rows
        if row.courses
        for one in quantities_of(row.courses[0])
        if any(one.name == bias.quantity.name for bias in study.biases(row))
    }
    return tuple(known.values())


def table(study: CaptureStudy) -> list[str]:
    """Lines of Markdown: settings in rows, what they take and what they find in columns."""
    shown = quantities(study)
    head = ["setting", "value", "seconds", "right-hand sides"]
    head += [f"{one.words} [{one.unit}]" if one.unit else one.words for one in shown]
    return markdown_table([*head, "verdict", ""], (_cells(study, row, shown) for row in study.rows))


def _cells(study: CaptureStudy, row: CaptureRow, shown: Iterable[Headline]) -> list[str]:
    found = {one.quantity.name: one for one in study.biases(row)}
    ran = not math.isnan(row.seconds)
    cells = [row.setting.name, value_of(row), f"{row.seconds:.3g}" if ran else _NONE]
    cells.append(str(row.right_hand_sides) if ran else _NONE)
    cells += [_cell(found[one.name]) if one.name in found else _NONE for one in shown]
    verdicts = study.verdicts(row)
    told = _NONE if verdicts is None else verdicts.words + ("" if verdicts.same else " !")
    return [*cells, told, remark(study, row)]


def value_of(row: CaptureRow) -> str:
    """Its step or tolerance."""
    unit = " s" if "step=" in row.setting.solver else ""
    return f"{row.setting.size:.3g}{unit}" if row.setting.size else _NONE


def _cell(one: Bias, unit: str = "") -> str:
    value, bias = _numbers(one)
    value += f" {unit}" if unit else ""
    marks = ("*" if one.told_apart else "") + ("!" if one.matters else "")
    return f"{value} ({bias}){marks}" if bias else f"{value} ({_range(one)})"


def _numbers(one: Bias) -> tuple[str, str]:
    """Median and bias to the digits of the quantity; of the finest no bias."""
    last = one.quantity.last_digit(one.median)
    value = printed(one.median, last)
    if one.bias is None:
        return value, ""
    bias = printed(abs(one.bias), last)
    return value, ("+" if one.bias >= 0.0 else "-") + bias if bias != "0" else "0"


def _range(one: Bias) -> str:
    last = one.quantity.last_digit(one.median)
    return f"{printed(one.least, last)} to {printed(one.largest, last)}"


def remark(study: CaptureStudy, row: CaptureRow) -> str:
    """What is to be said of a row: that it failed, was left out, is the finest, holds, or not."""
    if row.failed:
        return f"failed: {row.reason}"
    if row.reason:
        return row.reason
    if row is study.finest:
        return "the finest: ranges of its runs"
    if row.setting.alone:
        return "one run"
    if not row.courses or study.finest is None:
        return ""
    words = study.judged(row)
    return words if study.complete(row) else f"{words}; only {len(row.moved)} of {study.runs} moved starts"


def words(study: CaptureStudy) -> list[tuple[str, str]]:
    """Rows (setting, what it takes and finds in words)."""
    found = []
    for row in study.rows:
        if math.isnan(row.seconds):
            found.append((row.setting.name, remark(study, row) or "not run"))
            continue
        parts = [f"{row.seconds:.3g} s, {row.right_hand_sides} right-hand sides"]
        verdicts = study.verdicts(row)
        if verdicts is not None:
            parts.append(verdicts.words + ("" if verdicts.same else " !"))
        parts += [f"{one.quantity.words} {_cell(one, one.quantity.unit)}" for one in study.biases(row)]
        parts += [remark(study, row)]
        found.append((f"{row.setting.name} ({value_of(row)})", "; ".join(part for part in parts if part)))
    return found


def recommendation(study: CaptureStudy) -> list[tuple[str, str]]:
    """Rows (name, value): the cheapest setting that holds, what runs it, and how sure that is."""
    best, finest = study.recommended, study.finest
    if best is None or finest is None:
        return [("recommended", "nothing: no setting came through all its moved starts")]
    compared = [
        row for row in study.rows if row is not finest and study.complete(row) and not row.setting.alone
    ]
    if not compared:
        return [("recommended", "nothing: there is no finer setting to compare with; give a larger --budget")]
    seconds = f"{best.seconds:.3g} s a run"
    if best is finest:
        found = f"{best.setting.name}, {seconds}, the finest that ran: no other setting is found to hold"
        return [("recommended", found), *_to_run(best), *_open(study, best)]
    why = "each bias below a third of the range of the finest runs or below the digits, the same verdict"
    rows = [("recommended", f"{best.setting.name}, {seconds}: {why}"), *_to_run(best)]
    unsure = [one.quantity.words for one in study.biases(best) if not one.shown]
    if unsure:
        few = f"{study.runs} moved starts are too few to show it by two one-sided tests at 5 %"
        rows.append(("not shown", f"of {', '.join(unsure)}: {few}; give more --runs"))
    rows += _open(study, best)
    if study.runs < FEWEST:
        rows.append(("note", f"ranges of fewer than {FEWEST} runs tell little"))
    return rows


def _open(study: CaptureStudy, best: CaptureRow) -> list[tuple[str, str]]:
    """A row with what is cheaper than the recommended setting and may hold too."""
    cheaper = [
        f"{row.setting.name} ({row.seconds:.3g} s a run)"
        for row in study.rows
        if study.complete(row) and row.seconds < best.seconds and study.judged(row) == Judgement.OPEN
    ]
    if not cheaper:
        return []
    words = f"not told apart from the finest by {study.runs} moved starts; more --runs would tell"
    return [("may hold too", f"{', '.join(cheaper)}: {words}")]


def _to_run(row: CaptureRow) -> list[tuple[str, str]]:
    options = [f"--set '{one}'" for one in row.setting.overrides]
    return [("  to run it" if k == 0 else "", one) for k, one in enumerate(options)]


def write_csv(study: CaptureStudy, path: Path) -> None:
    """A row for each setting and quantity; empty cells where nothing is known."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_HEAD)
        for row in study.rows:
            verdicts = study.verdicts(row)
            outcome = "" if verdicts is None else verdicts.words
            front = [str(row.setting.knob), row.setting.name, _digits(row.setting.size or math.nan)]
            front += [_digits(row.seconds), str(row.right_hand_sides or "")]
            back = [outcome, remark(study, row)]
            for one in study.biases(row):
                numbers = (one.median, one.least, one.largest, one.bias, one.low, one.high, one.allowed)
                told = "" if one.bias is None else "yes" if one.told_apart else "no"
                shown = [_digits(math.nan if value is None else value) for value in numbers]
                writer.writerow([*front, one.quantity.key, one.runs, *shown, told, *back])
            if not row.courses:
                writer.writerow([*front, *[""] * 10, *back])


_HEAD = (
    *("knob", "setting", "step_or_tolerance", "seconds", "right_hand_sides", "quantity", "runs"),
    *("median", "least", "largest", "bias", "bias_low", "bias_high", "allowed", "told_apart"),
    *("verdict", "remark"),
)


def _digits(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6g}"

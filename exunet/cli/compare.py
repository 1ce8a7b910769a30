"""`exunet compare`: keys and metrics of two results that differ, states of the same net, a figure of both."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from exunet.base.errors import ExunetError, InputError
from exunet.base.files import replacing
from exunet.base.key_path import dotted, leaves
from exunet.base.validation import shown
from exunet.cli.output import print_columns, print_line, print_table
from exunet.cli.run import summary_at
from exunet.plots.curves import compared
from exunet.plots.style import SCREEN, drawing, write
from exunet.results.comparison import ComparedRun, compare
from exunet.results.ensemble import Ensemble, load_ensemble
from exunet.results.io import ENSEMBLE_FILE, RESULT_FILE, load_result
from exunet.results.observables import Observables
from exunet.results.run_folder import has_result, has_unfinished
from exunet.results.run_record import CaseText
from exunet.results.summary import summary_of_agreement, summary_of_metrics
from exunet.results.table import agreement_words, differences_of_states
from exunet.scene.casefile import parse_case

LINES = 12  # metrics that are printed without --all
COMPARISON = "compare.png"
VECTOR = 4  # numbers of a list that are compared together


class Design(NamedTuple):
    """Compared data of a result or an ensemble.

    metrics : "words", "unit", "text", "value" and "range" of each metric, as in summary.json
    outcome : of its capture; "" without a criterion
    source, ensemble : what curves and bands over time are of
    """

    name: str
    case: CaseText
    metrics: Mapping[str, Mapping[str, Any]]
    outcome: str
    run: ComparedRun | None
    source: Observables | Ensemble
    ensemble: Ensemble | None


class Difference(NamedTuple):
    """A metric of two designs A and B: texts, change from A to B, and what the ranges say.

    change : a part of A; in the metric's unit where A is zero or the sign changes; "" of the same texts, of
             numbers of elements, and of a metric of one design only
    """

    words: str
    texts: tuple[str, str]
    change: str
    verdict: str


def compare_designs(a: Path, b: Path, *, every: bool) -> Path | None:
    """Print what differs between two results or ensembles; draw both over time.

    Parameters
    ----------
    a, b : Path
        The results or ensembles, or their folders.
    every : bool
        Print all metrics.

    Returns
    -------
    Path or None
        The figure, `COMPARISON` beside the first; None: neither design has anything to draw.

    Raises
    ------
    InputError
        If one cannot be read, or the figure cannot be written.
    """
    one, other = _design(a), _design(b)
    rows = [("keys that differ" * (k == 0), words) for k, words in enumerate(_keys(one, other))]
    if one.outcome or other.outcome:
        same = "the same" if one.outcome == other.outcome else "differs"
        rows.append(("outcome", f"{one.outcome or 'none'}   {other.outcome or 'none'}   {same}"))
    print_table(f"A: {one.name}, B: {other.name}", rows)
    found = differences(one.metrics, other.metrics)
    shown = found if every else [item for item in found if item.verdict not in (SAME, WITHIN)][:LINES]
    if shown:
        lines = [(item.words, *item.texts, item.change, item.verdict) for item in shown]
        print_columns(("metric", "A", "B", "difference", ""), lines)
    if len(found) > len(shown):
        print_line(f"{len(found) - len(shown)} metrics more: --all")
    if one.run is not None and other.run is not None:
        print_table("states", list(_states(one, other)))
    place = (a if a.is_dir() else a.parent) / COMPARISON
    with drawing():
        figure = compared([(item.name, item.source, item.ensemble) for item in (one, other)])
        if figure is None:
            return None
        with replacing(place) as part:
            write(figure, part, "png", SCREEN)
    return place


def _design(path: Path) -> Design:
    folder = path.parent if path.name in (RESULT_FILE, ENSEMBLE_FILE) else path
    no_result = folder.is_dir() and not has_result(folder) and not has_unfinished(folder)
    if path.name == ENSEMBLE_FILE or no_result:
        ensemble = load_ensemble(path)
        words = ", ".join(f"{name} {number}" for name, number in ensemble.run.outcomes.items())
        found = summary_of_metrics({}, ensemble)
        return Design(str(path), ensemble.run.case, found, words, None, ensemble, ensemble)
    summary, result = summary_at(path), load_result(path)
    outcome = "" if summary.get("capture") is None else str(summary["capture"]["outcome"])
    around = None if result.ensemble_file is None else load_ensemble(result.ensemble_file)
    run = ComparedRun.of(result)
    return Design(str(path), result.run.case, summary["metrics"], outcome, run, Observables(result), around)


SAME, WITHIN, BEYOND, NO_RANGE = "the same", "within the ranges", "beyond both ranges", "no range"
BEYOND_A, BEYOND_B = "beyond the range of A", "beyond the range of B"
NUMBERS = "element_of_"  # begin of the keys of numbers of elements, whose differences mean nothing


def differences(
    one: Mapping[str, Mapping[str, Any]], other: Mapping[str, Mapping[str, Any]]
) -> list[Difference]:
    """Compare metrics, in the order of the list of metrics.

    Medians are compared, or values of a run without perturbed runs. Two ranges that overlap hold the
    difference; without ranges the printed digits do.
    """
    found = []
    for key in dict.fromkeys([*one, *other]):
        a, b = one.get(key), other.get(key)
        words = (a or b or {})["words"]
        texts = ("-" if a is None else str(a["text"]), "-" if b is None else str(b["text"]))
        bounds = [None if item is None else _bounds(item) for item in (a, b)]
        if a is None or b is None or bounds[0] is None or bounds[1] is None:
            found.append(Difference(words, texts, "", "in one only"))
            continue
        (low, middle, high), (low_b, middle_b, high_b) = bounds[0], bounds[1]
        if texts[0] == texts[1]:
            verdict = SAME
        elif low <= high_b and low_b <= high:
            verdict = WITHIN
        else:
            ranges = (a["range"] is not None, b["range"] is not None)
            verdict = {(True, True): BEYOND, (True, False): BEYOND_A, (False, True): BEYOND_B}.get(
                ranges, NO_RANGE
            )
        without = verdict == SAME or key.startswith(NUMBERS)
        found.append(
            Difference(words, texts, "" if without else _change(middle, middle_b, a["unit"]), verdict)
        )
    return found


def _bounds(item: Mapping[str, Any]) -> tuple[float, float, float] | None:
    limits, value = item["range"], item["value"]
    if limits is not None:
        return limits["low"], limits["median"], limits["high"]
    return None if value is None else (value, value, value)


def _change(a: float, b: float, unit: str) -> str:
    """Return the change from a to b as a part of a, or in its unit where that part means nothing."""
    return f"{(b - a) / abs(a):+.1%}" if a * b > 0.0 else f"{b - a:+.3g} {unit}".rstrip()


def _keys(one: Design, other: Design) -> Iterator[str]:
    """Return the keys of both cases that differ, in words."""
    try:
        a, b = (_flat(design.case) for design in (one, other))
    except ExunetError:
        yield "not compared: a case is not stored with its result"
        return
    keys = [key for key in dict.fromkeys([*a, *b]) if key != "title" and _differ(a.get(key), b.get(key))]
    texts = [
        tuple("absent" if item is None else item[0] for item in (a.get(key), b.get(key))) for key in keys
    ]
    yield from (f"{key}: {old} -> {new}" for key, (old, new) in zip(keys[:LINES], texts, strict=False))
    if len(keys) > LINES:
        yield f"{len(keys) - LINES} more"
    if not keys:
        yield "none"


_Setting = tuple[str, bool]  # text of a value, and whether the case gives another value than the default


def _differ(a: _Setting | None, b: _Setting | None) -> bool:
    """True of two values that differ, and of one that is not the default and absent in the other case."""
    if a is None or b is None:
        return (a or b or ("", False))[1]
    return a[0] != b[0]


def _flat(stored: CaseText) -> dict[str, _Setting]:
    """Return the values of a case by their keys, defaults too."""
    case = parse_case(stored.text, Path(stored.name or ""), stored.overrides)
    every, given = (
        leaves(case.scene.model_dump(exclude_defaults=without), vectors=VECTOR) for without in (False, True)
    )
    chosen = {path for path, _ in given}
    return {dotted(path): (shown(value), path in chosen) for path, value in every if value is not None}


def _states(one: Design, other: Design) -> Iterator[tuple[str, str]]:
    """Return the differences of the states of two runs of the same net, or why they are missing."""
    assert one.run is not None
    assert other.run is not None
    try:
        found = compare(one.run, other.run)
    except InputError as error:
        yield "not compared", str(error)
        return
    yield "times in common", f"{len(found.time)}, {found.time[0]:g} s to {found.time[-1]:g} s"
    for design in (one, other):
        if design.run is not None and not design.run.complete:
            yield f"run {design.name}", "incomplete"
    if found.identical:
        yield "difference", "none: both have the same states, bit by bit"
        return
    check = summary_of_agreement(found)
    yield "agreement", agreement_words(check)
    if found.apart_from is not None:
        yield "apart for good", f"from {found.apart_from:.4g} s on"
    yield from differences_of_states(check)
    for names, design in ((found.bodies.only_a, one), (found.bodies.only_b, other)):
        yield from ((f"body {name}", f"only in {design.name}") for name in names)

"""Printed table of a run, from its summary: the answer, what limits trust in it, warnings."""

from __future__ import annotations

import hashlib
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from exunet.base.times import duration
from exunet.results.ensemble import sensitivity, words_of_endings
from exunet.results.measures import NEARLY_OPEN
from exunet.results.run_record import Ending

Rows = list[tuple[str, str]]
Summary = Mapping[str, Any]

COMPLETE = "ok"  # the verdict of a run that reached its end
_CHOICES = ("auto:", "Exudyn:", "VelocityVerlet of Exudyn")  # begin of notes on a choice
NOTES, HEADLINES = 3, 4  # notes and warnings, and metrics that are not converged, printed without `every`
_NAME = 15  # characters of the column of names
GAP = "   "  # between values in a row
_WITH_MOUTH = {"wrapped", "closing"}
_CONDITIONS = {  # name, relation, unit
    "enclosed": ("enclosed", ">=", ""),
    "relative_speed_m_s": ("relative speed", "<=", " m/s"),
    "relative_spin_rad_s": ("relative spin", "<=", " rad/s"),
    "cqi": ("CQI", "<=", ""),
    "mcqi": ("MCQI", "<=", ""),
    "mouth_m": ("mouth", "<=", " m"),
    "touching": ("elements in contact", ">=", ""),
}


class ReportContent(NamedTuple):
    """Content of report.html beside figures: answer, further rows, text of the case, provenance."""

    answer: Rows
    table: Rows
    case: str
    provenance: Rows


def report(summary: Summary, case: str) -> ReportContent:
    """Return what report.html has of a run; case: the text of the case."""
    answer, every = list(_answer(summary)), rows(summary)
    versions = ", ".join(f"{name} {version}" for name, version in summary["versions"].items())
    seed = (summary["ensemble"] or {}).get("seed")
    provenance = [
        ("case", summary["case"] or ""),
        ("overrides", GAP.join(summary["overrides"] or ["none"])),
        ("hash", f"sha256 {hashlib.sha256(case.encode()).hexdigest()} of the case"),
        ("method", _setting(summary)),
        ("versions", versions),
        ("platform", summary["platform"] or "unknown"),
        ("seed", "none: no perturbed runs" if seed is None else f"{seed} of the perturbed runs"),
    ]
    return ReportContent(answer, every[len(answer) :], case, provenance)


def text(summary: Summary, *, every: bool = False, width: int = 110) -> str:
    """Return what is printed of a run.

    Parameters
    ----------
    summary : mapping
        Of the run, as from `summarise` or summary.json.
    every : bool
        All metrics, masses, counts and notes too.
    width : int
        Of a line, in characters; longer ones are folded.
    """
    cost = summary["cost"]
    known = f"{summary['simulated_until_s']:.4g} s in {duration(cost['integration_s'])} ({_setting(summary)})"
    title = summary["title"] or summary["case"] or "run"
    gap = width - len(title) - len(known)
    lines = [f"{title}{' ' * gap}{known}"] if gap > 1 else [title, f"  {known}"]
    indent = " " * (2 + _NAME)
    for name, value in rows(summary, every=every):
        begin = f"  {name:{_NAME - 1}s} " if len(name) < _NAME else f"  {name}  "
        lines += textwrap.wrap(begin + value, width, subsequent_indent=indent, break_on_hyphens=False)
    return "\n".join(lines)


def rows(summary: Summary, *, every: bool = False) -> Rows:
    """Return rows (name, value); a row without a name continues the one before."""
    found = [*_answer(summary), *_loads(summary), *_trust(summary, every=every)]
    warnings = [("!", words) for words in _warnings(summary)]
    # how the run was made stands in the first line: what the scene lacks or hides comes first
    notes = [("note", note) for note in sorted(summary["notes"], key=lambda note: note.startswith(_CHOICES))]
    if not every:
        more = len(warnings) + len(notes) - NOTES
        left = max(0, NOTES - len(warnings))
        return [*found, *warnings, *notes[:left], *([("", f"{more} more notes")] if more > 0 else [])]
    return [*found, *warnings, *notes, *_details(summary), *_all_metrics(summary)]


def _metric(summary: Summary, key: str) -> dict[str, Any] | None:
    found: dict[str, Any] | None = summary["metrics"].get(key)
    return found


def _value(summary: Summary, key: str, before: str = "", after: str = "") -> str:
    """Return a metric with its range between words; "" of a run that does not have it."""
    found = _metric(summary, key)
    return "" if found is None else f"{before}{found['text']}{after}"


def _join(parts: Iterable[str], between: str = GAP) -> str:
    return between.join(part for part in parts if part)


def _setting(summary: Summary) -> str:
    method = summary["method"]
    with_step = f"step {method['step_s']:.3g} s" if method["step_s"] else ""
    setting = f"tolerance {method['tolerance']:.2g}" if method["tolerance"] else with_step
    return _join([method["name"], setting, method["backend"] or ""], ", ")


def _answer(summary: Summary) -> Iterator[tuple[str, str]]:
    if summary["verdict"] != COMPLETE:
        until = f"{summary['simulated_until_s']:.6g} of {summary['end_s']:.6g} s"
        yield "STOPPED", f"after {until}: {summary['verdict']}"
    if (capture := summary.get("capture")) is not None:
        yield from _captured(capture)
    if events := summary["timeline"]:
        yield "Timeline", GAP.join(f"{item['time_s']:.4g} s {item['event']}" for item in events)
    area = _metric(summary, "largest_area_m2")
    if area is None or area["remark"]:  # it hardly changes
        return
    opening = _value(summary, "time_above_80_percent_s", f"above {NEARLY_OPEN:.0%} for ")
    if _metric(summary, "time_of_largest_area_s") is None:  # it is never wider than at the start
        if capture is None:
            yield "Mouth", _join([f"never wider than at the start, {area['text']}", opening])
        return
    relative = _value(summary, "relative_area", "", " of the achievable")
    when = _value(summary, "time_of_largest_area_s", "at ")
    if late := (_metric(summary, "time_of_largest_area_s") or {}).get("remark"):
        when += f" ({late})"
    yield "Largest area", _join([area["text"], relative, when, opening])


def _captured(capture: Summary) -> Iterator[tuple[str, str]]:
    state, target = capture["outcome"], capture["target"]
    if state == "captured":
        yield "CAPTURED", f"'{target}' since {capture['since_s']:.4g} s"
    else:
        words = f"'{target}'" if state == "undetermined" else f"'{target}' {state}"
        through, when = capture["left_through"], f"at {capture['time_s'] or 0.0:.4g} s"
        if state == "missed" and (capture["cause"] or {}).get("cause") == "would miss":
            words += " on the net's straight way after the end"
        elif state == "missed":
            least = capture["least_distance_m"]
            words += f" by {least:.3g} m {when}" if least > 0.0 else f": nodes of the net were in it {when}"
        if state == "escaped" or through:
            words += f"{' and lost' * (state == 'touched')} {when}{f' through the {through}' * bool(through)}"
        mouth = capture["conditions"].get("mouth_m")
        if state in _WITH_MOUTH and mouth is not None and mouth["since_s"] is None:
            words += " with an open mouth"
        yield "UNDETERMINED" if state == "undetermined" else "NOT CAPTURED", words
    conditions = _join(_condition(name, item) for name, item in capture["conditions"].items())
    yield "", f"{conditions}   all for {capture['duration_s']:g} s"
    if (cause := capture["cause"]) is not None:
        yield "Why", cause["words"]


def _condition(name: str, item: Summary) -> str:
    words, relation, unit = _CONDITIONS[name]
    since = "not met" if item["since_s"] is None else f"since {item['since_s']:.4g} s"
    return f"{words} {item['at_end']:.3g}{unit} ({relation} {item['bound']:g}{unit}: {since})"


def _loads(summary: Summary) -> Iterator[tuple[str, str]]:
    """Largest tensions with margins, and of each body in contact force and penetration."""
    metrics = summary["metrics"]
    tethers = [
        key[7:-18] for key in metrics if key.startswith("tether_") and key.endswith("_largest_tension_N")
    ]
    net = "net_" if "net_largest_tension_N" in metrics else ""
    margins = [_value(summary, f"margin_of_{kind}", f"margin of {kind} ") for kind in ("threads", "strings")]
    if not tethers or net:
        yield from _tension(summary, "Tension", net, _join(margins))
    for name in tethers:
        margin = _value(summary, f"tether_{name}_margin", "margin ")
        yield from _tension(summary, f"Tether {name}", f"tether_{name}_", margin)
    winch = _value(summary, "closing_wound_up_m", "wound up ")
    margin = _value(summary, "closing_margin", "margin ")
    yield from _tension(summary, "Closing line", "closing_", _join([margin, winch]))
    for name in summary["bodies"]:
        force = _value(summary, f"contact_{name}_largest_force_N")
        if force:
            depth = _value(summary, f"contact_{name}_deepest_m", "penetration ")
            yield f"Contact {name}", _join([force, depth])
    if summary["bodies"] == {}:
        yield from _row("Bullet speed", _value(summary, "bullet_speed_at_end_m_s", after=" at the end"))


def _tension(summary: Summary, name: str, before: str, more: str) -> Iterator[tuple[str, str]]:
    item = _metric(summary, f"{before}largest_tension_N")
    if item is not None and item["value"] != 0.0:
        time = _value(summary, f"{before}time_of_largest_tension_s", "at ")
        place = f"in {item['place']}" if item["place"] and " to " not in item["text"] else ""
        yield name, _join([_join([item["text"], place, time], " "), more])


def _row(name: str, value: str) -> Iterator[tuple[str, str]]:
    if value:
        yield name, value


def _trust(summary: Summary, *, every: bool) -> Iterator[tuple[str, str]]:
    """Perturbed runs, balances, check by the reference, step, division; what is not covered."""
    open_questions = []
    ensemble, check, estimate = (summary[key] for key in ("ensemble", "check", "error_estimate"))
    if ensemble is None or "refused" in ensemble:
        reason = "" if ensemble is None else f" ({ensemble['refused']})"
        open_questions.append(f"numerical sensitivity{reason}")
    else:
        yield "Ranges", sensitivity(ensemble["runs"], ensemble["move_m"])
        if outcomes := (summary.get("capture") or {}).get("perturbed_runs"):
            yield "", f"outcomes: {', '.join(f'{name} {number}' for name, number in outcomes.items())}"
        if ensemble["endings"]:
            yield "", f"ended: {words_of_endings(Ending(**item) for item in ensemble['endings'])}"
    yield from _row("Balances", _balances(summary))
    if check is None or "refused" in check:
        reason = "--check" if check is None else check["refused"]
        open_questions.append(f"reference ({reason})")
    else:
        yield "Reference", agreement_words(check)
    for name, key, finer, words, remedy in (
        ("Step", "step", "half of the step", "step", ""),
        ("Division", "divisions", "twice the elements", "division of threads", " (--divisions)"),
    ):
        found = summary[key]
        if found is not None and "refused" not in found:
            yield name, _moved(found["moved"], finer, every=every)
        elif found is not None:
            open_questions.append(f"{words} ({found['refused']})")
        elif key == "divisions" or (summary["method"]["step_s"] and estimate is None):
            open_questions.append(f"{words}{remedy}")
    yield from _estimate(estimate)
    yield "Not checked", ", ".join([*open_questions, "uncertainty of parameters"])


def _moved(moved: list[str], finer: str, *, every: bool) -> str:
    """Name metrics that finer runs move out of their ranges, the first `HEADLINES` only without `every`."""
    if not moved:
        return f"no metric leaves its range with {finer}"
    shown = moved if every else moved[:HEADLINES]
    more = [f"… {len(moved) - len(shown)} more: --all"] if len(shown) < len(moved) else []
    return f"medians → with {finer}: {'; '.join([*shown, *more])}"


def _balances(summary: Summary) -> str:
    energy, parts = summary["energy"], []
    if energy["scale_J"]:
        of = " of motion" if energy["scale_of"] == "motion" else ""
        parts = [f"energy {_short(energy['balance_error'])} of {energy['scale_J']:.4g} J{of}"]
    books = summary.get("momentum") or {}
    for kind, unit in (("linear", "kg_m_s"), ("angular", "kg_m2_s")):
        if books and books["residual_is_error"] and (size := books[f"{kind}_size_{unit}"]):
            name = "momentum" if kind == "linear" else "angular momentum"
            parts.append(f"{name} {_short(books[f'{kind}_residual_{unit}'] / size)}")
    return _join(parts)


def _short(value: float) -> str:
    return f"{value:.2g}" if value else "0"


def agreement_words(check: Summary) -> str:
    """Describe until when two runs agree, and within which limits."""
    parts = [("", check["agrees_until_s"])]
    parts += [(f"body {name}: ", body["agrees_until_s"]) for name, body in check["bodies"].items()]
    until = [name + ("to the end" if time is None else f"until {time:.4g} s") for name, time in parts]
    speed, position = check["speed_difference"], check["position_difference"]
    limits = (
        f"within {speed['allowed_m_s']:.1e} m/s of the {check['speeds_of']}, {position['allowed_m']:.1e} m"
    )
    return f"agrees {_join(until, ', ')} ({limits})"


def _estimate(found: Summary | None) -> Iterator[tuple[str, str]]:
    if found is None:
        return
    words = f"speeds of the {found['of']} {found['largest']:.1e} of the launch speed at most"
    words += f" (at {found['time_of_largest_s']:.4g} s), {found['at_end']:.1e} at the end"
    if found["lost_from_s"] is not None:
        words += (
            f"; the accuracy {found['accuracy']:g} is not known to hold from {found['lost_from_s']:.4g} s"
        )
    nodes = f"of the worst node {found['nodes_largest']:.1e} at most, {found['nodes_at_end']:.1e} at the end"
    yield "Error", f"{words}; {nodes} ({found['other']})"
    if found["sensitivity"] > found["accuracy"]:
        yield "", f"a start perturbed by {found['move_m']:.0e} m changes them by {found['sensitivity']:.1e}"


def _warnings(summary: Summary) -> Iterator[str]:
    """Implausible keys, bodies and threads that met without contact, entries that failed, breaks."""
    yield from summary["implausible"]
    for item in summary["overlaps"]:
        when = f"from {item['from_s']:.4g} s to {item['until_s']:.4g} s"
        yield f"bodies {' and '.join(item['bodies'])} overlap {when}: contact between them is not enabled"
    for item in summary["threads_inside"]:
        when = f"first element {item['element']} at {item['first_s']:.4g} s"
        yield f"elements through '{item['body']}': {item['elements']} ({when}); contact of threads is off"
    if (script := summary["script"]) is not None:
        yield from script["used_up"]
        if script["never"]:
            causes = {entry["entry"]: entry["cause"] for entry in script["entries"]}
            names = ", ".join(f"{name} ({causes[name]})" for name in script["never"])
            yield f"script: never reached: {names}"
    if broken := summary["broken"]:
        worst = max(item["energy_excess"] for item in broken)
        yield f"broken elements: {len(broken)}, with at most {worst:.2%} more energy than at the limit"


def _details(summary: Summary) -> Iterator[tuple[str, str]]:
    """Masses, steps, events of the script, corner units and the check, in full."""
    cost, fixed = summary["cost"], math.fsum(body["mass_of_nodes_kg"] for body in summary["bodies"].values())
    yield "nodes, elements", f"{summary['nodes']}, {summary['elements']}"
    yield "mass", mass_words(summary["mass_kg"], summary.get("mass_of_all_kg"), fixed)
    for name, body in summary["bodies"].items():
        nodes = body["mass_of_nodes_kg"]
        of = f", of which {nodes:.6g} kg are nodes of the net fixed to it" if nodes else ""
        yield f"body {name}", f"{body['mass_kg']:.6g} kg{of}"
    yield "steps", f"{cost['steps']} accepted, {cost['rejected_steps']} rejected"
    yield "right-hand sides", f"{cost['right_hand_sides']}"
    yield "wall time", f"{cost['build_s']:.2f} s build, {cost['integration_s']:.2f} s integration"
    for event in (summary["script"] or {}).get("events", ()):
        yield "script", f"t = {event['time_s']:.6g} s: {event['entry']}: {event['event']} ({event['cause']})"
    if (control := summary["control"]) is not None:
        each = ", ".join(f"{item['impulse_N_s']:.4g}" for item in control["units"])
        mass = control["propellant_kg"]
        propellant = "" if mass is None else f"; propellant {mass:.3g} kg in all, which stays in their mass"
        yield "control", f"by {control['kind']}; impulses of the units: {each} N s{propellant}"
    if (check := summary["check"]) is None or "refused" in check:
        return
    yield from ((f"reference: {name}", words) for name, words in differences_of_states(check))


def differences_of_states(check: Summary) -> Iterator[tuple[str, str]]:
    """Yield the largest differences of the states of two runs, of each body, and of the times of breaks."""
    speed, position = (check[f"{name}_difference"] for name in ("speed", "position"))
    words = f"speeds {speed['largest_m_s']:.1e} m/s, positions {position['largest_m']:.1e} m at most"
    if check["agrees_until_s"]:  # else they are those of the whole, or of no time
        least = speed["largest_while_agreeing_m_s"], position["largest_while_agreeing_m"]
        words += "; while they agree {:.1e} m/s, {:.1e} m".format(*least)
    yield "differences", words
    for name, body in check["bodies"].items():
        words = f"positions within {body['position_m']:.1e} m, velocities {body['velocity_m_s']:.1e} m/s"
        words += f", attitudes {body['attitude_rad']:.1e} rad"
        words += f", angular velocities {body['angular_velocity_rad_s']:.1e} rad/s"
        yield f"body {name}", words
    if broken := check["broken"]:
        alone = broken["only_here"] + broken["only_in_reference"]
        within = f"times within {broken['time_difference_s']:.1e} s"
        yield "breaks", f"{broken['in_both']} in both, {within}; {alone} in one only"


def _all_metrics(summary: Summary) -> Iterator[tuple[str, str]]:
    for item in summary["metrics"].values():
        has_range = " to " in item["text"] and item["value"] is not None
        own = f"this run {item['value']:.4g}" if has_range else ""
        more = _join([item["place"] or "", item["remark"] or "", own], "; ")
        yield item["words"], f"{item['text']} ({more})" if more else item["text"]


def mass_words(net: float, of_all: float | None, fixed: float) -> str:
    """Masses [kg] of the net with tethers, of all with bodies (None without bodies), of nodes on bodies."""
    if of_all is None:
        return f"{net:.6f} kg"
    once = f", of which {fixed:.6g} kg are nodes fixed to bodies and count with these" if fixed else ""
    return f"{net:.6f} kg of the net{once}; {of_all:.8g} kg in all"

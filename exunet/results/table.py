"""The table that a run prints: its summary in rows of words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from exunet.forces.corner_units import NAME as UNITS
from exunet.forces.from_outside import FIXED_NODES, SCRIPT
from exunet.results import corner_units, script_story
from exunet.results.attachment_headlines import ATTACHMENT
from exunet.results.headline import Headline, printed, shown
from exunet.results.headlines import headline
from exunet.results.judged import Judged, words_of_vector
from exunet.results.measures import NEARLY_OPEN
from exunet.results.spread import Spread
from exunet.results.summary import COMPLETE


def rows(summary: dict[str, Any], spread: Spread | str | None = None) -> list[tuple[str, str]]:
    """Rows (name, value with unit) of the table at the end of a run; spread: that of the summary."""
    method, cost = summary["method"], summary["cost"]
    setting = (
        f"tolerance {method['tolerance']:.3g}" if method["tolerance"] else f"step {method['step_s']:.4g} s"
    )
    table = [
        ("verdict", summary["verdict"]),
        ("nodes, elements", f"{summary['nodes']}, {summary['elements']}"),
        ("mass", mass_words(summary["mass_kg"], summary.get("mass_of_all_kg"), _of_nodes(summary["bodies"]))),
        *_body_rows(summary["bodies"]),
        ("method", f"{method['name']}, {setting}"),
        ("steps", f"{cost['steps']} accepted, {cost['rejected_steps']} rejected"),
        ("right-hand sides", f"{cost['right_hand_sides']}"),
        ("wall time", f"{cost['build_s']:.2f} s build, {cost['integration_s']:.2f} s integration"),
        *_part_row(summary),
        *_balance_rows(summary),
    ]
    if broken := summary["broken"]:
        first, worst = broken[0], max(item["energy_excess"] for item in broken)
        words = (
            f"in this run {len(broken)} element(s), first {first['element']} at t = {first['time_s']:.6g} s"
        )
        table.append(("broken", f"{words}; held at most {worst:.2%} more energy than at the limit"))
    moved = isinstance(spread, Spread)
    table += script_story.rows(summary["script"], moved=moved) + corner_units.rows(summary["control"])
    table += (
        _capture_rows(summary) + _without_contact(summary) + [("note", note) for note in summary["notes"]]
    )
    return table + _headline_rows(summary, spread) + _check_rows(summary["check"])


def _capture_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """What became of the target."""
    found = summary.get("capture")
    if found is None:
        return []
    rule = ", ".join(
        f"{_CONDITIONS[name][0]} {_CONDITIONS[name][1]} {value:g}{_CONDITIONS[name][2]}"
        f"{'' if found['hold_at_end'][name] else ' (not so at the end)'}"
        for name, value in found["conditions"].items()
    )
    words = f"{found['target']} {found['outcome']}"
    if found["since_s"] is not None:
        words += f"; the conditions hold from t = {found['since_s']:.6g} s on"
    words += f" (rule: {rule}, for {found['duration_s']:g} s until the end)"
    starts = found.get("moved_starts")
    if starts is None:
        return [("capture", f"{words}; in this run alone")]
    runs = sum(starts.values())
    return [
        (
            "capture",
            f"{words}; of {runs} moved starts: " + ", ".join(f"{n} {name}" for name, n in starts.items()),
        )
    ]


_CONDITIONS = {
    "enclosed": ("enclosed", ">=", ""),
    "relative_speed_m_s": ("relative speed", "<=", " m/s"),
    "relative_spin_rad_s": ("relative spin", "<=", " rad/s"),
    "cqi": ("CQI", "<=", ""),
    "mcqi": ("MCQI", "<=", ""),
    "mouth_m": ("mouth", "<=", " m"),
    "touching": ("elements that touch", ">=", ""),
}


def _balance_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Of the energy, and of the momenta of scenes with bodies, with the axes that these refer to."""
    energy, books = summary["energy"], summary.get("momentum")
    words = f"largest error {_short(energy['balance_error'])} as a part of the {energy['scale_J']:.6g} J"
    what = "of all motion: nothing can deform the net"
    if energy["scale_of"] == "deformation":
        what = "that can deform the net"
    found = [("energy balance", f"{words} {what}")]
    if not books:
        return found
    turning = "orbit" in summary["effects"]
    axes = "which turn with the orbit, relative to these" if turning else "which are inertial"
    found.append(("axes", f"places, rotations and momenta are in the scene's axes, {axes}"))
    for name, kind, unit, where in (
        ("momentum of all", "linear", "kg m/s", "in the scene's axes"),
        ("angular momentum of all", "angular", "kg m2/s", "about the scene's origin"),
    ):
        key = unit.replace("/", "_").replace(" ", "_")
        givers = (*summary["effects"], UNITS, FIXED_NODES, SCRIPT)
        gained, left, size = (books[f"{kind}_{item}_{key}"] for item in ("gained", "residual", "size"))
        part = f", {_short(left / size)} as a part of its size {size:.4g} {unit}" if size else ""
        lines = [giver for giver in givers if f"effect_{giver}_impulse_x_N_s" in summary["headlines"]]
        words = f"changes by at most {_short(gained)} {unit}"
        if lines:
            words += f", by no more than {_short(left)} {unit} beside the impulse of {' and '.join(lines)}"
        why = "error" if lines or books["residual_is_error"] else "by forces from outside, or error"
        found.append((name, f"{words}{part} ({where}; {why}{_besides(summary)})"))
    return found


def _besides(summary: dict[str, Any]) -> str:
    given = [name for name in summary["bodies"] if f"body_{name}_work_J" in summary["headlines"]]
    return f"; besides what {' and '.join(given)} gave" if given else ""


def _short(value: float) -> str:
    return f"{value:.2g}" if value else "0"


def mass_words(net: float, of_all: float | None, fixed: float) -> str:
    """Masses [kg] of the net with tethers, of all with bodies (None: there are none), of nodes on bodies."""
    if of_all is None:
        return f"{net:.6f} kg"
    once = f", of which {fixed:.6g} kg are nodes fixed to bodies and count with these" if fixed else ""
    return f"{net:.6f} kg of the net{once}; {of_all:.8g} kg in all"


def _of_nodes(bodies: dict[str, dict[str, Any]]) -> float:
    return math.fsum(body["mass_of_nodes_kg"] for body in bodies.values())


def _body_rows(bodies: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    return [(f"body {name}", f"{one['mass_kg']:.6g} kg{_nodes(one)}") for name, one in bodies.items()]


def _nodes(body: dict[str, Any]) -> str:
    mass = body["mass_of_nodes_kg"]
    return f", of which {mass:.6g} kg are nodes of the net fixed to it" if mass else ""


def _part_row(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """A heading for the rows about the stored states, which do not reach the end of a run that stopped."""
    if summary["verdict"] == COMPLETE:
        return []
    until = summary["simulated_until_s"]
    return [("stored states", f"until t = {until:.6g} s; the rows below refer to them")]


def _headline_rows(summary: dict[str, Any], spread: Spread | str | None) -> list[tuple[str, str]]:
    judged = spread.judged if isinstance(spread, Spread) else {}
    found = []
    every = [item for item in map(headline, summary["headlines"]) if not item.detail]
    for row, ones in groupby(every, lambda entry: entry.row):
        parts = list(ones)
        if parts[0] is next((one for one in every if one.of_book), None):
            found.append(("books", _BOOKS))
        if row:
            found.append(_vector_row(row, parts, summary, judged))
        else:
            found += [_headline_row(part, summary, judged) for part in parts]
    if summary["deployment"] is None:
        found.append(("deployment", "no mouth: not defined for this topology"))
    if isinstance(spread, Spread):
        told = [
            ("spread", element)
            for element in (spread.words(), spread.ends(), spread.verdict(), spread.unconverged())
            if element
        ]
        return [*found, *told, *_outside_row(summary["headlines"], spread)]
    why = "not asked for" if spread is None else spread
    return [*found, ("spread", f"{why}: these are the numbers of one run of a chaotic net")]


_BOOKS = (
    "gained from the start, before a throw then, to the end; all energies gained add up to the works less "
    "what is dissipated"
)


def _vector_row(
    row: str, parts: list[Headline], summary: dict[str, Any], judged: Mapping[str, Judged]
) -> tuple[str, str]:
    """The parts of a vector in one row."""
    if all(part.key in judged for part in parts):
        words = words_of_vector([judged[entry.key] for entry in parts])
    else:
        values = [summary["headlines"][item.key]["this_run"] for item in parts]
        last = parts[0].last_digit(0.0, math.hypot(*values))
        words = f"({', '.join(printed(value, last) for value in values)}) {parts[0].unit}"
    return row, f"{words} ({parts[0].remark})"


def _headline_row(one: Headline, summary: dict[str, Any], judged: Mapping[str, Judged]) -> tuple[str, str]:
    value = summary["headlines"][one.key]["this_run"]
    if one.key in summary["constant"] and one.key not in judged:
        return one.words, f"none: {summary['constant'][one.key]}"
    if one.key in judged:
        words = judged[one.key].words() + _where(judged[one.key])
    else:
        words = shown(one, value) + _where_in_run(one, summary)
    found = judged.get(one.key)
    ends = (
        (value,) if found is None else (found.median,) if found.predictable else (found.least, found.largest)
    )
    remarks = [one.remark] if one.remark else []
    remarks += _alone(one, value, judged)
    remarks += _remarks(one, ends, summary)
    if one.key in judged and (worst := summary["margins"].get(one.group)):
        remarks.append(f"in this run at t = {worst['time_s']:.6g} s")
        remarks += [] if worst["of"] == "all steps" else ["at stored times, between which it may be less"]
    return one.words, f"{words} ({'; '.join(remarks)})" if remarks else words


def _alone(one: Headline, value: float | None, judged: Mapping[str, Judged]) -> list[str]:
    """What has no range since no moved start has it, or a range that this run has no value of."""
    if judged and one.key not in judged:
        return ["of this run alone: no moved start has it"]
    return ["this run has it not"] if judged and value is None else []


def _outside_row(headlines: dict[str, Any], spread: Spread) -> list[tuple[str, str]]:
    """What of the run itself lies outside the ranges, as some headline of most runs does."""
    found = []
    for key, judged in spread.judged.items():
        value = headlines[key]["this_run"]
        if judged.headline.detail:
            continue
        if not judged.predictable and value is not None and not judged.least <= value <= judged.largest:
            found.append(f"{judged.headline.words} {shown(judged.headline, value)}")
    if not found:
        return []
    return [("this run", f"outside of the range: {', '.join(found)}")]


def _where(judged: Judged) -> str:
    """In which places, of runs that have some."""
    if not judged.places:
        return judged.headline.nowhere
    (place, runs), *others = judged.places
    if not others:
        return f" {judged.headline.place_is} {place}"
    return f", {judged.headline.place_is} {place} in {runs} of {judged.runs} runs"


def _where_in_run(one: Headline, summary: dict[str, Any]) -> str:
    if one.place is None:
        return ""
    if one.key.startswith("body_"):
        return _node_in_run(one, summary)
    if one.group:
        worst = summary["margins"][one.group]
        words = f" {one.place_is} {worst['element']} at t = {worst['time_s']:.6g} s"
        return words if worst["of"] == "all steps" else f"{words} (of the stored times)"
    peak = summary["largest_tensions"][one.peak_of] if one.peak_of else summary["largest_tension"]
    if peak["element"] is None and summary["verdict"] != COMPLETE:
        return f": no element was taut until {summary['simulated_until_s']:.6g} s"
    if peak["element"] is None:
        return one.nowhere
    words = f" {one.place_is} {peak['element']}"
    return words if peak["of"] == "all steps" else f"{words} (of the stored times)"


def _node_in_run(one: Headline, summary: dict[str, Any]) -> str:
    """Where threads pull most on a body."""
    body, _, quantity = one.key.removeprefix("body_").rpartition(ATTACHMENT)
    found = {
        (place["node"]): summary["headlines"][f"{place['headlines']}_{quantity}"]["this_run"]
        for place in summary["attachments"][body]
    }
    node = max(found, key=lambda node: found[node] or 0.0)
    return f" {one.place_is} {node}" if node is not None and found[node] else ""


# Forces without a potential that may put energy in, which is counted against what is dissipated.
_PUTS_IN = {"thrust": "thrust", "molecular_drag": "the flow of gas"}


def _remarks(one: Headline, ends: tuple[float, ...], summary: dict[str, Any]) -> list[str]:
    """What the table says of areas (of which part, and whether they may still grow) and of dissipation.

    ends : of its range; or its value alone
    """
    if one.key == "dissipated_energy_J":
        less = [words for effect, words in _PUTS_IN.items() if effect in summary["effects"]]
        return [f"less what {' and '.join(less)} put in"] if less else []
    if one.name.endswith("_time_of_least_distance") and ends[-1] == summary["simulated_until_s"]:
        return ["at the end of the run: still approaching?"]
    deployment = summary["deployment"]
    if deployment is None:
        return []
    most = deployment["achievable_area_m2"]
    if one.key == "largest_area_m2":
        parts = " to ".join(dict.fromkeys(f"{each / most:.1%}" for each in ends))
        return [f"{parts} of the achievable {most:.3f} m2"]
    if one.key == "time_of_largest_area_s" and deployment["largest_area_at_end"]:
        return ["at the end of the run: still growing?"]
    return [f"{NEARLY_OPEN * most:.3f} m2"] if one.key == "time_above_80_percent_s" else []


def _check_rows(check: dict[str, Any] | None) -> list[tuple[str, str]]:
    if not check:
        return []
    if refused := check.get("refused"):
        return [("check", f"none: {refused}")]
    agrees_until = check["agrees_until_s"]
    until = "the end" if agrees_until is None else f"t = {agrees_until:.3f} s"
    speed, position = check["speed_difference"], check["position_difference"]
    return [
        (
            "check: agrees until",
            f"{until} (speeds of the {check['speeds_of']} within {speed['allowed_m_s']:.1e} m/s, "
            f"positions of the nodes within {position['allowed_m']:.1e} m)",
        ),
        (
            "check: until then",
            f"speeds within {speed['largest_while_agreeing_m_s']:.1e} m/s, "
            f"positions within {position['largest_while_agreeing_m']:.1e} m",
        ),
        *_apart_row(check["apart_from_s"]),
        *_beside_rows(check),
    ]


def _beside_rows(check: dict[str, Any]) -> list[tuple[str, str]]:
    """Of bodies and of what broke, over the whole run."""
    table = []
    for name, body in check["bodies"].items():
        until = "the end" if body["agrees_until_s"] is None else f"t = {body['agrees_until_s']:.3f} s"
        words = f"positions within {body['position_m']:.1e} m (allowed {body['allowed_position_m']:.1e} m)"
        if body["attitude_rad"] is not None:
            words += f", attitudes within {body['attitude_rad']:.1e} rad"
            words += f" (allowed {body['allowed_attitude_rad']:.1e} rad)"
        table.append((f"check: body {name}", f"agrees until {until}; over the run {words}"))
    if broken := check["broken"]:
        alone = broken["only_here"] + broken["only_in_reference"]
        words = f"{broken['in_both']} in both codes, times within {broken['time_difference_s']:.1e} s"
        table.append(("check: broken", f"{words}; {alone} in one only" if alone else words))
    return table


def _apart_row(apart_from: float | None) -> list[tuple[str, str]]:
    if apart_from is None:
        return []
    words = f"from t = {apart_from:.3f} s to the end (before, at single instants within a snap only)"
    return [("check: apart", words)]


def _without_contact(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """A warning for each pair that overlapped while contact between the two is not enabled."""
    found = []
    for item in summary["overlaps"]:
        when = f"at t = {item['from_s']:.6g} s"
        if item["until_s"] > item["from_s"]:
            when = f"from t = {item['from_s']:.6g} s to {item['until_s']:.6g} s"
        often = f", {item['times']} times" if item["times"] > 1 else ""
        found.append(f"bodies {' and '.join(item['bodies'])} overlap {when}{often}, in this run")
    for entry in summary["passages"]:
        when = f"first element {entry['element']} at t = {entry['first_s']:.6g} s"
        found.append(
            f"{entry['elements']} element(s) in or through body {entry['body']}, {when}, in this run"
        )
    return [("no contact", f"{words}: contact between these is not enabled") for words in found]

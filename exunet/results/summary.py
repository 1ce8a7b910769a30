"""The numbers of a run that a user reads first: one dictionary for summary.json and for the table.

Numbers with a unit have it at the end of their name (_s, _m, _m2, _m_s, _kg, _N, _J); all others have none.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.files import replacing
from exunet.results.agreement import Agreement, ComparedBreaks
from exunet.results.body_comparison import BodyDifferences
from exunet.results.course import Course, course_of
from exunet.results.headlines import Headline, headline, headlines_of, shown
from exunet.results.measures import NEARLY_OPEN, energy_balance, energy_scale, momentum_gained
from exunet.results.passages import Overlap, Passage, overlaps, passages
from exunet.results.result import BodyStates, Result
from exunet.results.spread import Judged, Spread, description, numbers

Floats = NDArray[np.float64]

COMPLETE = "ok"  # the verdict of a run that reached its end


def summarise(
    result: Result, check: Agreement | str | None = None, spread: Spread | str | None = None
) -> dict[str, Any]:
    """Numbers of a result, ready for JSON; docs/results.md has the meaning and the unit of each key.

    check  : outcome of the comparison with the reference, or why there is none
    spread : of moved starts, or why there is none
    """
    story = result.provenance
    course = course_of(result)
    overlapping, passing = overlaps(result), passages(result)
    engine = story.get("engine", {})
    return {
        "title": story.get("title", ""),
        "case": story.get("case"),
        "overrides": story.get("overrides", []),
        "verdict": result.verdict,
        "end_s": story.get("end"),
        "simulated_until_s": float(result.time[-1]),
        "nodes": result.net.n_nodes,
        "elements": result.net.n_elements,
        "mass_kg": float(result.net.mass.sum()),
        "bodies": {name: _body(body) | _given(result, name) for name, body in result.bodies.items()},
        "effects": story.get("effects", []),
        "energy": {
            "initial_J": float(result.kinetic[0] + result.elastic[0] + result.potential[0]),
            "in_deformation_J": energy_scale(result),
            "balance_error": energy_balance(result),
        },
        **({"momentum": _momentum(result)} if result.bodies else {}),
        "headlines": numbers(spread, headlines_of(course)),
        "spread": description(spread),
        "largest_tension": _largest_tension(result, course),
        "margins": _margins(course),
        "deployment": _deployment(course),
        "overlaps": [_overlap(one) for one in overlapping],
        "passages": [_passage(one) for one in passing],
        "broken": story.get("broken"),
        "method": {
            "name": story.get("method"),
            "tolerance": story.get("tolerance"),
            "step_s": story.get("step"),
            "loop": engine.get("loop"),
            "net": engine.get("net"),
            "items": story.get("items", {}),
        },
        "cost": {
            "steps": story.get("steps"),
            "rejected_steps": story.get("rejected_steps"),
            "right_hand_sides": story.get("right_hand_sides"),
            "newton_iterations": story.get("newton_iterations"),
            "build_s": story.get("build_seconds"),
            "integration_s": story.get("integration_seconds"),
        },
        "retries": [_retry(one) for one in story.get("retries", [])],
        "notes": story.get("notes", []),
        "check": _found(check) if isinstance(check, Agreement) else _refused(check),
        "error_estimate": None,  # which `exunet run --estimate-error` fills in
        "versions": story.get("versions", {}),
        "platform": story.get("platform"),
    }


def _largest_tension(result: Result, course: Course) -> dict[str, Any]:
    """Where it was; of all steps, where the run tells it, else of the stored times."""
    element = course.peak.element
    known = "largest_tension" in result.provenance
    return {"element": element if element >= 0 else None, "of": "all steps" if known else "stored times"}


def _margins(course: Course) -> dict[str, Any]:
    """Where and when groups of elements have their least margins, by name; not of those never taut."""
    found = ((name, course.margin(name)) for name in (course.groups.names if course.groups else ()))
    return {
        name: {
            "element": one.element,
            "time_s": one.time,
            "strength_N": one.strength,
            "of": one.of,
        }
        for name, one in found
        if one is not None
    }


def _overlap(one: Overlap) -> dict[str, Any]:
    return {"bodies": list(one.bodies), "from_s": one.start, "until_s": one.end, "times": one.times}


def _passage(one: Passage) -> dict[str, Any]:
    return {"body": one.body, "elements": one.elements, "first_s": one.time, "element": one.element}


def _without_contact(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """A warning for each thing that went through another."""
    found = []
    for one in summary["overlaps"]:
        when = f"at t = {one['from_s']:.6g} s"
        if one["until_s"] > one["from_s"]:
            when = f"from t = {one['from_s']:.6g} s to {one['until_s']:.6g} s"
        often = f", {one['times']} times" if one["times"] > 1 else ""
        found.append(f"bodies {' and '.join(one['bodies'])} overlap {when}{often}")
    for one in summary["passages"]:
        when = f"first element {one['element']} at t = {one['first_s']:.6g} s"
        found.append(f"{one['elements']} element(s) in or through body {one['body']}, {when}")
    return [("no contact", f"{words}: there is no contact in this scene") for words in found]


def _deployment(course: Course) -> dict[str, Any] | None:
    """What a net with a mouth has beside its headlines."""
    if not 0.0 < course.achievable_area < math.inf:
        return None
    at_end = int(np.argmax(course.area)) == len(course.area) - 1
    return {"achievable_area_m2": course.achievable_area, "largest_area_at_end": at_end}


def _retry(story: dict[str, Any]) -> dict[str, Any]:
    return {
        "stopped": story["stopped"],
        "from_time_s": story["from_time"],
        "tolerance": story.get("tolerance"),
        "step_s": story.get("step"),
    }


def _body(body: BodyStates) -> dict[str, float]:
    return {"mass_kg": body.mass}


def _momentum(result: Result) -> dict[str, float]:
    """Its books, and those of the angular momentum about the origin."""
    found = momentum_gained(result).items()
    return {f"{name}_{'kg_m_s' if name.startswith('linear') else 'kg_m2_s'}": value for name, value in found}


def _given(result: Result, name: str) -> dict[str, Any]:
    """What a body that is fixed or prescribed has given to all else by the end; none of free ones."""
    found = ((quantity, result.states.get(f"{name}/{quantity}")) for quantity in _GIVEN)
    return {_GIVEN[quantity]: _number(states.values[-1]) for quantity, states in found if states is not None}


_GIVEN = {"work": "work_J", "impulse": "impulse_N_s", "angular_impulse": "angular_impulse_N_m_s"}


def _number(values: Floats) -> float | list[float]:
    return values.tolist() if len(values) > 1 else float(values[0])


def _refused(reason: str | None) -> dict[str, str] | None:
    return None if reason is None else {"refused": reason}


def _found(agreement: Agreement) -> dict[str, Any]:
    until = agreement.agrees_until
    agreeing = agreement.time < until if until is not None else slice(None)
    return {
        "compared_until_s": float(agreement.time[-1]),
        "agrees_until_s": until,
        "apart_from_s": agreement.apart_from,
        "speed_difference": _differences(agreement.allowed, agreement.speed_difference, agreeing, "m_s"),
        "position_difference": _differences(
            agreement.allowed_position, agreement.position_difference, agreeing, "m"
        ),
        "bodies": {name: _body_differences(one) for name, one in agreement.bodies.both.items()},
        "broken": _breaks(agreement.broken),
    }


def _body_differences(body: BodyDifferences) -> dict[str, float | None]:
    return {
        "position_m": float(body.position.max()),
        "velocity_m_s": float(body.velocity.max()),
        "attitude_rad": None if body.attitude is None else float(body.attitude.max()),
        "angular_velocity_rad_s": (
            None if body.angular_velocity is None else float(body.angular_velocity.max())
        ),
    }


def _breaks(broken: ComparedBreaks | None) -> dict[str, Any] | None:
    if broken is None:
        return None
    return {
        "in_both": len(broken.both),
        "only_here": len(broken.only_a),
        "only_in_reference": len(broken.only_b),
        "time_difference_s": broken.apart,
    }


def _differences(allowed: float, found: Floats, agreeing: Any, unit: str) -> dict[str, float]:
    return {
        f"allowed_{unit}": allowed,
        f"largest_{unit}": float(found.max()),
        f"largest_while_agreeing_{unit}": float(found[agreeing].max(initial=0.0)),
    }


def write_summary(summary: dict[str, Any], path: Path) -> None:
    """Write summary.json, whole or not at all; a number that is not finite is an error, not a value."""
    with replacing(path) as part:
        part.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def rows(summary: dict[str, Any], spread: Spread | str | None = None) -> list[tuple[str, str]]:
    """Rows (name, value with unit) of the table at the end of a run; spread: that of the summary."""
    method, cost, energy = summary["method"], summary["cost"], summary["energy"]
    setting = (
        f"tolerance {method['tolerance']:.3g}" if method["tolerance"] else f"step {method['step_s']:.4g} s"
    )
    table = [
        ("verdict", summary["verdict"]),
        ("nodes, elements", f"{summary['nodes']}, {summary['elements']}"),
        ("mass", f"{summary['mass_kg']:.6f} kg"),
        *_body_rows(summary["bodies"]),
        ("method", f"{method['name']}, {setting}"),
        ("steps", f"{cost['steps']} accepted, {cost['rejected_steps']} rejected"),
        ("right-hand sides", f"{cost['right_hand_sides']}"),
        ("wall time", f"{cost['build_s']:.2f} s build, {cost['integration_s']:.2f} s integration"),
        *_part_row(summary),
        (
            "energy balance",
            f"{energy['balance_error']:.1e} of {energy['in_deformation_J']:.6g} J in deformation",
        ),
    ]
    if books := summary.get("momentum"):
        words = f"{books['linear_gained_kg_m_s']:.1e} of {books['linear_size_kg_m_s']:.4g} kg m/s; angular, "
        words += f"about the origin, {books['angular_gained_kg_m2_s']:.1e} of "
        table.append(("momentum gained", f"{words}{books['angular_size_kg_m2_s']:.4g} kg m2/s"))
    if broken := summary["broken"]:
        first, worst = broken[0], max(one["energy_excess"] for one in broken)
        words = f"{len(broken)} element(s), first {first['element']} at t = {first['time_s']:.6g} s"
        table.append(("broken", f"{words}; held at most {worst:.2%} more energy than at the limit"))
    table += _without_contact(summary) + [("note", note) for note in summary["notes"]]
    return table + _headline_rows(summary, spread) + _check_rows(summary["check"])


def _body_rows(bodies: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    return [(f"body {name}", f"{one['mass_kg']:.6g} kg{_gave(one)}") for name, one in bodies.items()]


def _gave(body: dict[str, Any]) -> str:
    """Of a body that is fixed or prescribed."""
    if "work_J" not in body:
        return ""
    impulse = ", ".join(f"{value:.4g}" for value in body["impulse_N_s"])
    return f"; gave {body['work_J']:.4g} J and an impulse of ({impulse}) N s"


def _part_row(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """A heading for the rows about the stored states, which do not reach the end of a run that stopped."""
    if summary["verdict"] == COMPLETE:
        return []
    until = summary["simulated_until_s"]
    return [("stored states", f"until t = {until:.6g} s; the rows below refer to them")]


def _headline_rows(summary: dict[str, Any], spread: Spread | str | None) -> list[tuple[str, str]]:
    judged = spread.judged if isinstance(spread, Spread) else {}
    found = []
    for one in map(headline, summary["headlines"]):
        value = summary["headlines"][one.key]["this_run"]
        if one.key in judged:
            words = judged[one.key].words() + _where(judged[one.key])
        else:
            words = shown(one, value) + _where_in_run(one, summary)
        relative_to = judged[one.key].median if one.key in judged else value
        remarks = [one.remark] if one.remark else []
        remarks += _remarks(one, relative_to, summary["deployment"])
        if one.key in judged and (worst := summary["margins"].get(one.group)):
            remarks.append(f"in this run at t = {worst['time_s']:.6g} s")
            remarks += [] if worst["of"] == "all steps" else ["at stored times, between which it may be less"]
        found.append((one.words, f"{words} ({'; '.join(remarks)})" if remarks else words))
    if summary["deployment"] is None:
        found.append(("deployment", "no mouth: not defined for this topology"))
    if isinstance(spread, Spread):
        told = [("spread", spread.words()), ("spread", spread.verdict())]
        return [*found, *told, *_outside_row(summary["headlines"], spread)]
    why = "not asked for" if spread is None else spread
    return [*found, ("spread", f"{why}: these are the numbers of one run of a chaotic net")]


def _outside_row(headlines: dict[str, Any], spread: Spread) -> list[tuple[str, str]]:
    """What of the run itself lies outside the ranges: its start may be special, as a symmetric one is."""
    found = []
    for key, judged in spread.judged.items():
        value = headlines[key]["this_run"]
        if not judged.predictable and value is not None and not judged.least <= value <= judged.largest:
            found.append(f"{judged.headline.words} {shown(judged.headline, value)}")
    if not found:
        return []
    return [("this run", f"outside of the range, so that its exact start is not typical: {', '.join(found)}")]


def _where(judged: Judged) -> str:
    """In which places, of runs that have some."""
    if not judged.places:
        return ": no element was ever taut" if judged.headline.place is not None else ""
    (place, runs), *others = judged.places
    if not others:
        return f" in {judged.headline.place_is} {place}"
    return f", in {judged.headline.place_is} {place} in {runs} of {judged.runs} runs"


def _where_in_run(one: Headline, summary: dict[str, Any]) -> str:
    if one.place is None:
        return ""
    if one.group:
        worst = summary["margins"][one.group]
        words = f" in {one.place_is} {worst['element']} at t = {worst['time_s']:.6g} s"
        return words if worst["of"] == "all steps" else f"{words} (of the stored times)"
    peak = summary["largest_tension"]
    if peak["element"] is None and summary["verdict"] != COMPLETE:
        return f": no element was taut until {summary['simulated_until_s']:.6g} s"
    if peak["element"] is None:
        return ": no element was ever taut"
    words = f" in {one.place_is} {peak['element']}"
    return words if peak["of"] == "all steps" else f"{words} (of the stored times)"


def _remarks(one: Headline, value: float, deployment: dict[str, Any] | None) -> list[str]:
    """What the table says of areas: relative to which, and whether they may still grow."""
    if deployment is None:
        return []
    most = deployment["achievable_area_m2"]
    if one.key == "largest_area_m2":
        return [f"{value / most:.1%} of the achievable {most:.3f} m2"]
    if one.key == "time_of_largest_area_s" and deployment["largest_area_at_end"]:
        return ["at the end of the run: still growing?"]
    return [f"{NEARLY_OPEN * most:.3f} m2"] if one.key == "time_above_80_percent_s" else []


def _check_rows(check: dict[str, Any] | None) -> list[tuple[str, str]]:
    if not check:
        return []
    if refused := check.get("refused"):
        return [("check", f"refused: {refused}")]
    agrees_until = check["agrees_until_s"]
    until = "the end" if agrees_until is None else f"t = {agrees_until:.3f} s"
    speed, position = check["speed_difference"], check["position_difference"]
    return [
        (
            "check: agrees until",
            f"{until} (bullet speeds within {speed['allowed_m_s']:.1e} m/s, "
            f"positions within {position['allowed_m']:.1e} m)",
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
        words = f"positions within {body['position_m']:.1e} m"
        if body["attitude_rad"] is not None:
            words += f", attitudes within {body['attitude_rad']:.1e} rad"
        table.append((f"check: body {name}", words))
    if broken := check["broken"]:
        alone = broken["only_here"] + broken["only_in_reference"]
        words = f"{broken['in_both']} in both codes, times within {broken['time_difference_s']:.1e} s"
        table.append(("check: broken", f"{words}; {alone} in one only" if alone else words))
    return table


def _apart_row(apart_from: float | None) -> list[tuple[str, str]]:
    if apart_from is None:
        return []
    words = f"from t = {apart_from:.3f} s (earlier disagreement is that of single instants within a snap)"
    return [("check: apart for good", words)]

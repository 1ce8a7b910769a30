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

from exunet.base.arguments import takes
from exunet.base.files import replacing
from exunet.net.arrays import NET, TETHER, Net
from exunet.results import corner_units, script_story
from exunet.results.agreement import Agreement, ComparedBreaks
from exunet.results.body_comparison import BodyDifferences
from exunet.results.capture_headlines import bodies_with_contacts, outcomes, told
from exunet.results.course import Course, course_of
from exunet.results.headlines import constants_of, headlines_of
from exunet.results.loads import carried_until
from exunet.results.margins import Peak
from exunet.results.measures import (
    all_have_lines,
    energy_balance,
    energy_divisor,
    energy_scale,
    momentum_books,
    moving_mass,
    stays_the_same,
)
from exunet.results.passages import Overlap, Passage, overlaps, passages
from exunet.results.pulls import PACKED
from exunet.results.result import BodyStates, Result
from exunet.results.spread import Spread, description, numbers, whose

Floats = NDArray[np.float64]

COMPLETE = "ok"  # the verdict of a run that reached its end


@takes(result=Result, check=(Agreement, str), spread=(Spread, str))
def summarise(
    result: Result, check: Agreement | str | None = None, spread: Spread | str | None = None
) -> dict[str, Any]:
    """Numbers of a result, ready for JSON; docs/results.md has the meaning and the unit of each key.

    check  : outcome of the comparison with the reference, or why it is missing
    spread : of perturbed runs, or why they are missing
    """
    story = result.provenance
    course = _course(result, spread)
    overlapping, passing = overlaps(result), passages(result, but=bodies_with_contacts(course))
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
        **({"mass_of_all_kg": moving_mass(result)} if result.bodies else {}),
        "bodies": {name: _body(result.net, body) for name, body in result.bodies.items()},
        "effects": story.get("effects", []),
        "energy": {
            "initial_J": float(result.kinetic[0] + result.elastic[0] + result.potential[0]),
            "scale_J": energy_divisor(result),
            "scale_of": "deformation" if energy_scale(result) else "motion",
            "balance_error": energy_balance(result),
        },
        **({"momentum": _momentum(result)} if result.bodies else {}),
        "attachments": _attachments(course, story),
        "headlines": numbers(spread, headlines_of(course), constant := constants_of(course)),
        "constant": constant,
        "spread": description(spread),
        "largest_tension": _largest_tension(course.peak),
        "largest_tensions": _largest_tensions(course),
        "margins": _margins(course),
        "deployment": _deployment(course),
        **({} if (capture := _capture(course, spread)) is None else {"capture": capture}),
        "overlaps": [_overlap(item, whose(spread)) for item in overlapping],
        "passages": [_passage(entry, whose(spread)) for entry in passing],
        "broken": _broken(story.get("broken"), whose(spread)),
        "script": script_story.told(story, whose(spread)),
        "control": corner_units.told(result, whose(spread)),
        "method": {
            "name": story.get("method"),
            "tolerance": story.get("tolerance"),
            "step_s": story.get("step"),
            "backend": engine.get("backend"),
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
        "retries": [_retry(element) for element in story.get("retries", [])],
        "notes": story.get("notes", []),
        "check": _found(check) if isinstance(check, Agreement) else _refused(check),
        "error_estimate": None,  # which `exunet run --estimate-error` fills in
        "versions": story.get("versions", {}),
        "platform": story.get("platform"),
    }


def _course(result: Result, spread: Spread | str | None) -> Course:
    """The course of a result, which a spread has already that was made of it."""
    own = spread.run if isinstance(spread, Spread) else None
    return own if own is not None and own.time is result.time else course_of(result)


def _capture(course: Course, spread: Spread | str | None) -> dict[str, Any] | None:
    """What became of the target, in this run and in moved starts; None of a case without [capture]."""
    found = told(course)
    if found is not None and isinstance(spread, Spread):
        found["moved_starts"] = outcomes(spread.moved)
    return found


def _largest_tension(peak: Peak) -> dict[str, Any]:
    """Where it was; of all steps, where the run tells it, else of the stored times."""
    return {"element": peak.element if peak.element >= 0 else None, "of": peak.of}


def _largest_tensions(course: Course) -> dict[str, Any]:
    """The same of the net and of each tether, by name; of a scene without tethers none."""
    if not course.tether_names:
        return {}
    groups = (NET, *(TETHER + name for name in course.tether_names))
    found = ((name, course.peak_of(name)) for name in groups)
    return {name: _largest_tension(peak) for name, peak in found if peak is not None}


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


def _overlap(one: Overlap, whose: str) -> dict[str, Any]:
    found = {"bodies": list(one.bodies), "from_s": one.start, "until_s": one.end, "times": one.times}
    return {**found, "of": whose}


def _passage(one: Passage, whose: str) -> dict[str, Any]:
    found = {"body": one.body, "elements": one.elements, "first_s": one.time, "element": one.element}
    return {**found, "of": whose}


def _broken(those: list[dict[str, Any]] | None, whose: str) -> list[dict[str, Any]] | None:
    """Each element that broke; None without the effect."""
    return None if those is None else [{**item, "of": whose} for item in those]


def _deployment(course: Course) -> dict[str, Any] | None:
    """What a net with a mouth has beside its headlines."""
    if not 0.0 < course.achievable_area < math.inf:
        return None
    at_end = int(np.argmax(course.area)) == len(course.area) - 1 and not stays_the_same(course.area)
    return {"achievable_area_m2": course.achievable_area, "largest_area_at_end": at_end}


def _retry(story: dict[str, Any]) -> dict[str, Any]:
    return {
        "stopped": story["stopped"],
        "from_time_s": story["from_time"],
        "tolerance": story.get("tolerance"),
        "step_s": story.get("step"),
    }


def _body(net: Net, body: BodyStates) -> dict[str, float]:
    nodes = 0.0 if body.nodes is None else float(net.mass[body.nodes].sum())
    return {"mass_kg": body.mass, "mass_of_nodes_kg": nodes}


def _attachments(course: Course, story: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Where threads pull on each body, and the headlines of each place."""
    found: dict[str, list[dict[str, Any]]] = {}
    for place in course.pulled:
        packed = place.node == PACKED
        one = {
            "node": None if packed else place.node,
            "packed_net_until_s": min(carried_until(story), float(course.time[-1])) if packed else None,
            "headlines": f"attachment_{place.name}",
        }
        found.setdefault(place.body, []).append(one)
    return found


def _momentum(result: Result) -> dict[str, float | bool]:
    """Its books, and those of the angular momentum about the origin."""
    units = {"linear": "kg_m_s", "angular": "kg_m2_s"}
    numbers = {
        f"{name}_{entry}_{units[name]}": value
        for name, book in momentum_books(result).items()
        for entry, value in book._asdict().items()
    }
    return {**numbers, "residual_is_error": all_have_lines(result)}


def _refused(reason: str | None) -> dict[str, str] | None:
    return None if reason is None else {"refused": reason}


def _found(agreement: Agreement) -> dict[str, Any]:
    until = agreement.agrees_until
    agreeing = agreement.time < until if until is not None else slice(None)
    return {
        "compared_until_s": float(agreement.time[-1]),
        "agrees_until_s": until,
        "apart_from_s": agreement.apart_from,
        "speeds_of": agreement.speeds_of,
        "speed_difference": _differences(agreement.allowed, agreement.speed_difference, agreeing, "m_s"),
        "position_difference": _differences(
            agreement.allowed_position, agreement.position_difference, agreeing, "m"
        ),
        "bodies": {name: _body_differences(one) for name, one in agreement.bodies.both.items()},
        "broken": _breaks(agreement.broken),
    }


def _body_differences(body: BodyDifferences) -> dict[str, float | None]:
    return {
        "agrees_until_s": body.agrees_until,
        "allowed_position_m": body.allowed_position,
        "allowed_attitude_rad": None if body.attitude is None else body.allowed_attitude,
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

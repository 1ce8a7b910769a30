"""The numbers of a run that a user reads first: one dictionary for summary.json and for the table.

Numbers with a unit have it at the end of their name (_s, _m, _m2, _m_s, _kg, _N, _J); all others have none.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.files import replacing
from exunet.results.agreement import Agreement, ComparedBreaks
from exunet.results.body_comparison import BodyDifferences
from exunet.results.measures import NEARLY_OPEN, deployment, energy_balance, energy_scale, largest_tensions
from exunet.results.result import BodyStates, Result

Floats = NDArray[np.float64]

COMPLETE = "ok"  # the verdict of a run that reached its end


def summarise(result: Result, check: Agreement | str | None = None) -> dict[str, Any]:
    """Numbers of a result, ready for JSON; docs/results.md has the meaning and the unit of each key.

    check : outcome of the comparison with the reference, or why there is none
    """
    story = result.provenance
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
        "bodies": {name: _body(body) for name, body in result.bodies.items()},
        "effects": story.get("effects", []),
        "energy": {
            "initial_J": float(result.kinetic[0] + result.elastic[0] + result.potential[0]),
            "dissipated_J": float(result.dissipated[-1]),
            "in_deformation_J": energy_scale(result),
            "balance_error": energy_balance(result),
        },
        "largest_tension": _largest_tension(result),
        "deployment": _deployment(result),
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


def _largest_tension(result: Result) -> dict[str, Any]:
    """Of all steps, where the run tells it; else at the stored times."""
    known = result.provenance.get("largest_tension")
    found = dict(known) if known else _largest_stored_tension(result)
    if found["element"] < 0:  # no element was ever taut
        found |= {"time_s": None, "element": None}
    return found | {"of": "all steps" if known else "stored times"}


def _largest_stored_tension(result: Result) -> dict[str, Any]:
    largest = largest_tensions(result)
    at = int(np.argmax(largest))
    element = int(np.argmax(result.tension[at])) if largest[at] > 0.0 else -1
    return {"tension_N": float(largest[at]), "time_s": float(result.time[at]), "element": element}


def _deployment(result: Result) -> dict[str, Any] | None:
    measures = deployment(result)
    if measures is None:
        return None
    return {
        "achievable_area_m2": measures.achievable_area,
        "largest_area_m2": measures.largest_area,
        "relative_area": measures.relative_area,
        "time_of_largest_area_s": measures.time_of_largest,
        "largest_area_at_end": measures.at_end,
        "distance_m": measures.distance,
        "time_above_80_percent_s": measures.time_open,
    }


def _retry(story: dict[str, Any]) -> dict[str, Any]:
    return {
        "stopped": story["stopped"],
        "from_time_s": story["from_time"],
        "tolerance": story.get("tolerance"),
        "step_s": story.get("step"),
    }


def _body(body: BodyStates) -> dict[str, float]:
    way = np.linalg.norm(body.position[-1] - body.position[0])
    return {"mass_kg": body.mass, "displacement_m": float(way)}


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


def rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows (name, value with unit) of the table at the end of a run."""
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
        ("largest tension", _peak(summary["largest_tension"], summary)),
    ]
    if broken := summary["broken"]:
        first, worst = broken[0], max(one["energy_excess"] for one in broken)
        words = f"{len(broken)} element(s), first {first['element']} at t = {first['time_s']:.6g} s"
        table.append(("broken", f"{words}; held at most {worst:.2%} more energy than at the limit"))
    table += [("note", note) for note in summary["notes"]]
    return table + _deployment_rows(summary["deployment"]) + _check_rows(summary["check"])


def _body_rows(bodies: dict[str, dict[str, float]]) -> list[tuple[str, str]]:
    return [
        (f"body {name}", f"{one['mass_kg']:.6g} kg, at the end {one['displacement_m']:.4g} m from its start")
        for name, one in bodies.items()
    ]


def _part_row(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """A heading for the rows about the stored states, which do not reach the end of a run that stopped."""
    if summary["verdict"] == COMPLETE:
        return []
    until = summary["simulated_until_s"]
    return [("stored states", f"until t = {until:.6g} s; the rows below refer to them")]


def _peak(peak: dict[str, Any], summary: dict[str, Any]) -> str:
    if peak["element"] is None:
        until = (
            "at any time" if summary["verdict"] == COMPLETE else f"until {summary['simulated_until_s']:.6g} s"
        )
        return f"0 N: no element was taut {until}"
    words = f"{peak['tension_N']:.4g} N in element {peak['element']} at t = {peak['time_s']:.6g} s"
    return words if peak["of"] == "all steps" else f"{words} (of the stored times)"


def _deployment_rows(measures: dict[str, Any] | None) -> list[tuple[str, str]]:
    if not measures:
        return [("deployment", "no mouth: not defined for this topology")]
    end = "; at the end of the run: still growing?" if measures["largest_area_at_end"] else ""
    most = measures["achievable_area_m2"]
    area = f"{measures['largest_area_m2']:.3f} m2, {measures['relative_area']:.1%} of the achievable"
    return [
        ("largest area", f"{area} {most:.3f} m2{end}"),
        ("time of largest area", f"{measures['time_of_largest_area_s']:.3f} s"),
        ("distance travelled", f"{measures['distance_m']:.4g} m (centre of mass, until then)"),
        (
            "area above 80 %",
            f"during {measures['time_above_80_percent_s']:.3f} s ({NEARLY_OPEN * most:.3f} m2)",
        ),
    ]


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

"""The numbers of a run that a user reads first: one dictionary for summary.json and for the table."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.files import replacing
from exunet.results.agreement import Agreement
from exunet.results.measures import deployment, energy_balance, energy_scale
from exunet.results.result import BodyStates, Result
from exunet.results.rows import blocks


def summarise(result: Result, check: Agreement | str | None = None) -> dict[str, Any]:
    """Numbers of a result in SI units, ready for JSON; check: its outcome, or why there is none."""
    provenance = result.provenance
    measures = deployment(result)
    summary: dict[str, Any] = {
        "title": provenance.get("title", ""),
        "complete": result.complete,
        "verdict": result.verdict,
        "simulated_until_s": float(result.time[-1]),
        "nodes": result.net.n_nodes,
        "elements": result.net.n_elements,
        "mass_kg": float(result.net.mass.sum()),
        "bodies": {name: _body(body) for name, body in result.bodies.items()},
        "initial_energy_J": float(result.kinetic[0] + result.elastic[0] + result.potential[0]),
        "energy_balance": energy_balance(result),
        "energy_scale_J": energy_scale(result),
        "dissipated_J": float(result.dissipated[-1]),
        "largest_tension": provenance.get("largest_tension"),
        "largest_stored_tension_N": max(float(block.max(initial=0.0)) for block in blocks(result.tension)),
        "deployment": asdict(measures) if measures else None,
        "engine": {k: v for k, v in provenance.items() if k not in ("text", "title")},
    }
    if isinstance(check, str):
        summary["check"] = {"refused": check}
    elif check is not None:
        summary["check"] = _found(check)
    return summary


def _body(body: BodyStates) -> dict[str, float]:
    way = np.linalg.norm(body.position[-1] - body.position[0])
    return {"mass_kg": body.mass, "displacement_m": float(way)}


def _found(agreement: Agreement) -> dict[str, Any]:
    return {
        "agrees_until_s": agreement.agrees_until,
        "agrees_to_the_end": agreement.agrees_until is None,
        "apart_from_s": agreement.apart_from,
        "compared_until_s": float(agreement.time[-1]),
        "allowed_speed_difference_m_s": agreement.allowed,
        "allowed_position_difference_m": agreement.allowed_position,
        "largest_speed_difference_m_s": float(agreement.speed_difference.max()),
        "largest_position_difference_m": float(agreement.position_difference.max()),
        "before": _before(agreement),
    }


def _before(agreement: Agreement) -> dict[str, float]:
    """Largest differences while the two agree."""
    until = agreement.agrees_until
    agreeing = agreement.time < until if until is not None else slice(None)
    return {
        "speed_difference_m_s": float(agreement.speed_difference[agreeing].max(initial=0.0)),
        "position_difference_m": float(agreement.position_difference[agreeing].max(initial=0.0)),
    }


def write_summary(summary: dict[str, Any], path: Path) -> None:
    """Write summary.json, whole or not at all; a number that is not finite is an error, not a value."""
    with replacing(path) as part:
        part.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows (name, value with unit) of the table at the end of a run."""
    engine = summary["engine"]
    setting = (
        f"tolerance {engine['tolerance']:.3g}" if engine.get("tolerance") else f"step {engine['step']:.4g} s"
    )
    steps = f"{engine['steps']} accepted, {engine['rejected_steps']} rejected"
    wall = f"{engine['build_seconds']:.2f} s build, {engine['integration_seconds']:.2f} s integration"
    table = [
        ("verdict", summary["verdict"]),
        ("nodes, elements", f"{summary['nodes']}, {summary['elements']}"),
        ("mass", f"{summary['mass_kg']:.6f} kg"),
        *_body_rows(summary["bodies"]),
        ("method", f"{engine['method']}, {setting}"),
        ("steps", steps),
        ("right-hand sides", f"{engine['right_hand_sides']}"),
        ("wall time", wall),
        *_part_row(summary),
        (
            "energy balance",
            f"{summary['energy_balance']:.1e} of {summary['energy_scale_J']:.6g} J in deformation",
        ),
        ("largest tension", _peak(summary)),
    ]
    if broken := engine.get("broken"):
        first, worst = broken[0], max(one["energy_excess"] for one in broken)
        words = f"{len(broken)} element(s), first {first['element']} at t = {first['time_s']:.6g} s"
        table.append(("broken", f"{words}; held at most {worst:.2%} more energy than at the limit"))
    table += [("note", note) for note in engine.get("notes", [])]
    return table + _deployment_rows(summary["deployment"]) + _check_rows(summary.get("check"))


def _body_rows(bodies: dict[str, dict[str, float]]) -> list[tuple[str, str]]:
    return [
        (f"body {name}", f"{one['mass_kg']:.6g} kg, at the end {one['displacement_m']:.4g} m from its start")
        for name, one in bodies.items()
    ]


def _part_row(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """A heading for the rows about the stored states, which do not reach the end of a run that stopped."""
    if summary["complete"]:
        return []
    until = summary["simulated_until_s"]
    return [("stored states", f"until t = {until:.6g} s; the rows below refer to them")]


def _peak(summary: dict[str, Any]) -> str:
    peak = summary["largest_tension"]
    if not peak:
        return f"{summary['largest_stored_tension_N']:.4g} N at the stored times"
    if peak["element"] < 0:
        return "0 N: no element was ever taut"
    return f"{peak['tension_N']:.4g} N in element {peak['element']} at t = {peak['time_s']:.6g} s"


def _deployment_rows(measures: dict[str, Any] | None) -> list[tuple[str, str]]:
    if not measures:
        return [("deployment", "no mouth: not defined for this topology")]
    end = ", at the end of the run: still growing?" if measures["at_end"] else ""
    return [
        (
            "largest area",
            f"{measures['largest_area']:.3f} m2 ({measures['relative_area']:.1%} of the reference{end})",
        ),
        ("time of largest area", f"{measures['time_of_largest']:.3f} s"),
        ("distance travelled", f"{measures['distance']:.4g} m (centre of mass, until then)"),
        ("area above 80 %", f"during {measures['time_open']:.3f} s"),
    ]


def _check_rows(check: dict[str, Any] | None) -> list[tuple[str, str]]:
    if not check:
        return []
    if refused := check.get("refused"):
        return [("check", f"refused: {refused}")]
    until = "the end" if check["agrees_to_the_end"] else f"t = {check['agrees_until_s']:.3f} s"
    before = check["before"]
    return [
        (
            "check: agrees until",
            f"{until} (bullet speeds within {check['allowed_speed_difference_m_s']:.1e} m/s, "
            f"positions within {check['allowed_position_difference_m']:.1e} m)",
        ),
        (
            "check: until then",
            f"speeds within {before['speed_difference_m_s']:.1e} m/s, "
            f"positions within {before['position_difference_m']:.1e} m",
        ),
        *_apart_row(check["apart_from_s"]),
    ]


def _apart_row(apart_from: float | None) -> list[tuple[str, str]]:
    if apart_from is None:
        return []
    words = f"from t = {apart_from:.3f} s (earlier disagreement is that of single instants within a snap)"
    return [("check: apart for good", words)]

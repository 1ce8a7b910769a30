"""The numbers of a run that a user reads first: one dictionary for summary.json and for the table.

Numbers with a unit have it at the end of their name (_s, _m, _m2, _m_s, _kg, _N, _J); all others have none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.base.files import replacing
from exunet.forces.contact.status import NODES, THREADS
from exunet.net.arrays import Net
from exunet.results.comparison import Agreement, ComparedBreaks
from exunet.results.ensemble import Ensemble
from exunet.results.loads import PACKED, carried_until
from exunet.results.measures import (
    all_have_lines,
    energy_balance,
    energy_divisor,
    energy_scale,
    momentum_books,
    moving_mass,
)
from exunet.results.metrics import Metric, metrics_of
from exunet.results.observables import Observables, touched_bodies
from exunet.results.outcome import summary_of_capture
from exunet.results.penetration import overlaps, threads_inside
from exunet.results.result import BodyStates, Result
from exunet.results.run_record import RunRecord, summary_of_script

_SAME = 1e-3  # [s]: a contact is not listed beside the event of a script that waited for it
STANDARD_GRAVITY = 9.80665  # m/s2, which relates a specific impulse in seconds to a speed


@takes(result=Result, check=(Agreement, str), ensemble=(Ensemble, str))
def summarise(
    result: Result, check: Agreement | str | None = None, ensemble: Ensemble | str | None = None
) -> dict[str, Any]:
    """Collect the numbers of a result, ready for JSON; docs/reference/results.md has the meaning of each key.

    check    : outcome of the comparison with the reference, or why it is missing
    ensemble : of perturbed runs, or why they are missing
    """
    return summary_of(Observables(result), check, ensemble)


def summary_of(
    run: Observables, check: Agreement | str | None, ensemble: Ensemble | str | None
) -> dict[str, Any]:
    """Collect the numbers of a result from observables that are computed already in part."""
    result, record = run.result, run.result.run
    return {
        "title": record.title,
        "case": record.case.name,
        "overrides": list(record.case.overrides),
        "verdict": result.verdict,
        "end_s": record.end,
        "simulated_until_s": float(result.time[-1]),
        "nodes": result.net.n_nodes,
        "elements": result.net.n_elements,
        "mass_kg": float(result.net.mass.sum()),
        **({"mass_of_all_kg": moving_mass(result)} if result.bodies else {}),
        "bodies": {name: _body(result.net, body) for name, body in result.bodies.items()},
        "effects": list(record.effects),
        "energy": {
            "initial_J": float(result.kinetic[0] + result.elastic[0] + result.potential[0]),
            "scale_J": energy_divisor(result),
            "scale_of": "deformation" if energy_scale(result) else "motion",
            "balance_error": energy_balance(result),
        },
        **({"momentum": _momentum(result)} if result.bodies else {}),
        "attachments": _attachments(run),
        "metrics": summary_of_metrics(metrics_of(run), ensemble if isinstance(ensemble, Ensemble) else None),
        "ensemble": _ensemble(ensemble),
        "achievable_area_m2": run.achievable_area or None,
        **({} if (capture := _capture(run, ensemble)) is None else {"capture": capture}),
        "overlaps": [
            {"bodies": list(item.bodies), "from_s": item.start, "until_s": item.end, "times": item.times}
            for item in overlaps(result)
        ],
        "threads_inside": [
            {"body": item.body, "elements": item.elements, "first_s": item.time, "element": item.element}
            for item in threads_inside(result, but=touched_bodies(result, (THREADS, NODES)))
        ],
        "broken": [event.as_json() for event in record.breaks] if record.can_break else None,
        "timeline": [{"time_s": event.time, "event": event.name} for event in timeline(run)],
        "script": summary_of_script(record),
        "control": _control(run),
        "method": _method(record),
        "cost": _cost(record),
        "retries": [asdict(retry) for retry in record.retries],
        "notes": [] if record.plan is None else list(record.plan.notes),
        "check": summary_of_agreement(check) if isinstance(check, Agreement) else _refused(check),
        # What `exunet run` fills in, the latter three with finer runs and --estimate-error.
        "implausible": [],
        "step": None,
        "divisions": None,
        "error_estimate": None,
        "versions": dict(record.versions),
        "platform": record.platform,
    }


def _method(record: RunRecord) -> dict[str, Any]:
    plan, names = record.plan, ("name", "tolerance", "step_s", "backend")
    values = [None] * 4 if plan is None else [plan.method, plan.tolerance, plan.step, plan.backend]
    return {**dict(zip(names, values, strict=True)), "items": dict(record.items)}


def _cost(record: RunRecord) -> dict[str, float | None]:
    cost = dict.fromkeys(asdict(record.cost)) if record.plan is None else asdict(record.cost)
    return {name.replace("seconds", "s"): value for name, value in cost.items()}


class EventSummary(NamedTuple):
    """Event of a run: time [s], name, and of a script's entry what it did and why."""

    time: float
    name: str
    action: str = ""
    cause: str = ""


def timeline(run: Observables) -> list[EventSummary]:
    """Return events of the script, first contacts of the net, and the first break, in order."""
    record = run.result.run
    events = [EventSummary(item.time_s, item.entry, item.event, item.cause) for item in record.done]
    if not events:
        events = [EventSummary(item.time_s, "ejection") for item in record.ejections]
    for body in run.touched_bodies:
        first = run.first_contact(body)
        if first is not None and all(abs(first - event.time) > _SAME for event in events):
            events.append(EventSummary(first, f"contact with {body}"))
    if broken := record.breaks:
        item = min(broken, key=lambda item: item.time_s)
        events.append(EventSummary(item.time_s, "first break", f"element {item.element}"))
    return sorted(events)


def summary_of_metrics(own: Mapping[str, Metric], ensemble: Ensemble | None) -> dict[str, Any]:
    """Return values of a run, with time and place, and the range of perturbed runs, by key."""
    keys = dict.fromkeys([*own, *(ensemble.metrics if ensemble is not None else ())])
    found = {}
    for key in keys:
        metric, bounds = own.get(key), None if ensemble is None else ensemble.range(key)
        about = metric or ensemble.about[key]  # type: ignore[union-attr]
        found[key] = {
            "words": about.words,
            "unit": about.unit,
            "text": str(metric if bounds is None else bounds),
            "value": None if metric is None else metric.value,
            "time_s": None if metric is None else metric.time,
            "place": about.place or None,
            "remark": about.remark or None,
            "range": None
            if bounds is None
            else {"runs": bounds.runs, "median": bounds.median, "low": bounds.low, "high": bounds.high},
        }
    return found


def _ensemble(ensemble: Ensemble | str | None) -> dict[str, Any] | None:
    """Which runs the ranges are of, or why it has no ranges; None if none were requested."""
    if not isinstance(ensemble, Ensemble):
        return _refused(ensemble)
    record, plan = ensemble.run, _method(ensemble.run)
    return {
        "runs": ensemble.runs,
        "move_m": record.move_m,
        "seed": record.seed,
        "method": plan["name"],
        "tolerance": plan["tolerance"],
        "step_s": plan["step_s"],
        "endings": [asdict(item) for item in record.endings],
    }


def _capture(run: Observables, ensemble: Ensemble | str | None) -> dict[str, Any] | None:
    """Outcome of this run and of perturbed runs; None of a case without [capture]."""
    found = summary_of_capture(run)
    if found is not None and isinstance(ensemble, Ensemble):
        found["perturbed_runs"] = dict(ensemble.run.outcomes)
    return found


def _body(net: Net, body: BodyStates) -> dict[str, float]:
    nodes = 0.0 if body.nodes is None else float(net.mass[body.nodes].sum())
    return {"mass_kg": body.mass, "mass_of_nodes_kg": nodes}


def _attachments(run: Observables) -> dict[str, list[dict[str, Any]]]:
    """Where threads pull on each body, and how the metrics of each place begin."""
    found: dict[str, list[dict[str, Any]]] = {}
    for place in run.attachments:
        until = min(carried_until(run.result.run), float(run.time[-1])) if place.node == PACKED else None
        node = None if place.node == PACKED else place.node
        entry = {"node": node, "packed_net_until_s": until, "metrics": f"attachment_{place.name}"}
        found.setdefault(place.body, []).append(entry)
    return found


def _momentum(result: Result) -> dict[str, float | bool]:
    """Balances of the momentum, and of the angular momentum about the origin."""
    units = {"linear": "kg_m_s", "angular": "kg_m2_s"}
    numbers = {
        f"{name}_{entry}_{units[name]}": value
        for name, book in momentum_books(result).items()
        for entry, value in book._asdict().items()
    }
    return {**numbers, "residual_is_error": all_have_lines(result)}


def _control(run: Observables) -> dict[str, Any] | None:
    """Impulse of each corner unit and of all, and the propellant for it; None of a case without units."""
    about = run.result.run.units
    if about is None or run.spent is None:
        return None
    spent, specific = run.spent[-1].tolist(), about.specific_impulse

    def propellant(impulse: float) -> float | None:
        return None if specific is None else impulse / (STANDARD_GRAVITY * specific)

    units = [
        {"bullet": bullet, "impulse_N_s": value, "propellant_kg": propellant(value), "metrics": f"unit_{k}"}
        for k, (bullet, value) in enumerate(zip(about.bullets, spent, strict=True))
    ]
    return {
        "kind": about.kind,
        "period_s": about.period,
        "units": units,
        "impulse_N_s": sum(spent),
        "work_J": float(run.work_of_units[-1]),
        "propellant_kg": propellant(sum(spent)),
    }


def _refused(reason: str | None) -> dict[str, str] | None:
    return None if reason is None else {"refused": reason}


def summary_of_agreement(agreement: Agreement) -> dict[str, Any]:
    """Return the comparison of two runs, for summary.json."""
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
        "bodies": {
            name: {
                "agrees_until_s": one.agrees_until,
                "allowed_position_m": one.allowed_position,
                "allowed_attitude_rad": one.allowed_attitude,
                "position_m": float(one.position.max()),
                "velocity_m_s": float(one.velocity.max()),
                "attitude_rad": float(one.attitude.max()),
                "angular_velocity_rad_s": float(one.angular_velocity.max()),
            }
            for name, one in agreement.bodies.both.items()
        },
        "broken": _breaks(agreement.broken),
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

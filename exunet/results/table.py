"""The table that a run prints: its summary and metrics in rows of words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from exunet.forces.corner_units import NAME as UNITS
from exunet.forces.from_outside import FIXED_NODES, SCRIPT
from exunet.results import script_record
from exunet.results.ensemble import Ensemble, words_of_endings
from exunet.results.metrics import Metric, printed
from exunet.results.summary import COMPLETE

Rows = list[tuple[str, str]]


def rows(
    summary: dict[str, Any],
    metrics: Mapping[str, Metric] | None = None,
    ensemble: Ensemble | str | None = None,
) -> Rows:
    """Return rows (name, value with unit) of the table at the end of a run.

    metrics, ensemble : those of the summary
    """
    method, cost = summary["method"], summary["cost"]
    setting = (
        f"tolerance {method['tolerance']:.3g}" if method["tolerance"] else f"step {method['step_s']:.4g} s"
    )
    table = [
        ("verdict", summary["verdict"]),
        ("nodes, elements", f"{summary['nodes']}, {summary['elements']}"),
        ("mass", mass_words(summary["mass_kg"], summary.get("mass_of_all_kg"), _of_nodes(summary["bodies"]))),
        *[
            (f"body {name}", f"{body['mass_kg']:.6g} kg{_nodes(body)}")
            for name, body in summary["bodies"].items()
        ],
        ("method", f"{method['name']}, {setting}"),
        ("steps", f"{cost['steps']} accepted, {cost['rejected_steps']} rejected"),
        ("right-hand sides", f"{cost['right_hand_sides']}"),
        ("wall time", f"{cost['build_s']:.2f} s build, {cost['integration_s']:.2f} s integration"),
    ]
    if summary["verdict"] != COMPLETE:
        until = summary["simulated_until_s"]
        table.append(("stored states", f"until t = {until:.6g} s; the rows below refer to them"))
    table += _balance_rows(summary)
    if broken := summary["broken"]:
        first, worst = broken[0], max(item["energy_excess"] for item in broken)
        words = f"{len(broken)} element(s), first {first['element']} at t = {first['time_s']:.6g} s"
        table.append(("broken", f"{words}; held at most {worst:.2%} more energy than at the limit"))
    table += script_record.rows(summary["script"]) + _control_rows(summary["control"])
    table += _capture_rows(summary) + _without_contact(summary)
    table += [("note", note) for note in summary["notes"]]
    return table + _metric_rows(metrics or {}, ensemble) + _check_rows(summary["check"])


def _metric_rows(metrics: Mapping[str, Metric], ensemble: Ensemble | str | None) -> Rows:
    """Return a row for each metric, or for each vector of metrics, and which runs the ranges are of."""
    runs = ensemble if isinstance(ensemble, Ensemble) else None
    every = dict(metrics) | {
        key: one for key, one in (runs.about if runs else {}).items() if key not in metrics
    }
    shown = sorted((one for one in every.values() if not one.detail), key=lambda one: one.balance)
    table: Rows = []
    for row, group in groupby(shown, lambda one: one.row):
        parts = list(group)
        if parts[0].balance and not any(name == "balances" for name, _ in table):
            table.append(("balances", _BALANCES))
        if row:
            table.append((row, _vector(parts, metrics, runs)))
        else:
            table += [(one.words, _words(one, metrics, runs)) for one in parts]
    if runs is None:
        why = "disabled" if ensemble is None else ensemble
        return [*table, ("perturbed runs", f"{why}: results are from a single run")]
    ends = words_of_endings(runs.provenance.get("endings", []))
    return [
        *table,
        ("ranges", runs.sensitivity()),
        *([("ended", f"of {runs.runs} runs: {ends}")] if ends else []),
    ]


_BALANCES = (
    "gained from the start, before a throw then, to the end; all energies gained add up to the works less "
    "what is dissipated"
)


def _words(one: Metric, metrics: Mapping[str, Metric], runs: Ensemble | None) -> str:
    """Return median and range over perturbed runs, or the value of the run, with place and remark."""
    spread = None if runs is None else runs.range(one.key)
    own = metrics.get(one.key)
    words = str(one) if spread is None else str(spread)
    remarks = [remark for remark in (one.place, one.remark) if remark]
    if runs is not None and spread is None:
        remarks.append("of this run only")
    if own is None:
        remarks.append("not available for this run")
    elif spread is not None and not spread.known and not spread.low <= own.value <= spread.high:
        remarks.append(f"this run {own}")
    return f"{words} ({'; '.join(remarks)})" if remarks else words


def _vector(parts: list[Metric], metrics: Mapping[str, Metric], runs: Ensemble | None) -> str:
    """Return the components of a vector in one row."""
    spreads = [None if runs is None else runs.range(part.key) for part in parts]
    ranges = [spread for spread in spreads if spread is not None]
    if len(ranges) == len(parts) and not all(spread.known for spread in ranges):
        words = "; ".join(f"{part.name[-1]}: {spread}" for part, spread in zip(parts, ranges, strict=True))
        return f"{words} ({parts[0].remark})"
    values = [metrics[part.key].value if part.key in metrics else math.nan for part in parts]
    if len(ranges) == len(parts):
        values = [spread.median for spread in ranges]
    last = parts[0].last_digit(math.hypot(*values))
    return f"({', '.join(printed(value, last) for value in values)}) {parts[0].unit} ({parts[0].remark})"


def _control_rows(control: Mapping[str, Any] | None) -> Rows:
    if control is None:
        return []
    each = ", ".join(f"{item['impulse_N_s']:.4g}" for item in control["units"])
    words = f"by {control['kind']}; units: {len(control['units'])}, which spent {each} N s in this run"
    if control["propellant_kg"] is not None:
        words += f"; propellant {control['propellant_kg']:.3g} kg in all, which stays in their mass"
    return [("control", words)]


def _capture_rows(summary: dict[str, Any]) -> Rows:
    """Return the outcome of a capture."""
    found = summary.get("capture")
    if found is None:
        return []
    rule = ", ".join(
        f"{_CONDITIONS[name][0]} {_CONDITIONS[name][1]} {item['bound']:g}{_CONDITIONS[name][2]}"
        f" (at the end {item['at_end']:.3g}{', missed' if item['since_s'] is None else ''})"
        for name, item in found["conditions"].items()
    )
    words = f"{found['target']} {found['outcome']}"
    if found["since_s"] is not None:
        words += f"; the conditions hold from t = {found['since_s']:.6g} s on"
    words += f" (criterion: {rule}, for {found['duration_s']:g} s until the end)"
    if runs := found.get("perturbed_runs"):
        counts = ", ".join(f"{number} {name}" for name, number in runs.items())
        words += f"; of {sum(runs.values())} perturbed runs: {counts}"
    return [("capture", words)]


_CONDITIONS = {
    "enclosed": ("enclosed", ">=", ""),
    "relative_speed_m_s": ("relative speed", "<=", " m/s"),
    "relative_spin_rad_s": ("relative spin", "<=", " rad/s"),
    "cqi": ("CQI", "<=", ""),
    "mcqi": ("MCQI", "<=", ""),
    "mouth_m": ("mouth", "<=", " m"),
    "touching": ("elements that touch", ">=", ""),
}


def _balance_rows(summary: dict[str, Any]) -> Rows:
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
        lines = [giver for giver in givers if f"effect_{giver}_impulse_x_N_s" in summary["metrics"]]
        words = f"changes by at most {_short(gained)} {unit}"
        if lines:
            words += f", by no more than {_short(left)} {unit} beside the impulse of {' and '.join(lines)}"
        why = "error" if lines or books["residual_is_error"] else "by forces from outside, or error"
        found.append((name, f"{words}{part} ({where}; {why}{_besides(summary)})"))
    return found


def _besides(summary: dict[str, Any]) -> str:
    given = [name for name in summary["bodies"] if f"body_{name}_work_J" in summary["metrics"]]
    return f"; besides what {' and '.join(given)} gave" if given else ""


def _short(value: float) -> str:
    return f"{value:.2g}" if value else "0"


def mass_words(net: float, of_all: float | None, fixed: float) -> str:
    """Masses [kg] of the net with tethers, of all with bodies (None without bodies), of nodes on bodies."""
    if of_all is None:
        return f"{net:.6f} kg"
    once = f", of which {fixed:.6g} kg are nodes fixed to bodies and count with these" if fixed else ""
    return f"{net:.6f} kg of the net{once}; {of_all:.8g} kg in all"


def _of_nodes(bodies: dict[str, dict[str, Any]]) -> float:
    return math.fsum(body["mass_of_nodes_kg"] for body in bodies.values())


def _nodes(body: dict[str, Any]) -> str:
    mass = body["mass_of_nodes_kg"]
    return f", of which {mass:.6g} kg are nodes of the net fixed to it" if mass else ""


def _check_rows(check: dict[str, Any] | None) -> Rows:
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


def _beside_rows(check: dict[str, Any]) -> Rows:
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


def _apart_row(apart_from: float | None) -> Rows:
    if apart_from is None:
        return []
    words = f"from t = {apart_from:.3f} s to the end (before, at single instants within a snap only)"
    return [("check: apart", words)]


def _without_contact(summary: dict[str, Any]) -> Rows:
    """A warning for each pair that overlapped while contact between the two is not enabled."""
    found = []
    for item in summary["overlaps"]:
        when = f"at t = {item['from_s']:.6g} s"
        if item["until_s"] > item["from_s"]:
            when = f"from t = {item['from_s']:.6g} s to {item['until_s']:.6g} s"
        often = f", {item['times']} times" if item["times"] > 1 else ""
        found.append(f"bodies {' and '.join(item['bodies'])} overlap {when}{often}")
    for entry in summary["threads_inside"]:
        when = f"first element {entry['element']} at t = {entry['first_s']:.6g} s"
        found.append(f"{entry['elements']} element(s) in or through body {entry['body']}, {when}")
    return [("no contact", f"{words}: contact between these is not enabled") for words in found]

"""`exunet check`: what a case would simulate, before it runs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.build import expected_items
from exunet.case.casefile import Case
from exunet.case.script_lint import timeline
from exunet.forces.closing import way_of
from exunet.forces.effects import EFFECTS, switched_on
from exunet.interfaces.commands.body_rows import body_rows, vector
from exunet.interfaces.commands.control_rows import control_rows
from exunet.interfaces.commands.estimates import estimated
from exunet.methods.method import METHODS, Kind, Method, NetForm, TimeLoop
from exunet.net.arrays import Net
from exunet.net.folding import THREAD_ROUND_OFF, folded, threads
from exunet.net.mesh_checks import nearest
from exunet.net.tether import EndKeys
from exunet.results.table import mass_words
from exunet.simulation.planning import turning_limit
from exunet.simulation.preparation import Start, prepare_case
from exunet.studies.both_codes import refusal
from exunet.system.stability import (
    WEAK_GROWTH,
    largest_damping_rate,
    largest_frequency,
    stable_step,
    step_limit,
)

Floats = NDArray[np.float64]
OUTSIDE = 1e-6  # [m] from a body's shape: an end of a tether that is farther from it is told


def describe(case: Case) -> list[tuple[str, str]]:
    """Rows (name, value): counts, mass, effects, stable steps, the engine's items, what a run would take."""
    start = prepare_case(case, hosted=True)
    net, plan = start.net, start.plan
    on = switched_on(case.scene.effects)
    off = [name for name in EFFECTS if name not in on]
    compiled = case.scene.engine.loop == TimeLoop.COMPILED
    items = "none: compiled loop" if compiled else _items(start)
    setting = f"tolerance {plan.tolerance:.3g}" if plan.tolerance is not None else f"step {plan.step:.4g} s"
    times = case.scene.time.stored_times
    return [
        ("topology", str(case.scene.net.topology)),
        ("nodes, elements", f"{net.n_nodes}, {net.n_elements} ({int(net.is_string.sum())} of strings)"),
        ("bullets, fixed nodes", f"{len(net.bullet_nodes)}, {len(net.fixed_nodes)}"),
        ("mass", _mass(start)),
        *body_rows(start),
        *_tethers(start),
        *_closing(start),
        *control_rows(start),
        *_script(start),
        ("packing", _packing(start)),
        ("simulated time", f"{case.scene.time.end:g} s, {len(times)} stored states"),
        ("effects on", ", ".join(on) or "none"),
        ("effects off", ", ".join(off) or "none"),
        ("method", f"{plan.method}, {setting}"),
        *[("note", note) for note in plan.notes],
        ("stable step", _stable_steps(start)),
        ("engine items", items),
        *_cost(case, start),
    ]


def _cost(case: Case, start: Start) -> list[tuple[str, str]]:
    """What a run would take, and its check if the reference knows what is in the case."""
    refused = refusal(case, start.scene)
    rows = estimated(start, thorough=True, check=not refused).rows()
    if refused:
        rows.append(("check", f"none: the reference refuses the case: {refused}"))
    return [(f"{name} of a run", words) for name, words in rows]


def _mass(start: Start) -> str:
    """Of the net and, where there are bodies, of all; nodes that are fixed to bodies count once."""
    system, net = start.system, float(start.net.mass.sum())
    if not (system.bodies or system.blocks.body):
        return mass_words(net, None, 0.0)
    fixed = float(start.net.mass[system.kinematics.point].sum())
    return mass_words(net, float(system.mass.sum() + system.body_mass.sum()), fixed)


def _packing(start: Start) -> str:
    """How the net lies at the start."""
    initial = start.scene.initial
    if start.begun_from is not None:
        return f"as in {start.begun_from['result']} at {start.begun_from['time_s']:g} s"
    if initial.node_positions is not None:
        return "as listed in initial.node_positions"
    if initial.fold is None:
        return f"{initial.deployed:g} of the reference configuration"
    found = folded(start.net, start.scene.net, initial.fold)
    size = " x ".join(f"{edge:.4g}" for edge in found.size)
    words = f"{initial.fold.pattern} fold ({found.pleats}), {found.layers} layers, {size} m"
    return f"{words}; {_threads_apart(start.net, found.position)}"


def _threads_apart(net: Net, position: Floats) -> str:
    """How near threads that share no node come to each other in a folded net, and where."""
    thread = float(threads(net).max())
    near = nearest(net, position, thread * (1.0 - THREAD_ROUND_OFF))
    if near is None:
        return f"threads without a common node lie a thread apart, {thread:.4g} m"
    one, other = near.elements.tolist()
    x, y, z = near.place.tolist()
    return (
        f"threads without a common node are at least {near.distance:.2g} m apart, from middle to middle: "
        f"elements {one} and {other}, at ({x:.4g}, {y:.4g}, {z:.4g}) m in the canister"
    )


def _tethers(start: Start) -> list[tuple[str, str]]:
    """A row for each tether: how long it is, what it joins, how far these are apart at the start."""
    found = []
    for tether in start.net.tethers:
        keys = start.scene.tethers[tether.name]
        apart = float(np.linalg.norm(start.position[tether.nodes[-1]] - start.position[tether.nodes[0]]))
        ends = f"{_tied(keys.start)} to {_tied(keys.end)}, {apart:g} m apart at the start"
        words = f"{keys.length:g} m, elements: {keys.divisions}, from {ends}"
        if (reel := keys.reel) is not None:
            drum = _tied(keys.start if reel.at == "start" else keys.end)
            out = keys.length if reel.paid_out is None else reel.paid_out
            words += f"; reel at {drum}, {out:g} m outside, commands: {len(reel.commands)}"
        words += "".join(_beside_body(start, end) for end in (keys.start, keys.end))
        found.append((f"tether {tether.name}", words))
    return found


def _beside_body(start: Start, end: EndKeys) -> str:
    """That an end is fixed to a point outside of its body's solids, which may be a slip."""
    body = next((one for one in start.system.bodies if one.name == end.body), None)
    if body is None or body.shape is None or not body.shape.solids or end.point is None:
        return ""
    away = min(float(solid.distance(np.array([end.point]))[0]) for solid in body.shape.solids)
    if away <= OUTSIDE:
        return ""
    return f"; the point {vector(np.array(end.point))} m of {end.body} is {away:.4g} m outside its shape"


def _closing(start: Start) -> list[tuple[str, str]]:
    """What closes the mouth: a line with its way and its winch, or threads that become shorter."""
    keys, line = start.scene.closing, start.system.line
    if keys is None:
        return []
    if line is None:
        return [("closing", f"the edge, from {keys.at:g} s on, to {keys.part:g} of its length")]
    way = float(way_of(line, start.position).sum())
    kind = "a loop" if line.path[0] == line.path[-1] else "open"
    words = (
        f"a line of {line.length:g} m, {kind}, nodes: {len(set(line.path))}, way at the start: {way:.4g} m"
    )
    if line.has_winch:
        words += f"; winch, to {line.shortest:g} m, commands: {len(line.times)}"
    return [("closing", words)]


def _script(start: Start) -> list[tuple[str, str]]:
    """Describe the script as a timeline."""
    rows, end = [], start.scene.time.end
    for planned in timeline(start.scene.script):
        words = f"{planned.when}: {planned.entry.name}: {planned.entry.action_words}"
        late = planned.time is not None and planned.time > end
        rows.append(("script", words + (f"; after the end of the run, {end:g} s" if late else "")))
    return rows


def _tied(end: EndKeys) -> str:
    if end.body is not None:
        return f"body {end.body}"
    return f"bullet {end.bullet}" if end.node is None else f"node {end.node}"


def _items(start: Start) -> str:
    engine = start.scene.engine
    items = expected_items(start.system, fused=engine.net == NetForm.FUSED)
    return ", ".join(f"{number} {kind}" for kind, number in items.items())


def _stable_steps(start: Start) -> str:
    frequency = largest_frequency(start.system)
    rate = largest_damping_rate(start.system)
    limits, common = [], (Method.VELOCITY_VERLET, Method.RK33, Method.RK44)
    for name in common:
        limit = stable_step(name, frequency, rate)
        if math.isinf(limit):  # of one method, and so of all
            return "any: nothing in the scene swings or is damped"
        limits.append(f"{limit:.4g} s ({name})")
    own = start.plan.method
    if METHODS[own].kind == Kind.EXPLICIT and own not in common:
        limit = step_limit(own, frequency, rate)
        limits.insert(0, f"{limit:.4g} s ({own}: a mode grows by {WEAK_GROWTH:.0%} a step)")
    turning = turning_limit(start.scene, start.system, start.state, start.plan)
    if not math.isinf(turning):
        limits.append(f"{turning:.4g} s ({own}: bodies that turn)")
    return ", ".join(limits)

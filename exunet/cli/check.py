"""`exunet check`: describe what a case would simulate."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator

import numpy as np
from rich.filesize import decimal

from exunet.base.arrays import Floats
from exunet.base.times import duration, reached
from exunet.bodies.rigid import in_frames
from exunet.bodies.rotations import rotation_matrix
from exunet.cli.output import print_table, status
from exunet.forces.closing import way_of
from exunet.forces.cores import SAMPLED
from exunet.forces.corner_units import Control, FormationControl, PointControl, TableControl, growth_of_error
from exunet.forces.effects import EFFECTS
from exunet.forces.effects.contact import Contact
from exunet.forces.estimate import EstimateBasis, hardest_strain
from exunet.integrators.exudyn.build import expected_items
from exunet.methods.method import METHODS, Backend, Kind, Method
from exunet.model.limits import (
    WEAK_GROWTH,
    describe_limit,
    largest_damping_rate,
    largest_frequency,
    stable_step,
    step_limit,
)
from exunet.net.arrays import Net
from exunet.net.closing import Perimeter
from exunet.net.folding import THREAD_ROUND_OFF, folded, threads
from exunet.net.tether import TetherEnd
from exunet.net.weave import nearest
from exunet.results.table import mass_words
from exunet.scene.casefile import Case, implausible
from exunet.scene.script import begins_control, timeline
from exunet.simulation.planning import rotation_limit
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.recorder import stored_bytes
from exunet.studies.both_codes import refusal
from exunet.studies.ensemble import MOVE, default_runs, member_bytes, repeats, wall_times

OUTSIDE = 1e-6  # [m] from a body's shape, beyond which the end of a tether is reported
_RELATIVE, _ABSOLUTE = 1e-12, 1e-15  # of the largest component, and in its unit: below it is round-off


LINES = 15  # that are printed without --all, warnings first
BRIEF = ("mass", "effects on", "method", "step", "note", "runs beside", "time", "reference")  # rows of these


def check(case: Case, *, every: bool) -> None:
    """Print what is implausible in a case, then what would be simulated; every: all of it."""
    with status("building the net, choosing its steps"):
        rows = describe(case)
    scene = case.scene
    tables = {"bodies": scene.bodies, "tethers": scene.tethers, "script entries": scene.script}
    counts = [f"{what}: {len(items)}" for what, items in tables.items() if items]
    nodes = f"nodes, elements: {dict(rows)['nodes, elements'].partition(' (')[0]}"
    warnings = [("!", str(fault)) for fault in implausible(case)]
    shown = rows if every else list(_brief(rows))
    title = f"{case.path} is valid; {'; '.join([nodes, *counts])}"
    print_table(title, [*warnings, *shown], most=None if every else LINES)


def _brief(rows: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Return the rows of `BRIEF`, shortened, notes last; those on the choice of a method are in "step"."""
    chosen = (*(f"auto: {method}" for method in Method), "Exudyn:")
    for name, words in sorted(rows, key=lambda row: row[0] == "note"):
        if name not in BRIEF or (name == "note" and words.startswith((*chosen, "step = "))):
            continue
        if name == "mass":
            words = re.sub(r", of which [^;]*", "", words)
        yield name, words.partition(" (")[0] if words.startswith("auto: ") else words


def describe(case: Case) -> list[tuple[str, str]]:
    """Return rows (name, value): counts, masses, effects, stable steps, engine items, cost of a run."""
    start = prepare_case(case, hosted=True)
    net, plan = start.net, start.plan
    on = case.scene.effects.on
    off = [name for name in EFFECTS if name not in on]
    compiled = start.plan.backend == Backend.COMPILED
    items = "none: compiled loop" if compiled else _items(start)
    if plan.step is None:
        setting = f"tolerance {plan.tolerance:.3g}"
    else:
        setting = f"{case.scene.time.end / plan.step:,.0f} steps of {plan.step:.4g} s"
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
        ("step", describe_limit(start.system, plan.method)),
        *[("note", note) for note in (*plan.notes, *_choice_of_law(start))],
        ("stable step", _stable_steps(start)),
        ("engine items", items),
        *_cost(case, start),
    ]


def _choice_of_law(start: Start) -> Iterator[str]:
    """Yield a note if, at the largest strain that a snap can make, the cable law changes tensions by 1 %."""
    net = start.net
    position, velocity = (part[: net.n_nodes] for part in (start.position, start.velocity))
    strain = hardest_strain(EstimateBasis(net, start.scene.time.end, position, velocity))
    by_formula = net.law_number is None or bool((net.law_number < 2).any())
    if by_formula and 1.5 * strain > 0.01:
        words = f"a snap can strain cables by {100.0 * strain:.2g} %, where the law of the paper and Hooke's"
        yield f"{words} differ by {150.0 * strain:.2g} % in tension: law = of the cables decides"


def _cost(case: Case, start: Start) -> list[tuple[str, str]]:
    """Return the disk and the memory that a run takes, and whether the reference can check it."""
    runs = default_runs(start)
    size, memory = stored_bytes(start), runs * member_bytes(start)
    ensemble = f"{runs} perturbed by up to {MOVE:.2g} m, with {decimal(memory)} of memory"
    rows = [
        ("disk", f"{decimal(size)} of stored states"),
        ("runs beside", ensemble),
        ("time", _time(start)),
    ]
    if refused := refusal(case, start.scene):
        rows.append(("reference", f"does not read this case: {refused}"))
    return rows


def _time(start: Start) -> str:
    """Describe the estimated wall times of the run and of its repeats."""
    times = wall_times(start)
    if isinstance(times, str):
        return times
    run, others = (duration(time) if time >= 1.0 else "below 1 s" for time in times)
    alone = run if start.plan.backend == Backend.COMPILED else "not estimated, in Exudyn"
    number = sum(runs for runs, _ in repeats(start))
    if start.scene.effects.get(Contact) is not None:
        return (
            f"run {alone} without touching, repeats {others}; several times that while threads touch a body"
        )
    return f"run {alone}, then {number} repeats {others} on {os.cpu_count()} cores"


def _mass(start: Start) -> str:
    """Describe the mass of the net and, with bodies, of the scene; nodes fixed to bodies count once."""
    system, net = start.system, float(start.net.mass.sum())
    if not system.bodies:
        return mass_words(net, None, 0.0)
    fixed = float(start.net.mass[system.kinematics.point].sum())
    return mass_words(net, float(system.mass.sum() + system.body_mass.sum()), fixed)


def _packing(start: Start) -> str:
    """Describe the initial configuration of the net."""
    initial = start.scene.initial
    if start.restart is not None:
        return f"as in {start.restart.result} at {start.restart.time_s:g} s"
    if initial.node_positions is not None:
        return "as listed in initial.node_positions"
    if initial.fold is None:
        return f"{initial.deployed:g} of the reference configuration"
    packed = folded(start.net, start.scene.net, initial.fold)
    size = " x ".join(f"{edge:.4g}" for edge in packed.size)
    fold = f"{initial.fold.pattern} fold ({packed.pleats}), {packed.layers} layers, {size} m"
    return f"{fold}; {_thread_distance(start.net, packed.position)}"


def _thread_distance(net: Net, position: Floats) -> str:
    """Describe the smallest distance of threads without a common node in a folded net, and where it is."""
    thread = float(threads(net).max())
    near = nearest(net, position, thread * (1.0 - THREAD_ROUND_OFF))
    if near is None:
        return f"threads without a common node lie a thread apart, {thread:.4g} m"
    first, second = near.elements.tolist()
    x, y, z = near.place.tolist()
    return (
        f"threads without a common node are at least {near.distance:.2g} m apart, from middle to middle: "
        f"elements {first} and {second}, at ({x:.4g}, {y:.4g}, {z:.4g}) m in the canister"
    )


def _tethers(start: Start) -> list[tuple[str, str]]:
    """Describe each tether: length, what it joins, their initial distance, reel."""
    rows, net = [], start.net
    for tether in net.tethers:
        keys = start.scene.tethers[tether.name]
        distance = float(np.linalg.norm(start.position[tether.nodes[-1]] - start.position[tether.nodes[0]]))
        ends = f"{_tied(keys.start, net)} to {_tied(keys.end, net)}, {distance:g} m apart at the start"
        text = f"{keys.length:g} m, elements: {keys.divisions}, from {ends}"
        if (reel := keys.reel) is not None:
            drum = _tied(keys.start if reel.at == "start" else keys.end, net)
            out = keys.length if reel.paid_out is None else reel.paid_out
            text += f"; reel at {drum}, {out:g} m outside, commands: {len(reel.commands)}"
        text += "".join(_beside_body(start, end) for end in (keys.start, keys.end))
        rows.append((f"tether {tether.name}", text))
    return rows


def _beside_body(start: Start, end: TetherEnd) -> str:
    """Report an end that is fixed to a point outside its body, probably by mistake."""
    body = next((body for body in start.system.bodies if body.name == end.body), None)
    if body is None or body.shape is None or not body.shape.solids or end.point is None:
        return ""
    distance = min(float(solid.distance(np.array([end.point]))[0]) for solid in body.shape.solids)
    if distance <= OUTSIDE:
        return ""
    return f"; the point {vector(np.array(end.point))} m of {end.body} is {distance:.4g} m outside its shape"


def _closing(start: Start) -> list[tuple[str, str]]:
    """Describe what closes the mouth: a line with its path and winch, or threads that become shorter."""
    keys, line = start.scene.closing, start.system.line
    if keys is None:
        return []
    if isinstance(keys, Perimeter):
        return [("closing", f"the edge, from {keys.at:g} s on, to {keys.part:g} of its length")]
    assert line is not None
    path = float(way_of(line, start.position).sum())
    kind = "a loop" if line.path[0] == line.path[-1] else "open"
    text = f"a line of {line.length:g} m, {kind}, nodes: {len(set(line.path))}, initial path: {path:.4g} m"
    if line.has_winch:
        text += f"; winch, to {line.shortest:g} m, commands: {len(line.times)}"
    return [("closing", text)]


def _script(start: Start) -> list[tuple[str, str]]:
    """Describe the script as a timeline."""
    rows, end = [], start.scene.time.end
    for planned in timeline(start.scene.script):
        words = f"{planned.when}: {planned.entry.name}: {planned.entry.action_words}"
        late = planned.time is not None and not reached(end, planned.time)
        rows.append(("script", words + (f"; after the end of the run, {end:g} s" if late else "")))
    return rows


def _tied(end: TetherEnd, net: Net) -> str:
    if end.body is not None:
        return f"body {end.body}"
    if end.node is None:
        return f"bullet {end.bullet}"
    return f"node {end.node}" if isinstance(end.node, int) else f"{end.node}, node {net.node(end.node)}"


def _items(start: Start) -> str:
    items = expected_items(start.system)
    return ", ".join(f"{number} {kind}" for kind, number in items.items())


def _stable_steps(start: Start) -> str:
    frequency = largest_frequency(start.system)
    rate = largest_damping_rate(start.system)
    limits, common = [], (Method.VELOCITY_VERLET, Method.RK33, Method.RK44)
    for name in common:
        limit = stable_step(name, frequency, rate)
        if math.isinf(limit):  # of one method, and so of all
            return "any: nothing in the scene oscillates or is damped"
        limits.append(f"{limit:.4g} s ({name})")
    own = start.plan.method
    if METHODS[own].kind == Kind.EXPLICIT and own not in common:
        limit = step_limit(own, frequency, rate)
        limits.insert(0, f"{limit:.4g} s ({own}: a mode grows by {WEAK_GROWTH:.0%} a step)")
    turning = rotation_limit(start.scene, start.system, start.state, start.plan)
    if not math.isinf(turning):
        limits.append(f"{turning:.4g} s ({own}: bodies that turn)")
    return ", ".join(limits)


def body_rows(start: Start) -> list[tuple[str, str]]:
    """Describe rigid bodies by mass, centre, principal axes and initial motion."""
    system, state = start.system, start.state
    rows, states = [], in_frames(system.bodies, state.bodies)
    for k, body in enumerate(system.bodies):
        name, spin = body.name, states.angular_velocity[k]
        moments = ", ".join(f"{moment:g}" for moment in body.inertia)
        axes = ", ".join(map(vector, np.round(body.rotation.T, 6)))
        moving = _motion(states.position[k], states.velocity[k])
        in_scene = vector(rotation_matrix(states.attitude[k]) @ spin)
        rows += [
            (f"body {name}", f"{body.mass:g} kg, {start.scene.bodies[name].motion}{_attached(start, k)}"),
            (f"{name}: centre of mass", f"at {vector(np.array(body.centre))} m in the body's frame"),
            (
                f"{name}: inertia",
                f"{moments} kg m2 about the centre of mass and the principal axes {axes} of the body's frame",
            ),
            (
                f"{name}: at the start",
                f"centre of mass {moving}; turns at {vector(spin)} rad/s in the body's axes, "
                f"{in_scene} rad/s in the scene's",
            ),
        ]
    for name, surface in system.blocks.surfaces.items():
        if surface.cores.kind[0] == SAMPLED:
            samples, size = surface.cores.samples, surface.cores.samples.size / 1024**2
            words = (
                f"beside inner edges the distance is sampled each {samples.cell:.3g} m, {size:.3g} MB, up to "
            )
            rows.append((f"{name}: contact", f"{words}{surface.error:.2g} m off"))
    return rows


def vector(values: Floats) -> str:
    """Format a vector; components that are round-off are zero."""
    size = float(np.abs(values).max(initial=0.0))
    kept = np.where(np.abs(values) > max(_RELATIVE * size, _ABSOLUTE), values, 0.0)
    return "(" + ", ".join(f"{value:g}" for value in kept) + ")"


def _attached(start: Start, body: int) -> str:
    """Describe the nodes fixed to a body: their mass is part of its mass."""
    kinematics = start.system.kinematics
    nodes, words = kinematics.point[kinematics.body == body], ""
    if len(nodes):
        mass = float(start.net.mass[nodes].sum())
        words = f"; {mass:g} kg of it are nodes fixed to it: {', '.join(map(str, nodes.tolist()))}"
    ties = [tie for tie in kinematics.ties.values() if tie.body == body and tie.start]
    if ties:
        every = ", ".join(f"{tie.points[0]} ({tie.tie})" for tie in ties)
        words += f"; fixed to it until a script releases them: node {every}"
    return words


def _motion(position: Floats, velocity: Floats) -> str:
    return f"at {vector(position)} m with {vector(velocity)} m/s in the scene's axes"


def control_rows(start: Start) -> list[tuple[str, str]]:
    """Describe the corner units: law, samples, limits, stability of their sampled control."""
    keys = start.scene.control
    if keys is None:
        return []
    bullets = ", ".join(map(str, keys.bullets))
    rows = [
        ("control", f"{_law(keys)}; units: bullets {bullets}"),
        ("control: samples", _samples(keys, start, scripted=begins_control(start.scene.script))),
        ("control: limits", _limits(keys)),
    ]
    lightest = float(start.net.mass[start.net.bullet_nodes[list(keys.bullets)]].min())
    growth = growth_of_error(keys, lightest)
    if growth is not None:
        verdict = "unstable: choose a shorter period, or weaker gains" if growth > 1.0 else "stable"
        words = f"of a free unit of {lightest:.4g} kg, by a factor of {growth:.4g} from sample to sample"
        rows.append(("control: an error", f"{words}: {verdict}"))
    return rows


def _law(keys: Control) -> str:
    if isinstance(keys, TableControl):
        return f"table, {len(keys.time)} times from {keys.time[0]:g} s to {keys.time[-1]:g} s"
    if not isinstance(keys, PointControl | FormationControl):
        return "given: a function from Python"
    place = "the units' mean" if keys.body is None else f"body {keys.body}"
    if isinstance(keys, PointControl) and keys.point is not None:
        place = f"({', '.join(f'{value:g}' for value in keys.point)}) m"
    gains = f"{keys.stiffness:g} N/m, {keys.damping:g} N s/m"
    return f"{keys.kind}, {'to' if keys.kind == 'point' else 'about'} {place}; {gains}"


def _samples(keys: Control, start: Start, *, scripted: bool) -> str:
    begin, end = (
        "from the script's entry on" if scripted else f"from {keys.start:g} s on",
        start.scene.time.end,
    )
    words = f"every {keys.period:g} s, {begin}"
    if keys.start + keys.period > end:
        words += f": one at most, since the run ends at {end:g} s"
    if keys.noise is None:
        return f"{words}; no noise"
    noise = keys.noise
    return f"{words}; noise of {noise.position:g} m, {noise.velocity:g} m/s, seed {noise.seed}"


def _limits(keys: Control) -> str:
    words = f"at most {keys.largest_thrust:g} N a unit, direction: {keys.direction}"
    if keys.minimum_impulse > 0.0:
        least = keys.minimum_impulse / keys.period
        words += f"; below {keys.minimum_impulse:g} N s in a period ({least:g} N) nothing is fired"
    if keys.specific_impulse is not None:
        words += f"; specific impulse {keys.specific_impulse:g} s, masses stay as they are"
    return words

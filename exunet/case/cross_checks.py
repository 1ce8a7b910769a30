"""What the keys of a case demand of each other: plain functions, the second phase of checking.

The first phase, pydantic's, looks at each key by itself. These functions take its result, a Scene, or, of a
case that has faults, the valid part of one: to ask there for a key that is not valid raises Unknown, which
ends the check that needs it and no other (exunet.base.faults.each).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from exunet import net
from exunet.base.errors import Fault
from exunet.base.faults import each, exactly_one, inside, shortened, within
from exunet.bodies import cross_checks as bodies
from exunet.case import script, script_lint, verdict
from exunet.case.scene import Launch, NetFrame, Scene
from exunet.forces import control_keys, effects
from exunet.forces.requirements import RestOfCase, replaces_launch
from exunet.methods import keys as solver
from exunet.methods.method import COMPILED_METHODS, TimeLoop
from exunet.net import closing, explicit, folding, tether
from exunet.net.base import ThrownNetTable, other_length

MAX_STATES = 10_000_000


def cross_checks(scene: Scene) -> Iterator[Fault]:
    """Every fault between keys, at the key that is to be changed."""
    yield from each(
        exactly_one(scene),
        _states_fit(scene),
        shortened(_times_within_the_run(scene)),
        shortened(_times_increase(scene)),
        _loop_has_the_method(scene),
        _ports_are_compiled(scene),
        _positions_in_place_of_packing(scene),
        _not_with_a_state(scene),
        _net_can_be_folded(scene),
        _net_on_a_body(scene),
        _list_fits_the_net(scene, "node_positions"),
        _list_fits_the_net(scene, "node_velocities"),
        inside(scene, "solver", solver.cross_checks),
        inside(scene, "net", net.cross_checks),
        inside(scene, "launch", _one_form),
        _launch_has_bullets(scene),
        _bodies(scene),
        _tethers(scene),
        _reels(scene),
        inside(scene, "closing", closing.cross_checks),
        _name_of_the_line(scene),
        _control(scene),
        _choice(scene),
        within("effects", effects.cross_checks(scene)),
        _verdict(scene),
        _script(scene),
    )


def _verdict(scene: Scene) -> Iterator[Fault]:
    contact = getattr(scene.effects, "contact", None)
    touched = frozenset(() if contact is None else (*contact.threads, *contact.nodes))
    has_mouth = scene.net.topology != "explicit"
    yield from verdict.cross_checks(scene.verdict, scene.bodies, touched, has_mouth=has_mouth)


def _script(scene: Scene) -> Iterator[Fault]:
    if scene.script:
        faults = list(script_lint.entry_faults(scene.script, _stage(scene)))
        yield from faults
        wrong = {fault.path[1] for fault in faults}
        sound = [None if k in wrong else one for k, one in enumerate(scene.script)]
        yield from script_lint.conflicts(sound)


def _stage(scene: Scene) -> script_lint.Stage:
    """What of the scene a script may look at and act on."""
    line = scene.closing if scene.closing is not None and scene.closing.kind == "line" else None
    reels = {name: one.reel for name, one in scene.tethers.items() if one is not None and one.reel}
    drives = reels | ({closing.NAME: line.winch} if line is not None and line.winch is not None else {})
    has = {
        "target": scene.verdict is not None,
        "mouth": scene.net.topology != "explicit",
        "tethers": bool(scene.tethers),
        "line": line is not None,
        "contact": getattr(scene.effects, "contact", None) is not None,
        "thrust": getattr(scene.effects, "thrust", None) is not None,
        "control": scene.control is not None,
    }
    return script_lint.Stage(
        frozenset(name for name, there in has.items() if there),
        {name: one.damping for name, one in drives.items()},
        {name: one.rate_limit for name, one in drives.items()},
        frozenset(name for name, one in drives.items() if one.commands),
        frozenset(scene.tethers) - frozenset(reels),
        script_lint.settable(scene, drives),
        _ties(scene),
        _why_not_ejected(scene),
        scene.time.end,
    )


def _ties(scene: Scene) -> dict[str, str]:
    """What is fixed to bodies, by the names that a script has for it, and why it cannot be released."""
    bodies_of = {name: one for name, one in scene.bodies.items() if one is not None}
    ports, found = [name for name, one in bodies_of.items() if one.motion == "port"], dict[str, str]()
    port = "is fixed to a port, whose mass its host counts: nothing is released from it"
    for name, body in bodies_of.items():
        for label in body.attachments:
            found[f"bodies.{name}.attachments.{label}"] = port if name in ports else ""
    for name, tether_keys in scene.tethers.items():
        for end in ("start", "end") if tether_keys is not None else ():
            body_name, reel = getattr(tether_keys, end).body, tether_keys.reel
            drum = f"has the drum of the tether: release the other end, or pay out {name!r}"
            why = drum if reel is not None and reel.at == end else port if body_name in ports else ""
            if body_name is not None:
                found[f"tethers.{name}.{end}"] = why
    return found


def _why_not_ejected(scene: Scene) -> str:
    """Why no body holds the net until a script ejects it; "": one does."""
    frame = scene.initial.frame
    if frame is None:
        return "no body holds the net: [initial.frame] names one"
    if frame.is_given("eject_at"):
        return "initial.frame.eject_at ejects the net: remove it, or this entry"
    if frame.body in scene.bodies and scene.bodies[frame.body].motion == "port":
        return f"body {frame.body!r} is a port, which ejects a net at a time known to its host: give eject_at"
    if isinstance(scene.net, explicit.Keys) and scene.net.fixed:
        return "a net that a body holds until then has no net.fixed nodes"
    return ""


def _bodies(scene: Scene) -> Iterator[Fault]:
    yield from within("bodies", bodies.cross_checks(scene.bodies, RestOfCase(scene)))


def _tethers(scene: Scene) -> Iterator[Fault]:
    yield from within("tethers", tether.cross_checks(scene.tethers, scene.bodies))


def _choice(scene: Scene) -> Iterator[Fault]:
    if scene.effects.is_given("choose") and (scene.bodies or scene.tethers):
        words = "its estimates are of a net alone, without bodies and tethers: give the tables of what acts"
        yield Fault("effects.choose", words)


def _reels(scene: Scene) -> Iterator[Fault]:
    bodies = {name.lower() for name in scene.bodies}
    for name, keys in scene.tethers.items():
        if keys is None or keys.reel is None:
            continue
        if name.lower() in bodies:
            yield Fault(f"tethers.{name}", "a body has this name, and a result what either gives: rename one")


def _control(scene: Scene) -> Iterator[Fault]:
    if scene.control is None:
        return
    begins = script.begins_control(scene.script)
    own = control_keys.cross_checks(scene.control, RestOfCase(scene), scripted=begins)
    yield from within("control", own)


def _name_of_the_line(scene: Scene) -> Iterator[Fault]:
    if not scene.is_given("closing"):
        return
    words = "the closing line has this name in results: rename it"
    for table, names in (("bodies", scene.bodies), ("tethers", scene.tethers)):
        yield from (Fault(f"{table}.{name}", words) for name in names if name.lower() == closing.NAME)


def _states_fit(scene: Scene) -> Iterator[Fault]:
    step, end = scene.time.output_step, scene.time.end
    if step and end / step > MAX_STATES:
        reason = f"to {end:g} s, a state each {step:g} s are {end / step:.3g} states; at most {MAX_STATES:,} "
        yield Fault("time.output_step", f"{reason}are allowed", against=("time.end",))


def _times_within_the_run(scene: Scene) -> Iterator[Fault]:
    end = scene.time.end
    for k, time in enumerate(scene.time.output_times or ()):
        if time is not None and time > end:  # None: not valid
            yield Fault(f"time.output_times[{k}]", f"must not be after time.end, {end:g} s, got {time:g}")


def _times_increase(scene: Scene) -> Iterator[Fault]:
    before = -math.inf
    for k, time in enumerate(scene.time.output_times or ()):
        if time is None:  # not valid
            continue
        if time <= before:
            reason = f"must be greater than the time before it, {before:g} s, got {time:g}"
            yield Fault(f"time.output_times[{k}]", reason)
        before = time


def _loop_has_the_method(scene: Scene) -> Iterator[Fault]:
    method = scene.solver.method
    if scene.engine.loop == TimeLoop.COMPILED and method not in ("auto", *COMPILED_METHODS):
        known = ", ".join(("auto", *COMPILED_METHODS))
        yield Fault("engine.loop", f"the compiled loop has {known}, not solver.method = {method}")


def _ports_are_compiled(scene: Scene) -> Iterator[Fault]:
    for name, body in scene.bodies.items():
        if body.motion == "port" and scene.engine.loop != TimeLoop.COMPILED:
            words = (
                'a port needs engine.loop = "compiled": the net takes its own steps between those of the host'
            )
            yield Fault(f"bodies.{name}.motion", words, against=("engine.loop",))


def _positions_in_place_of_packing(scene: Scene) -> Iterator[Fault]:
    initial = scene.initial
    if initial.is_given("node_positions") and initial.packing is not None and initial.packing != 1:
        words = f"initial.node_positions needs initial.packing = 1, got {initial.packing:g}"
        yield Fault("initial.node_positions", words, against=("initial.packing",))


def _not_with_a_state(scene: Scene) -> Iterator[Fault]:
    """What says otherwise where things are at the start than the state of another run."""
    if not scene.initial.is_given("from"):
        return
    words = "excludes initial.from, whose state has places and velocities: remove one"
    for name in ("frame", "velocity", "spin", "node_positions", "node_velocities"):
        if scene.initial.is_given(name):
            yield Fault(f"initial.{name}", words, against=("initial.from",))
    if scene.is_given("launch"):
        yield Fault("launch", words, against=("initial.from",))
    for name, module in effects.EFFECTS.items():
        if replaces_launch(module) and scene.effects.is_given(name):
            yield Fault(f"effects.{name}", words, against=("initial.from",))
    for name, keys in scene.tethers.items():
        if keys is not None and keys.reel is not None and keys.reel.is_given("paid_out"):
            yield Fault(f"tethers.{name}.reel.paid_out", words, against=("initial.from",))


def _net_can_be_folded(scene: Scene) -> Iterator[Fault]:
    if scene.initial.is_given("fold") and scene.initial.fold is not None:
        yield from within("initial.fold", folding.cross_checks(scene.net, scene.initial.fold))


def _net_on_a_body(scene: Scene) -> Iterator[Fault]:
    frame = scene.initial.frame if scene.initial.is_given("frame") else None
    if frame is None:
        return
    yield from within("initial.frame", bodies.turned_once(frame))
    if frame.is_given("body") and frame.body not in scene.bodies:
        known = ", ".join(scene.bodies) or "none"
        yield Fault("initial.frame.body", f'there is no body "{frame.body}" (bodies: {known})')
    if frame.is_given("eject_at") and frame.eject_at > 0.0:
        yield from within("initial.frame", each(*_ejected_later(scene, frame)))


def _ejected_later(scene: Scene, frame: NetFrame) -> Iterator[Iterator[Fault]]:
    yield _in_time(scene, frame)
    yield _not_held_otherwise(scene)


def _in_time(scene: Scene, frame: NetFrame) -> Iterator[Fault]:
    if frame.eject_at >= scene.time.end:
        words = f"must be before time.end, {scene.time.end:g} s, got {frame.eject_at:g} s"
        yield Fault("eject_at", words)


def _not_held_otherwise(scene: Scene) -> Iterator[Fault]:
    if isinstance(scene.net, explicit.Keys) and scene.net.fixed:
        yield Fault("eject_at", "a net that a body holds until then has no net.fixed nodes")


def _list_fits_the_net(scene: Scene, name: str) -> Iterator[Fault]:
    if not scene.initial.is_given(name):
        return
    if scene.net.topology != "explicit":
        yield Fault(f"initial.{name}", f'is for net.topology = "explicit", not "{scene.net.topology}"')
    elif isinstance(scene.net, explicit.Keys) and (
        reason := other_length(getattr(scene.initial, name), scene.net.nodes)
    ):
        yield Fault(f"initial.{name}", reason)


def _one_form(launch: Launch) -> Iterator[Fault]:
    plain, polar = ("radial_speed", "axial_speed"), ("speed", "spread_angle")
    given, other = (polar, plain) if any(map(launch.is_given, polar)) else (plain, polar)
    for name in given:
        if not launch.is_given(name):
            yield Fault("", f"missing {name}: {Launch.model_fields[name].description}")
    for name in other:
        if launch.is_given(name):
            yield Fault(name, "give either radial_speed and axial_speed, or speed and spread_angle")


def _launch_has_bullets(scene: Scene) -> Iterator[Fault]:
    if not scene.is_given("launch"):
        return
    if not isinstance(scene.net, ThrownNetTable):
        yield Fault("launch", f'a net of topology "{scene.net.topology}" has no bullets to launch')
    elif not scene.net.is_given("bullets"):
        yield Fault("launch", "there are no bullets to launch: add [net.bullets] or remove [launch]")

"""Checks between the tables of a valid scene: names that exist, lists that fit, contradictions."""

from __future__ import annotations

from collections.abc import Iterator

from exunet.base.errors import Fault, within
from exunet.bodies import config as bodies
from exunet.forces import control_config, effects
from exunet.forces.requirements import RestOfCase, replaces_launch
from exunet.methods.method import COMPILED_METHODS, Backend
from exunet.net import closing, explicit, folding, tether
from exunet.net.base import ThrownNetConfig, other_length
from exunet.scene import capture, script, script_lint
from exunet.scene.scene import Scene


def cross_checks(scene: Scene) -> Iterator[Fault]:
    """Yield every contradiction between tables, at the key that is to be changed."""
    yield from _engine(scene)
    yield from _initial(scene)
    yield from _launch(scene)
    yield from within("bodies", bodies.cross_checks(scene.bodies, scene.time.end))
    yield from within("tethers", tether.cross_checks(scene.tethers, scene.bodies))
    yield from _names(scene)
    if scene.control is not None:
        scripted = script.begins_control(scene.script)
        own = control_config.cross_checks(scene.control, RestOfCase(scene), scripted=scripted)
        yield from within("control", own)
    if scene.effects.is_given("choose") and (scene.bodies or scene.tethers):
        words = "its estimates are of a net alone, without bodies and tethers: give the tables of what acts"
        yield Fault("effects.choose", words)
    yield from within("effects", effects.cross_checks(scene))
    if scene.capture is not None:
        contact = getattr(scene.effects, "contact", None)
        touched = frozenset(() if contact is None else (*contact.threads, *contact.nodes))
        mouth = scene.net.topology != "explicit"
        found = capture.cross_checks(scene.capture, scene.bodies, touched, has_mouth=mouth)
        yield from within("capture", found)
    yield from _script(scene)


def _engine(scene: Scene) -> Iterator[Fault]:
    method, backend = scene.solver.method, scene.engine.backend
    if backend == Backend.COMPILED and method not in ("auto", *COMPILED_METHODS):
        known = ", ".join(("auto", *COMPILED_METHODS))
        yield Fault("engine.backend", f"the compiled loop has {known}, not solver.method = {method}")
    for name, body in scene.bodies.items():
        if body.motion == "port" and backend != Backend.COMPILED:
            words = 'a port requires engine.backend = "compiled": the net takes steps of its own'
            yield Fault(f"bodies.{name}.motion", words, against=("engine.backend",))


def _initial(scene: Scene) -> Iterator[Fault]:
    initial = scene.initial
    if initial.fold is not None:
        yield from within("initial.fold", folding.cross_checks(scene.net, initial.fold))
    if (frame := initial.frame) is not None:
        if frame.body not in scene.bodies:
            known = ", ".join(scene.bodies) or "none"
            yield Fault("initial.frame.body", f'unknown body "{frame.body}" (bodies: {known})')
        if frame.eject_at > 0.0 and frame.eject_at >= scene.time.end:
            words = f"must be before time.end, {scene.time.end:g} s, got {frame.eject_at:g} s"
            yield Fault("initial.frame.eject_at", words)
        if frame.eject_at > 0.0 and isinstance(scene.net, explicit.ExplicitNetConfig) and scene.net.fixed:
            words = "a net that a body holds until then excludes net.fixed"
            yield Fault("initial.frame.eject_at", words)
    for name in ("node_positions", "node_velocities"):
        if (values := getattr(initial, name)) is None:
            continue
        if not isinstance(scene.net, explicit.ExplicitNetConfig):
            yield Fault(f"initial.{name}", f'is for net.topology = "explicit", not "{scene.net.topology}"')
        elif reason := other_length(values, scene.net.nodes):
            yield Fault(f"initial.{name}", reason)
    if initial.restart is not None:
        words = "excludes initial.restart, whose state has positions and velocities: remove one"
        excluded = ["launch"] if scene.launch is not None else []
        on = effects.switched_on(scene.effects)
        excluded += [f"effects.{name}" for name in on if replaces_launch(effects.EFFECTS[name])]
        for name, keys in scene.tethers.items():
            if keys.reel is not None and keys.reel.paid_out is not None:
                excluded.append(f"tethers.{name}.reel.paid_out")
        yield from (Fault(key, words, against=("initial.restart",)) for key in excluded)


def _launch(scene: Scene) -> Iterator[Fault]:
    if scene.launch is None:
        return
    if not isinstance(scene.net, ThrownNetConfig):
        yield Fault("launch", f'a net of topology "{scene.net.topology}" does not have bullets to launch')
    elif scene.net.bullets is None:
        yield Fault("launch", "there are no bullets to launch: add [net.bullets] or remove [launch]")


def _names(scene: Scene) -> Iterator[Fault]:
    """Require names that results can distinguish."""
    bodies = {name.lower() for name in scene.bodies}
    for name, keys in scene.tethers.items():
        if keys.reel is not None and name.lower() in bodies:
            words = "a body has this name too, and results have series of both: rename one"
            yield Fault(f"tethers.{name}", words)
    if scene.closing is not None:
        words = "the closing line has this name in results: rename it"
        for table, names in (("bodies", scene.bodies), ("tethers", scene.tethers)):
            yield from (Fault(f"{table}.{name}", words) for name in names if name.lower() == closing.NAME)


def _script(scene: Scene) -> Iterator[Fault]:
    if faults := list(script_lint.entry_faults(scene.script, _stage(scene))):
        yield from faults
    else:
        yield from script_lint.conflicts(scene.script)


def _stage(scene: Scene) -> script_lint.Stage:
    """What of the scene a script may look at and act on."""
    line = scene.closing if isinstance(scene.closing, closing.ClosingLineConfig) else None
    reels = {name: one.reel for name, one in scene.tethers.items() if one.reel}
    drives = reels | ({closing.NAME: line.winch} if line is not None and line.winch is not None else {})
    has = {
        "target": scene.capture is not None,
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
    ports, found = [name for name, one in scene.bodies.items() if one.motion == "port"], dict[str, str]()
    port = "is fixed to a port, whose mass its host counts: nothing is released from it"
    for name, body in scene.bodies.items():
        for label in body.attachments:
            found[f"bodies.{name}.attachments.{label}"] = port if name in ports else ""
    for name, tether_keys in scene.tethers.items():
        for end in ("start", "end"):
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
    if isinstance(scene.net, explicit.ExplicitNetConfig) and scene.net.fixed:
        return "a net that a body holds until then has no net.fixed nodes"
    return ""

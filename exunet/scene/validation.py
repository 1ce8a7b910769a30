"""From a TOML document to a valid scene, or to all of its faults; checks between the tables of a scene."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import Tag, ValidationError
from pydantic.fields import FieldInfo

from exunet.base.errors import Fault, within
from exunet.base.key_path import KeyPath, closest
from exunet.base.record import FAULTS, Record, config_of
from exunet.base.times import reached
from exunet.bodies import config as bodies
from exunet.forces import corner_units, effects
from exunet.forces.requirements import RestOfCase, replaces_launch
from exunet.methods.method import COMPILED_METHODS, Backend
from exunet.net import TOPOLOGIES, closing, explicit, folding, tether
from exunet.net.base import NetConfig, ThrownNetConfig, other_length
from exunet.scene import capture, script
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
        own = corner_units.cross_checks(scene.control, RestOfCase(scene), scripted=scripted)
        yield from within("control", own)
    if scene.effects.is_given("choose") and (scene.bodies or scene.tethers):
        words = "its estimates are of a net alone, without bodies and tethers: give the tables of what acts"
        yield Fault("effects.choose", words)
    yield from within("effects", effects.cross_checks(scene))
    if scene.capture is not None:
        contact = getattr(scene.effects, "contact", None)
        touched = frozenset(() if contact is None else (*contact.threads, *contact.nodes))
        found = capture.cross_checks(scene.capture, scene.bodies, touched, has_mouth=scene.net.has_mouth)
        yield from within("capture", found)
    yield from _script(scene)


def _engine(scene: Scene) -> Iterator[Fault]:
    method, backend = scene.solver.method, scene.engine.backend
    if backend == Backend.COMPILED and method not in ("auto", *COMPILED_METHODS):
        known = ", ".join(("auto", *COMPILED_METHODS))
        yield Fault("engine.backend", f"the compiled loop has {known}, not solver.method = {method}")
    for name, body in scene.bodies.items():
        if body.motion == "port" and backend == Backend.EXUDYN:
            words = 'a port excludes engine.backend = "exudyn": the net takes steps of its own'
            yield Fault(f"bodies.{name}.motion", words, against=("engine.backend",))


def _initial(scene: Scene) -> Iterator[Fault]:
    initial = scene.initial
    if initial.fold is not None:
        yield from within("initial.fold", folding.cross_checks(scene.net, initial.fold))
    if (frame := initial.frame) is not None:
        if frame.body not in scene.bodies:
            known = ", ".join(scene.bodies) or "none"
            yield Fault("initial.frame.body", f'unknown body "{frame.body}" (bodies: {known})')
        if frame.eject_at > 0.0 and reached(frame.eject_at, scene.time.end):
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
        elif scene.net.is_given("strings"):
            yield Fault(f"initial.{name}", "excludes net.strings, whose bullets are not listed")
        elif reason := other_length(values, scene.net.listed.nodes):
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
    if faults := list(script.entry_faults(scene)):
        yield from faults
    else:
        yield from script.conflicts(scene.script)


Located = tuple[tuple[KeyPath, ...], str]  # the keys that do not go together, and the reason

_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a string",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "model_type": "a table",
    "mapping_type": "a table",
    "dict_type": "a table",
    "model_attributes_type": "a table",
    "finite_number": "finite",
}


def validated(document: dict[str, Any]) -> tuple[Scene | None, list[Located]]:
    """Validate a document: the scene, or None and every fault.

    Tables are checked against each other if each of them is valid.
    """
    try:
        scene = Scene.model_validate(document)
    except ValidationError as error:
        errors = [item for item in error.errors(include_url=False) if not _follows_from_another(item)]
        return None, [fault for entry in errors for fault in _explained(entry)]
    return scene, [(fault.paths, fault.reason) for fault in cross_checks(scene)]


def _follows_from_another(error: Any) -> bool:
    """True for a list that is short only by its items that are not valid, and a default that needs a key."""
    if error["type"] == "default_factory_not_called":
        return True
    return error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]


def _explained(error: Any) -> Iterator[Located]:
    """Yield the faults of one of pydantic's `errors()`."""
    path, record, field = _located(error["loc"])
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    if kind == FAULTS:
        yield from (
            (tuple((*path, *item) for item in fault.paths), fault.reason) for fault in context[FAULTS]
        )
        return
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        key = context["discriminator"].strip("'")
        path = (*path, key)
        if kind == "union_tag_invalid":
            tags = [tag.strip("'") for tag in context["expected_tags"].split(", ")]
            given = value.get(key) if isinstance(value, dict) else context["tag"]
            choice = _choice([shown(tag) for tag in tags])
            reason = f"must be {choice}, got {shown(given)}{_suggestion(given, tags)}"
        else:
            members = [member for _, member in alternatives(field.annotation)] if field else []
            tags = [tag for member in members for tag in literals(member.model_fields.get(key))]
            reason = f"missing; must be {_choice([shown(tag) for tag in dict.fromkeys(tags)])}"
    elif kind == "missing" and isinstance(path[-1], int):
        path, reason = path[:-1], f"must have more items, got {len(value)}"
    elif kind == "missing":
        reason = _missing(field)
    elif kind == "extra_forbidden":
        reason = _unknown(str(path[-1]), record)
    elif kind == "string_pattern_mismatch":  # only names that a case chooses: keys of tables, of entries
        path = path[:-1] if path[-1] == "[key]" else path
        reason = "a name has letters, digits, _ and - only"
    elif kind == "value_error":
        reason = str(context["error"])
    elif kind == "alternatives":
        reason = error["msg"]
    elif kind == "literal_error":
        allowed = [shown(literal) for literal in literals(field)]
        close = _suggestion(value, [entry for entry in literals(field) if isinstance(entry, str)])
        reason = f"must be {_choice(allowed)}, got {shown(value)}{close}"
    elif kind in _KINDS:
        reason = f"must be {_KINDS[kind]}, got {shown(value)}"
    else:  # pydantic's words: "Input should be greater than 0", "Tuple should have at most 3 items ..."
        words = error["msg"].replace("Input should", "must").replace("Tuple should", "must")
        reason = f"{words}, got {shown(value)}"
    yield (path,), reason


def _located(loc: KeyPath) -> tuple[KeyPath, type[Record] | None, FieldInfo | None]:
    """The path of pydantic's `loc` in a case, without tags of unions; the record and the field there."""
    path: KeyPath = ()
    kind: Any = Scene
    record, field = None, None
    for part in loc:
        members = list(alternatives(kind))
        if len(members) > 1:  # of a tagged union, whose tag pydantic puts into the path
            kind = next((member for tag, member in members if part == tag or part in _tags(member)), None)
            continue
        kind, path = members[0][1] if members else None, (*path, part)
        if isinstance(kind, type) and issubclass(kind, Record):
            record, field = kind, kind.model_fields.get(str(part))
            kind = None if field is None else field.annotation
        else:  # a mapping from names, or a list
            kind = next(reversed([arg for arg in get_args(kind) if arg is not Ellipsis]), None)
    return path, record, field


def is_chosen_name(path: KeyPath) -> bool:
    """Return True for the path of a table whose name the case chooses, such as that of a body."""
    found, record, field = _located(path)
    return record is not None and field is not None and record.model_fields.get(str(found[-1])) is not field


def alternatives(kind: Any) -> Iterator[tuple[str | None, Any]]:
    """The alternatives of a type, each with its tag in a union that has tags."""
    origin = get_origin(kind)
    if origin is Annotated:
        inner, *metadata = get_args(kind)
        tag = next((item.tag for item in metadata if isinstance(item, Tag)), None)
        yield from ((tag or own, member) for own, member in alternatives(inner))
    elif origin in (Union, UnionType):
        for arg in get_args(kind):
            yield from alternatives(arg)
    elif kind not in (None, NoneType):
        yield None, kind


def _tags(member: Any) -> set[Any]:
    """The values of fields that distinguish a record in a union."""
    fields = member.model_fields.values() if hasattr(member, "model_fields") else ()
    return {value for field in fields if get_origin(field.annotation) is Literal for value in literals(field)}


def literals(field: FieldInfo | None) -> tuple[Any, ...]:
    kinds = [kind for _, kind in alternatives(field.annotation)] if field else []
    return next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ())


def _missing(field: FieldInfo | None) -> str:
    kinds = [kind for _, kind in alternatives(field.annotation)] if field else []
    what = "missing table" if any(hasattr(kind, "model_fields") for kind in kinds) else "missing"
    return f"{what}: {field.description}" if field and field.description else what


def _unknown(name: str, record: type[Record] | None) -> str:
    known = list(record.model_fields) if record else []
    if close := closest(name, known):
        return f"unknown key; did you mean '{close}'?"
    if record and issubclass(record, NetConfig):
        records = {topology: config_of(module, "NetConfig") for topology, module in TOPOLOGIES.items()}
        owners = [topology for topology, other in records.items() if name in other.model_fields]
        if owners:
            return f"unknown key of this topology; {', '.join(owners)} nets have it"
    return f"unknown key; known keys are {', '.join(known)}" if known else "unknown key"


def _choice(values: list[str]) -> str:
    return values[0] if len(values) == 1 else f"one of {', '.join(values)}"


def _suggestion(value: Any, allowed: Iterable[str]) -> str:
    close = closest(value, allowed) if isinstance(value, str) else None
    return f"; did you mean '{close}'?" if close else ""


def shown(value: Any) -> str:
    """A value as TOML has it, cut short."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        items = [shown(item) for item in value[:4]] + ["..."] * (len(value) > 4)
        return _cut("[" + ", ".join(items), "]")
    return _cut(json.dumps(value, ensure_ascii=False)[:-1], '"') if isinstance(value, str) else str(value)


def _cut(text: str, end: str) -> str:
    return (text if len(text) <= 60 else text[:57] + "...") + end

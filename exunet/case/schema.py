"""The case format as a JSON schema and as a commented template, both made from the records."""

from __future__ import annotations

import copy
import functools
import json
from collections.abc import Iterator
from textwrap import wrap
from typing import Any

from exunet.base.errors import KeyPath
from exunet.case.scene import Scene
from exunet.forces import control_keys
from exunet.forces.effects import EFFECTS
from exunet.forces.requirements import (
    bullet_keys,
    needs_bullets,
    needs_fresh_steps,
    not_carried,
    replaces_launch,
)
from exunet.methods.method import COMPILED_METHODS, METHODS, TimeLoop
from exunet.net import TOPOLOGIES

Node = dict[str, Any]

# Of keys of which a case gives exactly one, those that the template uses; it leaves out other optional keys.
_CHOSEN = (
    "output_step",
    "diameter",
    "packing",
    "box",
    "altitude",
    "radial_speed",
    "axial_speed",
    "strain",
    "mass",
    "inertia",
    "node",
    "chaser_mass",
    "threads",
    "stiffness",
    "restitution",
    "impact_speed",
    "friction_law",
    "enclosed",
    "rings",
)
_OF_PARTS = ("size",)  # of a box, the first of the shapes that a part may have
_BODY, _TETHER = "chaser", "tow"  # names of these in the template
_WIDTH = 78  # of lines of the template, without the "# " before those of optional tables


def json_schema() -> Node:
    """JSON schema (draft 2020-12) of a case: every key with its type, bounds, and meaning with units.

    It says which solver keys and which loop go with a method, which effects contradict or need each other,
    and which need bullets. What a schema cannot say, such as a mesh that divides the size, is checked on
    loading only.
    """
    return copy.deepcopy(_schema())


@functools.cache
def _schema() -> Node:
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "exunet case"}
    return Scene.model_json_schema() | about | {"allOf": [*_between_tables()]}


def _between_tables() -> Iterator[Node]:
    """What keys of different tables demand of each other."""
    bullets, effect = _given("net", "bullets"), functools.partial(_given, "effects")
    for name in ("launch", "control"):
        yield {"if": {"required": [name]}, "then": bullets}
    compiled = _given("engine", "loop", {"const": TimeLoop.COMPILED.value})
    known = ["auto", *(method.value for method in COMPILED_METHODS)]
    yield {"if": compiled, "then": _at("solver", "method", {"enum": known})}
    remembering = [method.value for method, facts in METHODS.items() if facts.remembers_acceleration]
    none = {"maxProperties": 0}
    yield {"if": effect("choose"), "then": {"properties": {"bodies": none, "tethers": none}}}
    for name, module in EFFECTS.items():
        if needs_fresh_steps(module):
            yield {"if": effect(name), "then": _at("solver", "method", {"not": {"enum": remembering}})}
        if needs_bullets(module):
            yield {"if": effect(name), "then": bullets}
        if replaces_launch(module):
            yield {"if": effect(name), "then": {"properties": {"launch": False}}}
        for key in not_carried(module):
            given = {"required": [key]}
            yield {"if": effect(name, given), "then": _at("initial", "frame", False)}
        if keys := bullet_keys(module):
            with_keys, without = {"required": list(keys)}, {"properties": dict.fromkeys(keys, False)}
            yield {
                "if": effect(name),
                "then": {
                    "if": bullets,
                    "then": effect(name, with_keys),
                    "else": _at("effects", name, without),
                },
            }


def _at(table: str, key: str, value: Node | bool) -> Node:
    """What `table.key` must be, if it is there."""
    return {"properties": {table: {"properties": {key: value}}}}


def _given(table: str, key: str, value: Node | None = None) -> Node:
    """`table.key` must be there, and be `value`."""
    inner: Node = {"required": [key]} | ({"properties": {key: value}} if value else {})
    return {"required": [table], "properties": {table: inner}}


def resolve(path: KeyPath, topology: str | None = None) -> Node:
    """The schema of the key at `path`, for a net of `topology`; {} if the format has no such key."""
    node = _plain(_schema(), topology)
    for part in path:
        if isinstance(part, str):
            named: Node = next(iter(node.get("patternProperties", {}).values()), {})  # names are free: bodies
            node = node.get("properties", {}).get(part, named)
        else:
            fixed = node.get("prefixItems", [])
            node = fixed[part] if part < len(fixed) else node.get("items", {})
        node = _plain(node, topology)
    return node


def _plain(node: Node, topology: str | None) -> Node:
    """`node` without its indirections: references, `null` as an alternative, the choice of a topology."""
    about = {key: value for key, value in node.items() if key not in ("$ref", "anyOf")}
    if "$ref" in node:
        return _plain(_schema()["$defs"][node["$ref"].rpartition("/")[2]], topology) | about
    if "anyOf" in node:
        return _plain(next(one for one in node["anyOf"] if one.get("type") != "null"), topology) | about
    if "discriminator" in node:
        if topology in TOPOLOGIES:
            return _plain({"$ref": node["discriminator"]["mapping"][topology]}, topology) | about
        names = list(TOPOLOGIES)
        choice = {"type": "string", "enum": names, "description": "one of " + ", ".join(names)}
        properties: Node = {}
        for one in names:
            properties = _plain(node, one)["properties"] | properties
        return {"type": "object", "properties": properties | {"topology": choice}} | about
    return node


def template(topology: str = "square") -> str:
    """A valid case for a net of `topology` with every key of the format, the optional ones commented out.

    Taking away the first "# " of all lines of a table switches that table on. Raises KeyError if there is no
    such topology.
    """
    if topology not in TOPOLOGIES:
        raise KeyError(topology)
    lines = [
        "# A case of exunet, in SI units. What is commented out is optional:",
        "# remove the first '# ' of a key, or of each line of a table, to use it.",
        *_keys((), topology),
        *_tables((), topology, needed=True),
    ]
    return "\n".join(lines) + "\n"


def _keys(path: tuple[str, ...], topology: str) -> Iterator[str]:
    """Lines of the keys of a table that are not tables, those that it needs first."""
    node = resolve(path, topology)
    first = node["then"]["required"] if path == ("closing",) else ()  # of the kind that the template shows
    chosen = ("point", *control_keys.NEEDS["point"]) if path == ("control",) else (*first, *_chosen(node))
    given = {*node.get("required", ()), *chosen, *(_OF_PARTS if "parts" in path else ())}
    keys = {name: _plain(raw, topology) for name, raw in _properties(node, path).items()}
    for name in sorted(keys, key=lambda name: name not in given):
        if keys[name].get("type") != "object":
            yield from _explained(("" if name in given else "# ") + _assignment(name, keys[name]), keys[name])
    if path == ("net",):
        yield from _other_topologies(topology)


def _chosen(node: Node) -> Iterator[str]:
    """The optional keys that the template uses in a table."""
    choices = [one["required"][0] for one in node.get("oneOf", ()) if set(one) == {"required"}]
    first = choices[:1] if choices[:1] == ["body"] else []  # an end of a tether that may have a reel
    yield from first
    yield from (name for name in _CHOSEN if not first or name not in choices)


def _tables(path: tuple[str, ...], topology: str, *, needed: bool) -> Iterator[str]:
    """Lines of the tables in a table, which is itself needed or optional, each with its header."""
    node = resolve(path, topology)
    for name, raw in _properties(node, path).items():
        key = _plain(raw, topology)
        if key.get("type") != "object":
            continue
        inner, on = (*path, name), needed and name in node.get("required", ())
        if keys := list(_keys(inner, topology)):  # a table of nothing but tables needs no header
            yield ""
            for line in (*_explained(f"[{'.'.join(inner)}]", key), *keys):
                yield line if on else "# " + line
        yield from _tables(inner, topology, needed=on)


def _properties(node: Node, path: tuple[str, ...]) -> Node:
    """The keys of the table at `path`; of one whose keys are names that a case chooses, an example."""
    if "properties" in node:
        properties: Node = node["properties"]
        return properties
    name = _TETHER if path == ("tethers",) else _BODY
    return dict(zip([name], node.get("patternProperties", {}).values(), strict=False))


def _other_topologies(chosen: str) -> Iterator[str]:
    """The keys that nets of the other topologies have in place of those of the chosen one, as comments."""
    common = set.intersection(*(set(module.Keys.model_fields) for module in TOPOLOGIES.values()))
    for topology in TOPOLOGIES:
        if topology == chosen:
            continue
        yield f"# Instead of these, {topology} nets have"
        properties = resolve(("net",), topology)["properties"]
        for name, raw in properties.items():
            key = _plain(raw, topology)
            if key.get("type") != "object" and (name not in common or name == "topology"):
                yield from _explained("#     " + _assignment(name, key), key, "#         ")


def _assignment(name: str, key: Node) -> str:
    return f"{name} = {_toml(example(key))}"


def _explained(line: str, key: Node, indent: str = "#     ") -> Iterator[str]:
    """A line with the description of its key or table behind it, or where it is too long for that, below."""
    about = str(key.get("description", ""))
    whole = f"{line}  # {about}" if about else line
    if len(whole) <= _WIDTH:
        yield whole
        return
    yield line
    yield from wrap(
        about,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _toml(value: Any) -> str:
    """A value as TOML writes it in one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(one)}" for name, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def example(key: Node) -> Any:
    """A valid value: the example of the field, its default, or the least one of its type."""
    if "examples" in key:
        return key["examples"][0]
    if key.get("default") is not None:
        return key["default"]
    if "const" in key:
        return key["const"]
    if "enum" in key:
        return key["enum"][0]
    kind = key.get("type")
    if kind == "array":
        return [example(item) for item in key.get("prefixItems", [])]
    if kind in ("number", "integer"):
        least = key.get("minimum", 1 if "exclusiveMinimum" in key else 0)
        return int(least) if kind == "integer" else float(least)
    return {"boolean": False, "string": ""}[str(kind)]

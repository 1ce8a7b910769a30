"""What pydantic finds wrong with a case, in plain words: what the key must be, and what it is."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable
from typing import Any

from exunet.base.errors import KeyPath
from exunet.case.schema import resolve
from exunet.net import TOPOLOGIES


def explain(error: Any, document: dict[str, Any]) -> tuple[KeyPath, str]:
    """The path of the key that one of pydantic's `errors()` is about, and what is wrong with it."""
    path, kind, value = without_topology(error["loc"]), error["type"], error["input"]
    if kind == "fault":
        return path, error["msg"]
    if kind == "value_error":
        return path, str(error["ctx"]["error"])
    if kind == "union_tag_not_found":
        kind, path = "missing", (*path, "topology")
    if kind == "union_tag_invalid":
        path, value = (*path, "topology"), document["net"]["topology"]
    if kind == "missing" and isinstance(path[-1], int):
        path = path[:-1]  # a list that is too short
    elif kind == "missing":
        return path, _missing(_node(path, document))
    if kind == "extra_forbidden":
        return path, _unknown(path, document)
    if kind == "string_pattern_mismatch":  # only names that a case chooses: keys of tables, of entries
        return path[:-1] if path[-1] == "[key]" else path, "a name has letters, digits, _ and - only"
    if kind == "finite_number":
        return path, f"must be finite, got {shown(value)}"
    node = _node(path, document)
    return path, f"must be {wanted(node)}, got {shown(value)}{_suggestion(value, node.get('enum', ()))}"


def wanted(node: dict[str, Any]) -> str:
    """What a value must be, from its JSON schema: "a number greater than 0", "a list of 3 numbers"."""
    if "const" in node:
        return shown(node["const"])
    if "enum" in node:
        return "one of " + ", ".join(map(shown, node["enum"]))
    kind = node.get("type")
    if kind == "array":
        return f"a list of {_plural(node)}"
    if kind in ("number", "integer"):
        return ("a number" if kind == "number" else "a whole number") + _bounds(node)
    if kind == "string" and node.get("minLength"):
        return "a string that is not empty"
    return {"string": "a string", "object": "a table", "boolean": "true or false"}.get(
        str(kind), "something else"
    )


def shown(value: Any) -> str:
    """A value as TOML would have it, cut short."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        items = [shown(item) for item in value[:4]] + ["..."] * (len(value) > 4)
        return _cut("[" + ", ".join(items), "]")
    return _cut(json.dumps(value, ensure_ascii=False)[:-1], '"') if isinstance(value, str) else str(value)


def _cut(text: str, end: str) -> str:
    return (text if len(text) <= 60 else text[:57] + "...") + end


def without_topology(place: KeyPath) -> KeyPath:
    """Pydantic puts the name of the topology after "net"; the case file has no such level."""
    return place[:1] + place[2:] if place[:1] == ("net",) and place[1:2] and place[1] in TOPOLOGIES else place


def _node(path: KeyPath, document: dict[str, Any]) -> dict[str, Any]:
    """The JSON schema of the key at `path`; {} if there is no such key."""
    net = document.get("net")
    topology = net.get("topology") if isinstance(net, dict) else None
    return resolve(path, topology if isinstance(topology, str) else None)


def _missing(node: dict[str, Any]) -> str:
    what = "missing table" if node.get("type") == "object" or "oneOf" in node else "missing"
    return f"{what}: {node['description']}" if "description" in node else what


def _unknown(path: KeyPath, document: dict[str, Any]) -> str:
    name = str(path[-1])
    known = list(_node(path[:-1], document).get("properties", {}))
    close = _close(name, known)
    if path[0] == "net" and len(path) == 2 and not close:
        owners = [topology for topology, module in TOPOLOGIES.items() if name in module.Keys.model_fields]
        if owners:
            return f"{document['net']['topology']} nets have no such key; {_listed(owners)} nets have"
    if close:
        return f"unknown key; did you mean {close!r}?"
    return f"unknown key; the known {'keys are' if len(known) > 1 else 'key is'} {_listed(known)}"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def _suggestion(value: Any, allowed: Iterable[Any]) -> str:
    close = _close(value, list(allowed)) if isinstance(value, str) else None
    return f"; did you mean {close!r}?" if close else ""


def _close(name: str, known: list[str]) -> str | None:
    by_lower = {candidate.lower(): candidate for candidate in known}
    found = difflib.get_close_matches(name.lower()[:100], by_lower, n=1)
    return by_lower[found[0]] if found else None


def _bounds(node: dict[str, Any]) -> str:
    words = {
        "exclusiveMinimum": "greater than",
        "minimum": "not less than",
        "exclusiveMaximum": "less than",
        "maximum": "not greater than",
    }
    parts = [f"{word} {node[key]:,.15g}" for key, word in words.items() if key in node]
    return " " + " and ".join(parts) if parts else ""


def _plural(node: dict[str, Any]) -> str:
    """The items of an array: "3 numbers", "lists of 2 whole numbers"."""
    if "prefixItems" in node:
        count, item = f"{len(node['prefixItems'])} ", node["prefixItems"][0]
    else:
        count, item = f"{node['minItems']} or more " if "minItems" in node else "", node.get("items", {})
    if item.get("type") == "array":
        return f"{count}lists of {_plural(item)}"
    names = {"number": "numbers", "integer": "whole numbers", "string": "strings"}
    return count + names.get(item.get("type", ""), "items") + _bounds(item)

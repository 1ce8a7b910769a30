"""The case format as a JSON schema and as a commented template, both made from the records."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from textwrap import wrap
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo

from exunet.base.record import Record, config_of
from exunet.base.validation import alternatives, literals
from exunet.net import TOPOLOGIES
from exunet.net.base import Cable, ThrownNetConfig
from exunet.net.explicit import ExplicitNet
from exunet.scene.scene import Scene

# Optional keys that the template uses, besides the first of each EXACTLY_ONE; it comments out the others.
_CHOSEN = (
    "inertia",
    "threads",
    "stiffness",
    "restitution",
    "impact_speed",
    "enclosed",
)
_OF_PARTS = ("size",)  # of a box, the first of the shapes that a part may have
# Optional tables that the template switches on, so that its net opens.
_ON = (("net", "strings"), ("net", "bullets"), ("launch",))
_NAMES = {
    "bodies": "chaser",
    "tethers": "tow",
    "attachments": "corner",
    "parts": "panel",
    "threads": "border",
}
# A second body, which other tables of the template name.
_TARGET = """
[bodies.target]  # a second body, for contact and capture
mass = 100.0
shape = "box"
size = [1.0, 1.0, 2.0]
edge_radius = 0.1
position = [0.0, 0.0, 4.0]
angular_velocity = [0.0, 0.0, 0.1]"""
_WIDTH = 78  # of lines of the template, without the "# " before those of optional tables


def json_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a case: every key with its type, bounds, and meaning with units.

    Contradictions between keys are checked on loading only.
    """
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "exunet case"}
    return Scene.model_json_schema() | about


def template(topology: str = "square") -> str:
    """A valid case for a net of `topology` with every key of the format, the optional ones commented out.

    Removing the first "# " of all lines of a table switches that table on. Raises KeyError if there is no
    such topology.
    """
    if topology not in TOPOLOGIES:
        raise KeyError(topology)
    lines = [
        "# A case of exunet, in SI units. Lines that are commented out are optional: to use",
        "# a key or a table, remove the first '# ' of the key, or of each line of the table.",
        *_keys(Scene, ()),
        *_tables(Scene, (), topology, needed=True),
    ]
    return "\n".join(lines) + "\n"


def tables_of(field: FieldInfo) -> list[type[Record]]:
    """The records that a field may hold, or a mapping from names to them."""
    kinds = [kind for _, kind in alternatives(field.annotation)]
    kinds = [get_args(kind)[1] if get_origin(kind) is Mapping else kind for kind in kinds]
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Record)]


def is_named(field: FieldInfo) -> bool:
    """True for a mapping from names that a case chooses."""
    return any(get_origin(kind) is Mapping for _, kind in alternatives(field.annotation))


def _shown_tables(field: FieldInfo, topology: str) -> list[type[Record]]:
    """The records of a field, first the record that the template shows."""
    tables = tables_of(field)
    return sorted(tables, key=lambda table: table is not config_of(TOPOLOGIES[topology], "Net"))


def _keys(record: type[Record], path: tuple[str, ...], *, moving: bool = False) -> Iterator[str]:
    """Lines of the keys of a table that are not tables, first the keys that it requires.

    moving : whether the net starts with a velocity, since its topology does not have a launch
    """
    needed = {name for name, field in record.model_fields.items() if field.is_required()}
    needed |= {"density", "youngs_modulus"} if issubclass(record, Cable) else set()
    needed |= {"elements", "corners"} if issubclass(record, ExplicitNet) else set()
    needed |= {"velocity"} if path == ("initial",) and moving else set()
    needed |= {*record.EXACTLY_ONE[:1], *(() if record.EXACTLY_ONE[:1] == ("body",) else _CHOSEN)}
    needed |= {*(_OF_PARTS if "parts" in path else ())}
    fields = {name: field for name, field in record.model_fields.items() if not tables_of(field)}
    for name in sorted(fields, key=lambda name: name not in needed):
        line = _assignment(name, fields[name])
        yield from _explained(line if name in needed else f"# {line}", fields[name])


def _tables(record: type[Record], path: tuple[str, ...], topology: str, *, needed: bool) -> Iterator[str]:
    """Lines of the tables in a table, which is itself needed or optional, each with its header."""
    for name, field in record.model_fields.items():
        if not (tables := _shown_tables(field, topology)):
            continue
        inner = (*path, name)
        if is_named(field):
            inner = (*inner, _NAMES[name])
        thrown = issubclass(config_of(TOPOLOGIES[topology], "Net"), ThrownNetConfig)
        on = needed and (field.is_required() or (thrown and inner in _ON))
        if keys := list(_keys(tables[0], inner, moving=not thrown)):  # tables alone do not need a header
            yield ""
            for line in (*_explained(f"[{'.'.join(inner)}]", field), *keys, *_instead(tables)):
                yield line if on else "# " + line
        yield from _tables(tables[0], inner, topology, needed=on)
        if name == "bodies":
            yield from (f"# {line}" if line else line for line in _TARGET.split("\n"))


def _instead(tables: list[type[Record]]) -> Iterator[str]:
    """The keys of the alternatives of a table that differ from those of the first record, as comments."""
    shown = {name: repr(field) for name, field in tables[0].model_fields.items()} if tables else {}
    for table in tables[1:]:
        yield "# Instead of these:"
        for name, field in table.model_fields.items():
            if repr(field) != shown.get(name) and not tables_of(field):
                yield from _explained("#     " + _assignment(name, field), field, "#         ")


def _assignment(name: str, field: FieldInfo) -> str:
    return f"{name} = {_toml(example(field))}"


def _explained(line: str, field: FieldInfo, indent: str = "#     ") -> Iterator[str]:
    """A line with the description of its key or table behind it, or where it is too long for that, below."""
    about = field.description or ""
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
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def example(field: FieldInfo) -> Any:
    """A valid value: the example of the field, its default, or the first of its choices."""
    if field.examples:
        return field.examples[0]
    if field.default is not None and not field.is_required():
        return field.default
    return literals(field)[0]

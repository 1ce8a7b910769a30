"""Writes docs/reference/keys, the pages of the case format, from its records: python docs/build_keys.py"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exunet.scene.scene import Scene

FOLDER = Path(__file__).parent / "reference" / "keys"
HEAD = """# Keys of a case

A case is one TOML file in SI units (m, kg, s, Pa, N, rad). A key that is not listed here is an error, and so
are NaN and infinities. Physical quantities do not have defaults: what a case does not state is not in the
scene. All errors of a file are reported at once, with their lines. `exunet schema --json` prints this format
as a JSON Schema, for editors.

Equations and conventions are in [theory](../../explanation/theory.md),
[effects](../../explanation/theory_effects.md), [bodies](../../explanation/theory_bodies.md)
and [contact](../../explanation/theory_contact.md). `NAME` stands for a name that the case chooses, of
letters, digits, `_` and `-`; names must differ by more than capital letters.

`--set KEY=VALUE`, and overrides in Python, name a key by its path: `time.end`, `script[2].force`,
`bodies.sat.size[0]`. An index counts from 0 the items of a list, or tables with names that the case chooses,
in their order (`bodies.sat.parts[2].radius`). An empty value removes a key, a table or an item. A table as
the value replaces the whole table; a warning lists the keys that it drops.

These pages are generated from the records of the program by `docs/build_keys.py`.
"""
TOP = "index"
# Path of a table, or its first part -> name of its page; all others have the first part as name.
PAGES = {
    **dict.fromkeys(("time", "solver", "engine"), "run"),
    "launch": "initial",
    **dict.fromkeys(("effects.contact", "effects.contact.friction", "effects.self_contact"), "contact"),
}
TITLES = {
    "run": "Time, solver and backend",
    "net": "Net",
    "initial": "Initial state and launch",
    "bodies": "Bodies",
    "tethers": "Tethers",
    "closing": "Closing",
    "control": "Corner units",
    "capture": "Capture",
    "script": "Script",
    "effects": "Effects",
    "contact": "Contact",
}
BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
TYPES = {"number": "float", "integer": "int", "boolean": "bool", "object": "table"}
Schema = dict[str, Any]


@dataclass
class Table:
    """A table of the case format: its alternative records, and the paths at which it may stand."""

    records: list[Schema]
    array: bool
    paths: list[str] = field(default_factory=list)

    @property
    def heading(self) -> str:
        """Headers as TOML writes them."""
        left, right = ("[[", "]]") if self.array else ("[", "]")
        return ", ".join(f"`{left}{path}{right}`" for path in self.paths)

    @property
    def page(self) -> str:
        """Name of the page that has the table."""
        path = self.paths[0]
        return PAGES.get(path) or PAGES.get(path.partition(".")[0]) or path.partition(".")[0]

    @property
    def keys(self) -> set[str]:
        """Names of the keys of all alternatives."""
        return {name for record in self.records for name in record["properties"]}


class Keys:
    """The tables of the schema of a case, each once, in the order in which they are reached."""

    def __init__(self) -> None:
        """Collect the tables below the top level."""
        self._top: Schema = Scene.model_json_schema()
        self._definitions: Schema = self._top["$defs"]
        self._tables: dict[str, Table] = {}
        self._collect("", self._top)

    def pages(self) -> dict[str, str]:
        """Return the text of each page by its file name."""
        links = "\n".join(f"- [{title}]({name}.md)" for name, title in TITLES.items())
        listed = f"## Tables\n\n{links}\n\n```{{toctree}}\n:hidden:\n" + "\n".join(TITLES) + "\n```\n"
        pages = {TOP: [HEAD, "## Top level\n", *self._rows(self._top["properties"], self._top), listed]}
        pages |= {name: [f"# {title}\n"] for name, title in TITLES.items()}
        for table in self._tables.values():
            pages[table.page] += self._section(table)
        return {f"{name}.md": "\n".join(lines).rstrip() + "\n" for name, lines in pages.items()}

    def tables(self) -> dict[str, Table]:
        """Return the tables by each of their paths; the top level has an empty path."""
        tables = {path: table for table in self._tables.values() for path in table.paths}
        return tables | {"": Table([self._top], False)}

    def _collect(self, path: str, record: Schema) -> None:
        for name, key in record["properties"].items():
            if not (records := self._records(key)):
                continue
            place = f"{path}.{name}{'.NAME' if is_mapping(key) else ''}".lstrip(".")
            known = json.dumps([shape(record) for record in records])
            if known in self._tables:  # the same records at another place
                if place not in self._tables[known].paths:
                    self._tables[known].paths.append(place)
                continue
            self._tables[known] = Table(records, is_array(key), [place])
            for inner in records:
                self._collect(place, inner)

    def _records(self, key: Schema) -> list[Schema]:
        """Return the records that a key may hold, or that its items or named tables are."""
        if "$ref" in key:
            record = self._resolved(key)
            return [record] if "properties" in record else self._records(record)
        parts = [*key.get("anyOf", ()), *key.get("oneOf", ())]
        parts += [key[name] for name in ("items", "additionalProperties") if isinstance(key.get(name), dict)]
        parts += key.get("patternProperties", {}).values()
        return [record for part in parts for record in self._records(part)]

    def _resolved(self, key: Schema) -> Schema:
        return self._definitions[key["$ref"].rpartition("/")[2]] if "$ref" in key else key

    def _section(self, table: Table) -> Iterator[str]:
        """Yield the keys that all alternatives have, then those of each alternative."""
        first, *others = table.records
        common = {
            name: key
            for name, key in first["properties"].items()
            if all(record["properties"].get(name) == key for record in others)
        }
        yield f"## {table.heading}\n"
        if not others:
            yield f"{described(first)}\n"
        if common:
            yield from self._rows(common, first)
        if not others:
            yield from rules(first)
            return
        for record in table.records:
            own = {name: key for name, key in record["properties"].items() if name not in common}
            tag = next((name for name, key in own.items() if "const" in key), None)
            if tag is None:
                title = " and ".join(f"`{name}`" for name in record.get("required", own))
            else:
                title = f'`{tag} = "{own.pop(tag)["const"]}"`'
            yield f"### With {title}\n"
            yield f"{described(record)}\n"
            if own:
                yield from self._rows(own, record)
            yield from rules(record)

    def _rows(self, keys: Schema, record: Schema) -> Iterator[str]:
        yield "| key | value | meaning |\n|---|---|---|"
        for name, key in keys.items():
            value = self._value(key)
            needed = ", required" if name in record.get("required", ()) else default(key)
            meaning = key.get("description") or described(self._resolved(key))
            yield f"| `{name}` | {value}{needed} | {meaning.replace('|', chr(92) + '|')} |"
        yield ""

    def _value(self, key: Schema) -> str:
        """Return the type and the bounds of a value."""
        if self._records(key):
            return "tables by name" if is_mapping(key) else "list of tables" if is_array(key) else "table"
        if "$ref" in key:
            return self._value(self._resolved(key))
        if "const" in key:
            return literal(key["const"])
        if "enum" in key:
            return ", ".join(map(literal, key["enum"]))
        parts = [*key.get("anyOf", ()), *key.get("oneOf", ())]
        if kinds := [self._value(part) for part in parts if part.get("type") not in ("null", None)]:
            return " or ".join(dict.fromkeys(kinds))
        if "prefixItems" in key:
            kinds = [self._value(item) for item in key["prefixItems"]]
            return f"{len(kinds)} × {' or '.join(dict.fromkeys(kinds))}"
        if key.get("type") == "array":
            return f"list of {self._value(key['items'])}"
        bounds = [f"{sign} {number(key[name])}" for name, sign in BOUNDS.items() if name in key]
        return ", ".join([TYPES.get(key.get("type", ""), key.get("type", "any")), *bounds])


def shape(record: Schema) -> Schema:
    """Return the keys of a record without examples: what two tables have in common that are the same."""
    keys = record["properties"].items()
    return {name: {k: v for k, v in key.items() if k != "examples"} for name, key in keys}


def is_mapping(key: Schema) -> bool:
    """Return whether a key holds tables by names that the case chooses."""
    return bool(key.get("patternProperties")) or isinstance(key.get("additionalProperties"), dict)


def is_array(key: Schema) -> bool:
    """Return whether a key holds an array of tables."""
    return key.get("type") == "array" or any(part.get("type") == "array" for part in key.get("anyOf", ()))


def described(record: Schema) -> str:
    """Return the docstring of a record in one line."""
    return " ".join(str(record.get("description", "")).split())


def rules(record: Schema) -> Iterator[str]:
    """Yield which keys of a record exclude each other."""
    if choices := [name for choice in record.get("oneOf", ()) for name in choice.get("required", ())]:
        yield f"Exactly one of {', '.join(f'`{name}`' for name in choices)} is given.\n"


def default(key: Schema) -> str:
    """Return the default of a key that has one."""
    value = key.get("default")
    return "" if value is None or isinstance(value, dict) or value == [] else f"; default {literal(value)}"


def literal(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, list):
        return "[" + ", ".join(map(literal, value)).replace("`", "") + "]"
    if isinstance(value, str):
        return f'`"{value}"`'
    return f"`{str(value).lower() if isinstance(value, bool) else number(value)}`"


def number(value: float) -> str:
    """Return a number with the fewest digits; π/2 and π as such."""
    known = {"1.5708": "π/2", "3.14159": "π", "0.333333": "1/3", "9.22337e+18": "2⁶³"}
    return known.get(f"{value:g}", f"{value:g}")


def pages() -> dict[str, str]:
    """Return the text of each page by its file name."""
    return Keys().pages()


if __name__ == "__main__":
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")

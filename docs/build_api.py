"""Writes docs/reference/python from the docstrings of the public names: python docs/build_api.py"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import exunet
from exunet.base.record import Record, tags
from exunet.plots.registry import ENSEMBLE_FIGURES, FIGURES, STUDY_FIGURES

FOLDER = Path(__file__).parent / "reference" / "python"
HEAD = """# The public interface

`import exunet` gives the names of these pages and no others; `dir(exunet)` lists them. The modules below
`exunet` may change without notice. SI units throughout: shapes of arrays stand in parentheses, units in
brackets. Examples are in `examples/` and in [simulation](../../how_to/simulation.md). These pages are
generated from the docstrings by `docs/build_api.py`.

"""


def pages() -> dict[str, str]:
    """Return the text of each page, one a group of names, by its file name."""
    written = {file_name(group): page(group, names) for group, names in exunet.API.items()}
    lists = (f"- [{group}]({name})" for group, name in zip(exunet.API, written, strict=True))
    contents = "\n".join(name.removesuffix(".md") for name in written)
    written["index.md"] = f"{HEAD}{chr(10).join(lists)}\n\n```{{toctree}}\n:hidden:\n{contents}\n```\n"
    return written


def file_name(group: str) -> str:
    return group.lower().replace(" ", "_") + ".md"


def page(group: str, names: Iterable[str]) -> str:
    """Return the page of a group."""
    parts = [f"# {group}\n"]
    records = [name for name in names if isinstance(getattr(exunet, name), type(Record)) and name != "Scene"]
    for name in names:
        if name not in records:
            parts += entry(name, getattr(exunet, name))
    if records:
        parts += entries_of_records(records)
    if group == "Figures":
        parts.append(table_of_figures())
    return "\n".join(parts)


def entries_of_records(names: list[str]) -> Iterator[str]:
    """Yield the records of a scene with the names of their arguments, which are keys."""
    yield (
        "Records, one for each table of a case. Arguments are given by name; their types, units, bounds and "
        "defaults are those of the [keys](../keys/index.md).\n"
    )
    for name in names:
        record = getattr(exunet, name)
        keys = ", ".join(f"`{key}`" for key in record.model_fields if key not in tags(record))
        yield f"## exunet.{name}\n\n{(inspect.getdoc(record) or '').partition(chr(10))[0]} {keys}\n"


def table_of_figures() -> str:
    """The figures of a result, an ensemble and a study: first lines of the docstrings of their functions."""
    rows = [
        f"| `{name}` | {(inspect.getdoc(figure.draw) or '').partition(chr(10))[0]} | {figure.requires} |\n"
        for name, figure in (FIGURES | ENSEMBLE_FIGURES | STUDY_FIGURES).items()
    ]
    return "| figure | shows | requires |\n|---|---|---|\n" + "".join(rows)


def entry(name: str, thing: Any) -> Iterator[str]:
    """Yield heading, signature and docstring of a function or a class, and of its public members."""
    yield f"## exunet.{name}\n"
    parts = [described(name, thing)]
    if inspect.isclass(thing):
        parts += [f"{base.__name__}: {inspect.getdoc(base)}" for base in inherited_records(thing)]
        for owner in (thing, *inherited_parts(thing)):
            for member, value in vars(owner).items():
                shown = not member.startswith("_") and not hasattr(Record, member)
                if shown and is_member(value) and inspect.getdoc(value):
                    parts.append(described(member, value, "."))
    yield "```text\n" + "\n\n".join(parts) + "\n```\n"


def inherited_records(thing: type) -> Iterator[type]:
    """Yield private bases whose fields a record has."""
    for base in inspect.getmro(thing)[1:]:
        if dataclasses.is_dataclass(base) and not hasattr(exunet, base.__name__):
            yield base


def inherited_parts(thing: type) -> Iterator[type]:
    """Yield private bases in exunet that have methods for this class, and are not records."""
    for base in inspect.getmro(thing)[1:]:
        records = dataclasses.is_dataclass(base) or issubclass(base, tuple | Exception | Record)
        if base.__module__.startswith("exunet") and not records and not hasattr(exunet, base.__name__):
            yield base


def is_member(value: Any) -> bool:
    return isinstance(value, FunctionType | property | classmethod | staticmethod)


def described(name: str, thing: Any, prefix: str = "") -> str:
    """Return a signature, or the name of a property or a plain value, with the docstring below it."""
    text = inspect.getdoc(thing) or ""
    if isinstance(thing, property):
        head = name
    elif inspect.isclass(thing):
        plain = dataclasses.is_dataclass(thing) or issubclass(thing, Exception | Record)
        head = "" if plain else signature(name, thing).removesuffix(" -> None")
    else:
        inner = thing.__func__ if isinstance(thing, classmethod | staticmethod) else thing
        head = signature(name, inner)
        for first in ("\n    self,", "\n    cls,", "self, ", "self", "cls, ", "cls"):
            head = head.replace(f"({first}", "(", 1)
    if not head:
        return text
    return f"{prefix}{head}\n" + "\n".join(f"    {line}".rstrip() for line in text.splitlines())


def signature(name: str, thing: Any) -> str:
    """Return a signature without quotation marks around types, on several lines if it is long."""
    parameters = inspect.signature(thing)
    text = f"{name}{parameters}".replace("'", "")
    if len(text) <= 110:
        return text
    lines = []
    for parameter in parameters.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in lines:
            lines.append("*")
        lines.append(str(parameter).replace("'", ""))
    arguments = ",\n    ".join(lines)
    annotation = parameters.return_annotation
    returns = "" if annotation is inspect.Signature.empty else f" -> {annotation}"
    return f"{name}(\n    {arguments},\n){returns}"


if __name__ == "__main__":
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")

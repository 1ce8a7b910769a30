"""From what pydantic finds wrong in a record to faults with the keys of a case."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo

from exunet.base.key_path import KeyPath, closest

FAULTS = "faults"  # type of the pydantic error that carries faults in its context
AnyRecord = TypeVar("AnyRecord", bound=BaseModel)
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


def explained(error: ValidationError, record: type[BaseModel]) -> list[Located]:
    """Return every fault that a validation of a record found, with keys relative to the record."""
    items = [item for item in error.errors(include_url=False) if not _follows_from_another(item)]
    last = {item["loc"][:-1]: item for item in items if _is_short(item)}  # of the missing items of each list
    items = [item for item in items if not _is_short(item) or item is last[item["loc"][:-1]]]
    return [fault for item in items for fault in _explained(item, record)]


def validated_record(
    document: dict[str, Any], kind: type[AnyRecord]
) -> tuple[AnyRecord | None, list[Located]]:
    """Validate a document: its record, or None and every fault."""
    try:
        return kind.model_validate(document), []
    except ValidationError as error:
        return None, explained(error, kind)


def _follows_from_another(error: Any) -> bool:
    """True for a list that is short only by its items that are not valid, and a default that needs a key."""
    if error["type"] == "default_factory_not_called":
        return True
    return error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]


def _is_short(error: Any) -> bool:
    return error["type"] == "missing" and isinstance(error["loc"][-1], int)


def _explained(error: Any, root: type[BaseModel]) -> Iterator[Located]:
    """Yield the faults of one of pydantic's `errors()`."""
    path, record, field = _located(error["loc"], root)
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    path = path[:-1] if path and path[-1] == "[key]" else path
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
    elif _is_short(error):
        path, reason = path[:-1], f"must have {int(path[-1]) + 1} items, got {shown(value)}"
    elif kind in ("too_short", "too_long"):
        bound, of = ("at least", "min_length") if kind == "too_short" else ("at most", "max_length")
        items = "item" if context[of] == 1 else "items"
        reason = f"must have {bound} {context[of]} {items}, got {shown(value)}"
    elif kind == "missing":
        reason = _missing(field)
    elif kind == "extra_forbidden":
        reason = _unknown(str(path[-1]), record)
    elif kind == "string_pattern_mismatch":  # only names that a case chooses: keys of tables, of entries
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


def _located(loc: KeyPath, root: type[BaseModel]) -> tuple[KeyPath, type[BaseModel] | None, FieldInfo | None]:
    """The path of pydantic's `loc` in a record, without tags of unions; the record and the field there."""
    path: KeyPath = ()
    kind: Any = root
    record, field = None, None
    for part in loc:
        members = list(alternatives(kind))
        if len(members) > 1:  # of a tagged union, whose tag pydantic puts into the path
            kind = next((member for tag, member in members if part == tag or part in _tags(member)), None)
            continue
        kind, path = members[0][1] if members else None, (*path, part)
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            record, field = kind, kind.model_fields.get(str(part))
            kind = None if field is None else field.annotation
        else:  # a mapping from names, or a list
            kind = next(reversed([arg for arg in get_args(kind) if arg is not Ellipsis]), None)
    return path, record, field


def is_chosen_name(path: KeyPath, root: type[BaseModel]) -> bool:
    """Return True for the path of a table whose name the case chooses, such as that of a body."""
    found, record, field = _located(path, root)
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


def _unknown(name: str, record: type[BaseModel] | None) -> str:
    known = list(record.model_fields) if record else []
    if close := closest(name, known):
        return f"unknown key; did you mean '{close}'?"
    if owners := getattr(record, "owners_of", lambda _: "")(name):
        return f"unknown key of this table; {owners} have it"
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
    if isinstance(value, str):
        return _cut(json.dumps(value, ensure_ascii=False)[:-1], '"')
    if isinstance(value, int) and value.bit_length() > 64:  # Python refuses to write very long ones
        return "a whole number of more than 64 bits"
    return str(value)


def _cut(text: str, end: str) -> str:
    return (text if len(text) <= 60 else text[:57] + "...") + end

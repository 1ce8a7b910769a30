"""What is valid in a table that has faults, so that its other keys can still be checked with each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, TypeVar, get_args, get_origin

from pydantic import BaseModel

from exunet.base.errors import KeyPath
from exunet.base.table import Unknown

Record = TypeVar("Record", bound=BaseModel)


def valid_part(model: type[Record], keys: Mapping[str, Any], faults: Sequence[KeyPath]) -> Record:
    """A record of `model` without the fields of `keys` that are missing or at fault.

    faults : where pydantic found them, relative to this table. Tables inside that have faults lose the fields
    at fault; lists of any length have None in place of such items.
    """
    record = model.model_construct(set(keys) & set(model.model_fields))
    for name, field in model.model_fields.items():
        of_field = [loc[1:] for loc in faults if loc[:1] == (name,)]
        try:
            if name in keys or of_field:
                kinds = list(_alternatives(field.annotation))
                record.__dict__[name] = _valid(kinds, keys.get(name), of_field)
        except Unknown:
            record.__dict__.pop(name, None)
    return record


def _valid(kinds: list[Any], value: Any, faults: Sequence[KeyPath]) -> Any:
    """What is valid of one value of these types; raises Unknown if nothing is."""
    if () in faults:
        raise Unknown
    if isinstance(value, dict):
        if get_origin(kinds[0]) is Mapping:
            of_item = {key: [loc[1:] for loc in faults if loc[0] == key] for key in value}
            kind = [get_args(kinds[0])[1]]
            return {key: _valid(kind, value[key], of_item[key]) for key in value if () not in of_item[key]}
        return valid_part(_table(kinds, value), value, faults)
    if (table := _of_rows(kinds)) is not None and isinstance(value, list):
        of_row = [[loc[1:] for loc in faults if loc[0] == k] for k in range(len(value))]
        rows = zip(value, of_row, strict=True)
        return tuple(None if () in wrong else valid_part(table, row, wrong) for row, wrong in rows)
    if not faults:
        return _frozen(value)
    if not any(get_origin(kind) is tuple and Ellipsis in get_args(kind) for kind in kinds):
        raise Unknown
    bad = {loc[0] for loc in faults}
    return tuple(None if k in bad else _frozen(item) for k, item in enumerate(value))


def _alternatives(annotation: Any) -> Iterator[Any]:
    """The types that a field may have, out of `X | None`, unions and Annotated."""
    if get_origin(annotation) is Annotated:
        yield from _alternatives(get_args(annotation)[0])
    elif get_args(annotation) and get_origin(annotation) not in (tuple, Mapping):
        for one in get_args(annotation):
            yield from _alternatives(one)
    else:
        yield annotation


def _table(kinds: list[Any], value: Mapping[str, Any]) -> type[BaseModel]:
    """The record that a table is for: of several, that of the net's topology."""
    tables = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    if len(tables) == 1:
        return tables[0]
    return next(
        table for table in tables if value["topology"] in get_args(table.model_fields["topology"].annotation)
    )


def _of_rows(kinds: list[Any]) -> type[BaseModel] | None:
    """The record that each item of a list is, if these types are such lists."""
    items = [get_args(kind)[0] for kind in kinds if get_origin(kind) is tuple]
    if len(items) == 1 and isinstance(items[0], type) and issubclass(items[0], BaseModel):
        return items[0]
    return None


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value

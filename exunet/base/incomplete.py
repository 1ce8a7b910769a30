"""What is valid in a table that has faults, so that checks between its other keys can still be made."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, SupportsIndex, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

Path = tuple[str | int, ...]


class Unknown(Exception):
    """A value that is missing or not valid; a check that needs it has nothing to say."""


class Items(tuple[Any, ...]):
    """A list in which some items are not valid: to ask for one of those raises Unknown."""

    def __getitem__(self, k: SupportsIndex | slice) -> Any:
        item = super().__getitem__(k)
        if item is Unknown:
            raise Unknown
        return item

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self)))


def partial(model: type[BaseModel], keys: Any, faults: Sequence[Path]) -> BaseModel:
    """A record of `model` without the fields of `keys` that are missing or at fault.

    faults : where pydantic found them, relative to this table. Tables in it that have faults are partial too;
    lists of any length have `Items`. Nothing is known of a table that is not a dict.
    """
    known: dict[str, Any] = {}
    unknown = set()
    for name, field in model.model_fields.items():
        if not isinstance(keys, dict) or (name not in keys and field.is_required()):
            unknown.add(name)
        elif name in keys:
            try:
                known[name] = _value(field, keys[name], [loc[1:] for loc in faults if loc[:1] == (name,)])
            except Unknown:
                unknown.add(name)
    record = model.model_construct(set(keys) if isinstance(keys, dict) else set(), **known)
    for name in unknown:  # pydantic has put the defaults there
        record.__dict__.pop(name, None)
    return record


def _value(field: FieldInfo, value: Any, faults: list[Path]) -> Any:
    kinds = list(_alternatives(field.annotation))
    if tables := [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]:
        if field.discriminator is None:
            return partial(tables[0], value, faults)
        return partial(_tagged(tables, str(field.discriminator), value), value, [loc[1:] for loc in faults])
    any_length = any(get_origin(kind) is tuple and Ellipsis in get_args(kind) for kind in kinds)
    if not faults:
        return _frozen(value)
    if not (any_length and isinstance(value, list) and all(faults)):
        raise Unknown
    bad = {loc[0] for loc in faults}
    return Items(Unknown if k in bad else _frozen(item) for k, item in enumerate(value))


def _alternatives(annotation: Any) -> Iterator[Any]:
    """The types that a field may have, out of `X | None`, unions and Annotated."""
    if get_origin(annotation) is Annotated:
        yield from _alternatives(get_args(annotation)[0])
    elif get_args(annotation) and get_origin(annotation) is not tuple:
        for one in get_args(annotation):
            yield from _alternatives(one)
    else:
        yield annotation


def _tagged(tables: list[type[BaseModel]], tag: str, value: Any) -> type[BaseModel]:
    name = value.get(tag) if isinstance(value, dict) else None
    for table in tables:
        if name in get_args(table.model_fields[tag].annotation):
            return table
    raise Unknown


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value

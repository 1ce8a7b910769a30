"""The base of every frozen, validated record that a case file fills."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from functools import cache
from inspect import Parameter, Signature
from itertools import islice, pairwise
from keyword import iskeyword
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    Strict,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from exunet.base.errors import CaseError, Fault, InputError, within
from exunet.base.key_path import dotted
from exunet.base.validation import FAULTS, Located, explained, literals

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]
Number = Annotated[int, Field(ge=0)]  # of an item that is counted from 0
# A TOML array arrives as a list, which a strict tuple refuses; its items stay strict.
FromArray = Strict(False)
Vector = Annotated[tuple[float, float, float], FromArray]

SHOWN = 20  # faults of one list


class Record(BaseModel):
    """A frozen record: unknown keys, NaN, infinities and values of the wrong type are errors.

    A subclass overrides `faults` to check its keys against each other. The constructor takes keys of a case
    file by name: plain values, NumPy scalars and arrays, records, and dictionaries in place of records.

    EXACTLY_ONE : keys of which a case gives exactly one, or none
    TABLE       : the only table of a case that has this record, which errors name; None: the class is named
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)
    EXACTLY_ONE: ClassVar[tuple[str, ...]] = ()
    TABLE: ClassVar[str | None] = None

    def __init__(self, /, *args: Any, **keys: Any) -> None:
        kind = type(self)
        if args:
            names = ", ".join(_argument(name, kind.model_fields[name]) for name in _arguments(kind))
            raise InputError(f"{kind.__name__} takes arguments by name only: {kind.__name__}({names})")
        try:
            self.__pydantic_validator__.validate_python(tags(kind) | plain(keys), self_instance=self)
        except ValidationError as error:
            table = kind.__name__ if self.TABLE is None else self.TABLE
            raise unlocated(explained(error, kind), table) from None

    # So that pydantic fills nested records without a call of __init__.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        required = {name: Parameter.empty for name, field in cls.model_fields.items() if field.is_required()}
        defaults = {
            name: field.default for name, field in cls.model_fields.items() if not field.default_factory
        }
        cls.__signature__ = Signature(
            [
                Parameter(name, Parameter.KEYWORD_ONLY, default=required.get(name, defaults.get(name)))
                for name in _arguments(cls)
            ]
        )

    if not TYPE_CHECKING:  # a type checker knows that fields are frozen

        def __setattr__(self, name: str, value: Any) -> None:
            raise _frozen(self, name)

        def __delattr__(self, name: str) -> None:
            raise _frozen(self, name)

    def document(self) -> dict[str, Any]:
        """Return the given keys as a table of a case file: plain values, lists and dictionaries."""
        given = ((name, getattr(self, name)) for name in type(self).model_fields if self.is_given(name))
        return {name: plain(value) for name, value in given}

    def __repr__(self) -> str:
        kind = type(self)
        names = [name for name in kind.model_fields if self.is_given(name) and name not in tags(kind)]
        return f"{kind.__name__}({', '.join(f'{name}={_brief(getattr(self, name))}' for name in names)})"

    __str__ = __repr__

    def faults(self) -> Iterator[Fault]:
        """Yield the contradictions between keys of this record; keys are relative to it."""
        yield from ()

    def is_given(self, name: str) -> bool:
        """True if the case has this key."""
        return name in self.model_fields_set and getattr(self, name) is not None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if found := [*self._choices(), *self.faults()]:
            message = "; ".join(str(fault) for fault in found).replace("{", "{{").replace("}", "}}")
            raise PydanticCustomError(FAULTS, message, {FAULTS: found})
        return self

    def _choices(self) -> Iterator[Fault]:
        given = [name for name in self.EXACTLY_ONE if self.is_given(name)]
        if self.EXACTLY_ONE and len(given) != 1:
            names = f"{', '.join(self.EXACTLY_ONE[:-1])} or {self.EXACTLY_ONE[-1]}"
            key, against = (given[-1], tuple(given[:-1])) if given else ("", ())
            remedy = f", got {' and '.join(given)}: remove all but one" if given else ""
            yield Fault(key, f"requires exactly one of {names}{remedy}", against=against)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = handler(core_schema)
        if cls.EXACTLY_ONE:
            handler.resolve_ref_schema(schema)["oneOf"] = [{"required": [name]} for name in cls.EXACTLY_ONE]
        return schema


@cache
def tags(kind: type[Record]) -> dict[str, Any]:
    """Return the required keys that have one possible value, such as `topology`, with this value."""
    found = {name: literals(field) for name, field in kind.model_fields.items() if field.is_required()}
    return {name: values[0] for name, values in found.items() if len(values) == 1}


def _arguments(kind: type[Record]) -> list[str]:
    """Return the arguments of a constructor, the required ones first."""
    names = [name for name in kind.model_fields if not iskeyword(name) and name not in tags(kind)]
    return sorted(names, key=lambda name: not kind.model_fields[name].is_required())


def _argument(name: str, field: FieldInfo) -> str:
    return f"{name}={'…' if field.is_required() or field.default_factory else _brief(field.default)}"


def _frozen(record: Record, name: str) -> InputError:
    words = "records are frozen: construct another with this value, or use Scene.replace"
    return InputError(f"{type(record).__name__}.{name}: {words}")


def plain(value: Any) -> Any:
    """Return a value as a TOML document has it; values of other types as they are."""
    if isinstance(value, Record):
        return value.document()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return value.value
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def unlocated(found: Iterable[Located], table: str = "") -> CaseError:
    """Return the error for faults of a record that is not from a file; keys are relative to the table."""
    faults = [Fault(dotted(paths[0]), reason) for paths, reason in found]
    return CaseError([*within(table, faults)] if table else faults)


def _brief(value: Any) -> str:
    """A value in a few words: the classes of records, the names in tables, the sizes of long lists."""
    if isinstance(value, Record):
        return f"{type(value).__name__}(...)"
    if isinstance(value, Mapping):
        return f"{{{', '.join(map(repr, value))}}}"
    if isinstance(value, tuple) and (
        len(value) > 4 or any(isinstance(item, tuple | Record) for item in value[:1])
    ):
        return f"<{len(value)} items>"
    return repr(value)


def one_of(*records: type[Record]) -> Discriminator:
    """Choose among alternative records, without a required key in common, by those that a table has.

    The tag of each alternative is "a and b" of its required keys a, b.
    """
    required = (
        [name for name, field in item.model_fields.items() if field.is_required()] for item in records
    )
    tags = {" and ".join(names): names for names in required}

    def tag_of(keys: Any) -> str | None:
        if not isinstance(keys, dict | BaseModel):
            return next(iter(tags))  # whose record reports it
        given = keys.model_fields_set if isinstance(keys, BaseModel) else keys
        counts = {tag: sum(name in fields for name in given) for tag, fields in tags.items()}
        found = [tag for tag, count in counts.items() if count]
        return found[0] if len(found) == 1 else None

    message = f"requires either {', or '.join(tags)}"
    return Discriminator(tag_of, custom_error_type="alternatives", custom_error_message=message)


def config_of(module: ModuleType, suffix: str = "") -> Any:
    """The record of a module: `AirDrag` of `air_drag`; of alternatives their union, `Any...`."""
    name = class_name(module, suffix)
    return getattr(module, f"Any{name}", None) or getattr(module, name)


def class_name(module: ModuleType, suffix: str = "") -> str:
    """`AirDrag` of a module `air_drag`."""
    return "".join(part.title() for part in module.__name__.rpartition(".")[2].split("_")) + suffix


def shortened(faults: Iterator[Fault]) -> Iterator[Fault]:
    """Yield the first faults of a long list, and the number of the others."""
    last = None
    for last in islice(faults, SHOWN):
        yield last
    if last and (more := sum(1 for _ in faults)):
        yield Fault(last.key.partition("[")[0], f"and {more} more like these")


def distinct(names: Iterable[str]) -> Iterator[Fault]:
    """Yield a fault for each name that differs from an earlier one by capital letters only."""
    known: dict[str, str] = {}
    for name in names:
        before = known.setdefault(name.lower(), name)
        if before != name:
            yield Fault(name, f'differs from "{before}" by capital letters only: rename one')


def increasing(key: str, times: Sequence[float], of: str = "") -> Iterator[Fault]:
    """Yield a fault for each time [s] of a list that is not later than the time before it."""
    for k, (before, time) in enumerate(pairwise(times), start=1):
        if time <= before:
            reason = f"must be greater than the time before it, {before:g} s, got {time:g}"
            yield Fault(f"{key}[{k}]{of}", reason)


def once(key: str, numbers: Sequence[int]) -> Iterator[Fault]:
    """Yield a fault for each number that a list has twice."""
    for k, number in enumerate(numbers):
        if number in numbers[:k]:
            yield Fault(f"{key}[{k}]", f"{number} is listed twice")

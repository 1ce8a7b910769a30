"""The base of every frozen, validated record that a case file fills."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from exunet.base.faults import Wrong, refuse_all
from exunet.base.incomplete import Unknown, partial

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]
# A TOML array arrives as a list, which a strict tuple refuses; its items stay strict.
FromArray = Strict(False)
Vector = Annotated[tuple[float, float, float], FromArray]


def exactly_one(first: str, second: str) -> ConfigDict:
    """Tells the JSON schema that a table has one of two keys; for the reader `unless_one` says why not."""
    return ConfigDict(json_schema_extra={"oneOf": [{"required": [first]}, {"required": [second]}]})


Check = Callable[[Any], Iterator[Wrong]]
AnyCheck = TypeVar("AnyCheck", bound=Check)


def check(method: AnyCheck) -> AnyCheck:
    """Mark a method of a Table, `method(self) -> Iterator[Wrong]`, as a check between its keys.

    It is made also if other keys have faults: then `self` lacks those, and asking for one raises Unknown,
    which ends the check. A check of many items catches Unknown for each.
    """
    method.is_check = True  # type: ignore[attr-defined]
    return method


class Table(BaseModel):
    """A frozen record: unknown keys, NaN, infinities and values of the wrong type are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in type(self).model_fields:
                raise Unknown(name)
            return super().__getattr__(name)

    def gives(self, name: str) -> bool:
        """True if the case has this key, valid or not."""
        return name in self.model_fields_set and self.__dict__.get(name, Unknown) is not None

    @model_validator(mode="wrap")
    @classmethod
    def _checked(cls, keys: Any, handler: Any) -> Any:
        """Faults of single keys and of the checks, all at once."""
        found: ValidationError | None = None
        try:
            record = handler(keys)
        except ValidationError as error:
            if not isinstance(keys, dict):
                raise
            found = error
            record = partial(cls, keys, [one["loc"] for one in error.errors(include_url=False)])
        refuse_all([_wrongs(one, record) for one in _checks(cls)], found)
        return record


@functools.cache
def _checks(model: type[Table]) -> list[Check]:
    return [
        method
        for base in reversed(model.__mro__)
        for method in vars(base).values()
        if getattr(method, "is_check", False)
    ]


def _wrongs(one: Check, record: Any) -> list[Wrong]:
    wrongs = []
    with suppress(Unknown):
        for wrong in one(record):
            wrongs.append(wrong)  # noqa: PERF402 - those before an Unknown count
    return wrongs

"""Faults that a record's validators find between keys, each with the key that it is about."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

SHOWN = 20  # of the faults that one check finds in a long list


class Wrong(NamedTuple):
    """A fault at `where`: keys and list indexes that lead to it from the record or field being validated."""

    where: tuple[str | int, ...]
    reason: str
    value: Any = None


def refuse(wrongs: Sequence[Wrong]) -> None:
    """Raise a ValidationError with all `wrongs`, if any; in a validator, pydantic adds the outer location."""
    refuse_all([wrongs])


def refuse_all(checks: Sequence[Sequence[Wrong]], error: ValidationError | None = None) -> None:
    """Raise what several checks found together with the faults of `error`, if there are any."""
    details = [detail for wrongs in checks if wrongs for detail in _details(wrongs)]
    if details:
        raise ValidationError.from_exception_data("case", [*again(error), *details] if error else details)
    if error:
        raise error


def refuse_too(error: ValidationError, other: ValidationError | None) -> None:
    """Raise the faults of both errors, if there is another."""
    if other:
        raise ValidationError.from_exception_data("case", [*again(error), *again(other)])


def refuse_with(wrongs: Sequence[Wrong], value: Any, handler: Callable[[Any], Any]) -> Any:
    """What a wrapped validation, `handler(value)`, returns; its faults are told together with `wrongs`."""
    try:
        valid = handler(value)
    except ValidationError as error:
        raise ValidationError.from_exception_data("case", [*again(error), *_details(wrongs)]) from None
    refuse(wrongs)
    return valid


def unless_one(names: tuple[str, str], keys: Any) -> list[Wrong]:
    """A fault if not exactly one of two keys is in a table: at the second, or at the table without any."""
    if not isinstance(keys, dict):
        return []
    given = [name for name in names if keys.get(name) is not None]
    if len(given) == 1:
        return []
    where = (names[1],) if given else ()
    return [Wrong(where, f"give either {names[0]} or {names[1]}, exactly one of them")]


def _details(wrongs: Sequence[Wrong]) -> list[InitErrorDetails]:
    shown = list(wrongs[:SHOWN])
    if len(wrongs) > SHOWN:
        shown.append(Wrong(wrongs[0].where[:1], f"and {len(wrongs) - SHOWN} more like these"))
    return [
        InitErrorDetails(
            type=PydanticCustomError("fault", "{reason}", {"reason": wrong.reason}),
            loc=wrong.where,
            input=wrong.value,
        )
        for wrong in shown
    ]


def again(error: ValidationError) -> list[InitErrorDetails]:
    """The faults of an error, to be raised together with others."""
    details = []
    for found in error.errors(include_url=False):
        context = found.get("ctx", {})
        kind = (
            PydanticCustomError("fault", "{reason}", context) if found["type"] == "fault" else found["type"]
        )
        details.append(InitErrorDetails(type=kind, loc=found["loc"], input=found["input"], ctx=context))
    return details

"""Faults that a record's validators find between keys, each with the key that it is about."""

from __future__ import annotations

from collections.abc import Sequence
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
    if not wrongs:
        return
    shown = list(wrongs[:SHOWN])
    if len(wrongs) > SHOWN:
        shown.append(Wrong(wrongs[0].where[:1], f"and {len(wrongs) - SHOWN} more like these"))
    details = [
        InitErrorDetails(
            type=PydanticCustomError("fault", "{reason}", {"reason": wrong.reason}),
            loc=wrong.where,
            input=wrong.value,
        )
        for wrong in shown
    ]
    raise ValidationError.from_exception_data("case", details)

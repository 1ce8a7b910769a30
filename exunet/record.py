"""The base of every frozen, validated record that a case file fills."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]
# A TOML array arrives as a list, which a strict tuple refuses; its items stay strict.
FromArray = Strict(False)
Vector = Annotated[tuple[float, float, float], FromArray]


class Record(BaseModel):
    """A frozen record: unknown keys, NaN, infinities and values of the wrong type are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

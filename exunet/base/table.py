"""The base of every frozen, validated record that a case file fills."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, Strict

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]
# A TOML array arrives as a list, which a strict tuple refuses; its items stay strict.
FromArray = Strict(False)
Vector = Annotated[tuple[float, float, float], FromArray]


class Unknown(Exception):
    """A key that is missing or not valid was asked for; a cross check that needs it has nothing to say."""


class Table(BaseModel):
    """A frozen record: unknown keys, NaN, infinities and values of the wrong type are errors.

    Only what concerns a single key is checked here; what keys demand of each other is checked afterwards, by
    plain functions (exunet.case.cross_checks), which may be given the valid part of a table that has faults.
    There, to ask for a key that is missing or not valid raises Unknown.

    EXACTLY_ONE : keys of which a case gives exactly one, for reader and JSON schema; or none
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    EXACTLY_ONE: ClassVar[tuple[str, ...] | None] = None

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in type(self).model_fields:
                raise Unknown(name)
            return super().__getattr__(name)

    def is_given(self, name: str) -> bool:
        """True if the case has this key, valid or not."""
        return name in self.model_fields_set and self.__dict__.get(name, Unknown) is not None

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = handler(core_schema)
        if cls.EXACTLY_ONE:
            handler.resolve_ref_schema(schema)["oneOf"] = [{"required": [name]} for name in cls.EXACTLY_ONE]
        return schema

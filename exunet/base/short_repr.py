"""Representations of dataclasses with large arrays that fit on a few lines."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

_SMALL = 4  # array entries and names shown in full
_TEXT = 60  # characters of a text


class ShortRepr:
    """Dataclass whose representation gives types and shapes of arrays instead of their values.

    Fields without a value are left out. The dataclass needs ``repr=False``.
    """

    def __repr__(self) -> str:
        values = ((field.name, getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]
        shown = (f"{name}={_short(value)}" for name, value in values if value is not None)
        return f"{type(self).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    """Represent a value on a part of a line."""
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple):
        size = len(shape) == 1 and shape[0]
        if 0 < size <= _SMALL:
            return str(value[:].tolist())
        return f"<{'x'.join(map(str, shape)) or 'scalar'} {getattr(value, 'dtype', 'float64')}>"
    if isinstance(value, Mapping):
        names = [str(name) for name in value]
        more = f", … {len(names)} in all" if len(names) > _SMALL else ""
        return f"{{{', '.join(names[:_SMALL])}{more}}}"
    if isinstance(value, str | Path):
        text = str(value)
        return repr(text if len(text) <= _TEXT else f"{text[:_TEXT]}…")
    if is_dataclass(value):
        return f"<{type(value).__name__}>"
    if isinstance(value, Sized) and len(value) > _SMALL:
        return f"<{type(value).__name__} of {len(value)}>"
    text = repr(value)
    return text if len(text) <= _TEXT else f"<{type(value).__name__}>"

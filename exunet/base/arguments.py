"""Checks of arguments of public functions; short representations of dataclasses with large arrays."""

from __future__ import annotations

import inspect
import math
import operator
import os
from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import fields, is_dataclass
from functools import wraps
from numbers import Real
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.errors import InputError

_P = ParamSpec("_P")
_R = TypeVar("_R")

# What is meant by a type, where its name does not say where to get it.
_WORDS = {
    "str": "a text",
    "bool": "True or False",
    "Callable": "a function",
    "Result": "a Result (of exunet.run or exunet.load_result)",
    "Ensemble": "an Ensemble (of exunet.ensemble or exunet.load_ensemble)",
    "StudyData": "a StudyData (of exunet.studies.report.study_data)",
    "Start": "a Start (of exunet.prepare)",
    "Net": "a Net (`net` of a Result or a Start)",
    "Agreement": "an Agreement (of exunet.compare)",
}
_SHOWN = 60  # characters of a value


def takes(**kinds: Any) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Let a function raise InputError for arguments that are not of these types, or tuples of them.

    None is, where it is the default.
    """

    def checked(function: Callable[_P, _R]) -> Callable[_P, _R]:
        parameters = inspect.signature(function).parameters
        expected = [
            (place, name, kinds[name], parameters[name].default is None)
            for place, name in enumerate(parameters)
            if name in kinds
        ]

        @wraps(function)
        def with_checks(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            for place, name, kind, optional in expected:
                if place >= len(args) and name not in kwargs:
                    continue
                given = args[place] if place < len(args) else kwargs[name]
                if not (isinstance(given, kind) or (optional and given is None)):
                    raise InputError(
                        f"{function.__name__}: {name}: needs {_wanted(kind)}, got {shown(given)}"
                    )
            return function(*args, **kwargs)

        return with_checks

    return checked


def shown(given: object) -> str:
    """An argument in a few words: plain values themselves, others by their type."""
    words = repr(given)
    plain = given is None or isinstance(given, bool | int | float | str | os.PathLike)
    return words if plain and len(words) <= _SHOWN else f"a value of type {type(given).__name__}"


def _wanted(kind: Any) -> str:
    names = [item.__name__ for item in (kind if isinstance(kind, tuple) else (kind,))]
    return " or ".join(_WORDS.get(name, f"a {name}") for name in names)


def finite_number(given: object) -> float | None:
    """A finite number, else None."""
    if type(given) is float:
        return given if math.isfinite(given) else None
    if isinstance(given, bool) or not isinstance(given, Real):
        return None
    try:
        number = float(given)
    except OverflowError:  # a whole number or a fraction beyond floating point
        return None
    return number if math.isfinite(number) else None


def whole_number(given: object) -> int | None:
    """A whole number of any type, else None."""
    if isinstance(given, bool):
        return None
    try:
        return operator.index(given)  # type: ignore[arg-type]
    except TypeError:
        return None


def finite_vector(given: ArrayLike, number: int) -> NDArray[np.float64] | None:
    """So many finite numbers, or a number alone where it is one, as (number,); else None."""
    if isinstance(given, Sequence) and any(isinstance(item, bool) for item in given):
        return None  # NumPy would take it for a number beside others
    try:
        vector = np.asarray(given)
    except (TypeError, ValueError):
        return None
    if number == 1 and vector.ndim == 0:
        vector = vector[None]
    if vector.shape != (number,) or vector.dtype.kind not in "iuf" or not np.isfinite(vector).all():
        return None
    return vector.astype(np.float64)


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

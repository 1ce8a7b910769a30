"""Arguments of public functions that are of a wrong type are told in words."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from exunet.base.errors import InputError

_P = ParamSpec("_P")
_R = TypeVar("_R")

# What is meant by a type, where its name does not say where to get it.
_WORDS = {
    "str": "a text",
    "bool": "True or False",
    "Callable": "a function",
    "Result": "a Result (of exunet.run or exunet.load_result)",
    "EnsembleResult": "an EnsembleResult (of exunet.ensemble or exunet.load_ensemble)",
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
    names = [one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,))]
    return " or ".join(_WORDS.get(name, f"a {name}") for name in names)

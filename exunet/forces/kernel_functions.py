"""What a function of a kernel may look like: its arguments, and the names that it may use.

Its text is put into a compiled file without the module that it stands in, so a name of that module is not
there. Numba would say so only as the file is compiled, in its own words.
"""

from __future__ import annotations

import builtins
import dis
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import CodeType
from typing import Any

Function = Callable[..., Any]

ARGUMENTS = {
    "add": ("t", "x", "v", "data", "force"),
    "place": ("t", "x", "v", "data"),
    "potential": ("x", "data"),
    "power": ("t", "x", "v", "data"),
    "work": ("h", "begin", "end", "data"),
    "remember": ("t", "x", "v", "data"),
}
MODULES = ("math", "np")


def refuse_wrong(functions: Mapping[str, Function | None], helpers: Iterable[Function]) -> None:
    """Raise TypeError for a function of other arguments, or one that uses a name that is not there.

    functions : by their names in ARGUMENTS; None: there is none
    helpers   : functions that these, and other helpers, call
    """
    for name, function in functions.items():
        arguments = ARGUMENTS[name]
        if function is not None and function.__code__.co_argcount != len(arguments):
            raise TypeError(f"{_told(function)}: its arguments must be ({', '.join(arguments)})")
    helpers = tuple(helpers)
    known = {*MODULES, *dir(builtins), *(one.__name__ for one in helpers)}
    for function in (*functions.values(), *helpers):
        if function is not None and (unknown := _globals_of(function.__code__) - known):
            raise TypeError(
                f"{_told(function)} uses {', '.join(sorted(unknown))}: a function of a kernel may use its "
                "arguments, math, np and its helpers only; make a number an entry of its data, and a "
                "function one of its helpers"
            )


def _told(function: Function) -> str:
    return f"{function.__module__}.{function.__qualname__}"


@cache
def _globals_of(code: CodeType) -> frozenset[str]:
    """The global names that a function reads."""
    return frozenset(one.argval for one in dis.get_instructions(code) if one.opname == "LOAD_GLOBAL")

"""One call in a compiled kernel: functions, their arguments and permitted names, and data.

Its text is put into a compiled file without the module that it stands in, so a name of that module is not
there. Numba would say so only as the file is compiled, in its own words.
"""

from __future__ import annotations

import builtins
import dis
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
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

    functions : by their names in ARGUMENTS; None: absent
    helpers   : functions that these, and other helpers, call
    """
    for name, function in functions.items():
        arguments = ARGUMENTS[name]
        if function is not None and function.__code__.co_argcount != len(arguments):
            raise TypeError(f"{_label(function)}: its arguments must be ({', '.join(arguments)})")
    helpers = tuple(helpers)
    known = {*MODULES, *dir(builtins), *(helper.__name__ for helper in helpers)}
    for function in (*functions.values(), *helpers):
        if function is not None and (unknown := _globals_of(function.__code__) - known):
            raise TypeError(
                f"{_label(function)} uses {', '.join(sorted(unknown))}: a function of a kernel may use its "
                "arguments, math, np and its helpers only; make a number an entry of its data, and a "
                "function one of its helpers"
            )


def _label(function: Function) -> str:
    return f"{function.__module__}.{function.__qualname__}"


@cache
def _globals_of(code: CodeType) -> frozenset[str]:
    """The global names that a function reads."""
    return frozenset(
        instruction.argval
        for instruction in dis.get_instructions(code)
        if instruction.opname == "LOAD_GLOBAL"
    )


@dataclass(frozen=True, eq=False)
class KernelCall:
    """One call in a compiled kernel.

    add     : module-level function add(t, x, v, data, force) that adds its forces [N], torques [N m] and
              rates of first-order states to `force`; x, v, force are flat arrays over all blocks, in the
              subset of Python that Numba compiles. It may use `math`, `np` and its `helpers`, no other global
              name
    data    : a named tuple of arrays, floats and ints. They are data of the compiled function, not text in
              it: a kind of force is compiled once, for all scenes
    helpers : module-level functions that the others call
    jumps   : the force jumps where an element becomes taut (see `exunet.forces.cable_term`)
    elastic : `add` returns the elastic energy [J] that it finds on its way
    place   : function place(t, x, v, data) that puts what follows from time and other entries into x and v,
              before any force is added; that of a later call comes before that of an earlier one
    tells_power : `add` returns the power [W] that it takes out, which depends on velocities alone
    remember : function remember(t, x, v, data) that changes arrays of the data at the end of each accepted
              step, whose state `add` was called with last; see `Memory.kept_in`
    held    : the data is large: compiled code gets a reference to it instead of all its words
    of_many : the functions are right for many runs at once too: x, v and force, and what is made of them,
              have a value in each run, with which arithmetic, max, min, abs and math.sqrt can be done. A
              condition on such values is true where it holds in one run, so what stands under it must change
              nothing in the others

    The energy that it stores or takes out comes from these; none means a force that does no work:
    potential : function potential(x, data) -> [J]
    power     : function power(t, x, v, data) -> [W] taken out
    work      : function work(h, begin, end, data) -> [J] taken out in a step of length h, from the states
                (x, v) at its start and end
    works     : the power taken out is -force . v
    """

    add: Function
    data: tuple[Any, ...] = ()
    potential: Function | None = None
    power: Function | None = None
    work: Function | None = None
    helpers: tuple[Function, ...] = ()
    works: bool = False
    jumps: bool = False
    elastic: bool = False
    place: Function | None = None
    tells_power: bool = False
    remember: Function | None = None
    held: bool = False
    of_many: bool = False

    @property
    def dissipates(self) -> bool:
        """True if it takes energy out, or puts some in, that is no potential energy."""
        return self.works or self.power is not None or self.work is not None

    def __post_init__(self) -> None:
        """Raise TypeError for a function that could not be compiled."""
        functions = {name: getattr(self, name) for name in ARGUMENTS}
        refuse_wrong(functions, self.helpers)

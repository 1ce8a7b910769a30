"""The functions of one kind of force, compiled once on a machine, and where they are then.

A `KernelCall` becomes a module of its own with an entry for each of its functions; the types of its data are
the same in all scenes, so no scene compiles a force that another had. `exunet.codegen.sums` calls them.
"""

from __future__ import annotations

import inspect
from functools import cache
from typing import Any

from exunet.codegen.compile import INSIDE, WIDTH, compiled_module
from exunet.forces.kernel_call import Function, KernelCall

# Each entry with the arguments of `exunet.codegen.pointers`, and what it passes on; {data} is a tuple, or its
# place in memory if it is `KernelCall.held`.
_ENTRIES = {
    "place": ("t, x, v, data", "t, x, v, {data}"),
    "add": ("t, x, v, data, force", "t, x, v, {data}, force"),
    "potential": ("x, data", "x, {data}"),
    "power": ("t, x, v, data", "t, x, v, {data}"),
    "work": ("h, x0, v0, x1, v1, data", "h, (x0, v0), (x1, v1), {data}"),
    "remember": ("t, x, v, data", "t, x, v, {data}"),
}
FUNCTIONS = tuple(_ENTRIES)


def call_source(call: KernelCall, *, lanes: bool) -> str:
    """Text of the module of one kind of force, from the text of its functions.

    lanes : for states of vectors of runs (see `exunet.codegen.lanes`)
    """
    own = {name: function for name in FUNCTIONS if (function := getattr(call, name)) is not None}
    texts = [_text(function) for function in dict.fromkeys((*call.helpers, *own.values()))]
    for name, function in own.items():
        given, passed = _ENTRIES[name]
        gives = name in ("potential", "power", "work") or (name == "add" and tells(call))
        passed = passed.format(data="data" if call.held else "whole(data)")
        line = f"    {'return ' if gives else ''}{function.__name__}({passed})"
        texts.append(f"{INSIDE}\ndef entry_{name}({given}):\n{line}")
    runs = f", {WIDTH} runs at once" if lanes else ""
    head = (
        f'"""Compiled by exunet for one kind of force{runs}; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
    )
    return "\n\n\n".join((*head, *texts)) + "\n"


def tells(call: KernelCall) -> bool:
    """True if its `add` returns an energy or a power."""
    return call.elastic or call.tells_power


@cache
def _text(function: Function) -> str:
    return f"{INSIDE}\n{inspect.getsource(function).rstrip()}"


def addresses(call: KernelCall, source: str, data: tuple[Any, ...], lanes: bool) -> dict[str, int]:
    """Of its functions by name, compiled for such data if they are not yet; needs Numba.

    source, lanes : `call_source` of the call
    """
    from numba import typeof

    names = tuple(name for name in FUNCTIONS if getattr(call, name) is not None)
    return _addresses(source, names, tells(call), typeof(data), lanes)


@cache
def _addresses(source: str, names: tuple[str, ...], told: bool, kind: Any, lanes: bool) -> dict[str, int]:
    from numba import float64

    from exunet.codegen.pointers import kind_at, signature_of

    number: Any = float64
    if lanes:
        from exunet.codegen.lanes import LANES

        number = LANES
    module = compiled_module(source)
    found = {}
    for name in names:
        result, arguments = signature_of("told" if name == "add" and told else name, number, kind_at(kind))
        function = getattr(module, f"entry_{name}")
        function.compile(arguments)
        compiled = function.overloads[arguments]
        if compiled.signature.return_type != result:
            returned = compiled.signature.return_type
            raise TypeError(f"{name} of a force must return {result} and returns {returned}:\n{source}")
        found[name] = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    return found

"""Writes the module of a kernel: the functions that a scene needs and the calls that join them.

A term that is absent leaves no call, no argument and no branch in the text.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Iterable, Sequence

from exunet.codegen.compile import CALLED, INSIDE
from exunet.forces.terms import Function, KernelCall


def module_source(
    calls: Sequence[KernelCall],
    drivers: Iterable[Function] = (),
    helpers: Iterable[Function] = (),
    *,
    bodies: bool = False,
    first_order: bool = False,
    imports: Sequence[str] = (),
) -> str:
    """Text of the module with functions over all calls, from `add_forces` to `remember`, and drivers.

    drivers are called from Python; their helpers, as all else, only in the module.
    `add_forces` first places what has no equations of motion, then adds to the forces that it is given; it
    returns the elastic energy [J] and the power [W] that is taken out, of the calls that tell theirs. bodies,
    first_order : the module integrates rigid bodies, or anything of first order (their attitudes too); else
    the compiler leaves that code out.
    `data` is a tuple of the data of all calls, in order. Raises ValueError if two different
    functions share a name.
    """
    functions: dict[str, Function] = {}
    for call in calls:
        for function in (
            *call.helpers,
            call.place,
            call.add,
            call.potential,
            call.power,
            call.work,
            call.remember,
        ):
            if function is not None and functions.setdefault(function.__name__, function) is not function:
                raise ValueError(f"two functions of one kernel share the name {function.__name__}")
    parts = [
        '"""Compiled by exunet for one kind of scene; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
        *imports,
        *(_text(function) for function in functions.values()),
        f"TAKES_ENERGY = {any(call.dissipates for call in calls)}",
        f"TOLD = {tells_all_power(calls)}",
        f"BODIES = {bodies}",
        f"FIRST_ORDER = {bodies or first_order}",
        f"JUMPS = {any(call.jumps for call in calls)}",
        f"REMEMBERS = {any(call.remember is not None for call in calls)}",
        _joined(calls),
        *(_text(helper) for helper in helpers),
        *(_text(driver, CALLED) for driver in drivers),
    ]
    return "\n\n\n".join(parts) + "\n"


def tells_all_power(calls: Sequence[KernelCall]) -> bool:
    """True if there is power that is taken out, and `add_forces` returns all of it."""
    taking = [call for call in calls if call.dissipates]
    return bool(taking) and all(call.tells_power for call in taking)


@functools.cache
def _text(function: Function, decorator: str = INSIDE) -> str:
    return f"{decorator}\n{inspect.getsource(function).rstrip()}"


def _joined(calls: Sequence[KernelCall]) -> str:
    forces = [INSIDE, "def add_forces(t, x, v, data, force):"]
    potential = [INSIDE, "def potential(x, data):", "    total = 0.0"]
    power = [INSIDE, "def power(t, x, v, data, scratch):", "    total = 0.0"]
    work = [INSIDE, "def extra_work(h, begin, middle, end, data):", "    total = 0.0"]
    remember = [INSIDE, "def remember(t, x, v, data):"]
    for k, call in reversed(list(enumerate(calls))):
        if call.place is not None:
            forces.append(f"    {call.place.__name__}(t, x, v, data[{k}])")
    forces += ["    held = 0.0", "    watts = 0.0"]
    for k, call in enumerate(calls):
        told = "held += " if call.elastic else "watts += " if call.tells_power else ""
        forces.append(f"    {told}{call.add.__name__}(t, x, v, data[{k}], force)")
        if call.potential is not None:
            potential.append(f"    total += {call.potential.__name__}(x, data[{k}])")
        if call.power is not None:
            power.append(f"    total += {call.power.__name__}(t, x, v, data[{k}])")
        elif call.work is not None:
            work.append(f"    total += {call.work.__name__}(h, begin, middle, end, data[{k}])")
        elif call.works:
            power += ["    for k in range(scratch.size):", "        scratch[k] = 0.0"]
            power.append(f"    {call.add.__name__}(t, x, v, data[{k}], scratch)")
            power += ["    for k in range(v.size):", "        total -= scratch[k] * v[k]"]
        if call.remember is not None:
            remember.append(f"    {call.remember.__name__}(t, x, v, data[{k}])")
    remember.append("    return")
    forces.append("    return held, watts")
    potential.append("    return total")
    power.append("    return total")
    work.append("    return total")
    parts = (forces, potential, power, work, remember)
    return "\n\n\n".join("\n".join(lines) for lines in parts)

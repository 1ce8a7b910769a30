"""Writes the module of a kernel: the functions that a scene needs and the calls that join them.

A term that is absent leaves no call, no argument and no branch in the text.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Function = Callable[..., Any]


@dataclass(frozen=True)
class Piece:
    """One call in the kernel; functions as in `KernelTerm`.

    What it takes out is had from one of these, or is nothing:
    power : function power(t, x, v, *parameters) -> [W]
    work  : function work(h, x0, v0, x1, v1, x2, v2, *parameters) -> [J] in a step of length h, from the
            states at its start, middle and end
    works : the power is -force . v

    elastic : the add function returns the elastic energy [J] that it finds on its way
    """

    add: Function
    parameters: tuple[Any, ...]
    potential: Function | None = None
    power: Function | None = None
    work: Function | None = None
    helpers: tuple[Function, ...] = ()
    works: bool = False
    elastic: bool = False


def module_source(pieces: Sequence[Piece], drivers: Iterable[Function] = ()) -> str:
    """Text of the module with `forces`, `potential`, `power`, `extra_work` over all pieces, and drivers.

    `forces` returns the elastic energy [J] of the pieces that tell theirs.
    The parameters of all pieces are one tuple `data`, in order. Raises ValueError if two different
    functions share a name.
    """
    functions: dict[str, Function] = {}
    for piece in pieces:
        for function in (*piece.helpers, piece.add, piece.potential, piece.power, piece.work):
            if function is not None and functions.setdefault(function.__name__, function) is not function:
                raise ValueError(f"two functions of one kernel share the name {function.__name__}")
    parts = [
        '"""Compiled by exunet for one kind of scene; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
        *(_text(function) for function in functions.values()),
        f"TAKES_ENERGY = {any(p.works or p.power is not None or p.work is not None for p in pieces)}",
        _joined(pieces),
        *(_text(driver) for driver in drivers),
    ]
    return "\n\n\n".join(parts) + "\n"


def data_of(pieces: Iterable[Piece]) -> tuple[Any, ...]:
    """The parameters of all pieces, as the functions of the module take them.

    Arrays are copied: contiguous and writable ones all have the same compiled code.
    """
    parameters = (parameter for piece in pieces for parameter in piece.parameters)
    return tuple(np.array(p) if isinstance(p, np.ndarray) else p for p in parameters)


def _text(function: Function) -> str:
    return "@compiled\n" + inspect.getsource(function).rstrip()


def _joined(pieces: Sequence[Piece]) -> str:
    forces = ["@compiled", "def forces(t, x, v, data, force):"]
    potential = ["@compiled", "def potential(x, data):", "    total = 0.0"]
    power = ["@compiled", "def power(t, x, v, data, scratch):", "    total = 0.0"]
    work = ["@compiled", "def extra_work(h, x0, v0, x1, v1, x2, v2, data):", "    total = 0.0"]
    forces += ["    for k in range(force.size):", "        force[k] = 0.0", "    held = 0.0"]
    first = 0
    for piece in pieces:
        last = first + len(piece.parameters)
        data = "".join(f", data[{k}]" for k in range(first, last))
        first = last
        forces.append(f"    {'held += ' * piece.elastic}{piece.add.__name__}(t, x, v{data}, force)")
        if piece.potential is not None:
            potential.append(f"    total += {piece.potential.__name__}(x{data})")
        if piece.power is not None:
            power.append(f"    total += {piece.power.__name__}(t, x, v{data})")
        elif piece.work is not None:
            work.append(f"    total += {piece.work.__name__}(h, x0, v0, x1, v1, x2, v2{data})")
        elif piece.works:
            power += ["    for k in range(scratch.size):", "        scratch[k] = 0.0"]
            power.append(f"    {piece.add.__name__}(t, x, v{data}, scratch)")
            power += ["    for k in range(scratch.size):", "        total -= scratch[k] * v[k]"]
    forces.append("    return held")
    potential.append("    return total")
    power.append("    return total")
    work.append("    return total")
    return "\n\n\n".join("\n".join(lines) for lines in (forces, potential, power, work))

"""Writes the module of a kernel: the functions that a scene needs and the calls that join them.

A term that is absent leaves no call, no argument and no branch in the text.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Iterable, Sequence

from exunet.forces.terms import Function, Piece


def module_source(
    pieces: Sequence[Piece],
    drivers: Iterable[Function] = (),
    *,
    bodies: bool = False,
    imports: Sequence[str] = (),
) -> str:
    """Text of the module with `add_forces`, `potential`, `power`, `extra_work` over all pieces, and drivers.

    `add_forces` adds to the forces that it is given, and returns the elastic energy [J] of the pieces that
    tell theirs. bodies : the module integrates rigid bodies too; else their code is left out by the compiler.
    The data of all pieces are one tuple `data`, in order. Raises ValueError if two different
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
        *imports,
        *(_text(function) for function in functions.values()),
        f"TAKES_ENERGY = {any(p.works or p.power is not None or p.work is not None for p in pieces)}",
        f"BODIES = {bodies}",
        f"JUMPS = {any(piece.jumps for piece in pieces)}",
        _joined(pieces),
        *(_text(driver) for driver in drivers),
    ]
    return "\n\n\n".join(parts) + "\n"


@functools.cache
def _text(function: Function) -> str:
    return "@compiled\n" + inspect.getsource(function).rstrip()


def _joined(pieces: Sequence[Piece]) -> str:
    forces = ["@compiled", "def add_forces(t, x, v, data, force):"]
    potential = ["@compiled", "def potential(x, data):", "    total = 0.0"]
    power = ["@compiled", "def power(t, x, v, data, scratch):", "    total = 0.0"]
    work = ["@compiled", "def extra_work(h, x0, v0, x1, v1, x2, v2, data):", "    total = 0.0"]
    forces.append("    held = 0.0")
    first = 0
    for piece in pieces:
        last = first + len(piece.data)
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

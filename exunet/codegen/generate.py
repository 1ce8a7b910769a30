"""Writes the module of a kernel: what asks for the forces of a scene, whichever they are."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Iterable, Sequence

from exunet.codegen.compile import CALLED, INSIDE
from exunet.codegen.sums import SUMS
from exunet.forces.kernel_call import Function


def in_any_order(function: Function) -> Function:
    """Mark a function whose sums compiled code may make in any order: faster, with other last bits."""
    return function


def module_source(
    drivers: Iterable[Function] = (),
    helpers: Iterable[Function] = (),
    *,
    bodies: bool = False,
    first_order: bool = False,
    imports: Sequence[str] = (),
) -> str:
    """Text of the module with the sums over all forces, from `add_forces` to `remember`, and drivers.

    drivers are called from Python; their helpers, as all else, only in the module. bodies, first_order : the
    module integrates rigid bodies, or anything of first order (their attitudes too); else the compiler leaves
    that code out.
    """
    parts = [
        '"""Compiled by exunet for all scenes of a kind; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
        *imports,
        f"BODIES = {bodies}",
        f"FIRST_ORDER = {bodies or first_order}",
        *(_text(helper) for helper in (*SUMS, *helpers)),
        *(_text(driver, CALLED) for driver in drivers),
    ]
    return "\n\n\n".join(parts) + "\n"


def loops_source(called: Iterable[Function], inside: Iterable[Function]) -> str:
    """Text of a module of functions that Python calls, and of those that they call."""
    parts = [
        '"""Compiled by exunet; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
        *(_text(one) for one in inside),
        *(_text(one, CALLED) for one in called),
    ]
    return "\n\n\n".join(parts) + "\n"


@functools.cache
def _text(function: Function, decorator: str = INSIDE) -> str:
    text = inspect.getsource(function).rstrip()
    return text if text.startswith("@") else f"{decorator}\n{text}"

"""The loops over ports of `exunet.coupling.port_loops`, compiled."""

from __future__ import annotations

from functools import cache
from types import ModuleType

from exunet.bodies.port import INSIDE
from exunet.codegen.compile import compiled_module, interpreted_module, numba_installed
from exunet.codegen.drivers import hold
from exunet.codegen.generate import loops_source
from exunet.coupling.port_loops import CALLED


@cache
def port_loops() -> ModuleType:
    """Their module: compiled as far as Numba is installed, else plain Python."""
    source = loops_source((hold, *CALLED), INSIDE)
    return compiled_module(source) if numba_installed() else interpreted_module(source)

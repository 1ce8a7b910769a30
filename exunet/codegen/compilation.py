"""Reports of compilation, which takes some seconds: once for each kind of scene on a machine.

Numba compiles a function at its first call, unless an earlier run has left it in the cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

KERNELS = "exunet_kernel_"  # begins the names of the modules that are compiled

_reports: list[Callable[[str], None]] = []  # of the open blocks in which nothing was compiled so far
_listening: list[Any] = []


@contextmanager
def reported_compilation(report: Callable[[str], None]) -> Iterator[None]:
    """Report the first compilation of a block, when it begins."""
    _reports.append(report)
    try:
        yield
    finally:
        if report in _reports:
            _reports.remove(report)


def listen() -> None:
    """Receive Numba's events from now on; called before kernels are made, as it imports Numba."""
    if _listening:
        return
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            if str(event.data["dispatcher"].py_func.__module__).startswith(KERNELS):
                while _reports:
                    _reports.pop()("compiling the forces of this scene, once on this machine: some seconds")

        def on_end(self, event: Any) -> None:
            """Do nothing."""

    _listening.append(Listener())
    event.register("numba:compile", _listening[0])

"""Tells when compiled code is made, which takes some seconds: once for each kind of scene on a machine.

Numba compiles a function when it is first called, and takes it from its cache where an earlier run has left
it there; only the former is reported.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

KERNELS = "exunet_kernel_"  # begins the names of the modules that are compiled


class Told:
    """Who is told, and how many seconds compilation has taken since then."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self.seconds, self._begun = say, 0.0, False
        self._inside, self._lock = threading.local(), threading.Lock()

    def begin(self) -> None:
        """A function is compiled now; those that it calls, inside of that, are not told apart."""
        self._inside.depth = getattr(self._inside, "depth", 0) + 1
        if self._inside.depth == 1:
            self._inside.since = clock.perf_counter()
            with self._lock:
                first, self._begun = not self._begun, True
            if first:
                self._say("compiling this scene's forces, once")

    def end(self) -> None:
        """It is done."""
        self._inside.depth -= 1
        if self._inside.depth == 0:
            with self._lock:
                self.seconds += clock.perf_counter() - self._inside.since


_told: list[Told] = []
_listening: list[Any] = []


@contextmanager
def told_compilation(say: Callable[[str], None]) -> Iterator[None]:
    """Say in words that this block compiles, when it begins to, and at the end how long that took."""
    told = Told(say)
    _told.append(told)
    try:
        yield
    finally:
        _told.remove(told)
        if told.seconds > 0.0:
            say(f"compiled this scene's forces in {told.seconds:.1f} s; later runs load them")


def listen() -> None:
    """Hear of each compilation from now on; called before kernels are made, as it imports Numba."""
    if _listening:
        return
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            if _of_kernel(event):
                for told in _told:
                    told.begin()

        def on_end(self, event: Any) -> None:
            if _of_kernel(event):
                for told in _told:
                    told.end()

    _listening.append(Listener())
    event.register("numba:compile", _listening[0])


def _of_kernel(event: Any) -> bool:
    return str(event.data["dispatcher"].py_func.__module__).startswith(KERNELS)

"""Tells when compiled code is made, which takes some seconds: once for each kind of scene on a machine.

Numba compiles a function when it is first called, and takes it from its cache where an earlier run has left
it there; only the former is told, with the seconds that its text is expected to take.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

KERNELS = "exunet_kernel_"  # begins the names of the modules that are compiled
# Seconds of processor time that a character of a kernel's text takes to compile: of eleven modules of 1 to 39
# thousand characters 1.9e-4 to 4.8e-4, of those with more than 10 thousand 2.4e-4 to 3.0e-4.
_A_CHARACTER = 2.7e-4

_expected: dict[str, float] = {}  # [s], by module that is to be compiled and of which nobody was told yet
_lock = threading.Lock()


def expect(name: str, text: str) -> None:
    """A module of this name and text will be compiled soon."""
    with _lock:
        _expected[name] = _A_CHARACTER * len(text)


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
                with _lock:
                    seconds = sum(_expected.values())
                    _expected.clear()
            if first or seconds:
                how_long = f"some {max(1.0, seconds):.0f} s" if seconds else "a few seconds"
                self._say(f"compiling {'' if first else 'more of '}this scene's forces, once: {how_long}")

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
    with _lock:
        _expected.clear()  # what was wanted before is none of this block's
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

"""Ctrl-C, and a limit of time, between two steps: raised inside the engine's own calls they would be lost.

Blocks are many and short, so handlers are set by the functions behind those of `signal`, which make an
enumeration member of each: ten times the time.
"""

from __future__ import annotations

import signal
import threading
from _signal import getsignal  # type: ignore[import-not-found]
from _signal import signal as set_handler
from collections.abc import Callable
from contextlib import ContextDecorator
from types import FrameType
from typing import Self

_open: list[Callable[[], None]] = []  # the check of the block that is open; a process has one handler only


class postponed(ContextDecorator):  # noqa: N801 - as the context managers of the standard library
    """Keep Ctrl-C until the function that the block is given is called, which raises KeyboardInterrupt, once.

    The end of the block is such a call too. A block inside another gets the other's function, and its end is
    none. A second Ctrl-C acts at once. Outside the main thread, or where a program has a handler of its own,
    nothing is changed and the function does nothing.
    """

    def __init__(self) -> None:
        self._asked = self._ours = False

    def _recreate_cm(self) -> Self:
        """A block of its own for each call of a decorated function."""
        return type(self)()

    def __enter__(self) -> Callable[[], None]:
        main = threading.current_thread() is threading.main_thread()
        if main and _open:
            return _open[0]
        self._ours = main and getsignal(signal.SIGINT) is signal.default_int_handler
        check = self._check
        if self._ours:
            _open.append(check)
            set_handler(signal.SIGINT, self._keep)
        return check

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if self._ours:
            set_handler(signal.SIGINT, signal.default_int_handler)
            _open.clear()
        if kind is None:
            self._check()  # requested after the last call inside the block

    def _keep(self, _number: int, _frame: FrameType | None) -> None:
        self._asked = True
        set_handler(signal.SIGINT, signal.default_int_handler)

    def _check(self) -> None:
        if self._asked:
            self._asked = False
            raise KeyboardInterrupt

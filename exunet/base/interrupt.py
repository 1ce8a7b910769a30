"""Ctrl-C between two steps: an exception raised inside the engine's own calls would be lost there."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_open: list[Callable[[], None]] = []  # the check of the block that is open; a process has one handler only


@contextmanager
def postponed() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C until the given function is called, which then raises KeyboardInterrupt, once.

    The end of the block is such a call too. A block inside another gets the other's function, and its end is
    none. A second Ctrl-C acts at once. Outside the main thread, or where a program has a handler of its own,
    nothing is changed and the function does nothing.
    """
    main = threading.current_thread() is threading.main_thread()
    if main and _open:
        yield _open[0]
        return
    asked = False

    def keep(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def check() -> None:
        nonlocal asked
        if asked:
            asked = False
            raise KeyboardInterrupt

    ours = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        _open.append(check)
        signal.signal(signal.SIGINT, keep)
    try:
        yield check
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            _open.clear()
    check()  # asked for after the last call inside the block

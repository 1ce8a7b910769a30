"""Ctrl-C between two steps: an exception raised inside the engine's own calls would be lost there."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def postponed() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C until the given function is called, which then raises KeyboardInterrupt.

    The end of the block is such a call too. A second Ctrl-C acts at once. Outside the main thread, or where
    a program has a handler of its own, nothing is changed and the function does nothing.
    """
    asked = False

    def keep(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if ours:
        signal.signal(signal.SIGINT, keep)
    try:
        yield check
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
    check()  # asked for after the last call inside the block

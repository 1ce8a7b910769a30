"""What is shown while something lasts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def waiting(words: str, *, quiet: bool = False) -> Iterator[None]:
    """Words and a moving sign on stderr while something lasts; nothing if quiet or not on a terminal."""
    if quiet or not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(words):
        yield

"""What is shown while something lasts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.status import Status


_shown: list[Status] = []  # at most one: two on one line would take turns


@contextmanager
def waiting(words: str, *, quiet: bool = False) -> Iterator[None]:
    """Words and a moving sign on stderr while something lasts; nothing if quiet or not on a terminal.

    What lasts while something else does has its own words until it ends.
    """
    if quiet or not sys.stderr.isatty():
        yield
    elif _shown:
        before = _shown[0].status
        _shown[0].update(words)
        try:
            yield
        finally:
            _shown[0].update(before)
    else:
        from rich.console import Console

        with Console(stderr=True).status(words) as one:
            _shown.append(one)
            try:
                yield
            finally:
                _shown.clear()

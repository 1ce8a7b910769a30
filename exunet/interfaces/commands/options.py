"""Faults of arguments of public functions, told as those of the options that gave them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from exunet.base.errors import InputError


@contextmanager
def as_options(*names: str) -> Iterator[None]:
    """Let an InputError that begins with an argument's name, or with several, name the options.

    names : of the arguments, as they stand in messages: "fps", "from, until"; other messages stay what they
            are. None: every message begins with a name
    """
    try:
        yield
    except InputError as error:
        what, colon, words = str(error).partition(": ")
        if names and what not in names:
            raise
        options = ", ".join(f"--{name}" for name in what.split(", "))
        raise InputError(f"{options}{colon}{words}") from None

"""Words in lines as wide as where they are read, and telling them on stderr."""

from __future__ import annotations

import os
import re
import shutil
import sys
from contextlib import suppress
from typing import TextIO
from unicodedata import combining, east_asian_width

WIDTH = 80  # columns of what does not go to a terminal
HANG = 2  # blanks before what continues a line


def width_of(stream: TextIO) -> int:
    """Columns of the terminal behind a stream, 80 where there is none."""
    return shutil.get_terminal_size((WIDTH, 24)).columns if stream.isatty() else WIDTH


def cells(text: str) -> int:
    """Columns that a text takes: two for each letter of Chinese and the like, none for a combining accent."""
    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)


def folded(text: str, width: int, hang: int = HANG) -> list[str]:
    """A text in lines of at most `width` columns, folded between words.

    hang : blanks before each line that continues another
    A word that is longer than a line is broken, but not a path, which someone may want to copy: it gets a
    line of its own, longer than the others if it has to be.
    """
    return [line for part in text.split("\n") for line in _folded(part, width, hang)]


def _folded(text: str, width: int, hang: int) -> list[str]:
    lines, indent = [""], " " * hang
    for word in re.findall(r"\s*\S+", text):
        if cells(lines[-1] + word) <= width:
            lines[-1] += word
            continue
        rest = word.lstrip() if lines[-1].strip() else word
        while rest:
            if lines[-1].strip():
                lines.append(indent)
            taken = len(rest) if is_path(rest) else _fitting(rest, width - cells(lines[-1]))
            lines[-1] += rest[:taken]
            rest = rest[taken:]
    return lines


def _fitting(word: str, width: int) -> int:
    """How many characters of a word fit; one at least."""
    taken = 1
    while taken < len(word) and cells(word[: taken + 1]) <= width:
        taken += 1
    return taken


def is_path(word: str) -> bool:
    """True for what may be a path, so that it is not broken."""
    return "/" in word or os.sep in word


def tell(text: str, hang: int = HANG) -> None:
    """Print on stderr, folded; a pipe that nobody reads any more must not end a run."""
    _write(folded(text, width_of(sys.stderr), hang))


def tell_faults(text: str) -> None:
    """Print faults on stderr: folded on a terminal, one line each where a program may read them."""
    _write(folded(text, width_of(sys.stderr)) if sys.stderr.isatty() else [text])


def _write(lines: list[str]) -> None:
    with suppress(BrokenPipeError):
        sys.stderr.write("\n".join(lines) + "\n")
        sys.stderr.flush()


def silent(_text: str, _hang: int = HANG) -> None:
    """Nothing is told."""

"""The folder that a run gets when nobody names one: results/CASE, with what `--set` changed."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from exunet.case.casefile import Case

RESULTS = Path("results")
_VALUE = 24  # characters of a value
_NAME = 150  # bytes of a name; file systems take 255, of which numbers and temporary names need some
_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")


def folder_of(case: Case, *more: str) -> Path:
    """results/CASE--net.size=2--solver.method=RK44: the same for the same case and the same overrides.

    more : words at the end, for what is not a run
    """
    name = "--".join([case.name, *map(_short, case.overrides), *more])
    code = name.encode("utf-8", "surrogateescape")
    if len(code) > _NAME:
        kept = code[:_NAME].decode("utf-8", "ignore")
        name = f"{kept}-{_hash(case.name, *case.overrides, *more)}"
    return RESULTS / name


def _short(override: str) -> str:
    """A key with its value, cut and marked by a hash if there is more to it than can stand in a name."""
    key, _, value = (part.strip() for part in override.partition("="))
    plain = value.strip("\"'")
    words = _UNSAFE.sub("_", plain)
    if words != plain or len(words) > _VALUE:
        words = f"{words[:_VALUE]}-{_hash(value)}"
    return f"{_UNSAFE.sub('_', key)}={words}"


def _hash(*text: str) -> str:
    return hashlib.sha256("\n".join(text).encode("utf-8", "surrogateescape")).hexdigest()[:8]

"""Shipped cases: their folder, names and first lines."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.key_path import closest

_PACKAGE = Path(__file__).parents[1]
# A wheel has the cases in the package, a clone beside it.
CASES = next(
    (path for path in (_PACKAGE / "cases", _PACKAGE.parent / "cases") if path.is_dir()), _PACKAGE / "cases"
)


def shipped(folder: str = "") -> dict[str, Path]:
    """Return name and file of the cases in cases/ or a folder of it; raises InputError without any."""
    paths = sorted((CASES / folder).glob("*.toml"))
    if not paths:
        raise InputError(f"{CASES / folder}: the shipped cases are missing: install exunet again")
    return {path.stem: path for path in paths}


def first_lines() -> Iterator[tuple[str, str]]:
    """Yield the name of each shipped case, such as capture/box, and the first sentence of its file."""
    for path in sorted(CASES.rglob("*.toml")):
        text = path.read_text(encoding="utf-8")
        comment = text.partition("\nformat =")[0] if text.startswith("#") else tomllib.loads(text)["title"]
        sentence = " ".join(line.lstrip("# ") for line in comment.splitlines()).partition(". ")[0]
        yield path.relative_to(CASES).with_suffix("").as_posix(), sentence.rstrip(".")


def found(case: Path) -> Path:
    """Return the file of a case, or of the shipped case of this name if there is no such file."""
    inside = CASES / case.with_suffix(".toml")
    if case.exists() or case.is_absolute():
        return case
    if not inside.is_file() and (near := closest(case.with_suffix("").as_posix(), dict(first_lines()))):
        raise InputError(f"{case}: no such file; did you mean the shipped case {near}?")
    return inside if inside.is_file() else case

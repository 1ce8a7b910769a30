"""The cases that come with exunet: under cases/ in the sources, beside the code if installed."""

from __future__ import annotations

from pathlib import Path

import exunet
from exunet.base.errors import InputError

CASES = Path(exunet.__file__).parent / "cases"


def shipped(folder: str = "") -> dict[str, Path]:
    """Name -> file of the cases in cases/ or a folder in it; raises InputError if there are none."""
    paths = sorted((CASES / folder).glob("*.toml"))
    if not paths:
        raise InputError(f"{CASES / folder}: the cases that come with exunet are not there: install it again")
    return {path.stem: path for path in paths}


def shipped_case(folder: str, name: str) -> Path:
    """One of them; raises InputError if it is not there."""
    if (path := shipped(folder).get(name)) is None:
        raise InputError(f"{CASES / folder / name}.toml: this case comes with exunet and is not there")
    return path

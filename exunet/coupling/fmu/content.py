"""What an FMU carries for its worker: the case with its files and overrides, and how it was made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.version import VERSION
from exunet.case.casefile import Case, load

FILE = "content.json"


@dataclass(frozen=True)
class Content:
    """Of the folder "resources" of an FMU.

    token     : that binds binary, description and states to each other
    exunet    : version that made it
    case      : name of the case file in the folder "case"
    overrides : applied to it, before those of parameters
    variables, starts : names of all variables, in the order of their values, and those in the case
    paths     : where the Python of the export found its modules
    """

    token: str
    exunet: str
    case: str
    overrides: tuple[str, ...]
    variables: tuple[str, ...]
    starts: tuple[float, ...]
    paths: tuple[str, ...]

    def as_text(self) -> str:
        """The file's text."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def read(cls, folder: Path) -> Content:
        """Of a folder; raises InputError if it is not there, or of another version of exunet."""
        try:
            found: Mapping[str, object] = json.loads((folder / FILE).read_text(encoding="utf-8"))
            content = cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})  # type: ignore[arg-type]
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise InputError(f"{folder / FILE}: cannot be read ({error}): export the FMU again") from error
        if content.exunet != VERSION:
            raise InputError(
                f"the FMU is of exunet {content.exunet}, its worker of exunet {VERSION}: export it again, or "
                "let EXUNET_PYTHON name a Python that has the exunet of the FMU"
            )
        return content

    def load(self, folder: Path, overrides: list[str]) -> Case:
        """The case, with further overrides."""
        return load(folder / "case" / self.case, [*self.overrides, *overrides])

"""hard.md: what the gallery of hard cases has shown, as a page to read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exunet.base.files import replacing
from exunet.verification.check import Check
from exunet.verification.gallery import ITEMS
from exunet.verification.report import made_with, table, tolerance_table, verdict, what_fails

NAME = "hard.md"


def write_report(folder: Path, checks: Sequence[Check], *, quick: bool, interrupted: bool) -> Path:
    """Write hard.md into a folder; returns its path."""
    forms = "In the compiled loop only" if quick else "In every form of the engine, and in the reference"
    lines = [
        "# Hard cases of exunet",
        "",
        f"**{verdict(checks, interrupted=interrupted)}**",
        "",
        f"{forms}; {made_with()}.",
        "",
        "A check holds if what was measured is not more than what is allowed; the reasons for what is "
        "allowed stand in the table of tolerances below.",
        "",
        *what_fails(checks),
    ]
    for item, title in ITEMS.items():
        if mine := [check for check in checks if check.rung == item]:
            lines += [f"## {item}. {title}", "", *table(mine)]
    path = folder / NAME
    with replacing(path) as part:
        part.write_text("\n".join([*lines, *tolerance_table("HARD")]) + "\n", encoding="utf-8")
    return path

"""verification.md: the evidence as a page to read, with its figures beside it."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import exunet
from exunet.backends.exudyn.loading import exudyn_version
from exunet.base.files import cannot_write, replacing
from exunet.verification import tolerances
from exunet.verification.check import Check, Finding, Plate, Text
from exunet.verification.ladder import RUNGS
from exunet.verification.planted import PLANTED
from exunet.verification.tolerances import Tolerance


def number(value: float, unit: str = "") -> str:
    """A measured or allowed value for a table."""
    return f"{value:.3g} {unit}".strip()


def save_plate(plate: Plate, folder: Path) -> None:
    """Draw a figure of the report into its folder; within `exunet.figures.style.drawing`."""
    with replacing(folder / f"{plate.name}.png") as part:
        plate.figure.savefig(part, format="png")


def make_folder(folder: Path, name: str = "verification.md") -> None:
    """The folder for the report of that name, proved writable; raises InputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(folder / name) as part:
            part.write_text("INCOMPLETE: the verification did not come to its end.\n", encoding="utf-8")
    except OSError as error:
        raise cannot_write(folder, error) from error


def write_report(
    folder: Path, findings: Sequence[Finding], cases: Sequence[str], *, quick: bool, interrupted: bool
) -> Path:
    """Write verification.md; its figures (`save_plate`) are expected beside it."""
    path = folder / "verification.md"
    text = "\n".join(_lines(findings, cases, quick=quick, interrupted=interrupted)) + "\n"
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")
    return path


def verdict(checks: Sequence[Check], *, interrupted: bool) -> str:
    """One sentence on the whole ladder."""
    demanded = [check for check in checks if check.allowed is not None]
    failed = [check for check in demanded if not check.holds]
    missing = [check for check in checks if check.left_out]
    but = f" {len(missing)} LEFT OUT: {_listed(missing)}." if missing else ""
    if interrupted:
        return f"INCOMPLETE: interrupted after {len(demanded)} checks, {len(failed)} of them failed.{but}"
    if failed:
        return f"{len(failed)} of {len(demanded)} checks FAIL.{but}"
    return f"All {len(demanded)} checks hold.{but}"


def _listed(checks: Sequence[Check]) -> str:
    """In words; rows that leave out the same for the same reason are told together."""
    subjects: dict[tuple[str, str], list[str]] = {}
    for check in checks:
        subjects.setdefault((check.name, check.worst), []).append(check.subject)
    return "; ".join(f"{', '.join(of)}: {name} ({why})" for (name, why), of in subjects.items())


def _lines(findings: Sequence[Finding], cases: Sequence[str], *, quick: bool, interrupted: bool) -> list[str]:
    checks = [finding for finding in findings if isinstance(finding, Check)]
    lines = [
        "# Verification of exunet",
        "",
        f"**{verdict(checks, interrupted=interrupted)}**",
        "",
        f"{'Quick' if quick else 'Full'} ladder over {', '.join(cases)}; {made_with()}.",
        "",
        "Exudyn is compared with `reference_impl`, a NumPy code that shares the case files with it and no "
        "line of code, and both with known answers. A check holds if what was measured is not more than what "
        "is allowed; every allowed value stands in the table of tolerances below, with its reason.",
        "",
    ]
    lines += what_fails(checks)
    for rung, title in RUNGS.items():
        if any(finding.rung == rung for finding in findings):
            lines += _section(rung, title, findings)
    return lines + tolerance_table() + _planted()


def made_with() -> str:
    """Date, versions and platform."""
    return (
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, exunet {exunet.__version__}, Exudyn {exudyn_version()}, "
        f"NumPy {np.__version__}, Python {platform.python_version()}, {platform.platform()}"
    )


def what_fails(checks: Sequence[Check]) -> list[str]:
    """Lines of a section on the checks that fail; none if all hold."""
    failed = [check for check in checks if not check.holds]
    if not failed:
        return []
    rows = [
        f"- rung {check.rung}, {check.subject}, {check.name}: {number(check.measured)} "
        f"(allowed {number(check.allowed.value) if check.allowed else '-'}). Worst: {check.worst}"
        for check in failed
    ]
    return ["## What fails", "", *rows, ""]


def _section(rung: int, title: str, findings: Sequence[Finding]) -> list[str]:
    mine = [finding for finding in findings if finding.rung == rung]
    lines = [f"## {rung}. {title}", ""]
    checks = [finding for finding in mine if isinstance(finding, Check)]
    if checks:
        lines += table(checks)
    for finding in mine:
        if isinstance(finding, Text):
            lines += [finding.words, ""]
        elif isinstance(finding, Plate):
            lines += [f"![{finding.caption}]({finding.name}.png)", "", f"*{finding.caption}*", ""]
    return lines


def table(checks: Sequence[Check]) -> list[str]:
    """Lines of a table of checks."""
    head = ["| case | check | measured | allowed | verdict | worst |", "|---|---|---|---|---|---|"]
    return [*head, *map(_row, checks), ""]


def _row(check: Check) -> str:
    unit = check.allowed.unit if check.allowed else ""
    allowed = number(check.allowed.value, unit) if check.allowed else "-"
    cells = (
        check.subject,
        check.name,
        number(check.measured, unit),
        allowed,
        check.verdict,
        check.worst,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def tolerance_table(prefix: str = "") -> list[str]:
    """Lines of the table of the tolerances whose names begin with `prefix`."""
    lines = ["## Tolerances", "", "| name | value | reason |", "|---|---|---|"]
    for name, value in vars(tolerances).items():
        if isinstance(value, Tolerance) and name.startswith(prefix):
            lines.append(f"| {name} | {number(value.value, value.unit)} | {value.reason} |")
    return [*lines, ""]


def _planted() -> list[str]:
    lines = [
        "## Planted errors",
        "",
        "A ladder that nothing can fail proves nothing. `pytest -m slow tests/mutations` plants these "
        "errors, one at a time, and demands that the quick ladder fails at the rung named here.",
        "",
        "| error | in | caught by |",
        "|---|---|---|",
    ]
    lines += [f"| {error.what} | {error.code} | rung {error.rung} |" for error in PLANTED]
    return [*lines, ""]

"""The evidence as one report: rows for the terminal as they come, and a page in Markdown with its figures."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import exunet
from exunet.base.files import cannot_write, markdown_table, replacing
from exunet.integrators.exudyn.engine import exudyn_version
from exunet.verification import tolerances
from exunet.verification.check import Check, Evidence, Plate, Text
from exunet.verification.tolerances import Tolerance


@dataclass
class Report:
    """What a verification found, in sections by rung.

    title      : first heading
    name       : of the file in the report's folder
    sections   : rung -> heading
    opening    : paragraphs after the verdict
    closing    : paragraphs after the sections
    tolerances : shown are those whose names begin so
    findings   : so far
    interrupted: it did not come to its end
    """

    title: str
    name: str
    sections: Mapping[int, str]
    opening: Sequence[str] = ()
    closing: Sequence[str] = ()
    tolerances: str = ""
    findings: list[Evidence] = field(default_factory=list)
    interrupted: bool = False

    @property
    def checks(self) -> list[Check]:
        """The rows of the tables."""
        return [finding for finding in self.findings if isinstance(finding, Check)]

    @property
    def holds(self) -> bool:
        """No check fails."""
        return all(check.holds for check in self.checks)

    @property
    def verdict(self) -> str:
        """One sentence on all checks."""
        demanded = [check for check in self.checks if check.allowed is not None]
        failed = [check for check in demanded if not check.holds]
        missing = [check for check in self.checks if check.left_out]
        but = f" {len(missing)} LEFT OUT: {_listed(missing)}." if missing else ""
        if self.interrupted:
            return f"INCOMPLETE: interrupted after {len(demanded)} checks, {len(failed)} of them failed.{but}"
        if failed:
            return f"{len(failed)} of {len(demanded)} checks FAIL.{but}"
        return f"All {len(demanded)} checks hold.{but}"

    def open(self, folder: Path) -> None:
        """Make the folder and prove it writable; raises InputError."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with replacing(folder / self.name) as part:
                part.write_text("INCOMPLETE: the verification did not come to its end.\n", encoding="utf-8")
        except OSError as error:
            raise cannot_write(folder, error) from error

    def add(self, finding: Evidence, folder: Path) -> list[str]:
        """Take a finding and draw its figure into the folder (within `exunet.plots.style.drawing`).

        Returns its lines for the terminal, under a heading where a section begins.
        """
        begins = finding.rung not in [check.rung for check in self.checks[-1:]]
        self.findings.append(finding)
        if isinstance(finding, Plate):
            with replacing(folder / f"{finding.name}.png") as part:
                finding.figure.savefig(part, format="png")
        if not isinstance(finding, Check):
            return []
        head = [f"\n{finding.rung}. {self.sections[finding.rung]}", _HEAD] if begins else []
        return [*head, *_printed(finding)]

    def write(self, folder: Path) -> Path:
        """Write the page; returns its path."""
        path = folder / self.name
        with replacing(path) as part:
            part.write_text("\n".join(self._page()) + "\n", encoding="utf-8")
        return path

    def _page(self) -> Iterator[str]:
        made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
        programs = f"exunet {exunet.__version__}, Exudyn {exudyn_version()}, NumPy {np.__version__}"
        python = f"Python {platform.python_version()}, {platform.platform()}"
        holding = "A check holds if it measures no more than is allowed; the last table gives the reasons."
        yield from (f"# {self.title}", "")
        for words in (f"**{self.verdict}**", *self.opening, holding, f"{made}, {programs}, {python}."):
            yield from (words, "")
        if not self.holds:
            yield from ("## What fails", "")
            yield from (_failure(check) for check in self.checks if not check.holds)
            yield ""
        for rung, title in self.sections.items():
            if mine := [finding for finding in self.findings if finding.rung == rung]:
                yield from (f"## {rung}. {title}", "")
                yield from _section(mine)
        yield from _tolerances(self.tolerances)
        for words in self.closing:
            yield from (words, "")


_LINE = "{:8s} {:>9s} {:>8s} {:5s} {}"
_HEAD = _LINE.format("verdict", "measured", "allowed", "unit", "case: check")


def _printed(check: Check) -> list[str]:
    """A row of the terminal's table, with what is worst where it fails."""
    allowed, unit = (check.allowed.value, check.allowed.unit) if check.allowed else (None, "")
    numbers = _number(None if check.left_out else check.measured), _number(allowed)
    cells = (check.verdict, *numbers, unit, f"{check.subject}: {check.name}")
    more = "because" if check.left_out else "worst"
    shown = check.left_out or not check.holds
    return [_LINE.format(*cells).rstrip(), *([f"    {more}: {check.worst}"] if shown else [])]


def _section(findings: Sequence[Evidence]) -> Iterator[str]:
    if checks := [finding for finding in findings if isinstance(finding, Check)]:
        head = ("case", "check", "measured", "allowed", "verdict", "worst")
        yield from markdown_table(head, [_cells(check) for check in checks])
    for finding in findings:
        if isinstance(finding, Text):
            yield from (finding.words, "")
        elif isinstance(finding, Plate):
            yield from (f"![{finding.caption}]({finding.name}.png)", "", f"*{finding.caption}*", "")


def _cells(check: Check) -> tuple[str, ...]:
    allowed, unit = (check.allowed.value, check.allowed.unit) if check.allowed else (None, "")
    amounts = _number(check.measured, unit), _number(allowed, unit)
    return check.subject, check.name, *amounts, check.verdict, check.worst


def _failure(check: Check) -> str:
    subject, name, measured, allowed, _, worst = _cells(check)
    return f"- rung {check.rung}, {subject}, {name}: {measured} (allowed {allowed}). Worst: {worst}"


def _listed(checks: Sequence[Check]) -> str:
    """In words; rows that leave out the same for the same reason are joined."""
    subjects: dict[tuple[str, str], list[str]] = {}
    for check in checks:
        subjects.setdefault((check.name, check.worst), []).append(check.subject)
    return "; ".join(f"{', '.join(of)}: {name} ({why})" for (name, why), of in subjects.items())


def _tolerances(prefix: str) -> Iterator[str]:
    rows = [
        (name, _number(value.value, value.unit), value.reason)
        for name, value in vars(tolerances).items()
        if isinstance(value, Tolerance) and name.startswith(prefix)
    ]
    yield from ("## Tolerances", "")
    yield from markdown_table(("name", "value", "reason"), rows)


def _number(value: float | None, unit: str = "") -> str:
    return "-" if value is None else f"{value:.3g} {unit}".strip()

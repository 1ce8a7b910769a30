"""Report of the verification: a summary for the terminal, and one page in HTML that contains its figures."""

from __future__ import annotations

import base64
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from pathlib import Path

import numpy as np

import exunet
from exunet.base.files import cannot_write, replacing
from exunet.integrators.exudyn.engine import exudyn_version
from exunet.verification import tolerances
from exunet.verification.check import Check, Finding, Picture

NAME = "report.html"
STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 75em; margin: 2em auto; padding: 0 1em; color: #111; }
table { border-collapse: collapse; width: 100%; margin: 0.5em 0 1.5em; font-size: 13px; }
th, td { border-bottom: 1px solid #ccc; padding: 0.25em 0.6em; text-align: left; vertical-align: top; }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.fails td { background: #f6d5d5; } tr.measured td, tr.not td { color: #666; }
figure { display: inline-block; width: 48%; margin: 0.5% 0.5% 1.5em; vertical-align: top; }
figure img { width: 100%; } figcaption { font-size: 13px; color: #444; }
details > summary { cursor: pointer; margin: 0.5em 0; }
"""


@dataclass
class Report:
    """Findings of a verification, in sections.

    Parameters
    ----------
    title : str
    sections : sequence of str
        In the order of the page.
    opening : sequence of str
        Paragraphs below the verdict.
    findings : list
        So far.
    interrupted : bool
        True if items are missing.
    """

    title: str
    sections: Sequence[str]
    opening: Sequence[str] = ()
    findings: list[Finding] = field(default_factory=list)
    interrupted: bool = False
    started: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def checks(self) -> list[Check]:
        return [finding for finding in self.findings if isinstance(finding, Check)]

    @property
    def failed(self) -> list[Check]:
        return [check for check in self.checks if not check.holds]

    @property
    def verdict(self) -> str:
        """One sentence on all checks."""
        required = sum(check.tolerance is not None for check in self.checks)
        if self.interrupted:
            return f"INCOMPLETE: interrupted after {required} checks, {len(self.failed)} of them failed."
        if self.failed:
            return f"{len(self.failed)} of {required} checks FAIL."
        return f"All {required} checks hold."

    def summary(self) -> list[tuple[str, str, str]]:
        """Return for each section the number of checks that hold, and the check nearest to its tolerance."""
        rows = []
        for section in self.sections:
            checks = [check for check in self.checks if check.section == section and check.tolerance]
            if checks:
                worst = max(checks, key=lambda check: check.part)
                nearest = f"{worst.part:.2g} of its tolerance ({worst.subject}: {worst.name})"
                rows.append((section, f"{sum(check.holds for check in checks)} of {len(checks)}", nearest))
        return rows

    def open(self, folder: Path) -> None:
        """Make the folder and prove it writable; raises InputError."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with replacing(folder / NAME) as part:
                part.write_text("INCOMPLETE: the verification did not come to its end.\n", encoding="utf-8")
        except OSError as error:
            raise cannot_write(folder, error) from error

    def write(self, folder: Path) -> Path:
        """Write the page; returns its path."""
        path = folder / NAME
        with replacing(path) as part:
            part.write_text("\n".join(self._page()) + "\n", encoding="utf-8")
        return path

    def _page(self) -> Iterator[str]:
        minutes = (datetime.now(UTC) - self.started).total_seconds() / 60.0
        made = f"{self.started:%Y-%m-%d %H:%M} UTC, {minutes:.1f} min"
        programs = f"exunet {exunet.__version__}, Exudyn {exudyn_version()}, NumPy {np.__version__}"
        machine = f"Python {platform.python_version()}, {platform.platform()}"
        title = escape(self.title)
        yield f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{title}</title>"
        yield f"<style>{STYLE}</style></head><body><h1>{title}</h1>"
        yield f"<p><strong>{escape(self.verdict)}</strong></p>"
        for paragraph in (*self.opening, f"{made}; {programs}; {machine}."):
            yield f"<p>{escape(paragraph)}</p>"
        yield "<h2>Summary</h2>"
        yield from _table(("section", "checks that hold", "nearest to its tolerance"), self.summary())
        if self.failed:
            yield "<h2>Failing checks</h2>"
            yield from _checks(self.failed)
        for section in self.sections:
            checks = [check for check in self.checks if check.section == section]
            pictures = [
                item for item in self.findings if isinstance(item, Picture) and item.section == section
            ]
            if not checks and not pictures:
                continue
            yield f"<h2>{escape(section)}</h2>"
            yield from (_figure(picture) for picture in sorted(pictures, key=lambda item: item.name))
            yield f"<details><summary>{len(checks)} rows</summary>"
            yield from _checks(checks)
            yield "</details>"
        if missing := [check for check in self.checks if check.skipped]:
            yield "<h2>Not compared</h2>"
            rows = [(check.subject, check.name, check.where) for check in missing]
            yield from _table(("subject", "what", "why"), rows)
        yield "<h2>Tolerances and their reasons</h2>"
        yield from _table(("tolerance", "value", "reason"), self._tolerances())
        yield "</body></html>"

    def _tolerances(self) -> Iterator[tuple[str, str, str]]:
        """Yield the tolerances of the checks."""
        used = {check.tolerance for check in self.checks}
        for name, value in vars(tolerances).items():
            if isinstance(value, tolerances.Tolerance) and value in used:
                yield name, _number(value.value, value.unit), value.reason


def _table(head: Sequence[str], rows: Iterator[tuple[str, ...]] | Sequence[tuple[str, ...]]) -> Iterator[str]:
    yield f"<table><tr>{''.join(f'<th>{escape(cell)}</th>' for cell in head)}</tr>"
    for row in rows:
        yield f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>"
    yield "</table>"


def _checks(checks: Sequence[Check]) -> Iterator[str]:
    """Yield a table of checks, by subject in the order of their arrival."""
    order = {subject: number for number, subject in enumerate(dict.fromkeys(c.subject for c in checks))}
    head = ("subject", "check", "value", "expected", "error", "tolerance", "verdict", "where")
    yield f"<table><tr>{''.join(f'<th>{cell}</th>' for cell in head)}</tr>"
    for check in sorted(checks, key=lambda item: order[item.subject]):
        tolerance, unit = (check.tolerance.value, check.tolerance.unit) if check.tolerance else (np.nan, "")
        error = np.nan if check.tolerance is None else check.error
        numbers = (
            *(_number(number, digits=10) for number in (check.value, check.expected)),
            _number(error, unit, failing=not check.holds), _number(tolerance, unit),
        )  # fmt: skip
        kind = "" if check.verdict == "holds" else check.verdict.split()[0].lower()
        yield f"<tr class='{kind}'><td>{escape(check.subject)}</td><td>{escape(check.name)}</td>"
        yield "".join(f"<td class='number'>{escape(number)}</td>" for number in numbers)
        yield f"<td>{check.verdict}</td><td>{escape(check.where)}</td></tr>"
    yield "</table>"


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    caption = escape(picture.caption)
    image = f"<img src='data:image/png;base64,{data}' alt='{caption}'>"
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _number(value: float, unit: str = "", *, digits: int = 3, failing: bool = False) -> str:
    """Format a number; empty for NaN, which stands for an absent one unless the check fails."""
    return "" if np.isnan(value) and not failing else f"{value:.{digits}g} {unit}".strip()


def line_of(check: Check) -> str:
    """Return a check in one line, for the terminal."""
    tolerance = check.tolerance.value if check.tolerance else np.nan
    numbers = "" if np.isnan(check.value) else f"; {check.value:.10g}, expected {check.expected:.10g}"
    compared = f"{check.subject}: {check.name}: {check.error:.3g} > {tolerance:.3g}"
    return f"{check.verdict} {compared}{numbers}; {check.where}"

"""A step of the ladder or of the gallery: the smallest part that can run by itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import reference_impl as reference
from exunet.backends.protocol import IntegrationFailed
from exunet.base.errors import ExunetError, Interrupted
from exunet.verification.check import Check, Evidence
from exunet.verification.tolerances import RAN


@dataclass(frozen=True)
class Step:
    """What is looked at, and how; `run` yields what it finds, and fails where a code stops.

    rung    : of the ladder, or item of the gallery
    subject : the case, mostly
    work    : calculates the findings
    """

    rung: int
    subject: str
    work: Callable[[], Iterable[Evidence]]

    def run(self) -> Iterator[Evidence]:
        """The findings of the step, under its rung and subject; a run that stops becomes a failed check."""
        try:
            for finding in self.work():
                yield self._signed(finding)
        except Interrupted:
            raise KeyboardInterrupt from None
        except (ExunetError, IntegrationFailed, reference.Diverged) as stop:
            yield self.stopped(str(stop).split("\n")[0])

    def stopped(self, why: str) -> Evidence:
        """The failed check of a step that did not come to its end."""
        return self._signed(Check("ran to its end", math.inf, RAN, why))

    def _signed(self, finding: Evidence) -> Evidence:
        if isinstance(finding, Check) and not finding.subject:
            finding = replace(finding, subject=self.subject)
        return replace(finding, rung=finding.rung or self.rung)

"""The typed ways in which exunet fails; each says what happened, where, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from exunet.results.result import Result


class ExunetError(Exception):
    """Base of all errors that a user can meet; `exit_code` is the command's exit status."""

    exit_code = 1


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong in a case: `place` is "file:line" (or the option it came from)."""

    place: str
    key: str
    reason: str

    def __str__(self) -> str:
        return ": ".join(part for part in (self.place, self.key, self.reason) if part)


class CaseError(ExunetError):
    """A case that cannot be simulated as written; holds every fault found, not only the first."""

    exit_code = 2

    def __init__(self, faults: list[Fault]) -> None:
        self.faults = faults
        super().__init__("\n".join(map(str, faults)))


class BeyondFloats(CaseError):
    """A case whose numbers, each of them valid, lead beyond what floating-point can hold."""


class InputError(ExunetError):
    """A file, folder, option or argument that cannot be used; nothing was written."""

    exit_code = 2


class RunStopped(ExunetError):
    """A run that a guard or the engine stopped.

    partial    : what was computed until then
    step_cause : True if the steps are likely to blame, so that smaller ones may help
    """

    exit_code = 3

    def __init__(self, message: str, partial: Result | None = None, step_cause: bool = False) -> None:
        self.partial = partial
        self.step_cause = step_cause
        super().__init__(message)


class Interrupted(RunStopped):
    """A run that the user stopped with Ctrl-C; `partial` holds what was computed until then."""

    exit_code = 130


class UncheckedRun(ExunetError):
    """The reference could not check a run; its result was written all the same."""

    exit_code = 4


class MissingExtra(ExunetError):
    """An optional dependency is absent."""

    exit_code = 2

"""The typed ways in which exunet fails; each says what happened, where, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

from exunet.base.key_path import KeyPath, key_path

LARGEST = 1e100  # of a number that a case leads to; products of three are still floating-point numbers


class ExunetError(Exception):
    """Base of all errors that a user can meet; `exit_code` is the command's exit status."""

    exit_code = 1


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong in a case.

    key   : where, as TOML writes keys, with [index] for items of lists: "net.cable.density", "net.nodes[3]"
    place : "file:line" or the option that it came from; "" as long as it is not known
    beyond_floats : numbers, each of them valid, lead outside the range of floating-point numbers here, or
                    outside of what they resolve
    against : keys, named likewise, that `key` does not go with: the error is located where the last is given
    """

    key: str
    reason: str
    _: KW_ONLY
    place: str = ""
    beyond_floats: bool = False
    against: tuple[str, ...] = ()

    @property
    def path(self) -> KeyPath:
        """The parts of a key that are all bare: ("net", "nodes", 3)."""
        return self.paths[0]

    @property
    def paths(self) -> tuple[KeyPath, ...]:
        """The path, and those of the keys in `against`."""
        return tuple(key_path(key) if key else () for key in (self.key, *self.against))

    def __str__(self) -> str:
        return ": ".join(part for part in (self.place, self.key, self.reason) if part)


def within(table: str, faults: Iterable[Fault]) -> Iterator[Fault]:
    """Yield faults of the keys in a table with keys relative to what holds the table."""
    for fault in faults:
        against = tuple(f"{table}.{key}" for key in fault.against)
        yield replace(fault, key=f"{table}.{fault.key}" if fault.key else table, against=against)


class CaseError(ExunetError):
    """A case that cannot be simulated as written; holds every fault found, not only the first."""

    exit_code = 2

    def __init__(self, faults: list[Fault]) -> None:
        self.faults = faults
        super().__init__("\n".join(map(str, faults)))


@contextmanager
def collected() -> Iterator[list[Fault]]:
    """Collect faults in a list; at the end of the block raise all of them at once.

    A CaseError from inside the block, after which it cannot continue, joins those found before.
    """
    faults: list[Fault] = []
    try:
        yield faults
    except CaseError as error:
        raise CaseError([*faults, *error.faults]) from error
    if faults:
        raise CaseError(faults)


@contextmanager
def joining(faults: list[Fault]) -> Iterator[None]:
    """Add the faults of a CaseError from inside the block to a list, and continue after the block."""
    try:
        yield
    except CaseError as error:
        faults += error.faults


class CaseWarning(UserWarning):
    """Warning of side effects of overrides: keys of a case that they drop, numbered nodes that they move."""


class InputError(ExunetError):
    """A file, folder, option or argument that cannot be used; nothing was written."""

    exit_code = 2


class UnsoundStates(InputError):
    """Stored states that no result can be made of: NaN, infinity, or times that do not increase."""


class RunStopped(ExunetError):
    """A run that a guard or the engine stopped.

    result     : what was computed until then
    step_cause : True if the steps are likely to blame, so that smaller ones may help
    """

    exit_code = 3

    def __init__(self, message: str, result: Any = None, step_cause: bool = False) -> None:
        self.result = result
        self.step_cause = step_cause
        super().__init__(message)


class Interrupted(RunStopped):
    """A run that the user stopped with Ctrl-C; `result` holds what was computed until then."""

    exit_code = 130


class UncheckedRun(ExunetError):
    """The reference could not check a run; its result was written all the same."""

    exit_code = 4


class FigureError(ExunetError):
    """Figures that could not be drawn; the others are written."""

    exit_code = 2


class MissingExtra(ExunetError):
    """An optional dependency is absent."""

    exit_code = 2

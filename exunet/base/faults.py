"""Plain functions that check keys against each other yield faults; here they are put together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import islice, pairwise
from typing import Any

from exunet.base.errors import CaseError, Fault
from exunet.base.table import Table, Unknown

SHOWN = 20  # of the faults in one list


def each(*checks: Iterator[Fault]) -> Iterator[Fault]:
    """The faults of several checks; a check that needs a key that is not valid ends there."""
    for check in checks:
        with suppress(Unknown):
            yield from check


def shortened(check: Iterator[Fault]) -> Iterator[Fault]:
    """The first faults that one check finds in a long list, and how many more there are."""
    last = None
    for last in islice(check, SHOWN):
        yield last
    if last and (more := sum(1 for _ in check)):
        yield Fault(last.key.partition("[")[0], f"and {more} more like these")


def inside(record: Table, name: str, checks: Callable[[Any], Iterator[Fault]]) -> Iterator[Fault]:
    """The faults of a table in a record, if it has it; raises Unknown if that is not a table."""
    if (table := getattr(record, name)) is not None:
        yield from within(name, checks(table))


def within(table: str, faults: Iterable[Fault]) -> Iterator[Fault]:
    """Faults of the keys in a table, as seen from outside it."""
    for fault in faults:
        against = tuple(f"{table}.{key}" for key in fault.against)
        yield replace(fault, key=f"{table}.{fault.key}" if fault.key else table, against=against)


def told_apart(names: Iterable[str]) -> Iterator[Fault]:
    """A fault for each name that differs from one before it by capital letters only."""
    known: dict[str, str] = {}
    for name in names:
        before = known.setdefault(name.lower(), name)
        if before != name:
            yield Fault(name, f'differs from "{before}" by capital letters only: rename one')


def increasing(key: str, times: Sequence[float | None]) -> Iterator[Fault]:
    """A fault for each time [s] of a list that is not later than the one before it; None: not valid."""
    for k, (before, time) in enumerate(pairwise(times), start=1):
        if before is not None and time is not None and time <= before:
            yield Fault(f"{key}[{k}]", f"must be greater than the time before it, {before:g} s, got {time:g}")


def exactly_one(keys: Table) -> Iterator[Fault]:
    """A fault for each table, this one or inside it, that has none or more than one of its choices."""
    if choices := type(keys).EXACTLY_ONE:
        given = [name for name in choices if keys.is_given(name)]
        if len(given) != 1:
            words = f"{', '.join(choices[:-1])} or {choices[-1]}"
            key, against = (given[-1], tuple(given[:-1])) if given else ("", ())
            yield Fault(key, f"give either {words}, exactly one of them", against=against)
    for name, value in keys.__dict__.items():
        if isinstance(value, Table):
            yield from within(name, exactly_one(value))


@contextmanager
def collected() -> Iterator[list[Fault]]:
    """A list for the faults that the block finds; at its end all are raised at once, if there are any.

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
    """Add the faults of a CaseError from inside the block to a list, and go on after the block."""
    try:
        yield
    except CaseError as error:
        faults += error.faults

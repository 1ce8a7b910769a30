"""A Result from stored rows: in memory while they are few, read when they are asked for while many."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError, UnsoundStates
from exunet.net.arrays import Net
from exunet.results.columns import (
    CONSTANTS,
    OPTIONAL,
    PATHS,
    STATES,
    BodyConstants,
    Column,
    body_path,
    body_quantities,
    declare,
)
from exunet.results.result import BodyStates, Result, TermStates
from exunet.results.rows import StoredRows, blocks
from exunet.results.store import RowSource

Floats = NDArray[np.float64]

IN_MEMORY = 64 << 20  # bytes of all columns up to which they are read at once


def result_of_rows(
    source: RowSource,
    net: Net,
    bodies: Mapping[str, BodyConstants],
    complete: bool,
    verdict: str,
    provenance: dict[str, Any],
    where: str,
) -> Result:
    """The Result of the rows in `source`, each value checked.

    Columns of up to 64 MB in all are copied to memory; of larger ones all but the times become
    `StoredRows`, which read from `source`; it must not change then. Raises InputError, which begins with
    `where`, if a column is absent, if a value is NaN or infinite, if the times do not increase, or if a node
    that is fixed to a body is not there.
    """
    for name, body in bodies.items():
        if body.nodes is not None and np.any((body.nodes < 0) | (body.nodes >= net.n_nodes)):
            raise InputError(f"{where}: a node is fixed to body {name} that the net does not have")
    there = {column.path: column for column in source.columns}
    small = len(source) * sum(column.row_bytes for column in source.columns) <= IN_MEMORY
    found: dict[str, Any] = {}
    of_terms = [column for column in source.columns if column.path.startswith(STATES)]
    for column in (*declare(net.n_nodes, net.n_elements, bodies), *of_terms):
        if column.path not in there:
            if column.path not in _OPTIONAL_PATHS:
                raise InputError(f"{where}: damaged or cut short (there is no {column.path})")
            continue
        shape = (len(source), *there[column.path].row)
        if shape[1:] != column.row:
            raise InputError(f"{where}: {column.path} has shape {shape}, unlike the other arrays")
        values: Any = StoredRows(partial(source.read, column.path), shape)
        found[column.path] = np.asarray(values) if small or column.path == "time" else values
        check_values(found[column.path], column, where)
    check_times(found["time"], where)
    return Result(
        net=net,
        **{name: found[path] for name, path in PATHS.items() if path in found},
        complete=complete,
        verdict=verdict,
        provenance=provenance,
        bodies={name: _body(found, name, body) for name, body in bodies.items()},
        states={c.path[len(STATES) :]: TermStates(c.units, found[c.path]) for c in of_terms},
    )


_OPTIONAL_PATHS = {PATHS[name] for name in OPTIONAL}


def _body(found: Mapping[str, Any], name: str, body: BodyConstants) -> BodyStates:
    states = {quantity: found[body_path(name, quantity)] for quantity in body_quantities(body)}
    return BodyStates(body.mass, **{one: getattr(body, one) for one in CONSTANTS}, **states)


def check_values(values: Any, column: Column, where: str) -> None:
    """Raises InputError if a value of a column is NaN or infinite."""
    first = 0
    for block in blocks(values):
        if not np.all(np.isfinite(block)):
            row, *others = (int(k) for k in np.argwhere(~np.isfinite(block))[0])
            at = [first + row, *others]
            raise UnsoundStates(f"{where}: {column.path} contains NaN or infinity (first at {at})")
        first += len(block)


def check_times(time: Floats, where: str) -> None:
    """Raises InputError unless there are stored times, and they increase."""
    if len(time) == 0 or np.any(np.diff(time) <= 0):
        raise UnsoundStates(f"{where}: the stored times must be at least one, and increase")

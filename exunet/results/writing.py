"""Writes result files: rows are joined by streaming, whatever store they come from.

The file is HDF5 with groups per block: `net/`, `bodies/NAME/`, `energy/`, `momentum/`, and what does not
change of the net in `net/reference/`. Each dataset has checksums, units and a description. The same rows give
the same bytes: the shape of the chunks follows from the number of rows and the size of one.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError
from exunet.base.files import cannot_write, path_of, replacing
from exunet.net.arrays import Net
from exunet.results.columns import (
    CONSTANTS,
    PATHS,
    STATES,
    BodyConstants,
    Column,
    body_path,
    body_quantities,
    declare,
    state_column,
)
from exunet.results.from_rows import check_times, check_values
from exunet.results.net_arrays import NET_ARRAYS, to_arrays
from exunet.results.result import Result
from exunet.results.rows import row_ranges
from exunet.results.store import RowSource

if TYPE_CHECKING:
    import h5py

Floats = NDArray[np.float64]

FILE_KIND, ENSEMBLE_KIND = "exunet result", "exunet ensemble"
FILE_FORMAT = 2
HDF5_VERSIONS = ("v110", "v110")  # every reader since 2016; the first form with checksums on all metadata
CHUNK_BYTES = 1 << 20  # what is read for a single state, and no more than HDF5 keeps at hand
PLAIN_BYTES = 1 << 16  # datasets up to that size are not compressed, which costs 12 ms for each MB
NET_GROUP = "net/reference"


@takes(result=Result, overwrite=bool)
def save(result: Result, path: str | Path, *, overwrite: bool = False) -> None:
    """Write `result` to an HDF5 file; the same result gives the same bytes.

    overwrite : replace an older file of that name, which stays as it is until the new one is whole

    The file appears whole or not at all. Raises InputError, and writes nothing, if there is a file of that
    name and `overwrite` is False, if an array contains NaN or infinity or has a shape that does not fit, if
    the stored times do not increase, if the provenance is not JSON-like, or if the file cannot be written.
    """
    path = path_of(path, "save")
    if not overwrite and os.path.isfile(path):
        raise InputError(f"{path}: there is a file of that name: give another, or overwrite=True")
    bodies = {
        name: BodyConstants(body.mass, **{one: getattr(body, one) for one in CONSTANTS})
        for name, body in result.bodies.items()
    }
    source = _ResultRows(result, bodies, _where(path))
    join(source, path, result.net, bodies, result.provenance, result.verdict, result.complete)


def join(
    source: RowSource,
    path: str | Path,
    net: Net,
    bodies: Mapping[str, BodyConstants],
    provenance: Mapping[str, Any],
    verdict: str,
    complete: bool,
) -> None:
    """Write the rows of `source` to a result file, about a megabyte at a time; see `save`."""
    where = _where(path)
    try:
        story = json.dumps(provenance, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{where}: provenance cannot be written as JSON: {error}") from error
    arrays = to_arrays(net, where)
    check_times(source.read("time", 0, len(source)), where)
    with new_file(path) as (file, sink):
        put_text(file, "kind", FILE_KIND)
        file.attrs["format"] = FILE_FORMAT
        file.attrs["complete"] = bool(complete)
        put_text(file, "verdict", verdict)
        put_text(file, "provenance", story)
        for name, kind in ((name, NET_ARRAYS[name]) for name in arrays):
            put(file, f"{NET_GROUP}/{name}", arrays[name], kind.units, kind.description)
        for name, body in bodies.items():
            put(file, body_path(name, "mass"), np.array([body.mass], dtype="<f8"), "kg", "mass")
            for one, values in body.arrays().items():
                stored = CONSTANTS[one]
                values = np.asarray(values, stored.dtype)
                put(file, body_path(name, one), values, stored.units, stored.description)
        for column in sorted(source.columns, key=lambda column: column.path):
            _put_rows(file, sink, source, column, where)


def _where(path: str | Path) -> str:
    return f"the result for {path}"


class _ResultRows:
    """The arrays of a Result as rows; raises InputError, which begins with `where`, if they do not fit."""

    def __init__(self, result: Result, bodies: Mapping[str, BodyConstants], where: str) -> None:
        arrays: dict[str, Any] = {path: getattr(result, name) for name, path in PATHS.items()}
        for name, properties in bodies.items():
            for quantity in body_quantities(properties):
                arrays[body_path(name, quantity)] = getattr(result.bodies[name], quantity)
        of_terms = [
            state_column(name, one.values.shape[1], one.units) for name, one in sorted(result.states.items())
        ]
        arrays |= {STATES + name: one.values for name, one in result.states.items()}
        self._arrays = {path: values for path, values in arrays.items() if values is not None}
        declared = (*declare(result.net.n_nodes, result.net.n_elements, bodies), *of_terms)
        self.columns = tuple(column for column in declared if column.path in self._arrays)
        for column in self.columns:
            shape = self._arrays[column.path].shape
            if shape != (len(self), *column.row):
                raise InputError(f"{where}: {column.path} has shape {shape}, unlike the other arrays")

    def __len__(self) -> int:
        return len(self._arrays["time"])

    def read(self, path: str, start: int, stop: int) -> Floats:
        return np.asarray(self._arrays[path][start:stop], dtype=np.float64, order="C")


def _put_rows(file: h5py.File, sink: _Sink, source: RowSource, column: Column, where: str) -> None:
    """One column, chunk by chunk, each value checked."""
    count, size = len(source), len(source) * column.row_bytes
    rows = max(1, min(count, CHUNK_BYTES // max(1, column.row_bytes)))
    if size <= PLAIN_BYTES:
        rows = max(1, count)
    dataset = _create(file, column.path, (count, *column.row), np.dtype("<f8"), (rows, *column.row))
    for start, stop in row_ranges(count, rows):
        values = source.read(column.path, start, stop)
        check_values(values, column, where)
        if size:
            dataset[start:stop] = values
        sink.refuse()
    _describe(dataset, column.units, column.description)


def put(file: h5py.File, path: str, values: NDArray[Any], units: str, description: str) -> None:
    """A dataset that is no larger than a state or two, in one chunk."""
    dataset = _create(file, path, values.shape, values.dtype, values.shape)
    if values.size:
        dataset[...] = values
    _describe(dataset, units, description)


def _create(
    file: h5py.File, path: str, shape: tuple[int, ...], dtype: np.dtype[Any], chunks: tuple[int, ...]
) -> h5py.Dataset:
    """An empty dataset with checksums, compressed if it is large."""
    kept: dict[str, Any] = {}
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    if size:
        kept = {"fletcher32": True, "chunks": chunks}
    if size > PLAIN_BYTES:
        kept |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    return file.create_dataset(path, shape=shape, dtype=dtype, track_times=False, **kept)


def _describe(dataset: h5py.Dataset, units: str, description: str) -> None:
    put_text(dataset, "units", units)
    put_text(dataset, "description", description)


def put_text(owner: h5py.Group | h5py.Dataset, name: str, text: str) -> None:
    """An attribute of fixed length: kept with the others under a checksum, unlike text of variable length."""
    import h5py

    code = text.encode("utf-8", "replace")
    owner.attrs.create(name, code, dtype=h5py.string_dtype("utf-8", max(1, len(code))))


class _Sink(io.RawIOBase):
    """A file for HDF5 to write to, which never sees an error: inside HDF5 a full disk ends the process.

    error : the first one, after which nothing more is written
    """

    def __init__(self, stream: io.FileIO) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def refuse(self) -> None:
        """Raise the first error, if there was one."""
        if self.error is not None:
            raise self.error

    def write(self, data: Any) -> int:
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while self.error is None and len(rest):
                rest = rest[self._stream.write(rest) :]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None) -> int:
        try:
            if self.error is None:
                return self._stream.truncate(size)
        except OSError as error:
            self.error = error
        return size or 0

    def readinto(self, buffer: Any) -> int:
        return self._stream.readinto(buffer) or 0

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True


@contextmanager
def new_file(path: str | Path) -> Iterator[tuple[h5py.File, _Sink]]:
    """An HDF5 file that takes the place of `path` at the end; a failure to write is an InputError."""
    import h5py

    with replacing(path) as part, io.FileIO(part, "r+") as stream:
        sink = _Sink(stream)
        try:
            with h5py.File(sink, "w", libver=HDF5_VERSIONS, rdcc_nbytes=CHUNK_BYTES) as file:
                yield file, sink
        except InputError:
            raise
        except Exception as error:
            if sink.error is None:
                raise
            raise cannot_write(path, sink.error) from error
        if sink.error is not None:
            raise cannot_write(path, sink.error)

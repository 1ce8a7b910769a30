"""Reads results: files of this and the first format, and the states of unfinished runs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.base.files import path_of
from exunet.base.interrupt import postponed
from exunet.results.columns import (
    CONSTANTS,
    PATHS,
    BodyConstants,
    Column,
    body_constants,
    declare,
    state_column,
)
from exunet.results.from_rows import result_of_rows
from exunet.results.net_arrays import NET_ARRAYS, OPTIONAL, from_arrays
from exunet.results.result import Result
from exunet.results.rows import StoredRows
from exunet.results.segments import Segments, is_store
from exunet.results.writing import CHUNK_BYTES, ENSEMBLE_KIND, FILE_FORMAT, FILE_KIND, NET_GROUP

if TYPE_CHECKING:
    import h5py

Floats = NDArray[np.float64]

RESULT_FILE = "result.h5"
SPREAD_FILE = "spread.h5"  # beside it: what moved starts gave, which describes it
STORE_FOLDER = "unfinished"  # beside it, during the run


def load_result(path: str | Path) -> Result:
    """The Result kept in a file that `save` wrote, or in the folder of a run; the same values, bit for bit.

    A folder is read for its result.h5, or else for the states of an unfinished run (see `open_unfinished`).
    A spread.h5 beside a result.h5 is its `spread_file`, which figures show.
    Large arrays stay in the file, see `Result`. Raises InputError, one line, if there is no such file or it
    is not a whole result file of a known format.
    """
    path = path_of(path, "load_result")
    if path.is_dir():
        whole = path / RESULT_FILE
        return load_result(whole) if whole.is_file() else open_unfinished(path)
    refuse_unreadable(path)
    with damage(path):
        file = open_to_read(path)
        open_rows = False
        try:
            _refuse_other_formats(file, path)
            result = _read(file, path)
            open_rows = isinstance(result.position, StoredRows)
        finally:
            if not open_rows:
                file.close()
        spread = path.with_name(SPREAD_FILE)
        its_own = path.name == RESULT_FILE and spread.is_file()
        return replace(result, spread_file=spread) if its_own else result


def open_unfinished(folder: str | Path) -> Result:
    """The states that a run has stored, during the run or after it was killed: an incomplete Result.

    folder : the run's folder, or the one in it with the stored states

    Raises InputError if there are none, or if a file is damaged.
    """
    folder = Path(folder)
    places = [place for place in (folder, folder / STORE_FOLDER) if is_store(place)]
    if not places:
        raise InputError(f"{folder}: neither a {RESULT_FILE} nor the states of an unfinished run are there")
    source = Segments(places[0])
    if len(source) == 0:
        raise InputError(f"{folder}: the unfinished run has not stored a state yet")
    end = float(source.read("time", len(source) - 1, len(source))[0])
    verdict = f"unfinished: {len(source)} states until t = {end:.6g} s were stored"
    return result_of_rows(source, source.net, source.bodies, False, verdict, source.provenance, str(folder))


class _FileRows:
    """The columns of an open result file, as far as they are there; HDF5 closes it after the last reference.

    names : dataset of each column, by the column's path
    """

    def __init__(
        self, file: h5py.File, path: str | Path, names: Mapping[str, str], declared: tuple[Column, ...]
    ) -> None:
        self._file = file
        self._path = path
        self._names = names
        self._count = len(file[names["time"]])
        there = [column for column in declared if names[column.path] in file]
        shapes = {column.path: file[names[column.path]].shape for column in there}
        for name, shape in shapes.items():
            if shape[:1] != (self._count,):
                raise InputError(f"{path}: {name} has shape {shape}, unlike the other arrays")
        self.columns = tuple(replace(column, row=shapes[column.path][1:]) for column in there)

    def __len__(self) -> int:
        return self._count

    def read(self, path: str, start: int, stop: int) -> Floats:
        with damage(self._path):
            return np.asarray(self._file[self._names[path]][start:stop], dtype=np.float64)


def _read(file: h5py.File, path: str | Path) -> Result:
    first = int(file.attrs["format"]) == 1
    group = file["net" if first else NET_GROUP]
    known = {name: kind for name, kind in NET_ARRAYS.items() if name in group or name not in OPTIONAL}
    arrays = {name: _native(group[name][()], kind.dtype) for name, kind in known.items()}
    net = from_arrays(arrays, str(path))
    bodies = {name: _constants(one) for name, one in file["bodies"].items()} if "bodies" in file else {}
    provenance = json.loads(_text(file.attrs["provenance"]))
    if not isinstance(provenance, dict):
        raise ValueError("provenance is not a JSON object")
    declared = (*declare(net.n_nodes, net.n_elements, bodies), *_of_terms(file))
    names = {column.path: column.path for column in declared}
    if first:  # it kept all columns at the root, under the names of the attributes
        names = {place: name for name, place in PATHS.items()}
    source = _FileRows(file, path, names, declared)
    complete, verdict = bool(file.attrs["complete"]), _text(file.attrs["verdict"])
    return result_of_rows(source, net, bodies, complete, verdict, provenance, str(path))


def _of_terms(file: h5py.File) -> Iterator[Column]:
    """The columns of the first-order states of forces."""
    import h5py

    for term, group in sorted(file["states"].items() if "states" in file else ()):
        for quantity, dataset in sorted(group.items()):
            if not isinstance(dataset, h5py.Dataset) or dataset.ndim != 2:
                raise ValueError(f"{dataset.name} is not an array over times and values")
            yield state_column(f"{term}/{quantity}", dataset.shape[1], _text(dataset.attrs["units"]))


def _constants(group: h5py.Group) -> BodyConstants:
    there = ((name, kind.dtype) for name, kind in CONSTANTS.items() if name in group)
    arrays = {name: _native(group[name][()], dtype) for name, dtype in there}
    try:
        return body_constants(float(group["mass"][0]), arrays)
    except ValueError as error:
        raise ValueError(f"{group.name}: {error}") from error


def _native(values: NDArray[Any], dtype: str) -> NDArray[Any]:
    return np.asarray(values, dtype=np.dtype(dtype).newbyteorder("="))


def _text(stored: Any) -> str:
    return stored.decode("utf-8") if isinstance(stored, bytes) else str(stored)


def open_to_read(path: str | Path) -> h5py.File:
    """Open an HDF5 file for reading, without a lock where the file system has no locks.

    Raises InputError if another program has locked it for writing.
    """
    import h5py

    try:
        return h5py.File(path, "r", rdcc_nbytes=CHUNK_BYTES)
    except BlockingIOError as error:
        raise InputError(f"{path}: another program is writing this file: close it there") from error
    except OSError as error:
        if "unable to lock file" not in str(error):
            raise
        return h5py.File(path, "r", rdcc_nbytes=CHUNK_BYTES, locking=False)


@contextmanager
def damage(path: str | Path) -> Iterator[None]:
    """Turns whatever HDF5 raises into an InputError; Ctrl-C waits, since h5py's destructors would lose it."""
    try:
        with postponed():
            yield
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file can make h5py raise anything
        _refuse(path, f"damaged or cut short ({' '.join(str(error).split())})", error)


def refuse_unreadable(path: str | Path) -> None:
    try:
        with Path(path).open("rb") as stream:
            start = stream.read(8)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if start != b"\x89HDF\r\n\x1a\n":
        _refuse(path, "it is not an HDF5 file")


def _refuse_other_formats(file: h5py.File, path: str | Path) -> None:
    kind = _text(file.attrs.get("kind"))
    if kind == ENSEMBLE_KIND:
        _refuse(path, f"it has the runs of an ensemble, or of the spread beside a {RESULT_FILE}")
    if kind != FILE_KIND:
        _refuse(path, "an HDF5 file of some other program")
    found = int(file.attrs["format"])
    if not 1 <= found <= FILE_FORMAT:
        newer = "; a newer exunet wrote it" if found > FILE_FORMAT else ""
        _refuse(path, f"its format is {found}, this exunet reads formats 1 to {FILE_FORMAT}{newer}")


def _refuse(path: str | Path, reason: str, cause: Exception | None = None) -> NoReturn:
    raise InputError(f"{path}: not a result file of exunet: {reason}") from cause

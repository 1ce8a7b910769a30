"""The result file: written from rows, read back bit for bit.

The file is HDF5 with groups: `net/`, `bodies/NAME/`, `energy/`, `momentum/`, and `net/reference/` for what
does not change of the net. Each dataset has checksums, units and a description. The same rows give the same
bytes: the shape of the chunks follows from the number of rows and the size of one.
"""

from __future__ import annotations

import io
import itertools
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError, UnsoundStates
from exunet.base.files import cannot_write, path_of, replacing
from exunet.base.interrupt import postponed
from exunet.forces.contact.status import ContactKey
from exunet.net.arrays import Net, TetherNodes
from exunet.results.result import (
    BODY_QUANTITIES,
    CONSTANTS,
    OPTIONAL,
    PATHS,
    STATES,
    BodyConstants,
    BodyStates,
    Column,
    Result,
    StoredRows,
    TermStates,
    body_constants,
    body_path,
    declare,
    row_ranges,
    state_column,
)
from exunet.results.run_record import RunRecord
from exunet.results.store import STORE_FILE, FileStore, MemoryStore, RowSource

if TYPE_CHECKING:
    import h5py


RESULT_FILE = "result.h5"
ENSEMBLE_FILE = "ensemble.h5"  # of perturbed runs, or of `exunet ensemble`

FILE_KIND, ENSEMBLE_KIND = "exunet result", "exunet ensemble"
FILE_FORMAT = 1
HDF5_VERSIONS = ("v110", "v110")  # every reader since 2016; the first form with checksums on all metadata
CHUNK_BYTES = 1 << 20  # what is read for a single state, and no more than HDF5 keeps at hand
PLAIN_BYTES = 1 << 16  # datasets up to that size are not compressed, which costs 12 ms for each MB
IN_MEMORY = 64 << 20  # bytes of all columns up to which they are read at once
NET_GROUP = "net/reference"


# --- the net as arrays


class _NetArray(NamedTuple):
    """One array of a net: letters of `shape` are sizes that arrays share, digits are fixed."""

    shape: str
    units: str
    description: str
    dtype: str = "<f8"


_PLAIN = {
    "reference_position": _NetArray("n3", "m", "node positions in the undeformed reference configuration"),
    "mass": _NetArray("n", "kg", "lumped mass of each node, bullets included"),
    "element_nodes": _NetArray("e2", "1", "nodes at the ends of each element, from 0", "<i8"),
    "reference_length": _NetArray("e", "m", "undeformed length of each element"),
    "area": _NetArray("e", "m2", "undeformed cross-section area of each element"),
    "youngs_modulus": _NetArray("e", "Pa", "Young's modulus of each element"),
    "density": _NetArray("e", "kg/m3", "mass density of each element"),
    "is_string": _NetArray("e", "1", "true for the elements of corner strings", "|b1"),
    "bullet_nodes": _NetArray("b", "1", "nodes that carry a bullet", "<i8"),
    "fixed_nodes": _NetArray("f", "1", "nodes that are held still", "<i8"),
    "knots": _NetArray("k", "1", "nodes at the ends of mesh sides", "<i8"),
}
_STRENGTH = _NetArray(
    "e",
    "N",
    "axial force that each element may bear: strength x knot efficiency / safety factor; 0: not known",
)
_LAW = {
    "law_number": _NetArray(
        "e", "1", "law of each element: 0 paper's, 1 Hooke's, 2 + first row of a table", "<i8"
    ),
    "law_table": _NetArray("r4", "1", "rows of tables: strain, force, slope over EA, energy over EA L0"),
}
_LOOPS = {  # name: sizes of the two arrays, content
    "face": ("vo", "loops of nodes round the mesh openings"),
    "mouth": ("wp", "loop of corner nodes round the net's mouth"),
    "tether": ("xy", "nodes along the tethers"),
}
_NET = (
    _PLAIN
    | {"strength": _STRENGTH}
    | _LAW
    | {
        f"{name}_{part}": _NetArray(size, "1", words, "<i8")
        for name, (sizes, content) in _LOOPS.items()
        for part, size, words in (
            ("values", sizes[0], f"{content}, one after another"),
            ("offsets", sizes[1], f"loop k is {name}_values[offsets[k]:offsets[k + 1]]"),
        )
    }
    | {
        "tether_first": _NetArray("t", "1", "first node of each tether that no other thread has", "<i8"),
        "tether_names": _NetArray("q", "1", "names of the tethers, a line each, in bytes of UTF-8", "|u1"),
    }
)


def _net_arrays(net: Net, where: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of a net, those of tethers and strengths if it has any; raises InputError."""
    arrays = {name: np.asarray(getattr(net, name), kind.dtype, order="C") for name, kind in _PLAIN.items()}
    loops = {"face": net.faces, "mouth": (net.mouth,) if net.mouth else ()}
    if net.tethers:
        loops["tether"] = tuple(tether.nodes for tether in net.tethers)
        names = "\n".join(tether.name for tether in net.tethers)
        arrays["tether_names"] = np.frombuffer(names.encode(), dtype="|u1")
        arrays["tether_first"] = np.array([tether.first for tether in net.tethers], dtype="<i8")
    for name, nodes in loops.items():
        arrays[f"{name}_values"] = np.array([node for loop in nodes for node in loop], dtype="<i8")
        arrays[f"{name}_offsets"] = np.cumsum([0, *map(len, nodes)], dtype="<i8")
    if net.strength is not None:
        arrays["strength"] = np.asarray(net.strength, dtype="<f8", order="C")
    if net.law_number is not None:
        arrays |= {name: np.asarray(getattr(net, name), kind.dtype, order="C") for name, kind in _LAW.items()}
    _validate_net(arrays, where)
    return arrays


def _net_of(arrays: Mapping[str, NDArray[Any]], where: str) -> Net:
    """Return the net of arrays that `_net_arrays` made; raises InputError."""
    _validate_net(arrays, where)
    plain: dict[str, Any] = {name: arrays[name] for name in (*_PLAIN, "strength", *_LAW) if name in arrays}
    for values in plain.values():
        values.setflags(write=False)
    faces, mouths = _loops(arrays, "face"), _loops(arrays, "mouth")
    tethers: tuple[TetherNodes, ...] = ()
    if "tether_names" in arrays:
        names = bytes(arrays["tether_names"]).decode(errors="replace").split("\n")
        parts = zip(names, arrays["tether_first"].tolist(), _loops(arrays, "tether"), strict=True)
        tethers = tuple(TetherNodes(*part) for part in parts)
    return Net(**plain, faces=faces, mouth=mouths[0] if mouths else (), tethers=tethers)


def _loops(arrays: Mapping[str, Ints], name: str) -> tuple[tuple[int, ...], ...]:
    nodes, bounds = arrays[f"{name}_values"].tolist(), arrays[f"{name}_offsets"].tolist()
    return tuple(tuple(nodes[a:b]) for a, b in itertools.pairwise(bounds))


def _validate_net(arrays: Mapping[str, NDArray[Any]], where: str) -> None:
    """Raise InputError unless shapes fit together, values are finite and nodes are there."""
    sizes = {"2": 2, "3": 3}
    for name, values in arrays.items():
        shape = _NET[name].shape
        if values.ndim != len(shape) or any(
            sizes.setdefault(axis, n) != n for axis, n in zip(shape, values.shape, strict=True)
        ):
            raise InputError(f"{where}: {name} of the net has shape {values.shape}, unlike the other arrays")
        if not np.all(np.isfinite(values)):
            raise InputError(f"{where}: {name} of the net contains NaN or infinity")
    for name in (name for name in _LOOPS if f"{name}_offsets" in arrays):
        offsets, end = arrays[f"{name}_offsets"], len(arrays[f"{name}_values"])
        if not len(offsets) or offsets[0] != 0 or offsets[-1] != end or np.any(np.diff(offsets) < 0):
            raise InputError(f"{where}: damaged: {name}_offsets of the net")
    nodes = ("element_nodes", "bullet_nodes", "fixed_nodes", *(f"{name}_values" for name in _LOOPS))
    for name in (name for name in (*nodes, "tether_first") if name in arrays):
        if np.any((arrays[name] < 0) | (arrays[name] >= sizes["n"])):
            raise InputError(f"{where}: {name} of the net has a node that the net does not have")


# --- writing


@takes(result=Result, overwrite=bool)
def save(result: Result, path: str | Path, *, overwrite: bool = False) -> None:
    """Write `result` to an HDF5 file; the same result gives the same bytes.

    overwrite : replace an older file of that name, which stays as it is until the new one is whole

    The file appears whole or not at all. Raises InputError, and writes nothing, if there is a file of that
    name and `overwrite` is False, if an array contains NaN or infinity or has a shape that does not fit, if
    the stored times do not increase, if its record has NaN or infinity, or if the file cannot be written.
    """
    path = path_of(path, "save")
    if not overwrite and os.path.isfile(path):
        raise InputError(f"{path}: there is a file of that name: give another, or overwrite=True")
    bodies = {
        name: BodyConstants(body.mass, **{constant: getattr(body, constant) for constant in CONSTANTS})
        for name, body in result.bodies.items()
    }
    source = _ResultRows(result, bodies, _where(path))
    write_rows(source, path, result.net, bodies, result.run)


def write_rows(
    source: RowSource,
    path: str | Path,
    net: Net,
    bodies: Mapping[str, BodyConstants],
    run: RunRecord,
) -> None:
    """Write the rows of `source` to a result file, about a megabyte at a time; see `save`."""
    where = _where(path)
    validate_times(source.read("time", 0, len(source)), where)
    with new_file(path) as (file, sink):
        _put_head(file, where, net, bodies, run)
        for column in sorted(source.columns, key=lambda column: column.path):
            count, size = len(source), len(source) * column.row_bytes
            rows = max(1, min(count, CHUNK_BYTES // max(1, column.row_bytes)))
            if size <= PLAIN_BYTES:
                rows = max(1, count)
            dataset = _create(file, column.path, (count, *column.row), np.dtype("<f8"), (rows, *column.row))
            for start, stop in row_ranges(count, rows):
                values = source.read(column.path, start, stop)
                validate_values(values, column, where, start)
                if size:
                    dataset[start:stop] = values
                sink.refuse()
            _describe(dataset, column.units, column.description)
            if column.key is not None:
                put_text(dataset, "key", json.dumps(astuple(column.key)))


def head_of(net: Net, bodies: Mapping[str, BodyConstants], run: RunRecord) -> bytes:
    """Return a result file without rows, for a run that goes on; raises InputError as `save`."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver=HDF5_VERSIONS) as file:
        _put_head(file, "the run", net, bodies, run)
    return stream.getvalue()


def _where(path: str | Path) -> str:
    return f"the result for {path}"


class _ResultRows:
    """The arrays of a Result as rows; raises InputError, which begins with `where`, if they do not fit."""

    def __init__(self, result: Result, bodies: Mapping[str, BodyConstants], where: str) -> None:
        arrays: dict[str, Any] = {path: getattr(result, name) for name, path in PATHS.items()}
        for name in bodies:
            for quantity in BODY_QUANTITIES:
                arrays[body_path(name, quantity)] = getattr(result.bodies[name], quantity)
        of_terms = {
            state_column(key, states.values.shape[1], states.units): states.values
            for key, states in (*result.states.items(), *result.contacts.items())
        }
        arrays |= {column.path: values for column, values in of_terms.items()}
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


def _put_head(
    file: h5py.File, where: str, net: Net, bodies: Mapping[str, BodyConstants], run: RunRecord
) -> None:
    """Write all but the rows."""
    try:
        record = run.to_json()
    except ValueError as error:
        raise InputError(f"{where}: the record cannot be written as JSON: {error}") from error
    put_text(file, "kind", FILE_KIND)
    file.attrs["format"] = FILE_FORMAT
    put_text(file, "run", record)
    for name, values in _net_arrays(net, where).items():
        put(file, f"{NET_GROUP}/{name}", values, _NET[name].units, _NET[name].description)
    for name, body in bodies.items():
        put(file, body_path(name, "mass"), np.array([body.mass], dtype="<f8"), "kg", "mass")
        for constant, values in body.arrays().items():
            kind = CONSTANTS[constant]
            put(file, body_path(name, constant), np.asarray(values, kind.dtype), kind.units, kind.description)


def put(file: h5py.File, path: str, values: NDArray[Any], units: str, description: str) -> None:
    """Write a dataset that is no larger than a state or two, in one chunk."""
    dataset = _create(file, path, values.shape, values.dtype, values.shape)
    if values.size:
        dataset[...] = values
    _describe(dataset, units, description)


def _create(
    file: h5py.File, path: str, shape: tuple[int, ...], dtype: np.dtype[Any], chunks: tuple[int, ...]
) -> h5py.Dataset:
    """Make an empty dataset with checksums, compressed if it is large."""
    options: dict[str, Any] = {}
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    if size:
        options = {"fletcher32": True, "chunks": chunks}
    if size > PLAIN_BYTES:
        options |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    return file.create_dataset(path, shape=shape, dtype=dtype, track_times=False, **options)


def _describe(dataset: h5py.Dataset, units: str, description: str) -> None:
    put_text(dataset, "units", units)
    put_text(dataset, "description", description)


def put_text(owner: h5py.Group | h5py.Dataset, name: str, text: str) -> None:
    """Write an attribute of fixed length: under a checksum with the others, unlike one of variable length."""
    import h5py

    code = text.encode("utf-8", "replace")
    owner.attrs.create(name, code, dtype=h5py.string_dtype("utf-8", max(1, len(code))))


class _Sink(io.FileIO):
    """A file for HDF5 to write to that raises no error: inside HDF5 a full disk ends the process.

    error : the first one, after which nothing more is written
    """

    error: OSError | None = None

    def refuse(self) -> None:
        """Raise the first error, if there was one."""
        if self.error is not None:
            raise self.error

    def write(self, data: Any) -> int:
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while self.error is None and len(rest):
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None) -> int:
        try:
            if self.error is None:
                return super().truncate(size)
        except OSError as error:
            self.error = error
        return size or 0


@contextmanager
def new_file(path: str | Path) -> Iterator[tuple[h5py.File, _Sink]]:
    """Open an HDF5 file that takes the place of `path` at the end; a failure to write is an InputError."""
    import h5py

    with replacing(path) as part, _Sink(part, "r+") as sink:
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


# --- reading


def load_result(path: str | Path) -> Result:
    """Read the Result in a file that `save` wrote, or in the folder of a run; the same values, bit for bit.

    A folder is read for its result.h5, or else for the states of an unfinished run (see `open_unfinished`).
    A ensemble.h5 beside a result.h5 is its `ensemble_file`, which figures show.
    Large arrays stay in the file, see `Result`. Raises InputError, one line, if there is no such file or it
    is not a whole result file of this format.
    """
    path = path_of(path, "load_result")
    if path.is_dir():
        whole = path / RESULT_FILE
        return load_result(whole) if whole.is_file() else open_unfinished(path)
    refuse_unreadable(path)
    with damage(path):
        file = open_to_read(path)
        stays_open = False
        try:
            kind = _text(file.attrs.get("kind"))
            if kind == ENSEMBLE_KIND:
                _refuse(path, f"it has the runs of an ensemble, or the perturbed runs beside a {RESULT_FILE}")
            if kind != FILE_KIND:
                _refuse(path, "an HDF5 file of some other program")
            if (found := int(file.attrs["format"])) != FILE_FORMAT:
                _refuse(path, f"its format is {found}, this exunet reads format {FILE_FORMAT}")
            result = _read(file, path)
            stays_open = isinstance(result.position, StoredRows)
        finally:
            if not stays_open:
                file.close()
        beside = path.with_name(ENSEMBLE_FILE)
        is_run = path.name == RESULT_FILE and beside.is_file()
        return replace(result, ensemble_file=beside) if is_run else result


def open_unfinished(folder: str | Path) -> Result:
    """Read the states that a run has stored, during the run or after it was killed: an incomplete Result.

    Raises InputError without any, or if the file is damaged.
    """
    path = Path(folder) / STORE_FILE
    if not path.is_file():
        raise InputError(f"{folder}: neither a {RESULT_FILE} nor the states of an unfinished run are there")
    store = FileStore(path, read_only=True)
    if len(store) == 0:
        raise InputError(f"{folder}: the unfinished run has not stored a state yet")
    with damage(path):
        import h5py

        with h5py.File(io.BytesIO(store.head), "r") as file:
            net, bodies, run = _head(file, str(path))
    end = float(store.read("time", len(store) - 1, len(store))[0])
    verdict = f"unfinished: {len(store)} states until t = {end:.6g} s were stored"
    return result_of_rows(store, net, bodies, replace(run, verdict=verdict), str(path))


def result_of_rows(
    source: RowSource,
    net: Net,
    bodies: Mapping[str, BodyConstants],
    run: RunRecord,
    where: str,
) -> Result:
    """Return the Result of the rows in `source`, each value checked when it is read.

    Columns of up to 64 MB in all are read at once, and those in memory are used as they are. Of larger ones
    all but the times become `StoredRows`, which read from `source`; it must not change then.

    Raises InputError, which begins with `where`, if a column is absent or has another shape, if a value is
    NaN or infinite, if the times do not increase, or if a node that is fixed to a body is not there.
    """
    for name, body in bodies.items():
        if body.nodes is not None and np.any((body.nodes < 0) | (body.nodes >= net.n_nodes)):
            raise InputError(f"{where}: a node is fixed to body {name} that the net does not have")
    there = {column.path: column for column in source.columns}
    size = len(source) * sum(column.row_bytes for column in source.columns)
    at_once = isinstance(source, MemoryStore) or size <= IN_MEMORY
    found: dict[str, Any] = {}
    of_terms = [column for column in source.columns if column.path.startswith(STATES)]
    for column in (*declare(net.n_nodes, net.n_elements, bodies), *of_terms):
        if column.path not in there:
            if column.path not in _OPTIONAL_PATHS:
                raise InputError(f"{where}: damaged or cut short (there is no {column.path})")
            continue
        if there[column.path].row != column.row:
            shape = (len(source), *there[column.path].row)
            raise InputError(f"{where}: {column.path} has shape {shape}, unlike the other arrays")
        values = _stored(source, column, where)
        found[column.path] = np.asarray(values) if at_once or column.path == "time" else values
    validate_times(found["time"], where)
    series = {column: TermStates(column.units, found[column.path]) for column in of_terms}
    return Result(
        net=net,
        **{name: found[path] for name, path in PATHS.items() if path in found},
        run=run,
        bodies={name: _body(found, name, body) for name, body in bodies.items()},
        states={c.path[len(STATES) :]: series[c] for c in of_terms if c.key is None},
        contacts={c.key: series[c] for c in of_terms if c.key is not None},
    )


_OPTIONAL_PATHS = {PATHS[name] for name in OPTIONAL}


def _stored(source: RowSource, column: Column, where: str) -> StoredRows:
    """Return a column as an array that is read, and checked, when it is used."""

    def read(start: int, stop: int) -> Floats:
        values = source.read(column.path, start, stop)
        validate_values(values, column, where, start)
        return values

    return StoredRows(read, (len(source), *column.row))


def _body(found: Mapping[str, Any], name: str, body: BodyConstants) -> BodyStates:
    states = {quantity: found[body_path(name, quantity)] for quantity in BODY_QUANTITIES}
    constants = {constant: getattr(body, constant) for constant in CONSTANTS}
    return BodyStates(body.mass, **constants, **states)


def validate_values(values: Floats, column: Column, where: str, first: int = 0) -> None:
    """Raise InputError if rows of a column, the first of which has this number, contain NaN or infinity."""
    if not np.all(np.isfinite(values)):
        row, *others = (int(k) for k in np.argwhere(~np.isfinite(values))[0])
        at = [first + row, *others]
        raise UnsoundStates(f"{where}: {column.path} contains NaN or infinity (first at {at})")


def validate_times(time: Floats, where: str) -> None:
    """Raise InputError unless there are stored times, and they increase."""
    if len(time) == 0 or np.any(np.diff(time) <= 0):
        raise UnsoundStates(f"{where}: the stored times must be at least one, and increase")


class _FileRows:
    """The columns of an open result file; HDF5 closes it after the last reference."""

    def __init__(self, file: h5py.File, path: str | Path, declared: tuple[Column, ...]) -> None:
        self._file, self._path = file, path
        self._count = len(file["time"])
        shapes = {column.path: file[column.path].shape for column in declared if column.path in file}
        for name, shape in shapes.items():
            if shape[:1] != (self._count,):
                raise InputError(f"{path}: {name} has shape {shape}, unlike the other arrays")
        there = (column for column in declared if column.path in shapes)
        self.columns = tuple(replace(column, row=shapes[column.path][1:]) for column in there)

    def __len__(self) -> int:
        return self._count

    def read(self, path: str, start: int, stop: int) -> Floats:
        with damage(self._path):
            return np.asarray(self._file[path][start:stop], dtype=np.float64)


def _head(file: h5py.File, where: str) -> tuple[Net, dict[str, BodyConstants], RunRecord]:
    """Return the net, what does not change of the bodies, and the record of the run."""
    group = file[NET_GROUP]
    optional = ("strength", *_LAW, *(name for name in _NET if name.startswith("tether")))
    if lacks := [name for name in _NET if name not in group and name not in optional]:
        raise InputError(f"{where}: damaged or cut short (the net has no {lacks[0]})")
    net = _net_of({name: _native(group[name][()], _NET[name].dtype) for name in _NET if name in group}, where)
    bodies = {name: _constants(body) for name, body in file["bodies"].items()} if "bodies" in file else {}
    return net, bodies, RunRecord.from_json(_text(file.attrs["run"]))


def _read(file: h5py.File, path: str | Path) -> Result:
    net, bodies, run = _head(file, str(path))
    source = _FileRows(file, path, (*declare(net.n_nodes, net.n_elements, bodies), *_of_terms(file)))
    return result_of_rows(source, net, bodies, run, str(path))


def _of_terms(file: h5py.File) -> Iterator[Column]:
    """Yield the columns of the states of forces."""
    for term, group in sorted(file["states"].items() if "states" in file else ()):
        for quantity, dataset in sorted(group.items()):
            key = dataset.attrs.get("key")
            name = f"{term}/{quantity}" if key is None else ContactKey(*json.loads(_text(key)))
            yield state_column(name, dataset.shape[1], _text(dataset.attrs["units"]))


def _constants(group: h5py.Group) -> BodyConstants:
    there = ((name, kind.dtype) for name, kind in CONSTANTS.items() if name in group)
    arrays = {name: _native(group[name][()], dtype) for name, dtype in there}
    return body_constants(float(group["mass"][0]), arrays)


def _native(values: NDArray[Any], dtype: str) -> NDArray[Any]:
    return np.asarray(values, dtype=np.dtype(dtype).newbyteorder("="))


def _text(stored: Any) -> str:
    return stored.decode("utf-8") if isinstance(stored, bytes) else str(stored)


@contextmanager
def damage(path: str | Path) -> Iterator[None]:
    """Turn whatever HDF5 raises into an InputError; Ctrl-C waits, since h5py's destructors would lose it."""
    try:
        with postponed():
            yield
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file can make h5py raise anything
        _refuse(path, f"damaged or cut short ({' '.join(str(error).split())})", error)


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


def refuse_unreadable(path: str | Path) -> None:
    """Raise InputError if a file cannot be read, or is not HDF5."""
    try:
        with Path(path).open("rb") as stream:
            start = stream.read(8)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if start != b"\x89HDF\r\n\x1a\n":
        _refuse(path, "it is not an HDF5 file")


def _refuse(path: str | Path, reason: str, cause: Exception | None = None) -> NoReturn:
    raise InputError(f"{path}: not a result file of exunet: {reason}") from cause

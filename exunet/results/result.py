"""The result of a run: arrays over the stored times, provenance, and the HDF5 file that keeps them."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.base.files import replacing
from exunet.net.arrays import Net

if TYPE_CHECKING:
    import h5py

Floats = NDArray[np.float64]

FILE_KIND = "exunet result"
FILE_FORMAT = 1
HDF5_VERSIONS = ("v110", "v110")  # every reader since 2016; the first form with checksums on all metadata


@dataclass(frozen=True)
class Result:
    """States and energies of a net over the stored times.

    net              : the net in its reference configuration
    time             : (n_times,) [s]
    position         : (n_times, n_nodes, 3) [m]
    velocity         : (n_times, n_nodes, 3) [m/s]
    strain           : (n_times, n_elements) Green-Lagrange strain E11, eq. (6); negative when slack
    tension          : (n_times, n_elements) axial force [N], zero when slack
    kinetic          : (n_times,) [J], eq. (18)
    elastic          : (n_times,) [J], eq. (19)
    potential        : (n_times,) [J], of constant loads such as gravity
    dissipated       : (n_times,) [J], work done by damping since t = 0
    momentum         : (n_times, 3) [kg m/s]
    angular_momentum : (n_times, 3) [kg m2/s], about the origin
    complete         : False if the run stopped before its end
    verdict          : "ok", or why it stopped
    provenance       : case text, versions, method, counts, wall times (JSON-like)
    largest_elastic  : (n_times,) [J], largest over all steps since the stored time before, which counts too;
                       None in older files
    least_kinetic    : (n_times,) [J], the same for the least kinetic energy
    """

    net: Net
    time: Floats
    position: Floats
    velocity: Floats
    strain: Floats
    tension: Floats
    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats
    momentum: Floats
    angular_momentum: Floats
    complete: bool
    verdict: str
    provenance: dict[str, Any] = field(default_factory=dict)
    largest_elastic: Floats | None = None
    least_kinetic: Floats | None = None


@dataclass(frozen=True)
class _Column:
    """How one array is kept in the file; letters of `shape` are sizes that arrays share, digits are fixed."""

    shape: str
    units: str
    description: str
    dtype: str = "<f8"


_STATES = {
    "time": _Column("t", "s", "stored times"),
    "position": _Column("tn3", "m", "node positions"),
    "velocity": _Column("tn3", "m/s", "node velocities"),
    "strain": _Column("te", "1", "Green-Lagrange strain of each element, negative when slack"),
    "tension": _Column("te", "N", "axial force in each element, zero when slack"),
    "kinetic": _Column("t", "J", "kinetic energy"),
    "elastic": _Column("t", "J", "elastic energy of the cables"),
    "potential": _Column("t", "J", "potential energy of constant loads"),
    "dissipated": _Column("t", "J", "work done by damping since the start"),
    "momentum": _Column("t3", "kg m/s", "linear momentum"),
    "angular_momentum": _Column("t3", "kg m2/s", "angular momentum about the origin"),
}

# Of runs only, and not in older files.
_BETWEEN = {
    "largest_elastic": _Column("t", "J", "largest elastic energy of the steps since the stored time before"),
    "least_kinetic": _Column("t", "J", "least kinetic energy of the steps since the stored time before"),
}

_NET = {
    "reference_position": _Column("n3", "m", "node positions in the undeformed reference configuration"),
    "mass": _Column("n", "kg", "lumped mass of each node, bullets included"),
    "element_nodes": _Column("e2", "1", "nodes at the ends of each element, from 0", "<i8"),
    "reference_length": _Column("e", "m", "undeformed length of each element"),
    "area": _Column("e", "m2", "undeformed cross-section area of each element"),
    "youngs_modulus": _Column("e", "Pa", "Young's modulus of each element"),
    "density": _Column("e", "kg/m3", "mass density of each element"),
    "is_string": _Column("e", "1", "true for the elements of corner strings", "|b1"),
    "bullet_nodes": _Column("b", "1", "nodes that carry a bullet", "<i8"),
    "fixed_nodes": _Column("f", "1", "nodes that are held still", "<i8"),
}

_RAGGED = {
    "face": "loops of nodes round the mesh openings",
    "mouth": "loop of corner nodes round the net's mouth",
}


def save(result: Result, path: str | Path) -> None:
    """Write `result` to an HDF5 file; the same result gives the same bytes.

    The file appears whole or not at all; an older file of that name is replaced. Raises InputError, and
    writes nothing, if an array has a value that is not finite or a shape that does not fit, if the stored
    times do not increase, if the provenance is not JSON-like, or if the file cannot be written.
    """
    import h5py

    checked = _checked(result, f"the result for {path}")
    try:
        provenance = json.dumps(result.provenance, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"the result for {path}: provenance cannot be written as JSON: {error}") from error
    with h5py.File(str(path), "w", driver="core", backing_store=False, libver=HDF5_VERSIONS) as file:
        _put_text(file, "kind", FILE_KIND)
        file.attrs["format"] = FILE_FORMAT
        file.attrs["complete"] = bool(result.complete)
        _put_text(file, "verdict", result.verdict)
        _put_text(file, "provenance", provenance)
        for name, column in (_STATES | _BETWEEN).items():
            if name in checked:
                _put(file, name, checked[name], column.units, column.description)
        group = file.create_group("net")
        for name, column in _NET.items():
            _put(group, name, checked["net." + name], column.units, column.description)
        for name, description in _RAGGED.items():
            values, offsets = _ragged(result.net.faces if name == "face" else _as_loops(result.net.mouth))
            _put(group, f"{name}_values", values, "1", f"{description}, one after another")
            where = f"loop k is {name}_values[offsets[k]:offsets[k + 1]]"
            _put(group, f"{name}_offsets", offsets, "1", where)
        file.flush()
        image = file.id.get_file_image()
    # Written as plain bytes: a full disk is then an ordinary error; inside HDF5 it brings the process down.
    with replacing(path) as part:
        part.write_bytes(image)


def load_result(path: str | Path) -> Result:
    """The Result kept in a file that `save` wrote; the same values, bit for bit.

    Raises InputError, one line, if there is no such file or it is not a whole result file of a known format.
    """
    import h5py

    _refuse_unreadable(path)
    try:
        with h5py.File(path, "r") as file:
            _refuse_other_formats(file, path)
            result = _read(file)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file can make h5py raise anything
        _refuse(path, f"damaged or cut short ({' '.join(str(error).split())})", error)
    _checked(result, str(path))
    return result


def _read(file: h5py.File) -> Result:
    states = {name: _get(file, name, column) for name, column in _STATES.items()}
    states |= {name: _get(file, name, column) for name, column in _BETWEEN.items() if name in file}
    group = file["net"]
    arrays = {name: _get(group, name, column) for name, column in _NET.items()}
    for values in arrays.values():
        values.setflags(write=False)
    faces, mouths = (_loops(group[f"{name}_values"][()], group[f"{name}_offsets"][()]) for name in _RAGGED)
    provenance = json.loads(_text(file.attrs["provenance"]))
    if not isinstance(provenance, dict):
        raise ValueError("provenance is not a JSON object")
    return Result(
        net=Net(**arrays, faces=faces, mouth=mouths[0] if mouths else ()),
        **states,
        complete=bool(file.attrs["complete"]),
        verdict=_text(file.attrs["verdict"]),
        provenance=provenance,
    )


def _put(group: h5py.Group, name: str, values: NDArray[Any], units: str, description: str) -> None:
    """One dataset with checksums; large arrays are compressed, which costs 12 ms for each MB."""
    kept: dict[str, Any] = {"fletcher32": True} if values.size else {}
    if values.nbytes > 1 << 16:
        kept |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    elif values.size:
        kept["chunks"] = values.shape
    dataset = group.create_dataset(name, data=values, track_times=False, **kept)
    _put_text(dataset, "units", units)
    _put_text(dataset, "description", description)


def _put_text(owner: h5py.Group | h5py.Dataset, name: str, text: str) -> None:
    """An attribute of fixed length: kept with the others under a checksum, unlike text of variable length."""
    import h5py

    code = text.encode("utf-8", "replace")
    owner.attrs.create(name, code, dtype=h5py.string_dtype("utf-8", max(1, len(code))))


def _text(stored: Any) -> str:
    return stored.decode("utf-8") if isinstance(stored, bytes) else str(stored)


def _get(group: h5py.Group, name: str, column: _Column) -> NDArray[Any]:
    return np.asarray(group[name][()], dtype=np.dtype(column.dtype).newbyteorder("="))


def _ragged(loops: tuple[tuple[int, ...], ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    values = np.array([node for loop in loops for node in loop], dtype="<i8")
    offsets = np.cumsum([0, *map(len, loops)], dtype="<i8")
    return values, offsets


def _as_loops(mouth: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    return (mouth,) if mouth else ()


def _loops(values: NDArray[np.int64], offsets: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    if offsets[0] != 0 or offsets[-1] != len(values) or np.any(np.diff(offsets) < 0):
        raise ValueError("loops of nodes with wrong offsets")
    nodes = values.tolist()
    bounds = offsets.tolist()
    return tuple(tuple(nodes[a:b]) for a, b in itertools.pairwise(bounds))


def _checked(result: Result, where: str) -> dict[str, NDArray[Any]]:
    """The arrays in the types of the file, by name; raises InputError at the first that is not in order."""
    sizes: dict[str, int] = {"2": 2, "3": 3}
    arrays: dict[str, NDArray[Any]] = {}
    found = [("net." + name, getattr(result.net, name), column) for name, column in _NET.items()]
    found += [(name, getattr(result, name), column) for name, column in _STATES.items()]
    between = [(name, getattr(result, name), column) for name, column in _BETWEEN.items()]
    found += [one for one in between if one[1] is not None]
    for label, value, column in found:
        values = np.ascontiguousarray(value, dtype=column.dtype)
        fits = values.ndim == len(column.shape) and all(
            sizes.setdefault(axis, n) == n for axis, n in zip(column.shape, values.shape, strict=True)
        )
        if not fits:
            raise InputError(f"{where}: {label} has shape {values.shape}, unlike the other arrays")
        if not np.all(np.isfinite(values)):
            raise InputError(f"{where}: {label} is not finite everywhere (first at {_first_bad(values)})")
        arrays[label] = values
    if sizes["t"] == 0 or np.any(np.diff(arrays["time"]) <= 0):
        raise InputError(f"{where}: the stored times must be at least one, and increase")
    _check_nodes(result.net, arrays, where)
    return arrays


def _first_bad(values: NDArray[Any]) -> str:
    return str([int(k) for k in np.argwhere(~np.isfinite(values))[0]])


def _check_nodes(net: Net, arrays: dict[str, NDArray[Any]], where: str) -> None:
    loops, _ = _ragged((*net.faces, net.mouth))
    for name in ("element_nodes", "bullet_nodes", "fixed_nodes"):
        loops = np.concatenate([loops, arrays["net." + name].ravel()])
    if np.any(loops < 0) or np.any(loops >= net.n_nodes):
        raise InputError(f"{where}: the net refers to a node that it does not have")


def _refuse_unreadable(path: str | Path) -> None:
    try:
        with Path(path).open("rb") as stream:
            start = stream.read(8)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if start != b"\x89HDF\r\n\x1a\n":
        _refuse(path, "it is not an HDF5 file")


def _refuse_other_formats(file: h5py.File, path: str | Path) -> None:
    if _text(file.attrs.get("kind")) != FILE_KIND:
        _refuse(path, "an HDF5 file of some other program")
    found = int(file.attrs["format"])
    if found != FILE_FORMAT:
        newer = "; a newer exunet wrote it" if found > FILE_FORMAT else ""
        _refuse(path, f"its format is {found}, this exunet reads format {FILE_FORMAT}{newer}")


def _refuse(path: str | Path, reason: str, cause: Exception | None = None) -> NoReturn:
    raise InputError(f"{path}: not a result file of exunet: {reason}") from cause

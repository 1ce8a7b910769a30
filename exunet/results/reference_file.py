"""Reads the .npz files of reference_impl; nothing in them is taken on trust."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError

FORMAT = 1

# Arrays that are read, with their shapes: letters are sizes that arrays share, digits are fixed.
_NUMBERS = {
    "t": "t",
    "position": "tn3",
    "velocity": "tn3",
    "reference_position": "n3",
    "mass": "n",
    "reference_length": "e",
    "area": "e",
    "youngs_modulus": "e",
}
_NODES = {"element_nodes": "e2", "bullet_nodes": "b", "fixed_nodes": "f"}
_SINGLE = ("format", "complete")


def read_reference(path: str | Path) -> dict[str, NDArray[Any]]:
    """The arrays of a run and of its net by name, as reference_impl's README lists them.

    All are finite and have shapes that fit together; times increase, node numbers are those of nodes. Raises
    InputError, one line, if there is no such file or one of these is not so.
    """
    arrays = _load(path)
    number, complete = (_single(path, name, arrays[name]) for name in _SINGLE)
    if number != FORMAT:
        raise InputError(f"{path}: its format is {number}, this exunet reads format {FORMAT}")
    sizes: dict[str, int] = {"2": 2, "3": 3}
    checked: dict[str, NDArray[Any]] = {"complete": np.array(bool(complete))}
    for name, shape in (_NUMBERS | _NODES).items():
        values = arrays[name]
        if values.dtype.kind not in ("iu" if name in _NODES else "fiu"):
            raise InputError(f"{path}: {name} holds {values.dtype}, not {_wanted(name)}")
        if values.ndim != len(shape) or any(
            sizes.setdefault(axis, n) != n for axis, n in zip(shape, values.shape, strict=True)
        ):
            raise InputError(f"{path}: {name} has shape {values.shape}, unlike the other arrays")
        if name in _NUMBERS and not np.isfinite(values).all():
            where = [int(k) for k in np.argwhere(~np.isfinite(values))[0]]
            raise InputError(f"{path}: {name} contains NaN or infinity (first at {where})")
        if name in _NODES and np.any((values < 0) | (values >= sizes["n"])):
            raise InputError(f"{path}: {name} refers to a node that the net does not have")
        checked[name] = values.astype(np.int64 if name in _NODES else np.float64)
    if sizes["n"] == 0:
        raise InputError(f"{path}: a net without nodes")
    if sizes["t"] == 0 or np.any(np.diff(checked["t"]) <= 0.0):
        raise InputError(f"{path}: the stored times must be at least one, and increase")
    return checked


def _load(path: str | Path) -> dict[str, NDArray[Any]]:
    try:
        # NumPy takes a file that is no archive for a pickle, and advises on that.
        with Path(path).open("rb") as stream:
            if stream.read(4) not in (b"PK\x03\x04", b"PK\x05\x06"):
                raise InputError(f"{path}: not a readable .npz file: it is not an archive")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                missing = [name for name in (*_NUMBERS, *_NODES, *_SINGLE) if name not in file.files]
                if missing:
                    raise InputError(f"{path}: not a file of reference_impl: it has no array {missing[0]}")
                return {name: _array(path, file, name) for name in (*_NUMBERS, *_NODES, *_SINGLE)}
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # a damaged archive can make zipfile and NumPy raise anything
        raise InputError(f"{path}: damaged or cut short ({' '.join(str(error).split())})") from error


def _array(path: str | Path, file: Any, name: str) -> NDArray[Any]:
    try:
        return np.asarray(file[name])
    except ValueError as error:
        if "pickle" in str(error).lower():
            raise InputError(f"{path}: {name} holds objects, not {_wanted(name)}") from error
        raise


def _single(path: str | Path, name: str, value: NDArray[Any]) -> Any:
    if value.shape != () or value.dtype.kind not in "biu":
        raise InputError(f"{path}: {name} is not a single {_wanted(name)}")
    return value[()]


def _wanted(name: str) -> str:
    return {"format": "whole number", "complete": "truth value"}.get(
        name, "node numbers" if name in _NODES else "real numbers"
    )

"""Reads the .npz files of reference_impl; nothing in them is taken on trust."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from exunet.base.errors import InputError
from exunet.results.result import BodyStates

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
# Of bodies beside the net and of what broke; files of earlier versions have none of these.
_BESIDE = {
    "body_mass": "k",
    "body_inertia": "k3",
    "body_products_of_inertia": "k3",
    "body_position": "tk3",
    "body_velocity": "tk3",
    "body_attitude": "tk33",
    "body_angular_velocity": "tk3",
    "break_time": "q",
}
_ELEMENTS = {"break_element": "q"}
_NAMES = {"body_names": "k"}


def read_reference(path: str | Path) -> dict[str, NDArray[Any]]:
    """The arrays of a run, its net and its bodies by name, as reference_impl's README lists them.

    Those of bodies and breaks are left out where the file has none of them. All are finite and have shapes
    that fit together; times increase, numbers are those of nodes and elements. Raises InputError, one line,
    if there is no such file or one of these is not so.
    """
    arrays = _load(path)
    number, complete = (_single(path, name, arrays[name]) for name in _SINGLE)
    if number != FORMAT:
        raise InputError(f"{path}: its format is {number}, this exunet reads format {FORMAT}")
    sizes: dict[str, int] = {"2": 2, "3": 3}
    checked: dict[str, NDArray[Any]] = {"complete": np.array(bool(complete))}
    for name, shape in (_NUMBERS | _NODES | _BESIDE | _ELEMENTS | _NAMES).items():
        if name not in arrays:
            continue
        values = arrays[name]
        if values.dtype.kind not in _kinds(name):
            raise InputError(f"{path}: {name} holds {values.dtype}, not {_wanted(name)}")
        if values.ndim != len(shape) or any(
            sizes.setdefault(axis, n) != n for axis, n in zip(shape, values.shape, strict=True)
        ):
            raise InputError(f"{path}: {name} has shape {values.shape}, unlike the other arrays")
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            where = [int(k) for k in np.argwhere(~np.isfinite(values))[0]]
            raise InputError(f"{path}: {name} contains NaN or infinity (first at {where})")
        if name in _NODES and np.any((values < 0) | (values >= sizes["n"])):
            raise InputError(f"{path}: {name} refers to a node that the net does not have")
        if name in _ELEMENTS and np.any((values < 0) | (values >= sizes["e"])):
            raise InputError(f"{path}: {name} refers to an element that the net does not have")
        checked[name] = values.astype(_TYPES.get(_kinds(name), np.float64))
    if sizes["n"] == 0:
        raise InputError(f"{path}: a net without nodes")
    if sizes["t"] == 0 or np.any(np.diff(checked["t"]) <= 0.0):
        raise InputError(f"{path}: the stored times must be at least one, and increase")
    return checked


def reference_bodies(arrays: Mapping[str, NDArray[Any]]) -> dict[str, BodyStates]:
    """The bodies in what `read_reference` gives, by name; attitudes as quaternions."""
    found = {}
    for k, name in enumerate(arrays.get("body_names", np.zeros(0, dtype=np.str_)).tolist()):
        inertia = np.diag(arrays["body_inertia"][k])
        rigid = bool((np.diag(inertia) > 0.0).all())
        if "body_products_of_inertia" in arrays:  # Jxy, Jxz, Jyz
            upper = np.triu_indices(3, 1)
            inertia[upper] = inertia.T[upper] = arrays["body_products_of_inertia"][k]
        turned = Rotation.from_matrix(arrays["body_attitude"][:, k]).as_quat(scalar_first=True)
        found[name] = BodyStates(
            float(arrays["body_mass"][k]),
            inertia if rigid else None,
            arrays["body_position"][:, k],
            arrays["body_velocity"][:, k],
            turned if rigid else None,
            arrays["body_angular_velocity"][:, k] if rigid else None,
        )
    return found


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
                beside = (*_BESIDE, *_ELEMENTS, *_NAMES)
                if missing := [name for name in beside if name not in file.files]:
                    if len(missing) < len(beside):
                        raise InputError(f"{path}: it has bodies or breaks, but no array {missing[0]}")
                    beside = ()
                names = (*_NUMBERS, *_NODES, *_SINGLE, *beside)
                return {name: _array(path, file, name) for name in names}
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


_TYPES: dict[str, type] = {"iu": np.int64, "U": np.str_}


def _kinds(name: str) -> str:
    """Kinds of NumPy types that an array may have."""
    return "U" if name in _NAMES else "iu" if name in (*_NODES, *_ELEMENTS) else "fiu"


def _wanted(name: str) -> str:
    words = {"format": "whole number", "complete": "truth value", "break_element": "element numbers"}
    words |= dict.fromkeys(_NODES, "node numbers") | dict.fromkeys(_NAMES, "text")
    return words.get(name, "real numbers")

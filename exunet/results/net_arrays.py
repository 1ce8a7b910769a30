"""A net as named arrays, for files: what each array is, how loops of nodes are kept, and what is refused."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.net.arrays import Net, Tether

Ints = NDArray[np.int64]
Loops = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class NetArray:
    """One array of a net: letters of `shape` are sizes that arrays share, digits are fixed."""

    shape: str
    units: str
    description: str
    dtype: str = "<f8"


_PLAIN = {
    "reference_position": NetArray("n3", "m", "node positions in the undeformed reference configuration"),
    "mass": NetArray("n", "kg", "lumped mass of each node, bullets included"),
    "element_nodes": NetArray("e2", "1", "nodes at the ends of each element, from 0", "<i8"),
    "reference_length": NetArray("e", "m", "undeformed length of each element"),
    "area": NetArray("e", "m2", "undeformed cross-section area of each element"),
    "youngs_modulus": NetArray("e", "Pa", "Young's modulus of each element"),
    "density": NetArray("e", "kg/m3", "mass density of each element"),
    "is_string": NetArray("e", "1", "true for the elements of corner strings", "|b1"),
    "bullet_nodes": NetArray("b", "1", "nodes that carry a bullet", "<i8"),
    "fixed_nodes": NetArray("f", "1", "nodes that are held still", "<i8"),
}
OF_TETHERS = {
    "tether_first": NetArray("t", "1", "from where on the nodes of each tether are its own", "<i8"),
    "tether_names": NetArray("q", "1", "names of the tethers, a line each, in bytes of UTF-8", "|u1"),
    "tether_values": NetArray("x", "1", "nodes along the tethers, one after another", "<i8"),
    "tether_offsets": NetArray("y", "1", "tether k is tether_values[offsets[k]:offsets[k + 1]]", "<i8"),
}
OF_STRENGTH = {
    "strength": NetArray("e", "N", "specified axial strength of each element; 0: not known"),
}
OPTIONAL = frozenset({*OF_TETHERS, *OF_STRENGTH})  # of nets that have such
_FACES = "loops of nodes round the mesh openings, one after another"
_MOUTH = "loop of corner nodes round the net's mouth, one after another"
NET_ARRAYS = _PLAIN | {
    "face_values": NetArray("v", "1", _FACES, "<i8"),
    "face_offsets": NetArray("o", "1", "loop k is face_values[offsets[k]:offsets[k + 1]]", "<i8"),
    "mouth_values": NetArray("w", "1", _MOUTH, "<i8"),
    "mouth_offsets": NetArray("p", "1", "loop k is mouth_values[offsets[k]:offsets[k + 1]]", "<i8"),
    **OF_TETHERS,
    **OF_STRENGTH,
}
_LOOPS = ("face", "mouth", "tether")


def to_arrays(net: Net, where: str) -> dict[str, NDArray[Any]]:
    """The arrays of NET_ARRAYS, those of tethers and of strengths if there are any.

    Raises InputError, which begins with `where`, if one is not in order.
    """
    arrays = {
        name: np.asarray(getattr(net, name), dtype=kind.dtype, order="C") for name, kind in _PLAIN.items()
    }
    mouths, chains = (net.mouth,) if net.mouth else (), tuple(one.nodes for one in net.tethers)
    for name, loops in zip(_LOOPS, (net.faces, mouths, chains), strict=True):
        arrays[f"{name}_values"] = np.array([node for loop in loops for node in loop], dtype="<i8")
        arrays[f"{name}_offsets"] = np.cumsum([0, *map(len, loops)], dtype="<i8")
    names = "\n".join(one.name for one in net.tethers)
    arrays["tether_names"] = np.frombuffer(names.encode(), dtype="|u1")
    arrays["tether_first"] = np.array([one.first for one in net.tethers], dtype="<i8")
    if net.strength is not None:
        arrays["strength"] = np.asarray(net.strength, dtype="<f8", order="C")
    _check(arrays, where)
    return {name: values for name, values in arrays.items() if net.tethers or name not in OF_TETHERS}


def from_arrays(arrays: Mapping[str, NDArray[Any]], where: str) -> Net:
    """The net that `to_arrays` was given; raises InputError, which begins with `where`, as that does."""
    arrays = _no_tethers() | dict(arrays)  # files from before there were any
    for name in NET_ARRAYS:
        if name not in arrays and name not in OPTIONAL:
            raise InputError(f"{where}: damaged or cut short (the net has no {name})")
    _check(arrays, where)
    plain = {name: np.asarray(arrays[name]) for name in (*_PLAIN, *OF_STRENGTH) if name in arrays}
    for values in plain.values():
        values.setflags(write=False)
    faces, mouths, chains = (_loops(arrays[f"{name}_values"], arrays[f"{name}_offsets"]) for name in _LOOPS)
    return Net(
        **plain, faces=faces, mouth=mouths[0] if mouths else (), tethers=_tethers(arrays, chains, where)
    )


def _no_tethers() -> dict[str, NDArray[Any]]:
    none = {name: np.zeros(0, dtype=kind.dtype) for name, kind in OF_TETHERS.items()}
    return none | {"tether_offsets": np.zeros(1, dtype="<i8")}


def _tethers(arrays: Mapping[str, NDArray[Any]], chains: Loops, where: str) -> tuple[Tether, ...]:
    text = bytes(np.asarray(arrays["tether_names"])).decode(errors="replace")
    names, first = text.split("\n") if chains else [], np.asarray(arrays["tether_first"]).tolist()
    if not len(names) == len(first) == len(chains):
        raise InputError(f"{where}: damaged or cut short (tethers without names)")
    return tuple(Tether(*one) for one in zip(names, first, chains, strict=True))


def _check(arrays: Mapping[str, NDArray[Any]], where: str) -> None:
    sizes = {"2": 2, "3": 3}
    for name, kind in NET_ARRAYS.items():
        if name not in arrays:
            continue
        values = arrays[name]
        if values.ndim != len(kind.shape) or any(
            sizes.setdefault(axis, n) != n for axis, n in zip(kind.shape, values.shape, strict=True)
        ):
            raise InputError(f"{where}: {name} of the net has shape {values.shape}, unlike the other arrays")
        if not np.all(np.isfinite(values)):
            raise InputError(f"{where}: {name} of the net contains NaN or infinity")
    for name in _LOOPS:
        offsets = arrays[f"{name}_offsets"]
        if not len(offsets) or offsets[0] != 0 or offsets[-1] != len(arrays[f"{name}_values"]):
            raise InputError(f"{where}: damaged or cut short (loops of nodes with wrong offsets)")
        if np.any(np.diff(offsets) < 0):
            raise InputError(f"{where}: damaged or cut short (loops of nodes with wrong offsets)")
    nodes = ("element_nodes", "bullet_nodes", "fixed_nodes", *(f"{name}_values" for name in _LOOPS))
    for name in (*nodes, "tether_first"):
        if np.any((arrays[name] < 0) | (arrays[name] >= sizes["n"])):
            raise InputError(f"{where}: the net refers to a node that it does not have")


def _loops(values: Ints, offsets: Ints) -> Loops:
    nodes, bounds = values.tolist(), offsets.tolist()
    return tuple(tuple(nodes[a:b]) for a, b in itertools.pairwise(bounds))

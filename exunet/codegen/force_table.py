"""The forces of a scene as compiled code takes them: a row of addresses for each."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.codegen.entries import FUNCTIONS, addresses, tells
from exunet.forces.kernel_call import KernelCall

# Of each call: where its functions are (0: it has none), where its data, and what its `add` returns.
#
# elastic, tells_power : 1 if it returns that
# works                : 1 if the power taken out is -force . v
ROW = np.dtype([(name, "i8") for name in (*FUNCTIONS, "data", "elastic", "tells_power", "works")])


class Takes(IntEnum):
    """How the energy is known that the forces of a scene take out."""

    NOTHING = 0  # they take none out
    INTEGRATED = 1  # their power is integrated along the run
    TOLD = 2  # they tell all of it on their way


class ForceTable(NamedTuple):
    """The forces of a scene.

    rows  : (n_calls,) records `ROW`; they keep what they point to
    takes : how the energy is known that they take out
    data  : of each call, whose arrays the rows point to
    changed : the memories that compiled code changes itself, one after the other
    kept  : the same by name; views
    """

    rows: Any
    takes: Takes
    data: tuple[Any, ...]
    changed: NDArray[np.float64]
    kept: Mapping[str, NDArray[np.float64]]

    def place_of(self, name: str, entry: int) -> int:
        """Where an entry of a memory stands in `changed`; counted from the end if negative."""
        ends = dict(zip(self.kept, np.cumsum([len(one) for one in self.kept.values()]).tolist(), strict=True))
        return int(ends[name] + (entry if entry < 0 else entry - len(self.kept[name])))


class _Owner(bytearray):
    """The bytes of an array, and what must not vanish before it: NumPy keeps the owner of its bytes."""

    owned: tuple[Any, ...] = ()


def compiled_rows(
    calls: Sequence[KernelCall], sources: Sequence[str], data: Sequence[Any], *, lanes: bool
) -> NDArray[np.void]:
    """Records `ROW` of calls with their data, which they own; sources : of each call."""
    memory = _Owner(len(calls) * ROW.itemsize)
    rows = np.frombuffer(memory, dtype=ROW)
    owned = []
    for row, call, source, own in zip(rows, calls, sources, data, strict=True):
        words = np.fromiter(_words(own), dtype=np.int64)
        row["data"] = words.ctypes.data
        for name, address in addresses(call, source, own, lanes).items():
            row[name] = address
        for name, value in _flags(call).items():
            row[name] = value
        owned.append((own, words))
    memory.owned = tuple(owned)
    return rows


def interpreted_rows(calls: Sequence[KernelCall], data: Sequence[Any]) -> list[dict[str, Any]]:
    """The same for the functions in plain Python, which stand in the rows themselves."""
    return [
        {name: getattr(call, name) or 0 for name in FUNCTIONS} | {"data": own} | _flags(call)
        for call, own in zip(calls, data, strict=True)
    ]


def _flags(call: KernelCall) -> dict[str, int]:
    works = call.works and call.power is None and call.work is None
    if works and tells(call):
        raise TypeError(f"{call.add.__name__} tells its energy or power, so its work is not -force . v")
    return {"elastic": int(call.elastic), "tells_power": int(call.tells_power), "works": int(works)}


def takes(calls: Sequence[KernelCall]) -> Takes:
    """How the energy is known that calls take out."""
    taking = [call for call in calls if call.dissipates]
    if not taking:
        return Takes.NOTHING
    return Takes.TOLD if all(call.tells_power for call in taking) else Takes.INTEGRATED


def _words(data: Any) -> Iterator[int]:
    """A tuple as it stands in the memory of compiled code: words of 8 bytes, as Numba lays arrays out.

    An array is: who counts its references and who owns it (nobody), its size, the bytes of an item, where it
    begins, its shape, its strides.
    """
    for value in data:
        if isinstance(value, np.ndarray):
            begins = value.__array_interface__["data"][0]
            yield from (0, 0, value.size, value.itemsize, begins, *value.shape, *value.strides)
        elif isinstance(value, float):  # NumPy's too
            yield struct.unpack("<q", struct.pack("<d", value))[0]
        elif isinstance(value, int) and not isinstance(value, bool):
            yield value
        else:
            raise TypeError(f"data of a force must be arrays, float or int, not {type(value).__name__}")

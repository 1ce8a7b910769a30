"""A snapshot: all that a run depends on from one instant on, in memory or in a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn_version
from exunet.base.blob import pack_arrays, read_arrays, unpack_arrays, write_arrays
from exunet.base.errors import InputError
from exunet.base.files import path_of
from exunet.base.short_repr import ShortRepr
from exunet.base.version import VERSION
from exunet.codegen.compile import numba_version
from exunet.simulation.preparation import Start
from exunet.simulation.snapshot_checks import array_faults, header_faults

KIND, FORMAT = "exunet snapshot", 2  # 1: paths of files counted as what a case is


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot(ShortRepr):
    """What `Simulation.restore` goes back to.

    of     : which scene and engine it belongs to, see `identity`
    header : numbers and words, JSON-like
    arrays : numbers, of the integrator, the energy balance and the guards
    """

    of: Mapping[str, Any]
    header: dict[str, Any]
    arrays: Mapping[str, NDArray[Any]]

    @property
    def time(self) -> float:
        """The instant [s]."""
        return float(self.header["time"])

    def save(self, path: str | Path) -> None:
        """Write it to a file, whole or not at all; raises InputError if that cannot be written."""
        path = path_of(path, "Snapshot.save")
        write_arrays(path, KIND, FORMAT, {"of": dict(self.of), **self.header}, self.arrays)

    @classmethod
    def load(cls, path: str | Path) -> Snapshot:
        """Read what `save` wrote; raises InputError if the file is damaged or of another kind or version."""
        return cls._of_parts(*read_arrays(path_of(path, "Snapshot.load"), KIND, FORMAT))

    def as_bytes(self) -> bytes:
        """The content of the file that `save` writes."""
        return pack_arrays(KIND, FORMAT, {"of": dict(self.of), **self.header}, self.arrays)

    @classmethod
    def of_bytes(cls, content: bytes) -> Snapshot:
        """What `as_bytes` gave; raises InputError as `load`."""
        return cls._of_parts(*unpack_arrays(content, KIND, FORMAT))

    @classmethod
    def _of_parts(cls, header: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Snapshot:
        read = cls(header.pop("of", None), header, arrays)
        read.refuse_damaged()
        return read

    def refuse_damaged(self) -> None:
        """Raise InputError if a number or a word in the header is not what it stands for."""
        if faults := header_faults({"of": self.of, **self.header}):
            raise InputError(f"the snapshot is damaged: {', '.join(faults[:5])}")

    def refuse_unlike(self, like: Snapshot, room: int) -> None:
        """Raise InputError if it has other names, types or sizes than another snapshot of the simulation.

        room : most states that may wait to be handed over
        """
        missing = [f"it lacks {key}" for key in like.header if key not in self.header]
        if faults := missing + array_faults(self.arrays, like.arrays, self.header["time"], room):
            raise InputError(
                f"the snapshot of t = {self.time:g} s is damaged, or not of this simulation: "
                f"{', '.join(faults[:5])}"
            )

    def refuse_other(self, start: Start) -> None:
        """Raise InputError if it does not belong to what `start` begins."""
        wanted = identity(start)
        for key, words in _DIFFERS.items():
            if self.of.get(key) != wanted[key]:
                shown = f" ({self.of.get(key)}, not {wanted[key]})" if key in _READABLE else ""
                raise InputError(
                    f"the snapshot of t = {self.time:g} s is of {words}{shown}: run the case from its start"
                )


_DIFFERS = {
    "exunet": "another version of exunet",
    "numpy": "another version of NumPy",
    "exudyn": "another version of Exudyn",
    "numba": "another version of Numba",
    "engine": "another engine or form of the net",
    "scene": "another case",
    "files": "a case whose files (bodies.*.file, initial.from) have another content",
    "state": "another start",
}
_READABLE = {"exunet", "numpy", "exudyn", "numba", "engine"}  # the others are checksums
# What a state does not depend on, and the paths of files.
_NOT_IN_SCENE: Any = {
    "time": True,
    "title": True,
    "initial": {"from"},
    "bodies": {"__all__": {"file"}},
}


@lru_cache(maxsize=8)
def identity(start: Start) -> Mapping[str, Any]:
    """What a snapshot must share with what it is put back into.

    Of a file that the case names, what was read from it counts, not how or from where its path is written.
    """
    scene = start.scene.model_dump(mode="json", exclude=_NOT_IN_SCENE)
    state = hashlib.sha256()
    for name, values in sorted(start.state.arrays().items()):
        state.update(name.encode() + np.ascontiguousarray(values).tobytes())
    found = {
        "exunet": VERSION,
        "numpy": np.__version__,
        "exudyn": exudyn_version(),
        "numba": numba_version(),
        "engine": start.scene.engine.model_dump(mode="json"),
        "scene": hashlib.sha256(json.dumps(scene, sort_keys=True).encode()).hexdigest(),
        "files": _read_from_files(start),
        "state": state.hexdigest(),
    }
    return MappingProxyType(found)


def _read_from_files(start: Start) -> str:
    """Checksum of the surfaces of bodies, and of the result and the stored time that the case starts from."""
    found = hashlib.sha256()
    for body in start.system.bodies:
        if body.shape is not None and (mesh := body.shape.mesh) is not None:
            for part in (mesh.vertices, mesh.triangles):
                found.update(f"{body.name} {part.shape}".encode() + np.ascontiguousarray(part).tobytes())
    if (restart := start.restart) is not None:
        found.update(f"{restart['sha256']} {restart['time_s']!r}".encode())
    return found.hexdigest()


def grouped(group: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Names of arrays with their group before them."""
    return {f"{group}:{name}": values for name, values in arrays.items()}


def group_of(group: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of a group by their own names."""
    start = f"{group}:"
    return {name[len(start) :]: values for name, values in arrays.items() if name.startswith(start)}

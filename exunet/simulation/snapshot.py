"""A snapshot: all that a run depends on from one instant on, in memory or in a file."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr
from exunet.base.errors import InputError
from exunet.base.files import pack_arrays, path_of, read_arrays, unpack_arrays, write_arrays
from exunet.base.version import VERSION
from exunet.integrators.exudyn.engine import exudyn_version
from exunet.kernels.compile import numba_version
from exunet.net.explicit import ExplicitNet
from exunet.simulation.preparation import Start

KIND, FORMAT = "exunet snapshot", 1


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot(ShortRepr):
    """State that `Simulation.restore` goes back to.

    of     : which scene and engine it belongs to, see `identity`
    header : numbers and words, JSON-like
    arrays : numbers, of the integrator, the energy balance and the guards
    """

    of: dict[str, Any]
    header: dict[str, Any]
    arrays: dict[str, NDArray[Any]]

    @property
    def time(self) -> float:
        """The instant [s]."""
        return float(self.header["time"])

    def save(self, path: str | Path) -> None:
        """Write it to a file, whole or not at all; raises InputError if that cannot be written."""
        path = path_of(path, "Snapshot.save")
        write_arrays(path, KIND, FORMAT, {"of": self.of, **self.header}, self.arrays)

    @classmethod
    def load(cls, path: str | Path) -> Snapshot:
        """Read what `save` wrote; raises InputError if the file is damaged or of another kind or version."""
        return cls._of_parts(*read_arrays(path_of(path, "Snapshot.load"), KIND, FORMAT))

    def as_bytes(self) -> bytes:
        """The content of the file that `save` writes."""
        return pack_arrays(KIND, FORMAT, {"of": self.of, **self.header}, self.arrays)

    @classmethod
    def of_bytes(cls, content: bytes) -> Snapshot:
        """Return the snapshot that `as_bytes` packed; raises InputError as `load`."""
        return cls._of_parts(*unpack_arrays(content, KIND, FORMAT))

    @classmethod
    def _of_parts(cls, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Snapshot:
        return cls(header.pop("of"), header, arrays)


def validate_snapshot(snapshot: Snapshot, start: Start, like: Snapshot) -> None:
    """Raise InputError for a snapshot of another case, engine or version, or with other arrays.

    like : a snapshot of the simulation that is to go to it
    """
    wanted, what = identity(start), f"the snapshot of t = {snapshot.time:g} s"
    for key, words in _DIFFERS.items():
        if snapshot.of.get(key) != wanted[key]:
            shown = f" ({snapshot.of.get(key)}, not {wanted[key]})" if key in _READABLE else ""
            raise InputError(f"{what} is of {words}{shown}: run the case from its start")
    if lacks := [key for key in like.header if key not in snapshot.header]:
        words = (
            "is not of a run with stored states" if "rows" in lacks else f"is damaged: it lacks {lacks[0]}"
        )
        raise InputError(f"{what} {words}")
    unknown = [name for name in snapshot.arrays if name.startswith("control:") and name not in like.arrays]
    unlike = [
        name for name, values in like.arrays.items() if not _alike(name, snapshot.arrays.get(name), values)
    ]
    if wrong := unlike + unknown:
        words = "attach and add the same as then"
        raise InputError(f"{what} does not fit this simulation ({wrong[0]}): {words}")


def _alike(name: str, values: NDArray[Any] | None, others: NDArray[Any]) -> bool:
    """True for arrays of one shape; the first size may be a number of rows that wait, or of events."""
    if values is None:
        return name.startswith("block:discrete:")  # absent where no state of the block is marked
    if name == "acting" or name.startswith("control:"):
        return values.shape == others.shape
    return not (values.size and others.size) or values.shape[1:] == others.shape[1:]


_DIFFERS = {
    "exunet": "another version of exunet",
    "numpy": "another version of NumPy",
    "exudyn": "another version of Exudyn",
    "numba": "another version of Numba",
    "backend": "another backend",
    "scene": "another case",
    "files": "a case whose files (bodies.*.file, net.*_file, initial.restart) have another content",
    "state": "another start",
}
_READABLE = {"exunet", "numpy", "exudyn", "numba", "backend"}  # the others are checksums
# What a state does not depend on, the backend, which the plan has, and the paths of files.
_NOT_IN_SCENE: Any = {
    "time": True,
    "title": True,
    "engine": True,
    "initial": {"restart"},
    "bodies": {"__all__": {"file"}},
    "net": {"nodes_file", "elements_file"},
}


@lru_cache(maxsize=8)
def identity(start: Start) -> dict[str, Any]:
    """Return the facts that a snapshot must share with the simulation that it is restored into.

    A file that the case names counts by what was read from it, not by how or from where its path is written.
    """
    scene = start.scene.model_dump(mode="json", exclude=_NOT_IN_SCENE)
    state = hashlib.sha256()
    for name, values in sorted(start.state.arrays().items()):
        state.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return {
        "exunet": VERSION,
        "numpy": np.__version__,
        "exudyn": exudyn_version(),
        "numba": numba_version(),
        "backend": start.plan.backend.value,
        "scene": hashlib.sha256(json.dumps(scene, sort_keys=True).encode()).hexdigest(),
        "files": _read_from_files(start),
        "state": state.hexdigest(),
    }


def _read_from_files(start: Start) -> str:
    """Checksum of a listed net, surfaces of bodies, and the result and time that the case starts from."""
    found = hashlib.sha256()
    if isinstance(start.scene.net, ExplicitNet):
        for part in start.scene.net.listed:
            found.update(np.ascontiguousarray([] if part is None else part).tobytes())
    for body in start.system.bodies:
        if body.shape is not None and (mesh := body.shape.mesh) is not None:
            for part in (mesh.vertices, mesh.triangles):
                found.update(f"{body.name} {part.shape}".encode() + np.ascontiguousarray(part).tobytes())
    if (restart := start.restart) is not None:
        found.update(f"{restart.sha256} {restart.time_s!r}".encode())
    return found.hexdigest()

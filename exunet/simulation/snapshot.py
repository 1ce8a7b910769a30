"""A snapshot: all that a run depends on from one instant on, in memory or in a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn_version
from exunet.base.blob import read_arrays, write_arrays
from exunet.base.errors import InputError
from exunet.base.files import path_of
from exunet.base.version import VERSION
from exunet.codegen.compile import numba_version
from exunet.simulation.preparation import Start

KIND, FORMAT = "exunet snapshot", 1


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What `Simulation.restore` goes back to.

    of     : which scene and engine it belongs to, see `identity`
    header : numbers and words, JSON-like
    arrays : numbers, of the integrator, the books and the guards
    """

    of: dict[str, Any]
    header: dict[str, Any]
    arrays: Mapping[str, NDArray[Any]]

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
        header, arrays = read_arrays(path_of(path, "Snapshot.load"), KIND, FORMAT)
        return cls(header.pop("of"), header, arrays)

    def refuse_incomplete(self, like: Snapshot) -> None:
        """Raise InputError if it lacks what another snapshot of the simulation has, or has other sizes."""
        missing = [key for key in like.header if key not in self.header]
        for name, values in like.arrays.items():
            found = self.arrays.get(name)
            grows = name.startswith(_GROW)
            if found is None:
                if not grows:
                    missing.append(name)
            elif found.shape[grows:] != values.shape[grows:] and found.size and values.size:
                missing.append(f"{name} of shape {values.shape}")
        if missing:
            raise InputError(
                f"the snapshot of t = {self.time:g} s is damaged: it lacks {', '.join(missing[:5])}"
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


# Arrays with a row for each state, mark, event or stop that there was.
_GROW = (
    "integrator:kept/",
    "integrator:rows/",
    "integrator:pushed",
    "monitor:peaks",
    "monitor:marks",
    "monitor:envelope",
    "stops:",
)
_DIFFERS = {
    "exunet": "another version of exunet",
    "numpy": "another version of NumPy",
    "exudyn": "another version of Exudyn",
    "numba": "another version of Numba",
    "engine": "another engine or form of the net",
    "scene": "another case",
    "state": "another start",
}
_READABLE = {"exunet", "numpy", "exudyn", "numba", "engine"}  # the others are checksums


def identity(start: Start) -> dict[str, Any]:
    """What a snapshot must share with what it is put back into."""
    scene = start.scene.model_dump(mode="json", exclude={"time", "title"})
    state = hashlib.sha256()
    for name, values in sorted(start.state.arrays().items()):
        state.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return {
        "exunet": VERSION,
        "numpy": np.__version__,
        "exudyn": exudyn_version(),
        "numba": numba_version(),
        "engine": start.scene.engine.model_dump(mode="json"),
        "scene": hashlib.sha256(json.dumps(scene, sort_keys=True).encode()).hexdigest(),
        "state": state.hexdigest(),
    }


def grouped(group: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Names of arrays with their group before them."""
    return {f"{group}:{name}": values for name, values in arrays.items()}


def group_of(group: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of a group by their own names."""
    start = f"{group}:"
    return {name[len(start) :]: values for name, values in arrays.items() if name.startswith(start)}

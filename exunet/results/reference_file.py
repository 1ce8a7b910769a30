"""States that reference_impl writes for `exunet run --check`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from exunet.results.comparison import ComparedRun
from exunet.results.result import BodyStates

_SHARED = (
    "time",
    "position",
    "velocity",
    "reference_position",
    "element_nodes",
    "bullet_nodes",
    "fixed_nodes",
    "mass",
    "reference_length",
    "axial_stiffness",
)  # arrays that the file and `ComparedRun` have under the same name


def read_reference(path: str | Path) -> ComparedRun:
    """Read the states of the net and of the bodies, and what broke.

    Raises
    ------
    OSError, ValueError, KeyError
        If `path` is not such a file.
    """
    with np.load(path, allow_pickle=False) as file:
        bodies = {}
        for k, name in enumerate(file["body_names"].tolist()):
            inertia = file["body_inertia"][k]
            rigid = bool(inertia.any())
            turn = scipy.spatial.transform.Rotation.from_matrix(file["body_attitude"][:, k])
            bodies[name] = BodyStates(
                float(file["body_mass"][k]),
                inertia if rigid else None,
                file["body_position"][:, k],
                file["body_velocity"][:, k],
                turn.as_quat(scalar_first=True) if rigid else None,
                file["body_angular_velocity"][:, k] if rigid else None,
            )
        broken = tuple(zip(file["break_element"].tolist(), file["break_time"].tolist(), strict=True))
        shared = {name: file[name] for name in _SHARED}
        return ComparedRun(complete=bool(file["complete"]), bodies=bodies, broken=broken, **shared)

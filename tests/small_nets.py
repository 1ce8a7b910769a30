"""Small scenes that several test files run."""

from __future__ import annotations

from typing import Any

from exunet.scene.scene import Scene

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 70e9}  # paper, Table 1


def thrown(solver: dict[str, Any], *, end: float = 0.5, **tables: Any) -> Scene:
    """A 2 x 2 net thrown open: snaps from 0.1 s on, the stable step of RK44 is 2.6e-4 s."""
    return Scene.model_validate(
        {
            "format": 1,
            "title": "small thrown net",
            "time": {"end": end, "output_step": 0.005},
            "solver": solver,
            "engine": {"backend": "exudyn"},
            "net": {
                "topology": "square",
                "size": 2.0,
                "mesh": 1.0,
                "cable": CABLE,
                "strings": {**CABLE, "diameter": 0.004, "length": 1.0},
                "bullets": {"mass": 0.5},
            },
            "initial": {"packing": 0.5},
            "launch": {"radial_speed": 5.0, "axial_speed": 0.0},
            **tables,
        }
    )


def pair_of_masses(**tables: Any) -> Scene:
    """Two masses of 0.5 kg on a cable of 1 m, at rest and just taut; EA = 10 N, as soft as rubber."""
    return Scene.model_validate(
        {
            "format": 1,
            "title": "two masses",
            "time": {"end": 0.5, "output_step": 0.05},
            "engine": {"backend": "exudyn"},
            "net": {
                "topology": "explicit",
                "nodes": [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]],
                "elements": [[0, 1]],
                "node_masses": [0.5, 0.5],
                "cable": {"area": 1e-4, "density": 10.0, "youngs_modulus": 1e5},
            },
            "initial": {"packing": 1.0},
            **tables,
        }
    )

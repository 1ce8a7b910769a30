"""Random valid cases: the reference's topologies, divided cables, strings, any material, any thrown start."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

TOPOLOGIES = ("square", "rectangular", "hexagonal", "radial", "cut", "explicit")


def random_case(random: np.random.Generator, topology: str | None = None) -> tuple[str, str]:
    """(topology, TOML text) of a valid case, drawn from `random`; `topology` fixes its kind."""
    kind = topology or str(random.choice(TOPOLOGIES))
    net: dict[str, Any] = {"topology": kind, "divisions": int(random.integers(1, 4))}
    side = float(random.uniform(0.2, 2.0))
    match kind:
        case "square":
            net |= {"mesh": side, "size": side * int(random.integers(1, 6))}
        case "rectangular":
            other = float(random.uniform(0.2, 2.0))
            cells = random.integers(1, 6, size=2).tolist()
            net |= {"mesh": [side, other], "size": [side * cells[0], other * cells[1]]}
        case "hexagonal":
            net |= {"mesh": side, "rings": int(random.integers(0, 3))}
        case "radial":
            spokes, rings = int(random.integers(3, 9)), int(random.integers(1, 4))
            net |= {"radius": side * rings, "spokes": spokes, "rings": rings}
        case "cut":
            net |= {"mesh": side, "size": side * float(random.uniform(4.0, 8.0)), "border": _cable(random)}
            net["outline"] = str(random.choice(["square", "hexagon", "octagon", "circle"]))
            net["mesh_shape"] = str(random.choice(["square", "triangle", "hexagon"]))
            if net["outline"] == "circle":
                net["corners"] = int(random.integers(3, 7))
        case "explicit":
            net |= _listed(random)
    thrown = kind != "explicit"
    tables: dict[str, dict[str, Any]] = {"net": net, "net.cable": _cable(random)}
    if thrown:
        longer = side * float(random.uniform(0.6, 2.0))
        tables["net.strings"] = _cable(random) | {"length": longer, "divisions": int(random.integers(1, 3))}
        tables["net.bullets"] = {"mass": float(random.uniform(0.05, 2.0))}
    packing, (velocity, spin) = random.uniform(0.02, 1.0), random.normal(size=(2, 3)).tolist()
    tables["initial"] = {"packing": packing, "velocity": velocity, "spin": spin}
    if thrown:
        radial, axial = random.uniform(0.1, 5.0), random.uniform(-5.0, 5.0)
        tables["launch"] = {"radial_speed": radial, "axial_speed": axial}
    if random.random() < 0.5:
        tables["effects.rayleigh_damping"] = {"alpha": float(random.uniform(0, 1e-2)), "beta": 1e-7}
    head = f'format = 1\ntitle = "random {kind} net"\n[time]\nend = 0.1\noutput_step = 0.1\n'
    return kind, head + "".join(_table(name, keys) for name, keys in tables.items())


def _cable(random: np.random.Generator) -> dict[str, float]:
    return {
        "diameter": float(random.uniform(5e-4, 5e-3)),
        "density": float(random.uniform(500.0, 3000.0)),
        "youngs_modulus": float(10.0 ** random.uniform(6.0, 11.5)),
    }


def _listed(random: np.random.Generator) -> dict[str, Any]:
    """A chain through random places with a few random chords, one node heavier, maybe one fixed."""
    count = int(random.integers(3, 9))
    nodes = random.uniform(-2.0, 2.0, size=(count, 3))
    pairs = {(k, k + 1) for k in range(count - 1)}
    for _ in range(int(random.integers(0, count))):
        i, j = sorted(random.choice(count, size=2, replace=False).tolist())
        pairs.add((i, j))
    masses = np.zeros(count)
    masses[int(random.integers(count))] = random.uniform(0.1, 1.0)
    listed = {"nodes": nodes.tolist(), "elements": sorted(pairs), "node_masses": masses.tolist()}
    if random.random() < 0.5:
        listed["fixed"] = [int(random.integers(count))]
    return listed


def _table(name: str, keys: dict[str, Any]) -> str:
    """A TOML table; JSON writes its strings, numbers and lists as TOML does."""
    own = "".join(
        f"{key} = {json.dumps(value)}\n" for key, value in keys.items() if not isinstance(value, dict)
    )
    inner = (_table(f"{name}.{key}", value) for key, value in keys.items() if isinstance(value, dict))
    return f"\n[{name}]\n{own}" + "".join(inner)

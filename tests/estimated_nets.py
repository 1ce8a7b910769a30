"""Small nets with a state to estimate from, which are known by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from exunet.forces.estimate import EstimateBasis
from exunet.net import AnyNetConfig, weave

CABLE = {"area": 1e-3, "density": 1000.0, "youngs_modulus": 1e6}  # 1 kg a metre, EA = 1 kN


def basis_of(net: dict[str, Any], position: Any, velocity: Any, duration: float = 0.5) -> EstimateBasis:
    woven = weave(TypeAdapter(AnyNetConfig).validate_python({"cable": CABLE} | net))
    return EstimateBasis(woven, duration, np.array(position, dtype=float), np.array(velocity, dtype=float))


def chain(**more: Any) -> EstimateBasis:
    """Three nodes on a line, elements of 0.5 m and 2 m: masses of 0.25, 1.25 and 1 kg."""
    net = {
        "topology": "explicit",
        "nodes": [[0, 0, 0], [0.5, 0, 0], [2.5, 0, 0]],
        "elements": [[0, 1], [1, 2]],
    }
    place, speed = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]], [[0, 0, 0], [3, 0, 0], [3, 4, 0]]
    return basis_of(net | more, place, speed)


def opening(duration: float) -> EstimateBasis:
    """2 x 2 meshes of 1 m at a tenth, bullets of 3 kg at the corners fly out at 2, up at 1 m/s."""
    net = {"topology": "square", "size": 2.0, "mesh": 1.0, "bullets": {"mass": 3.0}}
    woven = weave(TypeAdapter(AnyNetConfig).validate_python({"cable": CABLE} | net))
    velocity = np.zeros((9, 3))
    corners = woven.reference_position[woven.bullet_nodes]
    velocity[woven.bullet_nodes] = math.sqrt(2.0) * corners + [0.0, 0.0, 1.0]
    return basis_of(net, 0.1 * woven.reference_position, velocity, duration)

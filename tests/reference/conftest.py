"""What the tests of reference_impl share: small cases as dictionaries, and a runner."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from reference_impl import assemble, initial_state, march, read, read_document, weave  # noqa: E402

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 70e9}
STRINGS = {**CABLE, "diameter": 0.004, "length": 2**0.5}
NETS = {
    "square": {"topology": "square", "size": 5.0, "mesh": 1.0},
    "rectangular": {"topology": "rectangular", "size": [3.0, 1.0], "mesh": [0.5, 0.25]},
    "hexagonal": {"topology": "hexagonal", "mesh": 0.5, "rings": 2},
    "radial": {"topology": "radial", "radius": 2.0, "spokes": 8, "rings": 3},
}


class Scene:
    """A case made ready to run."""

    def __init__(self, case, symmetric=False):
        self.case, self.net = case, weave(case)
        self.system = assemble(case, self.net, symmetric)
        self.x0, self.v0 = initial_state(case, self.net)

    def march(self, times=None, **options):
        return march(self.system, self.x0, self.v0, self.case.times if times is None else times, **options)

    def bullet_speeds(self, trajectory):
        """(nt, k) [m/s]"""
        vx, vy, vz = np.moveaxis(trajectory.v[:, self.net.bullet_nodes], -1, 0)
        return np.sqrt((vx * vx + vy * vy) + vz * vz)


@pytest.fixture(scope="session")
def document():
    """document(topology, **overrides): a complete case with strings and bullets as a dictionary."""

    def make(topology="square", **net):
        return copy.deepcopy(
            {
                "format": 1,
                "title": topology,
                "time": {"end": 1.0, "output_step": 0.1},
                "net": {
                    **NETS[topology],
                    "cable": CABLE,
                    "strings": STRINGS,
                    "bullets": {"mass": 0.5},
                    **net,
                },
                "initial": {"packing": 0.1},
                "launch": {"radial_speed": 2.5, "axial_speed": 0.0},
            }
        )

    return make


@pytest.fixture(scope="session")
def explicit():
    """explicit(nodes, elements, initial, **net): a case listed node by node."""

    def make(nodes, elements, initial=None, **net):
        return copy.deepcopy(
            {
                "format": 1,
                "title": "explicit",
                "time": {"end": 1.0, "output_step": 0.1},
                "net": {"topology": "explicit", "nodes": nodes, "elements": elements, "cable": CABLE, **net},
                "initial": {"packing": 1.0, **(initial or {})},
            }
        )

    return make


@pytest.fixture(scope="session")
def scene():
    """scene(document or name of a file in cases/, overrides, symmetric): ready to run."""

    def make(what, overrides=None, symmetric=False):
        reader = read_document if isinstance(what, dict) else lambda name, o: read(ROOT / "cases" / name, o)
        return Scene(reader(what, overrides), symmetric)

    return make

"""What the tests of reference_impl share: small cases as dictionaries, and a runner."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from reference_impl import energy, load, prepare, read_document  # noqa: E402

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 70e9}
STRINGS = {**CABLE, "diameter": 0.004, "length": 2**0.5}
NETS = {
    "square": {"topology": "square", "size": 5.0, "mesh": 1.0},
    "rectangular": {"topology": "rectangular", "size": [3.0, 1.0], "mesh": [0.5, 0.25]},
    "hexagonal": {"topology": "hexagonal", "mesh": 0.5, "rings": 2},
    "radial": {"topology": "radial", "radius": 2.0, "spokes": 8, "rings": 3},
}


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
    """scene(document or name of a file in cases/, overrides, **arithmetic): ready to run."""

    def make(what, overrides=None, **arithmetic):
        if isinstance(what, dict):
            return prepare(read_document(what, overrides), **arithmetic)
        return load(ROOT / "cases" / what, overrides, **arithmetic)

    return make


@pytest.fixture(scope="session")
def bullet_speeds():
    """bullet_speeds(scene, trajectory): (nt, k) [m/s], alike to the last bit for mirrored velocities."""

    def make(made, trajectory):
        vx, vy, vz = np.moveaxis(trajectory.v[:, made.net.bullet_nodes], -1, 0)
        return np.sqrt((vx * vx + vy * vy) + vz * vz)

    return make


@pytest.fixture(scope="session")
def loose(document):
    """loose(**effects): four bullets of 0.5 kg on a net packed so that nothing is taut, at rest."""

    def make(**effects):
        case = document("square", size=2.0)
        del case["launch"]
        return {**case, "initial": {"packing": 0.2}, "effects": copy.deepcopy(effects)}

    return make


@pytest.fixture(scope="session")
def unbalanced():
    """unbalanced(scene, trajectory): change of the total energy over its largest term."""

    def make(made, run):
        books = energy.books(made.system, run)
        terms = (books.kinetic, books.elastic, books.potential, books.dissipated)
        return np.abs(books.total - books.total[0]).max() / max(np.abs(term).max() for term in terms)

    return make

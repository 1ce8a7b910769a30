"""Starts with terms that a test itself defines, on a small scene that tests of the blocks share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.terms import KernelTerm
from exunet.scene.casefile import load
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

BACKENDS = {
    "compiled": "engine.backend=compiled",
    "exudyn": "engine.backend=exudyn",
}
# Two nodes of 0.5 kg, 1.05 m apart on a cable of 1 m and 55 N, which move apart: it is taut for 0.2 s. Beside
# them a tumbling body of 2 kg with three different moments of inertia.
PAIR = """
format = 1
title = "Two nodes and a body"
time = { end = 0.15, output_step = 0.05 }
initial.packing = 1.0
initial.node_positions = [[0.0, 0.0, 0.0], [1.05, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.49945414827643875, 0.49945414827643875]  # and half the cable: 0.5 kg
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }
initial.node_velocities = [[-0.5, 0.0, 0.1], [0.5, 0.1, 0.0]]
"""
BODY = (
    "bodies.target={mass=2.0, inertia=[0.2, 0.3, 0.4], position=[-0.5, 0.2, 0.1], velocity=[0.1, 0.0, 0.2],"
    "attitude=[0.9, 0.1, 0.3, 0.2], angular_velocity=[1.0, 2.0, -1.5]}"
)


def case_file(folder: Path, text: str = PAIR) -> Path:
    """The scene as a file."""
    path = folder / "case.toml"
    path.write_text(text)
    return path


def start_of(
    path: Path,
    overrides: Sequence[str],
    make: Callable[[Blocks], Sequence[KernelTerm]],
    states: tuple[FirstOrder, ...] = (),
) -> Start:
    """A case with terms of a test beside its own; make(blocks) gives them."""
    return prepare_case(load(path, overrides)).with_forces(make, states)


def continue_alike(one: Simulation, other: Simulation, until: float, folder: Path) -> None:
    """Take `other` to where `one` is, through a file, and both on to a time [s]: to the same bits."""
    one.snapshot().save(folder / "here")
    other.restore(Snapshot.load(folder / "here"))
    for sim in (one, other):
        sim.advance_to(until)
    for name, values in one.state.arrays().items():
        np.testing.assert_array_equal(other.state.arrays()[name], values)
    assert one.energy == other.energy

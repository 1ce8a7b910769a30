"""What threads that press into a mesh do at states: momentum, work, what is booked. Nothing is compiled."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from scenes import OUTLINE, Placed, extruded, mesh_keys

import exunet
from exunet.forces.contact.status import STATUS
from exunet.forces.terms import KernelTerm, copied
from exunet.simulation.preparation import Start, prepare_case

Floats = np.ndarray

HALF, EDGE = 0.05, 0.02  # m, of an L with legs 0.1 m wide
CASE = """format = 1
title = "a net and an L"
time = {{ end = 1.0, output_step = 0.1 }}
engine.backend = "compiled"
initial.packing = 1.0
net.topology = "square"
net.size = 0.16
net.mesh = 0.08
net.cable = {{ diameter = 0.002, density = 1000.0, youngs_modulus = 1e5 }}
[bodies.target]
shape = "mesh"
file = "{file}"
unit = "m"
edge_radius = {edge}
grid_spacing = {spacing}
mass = 0.5
position = [0.0, 0.0, -1.0]
[effects.contact]
threads = ["target"]
law = "linear"
stiffness = 1e4
damping = 0.4
friction = {{ law = "regularised", coefficient = 0.3, slip_speed = 0.01 }}
"""
# Where the middle of the net is and along what its sides are, in the frame of the L: on its upper side, with
# a border in its inner corner, over one of its outer edges at 45 degrees to both sides of that.
PLACES = {
    "on a face": ((-0.05, -0.05, HALF), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "in a corner": ((0.031, 0.031, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "over an edge": ((-0.119, -0.03, HALF - 0.006), (1.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
}


@cache
def prepared() -> Start:
    with TemporaryDirectory() as folder:
        mesh = extruded([(0.5 * x, 0.5 * y) for x, y in OUTLINE], HALF)
        keys = mesh_keys(mesh, Path(folder), "target")
        path = Path(folder) / "case.toml"
        path.write_text(CASE.format(file=keys["file"], edge=EDGE, spacing=EDGE / 2.0))
        return prepare_case(exunet.load(path))


class Pressed(Placed):
    """A net that presses into an L which moves and turns, all at random."""

    def __init__(self, where: str, **law: float) -> None:
        super().__init__(prepared())
        random = np.random.default_rng(20261124)
        ((self.term, data),) = super().terms()
        self.data: Any = copied(data)._replace(law=data.law._replace(**law))
        (body,) = self.start.system.bodies
        middle, *sides = (np.array(place, dtype=float) for place in PLACES[where])
        first, second = (side / np.linalg.norm(side) for side in sides)
        own = self.start.net.reference_position
        places = middle + own[:, :1] * first + own[:, 1:2] * second + 0.0005 * random.normal(size=own.shape)
        self.centre()[:] = random.normal(size=3)
        turned = random.normal(size=4)
        self.attitude()[:] = turned / np.linalg.norm(turned)
        in_body = (places - body.centre) @ body.rotation
        self.x[self.nodes] = (in_body @ self.turn().T + self.centre()).ravel()
        self.v[: self.blocks.n_v] = 0.3 * random.normal(size=self.blocks.n_v)

    def terms(self) -> list[tuple[KernelTerm, Any]]:
        return [(self.term, self.data)]

    def force(self) -> Floats:
        found = np.zeros(self.blocks.n_force)
        self.term.add(0.0, self.x, self.v, self.data, found)
        return found


@pytest.mark.parametrize("rubbing", [False, True])
@pytest.mark.parametrize("where", PLACES)
def test_forces_on_a_mesh_change_no_momentum_and_their_work_is_booked(where: str, rubbing: bool) -> None:
    """The power is that of the stored energy, less what damping and friction take."""
    pressed = Pressed(where, **({} if rubbing else {"damping": 0.0, "friction": 0.0}))
    force, v = pressed.force(), pressed.v
    at = pressed.blocks.rate("contact/damping")
    taken = force[at : at + 2]
    power = float(force[: pressed.blocks.n_v] @ v[: pressed.blocks.n_v])
    assert power == pytest.approx(-pressed.rate_of_energy() - taken.sum(), rel=1e-6)
    assert (taken != 0.0).tolist() == [rubbing, rubbing]
    assert taken[1] >= 0.0
    size = np.abs(force[pressed.nodes]).sum()
    assert size > 0.1  # N
    total, moment = pressed.gained(force)
    assert total < 1e-14 * size
    assert moment < 1e-13 * size


def test_an_anchor_on_a_mesh_stays_while_it_holds_and_its_place_touches() -> None:
    """Of all threads that touch, as the net moves on; the force across them acts somewhere else then."""
    pressed = Pressed("on a face", slip_speed=0.0, friction=50.0, damping=0.0)
    assert pressed.term.remember is not None
    rows, forces = [], []
    for way in (0.0, 2e-4):
        pressed.x[pressed.nodes] += way * pressed.v[pressed.nodes]
        forces.append(pressed.force())
        pressed.term.remember(0.0, pressed.x, pressed.v, pressed.data)
        rows.append(pressed.data.kept[:-STATUS].reshape(-1, 5).copy())
        np.testing.assert_allclose(pressed.force(), forces[-1], rtol=1e-9, atol=1e-12)
    held = rows[0][:, 0] == 1.0
    assert held.sum() > 3
    np.testing.assert_array_equal(rows[1][held], rows[0][held])
    pressed.data.kept[: 5 * len(held) : 5] = 0.0
    assert np.abs(pressed.force() - forces[1]).max() > 1e-3  # without anchors nothing is held

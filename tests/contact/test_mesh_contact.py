"""Contact with bodies whose shape is a mesh: bounces, books, forms, snapshots, and the solid's motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import LINEAR, PLATE, THROWN, contact, simulation, taken_by_contact
from test_contact_momentum import END, FORMS, energy, momenta, touched

import exunet
from exunet.bodies.shapes import Solid
from exunet.bodies.surfaces import polyhedron
from exunet.forces.contact.status import status_of
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

pytestmark = pytest.mark.slow  # a kernel for each form, compiled in a minute each


def written(folder: Path, name: str, size: tuple[float, float, float]) -> str:
    """A box as a mesh in a file; the keys that name it."""
    trimesh = pytest.importorskip("trimesh")
    mesh = polyhedron(Solid("box", size))
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(folder / f"{name}.stl")
    return f'shape = "mesh"\nfile = "{name}.stl"\nunit = "m"'


def thrown(folder: Path, *changes: str) -> Simulation:
    keys = written(folder, "box", (0.25, 0.2, 0.1))
    text = THROWN.replace('shape = "box"\nsize = [0.25, 0.2, 0.1]', keys)
    return simulation(folder, text, *changes)


@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.2])
@pytest.mark.parametrize("what", ["threads", "bullets"])
def test_restitution_is_what_was_stated(what: str, restitution: float, tmp_path: Path) -> None:
    """On a plane face the distance is exact, so that it is as exact as with a solid."""
    keys: dict[str, Any] = LINEAR | {"restitution": restitution, "impact_speed": 1.0}
    changes, nodes = ["net.bullets.mass=1e-12", "solver.step=2e-6"], slice(4, 8)
    if what == "bullets":
        keys |= {"stiffness": 1e-9, "bullet_stiffness": 2e3}
        changes, nodes = ["net.bullets.mass=0.05", "solver.step=2e-5"], slice(0, 4)
    plate = written(tmp_path, "plate", (4.0, 4.0, 0.4))
    text = PLATE.replace('shape = "box"\nsize = [20.0, 20.0, 0.4]', f"{plate}\ngrid_spacing = 0.025")
    sim = simulation(tmp_path, text, *contact(**keys), "initial.velocity=[0.0, 0.0, -1.0]", *changes)
    sim.advance(0.098)  # before threads, which nothing stops beside bullets, are too deep
    velocity = sim.net.velocity[nodes, 2]
    assert status_of(sim.view.memory[f"contact/{what}/plate"]).first_touch > 0.0
    assert np.ptp(velocity) < 1e-9
    assert velocity[0] == pytest.approx(restitution, abs=1e-6)


def test_momentum_is_kept_and_energy_is_booked(tmp_path: Path) -> None:
    changes, taken = [], np.zeros(2)
    for step in (2e-5, 1e-5):
        sim = thrown(tmp_path, f"solver.step={step}")
        before, (start, _) = momenta(sim), energy(sim)
        sim.advance_to(END)
        after, (end, taken) = momenta(sim), energy(sim)
        assert sum(touched(sim)) >= 3.0
        assert np.abs(after[0] - before[0]).max() < 1e-12 * before[2]
        assert np.abs(after[1] - before[1]).max() < 1e-10 * before[3]
        changes.append(abs(end + taken.sum() - start) / start)
    assert taken.min() > 1e-5 * start
    assert max(changes) < 2e-6


def test_a_mesh_of_a_box_moves_as_the_box(tmp_path: Path) -> None:
    """What the box got of momentum, with finer grids; of 0.033 m/s and 0.47 rad/s."""
    known = simulation(tmp_path, THROWN, "solver.step=2e-5")
    known.advance_to(END)
    errors = []
    for spacing in (0.01, 0.0025):
        sim = thrown(tmp_path, "solver.step=2e-5", f"bodies.box.grid_spacing={spacing}")
        sim.advance_to(END)
        mine, theirs = sim.state.bodies, known.state.bodies
        errors.append(
            [
                float(np.abs(mine.velocity - theirs.velocity).max()),
                float(np.abs(mine.angular_velocity - theirs.angular_velocity).max()),
                abs(sum(taken_by_contact(sim)) / sum(taken_by_contact(known)) - 1.0),
            ]
        )
    assert (np.array(errors[1]) < 0.5 * np.array(errors[0])).all()
    assert errors[1][0] < 2e-6
    assert errors[1][1] < 2e-5
    assert errors[1][2] < 1e-4


def test_forms_give_the_same_motion(tmp_path: Path) -> None:
    found: dict[str, Any] = {}
    for form, change in FORMS.items():
        sim = thrown(tmp_path, change, "solver.step=5e-5")
        sim.advance_to(0.045)
        assert min(touched(sim)) >= 1.0
        found[form] = sim.net.position, sim.state.bodies.position, sim.view.first_order.copy()
    for form in ("fused", "connectors"):
        for one, other in zip(found[form], found["compiled"], strict=True):
            assert np.abs(one - other).max() < 1e-9, form


@pytest.mark.parametrize("form", ["compiled", "fused"])
def test_a_snapshot_in_mid_contact_repeats_to_the_bit(form: str, tmp_path: Path) -> None:
    def made() -> Simulation:
        return thrown(tmp_path, FORMS[form], "solver.step=5e-5")

    first = made()
    first.advance_to(0.04)
    assert min(touched(first)) >= 1.0
    first.snapshot().save(tmp_path / "here")
    first.advance_to(END)
    known = first.state.arrays()
    other = made()
    for sim in (first, other):
        sim.restore(Snapshot.load(tmp_path / "here"))
        sim.advance_to(END)
        for name, values in sim.state.arrays().items():
            np.testing.assert_array_equal(values, known[name], err_msg=name)


def test_a_start_inside_is_refused(tmp_path: Path) -> None:
    with pytest.raises(exunet.CaseError, match=r"scene.toml:\d+: .*deeper than .* in box"):
        thrown(tmp_path, "bodies.box.position=[0.25, 0.2, 0.0]")

"""A net and bullets on a free box, a solid or a mesh: momentum, energy, order, forms, snapshots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import BACKENDS, THROWN, taken_by_contact, thrown

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.contact.status import status_of
from exunet.integrators.exudyn.model import Model
from exunet.results.course import course_of
from exunet.results.headlines import headlines_of
from exunet.results.measures import dissipation
from exunet.results.taken import stored_over_time
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot
from exunet.studies.spread import spread_of

pytestmark = pytest.mark.slow  # a kernel for each form, compiled in a minute each

Floats = np.ndarray
SHAPES = ("solid", "mesh")
END = 0.06  # s, of contact from 20 ms on


def momenta(sim: Simulation) -> tuple[Floats, Floats, float, float]:
    """Momentum (3,), angular momentum (3,) about the origin, and what both are measured by."""
    state, system = sim.state, sim.start.system
    (body,) = system.bodies
    nodes = slice(0, sim.start.net.n_nodes)
    mass, x, v = system.mass[nodes], state.position[nodes], state.velocity[nodes]
    rigid = state.bodies
    turn = rotation_matrix(rigid.attitude[0])
    own = turn @ (np.array(body.inertia) * rigid.angular_velocity[0])
    push, arm = mass[:, None] * v, np.cross(x, mass[:, None] * v)
    box = body.mass * rigid.velocity[0]
    moment = np.cross(rigid.position[0], box) + own
    scale = np.linalg.norm(push, axis=1).sum(), np.linalg.norm(arm, axis=1).sum()
    return push.sum(axis=0) + box, arm.sum(axis=0) + moment, float(scale[0]), float(scale[1])


def touched(sim: Simulation) -> tuple[float, float]:
    """The most threads and bullets that touched at once."""
    memory = sim.view.memory
    return status_of(memory["contact/threads/box"]).most, status_of(memory["contact/bullets/box"]).most


def energy(sim: Simulation) -> tuple[float, Floats]:
    """All energy [J], with what damping and friction have taken, and these two."""
    now = sim.energy
    return now.kinetic + now.elastic + now.potential, np.array(taken_by_contact(sim))


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_momentum_is_kept_and_energy_is_booked(shape: str, tmp_path: Path) -> None:
    changes, taken = [], np.zeros(2)
    for step in (2e-5, 1e-5):
        sim = thrown(tmp_path, shape, f"solver.step={step}")
        before, (start, _) = momenta(sim), energy(sim)
        sim.advance_to(END)
        after, (end, taken) = momenta(sim), energy(sim)
        assert min(touched(sim)) >= 1.0
        assert sum(touched(sim)) >= 3.0
        assert np.abs(after[0] - before[0]).max() < 1e-12 * before[2]
        assert np.abs(after[1] - before[1]).max() < 1e-10 * before[3]
        changes.append(abs(end + taken.sum() - start) / start)
    assert taken.min() > 1e-5 * start  # both take something, the more does damping
    # First touches are kinks in time: order 1.4 with the solid, 1.2e-7 and 4.4e-8 of the start's energy. The
    # distance from a mesh has kinks of its slope between the points of its grid too.
    assert max(changes) < 2e-6
    if shape == "solid":
        assert changes[1] < 1e-6
        assert changes[1] < 0.6 * changes[0]


@pytest.mark.ci_for("solid")
@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_forms_give_the_same_motion(shape: str, tmp_path: Path) -> None:
    """With friction and its memory, until threads that snap taut make it chaotic."""
    found: dict[str, Any] = {}
    for form, change in BACKENDS.items():
        sim = thrown(tmp_path, shape, change, "solver.step=5e-5")
        sim.advance_to(0.045)
        assert min(touched(sim)) >= 1.0
        found[form] = sim.net.position, sim.state.bodies.position, sim.view.first_order.copy()
    for one, other in zip(found["exudyn"], found["compiled"], strict=True):
        assert np.abs(one - other).max() < 1e-9


@pytest.mark.ci_for("compiled-mesh")
@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("form", ["compiled", "exudyn"])
def test_a_snapshot_in_mid_contact_repeats_to_the_bit(form: str, shape: str, tmp_path: Path) -> None:
    def made() -> Simulation:
        return thrown(tmp_path, shape, BACKENDS[form], "solver.step=5e-5")

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
    assert isinstance(other, exunet.Simulation)


@pytest.mark.ci
@pytest.mark.slow
def test_what_contact_takes_is_dissipated_in_moved_starts_too(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(THROWN)
    case = exunet.load(path, ["time.end=0.1"])
    run, spread = exunet.run(case), spread_of(prepare_case(case), 1)
    taken = dissipation(run)[-1]
    assert taken == run.dissipated[-1] > 1e-4
    assert headlines_of(course_of(run))["dissipated_energy_J"] == taken
    assert headlines_of(spread.plain)["dissipated_energy_J"] == pytest.approx(taken, rel=1e-9)
    # Nothing else takes energy here: both lines of the books add up to all that is dissipated.
    lines = [f"taken_by_contact_{item}_J" for item in ("damping", "friction")]
    ours, theirs = headlines_of(course_of(run)), headlines_of(spread.plain)
    assert [ours[line] for line in lines] == [
        run.states[f"contact/{entry}"].values[-1, 0] for entry in ("damping", "friction")
    ]
    assert sum(ours[line] for line in lines) == pytest.approx(taken, rel=1e-9)
    assert [theirs[line] for line in lines] == pytest.approx([ours[line] for line in lines], rel=1e-9)
    labels = [line.get_label() for line in exunet.figure(run, "energies").axes[0].get_lines()]
    assert {"by damping of contact", "by friction of contact"} < set(labels)
    # Nor does anything else have potential energy: that of contact is all of it, and no curve of its own.
    stored = stored_over_time({name: one.values[:, 0] for name, one in run.states.items()})
    assert stored is not None
    assert stored == pytest.approx(np.asarray(run.potential), rel=1e-9)
    assert stored.max() > 1e-4
    line = "stored_in_contact_J"
    assert ours[line] == stored[-1]
    assert theirs[line] == pytest.approx(ours[line], rel=1e-6)
    assert not {"potential", "stored in contact"} <= set(labels)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["exudyn"])
def test_verlet_asks_once_for_the_forces_of_a_steps_end(tmp_path: Path, form: str) -> None:
    """The engine asks for forces with the velocity of the half step and for rates with that of the end: these
    are those of the half step, as in the compiled loop; with a Runge-Kutta method both are of one stage.
    """
    for method, same in (("VelocityVerlet", True), ("RK44", False)):
        sim = thrown(tmp_path, "solid", BACKENDS[form], f"solver.method={method}", "solver.step=5e-5")
        sim.advance_to(0.022)  # threads and a bullet touch
        (model,) = (part for part in vars(sim._integrator).values() if isinstance(part, Model))
        now, later, forces = model.coordinates(), sim.time + 1.0, np.zeros(model.n_coordinates)
        model.applied.evaluate(later, now.q, now.v, forces)
        asked = model.applied.rates(later, now.q, now.v).copy()
        assert np.abs(asked).min() > 0.0  # damping and friction
        found = model.applied.rates(later, now.q, 1.5 * now.v)
        assert (found == asked).all() == same

"""What compiled code sees of the engine's steps with the fused net, against all states of the connectors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from starts import CASES, model, planar

import exunet
from exunet.backends.compiled.sight import THINNED
from exunet.backends.exudyn.stepper import Stepper
from exunet.backends.protocol import Batch, Extremes
from exunet.bodies.rigid import RigidStates
from exunet.case.casefile import load
from exunet.simulation.preparation import Start, prepare
from exunet.system.states import States

UNTIL = 0.01  # s: the corners of the planar net have pulled their first strings taut
SET = ("initial.packing = 0.999", 'solver = {method = "VelocityVerlet", step = 2e-5}')
ON = ("material_damping", "gravity", "mass_damping")


class Told:
    """An observer that keeps all that it is told."""

    asks_for_elements = True

    def __init__(self) -> None:
        self.batches: list[Batch] = []
        self.extremes: list[Extremes] = []

    def take(self, batch: Batch) -> None:
        self.batches.append(batch)

    def between(self, until: float, extremes: Extremes) -> None:
        self.extremes.append(extremes._replace(of_elements=extremes.of_elements.copy()))

    def changed(self, *_: Any) -> None: ...

    def ends(self, time: float) -> None: ...

    def remembered(self, *_: Any) -> None: ...


def run(start: Start, *, fused: bool, force: Any = None) -> tuple[Told, Stepper]:
    told = Told()
    stepper = Stepper(start.system, start.state, start.plan, told, fused=fused)
    if force is not None:
        stepper.push(force)
    stepper.advance(UNTIL)
    stepper.hand_over()
    return told, stepper


def joined(batches: list[Batch]) -> Batch:
    """One batch of all; each begins with the last state of the one before. None has a body or such states."""
    first, *later = batches
    parts = [(one.time[1:], one.position[1:], one.velocity[1:]) for one in later]
    time, position, velocity = (
        np.concatenate(each)
        for each in zip((first.time, first.position, first.velocity), *parts, strict=True)
    )
    bodies, states, taken = RigidStates.none(len(time)), np.zeros((len(time), 0)), None
    if first.taken is not None:
        taken = np.concatenate([first.taken, *(one.taken[1:] for one in later if one.taken is not None)])
    return Batch(time, position, velocity, bodies, states, taken)


def states_of(start: Start, batch: Batch) -> States:
    return States(start.system, *batch[:4], dict(start.state.memory), batch.first_order)


@pytest.mark.parametrize("method", ["VelocityVerlet", "RK44", "DOPRI5"])
def test_each_step_is_seen_though_few_are_handed_over(method: str) -> None:
    """Energies, tensions and the energy taken out are those that NumPy finds in every state."""
    solver = (
        f'solver = {{method = "{method}", {"tolerance = 1e-8" if method == "DOPRI5" else "step = 2e-5"}}}'
    )
    start = planar(SET[0], solver, on=ON)
    (every, _), (told, stepper) = (run(start, fused=fused) for fused in (False, True))
    all_of_them, few = joined(every.batches), joined(told.batches)
    assert not every.extremes
    assert len(few.time) == 2 + (stepper.counts.steps - 1) // THINNED
    rows = np.abs(all_of_them.time[:, None] - few.time).argmin(axis=0)
    assert np.abs(all_of_them.time[rows] - few.time).max() < 1e-9  # steps are chosen from round-off too
    states, (seen,) = states_of(start, all_of_them)[1:], told.extremes
    # Round-off, which grows little until then: the forms' states differ by less than 1e-9 of their size.
    assert seen.elastic == pytest.approx(states.elastic.max(), rel=1e-6)
    assert seen.kinetic == pytest.approx(states.kinetic.min(), rel=1e-6)
    assert seen.of_elements == pytest.approx(states.tension.max(axis=0), rel=1e-6, abs=1e-9)
    largest = max(one.tension for one in seen.largest)
    assert largest == pytest.approx(states.tension.max(), rel=1e-6)
    assert largest > 0.0
    assert few.taken is not None
    work = np.concatenate([[0.0], np.cumsum(states_of(start, all_of_them).work_taken())])[rows]
    assert few.taken == pytest.approx(work, rel=1e-6, abs=1e-12 * work[-1])
    assert work[-1] > 0.0


def test_the_work_of_forces_from_outside_is_booked() -> None:
    start = planar(*SET)
    force = np.zeros((start.system.blocks.n_points, 3))
    force[3] = 0.5, -0.2, 0.1  # N
    told, _ = run(start, fused=True, force=force)
    (few,) = told.batches
    assert few.taken is not None
    given = force[3] @ (few.position[-1, 3] - few.position[0, 3])
    assert few.taken[-1] == pytest.approx(-given, rel=1e-9)


def test_forces_and_rates_of_one_state_come_of_one_evaluation() -> None:
    """Rates are looked up where forces, memories and state are the same; a number put there tells."""
    case = load(CASES / "capture" / "free_sphere.toml", ["engine={loop = 'exudyn', net = 'fused'}"]).scene
    start = prepare(case)
    made = model(start, "fused")
    applied, blocks, (q, v, _) = made.applied, start.system.blocks, made.coordinates()
    place, out = applied.place, np.zeros(made.n_coordinates)
    rates = slice(blocks.n_v, blocks.n_force)

    def evaluated_anew(time: float, speed: Any) -> bool:
        place.force[rates] = 7.0
        return not (applied.rates(time, q, speed) == 7.0).all()

    assert blocks.n_states > 0
    applied.evaluate(0.5, q, v, out)
    assert not evaluated_anew(0.5, v)
    assert evaluated_anew(0.5, v + 1e-9)
    assert not evaluated_anew(0.5, v + 1e-9)
    assert evaluated_anew(0.6, v)
    applied.push(np.ones((blocks.n_points, 3)))
    assert evaluated_anew(0.6, v)
    applied.accepted(0.6, q, v)
    assert evaluated_anew(0.6, v)
    applied.remember(start.state.memory)
    assert evaluated_anew(0.6, v)


@pytest.mark.parametrize("name", ["verification/hanging", "bodies/tow", "capture/free_sphere"])
def test_points_in_one_node_stand_where_the_points_are(name: str) -> None:
    """With fixed nodes, points on bodies and bodies among them."""
    start = prepare(load(CASES / f"{name}.toml", []).scene)
    one, each = model(start, "fused"), model(start, "connectors")
    assert one.system.systemData.NumberOfNodes() < each.system.systemData.NumberOfNodes()
    assert (one.columns() == each.columns()).all()
    memory = start.state.memory
    found, expected = (m.places.unpack(m.coordinates(), start.state.time, memory) for m in (one, each))
    assert (found.position == expected.position).all()
    assert (found.velocity == expected.velocity).all()


def test_a_simulation_that_goes_back_books_the_same() -> None:
    """What was taken out and seen is part of a snapshot, to the last bit."""
    settings = [
        *SET,
        'engine = {loop = "exudyn", net = "fused"}',
        "effects.material_damping.relaxation_time = 1e-4",
    ]
    sim = exunet.Simulation(CASES / "planar_deployment.toml", settings)
    sim.advance(0.3 * UNTIL)
    here = sim.snapshot()
    sim.advance(UNTIL)
    first = sim.energy, sim.state
    sim.restore(here)
    sim.advance(UNTIL)
    assert sim.energy == first[0]
    assert sim.energy.dissipated > 0.0
    assert (sim.state.position == first[1].position).all()

"""What the compiled loop copies of every step for the conditions of a script is all that these look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.bodies.rigid import RigidStates
from exunet.integrators.compiled.loop import CompiledLoop
from exunet.model.quantities import VALUES, Sample, Sources
from exunet.model.states import States
from exunet.scene.script import HAPPENINGS, QUANTITIES
from exunet.simulation.simulation import Simulation

BEFORE = {"touching": 0.2042}  # [s]: first touched at 0.2047 s
FORM = (
    "engine.backend=compiled",
    "time.end=0.3",
    'closing.winch.commands=[{at=0.0, mode="tension", force=10.0}]',
    "closing.winch.largest_rate=30.0",
)
EJECT = '{name="throw", at=0.05, do="eject"}'
TOW = Path(__file__).parents[1] / "cases" / "missions" / "throw_close_tow.toml"


def watching(condition: str) -> Simulation:
    """The mission, its script ejection and a condition that never holds, its line drawn from 0 s on."""
    script = f'script=[{EJECT}, {{name="never", when="{condition}", do="note"}}]'
    return Simulation(exunet.load(TOW, [script, *FORM]))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*QUANTITIES, *HAPPENINGS])
def test_a_quantity_follows_from_what_is_copied_of_a_step(name: str) -> None:
    """All other entries of the rows are not numbers; the values are those of the whole state, at each step.

    Taken from a run: the line is taut at 0.04 s, and slack when a thread touches the box for the first time.
    """
    simulation = watching(name if name in HAPPENINGS else f"{name} > 1e9")
    loop = simulation._integrator
    assert isinstance(loop, CompiledLoop)
    if name in QUANTITIES:
        simulation.advance_to(BEFORE.get(name, 0.04))
    looks, step = loop._looks, simulation.plan.step
    assert step is not None
    for part in (looks.x, looks.v, looks.reported, looks.mean):
        part[:] = np.nan
    before = simulation.counts.steps
    simulation.advance(10.5 * step)
    rows = simulation.counts.steps - before
    assert looks.at.tolist() == [rows, len(looks.time)]
    assert rows == 11
    quantity = "area" if name == "largest_area" else "touching" if name == "first_contact" else name
    system = simulation.start.system
    sight = Sources.of(system, "box")
    state = simulation.state
    whole = States.of(system, state)
    moving = system.layout.unpack(looks.x[:, :rows].T, looks.v[:, :rows].T)
    moving = moving.completed(system.kinematics, looks.time[:rows], state.memory)
    seen = States(system, looks.time[:rows], *moving[:3], state.memory, moving.first_order)
    now = np.array([[state.memory[one][place] for one, place in sight.tells]])
    mean = looks.mean[:rows] if looks.weights.size else None
    found = VALUES[quantity](sight, Sample(lambda: seen, looks.reported[:rows], mean))
    assert np.isfinite(found).all()
    assert found[-1] == pytest.approx(VALUES[quantity](sight, Sample(lambda: whole, now))[0], rel=1e-13)
    if name in ("closing_tension", "touching"):
        assert len(set(found.tolist())) > 1  # told at each step, not at the last


@pytest.mark.slow
def test_watching_changes_no_step() -> None:
    """Nor is a state handed over for its sake: the same bits, and the same largest values."""
    ours = watching("mouth_diameter < 1e-3")
    plain = Simulation(exunet.load(TOW, [f"script=[{EJECT}]", *FORM]))
    for item in (ours, plain):
        item.advance_to(0.28)
    assert np.array_equal(ours.state.position, plain.state.position)
    assert ours.counts == plain.counts
    assert ours.largest_tension == plain.largest_tension


@pytest.mark.slow
@pytest.mark.parametrize("name", ["range", "area", "mouth_diameter"])
def test_what_was_ejected_is_seen_where_it_flies(name: str) -> None:
    """The bound is what the quantity is at 0.12 s without the condition; from the ejection on it falls until
    then. Points that a body has let go are no longer where the body is.
    """
    plain = Simulation(exunet.load(TOW, [f"script=[{EJECT}]", *FORM]))
    plain.advance_to(0.12)
    state = plain.state
    bodies = RigidStates(*(part[None] for part in state.bodies.parts()))
    points = state.position[None], state.velocity[None]
    whole = States(
        plain.start.system, np.array([0.12]), *points, bodies, state.memory, state.first_order[None]
    )
    look = Sample(lambda: whole, np.zeros((1, 0)))
    bound = float(VALUES[name](Sources.of(plain.start.system, "box"), look)[0])
    ours = watching(f"{name} < {bound!r}")
    ours.advance_to(0.2)
    (told,) = (item for item in ours._monitor.provenance()["script"] if item["entry"] == "never")
    assert told["time_s"] == pytest.approx(0.12, abs=1e-6)


@pytest.mark.slow
def test_steps_that_are_taken_again_have_seen_what_touches() -> None:
    """A stretch of many steps in which a condition comes true is taken again up to there: pairs that had left
    the body by its end touch it again, and have not come unseen.
    """
    again = '{name="again", when="touching > 1", do="note", repeat=true}'
    case = exunet.load(TOW, ["engine.backend=compiled", "time.end=0.4", f"script=[{EJECT}, {again}]"])
    simulation = Simulation(case)
    simulation.advance_to(0.4)  # told as "faster than contact looks for it" before
    assert len(simulation._monitor.provenance()["script"]) > 2

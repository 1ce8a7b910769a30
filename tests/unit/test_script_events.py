"""What the events of a script find between two states, and what the compiled loop copies for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes import CASES
from scipy.interpolate import CubicHermiteSpline
from scripts import NET, SCENE, case_of, entry

from exunet.forces.terms import Seen
from exunet.integrators.compiled.loop import CompiledStepper
from exunet.model.script import (
    ARMED,
    DONE,
    LOCATED_TO,
    RESTING,
    VALUES,
    WAITING,
    WIDTH,
    EndStates,
    EntryState,
    ScriptEvents,
    Sources,
    interpolated,
)
from exunet.model.states import States
from exunet.scene.casefile import load
from exunet.scene.script import HAPPENINGS, QUANTITIES
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.simulation import Simulation

BEGIN, END = 0.3, 0.7  # [s]


def begun(*entries: str, scene: str = SCENE) -> tuple[Start, ScriptEvents]:
    """A scene whose target moves, and the events of its script."""
    start = prepare_case(case_of("".join(entries), scene=scene.replace('motion = "fixed"\n', "")))
    (events,) = (force.switch for force in start.system.forces if isinstance(force.switch, ScriptEvents))
    return start, events


def discrete_state_of(start: Start, events: ScriptEvents, *rows: EntryState) -> np.ndarray:
    seen = [start.system.discrete[name] for name in events.sees]
    return np.concatenate([np.array(rows).ravel(), [0.0], *seen])


ONE = EntryState(ARMED, 0.0, 0.0, 0.0)


def two_states(start: Start, discrete: np.ndarray) -> tuple[Seen, Seen]:
    """The state at the start, and all of it moved and turned a little; with different velocities."""
    x, v = start.system.layout.pack(start.state.moving)
    rng, moved = np.random.default_rng(4), start.system.blocks.centres
    found, speeds = [], (v + rng.normal(size=len(v)) * 0.05, v + rng.normal(size=len(v)) * 0.05)
    speeds[0][:3], speeds[1][:3] = (0.5, 0.2, -1.0), (0.9, -0.4, -2.2)  # of the node
    for time, speed in zip((BEGIN, END), speeds, strict=True):
        place = x + rng.normal(size=len(x)) * 0.01
        if time == END:
            place[:moved] += 0.5 * (END - BEGIN) * (speeds[0] + speeds[1])[:moved]
        place[start.system.blocks.state("tow/wound_up")] = 0.2 + 0.4 * time
        found.append(Seen(np.array([time]), place[None], speed[None], discrete, np.zeros((1, 0))))
    return found[0], found[1]


def between(start: Start, name: str, ends: tuple[Seen, Seen]) -> Callable[[float], float]:
    """A quantity at a time [s] in the step: points and centres by the cubic, all else straight."""
    system, (begin, end) = start.system, ends
    moved = system.blocks.centres
    whole = [
        np.concatenate([item.x[:, :moved] for item in ends]),
        np.concatenate([element.v[:, :moved] for element in ends]),
    ]
    spline = CubicHermiteSpline([BEGIN, END], *whole)

    def value(time: float) -> float:
        part = (time - BEGIN) / (END - BEGIN)
        x, v = ((1.0 - part) * a + part * b for a, b in ((begin.x, end.x), (begin.v, end.v)))
        x[0, :moved], v[0, :moved] = spline(time), spline(time, 1)
        states = States(system, np.array([time]), x, v, system.discrete).completed()
        look = EndStates(lambda: states, np.zeros((1, 0)))
        return float(VALUES[name](Sources.of(system, "target"), look)[0])

    return value


def test_a_cubic_is_itself_within_a_step() -> None:
    """x = (t - 1)^3, with its velocity, from t = 2 s to 2.5 s; what v does not move goes straight."""
    ends = [
        Seen(
            np.array([t]),
            np.array([[(t - 1.0) ** 3, t]]),
            np.array([[3.0 * (t - 1.0) ** 2]]),
            *[np.zeros(0)] * 2,
        )
        for t in (2.0, 2.5)
    ]
    for part in (0.0, 0.3, 1.0):
        t = 2.0 + 0.5 * part
        found = interpolated(ends[0], ends[1], part, 1)
        assert found.time[0] == pytest.approx(t, rel=1e-15)
        assert found.x[0] == pytest.approx([(t - 1.0) ** 3, t], rel=1e-14)
        assert found.v[0] == pytest.approx([3.0 * (t - 1.0) ** 2], rel=1e-14)


@pytest.mark.parametrize("part", [0.2, 0.37, 0.8])
@pytest.mark.parametrize("name", ["range", "relative_speed", "tether_tension"])
def test_where_in_a_step_a_quantity_crosses_its_bound(name: str, part: float) -> None:
    """The bound is what the quantity is there; half of LOCATED_TO before."""
    start, events = begun(entry("never", when=f"{name} > 1e9", do="note"))
    ends = two_states(start, discrete_state_of(start, events, ONE))
    value, when = between(start, name, ends), BEGIN + part * (END - BEGIN)
    first, there, last = value(BEGIN), value(when), value(END)
    assert (first - there) * (last - there) < 0.0  # it crosses
    sign = ">" if last > there else "<"
    _, events = begun(entry("some", when=f"{name} {sign} {there!r}", do="note"))
    found = events.crossing(*ends)
    assert found == pytest.approx(when - 0.5 * LOCATED_TO, abs=0.05 * LOCATED_TO)
    # It does not hold the other way round, nor while it is not looked at.
    _, events = begun(entry("other", when=f"{name} {'<' if sign == '>' else '>'} {there!r}", do="note"))
    assert events.crossing(*ends) is None
    _, events = begun(entry("some", when=f"{name} {sign} {there!r}", do="note"))
    rests = discrete_state_of(start, events, ONE._replace(state=RESTING))
    assert events.crossing(*(end._replace(discrete=rests) for end in ends)) is None


def moving_away(start: Start, discrete: np.ndarray, times: tuple[float, ...], speed: float = 2.0) -> Seen:
    """The node flies from the target along x, 1 m + speed t from it, and all else rests."""
    x, v = start.system.layout.pack(start.state.moving)
    x, v, time = np.tile(x, (len(times), 1)), np.zeros((len(times), len(v))), np.array(times)
    x[:, :3], v[:, 0] = 0.0, speed
    x[:, 0] = 1.0 + speed * time
    return Seen(time, x, v, discrete, np.zeros((len(times), 0)))


def rows_of(steps: Seen) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    return float(steps.time[-1]), steps.x[-1], steps.v[-1], steps.discrete


@pytest.mark.parametrize(
    ("begin", "bound", "known"),
    [
        (0.25, 2.0, 0.5 - 0.5 * LOCATED_TO),  # crossed at 0.5 s
        (0.5 - 0.5 * LOCATED_TO, 2.0, 0.5 + 1.5 * LOCATED_TO),  # too near to the begin of the step
        (0.5 - 1.5 * LOCATED_TO, 2.0, 0.5 - 0.5 * LOCATED_TO),
        (1.0 - 1.5 * LOCATED_TO, 3.0 - LOCATED_TO, 1.0),  # a step that is no longer than twice LOCATED_TO
        (0.5, 2.0, 0.5 + 2.0 * LOCATED_TO),  # just at the bound as the step begins
    ],
)
def test_a_crossing_is_located_just_before_it_or_just_beyond(
    begin: float, bound: float, known: float
) -> None:
    start, events = begun(entry("far", when=f"range > {bound!r}", do="note"))
    discrete = discrete_state_of(start, events, ONE)
    ends = moving_away(start, discrete, (begin,)), moving_away(start, discrete, (1.0,))
    assert events.crossing(*ends) == pytest.approx(known, abs=0.02 * LOCATED_TO)


def test_late_crossings_are_located_to_round_off() -> None:
    """At 1e8 s numbers are 1.5e-8 s apart: to 64 of that."""
    start, events = begun(entry("far", when="range > 1.6e8", do="note"))
    discrete, late = discrete_state_of(start, events, ONE), 64.0 * math.ulp(1e8)
    ends = moving_away(start, discrete, (0.5e8,)), moving_away(start, discrete, (1e8,))
    assert events.crossing(*ends) == pytest.approx(0.8e8 - 0.5 - 0.5 * late, abs=0.2 * late)


def test_the_first_of_several_crossings() -> None:
    start, events = begun(
        entry("later", when="range > 2.4", do="note"),
        entry("first", when="range > 1.8", do="note"),
        entry("none", when="range > 9.0", do="note"),
    )
    discrete = discrete_state_of(start, events, ONE, ONE, ONE)
    ends = moving_away(start, discrete, (0.0,)), moving_away(start, discrete, (1.0,))
    assert events.crossing(*ends) == pytest.approx(0.4 - 0.5 * LOCATED_TO, abs=0.02 * LOCATED_TO)
    assert events.crossed(*rows_of(ends[1])).tolist() == [1]  # of both that hold by then
    assert events.crossed(*rows_of(moving_away(start, discrete, (0.3,)))).tolist() == []
    assert events.crossed(*rows_of(moving_away(start, discrete, (0.5,)))).tolist() == [1]


def test_the_first_step_at_whose_end_a_condition_holds() -> None:
    """Or one that rests does not hold; one that rests and holds, or has happened, is not reported."""
    start, events = begun(
        entry("far", when="range > 2.5", do="note"), entry("near", when="range < 2.5", do="note", repeat=True)
    )
    times = (0.1, 0.3, 0.5, 0.7, 0.76, 0.9)
    far, rests, done = ONE, ONE._replace(state=RESTING), ONE._replace(state=DONE)
    for rows, known in (((far, done), 4), ((done, rests), 4), ((rests, done), 0), ((done, done), None)):
        discrete = discrete_state_of(start, events, *rows)
        assert events.comes_true(moving_away(start, discrete, times)) == known
    discrete = discrete_state_of(start, events, far, done)
    early = moving_away(start, discrete, times[:4])
    assert events.comes_true(early) is None
    assert events.crossed(*rows_of(early)).tolist() == []
    assert events.comes_true(moving_away(start, discrete, (0.3,))) is None
    exactly = moving_away(start, discrete, (0.25, 0.75))  # at the bound it does not hold yet
    assert events.comes_true(exactly) is None
    assert events.in_steps(discrete)
    assert not events.in_steps(discrete_state_of(start, events, done, done))


def test_an_entry_that_repeats_is_not_due_before_it_has_rested() -> None:
    """It has happened at 0.2 s and rests for 0.5 s; from then on it counts again."""
    start, events = begun(entry("far", when="range > 1.2", do="note", repeat=True, rest=0.5))
    discrete = discrete_state_of(start, events, ONE._replace(since=0.2, times=1.0))
    assert events.comes_true(moving_away(start, discrete, (0.3, 0.5, 0.69, 0.7, 0.9))) == 3
    again = discrete_state_of(start, events, ONE._replace(since=0.2))
    assert events.comes_true(moving_away(start, again, (0.3, 0.5, 0.69, 0.71, 0.9))) == 0


def test_when_entries_are_armed() -> None:
    """At their times, so long after others once these have happened; at once without; never till then."""
    start, events = begun(
        entry("at", at=0.8, do="note"),
        entry("soon", after="at", delay=0.25, do="note"),
        entry("late", after="soon", delay=0.5, do="note"),
        entry("now", when="range < 1.0", do="note"),
    )
    wait = ONE._replace(state=WAITING)
    assert events.instants(discrete_state_of(start, events, wait, wait, wait, wait)) == (
        0.8,
        math.inf,
        math.inf,
        0.0,
    )
    done = EntryState(DONE, 0.9, 1.0, 0.0)
    discrete = discrete_state_of(start, events, done, wait, wait, ONE)
    assert events.instants(discrete) == (0.9 + 0.25, math.inf)
    assert events.crossed(*rows_of(moving_away(start, discrete, (1.149,)))).tolist() == []
    assert events.crossed(*rows_of(moving_away(start, discrete, (1.15,)))).tolist() == [1]
    assert not events.stops(discrete)


def changed(start: Start, events: ScriptEvents, discrete: np.ndarray, item: int) -> Any:
    time, x, v, discrete = rows_of(moving_away(start, discrete, (0.75,)))
    every: dict[str, np.ndarray] = dict(start.system.discrete)
    return events.change(time, x, v, discrete, np.array([item]), every)


def test_what_an_event_writes() -> None:
    """State, time, how often, and the quantity then: 2.5 m. A stop ends the run."""
    start, events = begun(
        entry("far", when="range > 2.4", do="note"),
        entry("again", when="range > 2.4", do="note", repeat=True),
        entry("end", at=0.5, do="stop", verdict="over"),
    )
    twice = ONE._replace(times=2.0, since=0.1)
    discrete = discrete_state_of(start, events, ONE._replace(state=WAITING), twice, ONE)
    rows = discrete[: 3 * WIDTH].reshape(3, WIDTH)
    for item, known in (
        (0, (ARMED, 0.75, 0.0, 0.0)),
        (1, (RESTING, 0.75, 3.0, 2.5)),
        (2, (DONE, 0.75, 1.0, 0.0)),
    ):
        change = changed(start, events, discrete, item)
        expected = rows.copy()
        expected[item] = (*known, 0.0)
        np.testing.assert_allclose(change.discrete[: 3 * WIDTH].reshape(3, WIDTH), expected, rtol=1e-15)
        assert change.discrete[3 * WIDTH] == float(item == 2)
        assert change.more == (item != 2)
        assert events.stops(change.discrete) == (item == 2)


def test_the_knots_of_a_thrust_count_from_when_it_was_begun() -> None:
    """Not those of one that waits, nor from other entries."""
    scene = (CASES / "planar_undamped.toml").read_text(encoding="utf-8")
    table = "effects.thrust={bullets=[0],time=[0.0,0.05,0.2],force=[[0,0,1],[0,0,2],[0.5,0,0]]}"
    script = entry("go", at=0.125, do="thrust") + entry("say", at=0.3, do="note")
    start = prepare_case(case_of(script, table, scene=scene))
    (events,) = (force.switch for force in start.system.forces if isinstance(force.switch, ScriptEvents))
    wait, done = ONE._replace(state=WAITING), ONE._replace(state=DONE)
    assert events.instants(discrete_state_of(start, events, wait, done._replace(since=0.1))) == (0.125,)
    discrete = discrete_state_of(start, events, done._replace(since=0.25), wait)
    assert events.instants(discrete) == (0.3, 0.25, 0.25 + 0.05, 0.25 + 0.2)


def grown(start: Start, discrete: np.ndarray, sizes: tuple[float, ...]) -> Seen:
    """The net, flat and so many times as large as in its reference configuration."""
    x, v = start.system.layout.pack(start.state.moving)
    count = 3 * start.net.n_nodes
    every = np.tile(x, (len(sizes), 1))
    every[:, :count] = np.outer(sizes, start.net.reference_position.ravel())
    time = 0.1 + 0.1 * np.arange(len(sizes))
    return Seen(time, every, np.zeros((len(sizes), len(v))), discrete, np.zeros((len(sizes), 0)))


def test_an_area_that_has_fallen_by_a_part_of_the_largest() -> None:
    """3 sqrt(3) m2 at size 1, times its square: 0.83^2 = 0.689 of the largest until then, 0.84^2 = 0.706."""
    script = entry("fallen", when="largest_area", fall=0.3, do="note")
    start = prepare_case(case_of(script, scene=NET))
    (events,) = (force.switch for force in start.system.forces if isinstance(force.switch, ScriptEvents))
    whole, discrete = 3.0 * math.sqrt(3.0), discrete_state_of(start, events, ONE)
    assert events.comes_true(grown(start, discrete, (0.5, 1.0, 0.9, 0.84, 0.83, 0.5))) == 4
    assert events.comes_true(grown(start, discrete, (0.5, 0.45, 0.42, 0.7))) is None
    after = events.remembered(grown(start, discrete, (0.5, 0.9, 0.7)))
    assert after is not None
    np.testing.assert_allclose(after[:4], [ARMED, 0.0, 0.0, 0.81 * whole], rtol=1e-12)
    known = discrete_state_of(start, events, ONE._replace(value=whole))
    assert events.remembered(grown(start, known, (0.5, 0.9, 0.7))) is None
    assert events.comes_true(grown(start, known, (0.9, 0.84, 0.83))) == 2


# What the compiled loop copies of every step is all that the conditions look at

BEFORE = {"touching": 0.2042}  # [s]: first touched at 0.2047 s
FORM = (
    "engine.backend=compiled",
    "time.end=0.3",
    'closing.winch.commands=[{at=0.0, mode="tension", force=10.0}]',
    "closing.winch.largest_rate=30.0",
)
EJECT = '{name="throw", at=0.05, do="eject"}'
TOW = CASES / "missions" / "throw_close_tow.toml"


def watching(condition: str) -> Simulation:
    """The mission, its script ejection and a condition that never holds, its line drawn from 0 s on."""
    script = f'script=[{EJECT}, {{name="never", when="{condition}", do="note"}}]'
    return Simulation(load(TOW, [script, *FORM]))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*QUANTITIES, *HAPPENINGS])
def test_a_quantity_follows_from_what_is_copied_of_a_step(name: str) -> None:
    """All other entries of the rows are not numbers; the values are those of the whole state, at each step.

    Taken from a run: the line is taut at 0.04 s, and slack when a thread touches the box for the first time.
    """
    simulation = watching(name if name in HAPPENINGS else f"{name} > 1e9")
    loop = simulation.run.stepper
    assert isinstance(loop, CompiledStepper)
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
    x, v = looks.x[:, :rows].T, looks.v[:, :rows].T
    seen = States(system, looks.time[:rows], x, v, state.discrete).completed()
    now = np.array([[state.discrete[name][place] for name, place in sight.reports]])
    mean = looks.mean[:rows] if looks.weights.size else None
    found = VALUES[quantity](sight, EndStates(lambda: seen, looks.reported[:rows], mean))
    assert np.isfinite(found).all()
    assert found[-1] == pytest.approx(VALUES[quantity](sight, EndStates(lambda: whole, now))[0], rel=1e-13)
    if name in ("closing_tension", "touching"):
        assert len(set(found.tolist())) > 1  # known at each step, not at the last


@pytest.mark.slow
def test_watching_changes_no_step() -> None:
    """Nor is a state returned for its sake: states, counts and largest values agree bitwise."""
    ours = watching("mouth_diameter < 1e-3")
    plain = Simulation(load(TOW, [f"script=[{EJECT}]", *FORM]))
    for item in (ours, plain):
        item.advance_to(0.28)
    assert np.array_equal(ours.state.position, plain.state.position)
    assert ours.counts == plain.counts
    assert ours.largest_tension == plain.largest_tension


@pytest.mark.slow
@pytest.mark.parametrize("name", ["range", "area", "mouth_diameter"])
def test_what_was_ejected_is_observed_where_it_flies(name: str) -> None:
    """The bound is what the quantity is at 0.12 s without the condition; from the ejection on it falls until
    then. Points that a body has let go are no longer where the body is.
    """
    plain = Simulation(load(TOW, [f"script=[{EJECT}]", *FORM]))
    plain.advance_to(0.12)
    state = plain.state
    whole = States.of(plain.start.system, state)
    look = EndStates(lambda: whole, np.zeros((1, 0)))
    bound = float(VALUES[name](Sources.of(plain.start.system, "box"), look)[0])
    ours = watching(f"{name} < {bound!r}")
    ours.advance_to(0.2)
    (event,) = (item for item in ours.log.events if getattr(item, "entry", "") == "never")
    assert event.time_s == pytest.approx(0.12, abs=1e-6)


@pytest.mark.slow
def test_steps_that_are_taken_again_know_what_touches() -> None:
    """An interval of many steps in which a condition comes true is taken again up to there: pairs that had
    left the body by its end touch it again, and are not refused as faster than the search of contact.
    """
    again = '{name="again", when="touching > 1", do="note", repeat=true}'
    case = load(TOW, ["engine.backend=compiled", "time.end=0.4", f"script=[{EJECT}, {again}]"])
    simulation = Simulation(case)
    simulation.advance_to(0.4)
    assert len(simulation.log.events) > 2

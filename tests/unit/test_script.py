"""Scripts of missions: when their entries happen and what they do, against hand calculations; restarts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from commands import cut_short
from scenes import BACKENDS, CASES, continue_alike, every_backend
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scripts import (
    EA,
    FALL,
    HANGS,
    LIFTS,
    SCENE,
    SECTION,
    SLIDES,
    G,
    case_of,
    entry,
    happened,
    only,
    range_at,
    when_range_is,
)

import exunet
from exunet.base.errors import InputError
from exunet.model import script as script_events
from exunet.model.script import LOCATED_TO
from exunet.net.areas import mouth_area
from exunet.results.store import STORE_FILE, FileStore
from exunet.scene.casefile import parse_case
from exunet.simulation import run as runs
from exunet.simulation.simulation import Simulation

METHODS = {
    "RK44": (),
    "VelocityVerlet": ('solver={method="VelocityVerlet", step=5e-4}',),
    "DOPRI5": ('solver={method="DOPRI5", tolerance=1e-8}',),
}
UNDAMPED = (CASES / "planar_undamped.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize("step", [0.05, 0.37])
def test_a_crossing_is_located_whatever_the_steps(method: tuple[str, ...], step: float) -> None:
    """The run ends there, and its last state is that of the crossing; 1e-6 s is what is promised.

    A crossing is taken up to 2 LOCATED_TO too late; VelocityVerlet is exact for a parabola too.
    """
    script = entry("near", when="range < 1.3", do="stop", verdict="near")
    result = exunet.run(case_of(script, *method, f"time.output_step={step}", scene=FALL))
    exact = when_range_is(1.3)
    assert only(result) == pytest.approx(exact, abs=3.0 * LOCATED_TO)
    (event,) = result.run.script
    assert event.crossed_s == pytest.approx(exact, abs=2.0 * LOCATED_TO)
    assert event.value == pytest.approx(1.3, abs=1e-5)
    assert result.complete
    assert result.time[-1] == only(result)
    assert np.linalg.norm(result.position[-1, 0]) == pytest.approx(event.value, abs=1e-9)


@pytest.mark.slow
def test_a_script_ejects_a_net_as_a_case_does() -> None:
    """At the same time, to the last bit, with the same loads; and when a condition holds."""
    scene = (CASES / "bodies" / "ejection.toml").read_text(encoding="utf-8")
    form = ["engine.backend=compiled", "solver.method=RK44", "time.end=0.15", "time.output_step=0.01"]
    ours = exunet.run(case_of(entry("throw", at=0.05, do="eject"), *form, scene=scene))
    theirs = exunet.run(case_of("", *form, "initial.frame.eject_at=0.05", scene=scene))
    assert happened(ours) == [("throw", 0.05)]
    assert np.array_equal(ours.position, theirs.position)
    carried = [exunet.loads(item, "chaser").carried for item in (ours, theirs)]
    assert carried[0].until == carried[1].until == 0.05
    later = entry("throw", when="time > 0.0612", do="eject")
    (ejected,) = exunet.run(case_of(later, *form, scene=scene)).run.ejections
    assert ejected.time_s == pytest.approx(0.0612, abs=3.0 * LOCATED_TO)


@pytest.mark.slow
@every_backend
def test_a_script_begins_a_thrust(backend: str) -> None:
    """Its knots count from the event on: as a thrust at those times, to round-off of the times of steps."""
    table = "effects.thrust={{bullets=[0],time={0},force=[[0,0,1],[0,0,2],[0.5,0,0]]}}"
    form = ["solver={method='RK44', step=2e-4}", BACKENDS[backend], "time.end=0.3", "time.output_step=0.01"]
    script = entry("go", at=0.125, do="thrust")
    ours = exunet.run(case_of(script, *form, table.format("[0.0,0.05,0.1]"), scene=UNDAMPED))
    theirs = exunet.run(case_of("", *form, table.format("[0.125,0.175,0.225]"), scene=UNDAMPED))
    assert happened(ours) == [("go", 0.125)]
    assert np.abs(ours.position - theirs.position).max() < 1e-12
    assert np.abs(ours.velocity[-1, ours.net.bullet_nodes[0], 2]) > 0.1


@pytest.mark.parametrize("method", ["RK44", "DOPRI5"])
def test_events_come_at_the_same_times_in_both_back_ends(method: str) -> None:
    """Crossings, and entries that follow from them at the same time and later, in one step and in another."""
    script = (
        entry("at_once", after="near", do="note")
        + entry("next", when="range < 1.299", do="brake", on="tow", force=5.0)
        + entry("near", when="range < 1.301", do="lock", on="tow")
        + entry("later", after="near", delay=0.0021, do="note")
        + entry("with_it", after="later", do="note")
    )
    near, following = when_range_is(1.301), when_range_is(1.299)
    for backend in BACKENDS.values():
        result = exunet.run(case_of(script, backend, *METHODS[method], "time.end=0.6"))
        (_, first), (_, again), (_, second), (_, later), (_, last) = events = happened(result)
        assert [name for name, _ in events] == ["near", "at_once", "next", "later", "with_it"]
        assert first == again == pytest.approx(near, abs=3.0 * LOCATED_TO)
        assert second == pytest.approx(following, abs=3.0 * LOCATED_TO)
        assert later == last == first + 0.0021


@pytest.mark.slow_for("exudyn-RK44", "exudyn-VelocityVerlet")
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@every_backend
def test_a_condition_that_must_last(backend: str, method: tuple[str, ...]) -> None:
    """The node is nearer than 1 m from t1 to t2: an entry comes in time, later than that it does not.

    Farther away it is from the start, and again from t2 on; a delay counts from the entry.
    """
    t1, t2 = when_range_is(1.0), float(brentq(lambda t: range_at(t) - 1.0, 0.8, 1.0))
    within = t2 - t1
    script = (
        entry("short", when="range < 1.0", do="note") + f"for = {0.5 * within!r}\n"
        + entry("long", when="range < 1.0", do="note") + f"for = {1.01 * within!r}\n"
        + entry("far", when="range > 1.0", do="note", repeat=True) + "for = 0.05\n"
        + entry("then", after="short", delay=0.02, do="note")
        + entry("never", when="range > 1.0", unless="far", do="note") + "for = 0.06\n"
    )  # fmt: skip
    result = exunet.run(case_of(script, BACKENDS[backend], *method, scene=FALL))
    names = [name for name, _ in happened(result)]
    assert names == ["far", "short", "then", "far"]
    expected = [0.05, t1 + 0.5 * within, t1 + 0.5 * within + 0.02, t2 + 0.05]
    np.testing.assert_allclose([t for _, t in happened(result)], expected, atol=3.0 * LOCATED_TO)
    (event,) = [item for item in result.run.script if item.entry == "short"]
    assert event.crossed_s == pytest.approx(t1, abs=3.0 * LOCATED_TO)


@every_backend
def test_a_snapshot_while_a_condition_lasts(tmp_path: Path, backend: str) -> None:
    script = entry("short", when="range < 1.0", do="note") + "for = 0.1\n"
    case = case_of(script, BACKENDS[backend], *METHODS["DOPRI5"], scene=FALL)
    one, other = Simulation(case), Simulation(case)
    one.advance_to(0.7)  # since 0.639 s
    continue_alike(one, other, 1.0, tmp_path)
    assert one.log.events == other.log.events
    assert len(one.log.events) == 1


def test_a_state_between_two_looks_is_seen() -> None:
    """All 1000 steps are looked at in one go, to 1 s. In between, the node passes the target and is
    nearer than 0.395 m for 14 ms.
    """
    script = entry("past", when="range < 0.395", do="note")
    time = only(exunet.run(case_of(script, "time.output_step=1.0", scene=FALL)))
    assert time == pytest.approx(brentq(lambda t: range_at(t) - 0.395, 0.7, 0.782), abs=3.0 * LOCATED_TO)
    assert range_at(1.0) > 0.395


def test_two_crossings_in_one_step_come_in_their_order() -> None:
    """At 5.8 m/s the ranges of 1.301 m and 1.299 m are 0.35 ms apart, within a step of 1 ms."""
    later = entry("later", when="range < 1.299", do="brake", on="tow", force=5.0)
    sooner = entry("sooner", when="range < 1.301", do="lock", on="tow")
    result = exunet.run(case_of(later + sooner))
    times = [when_range_is(1.301), when_range_is(1.299)]
    assert math.floor(1e3 * times[0]) == math.floor(1e3 * times[1])
    assert happened(result) == [
        ("sooner", pytest.approx(times[0], abs=3.0 * LOCATED_TO)),
        ("later", pytest.approx(times[1], abs=3.0 * LOCATED_TO)),
    ]


def test_what_is_due_at_one_time_comes_in_the_order_of_the_script() -> None:
    """Times, delays, and a condition that holds already when it is looked at first."""
    script = (
        entry("last", after="first", delay=0.1, do="lock", on="tow")
        + entry("first", at=0.2, do="reel", on="tow", rate=0.1)
        + entry("holds", at=0.2, when="range < 50", do="brake", on="tow", force=1.0)
        + entry("begin", at=0.0, do="pay_out", on="tow", rate=0.01)
    )
    result = exunet.run(case_of(script))
    assert happened(result) == [("begin", 0.0), ("first", 0.2), ("holds", 0.2), ("last", 0.2 + 0.1)]


@pytest.mark.slow
@every_backend
def test_a_script_commands_a_reel_as_a_case_does(backend: str) -> None:
    """The same modes and values at the same times give bitwise the same result."""
    script = (
        entry("in", at=0.1, do="reel", on="tow", rate=0.4)
        + entry("pull", at=0.3, do="reel", on="tow", force=2.0)
        + entry("out", at=0.55, do="pay_out", on="tow", rate=0.3)
        + entry("brake", at=0.7, do="brake", on="tow", force=0.5)
        + entry("hold", at=0.9, do="lock", on="tow")
    )
    commands = (
        '{at=0.1, mode="rate", rate=0.4}, {at=0.3, mode="tension", force=2.0}, '
        '{at=0.55, mode="rate", rate=-0.3}, {at=0.7, mode="brake", force=0.5}, {at=0.9, mode="lock"}'
    )
    ours = exunet.run(case_of(script, BACKENDS[backend]))
    theirs = exunet.run(case_of("", BACKENDS[backend], f"tethers.tow.reel.commands=[{commands}]"))
    assert np.array_equal(ours.position, theirs.position)
    wound = [item.states["tow/wound_up"].values[-1, 0] for item in (ours, theirs)]
    assert wound[0] == wound[1] != 0.0


def test_a_restart_in_mid_script_goes_on_to_the_last_bit() -> None:
    script = (
        entry("near", when="range < 2.0", do="reel", on="tow", rate=0.3)
        + entry("then", after="near", delay=0.21, do="lock", on="tow")
        + entry("end", when="range < 0.8", do="stop", verdict="near")
    )
    case = case_of(script)
    one = Simulation(case)
    assert one.log.phase == ""
    one.advance_to(0.5)  # after the first, before the second
    assert one.log.phase == "near"
    held = one.snapshot()
    other = Simulation(case)
    other.restore(held)
    for each in (one, other):
        each.advance_to(0.9)
    assert one.stopped
    assert one.time == other.time == pytest.approx(when_range_is(0.8), abs=3.0 * LOCATED_TO)
    assert one.log.events == other.log.events
    assert [event.entry for event in one.log.events] == ["near", "then", "end"]
    for name, values in one.snapshot().arrays.items():
        assert np.array_equal(values, other.snapshot().arrays[name]), name
    with pytest.raises(InputError, match=r"the script of the case has ended the run at t = 0\.681"):
        one.advance(0.01)
    one.restore(held)
    one.advance_to(0.6)


def test_an_entry_that_another_one_forbids() -> None:
    script = (
        entry("caught", when="range < 2.5", do="note")
        + entry("missed", at=0.6, unless="caught", do="note")
        + entry("far", when="range > 40", unless="caught", do="note")
        + entry("nothing", at=0.7, unless="missed", do="note")
    )
    result = exunet.run(case_of(script, scene=FALL))
    assert [name for name, _ in happened(result)] == ["caught", "nothing"]
    assert sorted(item.entry for item in result.run.script if not item.done) == [
        "far",
        "missed",
    ]


@pytest.mark.slow
def test_a_condition_that_repeats_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node on a thread swings in its field; each time that it is far away the drive is locked again."""
    scene = SCENE.replace("net.nodes = [[0.0, 0.0, 3.0]]", "net.nodes = [[0.0, 0.0, 3.0], [0.4, 0.0, 3.0]]")
    scene = scene.replace("elements = []", "elements = [[0, 1]]\nnet.fixed = [0]")
    scene = scene.replace("masses = [1.0]", "masses = [1.0, 1.0]").replace(
        "[[0.5, 0.0, 0.0]]", "[[0,0,0], [0,0,0]]"
    )
    scene = scene.replace(
        "0.001, density = 1390.0, youngs_modulus = 70e9 }\n",
        "0.001, density = 1390.0, youngs_modulus = 1e9 }\n",
        1,
    )
    script = entry("far", when="range < 2.9", repeat=True, do="lock", on="tow")
    swings = ["time.end=6.0", "time.output_step=0.01"]
    result = exunet.run(case_of(script, *swings, scene=scene))
    centre = result.position[:, :2].mean(axis=1)
    below = np.linalg.norm(centre, axis=1) < 2.9
    expected = result.time[1:][below[1:] & ~below[:-1]]
    times = [time for _, time in happened(result)]
    assert len(times) == len(expected) > 3
    assert np.all((expected - times >= 0.0) & (expected - times < 0.01))
    monkeypatch.setattr(script_events, "MAX_ACTIVATIONS", 2)
    limited = exunet.run(case_of(script, *swings, scene=scene))
    assert [time for _, time in happened(limited)] == times[:2]


TOUCH = """
[effects.contact]
nodes = ["target"]
node_radius = 0.02
law = "linear"
node_stiffness = 1e3
damping = 0.1
"""


def when_they_touch() -> float:
    """The node, of radius 0.02 m and thrown at 0.05 m/s along x, and the ball of 0.1 m [s]."""
    gap = lambda t: math.hypot(0.05 * t, 3.0 - 0.5 * 9.81 * t * t) - 0.12  # noqa: E731
    return float(brentq(gap, 0.0, 0.77, xtol=1e-14))


@pytest.mark.slow
@every_backend
def test_one_contact_has_one_time(backend: str) -> None:
    """The range is 0.121 m some 0.13 ms before they touch, in the same step."""
    script = (
        entry("many", when="touching > 0", do="note")
        + entry("first", when="first_contact", do="note")
        + entry("near", when="range < 0.121", do="note")
    )
    scene = FALL.replace("[[0.5, 0.0, 0.0]]", "[[0.05, 0.0, 0.0]]") + TOUCH
    result = exunet.run(case_of(script, BACKENDS[backend], "time.end=0.77", scene=scene))
    exact, (near, many, first) = when_they_touch(), result.run.script
    assert [element.entry for element in (near, many, first)] == ["near", "many", "first"]
    assert near.crossed_s == pytest.approx(exact, abs=2e-4)
    assert near.crossed_s < exact
    assert many.time_s == first.time_s == many.crossed_s == first.crossed_s
    assert first.time_s == pytest.approx(exact, abs=3.0 * LOCATED_TO)


@pytest.mark.slow
def test_an_entry_that_repeats_rests() -> None:
    """Two entries that switch a drive at one tension do so once in each rest, and again in the next."""
    script = entry(
        "slack", when="tether_tension < 0.1", repeat=True, rest=0.04, do="reel", on="tow", rate=2.0
    )
    script += entry(
        "taut", when="tether_tension > 0.1", repeat=True, rest=0.04, do="brake", on="tow", force=0.0
    )
    result = exunet.run(case_of(script, "time.end=0.3"))
    slack, taut = (
        np.array([t for name, t in happened(result) if name == item]) for item in ("slack", "taut")
    )
    for times in (slack, taut):
        assert len(times) > 4
        assert np.diff(times).min() > 0.04 - 1e-9
        assert np.median(np.diff(times)) < 0.041 + 0.02


@pytest.mark.slow
def test_the_largest_area_is_known_once_it_has_fallen_by_a_part() -> None:
    """Against the stored areas: nowhere before is one that is smaller by 5 % than the largest until then."""
    thrown = exunet.load(
        CASES / "planar_undamped.toml",
        ["solver={method='RK44'}", "engine.backend='compiled'", "time.end=1.5", "time.output_step=1e-4"],
    )
    text = thrown.text + entry("open", when="largest_area", fall=0.05, do="stop", verdict="open")
    result = exunet.run(parse_case(text, thrown.path, thrown.overrides))
    time = only(result)
    area = mouth_area(result.net, result.position)
    fallen = area < 0.95 * np.maximum.accumulate(area)
    assert result.time[-1] == time
    assert not fallen[:-1].any()
    assert area[-1] == pytest.approx(
        0.95 * area.max(), rel=1e-4
    )  # the largest stored may be below the largest


@pytest.mark.ci
@pytest.mark.slow
def test_a_killed_run_goes_on_from_the_checkpoint_of_its_script(tmp_path: Path) -> None:
    """Killed at 0.5 s, after one entry and before the others; resumed from 0.3 s, with the same events."""
    script = (
        entry("save", at=0.3, do="checkpoint")
        + entry("near", when="range < 2.4", do="reel", on="tow", rate=0.3)
        + entry("then", after="near", delay=0.21, do="lock", on="tow")
        + entry("end", when="range < 0.8", do="stop", verdict="near")
    )
    case = case_of(script)
    cut_short(tmp_path, case, 0.5)
    assert FileStore(tmp_path / STORE_FILE).checkpoint is not None
    resumed, whole = runs.resume(tmp_path), exunet.run(case)
    assert np.array_equal(resumed.position[:], whole.position)
    assert resumed.run.script == whole.run.script
    assert [name for name, _ in happened(whole)] == ["save", "near", "then", "end"]


@pytest.mark.slow
@every_backend
def test_a_script_sets_the_factor_of_a_thrust(backend: str) -> None:
    """1 N for 0.1 s, half of it for 0.1 s, then nothing: the net, on which nothing else acts, gets 0.15 N s.

    The work of the thrust is in the energy balance.
    """
    form = [
        "solver={method='RK44', step=2e-4}",
        BACKENDS[backend],
        "time.end=0.3",
        "time.output_step=0.1",
        "effects.thrust={bullets=[0], time=[0.0, 1.0], force=[[0,0,1], [0,0,1]]}",
    ]
    script = entry("half", at=0.1, do="set", on="thrust.factor", value=0.5)
    script += entry("off", at=0.2, do="set", on="thrust.factor", value=0.0)
    result = exunet.run(case_of(script, *form, scene=UNDAMPED))
    assert happened(result) == [("half", 0.1), ("off", 0.2)]
    gained = result.momentum[:, 2] - result.momentum[0, 2]
    np.testing.assert_allclose(gained, [0.0, 0.1, 0.15, 0.15], atol=1e-12)
    balance = result.kinetic + result.elastic + result.dissipated
    assert np.ptp(balance) < 1e-6 * result.kinetic.max()
    assert result.dissipated[-1] < -1e-3  # the work of the thrust, put in


# Parameters that a script sets

SOFT = entry("soft", at=0.3, do="set", on="tow.youngs_modulus", value=0.4 * EA / SECTION)


def tension(length: float, stiffness: float) -> float:
    """Of a tether of 1 m [N]."""
    return max(0.0, 0.5 * stiffness * (length**2 - 1.0) * length)


def falls(t: float, y: np.ndarray, stiffness: float) -> list[float]:
    mass = 1.0 + 0.5 * SECTION  # with half of the tether
    return [y[1], tension(-y[0], stiffness) / mass - G]


@pytest.mark.slow_for("exudyn")
@every_backend
def test_a_tether_becomes_softer_while_it_is_stretched(backend: str) -> None:
    """Against the weight's equation of motion, solved by itself; 0.6 of what the tether stored is lost."""
    result = exunet.run(case_of(SOFT, BACKENDS[backend], scene=HANGS))
    times, precise = result.time, {"rtol": 1e-10, "atol": 1e-12}
    first = solve_ivp(falls, (0.0, 0.3), [-1.0, 0.0], t_eval=times[:16], args=(EA,), **precise)
    after = solve_ivp(falls, (0.3, 0.6), first.y[:, -1], t_eval=times[15:], args=(0.4 * EA,), **precise)
    np.testing.assert_allclose(result.position[:16, 0, 2], first.y[0], atol=1e-7)
    np.testing.assert_allclose(result.position[15:, 0, 2], after.y[0], atol=1e-7)
    balance = result.kinetic + result.elastic + result.potential + result.dissipated
    assert np.ptp(balance) < 1e-8
    (event,) = result.run.script
    stored = 0.5 * EA * (0.5 * (first.y[0, -1] ** 2 - 1.0)) ** 2
    assert event.energy_lost_J == pytest.approx(0.6 * stored, rel=1e-6)
    expected = [tension(-z, 0.4 * EA) for z in result.position[16:, 0, 2]]
    np.testing.assert_allclose(result.tension[16:, 0], expected, rtol=1e-9)


@pytest.mark.slow_for("exudyn")
@every_backend
def test_friction_of_contact_changes(backend: str) -> None:
    """A ball of 1 kg on a table slows down at mu g, with another mu from 0.1 s, and none from 0.2 s on."""
    script = entry("rough", at=0.1, do="set", on="contact.friction", value=0.1)
    script += entry("smooth", at=0.2, do="set", on="contact.friction", value=0.0)
    result = exunet.run(case_of(script, BACKENDS[backend], scene=SLIDES))
    t, speed = result.time, result.velocity[:, 0, 0]
    expected = 1.0 - G * (0.3 * np.minimum(t, 0.1) + 0.1 * np.clip(t - 0.1, 0.0, 0.1))
    # The first 1e-3 s it leans against its anchor: 0.3 g of 1 kg on a spring of 5 kN/m.
    np.testing.assert_allclose(speed, expected, atol=2e-3)
    lost = 0.5 - 0.5 * speed**2
    np.testing.assert_allclose(result.states["contact/friction"].values[:, 0], lost, atol=1e-6)
    balance = result.kinetic + result.potential + result.dissipated
    assert np.ptp(balance) < 1e-6


FINE = ("time.end=0.9", "time.output_step=0.01", "solver.step=1e-4")
LIFT = entry("lift", at=0.05, do="close", force=25.0)


@pytest.mark.slow_for("exudyn")
@every_backend
def test_friction_of_a_closing_line_changes(backend: str) -> None:
    """The tensions beside the ring have the ratio e^(mu pi / 2) while the winch lifts, with mu as it is then.

    Where mu falls, the line slides at once, and friction takes what it stores less; where it grows, nothing
    does. All energy is accounted for.
    """
    script = LIFT + entry("slip", at=0.4, do="set", on="closing.friction", value=0.1)
    script += entry("hold", at=0.6, do="set", on="closing.friction", value=0.2)
    result = exunet.run(case_of(script, BACKENDS[backend], *FINE, scene=LIFTS))
    start, end = (result.states[f"closing/tension_{name}"].values[:, 0] for name in ("start", "end"))
    for until, friction in ((0.395, 0.3), (0.595, 0.1), (0.895, 0.2)):
        late = (result.time > until - 0.1) & (result.time < until)
        np.testing.assert_allclose(start[late] / end[late], math.exp(0.5 * math.pi * friction), rtol=1e-8)
    _, slip, hold = result.run.script
    assert slip.energy_taken_J > 1e-4
    assert hold.energy_taken_J == pytest.approx(0.0, abs=1e-12)
    balance = result.kinetic + result.potential + result.dissipated
    work = result.states["closing/work"].values[-1, 0]
    assert np.ptp(balance) < 1e-6 * work
    lengths = np.array([1.0, -result.position[-1, 2, 2]])  # N^2 L / (2 EA) of each part, nearly
    stored = 0.5 / 1e4 * np.array([start[-1], end[-1]]) ** 2 @ lengths
    assert result.states["closing/elastic"].values[-1, 0] == pytest.approx(stored, rel=5e-3)


def test_what_a_drive_does_goes_on_with_another_force_or_rate() -> None:
    """To the last bit as with a command that has both; setting what it does not have changes nothing."""
    fast = ["bodies.right.velocity=[2.0, 0.0, 0.0]", "tethers.tow.reel.paid_out=3.0"]
    begin = entry("in", at=0.05, do="reel", on="tow", rate=0.4, force=30.0)
    sets = entry("weak", at=0.2, do="set", on="tow.force", value=10.0)
    sets += entry("slow", at=0.3, do="set", on="tow.rate", value=0.1)
    says = entry("weak", at=0.2, do="reel", on="tow", rate=0.4, force=10.0)
    says += entry("slow", at=0.3, do="reel", on="tow", rate=0.1, force=10.0)
    hold = entry("hold", at=0.6, do="lock", on="tow")
    late = entry("late", at=0.7, do="set", on="tow.force", value=1.0)
    note = entry("late", at=0.7, do="note")
    ours, theirs = (
        exunet.run(case_of(begin + item, *fast)) for item in (sets + hold + late, says + hold + note)
    )
    assert np.array_equal(ours.position, theirs.position)
    wound = [element.states["tow/wound_up"].values for element in (ours, theirs)]
    assert np.array_equal(*wound)
    assert wound[0][-1, 0] > 0.1  # m: it has wound up
    assert [name for name, _ in happened(ours)] == ["in", "weak", "slow", "hold", "late"]


@pytest.mark.slow_for("exudyn")
@every_backend
@pytest.mark.parametrize("scene", ["tether", "line"])
def test_a_snapshot_between_goes_on(tmp_path: Path, backend: str, scene: str) -> None:
    slip = LIFT + entry("slip", at=0.2, do="set", on="closing.friction", value=0.1)
    text = HANGS + SOFT if scene == "tether" else LIFTS + slip
    case = parse_case(text, Path("set.toml"), [BACKENDS[backend], *(FINE if scene == "line" else ())])
    one, other = Simulation(case), Simulation(case)
    one.advance_to(0.35)
    continue_alike(one, other, 0.5, tmp_path)

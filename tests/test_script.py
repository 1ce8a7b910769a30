"""Scripts of missions: when their entries happen, against hand calculations; what they do; restarts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import cut_short
from scipy.optimize import brentq

import exunet
from exunet.base.errors import InputError
from exunet.model import script as script_events
from exunet.model.script import LOCATED_TO
from exunet.net.areas import mouth_area
from exunet.results.store import STORE_FILE, FileStore
from exunet.results.summary import summarise
from exunet.results.table import rows
from exunet.scene.casefile import Case, parse_case
from exunet.simulation import run as runs
from exunet.simulation.simulation import Simulation

# A node that falls past a body that stays where it is, and two bodies far away with a reel between them.
SCENE = """
format = 1
title = "A script"
time = { end = 1.0, output_step = 0.05 }
solver = { method = "RK44", step = 1e-3 }
engine.backend = "compiled"
initial.packing = 1.0
initial.node_velocities = [[0.5, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 3.0]]
net.elements = []
net.node_masses = [1.0]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
effects.gravity.acceleration = [0.0, 0.0, -9.81]

[bodies.target]
shape = "sphere"
radius = 0.1
mass = 1.0
motion = "fixed"
[bodies.left]
mass = 2.0
inertia = [0.3, 0.4, 0.5]
position = [0.0, 50.0, 0.0]
[bodies.right]
mass = 3.0
inertia = [0.3, 0.4, 0.5]
position = [3.0, 50.0, 0.0]

[tethers.tow]
diameter = 0.001
density = 1390.0
youngs_modulus = 1e9
length = 3.2
divisions = 2
start = { body = "left" }
end = { body = "right" }
[tethers.tow.reel]
damping = 100.0

[capture]
target = "target"
relative_speed = 1e3
duration = 0.0
"""
FALL = SCENE[: SCENE.index("[tethers.tow]")] + SCENE[SCENE.index("[capture]") :]
BACKENDS = {
    "RK44": (),
    "VelocityVerlet": ('solver={method="VelocityVerlet", step=5e-4}',),
    "DOPRI5": ('solver={method="DOPRI5", tolerance=1e-8}',),
}
EXUDYN = ('engine.backend="exudyn"',)


def case_of(script: str, *overrides: str, scene: str = SCENE) -> Case:
    return parse_case(scene + script, Path("script.toml"), overrides)


def entry(name: str, **keys: Any) -> str:
    """A table of the script; every value as TOML writes it."""
    lines = [f'{key} = "{one}"' if isinstance(one, str) else f"{key} = {one}" for key, one in keys.items()]
    return "\n".join(["[[script]]", f'name = "{name}"', *lines, ""]).replace("True", "true")


def happened(result: exunet.Result) -> list[tuple[str, float]]:
    """Name and time of what was done, in order."""
    return [(item["entry"], item["time_s"]) for item in result.provenance["script"] if item["done"]]


def only(result: exunet.Result) -> float:
    """When the only entry that did anything did it [s]."""
    assert len(happened(result)) == 1
    return happened(result)[0][1]


def range_at(t: float) -> float:
    """Of the node that is thrown at 0.5 m/s along x, from 3 m above, and falls [m]."""
    return math.hypot(0.5 * t, 3.0 - 0.5 * 9.81 * t * t)


def when_range_is(value: float) -> float:
    """On the way down [s]; the node passes the target at some 0.77 s."""
    return float(brentq(lambda t: range_at(t) - value, 0.0, 0.75, xtol=1e-14))


@pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)
@pytest.mark.parametrize("step", [0.05, 0.37])
def test_a_crossing_is_located_whatever_the_steps(form: tuple[str, ...], step: float) -> None:
    """The run ends there, and its last state is that of the crossing; 1e-6 s is what is promised.

    A crossing is taken up to 2 LOCATED_TO too late; VelocityVerlet is exact for a parabola too.
    """
    script = entry("near", when="range < 1.3", do="stop", verdict="near")
    result = exunet.run(case_of(script, *form, f"time.output_step={step}", scene=FALL))
    exact = when_range_is(1.3)
    assert only(result) == pytest.approx(exact, abs=3.0 * LOCATED_TO)
    (event,) = result.provenance["script"]
    assert event["crossed_s"] == pytest.approx(exact, abs=2.0 * LOCATED_TO)
    assert event["value"] == pytest.approx(1.3, abs=1e-5)
    assert result.complete
    assert result.time[-1] == only(result)
    assert np.linalg.norm(result.position[-1, 0]) == pytest.approx(event["value"], abs=1e-9)


@pytest.mark.slow
def test_a_script_ejects_a_net_as_a_case_does() -> None:
    """At the same time, to the last bit, with the same loads; and when a condition holds."""
    scene = (Path(__file__).parents[1] / "cases" / "bodies" / "ejection.toml").read_text(encoding="utf-8")
    form = ["engine.backend=compiled", "solver.method=RK44", "time.end=0.15", "time.output_step=0.01"]
    ours = exunet.run(case_of(entry("throw", at=0.05, do="eject"), *form, scene=scene))
    theirs = exunet.run(case_of("", *form, "initial.frame.eject_at=0.05", scene=scene))
    assert happened(ours) == [("throw", 0.05)]
    assert np.array_equal(ours.position, theirs.position)
    carried = [exunet.loads(item, "chaser").carried for item in (ours, theirs)]
    assert carried[0].until == carried[1].until == 0.05
    later = entry("throw", when="time > 0.0612", do="eject")
    (ejected,) = exunet.run(case_of(later, *form, scene=scene)).provenance["ejection"]
    assert ejected["time_s"] == pytest.approx(0.0612, abs=3.0 * LOCATED_TO)


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["compiled", "exudyn"])
def test_a_script_begins_a_thrust(loop: str) -> None:
    """Its knots count from the event on: as a thrust at those times, to round-off of the times of steps."""
    path = Path(__file__).parents[1] / "cases" / "planar_undamped.toml"
    table = "effects.thrust={{bullets=[0],time={0},force=[[0,0,1],[0,0,2],[0.5,0,0]]}}"
    form = [
        "solver={method='RK44', step=2e-4}",
        f"engine.backend={loop}",
        "time.end=0.3",
        "time.output_step=0.01",
    ]
    scene = path.read_text(encoding="utf-8")
    script = entry("go", at=0.125, do="thrust")
    ours = exunet.run(case_of(script, *form, table.format("[0.0,0.05,0.1]"), scene=scene))
    theirs = exunet.run(case_of("", *form, table.format("[0.125,0.175,0.225]"), scene=scene))
    assert happened(ours) == [("go", 0.125)]
    assert np.abs(ours.position - theirs.position).max() < 1e-12
    assert np.abs(ours.velocity[-1, ours.net.bullet_nodes[0], 2]) > 0.1


@pytest.mark.ci
@pytest.mark.slow
def test_exudyn_acts_at_the_steps_end_and_says_so() -> None:
    """It cannot go back in a step: the time that it tells is interpolated, and the words say that."""
    script = entry("near", when="range < 1.3", do="stop", verdict="near")
    result = exunet.run(case_of(script, *EXUDYN))
    (event,) = result.provenance["script"]
    assert event["crossed_s"] == pytest.approx(when_range_is(1.3), abs=2.0 * LOCATED_TO)
    assert event["time_s"] == pytest.approx(math.ceil(1e3 * when_range_is(1.3)) / 1e3, abs=1e-12)
    told = [words for label, words in rows(summarise(result)) if label == "script"]
    assert sum("interpolated, and acted at the step's end" in words for words in told) == 1
    later, sooner = (
        entry(f"at_{1000 * bound:.0f}", when=f"range < {bound}", do="note") for bound in (1.299, 1.301)
    )
    both = exunet.run(case_of(later + sooner, *EXUDYN, "time.end=0.6"))
    assert [name for name, _ in happened(both)] == ["at_1301", "at_1299"]


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


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@pytest.mark.parametrize("loop", ["compiled", "exudyn"])
def test_a_script_commands_a_reel_as_a_case_does(loop: str) -> None:
    """The same modes and values at the same times give the same bits."""
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
    form = [f'engine.backend="{loop}"']
    case = case_of(script, *form)
    ours = exunet.run(case)
    theirs = exunet.run(case_of("", *form, f"tethers.tow.reel.commands=[{commands}]"))
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
    assert one.monitor.phase == ""
    one.advance_to(0.5)  # after the first, before the second
    assert one.monitor.phase == "near"
    held = one.snapshot()
    other = Simulation(case)
    other.restore(held)
    for each in (one, other):
        each.advance_to(0.9)
    assert one.stopped
    assert one.time == other.time == pytest.approx(when_range_is(0.8), abs=3.0 * LOCATED_TO)
    assert one.monitor.events == other.monitor.events
    assert [event["entry"] for event in one.monitor.events] == ["near", "then", "end"]
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
    told = [item["event"] for item in result.provenance["script"] if not item["done"]]
    assert told == ["not done: caught has happened"] * 2
    summary = summarise(result)["script"]
    assert summary["never"] == ["missed", "far"]
    assert dict(rows(summarise(result)))["script"] == (
        "never reached: missed (t = 0.6 s, unless caught has happened), "
        "far (range > 40, unless caught has happened)"
    )


@pytest.mark.slow
@pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)
def test_a_speed_is_located(form: tuple[str, ...]) -> None:
    """sqrt(0.5^2 + (9.81 t)^2) m/s is 4 m/s at 0.4046 s, in steps that are exact for a parabola."""
    script = entry("fast", when="relative_speed > 4", do="lock", on="tow")
    time = only(exunet.run(case_of(script, *form)))
    assert time == pytest.approx(math.sqrt(16.0 - 0.25) / 9.81, abs=3.0 * LOCATED_TO)


@pytest.mark.slow
def test_a_condition_that_repeats_is_limited_and_that_is_told(monkeypatch: Any) -> None:
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
    assert limited.provenance["script"][-1]["event"] == "disabled after 2 activations"


def test_times_of_conditions_are_told_as_those_of_this_run_alone() -> None:
    """Without moved starts that show how far they are known; those that the case gives are known."""
    alone = "times that the case does not give are of this run only: other runs of it may have others"
    for trigger, of in ({"when": "range < 2.9"}, "this run only"), ({"at": 0.5}, "this run"):
        result = exunet.run(case_of(entry("near", do="note", **trigger)))
        summary = summarise(result)
        assert happened(result)
        assert summary["script"]["of"] == of
        assert (("script", alone) in rows(summary)) == (of == "this run only")


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
@pytest.mark.parametrize("loop", ["compiled", "exudyn"])
def test_one_contact_has_one_time(loop: str) -> None:
    """Located in the compiled loop; told as the end of the step, and as what it is, in Exudyn.

    What is interpolated comes before it: the range is 0.121 m some 0.13 ms before they touch.
    """
    script = (
        entry("many", when="touching > 0", do="note")
        + entry("first", when="first_contact", do="note")
        + entry("near", when="range < 0.121", do="note")
    )
    scene = FALL.replace("[[0.5, 0.0, 0.0]]", "[[0.05, 0.0, 0.0]]") + TOUCH
    result = exunet.run(case_of(script, f'engine.backend="{loop}"', "time.end=0.77", scene=scene))
    exact, (near, many, first) = when_they_touch(), result.provenance["script"]
    assert [element["entry"] for element in (near, many, first)] == ["near", "many", "first"]
    assert near["crossed_s"] == pytest.approx(exact, abs=2e-4)
    assert near["crossed_s"] < exact
    assert many["time_s"] == first["time_s"] == many["crossed_s"] == first["crossed_s"]
    told = [words for name, words in rows(summarise(result)) if name == "script"]
    if loop == "compiled":
        assert first["time_s"] == pytest.approx(exact, abs=3.0 * LOCATED_TO)
        assert not any("came true" in one for one in told)
    else:
        assert first["time_s"] == pytest.approx(math.ceil(1e3 * exact) / 1e3, abs=1e-12)
        assert first["after_s"] == pytest.approx(math.floor(1e3 * exact) / 1e3, abs=1e-12)
        assert "came true at t = 0.76" in told[0]
        assert "interpolated" in told[0]
        for item in told[1:3]:
            assert "came true in the step from t = 0.767 s on, at whose end alone it is known" in item


@pytest.mark.slow
def test_an_entry_that_repeats_rests() -> None:
    """Two that switch a drive to and fro at one tension do so once in each rest, and go on in the next."""
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


def test_what_is_used_up_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(script_events, "MAX_ACTIVATIONS", 3)
    script = entry("slack", when="tether_tension < 0.1", repeat=True, do="reel", on="tow", rate=2.0)
    script += entry("taut", when="tether_tension > 0.1", repeat=True, do="brake", on="tow", force=0.0)
    told = dict(rows(summarise(exunet.run(case_of(script, "time.end=0.1")))))
    assert "happened 3 times, from t = " in told["script: NOTE"]
    assert "and no more: what was asked last stays until the end" in told["script: NOTE"]


def test_what_takes_the_place_of_another_command_or_is_in_vain_is_told() -> None:
    script = (
        entry("lock", at=0.2, do="lock", on="tow")
        + entry("reel", at=0.2, when="range < 50", do="reel", on="tow", rate=0.1)
        + entry("free", at=0.3, do="release", on="tethers.tow.end")
        + entry("more", at=0.4, do="release", on="tethers.tow.end")
        + entry("pull", at=0.5, do="reel", on="tow", rate=0.3)
    )
    result = exunet.run(case_of(script))
    assert [item["event"] for item in result.provenance["script"]] == [
        "lock tow",
        "reel tow at 0.1 m/s; replaces the command of lock at the same time",
        "release tethers.tow.end",
        "release tethers.tow.end; no effect: already released",
        "reel tow at 0.3 m/s; no effect: its end has been released",
    ]


@pytest.mark.slow
def test_the_largest_area_is_known_once_it_has_fallen_by_a_part() -> None:
    """Against the stored areas: nowhere before is one that is smaller by 5 % than the largest until then."""
    thrown = exunet.load(
        Path(__file__).parents[1] / "cases" / "planar_undamped.toml",
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
def test_a_killed_run_goes_on_from_the_checkpoint_that_its_script_asked_for(tmp_path: Path) -> None:
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
    assert resumed.provenance["script"] == whole.provenance["script"]
    assert [name for name, _ in happened(whole)] == ["save", "near", "then", "end"]


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["compiled", "exudyn"])
def test_a_script_sets_the_factor_of_a_thrust(loop: str) -> None:
    """1 N for 0.1 s, half of it for 0.1 s, then nothing: the net, on which nothing else acts, gets 0.15 N s.

    The work of the thrust is in the books.
    """
    path = Path(__file__).parents[1] / "cases" / "planar_undamped.toml"
    form = [
        "solver={method='RK44', step=2e-4}",
        f"engine.backend={loop}",
        "time.end=0.3",
        "time.output_step=0.1",
        "effects.thrust={bullets=[0], time=[0.0, 1.0], force=[[0,0,1], [0,0,1]]}",
    ]
    script = entry("half", at=0.1, do="set", on="thrust.factor", value=0.5)
    script += entry("off", at=0.2, do="set", on="thrust.factor", value=0.0)
    result = exunet.run(case_of(script, *form, scene=path.read_text(encoding="utf-8")))
    assert happened(result) == [("half", 0.1), ("off", 0.2)]
    gained = result.momentum[:, 2] - result.momentum[0, 2]
    np.testing.assert_allclose(gained, [0.0, 0.1, 0.15, 0.15], atol=1e-12)
    balance = result.kinetic + result.elastic + result.dissipated
    assert np.ptp(balance) < 1e-6 * result.kinetic.max()
    assert result.dissipated[-1] < -1e-3  # the work of the thrust, put in

"""Thrust on bullets and the laws of corner units: keys, demands, limits, the clock of samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scenes import BACKENDS, CASES, every_backend

from exunet.base.errors import CaseError
from exunet.forces import corner_units
from exunet.forces.blocks import Blocks, Inertia
from exunet.forces.corner_units import AnyControl, Control, Sensed, UnitLaw, fired, growth_of_error
from exunet.net.arrays import Net
from exunet.scene.casefile import load, parse_case
from exunet.simulation.run import run

PLANAR, UNDAMPED = CASES / "planar_deployment.toml", CASES / "planar_undamped.toml"  # four bullets
GOOD: dict[str, Any] = {"bullets": [0, 3], "time": [0.0, 0.5], "force": [[0, 0, 1], [0, 0, 2]]}


@pytest.mark.parametrize(
    ("changes", "keys"),
    [
        ({}, []),
        ({"bullets": [0, 4, 7]}, ["bullets[1]", "bullets[2]"]),
        ({"bullets": [1, 2, 1]}, ["bullets[2]"]),
        ({"time": [0.5, 0.5]}, ["time[1]"]),
        ({"time": [0.5, 0.2]}, ["time[1]"]),
        ({"time": [0.0, 0.5, 1.0]}, ["force"]),
        (
            {"bullets": [1, 1], "time": [0.5, 0.1], "force": [[0, 0, 1]] * 3},
            ["bullets[1]", "time[1]", "force"],
        ),
    ],
)
def test_faults_between_keys(changes: dict[str, Any], keys: list[str]) -> None:
    text = PLANAR.read_text(encoding="utf-8") + "[effects.thrust]\n"
    text += "".join(f"{key} = {value}\n" for key, value in (GOOD | changes).items())
    found: list[str] = []
    try:
        parse_case(text, PLANAR)
    except CaseError as error:
        found = [fault.key.removeprefix("effects.thrust.") for fault in error.faults]
    assert found == keys


def test_a_net_without_bullets_has_no_thrust() -> None:
    with pytest.raises(CaseError, match=r"effects\.thrust"):
        load(CASES / "verification" / "square_net.toml", [PUSH])


# Two bullets: 1.5 N for 0.05 s, then on average (0.25, 0, 1) N for 0.15 s.
PUSH = "effects.thrust={bullets=[0,2],time=[0.1,0.15,0.3],force=[[0,0,1],[0,0,2.0],[0.5,0,0]]}"
IMPULSE = 2.0 * (np.array([0.0, 0.0, 1.5]) * 0.05 + np.array([0.25, 0.0, 1.0]) * 0.15)


@pytest.mark.slow_for("compiled", "RK44", "VelocityVerlet")
@every_backend
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
def test_thrust_gives_its_impulse_and_its_work_is_booked(backend: str, method: str) -> None:
    """Steps end at the knots, so the impulse of a force linear in time is exact for every method."""
    changes = [PUSH, "time.end=0.4", BACKENDS[backend], f"solver.method={method}"]
    result = run(load(UNDAMPED, changes))
    # 1e4 added steps of round-off
    np.testing.assert_allclose(result.momentum[-1] - result.momentum[0], IMPULSE, rtol=0, atol=1e-13)
    total = result.kinetic + result.elastic + result.dissipated
    assert result.dissipated[-1] < 0.0  # put in
    # As without thrust on this undamped net: 1e-3 J for Verlet, 4e-4 J for RK44.
    assert np.abs(total - total[0]).max() < {"DOPRI5": 1e-6, "RK44": 1e-3, "VelocityVerlet": 3e-3}[method]


@pytest.mark.slow
def test_a_thrust_that_is_over_leaves_the_bare_motion() -> None:
    """On a bullet alone: velocity F T / m, place F T^2 / 2 m after a constant force over T."""
    # The strings are slack until 0.3 s, so the bullet is free.
    push = "effects.thrust={bullets=[1],time=[0.02,0.06],force=[[0,0,3.0],[0,0,3.0]]}"
    changes = [push, "time.end=0.08", "time.output_step=0.01", BACKENDS["compiled"]]
    result = run(load(UNDAMPED, changes))
    bullet = result.net.bullet_nodes[1]
    mass = result.net.mass[bullet]
    late = np.clip(result.time - 0.02, 0.0, 0.04)
    np.testing.assert_allclose(result.velocity[:, bullet, 2], 3.0 * late / mass, rtol=1e-12, atol=1e-15)
    coast = np.clip(result.time - 0.06, 0.0, None)
    way = 3.0 / mass * (0.5 * late**2 + 0.04 * coast)
    np.testing.assert_allclose(result.position[:, bullet, 2], way, rtol=1e-12, atol=1e-15)


RANDOM = np.random.default_rng(12)
PLACE, SPEED = RANDOM.normal(size=(2, 3, 3))
CENTRE, DRIFT = RANDOM.normal(size=(2, 3))
OFFSETS = RANDOM.normal(size=(3, 3))
OFFSETS -= OFFSETS.mean(axis=0)
SENSED = Sensed(0.3, *(item.ravel().tolist() for item in (PLACE, SPEED, CENTRE, DRIFT)))


def control(**given: Any) -> Control:
    numbers = {"bullets": [0, 2, 3], "period": 0.02, "largest_thrust": 1e3, "kind": "given"}
    keys: Control = TypeAdapter(AnyControl).validate_python(numbers | given)
    return keys


@pytest.mark.parametrize("kind", ["point", "body", "offset", "mean", "about"])
def test_a_demand_is_a_spring_and_a_damper_to_the_goal(kind: str) -> None:
    given: dict[str, Any] = {"stiffness": 7.0, "damping": 3.0}
    goal, speed = np.zeros((3, 3)), np.zeros((3, 3))
    if kind == "point":
        given |= {"kind": "point", "point": [0.3, -0.2, 0.9]}
        goal += [0.3, -0.2, 0.9]
    elif kind in ("body", "offset"):
        given |= {"kind": "point", "body": "ball"}
        goal, speed = goal + CENTRE, speed + DRIFT
        if kind == "offset":
            given["offset"] = [0.1, 0.2, -0.4]
            goal += [0.1, 0.2, -0.4]
    else:
        given |= {"kind": "formation", "offsets": OFFSETS.tolist()}
        about = (CENTRE, DRIFT) if kind == "about" else (PLACE.mean(axis=0), SPEED.mean(axis=0))
        goal, speed = OFFSETS + about[0], speed + about[1]
        if kind == "about":
            given["body"] = "ball"
    found = UnitLaw(control(**given)).demanded(SENSED)
    wanted = 7.0 * (goal - PLACE) + 3.0 * (speed - SPEED)
    np.testing.assert_allclose(np.reshape(found, (3, 3)), wanted, rtol=1e-12)


def test_a_table_is_linear_between_its_times_and_nothing_outside() -> None:
    """The first and the last time belong to it."""
    times, forces = [0.1, 0.4, 0.9], RANDOM.normal(size=(3, 3, 3))
    law = UnitLaw(control(kind="table", time=times, force=forces.tolist()))
    for time in (0.1, 0.15, 0.4, 0.5, 0.9):
        found = law.demanded(Sensed(time, *[[0.0] * 9] * 2, *[[0.0] * 3] * 2))
        wanted = [np.interp(time, times, column) for column in forces.reshape(3, 9).T]
        np.testing.assert_allclose(found, wanted, rtol=1e-13)
    for time in (0.0999, 0.9001):
        assert law.demanded(Sensed(time, *[[0.0] * 9] * 2, *[[0.0] * 3] * 2)) == [0.0] * 9
    assert UnitLaw(control()).demanded(SENSED) == [0.0] * 9


@pytest.mark.parametrize("direction", ["any", "flight", "outward"])
def test_what_is_fired_lies_along_the_thrusters_within_their_limits(direction: str) -> None:
    demand = 20.0 * RANDOM.normal(size=(3, 3))
    lines = {"flight": SPEED, "outward": PLACE - PLACE.mean(axis=0)}
    wanted = demand.copy()
    if direction != "any":
        along = lines[direction] / np.linalg.norm(lines[direction], axis=1, keepdims=True)
        wanted = (demand * along).sum(axis=1, keepdims=True) * along
    size = np.linalg.norm(wanted, axis=1)
    least, middle, _ = np.sort(size)
    keys = control(direction=direction, largest_thrust=1.1 * middle, minimum_impulse=0.02 * 1.01 * least)
    wanted[np.argmin(size)] = 0.0
    wanted[np.argmax(size)] *= 1.1 * middle / size.max()
    found = fired(keys, demand.ravel().tolist(), SENSED)
    np.testing.assert_allclose(np.reshape(found, (3, 3)), wanted, rtol=1e-12)


def test_at_its_limits_a_thrust_is_fired_as_it_is() -> None:
    """An impulse that is just the least, and a force that is just the largest: 5 N for 0.25 s."""
    keys = control(period=0.25, largest_thrust=5.0, minimum_impulse=1.25)
    assert fired(keys, [3.0, 4.0, 0.0] * 3, SENSED) == [3.0, 4.0, 0.0] * 3
    more = keys.model_copy(update={"largest_thrust": 4.0})  # 1 N s at most
    assert fired(more, [3.0, 4.0, 0.0] * 3, SENSED) == [0.0] * 9


def test_an_error_grows_as_the_motion_of_a_free_unit_tells() -> None:
    """x + h v + h^2 F / 2m, v + h F / m with F = -k x - c v: both eigenvalues by their polynomial."""
    for k, c in ((40.0, 3.0), (3000.0, 1.0), (40.0, 30.0)):
        keys = control(kind="point", point=[0.0] * 3, stiffness=k, damping=c, period=0.05)
        h, m = 0.05, 0.7
        a, b = 1.0 - 0.5 * h * h * k / m, h - 0.5 * h * h * c / m
        d, e = -h * k / m, 1.0 - h * c / m
        known = np.abs(np.roots([1.0, -(a + e), a * e - b * d])).max()
        assert growth_of_error(keys, m) == pytest.approx(known, rel=1e-12)
    assert growth_of_error(control(), 0.7) is None


def test_the_clock_of_samples() -> None:
    """Not before it begins, at each period once, not after it ends; what acts is kept in between."""
    nothing, none = np.zeros(0), np.zeros(0, dtype=np.int64)
    net = Net(np.zeros((4, 3)), np.ones(4), np.zeros((0, 2), dtype=np.int64), *[nothing] * 4,
              nothing.astype(bool), np.arange(4), none)  # fmt: skip
    keys = control(period=0.25, start=0.5, body="ball", kind="point", stiffness=2.0, damping=1.0)
    inertia = Inertia(np.ones(1), np.ones((1, 3)))
    blocks = Blocks(net, np.zeros((4, 3)), ("ball",), corner_units.states_of(keys), inertia=inertia)
    assert [len(state.initial) for state in blocks.states] == [3, 1]
    assert [item.gives for item in blocks.states] == [0.0, 1.0]
    x, v = RANDOM.normal(size=blocks.n_x), RANDOM.normal(size=blocks.n_v)
    places = np.r_[0:3, 6:12]

    def completed(time: float, x: Any, v: Any, every: Any) -> Any:
        return x, v

    def term(waits: bool) -> Any:
        return corner_units.term_of(keys, blocks, completed, waits=waits, counted=False)

    switch, discrete = term(False).switch, term(False).discrete.initial
    np.testing.assert_array_equal(term(False).data.bullets, [0, 6, 9])
    assert switch.crossed(0.4999, x, v, discrete).tolist() == []
    for sample in range(3):
        due = 0.5 + 0.25 * sample
        assert switch.instants(discrete) == (due,)
        assert switch.crossed(due, x, v, discrete).tolist() == [0]
        discrete = switch.change(due, x, v, discrete, none, {}).discrete
        assert switch.crossed(due, x, v, discrete).tolist() == []
        assert discrete[:4].tolist() == [1.0, 0.5, sample + 1.0, sample + 1.0]
        ball = np.tile(x[12:15], 3), np.tile(v[12:15], 3)
        np.testing.assert_allclose(discrete[4:], 2.0 * (ball[0] - x[places]) + ball[1] - v[places])
    ended = corner_units.released(discrete)
    assert ended.tolist() == [0.0, 0.5, 3.0, 3.0] + [0.0] * 9
    assert switch.instants(ended) == ()
    assert switch.crossed(9.0, x, v, ended).tolist() == []
    again = corner_units.started(ended, 2.0)
    assert again.tolist() == [1.0, 2.0, 0.0, 3.0] + [0.0] * 9
    assert switch.instants(again) == (2.0,)
    alone = control(kind="point", point=[0.3, -0.2, 0.9], stiffness=2.0, damping=1.0)
    there = corner_units.term_of(alone, blocks, completed, waits=False, counted=False)
    seen = there.switch.change(0.0, x, v, there.discrete.initial, none, {}).discrete
    np.testing.assert_allclose(seen[4:], 2.0 * (np.tile([0.3, -0.2, 0.9], 3) - x[places]) - v[places])
    waiting = term(True).discrete.initial
    assert waiting.tolist() == [0.0, 0.5, 0.0, 0.0] + [0.0] * 9

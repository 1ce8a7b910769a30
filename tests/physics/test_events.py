"""Events that change the state, inactive points, inputs and first-order states, by terms of the tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BACKENDS, CASES, PAIR, case_file, continue_alike, every_backend, start_of

import exunet
from exunet.base.run_events import RunEvent
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.cable_term import CableTerm
from exunet.forces.loops import add_no_force
from exunet.forces.terms import Change, DiscreteState, Input, KernelTerm, Switch
from exunet.model.system import System
from exunet.results.io import save
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

Floats = np.ndarray
E, G, HEIGHT = 0.7, 9.81, 0.05  # restitution, m/s2, m
FALL = math.sqrt(2.0 * HEIGHT / G)  # until the first bounce
BOUNCED = FALL * (1.0 + 2.0 * (E + E**2)) + 0.3 * FALL * E**3  # after three bounces
# One free node over the plane z = 0; the other is held far above, on a cable that stays slack.
BOUNCE = f"""
format = 1
title = "A node that bounces"
time = {{ end = {BOUNCED!r}, output_step = 0.02 }}
initial.packing = 1.0
initial.node_positions = [[0.0, 0.0, {HEIGHT}], [0.0, 0.0, 0.5]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
net.elements = [[0, 1]]
net.node_masses = [0.5, 0.5]
net.fixed = [1]
net.cable = {{ diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }}
effects.gravity.acceleration = [0.0, 0.0, {-G}]
"""


class Count(NamedTuple):
    """number : (1,) of events so far; gravity : [m/s2]."""

    number: Floats
    gravity: float = G


def below_plane(t: float, x: Any, v: Any, count: Any) -> float:
    """Height of node 0 below the plane [m] while it falls."""
    return -x[2] if v[2] < 0.0 else -1.0


def step_to_plane(step: float, least: float, x: Any, v: Any, count: Any) -> float:
    """To just beyond the plane, on the parabola."""
    until = (v[2] + math.sqrt(v[2] ** 2 + 2.0 * count.gravity * max(x[2], 0.0))) / count.gravity + least
    return max(least, until) if until < step else step


class Plane(Switch):
    """z of node 0 becomes negative while it falls: the velocity turns round, e times as fast.

    back : from where a step ended beyond the plane, the parabola is followed back to the bounce
    """

    def __init__(self, mass: float, *, back: bool) -> None:
        self._mass, self._back = mass, back

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> np.ndarray:
        return np.flatnonzero([x[2] <= 0.0 and v[2] < 0.0])

    def in_steps(self, discrete: Floats) -> bool:
        return True

    def step_within(self, step: float, least: float, x: Floats, v: Floats, discrete: Floats) -> float:
        return step_to_plane(step, least, x, v, Count(discrete))

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: np.ndarray, _: Any
    ) -> Change:
        x, v = x.copy(), v.copy()
        at = -math.sqrt(v[2] ** 2 + 2.0 * G * x[2]) if self._back else v[2]  # the speed at the plane
        after = (at - v[2]) / G if self._back else 0.0  # s since then
        before = self._mass * (0.5 * v[2] ** 2 + G * x[2])
        v[2] = -E * at - G * after
        x[2] = -E * at * after - 0.5 * G * after**2 if self._back else x[2]
        lost = before - self._mass * (0.5 * v[2] ** 2 + G * x[2])
        return Change(discrete + 1.0, lost, (RunEvent(time_s=time - after, energy_lost_J=lost),), x=x, v=v)


def bouncing(folder: Path, backend: str, *overrides: str, back: bool = False) -> Start:
    def terms(blocks: Blocks) -> Sequence[KernelTerm]:
        discrete = DiscreteState("plane/bounces", np.zeros(1), Count)
        plane, count = Plane(float(blocks.mass[0]), back=back), Count(np.zeros(1))
        events = {"discrete": discrete, "switch": plane, "event": below_plane, "shorten": step_to_plane}
        return (KernelTerm("node", add_no_force, count, **events),)

    return start_of(case_file(folder, BOUNCE), [BACKENDS[backend], *overrides], terms)


def height(time: Floats) -> Floats:
    """The known motion."""
    z, start, speed = np.zeros_like(time), 0.0, G * FALL
    z = HEIGHT - 0.5 * G * time**2
    start = FALL
    while start < BOUNCED:
        speed *= E
        since = time - start
        z = np.where(since > 0.0, speed * since - 0.5 * G * since**2, z)
        start += 2.0 * speed / G
    return z


@pytest.mark.ci_for("compiled-RK44")
@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
@every_backend
def test_heights_times_and_energy_are_known(backend: str, method: str, tmp_path: Path) -> None:
    """All methods follow a parabola exactly; bounces within a step are put where they were."""
    step = "" if method == "DOPRI5" else ", step=1e-3"
    start = bouncing(tmp_path, backend, f"solver={{method='{method}'{step}}}", back=True)
    result = simulate(start)
    assert np.abs(result.position[:, 0, 2] - height(result.time)).max() < 1e-10  # m
    bounces = result.run.events
    known = FALL * np.array([1.0, 1.0 + 2.0 * E, 1.0 + 2.0 * E + 2.0 * E**2])
    np.testing.assert_allclose([bounce.time_s for bounce in bounces], known, rtol=1e-10)
    lost = float(start.system.mass[0]) * G * HEIGHT * (1.0 - E**2)
    np.testing.assert_allclose(
        [item.energy_lost_J for item in bounces], lost * E ** (2.0 * np.arange(3)), rtol=1e-9
    )
    assert result.dissipated[-1] == pytest.approx(sum(entry.energy_lost_J for entry in bounces), rel=1e-12)
    total = result.kinetic + result.elastic + result.potential + result.dissipated
    assert np.abs(total - total[0]).max() < 1e-12


RELEASE = (0.05, 0.1, 0.15)  # s: nodes 2, 3, 4 become active; 5 does not
END, STEP = 0.2, 0.01
# Six nodes along x, 0.1 m apart; the threads between them are stretched by a tenth, so that each pulls
# at once. The first, heavier, flies off.
CHAIN = f"""
format = 1
title = "A chain that is released"
time = {{ end = {END}, output_step = {STEP} }}
initial.packing = 1.1
initial.node_velocities = [[-2.0, 0.0, 0.1], [-1.0, 0.1, 0.0], {", ".join(["[0.0, 0.0, 0.0]"] * 4)}]
net.topology = "explicit"
net.nodes = [{", ".join(f"[{0.1 * k}, 0.0, {0.001 * k * k}]" for k in range(6))}]
net.elements = [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5]]
net.node_masses = [0.5, 0.1, 0.1, 0.1, 0.1, 0.1]
net.cable = {{ diameter = 0.001, density = 1390.0, youngs_modulus = 7e6 }}
"""


class Release(Switch):
    """One node more is active after each of the times."""

    times = RELEASE

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> np.ndarray:
        return np.flatnonzero(np.searchsorted(self.times, time, side="right") > discrete)

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: np.ndarray, _: Any
    ) -> Change:
        number = int(discrete[0]) + 1
        return Change(discrete + 1.0, events=(RunEvent(time_s=time),), active=active(number))


def active(released: int) -> Floats:
    return np.array([1.0] * (2 + released) + [0.0] * (4 - released))


def solver(method: str) -> str:
    return "solver.tolerance=1e-10" if method == "DOPRI5" else f"solver={{method='{method}', step=2e-4}}"


def with_inactive_points(folder: Path, backend: str, method: str) -> Start:
    def terms(blocks: Blocks) -> Sequence[KernelTerm]:
        discrete = DiscreteState("hold/released", np.zeros(1), Count)
        return (KernelTerm("nodes", add_no_force, Count(np.zeros(1)), discrete=discrete, switch=Release()),)

    case = exunet.load(case_file(folder, CHAIN), [BACKENDS[backend], solver(method)])
    return prepare_case(case).with_forces(terms, active=active(0))


def held_by_fixed_nodes(folder: Path, backend: str, method: str) -> tuple[Floats, Floats]:
    """Position and velocity at the stored times: four runs, each from the end of the one before."""
    start = start_of(case_file(folder, CHAIN), [BACKENDS[backend], solver(method)], lambda _: ())
    times, places, speeds = (0.0, *RELEASE, END), [start.position], [start.velocity]
    for number, (begin, end) in enumerate(pairwise(times)):
        net = replace(start.net, fixed_nodes=np.flatnonzero(active(number) == 0.0))
        system = System(
            replace(start.system.blocks, net=net), replace(start.system.forces, cable=CableTerm(net))
        )
        sim = exunet.Simulation(replace(start, system=system).moved(places[-1], speeds[-1]))
        for k in range(round((end - begin) / STEP)):
            sim.advance_to((k + 1) * STEP if k + 1 < round((end - begin) / STEP) else end - begin)
            places.append(sim.state.position)
            speeds.append(sim.state.velocity)
    return np.array(places), np.array(speeds)


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
@every_backend
def test_a_chain_is_released_as_by_fixed_nodes(backend: str, method: str, tmp_path: Path) -> None:
    result = simulate(with_inactive_points(tmp_path, backend, method))
    places, speeds = held_by_fixed_nodes(tmp_path, backend, method)
    allowed = 1e-7 if method == "DOPRI5" else 1e-9  # steps of DOPRI5 are chosen anew after each release
    assert np.abs(result.position - places).max() < allowed
    assert np.abs(result.velocity - speeds).max() < 30.0 * allowed
    assert [item.time_s for item in result.run.events] == pytest.approx(RELEASE, rel=1e-12)
    for node, time in zip((2, 3, 4, 5), (*RELEASE, END), strict=True):
        inactive = result.time <= time
        assert not result.velocity[inactive, node].any()
        assert (result.position[inactive, node] == result.position[0, node]).all()
        assert node == 5 or result.velocity[~inactive, node].any()
    energy = result.kinetic + result.elastic + result.potential + result.dissipated
    off = np.abs(energy - energy[0]).max()
    assert off < (1e-8 if method == "DOPRI5" else 1e-3)  # J of 2 J
    assert np.ptp(result.momentum[:5, 0]) > 0.01  # what holds the chain takes momentum up
    mass = result.net.mass
    np.testing.assert_allclose(result.momentum, np.einsum("n,kna->ka", mass, result.velocity), rtol=1e-12)
    assert (result.largest_elastic >= result.elastic).all()


@pytest.mark.slow_for("compiled")
@every_backend
@pytest.mark.parametrize("cut", [0.04, 0.1])
def test_a_snapshot_continues_to_the_bit(backend: str, cut: float, tmp_path: Path) -> None:
    one, other = (exunet.Simulation(with_inactive_points(tmp_path, backend, "DOPRI5")) for _ in range(2))
    one.advance_to(cut)
    continue_alike(one, other, 0.18, tmp_path)
    one.reset()
    assert one.state.discrete["points/active"].tolist() == active(0).tolist()


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_retry_begins_beyond_the_event(backend: str, tmp_path: Path) -> None:
    """From a state at the time of an event."""
    sim = exunet.Simulation(with_inactive_points(tmp_path, backend, "RK44"))
    sim.advance_to(RELEASE[0])
    assert sim.energy.total > 0.0  # the guards have looked
    assert sim.run.observers.safe.state.time == RELEASE[0]
    assert sim.run.observers.safe.state.discrete["points/active"].tolist() == active(1).tolist()
    assert sim.run.observers.safe.state.discrete["hold/released"] == [1.0]
    assert len(sim.log.events) == 1


def test_points_that_cannot_be_inactive_are_refused(tmp_path: Path) -> None:
    with pytest.raises(exunet.CaseError):
        exunet.Simulation(with_inactive_points(tmp_path, "exudyn", "GeneralizedAlpha"))
    start = with_inactive_points(tmp_path, "compiled", "RK44")
    with pytest.raises(exunet.CaseError):  # those that move
        exunet.Simulation(start.moved(start.position, start.velocity + 1.0))


TAU, FIRST, U = 0.05, 0.3, 2.0  # s, N at the start, N
# Both nodes at rest on a cable that stays slack, so that the node that is pushed is free.
SLACK = PAIR.replace("[1.05, 0.0, 0.0]", "[0.9, 0.0, 0.0]").replace(
    "[-0.5, 0.0, 0.1], [0.5, 0.1, 0.0]", "[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]"
)
FREE_MASS = 0.5


class Filter(NamedTuple):
    """Where the state and its rate stand, node's z, time constant [s], and u (1,) [N]."""

    state: int
    rate: int
    node: int
    tau: float
    u: Floats


def add_filtered(t: float, x: Any, v: Any, low: Any, force: Any) -> None:
    """y on the node, and y' = (u - y) / tau."""
    y = x[low.state]
    force[low.node] += y
    force[low.rate] += (low.u[0] - y) / low.tau


FORCE_INPUT = Input("filter/u", "u", np.array([U]), "N")
STATE = FirstOrder("filter/y", (FIRST,), "N")


def filter_terms(blocks: Blocks) -> Sequence[KernelTerm]:
    data = Filter(blocks.state("filter/y"), blocks.rate("filter/y"), 2, TAU, np.array([U]))
    return (KernelTerm("node", add_filtered, data, inputs=(FORCE_INPUT,)),)


def filtered(folder: Path, backend: str, *overrides: str) -> Start:
    return start_of(case_file(folder, SLACK), [BACKENDS[backend], *overrides], filter_terms, (STATE,))


def filter_response(time: Any, y: float = FIRST, v: float = 0.0, u: float = U) -> tuple[Any, Any]:
    """y and the node's velocity after a time under u."""
    decay = np.exp(-time / TAU)
    return u + (y - u) * decay, v + (u * time + (y - u) * TAU * (1.0 - decay)) / FREE_MASS


def steps_of(name: str, step: float) -> str:
    return f"solver={{method='{name}', step={step}, force=true}}"


@pytest.mark.slow_for("compiled")
@every_backend
def test_the_filter_is_the_known_one(backend: str, tmp_path: Path) -> None:
    start = filtered(tmp_path, backend, "solver.tolerance=1e-10")
    result = simulate(start)
    y, v = filter_response(result.time)
    states = result.states["filter/y"]
    assert states.units == "N"
    assert np.abs(states.values[:, 0] - y).max() < 1e-9
    assert np.abs(result.velocity[:, 0, 2] - v).max() < 1e-9
    np.testing.assert_allclose(result.dissipated, -0.5 * FREE_MASS * v**2, atol=1e-9)  # its work, put in
    save(result, tmp_path / "result.h5")
    read = exunet.load_result(tmp_path / "result.h5").states["filter/y"]
    np.testing.assert_array_equal(read.values, states.values)
    assert read.units == "N"


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("name", ["DOPRI5", "RK44", "VelocityVerlet"])
@every_backend
def test_an_input_changes_between_steps_and_restarts_to_the_bit(
    backend: str, name: str, tmp_path: Path
) -> None:
    solver = "solver.tolerance=1e-10" if name == "DOPRI5" else steps_of(name, 5e-4)
    one, other = (exunet.Simulation(filtered(tmp_path, backend, solver)) for _ in range(2))
    one.advance_to(0.05)
    one.set_input("filter/u", [-1.0])
    one.advance_to(0.1)
    one.snapshot().save(tmp_path / "here")
    other.restore(exunet.Snapshot.load(tmp_path / "here"))
    assert other.inputs["filter/u"] == [-1.0]
    for sim in (one, other):
        sim.advance_to(0.12)
        sim.set_input("filter/u", 0.5)
        sim.advance_to(0.15)
    for key, values in one.state.arrays().items():
        np.testing.assert_array_equal(other.state.arrays()[key], values)
    assert one.energy == other.energy
    y, v = filter_response(0.05)
    y, v = filter_response(0.07, y, v, -1.0)
    y, v = filter_response(0.03, y, v, 0.5)
    allowed = 0.02 if name == "VelocityVerlet" and backend != "compiled" else 1e-4
    assert one.state.first_order[0] == pytest.approx(y, abs=allowed)
    assert one.state.velocity[0, 2] == pytest.approx(v, abs=allowed)
    assert one.energy.dissipated == pytest.approx(-0.5 * FREE_MASS * v**2, abs=10 * allowed)
    one.reset()
    assert (one.inputs["filter/u"], one.state.first_order) == ([U], [FIRST])
    for key, value in (("u", 1.0), ("filter/u", [1.0, 2.0]), ("filter/u", math.nan), ("filter/u", "1")):
        with pytest.raises(exunet.InputError):
            one.set_input(key, value)


class Push(NamedTuple):
    """Node's z, and what pushes it [N]."""

    node: int
    u: Floats


def add_push(t: float, x: Any, v: Any, push: Any, force: Any) -> None:
    force[push.node] += push.u[0]


@pytest.mark.slow
@every_backend
def test_a_retry_repeats_the_inputs(backend: str) -> None:
    """Steps fail at 0.23 s, and a retry goes back to 0.1 s; the impulse is F t anyway."""
    small = ("net.size=2.0", "net.strings.length=1.0", "initial.packing=0.5", "launch.radial_speed=5.0")
    solver = "solver={method='RK44', step=2.3e-4}"

    def pushed(blocks: Blocks) -> Sequence[KernelTerm]:
        zero = np.zeros(1)
        return (KernelTerm("node", add_push, Push(11, zero), inputs=(Input("u", "u", zero, "N"),)),)

    sim = exunet.Simulation(
        start_of(CASES / "planar_undamped.toml", [*small, solver, BACKENDS[backend]], pushed)
    )
    for k in range(1, 31):
        if k in (19, 27):
            sim.set_input("u", 0.5 if k == 19 else 0.0)
        sim.advance_to(0.01 * k)
    state = sim.state
    assert sim.plan.step is not None
    assert sim.plan.step < 2.3e-4  # there was a retry
    momentum = sim.start.system.mass @ state.velocity[:, 2]
    assert momentum == pytest.approx(0.5 * 0.08, rel=1e-9)

"""Inputs from outside and first-order states: a low-pass filtered force y' = (u - y) / tau on a node."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BACKENDS, PAIR, case_file, start_of

import exunet
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.terms import Input, KernelTerm
from exunet.results.io import save
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

Floats = np.ndarray
TAU, FIRST, U = 0.05, 0.3, 2.0  # s, N at the start, N
# Both nodes at rest on a cable that stays slack, so that the node that is pushed is free.
SLACK = PAIR.replace("[1.05, 0.0, 0.0]", "[0.9, 0.0, 0.0]").replace(
    "[-0.5, 0.0, 0.1], [0.5, 0.1, 0.0]", "[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]"
)
MASS = 0.5


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


PUSH = Input("filter/u", "u", np.array([U]), "N")
STATE = FirstOrder("filter/y", (FIRST,), "N")


def terms(blocks: Blocks) -> Sequence[KernelTerm]:
    data = Filter(blocks.state("filter/y"), blocks.rate("filter/y"), 2, TAU, np.array([U]))
    return (KernelTerm("node", add_filtered, data, inputs=(PUSH,)),)


def made(folder: Path, form: str, *overrides: str) -> Start:
    return start_of(case_file(folder, SLACK), [BACKENDS[form], *overrides], terms, (STATE,))


def known(time: Any, y: float = FIRST, v: float = 0.0, u: float = U) -> tuple[Any, Any]:
    """y and the node's velocity after a time under u."""
    decay = np.exp(-time / TAU)
    return u + (y - u) * decay, v + (u * time + (y - u) * TAU * (1.0 - decay)) / MASS


def method(name: str, step: float) -> str:
    return f"solver={{method='{name}', step={step}, force=true}}"


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_the_filter_is_the_known_one(form: str, tmp_path: Path) -> None:
    start = made(tmp_path, form, "solver.tolerance=1e-10")
    result = simulate(start)
    y, v = known(result.time)
    states = result.states["filter/y"]
    assert states.units == "N"
    assert np.abs(states.values[:, 0] - y).max() < 1e-9
    assert np.abs(result.velocity[:, 0, 2] - v).max() < 1e-9
    np.testing.assert_allclose(result.dissipated, -0.5 * MASS * v**2, atol=1e-9)  # its work, put in
    save(result, tmp_path / "result.h5")
    read = exunet.load_result(tmp_path / "result.h5").states["filter/y"]
    np.testing.assert_array_equal(read.values, states.values)
    assert read.units == "N"


ORDERS = [("compiled", "RK44", 4), ("compiled", "VelocityVerlet", 2)]
ORDERS += [("exudyn", "RK44", 4), ("exudyn", "VelocityVerlet", 1), ("exudyn", "ExplicitMidpoint", 2)]


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize(("form", "name", "order"), ORDERS)
def test_methods_have_their_orders(form: str, name: str, order: int, tmp_path: Path) -> None:
    """The engine's Verlet is of order 1 for first-order states (exudyn-facts)."""
    errors = []
    for step in (0.01, 0.005) if order > 1 else (1e-3, 5e-4):
        result = simulate(made(tmp_path, form, method(name, step), "time.output_step=0.15"))
        y, v = known(0.15)
        errors.append(abs(result.states["filter/y"].values[-1, 0] - y) + abs(result.velocity[-1, 0, 2] - v))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25), errors


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("name", ["DOPRI5", "RK44", "VelocityVerlet"])
@pytest.mark.parametrize("form", BACKENDS)
def test_an_input_changes_between_steps_and_restarts_to_the_bit(form: str, name: str, tmp_path: Path) -> None:
    solver = "solver.tolerance=1e-10" if name == "DOPRI5" else method(name, 5e-4)
    one, other = (exunet.Simulation(made(tmp_path, form, solver)) for _ in range(2))
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
    y, v = known(0.05)
    y, v = known(0.05, y, v, -1.0)
    y, v = known(0.02, y, v, -1.0)
    y, v = known(0.03, y, v, 0.5)
    allowed = 0.02 if name == "VelocityVerlet" and form != "compiled" else 1e-4
    assert one.state.first_order[0] == pytest.approx(y, abs=allowed)
    assert one.state.velocity[0, 2] == pytest.approx(v, abs=allowed)
    assert one.energy.dissipated == pytest.approx(-0.5 * MASS * v**2, abs=10 * allowed)
    one.reset()
    assert one.inputs["filter/u"] == [U]
    assert one.state.first_order == [FIRST]


def test_a_wrong_input_is_refused(tmp_path: Path) -> None:
    sim = exunet.Simulation(made(tmp_path, "compiled"))
    for name in ("u", 3, None):
        with pytest.raises(exunet.InputError, match=r"set_input: unknown input .*filter/u"):
            sim.set_input(name, 1.0)  # type: ignore[arg-type]
    for values in ([1.0, 2.0], [], math.nan, "1", None, [[1.0]], True):
        with pytest.raises(exunet.InputError, match="set_input: filter/u must be a finite number, got"):
            sim.set_input("filter/u", values)  # type: ignore[arg-type]
    plain = exunet.Simulation(prepare_case(exunet.load(case_file(tmp_path), [BACKENDS["compiled"]])))
    with pytest.raises(exunet.InputError, match="unknown input 'u'"):
        plain.set_input("u", 1.0)


@pytest.mark.parametrize("form", ["exudyn"])
def test_implicit_methods_refuse_first_order_states(form: str, tmp_path: Path) -> None:
    start = made(tmp_path, form, "solver={method='TrapezoidalIndex2', step=1e-3}")
    with pytest.raises(exunet.CaseError, match=r"TrapezoidalIndex2.*first-order states \(filter/y\)"):
        simulate(start)


class Push(NamedTuple):
    """Node's z, and what pushes it [N]."""

    node: int
    u: Floats


def add_push(t: float, x: Any, v: Any, push: Any, force: Any) -> None:
    force[push.node] += push.u[0]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["exudyn", pytest.param("compiled", marks=pytest.mark.slow)])
def test_a_retry_goes_the_way_of_the_inputs(form: str) -> None:
    """As in test_restart: steps fail at 0.23 s, and a retry goes back to 0.1 s; the impulse is F t anyway."""
    planar = Path(__file__).parents[1] / "cases" / "planar_undamped.toml"
    small = ("net.size=2.0", "net.strings.length=1.0", "initial.packing=0.5", "launch.radial_speed=5.0")
    solver = "solver={method='RK44', step=2.3e-4}"

    def pushed(blocks: Blocks) -> Sequence[KernelTerm]:
        zero = np.zeros(1)
        return (KernelTerm("node", add_push, Push(11, zero), inputs=(Input("u", "u", zero, "N"),)),)

    sim = exunet.Simulation(start_of(planar, [*small, solver, BACKENDS[form]], pushed))
    for k in range(1, 31):
        if k in (19, 27):
            sim.set_input("u", 0.5 if k == 19 else 0.0)
        sim.advance_to(0.01 * k)
    state = sim.state
    assert sim.plan.step is not None
    assert sim.plan.step < 2.3e-4  # there was a retry
    momentum = sim.start.system.mass @ state.velocity[:, 2]
    assert momentum == pytest.approx(0.5 * 0.08, rel=1e-9)

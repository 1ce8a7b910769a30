"""Nodes that sleep and wake: a chain that is released node by node, against one that fixed nodes hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BACKENDS, case_file, continue_alike, start_of

import exunet
from exunet.forces.blocks import Blocks
from exunet.forces.cable_term import CableTerm
from exunet.forces.terms import Change, KernelTerm, Memory
from exunet.model.system import System
from exunet.results.result import Result
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

Floats = np.ndarray
RELEASE = (0.05, 0.1, 0.15)  # s: nodes 2, 3, 4 wake; 5 sleeps on
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


class Nothing(NamedTuple):
    """released : (1,) number so far."""

    released: Floats


def add_no_hold(t: float, x: Any, v: Any, nothing: Any, force: Any) -> None:
    """What holds the chain does so without a force."""


class Release:
    """One node more is awake after each of the times."""

    heading = "releases"
    times = RELEASE

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> np.ndarray:
        return np.flatnonzero(np.searchsorted(self.times, time, side="right") > memory)

    def in_steps(self, memory: Floats) -> bool:
        return False

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        return step

    def change(self, time: float, x: Floats, v: Floats, memory: Floats, items: np.ndarray, _: Any) -> Change:
        number = int(memory[0]) + 1
        return Change(memory + 1.0, events=({"time_s": time, "node": 1 + number},), awake=awake(number))


def awake(released: int) -> Floats:
    return np.array([1.0] * (2 + released) + [0.0] * (4 - released))


def solver(method: str) -> str:
    return "solver.tolerance=1e-10" if method == "DOPRI5" else f"solver={{method='{method}', step=1e-4}}"


def made(folder: Path, form: str, method: str) -> Start:
    def terms(blocks: Blocks) -> Sequence[KernelTerm]:
        memory, nothing = Memory("hold/released", np.zeros(1), Nothing), Nothing(np.zeros(1))
        return (KernelTerm("nodes", add_no_hold, nothing, memory=memory, switch=Release()),)

    case = exunet.load(case_file(folder, CHAIN), [BACKENDS[form], solver(method)])
    return prepare_case(case).with_forces(terms, awake=awake(0))


def held_by_fixed_nodes(folder: Path, form: str, method: str) -> tuple[Floats, Floats]:
    """Position and velocity at the stored times: four runs, each from the end of the one before."""
    start = start_of(case_file(folder, CHAIN), [BACKENDS[form], solver(method)], lambda _: ())
    times, places, speeds = (0.0, *RELEASE, END), [start.position], [start.velocity]
    for number, (begin, end) in enumerate(pairwise(times)):
        net = replace(start.net, fixed_nodes=np.flatnonzero(awake(number) == 0.0))
        system = System(
            replace(start.system.blocks, net=net), replace(start.system.forces, cable=CableTerm(net))
        )
        sim = exunet.Simulation(replace(start, system=system).moved(places[-1], speeds[-1]))
        for k in range(round((end - begin) / STEP)):
            sim.advance_to((k + 1) * STEP if k + 1 < round((end - begin) / STEP) else end - begin)
            places.append(sim.state.position)
            speeds.append(sim.state.velocity)
    return np.array(places), np.array(speeds)


def total(result: Result) -> Floats:
    return result.kinetic + result.elastic + result.potential + result.dissipated


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
@pytest.mark.parametrize("form", ["compiled", "exudyn"])
def test_a_chain_is_released_as_by_fixed_nodes(form: str, method: str, tmp_path: Path) -> None:
    result = simulate(made(tmp_path, form, method))
    places, speeds = held_by_fixed_nodes(tmp_path, form, method)
    allowed = 1e-7 if method == "DOPRI5" else 1e-9  # steps of DOPRI5 are chosen anew after each release
    assert np.abs(result.position - places).max() < allowed
    assert np.abs(result.velocity - speeds).max() < 30.0 * allowed
    assert [item["node"] for item in result.provenance["releases"]] == [2, 3, 4]
    for node, time in zip((2, 3, 4, 5), (*RELEASE, END), strict=True):
        asleep = result.time <= time
        assert not result.velocity[asleep, node].any()
        assert (result.position[asleep, node] == result.position[0, node]).all()
        assert node == 5 or result.velocity[~asleep, node].any()
    off = np.abs(total(result) - total(result)[0]).max()
    assert off < (1e-8 if method == "DOPRI5" else 1e-3)  # J of 2 J
    assert np.ptp(result.momentum[:5, 0]) > 0.01  # what holds the chain takes momentum up
    mass = result.net.mass
    np.testing.assert_allclose(result.momentum, np.einsum("n,kna->ka", mass, result.velocity), rtol=1e-12)
    assert (result.largest_elastic >= result.elastic).all()


@pytest.mark.slow
def test_both_backends_agree(tmp_path: Path) -> None:
    one, other = (simulate(made(tmp_path, form, "RK44")) for form in BACKENDS)
    np.testing.assert_allclose(one.position, other.position, atol=1e-12)
    np.testing.assert_allclose(one.largest_elastic, other.largest_elastic, rtol=1e-9)


def test_elements_between_sleeping_nodes_are_not_computed(tmp_path: Path) -> None:
    """Of five, those at an awake node: what sleeps does not cost."""
    start = made(tmp_path, "compiled", "RK44")
    cable = start.system.forces.cable
    assert [len(cable.data_at({"points/awake": awake(n)})[0].factor) for n in range(4)] == [2, 3, 4, 5]


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", ["compiled", "exudyn"])
@pytest.mark.parametrize("cut", [0.04, 0.1, 0.12])
def test_a_snapshot_continues_to_the_bit(form: str, cut: float, tmp_path: Path) -> None:
    one, other = (exunet.Simulation(made(tmp_path, form, "DOPRI5")) for _ in range(2))
    one.advance_to(cut)
    continue_alike(one, other, 0.18, tmp_path)
    one.reset()
    assert one.state.memory["points/awake"].tolist() == awake(0).tolist()


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", ["compiled", "exudyn"])
def test_a_retry_begins_beyond_the_event(form: str, tmp_path: Path) -> None:
    """From a state that was asked for at the very time of an event."""
    sim = exunet.Simulation(made(tmp_path, form, "RK44"))
    sim.advance_to(RELEASE[0])
    assert sim.energy.total > 0.0  # the guards have looked
    assert sim.monitor.safe.time == RELEASE[0]
    assert sim.monitor.safe.memory["points/awake"].tolist() == awake(1).tolist()
    assert sim.monitor.go_back().memory["hold/released"] == [1.0]
    assert len(sim.monitor.events) == 1


def test_what_cannot_sleep_is_refused(tmp_path: Path) -> None:
    with pytest.raises(exunet.CaseError, match="GeneralizedAlpha does not support points that sleep"):
        exunet.Simulation(made(tmp_path, "exudyn", "GeneralizedAlpha"))
    start = made(tmp_path, "compiled", "RK44")
    with pytest.raises(exunet.CaseError, match="a point that sleeps must be at rest"):
        exunet.Simulation(start.moved(start.position, start.velocity + 1.0))

"""Runs with threads that touch each other: known answers, books, forms, snapshots, what stops a run."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from contact_scenes import BACKENDS, CROSSED, RADIUS, REACH, STIFFNESS, crossing, simulation
from numpy.typing import NDArray
from scipy.optimize import brentq

import exunet
from exunet.base.errors import RunStopped
from exunet.forces.contact.status import Status, status_of
from exunet.results.course import course_of
from exunet.results.headlines import headlines_of
from exunet.results.measures import energy_balance, momentum_books
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]

# A thread that rests across two others, 0.6 m apart, which are held.
RESTING = f"""
format = 1
title = "A thread on two others"
time = {{ end = 2.0, output_step = 0.1 }}
solver = {{ method = "RK44", step = 1e-4 }}
engine.backend = "compiled"
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[-0.3, -0.5, 0], [-0.3, 0.5, 0], [0.3, -0.5, 0], [0.3, 0.5, 0], [-0.5, 0, 0.01], [0.5, 0, 0.01]]
net.elements = [[0, 1], [2, 3], [4, 5]]
net.fixed = [0, 1, 2, 3]
net.cable = {{ diameter = 0.002, density = 1000.0, youngs_modulus = 1e6 }}
effects.self_contact = {{ radius = {RADIUS}, stiffness = {STIFFNESS}, damping = 0.0 }}
effects.gravity.acceleration = [0.0, 0.0, -9.81]
effects.mass_damping.alpha = 60.0
"""


@pytest.mark.slow
def test_restitution_is_that_of_the_law(tmp_path: Path) -> None:
    """Threads that meet side by side at 1 m/s, with e = 0.5 there: speed after over before."""
    keys = "effects.self_contact={radius=0.005,stiffness=1e4,restitution=0.5,impact_speed=1.0}"
    lines = [
        "net.nodes=[[-0.5,0,0],[0.5,0,0],[-0.5,0,0.012],[0.5,0,0.012]]",
        "net.elements=[[0,1],[2,3]]",
        "net.node_masses=[0.01,0.01,0.01,0.01]",
        "initial.node_velocities=[[0,0,1],[0,0,1],[0,0,0],[0,0,0]]",
    ]
    sim = simulation(tmp_path, CROSSED, keys, *lines, "solver.step=1e-5", "engine.backend=exudyn")
    sim.advance_to(0.05)
    v = sim.net.velocity[:, 2]
    assert v[2] - v[0] == pytest.approx(0.5, abs=1e-4)
    assert v[0] + v[2] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.slow
def test_a_thread_rests_on_two_others_as_by_hand(tmp_path: Path) -> None:
    """Half of its weight on each, at right angles: the distance of the axes follows from `crossing`."""
    sim = simulation(tmp_path, RESTING)
    sim.advance_to(1.5)
    weight = 9.81 * sim.start.net.mass[4:].sum()
    apart = brentq(lambda d: 2 * crossing(d, math.pi / 2) - weight, 0.6 * REACH, REACH, xtol=1e-15)
    assert REACH - apart > 0.01 * REACH  # pressed in by more than a hundredth
    assert sim.net.position[4:, 2] == pytest.approx(apart, rel=1e-8)


def momenta(sim: Simulation) -> tuple[Floats, Floats]:
    mass, x, v = sim.start.net.mass[:, None], sim.net.position, sim.net.velocity
    return (mass * v).sum(axis=0), np.cross(x, mass * v).sum(axis=0)


def known(sim: Simulation) -> Status:
    return status_of(sim.view.memory["self_contact/threads"])


@pytest.mark.ci
@pytest.mark.slow
def test_momentum_is_kept_and_energy_is_booked(tmp_path: Path) -> None:
    for damping in (0.0, 0.5):
        errors = []
        for step in (2e-4, 5e-5):
            sim = simulation(
                tmp_path, CROSSED, f"solver.step={step}", f"effects.self_contact.damping={damping}"
            )
            before, start = momenta(sim), sim.energy.total
            sim.advance_to(0.015)
            assert known(sim).stored == pytest.approx(sim.energy.potential, rel=1e-9)
            assert known(sim).stored > 1e-4
            sim.advance_to(0.03)
            assert known(sim).touching == 0.0  # they have parted again
            assert known(sim).most >= 1.0
            for one, other in zip(momenta(sim), before, strict=True):
                assert np.abs(one - other).max() < 1e-12 * 0.02  # kg m/s; the largest is 0.015
            taken = float(sim.view.first_order[0])
            assert (taken > 1e-5) == (damping > 0.0)
            now = sim.energy
            errors.append(abs(now.kinetic + now.elastic + now.potential + taken - start) / start)
        # 2e-6 and 4e-9, damped 1.4e-6 and 3e-8: order 4, or 3 with the kinks where threads part.
        assert errors[1] < 1e-7
        assert errors[1] < errors[0] / 4**2


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("form", ["compiled", "exudyn"])
def test_a_thread_that_bounces_between_two_others_goes_on(form: str, damping: float, tmp_path: Path) -> None:
    """No guard stops it, and its books close: light, it hits them off their middles, 12 mm from both."""
    path = tmp_path / "scene.toml"
    path.write_text(CROSSED)
    changes = (
        "net.nodes=[[-0.5,0,0],[0.5,0,0],[0.05,-0.5,0.012],[0.1,0.5,0.012],[-0.1,-0.5,-0.012],[0,0.5,-0.012]]",
        "net.elements=[[0,1],[2,3],[4,5]]",
        "net.node_masses=[0.01,0.012,1.0,1.2,1.4,1.0]",
        "initial.node_velocities=[[0,0,0.4],[0,0,0.5],[0,0,0],[0,0,0],[0,0,0],[0,0,0]]",
        f"effects.self_contact={{radius={RADIUS},stiffness={100 * STIFFNESS},damping={damping}}}",
        "solver={tolerance=1e-10}",
        "time={end=0.1,output_step=1e-3}",
    )
    result = exunet.run(exunet.load(path, [BACKENDS[form], *changes]))
    assert result.complete
    upwards = result.velocity[:, :2, 2].mean(axis=1) > 0.0
    assert np.count_nonzero(upwards[1:] != upwards[:-1]) >= 4  # it turns round at each bounce
    assert energy_balance(result) < 2e-6  # 3e-8 to 5e-7
    assert (result.dissipated[-1] > 0.4 * result.kinetic[0]) == (damping > 0.0)
    for book in momentum_books(result).values():
        assert book.residual < 1e-14 * book.size


@pytest.mark.slow
def test_forms_agree_over_a_run(tmp_path: Path) -> None:
    found = {}
    for form, change in BACKENDS.items():
        sim = simulation(tmp_path, CROSSED, change, "effects.self_contact.damping=0.5")
        sim.advance_to(0.0075)
        assert known(sim).touching >= 1.0
        found[form] = sim.net.position, sim.net.velocity, sim.view.first_order.copy()
    for one, other in zip(found["exudyn"], found["compiled"], strict=True):
        assert np.abs(one - other).max() < 1e-12  # m, m/s, J: round-off of 75 steps


@pytest.mark.slow
@pytest.mark.parametrize("form", ["compiled", "exudyn"])
def test_a_snapshot_in_mid_contact_repeats_to_the_bit(form: str, tmp_path: Path) -> None:
    def made() -> Simulation:
        return simulation(tmp_path, CROSSED, BACKENDS[form], "effects.self_contact.damping=0.5")

    first = made()
    first.advance_to(0.0075)
    assert known(first).touching >= 1.0
    first.snapshot().save(tmp_path / "here")
    first.advance_to(0.02)
    later = first.state.arrays()
    for sim in (first, made()):
        sim.restore(Snapshot.load(tmp_path / "here"))
        sim.advance_to(0.02)
        for name, values in sim.state.arrays().items():
            np.testing.assert_array_equal(values, later[name], err_msg=name)


@pytest.mark.slow
def test_headlines_tell_depth_and_force(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(CROSSED)
    result = exunet.run(exunet.load(path, ["time.end=0.03", "time.output_step=1e-4"]))
    found = headlines_of(course_of(result))
    assert 0.004 < found["self_contact_first_s"] < 0.0042  # 2 mm at some 0.49 m/s, where they cross
    depth = found["self_contact_deepest_m"]
    assert found["self_contact_most_touching"] >= 1.0
    # By hand at the least distance, each step being stored; bent threads touch a little longer.
    by_hand = crossing(REACH - depth, math.atan2(0.501, 0.01))
    assert found["self_contact_largest_force_N"] == pytest.approx(by_hand, rel=0.1)


FAST = "initial.node_velocities=[[0,0,{0}],[0,0,{0}],[0,0,{0}],[0,0,0],[0,0,0],[0,0,0]]"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed", "words"),
    [
        (3.0, r"the axes of elements 1 and \d are nearer than 0\.00577 m at t = 0\.00\d+ s"),
        (300.0, r"elements 1 and \d have passed through each other in the step that ends at t = 0\.0001 s"),
    ],
)
def test_what_passes_through_stops_the_run(speed: float, words: str, tmp_path: Path) -> None:
    sim = simulation(tmp_path, CROSSED, FAST.format(speed), "engine.backend=exudyn")
    with pytest.raises(RunStopped, match=words + r".* Give a larger effects\.self_contact\.stiffness"):
        sim.advance_to(0.02)

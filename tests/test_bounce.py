"""An event that changes the state: a node that bounces on a plane with a restitution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scenes import BACKENDS, case_file, start_of

import exunet
from exunet.forces.blocks import Blocks
from exunet.forces.terms import Change, KernelTerm, Memory
from exunet.simulation.preparation import Start
from exunet.simulation.run import simulate

Floats = np.ndarray
E, G, HEIGHT = 0.7, 9.81, 0.05  # restitution, m/s2, m
FALL = math.sqrt(2.0 * HEIGHT / G)  # until the first bounce
END = FALL * (1.0 + 2.0 * (E + E**2)) + 0.3 * FALL * E**3  # after three bounces
# One free node over the plane z = 0; the other is held far above, on a cable that stays slack.
SCENE = f"""
format = 1
title = "A node that bounces"
time = {{ end = {END!r}, output_step = 0.02 }}
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


class Nothing(NamedTuple):
    """bounces : (1,) number so far."""

    bounces: Floats


def add_no_force(t: float, x: Any, v: Any, nothing: Any, force: Any) -> None:
    """The plane acts by its events alone."""


class Plane:
    """z of node 0 becomes negative while it falls: the velocity turns round, e times as fast.

    back : from where a step ended beyond the plane, the parabola is followed back to the bounce
    """

    heading = "bounces"
    times: tuple[float, ...] = ()

    def __init__(self, mass: float, *, back: bool) -> None:
        self._mass, self._back = mass, back

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> np.ndarray:
        return np.flatnonzero([x[2] <= 0.0 and v[2] < 0.0])

    def in_steps(self, memory: Floats) -> bool:
        return True

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """To just beyond the plane, on the parabola."""
        until = (v[2] + math.sqrt(v[2] ** 2 + 2.0 * G * max(x[2], 0.0))) / G + least
        return max(least, until) if until < step else step

    def change(self, time: float, x: Floats, v: Floats, memory: Floats, items: np.ndarray, _: Any) -> Change:
        x, v = x.copy(), v.copy()
        at = -math.sqrt(v[2] ** 2 + 2.0 * G * x[2]) if self._back else v[2]  # the speed at the plane
        after = (at - v[2]) / G if self._back else 0.0  # s since then
        before = self._mass * (0.5 * v[2] ** 2 + G * x[2])
        v[2] = -E * at - G * after
        x[2] = -E * at * after - 0.5 * G * after**2 if self._back else x[2]
        lost = before - self._mass * (0.5 * v[2] ** 2 + G * x[2])
        return Change(memory + 1.0, lost, ({"time_s": time - after, "energy_J": lost},), x=x, v=v)


def made(folder: Path, form: str, *overrides: str, back: bool = False) -> Start:
    def terms(blocks: Blocks) -> Sequence[KernelTerm]:
        memory = Memory("plane/bounces", np.zeros(1), Nothing)
        plane = Plane(float(blocks.mass[0]), back=back)
        return (KernelTerm("node", add_no_force, Nothing(np.zeros(1)), memory=memory, switch=plane),)

    return start_of(case_file(folder, SCENE), [BACKENDS[form], *overrides], terms)


def height(time: Floats) -> Floats:
    """The known motion."""
    z, start, speed = np.zeros_like(time), 0.0, G * FALL
    z = HEIGHT - 0.5 * G * time**2
    start = FALL
    while start < END:
        speed *= E
        since = time - start
        z = np.where(since > 0.0, speed * since - 0.5 * G * since**2, z)
        start += 2.0 * speed / G
    return z


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
@pytest.mark.parametrize("form", BACKENDS)
def test_heights_times_and_energy_are_known(form: str, method: str, tmp_path: Path) -> None:
    """All methods follow a parabola exactly; bounces within a step are put where they were."""
    step = "" if method == "DOPRI5" else ", step=1e-3"
    start = made(tmp_path, form, f"solver={{method='{method}'{step}}}", back=True)
    result = simulate(start)
    assert np.abs(result.position[:, 0, 2] - height(result.time)).max() < 1e-10  # m
    bounces = result.provenance["bounces"]
    known = FALL * np.array([1.0, 1.0 + 2.0 * E, 1.0 + 2.0 * E + 2.0 * E**2])
    np.testing.assert_allclose([bounce["time_s"] for bounce in bounces], known, rtol=1e-10)
    lost = float(start.system.mass[0]) * G * HEIGHT * (1.0 - E**2)
    np.testing.assert_allclose(
        [item["energy_J"] for item in bounces], lost * E ** (2.0 * np.arange(3)), rtol=1e-9
    )
    assert result.dissipated[-1] == pytest.approx(sum(entry["energy_J"] for entry in bounces), rel=1e-12)
    total = result.kinetic + result.elastic + result.potential + result.dissipated
    assert np.abs(total - total[0]).max() < 1e-12


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("form", BACKENDS)
def test_adaptive_steps_end_at_the_bounce(form: str, tmp_path: Path) -> None:
    """Without following the parabola back: `step_within` makes the step end 1e-8 s beyond, at 1 m/s."""
    result = simulate(made(tmp_path, form, "solver.method=DOPRI5"))
    assert np.abs(result.position[:, 0, 2] - height(result.time)).max() < 3e-7


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
@pytest.mark.parametrize("form", BACKENDS)
def test_a_snapshot_around_a_bounce_continues_to_the_bit(form: str, method: str, tmp_path: Path) -> None:
    step = "" if method == "DOPRI5" else ", step=1e-3"
    solver = f"solver={{method='{method}'{step}}}"
    for cut in (0.9 * FALL, 1.05 * FALL):
        one, other = (exunet.Simulation(made(tmp_path, form, solver)) for _ in range(2))
        one.advance_to(cut)
        one.snapshot().save(tmp_path / "here")
        other.restore(exunet.Snapshot.load(tmp_path / "here"))
        for sim in (one, other):
            sim.advance_to(1.5 * FALL)
        for name, values in one.state.arrays().items():
            np.testing.assert_array_equal(other.state.arrays()[name], values)
        assert one.energy == other.energy

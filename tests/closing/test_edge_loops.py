"""The loops of threads that become shorter, as Python: forces, energy, work, bounds, instants."""

from __future__ import annotations

import numpy as np
import pytest

from exunet.forces import perimeter
from exunet.forces.blocks import Blocks
from exunet.forces.cable import Law
from exunet.net.arrays import Net
from exunet.net.closing import Perimeter

Floats = np.ndarray
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
LENGTH = np.array([0.8, 0.9, 1.1, 1.3, 1.0])
STIFFNESS = np.array([30.0, 50.0, 70.0, 20.0, 40.0])


def edge(
    mass: Floats, law: Law, elements: tuple[int, ...] = (3, 0, 1), **given: float
) -> perimeter.Shortening:
    """Some elements of a small net, which begin to become shorter at 0.1 s, by 2 / s, down to 0.6."""
    n = len(mass)
    nothing = np.zeros(0, dtype=np.int64)
    net = Net(np.zeros((n, 3)), mass, ENDS, LENGTH, STIFFNESS, STIFFNESS, STIFFNESS,
              np.zeros(5, dtype=bool), nothing, nothing)  # fmt: skip
    one = Perimeter(elements, **({"at": 0.1, "rate": 2.0, "part": 0.6} | given))
    return perimeter.Shortening(one, Blocks.of(net, np.zeros((n, 3)), (), (), perimeter.states_of(one)), law)


@pytest.mark.parametrize("time", [None, 0.02])
def test_force_work_and_energy(time: float | None) -> None:
    """-dU/dx on the nodes, the power of what shortens, by differences; what is left is what viscosity takes.

    Each thread pulls by EA (e + tau de/dt) lambda, and not at all where it is slack.
    """
    random = np.random.default_rng(4)
    law = Law(LENGTH, STIFFNESS, None if time is None else np.full(5, time))
    one = edge(np.full(4, 0.5), law)
    assert one.elements == (3, 0, 1)
    data, taut = one.data(np.ones(1)), 0
    assert one.data(np.zeros(1)).falls == one.data(np.full(1, 2.0)).falls == 0.0
    for _ in range(4):
        x = np.append(random.normal(scale=0.5, size=12), [0.8, 0.0])
        v, force = random.normal(scale=0.4, size=12), np.zeros(14)
        perimeter.add_threads(0.0, x, v, data, force)
        assert force[12] == -2.0
        pulls = np.zeros((4, 3))
        moved = [x + sign * 1e-6 * np.append(v, [-2.0, 0.0]) for sign in (1.0, -1.0)]
        for e in one.elements:
            (i, j), strain = ENDS[e], []
            for y in (x, *moved):
                span, natural = y[3 * j : 3 * j + 3] - y[3 * i : 3 * i + 3], y[12] * LENGTH[e]
                strain.append(0.5 * (span @ span / natural**2 - 1.0))
            span, natural = x[3 * j : 3 * j + 3] - x[3 * i : 3 * i + 3], x[12] * LENGTH[e]
            whole = strain[0] + (time or 0.0) * (strain[1] - strain[2]) / 2e-6
            pull = STIFFNESS[e] * max(whole, 0.0) * span / natural if strain[0] > 0.0 else 0.0 * span
            taut += strain[0] > 0.0
            pulls[i] += pull
            pulls[j] -= pull
        np.testing.assert_allclose(force[:12], pulls.ravel(), rtol=1e-7, atol=1e-7)
        slope = np.zeros(13)
        for k in range(13):
            step = 1e-6 * np.eye(14)[k]
            ends = [perimeter.energy_of_threads(x + sign * step, data) for sign in (1.0, -1.0)]
            slope[k] = (ends[0] - ends[1]) / 2e-6
        if time is None:
            np.testing.assert_allclose(force[:12], -slope[:12], rtol=1e-6, atol=1e-6)
            assert force[13] == pytest.approx(-2.0 * slope[12], rel=1e-6)
        # The power of what shortens goes into the nodes, into the elastic energy, and into viscosity.
        balance = force[13] - force[:12] @ v - slope[:12] @ v + 2.0 * slope[12]
        assert perimeter.power_in_threads(0.0, x, v, data) == pytest.approx(balance, rel=1e-6, abs=1e-6)
    assert 4 < taut < 12


def test_threads_whose_ends_meet_do_not_pull() -> None:
    one = edge(np.full(4, 0.5), Law(LENGTH, STIFFNESS, np.full(5, 0.02)))
    x, force = np.append(np.full(12, 0.3), [0.7, 0.0]), np.zeros(14)
    perimeter.add_threads(0.0, x, np.ones(12), one.data(np.ones(1)), force)
    assert force.tolist() == [0.0] * 12 + [-2.0, 0.0]


def test_what_is_seen_of_warm_threads() -> None:
    """The strain is that from the reference length, the tension that from the length free of stress."""
    law = Law(1.02 * LENGTH, STIFFNESS, np.full(5, 0.01))
    one = edge(np.full(4, 0.5), law)
    random = np.random.default_rng(8)
    x = np.hstack([random.normal(scale=0.3, size=(6, 12)), np.full((6, 1), 0.7), np.zeros((6, 1))])
    v = random.normal(scale=0.4, size=(6, 12))
    elements, strain, tension = one.seen({"closing/perimeter": np.ones(1)}, x, v)
    assert elements.tolist() == [3, 0, 1]
    assert 3 < np.count_nonzero(tension) < 16
    for row in range(6):
        for k, e in enumerate(one.elements):
            i, j = 3 * ENDS[e]
            length = float(np.linalg.norm(x[row, j : j + 3] - x[row, i : i + 3]))
            assert strain[row, k] == pytest.approx(0.5 * ((length / (0.7 * LENGTH[e])) ** 2 - 1.0), rel=1e-12)
            pull = perimeter.threads_pull(x[row], v[row], one.data(np.ones(1)), k)[3]
            assert tension[row, k] == pytest.approx(pull, rel=1e-11, abs=1e-13)


def test_the_bound_for_the_step_is_reached_on_a_folded_loop() -> None:
    """Equal threads round four nodes at two places: the stiffness that they gain, over the mass; EA gains
    1 / 0.4 - 1 of itself, and what is added to the viscosity is tau times that."""
    length, stiffness, mass = np.full(5, 1.25), np.full(5, 30.0), np.full(4, 0.5)
    law = Law(length, stiffness, np.full(5, 0.02))
    one = edge(mass, law, (0, 1, 2, 3), part=0.4)
    assert one.instants == pytest.approx((0.1, 0.4))

    def largest(part: float) -> float:
        """Eigenvalue of -dF/dx / m of threads that are hardly stretched."""
        x = np.zeros(14)
        x[0:12:3], x[12] = np.array([0.0, 1.25, 0.0, 1.25]) * part * (1.0 + 1e-4), part
        data = one.data(np.zeros(1))._replace(time=0.0)
        matrix = np.zeros((4, 4))
        for k in range(4):
            both = []
            for sign in (1.0, -1.0):
                force, y = np.zeros(14), x.copy()
                y[3 * k] += sign * 1e-6
                perimeter.add_threads(0.0, y, np.zeros(12), data, force)
                both.append(force[0:12:3])
            matrix[k] = -(both[0] - both[1]) / 2e-6
        return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1]) / 0.5

    term = one.term()
    assert term.stiffness_rate == pytest.approx(largest(0.4) - largest(1.0), rel=1e-3)
    assert term.damping_rate == pytest.approx(0.02 * term.stiffness_rate, rel=1e-12)
    assert term.power is not None
    lighter = edge(np.array([0.5, 0.2, 0.5, 0.5]), law, (0, 1, 2, 3), part=0.4).term()
    assert lighter.stiffness_rate == pytest.approx(2.5 * term.stiffness_rate, rel=1e-12)


def test_instants_count_once_each() -> None:
    """At 0.1 s and 0.3 s, and not before; each once."""
    switch = edge(np.full(4, 0.5), Law(LENGTH, STIFFNESS)).term().switch
    assert switch is not None
    nothing, memory, told = np.zeros(0), np.zeros(1), []
    assert switch.crossed(0.0999, nothing, nothing, memory).tolist() == []
    for time in switch.times:
        assert switch.crossed(time, nothing, nothing, memory).tolist() == [0]
        change = switch.change(time, nothing, nothing, memory, np.zeros(1, dtype=np.int64), {})
        memory = change.memory
        told.append((memory.tolist(), change.events[0]["event"]))
        assert switch.crossed(time, nothing, nothing, memory).tolist() == []
    assert switch.times == pytest.approx((0.1, 0.3))
    assert told == [
        ([1.0], "the edge begins to become shorter"),
        ([2.0], "the edge is as short as it gets"),
    ]

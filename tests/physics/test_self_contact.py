"""Contact of threads with each other: the force by hand, near pairs, runs, and what stops a run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from result_samples import net
from scenes import (
    BACKENDS,
    CROSSED,
    RADIUS,
    REACH,
    STIFFNESS,
    continue_alike,
    crossing,
    every_backend,
    of_text,
    refused,
    simulation,
)
from scipy.optimize import brentq, lsq_linear

from exunet.base.errors import RunStopped
from exunet.forces.blocks import Blocks
from exunet.forces.contact.estimate import damping_rate, speed_of_threads
from exunet.forces.contact.segment_segment import (
    apart,
)
from exunet.forces.contact.self_contact import neighbours_of, threads_together
from exunet.forces.contact.status import ContactStatus, status_of
from exunet.forces.effects.self_contact import SelfContact
from exunet.forces.terms import KernelTerm
from exunet.simulation.simulation import Simulation

Floats = NDArray[np.float64]


def crossing_energy(apart: float, angle: float) -> float:
    """What they store [J]: the integral of this force."""
    return 2 * STIFFNESS / (15 * REACH**2) * (REACH**2 - apart**2) ** 2.5 / math.sin(angle)


def side_by_side(apart: float) -> float:
    """Force [N/m] of parallel threads: K d / (pi R^2) times half a circle of radius (R^2 - d^2)^(1/2)."""
    return STIFFNESS / (2 * REACH**2) * apart * (REACH**2 - apart**2)


def pair_of(*lines: Any, damping: float = 0.0, overlapping: bool = False) -> tuple[KernelTerm, Blocks]:
    """The term of elements (m, 2, 3) that share no node, and the blocks that it stands in."""
    places, number = np.array(lines, dtype=float).reshape(-1, 3), len(lines)
    of = net(places, np.arange(2 * number).reshape(-1, 2))
    of = replace(of, mass=np.ones(2 * number), is_string=np.zeros(number, bool))
    far = 10.0 * (np.arange(2 * number)[:, None] // 2)  # so that nothing overlaps at the start
    blocks = Blocks(of, places + (0.0 if overlapping else far), states=SelfContact.first_order_states(None))  # type: ignore[arg-type]
    return threads_together(blocks, np.full(number, RADIUS), STIFFNESS, damping), blocks


def forces(term: KernelTerm, blocks: Blocks, x: Floats, v: Floats | None = None) -> tuple[Floats, float]:
    """(n_nodes, 3) [N], and the power of damping [W]."""
    force = np.zeros(blocks.n_force)
    flat = np.zeros(blocks.n_x)
    flat[: x.size] = x.ravel()
    speed = np.zeros(blocks.n_v) if v is None else np.asarray(v, dtype=float).ravel()
    term.add(0.0, flat, speed, term.data, force)
    return force[: x.size].reshape(-1, 3), float(force[blocks.rate("self_contact/damping")])


def stored(term: KernelTerm, x: Floats) -> float:
    """Energy [J]."""
    assert term.potential is not None
    return float(term.potential(x.ravel(), term.data))


def crossed(apart: float, angle: float) -> Floats:
    """Two elements of 1 m that cross in their middles."""
    along = 0.5 * np.array([math.cos(angle), math.sin(angle), 0.0])
    up = np.array([0.0, 0.0, apart])
    return np.array([[-0.5, 0, 0], [0.5, 0, 0], up - along, up + along])


@pytest.mark.parametrize("angle", [0.3, 1.0, math.pi / 2, 2.5])
@pytest.mark.parametrize("part", [0.7, 0.9, 0.999])
def test_threads_that_cross_push_as_by_hand(angle: float, part: float) -> None:
    x = crossed(part * REACH, angle)
    term, blocks = pair_of(x[:2], x[2:])
    found, _ = forces(term, blocks, x)
    expected = crossing(part * REACH, angle)
    assert found[2:].sum(axis=0) == pytest.approx([0, 0, expected], rel=1e-9, abs=1e-12 * STIFFNESS * REACH)
    assert found[0, 2] == pytest.approx(found[1, 2], rel=1e-9)  # in the middle
    # The less the angle the longer they touch, so they turn each other to right angles, by couples.
    turning = np.cross(x, found)[:2].sum(axis=0)[2]
    by = 1e-6
    slope = (crossing_energy(part * REACH, angle + by) - crossing_energy(part * REACH, angle - by)) / (2 * by)
    assert turning == pytest.approx(slope, rel=1e-6, abs=1e-9 * expected * REACH)


def test_threads_side_by_side_push_as_by_hand() -> None:
    """K p (1 - p/R) (1 - p/2R) per length where both lie side by side, but for their ends."""
    found = []
    for length in (1.0, 2.0):
        lines = [[[-length, 0, 0], [length, 0, 0]], [[-length, 0, 0.8 * REACH], [length, 0, 0.8 * REACH]]]
        term, blocks = pair_of(*lines)
        force, _ = forces(term, blocks, np.array(lines).reshape(-1, 3))
        found.append(force[2:, 2].sum())
    p = 0.2 * REACH
    by_depth = STIFFNESS * p * (1 - 0.2) * (1 - 0.1)
    assert side_by_side(0.8 * REACH) == pytest.approx(by_depth, rel=1e-12)
    assert (found[1] - found[0]) / 2.0 == pytest.approx(by_depth, rel=1e-9)


def test_forces_do_not_jump_where_the_closest_points_do() -> None:
    """Threads that turn through being parallel: the closest points jump from end to end, forces do not.

    At the middle of 1 m the other thread is 0.5 sin a away from where it was: a small part of the reach of
    10 mm as long as a is small, and so is the change; forces at the closest points would change by all.
    """
    x = crossed(0.8 * REACH, 0.0)
    term, blocks = pair_of(x[:2], x[2:])
    at = forces(term, blocks, x)[0]
    for angle in (1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
        for sign in (-1, 1):
            turned = forces(term, blocks, crossed(0.8 * REACH, sign * angle))[0]
            assert np.abs(turned - at).max() < 0.5 * angle / REACH * np.abs(at).max() + 1e-14


def random_pairs(count: int) -> list[Floats]:
    """Lines of 1 m and less, near each other in all ways: over their ends, nearly parallel, side by side."""
    random = np.random.default_rng(20261123)
    found = []
    while len(found) < count:
        d, e = random.normal(size=(2, 3)) * random.uniform(0.005, 0.3, size=(2, 1))
        if len(found) % 3 == 0:
            e = d * random.uniform(0.3, 1.5) + 1e-3 * random.normal(size=3)
        side = np.cross(d, random.normal(size=3))
        side *= random.uniform(0.6, 1.0) * REACH / np.linalg.norm(side)
        a = -random.uniform() * d
        p = side - random.uniform() * e
        found.append(np.array([a, a + d, p, p + e]))
    return found


@pytest.mark.slow
def test_force_is_the_slope_of_the_energy_and_keeps_both_momenta() -> None:
    for x in random_pairs(6):
        term, blocks = pair_of(x[:2], x[2:])
        found, _ = forces(term, blocks, x)
        slope, by = np.zeros(x.size), 1e-7
        for k in range(x.size):
            shift = np.zeros(x.size)
            shift[k] = by
            rise = stored(term, x + shift.reshape(x.shape)) - stored(term, x - shift.reshape(x.shape))
            slope[k] = rise / (2 * by)
        scale = np.abs(found).max()
        assert scale > 0.0
        # Differences over 1e-7 m of energies with an error of 1e-8 of a few microjoules at the least smooth.
        assert np.abs(found.ravel() + slope).max() < 1e-5 * scale
        assert np.abs(found.sum(axis=0)).max() < 1e-14 * scale
        assert np.abs(np.cross(x, found).sum(axis=0)).max() < 1e-14 * scale


def test_force_does_not_depend_on_the_division_of_threads() -> None:
    """One element, and the same thread as two: where they cross 1 mm from the node the sum is the same."""
    whole = crossed(0.8 * REACH, 1.0)
    term, blocks = pair_of(whole[:2], whole[2:])
    one = forces(term, blocks, whole)[0][:2].sum(axis=0)
    node = np.array([0.001, 0.0, 0.0])
    parts = np.array([whole[0], node, node, whole[1], whole[2], whole[3]])
    term, blocks = pair_of(parts[:2], parts[2:4], parts[4:])
    two = forces(term, blocks, parts)[0][:4].sum(axis=0)
    assert two == pytest.approx(one, rel=1e-8, abs=1e-8)


def test_damping_force_and_power() -> None:
    """At a speed of approach of 2 m/s the force is 1 + 2 a times as large, at -2 m/s none is negative."""
    x = crossed(0.8 * REACH, 1.0)
    plain, blocks = pair_of(x[:2], x[2:])
    damped, _ = pair_of(x[:2], x[2:], damping=0.75)
    known = forces(plain, blocks, x)[0]
    down = np.array([[0, 0, 0], [0, 0, 0], [0, 0, -2.0], [0, 0, -2.0]])
    found, taken = forces(damped, blocks, x, down)
    assert found == pytest.approx(2.5 * known, rel=1e-12, abs=1e-12)
    assert taken == pytest.approx(1.5 * known[2:, 2].sum() * 2.0, rel=1e-12)
    found, taken = forces(damped, blocks, x, -down)
    assert not found.any()
    assert taken == pytest.approx(known[2:, 2].sum() * 2.0, rel=1e-12)


def test_neighbours_along_threads_do_not_touch() -> None:
    """Half a turn is pi R / 2 = 15.7 mm: of elements of 6 mm those with two or less between them."""
    of = net([[0.006 * k, 0.0, 0.0] for k in range(8)], [[k, k + 1] for k in range(7)])
    found = neighbours_of(of, np.full(7, RADIUS)).tolist()
    assert found == [k * 7 + m for k in range(7) for m in range(k + 2, min(7, k + 4))]


def test_rates_for_the_stable_step() -> None:
    """6 threads with K L at each end, over the mass of 1 kg of each node that is not fixed."""
    lines = np.array([[[0.0, 0, z], [length, 0, z]] for z, length in ((0.0, 0.4), (1.0, 0.6), (2.0, 0.8))])
    term, blocks = pair_of(*lines, damping=0.3)
    rate = 6.0 * STIFFNESS * 0.8
    assert term.stiffness_rate == pytest.approx(rate, rel=1e-12)
    assert term.damping_rate == damping_rate(0.3, rate, speed_of_threads(blocks))
    fixed = replace(blocks, net=replace(blocks.net, fixed_nodes=np.array([4, 5])))
    term = threads_together(fixed, np.full(3, RADIUS), STIFFNESS, 0.0)
    assert term.stiffness_rate == pytest.approx(6.0 * STIFFNESS * 0.6, rel=1e-12)


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ("stiffness=1e4", ""),  # neither damping nor restitution
        ("stiffness=1e4,damping=0.0,restitution=0.5,impact_speed=1.0", ""),
        ("stiffness=1e4,restitution=0.5", ""),
        ("stiffness=1e4,restitution=1.5,impact_speed=1.0", ".restitution"),
        ("stiffness=1e4,damping=0.0,radius=0.99e-3", ".radius"),  # the cable has 1 mm
        ("stiffness=0.0,damping=0.0", ".stiffness"),
        ("stiffness=1e4,damping=0.0,friction=0.3", ".friction"),
    ],
)
def test_wrong_keys_are_refused(keys: str, key: str) -> None:
    assert refused(CROSSED, f"effects.self_contact={{{keys}}}") == [f"effects.self_contact{key}"]
    of_text(CROSSED, "effects.self_contact.radius=0.001")


# What starts near, and what passes through


def test_threads_that_overlap_at_the_start_keep_to_that_distance() -> None:
    """Side by side 6 mm apart, of a reach of 10 mm: they push as if 6 mm were their reach."""
    lines = np.array([[[-0.5, 0, 0], [0.5, 0, 0]], [[-0.5, 0, 0.006], [0.5, 0, 0.006]]])
    term, blocks = pair_of(*lines, overlapping=True)
    x = lines.reshape(-1, 3)
    assert not forces(term, blocks, x)[0].any()
    x[2:, 2] = 0.005
    found, _ = forces(term, blocks, x)
    p = 1.0 - 0.005 / 0.006
    by_depth = STIFFNESS * 0.006 * p * (1 - p) * (1 - p / 2)  # per length, but for the ends
    assert found[2:, 2].sum() == pytest.approx(by_depth, rel=0.01)
    x[2:, 2] = 0.007
    assert not forces(term, blocks, x)[0].any()


# Single functions, by other routes


def test_the_distance_of_two_lines_is_that_of_bounded_least_squares() -> None:
    """scipy's `lsq_linear` with 0 <= s, t <= 1; of lines that are points too, and of parallel ones."""
    random = np.random.default_rng(20)
    for k in range(60):
        a, b, p, q = random.normal(size=(4, 3))
        if k % 6 == 1:
            b = a
        if k % 6 == 2:
            q = p
        if k % 12 == 3:
            b, q = a, p
        if k % 6 == 4:
            q = p + random.normal() * (b - a)
        matrix = np.column_stack([b - a, p - q])
        known = lsq_linear(matrix, p - a, (0.0, 1.0), tol=1e-15, method="bvls")
        found = apart(tuple(a), tuple(b), tuple(p), tuple(q))
        assert found == pytest.approx(math.sqrt(2.0 * known.cost), rel=1e-7)
        assert apart(tuple(p), tuple(q), tuple(a), tuple(b)) == pytest.approx(found, rel=1e-12)


def test_energy_and_status_by_hand() -> None:
    """Of elements of other lengths; depth, pair and force of the deeper one of two pairs."""
    x = np.concatenate([crossed(0.8 * REACH, 1.0), np.add(crossed(0.7 * REACH, 1.2), [5.0, 0.0, 0.0])])
    x[[0, 4]] += 0.5 * (x[[0, 4]] - x[[1, 5]])  # 1.5 m long
    x[[3, 7]] += 0.25 * (x[[3, 7]] - x[[2, 6]])
    term, blocks = pair_of(*(x[2 * k : 2 * k + 2] for k in range(4)))
    known = crossing_energy(0.8 * REACH, 1.0) + crossing_energy(0.7 * REACH, 1.2)
    assert stored(term, x) == pytest.approx(known, rel=1e-9)
    forces(term, blocks, x)
    data: Any = term.data
    push = crossing(0.8 * REACH, 1.0) + crossing(0.7 * REACH, 1.2)
    assert data.now[[0, 1, 2, 4, 5, 7]] == pytest.approx(
        [0.3 * REACH, 2 * 4 + 3, 2, 0, push, known], rel=1e-9
    )
    assert term.remember is not None
    term.remember(0.25, x.ravel(), np.zeros(0), data)
    told = (0.3 * REACH, 0.25, 11, 0.25, 0, 0, 0, 2, 0.25, 2, push, known, *np.zeros(6))
    assert status_of(data.kept) == pytest.approx(told, rel=1e-9)
    assert (data.kept[: x.size] == x.ravel()).all()


def test_pairs_that_overlap_at_the_start_are_all_found() -> None:
    """By the distances of all pairs, of 40 lines in all ways."""
    lines = [pair[part] for pair in random_pairs(20) for part in (slice(0, 2), slice(2, 4))]
    random = np.random.default_rng(22)
    lines = [line + 0.05 * random.normal(size=3) for line in lines]
    term, _ = pair_of(*lines, overlapping=True)
    data: Any = term.data
    x, number = np.concatenate(lines).ravel(), len(lines)
    known = {}
    for k in range(number):
        for m in range(k + 1, number):
            far = apart(*(tuple(item.tolist()) for item in (*lines[k], *lines[m])))
            if far < REACH:
                known[k * number + m] = far
    assert len(known) > 10
    assert data.initial.tolist() == sorted(known)
    assert data.initial_reach.tolist() == [known[pair] for pair in sorted(known)]
    assert data.look[0] == len(known)
    assert data.pairs[: len(known)].tolist() == sorted(known)
    assert x.size == data.listed_at.size


def test_threads_that_are_too_near_stop_the_run() -> None:
    """At 1/3^(1/2) of the reach; not what began at less than half of both radii, but what began at half."""
    lines = np.concatenate([crossed(0.59 * REACH, 1.0), np.add(crossed(0.57 * REACH, 1.2), [5.0, 0.0, 0.0])])
    for begins, wrong in ((0.9, True), (0.51, True), (0.49, False)):
        start = np.concatenate(
            [crossed(2.0 * REACH, 1.0), np.add(crossed(begins * REACH, 1.2), [5.0, 0.0, 0.0])]
        )
        term, blocks = pair_of(*start.reshape(-1, 2, 3), overlapping=True)
        x = lines.copy()
        x[-2:, 2] = 0.57 * begins * REACH
        forces(term, blocks, x)
        data: Any = term.data
        assert data.now[4] == (1.0 + 11 if wrong else 0.0)
        assert term.remember is not None
        term.remember(0.5, x.ravel(), np.zeros(0), data)
        status = status_of(data.kept)
        assert (status.wrong, status.wrong_time, status.wrong_pair) == (
            (1.0, 0.5, 11.0) if wrong else (0, 0, 0)
        )
        assert term.discrete is not None
        assert term.discrete.wrong is not None
        assert bool(term.discrete.wrong(data.kept)) == wrong


def long_lines(apart: float) -> Floats:
    """Two elements of 40 m that cross; the list's skin is 10 m."""
    x = 40.0 * crossed(0.0, 1.0)
    x[2:, 2] = apart
    return x


WAYS = {
    # distances [m] at the ends of steps, in which both move as much against each other
    "slowly, then through": [6.0, 4.0, 2.0, 0.1, -0.1],
    "in one step": [9.0, -0.3],
    "in one step, after which they are listed anew": [7.0, -5.0],
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("aside", [0.0, 30.0])
def test_threads_that_pass_through_each_other_are_reported(way: str, aside: float) -> None:
    """Steps of metres, far more than a reach of 1 cm; not threads that pass beside each other."""
    begin, *steps = WAYS[way]
    x = long_lines(begin)
    x[2:, :2] += aside
    term, blocks = pair_of(x[:2], x[2:])
    data: Any = term.data
    data.kept[: x.size] = x.ravel()
    for time, z in enumerate(steps):
        both = 0.5 * (begin - z)
        x[:2, 2], x[2:, 2] = both, begin - both
        forces(term, blocks, x)
        assert term.remember is not None
        term.remember(float(time), x.ravel(), np.zeros(0), data)
    found = status_of(data.kept)
    last = float(len(steps) - 1)
    assert (found.wrong, found.wrong_time, found.wrong_pair) == ((0, 0, 0) if aside else (2.0, last, 1.0))


def test_forces_are_the_same_whenever_pairs_were_listed() -> None:
    """Two that come from 4 m to where they touch, each as far: listed once, and listed there."""
    x = long_lines(4.0)
    term, blocks = pair_of(x[:2], x[2:])
    forces(term, blocks, x)
    data: Any = term.data
    assert data.gaps[0] == pytest.approx(4.0 - REACH, rel=1e-12)
    both = 2.0 - 0.4 * REACH
    x[:2, 2], x[2:, 2] = both, 4.0 - both
    found, _ = forces(term, blocks, x)
    assert data.look[3] == pytest.approx(both, rel=1e-12)
    assert found[2:].sum(axis=0)[2] == pytest.approx(crossing(0.8 * REACH, 1.0), rel=1e-6)
    fresh, _ = pair_of(x[:2], x[2:])
    np.testing.assert_array_equal(forces(fresh, blocks, x)[0], found)
    moved = np.add(x, [7.0, -3.0, 2.0])  # with a shift that all have in common
    assert forces(term, blocks, moved)[0] == pytest.approx(found, rel=1e-6, abs=1e-9)


def test_an_element_that_has_become_a_point_pushes_as_a_very_short_one() -> None:
    """Beside another of 1 m; the point is in the middle of it, and both ends get half of the force."""
    x = np.array([[-0.5, 0.1, 0.0], [0.5, -0.1, 0.002], [0.02, 0.0, 0.7 * REACH], [0.02, 0.0, 0.7 * REACH]])
    term, blocks = pair_of([x[0], x[1]], [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    point, _ = forces(term, blocks, x)
    at = stored(term, x)
    x[2:, 0] += [-2e-7, 2e-7]
    short, _ = forces(term, blocks, x)
    assert np.abs(point).max() > 0.1
    np.testing.assert_allclose(point, short, rtol=1e-4, atol=1e-6 * np.abs(point).max())
    np.testing.assert_allclose(point[2], point[3], rtol=1e-12)
    assert at == pytest.approx(stored(term, x), rel=1e-6)
    x[2:, 0] += 5e-8 * REACH
    np.testing.assert_allclose(forces(term, blocks, x)[0], short, rtol=1e-3, atol=1e-5 * np.abs(point).max())


# Runs

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


def seen(sim: Simulation) -> ContactStatus:
    return status_of(sim.view.discrete["self_contact/threads"])


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
            assert seen(sim).stored == pytest.approx(sim.energy.potential, rel=1e-9)
            assert seen(sim).stored > 1e-4
            sim.advance_to(0.03)
            assert seen(sim).touching == 0.0  # they have parted again
            assert seen(sim).most >= 1.0
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
def test_both_back_ends_agree_over_a_run(tmp_path: Path) -> None:
    found = []
    for backend in BACKENDS.values():
        sim = simulation(tmp_path, CROSSED, backend, "effects.self_contact.damping=0.5")
        sim.advance_to(0.0075)
        assert seen(sim).touching >= 1.0
        found.append((sim.net.position, sim.net.velocity, sim.view.first_order.copy()))
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() < 1e-12  # m, m/s, J: round-off of 75 steps


@pytest.mark.slow
@every_backend
def test_a_snapshot_in_mid_contact_repeats_to_the_bit(backend: str, tmp_path: Path) -> None:
    one, other = (
        simulation(tmp_path, CROSSED, BACKENDS[backend], "effects.self_contact.damping=0.5") for _ in "12"
    )
    one.advance_to(0.0075)
    assert seen(one).touching >= 1.0
    continue_alike(one, other, 0.02, tmp_path)


FAST = "initial.node_velocities=[[0,0,{0}],[0,0,{0}],[0,0,{0}],[0,0,0],[0,0,0],[0,0,0]]"


@pytest.mark.slow
@pytest.mark.parametrize("speed", [3.0, 300.0])  # nearer than 5.77 mm; through each other in the first step
def test_threads_that_pass_through_each_other_stop_the_run(speed: float, tmp_path: Path) -> None:
    sim = simulation(tmp_path, CROSSED, FAST.format(speed), "engine.backend=exudyn")
    with pytest.raises(RunStopped, match=r"elements 1 and \d"):
        sim.advance_to(0.02)
    assert sim.time <= (0.02 if speed < 10.0 else 1e-4)

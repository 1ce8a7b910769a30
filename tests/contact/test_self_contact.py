"""Threads that touch each other: the force by hand, continuity, which pairs are near, what is refused."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from contact_scenes import CROSSED, RADIUS, REACH, STIFFNESS, crossing
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import lsq_linear

import exunet
from exunet.forces.blocks import Blocks
from exunet.forces.contact.estimate import damping_rate, speed_of_threads
from exunet.forces.contact.segment_segment import (
    apart,
    chord,
    list_is_right,
    list_pairs,
    meet,
    near_range,
    passed,
    place_of,
    sort,
    spread,
    volume_of,
)
from exunet.forces.contact.self_contact import Together, is_watched, neighbours_of, threads_together
from exunet.forces.contact.status import status_of
from exunet.forces.effects.self_contact import first_order_states
from exunet.forces.terms import KernelTerm
from exunet.net.arrays import Net
from exunet.simulation.preparation import prepare_case

Floats = NDArray[np.float64]


def crossing_energy(apart: float, angle: float) -> float:
    """What they store [J]: the integral of this force."""
    return 2 * STIFFNESS / (15 * REACH**2) * (REACH**2 - apart**2) ** 2.5 / math.sin(angle)


def side_by_side(apart: float) -> float:
    """Force [N/m] of parallel threads: K d / (pi R^2) times half a circle of radius (R^2 - d^2)^(1/2)."""
    return STIFFNESS / (2 * REACH**2) * apart * (REACH**2 - apart**2)


@cache
def any_net() -> Net:
    """One to take materials from."""
    path = Path(__file__).parents[2] / "cases" / "verification" / "free_net.toml"
    return prepare_case(exunet.load(path)).net


def pair_of(*lines: Any, damping: float = 0.0, overlapping: bool = False) -> tuple[KernelTerm, Blocks]:
    """The term of elements (m, 2, 3) that share no node, and the blocks that it stands in."""
    places = np.array(lines, dtype=float).reshape(-1, 3)
    number = len(lines)
    net = any_net()
    length = np.linalg.norm(places[1::2] - places[::2], axis=1)
    of_elements = {
        name: np.resize(getattr(net, name), number)
        for name in ("area", "youngs_modulus", "density", "is_string")
    }
    net = replace(
        net,
        reference_position=places,
        mass=np.ones(2 * number),
        element_nodes=np.arange(2 * number).reshape(-1, 2),
        reference_length=length,
        bullet_nodes=np.zeros(0, dtype=np.int64),
        fixed_nodes=np.zeros(0, dtype=np.int64),
        faces=(),
        mouth=(),
        **of_elements,
    )
    far = 10.0 * (np.arange(2 * number)[:, None] // 2)  # so that nothing overlaps at the start
    blocks = Blocks.of(net, places + (0.0 if overlapping else far), (), states=first_order_states(None))  # type: ignore[arg-type]
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


def test_force_does_not_depend_on_how_threads_are_divided() -> None:
    """One element, and the same thread as two: where they cross 1 mm from the node the sum is the same."""
    whole = crossed(0.8 * REACH, 1.0)
    term, blocks = pair_of(whole[:2], whole[2:])
    one = forces(term, blocks, whole)[0][:2].sum(axis=0)
    node = np.array([0.001, 0.0, 0.0])
    parts = np.array([whole[0], node, node, whole[1], whole[2], whole[3]])
    term, blocks = pair_of(parts[:2], parts[2:4], parts[4:])
    two = forces(term, blocks, parts)[0][:4].sum(axis=0)
    assert two == pytest.approx(one, rel=1e-8, abs=1e-8)


def test_damping_takes_what_it_is_said_to_take() -> None:
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


def test_lists_are_right_until_something_has_moved_by_half_a_skin() -> None:
    lines = random_pairs(2)
    term, _ = pair_of(*(pair[part] for pair in lines for part in (slice(0, 2), slice(2, 4))))
    data: Any = term.data
    x = np.concatenate(lines)
    list_pairs(x.ravel(), data)
    half = 0.5 * data.look[1]
    assert list_is_right(x.ravel(), data)
    assert list_is_right((x + np.array([100.0, 3.0, 0.0])).ravel(), data)  # all moved together
    x[3, 1] += 0.9 * half
    assert list_is_right(x.ravel(), data)
    x[3, 1] += 0.4 * half  # less what of this is taken for a common motion
    assert not list_is_right(x.ravel(), data)


def test_all_pairs_that_are_near_are_listed() -> None:
    """The sweep beside all pairs, of 40 lines."""
    lines = [pair[part] for pair in random_pairs(20) for part in (slice(0, 2), slice(2, 4))]
    term, _ = pair_of(*lines)
    data: Any = term.data
    x = np.concatenate(lines).ravel()
    list_pairs(x, data)
    found = data.pairs[: int(data.look[0])].tolist()
    assert found == sorted(set(found))
    every = range(len(lines))
    far = REACH + data.look[1]
    near = [k * len(lines) + m for k in every for m in every if k < m and _sampled(lines[k], lines[m]) < far]
    assert set(near) <= set(found)
    assert len(near) > 20


def _sampled(one: Floats, other: Floats) -> float:
    """Distance of two lines from above, by points on both."""
    s = np.linspace(0.0, 1.0, 60)[:, None]
    a, b = (line[0] + s * (line[1] - line[0]) for line in (one, other))
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


def test_neighbours_along_threads_do_not_touch(tmp_path: Path) -> None:
    """Half a turn is pi R / 2 = 15.7 mm: of elements of 6 mm those with two or less between them."""
    nodes = [[0.006 * k, 0.0, 0.0] for k in range(8)]
    path = tmp_path / "scene.toml"
    path.write_text(CROSSED)
    case = exunet.load(
        path,
        [
            f"net.nodes={nodes}",
            f"net.elements={[[k, k + 1] for k in range(7)]}",
            f"net.node_masses={[0.01] * 8}",
            f"initial.node_velocities={[[0, 0, 0]] * 8}",
        ],
    )
    net = prepare_case(case).net
    found = neighbours_of(net, np.full(7, RADIUS)).tolist()
    assert found == [k * 7 + m for k in range(7) for m in range(k + 2, min(7, k + 4))]


# What starts near, what passes through, and what is refused


def test_what_overlaps_at_the_start_keeps_to_that_distance() -> None:
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


def test_passing_is_seen_where_the_elements_met_and_not_beside_them() -> None:
    before = crossed(1.5 * REACH, 1.0)
    after = crossed(-1.5 * REACH, 1.0)
    term, _ = pair_of(before[:2], before[2:])
    data: Any = term.data
    assert isinstance(data, Together)
    assert passed(after.ravel(), before.ravel(), data, 0, 1, data.least * REACH)
    aside = np.array([[0, 0, 0], [0, 0, 0], [2.0, 0, 0], [2.0, 0, 0]])
    assert not passed((after + aside).ravel(), (before + aside).ravel(), data, 0, 1, data.least * REACH)


WRONG = {
    "no damping": ("{stiffness=1e4}", r"effects\.self_contact: requires either restitution"),
    "both": (
        "{stiffness=1e4,damping=0.0,restitution=0.5,impact_speed=1.0}",
        r"effects\.self_contact: requires either",
    ),
    "half": ("{stiffness=1e4,restitution=0.5}", r"requires restitution and impact_speed together"),
    "above one": ("{stiffness=1e4,restitution=1.5,impact_speed=1.0}", r"self_contact\.restitution: .*1"),
    "thin": (
        "{stiffness=1e4,damping=0.0,radius=1e-4}",
        r"radius: must be at least that of net\.cable, 0\.001 m",
    ),
    "soft": ("{stiffness=0.0,damping=0.0}", r"self_contact\.stiffness: .*greater than 0"),
    "friction": ("{stiffness=1e4,damping=0.0,friction=0.3}", r"self_contact\.friction: unknown key"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_with_its_line(name: str, tmp_path: Path) -> None:
    keys, words = WRONG[name]
    path = tmp_path / "scene.toml"
    lines = CROSSED.splitlines()
    (number,) = (k for k, line in enumerate(lines) if line.startswith("effects.self_contact"))
    lines[number] = f"effects.self_contact = {keys}"
    path.write_text("\n".join(lines))
    with pytest.raises(exunet.CaseError) as refused:
        exunet.load(path)
    assert re.search(rf"scene\.toml:{number + 1}: .*{words}", str(refused.value)), str(refused.value)


def test_threads_may_be_as_thin_as_they_are_but_for_round_off(tmp_path: Path) -> None:
    """Down to 1 - 1e-12 of the radius that follows from the area, that included."""
    path = tmp_path / "scene.toml"
    path.write_text(CROSSED)
    own = math.sqrt(exunet.load(path).scene.net.cable.cross_section / math.pi)
    least = (1.0 - 1e-12) * own
    exunet.load(path, [f"effects.self_contact.radius={least!r}"])
    with pytest.raises(exunet.CaseError, match="must be at least that of"):
        exunet.load(path, [f"effects.self_contact.radius={float(np.nextafter(least, 0.0))!r}"])


def test_broken_elements_and_self_contact_exclude_each_other(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(CROSSED)
    with pytest.raises(exunet.CaseError, match=r"self_contact: contradicts effects\.breaking"):
        exunet.load(path, ["effects.breaking.strain=0.1"])


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


def test_a_line_is_near_a_point_between_the_roots() -> None:
    """Of |p + s d|^2 = R^2; none, or none that ends, where they are not real."""
    random, real = np.random.default_rng(21), 0
    for _ in range(40):
        p, d = random.normal(size=(2, 3))
        roots = np.roots([d @ d, 2.0 * p @ d, p @ p - 1.7])
        found = near_range(tuple(p), tuple(d), 1.7)
        if np.isreal(roots).all():
            real += 1
            assert found == pytest.approx(sorted(roots.real.tolist()), rel=1e-9)
        else:
            assert found == (2.0, -1.0)
    assert 10 < real < 35
    assert near_range((1.0, 2.0, 2.0), (0.0, 0.0, 0.0), 8.9) == (2.0, -1.0)
    assert near_range((1.0, 2.0, 2.0), (0.0, 0.0, 0.0), 9.1) == (-1.0, 2.0)
    assert near_range((1.0, 0.0, 1.0), (-1.0, 0.0, 0.0), 2.0) == (0.0, 2.0)  # begins where it is as far
    assert near_range((1.0, 0.0, 1.0), (1.0, 0.0, 0.0), 2.0) == (-2.0, 0.0)
    assert near_range((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 5.0) == (-2.0, 2.0)


def test_integrals_along_a_chord_are_those_of_quadrature() -> None:
    """Of q, z q, z^2 q and q^3, where q^2 = R^2 - z^2; the second from where it is -R^3 / 3."""
    square, kinds = 1.7, ((0, 1), (1, 1), (2, 1), (0, 3))  # powers of z and of q
    for z in (-1.1, -0.4, 0.3, 1.25):
        for n, of in enumerate(kinds):
            known = quad(lambda y, of=of: y ** of[0] * (square - y * y) ** (0.5 * of[1]), 0.0, z)[0]
            if n == 1:
                known -= square**1.5 / 3.0
            assert chord(z, square)[n] == pytest.approx(known, rel=1e-9)


def test_the_energy_is_that_by_hand_and_what_is_told_of_a_state_too() -> None:
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
    told = (0.3 * REACH, 0.25, 11, 0.25, 0, 0, 0, 2, 0.25, 2, push, known)
    assert status_of(data.kept) == pytest.approx(told, rel=1e-9)
    assert (data.kept[: x.size] == x.ravel()).all()


def test_damping_does_nothing_where_the_force_across_vanishes() -> None:
    """One thread in the middle of another: they push in no direction, and turn what lies along them."""
    x = np.array([[-1.0, 0, 0], [1.0, 0, 0], [-0.5, 0, 0], [0.5, 0, 0]])
    v = np.random.default_rng(1).normal(size=(4, 3))
    plain, damped = (forces(*pair_of(x[:2], x[2:], damping=item), x, v) for item in (0.0, 0.5))
    assert (plain[0] == damped[0]).all()
    assert plain[1] == damped[1] == 0.0


def test_rates_and_the_room_of_the_list_are_by_the_words() -> None:
    """6 threads with K L at each end, over the mass of 1 kg of each node; skin of 1/4 of the mean length."""
    lines = np.array([[[0.0, 0, z], [length, 0, z]] for z, length in ((0.0, 0.4), (1.0, 0.6), (2.0, 0.8))])
    term, blocks = pair_of(*lines, damping=0.3)
    rate = 6.0 * STIFFNESS * 0.8
    assert term.stiffness_rate == pytest.approx(rate, rel=1e-12)
    assert term.damping_rate == damping_rate(0.3, rate, speed_of_threads(blocks))
    data: Any = term.data
    assert data.skin == pytest.approx(0.15, rel=1e-12)
    assert (data.few, len(data.pairs), data.least) == (24, 3, 1.0 / math.sqrt(3.0))
    assert data.look.tolist() == [0.0, 0.0, 0.0, 0.0]
    fixed = replace(blocks, net=replace(blocks.net, fixed_nodes=np.array([4, 5])))
    term = threads_together(fixed, np.full(3, RADIUS), STIFFNESS, 0.0)
    assert term.stiffness_rate == pytest.approx(6.0 * STIFFNESS * 0.6, rel=1e-12)
    short, _ = pair_of(*(0.01 * lines))
    assert short.data.skin == 2.0 * RADIUS  # type: ignore[attr-defined]


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


def test_what_is_too_near_stops_and_is_named() -> None:
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
        assert term.memory is not None
        assert term.memory.wrong is not None
        near = (
            f"the axes of elements 2 and 3 are nearer than {begins * REACH / math.sqrt(3.0):.3g} m at t = 0.5"
        )
        assert term.memory.wrong(data.kept).startswith(near) == wrong
    thick: Any = SimpleNamespace(thick=(0.5, 0.25))
    assert is_watched(thick, 0, 1, 0.375)


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
def test_whoever_passes_through_another_is_seen(way: str, aside: float) -> None:
    """Steps of metres, far more than a reach of 1 cm; not those who pass beside each other."""
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


def test_two_lines_pass_where_the_volume_between_them_changes_its_sign() -> None:
    """Ways at random; the instant by the roots of a polynomial of degree 3, the distance there by `apart`."""
    random, seen = np.random.default_rng(23), {True: 0, False: 0}
    term, _ = pair_of(*random_pairs(1)[0].reshape(2, 2, 3))
    data: Any = term.data

    def volume(x: Floats) -> float:
        a, b, p, q = x
        return float(np.cross(b - a, q - p) @ (a - p))

    for _ in range(80):
        before, after = random.normal(size=(2, 4, 3))
        assert volume_of(before.ravel(), data, 0, 1) == pytest.approx(volume(before), rel=1e-12)
        at = np.linspace(0.0, 1.0, 4)
        cubic = np.polyfit(at, [volume(before + s * (after - before)) for s in at], 3)
        roots = np.roots(cubic)
        inside = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real < 1.0)]
        if len(inside) == 3:
            continue  # any of these may be found
        if len(inside) != 1:
            assert not passed(after.ravel(), before.ravel(), data, 0, 1, 1e3)
            continue
        there = before + inside[0] * (after - before)
        far = apart(*(tuple(item.tolist()) for item in there))
        for least in (0.9 * far, 1.1 * far) if far > 1e-9 else (1e-6,):  # 0 of those that meet
            found = passed(after.ravel(), before.ravel(), data, 0, 1, least)
            assert found == (far < least)
            seen[found] += 1
    assert min(seen.values()) > 10


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


def test_the_skin_is_halved_until_there_are_few_pairs_and_too_many_are_told() -> None:
    """Lines on a grid 1 cm, or a reach, and 1 mm apart: all with those beside them, whatever the skin is."""
    lines = [[[0.0, 0.011 * k, 0.0], [0.8, 0.011 * k, 0.0]] for k in range(12)]
    term, _ = pair_of(*lines)
    data: Any = term.data
    x = np.array(lines).ravel()
    counts = {}
    for few in (66, 30, 11):
        own = data._replace(few=few, look=np.zeros(4))
        list_pairs(x, own)
        counts[few] = (int(own.look[0]), float(own.look[1] / data.skin), float(own.look[2]))
        number = sum(0.011 * (m - k) < REACH + own.look[1] for k in range(12) for m in range(k + 1, 12))
        assert own.look[0] == number
        known = [0.011 * (pair % 12 - pair // 12) - REACH for pair in own.pairs[:number]]
        np.testing.assert_allclose(own.gaps[:number], known, rtol=1e-9)
        np.testing.assert_array_equal(own.listed_at, x)
    assert counts[66] == (66, 1.0, 0.0)
    assert counts[30] == (30, 0.125, 0.0)
    assert counts[11] == (11, 0.03125, 0.0)
    own = data._replace(few=3, look=np.zeros(4))
    close = x * np.tile([1.0, 0.009 / 0.011, 1.0], 24)  # 9 mm apart: 11 pairs touch
    list_pairs(close, own)
    skin = 0.5**10 * data.skin  # a thousandth: then as many as there is room for
    assert own.look.tolist() == [11.0, skin, 0.0, 0.0]
    own = data._replace(few=66, pairs=np.zeros(10, dtype=np.int64), look=np.zeros(4))
    list_pairs(close, own)
    assert (own.look[0], own.look[2]) == (0.0, 1.0)
    own.look[:] = 0.0, 0.25 * data.skin, 0.0, 0.0  # the skin of before may be doubled, and no more
    list_pairs(x, own._replace(few=66, pairs=np.zeros(66, dtype=np.int64)))
    assert own.look[1] == 0.5 * data.skin


def test_lists_are_sorted_and_searched() -> None:
    random = np.random.default_rng(24)
    for number in (0, 1, 2, 3, 14, 200):
        items = random.permutation(3 * number)[:number]
        left = items.copy()
        sort(left, number, np.zeros(0))
        assert left.tolist() == sorted(items.tolist())
        of = random.normal(size=3 * number + 1)
        by = items.copy()
        sort(by, max(number - 1, 0), of)
        assert by[: number - 1].tolist() == sorted(items[: number - 1].tolist(), key=lambda item: of[item])
        for entry in range(3 * number):
            found = np.flatnonzero(left == entry)
            assert place_of(left, entry) == (found[0] if len(found) else -1)


def test_boxes_meet_where_they_share_a_face() -> None:
    one = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    for axis in range(3):
        for shift, shared in ((1.0, True), (1.25, False), (-1.0, True), (-1.25, False), (0.5, True)):
            other = np.array(one)
            other[[axis, 3 + axis]] += shift
            assert meet(np.array([one, other]), 0, 1) == shared
            assert meet(np.array([one, other]), 1, 0) == shared
    assert spread(np.array([0.5, -2.0, 1.25])) == 3.25

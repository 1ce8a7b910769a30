"""Threads that touch each other: the force by hand, continuity, which pairs are near, what is refused."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import CROSSED, RADIUS, REACH, STIFFNESS, crossing
from numpy.typing import NDArray

import exunet
from exunet.forces.blocks import Blocks
from exunet.forces.contact.together import Together, neighbours_of, threads_together
from exunet.forces.contact.together_loops import list_is_right, list_pairs, passed
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
    "no damping": ("{stiffness=1e4}", r"effects\.self_contact: needs either restitution"),
    "both": (
        "{stiffness=1e4,damping=0.0,restitution=0.5,impact_speed=1.0}",
        r"effects\.self_contact: needs either",
    ),
    "half": ("{stiffness=1e4,restitution=0.5}", r"needs restitution and impact_speed together"),
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

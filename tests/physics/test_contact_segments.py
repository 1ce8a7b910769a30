"""Contact of threads with solids, as plain Python: signed distances, spans and integrals of the force."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes import (
    COMPOUNDS,
    EDGE,
    SHAPES,
    TOUCHED,
    TWO_BOXES,
    body_of,
    contact_of,
    from_core,
    half_planes,
    in_principal,
    in_solid,
    rounding_of,
    surface,
    to_principal,
)
from scipy.optimize import brentq

from exunet.bodies.shapes import Solid
from exunet.forces.contact.segment_surface import find_spans, lay, span, touch
from exunet.forces.contact.signed_distance import box_distance, core_gradient

Floats = np.ndarray
STIFFNESS, THICK = 3.0, 0.01  # N/m2, m
DAMPING = 1.5  # s/m


def points_around(seed: int, number: int) -> Floats:
    """(number, 3) around a solid, most of them outside."""
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (number, 3))


def signed(name: str, place: Floats) -> tuple[float, Floats]:
    """Distance from the core and its gradient by the loops."""
    d, *gradient = core_gradient(surface((TOUCHED[name],)).cores, 0, *place)
    return d, np.array(gradient)


@pytest.mark.parametrize("name", TOUCHED)
def test_distances_outside_are_those_from_the_outline(name: str) -> None:
    """With gradients of length one, and those of central differences: 1e-12 / d^2, and round-off of 1e-10."""
    solid, outside = TOUCHED[name], 0
    for place in points_around(1, 150):
        found, gradient = signed(name, place)
        known = from_core(solid, EDGE, in_solid(solid, place[None]))[0][0]
        assert np.linalg.norm(gradient) == pytest.approx(1.0, abs=1e-14)
        if found <= 0.0:
            assert known == 0.0
            continue
        outside += 1
        assert found == pytest.approx(known, abs=1e-13)
        if found > 0.02 and outside % 3 == 0:
            steps = 1e-6 * np.eye(3)
            slope = [(signed(name, place + step)[0] - signed(name, place - step)[0]) / 2e-6 for step in steps]
            np.testing.assert_allclose(gradient, slope, atol=1e-8)
    assert outside > 100


@pytest.mark.parametrize("name", [name for name in TOUCHED if name not in ("sphere", "capsule")])
def test_inside_it_is_the_way_out_through_the_nearest_face(name: str) -> None:
    """Below zero, in the direction of that face's normal. A sphere's core is a point, a capsule's a line."""
    solid = TOUCHED[name]
    places = 0.4 * points_around(6, 800)
    near = in_solid(solid, places)
    within = from_core(solid, EDGE, near)[0] == 0.0
    for place, own in zip(places[within], near[within], strict=True):
        if solid.kind == "box":
            faces = np.vstack([np.eye(3), -np.eye(3)])
            limits = np.tile(0.5 * np.array(solid.numbers) - EDGE, 2)
        else:
            flat, limits = half_planes(solid, EDGE)
            around = own[:2] / np.hypot(*own[:2])
            faces = np.column_stack([flat[:, :1] * around, flat[:, 1]])
        beyond = faces @ own - limits
        found, gradient = signed(name, place)
        assert found == pytest.approx(beyond.max(), abs=1e-14)
        np.testing.assert_allclose(gradient, to_principal(solid, faces[beyond.argmax()]), atol=1e-14)
    assert within.sum() > 5


@pytest.mark.parametrize("name", TOUCHED)
def test_the_surface_is_that_of_the_solid(name: str) -> None:
    """Along rays from its middle: rounded edges are inside of the sharp solid, and nothing is outside."""
    solid = TOUCHED[name]
    cores = surface((solid,)).cores
    assert cores.rounding[0] == rounding_of(solid, EDGE)
    for way in np.random.default_rng(2).normal(size=(40, 3)):
        way /= np.linalg.norm(way)
        middle = np.array(cores.place[0])

        def excess(s: float, way: Floats = way, middle: Floats = middle) -> float:
            return signed(name, middle + s * way)[0] - cores.rounding[0]

        low = brentq(excess, 0.0, 3.0, xtol=1e-15)
        assert solid.depth(in_solid(solid, (middle + low * way)[None]))[0] < 1e-12


def test_a_ball_around_a_compound() -> None:
    """About the middle of the balls around its boxes, of 0.6 x 1 x 0.4 m at 0.3 m to both sides."""
    found, around = surface(SHAPES[TWO_BOXES]), 0.5 * np.linalg.norm([0.6, 1.0, 0.4])
    np.testing.assert_allclose(found.middle, in_principal(0.0, 0.0, 0.0), atol=1e-15)
    assert found.radius == pytest.approx(0.3 + around, rel=1e-14)


@pytest.mark.parametrize("axis", range(3))
def test_points_equally_far_beyond_faces_of_a_box(axis: int) -> None:
    """At edges and corners, with half edges 1, 2 and 3 m: 3-4-5 and 1-2-2, turned to all axes and signs."""
    half = np.array([1.0, 2.0, 3.0])
    for way in ((2.0, 2.0, 1.0), (3.0, 3.0, 0.0), (3.0, 4.0, 0.0), (3.0, 0.0, 0.0), (2.0, 2.0, 2.0)):
        for sign in (1.0, -1.0):
            beyond = np.roll(way, axis) * np.where(np.arange(3) == axis, sign, 1.0)
            place = np.copysign(half, beyond) + beyond
            place -= np.where(beyond == 0.0, 0.5 * half, 0.0)  # beside a face or an edge
            size = float(np.linalg.norm(beyond))
            found = box_distance(1.0, 2.0, 3.0, *place.tolist())
            assert found == pytest.approx((size, *(beyond / size)), rel=1e-15)


# Touched spans and integrals


def threads(name: str, seed: int, number: int) -> list[tuple[Floats, Floats]]:
    """Ends of threads that touch, 1 mm to 7 cm deep, and do not enter a core."""
    random = np.random.default_rng(seed)
    found: list[tuple[Floats, Floats]] = []
    while len(found) < number:
        a = random.uniform(-0.9, 0.9, 3)
        b = a + random.normal(size=3) * random.choice([0.05, 0.3, 1.0])
        depths, _ = depths_of(name, np.linspace(a, b, 200))
        if 1e-3 < depths.max() < 0.07:
            found.append((a, b))
    return found


def depths_of(name: str, points: Floats) -> tuple[Floats, Floats]:
    """(n,) depths of points (n, 3) of a thread, (sum p^8)^(1/8), and (n, k) the depths p in each solid."""
    own = np.stack([depth_in(solid, points) for solid in SHAPES[name]], axis=-1)
    own = np.maximum(own, 0.0)
    return np.asarray((own**8).sum(axis=-1) ** 0.125), own


def depth_in(solid: Solid, points: Floats) -> Floats:
    """(n,) depths in one solid, below 0 outside."""
    return rounding_of(solid, EDGE) + THICK - from_core(solid, EDGE, in_solid(solid, points))[0]


def touched(
    name: str, a: Any, b: Any, v: Any = (0, 0, 0), w: Any = (0, 0, 0), damping: float = 0.0
) -> Floats:
    """(12,) what `touch` finds; zeros where nothing is touched."""
    c = contact_of(surface(SHAPES[name]), STIFFNESS, damping)
    a, b, v, w = (tuple(map(float, part)) for part in (a, b, v, w))
    m, _ = find_spans(c, THICK, a, b)
    found = m > 0 and touch(c, THICK, v, w, m, c.work.sums)
    return c.work.sums.copy() if found else np.zeros(12)


def quadrature(name: str, a: Floats, b: Floats, function: Callable[[Floats], Floats]) -> Floats:
    """(k,) integrals over [0, 1] of a function (n,) -> (n, k) that is 0 where the thread does not touch.

    Gauss's rule of 10 points between the places where touching begins or ends, halved where it differs; kinks
    are closed in to a length of 2^-45.
    """
    places, weights = np.polynomial.legendre.leggauss(10)
    places, weights = 0.5 + 0.5 * places, 0.5 * weights

    def by_pieces(begin: Floats, length: Floats) -> Floats:
        values = function((begin[:, None] + length[:, None] * places).ravel()).reshape(len(begin), 10, -1)
        return np.asarray(length[:, None] * np.einsum("g,ngk->nk", weights, values))

    ends = np.sort([*np.arange(9) / 8.0, *borders(name, a, b)])
    begin, length = ends[:-1], np.diff(ends)
    whole = by_pieces(begin, length)
    scale = 1e-12 * np.abs(whole).max() + 1e-14  # above the round-off of lengths of 1 m
    total = np.zeros(whole.shape[1])
    for _ in range(45):
        length = np.repeat(0.5 * length, 2)
        begin = np.repeat(begin, 2)
        begin[1::2] += length[1::2]
        halves = by_pieces(begin, length)
        differs = np.abs(halves[::2] + halves[1::2] - whole).max(axis=1) > scale * length[::2]
        both = np.repeat(differs, 2)
        total += halves[~both].sum(axis=0)
        if not differs.any():
            return total
        begin, length, whole = begin[both], length[both], halves[both]
    return np.asarray(total + whole.sum(axis=0))


def borders(name: str, a: Floats, b: Floats) -> list[float]:
    """Places of the thread where it begins or ceases to touch a solid: by 2001 places and Brent's method."""
    s = np.linspace(0.0, 1.0, 2001)
    found = []
    for solid in SHAPES[name]:

        def depth(s: float, solid: Solid = solid) -> float:
            return float(depth_in(solid, (a + s * (b - a))[None])[0])

        touches = depth_in(solid, a + s[:, None] * (b - a)) > 0.0
        at = np.flatnonzero(touches[1:] != touches[:-1])
        found += [brentq(depth, s[k], s[k + 1], xtol=1e-15) for k in at]
    return found


def integrals(name: str, a: Floats, b: Floats) -> Floats:
    """(4,) of f, s f, F p / 2, f = F, and the largest depth."""

    def integrand(s: Floats) -> Floats:
        p = depths_of(name, a + s[:, None] * (b - a))[0]
        return STIFFNESS * np.stack([p, s * p, 0.5 * p * p], axis=1)

    deepest = depths_of(name, np.linspace(a, b, 2001))[0].max()
    return np.append(quadrature(name, a, b, integrand), deepest)


@pytest.mark.slow_for("cone upside down", "box and lying cylinder")
@pytest.mark.parametrize("name", SHAPES)
def test_integrals_are_those_of_adaptive_quadrature(name: str) -> None:
    for a, b in threads(name, 1, 8):
        found, known = touched(name, a, b), integrals(name, a, b)
        scale = STIFFNESS * known[3]
        np.testing.assert_allclose(found[[6, 7]], known[:2], rtol=1e-10, atol=1e-10 * scale)
        assert found[9] == pytest.approx(known[2], rel=1e-10)
        assert 0.0 < found[10] < known[3] + 1e-5  # at a place of a rule, and at one of 2001 places


@pytest.mark.slow_for(
    "cone", "capsule", "frustum", "sphere and cone", "cone upside down", "widening frustum",
    "box and lying cylinder",
)  # fmt: skip
@pytest.mark.parametrize("name", SHAPES)
def test_spans_are_where_the_distance_is_less(name: str) -> None:
    """By 2001 points of each thread; half of the threads are anywhere, also through the core."""
    random = np.random.default_rng(2)
    s = np.linspace(0.0, 1.0, 2001)
    near, parts, cleared = 0, 0, 0
    passing = [random.uniform(-1.0, 1.0, (2, 3)) for _ in range(15)]
    for a, b in [*threads(name, 2, 15), *passing]:
        c = contact_of(surface(SHAPES[name]))
        for n, solid in enumerate(SHAPES[name]):
            lay(c, n, a, b)
            low, high, clear = span(c, n, rounding_of(solid, EDGE) + THICK)
            depth = depth_in(solid, a + s[:, None] * (b - a))
            # But for round-off, for which `keep_clear` takes 1e-9 of the body's radius off.
            assert 0.0 <= clear <= max(-depth.max(), 0.0) + 1e-15
            is_near = depth > 0.0
            cleared += clear > 0.0
            near += bool(is_near.any())
            parts += bool(is_near.any() and not is_near.all())
            assert np.all((s > low - 1e-12) & (s < high + 1e-12) | ~is_near)
            assert np.all(is_near | (s <= low + 1e-12) | (s >= high - 1e-12))
    assert near > 10
    assert parts > 5
    assert cleared > 5


@pytest.mark.parametrize("name", SHAPES)
def test_forces_are_minus_the_gradient_of_the_energy(name: str) -> None:
    """Virtual work of both ends, on a thread of length 1: central differences of order 4.

    With steps of 1e-5 of 1 m and depths of some 1e-2 m differences are good to 1e-8 of the force where the
    energy is three times differentiable: it is twice, where a thread passes an edge, so of the mean 1e-6.
    """
    h = 1e-5
    for a, b in threads(name, 3, 4):
        found = touched(name, a, b)
        known = np.zeros((2, 3))
        for end, axis in np.ndindex(2, 3):
            energy = []
            for k in (-2.0, -1.0, 1.0, 2.0):
                ends = [a.copy(), b.copy()]
                ends[end][axis] += k * h
                energy.append(touched(name, *ends)[9])
            known[end, axis] = -(energy[0] - 8.0 * energy[1] + 8.0 * energy[2] - energy[3]) / (12.0 * h)
        scale = found[6] + 1e-3 * STIFFNESS * found[10]
        np.testing.assert_allclose([found[:3] - found[3:6], found[3:6]], known, atol=1e-6 * scale)


def damped(name: str, a: Floats, b: Floats, v: Floats, w: Floats) -> Callable[[Floats], Floats]:
    """(n,) -> (n, 8): f n (3), s f n (3), f and (f - F) p'; v, w : (3) velocities of the ends."""

    def integrand(s: Floats) -> Floats:
        at = a + s[:, None] * (b - a)
        depth, own = depths_of(name, at)
        shares = (own / np.maximum(depth, 1e-300)[:, None]) ** 7
        outwards = [
            to_principal(solid, from_core(solid, EDGE, in_solid(solid, at))[1]) for solid in SHAPES[name]
        ]
        n = sum(shares[:, [k]] * direction for k, direction in enumerate(outwards))
        rate = -((v + s[:, None] * (w - v)) * n).sum(axis=1)
        elastic = STIFFNESS * depth
        f = elastic * np.maximum(1.0 + DAMPING * rate, 0.0)
        along = f[:, None] * n
        return np.column_stack([along, s[:, None] * along, f, (f - elastic) * rate])

    return integrand


@pytest.mark.slow_for("box", "box and lying cylinder")
@pytest.mark.parametrize("name", ["box", "cone", "box and lying cylinder"])
def test_damped_forces_and_their_power(name: str) -> None:
    """f = F max(1 + a p', 0) with p' = -(rate of the distance), and (f - F) p', with part of them cut off.

    Where 1 + a p' becomes 0 the integrand has a kink, which adaptive quadrature finds by itself.
    """
    random = np.random.default_rng(4)
    cut_off = 0
    for a, b in threads(name, 5, 2 if name in COMPOUNDS else 6):
        v, w = random.normal(size=(2, 3))
        known = quadrature(name, a, b, damped(name, a, b, v, w))
        found, free = touched(name, a, b, v, w, DAMPING), touched(name, a, b)
        cut_off += found[6] < 0.9 * free[6]
        scale = free[6] + 1e-6
        np.testing.assert_allclose(found[[0, 1, 2, 3, 4, 5, 6, 8]], known, atol=1e-9 * scale)
    assert cut_off > 0


def test_a_seam_is_cut_off_where_the_thread_leaves_fast_enough() -> None:
    """In the groove between two boxes, both of which are touched all along: no force from 0.35 of it on."""
    a, b = (in_principal(0.0, *end) for end in ((-0.3, 0.15), (0.3, 0.15)))
    v, w = (body_of(()).rotation.T @ each for each in ([0.1, -0.2, 0.0], [-0.1, 0.3, 5.0]))
    known = quadrature(TWO_BOXES, a, b, damped(TWO_BOXES, a, b, v, w))
    found, free = touched(TWO_BOXES, a, b, v, w, DAMPING), touched(TWO_BOXES, a, b)
    assert found[6] < 0.2 * free[6]
    np.testing.assert_allclose(found[[0, 1, 2, 3, 4, 5, 6, 8]], known, atol=1e-9 * free[6])


def test_a_seam_is_integrated_as_finely_as_it_needs() -> None:
    """Two boxes become as deep as one another while depths change fast: in four parts it errs by 1e-5."""
    a, b = np.array([0.123, 0.461, -0.111]), np.array([0.063, 0.612, 0.135])
    found, known = touched(TWO_BOXES, a, b), integrals(TWO_BOXES, a, b)
    np.testing.assert_allclose(found[[6, 7, 9]], known[:3], rtol=1e-12)
    assert max(depths_of(TWO_BOXES, np.linspace(a, b, 200))[1].max(axis=0)) < 0.07  # not in a core


def test_two_solids_in_one_place_are_deeper_by_an_eighth_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """(2 p^8)^(1/8), and the direction is as long."""
    monkeypatch.setitem(SHAPES, "twice", (TOUCHED["box"],) * 2)
    a, b = in_principal(0.2, -0.1, 0.198), in_principal(0.45, 0.12, 0.197)
    one, both = touched("box", a, b), touched("twice", a, b)
    root = 2.0**0.125
    np.testing.assert_allclose(both[:6], root**2 * one[:6], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(both[[6, 7, 9]], one[[6, 7, 9]] * [root, root, root**2], rtol=1e-9)


def test_a_thread_that_leaves_fast_is_not_pushed() -> None:
    """1 + a p' < 0 everywhere: f = 0, and what was stored is taken at the rate F p', K p times 2 m/s."""
    a, b = (in_principal(x, 0.0, 0.2) for x in (-0.1, 0.1))
    up = in_principal(0.0, 0.0, 2.0) - in_principal(0.0, 0.0, 0.0)
    found = touched("box", a, b, up, up, damping=1.0)
    np.testing.assert_array_equal(found[:8], 0.0)
    assert found[8] == pytest.approx(STIFFNESS * THICK * 2.0, rel=1e-12)


@pytest.mark.parametrize("name", ["box", TWO_BOXES])
def test_the_work_space_of_one_thread_does_not_count_for_the_next(name: str) -> None:
    """Bitwise as in a fresh work space; every second thread is the middle of another, of fewer pieces."""
    c = contact_of(surface(SHAPES[name]), STIFFNESS)
    number = 0
    for one, other in threads(name, 1, 8):
        shift = 0.45 * (one - other)
        for a, b in ((one, other), (one - shift, other + shift)):
            m, _ = find_spans(c, THICK, tuple(a.tolist()), tuple(b.tolist()))
            known = touched(name, a, b)
            if m and touch(c, THICK, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), m, c.work.sums):
                number += 1
                np.testing.assert_array_equal(c.work.sums, known)
            else:
                assert not known.any()
    assert number > 10


LINES = {
    # On the top of a box of 0.6 x 1.0 x 0.4 m, whose core ends at 0.22, 0.42 and 0.12 m.
    "flat on a face": ("box", (-0.15, -0.2, 0.2), (0.15, 0.25, 0.2)),
    "flat on a face and over both ends": ("box", (-0.5, 0.1, 0.2), (0.5, 0.1, 0.2)),
    "along an edge of the core": ("box", (0.22, -0.2, 0.2), (0.22, 0.3, 0.2)),
    "along a rounded edge": ("box", (0.27, -0.2, 0.175), (0.27, 0.3, 0.175)),
    "through a corner": ("box", (0.22, 0.42, 0.12 + 0.08), (0.3, 0.42, 0.3)),
    "across a seam": (TWO_BOXES, (-0.3, 0.0, 0.2), (0.3, 0.0, 0.2)),
    "along a seam": (TWO_BOXES, (0.0, -0.3, 0.15), (0.0, 0.3, 0.15)),
    "on the flat end of a cylinder": ("cylinder", (-0.2, 0.0, 0.5), (0.2, 0.1, 0.5)),
    "along the side of a cylinder": ("cylinder", (0.4, 0.0, -0.3), (0.4, 0.0, 0.3)),
    "along the side of a cone, through its tip": ("cone", (0.4, 0.0, -0.27), (0.0, 0.0, 0.45)),
}


@pytest.mark.parametrize("line", LINES)
def test_forces_are_continuous_where_a_thread_lies_along_a_face_or_an_edge(line: str) -> None:
    """Noise of 1e-15 m on depths of 1e-2 m changes the force by 1e-13, with round-off of some units.

    Along a seam both boxes push with a share in proportion to the seventh power of the depth, here 5e-3 m.
    """
    name, *ends = LINES[line]
    a, b = (in_principal(*end) for end in ends)
    before = touched(name, a, b)
    assert before[6] > 0.0
    for noise, allowed in ((1e-15, (7.0 if line == "along a seam" else 1.0) * 1e-12), (1e-7, 1e-3)):
        random = np.random.default_rng(7)
        for _ in range(20):
            after = touched(name, *(end + noise * random.normal(size=3) for end in (a, b)))
            assert np.abs(after[:6] - before[:6]).max() < allowed * before[6]

"""Where threads touch, and integrals of the force over them, as plain Python against adaptive quadrature."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from touched_solids import (
    COMPOUNDS,
    EDGE,
    SHAPES,
    SOLIDS,
    body_of,
    contact_of,
    from_core,
    in_solid,
    rounding_of,
    surface,
    to_principal,
)

from exunet.bodies.shapes import Solid
from exunet.forces.contact.segment_surface import (
    find_spans,
    lay,
    order,
    parts_of_seam,
    span,
    split,
    split_at_cone,
    touch,
)

Floats = np.ndarray
STIFFNESS, THICK = 3.0, 0.01  # N/m2, m
DAMPING = 1.5  # s/m
PAIR = "two boxes side by side"


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
    """(n,) depths of a thread's points (n, 3) and (n, k) those in each solid, by the law's words."""
    parts = [
        rounding_of(solid, EDGE) + THICK - from_core(solid, EDGE, in_solid(solid, points))[0]
        for solid in SHAPES[name]
    ]
    own = np.maximum(np.stack(parts, axis=-1), 0.0)
    return np.asarray((own**8).sum(axis=-1) ** 0.125), own


def directions(solid: Solid, points: Floats) -> Floats:
    """(n, 3) in which the distance grows."""
    return to_principal(solid, from_core(solid, EDGE, in_solid(solid, points))[1])


def touched(
    name: str, a: Any, b: Any, v: Any = (0, 0, 0), w: Any = (0, 0, 0), damping: float = 0.0
) -> Floats:
    """(12,) what `touch` finds; zeros where nothing is touched."""
    c = contact_of(surface(SHAPES[name]), STIFFNESS, damping)
    a, b, v, w = (tuple(map(float, part)) for part in (a, b, v, w))
    m, _ = find_spans(c, THICK, a, b)
    found = m > 0 and touch(c, THICK, v, w, m, c.sums)
    return c.sums.copy() if found else np.zeros(12)


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

        def excess(s: float, solid: Solid = solid) -> float:
            distance, _ = from_core(solid, EDGE, in_solid(solid, (a + s * (b - a))[None]))
            return float(distance[0]) - rounding_of(solid, EDGE) - THICK

        distances = from_core(solid, EDGE, in_solid(solid, a + s[:, None] * (b - a)))[0]
        is_near = distances < rounding_of(solid, EDGE) + THICK
        at = np.flatnonzero(is_near[1:] != is_near[:-1])
        found += [brentq(excess, s[k], s[k + 1], xtol=1e-15) for k in at]
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
    for a, b in threads(name, 1, 12):
        found, known = touched(name, a, b), integrals(name, a, b)
        scale = STIFFNESS * known[3]
        np.testing.assert_allclose(found[[6, 7]], known[:2], rtol=1e-10, atol=1e-10 * scale)
        assert found[9] == pytest.approx(known[2], rel=1e-10)
        assert 0.0 < found[10] < known[3] + 1e-5  # at a place of a rule, and at one of 2001 places


@pytest.mark.slow_for(
    "cone",
    "capsule",
    "frustum",
    "sphere and cone",
    "cone upside down",
    "widening frustum",
    "box and lying cylinder",
)
@pytest.mark.parametrize("name", SHAPES)
def test_spans_are_where_the_distance_is_less(name: str) -> None:
    """By 2001 points of each thread; half of the threads are anywhere, also through the core."""
    random = np.random.default_rng(2)
    s = np.linspace(0.0, 1.0, 2001)
    near, parts, cleared = 0, 0, 0
    passing = [random.uniform(-1.0, 1.0, (2, 3)) for _ in range(15)]
    for a, b in [*threads(name, 2, 15), *passing]:
        c = contact_of(surface(SHAPES[name]))
        own = depths_of(name, a + s[:, None] * (b - a))[1]
        for n, solid in enumerate(SHAPES[name]):
            lay(c, n, a, b)
            reach = rounding_of(solid, EDGE) + THICK
            low, high, clear = span(c, n, reach)
            distance = from_core(solid, EDGE, in_solid(solid, a + s[:, None] * (b - a)))[0] - reach
            # But for round-off, for which `keep_clear` takes 1e-9 of the body's radius off.
            assert 0.0 <= clear <= max(distance.min(), 0.0) + 1e-15
            cleared += clear > 0.0
            is_near = own[:, n] > 0.0
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
        on_b = found[3:6]
        on_a = found[0:3] - on_b
        known = np.zeros((2, 3))
        for end in range(2):
            for axis in range(3):
                energy = []
                for k in (-2.0, -1.0, 1.0, 2.0):
                    ends = [a.copy(), b.copy()]
                    ends[end][axis] += k * h
                    energy.append(touched(name, *ends)[9])
                known[end, axis] = -(energy[0] - 8.0 * energy[1] + 8.0 * energy[2] - energy[3]) / (12.0 * h)
        scale = found[6] + 1e-3 * STIFFNESS * found[10]
        np.testing.assert_allclose([on_a, on_b], known, atol=1e-6 * scale)


def damped(name: str, a: Floats, b: Floats, v: Floats, w: Floats) -> Callable[[Floats], Floats]:
    """(n,) -> (n, 8): f n (3), s f n (3), f and (f - F) p'; v, w : (3) velocities of the ends."""

    def integrand(s: Floats) -> Floats:
        at = a + s[:, None] * (b - a)
        depth, own = depths_of(name, at)
        shares = (own / np.maximum(depth, 1e-300)[:, None]) ** 7
        n = sum(shares[:, [k]] * directions(solid, at) for k, solid in enumerate(SHAPES[name]))
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
        found = touched(name, a, b, v, w, DAMPING)
        free = touched(name, a, b)
        cut_off += found[6] < 0.9 * free[6]
        scale = free[6] + 1e-6
        np.testing.assert_allclose(found[[0, 1, 2, 3, 4, 5, 6, 8]], known, atol=1e-9 * scale)
    assert cut_off > 0


def test_along_a_seam_the_force_is_cut_off_where_the_thread_leaves_fast_enough() -> None:
    """In the groove between two boxes, both of which are touched all along: at 0 from some 0.35 of it on."""
    solid = SHAPES[PAIR][0]
    a, b = (in_principal(solid, (0.0, *end)) for end in ((-0.3, 0.15), (0.3, 0.15)))
    v, w = (body_of((solid,)).rotation.T @ each for each in ([0.1, -0.2, 0.0], [-0.1, 0.3, 5.0]))
    known = quadrature(PAIR, a, b, damped(PAIR, a, b, v, w))
    found, free = touched(PAIR, a, b, v, w, DAMPING), touched(PAIR, a, b)
    assert found[6] < 0.2 * free[6]
    np.testing.assert_allclose(found[[0, 1, 2, 3, 4, 5, 6, 8]], known, atol=1e-9 * free[6])


# Continuity


def changes(name: str, ends: Any, noise: float, seed: int = 7, number: int = 20) -> float:
    """The largest change of the forces on both ends by noise [m] at the ends, over the force."""
    random = np.random.default_rng(seed)
    a, b = (np.array(end, dtype=float) for end in ends)
    before = touched(name, a, b)
    assert before[6] > 0.0
    largest = 0.0
    for _ in range(number):
        after = touched(name, a + noise * random.normal(size=3), b + noise * random.normal(size=3))
        largest = max(largest, np.abs(after[:6] - before[:6]).max() / before[6])
    return largest


def in_principal(solid: Solid, point: Any) -> Floats:
    """A point in the axes of a solid, in those of the body."""
    return np.asarray(body_of((solid,)).in_principal_axes(np.array(point)))


LINES = {
    # On the top of a box of 0.6 x 1.0 x 0.4 m, whose core ends at 0.22, 0.42 and 0.12 m.
    "flat on a face": ("box", (-0.15, -0.2, 0.2), (0.15, 0.25, 0.2)),
    "flat on a face and over both ends": ("box", (-0.5, 0.1, 0.2), (0.5, 0.1, 0.2)),
    "along an edge of the core": ("box", (0.22, -0.2, 0.2), (0.22, 0.3, 0.2)),
    "along a rounded edge": ("box", (0.27, -0.2, 0.175), (0.27, 0.3, 0.175)),
    "through a corner": ("box", (0.22, 0.42, 0.12 + 0.08), (0.3, 0.42, 0.3)),
    "across a seam": (PAIR, (-0.3, 0.0, 0.2), (0.3, 0.0, 0.2)),
    "along a seam": (PAIR, (0.0, -0.3, 0.15), (0.0, 0.3, 0.15)),
    "on the flat end of a cylinder": ("cylinder", (-0.2, 0.0, 0.5), (0.2, 0.1, 0.5)),
    "along the side of a cylinder": ("cylinder", (0.4, 0.0, -0.3), (0.4, 0.0, 0.3)),
    "along the side of a cone, through its tip": ("cone", (0.4, 0.0, -0.27), (0.0, 0.0, 0.45)),
}


@pytest.mark.parametrize("line", LINES)
def test_noise_of_1e_15_m_changes_a_force_by_1e_12_at_most(line: str) -> None:
    """Depths of 1e-2 m: 1e-15 / 1e-2 is 1e-13, with round-off of some units.

    Along a seam both boxes push with a share in proportion to the seventh power of the depth, here 5e-3 m.
    """
    name, a, b = LINES[line]
    solid = SHAPES[name][0]
    ends = [in_principal(Solid(solid.kind, solid.numbers), end) for end in (a, b)]
    assert changes(name, ends, 1e-15) < (7.0 if line == "along a seam" else 1.0) * 1e-12
    # And in proportion to larger noise: the force has no jump.
    assert changes(name, ends, 1e-7) < 1e-3


PASSES = {
    "over an edge": ("box", (1.0, 0.0, 0.0), (0.2, -0.1, 0.198), (0.45, 0.1, 0.198)),
    "across it": ("box", (1.0, 0.0, 0.0), (0.3, -0.1, 0.0), (0.3, 0.1, 0.2)),
    "across a seam": (PAIR, (1.0, 0.0, 0.0), (-0.05, -0.1, 0.198), (0.05, 0.2, 0.198)),
    "over a rim": ("cylinder", (1.0, 0.0, 0.0), (0.2, -0.1, 0.498), (0.45, 0.1, 0.498)),
    "over a tip": ("cone", (1.0, 0.0, 0.0), (-0.1, -0.1, 0.28), (0.1, 0.15, 0.28)),
    "turning until it is flat": ("box", (0.0, 0.0, 0.0), (-0.1, -0.1, 0.199), (0.1, 0.1, 0.199)),
}


@pytest.mark.slow_for("across it", "over a rim", "over a tip", "across a seam")
@pytest.mark.parametrize("name", PASSES)
def test_forces_have_no_jump_along_a_way(name: str) -> None:
    """Steps of a way of 0.2 m: the largest change of the force in one falls with the step, down to 1e-7 m."""
    shape, way, a, b = PASSES[name]
    solid = Solid(SHAPES[shape][0].kind, SHAPES[shape][0].numbers)

    def force(s: float) -> Floats:
        shift = (s - 0.1) * np.array(way)
        tilt = np.array([0.0, 0.0, 0.02 * (s - 0.1) if not np.any(way) else 0.0])
        one = in_principal(solid, np.array(a) + shift - tilt)
        return touched(shape, one, in_principal(solid, np.array(b) + shift + tilt))[:6]

    coarse = np.linspace(0.0, 0.2, 201)
    found = np.array([force(s) for s in coarse])
    scale = np.abs(found).max()
    assert scale > 0.0
    at = int(np.abs(np.diff(found, axis=0)).max(axis=1).argmax())
    low, high = coarse[at], coarse[at + 1]
    for _ in range(40):  # where the change is, ever nearer
        middle = 0.5 * (low + high)
        first, half, last = force(low), force(middle), force(high)
        low, high = (
            (low, middle) if np.abs(half - first).max() > np.abs(last - half).max() else (middle, high)
        )
        if high - low < 1e-9:
            break
    assert np.abs(force(high) - force(low)).max() < 1e-4 * scale


def test_a_thread_that_leaves_fast_is_not_pushed_and_its_energy_is_booked() -> None:
    """1 + a p' < 0 everywhere: f = 0, and what was stored is taken at the rate F p', K p times 2 m/s."""
    solid = SOLIDS["box"]
    a, b = (in_principal(solid, (x, 0.0, 0.2)) for x in (-0.1, 0.1))
    up = in_principal(solid, (0.0, 0.0, 2.0)) - in_principal(solid, (0.0, 0.0, 0.0))
    found = touched("box", a, b, up, up, damping=1.0)
    np.testing.assert_array_equal(found[:8], 0.0)
    assert found[8] == pytest.approx(STIFFNESS * THICK * 2.0, rel=1e-12)


# Where pieces are parted


def test_lines_are_parted_where_they_cross_a_cone() -> None:
    """x^2 + y^2 = (width + slope z)^2, by the roots of a polynomial; both of them within some bounds."""
    random, number = np.random.default_rng(30), [0, 0, 0]
    for k in range(60):
        p, d = random.normal(size=(2, 3))
        width, slope = random.uniform(0.1, 1.0), random.normal() if k % 2 else 0.0
        w, g = width + slope * p[2], slope * d[2]
        roots = np.roots([d[:2] @ d[:2] - g * g, 2.0 * (p[:2] @ d[:2] - w * g), p[:2] @ p[:2] - w * w])
        low, high = (-1.5, 2.0) if k % 3 else (-9.0, 9.0)
        known = sorted(item for item in roots.real if low < item < high) if np.isreal(roots).all() else []
        splits = np.full(6, np.nan)
        m = split_at_cone(tuple(p), tuple(d), width, slope, low, high, splits, 2)
        assert sorted(splits[2:m]) == pytest.approx(known, rel=1e-9)
        number[m - 2] += 1
    assert min(number) > 5


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("beside", [0.0, 1e-12, -1e-12])
def test_a_line_along_a_cone_is_parted_as_exactly(beside: float, sign: float) -> None:
    """x = 1/2 + s/5 meets 7/10 - s/5 at 1/2; the other crossing is 1e12 away, or nowhere. Forth and back."""
    splits, begin = np.zeros(4), 0.0 if sign > 0.0 else 1.0
    g = -0.2 * (1.0 + beside)
    p, d = (0.5 + 0.2 * begin, 0.0, g * begin), (0.2 * sign, 0.0, g * sign)
    assert split_at_cone(p, d, 0.7, 1.0, 0.0, 1.0, splits, 0) == 1
    at = 0.2 / (0.2 - g)
    assert splits[0] == pytest.approx(at if sign > 0.0 else 1.0 - at, rel=1e-12)


def test_splits_are_between_bounds_and_in_order_and_no_more_than_there_is_room() -> None:
    splits = np.full(4, 9.0)
    m = 0
    for item in (0.5, 0.0, 1.0, 0.25, 0.75, 0.6, 0.1):
        m = split(item, 0.0, 1.0, splits, m)
    assert m == 4
    assert splits.tolist() == [0.5, 0.25, 0.75, 0.6]
    order(splits, 3)
    assert splits.tolist() == [0.25, 0.5, 0.75, 0.6]
    order(splits, 4)
    assert splits.tolist() == [0.25, 0.5, 0.6, 0.75]


def test_a_seam_is_integrated_as_finely_as_it_needs() -> None:
    """Two boxes become as deep as one another while depths change fast: in four parts it errs by 1e-5."""
    a, b = np.array([0.123, 0.461, -0.111]), np.array([0.063, 0.612, 0.135])
    found, known = touched(PAIR, a, b), integrals(PAIR, a, b)
    np.testing.assert_allclose(found[[6, 7, 9]], known[:3], rtol=1e-12)
    assert max(depths_of(PAIR, np.linspace(a, b, 200))[1].max(axis=0)) < 0.07  # not in a core


def test_two_solids_in_one_place_are_deeper_by_an_eighth_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """(2 p^8)^(1/8), and the direction is as long: along a thread nothing tells one from the other."""
    box = SOLIDS["box"]
    monkeypatch.setitem(SHAPES, "twice", (box, box))
    a, b = (in_principal(box, end) for end in ((0.2, -0.1, 0.198), (0.45, 0.12, 0.197)))
    one, both = touched("box", a, b), touched("twice", a, b)
    root = 2.0**0.125
    np.testing.assert_allclose(both[:6], root**2 * one[:6], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(both[[6, 7, 9]], one[[6, 7, 9]] * [root, root, root**2], rtol=1e-9)


def test_a_piece_on_a_seam_has_a_part_for_each_eighth_of_the_depth() -> None:
    """By which the difference of both distances changes along it, over the least depth; 4 to 64 of them."""
    random, counts = np.random.default_rng(31), []
    for _ in range(60):
        a = np.array([0.123, 0.461, -0.111]) + 0.02 * random.normal(size=3)
        b = np.array([0.063, 0.612, 0.135]) + 0.02 * random.normal(size=3)
        c = contact_of(surface(SHAPES[PAIR]))
        m, _ = find_spans(c, THICK, tuple(a), tuple(b))
        for low, high in pairwise(c.splits[:m].tolist()):
            middle = 0.5 * (low + high)
            if not all(begin < middle < end for begin, end in c.spans):
                continue
            depth, own = depths_of(PAIR, a + np.array([[low], [middle], [high]]) * (b - a))
            if own.max() > 0.08:  # in a core
                continue
            falls = own[0] - own[2]
            known = 8.0 * (falls.max() - falls.min()) / depth.min()
            counts.append(parts_of_seam(c, THICK, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), low, high))
            assert abs(counts[-1] - min(max(known, 4.0), 64.0) + 0.5) <= 0.5 + 1e-6
    assert len(counts) > 20
    assert len(set(counts)) > 8


@pytest.mark.parametrize("name", ["box", "frustum", PAIR])
def test_what_a_thread_leaves_in_the_work_space_does_not_count_for_the_next(name: str) -> None:
    """The same bits as in a fresh one; every other one is the middle part of a thread, of fewer pieces."""
    c = contact_of(surface(SHAPES[name]), STIFFNESS)
    parts = [(a - 0.45 * (a - b), b + 0.45 * (a - b)) for a, b in threads(name, 1, 12)]
    number = 0
    for one, part in zip(threads(name, 1, 12), parts, strict=True):
        for a, b in (one, part):
            m, _ = find_spans(c, THICK, tuple(a.tolist()), tuple(b.tolist()))
            known = touched(name, a, b)
            if m and touch(c, THICK, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), m, c.sums):
                number += 1
                np.testing.assert_array_equal(c.sums, known)
            else:
                assert not known.any()
    assert number > 15


def test_a_solid_for_whose_ends_there_is_no_room_is_left_out() -> None:
    """A ball has no more splits than its ends."""
    a, b = threads("sphere", 1, 1)[0]
    for room, number in ((3, 2), (2, 2), (1, 0)):
        c = contact_of(surface(SHAPES["sphere"]))
        c.splits = np.zeros(room)
        assert find_spans(c, THICK, tuple(a.tolist()), tuple(b.tolist()))[0] == number

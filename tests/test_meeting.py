"""How near threads come to each other: against a least-squares fit with bounds, pair by pair."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from result_samples import net
from scipy.optimize import lsq_linear

from exunet.net.arrays import Net
from exunet.net.mesh_checks import between_segments, nearest

Floats = np.ndarray


def apart(one: Floats, other: Floats) -> float:
    """Least distance of two pieces (2, 3): of |r + s d - t e| over 0 <= s, t <= 1."""
    ways = np.stack([one[1] - one[0], other[0] - other[1]], axis=1)
    found = lsq_linear(ways, other[0] - one[0], (0.0, 1.0), method="bvls", tol=1e-15)
    return float(np.sqrt(2.0 * found.cost))


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e4])
def test_distances_of_pieces(scale: float) -> None:
    """Nearest within both, at an end of one and at ends of both, and pieces that are parallel."""
    rng = np.random.default_rng(5)
    one, other = rng.normal(size=(2, 120, 2, 3))
    other[:40] += rng.normal(size=(40, 1, 3)) * 3.0
    along = (one[80:, 1] - one[80:, 0])[:, None]
    other[80:] = one[80:] + rng.normal(size=(40, 1, 1)) * along + rng.normal(size=(40, 1, 3))
    other[100:, 1] = other[100:, 0] - 0.7 * along[20:, 0]
    known = [apart(*pair) for pair in zip(one, other, strict=True)]
    for pair in ((one, other), (other, one)):
        found = between_segments(*(scale * part for part in pair))
        np.testing.assert_allclose(found / scale, known, rtol=1e-6, atol=1e-9)


def tangle(number: int, seed: int) -> Net:
    """Separate pieces and chains of two."""
    rng = np.random.default_rng(seed)
    begin = rng.uniform(-1.0, 1.0, (number, 3)) * (1.0, 2.0, 0.3)
    ends = begin + rng.normal(size=(number, 3)) * 0.3
    chained = [(number + k, k + 1) for k in range(0, number - 1, 3)]
    of = net(np.concatenate([begin, ends]), [*((k, number + k) for k in range(number)), *chained])
    of.is_string[1::4] = True
    return of


@pytest.mark.parametrize("strings", [True, False])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (-7.0, -5.0, -3.0), (1.2, -2.3, 40.0)])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_nearest_of_all_that_share_no_node(
    seed: int, shift: tuple[float, float, float], strings: bool
) -> None:
    """Wherever they are."""
    of = tangle(24, seed)
    position, every = of.reference_position + shift, of.element_nodes
    rows = [k for k in range(len(every)) if strings or not of.is_string[k]]
    known = {
        (a, b): apart(position[every[a]], position[every[b]])
        for a, b in combinations(rows, 2)
        if not set(every[a]) & set(every[b])
    }
    least = min(known.values())
    assert nearest(of, position, least * (1.0 - 1e-6), strings=strings) is None
    for within in (least * (1.0 + 1e-6), 3.0 * least, 10.0):
        found = nearest(of, position, within, strings=strings)
        assert found is not None
        assert found.distance == pytest.approx(least, rel=1e-9)
        assert known[tuple(found.elements.tolist())] == pytest.approx(least, rel=1e-9)
        point = np.tile(found.place, (2, 1))
        point[1, 2] += 1e-12
        for element in found.elements:
            assert apart(position[every[element]], point) == pytest.approx(0.5 * least, rel=1e-6)


def test_pieces_that_are_a_little_nearer_than_asked_are_found() -> None:
    """Two that are parallel, 1 - 2e-10 apart along the largest side of their boxes; not those 1 apart."""
    of = net([(0, 0, 0), (0.5, 0, 0), (0, 1, 0), (0.5, 1, 0)], [(0, 1), (2, 3)])
    assert nearest(of, of.reference_position, 1.0) is None
    nearer = of.reference_position * (1.0, 1.0 - 2e-10, 1.0)
    found = nearest(of, nearer, 1.0)
    assert found is not None
    assert found.distance == 1.0 - 2e-10


@pytest.mark.parametrize("pair", [(3, 2100), (2050, 2100), (2047, 2048)])
def test_among_thousands(pair: tuple[int, int]) -> None:
    """Pieces 0.1 m long in a row, 1 m from each other; one has been put 1 cm beside another."""
    x = np.arange(2200.0)
    ends = np.stack(
        [np.stack([x, 0.0 * x, 0.0 * x], axis=1), np.stack([x + 0.1, 0.0 * x, 0.0 * x], axis=1)], axis=1
    )
    ends[pair[1]] = ends[pair[0]] + (0.0, 0.01, 0.0)
    of = net(ends.reshape(-1, 3), np.arange(4400).reshape(-1, 2))
    found = nearest(of, of.reference_position, 0.5)
    assert found is not None
    assert found.elements.tolist() == list(pair)
    assert found.distance == pytest.approx(0.01, rel=1e-12)

"""Where nets are creased, by whole numbers and every choice; and how values then lie to and fro."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from pydantic import TypeAdapter
from result_samples import net

from exunet.net import TOPOLOGIES, AnyNetConfig
from exunet.net.folding import creases, narrowest, pleated, usable, widths


def equal_by_hand(lines: list[int], low: int, high: int, room: int) -> list[int] | None:
    """Pleats of one width: even numbers of them first, then the widest, the fewest, the most symmetric."""
    every = sorted({b - a for a, b in combinations(lines, 2)} | {high - low}, reverse=True)
    for even in (True, False):
        for width in (item for item in every if item <= room):
            tried = [list(range(start, high, width)) for start in lines if start - low <= width]
            tried = [entry for entry in tried if set(entry) <= set(lines) and not (even and len(entry) % 2)]
            if tried:
                return min(
                    tried, key=lambda element: (len(element), abs((element[0] - low) - (high - element[-1])))
                )
    return None


def to_the_walls_by_hand(lines: list[int], low: int, high: int, room: int) -> list[int] | None:
    """Each pleat ends at the last line that is still in the room."""
    found: list[int] = []
    begin, place, way = low, 0, 1
    while (last := begin + (room - place if way > 0 else place)) < high:
        ends = [line for line in lines if begin < line <= last]
        if not ends:
            return None
        place, begin, way = place + way * (ends[-1] - begin), ends[-1], -way
        found.append(begin)
    return found


def by_hand(lines: list[int], low: int, high: int, room: int) -> list[int] | None:
    if high - low <= room:
        return []
    equal, other = equal_by_hand(lines, low, high, room), to_the_walls_by_hand(lines, low, high, room)
    if equal is None or (other is not None and len(other) < 0.75 * len(equal)):
        return other
    return equal


@pytest.mark.parametrize("unit", [1.0, 0.1, 1.0 / 3.0])
@pytest.mark.parametrize("seed", range(4))
def test_creases_by_every_choice(seed: int, unit: float) -> None:
    """Lines at random whole numbers of a unit: round-off decides nothing."""
    rng, kinds = np.random.default_rng(seed), set()
    for _ in range(60):
        low, length = int(rng.integers(-20, 5)), int(rng.integers(4, 30))
        inside = range(low + 1, low + length)
        few = int(rng.integers(max(1, len(inside) // 3), len(inside) + 1))
        lines = sorted(rng.choice(list(inside), few, replace=False).tolist())
        room = int(rng.integers(1, length + 1))
        asked = unit * np.array([low, *lines, low + length], dtype=float)
        known = by_hand(lines, low, low + length, room)
        found = creases(asked, asked[0], asked[-1], room * unit)
        if known is None:
            assert found is None
        else:
            assert found is not None
            at = (np.array(found) / unit).round(6).tolist()
            kinds.add((len(known) % 2, known == to_the_walls_by_hand(lines, low, low + length, room)))
            assert at == known
    assert len(kinds) > 2


@pytest.mark.parametrize("seed", range(4))
def test_the_narrowest_pleats(seed: int) -> None:
    """Of all widths the least room for which there are creases; widths decrease, the whole comes first."""
    rng = np.random.default_rng(seed)
    lines = np.sort(rng.choice(np.arange(1, 20), 8, replace=False))
    found = widths(lines.astype(float), 0.0, 20.0).tolist()
    assert found == [20.0, *sorted({float(b - a) for a, b in combinations(lines.tolist(), 2)}, reverse=True)]
    least = min(room for room in found if by_hand(lines.tolist(), 0, 20, int(room)) is not None)
    assert narrowest(lines.astype(float), 0.0, 20.0) == least


def test_lines_that_are_one_but_for_round_off() -> None:
    """Of two as near to where a crease is wanted the farther one; widths are those in the middle."""
    lines = np.arange(1.0, 601.0)
    two = 2.0 + np.array([-(2.0**-24), 2.0**-24])  # 6e-8, less than 1e-7 of the net
    lines = np.concatenate([lines[:1], two, lines[2:]])
    found = creases(lines, 0.0, 601.0, 1.0)
    assert found is not None
    np.testing.assert_array_equal(found, np.delete(lines, 1))


def test_values_lie_to_and_fro() -> None:
    """Creases at 2, 3 and 7 of values from 0 to 9: places |0 2|, |2 1|, |1 5|, |5 3|, less the mean of ends.

    The value 6.9 is joined to 7.5 by an element that crosses the crease at 7, and is drawn to it; 2.25 lies
    within the 0.25 that count as on the crease.
    """
    values = np.array([0.0, 1.0, 2.25, 2.6, 4.0, 6.9, 7.5, 9.0])
    elements = np.array([(0, 1), (2, 3), (5, 6), (6, 7)])
    found = pleated(values, np.array([2.0, 3.0, 7.0]), elements, 0.25)
    along = np.array([0.0, 1.0, 2.0, 2.6, 4.0, 7.0, 7.5, 9.0])
    np.testing.assert_allclose(found.along, along - 4.5, atol=1e-15)
    place = np.array([0.0, 1.0, 2.0, 1.4, 2.0, 5.0, 4.5, 3.0])
    np.testing.assert_allclose(found.place, place - 2.5, atol=1e-14)
    assert found.pleat.tolist() == [0.0, 0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 3.0]
    assert found.forward.tolist()[:2] == [1.0, 1.0]
    assert found.forward.tolist()[3:5] == [-1.0, 1.0]
    assert found.forward.tolist()[6:] == [-1.0, -1.0]
    assert found.number == 4


def test_of_an_element_across_a_crease_the_nearer_end_is_drawn_to_it() -> None:
    """From either side; one with an end on the crease does not cross it."""
    values = np.array([-3.0, -1.0, 0.5, 2.0, 0.0, 1.5])
    found = pleated(values, np.array([0.0]), np.array([(1, 2), (0, 4), (4, 5), (3, 0)]), 1e-9)
    np.testing.assert_allclose(found.along + 0.5 * (-3.0 + 1.5), [-3.0, -1.0, 0.0, 0.0, 0.0, 1.5], atol=1e-15)


def test_lines_that_elements_cross_but_for_close_to_an_end() -> None:
    """One of 2 m along x, another of 1 m up from its end: they are crossed beyond 5 % of that from an end."""
    of = net([(-1.0, 0.5, 0.0), (1.0, 0.5, 0.0), (1.0, 1.5, 0.0)], [(0, 1), (1, 2)])
    lines = np.array([-1.2, -1.0, -0.91, -0.89, 0.0, 0.89, 0.91, 1.0, 1.2])
    assert usable(lines, of, 0, 0.05).tolist() == [-1.2, -1.0, -0.91, 0.91, 1.0, 1.2]
    up = np.array([0.4, 0.5, 0.54, 0.56, 1.0, 1.44, 1.46, 1.5, 1.6])
    assert usable(up, of, 1, 0.05).tolist() == [0.4, 0.5, 0.54, 1.46, 1.5, 1.6]
    assert usable(up, of, 1, 0.0).tolist() == [0.4, 0.5, 1.5, 1.6]
    half = np.array([-0.5, -0.49, 0.49, 0.5])
    assert usable(half, of, 0, 0.25).tolist() == [-0.5, 0.5]  # a quarter of the length itself is not beyond


@pytest.mark.parametrize("length", [0.01, 1.0, 100.0])
def test_lines_at_an_end_are_not_crossed(length: float) -> None:
    """Within a millionth of the length; five times as much is beyond."""
    of = net([(-length, 0.0, 0.0), (0.0, 0.0, 0.0)], [(0, 1)])
    off = 1e-6 * length * np.array([-0.5, 0.5])
    at_ends = np.concatenate([off - length, off])
    assert usable(at_ends, of, 0, 0.0).tolist() == at_ends.tolist()
    assert usable(10.0 * off - length, of, 0, 0.0).tolist() == [10.0 * off[0] - length]
    assert usable(10.0 * off, of, 0, 0.0).tolist() == [10.0 * off[1]]


def test_what_fits_is_not_creased() -> None:
    """To a ten-millionth of its size."""
    lines = np.arange(-3.0, 5.0)
    for room in (9.0, 9.0 - 5e-7, 12.0):
        found = creases(lines, -4.0, 5.0, room)
        assert found is not None
        assert len(found) == 0
    assert creases(lines, -4.0, 5.0, 9.0 - 2e-6).tolist() != []


KEYS = TypeAdapter(AnyNetConfig)
CABLE = {"diameter": 1e-3, "density": 1390.0, "youngs_modulus": 7e10}
FOLDED = {
    "square": {"topology": "square", "size": 3.0, "mesh": 0.6},
    "rectangular": {"topology": "rectangular", "size": [4.0, 2.4], "mesh": [0.25, 0.4]},
    "one cell": {"topology": "hexagonal", "mesh": 0.7, "rings": 0},
    "honeycomb": {"topology": "hexagonal", "mesh": 2.5, "rings": 5},
    **{
        f"cut {shape}": {
            "topology": "cut",
            "outline": "octagon",
            "size": 5.0,
            "mesh": 0.7,
            "mesh_shape": shape,
        }
        for shape in ("square", "hexagon")
    },
}


@pytest.mark.parametrize("name", FOLDED)
def test_lines_to_fold_along_are_those_of_knots(name: str) -> None:
    """Of each knot there is one along both axes, but for those on a cut; and no others inside."""
    keys = KEYS.validate_python(
        {"cable": CABLE} | ({"border": CABLE} if "cut" in name else {}) | FOLDED[name]
    )
    topology = TOPOLOGIES[keys.topology]
    found = topology.mesh(keys)
    knots = found.knots[: len(found.knots) - found.n_border]
    for axis, lines in enumerate(topology.fold_lines(keys)):
        assert (np.diff(lines) > 0.0).all()
        values = knots[:, axis]
        assert abs(values[:, None] - lines).min(axis=1).max() < 1e-12
        inside = lines[(lines > values.min() - 1e-9) & (lines < values.max() + 1e-9)]
        assert abs(inside[:, None] - values).min(axis=1).max() < 1e-12

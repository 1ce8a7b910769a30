"""Folded nets by the rules of docs/explanation/theory.md: creases, layers, canisters, stars, strings."""

from __future__ import annotations

import json
import math
import re
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from result_samples import net
from scenes import CASES
from scipy.spatial import cKDTree

import exunet
from exunet.base.errors import CaseError
from exunet.net import AnyNetConfig, weave
from exunet.net.arrays import Net
from exunet.net.folding import (
    Fold,
    Folded,
    check_chords,
    check_strings,
    creases,
    folded,
    narrowest,
    pleated,
    spread,
    usable,
    widths,
    with_strings,
)
from exunet.net.weave import between_segments, nearest
from exunet.verification.reference_run import ReferenceRun

KEYS = TypeAdapter(AnyNetConfig)
THREAD = 1e-3
CABLE = {"diameter": THREAD, "density": 1390.0, "youngs_modulus": 7e10}


# Creases of given lines


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
@pytest.mark.parametrize("seed", range(2))
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


@pytest.mark.parametrize("seed", range(2))
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


def test_pleated_values() -> None:
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


STRINGS = CABLE | {"length": 1.0}
SQUARE = {"topology": "square", "size": 5.0, "mesh": 0.5}
RECTANGLE = {"topology": "rectangular", "size": [4.0, 2.4], "mesh": [0.25, 0.4]}
HONEYCOMB = {"topology": "hexagonal", "mesh": 0.5, "rings": 3}
CUT = {"topology": "cut", "size": 5.0, "mesh": 0.5, "border": CABLE}
OCTAGON = CUT | {"outline": "octagon", "mesh_shape": "square"}
CIRCLE = CUT | {"outline": "circle", "corners": 8, "mesh_shape": "square", "mesh": 0.37}
TRIANGLES = CUT | {"outline": "hexagon", "mesh_shape": "triangle", "size": 6.0}
WEB = {"topology": "radial", "radius": 2.5, "spokes": 8, "rings": 10}
BOX = {"pattern": "accordion", "box": [1.3, 1.3, 0.4]}
WIDE = {"pattern": "accordion", "box": [8.0, 1.3, 0.1]}
STAR = {"pattern": "star", "cylinder": [2.0, 0.6]}

ONE_WAY = {
    "square": (SQUARE, WIDE),
    "narrow pleats": (SQUARE, {"pattern": "accordion", "box": [8.0, 0.51, 0.1]}),
    "along x": (SQUARE, {"pattern": "accordion", "box": [1.3, 8.0, 0.1]}),
    "rectangle": (RECTANGLE, WIDE),
    "honeycomb": (HONEYCOMB, WIDE),
    "octagon": (OCTAGON, WIDE),
    "circle": (CIRCLE, WIDE),
    "triangles": (TRIANGLES, WIDE),
    "divided": (SQUARE | {"divisions": 3}, WIDE),
}
TWO_WAYS = {
    "square": (SQUARE, BOX),
    "smallest": (SQUARE | {"size": 3.0}, {"pattern": "accordion", "box": [0.51, 0.51, 0.4]}),
    "cylinder": (SQUARE, {"pattern": "accordion", "cylinder": [0.6, 0.4]}),
    "rectangle": (RECTANGLE, {"pattern": "accordion", "box": [0.9, 0.9, 0.4]}),
    "honeycomb": (HONEYCOMB, BOX),
    "octagon": (OCTAGON, BOX),
    "circle": (CIRCLE | {"mesh": 0.5}, BOX),
    "divided": (SQUARE | {"divisions": 2}, BOX),
}
STARS = {
    "eight": (WEB, STAR),
    "four": (WEB | {"spokes": 4}, {"pattern": "star", "cylinder": [3.0, 2.6]}),
    "six": (WEB | {"spokes": 6}, {"pattern": "star", "cylinder": [3.0, 2.6]}),
    "one pleat": (WEB | {"spokes": 24}, {"pattern": "star", "box": [1.4, 1.4, 2.6]}),
    "a pleat a ring": (WEB | {"spokes": 12, "rings": 8}, {"pattern": "star", "cylinder": [1.4, 0.4]}),
    "divided": (WEB | {"spokes": 16, "divisions": 2}, STAR),
}


def fold(net: dict[str, Any], how: dict[str, Any], **others: Any) -> tuple[Net, Folded]:
    keys = KEYS.validate_python({"cable": CABLE, "strings": STRINGS, "bullets": {"mass": 0.5}} | net | others)
    woven = weave(keys)
    return woven, folded(woven, keys, Fold.model_validate(how))


def refused(net: dict[str, Any], how: dict[str, Any], **others: Any) -> str:
    with pytest.raises(CaseError) as caught:
        fold(net, how, **others)
    return str(caught.value)


def chords(of: Net, position: np.ndarray) -> np.ndarray:
    """Distance between the ends of each element, as a part of its reference length."""
    i, j = of.element_nodes.T
    return np.asarray(np.linalg.norm(position[j] - position[i], axis=1) / of.reference_length)


def least_apart(of: Net, position: np.ndarray, *, strings: bool = True) -> float:
    """Between threads that share no node [m], by looking at every pair whose boxes are near each other."""
    ends = of.element_nodes[strings | ~of.is_string]
    low, high = position[ends].min(axis=1) - 0.01, position[ends].max(axis=1) + 0.01
    a, b = np.triu_indices(len(ends), 1)
    near = ((low[a] < high[b]) & (low[b] < high[a])).all(axis=1)
    a, b = a[near], b[near]
    strange = (ends[a][:, :, None] != ends[b][:, None, :]).all(axis=(1, 2))
    return float(between_segments(position[ends[a[strange]]], position[ends[b[strange]]]).min(initial=0.01))


ALL = {
    f"{kind}, {name}": case
    for kind, table in (("one way", ONE_WAY), ("two ways", TWO_WAYS), ("star", STARS))
    for name, case in table.items()
}


@pytest.mark.ci_for("1-two ways, octagon")
@pytest.mark.slow_for(
    "1-two ways, octagon",
    "4-star, six",
    "4-star, four",
    "4-star, eight",
    "4-star, divided",
    "4-star, one pleat",
    "4-star, a pleat a ring",
)
@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("divisions", [1, 4])
def test_lengths_canister_and_distances(name: str, divisions: int) -> None:
    """Elements keep 0.9 to 1 of their length, the net fits, threads without a common node are one apart."""
    net, how = ALL[name]
    woven, found = fold(net, how, strings=STRINGS | {"divisions": divisions})
    part = chords(woven, found.position)
    assert part.min() >= 0.9 - 1e-9
    assert part.max() <= 1.0 + 1e-9
    mesh = found.position[np.unique(woven.element_nodes[~woven.is_string])]
    size = np.ptp(mesh, axis=0) + THREAD
    if "box" in how:
        assert (size <= np.array(how["box"]) + 1e-9).all()
    else:
        assert np.hypot(mesh[:, 0], mesh[:, 1]).max() + THREAD / 2 <= how["cylinder"][0] + 1e-9
        assert size[2] <= how["cylinder"][1] + 1e-9
    np.testing.assert_allclose(mesh.min(axis=0)[2], -mesh.max(axis=0)[2], atol=1e-9)
    assert least_apart(woven, found.position) > THREAD * (1.0 - 2e-6)
    apart, _ = cKDTree(found.position).query(found.position, k=2)
    assert apart[:, 1].min() > THREAD * (1.0 - 2e-6)


SCANNED = {
    f"{outline}, {meshes}, {size} m": (CUT | shape | {"mesh_shape": meshes, "size": float(size)})
    for outline, shape in {
        "octagon": {"outline": "octagon"},
        "hexagon": {"outline": "hexagon"},
        "circle": {"outline": "circle", "corners": 12},
    }.items()
    for meshes in ("square", "hexagon")
    for size in (3, 5)
}


@pytest.mark.slow_for("4")
@pytest.mark.parametrize("name", SCANNED)
@pytest.mark.parametrize("divisions", [1, 4])
def test_threads_of_cut_nets_are_a_thread_apart(name: str, divisions: int) -> None:
    """Strings among them, in a small canister or in that which its refusal names; threads are 4 mm thick."""
    thick = CABLE | {"diameter": 4e-3}
    strings = thick | {"length": 0.6, "divisions": divisions}
    others = {"cable": CABLE | {"diameter": 2e-3}, "border": thick, "strings": strings}
    how = {"pattern": "accordion", "box": [1.6, 1.3, 0.9]}
    try:
        woven, found = fold(SCANNED[name], how, **others)
    except CaseError as error:
        (fits,) = re.findall(r"box = (\[.*\]) would fit", str(error))
        woven, found = fold(SCANNED[name], how | {"box": json.loads(fits)}, **others)
    assert least_apart(woven, found.position) > 4e-3 * (1.0 - 2e-6)


def test_threads_that_come_too_near_are_found() -> None:
    """In a stack that is pressed flat; and what meets in it is found as by looking at every pair."""
    woven, found = fold(*TWO_WAYS["octagon"])
    flat, how = found.position * [1.0, 1.0, 0.0], Fold.model_validate(BOX)
    with pytest.raises(CaseError, match=r"initial\.fold\.box"):
        check_strings(woven, flat, how)
    with pytest.raises(CaseError):
        spread(lambda layer: flat, woven, how)
    met = nearest(woven, flat, 1e-9)
    assert met is not None
    one, other = woven.element_nodes[met.elements]
    assert not set(one) & set(other)
    assert between_segments(flat[[one]], flat[[other]]) < 1e-9
    least = least_apart(woven, found.position)
    assert nearest(woven, found.position, least) is None
    there = nearest(woven, found.position, 2.0 * least)
    assert there is not None
    assert there.distance == pytest.approx(least, rel=1e-9)
    ends = found.position[woven.element_nodes[there.elements]]
    point = np.tile(there.place, (2, 2, 1))
    point[:, 1, 0] += 1e-12
    np.testing.assert_allclose(between_segments(ends, point), 0.5 * least, rtol=1e-6)


@pytest.mark.parametrize(("chord", "kept"), [(0.899, False), (0.901, True), (1.0, True), (1.001, False)])
def test_a_chord_is_90_to_100_percent_of_a_length(chord: float, kept: bool) -> None:
    of, how = net([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [(0, 1)]), Fold.model_validate(BOX)
    place = chord * of.reference_position
    if kept:
        check_chords(of, place, how)
    else:
        with pytest.raises(CaseError, match="of its length"):
            check_chords(of, place, how)


def test_layers_are_as_far_apart_as_threads_need() -> None:
    """Twice a thread, if threads come as near as half of what layers do; strings do not count."""
    woven, found = fold(SQUARE, WIDE)
    how = Fold.model_validate(WIDE)
    heights = found.position * [1.0, 1.0, 0.5]
    assert spread(lambda layer: found.position, woven, how) == pytest.approx(THREAD, rel=1e-12)
    assert spread(lambda layer: heights * [1.0, 1.0, layer / THREAD], woven, how) == pytest.approx(
        2.0 * THREAD, rel=1e-4
    )


def test_a_bellows_by_hand() -> None:
    """4 x 4 meshes of 1 m in pleats of one: four layers on a slope, 4 m long, as high as the canister.

    Box 1.1 x 1.1 x 0.401 m, thread d = 1 mm: sin a = 0.4 / 4, so each layer is shifted by 10 d. Rows at
    y = -2, -1, 0, 1, 2 lie at the ends of the first pleat, and on creases: at layers 0, 0.5, 1.5, 2.5 and 3.
    """
    net = {"topology": "square", "size": 4.0, "mesh": 1.0, "strings": None, "bullets": None}
    _, found = fold(net, {"pattern": "accordion", "box": [1.1, 1.1, 0.401]})
    position = found.position.reshape(5, 5, 3)
    shift, rows = 10 * THREAD, np.array([0.0, 0.5, 1.5, 2.5, 3.0])
    # Elements along y inside are shifted by a layer.
    s = np.sqrt(1.0 - shift**2)
    to_and_fro = np.array([-0.5, 0.5, -0.5, 0.5, -0.5])
    x = s * np.sqrt(1.0 - 0.1**2) * to_and_fro - shift * (rows[:, None] - 1.5)
    np.testing.assert_allclose(position[..., 0], x, atol=1e-12)
    np.testing.assert_allclose(position[..., 1], np.tile(s * to_and_fro[:, None], 5), atol=1e-12)
    np.testing.assert_allclose(position[..., 2], np.tile(0.1 * s * np.arange(-2.0, 3.0), (5, 1)), atol=1e-12)


def test_an_accordion_by_hand() -> None:
    """Three meshes of 1 m, one a pleat: rows at y = -1.5 ... 1.5 come to the ends of a pleat in turn.

    The first and the last row are in layers 0 and 2, the creases at heights 1/2 and 3/2. The elements of the
    first and the last pleat rise by half a thread, of the middle one by a thread: it bounds the width,
    sqrt(1 - d^2).
    """
    net = {"topology": "square", "size": 3.0, "mesh": 1.0, "strings": None, "bullets": None}
    woven, found = fold(net, {"pattern": "accordion", "box": [4.0, 1.1, 0.1]})
    assert 1.0 - 1e-13 < chords(woven, found.position).max() <= 1.0  # nothing is strained
    position = found.position.reshape(4, 4, 3)
    width = np.sqrt(1.0 - THREAD**2)
    np.testing.assert_allclose(position[:, 0, 1], np.array([-1, 1, -1, 1]) * width / 2, atol=1e-12)
    np.testing.assert_allclose(position[:, 2, 2], np.array([-1.0, -0.5, 0.5, 1.0]) * THREAD, atol=1e-15)
    np.testing.assert_allclose(position[0, :, 0], np.array([-1.5, -0.5, 0.5, 1.5]) * width, atol=1e-12)


def test_bullets_are_outward_of_their_corners() -> None:
    """Opposite ends of the net lie at opposite ends of the stack, so bullets are on the side they fly to."""
    for keys, how in (ONE_WAY["square"], TWO_WAYS["square"], STARS["eight"]):
        woven, found = fold(keys, how)
        there = found.position[woven.bullet_nodes, :2]
        flat = woven.reference_position[woven.bullet_nodes, :2]
        assert ((there * flat).sum(axis=1) > 0.0).all()
    woven, found = fold(SQUARE, BOX, strings=STRINGS | {"divisions": 4})
    held = woven.element_nodes[woven.is_string]
    corners = np.setdiff1d(held[:, 1], held[:, 0])
    near = cKDTree(found.position[corners]).query(found.position[woven.bullet_nodes])[0]
    # Out and back twice, a thread further aside each time; three threads outward of the corner.
    np.testing.assert_allclose(near, 5 * THREAD, rtol=1e-9)


@st.composite
def folds(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, Any]]:
    """A net that can be folded, and a canister that it may fit."""
    mesh, n, m = draw(st.floats(0.1, 1.0)), draw(st.integers(1, 9)), draw(st.integers(1, 9))
    size = mesh * draw(st.floats(3.0, 12.0))
    net: dict[str, Any] = draw(
        st.sampled_from(
            [
                {"topology": "square", "mesh": mesh, "size": n * mesh},
                {"topology": "rectangular", "mesh": [mesh, 0.3], "size": [n * mesh, m * 0.3]},
                {"topology": "hexagonal", "mesh": mesh, "rings": n // 3},
                {"topology": "radial", "radius": n * mesh, "spokes": 2 * m + 2, "rings": n},
                OCTAGON | {"mesh": mesh, "size": size},
                CIRCLE | {"mesh": mesh, "size": size, "mesh_shape": "hexagon", "corners": 3},
                TRIANGLES | {"mesh": mesh, "size": size},
            ]
        )
    )
    edge = st.floats(0.1, 6.0)
    canister = {"box": draw(st.tuples(edge, edge, edge))}
    if draw(st.booleans()):
        canister = {"cylinder": draw(st.tuples(edge, edge))}
    pattern = "star" if net["topology"] == "radial" else "accordion"
    return net | {"divisions": draw(st.integers(1, 2))}, {"pattern": pattern} | canister


def tried(net: dict[str, Any], how: dict[str, Any], strings: dict[str, Any]) -> tuple[Net | None, Any]:
    """The net in the canister, or in the one that is said to fit; None if threads are too thick."""
    try:
        return fold(net, how, strings=strings)
    except CaseError as error:
        words = str(error)
    for key, sizes in re.findall(r"(box|cylinder) = \[([^\]]*)\] would fit", words):
        fitting = {"pattern": how["pattern"], key: [float(item) for item in sizes.split(",")]}
        return fold(net, fitting, strings=strings)
    assert "thick" in words
    return None, None


@pytest.mark.slow
@settings(max_examples=150)
@given(folds(), st.integers(1, 4))
def test_any_net_fits_its_canister_or_the_one_that_a_refusal_names(
    case: tuple[dict[str, Any], dict[str, Any]], divisions: int
) -> None:
    net, how = case
    strings = STRINGS | {"length": 1.5, "divisions": divisions}
    woven, found = tried(net, how, strings)
    if woven is None:
        return
    part = chords(woven, found.position)
    assert part.min() >= 0.9 - 1e-9
    assert part.max() <= 1.0 + 1e-9
    assert least_apart(woven, found.position, strings=False) > THREAD * (1.0 - 2e-6)


# Canisters that are too small


@pytest.mark.parametrize(
    ("net", "how"),
    [
        (SQUARE, {"pattern": "accordion", "box": [0.6, 0.6, 0.05]}),
        (SQUARE, {"pattern": "accordion", "cylinder": [0.3, 0.05]}),
        (TRIANGLES, {"pattern": "accordion", "box": [0.6, 0.6, 0.05]}),
        (HONEYCOMB, {"pattern": "accordion", "cylinder": [0.1, 0.1]}),
        (WEB, {"pattern": "star", "cylinder": [1.0, 0.1]}),
        # A thread between its layers, this star is a little longer than with the distance that they need.
        (WEB | {"radius": 2.0, "rings": 8}, {"pattern": "star", "cylinder": [1.1, 0.9]}),
    ],
)
def test_the_canister_that_a_refusal_names_fits(net: dict[str, Any], how: dict[str, Any]) -> None:
    words = refused(net, how)
    ((key, sizes),) = re.findall(r"(box|cylinder) = \[([^\]]*)\] would fit", words)
    fold(net, {"pattern": how["pattern"], key: [float(item) for item in sizes.split(",")]})


@pytest.mark.parametrize(
    ("net", "how"),
    [
        ({"topology": "radial", "radius": 2.0, "spokes": 7, "rings": 3}, STAR),  # an odd number of spokes
        (WEB, BOX),
        (SQUARE, STAR),
        (CIRCLE, STAR),
    ],
)
def test_a_net_and_its_pattern_must_fit(net: dict[str, Any], how: dict[str, Any]) -> None:
    changes = [f"net={toml(net | {'cable': CABLE})}", f"initial.fold={toml(how)}", "launch="]
    with pytest.raises(CaseError) as caught:
        exunet.load(CASES / "nets" / "accordion.toml", changes)
    assert [fault.key for fault in caught.value.faults] == ["initial.fold.pattern"]


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(entry)}" for key, entry in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else str(value)


# Runs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["accordion", "star"])
def test_a_folded_net_opens(name: str) -> None:
    """At rest but for the bullets at the start, nothing strained, momentum that of the launch throughout."""
    case = exunet.load(CASES / "nets" / f"{name}.toml", ["time.end=0.5", "solver.tolerance=1e-6"])
    run = exunet.run(case)
    assert run.complete
    assert not run.tension[0].any()
    bullets = run.net.bullet_nodes
    others = np.setdiff1d(np.arange(run.net.n_nodes), bullets)
    assert not run.velocity[0, others].any()
    thrown = run.net.mass[bullets] @ run.velocity[0, bullets]
    np.testing.assert_allclose(run.momentum, np.broadcast_to(thrown, run.momentum.shape), atol=1e-9)
    assert run.run.largest_tension.time > 0.0
    area = exunet.mouth_area(run.net, run.position)
    assert area[-1] > area[0]


@pytest.mark.slow
def test_a_run_from_a_fold_is_checked() -> None:
    """In the reference's own process too. Measured: 3e-9 m; the net grows what the tolerances leave."""
    case = exunet.load(CASES / "nets" / "accordion.toml", ["time.end=0.1", "time.output_step=0.05"])
    with ReferenceRun(case) as check:
        assert check.refusal() == ""
        found = check.agreement(exunet.run(case))
    assert found.time[-1] == 0.1
    assert max(found.position_difference) < 1e-6


# Stars, knot by knot, in complex numbers and by every choice of lengths

LEVELS = [0.99 - 0.005 * k for k in range(18)]  # of their lengths that a ring's side and a spoke may keep
WEBS = {"eight": (8, 10, 2.5), "four": (4, 5, 2.0), "six": (6, 7, 2.5), "twelve": (12, 8, 2.5)}


def outer_meeting(one: complex, its: float, other: complex, others: float) -> complex | None:
    """Of the points at two distances from two places that with the larger real part."""
    apart = abs(other - one)
    if not abs(its - others) <= apart <= its + others:
        return None
    cosine = (apart**2 + its**2 - others**2) / (2.0 * apart * its)
    way = (other - one) / apart * its
    aside = 1j * math.sqrt(max(0.0, 1.0 - cosine**2))
    return max((one + way * (cosine + aside), one + way * (cosine - aside)), key=lambda z: z.real)


def profile(web: tuple[int, int, float], per_pleat: int, layer: float) -> tuple[list[complex], list[complex]]:
    """Of the knots at the axis and at the tips, ring by ring: distance from the axis + i times height."""
    spokes, rings, radius = web
    turn, step = 2.0 * math.pi / spokes, radius / rings
    axis, tips = [0j], [0j]
    for ring in range(1, rings + 1):
        pleat, within = divmod(ring - 1, per_pleat)
        on_crease = within == per_pleat - 1 and ring < rings
        away = (0.5 + pleat + 0.5 * on_crease) * layer / math.sin(turn)
        rise = math.sqrt((0.99 * step) ** 2 - (away - axis[-1].real) ** 2)
        axis.append(complex(away, axis[-1].imag - rise * (-1) ** pleat))
        chord, beside = 2.0 * math.sin(turn / 2) * step * ring, away * math.sin(turn)
        found = {}
        for a in LEVELS:
            for b in LEVELS:
                if (square := (a * chord) ** 2 - beside**2) > 0.0:
                    centre = complex(away * math.cos(turn), axis[-1].imag)
                    met = outer_meeting(tips[-1], b * step, centre, math.sqrt(square))
                    if met is not None and met.real > tips[-1].real - 1e-9:
                        found[round(min(a, b), 6), round(a + b, 6), a] = met
        tips.append(found[max(found)])
    return axis, tips


def star(web: tuple[int, int, float], others: Any = (), **how: Any) -> Folded:
    spokes, rings, radius = web
    table = {"topology": "radial", "radius": radius, "spokes": spokes, "rings": rings, "cable": CABLE}
    keys = KEYS.validate_python(table | dict(others))
    return folded(weave(keys), keys, Fold.model_validate({"pattern": "star"} | how))


CHOSEN = [("eight", 2.3, 9), ("eight", 0.8, 3), ("four", 2.1, 5), ("six", 3.0, 7)]
CHOSEN += [("twelve", 0.35, 1), ("twelve", 0.7, 2)]


@pytest.mark.parametrize(("name", "height", "per_pleat"), CHOSEN)
def test_every_knot_of_a_star(name: str, height: float, per_pleat: int) -> None:
    """Of the longest pleats that are no higher than the box; the first knot gives the distance of layers.

    Spokes keep 0.99 of their lengths at the axis, so a pleat of k rings is about 0.99 k steps high.
    """
    spokes, rings, _ = web = WEBS[name]
    found = star(web, box=[9.0, 9.0, height])
    assert found.pleats == f"{spokes // 2} arms, {math.ceil(rings / per_pleat)} pleats along the axis"
    assert found.layers == math.ceil(rings / per_pleat)
    position, turn = found.position[1:].reshape(rings, spokes, 3), 2.0 * math.pi / spokes
    layer = position[0, 0, 0] * math.sin(turn) / (0.5 if per_pleat > 1 else 1.0)
    assert layer > THREAD * (1.0 - 1e-9)
    axis, tips = profile(web, per_pleat, layer)
    heights = [tip.imag for tip in (*axis, *tips)]
    middle = 0.5 * (max(heights) + min(heights))
    np.testing.assert_allclose(found.position[0], [0.0, 0.0, -middle], atol=1e-12)
    for first, line in ((0, axis), (1, tips)):
        own, ring = position[:, first::2], np.array(line[1:])
        turns = np.exp(1j * turn * np.arange(first, spokes, 2))
        np.testing.assert_allclose(own @ [1.0, 1j, 0.0], ring.real[:, None] * turns, atol=1e-12)
        np.testing.assert_allclose(own[..., 2] - ring.imag[:, None], -middle, atol=1e-12)
    across = 2.0 * max(item.real for item in (*axis, *tips)) + THREAD
    known = [across, across, max(heights) - min(heights) + THREAD]
    np.testing.assert_allclose(found.size, known, rtol=1e-12)
    again = star(web, box=[9.0, 9.0, known[2] * (1.0 - 5e-10)])  # to round-off it fits
    # With layers a thread apart some are a little higher; then one of those that fit at once is taken.
    same = np.array_equal(again.position, found.position)
    assert same == (layer < 1.001 * THREAD)


def test_threads_are_straight_between_the_knots_of_a_star() -> None:
    """One ring in a pleat, each thread divided into three; bullets come first, knots, inner nodes."""
    spokes, rings, radius = web = WEBS["twelve"]
    more = {"divisions": 3, "strings": CABLE | {"length": 1.0}, "bullets": {"mass": 0.5}}
    position = star(web, more, box=[9.0, 9.0, 0.35]).position
    number = 1 + spokes * rings
    knots = position[spokes : spokes + number]
    angles = 2.0 * math.pi / spokes * np.arange(spokes)
    ways = knots[1:].reshape(rings, spokes, 3) @ [1.0, 1j, 0.0]
    np.testing.assert_allclose(ways * np.exp(-1j * angles), abs(ways), rtol=1e-12)
    assert (np.diff(abs(ways), axis=0) > 0.0).all()
    table = {"topology": "radial", "radius": radius, "spokes": spokes, "rings": rings, "cable": CABLE}
    i, j = weave(KEYS.validate_python(table)).element_nodes.T  # one element a thread
    inner = position[spokes + number :].reshape(len(i), 2, 3)
    np.testing.assert_allclose(inner[:, 0], (2.0 * knots[i] + knots[j]) / 3.0, atol=1e-14)
    np.testing.assert_allclose(inner[:, 1], (knots[i] + 2.0 * knots[j]) / 3.0, atol=1e-14)


# Strings

THICK = 0.01
CORNER = np.array([0.4, -0.3, 0.2])
UNFOLDED = np.array([2.0, 1.0, 0.5])  # of the corner
LENGTH = 0.6  # of an element of a string
WAY = np.array([2.0, -1.0, 2.0]) / 3.0  # to the bullet in the flat net
FORWARD = np.array([1.0, -1.0, 1.0])  # so that y is turned round


def hung(divisions: int, threads: list[np.ndarray]) -> tuple[Net, np.ndarray, np.ndarray]:
    """A string from bullet 0 to corner 1, and threads (2, 3) that it shares no node with; places, forward."""
    inner = [UNFOLDED + WAY * LENGTH * (divisions - k) for k in range(1, divisions)]
    nodes = [
        UNFOLDED + WAY * LENGTH * divisions,
        UNFOLDED,
        *inner,
        *(end for thread in threads for end in thread),
    ]
    chain = [0, *range(2, divisions + 1), 1]
    first = divisions + 1
    own = [(first + 2 * k, first + 2 * k + 1) for k in range(len(threads))]
    elements = [*own, (1, first), *pairwise(chain)]
    of = net(nodes, elements, strings=tuple(range(len(own) + 1, len(elements))))
    place = np.array(nodes)
    place[1] = CORNER
    place[0], place[2:first] = np.nan, np.nan
    return of, place, np.tile(FORWARD, (len(nodes), 1))


AWAY = [np.array([(-5.0, 0.0, 0.0), (-6.0, 0.0, 0.0)])]
OUTWARD = WAY * FORWARD


def test_a_string_of_one_element_is_straight() -> None:
    """0.95 of its length, outward as in the flat net by the way that the corner's pleat runs."""
    of, place, forward = hung(1, AWAY)
    found = with_strings(of, place, forward, THICK)
    np.testing.assert_allclose(found[0], CORNER + 0.95 * LENGTH * OUTWARD, rtol=1e-14)
    np.testing.assert_array_equal(found[1:], place[1:])


@pytest.mark.parametrize("divisions", [2, 5])
@pytest.mark.parametrize("thread", [THICK, 0.004])
def test_a_divided_string_lies_to_and_fro(divisions: int, thread: float) -> None:
    """From the corner on: a node far outward and one beside the corner in turn, each a thread further aside.

    Elements keep the mean of 0.95 and 1 of their length; beside the corner is 3 threads outward, at most 0.04
    of an element.
    """
    of, place, forward = hung(divisions, AWAY)
    found = with_strings(of, place, forward, thread)
    aside = np.array([-OUTWARD[1], OUTWARD[0], 0.0]) / math.hypot(OUTWARD[0], OUTWARD[1])
    chain = [1, *range(divisions, 1, -1), 0]
    far, near = math.sqrt((0.975 * LENGTH) ** 2 - thread**2), min(3.0 * thread, 0.04 * LENGTH)
    for k, node in enumerate(chain):
        out = 0.0 if k == 0 else far if k % 2 else near
        np.testing.assert_allclose(found[node], CORNER + out * OUTWARD + k * thread * aside, atol=1e-14)


def test_a_string_along_the_axis_goes_aside_along_x() -> None:
    of = net(
        [(0.0, 0.0, 3.0), (0.0, 0.0, 2.0), (0.0, 0.0, 1.0), (5.0, 0.0, 1.0)],
        [(2, 3), (0, 1), (1, 2)],
        strings=(1, 2),
    )
    found = with_strings(of, of.reference_position, np.ones((4, 3)), THICK)
    far = math.sqrt(0.975**2 - THICK**2)
    np.testing.assert_allclose(found[1], [THICK, 0.0, 1.0 + far], atol=1e-14)
    np.testing.assert_allclose(found[0], [2 * THICK, 0.0, 1.0 + 3 * THICK], atol=1e-14)


@pytest.mark.parametrize("divisions", [1, 3])
def test_a_bridle_is_in_the_plane_of_its_corners(divisions: int) -> None:
    """Its bullet is as far from both, on the side that is outward in the flat net."""
    flat = np.array([(1.0, -0.4, 0.0), (1.0, 0.4, 0.0)])
    bullet = np.array([3.0, 0.0, 0.5])
    there = np.array([(0.2, 0.1, 0.3), (0.5, 0.7, 0.1)])
    nodes, elements = [bullet, *flat, np.array([-5.0, 0.0, 0.0])], [(1, 3), (2, 3)]
    strings = []
    for corner in (1, 2):
        parts = [bullet + (nodes[corner] - bullet) * k / divisions for k in range(1, divisions)]
        chain = [0, *range(len(nodes), len(nodes) + len(parts)), corner]
        nodes += parts
        strings += pairwise(chain)
    of = net(nodes, elements + strings, strings=tuple(range(2, 2 + len(strings))))
    place = np.array(nodes)
    place[1:3] = there
    found = with_strings(of, place, np.ones((len(nodes), 3)), THICK)
    string = 0.95 * float(np.linalg.norm(flat[0] - bullet))
    outward = (bullet - (1.0, 0.0, 0.0)) / np.linalg.norm(bullet - (1.0, 0.0, 0.0))
    half = 0.5 * (there[1] - there[0])
    across = half / np.linalg.norm(half)
    way = outward - (outward @ across) * across
    way /= np.linalg.norm(way)
    apex = there.mean(axis=0) + math.sqrt(string**2 - half @ half) * way
    np.testing.assert_allclose(found[0], apex, rtol=1e-13)
    for k, corner in enumerate((1, 2)):
        for part in range(1, divisions):
            node = 3 + k * (divisions - 1) + part
            known = apex + (there[corner - 1] - apex) * part / divisions
            np.testing.assert_allclose(found[node], known, rtol=1e-13)


def ways() -> list[np.ndarray]:
    """Outward, and then turned away from it by 5 degrees more each time, all round in steps of 15."""
    across = np.cross(OUTWARD, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    up = np.cross(across, OUTWARD)
    found = [OUTWARD]
    for turn in range(5, 95, 5):
        for around in range(0, 360, 15):
            t, a = math.radians(turn), math.radians(around)
            found.append(math.cos(t) * OUTWARD + math.sin(t) * (math.cos(a) * across + math.sin(a) * up))
    return found


def around(outward: np.ndarray, away: float, rng: np.random.Generator) -> np.ndarray:
    """A thread (2, 3) of 0.4 m, normal to a way from the corner, at some distance on it."""
    way = np.cross(outward, rng.normal(size=3))
    return CORNER + away * outward + np.outer([-0.15, 0.25], way / np.linalg.norm(way))


@pytest.mark.parametrize("divisions", [1, 2])
@pytest.mark.parametrize("part", [0.3, 0.9])
@pytest.mark.parametrize("thread", [THICK, 0.06])
def test_a_string_goes_round_what_is_in_its_way(divisions: int, part: float, thread: float) -> None:
    """The first way on which no thread that shares no node with it comes nearer than one."""
    rng = np.random.default_rng(7)
    threads = [around(OUTWARD, part * LENGTH, rng) for _ in range(3)]
    of, place, forward = hung(divisions, [*AWAY, *threads])
    found = with_strings(of, place, forward, thread)
    chosen = clear_way(divisions, threads, thread)
    assert chosen is not None
    assert chosen > 0
    np.testing.assert_allclose(
        found[[0, *range(2, divisions + 1)]],
        pieces(divisions, ways()[chosen], thread)[::-1][:divisions],
        atol=1e-13,
    )


def test_where_no_way_is_clear_the_clearest_is_taken() -> None:
    """Threads on all sides."""
    rng = np.random.default_rng(3)
    sides = [item / np.linalg.norm(item) for item in rng.normal(size=(25, 3))]
    threads = [around(side, rng.uniform(0.2, 0.4), rng) for side in sides]
    of, place, forward = hung(1, [*AWAY, *threads])
    found = with_strings(of, place, forward, 0.19)
    clear = [clearance(pieces(1, way, 0.19), threads) for way in ways()]
    assert max(clear) < 0.19
    best = int(np.argmax(clear))
    assert 0 < best < len(clear) - 1
    np.testing.assert_allclose(found[0], CORNER + 0.95 * LENGTH * ways()[best], atol=1e-13)


def pieces(divisions: int, way: np.ndarray, thread: float) -> np.ndarray:
    """(divisions + 1, 3) from the corner on."""
    if divisions == 1:
        return np.array([CORNER, CORNER + 0.95 * LENGTH * way])
    aside = np.array([-way[1], way[0], 0.0]) / math.hypot(way[0], way[1])
    far, near = math.sqrt((0.975 * LENGTH) ** 2 - thread**2), min(3.0 * thread, 0.04 * LENGTH)
    return np.array([CORNER, CORNER + far * way + thread * aside, CORNER + near * way + 2.0 * thread * aside])


def clearance(line: np.ndarray, threads: list[np.ndarray]) -> float:
    own = np.stack([line[:-1], line[1:]], axis=1)
    pairs = np.repeat(own, len(threads), axis=0), np.tile(np.array(threads), (len(own), 1, 1))
    return float(between_segments(*pairs).min())


def clear_way(divisions: int, threads: list[np.ndarray], thread: float) -> int | None:
    for k, way in enumerate(ways()):
        if clearance(pieces(divisions, way, thread), threads) >= thread * (1.0 - 1e-6):
            return k
    return None


def test_strings_go_round_each_other() -> None:
    """Two corners whose strings would cross: the second turns away from the first."""
    flat = np.array([(1.0, 0.1, 0.0), (1.0, -0.1, 0.0)])
    bullets = flat + np.array([(0.6, 0.8, 0.0), (0.6, -0.8, 0.0)])
    of = net([*bullets, *flat, (-5.0, 0.0, 0.0)], [(2, 4), (3, 4), (0, 2), (1, 3)], strings=(2, 3))
    place = of.reference_position.copy()
    place[2:4] = place[3:1:-1]
    found = with_strings(of, place, np.ones((5, 3)), THICK)
    first = np.array([place[2], place[2] + 0.95 * (bullets[0] - flat[0])])
    np.testing.assert_allclose(found[0], first[1], rtol=1e-14)
    second = np.array([place[3], found[1]])
    straight = np.array([place[3], place[3] + 0.95 * (bullets[1] - flat[1])])
    assert between_segments(first[None], straight[None])[0] < 1e-9
    assert between_segments(first[None], second[None])[0] >= THICK * (1.0 - 1e-6)
    turned = (second[1] - second[0]) @ (bullets[1] - flat[1]) / 0.95
    assert turned == pytest.approx(math.cos(math.radians(5.0)), rel=1e-12)

"""Folded nets: what docs/theory.md promises of lengths, layers and canisters, and that they open."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from scipy.spatial import cKDTree

import exunet
import reference_impl
from exunet.base.errors import CaseError
from exunet.cli.check import describe
from exunet.net import AnyNetConfig, weave
from exunet.net.arrays import Net
from exunet.net.folding import Fold, Folded, check_strings, creases, folded, pleated, spread, usable
from exunet.net.mesh_checks import nearest
from exunet.simulation.preparation import prepare_case
from exunet.studies.both_codes import read_both
from exunet.verification.reference_run import ReferenceRun
from exunet.verification.topology import topology

CASES = Path(__file__).parents[1] / "cases"
KEYS = TypeAdapter(AnyNetConfig)
THREAD = 1e-3
CABLE = {"diameter": THREAD, "density": 1390.0, "youngs_modulus": 7e10}
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
    "cylinder": (SQUARE, {"pattern": "accordion", "cylinder": [0.8, 0.4]}),
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
ALL = {
    f"{kind}, {name}": case
    for kind, table in (("one way", ONE_WAY), ("two ways", TWO_WAYS), ("star", STARS))
    for name, case in table.items()
}


def fold(net: dict[str, Any], how: dict[str, Any], **others: Any) -> tuple[Net, Folded]:
    keys = KEYS.validate_python({"cable": CABLE, "strings": STRINGS, "bullets": {"mass": 0.5}} | net | others)
    woven = weave(keys)
    return woven, folded(woven, keys, Fold.model_validate(how))


def refused(net: dict[str, Any], how: dict[str, Any], **others: Any) -> str:
    with pytest.raises(CaseError) as caught:
        fold(net, how, **others)
    return str(caught.value)


def chords(net: Net, position: np.ndarray) -> np.ndarray:
    """Distance between the ends of each element, as a part of its reference length."""
    i, j = net.element_nodes.T
    return np.asarray(np.linalg.norm(position[j] - position[i], axis=1) / net.reference_length)


def least_apart(net: Net, position: np.ndarray, *, strings: bool = True) -> float:
    """Between threads that share no node [m], by looking at every pair whose boxes are near each other."""
    ends = net.element_nodes[strings | ~net.is_string]
    low, high = position[ends].min(axis=1) - 0.01, position[ends].max(axis=1) + 0.01
    a, b = np.triu_indices(len(ends), 1)
    near = ((low[a] < high[b]) & (low[b] < high[a])).all(axis=1)
    a, b = a[near], b[near]
    strange = (ends[a][:, :, None] != ends[b][:, None, :]).all(axis=(1, 2))
    return float(between_segments(position[ends[a[strange]]], position[ends[b[strange]]]).min(initial=0.01))


def between_segments(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) least distances of straight pieces (n, 2, 3); C. Ericson, Real-Time Collision Detection, 5.1.9."""
    d, e, r = one[:, 1] - one[:, 0], other[:, 1] - other[:, 0], one[:, 0] - other[:, 0]
    dd, ee, de, dr, er = ((p * q).sum(axis=1) for p, q in ((d, d), (e, e), (d, e), (d, r), (e, r)))
    across = dd * ee - de**2
    level = across <= 1e-14 * dd * ee
    s = np.where(level, 0.0, np.clip((de * er - dr * ee) / np.where(level, 1.0, across), 0.0, 1.0))
    t = (de * s + er) / ee
    s = np.clip(np.where(t < 0.0, -dr / dd, np.where(t > 1.0, (de - dr) / dd, s)), 0.0, 1.0)
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(np.linalg.norm(r + s[:, None] * d - t[:, None] * e, axis=1))


@pytest.mark.ci_for("1-two ways, octagon")
@pytest.mark.slow_for(
    "two ways, octagon",
    "4-star, six",
    "4-star, four",
    "4-star, eight",
    "4-star, divided",
    "4-star, one pleat",
    "5-star, one pleat",
    "4-star, a pleat a ring",
    "5-star, a pleat a ring",
)
@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("divisions", [1, 4, 5])
def test_lengths_canister_and_determinism(name: str, divisions: int) -> None:
    net, how = ALL[name]
    woven, found = fold(net, how, strings=STRINGS | {"divisions": divisions})
    part = chords(woven, found.position)
    assert part.min() >= 0.9 - 1e-9
    assert part.max() <= 1.0 + 1e-9
    nodes = np.unique(woven.element_nodes[~woven.is_string])
    mesh = found.position[nodes]
    size = np.ptp(mesh, axis=0) + THREAD
    if "box" in how:
        assert (size <= np.array(how["box"]) + 1e-9).all()
    else:
        assert np.hypot(mesh[:, 0], mesh[:, 1]).max() + THREAD / 2 <= how["cylinder"][0] + 1e-9
        assert size[2] <= how["cylinder"][1] + 1e-9
    np.testing.assert_allclose(mesh.min(axis=0)[2], -mesh.max(axis=0)[2], atol=1e-9)
    np.testing.assert_array_equal(
        found.position, fold(net, how, strings=STRINGS | {"divisions": divisions})[1].position
    )


@pytest.mark.slow_for(
    "4-star, six",
    "4-star, four",
    "4-star, eight",
    "4-star, divided",
    "4-star, one pleat",
    "4-star, a pleat a ring",
)
@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("divisions", [1, 4])
def test_threads_without_a_common_node_are_a_thread_apart(name: str, divisions: int) -> None:
    """Each pair of elements, those of strings too; and so all nodes."""
    woven, found = fold(*ALL[name], strings=STRINGS | {"divisions": divisions})
    assert least_apart(woven, found.position) > THREAD * (1.0 - 2e-6)
    apart, _ = cKDTree(found.position).query(found.position, k=2)
    assert apart[:, 1].min() > THREAD * (1.0 - 2e-6)


@pytest.mark.parametrize("divisions", [1, 2, 3])
@pytest.mark.parametrize(
    "net", [SQUARE | {"size": 4.0}, HONEYCOMB | {"rings": 2}, OCTAGON], ids=["square", "honeycomb", "octagon"]
)
def test_a_thick_net_in_a_small_canister(net: dict[str, Any], divisions: int) -> None:
    """Threads of 2 mm, in pleats of one mesh; with layers that turn flat round each other, hundreds of pairs
    would be nearer than a thread, 0.006 to 0.05 mm at least."""
    thick = CABLE | {"diameter": 2e-3}
    others = {"cable": thick, "strings": thick | {"length": 1.0}}
    others |= {"border": thick} if net["topology"] == "cut" else {}
    # Short elements of a cut border leave less to draw nodes to a crease: wider pleats.
    how = {"pattern": "accordion", "box": [0.6, 0.6, 0.5] if net is not OCTAGON else [2.6, 2.6, 0.5]}
    woven, found = tried(net | {"divisions": divisions} | others, how, others["strings"])
    assert woven is not None
    assert found.layers >= 4
    part = chords(woven, found.position)
    assert 0.9 - 1e-9 <= part.min() <= part.max() <= 1.0 + 1e-9
    assert least_apart(woven, found.position) > 2e-3 * (1.0 - 2e-6)


SCANNED = {
    f"{outline}, {meshes}, {size} m": (CUT | shape | {"mesh_shape": meshes, "size": float(size)})
    for outline, shape in {
        "octagon": {"outline": "octagon"},
        "hexagon": {"outline": "hexagon"},
        "circle": {"outline": "circle", "corners": 12},
    }.items()
    for meshes in ("square", "hexagon")
    for size in (3, 4, 5, 6, 8)
}


@pytest.mark.ci_for("4-circle, hexagon, 4 m")
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


FLAT = "1 pleats along y, 1 along x"


@pytest.mark.slow_for("16", "3", "12-1")
@pytest.mark.parametrize(
    ("outline", "meshes", "folded_to"),
    [
        *[("octagon", meshes, None) for meshes in (6, 8, 20)],
        *[("octagon", meshes, to) for meshes, to in ((10, 2), (12, 1), (14, 2), (16, 6))],
        ("circle", 6, None),
        *[("circle", meshes, to) for meshes, to in ((8, 2), (10, 1), (12, 2), (14, 2), (16, 4), (20, 3))],
    ],
)
def test_how_far_cut_nets_fold(outline: str, meshes: int, folded_to: int | None) -> None:
    """What docs/theory.md says of them, in meshes; in a canister that is too small for any."""
    net = CUT | {"outline": outline, "mesh_shape": "square", "size": 0.5 * meshes}
    net |= {"corners": 12} if outline == "circle" else {}
    words = refused(net, {"pattern": "accordion", "box": [0.3, 0.3, 4.0]})
    assert (FLAT in words) == (folded_to is None)
    along_y = float(re.findall(r"takes [\d.]+ x ([\d.]+) x", words)[0])
    assert along_y == pytest.approx(0.5 * (folded_to or meshes), rel=0.05)


def test_threads_that_come_too_near_are_found() -> None:
    """In a stack that is pressed flat; and what meets in it is found as by looking at every pair."""
    woven, found = fold(*TWO_WAYS["octagon"])
    flat, how = found.position * [1.0, 1.0, 0.0], Fold.model_validate(BOX)
    with pytest.raises(CaseError, match=r"initial\.fold\.box: folded into it, elements \d+ between nodes"):
        check_strings(woven, flat, how)
    with pytest.raises(CaseError, match="less than a thread, however far apart the layers"):
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


@pytest.mark.parametrize(("room", "pleats"), [(5.01, 1), (1.01, 5), (0.51, 10)])
def test_layers_are_counted(room: float, pleats: int) -> None:
    """10 meshes of 0.5 m: one layer; five pleats of two meshes; ten of one, whose creases are odd."""
    woven, found = fold(SQUARE, {"pattern": "accordion", "box": [8.0, room, 0.1]})
    assert found.layers == pleats
    assert found.pleats == f"{pleats} pleats along y, 1 along x"
    heights = found.position[np.unique(woven.element_nodes[~woven.is_string]), 2]
    assert np.ptp(heights) == pytest.approx(THREAD * (pleats - 1), abs=1e-12)


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
    for net, how in (ONE_WAY["square"], TWO_WAYS["square"], STARS["eight"]):
        woven, found = fold(net, how)
        there = found.position[woven.bullet_nodes, :2]
        flat = woven.reference_position[woven.bullet_nodes, :2]
        assert ((there * flat).sum(axis=1) > 0.0).all()
    woven, found = fold(SQUARE, BOX, strings=STRINGS | {"divisions": 4})
    held = woven.element_nodes[woven.is_string]
    corners = np.setdiff1d(held[:, 1], held[:, 0])
    near = cKDTree(found.position[corners]).query(found.position[woven.bullet_nodes])[0]
    # To and fro twice, a thread further aside each time; three threads outward of the corner.
    np.testing.assert_allclose(near, 5 * THREAD, rtol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_creases_are_where_the_pleats_turn(seed: int) -> None:
    """Along a pleat distances stay, and no pleat is wider than the room."""
    random = np.random.default_rng(seed)
    number, room = int(random.integers(2, 40)), float(random.uniform(1.0, 6.0))
    lines = np.arange(number + 1) - number / 2
    at = creases(lines, lines[0], lines[-1], room)
    assert at is not None
    values = np.linspace(lines[0], lines[-1], 10 * number + 1)
    found = pleated(values, at, np.empty((0, 2), dtype=np.int64), 1e-6)
    assert np.ptp(found.place) <= room + 1e-9
    np.testing.assert_allclose(np.abs(np.diff(found.place)), 0.1, atol=1e-9)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(found.place)))) + 1
    np.testing.assert_allclose(values[turns], at, atol=1e-9)
    np.testing.assert_array_equal(found.pleat[turns], np.arange(len(at)) + 0.5)


def test_pleats_of_different_widths_where_lines_are_not_regular() -> None:
    """Room for 2.5 m: on to 2 m, back to 4 m, on to 6 m; from there 2 m back, where no line is, or is one."""
    assert creases(np.array([1.0, 2.0, 4.0, 5.0, 6.0, 9.0]), 0.0, 10.0, 2.5) is None
    at = creases(np.array([1.0, 2.0, 4.0, 5.0, 6.0, 8.0]), 0.0, 10.0, 2.5)
    np.testing.assert_array_equal(at, [2.0, 4.0, 6.0, 8.0])
    at = creases(np.array([1.5, 2.0, 2.6, 5.0, 5.2]), 0.0, 7.5, 2.6)
    np.testing.assert_array_equal(at, [2.6, 5.2])  # 2.6 wide each; and the last of 2.3


def test_lines_that_elements_cross_are_not_used() -> None:
    """A triangular mesh along x: its sides cross every line x = const; along y its rows are free."""
    woven, _ = fold(TRIANGLES, WIDE)
    inner = np.array([-0.25, 0.0, 0.25])
    assert len(usable(inner, woven, 0, 0.04)) == 0
    assert len(usable(np.array([-1.0, 0.0, 1.0]) * np.sqrt(0.75) * 0.5, woven, 1, 0.04)) == 3


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
def test_any_net_fits_or_is_told_what_would(
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
        (SQUARE, {"pattern": "accordion", "box": [0.3, 0.3, 0.3]}),
        (SQUARE, {"pattern": "accordion", "box": [0.6, 0.6, 0.05]}),
        (SQUARE, {"pattern": "accordion", "cylinder": [0.3, 0.05]}),
        (TRIANGLES, {"pattern": "accordion", "box": [0.6, 0.6, 0.05]}),
        (HONEYCOMB, {"pattern": "accordion", "cylinder": [0.1, 0.1]}),
        (WEB, {"pattern": "star", "cylinder": [1.0, 0.1]}),
        (WEB, {"pattern": "star", "box": [1.0, 1.0, 2.0]}),
        # A thread between its layers, this star is a little longer than with the distance that they need.
        (WEB | {"radius": 2.0, "rings": 8}, {"pattern": "star", "cylinder": [1.1, 0.9]}),
    ],
)
def test_a_canister_that_is_too_small_is_told_one_that_is_not(
    net: dict[str, Any], how: dict[str, Any]
) -> None:
    words = refused(net, how)
    assert words.startswith(f"initial.fold.{'box' if 'box' in how else 'cylinder'}: ")
    ((key, sizes),) = re.findall(r"(box|cylinder) = \[([^\]]*)\] would fit", words)
    fold(net, {"pattern": how["pattern"], key: [float(item) for item in sizes.split(",")]})


def test_how_high_a_bellows_has_to_be() -> None:
    """Layers of 1 mm are shifted by half of an element, 0.5 m, at most: a slope of 0.004, of 5 m."""
    words = refused(SQUARE, {"pattern": "accordion", "box": [1.3, 1.3, 0.01]})
    assert ", 1.3, 0.021] would fit" in words


def test_a_cut_that_leaves_few_lines_to_crease_is_told() -> None:
    """Hexagon of 5 m, triangles of 0.5 m: along its slanting sides knots are moved by a tenth of a side."""
    words = refused(TRIANGLES | {"size": 5.0}, WIDE)
    assert "10 lines cannot be creased: near the border, threads cross them" in words


def test_threads_that_are_too_thick_for_their_elements() -> None:
    """Layers of 30 cm on a slope of 1/2 are shifted by 60 cm, too much for elements of 50 cm."""
    thick = CABLE | {"diameter": 0.3}
    words = refused(SQUARE, {"pattern": "accordion", "box": [1.5, 1.5, 9.0]}, cable=thick, strings=STRINGS)
    assert "thinner threads" in words


@pytest.mark.parametrize(
    ("net", "how", "words"),
    [
        (
            {"topology": "radial", "radius": 2.0, "spokes": 7, "rings": 3},
            STAR,
            "an even number of them, not 7",
        ),
        (WEB, BOX, "radial nets have no lines to crease them along"),
        (SQUARE, STAR, 'it is for radial nets, not for square ones; use "accordion"'),
        (CIRCLE, STAR, "a border cut from meshes has no knots there to bend at: it is for radial nets"),
    ],
)
def test_what_cannot_be_folded_is_refused_on_reading(
    net: dict[str, Any], how: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = written(tmp_path, net, how)
    with pytest.raises(CaseError) as caught:
        exunet.load(path)
    line = path.read_text().splitlines().index(f'pattern = "{how["pattern"]}"') + 1
    assert str(caught.value).startswith(f"{path}:{line}: initial.fold.pattern: ")
    assert words in str(caught.value)


def test_a_fault_of_the_canister_has_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, SQUARE, {"pattern": "accordion", "box": [0.3, 0.3, 0.3]})
    line = path.read_text().splitlines().index("box = [0.3, 0.3, 0.3]") + 1
    with pytest.raises(CaseError, match=f":{line}: initial.fold.box: the folded net"):
        prepare_case(exunet.load(path))


def written(folder: Path, net: dict[str, Any], how: dict[str, Any]) -> Path:
    """A case file of a net without strings."""
    values: dict[str, Any] = net | {"cable": CABLE}
    lines = ["format = 1", 'title = ""', "[time]", "end = 0.1", "output_step = 0.1", "[net]"]
    lines += [f"{key} = {toml(value)}" for key, value in values.items()]
    lines += ["[initial.fold]", *(f"{key} = {toml(value)}" for key, value in how.items())]
    path = folder / "case.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else str(value)


# Runs


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) for name in ("accordion", "star")]
)
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
    assert run.provenance["largest_tension"]["time_s"] > 0.0
    area = exunet.mouth_area(run.net, run.position)
    assert area[-1] > area[0]


@pytest.mark.slow
def test_a_folded_net_without_a_launch_stays_at_rest() -> None:
    """No element is strained, so nothing moves: momentum and speeds are zero."""
    case = exunet.load(CASES / "nets" / "accordion.toml", ["launch=", "time.end=0.1"])
    run = exunet.run(case)
    assert not run.velocity.any()
    assert not run.momentum.any()


@pytest.mark.ci
@pytest.mark.slow
def test_exunet_check_says_how_the_net_is_packed() -> None:
    rows = dict(describe(exunet.load(CASES / "nets" / "accordion.toml")))
    # 2 mm strings are the thickest: 25 layers of 2 mm.
    assert rows["packing"].startswith("accordion fold (5 pleats along y, 5 along x), 25 layers, ")
    assert rows["packing"].endswith(" m; threads without a common node lie a thread apart, 0.002 m")
    rows = dict(describe(exunet.load(CASES / "planar_deployment.toml")))
    assert rows["packing"] == "0.1 of the reference configuration"
    rows = dict(describe(exunet.load(CASES / "verification" / "snap_from_slack.toml")))
    assert rows["packing"] == "as listed in initial.node_positions"


@pytest.mark.parametrize("name", ["accordion", "star"])
def test_the_reference_starts_from_these_places(name: str) -> None:
    """Which it compares with the rules of the format by itself; its own accordion differs in strings only."""
    both = read_both(CASES / "nets" / f"{name}.toml")
    assert [check for check in topology(both) if not check.holds] == []
    x, v = both.theirs.x0[both.reference_nodes], both.theirs.v0[both.reference_nodes]
    assert np.abs(x - both.start.position).max() < 1e-14
    assert np.abs(v - both.start.velocity).max() < 1e-13
    own = reference_impl.load(both.path)
    meshed = np.unique(own.net.element_nodes[~own.net.of_string])
    away = np.abs(own.x0 - both.theirs.x0)
    assert away.max() > 1e-3
    assert (away[meshed].max() < 1e-9) == (name == "accordion")


@pytest.mark.slow
def test_a_run_from_a_fold_is_checked() -> None:
    """In the reference's own process too. Measured: 3e-9 m; the net grows what the tolerances leave."""
    case = exunet.load(CASES / "nets" / "accordion.toml", ["time.end=0.1", "time.output_step=0.05"])
    with ReferenceRun(case) as check:
        assert check.refusal() == ""
        found = check.agreement(exunet.run(case))
    assert found.time[-1] == 0.1
    assert max(found.position_difference) < 1e-6

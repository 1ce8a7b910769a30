"""Nets by topology: counts, masses, geometry and the mouth's largest area, by the rules of theory.md."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from result_samples import net as loop_net
from result_samples import result, square_net
from scenes import CABLE as PAPER_CABLE
from scenes import CASES, thrown
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist

from exunet.base.errors import CaseError
from exunet.net import TOPOLOGIES, AnyNetConfig, weave
from exunet.net.areas import (
    achievable_area,
    border_lengths,
    largest_polygon,
    mouth_against,
    mouth_diameter,
)
from exunet.net.arrays import Net
from exunet.net.base import MAX_ELEMENTS
from exunet.results import measures as metrics
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

CABLE = {"area": 1e-3, "density": 1000.0, "youngs_modulus": 1e9}  # 1 kg of cable a metre
STRING = {"area": 2e-3, "density": 1000.0, "youngs_modulus": 1e9}  # 2 kg a metre
KEYS = TypeAdapter(AnyNetConfig)


def keys(topology: str, **others: Any) -> Any:
    return KEYS.validate_python({"topology": topology, "cable": CABLE, **others})


def net(topology: str, **others: Any) -> Net:
    return weave(keys(topology, **others))


def area(loop: tuple[int, ...], position: np.ndarray) -> float:
    """Signed area in the x-y plane, positive for an anticlockwise loop (shoelace formula)."""
    x, y = position[list(loop), :2].T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@contextmanager
def traced() -> Iterator[Callable[[], int]]:
    """Count the memory [byte] that the block takes at most."""
    tracemalloc.start()
    try:
        yield lambda: tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def distances(woven: Net) -> np.ndarray:
    i, j = woven.element_nodes.T
    return np.linalg.norm(woven.reference_position[j] - woven.reference_position[i], axis=1)


# The paper's net


def test_the_papers_net() -> None:
    """Sec. 3.3 of the paper: 40 nodes, 64 elements. Mass from Table 1, 60 m of cable, 4 sqrt(2) m of string.

    1390 pi/4 (0.002^2 60 + 0.004^2 4 sqrt(2)) + 4 * 0.5 = 2.360819 kg. Fig. 3: strings of sqrt(2) m continue
    the diagonals of the 5 m net, so bullets lie at 2.5 + 1 = 3.5 m on each axis.
    """
    woven = weave(load(CASES / "planar_deployment.toml").scene.net)
    assert (woven.n_nodes, woven.n_elements, len(woven.faces)) == (40, 64, 25)
    assert woven.mass.sum() == pytest.approx(2.360819, abs=5e-7)
    assert woven.is_string.sum() == 4
    expected = [[-3.5, -3.5, 0], [3.5, -3.5, 0], [3.5, 3.5, 0], [-3.5, 3.5, 0]]
    np.testing.assert_allclose(woven.reference_position[woven.bullet_nodes], expected, atol=1e-14)
    np.testing.assert_array_equal(woven.bullet_nodes, [0, 1, 2, 3])


# Counts and masses

COUNTS = [
    # (n + 1)^2 knots and 2 n (n + 1) sides; four strings and their ends more
    *(("square", {"size": 3.0, "mesh": 3.0 / n, "strings": STRING | {"length": 1.0}},
       (n + 1) ** 2 + 4, 2 * n * (n + 1) + 4, n * n) for n in (1, 2, 12)),
    # (nx + 1)(ny + 1) knots, nx (ny + 1) + ny (nx + 1) sides
    *(("rectangular", {"size": [nx * 0.3, ny * 0.7], "mesh": [0.3, 0.7]},
       (nx + 1) * (ny + 1), nx * (ny + 1) + ny * (nx + 1), nx * ny) for nx, ny in ((1, 1), (3, 2), (2, 7))),
    # 3 R (R + 1) + 1 cells, 6 (R + 1)^2 knots (those of a coronene), so by Euler V + F - 1 sides
    *(("hexagonal", {"mesh": 0.4, "rings": r}, 6 * (r + 1) ** 2, 9 * r * r + 15 * r + 6, 3 * r * (r + 1) + 1)
      for r in (0, 1, 5)),
    # A hub and spokes x rings knots; as many sides along spokes as along rings, and as many openings
    *(("radial", {"radius": 2.0, "spokes": s, "rings": r}, 1 + s * r, 2 * s * r, s * r)
      for s, r in ((3, 1), (8, 4), (5, 2))),
]  # fmt: skip


@pytest.mark.parametrize(("topology", "numbers", "nodes", "elements", "faces"), COUNTS)
def test_counts(topology: str, numbers: dict[str, Any], nodes: int, elements: int, faces: int) -> None:
    woven = net(topology, **numbers)
    assert (woven.n_nodes, woven.n_elements, len(woven.faces)) == (nodes, elements, faces)


MASSES = {
    # 2 x 2 meshes of 1 m at 1 kg/m: half of two sides at a corner, of three at an edge, of four within. A
    # string of 0.5 m at 2 kg/m gives 0.5 kg to the corner and 0.5 kg to the bullet of 3 kg.
    "square": ({"size": 2.0, "mesh": 1.0, "strings": STRING | {"length": 0.5}, "bullets": {"mass": 3.0}},
               [3.5] * 4 + [1.5, 1.5, 1.5, 1.5, 2.0, 1.5, 1.5, 1.5, 1.5]),
    # One mesh of 4 m x 2 m at 1 kg/m: every corner carries half of 4 m and half of 2 m
    "rectangular": ({"size": [4.0, 2.0], "mesh": [4.0, 2.0]}, [3.0] * 4),
    # One cell of 2 m sides at 1 kg/m: 2 kg at each of its six knots. Each knot holds one string of each of
    # two bridles: 2 x 0.5 x 2 kg/m x 1.5 m = 3 kg; so does each bullet of 1 kg.
    "hexagonal": ({"mesh": 2.0, "rings": 0, "strings": STRING | {"length": 1.5}, "bullets": {"mass": 1.0}},
                  [4.0] * 6 + [5.0] * 6),
    # Four spokes of 1 m, one ring with chords of sqrt(2) m, 1 kg/m: hub 4/2, knots 1/2 + 2 sqrt(2)/2
    "radial": ({"radius": 1.0, "spokes": 4, "rings": 1}, [2.0] + [0.5 + math.sqrt(2)] * 4),
}  # fmt: skip


@pytest.mark.parametrize("topology", MASSES)
def test_masses_by_hand(topology: str) -> None:
    numbers, masses = MASSES[topology]
    np.testing.assert_allclose(net(topology, **numbers).mass, masses, rtol=1e-14)


def test_explicit_masses_by_hand() -> None:
    """3 m and 4 m of cable at 1 kg/m in a chain; 10 kg more at its end, which is fixed."""
    woven = net(
        "explicit",
        nodes=[[0, 0, 0], [3, 0, 0], [3, 4, 0]],
        elements=[[0, 1], [1, 2]],
        node_masses=[0.0, 0.0, 10.0],
        fixed=[2],
    )
    np.testing.assert_allclose(woven.mass, [1.5, 3.5, 12.0], rtol=1e-14)
    np.testing.assert_array_equal(woven.fixed_nodes, [2])
    assert woven.bullet_nodes.size == 0
    assert woven.faces == ()
    with pytest.raises(ValueError, match="without names"):
        woven.node("centre")


# Geometry

THROWN = {
    "square": {"size": 3.0, "mesh": 0.75},
    "rectangular": {"size": [2.0, 3.0], "mesh": [0.5, 1.0]},
    "hexagonal": {"mesh": 0.6, "rings": 2},
    "radial": {"radius": 2.0, "spokes": 7, "rings": 3},
    "cut": {"outline": "hexagon", "size": 3.1, "mesh_shape": "triangle", "mesh": 0.7, "border": CABLE},
}
# Reference areas: L^2; Lx Ly; 19 cells (R = 2) of 3 sqrt(3)/2 a^2; the regular heptagon n/2 r^2 sin(2 pi/n);
# the regular hexagon of width L, sqrt(3)/2 L^2.
AREAS = {
    "square": 9.0,
    "rectangular": 6.0,
    "hexagonal": 19 * 1.5 * math.sqrt(3) * 0.36,
    "radial": 3.5 * 4.0 * math.sin(2 * math.pi / 7),
    "cut": 0.5 * math.sqrt(3) * 3.1**2,
}
TURNS = {"square": 4, "rectangular": 2, "hexagonal": 6, "radial": 7, "cut": 6}


@pytest.mark.parametrize("topology", THROWN)
@pytest.mark.parametrize("divisions", [1, 3])
@pytest.mark.parametrize("more", [{}, {"strings": {**STRING, "length": 0.9}}], ids=["bare", "strings"])
def test_faces_are_anticlockwise_along_elements_and_cover_the_net(
    topology: str, divisions: int, more: Any
) -> None:
    woven = net(topology, **THROWN[topology], **more, divisions=divisions)
    elements = {frozenset(pair) for pair in woven.element_nodes.tolist()}
    for face in woven.faces:
        assert len(set(face)) == len(face)
        assert {frozenset(pair) for pair in zip(face, face[1:] + face[:1], strict=True)} <= elements
    areas = [area(face, woven.reference_position) for face in woven.faces]
    assert min(areas) > 0
    assert sum(areas) == pytest.approx(AREAS[topology], rel=1e-12)


@pytest.mark.parametrize("topology", THROWN)
@pytest.mark.parametrize("divisions", [1, 3])
def test_nets_look_the_same_after_a_turn(topology: str, divisions: int) -> None:
    """A quarter turn of the square, half of the rectangle, sixth of the honeycomb and of the cut triangles,
    one spoke of the web."""
    more = {"strings": {**STRING, "length": 0.9, "divisions": 2}, "bullets": {"mass": 1.0}}
    woven = net(topology, **THROWN[topology], **more, divisions=divisions)
    angle = 2 * math.pi / TURNS[topology]
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    position = woven.reference_position
    apart = np.linalg.norm((position[:, :2] @ turn)[:, None] - position[None, :, :2], axis=2)
    image = apart.argmin(axis=1)
    assert apart.min(axis=1).max() < 1e-12
    np.testing.assert_allclose(woven.mass[image], woven.mass, rtol=1e-12)
    elements = np.sort(woven.element_nodes, axis=1).tolist()
    assert sorted(np.sort(image[woven.element_nodes], axis=1).tolist()) == sorted(elements)


def test_names_of_nodes_are_places() -> None:
    """Of a square net of 2 m: the same for other meshes and divisions, as far as these have a knot there."""
    places = {
        "centre": (0.0, 0.0), "corner 0": (-1.0, -1.0), "corner 2": (1.0, 1.0),
        "rim 0.25": (1.0, -1.0), "rim 0.375": (1.0, 0.0), "rim 0.99": (-1.0, -1.0),
    }  # fmt: skip
    for meshes in (2, 4, 6):
        for divisions in (1, 2, 3):
            of = net(
                "square", size=2.0, meshes=meshes, divisions=divisions, strings={**STRING, "length": 1.0}
            )
            found = {name: of.reference_position[of.node(name)] for name in places}
            np.testing.assert_allclose(
                [found[name][:2] for name in places], list(places.values()), atol=1e-15
            )
            names = [of.name_of(node) for node in range(of.n_nodes)]
            assert all(name is None or of.node(name) == node for node, name in enumerate(names))
            assert names.count("centre") == 1
    odd = net("square", size=2.0, mesh=0.4, divisions=2)  # four knots are as near: the lowest, then leftmost
    np.testing.assert_allclose(odd.reference_position[odd.node("centre"), :2], [-0.2, -0.2], atol=1e-15)
    # Half the diagonal of a mesh of 0.4 m; half a mesh along the rim; none.
    distances = {"centre": 0.2 * np.sqrt(2.0), "rim 0.125": 0.2, "corner 1": 0.0}
    for name, distance in distances.items():
        assert odd.distance_from_name(name) == pytest.approx(distance, abs=1e-12)


@pytest.mark.parametrize("name", ["corner 4", "rim 1.5", "center", 25, -1])
def test_nodes_that_a_net_does_not_have_are_refused(name: int | str) -> None:
    with pytest.raises(ValueError, match="nodes 0 to 24"):
        net("square", size=2.0, mesh=0.5).node(name)


def test_numbers_of_meshes_make_the_same_net() -> None:
    for topology, size, mesh, meshes in (
        ("square", 1.5, 0.25, 6),
        ("rectangular", [1.5, 2.0], [0.25, 0.4], [6, 5]),
    ):
        one, other = net(topology, size=size, mesh=mesh), net(topology, size=size, meshes=meshes)
        for name in ("reference_position", "element_nodes", "reference_length", "mass"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
        for wrong in ({}, {"mesh": mesh, "meshes": meshes}):
            with pytest.raises(ValidationError):
                keys(topology, size=size, **wrong)


def test_square_positions_are_mirrored_exactly() -> None:
    """Not only to rounding: an asymmetry of one ulp would grow in the simulation (Fig. 4 of the paper)."""
    position = net("square", size=5.0, mesh=5.0 / 7).reference_position.reshape(8, 8, 3)
    np.testing.assert_array_equal(position[:, :, 0], -position[:, ::-1, 0])
    np.testing.assert_array_equal(position[:, :, 1], -position[::-1, :, 1])
    np.testing.assert_array_equal(position[:, :, 0], position[:, :, 1].T)


def test_hexagonal_knots_are_those_of_the_case_format() -> None:
    """Every vertex of every cell as docs/explanation/theory.md writes them, computed one by one."""
    a, rings = 0.7, 2
    expected = set()
    for q in range(-rings, rings + 1):
        for r in range(-rings, rings + 1):
            if abs(q + r) <= rings:
                centre = a * math.sqrt(3) * (q + r / 2), a * 1.5 * r
                for k in range(6):
                    angle = math.radians(30 + 60 * k)
                    x, y = centre[0] + a * math.cos(angle), centre[1] + a * math.sin(angle)
                    expected.add((round(x, 9) + 0.0, round(y, 9) + 0.0))
    found = net("hexagonal", mesh=a, rings=rings).reference_position.round(9) + 0.0
    assert {(x, y) for x, y, _ in found.tolist()} == expected
    assert len(found) == len(expected)


@pytest.mark.parametrize("rings", [0, 1, 3])
def test_bridles(rings: int) -> None:
    """theory.md: bullet k on the ray at 60 k degrees, at (R + 1/2) sqrt(3) a + sqrt(l^2 - a^2/4)."""
    a, length = 0.5, 0.8
    woven = net("hexagonal", mesh=a, rings=rings, strings={**STRING, "length": length}, bullets={"mass": 1.0})
    knots = (rings + 0.5) * math.sqrt(3) * a
    distance = knots + math.sqrt(length**2 - a**2 / 4)
    bullets = woven.reference_position[woven.bullet_nodes]
    angle = np.radians(60.0 * np.arange(6))
    expected = distance * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    np.testing.assert_allclose(bullets, expected, atol=1e-13)
    held = woven.element_nodes[woven.is_string]
    assert np.bincount(held[:, 0]).tolist() == [2] * 6
    # The knots that a bridle holds are (R + 1/2) sqrt(3) a along the ray and a/2 to its sides.
    for bullet, knot in held.tolist():
        ray = bullets[bullet] / distance
        place = woven.reference_position[knot]
        assert place @ ray == pytest.approx(knots, rel=1e-12)
        assert np.linalg.norm(place - (place @ ray) * ray) == pytest.approx(a / 2, rel=1e-12)


def test_radial_knots_are_those_of_the_case_format() -> None:
    """radius j / rings at angle 2 pi k / spokes, and the hub."""
    found = net("radial", radius=3.0, spokes=5, rings=2).reference_position
    expected = [[0.0, 0.0, 0.0]]
    for j in (1, 2):
        for k in range(5):
            angle = 2 * math.pi * k / 5
            expected.append([1.5 * j * math.cos(angle), 1.5 * j * math.sin(angle), 0.0])
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize("topology", THROWN)
def test_mouth_joins_the_corners_anticlockwise(topology: str) -> None:
    """The mouth spans the whole square, rectangle and polygon; the honeycomb's is a polygon of 12 corners."""
    woven = net(topology, **THROWN[topology], divisions=2, strings={**STRING, "length": 0.9})
    spanned = area(woven.mouth, woven.reference_position)
    if topology == "hexagonal":
        # Corners at ((R + 1/2) sqrt(3) a, +- a/2): twelve triangles from the centre, six of them a/2 wide.
        apothem, half = 2.5 * math.sqrt(3) * 0.6, 0.3
        wide = 0.5 * (apothem**2 + half**2) * math.sin(math.pi / 3 - 2 * math.atan(half / apothem))
        assert spanned == pytest.approx(6 * (apothem * half + wide), rel=1e-12)
    else:
        assert spanned == pytest.approx(AREAS[topology], rel=1e-12)
    held, sides = (set(woven.element_nodes[kind].ravel()) for kind in (woven.is_string, ~woven.is_string))
    assert set(woven.mouth) == held & sides


RIM = [0, 1, 2, 5, 8, 7, 6, 3]  # of two by two meshes, knots row by row: 0, 2, 8 and 6 are the corners


@pytest.mark.parametrize(
    "wrong",
    [
        {"mouth": RIM},
        {"mouth": [0, 2, 8]},
        {"mouth": [0, 2, 8, 6, 0]},
        {"mouth": [6, 8, 2, 0]},
        {"faces": [[0, 1, 4, 3], [1, 2, 5, 8]]},  # no side from 8 to 1
        {"faces": [[0, 1, 4, 3], [1, 4, 5, 2]]},  # clockwise
    ],
)
def test_a_topology_whose_mouth_or_faces_are_wrong_is_refused(
    monkeypatch: pytest.MonkeyPatch, wrong: dict[str, Any]
) -> None:
    """It would run, and its measures of deployment be wrong."""
    square, real = TOPOLOGIES["square"], TOPOLOGIES["square"].mesh
    arrays = {name: np.array(value) for name, value in wrong.items()}
    arrays |= {"faces": (arrays["faces"],)} if "faces" in arrays else {}
    monkeypatch.setattr(square, "mesh", lambda keys: replace(real(keys), **arrays))
    with pytest.raises(ValueError, match="the mesh of the topology 'square'"):
        net("square", size=2.0, mesh=1.0)


# Strings, bullets, divisions


def test_strings_without_bullets_end_in_a_node_with_half_their_mass() -> None:
    """2 kg/m x 1.5 m / 2 = 1.5 kg; such a node is no bullet."""
    woven = net("square", size=1.0, mesh=1.0, strings={**STRING, "length": 1.5})
    np.testing.assert_allclose(woven.mass[:4], 1.5)
    assert woven.bullet_nodes.size == 0


def test_divided_strings_pass_from_bullet_to_corner() -> None:
    """0.9 m in three: elements of 0.3 m in a row, with 2 kg/m x 0.3 m at each inner node."""
    woven = net("square", size=1.0, mesh=1.0, strings={**STRING, "length": 0.9, "divisions": 3})
    first = woven.element_nodes[woven.is_string][:3]
    np.testing.assert_array_equal(first[1:, 0], first[:-1, 1])
    assert (first[0, 0], first[-1, 1]) == (0, 4)
    np.testing.assert_allclose(woven.reference_length[woven.is_string], 0.3)
    np.testing.assert_allclose(distances(woven), woven.reference_length, rtol=1e-12)
    np.testing.assert_allclose(woven.mass[first[1:, 0]], 0.6)


@pytest.mark.parametrize("topology", THROWN)
def test_divisions_keep_mass_and_length(topology: str) -> None:
    more = {"strings": {**STRING, "length": 0.9}, "bullets": {"mass": 1.0}}
    whole = net(topology, **THROWN[topology], **more)
    more["strings"]["divisions"] = 5
    parts = net(topology, **THROWN[topology], **more, divisions=3)
    assert parts.mass.sum() == pytest.approx(whole.mass.sum(), rel=1e-12)
    assert parts.reference_length.sum() == pytest.approx(whole.reference_length.sum(), rel=1e-12)
    sides, strings = (~whole.is_string).sum(), whole.is_string.sum()
    assert parts.n_elements == 3 * sides + 5 * strings
    assert parts.n_nodes == whole.n_nodes + 2 * sides + 4 * strings


# Any valid net

CABLES = st.fixed_dictionaries(
    {
        "area": st.floats(1e-8, 1e-2),
        "density": st.floats(10.0, 1e4),
        "youngs_modulus": st.floats(1e3, 1e12),
    }
)
LENGTHS = st.floats(1e-3, 1e3)


@st.composite
def nets(draw: st.DrawFn) -> dict[str, Any]:
    """Keys of [net] of any topology."""
    table: dict[str, Any] = {
        "topology": draw(st.sampled_from(list(TOPOLOGIES))),
        "cable": draw(CABLES),
        "divisions": draw(st.integers(1, 4)),
    }
    small = st.integers(1, 6)
    mesh = draw(LENGTHS)
    if table["topology"] == "square":
        table |= {"mesh": mesh, "size": mesh * draw(small)}
    elif table["topology"] == "rectangular":
        other = draw(LENGTHS)
        table |= {"mesh": [mesh, other], "size": [mesh * draw(small), other * draw(small)]}
    elif table["topology"] == "hexagonal":
        table |= {"mesh": mesh, "rings": draw(st.integers(0, 3))}
    elif table["topology"] == "radial":
        table |= {"radius": mesh, "spokes": draw(st.integers(3, 9)), "rings": draw(small)}
    elif table["topology"] == "cut":
        outline = draw(st.sampled_from(["square", "hexagon", "octagon", "circle"]))
        table |= {"outline": outline, "mesh": mesh, "size": mesh * draw(st.floats(3.0, 9.0))}
        table |= {
            "mesh_shape": draw(st.sampled_from(["square", "triangle", "hexagon"])),
            "border": draw(CABLES),
        }
        if outline == "circle":
            table["corners"] = draw(st.integers(3, 8))
    else:
        place = st.tuples(*[st.integers(-9, 9)] * 3).map(list)
        nodes = draw(st.lists(place, min_size=2, max_size=8, unique_by=tuple))
        return table | {"nodes": nodes, "elements": [[k, k + 1] for k in range(len(nodes) - 1)]}
    if draw(st.booleans()):
        string = {"length": mesh * draw(st.floats(0.6, 3.0)), "divisions": draw(st.integers(1, 3))}
        table["strings"] = draw(CABLES) | string
    if draw(st.booleans()) and (table["topology"] != "hexagonal" or "strings" in table):
        table["bullets"] = {"mass": draw(st.floats(1e-3, 1e3))}
    return table


# Long meshes beside short strings: coordinates of 2185 m, distances of 0.2 mm.
FAR_FROM_THE_ORIGIN = {
    "topology": "rectangular",
    "mesh": [1e-3, 874.0],
    "size": [1e-3, 4370.0],
    "cable": CABLE,
    "strings": STRING | {"length": 6e-4, "divisions": 3},
}


@pytest.mark.ci
@pytest.mark.slow
@settings(max_examples=150)
@given(nets())
@example(FAR_FROM_THE_ORIGIN)
def test_any_net_is_sound(table: dict[str, Any]) -> None:
    woven = weave(KEYS.validate_python(table))
    n, m = woven.n_nodes, woven.n_elements
    assert m == KEYS.validate_python(table).n_elements
    bullets = len(woven.bullet_nodes) * table.get("bullets", {}).get("mass", 0.0)
    cables = float(np.sum(woven.density * woven.area * woven.reference_length))
    assert woven.mass.sum() == pytest.approx(cables + bullets, rel=1e-10)
    assert (woven.mass > 0).all()
    i, j = woven.element_nodes.T
    assert (woven.element_nodes >= 0).all()
    assert (woven.element_nodes < n).all()
    assert (i != j).all()
    assert len({frozenset(pair) for pair in woven.element_nodes.tolist()}) == m
    # Round-off goes with the coordinates: each is off by up to one spacing of doubles at the net's reach, so
    # the vector between two nodes by 2 sqrt(3) of them at most, and its length by its own arithmetic.
    off = (
        2.0 * math.sqrt(3.0) * np.spacing(np.abs(woven.reference_position).max())
        + 1e-14 * woven.reference_length
    )
    assert (np.abs(distances(woven) - woven.reference_length) <= off).all()
    assert connected_components(coo_array((np.ones(m), (i, j)), shape=(n, n)))[0] == 1
    for array in (woven.area, woven.youngs_modulus, woven.density, woven.is_string):
        assert array.shape == (m,)
    assert woven.reference_position.shape == (n, 3)


# Nets that cannot be


def refused(topology: str, **others: Any) -> list[tuple[tuple[Any, ...], str]]:
    """(location below [net], message) of each fault: of single keys or, without such, between keys."""
    with pytest.raises(ValidationError) as error:
        keys(topology, **others)
    found: list[tuple[tuple[Any, ...], str]] = []
    for item in error.value.errors():
        below = item["loc"][1:]
        own = item["ctx"]["faults"] if item["type"] == "faults" else []
        found += [((*below, *fault.path), fault.reason) for fault in own] or [(below, item["msg"])]
    return found


@given(size=st.floats(0.01, 1e4), ratio=st.floats(0.1, 5e2))
@settings(max_examples=60)
def test_the_meshes_that_a_fault_proposes_do_fit(size: float, ratio: float) -> None:
    try:
        keys("square", size=size, mesh=size / ratio)
        return
    except ValidationError:
        ((_, reason),) = refused("square", size=size, mesh=size / ratio)
    proposed = reason.partition("; mesh = ")[2].removesuffix(" would fit")
    for text in proposed.split(" or ") if proposed else ():
        assert keys("square", size=size, mesh=float(text.split(" (")[0])).n_sides > 0


def test_a_whole_number_of_meshes_may_be_off_by_1e_9() -> None:
    """The bound of docs/explanation/theory.md."""
    assert keys("square", size=5.0, mesh=5.0 / (3 + 0.5e-9)).n_sides == 24
    assert refused("square", size=5.0, mesh=5.0 / (3 + 2e-9))[0][0] == ("mesh",)


def test_hexagonal_strings_must_reach_the_bridle_and_hold_the_bullets() -> None:
    """docs/explanation/theory.md: longer than a/2 = 0.5 m."""
    faults = refused("hexagonal", mesh=1.0, rings=1, strings={**STRING, "length": 0.5})
    assert [where for where, _ in faults] == [("strings", "length")]
    assert keys("hexagonal", mesh=1.0, rings=1, strings={**STRING, "length": 0.501}).n_strings == 12
    assert refused("hexagonal", mesh=1.0, rings=1, bullets={"mass": 1.0})[0][0] == ("bullets",)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"elements": [[0, 1], [1, 1]]}, ("elements", 1)),
        ({"elements": [[0, 1], [1, 3]]}, ("elements", 1)),
        ({"elements": [[0, 1], [-1, 0]]}, ("elements", 1, 0)),
        ({"nodes": [[0, 0, 0], [1, 0, 0], [1, 0, 0]], "elements": [[0, 1], [1, 2]]}, ("elements", 1)),
        ({"elements": [[0, 1]]}, ("nodes", 2)),
        ({"elements": None}, ("elements",)),
        ({"bullets": {"mass": 1.0}}, ("bullets",)),
        ({"corners": [0, 1, 3]}, ("corners", 2)),
        ({"corners": [0, 1, 1]}, ("corners", 2)),
        ({"elements": [[0, 1]], "node_masses": [1, 1, 0]}, ("nodes", 2)),
        ({"node_masses": [1.0, 2.0]}, ("node_masses",)),
        ({"node_masses": [1.0, 2.0, -1.0]}, ("node_masses", 2)),
        ({"fixed": [0, 3]}, ("fixed", 1)),
        ({"fixed": [-1]}, ("fixed", 0)),
        ({"nodes": []}, ("nodes",)),
    ],
)
def test_explicit_faults_are_located(change: dict[str, Any], where: tuple[Any, ...]) -> None:
    table = {"nodes": [[0, 0, 0], [1, 0, 0], [2, 0, 0]], "elements": [[0, 1], [1, 2]]}
    assert refused("explicit", **(table | change))[0][0] == where


@pytest.mark.parametrize(
    ("topology", "others"),
    [
        ("square", {"size": 1000.0, "mesh": 1.0}),  # 2 n (n + 1) = 2 002 000 elements
        ("square", {"size": 1.0, "mesh": 1.0, "divisions": MAX_ELEMENTS}),
        ("square", {"size": 1e300, "mesh": 1e-300}),
        ("hexagonal", {"mesh": 1.0, "rings": 1000}),
        ("radial", {"radius": 1.0, "spokes": 1000, "rings": 1000}),
        ("radial", {"radius": 1.0, "spokes": 10**18, "rings": 10**18}),
    ],
)
def test_absurd_sizes_are_refused_before_they_are_made(topology: str, others: dict[str, Any]) -> None:
    """The smallest of these nets would take 16 MB for the numbers of its elements' nodes alone."""
    with traced() as most:
        assert refused(topology, **others)
        assert most() < 1e6


def test_lengths_beyond_floating_point_are_a_typed_error() -> None:
    with pytest.raises(CaseError, match="mass"):
        net("square", size=1e300, mesh=1e300)


sides = st.lists(st.floats(0.01, 10.0), min_size=3, max_size=9)


def regular(corners: int, side: float) -> float:
    return corners * side**2 / (4 * math.tan(math.pi / corners))


@pytest.mark.parametrize(
    ("lengths", "area"),
    [
        ([3.0, 4.0, 5.0], 6.0),  # right-angled: the centre of the circle lies on the longest side
        ([2.0, 2.0, 2.0], math.sqrt(3.0)),
        ([2.0, 3.0, 2.0, 3.0], 6.0),
        ([3.0, 2.0, 2.0, 3.0], 6.0),  # the order of the sides does not matter
        ([7.0, 15.0, 20.0, 24.0], 234.0),  # Brahmagupta, with two right angles: 7^2 + 24^2 = 15^2 + 20^2
        ([1.0] * 6, regular(6, 1.0)),
        ([0.3] * 1000, regular(1000, 0.3)),
        ([1.0, 1.0, 1.99], 0.5),  # the third side hangs slack at sqrt(2): at 1.99 m only 0.1 m2 were left
        ([1.0, 1.0, 50.0], 0.5),  # longer than the others together
        ([1.0, 1.0, 1.0, 50.0], 3 * math.sqrt(3) / 4),  # half of a regular hexagon
        ([1.0, 1.0, math.inf], 0.5),
        ([1.0, 1.0, 1e-12], 0.5e-12),  # to 1e-12 of the longest side squared
        ([1.0, 1.0, 1e-3], 0.5e-3 * math.sqrt(1 - 0.25e-6)),
        ([1.0, 2.0], 0.0),
        ([1.0, 2.0, 0.0], 0.0),
        ([], 0.0),
    ],
)
def test_largest_polygons_that_are_known(lengths, area):
    assert largest_polygon(np.array(lengths)) == pytest.approx(area, rel=1e-12, abs=1e-12)


@given(sides, st.integers(0, 2**32 - 1))
def test_longer_threads_never_bound_a_smaller_area(lengths, seed):
    lengths = np.array(lengths)
    longer = lengths * np.random.default_rng(seed).uniform(1.0, 2.0, len(lengths))
    assert largest_polygon(longer) >= largest_polygon(lengths) * (1 - 1e-12)


@pytest.mark.slow
@settings(max_examples=300)
@given(st.integers(3, 12), st.floats(0.0, 3.0), st.integers(0, 2**32 - 1))
def test_no_loop_in_space_has_more_area_than_the_flat_one(corners, depth, seed):
    """Corners at random, from flat to deep: the fan from their mean against the sides that they have."""
    rng = np.random.default_rng(seed)
    loop = rng.normal(size=(corners, 3)) * (1.0, 1.0, depth)
    of = loop_net(loop, [(k, (k + 1) % corners) for k in range(corners)], mouth=tuple(range(corners)))
    assert metrics.mouth_area(of, loop) <= achievable_area(of) * (1 + 1e-12)


def test_the_largest_polygon_is_reached():
    """Regular loops, deformed along their circle, come as near as one likes: the bound is no other number."""
    angles = np.sort(np.random.default_rng(3).uniform(0, 2 * np.pi, 9))
    loop = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(9)])
    of = loop_net(loop, [(k, (k + 1) % 9) for k in range(9)], mouth=tuple(range(9)))
    ahead = np.append(np.diff(angles), 2 * np.pi + angles[0] - angles[-1])
    assert ahead.max() < np.pi  # the centre is inside
    assert achievable_area(of) == pytest.approx(0.5 * np.sin(ahead).sum(), rel=1e-12)


def test_a_border_is_the_shortest_way_along_the_threads():
    """A loop with a detour beside each direct thread, and two threads between the same knots."""
    at = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, -1, 0)]
    of = loop_net(at, [(0, 1), (1, 2), (2, 1), (2, 3), (3, 0), (0, 4), (4, 1)], mouth=(0, 1, 2, 3))
    np.testing.assert_allclose(border_lengths(of), 1.0, rtol=1e-15)
    assert achievable_area(of) == pytest.approx(1.0, rel=1e-14)


def test_a_mouth_that_threads_do_not_hold_has_no_measures():
    of = loop_net([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1), (2, 3)], mouth=(0, 1, 2, 3))
    assert achievable_area(of) == math.inf
    assert metrics.deployment(result(of, [0.0], [of.reference_position])) is None
    assert achievable_area(loop_net([(0, 0, 0), (1, 0, 0)], [(0, 1)])) == 0.0
    assert achievable_area(square_net(cells=4, strings=True)) == pytest.approx(1.0, rel=1e-14)


PAPER_STRINGS = {**PAPER_CABLE, "diameter": 0.004, "length": 1.0}
SPANNED = {
    "square": ({"topology": "square", "size": 2.0, "mesh": 0.5}, 4.0),
    "square, divided": ({"topology": "square", "size": 2.0, "mesh": 1.0, "divisions": 3}, 4.0),
    "rectangular": ({"topology": "rectangular", "size": [3.0, 1.0], "mesh": [1.0, 0.5]}, 3.0),
    "radial": ({"topology": "radial", "radius": 1.5, "spokes": 5, "rings": 3}, None),
    "radial, three": ({"topology": "radial", "radius": 1.5, "spokes": 3, "rings": 2, "divisions": 2}, None),
    "one cell": ({"topology": "hexagonal", "mesh": 0.7, "rings": 0}, 1.5 * math.sqrt(3) * 0.49),
    # Twelve sides: six of 0.3 m at the corner cells, six zigzags of 2 x 2 threads between those.
    "hexagonal": ({"topology": "hexagonal", "mesh": 0.3, "rings": 2}, None),
    "cut": (  # an octagon of width 2 m
        {"topology": "cut", "outline": "octagon", "size": 2.0, "mesh_shape": "triangle", "mesh": 0.4}
        | {"border": PAPER_CABLE},
        8.0 * math.tan(math.pi / 8.0),
    ),
    "hexagonal, divided": ({"topology": "hexagonal", "mesh": 0.3, "rings": 2, "divisions": 2}, None),
}


@pytest.mark.parametrize("name", SPANNED)
def test_borders_of_the_topologies(name):
    keys, area = SPANNED[name]
    of = prepare(
        thrown({}, net={"cable": PAPER_CABLE, "strings": PAPER_STRINGS, "bullets": {"mass": 0.5}, **keys})
    ).net
    border, reference = border_lengths(of), float(metrics.mouth_area(of, of.reference_position))
    if keys["topology"] == "hexagonal" and keys["rings"]:
        rings, side = keys["rings"], keys["mesh"]
        np.testing.assert_allclose(border, [side, 2 * rings * side] * 6, rtol=1e-12)
        known = largest_polygon(np.tile([side, 2 * rings * side], 6))
        assert achievable_area(of) == pytest.approx(known, rel=1e-12)
        assert achievable_area(of) > 1.1 * reference  # straight zigzags make room
    else:
        corners = of.reference_position[list(of.mouth)]
        apart = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        np.testing.assert_allclose(border, apart, rtol=1e-12)
        assert achievable_area(of) == pytest.approx(reference, rel=1e-12)
    if area is not None:
        assert achievable_area(of) == pytest.approx(area, rel=1e-12)


@pytest.mark.slow_for("cut", "one cell", "hexagonal", "square, divided", "hexagonal, divided")
@pytest.mark.parametrize("name", sorted(SPANNED))
def test_no_thrown_net_opens_beyond_its_achievable_area(name):
    """Thrown so hard that its threads strain: the area exceeds the bound by their stretch at most."""
    keys, _ = SPANNED[name]
    of = {"cable": PAPER_CABLE, "strings": PAPER_STRINGS, "bullets": {"mass": 0.5}, **keys}
    changes = {"net": of, "launch": {"radial_speed": 15.0, "axial_speed": 3.0}, "initial": {"packing": 0.6}}
    run = simulate(prepare(thrown({}, end=0.4, engine={"backend": "compiled"}, **changes)))
    area = metrics.mouth_area(run.net, run.position)
    stretch = np.sqrt(1 + 2 * np.maximum(run.strain.max(axis=1), 0.0))  # eq. (6): L / L0
    assert 1.0 < stretch.max() < 1.08
    largest = float(area.max()) / achievable_area(run.net)
    assert largest > 0.7  # the bound is near what a loop_net reaches
    assert np.all(area <= stretch**2 * achievable_area(run.net) * (1 + 1e-12))
    found = metrics.deployment(run)
    assert found is not None
    assert found.relative_area == largest
    assert largest <= float(stretch.max()) ** 2


def test_a_mouth_against_a_width():
    """Of states that follow each other: the sign of the diameter less the width, and no more than that."""
    rng = np.random.default_rng(0)
    loop = rng.normal(size=(7, 3))
    of = loop_net(loop, [(k, (k + 1) % 7) for k in range(7)], faces=(tuple(range(7)),), mouth=(0, 2, 4))
    states = loop * rng.uniform(0.2, 1.5, (40, 1, 1)) + rng.normal(size=(40, 7, 3)) * 0.4
    known = np.array([pdist(state).max() for state in states])
    np.testing.assert_allclose(mouth_diameter(of, states), known, rtol=1e-14)
    exact = 0
    for width in (
        *np.quantile(known, [0.05, 0.3, 0.5, 0.8]).tolist(),
        float(known[7]),
        float(known.max()) * 3.0,
    ):
        found = mouth_against(of, states, width)
        apart = known - width
        near = abs(apart) < 1e-12
        np.testing.assert_array_equal(found[~near] > 0.0, apart[~near] > 0.0)
        assert abs(found[near]).max(initial=0.0) < 1e-12
        assert (abs(found) <= abs(apart) + 1e-12).all()
        exact += int((abs(found - apart) < 1e-12).sum())
    assert exact > 10
    bare = loop_net(loop, [(0, 1)])
    assert mouth_against(bare, states[:2], 0.5).tolist() == [-0.5, -0.5]
    assert mouth_diameter(bare, states[:2]).tolist() == [0.0, 0.0]

"""Nets cut to an outline: against what theory.md says of them, written apart, and by hand."""

from __future__ import annotations

import math
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from scenes import CASES, listed
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import exunet
import reference_impl
from exunet.net import AnyNetConfig, weave
from exunet.net.arrays import Net
from exunet.net.cut import SHORTEST, CutNet, mesh
from exunet.results.measures import mouth_area

CABLE = {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e9}
BORDER = {"area": 4e-6, "density": 2000.0, "youngs_modulus": 2e9}
OUTLINES = {"square": 4, "hexagon": 6, "octagon": 8, "circle": 12}
MESHES = ("square", "triangle", "hexagon")
KEYS = TypeAdapter(AnyNetConfig)


def keys(outline: str, mesh_shape: str, size: float = 5.0, mesh: float = 0.5, **others: Any) -> CutNet:
    table = {"topology": "cut", "outline": outline, "mesh_shape": mesh_shape, "size": size, "mesh": mesh}
    if outline == "circle":
        table["corners"] = OUTLINES[outline]
    found = KEYS.validate_python(table | {"cable": CABLE, "border": BORDER} | others)
    assert isinstance(found, CutNet)
    return found


def outside(outline: str, points: np.ndarray, size: float = 5.0) -> np.ndarray:
    """How far points lie beyond the nearest side of the outline [m], negative inside."""
    if outline == "circle":
        return np.hypot(*points.T) - size / 2
    number = OUTLINES[outline]
    first = {"square": 0.0, "hexagon": 30.0, "octagon": 0.0}[outline]
    angle = np.radians(first + 360.0 / number * np.arange(number))
    return (points @ np.stack([np.cos(angle), np.sin(angle)])).max(axis=1) - size / 2


def border(woven: Net) -> np.ndarray:
    """Which elements are of the border."""
    return np.asarray(woven.area == BORDER["area"])


def area(loop: Any, position: np.ndarray) -> float:
    x, y = position[list(loop), :2].T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@pytest.mark.parametrize(("outline", "mesh_shape"), list(product(OUTLINES, MESHES)))
@pytest.mark.parametrize("size", [5.0, 4.73, 3.3])
def test_what_every_cut_net_is(outline: str, mesh_shape: str, size: float) -> None:
    """Connected, planar (Euler: V - E + F = 1), over the whole outline, nothing shorter than promised."""
    of = keys(outline, mesh_shape, size)
    woven = weave(of)
    assert woven.n_elements == of.n_elements == of.n_sides
    ends, at = woven.element_nodes, woven.reference_position
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(woven.n_nodes, woven.n_nodes))
    assert connected_components(graph)[0] == 1
    assert woven.n_nodes - woven.n_elements + len(woven.faces) == 1
    areas = [area(face, at) for face in woven.faces]
    rim = ends[border(woven), 0]
    assert min(areas) > 0.0
    assert sum(areas) == pytest.approx(area(rim, at), rel=1e-12)
    assert woven.reference_length.min() > SHORTEST * 0.5
    assert not at[:, 2].any()
    # The border is one closed thread on the outline, and nothing else touches it from outside.
    assert (ends[border(woven), 1] == np.roll(rim, -1)).all()
    assert np.abs(outside(outline, at[rim, :2], size)).max() < 1e-14 * size
    inner = np.setdiff1d(np.arange(woven.n_nodes), rim)
    assert outside(outline, at[inner, :2], size).max() < -0.25 * 0.5


@pytest.mark.parametrize(("outline", "mesh_shape"), list(product(OUTLINES, MESHES)))
def test_areas_and_lengths_of_the_border(outline: str, mesh_shape: str) -> None:
    """Of polygons n tan(pi/n) L^2/4 and n tan(pi/n) L; of the circle a polygon of chords, a little less."""
    woven = weave(keys(outline, mesh_shape))
    number = OUTLINES[outline]
    of_border = woven.reference_length[border(woven)].sum()
    total = sum(area(face, woven.reference_position) for face in woven.faces)
    mouth = float(mouth_area(woven, woven.reference_position))
    corners = woven.reference_position[list(woven.mouth), :2]
    assert len(corners) == number
    if outline == "circle":
        longest = woven.reference_length[border(woven)].max()
        # A chord s of radius R is shorter than its arc by s^3 / (24 R^2), its segment s^3 / (12 R), and more.
        assert 0.0 < math.pi * 5.0 - of_border < len(woven.faces) * longest**3 / 24 / 2.5**2
        assert 0.0 < math.pi * 2.5**2 - total < len(woven.faces) * longest**3 / 12 / 2.5
        assert mouth == pytest.approx(6 * 2.5**2 * math.sin(2 * math.pi / 12), rel=1e-12)
    else:
        assert of_border == pytest.approx(number * math.tan(math.pi / number) * 5.0, rel=1e-12)
        assert total == pytest.approx(number * math.tan(math.pi / number) * 2.5**2, rel=1e-12)
        assert mouth == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize(("outline", "mesh_shape"), list(product(OUTLINES, MESHES)))
@pytest.mark.parametrize("size", [5.0, 4.73])
def test_mirrored_to_the_last_bit(outline: str, mesh_shape: str, size: float) -> None:
    """About both axes, and squares and octagons of squares about the diagonal too."""
    at = mesh(keys(outline, mesh_shape, size)).knots[:, :2] + 0.0
    places = {tuple(item) for item in at.tolist()}
    for image in (at * [-1.0, 1.0], at * [1.0, -1.0]):
        assert {tuple(entry) for entry in (image + 0.0).tolist()} == places
    if mesh_shape == "square" and outline != "hexagon":
        assert {tuple(element) for element in at[:, ::-1].tolist()} == places


@pytest.mark.parametrize("n", [4, 7])
def test_squares_that_fit_a_square_are_the_square_net(n: int) -> None:
    """n meshes a side: the same knots and sides as topology "square", the outer ones of the border thread."""
    found = weave(keys("square", "square", 3.0, 3.0 / n))
    table = {"topology": "square", "size": 3.0, "mesh": 3.0 / n, "cable": CABLE}
    known = weave(KEYS.validate_python(table))
    assert border(found).sum() == 4 * n

    def drawn(net: Net) -> set[Any]:
        at = net.reference_position.round(9) + 0.0
        return {frozenset(map(tuple, at[pair].tolist())) for pair in net.element_nodes}

    assert drawn(found) == drawn(known)


def test_triangles_that_fit_a_hexagon() -> None:
    """A hexagon of side n l has 3 n (n + 1) + 1 knots and 9 n^2 + 3 n sides, 6 n of them its border."""
    n, side = 4, 0.5
    woven = weave(keys("hexagon", "triangle", n * side * math.sqrt(3), side))
    assert woven.n_nodes == 3 * n * (n + 1) + 1
    assert woven.n_elements == 9 * n * n + 3 * n
    assert border(woven).sum() == 6 * n
    np.testing.assert_allclose(woven.reference_length, side, rtol=1e-12)


@pytest.mark.parametrize(("outline", "mesh_shape"), list(product(OUTLINES, MESHES)))
@pytest.mark.parametrize("size", [2.5, 2.21])
def test_both_codes_cut_alike(outline: str, mesh_shape: str, size: float) -> None:
    """The reference cuts one side after the other: the same nodes, elements between them and masses."""
    of = keys(outline, mesh_shape, size)
    case = listed([], [], 1.0) | {"net": of.document()}
    theirs = reference_impl.prepare(reference_impl.read_document(case)).net
    ours = weave(of)
    apart, same = cKDTree(theirs.reference_position).query(ours.reference_position)
    assert apart.max() < 1e-12 * size
    pairs = (np.sort(same[ours.element_nodes], axis=1), np.sort(theirs.element_nodes, axis=1))
    assert sorted(pairs[0].tolist()) == sorted(pairs[1].tolist())
    np.testing.assert_allclose(ours.mass, theirs.mass[same], rtol=1e-12)


def test_a_cut_through_squares_by_hand() -> None:
    """An octagon of 4 m, meshes of 1 m: knots at whole metres, n = 4 meshes across.

    Its corners lie at 2 (1, tan 22.5) = (2, 0.828), so the knots (2, 1), 0.12 m off the slanting side and
    near its end, become corners. Those at (2, 2) are outside; (1, 1) and all nearer to the origin are inner:
    nine, and the border has 8 corners, with (2, 0) and its like 4 more. The thread from (1, 1) to (2, 1) ends
    at the corner (2, 0.828).
    """
    woven = weave(keys("octagon", "square", 4.0, 1.0))
    assert (woven.n_nodes, border(woven).sum()) == (21, 12)
    assert woven.n_elements == 12 + 12 + 12  # of inner knots, from those to the border, of the border
    lengths = np.sort(woven.reference_length[~border(woven)])
    np.testing.assert_allclose(lengths[:16], 1.0, rtol=1e-14)
    corner = math.hypot(1.0, 1.0 - 2.0 * math.tan(math.pi / 8))
    np.testing.assert_allclose(lengths[16:], corner, rtol=1e-14)


def test_the_border_is_a_thread_of_its_own() -> None:
    """Its area, density and modulus on its elements; divided as the others, all mass in its place."""
    strings = CABLE | {"length": 0.6, "divisions": 2}
    woven = weave(keys("circle", "triangle", divisions=3, strings=strings, bullets={"mass": 0.5}))
    of_border = border(woven)
    assert (woven.density[of_border] == BORDER["density"]).all()
    assert (woven.youngs_modulus[of_border] == BORDER["youngs_modulus"]).all()
    assert (woven.area[~of_border] == CABLE["area"]).all()
    assert not (of_border & woven.is_string).any()
    assert woven.is_string.sum() == 24
    cables = float((woven.area * woven.density * woven.reference_length).sum())
    assert woven.mass.sum() == pytest.approx(cables + 12 * 0.5, rel=1e-12)
    corners = woven.reference_position[list(woven.mouth)]
    bullets = woven.reference_position[woven.bullet_nodes]
    np.testing.assert_allclose(bullets, corners * (2.5 + 0.6) / 2.5, atol=1e-14)


@pytest.mark.slow
@settings(max_examples=60)
@given(
    st.sampled_from(list(OUTLINES)),
    st.sampled_from(MESHES),
    st.floats(3.0, 15.0),
    st.integers(3, 8),
    st.floats(1e-3, 1e3),
)
def test_no_side_is_short_at_any_size(
    outline: str, mesh_shape: str, ratio: float, corners: int, side: float
) -> None:
    more = {"corners": corners} if outline == "circle" else {}
    try:
        of = keys(outline, mesh_shape, ratio * side, side, **more)
    except ValidationError:
        return
    found = mesh(of)
    at = found.knots[:, :2]
    lengths = np.linalg.norm(at[found.sides[:, 1]] - at[found.sides[:, 0]], axis=1)
    assert lengths.min() > (SHORTEST - 1e-8) * side
    faces = [loop for group in found.faces for loop in group]
    assert len(at) - len(found.sides) + len(faces) == 1
    assert min(area(loop, at) for loop in faces) > 0.0


def test_the_same_size_in_other_units_is_the_same_net() -> None:
    """Where size / mesh is half a number, round-off decides nothing: 0.75 / 0.3, 7.5 / 3."""
    first, second = (mesh(keys("octagon", "square", 7.5 * u, 3.0 * u / 5)) for u in (0.1, 1.0))
    np.testing.assert_array_equal(first.sides, second.sides)
    np.testing.assert_allclose(10.0 * first.knots, second.knots, atol=1e-14)


# Faults


@pytest.mark.parametrize(
    ("outline", "numbers", "others", "where"),
    [
        ("circle", (), {"corners": None}, "corners"),
        ("circle", (), {"corners": 2}, "corners"),
        ("hexagon", (), {"corners": 6}, "corners"),
        ("square", (5.0, 1.7), {}, "size"),  # fewer than three meshes across
        ("circle", (), {"corners": 40}, "mesh"),  # corners nearer than a mesh: 5 sin(pi/40) = 0.392 m
        ("circle", (1e3, 1e-2), {}, None),  # 2 sqrt(3) (1e5)^2 = 3.46e10 sides, before they are made
    ],
)
def test_nets_that_cannot_be_cut(
    outline: str, numbers: tuple[float, ...], others: dict[str, Any], where: str | None
) -> None:
    with pytest.raises(ValidationError) as error:
        keys(outline, "triangle", *numbers, **others)
    found: set[Any] = set()
    for item in error.value.errors():
        own = item["ctx"]["faults"] if item["type"] == "faults" else []
        found |= {(*item["loc"][1:], *fault.path) for fault in own} or {item["loc"][1:]}
    assert where is None or found == {(where,)}


# The shipped case


@pytest.mark.ci
@pytest.mark.slow
def test_the_shipped_case_flies_until_its_strings_snap() -> None:
    """Compiled, without damping: bullets at 2.5 m/s, packed to a tenth, strings of 1 m: 0.9 / 2.5 = 0.36 s.

    The net is thrown symmetrically: its momentum stays that of the throw along z.
    """
    case = exunet.load(CASES / "nets" / "cut.toml", ["time.end=0.4", "engine.backend=compiled"])
    run = exunet.run(case)
    assert run.complete
    slack = run.time < 0.36
    assert slack.sum() > 2
    assert not run.tension[slack].any()
    assert run.tension[-1].max() > 0.0 or run.run.largest_tension.time > 0.36
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-9


def test_angles_of_the_corners() -> None:
    """docs/explanation/theory.md: 45 + 90 k, 60 k, 22.5 + 45 k, 360 k / corners degrees."""
    first = {"square": 45.0, "hexagon": 0.0, "octagon": 22.5, "circle": 0.0}
    for outline, number in OUTLINES.items():
        found = mesh(keys(outline, "square"))
        corners = found.knots[found.mouth, :2]
        angles = np.degrees(np.arctan2(corners[:, 1], corners[:, 0])) % 360.0
        np.testing.assert_allclose(angles, first[outline] + 360.0 / number * np.arange(number), atol=1e-12)
        steps = [b - a for a, b in pairwise(found.mouth.tolist())]
        assert min(steps) > 0

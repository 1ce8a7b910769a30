"""Nets of reference_impl: counts, lengths, masses, places at the start, the rules by which nets are cut."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import Refused, prepare, read_document, weave, with_places

CABLE_MASS = 1390.0 * math.pi / 4 * 0.002**2  # [kg/m]
STRING_MASS = 4 * CABLE_MASS  # [kg/m], twice as thick


@pytest.fixture(scope="module")
def net(document):
    return lambda topology, **keys: weave(read_document(document(topology, **keys)))


def test_planar_net_of_the_paper(net):
    """Paper, 3.3: 40 nodes, 64 elements; by hand 2.360819 kg."""
    planar = net("square")
    assert (len(planar.mass), len(planar.element_nodes)) == (40, 64)
    assert planar.mass.sum() == pytest.approx(2.360819, abs=5e-7)
    assert np.allclose(
        planar.reference_position[planar.bullet_nodes],
        3.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
        atol=1e-15,
    )


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (6, 4), (1, 9)])
def test_rectangular_counts(net, nx, ny):
    grid = net("rectangular", size=[0.5 * nx, 0.25 * ny])
    knots, sides = (nx + 1) * (ny + 1), nx * (ny + 1) + ny * (nx + 1)
    assert (len(grid.mass), len(grid.element_nodes)) == (knots + 4, sides + 4)
    length = 0.5 * nx * (ny + 1) + 0.25 * ny * (nx + 1)
    assert grid.mass.sum() == pytest.approx(length * CABLE_MASS + 4 * (0.5 + 2**0.5 * STRING_MASS), rel=1e-14)


def cells(at, ring):
    """Middles (k, 2) of the hexagons whose six corners, middle - ring (6, 2), are among the points `at`."""
    middles = np.unique(np.round((at[:, None] + ring).reshape(-1, 2), 9) + 0.0, axis=0, return_counts=True)
    return middles[0][middles[1] == 6]


@pytest.mark.parametrize("rings", [0, 1, 2, 5])
def test_hexagonal_counts(net, rings):
    """V = 6 (R+1)^2 knots, S = 9 R^2 + 15 R + 6 sides: Euler's V - S + C = 1 with C = 3 R (R+1) + 1 cells.

    Two or three sides meet in a knot: 6 R + 6 corners of the rim and, as 2 S = 2 n2 + 3 n3, 6 R (R+1) inside.
    Cells are found by their middles, which have six knots at the distance of a side, 0.5 m.
    """
    comb = net("hexagonal", rings=rings)
    knots, sides = 6 * (rings + 1) ** 2, 9 * rings**2 + 15 * rings + 6
    assert (len(comb.mass), len(comb.element_nodes)) == (knots + 6, sides + 12)
    assert comb.mass.sum() == pytest.approx(0.5 * sides * CABLE_MASS + 6 * 0.5 + 12 * 2**0.5 * STRING_MASS)
    of_cable = ~np.isin(comb.element_nodes, comb.bullet_nodes).any(axis=1)
    meeting = np.bincount(comb.element_nodes[of_cable].ravel(), minlength=len(comb.mass))
    inside = [6 * rings * (rings + 1)] if rings else []
    assert np.bincount(meeting).tolist() == [6, 0, 6 * rings + 6, *inside]  # the bullets have strings only
    at = np.delete(comb.reference_position, comb.bullet_nodes, axis=0)[:, :2]
    ring = [(math.cos(angle), math.sin(angle)) for angle in math.pi / 3 * (np.arange(6) + 0.5)]
    ring = 0.5 * np.array(ring)  # with a corner straight up
    assert len(cells(at, ring)) == 3 * rings * (rings + 1) + 1
    bullets = comb.reference_position[comb.bullet_nodes]
    radius = (rings + 0.5) * 3**0.5 * 0.5 + (2 - 0.5**2 / 4) ** 0.5
    angle = math.pi / 3 * np.arange(-3, 3)
    assert np.allclose(bullets[:, :2], radius * np.column_stack((np.cos(angle), np.sin(angle))), atol=1e-14)


@pytest.mark.parametrize(("spokes", "rings"), [(3, 1), (8, 3), (7, 10)])
def test_radial_counts(net, spokes, rings):
    web = net("radial", spokes=spokes, rings=rings)
    assert len(web.mass) == 1 + spokes * rings + spokes
    assert len(web.element_nodes) == 2 * spokes * rings + spokes
    chords = 2 * math.sin(math.pi / spokes) * 2.0 * (rings + 1) / 2
    mass = spokes * ((2.0 + chords) * CABLE_MASS + 0.5 + 2**0.5 * STRING_MASS)
    assert web.mass.sum() == pytest.approx(mass, rel=1e-13)


@pytest.mark.parametrize("topology", ["square", "rectangular", "hexagonal", "radial"])
@pytest.mark.parametrize("divisions", [1, 2, 5])
def test_lengths_are_distances_and_divisions_keep_the_mass(net, document, topology, divisions):
    whole = net(topology)
    strings = {**document()["net"]["strings"], "divisions": divisions}
    fine = net(topology, divisions=divisions, strings=strings)
    ends = fine.reference_position[fine.element_nodes]
    distance = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert fine.reference_length == pytest.approx(distance, abs=2e-15)
    assert len(fine.element_nodes) == divisions * len(whole.element_nodes)
    assert len(fine.mass) == len(whole.mass) + (divisions - 1) * len(whole.element_nodes)
    assert fine.mass.sum() == pytest.approx(whole.mass.sum(), rel=1e-13)
    assert len(np.unique(np.round(fine.reference_position, 9), axis=0)) == len(fine.mass)


@pytest.mark.parametrize(
    ("topology", "swaps"), [("square", True), ("rectangular", False), ("hexagonal", False), ("radial", True)]
)
def test_mirrored_nodes_agree_to_the_last_bit(net, topology, swaps):
    mesh = net(topology, divisions=3)
    rows = {tuple(p): m for p, m in zip((mesh.reference_position + 0.0).tolist(), mesh.mass, strict=True)}
    for (x, y, z), mass in rows.items():
        assert rows[(-x + 0.0, y, z)] == mass
        assert rows[(x, -y + 0.0, z)] == mass
        assert not swaps or rows[(y, x, z)] == mass


def test_bullets_without_strings_sit_on_the_corners(document):
    case = document("radial")
    del case["net"]["strings"]
    web = weave(read_document(case))
    assert len(web.mass) == 25
    assert np.linalg.norm(web.reference_position[web.bullet_nodes], axis=1) == pytest.approx([2.0] * 8)
    assert np.all(web.mass[web.bullet_nodes] > 0.5)


def test_strings_without_bullets_end_in_light_nodes(document):
    case = document("square")
    del case["net"]["bullets"], case["launch"]
    net = weave(read_document(case))
    assert len(net.mass) == 40
    assert net.bullet_nodes.size == 0
    assert net.mass.min() == pytest.approx(1.5 * CABLE_MASS)  # a knot on a side of the net
    tips = np.abs(net.reference_position[:, 0]) > 3.0
    assert net.mass[tips] == pytest.approx([2**0.5 / 2 * STRING_MASS] * 4)


def test_explicit_net_keeps_the_listed_order(explicit, scene):
    nodes = [[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 0.0, 1.0], [3.0, 4.0, 1.0]]
    start = {
        "node_positions": [[1.0, 0.0, 0.0], [0.0, 3.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 5.0]],
        "node_velocities": [[3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 3.0, 0.0]],
        "velocity": [0.0, 0.0, 1.0],
    }
    listed = scene(
        explicit(nodes, [[0, 1], [3, 1]], start, divisions=3, node_masses=[0, 0, 2.5, 0], fixed=[1])
    )
    net = listed.net
    assert np.array_equal(net.reference_position[:4], nodes)
    assert net.reference_position[4:].tolist() == pytest.approx(
        np.array([[1, 0, 1], [2, 0, 1], [3, 8 / 3, 1], [3, 4 / 3, 1]])
    )
    assert net.element_nodes.tolist() == [[0, 4], [4, 5], [5, 1], [3, 6], [6, 7], [7, 1]]
    assert net.reference_length == pytest.approx([1.0] * 3 + [4 / 3] * 3)
    assert net.mass[2] == 2.5
    assert net.fixed_nodes.tolist() == [1]
    assert listed.x0[4] == pytest.approx([2 / 3, 1.0, 0.0])
    assert listed.v0[4] == pytest.approx([2.0, 0.0, 1.0])
    assert listed.v0[6] == pytest.approx([0.0, 2.0, 1.0])
    assert listed.v0[1].tolist() == [0.0, 0.0, 0.0]


def test_initial_state(document, scene):
    still = scene(
        document("hexagonal"),
        {"initial.velocity": [0.0, 0.0, 1.0], "initial.spin": [0.0, 0.0, 2.0], "launch.axial_speed": 0.5},
    )
    net = still.net
    assert np.array_equal(still.x0, 0.1 * net.reference_position)
    away = net.reference_position[net.bullet_nodes] / np.linalg.norm(
        net.reference_position[net.bullet_nodes], axis=1, keepdims=True
    )
    x, y, _ = still.x0.T
    expected = np.column_stack((-2 * y, 2 * x, np.ones_like(x)))
    expected[net.bullet_nodes] += 2.5 * away + [0, 0, 0.5]
    assert still.v0 == pytest.approx(expected, abs=1e-15)


def test_places_of_a_folded_net(document):
    """Of any order of nodes, if all are there, inside the canister, 0.9 to 1 of a length apart."""
    case = document("square", size=2.0)
    case["initial"] = {"fold": {"pattern": "accordion", "box": [4.0, 4.0, 0.01]}}
    read = read_document(case)
    flat = weave(read).reference_position
    turned = flat[::-1] * [-1.0, 1.0, 1.0]  # mirrored, as another program may number and fold it
    made = prepare(with_places(read, turned, 0.95 * turned))
    assert made.x0 == pytest.approx(0.95 * flat, abs=1e-14)
    wrong = {
        "none is given of the node": (flat + 1e-3, 0.95 * flat),
        "12 nodes are given": (flat[1:], 0.95 * flat[1:]),
        "not inside its canister": (flat, 0.95 * flat + 1.2),
        "not 0.9 to 1": (flat, 0.85 * flat),
        "finite": (flat, np.full_like(flat, np.nan)),
    }
    for named, (reference, place) in wrong.items():
        with pytest.raises(Refused, match=named):
            prepare(with_places(read, reference, place))
    with pytest.raises(Refused, match="must be given"):
        prepare(read)
    with pytest.raises(Refused, match="has no initial"):
        with_places(read_document(document("square")), flat, flat)


BORDER = {"diameter": 0.004, "density": 1390.0, "youngs_modulus": 70e9}


@pytest.fixture(scope="module")
def cut(document):
    """cut(outline, mesh_shape, size, mesh, **net): a case of a cut net, with strings and bullets."""

    def make(outline="square", mesh_shape="square", size=3.0, mesh=1.0, **net):
        case = document("square", outline=outline, mesh_shape=mesh_shape, border=BORDER, **net)
        case["net"].update(topology="cut", size=size, mesh=mesh)
        return case

    return make


@pytest.fixture(scope="module")
def bare(cut):
    """bare(...): the net of such a case without strings and bullets."""

    def make(*args, **net):
        case = cut(*args, **net)
        del case["net"]["strings"], case["net"]["bullets"], case["launch"]
        return weave(read_document(case))

    return make


def of_border(net):
    return net.area > math.pi / 4 * 0.003**2


def test_a_square_of_whole_meshes_is_the_square_net(bare, document):
    """Nothing to cut: the lines on the outline become the border; the rest is the topology `square`."""
    for n in (3, 4, 9):
        mine = bare("square", "square", 0.3 * n, 0.3)
        case = document("square", size=0.3 * n, mesh=0.3)
        del case["net"]["strings"], case["net"]["bullets"], case["launch"]
        other = weave(read_document(case))
        assert len(mine.element_nodes) == len(other.element_nodes) == 2 * n * (n + 1)
        places = [np.unique(np.round(net.reference_position, 9) + 0.0, axis=0) for net in (mine, other)]
        assert np.array_equal(*places)
        assert np.count_nonzero(of_border(mine)) == 4 * n
        assert mine.reference_length == pytest.approx(np.full(2 * n * (n + 1), 0.3), rel=1e-14)


def test_a_hexagon_of_whole_triangles_by_hand(bare):
    """Corners m meshes out: 3 m (m + 1) + 1 knots, 9 m^2 + 3 m sides of one length, 6 m of them border."""
    for m in (2, 3, 6):
        net = bare("hexagon", "triangle", math.sqrt(3.0) * m * 0.5, 0.5)
        assert len(net.mass) == 3 * m * (m + 1) + 1
        assert len(net.element_nodes) == 9 * m * m + 3 * m
        assert net.reference_length == pytest.approx(np.full(9 * m * m + 3 * m, 0.5), rel=1e-12)
        assert np.count_nonzero(of_border(net)) == 6 * m


def test_a_thread_of_the_border_beside_a_cut_line_by_hand(bare):
    """L = 3.4, squares of 1: n = 3, so lines at -1.5 ... 1.5, 0.2 from the outline, which they are moved to.

    16 knots: 4 inner, 8 on the sides at (+-0.5, +-1.7), 4 that come to the corners with no side left of
    them.  12 sides of the mesh: 4 of 1 m, 8 of 1.2 m.  12 of the border: 4 of 1 m, 8 of 1.2 m.
    """
    net = bare("square", "square", 3.4)
    assert len(net.mass) == 16
    for of in (of_border(net), ~of_border(net)):
        assert sorted(net.reference_length[of]) == pytest.approx([1.0] * 4 + [1.2] * 8, rel=1e-14)


def test_lines_that_are_cut_by_hand(bare):
    """L = 3.6: n = 4, lines at -2 ... 2; the outer ones, 0.2 outside, come to the outline at 1.8.

    L = 3.48: n = 3, lines at +-0.5, +-1.5, the outer ones 0.24 inside, within a quarter.  L = 3.502 keeps
    n = 4: lines at +-1 and 0, and +-2, 0.249 outside.
    """
    for size, inner in ((3.6, 9), (3.48, 4), (3.502, 9)):
        net = bare("square", "square", size)
        on_rim = np.unique(net.element_nodes[of_border(net)])
        assert len(net.mass) - len(on_rim) == inner
        assert np.abs(net.reference_position[on_rim]).max() == pytest.approx(size / 2, rel=1e-15)


def test_a_circle_by_hand(bare):
    """Diameter 3, squares of 1: n = 3, inner knots (+-0.5, +-0.5); (1.5, 0.5) is 0.081 outside.

    It moves along its radius.  (1.5, 1.5) has no inner neighbour.  With 4 corners, at 0, 90, ... degrees:
    0.3218 rad along the circle, 0.48 m, from them, so nothing is near one.
    """
    net = bare("circle", "square", corners=4)
    rim = 1.5 * np.array([1.5, 0.5]) / math.hypot(1.5, 0.5)
    assert len(net.mass) == 4 + 8 + 4
    chords = 2 * 1.5 * np.sin(0.5 * np.array([math.atan2(0.5, 1.5), math.pi / 2 - 2 * math.atan2(0.5, 1.5)]))
    expected = [chords[0]] * 8 + [chords[1]] * 4
    assert sorted(net.reference_length[of_border(net)]) == pytest.approx(sorted(expected), rel=1e-14)
    to_rim = math.dist(rim, (0.5, 0.5))
    assert sorted(net.reference_length[~of_border(net)]) == pytest.approx(sorted([1.0] * 4 + [to_rim] * 8))


def test_ends_near_a_corner_come_to_it(bare):
    """Diameter 3, squares of 1, corners every 40 degrees: the ends are at +-18.43, +-71.57 and beyond +-90.

    0.25 m are 9.56 degrees: those at +-71.57 and +-161.57 come to the corners at +-80 and +-160, 8.43 and
    1.57 away; those at +-18.43 and +-108.43 stay.
    """
    net = bare("circle", "square", corners=9)
    assert len(net.mass) == 4 + 9 + 4
    rim = np.unique(net.element_nodes[of_border(net)])
    angle = np.degrees(np.arctan2(*net.reference_position[rim].T[1::-1]))
    own = math.degrees(math.atan2(0.5, 1.5))
    expected = [*(40.0 * np.arange(-4, 5)), own, -own, 90.0 + own, -90.0 - own]
    assert np.sort(angle) == pytest.approx(np.sort(expected), abs=1e-12)
    assert np.count_nonzero(~of_border(net)) == 12

"""The net of reference_impl: counts, lengths, masses, mirrored coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import Refused, read_document, weave
from reference_impl.weave import direction

CABLE_MASS = 1390.0 * math.pi / 4 * 0.002**2  # [kg/m]
STRING_MASS = 4 * CABLE_MASS  # [kg/m], twice as thick


@pytest.fixture(scope="module")
def net(document):
    return lambda topology, **keys: weave(read_document(document(topology, **keys)))


def test_planar_net_of_the_paper(net):
    """Paper, 3.3: 40 nodes, 64 elements; issue: 2.360819 kg."""
    planar = net("square")
    assert (len(planar.mass), len(planar.element_nodes)) == (40, 64)
    assert planar.mass.sum() == pytest.approx(2.360819, abs=5e-7)
    assert np.allclose(
        planar.reference_position[planar.bullet_nodes],
        3.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
        atol=1e-15,
    )


def test_one_cell_weighed_by_hand(net):
    """Four sides of 1 m and 4.366814e-3 kg/m, four strings of sqrt(2) m and 4 times that."""
    cell = net("square", size=1.0)
    assert sorted(cell.mass) == pytest.approx([0.01671803] * 4 + [0.51235122] * 4, abs=1e-8)


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
    The cells are told by their middles, which have six knots at the distance of a side, 0.5 m.
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


def test_lengths_of_square_cells_are_exact(net):
    for mesh, size in ((1.0, 5.0), (0.1, 5.0), (0.3, 2.7)):
        lengths = net("square", mesh=mesh, size=size).reference_length[:-4]
        assert np.abs(lengths - mesh).max() <= 1e-14 * mesh


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


def test_node_without_mass_is_refused(explicit):
    with pytest.raises(Refused, match="node 2 has no mass"):
        weave(read_document(explicit([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], [[0, 1]])))


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


@pytest.mark.parametrize("n", [3, 4, 5, 8, 12, 36])
def test_directions(n):
    for k in range(n):
        c, s = direction(k, n)
        assert (c, s) == pytest.approx(
            (math.cos(2 * math.pi * k / n), math.sin(2 * math.pi * k / n)), abs=1e-15
        )
        assert direction(n - k, n) == (c, -s)

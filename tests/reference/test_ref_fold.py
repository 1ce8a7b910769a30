"""Folded starts in reference_impl: lengths, distances, canisters, counts of layers, bad input."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from reference_impl.pleats import ways
from reference_impl.spread import least_gap, spread
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from reference_impl import Refused, prepare, read_document, with_places

D = 0.004  # [m] of the strings, the thickest threads of the cases of `document`
SQUARE = {"size": 2.0, "mesh": 0.25}
CUT = {
    "topology": "cut",
    "outline": "square",
    "size": 2.0,
    "mesh_shape": "square",
    "mesh": 0.25,
    "border": {"diameter": 0.003, "density": 1390.0, "youngs_modulus": 70e9},
}


@pytest.fixture(scope="module")
def folded(document, scene):
    """folded(topology, pattern, **canister or net): the scene of a folded net."""

    def make(kind, pattern="accordion", box=None, cylinder=None, **net):
        case = document("square" if kind == "cut" else kind)
        case["net"].update(net)
        canister = {"box": box, "cylinder": cylinder}
        fold = {"pattern": pattern, **{k: v for k, v in canister.items() if v is not None}}
        return scene({**case, "initial": {"fold": fold}})

    return make


def chords(made, strings=False):
    of = made.net.of_string == strings
    i, j = made.net.element_nodes[of].T
    return np.linalg.norm(made.x0[j] - made.x0[i], axis=1) / made.net.reference_length[of]


def meshed(made):
    """Places of the net's nodes without those of strings, but for their feet."""
    return made.x0[np.unique(made.net.element_nodes[~made.net.of_string])]


FOLDS = {
    "square": ("square", {"box": [0.6, 0.6, 0.3], **SQUARE}),
    "square in a cylinder": ("square", {"cylinder": [0.45, 0.3], **SQUARE}),
    "square with an even count": ("square", {"box": [0.6, 0.52, 0.09], "size": 1.0, "mesh": 0.25}),
    "only along y": ("square", {"box": [2.1, 0.6, 0.3], **SQUARE}),
    "divided": ("square", {"box": [0.8, 1.1, 0.3], **SQUARE, "divisions": 2}),
    "rectangular": ("rectangular", {"box": [1.2, 0.6, 0.3]}),
    "hexagonal": ("hexagonal", {"box": [1.5, 1.5, 0.4]}),
    "cut": ("cut", {"box": [0.6, 0.6, 0.3], **CUT}),
    "cut triangles": (
        "cut",
        {"box": [2.1, 0.7, 0.3], **CUT, "mesh_shape": "triangle", "size": 0.25 * 48**0.5},
    ),
    "star of 16": ("radial", {"pattern": "star", "cylinder": [0.9, 0.5], "spokes": 16, "rings": 8}),
    "star of 8": ("radial", {"pattern": "star", "cylinder": [1.6, 0.6], "rings": 6, "divisions": 2}),
    "star of 6": ("radial", {"pattern": "star", "cylinder": [2.1, 2.1], "spokes": 6}),
    "star of 4": ("radial", {"pattern": "star", "box": [4.1, 4.1, 2.1], "spokes": 4}),
}


@pytest.mark.parametrize("name", FOLDS)
def test_what_the_page_says_of_every_fold(folded, name):
    """Chords of 90 to 100 %, nodes a thread apart, all inside the canister round the origin.

    The inner nodes of divided spokes come together at the hub, says the page.
    """
    topology, keys = FOLDS[name]
    made = folded(topology, **keys)
    found = chords(made)
    assert found.min() >= 0.9
    assert found.max() <= 1.0
    at = meshed(made)
    if not (topology == "radial" and "divisions" in keys):
        assert pdist(at).min() >= D * (1.0 - 1e-9)
    if "box" in keys:
        assert np.all(2.0 * np.abs(at).max(axis=0) + D <= np.array(keys["box"]) + 1e-12)
    else:
        radius, height = keys["cylinder"]
        assert np.hypot(at[:, 0], at[:, 1]).max() + D / 2 <= radius
        assert 2.0 * np.abs(at[:, 2]).max() + D <= height + 1e-12
    assert at[:, 2].min() == pytest.approx(-at[:, 2].max(), abs=1e-12)
    assert made.v0[0] == pytest.approx([0.0, 0.0, 0.0])  # not thrown


def test_a_bellows_by_hand(folded):
    """8 meshes of 0.25 m in a box of 0.6 m: 4 pleats of 2; an odd number is 5, of 1 + 2 + 2 + 2 + 1.

    Of a net 2 m long, 0.3 - 0.004 m high: sin(alpha) = 0.148, a layer 4 mm/0.148 beside the next (3e-5 of it
    more, for threads that slant).  Width and four of these fit into 0.596 m: that gives the factor.
    """
    made = folded("square", box=[0.6, 0.6, 0.3], **SQUARE)
    flat = made.net.reference_position[np.unique(made.net.element_nodes[~made.net.of_string])]
    u, v = np.rint(flat[:, :2].T / 0.25 + 4.0).astype(int)
    to_and_fro = np.array([0, 1, 0, -1, 0, 1, 0, -1, 0]) * 0.25
    layer = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])
    beside, level = D / 0.148, math.sqrt(1.0 - 0.148**2)
    factor = (0.596 - 4 * beside) / (0.5 * level)
    expected = np.column_stack(
        (
            factor * level * to_and_fro[u] - beside * (layer[v] - 2.0),
            factor * to_and_fro[v],
            factor * 0.148 * 0.25 * (u - 4.0),
        )
    )
    assert meshed(made) == pytest.approx(expected, abs=1e-5)


def test_a_row_across_a_crease_by_hand(folded):
    """Pleats along y alone.  Threads along y go down by D/2 towards a crease: so the factor."""
    made = folded("square", box=[2.1, 0.6, 0.3], **SQUARE)
    at, flat = (
        meshed(made),
        made.net.reference_position[np.unique(made.net.element_nodes[~made.net.of_string])],
    )
    middle = np.abs(flat[:, 1]) < 1e-9
    factor = math.sqrt(0.25**2 - (D / 2) ** 2) / 0.25
    assert at[middle, 2] == pytest.approx(np.zeros(9), abs=1e-12)
    assert np.ptp(at[:, 1]) == pytest.approx(0.5 * factor, rel=1e-8)
    assert np.sort(at[middle, 0]) == pytest.approx(factor * np.sort(flat[middle, 0]), rel=1e-8)
    assert np.unique(np.round((at[:, 2] - at[:, 2].min()) / D, 3)).tolist() == [
        0,
        0.5,
        1,
        1.5,
        2,
        2.5,
        3,
        3.5,
        4,
    ]


def test_a_star_is_an_isometry(folded):
    """All threads of a star keep their lengths; spokes 1, 3, ... are beside the axis, the layers D apart."""
    made = folded("radial", "star", cylinder=[0.9, 0.5], spokes=16, rings=8)
    assert chords(made) == pytest.approx(np.ones(8 * 16 * 2), abs=2e-9)
    flat, at = made.net.reference_position, made.x0
    radius, spoke = np.hypot(*flat.T[:2]), np.rint(np.arctan2(flat[:, 1], flat[:, 0]) * 8 / math.pi) % 2
    beside = (spoke == 1) & (radius < 2.1) & (radius > 0.1)
    layer = D / math.sin(math.pi / 8)  # threads of rings leave at 22.5 degrees, D apart
    away = np.hypot(at[beside, 0], at[beside, 1])
    assert away.min() == pytest.approx(
        layer, rel=1e-12
    )  # half a layer to a crease, and as much to the middle
    steps = away / layer * 2
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    assert steps.max() == pytest.approx(15)  # 8 rings of 0.25 m: the height holds pleats of one
    assert np.ptp(at[radius < 2.1, 2]) < 0.5


@pytest.mark.parametrize("name", FOLDS)
def test_threads_are_a_thickness_apart(folded, name):
    """100 points on each element: none nearer than that to an element that it does not share a node with."""
    topology, keys = FOLDS[name]
    made = folded(topology, **keys)
    ends, part = made.net.element_nodes[~made.net.of_string], np.linspace(0.0, 1.0, 100)[:, None]
    first, last = made.x0[ends[:, 0]][:, None], made.x0[ends[:, 1]][:, None]
    points = (first + part * (last - first)).reshape(-1, 3)
    near = cKDTree(points).query_pairs(D * (1.0 - 2e-6), output_type="ndarray") // 100
    assert len(near)
    assert np.all(np.any(ends[near[:, 0]][:, :, None] == ends[near[:, 1]][:, None, :], axis=(1, 2)))


def test_the_least_distance_of_elements():
    """Two that cross 3 mm apart, and a third that has a node with one of them; beyond 5 mm nothing counts."""
    place = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0.003], [0, 1, 0.003], [0, 2, 0.001]])
    ends = np.array([[0, 1], [2, 3], [1, 4]])
    assert least_gap(place, ends, 0.005) == pytest.approx(0.003, rel=1e-12)
    assert least_gap(place, ends, 0.002) == 0.002
    high = place * [1.0, 1.0, 2.0]
    found = spread(lambda layer: high * [1.0, 1.0, layer / 0.012], ends, 0.012)
    assert found[2, 2] == pytest.approx(0.012, rel=1e-4)


@pytest.mark.parametrize("divisions", [1, 4])
def test_strings_are_outside(folded, divisions):
    """One element: outward as in the flat net, 95 % of its length.  Divided: to and fro beside its corner."""
    strings = {
        "diameter": D,
        "density": 1390.0,
        "youngs_modulus": 70e9,
        "length": 1.2,
        "divisions": divisions,
    }
    made = folded("square", box=[0.6, 0.6, 0.3], **SQUARE, strings=strings)
    feet = made.net.element_nodes[made.net.of_string][::divisions, 0]
    tips = made.net.element_nodes[made.net.of_string][divisions - 1 :: divisions, 1]
    way = made.x0[tips] - made.x0[feet]
    if divisions == 1:
        corner = made.net.reference_position[feet]
        assert way == pytest.approx(
            0.95 * 1.2 * corner / np.linalg.norm(corner, axis=1, keepdims=True), abs=1e-14
        )
    else:
        assert np.linalg.norm(way, axis=1) == pytest.approx([divisions * D] * 4, rel=1e-12)
        assert chords(made, strings=True) == pytest.approx(np.full(16, 0.95), abs=1e-3)
        assert pdist(made.x0).min() >= D * (1.0 - 1e-9)


def test_bridles_hold_their_bullets(folded):
    made = folded("hexagonal", box=[1.5, 1.5, 0.4])
    assert chords(made, strings=True) == pytest.approx(np.full(12, 0.95), rel=1e-12)


def test_a_fold_is_carried_and_thrown(folded, scene, document):
    """velocity, spin and launch are those of a packed net; a body may carry the folded one."""
    case = document("square", **SQUARE)
    fold = {"pattern": "accordion", "box": [0.6, 0.6, 0.3]}
    one = scene({**case, "initial": {"fold": fold, "spin": [0.0, 0.0, 2.0]}})
    x, y, _ = one.x0.T
    still = np.setdiff1d(np.arange(len(x)), one.net.bullet_nodes)
    assert one.v0[still] == pytest.approx(np.column_stack((-2 * y, 2 * x, 0 * x))[still], abs=1e-14)
    body = {"mass": 50.0, "inertia": [5.0] * 3, "position": [1.0, 2.0, 3.0]}
    carried = copy.deepcopy(
        {**case, "initial": {"fold": fold, "frame": {"body": "b"}}, "bodies": {"b": body}}
    )
    assert scene(carried).x0 == pytest.approx(one.x0 + np.array([1.0, 2.0, 3.0]), abs=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["accordion", "star"])
def test_the_shipped_cases(scene, name):
    """What the cases say of themselves: 25 layers, of 2 mm, in 1.2 x 1.1 x 0.2 m; eight arms."""
    made = scene(f"nets/{name}.toml")
    at, found = meshed(made), chords(made)
    assert 0.9 <= found.min() <= found.max() <= 1.0
    if name == "accordion":
        assert np.ptp(at, axis=0) == pytest.approx([1.198, 0.995, 0.197], rel=2e-3)
    else:
        arms = np.unique(np.round(np.degrees(np.arctan2(at[:, 1], at[:, 0]))[np.hypot(*at.T[:2]) > 0.5], 6))
        assert arms.tolist() == [-135.0, -90.0, -45.0, 0.0, 45.0, 90.0, 135.0, 180.0]
        assert np.ptp(at[:, 2]) < 0.6
    run = made.integrate([0.0, 0.02])
    assert np.isfinite(run.x).all()


def test_creases_are_lines_that_nothing_crosses():
    """A triangular mesh has none along x: every line of knots is crossed by a side of the next row."""
    x = np.array([0.0, 1.0, 2.0, 3.0, 0.5, 1.5, 2.5, 3.5])
    ends = np.array(
        [
            [0, 1],
            [1, 2],
            [2, 3],
            [4, 5],
            [5, 6],
            [6, 7],
            [0, 4],
            [4, 1],
            [1, 5],
            [5, 2],
            [2, 6],
            [6, 3],
            [3, 7],
        ]
    )
    assert [w.count for w in ways(x, ends, 1.0, 10.0)] == [1]
    assert [w.count for w in ways(x, ends, 1.0, 2.0)] == []
    grid = np.arange(4.0)
    assert [w.count for w in ways(grid, np.array([[0, 1], [1, 2], [2, 3]]), 1.0, 1.5)] == [3]


@pytest.mark.parametrize(
    ("topology", "initial", "net", "fault"),
    [
        (
            "square",
            {"fold": {"pattern": "roll", "box": [1.0] * 3}},
            {},
            "initial.fold.pattern: must be one of",
        ),
        ("square", {"fold": {"pattern": "accordion"}}, {}, "initial.fold: give exactly one of"),
        (
            "square",
            {"fold": {"pattern": "accordion", "box": [1.0] * 3, "cylinder": [1.0] * 2}},
            {},
            "initial.fold: give exactly one of initial.fold.box and initial.fold.cylinder",
        ),
        (
            "square",
            {"fold": {"pattern": "accordion", "box": [1.0] * 2}},
            {},
            "initial.fold.box: must be a list",
        ),
        (
            "square",
            {"fold": {"pattern": "accordion", "box": [1.0, 0, 1.0]}},
            {},
            "initial.fold.box: must be gr",
        ),
        ("square", {"fold": 3}, {}, "initial.fold: must be a table"),
        ("square", {}, {}, "initial.packing: missing"),
        (
            "square",
            {"packing": 0.1, "fold": {"pattern": "accordion", "box": [1.0] * 3}},
            {},
            "initial: give exactly one of initial.packing and initial.fold",
        ),
        (
            "square",
            {"fold": {"pattern": "accordion", "box": [1.0] * 3, "layers": 3}},
            {},
            "reference_impl does not know initial.fold.layers",
        ),
        ("square", {"fold": {"pattern": "star", "box": [1.0] * 3}}, {}, "initial.fold.pattern: a star is of"),
        (
            "radial",
            {"fold": {"pattern": "accordion", "box": [1.0] * 3}},
            {},
            "initial.fold.pattern: an accordion",
        ),
        (
            "radial",
            {"fold": {"pattern": "star", "box": [1.0] * 3}},
            {"spokes": 7},
            "initial.fold.pattern: a star needs an even number of spokes, at least 4, not 7",
        ),
    ],
)
def test_bad_folds_are_refused(document, topology, initial, net, fault):
    with pytest.raises(Refused) as refused:
        read_document({**document(topology, **net), "initial": initial})
    assert any(line.startswith(fault) for line in refused.value.faults), refused.value.faults


@pytest.mark.parametrize(
    ("topology", "pattern", "keys", "words"),
    [
        ("square", "accordion", {"box": [0.6, 0.6, 0.01], **SQUARE}, "a box of 0.5"),
        ("square", "accordion", {"box": [0.2, 0.2, 1.0], **SQUARE}, "no creases were found"),
        ("radial", "star", {"cylinder": [0.9, 0.3]}, "(star): a box of"),
    ],
)
def test_what_does_not_fit_is_refused(folded, topology, pattern, keys, words):
    with pytest.raises(Refused, match=r"initial.fold: the net does not fit into its canister") as refused:
        folded(topology, pattern, **keys)
    assert words in refused.value.faults[0]


def test_another_fold_by_the_rules_stands_in(folded):
    """The mirror image of a fold is one; nodes are told in another order."""
    made = folded("square", box=[0.6, 0.6, 0.3], **SQUARE)
    flat, place = made.net.reference_position, made.x0 * [-1.0, 1.0, 1.0]
    given = prepare(with_places(made.case, flat[::-1], place[::-1]))
    assert np.array_equal(given.x0, place)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda flat, place: (flat[1:], place[1:]), "nodes are given, the net has"),
        (lambda flat, place: (flat + 0.1, place), "none is given of the node at"),
        (
            lambda flat, place: (flat[np.maximum(np.arange(len(flat)), 1)], place),
            "none is given of the node at",
        ),
        (lambda flat, place: (flat, place[:-1]), "a place .n, 3. of each node"),
        (lambda flat, place: (flat, 0.8 * place), "of its length, not 0.9 to 1"),
        (lambda flat, place: (flat, place + np.array([0.0, 0.0, 0.2])), "not inside its canister"),
        (lambda flat, place: (flat, place * np.nan), "finite numbers"),
    ],
)
def test_places_that_are_no_fold_are_refused(folded, change, words):
    made = folded("square", box=[0.6, 0.6, 0.3], **SQUARE)
    with pytest.raises(Refused, match=f"^places: .*{words}"):
        prepare(with_places(made.case, *change(made.net.reference_position, made.x0)))


def test_places_need_a_fold(document, scene):
    flat = scene(document("square"))
    with pytest.raises(Refused, match="the case has no"):
        with_places(flat.case, flat.net.reference_position, flat.x0)

"""From a topology's mesh to a net: validity, openings, strings, bullets, divided cables, masses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy

from exunet.base.errors import CaseError, Fault
from exunet.net.arrays import Floats, Ints, Mesh, Net
from exunet.net.base import Bullets, Cable, NetConfig, Strings, ThrownNetConfig, laws_of


def openings(knots: Floats, sides: Ints) -> tuple[Ints, ...]:
    """Loops round the openings, anticlockwise: one (n, corners) array for each number of corners.

    knots : (n_knots, 2) in a plane [m]; sides : (n_sides, 2), which meet at knots only; all are connected
    """
    return _by_length(_loops(knots, sides), knots)


def planar_openings(knots: Floats, sides: Ints) -> tuple[Ints, ...]:
    """Loops round the meshes of a planar net as seen from +z, as of `openings`; () of other nets.

    A net is planar if its knots (n_knots, 3) [m] lie in a plane that is not vertical, its sides are connected
    and meet at knots only. Loops begin at their least knot, and are in the order of these.
    """
    used = np.unique(sides)
    if not len(used):
        return ()
    flat = knots[used] - knots[used].mean(axis=0)
    size = float(np.ptp(flat, axis=0).max())
    normal = np.linalg.svd(flat, full_matrices=True)[2][2]
    edges = scipy.sparse.coo_array((np.ones(len(sides)), tuple(sides.T)), shape=(len(knots), len(knots)))
    parts = scipy.sparse.csgraph.connected_components(edges, directed=False)[1][used]
    if np.abs(flat @ normal).max() > _FLAT * size or abs(normal[2]) < _FLAT or np.ptp(parts):
        return ()
    pieces = knots[sides]
    for a, b in _neighbours(pieces, _FLAT * size):
        apart = (sides[a][:, :, None] != sides[b][:, None, :]).all(axis=(1, 2))
        if (between_segments(pieces[a[apart]], pieces[b[apart]]) <= _FLAT * size).any():
            return ()
    found = _by_length(_loops(knots[:, :2], sides), knots)
    turned = [
        np.take_along_axis(loops, (loops.argmin(1)[:, None] + np.arange(n := loops.shape[1])) % n, axis=1)
        for loops in found
    ]
    return tuple(loops[np.lexsort(loops.T[::-1])] for loops in turned)


def _loops(knots: Floats, sides: Ints) -> list[list[int]]:
    """Loops of knots with an opening, or all that is outside, to the left."""
    ends = np.concatenate([sides, sides[:, ::-1]])  # each side, one way and the other
    way = knots[ends[:, 1]] - knots[ends[:, 0]]
    order = np.lexsort((np.arctan2(way[:, 1], way[:, 0]), ends[:, 0]))  # round each knot, anticlockwise
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    starts = np.searchsorted(ends[order, 0], np.arange(len(knots) + 1))
    back = np.roll(np.arange(len(ends)), len(sides))  # the same side, the other way
    # With the opening to the left, go on along the side that is next clockwise from the one that led here.
    at = place[back]
    here = ends[:, 1]
    onward = order[np.where(at == starts[here], starts[here + 1], at) - 1]
    return _cycles(onward.tolist(), ends[:, 0].tolist())


def _cycles(onward: list[int], knot: list[int]) -> list[list[int]]:
    """Each cycle of a permutation, from its least item on, as the knots of its items."""
    seen = bytearray(len(onward))
    found = []
    for first in range(len(onward)):
        loop = []
        item = first
        while not seen[item]:
            seen[item] = 1
            loop.append(knot[item])
            item = onward[item]
        if loop:
            found.append(loop)
    return found


def _by_length(loops: list[list[int]], knots: Floats) -> tuple[Ints, ...]:
    """Loops grouped by their number of knots, without the one that goes round the whole net, clockwise."""
    groups: dict[int, list[list[int]]] = {}
    for loop in loops:
        groups.setdefault(len(loop), []).append(loop)
    found = []
    for _, group in sorted(groups.items()):
        nodes: Ints = np.array(group, dtype=np.int64)
        x, y = knots[nodes, 0], knots[nodes, 1]
        doubled = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)
        if (doubled > 0.0).any():
            found.append(nodes[doubled > 0.0])
    return tuple(found)


_FLAT = 1e-9  # of the size of a net: what is nearer to a plane, or to a side, than this lies in it
_GUIDE = "see docs/how_to/extending.md, A topology"


def refuse_unsound(mesh: Mesh, topology: str) -> None:
    """Raise ValueError, for who writes a topology, if its faces or its mouth are not what `Mesh` says.

    Measures of deployment, contact and closing would take them as they are, and be wrong.
    """
    where = f"the mesh of the topology {topology!r}"
    corners = np.unique(mesh.anchors)
    if len(mesh.mouth) and not np.array_equal(np.sort(mesh.mouth), corners):
        words = f"its mouth has the knots {_few(mesh.mouth)}, its corners (anchors) are {_few(corners)}"
        raise ValueError(f"{where}: {words}: the mouth is the ring of corners, each once; {_GUIDE}")
    if len(mesh.mouth) and (_turning(mesh.knots, mesh.mouth[None]) < 0.0).any():
        raise ValueError(f"{where}: its mouth is not anticlockwise as seen from +z; {_GUIDE}")
    joined = np.sort(_names(np.sort(mesh.sides, axis=1), len(mesh.knots)))
    for loops in mesh.faces:
        pairs = np.stack([loops, np.roll(loops, -1, axis=1)], axis=-1)
        names = _names(np.sort(pairs.reshape(-1, 2), axis=1), len(mesh.knots))
        if (wrong := joined[np.searchsorted(joined[:-1], names)] != names).any():
            pair = pairs.reshape(-1, 2)[int(np.argmax(wrong))].tolist()
            raise ValueError(f"{where}: a face goes from knot {pair[0]} to {pair[1]}: no side; {_GUIDE}")
        if (turns := _turning(mesh.knots, loops) < 0.0).any():
            face = _few(loops[int(np.argmax(turns))])
            raise ValueError(f"{where}: the face {face} is not anticlockwise as seen from +z; {_GUIDE}")


def _names(pairs: Ints, n_knots: int) -> Ints:
    """(n,) a number for each pair of knots (n, 2)."""
    return np.asarray(pairs[:, 0] * n_knots + pairs[:, 1])


def _turning(knots: Floats, loops: Ints) -> Floats:
    """(n_loops,) twice the area of loops of knots (n_loops, k) as seen from +z, below 0 if clockwise."""
    with np.errstate(over="ignore", invalid="ignore"):  # a net beyond floats is refused elsewhere
        x, y = np.moveaxis(knots[loops][..., :2] - knots[loops[:, :1]][..., :2], -1, 0)
        return np.asarray((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))


def _few(knots: Ints) -> str:
    shown = ", ".join(map(str, knots[:8].tolist()))
    return f"[{shown}{', ...' if len(knots) > 8 else ''}]"


_ROWS = 2048  # elements whose neighbours are looked for in one go


class NearestElements(NamedTuple):
    """Two elements that share no node, and how near they come to each other.

    elements : (2,)
    distance : of their middles [m]
    place    : (3,) half way between the two points that are so near [m]
    """

    elements: Ints
    distance: float
    place: Floats


def between_segments(one: Floats, other: Floats) -> Floats:
    """(n,) least distances of straight pieces (n, 2, 3) [m].

    Ericson, Real-Time Collision Detection (2005), section 5.1.9; here the least of the nearest point of two
    lines and of each end from the other piece.
    """
    return np.asarray(np.linalg.norm(_closest(one, other)[0], axis=1))


def nearest(net: Net, position: Floats, within: float, *, strings: bool = True) -> NearestElements | None:
    """Return the two nearest elements of all pairs that share no node.

    position : (n_nodes, 3) [m]
    within   : [m]; None if none are nearer
    strings  : whether elements of strings count
    """
    counted, found = np.flatnonzero(strings | ~net.is_string), None
    ends = net.element_nodes[counted]
    for a, b in _neighbours(position[ends], within):
        apart = (ends[a][:, :, None] != ends[b][:, None, :]).all(axis=(1, 2))
        a, b = a[apart], b[apart]
        pieces = position[ends[a]], position[ends[b]]
        distance = between_segments(*pieces)
        if not len(distance) or not distance.min() < within:
            continue
        k = int(distance.argmin())
        way, on_one = (part[0] for part in _closest(pieces[0][[k]], pieces[1][[k]]))
        within = float(distance[k])
        found = NearestElements(counted[[a[k], b[k]]], within, on_one - 0.5 * way)
    return found


def _closest(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """(n, 3) each: from the nearest point of the other piece to that of the one, and the latter [m]."""
    d, e, r = one[:, 1] - one[:, 0], other[:, 1] - other[:, 0], one[:, 0] - other[:, 0]
    dd, ee, de, dr, er = (np.einsum("na,na->n", p, q) for p, q in ((d, d), (e, e), (d, e), (d, r), (e, r)))
    across = dd * ee - de**2
    level = across <= 1e-14 * dd * ee
    s = np.clip(np.divide(de * er - dr * ee, across, out=np.zeros_like(dd), where=~level), 0.0, 1.0)
    t = (de * s + er) / ee
    s = np.where(t < 0.0, -dr / dd, np.where(t > 1.0, (de - dr) / dd, s))
    s, t = np.clip(s, 0.0, 1.0), np.clip(t, 0.0, 1.0)
    return r + s[:, None] * d - t[:, None] * e, one[:, 0] + s[:, None] * d


def _neighbours(pieces: Floats, near: float) -> Iterator[tuple[Ints, Ints]]:
    """Pairs of pieces (n, 2, 3) whose boxes are nearer than `near` [m]."""
    low, high = pieces.min(axis=1) - 0.5 * near, pieces.max(axis=1) + 0.5 * near
    size = (high - low).max(axis=0)
    # Boxes that meet have middles within 1 of each other along each axis.
    middle = 0.5 * (low + high) / size
    tree = scipy.spatial.cKDTree(middle)
    for start in range(0, len(pieces), _ROWS):
        around = tree.query_ball_point(middle[start : start + _ROWS], 1.0 + 1e-9, p=np.inf)
        a = np.repeat(np.arange(start, start + len(around)), [len(item) for item in around])
        b = np.concatenate([np.array(entry, dtype=np.int64) for entry in around])
        kept = a < b
        a, b = a[kept], b[kept]
        boxes = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        yield a[boxes], b[boxes]


@dataclass(frozen=True)
class _Cables:
    """Sides or strings of one kind, divided into elements.

    chains : (n_cables, divisions + 1) the nodes along each cable
    length : (n_cables,) reference length of each element [m]
    key    : of made_of in [net]
    """

    chains: Ints
    length: Floats
    made_of: Cable
    key: str

    @property
    def is_string(self) -> bool:
        return self.key == "strings"

    @property
    def element_nodes(self) -> Ints:
        return np.stack([self.chains[:, :-1], self.chains[:, 1:]], axis=-1).reshape(-1, 2)

    @property
    def divisions(self) -> int:
        return self.chains.shape[1] - 1


def net_of(mesh: Mesh, keys: NetConfig) -> Net:
    """The net that `keys` asks for on the topology's `mesh`.

    Raises CaseError if a node's mass or position is beyond what floating-point numbers can hold, and
    ValueError if the topology is at fault (`refuse_unsound`).
    """
    refuse_unsound(mesh, keys.topology)
    strings, bullets = _thrown(keys)
    string_ends, end_position = _string_ends(mesh, strings)
    shift = 0 if mesh.knots_first else len(end_position)  # else bullets come first
    ends = np.concatenate([mesh.knots, end_position] if mesh.knots_first else [end_position, mesh.knots])

    sides = mesh.sides + shift
    span = ends[sides[:, 1]] - ends[sides[:, 0]]
    with np.errstate(over="ignore"):
        side_length = np.linalg.norm(span, axis=1)
    side_chains = _chains(sides, keys.divisions, len(ends))
    cables, order = _of_sides(side_chains, side_length / keys.divisions, mesh, keys)
    inner = [between(ends, sides, keys.divisions)]
    if strings:
        string_length = np.full(len(string_ends), strings.length / strings.divisions)
        chains = _chains(string_ends, strings.divisions, len(ends) + len(inner[0]))
        cables.append(_Cables(chains, string_length, strings, "strings"))
        inner.append(between(ends, string_ends, strings.divisions))

    position = np.concatenate([ends, *inner])
    bullet_nodes = _bullet_nodes(mesh, strings, bullets)
    mass = _lumped_mass(cables, len(position))
    if bullets:
        mass[bullet_nodes] += bullets.mass
    if mesh.node_mass is not None:
        mass[shift : shift + len(mesh.knots)] += mesh.node_mass
    _refuse_overflow(mass, position)
    return _net(
        cables,
        order=order,
        reference_position=position,
        mass=mass,
        bullet_nodes=bullet_nodes,
        fixed_nodes=np.unique(mesh.fixed) + shift,
        faces=_loops_through(side_chains, [loops + shift for loops in mesh.faces]),
        mouth=tuple((mesh.mouth + shift).tolist()),
        knots=np.arange(shift, shift + len(mesh.knots)),
    )


def _of_sides(chains: Ints, length: Floats, mesh: Mesh, keys: NetConfig) -> tuple[list[_Cables], Ints | None]:
    """The cables of the mesh, in groups of one cable: threads or, if the topology has one, the border.

    And the place of each side in the order of the groups; None: they are in order.
    """
    if mesh.threads is not None:
        made_of: Sequence[Cable] = getattr(keys, "thread_cables")()  # noqa: B009 - of the topology that has them
        groups = [(cable, np.flatnonzero(mesh.threads == k)) for k, cable in enumerate(made_of)]
        names = ["cable", *(f"threads.{name}" for name in getattr(keys, "threads"))]  # noqa: B009 - likewise
        cables = [
            _Cables(chains[own], length[own], cable, name)
            for name, (cable, own) in zip(names, groups, strict=True)
        ]
        return cables, np.argsort(np.concatenate([own for _, own in groups]))
    if not mesh.n_border:
        return [_Cables(chains, length, keys.cable, "cable")], None
    inside = len(chains) - mesh.n_border
    border: Cable = getattr(keys, "border")  # noqa: B009 - of the topologies that have one
    inner = _Cables(chains[:inside], length[:inside], keys.cable, "cable")
    return [inner, _Cables(chains[inside:], length[inside:], border, "border")], None


def between(values: Floats, ends: Ints, divisions: int) -> Floats:
    """Values at the inner nodes of divided cables, evenly spaced between the values at their ends.

    values : (n_nodes, k); ends : (n_cables, 2) -> (n_cables * (divisions - 1), k), cable by cable
    """
    fraction = np.arange(1, divisions)[:, None] / divisions
    first, last = values[ends[:, 0], None], values[ends[:, 1], None]
    return (first * (1 - fraction) + last * fraction).reshape(-1, values.shape[1])


def _thrown(keys: NetConfig) -> tuple[Strings | None, Bullets | None]:
    return (keys.strings, keys.bullets) if isinstance(keys, ThrownNetConfig) else (None, None)


def _string_ends(mesh: Mesh, strings: Strings | None) -> tuple[Ints, Floats]:
    """Node pairs (bullet, corner) of the strings, and the bullets' positions (n_bullets, 3) [m].

    A bullet lies on the ray from the origin through the mean of its corner knots, at the strings' length from
    each: for one knot, length x unit vector beyond it; for a bridle, at the apex of the triangle.
    """
    if strings is None:
        return np.empty((0, 2), dtype=np.int64), np.empty((0, 3))
    n_bullets, n_strings = mesh.anchors.shape
    corners = mesh.knots[mesh.anchors]
    middle = corners.mean(axis=1)
    half_span = np.linalg.norm(corners[:, 0] - middle, axis=1)
    distance = np.linalg.norm(middle, axis=1)
    height = np.sqrt((strings.length - half_span) * (strings.length + half_span))
    position = middle * (1 + height / distance)[:, None]
    bullets = np.repeat(np.arange(n_bullets), n_strings)
    first, shift = (len(mesh.knots), 0) if mesh.knots_first else (0, n_bullets)
    return np.stack([bullets + first, mesh.anchors.ravel() + shift], axis=1), position


def _bullet_nodes(mesh: Mesh, strings: Strings | None, bullets: Bullets | None) -> Ints:
    if bullets is None:
        return np.empty(0, dtype=np.int64)
    first = len(mesh.knots) if mesh.knots_first else 0
    return first + np.arange(len(mesh.anchors)) if strings else mesh.anchors[:, 0].copy()


def _chains(ends: Ints, divisions: int, first_inner: int) -> Ints:
    """(n_cables, divisions + 1) nodes along each cable; inner nodes are numbered from `first_inner` on."""
    inner = first_inner + np.arange(len(ends) * (divisions - 1)).reshape(len(ends), divisions - 1)
    return np.concatenate([ends[:, :1], inner, ends[:, 1:]], axis=1)


def _lumped_mass(cables: Iterable[_Cables], n_nodes: int) -> Floats:
    """(n_nodes,) half the mass of every element that ends in a node, eq. (9) [kg]."""
    mass = np.zeros(n_nodes)
    for kind in cables:
        half = (
            0.5 * kind.made_of.density * kind.made_of.cross_section * np.repeat(kind.length, kind.divisions)
        )
        for end in kind.element_nodes.T:
            mass += np.bincount(end, weights=half, minlength=n_nodes)
    return mass


def _loops_through(chains: Ints, faces: Iterable[Ints]) -> tuple[tuple[int, ...], ...]:
    """Loops of knots turned into loops of all nodes: the inner nodes of each side follow its first knot."""
    n_nodes = int(chains.max(initial=0)) + 1
    forward = chains[:, 0] * n_nodes + chains[:, -1]
    backward = chains[:, -1] * n_nodes + chains[:, 0]
    names = np.concatenate([forward, backward])
    # Without the last knot of each side, which opens the next one.
    steps = np.concatenate([chains[:, :-1], chains[:, :0:-1]])
    order = np.argsort(names)
    loops: list[tuple[int, ...]] = []
    for face in faces:
        wanted = face * n_nodes + np.roll(face, -1, axis=1)
        side = order[np.searchsorted(names, wanted, sorter=order)]
        loops.extend(map(tuple, steps[side].reshape(len(face), face.shape[1] * steps.shape[1]).tolist()))
    return tuple(loops)


def _refuse_overflow(mass: Floats, position: Floats) -> None:
    bad = ~((mass > 0) & np.isfinite(mass) & np.isfinite(position).all(axis=1))
    if bad.any():
        node = int(np.argmax(bad))
        reason = (
            f"node {node} has a mass of {mass[node]:g} kg at {position[node].tolist()} m; a node needs both"
        )
        reason += " a mass above 0 and a finite position"
        raise CaseError([Fault("net", reason, beyond_floats=True)])


def _net(
    cables: list[_Cables],
    order: Ints | None,
    faces: tuple[tuple[int, ...], ...],
    mouth: tuple[int, ...],
    **of_nodes: np.ndarray,
) -> Net:
    """Put the elements of all cables one after another, or in the order of their sides; lock the arrays."""
    counts = [kind.chains.shape[0] * kind.divisions for kind in cables]

    def spread(values: list[float]) -> Floats:
        return np.repeat(np.array(values, dtype=float), counts)

    arrays: dict[str, Any] = {
        "element_nodes": np.concatenate([kind.element_nodes for kind in cables]),
        "reference_length": np.concatenate([np.repeat(kind.length, kind.divisions) for kind in cables]),
        "area": spread([kind.made_of.cross_section for kind in cables]),
        "youngs_modulus": spread([kind.made_of.modulus for kind in cables]),
        "density": spread([kind.made_of.density for kind in cables]),
        "is_string": np.repeat([kind.is_string for kind in cables], counts),
    }
    if any(kind.made_of.allowable for kind in cables):
        arrays["strength"] = spread([kind.made_of.allowable or 0.0 for kind in cables])
    numbers, table = laws_of(kind.made_of for kind in cables)
    if any(numbers):
        arrays["law_number"] = np.repeat(numbers, counts)
    if order is not None:
        each = cables[0].divisions
        own = (order[:, None] * each + np.arange(each)).ravel()
        arrays = {k: np.concatenate([array[own], array[len(own) :]]) for k, array in arrays.items()}
    arrays |= of_nodes
    if any(numbers):
        arrays["law_table"] = table
    for array in arrays.values():
        array.flags.writeable = False
    keys = {k: f"net.{kind.key}.table" for k, kind in zip(numbers, cables, strict=True) if k > 1}
    return Net(**arrays, faces=faces, mouth=mouth, table_keys=keys)

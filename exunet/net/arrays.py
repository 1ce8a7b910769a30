"""The two values of this package: a topology's `Mesh` and the finished `Net`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr
from exunet.base.arrays import Floats, Ints

NET, TETHER = "net", "tether "  # groups of elements: of the net itself, and, before its name, of a tether


NODE_NAME = re.compile(r"(?:centre|corner (\d{1,9})|rim (0(?:\.\d*)?|\.\d+))")
NO_TABLE = np.zeros((0, 4))
_NEAR = 1e-9  # of the size of a net: knots whose distances differ by less are equally near


def _no_indexes() -> Ints:
    return np.empty(0, dtype=np.int64)


def _no_anchors() -> Ints:
    return np.empty((0, 1), dtype=np.int64)


@dataclass(frozen=True)
class Mesh:
    """Knots and sides that a topology fills in, before strings, bullets and division of the sides.

    knots      : (n_knots, 3) reference positions [m]
    sides      : (n_sides, 2) knots at the ends of each cable side
    anchors    : (n_corners, n_strings) for each bullet the knots that its strings hold: one knot for a plain
                 corner, several for a bridle; no rows when the topology has no corners
    faces      : mesh openings as loops of knots, anticlockwise seen from +z: one (n_faces, n_corners) array
                 for each number of corners
    mouth      : loop of corner knots that spans the net's opening, anticlockwise; empty without a mouth
    node_mass  : (n_knots,) mass added to the knots [kg]; None: nothing
    fixed      : knots that are held still
    n_border   : how many of the sides, the last ones, are of the border thread that the topology has
    threads    : (n_sides,) which cable each side has, of those of the topology; None: all have the first
    knots_first : whether bullets on strings are numbered after the knots
    """

    knots: Floats
    sides: Ints
    anchors: Ints = field(default_factory=_no_anchors)
    faces: tuple[Ints, ...] = ()
    mouth: Ints = field(default_factory=_no_indexes)
    node_mass: Floats | None = None
    fixed: Ints = field(default_factory=_no_indexes)
    n_border: int = 0
    threads: Ints | None = None
    knots_first: bool = False


@dataclass(frozen=True)
class TetherNodes:
    """A cable beside the net.

    first : its own nodes are numbered from here on; an end may be a node of the net
    nodes : along it
    """

    name: str
    first: int
    nodes: tuple[int, ...]


@dataclass(frozen=True, repr=False)
class Net(ShortRepr):
    """A cable net in its reference configuration, ready for either engine. The arrays are read-only.

    Nodes come in the order bullets (or free string ends), knots, inner nodes of divided sides, inner nodes
    of divided strings; without strings a bullet is its corner knot. In explicit nets bullets follow the
    knots. Elements of the sides come before those
    of the strings, those of a border last among them; the elements of one side or string follow each other.

    reference_position : (n_nodes, 3) [m], undeformed
    mass               : (n_nodes,) lumped mass [kg], eq. (9) plus bullets
    element_nodes      : (n_elements, 2)
    reference_length   : (n_elements,) L [m]
    area               : (n_elements,) A [m2], reference
    youngs_modulus     : (n_elements,) E [Pa]
    density            : (n_elements,) rho [kg/m3], reference
    is_string          : (n_elements,) True for the elements of the strings
    bullet_nodes       : (n_bullets,)
    fixed_nodes        : (n_fixed,) nodes that are held still, increasing
    faces              : loops of nodes round each mesh opening (inner nodes of sides included), anticlockwise
                         seen from +z
    mouth              : loop of corner nodes, anticlockwise; empty if the topology has none
    rim                : loop of all nodes along the edge of the meshes from corner to corner of the mouth,
                         inner nodes of sides too; the corners alone where no edge goes through them all
    tethers            : cables beside the net: their own nodes and elements are the last ones
    strength           : (n_elements,) axial force that each element is said to bear (its strength x
                         knot_efficiency / safety_factor), or at which it breaks [N]; 0: not known. None: of
                         no element
    law_number         : (n_elements,) number of each element's law, see `exunet.forces.law`; None: 0
    law_table          : (n_rows, 4) rows of the tables of laws
    table_keys         : key of a case of each table, by its law's number; empty in a stored net
    knots              : (n_knots,) nodes at the ends of mesh sides, which names refer to: divisions do not
                         move them
    """

    reference_position: Floats
    mass: Floats
    element_nodes: Ints
    reference_length: Floats
    area: Floats
    youngs_modulus: Floats
    density: Floats
    is_string: NDArray[np.bool_]
    bullet_nodes: Ints
    fixed_nodes: Ints
    faces: tuple[tuple[int, ...], ...] = ()
    mouth: tuple[int, ...] = ()
    tethers: tuple[TetherNodes, ...] = ()
    strength: Floats | None = None
    knots: Ints = field(default_factory=_no_indexes)
    law_number: Ints | None = None
    law_table: Floats = field(default_factory=lambda: NO_TABLE)
    table_keys: Mapping[int, str] = field(default_factory=dict, compare=False)

    def node(self, given: int | str) -> int:
        """Return the number of a node of the net itself.

        Parameters
        ----------
        given : int or str
            The number; or, of a net with a mouth, "centre": the knot nearest to the centre (of equally near
            knots that with the smallest y, then x); "corner 2": a corner of the mouth; "rim 0.25": the knot
            of the rim nearest to this part of the perimeter from corner 0 on, anticlockwise. All refer to
            the reference configuration.

        Raises
        ------
        ValueError
            If the net does not have this node.
        """
        if not isinstance(given, str):
            if 0 <= given < self.n_net_nodes:
                return int(given)
            raise ValueError(f"there is no node {given}: {self._nodes_there}")
        match = NODE_NAME.fullmatch(given)
        corner = 0 if match is None or match[1] is None else int(match[1])
        if match is None or not self.node_names or corner >= len(self.mouth):
            raise ValueError(f'there is no node "{given}": {self._nodes_there}')
        if match[1] is not None:
            return self.mouth[corner]
        if match[2] is not None:
            nodes, parts, _ = self._rim_knots
            distance = np.abs(parts - float(match[2]))
            distance = np.minimum(distance, 1.0 - distance)
            return int(nodes[np.argmax(distance <= distance.min() + _NEAR)])
        place = self.reference_position[self.knots]
        distance = np.linalg.norm(place, axis=1)
        near = np.flatnonzero(distance <= distance.min() + _NEAR * self.size)
        x, y = np.round(place[near, :2].T / (_NEAR * self.size))
        return int(self.knots[near[np.lexsort((x, y))[0]]])

    def distance_from_name(self, name: str) -> float:
        """Return how far a named node is from what its name means [m], on the rim along it."""
        node, part = self.node(name), name.removeprefix("rim ")
        if name == "centre":
            return float(np.linalg.norm(self.reference_position[node]))
        if part == name:
            return 0.0
        nodes, parts, perimeter = self._rim_knots
        distance = abs(float(parts[nodes == node][0]) - float(part))
        return min(distance, 1.0 - distance) * perimeter

    def bullet(self, number: int) -> int:
        """Return the node of a bullet; raise ValueError if the net does not have it."""
        if 0 <= number < len(self.bullet_nodes):
            return int(self.bullet_nodes[number])
        raise ValueError(f"there is no bullet {number}: the net has {len(self.bullet_nodes)}, from 0 on")

    def name_of(self, node: int) -> str | None:
        """Return a name of a node of the net, if it has one."""
        if not self.node_names or node not in self.knots:
            return None
        if node in self.mouth:
            return f"corner {self.mouth.index(node)}"
        nodes, parts, _ = self._rim_knots
        on_rim = np.flatnonzero(nodes == node)
        name = f"rim {parts[on_rim[0]]:.4f}".rstrip("0") if len(on_rim) else "centre"
        return name if self.node(name) == node else None

    @property
    def node_names(self) -> str:
        """List the names of nodes; "" of a net without a mouth, which does not have them."""
        if not self.mouth or not len(self.knots):
            return ""
        return f'"centre", "corner 0" to "corner {len(self.mouth) - 1}", "rim 0" to below "rim 1"'

    @property
    def _nodes_there(self) -> str:
        return f"the net has nodes 0 to {self.n_net_nodes - 1}, {self.node_names or 'without names'}"

    @cached_property
    def _rim_knots(self) -> tuple[Ints, Floats, float]:
        """Knots of the rim, the part of the perimeter from corner 0 to each, and the perimeter [m]."""
        rim = np.array(self.rim, dtype=np.int64)
        place = self.reference_position[np.append(rim, rim[0])]
        way = np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))
        parts, own = np.append(0.0, way[:-1]) / way[-1], np.isin(rim, self.knots)
        return rim[own], parts[own], float(way[-1])

    @cached_property
    def rim(self) -> tuple[int, ...]:
        found = edge_of(self.faces, self.mouth[0]) if self.mouth else ()
        return found if set(self.mouth).issubset(found) else self.mouth

    @property
    def n_nodes(self) -> int:
        return len(self.mass)

    @property
    def n_elements(self) -> int:
        return len(self.reference_length)

    @property
    def n_net_nodes(self) -> int:
        """Nodes of the net itself: those before the tethers' own."""
        return self.tethers[0].first if self.tethers else self.n_nodes

    @property
    def n_net_elements(self) -> int:
        """Elements of the net itself, strings included: those before the tethers'."""
        return self.n_elements - sum(len(tether.nodes) - 1 for tether in self.tethers)

    @property
    def alone(self) -> Net:
        """The same without tethers; masses stay what they are with them."""
        if not self.tethers:
            return self
        nodes, elements = self.n_net_nodes, self.n_net_elements
        of_nodes = ("reference_position", "mass")
        of_elements = ["element_nodes", "reference_length", "area", "youngs_modulus", "density", "is_string"]
        of_elements += [name for name in ("strength", "law_number") if getattr(self, name) is not None]
        parts = {name: getattr(self, name)[:nodes] for name in of_nodes}
        parts |= {name: getattr(self, name)[:elements] for name in of_elements}
        return replace(self, tethers=(), **parts)

    @property
    def tether_elements(self) -> dict[str, range]:
        """The elements of each tether, by name."""
        found, first = {}, self.n_net_elements
        for tether in self.tethers:
            found[tether.name] = range(first, first := first + len(tether.nodes) - 1)
        return found

    def node_words(self, node: int) -> str:
        """Return what a node is called in figures: "bullet 2", "centre", "end of tether tow", "node 12"."""
        bullet = np.flatnonzero(self.bullet_nodes == node).tolist()
        if bullet:
            return f"bullet {bullet[0]}"
        ends = (
            f"{words} of tether {tether.name}"
            for tether in self.tethers
            for words, end in (("start", tether.nodes[0]), ("end", tether.nodes[-1]))
            if end == node
        )
        return self.name_of(node) or next(ends, f"node {node}")

    @property
    def groups(self) -> dict[str, range]:
        """Groups of elements with reported largest tensions: "net", then "tether NAME" of each tether."""
        tethers = {TETHER + name: own for name, own in self.tether_elements.items()}
        return {NET: range(self.n_net_elements), **tethers}

    @property
    def spans(self) -> dict[str, range]:
        """`groups`, but that of the net in parts of threads or strings of one strength, where it is known.

        The largest tension of each gives its margin. The first part has the name of the group.
        """
        n = self.n_net_elements
        if self.strength is None or n == 0:
            return self.groups
        kind = np.stack([self.is_string[:n], self.strength[:n]])
        ends = [0, *(np.flatnonzero((np.diff(kind) != 0.0).any(axis=0)) + 1).tolist(), n]
        parts = {f"{NET} from element {a}" if a else NET: range(a, b) for a, b in pairwise(ends)}
        return parts | {name: own for name, own in self.groups.items() if name != NET}

    @property
    def size(self) -> float:
        """Largest side of the box around the net's reference configuration [m]; 1 if it is a point."""
        return float(np.ptp(self.reference_position[: self.n_net_nodes], axis=0).max(initial=0.0)) or 1.0

    @property
    def axial_stiffness(self) -> Floats:
        """(n_elements,) EA [N]."""
        return self.youngs_modulus * self.area


def edge_of(faces: Sequence[tuple[int, ...]], begin: int | None = None) -> tuple[int, ...]:
    """The loop of nodes along the edge of the meshes, anticlockwise from a node on; () without meshes.

    Without a node to begin at it must be the only edge, and begins at its least node. Of two meshes that
    share a side one goes along it forwards and the other backwards, so a side of the edge is one that no mesh
    goes along backwards.
    """
    sides = {pair for face in faces for pair in pairwise((*face, face[0]))}
    after = {a: b for a, b in sides if (b, a) not in sides}
    first = min(after, default=-1) if begin is None else begin
    found, node = [first], after.get(first, -1)
    while node not in (first, -1) and len(found) <= len(after):
        found.append(node)
        node = after.get(node, -1)
    return tuple(found) if node == first != -1 and (begin is not None or len(found) == len(after)) else ()

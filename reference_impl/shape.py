"""The topologies of the case format: their records, and the readers of their keys of `[net]`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from reference_impl.arrays import Vector
from reference_impl.table import Table, count, counts, number, numbers, one_of_names, refusal, text, triples

LARGEST_COUNT = 10_000_000  # of cells, elements or stored times; beyond it a slip of the pen is likelier


@dataclass(frozen=True)
class Rectangular:
    """Grid of `cells` = (nx, ny) meshes on a rectangle of `size` = (Lx, Ly) [m]; a square net is one too."""

    size: tuple[float, float]
    cells: tuple[int, int]


@dataclass(frozen=True)
class Hexagonal:
    """Honeycomb: side of a cell [m], rings of cells around the middle one."""

    mesh: float
    rings: int


@dataclass(frozen=True)
class Radial:
    """Spider's web: radius [m], spokes, rings."""

    radius: float
    spokes: int
    rings: int


@dataclass(frozen=True)
class Cut:
    """Meshes of sides `mesh` [m] cut to an outline: `size` [m] between opposite sides, or the diameter."""

    outline: str  # square, hexagon, octagon, circle
    size: float
    mesh_shape: str  # square, triangle, hexagon
    mesh: float
    corners: int


@dataclass(frozen=True)
class Explicit:
    """A net listed node by node: positions [m], element ends, extra masses [kg], nodes held still."""

    nodes: tuple[Vector, ...]
    elements: tuple[tuple[int, int], ...]
    node_masses: tuple[float, ...]
    fixed: tuple[int, ...]


Shape = Rectangular | Hexagonal | Radial | Cut | Explicit


def bullets_of(shape: Shape) -> int:
    """How many bullets a net of this shape has, if it has any."""
    if isinstance(shape, Radial):
        return shape.spokes
    if isinstance(shape, Cut):
        return shape.corners
    return {Rectangular: 4, Hexagonal: 6, Explicit: 0}[type(shape)]


def read_shape(net: Table) -> Any:
    """The topology with its keys; None with faults noted where it cannot be read."""
    shapes: dict[str, Callable[[Table], Any]] = {
        "square": _square,
        "rectangular": _rectangular,
        "hexagonal": _hexagonal,
        "radial": _radial,
        "cut": _cut,
        "explicit": _explicit,
    }
    topology = net.need("topology", text)
    if topology is None:
        net.ignore_rest()
        return None
    if topology not in shapes:
        net.faults.append(refusal(f'net.topology = "{topology}"', "it knows " + ", ".join(shapes)))
        net.ignore_rest()
        return None
    return shapes[topology](net)


def _cells(size: float | None, mesh: float | None, faults: list[str]) -> int:
    """How many meshes fit on a side: must be a whole number within 1e-9."""
    if size is None or mesh is None:
        return 1
    ratio = size / mesh
    if not 0.5 < ratio < LARGEST_COUNT or abs(ratio - round(ratio)) > 1e-9:
        faults.append(f"net.mesh: net.size / net.mesh must be a whole number, not {ratio:.12g}")
        return 1
    return round(ratio)


def _square(net: Table) -> Rectangular:
    size, mesh = net.need("size", number(above=0.0)), net.need("mesh", number(above=0.0))
    cells = _cells(size, mesh, net.faults)
    return Rectangular((size, size), (cells, cells))


def _rectangular(net: Table) -> Rectangular:
    size = net.need("size", numbers(2, above=0.0))
    mesh = net.need("mesh", numbers(2, above=0.0))
    pairs = zip(size or (None, None), mesh or (None, None), strict=True)
    cells = tuple(_cells(s, m, net.faults) for s, m in pairs)
    return Rectangular(size, (cells[0], cells[1]))


def _hexagonal(net: Table) -> Hexagonal:
    return Hexagonal(net.need("mesh", number(above=0.0)), net.need("rings", count(0)))


def _radial(net: Table) -> Radial:
    return Radial(
        net.need("radius", number(above=0.0)), net.need("spokes", count(3)), net.need("rings", count(1))
    )


_OUTLINES = {"square": 4, "hexagon": 6, "octagon": 8, "circle": 0}
_ROUND = 1e-9  # part of a length that is round-off where it is compared with another


def _cut(net: Table) -> Cut | None:
    """The cut net; None with faults noted where its lengths cannot be read or do not fit each other."""
    outline = net.need("outline", one_of_names(*_OUTLINES))
    shape = net.need("mesh_shape", one_of_names("square", "triangle", "hexagon"))
    size, mesh = net.need("size", number(above=0.0)), net.need("mesh", number(above=0.0))
    corners: int | None = _OUTLINES.get(outline or "", 0)
    if outline == "circle":
        corners = net.need("corners", count(3))
    elif "corners" in net.values:
        net.seen.add("corners")
        if outline is not None:
            net.faults.append(f"net.corners: only of a circle; a {outline} has {corners}")
    if outline is None or shape is None or size is None or mesh is None or not corners:
        return None
    if not size >= 3.0 * mesh * (1.0 - _ROUND):
        net.faults.append(f"net.size: must be at least 3 times net.mesh, {3.0 * mesh:.10g}, not {size:.10g}")
        return None
    if (size / mesh) ** 2 > LARGEST_COUNT:
        net.faults.append(f"net.mesh: more than {LARGEST_COUNT} cells")
        return None
    apart = size * math.sin(math.pi / corners)
    if outline == "circle" and not apart >= mesh * (1.0 - _ROUND):
        net.faults.append(
            f"net.corners: neighbours must be at least net.mesh apart, {mesh:.10g}, not {apart:.10g}"
        )
        return None
    return Cut(outline, size, shape, mesh, corners)


def _explicit(net: Table) -> Explicit:
    nodes = net.need("nodes", triples)
    elements = net.need("elements", _pairs)
    masses = net.get("node_masses", numbers(None, minimum=0.0), ())
    fixed = net.get("fixed", counts, ())
    if nodes is not None:
        if "node_masses" in net.seen and masses is not None and len(masses) != len(nodes):
            net.faults.append(f"net.node_masses: {len(masses)} masses for {len(nodes)} nodes")
        for key, listed in (
            ("elements", [e for pair in elements or () for e in pair]),
            ("fixed", fixed or ()),
        ):
            if outside := [i for i in listed if i >= len(nodes)]:
                net.faults.append(f"net.{key}: there is no node {outside[0]}")
    for i, j in elements or ():
        if i == j or (nodes is not None and max(i, j) < len(nodes) and nodes[i] == nodes[j]):
            net.faults.append(f"net.elements: [{i}, {j}] has no length")
    return Explicit(nodes, elements, masses or (), fixed)


def _pairs(value: Any) -> tuple[tuple[int, ...], ...]:
    if not isinstance(value, list) or any(not isinstance(v, list) or len(v) != 2 for v in value):
        raise ValueError("must be a list of [i, j]")
    return tuple(counts(v) for v in value)

"""The topologies of the case format: their records, and the readers of their keys of `[net]`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from reference_impl.arrays import Vector
from reference_impl.table import (
    Refused,
    Table,
    count,
    counts,
    list_of,
    number,
    numbers,
    text,
    triples,
    unknown,
)


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
    """A net listed node by node: positions [m], element ends, extra masses [kg], nodes held still.

    Corners of the mouth, if there is one, and the name of the thread of each element, "" of most.
    """

    nodes: tuple[Vector, ...]
    elements: tuple[tuple[int, int], ...]
    node_masses: tuple[float, ...]
    fixed: tuple[int, ...]
    corners: tuple[int, ...] = ()
    threads: tuple[str, ...] = ()


Shape = Rectangular | Hexagonal | Radial | Cut | Explicit

_OUTLINES = {"square": 4, "hexagon": 6, "octagon": 8}


def bullets_of(shape: Shape) -> int:
    """How many bullets a net of this shape has, if it has any."""
    if isinstance(shape, Radial):
        return shape.spokes
    if isinstance(shape, Cut):
        return shape.corners
    if isinstance(shape, Explicit):
        return len(shape.corners)
    return {Rectangular: 4, Hexagonal: 6}[type(shape)]


def _rows(file: Path) -> list[dict[str, str]]:
    """The rows of a file of values between commas, by the words of its first row."""
    try:
        lines = [line for line in file.read_text(encoding="utf-8-sig").splitlines() if line.strip(" ,")]
    except OSError as error:
        raise Refused([f"{file}: {error.strerror or error}"]) from error
    head, *rows = [[word.strip().strip('"') for word in line.split(",")] for line in lines]
    return [dict(zip(head, row, strict=True)) for row in rows]


def _read_listed(net: Table, folder: Path) -> Explicit:
    masses: tuple[float, ...] = net.get("node_masses", numbers, ())
    threads: tuple[str, ...] = ()
    if "nodes_file" in net:
        rows = _rows(folder / net.need("nodes_file", text))
        nodes = tuple((float(row["x"]), float(row["y"]), float(row["z"])) for row in rows)
        masses = masses or tuple(float(row["mass"]) for row in rows if "mass" in row)
    else:
        nodes = net.need("nodes", triples)
    if "elements_file" in net:
        rows = _rows(folder / net.need("elements_file", text))
        elements = tuple((int(row["i"]), int(row["j"])) for row in rows)
        threads = tuple(row.get("thread", "") for row in rows)
    else:
        elements = net.need("elements", list_of(list_of(count, 2)))
    fixed, corners = (net.get(key, counts, ()) for key in ("fixed", "corners"))
    return Explicit(nodes, elements, masses, fixed, corners, threads)


def read_shape(net: Table, folder: Path) -> Shape:
    """The topology with its keys; files are relative to `folder`."""
    kind = net.need("topology", text)
    if kind == "square":
        size = net.need("size", number)
        cells = net.need("meshes", count) if "meshes" in net else round(size / net.need("mesh", number))
        return Rectangular((size, size), (cells, cells))
    if kind == "rectangular":
        x, y = net.need("size", list_of(number, 2))
        if "meshes" in net:
            return Rectangular((x, y), net.need("meshes", list_of(count, 2)))
        a, b = net.need("mesh", list_of(number, 2))
        return Rectangular((x, y), (round(x / a), round(y / b)))
    if kind == "hexagonal":
        return Hexagonal(net.need("mesh", number), net.need("rings", count))
    if kind == "radial":
        return Radial(net.need("radius", number), net.need("spokes", count), net.need("rings", count))
    if kind == "cut":
        outline = net.choice("outline", *_OUTLINES, "circle")
        shape = net.choice("mesh_shape", "square", "triangle", "hexagon")
        corners = net.need("corners", count) if outline == "circle" else _OUTLINES[outline]
        return Cut(outline, net.need("size", number), shape, net.need("mesh", number), corners)
    if kind == "explicit":
        return _read_listed(net, folder)
    why = "it knows square, rectangular, hexagonal, radial, cut, explicit"
    raise unknown(f'net.topology = "{kind}"', why)

"""Meshes of a body's surface: read from STL, OBJ or GLB, and refused unless they enclose a volume.

A face is read as a whole polygon here, since the triangles that trimesh gives do not say what face or what
line of the file they are of.
"""

from __future__ import annotations

import importlib.util
import logging
import math
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError, MissingExtra
from exunet.bodies.distance import goes_through_itself
from exunet.bodies.mass_properties import volume_of
from exunet.bodies.shapes import TriangleMesh

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}  # in one unit of the file
ENDINGS = (".stl", ".obj", ".glb")
logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs what it then reads in another way
_FLAT = 1e-9  # of the volume of the box around a mesh, below which it encloses nothing


def read_mesh(path: Path, unit: str) -> TriangleMesh:
    """The closed surface in a file of this unit (a key of `METRES`), in metres.

    Raises MissingExtra without trimesh, and InputError if the file cannot be read or its surface is not that
    of a body (see `closed`), has a face that is not what its triangles are, or goes through itself.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: must end in {', '.join(ENDINGS)}")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if importlib.util.find_spec("trimesh") is None:
        words = f"{path}: meshes need trimesh, which is not installed: pip install 'exunet[mesh]'"
        raise MissingExtra(words)
    vertices, triangles = _read(path)
    if path.suffix.lower() == ".obj":
        refuse_overlapping_fans(path)
    mesh = closed(METRES[unit] * vertices, triangles, str(path))
    if goes_through_itself(mesh):
        words = "goes through itself, or has a piece inside another: what they share would count twice"
        raise InputError(f"{path}: {words}; make it one surface, as the union of its pieces")
    return mesh


def _read(path: Path) -> tuple[Floats, Ints]:
    import trimesh

    kind = path.suffix.lower().removeprefix(".")
    data = path.read_bytes()
    if kind == "obj":
        _refuse_vertex_0(path)
        # Without comments, tabs and other line ends, which trimesh does not read.
        data = "\n".join(" ".join(words) for _, words in _statements(path)).encode()
    elif kind == "stl":
        data = data[: _end_of_binary_stl(data)]
    try:
        # Scenes, such as GLB holds, give all their meshes as they are placed there.
        found: Any = trimesh.load_scene(BytesIO(data), file_type=kind, process=False).to_mesh()
    except ImportError as error:  # of a package that guesses what the text is written in
        words = "cannot be read as a mesh: its text is not UTF-8, nor is it a binary file of this kind"
        raise InputError(f"{path}: {words}") from error
    except Exception as error:
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(str(error).split())}") from error
    return np.array(found.vertices, dtype=float), np.array(found.faces, dtype=np.int64)


def _end_of_binary_stl(data: bytes) -> int:
    """Return where the triangles of a binary STL file end; its length for a text, which has no such number.

    Some programs write bytes behind the triangles, such as colours or padding.
    """
    if len(data) < 84:
        return len(data)
    end = 84 + 50 * int.from_bytes(data[80:84], "little")
    return end if end < len(data) else len(data)


def _refuse_vertex_0(path: Path) -> None:
    """Raise InputError with the line of an OBJ face that counts vertices from 0; the format counts from 1."""
    for line, words in _statements(path):
        if words[0] == "f" and any(word.partition("/")[0] == "0" for word in words[1:]):
            raise InputError(f"{path}:{line}: a face has vertex 0; OBJ counts vertices from 1: add 1 to each")


def closed(vertices: Floats, triangles: Ints, name: str) -> TriangleMesh:
    """A mesh of these vertices (n, 3) [m] and triangles (m, 3), if it encloses a volume.

    Vertices at the same place become one, triangles without area are removed (`_without_slivers`), and a mesh
    that is inside out is turned. Raises InputError, which begins with `name`, if a number is not finite, if
    an edge has not exactly two triangles, one on either side of it, or if there is no volume. That a surface
    goes through itself is not looked for.
    """
    if not len(triangles):
        raise InputError(f"{name}: has no triangles, or the file is not whole")
    if not np.isfinite(vertices).all():
        raise InputError(f"{name}: has a vertex that is not finite")
    vertices, same = np.unique(vertices, axis=0, return_inverse=True)
    triangles = same.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    triangles = _without_slivers(vertices, triangles)
    if fault := _edge_fault(triangles):
        raise InputError(f"{name}: {fault}{_closed_by_merging(vertices, triangles)}")
    mesh = TriangleMesh(vertices, triangles)
    volume = volume_of(mesh)
    around = float(np.prod(np.ptp(vertices, axis=0)))
    if not abs(volume) > _FLAT * around:
        raise InputError(f"{name}: encloses no volume")
    return mesh if volume > 0.0 else TriangleMesh(vertices, triangles[:, ::-1].copy())


def _edge_fault(triangles: Ints) -> str:
    """Describe edges that do not have exactly two triangles, one on either side; "" without any."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ends, owner = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    count = np.bincount(owner.reshape(-1), minlength=len(ends))
    if alone := int((count == 1).sum()):
        words = f"is not closed: {alone} of {len(ends)} edges belong to one triangle only"
        return f"{words}; mass and inertia need a surface without holes"
    if shared := int((count > 2).sum()):
        return f"{shared} of {len(ends)} edges belong to more than two triangles"
    way = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    if np.bincount(owner.reshape(-1), weights=way).any():
        return "neighbouring triangles disagree on which side is outside"
    return ""


def _closed_by_merging(vertices: Floats, triangles: Ints) -> str:
    """Describe the distance within which merged vertices close an open surface; "" if none does."""
    size = 10.0 ** math.floor(math.log10(float(np.ptp(vertices, axis=0).max()) or 1.0))
    for distance in (1e-6 * size, 1e-5 * size, 1e-4 * size):
        i, j = scipy.spatial.cKDTree(vertices).query_pairs(distance, output_type="ndarray").T
        graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(vertices),) * 2)
        merged = scipy.sparse.csgraph.connected_components(graph, directed=False)[1][triangles]
        kept = merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]
        if len(i) and len(kept) and not _edge_fault(kept):
            return f"; vertices differ by rounding: merging those within {distance:.0e} m would close it"
    return ""


_THIN = 1e-6  # height of a triangle over its longest side, below which its corners are in one line


def _thin(corners: Floats) -> NDArray[np.bool_]:
    """(m,) True for triangles (m, 3, 3) whose corners are in one line."""
    sides = np.roll(corners, -1, axis=1) - corners
    height = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(height <= _THIN * np.sum(sides**2, axis=2).max(axis=1))


def _without_slivers(vertices: Floats, triangles: Ints) -> Ints:
    """Replace triangles whose corners are in one line such that a closed surface stays closed.

    They are left out if edges are sound without them. Else one would leave its longest side against the two
    others. So this side is flipped: the middle corner divides the neighbour there.
    """
    thin = _thin(vertices[triangles])
    if not thin.any():
        return triangles
    if not _edge_fault(triangles[~thin]):
        return triangles[~thin]
    if _edge_fault(triangles):
        return triangles
    faces, owner = triangles.copy(), dict[tuple[int, int], int]()

    def put(k: int, *face: int) -> None:
        faces[k] = face
        owner.update(dict.fromkeys(zip(face, (*face[1:], face[0]), strict=True), k))

    left, before = np.flatnonzero(thin).tolist(), -1
    for k, face in enumerate(triangles.tolist()):
        put(k, *face)
    while len(left) != before:
        slivers, before, left = left, len(left), []
        for k in slivers:
            sides = np.linalg.norm(vertices[np.roll(faces[k], -1)] - vertices[faces[k]], axis=1)
            a, b, c = np.roll(faces[k], 2 - int(sides.argmax())).tolist()  # the longest side is from c to a
            other = owner[a, c]
            d = int(faces[other].sum()) - a - c
            if {(b, d), (d, b)} & owner.keys() or _thin(vertices[[[a, b, d], [b, c, d]]]).any():
                left.append(k)  # until the neighbour is no sliver any more
                continue
            del owner[a, c], owner[c, a]
            put(k, a, b, d)
            put(other, b, c, d)
    return faces


_BACKWARDS = 1e-9  # of the face's area, that a triangle may have on the wrong side by round-off


def refuse_overlapping_fans(path: Path) -> None:
    """Raises InputError with the line of a face that its fan would cover twice, or go beyond.

    Such a face is concave. The sum of the triangles' vector areas is that of the face all the same, and so
    are volume and inertia; contact and distances would see triangles where there is no surface.
    """
    points: list[list[float]] = []
    faces: list[tuple[int, list[int]]] = []
    for line, words in _statements(path):
        try:
            if words[0] == "v":
                points.append([float(word) for word in words[1:4]])
            elif words[0] == "f" and len(words) > 4:
                numbers = [int(word.partition("/")[0]) for word in words[1:]]
                faces.append((line, [k - 1 if k > 0 else len(points) + k for k in numbers]))
        except ValueError:  # what trimesh has read all the same
            continue
    for line, corners in faces:
        if max(corners) < len(points) and _overlap(np.array([points[k] for k in corners])):
            why = f"the face of {len(corners)} corners is concave: its triangles, all from its first corner,"
            what = "triangulate it where the file is made, or begin it at a corner that sees all others"
            raise InputError(f"{path}:{line}: {why} would overlap; {what}")


def _overlap(corners: Floats) -> bool:
    """True if a triangle of the fan of corners (n, 3) lies on the back of the face."""
    sides = corners[1:] - corners[0]
    with np.errstate(all="ignore"):  # numbers that are not finite are refused elsewhere
        areas = np.cross(sides[:-1], sides[1:])
        normal = areas.sum(axis=0)
        return bool((areas @ normal).min() < -_BACKWARDS * (normal @ normal))


def _statements(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The words of each statement and the line where it begins; a backslash continues it on the next line."""
    words: list[str] = []
    first = 0
    for line, text in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), start=1):
        first = first if words else line
        text = text.partition("#")[0].rstrip()
        words += text.removesuffix("\\").split()
        if words and not text.endswith("\\"):
            yield first, words
            words = []

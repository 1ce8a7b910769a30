"""Meshes of a body's surface: read from STL, OBJ or GLB, and refused unless they enclose a volume."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError, MissingExtra
from exunet.bodies.mass_properties import volume_of
from exunet.bodies.obj_faces import refuse_overlapping_fans
from exunet.bodies.shapes import TriangleMesh
from exunet.bodies.surfaces import goes_through_itself

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}  # in one unit of the file
ENDINGS = (".stl", ".obj", ".glb")
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

    try:
        # Scenes, such as GLB holds, give all their meshes as they are placed there.
        found: Any = trimesh.load_scene(path, process=False).to_mesh()
    except ImportError as error:  # of a package that guesses what the text is written in
        words = "cannot be read as a mesh: its text is not UTF-8, nor is it a binary file of this kind"
        raise InputError(f"{path}: {words}") from error
    except Exception as error:
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(str(error).split())}") from error
    return np.array(found.vertices, dtype=float), np.array(found.faces, dtype=np.int64)


def closed(vertices: Floats, triangles: Ints, name: str) -> TriangleMesh:
    """A mesh of these vertices (n, 3) [m] and triangles (m, 3), if it encloses a volume.

    Vertices at the same place become one, triangles without area are left out, and a mesh that is inside out
    is turned. Raises InputError, which begins with `name`, if a number is not finite, if an edge has not
    exactly two triangles, one on either side of it, or if there is no volume. That a surface goes
    through itself is not looked for.
    """
    if not len(triangles):
        raise InputError(f"{name}: has no triangles, or the file is not whole")
    if not np.isfinite(vertices).all():
        raise InputError(f"{name}: has a vertex that is not finite")
    vertices, same = np.unique(vertices, axis=0, return_inverse=True)
    triangles = same.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _refuse_open(triangles, name)
    mesh = TriangleMesh(vertices, triangles)
    volume = volume_of(mesh)
    around = float(np.prod(np.ptp(vertices, axis=0)))
    if not abs(volume) > _FLAT * around:
        raise InputError(f"{name}: encloses no volume")
    return mesh if volume > 0.0 else TriangleMesh(vertices, triangles[:, ::-1].copy())


def _refuse_open(triangles: Ints, name: str) -> None:
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ends, owner = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    count = np.bincount(owner.reshape(-1), minlength=len(ends))
    if alone := int((count == 1).sum()):
        words = f"is not closed: {alone} of {len(ends)} edges belong to one triangle only"
        raise InputError(f"{name}: {words}; mass and inertia need a surface without holes")
    if shared := int((count > 2).sum()):
        raise InputError(f"{name}: {shared} of {len(ends)} edges belong to more than two triangles")
    way = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    if np.bincount(owner.reshape(-1), weights=way).any():
        raise InputError(f"{name}: neighbouring triangles disagree on which side is outside")

"""Meshes for tests, and files of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exunet.bodies.shapes import TriangleMesh

# An L of legs that are 0.2 m wide and 0.5 m long, around its inner corner from there on.
OUTLINE = [(-0.05, -0.05), (-0.05, 0.25), (-0.25, 0.25), (-0.25, -0.25), (0.25, -0.25), (0.25, -0.05)]


def extruded(outline: list[tuple[float, float]], half: float) -> TriangleMesh:
    """A prism of an outline whose first corner sees all others; z = -half ... half [m]."""
    n = len(outline)
    vertices = np.array([(x, y, z) for z in (-half, half) for x, y in outline])
    found = [(n, n + k, n + k + 1) for k in range(1, n - 1)] + [(0, k + 1, k) for k in range(1, n - 1)]
    for k in range(n):
        m = (k + 1) % n
        found += [(k, m, n + m), (k, n + m, n + k)]
    return TriangleMesh(vertices, np.array(found))


def keys_of(mesh: TriangleMesh, folder: Path, name: str) -> dict[str, str]:
    """Write a mesh into a file in a folder: the keys of a body that name it."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(folder / f"{name}.stl")
    return {"shape": "mesh", "file": f"{name}.stl", "unit": "m"}

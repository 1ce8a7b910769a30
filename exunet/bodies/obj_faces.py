"""Faces of an OBJ file that a fan of triangles from the first corner, as trimesh makes it, does not fit.

A face is read as a whole polygon here, since the triangles that trimesh gives do not say what face or what
line of the file they are of.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError

Floats = NDArray[np.float64]

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
    begun: list[str] = []
    first = 0
    for line, text in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        first = first if begun else line
        begun += text.removesuffix("\\").split()
        if begun and not text.endswith("\\"):
            yield first, begun
            begun = []

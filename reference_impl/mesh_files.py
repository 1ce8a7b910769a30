"""Reads surfaces of triangles from files: STL, binary or of text, and OBJ.

STL: a header of 80 bytes, the number of triangles, and for each 12 floats and 2 bytes, little-endian; or the
words `facet normal ... vertex x y z ... endfacet` (3D Systems, StereoLithography Interface Specification,
1989).  Normals are passed over: the order of the corners gives them.  OBJ: lines `v x y z`, and `f` with
numbers of vertices from 1, or from -1 backwards (Wavefront, Advanced Visualizer, appendix B1); faces of more
corners are fans of triangles, and refused where these overlap.  Files of text that give no triangle at all
are refused.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from reference_impl.arrays import Floats

ROUND_OFF = 1e-9  # of a face's area
_HEADER = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])


def triangles(path: Path) -> Floats:
    """Corners (f, 3, 3) of the triangles of a file, in its unit; ValueError says what is wrong with it."""
    kind = path.suffix.lower()
    if kind not in (".stl", ".obj"):
        raise ValueError(
            f"reference_impl does not know files of the kind {kind or 'without a suffix'}: "
            "it knows .stl, .obj"
        )
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from error
    try:
        found = _stl(content) if kind == ".stl" else _obj(_text(content))
    except (IndexError, OverflowError) as error:
        raise ValueError(f"{path}: a face names a vertex that is not there") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if not len(found):
        raise ValueError(f"{path}: no triangles in it")
    if not np.all(np.isfinite(found)):
        raise ValueError(f"{path}: its coordinates must be finite")
    return found


def _stl(content: bytes) -> Floats:
    """The corners of a binary file if it has as many triangles as it says, else of text.

    Bytes behind the triangles are passed over.
    """
    if len(content) >= _HEADER:
        (count,) = struct.unpack_from("<I", content, _HEADER - 4)
        if len(content) >= _HEADER + count * _TRIANGLE.itemsize:
            return np.asarray(np.frombuffer(content, _TRIANGLE, count, _HEADER)["corner"].astype(float))
    words = _text(content).split()
    if not words or words[0].lower() != "solid":
        raise ValueError("not an STL file, or one that was cut short")
    corners = [words[at + 1 : at + 4] for at, word in enumerate(words) if word.lower() == "vertex"]
    if len(corners) % 3 or sum(word.lower() == "endfacet" for word in words) != len(corners) // 3:
        raise ValueError("its facets must have three vertices each")
    return _numbers(corners).reshape(-1, 3, 3)


def _obj(text: str) -> Floats:
    text = "\n".join(line.partition("#")[0].rstrip() for line in text.splitlines())
    found = re.finditer(r"(?:\\\n|[^\n])+", text)
    lines = [(item.start(), item[0].replace("\\\n", " ").split()) for item in found]
    points = _numbers([words[1:4] for _, words in lines if words[:1] == ["v"]])
    faces, before = [], 0
    for begin, words in lines:
        before += words[:1] == ["v"]
        if words[:1] == ["f"]:
            named = [int(word.split("/")[0]) for word in words[1:]]
            ring = [number - 1 if number > 0 else before + number for number in named]
            if len(ring) < 3 or 0 in named or min(ring) < 0:
                raise ValueError(f"not a face: {' '.join(words)}")
            if len(ring) > 3 and _overlap(points[ring]):
                line = 1 + text.count("\n", 0, begin)
                raise ValueError(
                    f"line {line}: a concave face, of which the triangles from its first corner overlap: "
                    "write it as triangles"
                )
            faces += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
    return np.asarray(points[np.array(faces, dtype=np.intp).reshape(-1, 3)])


def _overlap(corners: Floats) -> bool:
    """Whether the triangles of a fan have more area, seen along the face's normal, than the face itself."""
    rays = corners[1:] - corners[0]
    doubled = np.cross(rays[:-1], rays[1:])
    whole = np.sum(doubled, axis=0)  # Newell's normal
    seen = doubled @ whole
    return bool(np.sum(np.abs(seen)) > (1.0 + ROUND_OFF) * np.sum(seen))


def _text(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("neither a text nor of the length that its number of triangles asks for") from error


def _numbers(rows: list[list[str]]) -> Floats:
    """Triples of numbers (n, 3)."""
    if any(len(row) != 3 for row in rows):
        raise ValueError("a vertex must have three coordinates")
    return np.array([[float(word) for word in row] for row in rows]).reshape(-1, 3)

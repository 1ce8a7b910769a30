"""The lines that show a body's shape: where they are, how long, kept with the result."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exunet
from exunet.bodies.shapes import Shape, Solid, TriangleMesh
from exunet.bodies.wireframe import AROUND, wireframe

SOLIDS = {
    "box": Solid("box", (1.0, 2.0, 3.0)),
    "cylinder": Solid("cylinder", (0.5, 2.0, 0.0)),
    "sphere": Solid("sphere", (0.7, 0.0, 0.0)),
    "capsule": Solid("capsule", (0.5, 2.0, 0.0)),
    "frustum": Solid("frustum", (0.5, 0.0, 2.0)),
}
CHORD = 2.0 * AROUND * math.sin(math.pi / AROUND)  # of the polygon that stands for a circle of radius 1


def length(lines: Any) -> float:
    return float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum())


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("box", 4.0 * 6.0),
        ("cylinder", 2.0 * 0.5 * CHORD + 4.0 * 2.0),
        ("sphere", 0.7 * CHORD * 3.0),  # the equator and four meridians from pole to pole
        ("capsule", 0.5 * CHORD * (2.0 + 2.0) + 4.0 * 2.0),
        ("frustum", 0.5 * CHORD + 4.0 * math.hypot(0.5, 2.0)),  # a cone: one circle
    ],
)
def test_lines_have_their_length_and_lie_on_the_surface(kind: str, expected: float) -> None:
    solid, lines = SOLIDS[kind], wireframe(Shape((SOLIDS[kind],)))
    assert length(lines) == pytest.approx(expected, rel=1e-12)
    ends = lines.reshape(-1, 3)
    assert solid.contains(ends * (1.0 - 1e-9)).all()  # all five are star-shaped about the origin
    assert not solid.contains(ends * (1.0 + 1e-9)).any()
    middles = lines.mean(axis=1)
    assert len(np.unique(np.round(middles, 9), axis=0)) == len(middles)  # no line twice
    if kind != "frustum":  # the others are their own mirror images in the planes of their axes
        np.testing.assert_allclose(middles.sum(axis=0), 0.0, atol=1e-12)


def test_lines_of_a_part_are_placed_as_the_part() -> None:
    turned = Solid("box", (1.0, 2.0, 3.0), (5.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    ends = wireframe(Shape((SOLIDS["box"], turned)))[12:].reshape(-1, 3)
    np.testing.assert_allclose(ends.min(axis=0), [4.0, -0.5, -1.5], atol=1e-15)  # about z by 90 degrees
    np.testing.assert_allclose(ends.max(axis=0), [6.0, 0.5, 1.5], atol=1e-15)


def test_a_mesh_shows_its_sharp_edges_only() -> None:
    """Of a cube its 12 edges, not the diagonals of its faces."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([part for a, b, c, d in faces for part in ((a, b, c), (a, c, d))])
    lines = wireframe(Shape(mesh=TriangleMesh(corners, triangles)))
    assert len(lines) == 12
    assert length(lines) == pytest.approx(12.0, rel=1e-15)


def test_a_result_keeps_them_from_the_centre_of_mass(tmp_path: Path) -> None:
    case = Path(exunet.__file__).parent / "cases" / "bodies" / "tumbling.toml"
    result = exunet.run(exunet.load(case, ["time.end=0.02"]))
    lines = result.bodies["target"].wireframe
    assert lines is not None
    # Volumes and centres of bus, panels and nozzle (a frustum: Bronshtein, Handbook of Mathematics, 3.3.4).
    nozzle = math.pi * 0.4 / 3.0 * (0.09 + 0.03 + 0.01)
    low = -1.2 + 0.1 * (0.09 + 2.0 * 0.03 + 3.0 * 0.01) / (0.09 + 0.03 + 0.01)
    centre = (0.128 * 0.3 + nozzle * low) / (1.92 + 0.128 + nozzle)
    assert lines[..., 2].min() == pytest.approx(-1.2 - centre, rel=1e-14)
    exunet.save(result, tmp_path / "result.h5")
    again = exunet.load_result(tmp_path / "result.h5").bodies["target"].wireframe
    assert again is not None
    assert np.array_equal(again, lines)

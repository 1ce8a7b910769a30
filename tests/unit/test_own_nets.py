"""Nets of listed nodes and elements with corners, from CSV files too; their errors, and both codes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES, case_in, refused, values_of

import exunet
from exunet.base.errors import CaseError
from exunet.net import weave
from exunet.net.explicit import ExplicitNet
from exunet.net.square import SquareNet, mesh
from exunet.studies.both_codes import read_both
from exunet.verification.cross_code import compared, motion

CABLE = {"diameter": 1e-3, "density": 1000.0, "youngs_modulus": 1e9}
SIZE, MESHES = 4.0, 6
CORNERS = [0, 6, 48, 42]
CASE = """
format = 1
title = "square"
time = { end = 0.4, output_step = 0.02 }
initial = { packing = 0.2 }
launch = { speed = 3.0, spread_angle = 0.7 }
effects.material_damping.relaxation_time = 1e-5
[solver]
method = "RK44"
step = 2e-5
[net]
cable = { diameter = 1e-3, density = 1000.0, youngs_modulus = 1e9 }
bullets = { mass = 0.1 }
"""
WOVEN = f'topology = "square"\nsize = {SIZE}\nmeshes = {MESHES}\n'
OWN = (
    f'topology = "explicit"\nnodes_file = "nodes.csv"\nelements_file = "elements.csv"\ncorners = {CORNERS}\n'
)
STRINGS = "[net.strings]\ndiameter = 1e-3\ndensity = 1000.0\nyoungs_modulus = 1e9\nlength = 0.7\n"


def tables(folder: Path, lift: float = 0.0) -> None:
    """The square net as two CSV files; lift : of its middle row out of the plane [m]."""
    keys = {"topology": "square", "size": SIZE, "meshes": MESHES, "cable": CABLE}
    square = mesh(SquareNet.model_validate(keys))
    knots = square.knots.copy()
    knots[np.abs(knots[:, 1]) < 1e-9, 2] += lift
    nodes = [", ".join(map(repr, row)) for row in knots.tolist()]
    elements = [f"{i},{j}" for i, j in square.sides.tolist()]
    (folder / "nodes.csv").write_text("\n".join(["x, y, z", *nodes]))
    (folder / "elements.csv").write_text("\n".join(["i,j", *elements]))


def net(folder: Path, **keys: Any) -> Any:
    files = (folder / "nodes.csv", folder / "elements.csv")
    return weave(ExplicitNet.from_csv(*files, **({"cable": CABLE, "corners": CORNERS} | keys)))


def test_a_square_net_from_files_has_the_metrics_of_the_square_topology(tmp_path: Path) -> None:
    """Bitwise without strings, whose nodes have the same numbers; with strings to 1e-9 before the horizon."""
    tables(tmp_path)
    for strings, tolerance in (("", 0.0), (STRINGS, 1e-9)):
        own, woven = (
            values_of(exunet.run(case_in(tmp_path, CASE + keys + strings))) for keys in (OWN, WOVEN)
        )
        assert own.keys() == woven.keys()
        assert own["largest_tension_N"] > 1.0
        for name, value in woven.items():
            assert own[name] == pytest.approx(value, rel=tolerance, abs=tolerance, nan_ok=True), name


def test_names_rim_and_meshes_are_those_of_the_square(tmp_path: Path) -> None:
    tables(tmp_path)
    made = net(tmp_path)
    assert [made.node("centre"), made.node("corner 2"), made.node("rim 0.125")] == [24, 48, 3]
    assert len(made.faces) == MESHES**2
    assert len(made.rim) == 4 * MESHES


def test_a_net_that_is_not_planar_has_the_area_of_its_corners_alone(tmp_path: Path) -> None:
    tables(tmp_path, lift=0.2)
    made = net(tmp_path)
    assert made.faces == ()
    assert made.rim == tuple(CORNERS)
    assert exunet.mouth_area(made, made.reference_position) == pytest.approx(SIZE**2, rel=1e-12)


def test_threads_that_cross_without_a_node_leave_no_meshes() -> None:
    """A square with both diagonals; with a node where these cross it has four triangles."""
    nodes = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0]]
    ring = [[0, 1], [1, 2], [2, 3], [3, 0]]
    keys = {"topology": "explicit", "cable": CABLE, "corners": [0, 1, 2, 3]}
    crossed = {"nodes": nodes[:4], "elements": [*ring, [0, 2], [1, 3]]}
    joined = {"nodes": nodes, "elements": [*ring, [0, 4], [4, 2], [1, 4], [4, 3]]}
    assert weave(ExplicitNet.model_validate(keys | crossed)).faces == ()
    assert len(weave(ExplicitNet.model_validate(keys | joined)).faces) == 4


def test_threads_have_their_cables_and_elements_their_order(tmp_path: Path) -> None:
    """One element in three is thick: masses and areas by hand, two elements a side."""
    tables(tmp_path)
    rows = (tmp_path / "elements.csv").read_text().splitlines()
    named = [f"{row}, {'thick' if k % 3 == 0 else ''}" for k, row in enumerate(rows[1:])]
    (tmp_path / "elements.csv").write_text("\n".join(["i, j, thread", *named]))
    thick = CABLE | {"diameter": 2e-3}
    made = net(tmp_path, threads={"thick": thick}, divisions=2)
    expected = np.repeat(np.where(np.arange(84) % 3 == 0, 4.0, 1.0), 2)
    np.testing.assert_allclose(made.area, expected * np.pi / 4 * 1e-6, rtol=1e-12)
    assert made.element_nodes[[0, -1]].tolist() == [[0, 49], [49 + 83, 48]]
    assert made.mass.sum() == pytest.approx(np.pi / 4 * 1e-3 * SIZE / MESHES * (28 * 4 + 56), rel=1e-12)


def line_of(folder: Path, file: str, line: int, text: str) -> None:
    rows = (folder / file).read_text().splitlines()
    rows[line - 1] = text
    (folder / file).write_text("\n".join(rows))


@pytest.mark.parametrize(
    ("file", "line", "text"),
    [
        ("elements.csv", 17, "3, 900"),
        ("elements.csv", 17, "3, -1"),
        ("elements.csv", 17, "3, 3"),
        ("elements.csv", 17, "1, 0"),
        ("elements.csv", 17, "3, 4.5"),
        ("elements.csv", 17, "3"),
        ("elements.csv", 1, "i, k"),
        ("nodes.csv", 9, "1.0, 2.0, middle"),
        ("nodes.csv", 9, "1.0, 2.0, nan"),
        ("nodes.csv", 1, "x, y"),
    ],
)
def test_errors_of_files_name_the_line(file: str, line: int, text: str, tmp_path: Path) -> None:
    tables(tmp_path)
    line_of(tmp_path, file, line, text)
    with pytest.raises(CaseError, match=rf"{file}:{line}: "):
        net(tmp_path)


def test_errors_of_threads_masses_and_missing_files(tmp_path: Path) -> None:
    tables(tmp_path)
    line_of(tmp_path, "elements.csv", 1, "i, j, thread")
    with pytest.raises(CaseError, match=r"elements.csv:2: "):
        net(tmp_path)
    (tmp_path / "elements.csv").write_text("i, j, thread\n0, 1, thck\n")
    with pytest.raises(CaseError, match=r"elements.csv:2: .*thck"):
        net(tmp_path, threads={"thick": CABLE})
    (tmp_path / "nodes.csv").write_text("x, y, z, mass\n0, 0, 0, 1\n1, 0, 0, -1\n")
    with pytest.raises(CaseError, match=r"nodes.csv:3: "):
        net(tmp_path)
    (tmp_path / "nodes.csv").unlink()
    with pytest.raises(CaseError, match=r"nodes.csv: "):
        net(tmp_path)


@pytest.mark.parametrize(
    ("corners", "answer"),
    [
        ([0, 42, 48, 6], r"\[0, 6, 48, 42\]"),
        ([0, 48, 6, 42], r"\[0, 6, 48, 42\]"),
        ([0, 6, 48, 48], "48 is listed twice"),
        ([0, 6, 24, 42], "24 is not on the edge"),
        ([0, 6, 49, 42], "no node 49"),
    ],
)
def test_errors_of_corners_have_the_right_order(corners: list[int], answer: str, tmp_path: Path) -> None:
    tables(tmp_path)
    with pytest.raises(CaseError, match=answer):
        net(tmp_path, corners=corners)


def test_a_launch_needs_bullets_and_these_need_corners(tmp_path: Path) -> None:
    tables(tmp_path)
    path = tmp_path / "own.toml"
    path.write_text(CASE + OWN)
    assert refused(path, "net.corners=") == ["net.bullets"]
    assert refused(path, "net.bullets=") == ["launch"]


def test_both_codes_have_the_same_net_and_start() -> None:
    """By place: own numbers, threads, strings, bullets and launch of the shipped case."""
    path = CASES / "nets" / "own.toml"
    both = read_both(path)
    ours, theirs = both.start.net, both.theirs.net
    nodes, elements = both.reference_nodes, both.reference_elements
    np.testing.assert_array_equal(nodes[:67], np.arange(67))  # listed nodes keep their numbers
    np.testing.assert_allclose(theirs.mass[nodes], ours.mass, rtol=1e-12)
    for name in ("area", "youngs_modulus", "density", "reference_length"):
        np.testing.assert_allclose(getattr(theirs, name)[elements], getattr(ours, name), rtol=1e-12)
    np.testing.assert_array_equal(nodes[ours.bullet_nodes], theirs.numbered_bullets)
    np.testing.assert_allclose(both.theirs.v0[nodes], both.start.velocity, atol=1e-12)


def test_laws_of_threads_and_tilts_agree_in_both_codes(tmp_path: Path) -> None:
    """Elements keep their laws in the order of the file; bullets above the plane tilt about level axes."""
    (tmp_path / "nodes.csv").write_text("x,y,z\n-1,-1,0.3\n1,-1,0.3\n1,1,0.3\n-1,1,0.3\n")
    (tmp_path / "elements.csv").write_text("i,j,thread\n0,1,edge\n0,2,\n1,2,edge\n2,3,edge\n3,0,hooke\n")
    table = 'law = "table"\ntable = [[0.0, 0.0], [0.01, 100.0], [0.05, 900.0]]\n'
    tilts = "[[0.1, 0.05], [0.0, 0.1], [0.1, 0.0], [-0.1, 0.2]]"
    path = tmp_path / "case.toml"
    path.write_text(
        CASE.replace("0.7 }", f"0.7, tilts = {tilts} }}")
        + OWN.replace(str(CORNERS), "[0, 1, 2, 3]")
        + f"divisions = 2\n[net.threads.edge]\ndiameter = 2e-3\ndensity = 970.0\n{table}"
        + '[net.threads.hooke]\ndiameter = 1e-3\nmaterial = "nylon"\nlaw = "hooke"\n'
        + f'[net.strings]\ndiameter = 1e-3\nmaterial = "vectran"\nlength = 1.5\n{table}'
    )
    both = read_both(path)
    assert both.start.net.law_number.tolist() == [2, 2, 0, 0, 2, 2, 2, 2, 1, 1] + [5] * 4
    np.testing.assert_allclose(both.theirs.v0[both.reference_nodes], both.start.velocity, atol=1e-14)
    for check in compared(motion(both, compiled=True), 5):
        assert check.holds, check

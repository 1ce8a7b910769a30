"""Exports, read back: VTKHDF by VTK, time series from CSV."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from result_samples import around_a_box
from scenes import PAIR

import exunet
from exunet.base.errors import InputError
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.touched import surface_shown
from exunet.cli.export import export_result
from exunet.net.arrays import TetherNodes
from exunet.results.clearance import rounded_shapes
from exunet.results.result import Result
from exunet.scene.casefile import parse_case
from exunet.simulation.run import run_into


def blocks(path: Path, row: int) -> dict[str, Any]:
    """Return the parts of a file at a step, by name, as VTK reads them."""
    hdf = pytest.importorskip("vtkmodules.vtkIOHDF")
    data = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    reader = hdf.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 7
    reader.SetStep(row)
    reader.Update()
    found = reader.GetOutputDataObject(0)
    name = data.vtkCompositeDataSet.NAME()
    parts = range(found.GetNumberOfPartitionedDataSets())
    return {found.GetMetaData(k).Get(name): found.GetPartition(k, 0) for k in parts}


def numbers(array: Any) -> np.ndarray:
    return np.array(pytest.importorskip("vtkmodules.util.numpy_support").vtk_to_numpy(array))


def test_vtk_reads_the_states_of_the_result(tmp_path: Path) -> None:
    of = around_a_box()
    exunet.save(of, tmp_path / "result.h5")
    out = export_result(tmp_path, "vtkhdf", None, overwrite=False)
    assert out == tmp_path / "result.vtkhdf"
    (tmp_path / "result.h5").unlink()
    mesh, body = surface_shown(rounded_shapes(of)["box"]), of.bodies["box"]
    for row in (0, 3, 6):
        parts = blocks(out, row)
        assert list(parts) == ["net", "closing_line", "body_box"]
        net = parts["net"]
        np.testing.assert_array_equal(numbers(net.GetPoints().GetData()), of.position[row])
        np.testing.assert_array_equal(numbers(net.GetCellData().GetArray("tension")), of.tension[row])
        np.testing.assert_array_equal(numbers(net.GetPointData().GetArray("velocity")), of.velocity[row])
        broken = (np.arange(of.net.n_elements) == 5) & (of.time[row] >= 0.8)
        np.testing.assert_array_equal(numbers(net.GetCellData().GetArray("broken")), broken)
        ends = numbers(net.GetLines().GetConnectivityArray()).reshape(-1, 2)
        np.testing.assert_array_equal(ends, of.net.element_nodes)
        line = numbers(parts["closing_line"].GetPoints().GetData())
        np.testing.assert_array_equal(line, of.position[row][[0, 2, 8, 6, 0]])
        along = numbers(parts["closing_line"].GetCellData().GetArray("tension"))
        np.testing.assert_allclose(along, np.linspace(2.0, 1.0, 4) * (row > 3), rtol=1e-15)
        corners = mesh.vertices @ rotation_matrix(body.attitude[row]).T + body.position[row]
        np.testing.assert_allclose(numbers(parts["body_box"].GetPoints().GetData()), corners, atol=1e-15)
        assert parts["body_box"].GetNumberOfPolys() == len(mesh.triangles)


def test_tethers_are_a_group_of_their_own(tmp_path: Path) -> None:
    of = around_a_box()
    tethered = replace(of.net, tethers=(TetherNodes("tow", 12, (11, 12)),))
    whole: Result = replace(of, net=tethered)
    exunet.export(whole, tmp_path / "result.vtkhdf")
    group = numbers(blocks(tmp_path / "result.vtkhdf", 6)["net"].GetCellData().GetArray("group"))
    assert group.tolist() == [0] * 15 + [1]


def test_a_net_without_elements_has_points_and_no_cells(tmp_path: Path) -> None:
    run_into(tmp_path, parse_case(PAIR, tmp_path / "case.toml", ["net.elements=[]", "time.end=0.3"]))
    (tmp_path / "copy").mkdir()
    for out in (None, tmp_path / "copy" / "a.vtkhdf"):
        net = blocks(export_result(tmp_path, "vtkhdf", out, overwrite=False), 6)["net"]
        assert (net.GetNumberOfPoints(), net.GetNumberOfCells()) == (2, 0)


def test_bodies_whose_names_differ_in_signs_are_parts_of_their_own(tmp_path: Path) -> None:
    of = around_a_box()
    (body,) = of.bodies.values()
    exunet.export(replace(of, bodies={"b-1": body, "b_1": body, "b+1": body}), tmp_path / "a.vtkhdf")
    parts = [part for name, part in blocks(tmp_path / "a.vtkhdf", 0).items() if name.startswith("body")]
    assert [part.GetNumberOfPoints() > 0 for part in parts] == [True] * 3


def test_a_body_at_rest_is_stored_once(tmp_path: Path) -> None:
    of = around_a_box()
    still = of.bodies["box"]
    still = replace(still, position=still.position[[0] * 7], attitude=still.attitude[[0] * 7])
    exunet.export(replace(of, bodies={"box": still}), tmp_path / "a.vtkhdf")
    corners = surface_shown(rounded_shapes(of)["box"]).vertices
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        assert len(file["VTKHDF/body_box/Points"]) == len(corners)
    for row in (0, 6):
        found = numbers(blocks(tmp_path / "a.vtkhdf", row)["body_box"].GetPoints().GetData())
        np.testing.assert_allclose(found, corners + still.position[0], atol=1e-15)


def test_csv_has_all_time_series(tmp_path: Path) -> None:
    of = around_a_box()
    exunet.export(of, tmp_path / "series.csv")
    with (tmp_path / "series.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    columns = dict(zip(head, np.array(rows, dtype=float).T, strict=True))
    np.testing.assert_array_equal(columns["time [s]"], of.time)
    np.testing.assert_array_equal(columns["tension [N]"], of.tension.max(axis=1))
    np.testing.assert_array_equal(columns["kinetic [J]"], of.kinetic)
    np.testing.assert_array_equal(columns["contact_box/threads_force [N]"][-1], 1.5)


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    of = around_a_box()
    exunet.save(of, tmp_path / "result.h5")
    with pytest.raises(InputError, match="must end in"):
        exunet.export(of, tmp_path / "a.vtu")
    with pytest.raises(InputError, match="--to"):
        export_result(tmp_path, "usd", None, overwrite=False)
    export_result(tmp_path, "csv", None, overwrite=False)
    with pytest.raises(InputError, match="--overwrite"):
        export_result(tmp_path, "csv", None, overwrite=False)

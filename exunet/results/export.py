"""Export of a result: to VTKHDF, which ParaView and VTK read, and of its time series to CSV or pandas.

A VTKHDF file has net, tethers, closing line and bodies over the stored times. It is a collection of PolyData
with steps, format 2.3 (VTK file formats, docs.vtk.org). What does not change, such as the elements, is in it
once. The format has no motion of a block: the corners of a body that moves are in it at each time.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError
from exunet.base.files import path_of, replacing
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.touched import surface_shown
from exunet.results.clearance import rounded_shapes
from exunet.results.loads import broken_at
from exunet.results.observables import LINE, Observables, further_series, time_series
from exunet.results.result import Result, row_ranges, table

if TYPE_CHECKING:
    import h5py
    from pandas import DataFrame

Rows = Callable[[int, int], NDArray[Any]]  # first and last stored time: values (times, n, ...)

FORMAT = np.array([2, 3])
_CELLS = ("Vertices", "Lines", "Polygons", "Strips")
_BLOCK = 64  # states that are written at a time


@takes(result=Result)
def export(result: Result, path: str | Path) -> None:
    """Write a result for other programs.

    Parameters
    ----------
    result : Result
        The run.
    path : str or Path
        File to write. Ends in .vtkhdf (states, for ParaView) or in .csv (time series: a row for each stored
        time).

    Raises
    ------
    InputError
        For another ending, or a file that cannot be written.
    """
    path = path_of(path, "export")
    if path.suffix == ".csv":
        _write_csv(result, path)
    elif path.suffix == ".vtkhdf":
        _write_vtkhdf(result, path)
    else:
        raise InputError(f"{path}: the name must end in .vtkhdf or .csv")


@takes(result=Result)
def to_frame(result: Result) -> DataFrame:
    """Return the time series of a result as a pandas table: a row for each stored time, units in brackets.

    The index is "time [s]". The columns are the quantities of an ensemble over time, potential energy,
    distances, and position [m] and velocity [m/s] of each body. Raises MissingExtra without pandas
    (pip install 'exunet[pandas]').
    """
    return table("time [s]", result.time, _columns(result))


def _columns(result: Result) -> dict[str, Floats]:
    """Return the time series (t,) by name with unit."""
    run = Observables(result)
    series = (*time_series(run), *further_series(run))
    found = {f"{item.name} [{item.unit or '1'}]": np.asarray(item.values) for item in series}
    for name, body in result.bodies.items():
        for quantity, unit, values in (("position", "m", body.position), ("velocity", "m/s", body.velocity)):
            columns = zip("xyz", np.asarray(values[:]).T, strict=True)
            found |= {f"body_{name}/{quantity}_{axis} [{unit}]": column for axis, column in columns}
    return found


def _write_csv(result: Result, path: Path) -> None:
    columns = {"time [s]": result.time, **_columns(result)}
    with replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def _write_vtkhdf(result: Result, path: Path) -> None:
    import h5py

    net = result.net
    with replacing(path) as part, h5py.File(part, "w", libver=("v110", "v110")) as file:
        root = file.create_group("VTKHDF", track_order=True)
        _describe(root, "PartitionedDataSetCollection")
        assembly = root.create_group("Assembly", track_order=True)

        def block(name: str, cells: Mapping[str, Ints], n_points: int, *, moves: bool = True) -> h5py.Group:
            """Add a part of the scene, without its points; moves : these differ from time to time."""
            plain = name = "".join(letter if letter.isalnum() else "_" for letter in name)
            while name in assembly:  # names that differ in other letters only
                name = f"{plain}_{len(assembly)}"
            group = root.create_group(name)
            group.attrs["Index"] = len(assembly)
            assembly[name] = h5py.SoftLink(f"/VTKHDF/{name}")
            _describe(group, "PolyData")
            _topology(group, cells, n_points if moves else 0, result.time)
            group["NumberOfPoints"] = np.array([n_points])
            return group

        group = block("net", {"Lines": net.element_nodes}, net.n_nodes)
        _copy(group, "Points", result.position.shape, lambda a, b: result.position[a:b])
        cells = group.create_group("CellData")
        _copy(cells, "tension", result.tension.shape, lambda a, b: result.tension[a:b])
        broken = np.full(net.n_elements, np.inf)
        for element, when in broken_at(result).items():
            broken[element] = when
        size = (len(result.time), net.n_elements)
        _copy(cells, "broken", size, lambda a, b: np.asarray(result.time[a:b])[:, None] >= broken, "u1")
        points = group.create_group("PointData")
        _copy(points, "velocity", result.velocity.shape, lambda a, b: result.velocity[a:b])
        threads = np.zeros(net.n_elements, dtype="<i8")
        for k, own in enumerate(net.groups.values()):
            threads[own.start : own.stop] = k
        cells["group"] = threads  # 0: net; 1 and on: tethers
        sizes = {"tension": net.n_elements, "broken": net.n_elements, "group": 0}
        _offsets(group, "CellData", sizes, len(result.time))
        _offsets(group, "PointData", {"velocity": net.n_nodes}, len(result.time))

        if result.run.closing_path:
            nodes = np.array(result.run.closing_path)
            pieces = np.stack([np.arange(len(nodes) - 1), np.arange(1, len(nodes))], axis=1)
            group = block("closing_line", {"Lines": pieces}, len(nodes))
            shape = (len(result.time), len(nodes), 3)
            _copy(group, "Points", shape, lambda a, b: np.asarray(result.position[a:b])[:, nodes])
            ends = [
                np.asarray(result.states[f"{LINE}tension_{end}"].values[:])[:, 0] for end in ("start", "end")
            ]
            along = np.linspace(ends[0], ends[1], len(pieces), axis=1)
            group.create_group("CellData")["tension"] = along.ravel()
            _offsets(group, "CellData", {"tension": len(pieces)}, len(result.time))

        for name, shape_of in rounded_shapes(result).items():
            mesh, body = surface_shown(shape_of), result.bodies[name]
            poses = np.concatenate([body.position[:], np.asarray(body.attitude)], axis=1)
            moves = bool(np.ptp(poses, axis=0).any())
            group = block(f"body_{name}", {"Polygons": mesh.triangles}, len(mesh.vertices), moves=moves)

            def corners(a: int, b: int, mesh: Any = mesh, body: Any = body) -> Floats:
                turns = rotation_matrix(np.asarray(body.attitude[a:b]))
                centre = np.asarray(body.position[a:b])[:, None]
                return np.asarray(mesh.vertices @ turns.swapaxes(1, 2) + centre)

            _copy(group, "Points", (len(result.time) if moves else 1, len(mesh.vertices), 3), corners)


def _describe(group: h5py.Group, kind: str) -> None:
    import h5py

    group.attrs["Version"] = FORMAT
    group.attrs.create("Type", kind.encode(), dtype=h5py.string_dtype("ascii", len(kind)))


def _copy(group: h5py.Group, name: str, shape: tuple[int, ...], rows: Rows, kind: str = "<f8") -> None:
    """Write values (times, n, ...) for each time one after another."""
    flat, n = (shape[0] * shape[1], *shape[2:]), shape[1]
    if not flat[0]:  # of no cells: chunks must not be larger than the data
        group.create_dataset(name, flat, kind)
        return
    data = group.create_dataset(
        name, flat, kind, chunks=(n, *shape[2:]), compression="gzip", compression_opts=1, shuffle=True
    )
    for first, last in row_ranges(shape[0], _BLOCK):
        data[first * shape[1] : last * shape[1]] = rows(first, last).reshape(-1, *shape[2:])


def _topology(group: h5py.Group, cells: Mapping[str, Ints], further: int, time: Floats) -> None:
    """Write cells, once, and the steps: the points of each stand `further` than those before."""
    steps, count = group.create_group("Steps"), len(time)
    none = np.zeros(count, dtype="<i8")
    steps.attrs["NSteps"] = count
    steps["Values"] = time
    steps["PartOffsets"] = none
    steps["NumberOfParts"] = none + 1
    steps["PointOffsets"] = np.arange(count, dtype="<i8") * further
    steps["CellOffsets"] = steps["ConnectivityIdOffsets"] = np.zeros((count, len(_CELLS)), dtype="<i8")
    for kind in _CELLS:
        own = cells.get(kind, np.zeros((0, 1), dtype=np.int64))
        part = group.create_group(kind)
        part["NumberOfCells"], part["NumberOfConnectivityIds"] = np.array([len(own)]), np.array([own.size])
        part["Connectivity"] = own.ravel().astype("<i8")
        part["Offsets"] = np.arange(len(own) + 1, dtype="<i8") * own.shape[1]


def _offsets(group: h5py.Group, data: str, sizes: Mapping[str, int], count: int) -> None:
    """Write where the values of each step begin; size 0: they do not change."""
    offsets = group["Steps"].create_group(f"{data}Offsets")
    for name, size in sizes.items():
        offsets[name] = np.arange(count, dtype="<i8") * size

"""Reads `[bodies.NAME]`: what a body is made of, or its mass and inertia, and how it starts."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from reference_impl import solids
from reference_impl.arrays import Floats
from reference_impl.bodies import Body, driven, rotation, turn
from reference_impl.case import Attachment
from reference_impl.drive import Poses
from reference_impl.effects.values import one_of
from reference_impl.mesh_files import triangles
from reference_impl.read_ties import read_attachments
from reference_impl.solids import Solid
from reference_impl.surface import enclosed
from reference_impl.table import Table, number, numbers, one_of_names, refusal, text, triples

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_PLATE = 1e-12  # round-off in the moments of a flat body, the greatest of which is the sum of the others
_NEEDLE = 1e-14  # least over greatest principal moment that a full matrix still holds
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}  # [m]
_HALF = 0.5 * (1.0 + 1e-12)
_HALF_TURN = -1.0 + (1e-6) ** 2  # trace 1 + 2 cos of a rotation that is 1e-6 rad less than half a turn


def read_bodies(
    table: Table, end: float | None, folder: Path
) -> tuple[tuple[Body, ...], tuple[Attachment, ...]]:
    """Reads and closes the table `[bodies]`: the bodies, and the nodes that are points of them.

    `end` [s] of the scene, if it is known; files of shapes are relative to `folder`.  A body with faults is
    one of no mass, so that nobody who names it is told that it is not there.
    """
    attached: list[Attachment] = []
    with np.errstate(all="ignore"):  # what leaves the range of numbers is a fault, found in `_mass`
        bodies = [
            _body(table.table(name, required=False), name, attached, end, folder) or Body(name, 0.0)
            for name in table.values
        ]
    table.close()
    return tuple(bodies), tuple(attached)


def _body(
    table: Table, name: str, attached: list[Attachment], end: float | None, folder: Path
) -> Body | None:
    """One body; None with faults noted where it cannot be read.  Its attachments are added to `attached`."""
    before = len(table.faults)
    _check_name(table, name)
    if not table:
        return None
    solid, shaped, rounding = _material(table, folder)
    made = _mass(table, solid, shaped)
    attitude = read_attitude(table)
    position, velocity, spin = (
        table.get(key, numbers(3), (0.0, 0.0, 0.0)) for key in ("position", "velocity", "angular_velocity")
    )
    motion = table.get("motion", text, "free")
    poses = _poses(table, motion, end, attitude)
    of_scene = table.get("angular_velocity_frame", _frame, "body") == "scene"
    attached += read_attachments(table.table("attachments", required=False), name)
    table.close()
    if len(table.faults) > before or made is None or attitude is None:
        return None
    turning = attitude.T @ spin if of_scene else np.array(spin)
    start = (np.array(position), np.array(velocity), attitude, turning)
    blocks = () if solid is None else solid.blocks
    body = Body(name, *made, *start, blocks=blocks, edge_radius=rounding)
    return body if motion == "free" else driven(body, poses)


_STARTS = {  # what each list of poses replaces
    "pose_positions": ("position", "velocity", "angular_velocity", "angular_velocity_frame"),
    "pose_attitudes": ("attitude", "axis", "angle"),
}
_POSES = ("pose_times", "pose_positions", "pose_attitudes")


def _poses(table: Table, motion: str | None, end: float | None, attitude: Floats | None) -> Poses | None:
    """The table of poses; None where there is none, or with faults noted.

    Without `pose_attitudes` the body keeps `attitude` (3, 3), its own at time 0.
    """
    if motion not in ("free", "fixed", "prescribed", None):
        table.faults.append(
            refusal(f'{table.name("motion")} = "{motion}"', "it knows free, fixed, prescribed")
        )
    if motion == "fixed":
        for key in ("velocity", "angular_velocity"):
            if key in table.values and any(table.get(key, numbers(3), None) or ()):
                table.faults.append(f"{table.name(key)}: a fixed body rests at its start")
    given = [key for key in _POSES if key in table.values]
    if not given or motion != "prescribed":
        table.seen.update(given)
        table.faults += [f'{table.name(key)}: only with motion = "prescribed"' for key in given]
        return None
    table.faults += [
        f"{table.name(key)}: leave it out, {table.name(poses)} are in its place"
        for poses, keys in _STARTS.items()
        for key in keys
        if key in table.values and (poses == "pose_positions" or poses in given)
    ]
    times, positions = table.need("pose_times", numbers(None)), table.need("pose_positions", triples)
    attitudes = table.get("pose_attitudes", _quaternions, None)
    if times is None or positions is None or (attitudes is None and "pose_attitudes" in table.values):
        return None
    faults = len(table.faults)
    if len(times) < 2 or any(b <= a for a, b in pairwise(times)):
        table.faults.append(f"{table.name('pose_times')}: must be at least two times that increase")
    elif times[0] > 0.0 or (end is not None and times[-1] < end):
        table.faults.append(f"{table.name('pose_times')}: must go from 0 or before to time.end or later")
    for key, rows in (("pose_positions", positions), ("pose_attitudes", attitudes)):
        if rows is not None and len(rows) != len(times):
            table.faults.append(f"{table.name(key)}: {len(rows)} entries for {len(times)} times")
    for before, after in pairwise(attitudes or ()):
        if np.trace(before.T @ after) < _HALF_TURN:
            table.faults.append(
                f"{table.name('pose_attitudes')}: neighbours are half a turn apart: no way is the shorter"
            )
            break
    if len(table.faults) > faults:
        return None
    if attitudes is None:
        return None if attitude is None else Poses(times, positions, np.tile(attitude, (len(times), 1, 1)))
    return Poses(times, positions, np.array(attitudes))


def _quaternions(value: Any) -> tuple[Floats, ...]:
    """Reads a list of quaternions, as rotation matrices."""
    if not isinstance(value, list):
        raise ValueError("must be a list of [w, x, y, z]")
    rows = [numbers(4)(v) for v in value]
    if not all(any(row) for row in rows):
        raise ValueError("must not be zero")
    return tuple(rotation(row) for row in rows)


def _material(table: Table, folder: Path) -> tuple[Solid | None, bool, float]:
    """The solid of `shape` or `parts`, None if there is none or it is faulty; whether the keys are there.

    And the rounding of its edges [m].
    """
    kinds = [key for key in ("shape", "parts") if key in table.values]
    solid = None
    if len(kinds) == 2:
        table.faults.append(f"{table.path}: give either {' or '.join(map(table.name, kinds))}, not both")
        table.ignore_rest()
    elif kinds == ["shape"]:
        solid = _mesh(table, folder) if table.values["shape"] == "mesh" else _shape(table, "mesh")
    elif kinds:
        solid = _parts(table.table("parts", required=False))
    rounding = table.get("edge_radius", number(0.0), None)
    if "edge_radius" in table.values and not kinds:
        table.faults.append(f"{table.name('edge_radius')}: needs {_a_shape(table)}")
    elif rounding is not None and solid is not None and rounding > _HALF * solid.extent:
        at_most = f"at most half of the smallest dimension, {0.5 * solid.extent:.10g}"
        table.faults.append(f"{table.name('edge_radius')}: must be {at_most}, not {rounding:.10g}")
    return solid, bool(kinds), rounding or 0.0


def _mesh(table: Table, folder: Path) -> Solid | None:
    """The solid inside the surface in a file; None with faults noted."""
    table.need("shape", text)
    file, unit = table.need("file", text), table.need("unit", one_of_names(*_UNITS))
    table.get("grid_spacing", number(above=0.0), None)  # for contact with it, which is refused
    if file is None or unit is None:
        return None
    try:
        return enclosed(_UNITS[unit] * triangles(folder / file))
    except ValueError as error:
        table.faults.append(f"{table.name('file')}: {error}")
        return None


def _shape(table: Table, *others: str) -> Solid | None:
    """The solid of a table with `shape` and its keys; None with faults noted.  `others`: known elsewhere."""
    length, size, both = number(above=0.0), numbers(3, above=0.0), numbers(2, minimum=0.0)
    known: dict[str, tuple[Callable[..., Solid], dict[str, Callable[[Any], Any]]]] = {
        "box": (solids.box, {"size": size}),
        "cylinder": (solids.cylinder, {"radius": length, "length": length}),
        "sphere": (solids.sphere, {"radius": length}),
        "capsule": (solids.capsule, {"radius": length, "length": length}),
        "frustum": (solids.frustum, {"radii": both, "length": length}),
    }
    kind = table.need("shape", text)
    if kind not in known:
        if kind is not None:
            table.faults.append(
                refusal(f'{table.name("shape")} = "{kind}"', "it knows " + ", ".join((*known, *others)))
            )
        table.ignore_rest()
        return None
    make, keys = known[kind]
    values = {key: table.need(key, convert) for key, convert in keys.items()}
    if values.get("radii") == (0.0, 0.0):
        table.faults.append(f"{table.name('radii')}: must not both be 0")
        return None
    return None if None in values.values() else make(**values)


def _parts(parts: Table) -> Solid | None:
    """The solids of a compound, each in its place; None with faults noted."""
    if not parts:
        return None
    if not parts.values:
        parts.faults.append(f"{parts.path}: must have at least one part")
    placed = [_part(parts.table(name, required=False), name) for name in parts.values]
    whole = [part for part in placed if part is not None]
    return solids.union(whole) if whole and len(whole) == len(placed) else None


def _part(table: Table, name: str) -> Solid | None:
    _check_name(table, name)
    if not table:
        return None
    solid, attitude = _shape(table), read_attitude(table)
    position = table.get("position", numbers(3), (0.0, 0.0, 0.0))
    table.close()
    if solid is None or attitude is None or position is None:
        return None
    return solid.moved(attitude, np.array(position))


def _mass(table: Table, solid: Solid | None, shaped: bool) -> tuple[float, Floats, Floats] | None:
    """Mass [kg], matrix of inertia (3, 3) [kg m2] and centre of mass (3,) [m]; None with faults noted.

    Inertia and centre of mass are those of the evenly filled solid unless they are given.
    """
    given = one_of(table, {"mass": number(above=0.0), "density": number(above=0.0)})
    moments = numbers(3, above=0.0)
    diagonal = table.get("inertia", moments, None) if shaped else table.need("inertia", moments)
    products = table.get("products_of_inertia", numbers(3), (0.0, 0.0, 0.0))
    centre = table.get("centre_of_mass", numbers(3), None if shaped else (0.0, 0.0, 0.0))
    if "density" in table.values and not shaped:
        table.faults.append(f"{table.name('density')}: needs {_a_shape(table)}")
    for key in ("products_of_inertia", "centre_of_mass"):
        if key in table.values and "inertia" not in table.values and shaped:
            table.faults.append(f"{table.name(key)}: needs {table.name('inertia')}")
    inertia = None if diagonal is None or products is None else _given(table, diagonal, products)
    mass = given["mass"]
    if solid is not None:
        volume, centroid, over_mass = solids.moments(solid)
        if given["density"] is not None:
            mass = given["density"] * volume
        if "inertia" not in table.values:
            inertia = over_mass * (1.0 if mass is None else mass)
        if "centre_of_mass" not in table.values:
            centre = centroid
    if mass is None or inertia is None or centre is None:
        return None
    if not (0.0 < mass < math.inf and _holds(inertia) and np.all(np.isfinite(centre))):
        table.faults.append(f"{table.path}: mass and inertia of its shape leave the range of numbers")
        return None
    return mass, inertia, np.array(centre)


def _given(table: Table, diagonal: tuple[float, ...], products: tuple[float, ...]) -> Floats | None:
    """The matrix of inertia (3, 3) of a body that can exist; None with a fault noted.

    Some mass has these moments if no principal one is above the sum of the two others; the diagonal obeys
    the same rule in any axes.
    """
    if math.fsum(moment / max(diagonal) for moment in diagonal) * (1.0 + _PLATE) < 2.0:
        table.faults.append(f"{table.name('inertia')}: no moment may be above the sum of the two others")
        return None
    xy, xz, yz = products
    inertia = np.diag(diagonal) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
    if any(products):
        largest = np.max(np.abs(inertia))
        parts = np.linalg.eigvalsh(inertia / largest)  # so that none of them, nor their sum, is infinite
        if not (_holds(inertia) and 2.0 * parts[2] <= np.sum(parts) * (1.0 + _PLATE)):
            found = ", ".join(f"{largest * part:.6g}" for part in parts)
            table.faults.append(
                f"{table.name('products_of_inertia')}: no body has principal moments of {found}: all must be "
                "above 0 and none above the sum of the two others"
            )
            return None
    return inertia


def _holds(inertia: Floats) -> bool:
    """Whether a matrix of inertia (3, 3) is finite and positive, and tells its least moment from zero."""
    if not np.all(np.isfinite(inertia)):
        return False
    if not np.any(inertia - np.diag(np.diag(inertia))):
        return bool(np.all(np.diag(inertia) > 0.0))
    principal = np.linalg.eigvalsh(inertia / np.max(np.abs(inertia)))
    return bool(principal[0] > _NEEDLE * principal[2])


def read_attitude(table: Table) -> Floats | None:
    """Rotation matrix (3, 3) of `attitude`, or of `axis` and `angle`; None with faults noted."""
    about = [key for key in ("axis", "angle") if key in table.values]
    quaternion = table.get("attitude", numbers(4), (1.0, 0.0, 0.0, 0.0))
    axis = table.need("axis", numbers(3)) if about else None
    angle = table.need("angle", number()) if about else None
    for key, value in (("attitude", quaternion), ("axis", axis)):
        if value is not None and not any(value):
            table.faults.append(f"{table.name(key)}: must not be zero")
            return None
    if about and "attitude" in table.values:
        turned = " and ".join(map(table.name, about))
        table.faults.append(f"{table.path}: give either {table.name('attitude')} or {turned}, not both")
        return None
    if not about:
        return None if quaternion is None else rotation(quaternion)
    if axis is None or angle is None:
        return None
    scaled = np.array(axis) / max(map(abs, axis))
    return turn(scaled / np.linalg.norm(scaled), angle)


def _check_name(table: Table, name: str) -> None:
    if not _NAME.fullmatch(name):
        table.faults.append(f"{table.path}: the name must be of letters, digits, _ and -")


def _a_shape(table: Table) -> str:
    return f"{table.name('shape')} or {table.name('parts')}"


def _frame(value: Any) -> str:
    """Reads a name of the axes of an angular velocity."""
    if value not in ("body", "scene"):
        raise ValueError(f'must be "body" or "scene", not {value!r}')
    return str(value)

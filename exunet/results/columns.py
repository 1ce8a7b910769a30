"""What is stored of each state: the columns of a system, by their place in the result file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.bodies.shape_arrays import WIDTH, unpacked

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """One quantity of float64 values, stored once for each state.

    path        : of its dataset, such as "net/position"
    row         : shape of its values for one state, such as (n_nodes, 3); () for a single number
    units       : of its values, "1" if they have none
    description : in a few words
    """

    path: str
    row: tuple[int, ...]
    units: str
    description: str

    @property
    def row_bytes(self) -> int:
        """Size of the values for one state."""
        return 8 * math.prod(self.row)


@dataclass(frozen=True)
class BodyConstants:
    """What does not change of a body.

    mass      : [kg]
    inertia   : (3, 3) about the centre of mass, in body axes [kg m2]; None: a point mass
    nodes     : (m,) nodes of the net and of tethers that are fixed to it; None: none
    solids, vertices, triangles : its shape, as of `exunet.bodies.shape_arrays`; None: it has no such
    """

    mass: float
    inertia: Floats | None = None
    nodes: NDArray[np.int64] | None = None
    solids: Floats | None = None
    vertices: Floats | None = None
    triangles: NDArray[np.int64] | None = None

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Those of its values that are arrays, by name."""
        return {name: values for name in CONSTANTS if (values := getattr(self, name)) is not None}


class Constant(NamedTuple):
    """An array of `BodyConstants`: shape (None: any number), units, description, type."""

    shape: tuple[int | None, ...]
    units: str
    description: str
    dtype: str = "<f8"


CONSTANTS = {
    "inertia": Constant((3, 3), "kg m2", "inertia about the centre of mass, in body axes"),
    "nodes": Constant((None,), "1", "nodes of the net and of tethers that are fixed to the body", "<i8"),
    "solids": Constant(
        (None, WIDTH),
        "1",
        "solids of the shape: kind (0 box, 1 cylinder, 2 sphere, 3 capsule, 4 frustum), three dimensions "
        "[m], place from the centre of mass [m] and quaternion (w, x, y, z), in body axes",
    ),
    "vertices": Constant((None, 3), "m", "of the mesh, from the centre of mass, in body axes"),
    "triangles": Constant((None, 3), "1", "vertices of the mesh's triangles, from 0", "<i8"),
}


def body_constants(mass: float, arrays: Mapping[str, Any]) -> BodyConstants:
    """From what a file has of them. Raises ValueError if these are not finite numbers of these shapes."""
    if not np.isfinite(mass):
        raise ValueError("mass contains NaN or infinity")
    for name, values in arrays.items():
        shape, kind = CONSTANTS[name].shape, np.dtype(CONSTANTS[name].dtype).kind
        fits = values.ndim == len(shape) and all(
            want in (None, size) for want, size in zip(shape, values.shape, strict=True)
        )
        if not fits or values.dtype.kind != kind or not np.all(np.isfinite(values)):
            words = " x ".join("k" if size is None else str(size) for size in shape)
            raise ValueError(f"{name} is not an array of {words} finite numbers")
    unpacked(*(arrays.get(name) for name in ("solids", "vertices", "triangles")))
    return BodyConstants(mass, **arrays)


# Attribute of a Result: path, shape of a row (n nodes, e elements), units, description.
_STATES: dict[str, tuple[str, str, str, str]] = {
    "time": ("time", "", "s", "stored times"),
    "position": ("net/position", "n3", "m", "node positions"),
    "velocity": ("net/velocity", "n3", "m/s", "node velocities"),
    "strain": ("net/strain", "e", "1", "Green-Lagrange strain of each element, negative when slack"),
    "tension": ("net/tension", "e", "N", "axial force in each element, zero when slack"),
    "kinetic": ("energy/kinetic", "", "J", "kinetic energy"),
    "elastic": ("energy/elastic", "", "J", "elastic energy of the cables"),
    "potential": (
        "energy/potential",
        "",
        "J",
        "potential energy of contact, loads, fields, launching springs, outlets of reels and a closing line",
    ),
    "dissipated": ("energy/dissipated", "", "J", "energy taken out since the start, less what is put in"),
    "momentum": ("momentum/linear", "3", "kg m/s", "linear momentum"),
    "angular_momentum": ("momentum/angular", "3", "kg m2/s", "angular momentum about the scene's origin"),
    "largest_elastic": (
        "energy/largest_elastic",
        "",
        "J",
        "largest elastic energy of the steps since the stored time before",
    ),
    "least_kinetic": (
        "energy/least_kinetic",
        "",
        "J",
        "least kinetic energy of the steps since the stored time before",
    ),
}

PATHS = {name: path for name, (path, *_) in _STATES.items()}  # by the attribute of Result
OPTIONAL = frozenset({"largest_elastic", "least_kinetic"})  # of runs only

_BODY: dict[str, tuple[int, str, str]] = {
    "position": (3, "m", "position of the centre of mass"),
    "velocity": (3, "m/s", "velocity of the centre of mass"),
}
_RIGID: dict[str, tuple[int, str, str]] = {
    "attitude": (4, "1", "unit quaternion (w, x, y, z) that turns body axes into the scene's axes"),
    "angular_velocity": (3, "rad/s", "angular velocity in body axes"),
}


def declare(n_nodes: int, n_elements: int, bodies: Mapping[str, BodyConstants]) -> tuple[Column, ...]:
    """The columns of a system of a net and `bodies` by name; raises InputError for an impossible name."""
    sizes = {"n": n_nodes, "e": n_elements, "3": 3}
    columns = [
        Column(path, tuple(sizes[axis] for axis in row), units, description)
        for path, row, units, description in _STATES.values()
    ]
    for name, body in bodies.items():
        if not name or "/" in name or name == ".":
            raise InputError(f"{name!r} cannot be the name of a body in a result file")
        columns += [
            Column(body_path(name, quantity), (size,), units, description)
            for quantity, (size, units, description) in body_quantities(body).items()
        ]
    return tuple(columns)


STATES = "states/"  # what is stored of terms stands there, by the name of term and quantity


KEPT = {  # by their quantities
    "impulse": "impulse given to all else since the start, in the scene's axes",
    "angular_impulse": "angular impulse given to all else since the start, about the scene's origin",
    "work": "work done since the start",
    "wound_up": "length that is wound up",
    "spent": "impulse that each of the corner units has spent since the start",
    "friction": "energy that friction has taken since the start",
    "elastic": "elastic energy",
    "tension_start": "tension at the start of the line",
    "tension_end": "tension at the end of the line",
    "way": "length of the line's way through its rings",
    "largest": "largest tension of all steps so far",
    "largest_time": "when the tension was largest so far",
    "load": "largest tension so far over the strength",
}
_OF_CONTACT = {
    "touching": "how many {}s touch the body",
    "force": "sum of the forces between {}s and the body, across its surface",
    "resultant": "resultant of the forces of {}s on the body, in the scene's axes",
    "torque": "torque of the forces of {}s about the body's centre of mass, in its axes",
    "stored": "energy stored between {}s and the body",
    "first": "when a {} first touched the body; -1 until then",
    "deepest": "largest depth of a {} in the body so far, surface in surface",
}
KEPT |= {
    f"{what}s_{name}": words.format(what)
    for what in ("thread", "node", "bullet")
    for name, words in _OF_CONTACT.items()
}


def state_column(name: str, size: int, units: str) -> Column:
    """The column of first-order states of a term; name: "term/quantity"."""
    words = KEPT.get(name.rpartition("/")[2], "first-order states of a force")
    return Column(STATES + name, (size,), units, words)


def body_path(name: str, quantity: str) -> str:
    """Path of a quantity of a body."""
    return f"bodies/{name}/{quantity}"


def body_quantities(body: BodyConstants) -> dict[str, tuple[int, str, str]]:
    """Number of values, units and description of each quantity that is stored of a body."""
    return _BODY if body.inertia is None else _BODY | _RIGID

"""The result of a run: its columns, arrays over the stored times, and how they were found."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, MissingExtra
from exunet.bodies.shapes import WIDTH, unpacked
from exunet.forces.contact.status import ContactKey
from exunet.net.arrays import Net
from exunet.results.run_record import Recorded, RunRecord

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class Column:
    """One quantity of float64 values, stored once for each state.

    path        : of its dataset, such as "net/position"
    row         : shape of its values for one state, such as (n_nodes, 3); () for a single number
    units       : of its values, "1" if they have none
    description : in a few words
    key         : of a series of a contact
    """

    path: str
    row: tuple[int, ...]
    units: str
    description: str
    key: ContactKey | None = None

    @property
    def row_bytes(self) -> int:
        """Size of the values for one state."""
        return 8 * math.prod(self.row)


@dataclass(frozen=True)
class BodyConstants:
    """Constant properties of a body.

    mass      : [kg]
    inertia   : (3, 3) about the centre of mass, in body axes [kg m2]
    nodes     : (m,) nodes of the net and of tethers that are fixed to it; None: none
    solids, vertices, triangles : its shape, as of `exunet.bodies.shapes`; None: it has no such
    """

    mass: float
    inertia: Floats
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
    if "inertia" not in arrays:
        raise ValueError("inertia is absent")
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

# Number of values, units and description of each quantity that is stored of a body.
BODY_QUANTITIES: dict[str, tuple[int, str, str]] = {
    "position": (3, "m", "position of the centre of mass"),
    "velocity": (3, "m/s", "velocity of the centre of mass"),
    "attitude": (4, "1", "unit quaternion (w, x, y, z) that turns body axes into the scene's axes"),
    "angular_velocity": (3, "rad/s", "angular velocity in body axes"),
}


def declare(n_nodes: int, n_elements: int, bodies: Iterable[str]) -> tuple[Column, ...]:
    """The columns of a system of a net and `bodies` by name; raises InputError for an impossible name."""
    sizes = {"n": n_nodes, "e": n_elements, "3": 3}
    columns = [
        Column(path, tuple(sizes[axis] for axis in row), units, description)
        for path, row, units, description in _STATES.values()
    ]
    for name in bodies:
        if not name or "/" in name or name == ".":
            raise InputError(f"{name!r} cannot be the name of a body in a result file")
        columns += [
            Column(body_path(name, quantity), (size,), units, description)
            for quantity, (size, units, description) in BODY_QUANTITIES.items()
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
    "touching": "number of contacts of {} with the body",
    "force": "sum of the forces between {} and the body, across its surface",
    "resultant": "resultant of the forces of {} on the body, in the scene's axes",
    "torque": "torque of the forces of {} about the body's centre of mass, in its axes",
    "stored": "energy stored between {} and the body",
    "first": "time of the first contact of {} with the body; -1 until then",
    "deepest": "largest penetration of {} in the body so far, surface in surface",
}


def state_column(key: Hashable, size: int, units: str) -> Column:
    """Return the column of a series of a contact, or of states of a term by "term/quantity"."""
    path = f"{STATES}{key}"
    if isinstance(key, ContactKey):
        return Column(path, (size,), units, _OF_CONTACT[key.quantity].format(key.other), key)
    return Column(path, (size,), units, KEPT.get(path.rpartition("/")[2], "first-order states of a force"))


def body_path(name: str, quantity: str) -> str:
    """Path of a quantity of a body."""
    return f"bodies/{name}/{quantity}"


BLOCK_BYTES = 16 << 20  # of an array that is processed in one piece


class StoredRows(NDArrayOperatorsMixin):
    """An array over the stored times that stays in a file, and is read when it is used.

    Rows are chosen as in an array: `states[7]`, `states[100:200]`, `states[rows, 3]`; only those are read.
    Anything else, such as `states.max()` or `states - 1`, reads the whole into memory first.

    read  : returns rows start to stop (not included) as an array
    shape : as of an array
    """

    def __init__(self, read: Callable[[int, int], Floats], shape: tuple[int, ...]) -> None:
        self._read = read
        self.shape, self.ndim, self.dtype = shape, len(shape), np.dtype(np.float64)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> Any:
        first, *others = key if isinstance(key, tuple) else (key,)
        if isinstance(first, slice):
            start, stop, step = first.indices(len(self))
            if step > 0:
                return self._read(start, max(start, stop))[(slice(None, None, step), *others)]
        elif first is not Ellipsis and first is not None:
            chosen = np.arange(len(self))[first]
            low, high = int(chosen.min(initial=len(self))), int(chosen.max(initial=-1)) + 1
            if high - low <= 4 * chosen.size:  # in one piece
                return self._read(low, max(low, high))[(chosen - low, *others)]
            return np.concatenate([self._read(k, k + 1) for k in chosen.tolist()])[
                (np.arange(chosen.size), *others)
            ]
        return np.asarray(self)[key]

    def __iter__(self) -> Iterator[Floats]:
        for block in blocks(self):
            yield from block

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self._read(0, len(self)), dtype=dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        whole = [np.asarray(values) if isinstance(values, StoredRows) else values for values in inputs]
        return getattr(ufunc, method)(*whole, **options)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)


def blocks(values: Any) -> Iterator[Floats]:
    """Yield consecutive rows of an array or of StoredRows, as arrays of at most 16 MB (or one row)."""
    per_row = 8 * int(np.prod(values.shape[1:], dtype=np.int64))
    yield from (values[a:b] for a, b in row_ranges(len(values), max(1, BLOCK_BYTES // max(1, per_row))))


def row_ranges(count: int, size: int) -> Iterator[tuple[int, int]]:
    """Yield start and stop of consecutive groups of at most `size` rows; one empty group for no rows."""
    for start in range(0, max(1, count), size):
        yield start, min(start + size, count)


def over_blocks(measure: Callable[[Floats], Floats], values: Any) -> Floats:
    """Apply `measure` to the rows of `values`, block by block."""
    return np.concatenate([measure(block) for block in blocks(values)])


def table(name: str, index: NDArray[Any], columns: Mapping[str, NDArray[Any]]) -> DataFrame:
    """Return a pandas table with a named index (n,) and named columns (n,); MissingExtra without pandas."""
    try:
        from pandas import DataFrame, Index
    except ImportError:
        raise MissingExtra("a table of a result needs pandas: pip install 'exunet[pandas]'") from None
    return DataFrame(dict(columns), index=Index(index, name=name))


@dataclass(frozen=True, repr=False)
class BodyStates(ShortRepr):
    """The motion of one body over the stored times.

    mass             : [kg]
    inertia          : (3, 3) [kg m2] about the centre of mass, in body axes
    position         : (n_times, 3) [m], of the centre of mass
    velocity         : (n_times, 3) [m/s]
    attitude         : (n_times, 4) unit quaternion (w, x, y, z) that turns body axes into the scene's axes
    angular_velocity : (n_times, 3) [rad/s], in body axes
    nodes            : (m,) nodes of the net and of tethers that are fixed to it; None: none
    solids           : (k, 11) the solids of its shape: number of the kind (0 box, 1 cylinder, 2 sphere,
                       3 capsule, 4 frustum), three dimensions as in the case [m], place from the centre of
                       mass [m], unit quaternion (w, x, y, z), in body axes; None: it has none
    vertices, triangles : (n, 3) from the centre of mass, in body axes [m], and (m, 3) of a shape that is a
                       mesh; None: not a mesh
    """

    mass: float
    inertia: Floats
    position: Floats
    velocity: Floats
    attitude: Floats
    angular_velocity: Floats
    nodes: NDArray[np.int64] | None = None
    solids: Floats | None = None
    vertices: Floats | None = None
    triangles: NDArray[np.int64] | None = None


@dataclass(frozen=True, repr=False)
class TermStates(ShortRepr):
    """Stored states of a force at the stored times: values (n_times, m), and their units."""

    units: str
    values: Floats

    def __getitem__(self, rows: Any) -> Any:
        """Return the values at stored times, as `values[rows]`."""
        return self.values[rows]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.asarray(self.values[:], dtype=dtype)


@dataclass(frozen=True, repr=False)
class Result(ShortRepr, Recorded):
    """States and energies of a system over the stored times.

    Of a large file or store (see `exunet.results.io`) all arrays but `time` are
    `StoredRows`, which are read when they are used.

    net              : the net in its reference configuration
    time             : (n_times,) [s]
    position         : (n_times, n_nodes, 3) [m]
    velocity         : (n_times, n_nodes, 3) [m/s]
    strain           : (n_times, n_elements) Green-Lagrange strain E11, eq. (6); negative when slack
    tension          : (n_times, n_elements) axial force [N], zero when slack
    kinetic          : (n_times,) [J], eq. (18)
    elastic          : (n_times,) [J], eq. (19)
    potential        : (n_times,) [J], of constant loads such as gravity
    dissipated       : (n_times,) [J], energy that forces without a potential have taken out since t = 0, less
                       the work that they, drums, an ejection, and bodies whose motion is given have put in
    momentum         : (n_times, 3) [kg m/s]
    angular_momentum : (n_times, 3) [kg m2/s], about the origin
    run              : record of the run: verdict, case, plan, cost, largest tensions, events
    largest_elastic  : (n_times,) [J], largest over all steps since the stored time before, which counts too;
                       None: not a result of a run
    least_kinetic    : (n_times,) [J], the same for the least kinetic energy
    bodies           : the bodies beside the net, by name
    states           : first-order states of forces, and what is stored of what they remember, by
                       "term/quantity"
    contacts         : series of contacts, by body, what touches it, and quantity
    ensemble_file      : of a result that was read: perturbed runs, beside its file; None: no such file
    """

    net: Net
    time: Floats
    position: Floats
    velocity: Floats
    strain: Floats
    tension: Floats
    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats
    momentum: Floats
    angular_momentum: Floats
    run: RunRecord = field(default_factory=RunRecord)
    largest_elastic: Floats | None = None
    least_kinetic: Floats | None = None
    bodies: Mapping[str, BodyStates] = field(default_factory=dict)
    states: Mapping[str, TermStates] = field(default_factory=dict)
    contacts: Mapping[ContactKey, TermStates] = field(default_factory=dict)
    ensemble_file: Path | None = None

"""Kernel: the compiled functions of force terms, and the data that they work on.

A `KernelCall` becomes a module of its own with an entry for each of its functions; the types of its data are
the same in all scenes, so no scene compiles a force that another had. `exunet.kernels.source` calls them.
"""

from __future__ import annotations

import inspect
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import IntEnum
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.cable_term import CableTerm
from exunet.forces.terms import (
    ARGUMENTS,
    Constraint,
    DiscreteStates,
    Function,
    KernelCall,
    KernelTerm,
    Term,
    copied,
    leaves,
)
from exunet.kernels.compile import (
    BY_ADDRESS,
    INSIDE,
    SELDOM,
    WIDTH,
    compiled_module,
    interpreted_module,
    kept_before,
    numba_installed,
)
from exunet.kernels.source import DRIVERS, HELPERS, module_source

FUNCTIONS = ("place", "add", "potential", "power", "work", "verlet_work", "remember", "event", "shorten")


def call_source(call: KernelCall, *, lanes: bool) -> str:
    """Text of the module of one kind of force, from the text of its functions.

    lanes : for states of vectors of runs (see `exunet.kernels.lanes`)
    """
    own = {name: function for name in FUNCTIONS if (function := getattr(call, name)) is not None}
    texts = [_text(function) for function in dict.fromkeys((*call.helpers, *own.values()))]
    for name, function in own.items():
        given = passed = ", ".join(ARGUMENTS[name])
        if name == "work":  # whose states come one by one
            given, passed = "h, x0, v0, x1, v1, data", "h, (x0, v0), (x1, v1), data"
        gives = name not in ("place", "add", "remember") or (name == "add" and reports(call))
        passed = passed if call.held else passed.replace("data", "whole(data)")
        line = f"    {'return ' if gives else ''}{function.__name__}({passed})"
        texts.append(f"{SELDOM if name == 'potential' else BY_ADDRESS}\ndef entry_{name}({given}):\n{line}")
    runs = f", {WIDTH} runs at once" if lanes else ""
    head = (
        f'"""Compiled by exunet for one kind of force{runs}; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
    )
    return "\n\n\n".join((*head, *texts)) + "\n"


def reports(call: KernelCall) -> bool:
    """True if its `add` returns an energy or a power."""
    return call.elastic or call.tells_power


@cache
def _text(function: Function) -> str:
    return f"{INSIDE}\n{inspect.getsource(function).rstrip()}"


def addresses(call: KernelCall, source: str, data: tuple[Any, ...], lanes: bool) -> dict[str, int]:
    """Return the addresses of a call's functions by name, compiled for such data if needed; needs Numba.

    source, lanes : `call_source` of the call
    """
    key = source, reports(call), _kinds(data), lanes
    if key not in _addresses:
        names = tuple(name for name in FUNCTIONS if getattr(call, name) is not None)
        _addresses[key] = _compiled(source, names, reports(call), data, lanes)
    return _addresses[key]


_addresses: dict[Any, dict[str, int]] = {}


def _kinds(data: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the key of the types of compiled code; Numba's `typeof` takes a hundred times as long."""
    return type(data), *(
        _kinds(value)
        if isinstance(value, tuple)
        else (value.dtype.num, value.ndim, value.flags.num)
        if isinstance(value, np.ndarray)
        else type(value)
        for value in data
    )


def _compiled(
    source: str, names: tuple[str, ...], reporting: bool, data: tuple[Any, ...], lanes: bool
) -> dict[str, int]:
    from numba import float64, typeof

    from exunet.kernels.pointers import kind_at, signature_of

    number: Any = float64
    if lanes:
        from exunet.kernels.lanes import LANES

        number = LANES
    module = compiled_module(source)
    found = {}
    for name in names:
        result, arguments = signature_of(
            "reporting" if name == "add" and reporting else name, number, kind_at(typeof(data))
        )
        function = getattr(module, f"entry_{name}")
        function.compile(arguments)
        compiled = function.overloads[arguments]
        if compiled.signature.return_type != result:
            returned = compiled.signature.return_type
            raise TypeError(f"{name} of a force must return {result} and returns {returned}:\n{source}")
        found[name] = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    return found


# Of each call: where its functions are (0: it has none), where its data, and what its `add` returns.
#
# elastic, tells_power : 1 if it returns that
# works                : 1 if the power taken out is -force . v
ROW = np.dtype([(name, "i8") for name in (*FUNCTIONS, "data", "elastic", "tells_power", "works")])


class Takes(IntEnum):
    """How the energy is known that the forces of a scene take out."""

    NOTHING = 0  # they take none out
    INTEGRATED = 1  # their power is integrated along the run
    REPORTED = 2  # the forces report all of it


class ForceTable(NamedTuple):
    """The forces of a scene.

    rows  : (n_calls,) records `ROW`; they keep what they point to
    takes : how the energy is known that they take out
    data  : of each call, whose arrays the rows point to
    changed : the discrete states that compiled code changes itself, one after the other
    kept  : the same by name; views
    """

    rows: Any
    takes: Takes
    data: tuple[Any, ...]
    changed: NDArray[np.float64]
    kept: Mapping[str, NDArray[np.float64]]

    def place_of(self, name: str, entry: int) -> int:
        """Where an entry of a discrete state stands in `changed`; counted from the end if negative."""
        ends = dict(
            zip(self.kept, np.cumsum([len(item) for item in self.kept.values()]).tolist(), strict=True)
        )
        return int(ends[name] + (entry if entry < 0 else entry - len(self.kept[name])))


class _Owner(bytearray):
    """The bytes of an array, and what must not vanish before it: NumPy keeps the owner of its bytes."""

    owned: tuple[Any, ...] = ()


def compiled_rows(
    calls: Sequence[KernelCall], sources: Sequence[str], data: Sequence[Any], *, lanes: bool
) -> NDArray[np.void]:
    """Records `ROW` of calls with their data, which they own; sources : of each call."""
    discrete = _Owner(len(calls) * ROW.itemsize)
    rows = np.frombuffer(discrete, dtype=ROW)
    owned = []
    for row, call, source, own in zip(rows, calls, sources, data, strict=True):
        words = np.fromiter(_words(own), dtype=np.int64)
        row["data"] = words.ctypes.data
        for name, address in addresses(call, source, own, lanes).items():
            row[name] = address
        for name, value in _flags(call).items():
            row[name] = value
        owned.append((own, words))
    discrete.owned = tuple(owned)
    return rows


def interpreted_rows(calls: Sequence[KernelCall], data: Sequence[Any]) -> list[dict[str, Any]]:
    """The same for the functions in plain Python, which stand in the rows themselves."""
    return [
        {name: getattr(call, name) or 0 for name in FUNCTIONS} | {"data": own} | _flags(call)
        for call, own in zip(calls, data, strict=True)
    ]


def _flags(call: KernelCall) -> dict[str, int]:
    works = call.works and call.power is None and call.work is None
    if works and reports(call):
        raise TypeError(f"{call.add.__name__} reports its energy or power, so its work is not -force . v")
    return {"elastic": int(call.elastic), "tells_power": int(call.tells_power), "works": int(works)}


def takes(calls: Sequence[KernelCall]) -> Takes:
    """How the energy is known that calls take out."""
    taking = [call for call in calls if call.dissipates]
    if not taking:
        return Takes.NOTHING
    return Takes.REPORTED if all(call.tells_power for call in taking) else Takes.INTEGRATED


def _words(data: Any) -> Iterator[int]:
    """A tuple as it stands in the memory of compiled code: words of 8 bytes, as Numba lays arrays out.

    An array is: who counts its references and who owns it (nobody), its size, the bytes of an item, where it
    begins, its shape, its strides.
    """
    for value in leaves(data):
        if isinstance(value, np.ndarray):
            begins = value.__array_interface__["data"][0]
            yield from (0, 0, value.size, value.itemsize, begins, *value.shape, *value.strides)
        elif isinstance(value, float):  # NumPy's too
            yield struct.unpack("<q", struct.pack("<d", value))[0]
        elif isinstance(value, int) and not isinstance(value, bool):
            yield value
        else:
            raise TypeError(f"data of a force must be arrays, float or int, not {type(value).__name__}")


Floats = NDArray[np.float64]


class Kernel:
    """The forces of some terms; `extra` functions and their `helpers`, which need `imports`, join `drivers`.

    lanes    : the functions take states of several runs at once (see `exunet.kernels.lanes`)
    compiled : machine code, as far as Numba is installed; else plain Python, some hundred times slower
    """

    def __init__(
        self,
        terms: Iterable[Term],
        extra: tuple[Function, ...] = (),
        helpers: tuple[Function, ...] = (),
        *,
        bodies: bool = False,
        first_order: bool = False,
        imports: tuple[str, ...] = (),
        lanes: bool = False,
        compiled: bool = True,
    ) -> None:
        self._terms = tuple(terms)
        self.calls = tuple(call for term in self._terms for call in term.calls)
        self.takes = takes(self.calls)
        self._lanes, self._compiled = lanes, compiled and numba_installed()
        of_bodies = [term for term in self._terms if isinstance(term, KernelTerm | Constraint)]
        self.source = module_source(
            (*DRIVERS, *extra),
            (*HELPERS, *helpers),
            bodies=bodies or any(isinstance(term, Constraint) or term.bodies for term in of_bodies),
            first_order=first_order,
            imports=imports,
        )

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """Texts of the modules of its calls, in order; scenes of other numbers share them."""
        return tuple(call_source(call, lanes=self._lanes) for call in self.calls)

    @property
    def compiled_before(self) -> bool:
        """True if all of it was compiled before and kept; needs Numba."""
        return all(kept_before(source) for source in (self.source, *self.sources))

    @cached_property
    def module(self) -> ModuleType:
        """Compiled or interpreted."""
        return compiled_module(self.source) if self._compiled else interpreted_module(self.source)

    def table(self, discrete: Mapping[str, Floats] | None = None) -> ForceTable:
        """All terms with a copy of their data, as the functions of the module take their rows.

        discrete : values of the terms' discrete states by name; a name that is absent has its initial value
        Arrays are contiguous and writable: all of them have the same compiled code.
        """
        every: list[Any] = []
        places: dict[str, tuple[int, str]] = {}
        for term in self._terms:
            for data in term.data_at(discrete or {}):
                if term.discrete is not None and term.discrete.kept_in:
                    places[term.discrete.name] = len(every), term.discrete.kept_in
                every.append(copied(data))
        changed, kept = _in_one(every, places)
        if self._compiled:
            rows: Any = compiled_rows(self.calls, self.sources, every, lanes=self._lanes)
        else:
            rows = interpreted_rows(self.calls, every)
        return ForceTable(rows, self.takes, tuple(every), changed, kept)

    def forces(
        self, time: float, position: Floats, velocity: Floats, discrete: Mapping[str, Floats] | None = None
    ) -> Floats:
        """(n_points, 3) [N] from position and velocity (n_points, 3), of points alone."""
        force = np.zeros(position.size)
        x, v = (np.array(a, dtype=float).ravel() for a in (position, velocity))
        self.module.forces(time, x, v, self.table(discrete).rows, force)
        return force.reshape(-1, 3)

    def remembered(
        self, time: float, x: Floats, v: Floats, size: int, discrete: DiscreteStates
    ) -> DiscreteStates:
        """Return the discrete states after a step that ends at a state x (n_x,), v (n_v,) [s].

        size : of the array of forces and rates, see `Blocks.n_force`
        """
        x, v, table = np.array(x, dtype=float), np.array(v, dtype=float), self.table(discrete)
        self.module.forces(time, x, v, table.rows, np.zeros(size))
        for call, data in zip(self.calls, table.data, strict=True):
            if call.remember is not None:
                call.remember(time, x, v, data)  # in Python: once a run
        return table.kept

    def potential(self, x: Floats, discrete: Mapping[str, Floats] | None = None) -> Floats:
        """Potential energy of the terms that have one [J]; (k, n_x) -> (k,)."""
        energy = np.empty(len(x))
        self.module.potentials(np.array(x, dtype=float), self.table(discrete).rows, energy)
        return energy

    def power(
        self, time: Floats, x: Floats, v: Floats, discrete: Mapping[str, Floats] | None = None
    ) -> Floats:
        """Power that the terms without a potential take out [W]; (k,), (k, n_x), (k, n_v) -> (k,)."""
        taken = np.empty(len(time))
        x, v = np.array(x, dtype=float), np.array(v, dtype=float)
        self.module.powers(
            np.array(time, dtype=float), x, v, self.table(discrete).rows, np.zeros(x.shape[1]), taken
        )
        return taken

    def work(
        self,
        step: Floats,
        states: Sequence[tuple[Floats, Floats]],
        discrete: Mapping[str, Floats] | None = None,
    ) -> Floats:
        """Energy [J] taken out in steps (k,) [s], of the terms that report it (`KernelCall.work`) -> (k,).

        states : x (k, n_x) and v (k, n_v) at the start and the end of the steps
        """
        taken = np.empty(len(step))
        begin, end = (tuple(np.array(part, dtype=float) for part in pair) for pair in states)
        self.module.works(np.array(step, dtype=float), begin, end, self.table(discrete).rows, taken)
        return taken

    def all_forces(
        self, time: Floats, x: Floats, v: Floats, number: int, discrete: Mapping[str, Floats] | None = None
    ) -> Floats:
        """Forces, rates of `number` first-order states; (k,), (k, n_x), (k, n_v) -> (k, n_v + number)."""
        force = np.zeros((len(time), v.shape[1] + number))
        x, v, rows = np.array(x, dtype=float), np.array(v, dtype=float), self.table(discrete).rows
        for row, t in enumerate(time.tolist()):
            self.module.forces(t, x[row], v[row], rows, force[row])
        return force


def _in_one(every: list[Any], places: Mapping[str, tuple[int, str]]) -> tuple[Floats, dict[str, Floats]]:
    """One array for fields of the data, whose new arrays are views of it; by name.

    places : number of the data, and name of the field
    """
    values = [getattr(every[number], field) for number, field in places.values()]
    ends = np.cumsum([0, *(len(value) for value in values)]).tolist()
    changed, kept = np.concatenate([np.zeros(0), *values]), {}
    for (name, (number, field)), (begin, end) in zip(places.items(), pairwise(ends), strict=True):
        kept[name] = changed[begin:end]
        every[number] = every[number]._replace(**{field: kept[name]})
    return changed, kept


@lru_cache(maxsize=8)
def cable_kernel(cable: CableTerm) -> Kernel:
    """The elements alone."""
    return Kernel((cable,))


@lru_cache(maxsize=8)
def term_kernel(kernels: tuple[Term, ...]) -> Kernel:
    """The nonlinear terms alone, for the forms that take the rest in another way."""
    return Kernel(kernels)

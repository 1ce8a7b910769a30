"""A kernel: the compiled functions of some force terms, and the data that they work on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, lru_cache
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.codegen import drivers
from exunet.codegen.compile import (
    compiled_module,
    interpreted_module,
    kept_before,
    numba_installed,
)
from exunet.codegen.entries import call_source
from exunet.codegen.force_table import ForceTable, compiled_rows, interpreted_rows, takes
from exunet.codegen.generate import module_source
from exunet.forces.cable_term import CableTerm
from exunet.forces.kernel_call import Function
from exunet.forces.terms import Constraint, KernelTerm, Term, copied
from exunet.forces.total import Forces

Floats = NDArray[np.float64]


class Kernel:
    """The forces of some terms; `extra` functions and their `helpers`, which need `imports`, join `drivers`.

    lanes    : the functions take states of several runs at once (see `exunet.codegen.lanes`)
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
            (*drivers.DRIVERS, *extra),
            (*drivers.HELPERS, *helpers),
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

    def table(self, memory: Mapping[str, Floats] | None = None) -> ForceTable:
        """All terms with a copy of their data, as the functions of the module take their rows.

        memory : values of the terms' memories by name; a name that is absent has its initial value
        Arrays are contiguous and writable: all of them have the same compiled code.
        """
        every: list[Any] = []
        places: dict[str, tuple[int, str]] = {}
        for term in self._terms:
            for data in term.data_at(memory or {}):
                if term.memory is not None and term.memory.kept_in:
                    places[term.memory.name] = len(every), term.memory.kept_in
                every.append(copied(data))
        changed, kept = _in_one(every, places)
        if self._compiled:
            rows: Any = compiled_rows(self.calls, self.sources, every, lanes=self._lanes)
        else:
            rows = interpreted_rows(self.calls, every)
        return ForceTable(rows, self.takes, tuple(every), changed, kept)

    def forces(
        self, time: float, position: Floats, velocity: Floats, memory: Mapping[str, Floats] | None = None
    ) -> Floats:
        """(n_points, 3) [N] from position and velocity (n_points, 3), of points alone."""
        force = np.zeros(position.size)
        x, v = (np.array(a, dtype=float).ravel() for a in (position, velocity))
        self.module.forces(time, x, v, self.table(memory).rows, force)
        return force.reshape(-1, 3)

    def potential(self, x: Floats, memory: Mapping[str, Floats] | None = None) -> Floats:
        """Potential energy of the terms that have one [J]; (k, n_x) -> (k,)."""
        energy = np.empty(len(x))
        self.module.potentials(np.array(x, dtype=float), self.table(memory).rows, energy)
        return energy

    def power(self, time: Floats, x: Floats, v: Floats, memory: Mapping[str, Floats] | None = None) -> Floats:
        """Power that the terms without a potential take out [W]; (k,), (k, n_x), (k, n_v) -> (k,)."""
        taken = np.empty(len(time))
        x, v = np.array(x, dtype=float), np.array(v, dtype=float)
        self.module.powers(
            np.array(time, dtype=float), x, v, self.table(memory).rows, np.zeros(x.shape[1]), taken
        )
        return taken

    def work(
        self,
        step: Floats,
        states: Sequence[tuple[Floats, Floats]],
        memory: Mapping[str, Floats] | None = None,
    ) -> Floats:
        """Energy [J] taken out in steps (k,) [s], of the terms that tell it (`KernelCall.work`) -> (k,).

        states : x (k, n_x) and v (k, n_v) at the start and the end of the steps
        """
        taken = np.empty(len(step))
        begin, end = (tuple(np.array(part, dtype=float) for part in pair) for pair in states)
        self.module.works(np.array(step, dtype=float), begin, end, self.table(memory).rows, taken)
        return taken

    def rates(
        self, time: Floats, x: Floats, v: Floats, number: int, memory: Mapping[str, Floats] | None = None
    ) -> Floats:
        """Rates of the `number` first-order states; (k,), (k, n_x), (k, n_v) -> (k, number)."""
        force = np.zeros((len(time), v.shape[1] + number))
        x, v, rows = np.array(x, dtype=float), np.array(v, dtype=float), self.table(memory).rows
        for row, t in enumerate(time.tolist()):
            self.module.forces(t, x[row], v[row], rows, force[row])
        return force[:, v.shape[1] :]


def _in_one(every: list[Any], places: Mapping[str, tuple[int, str]]) -> tuple[Floats, dict[str, Floats]]:
    """One array for fields of the data, whose new arrays are views of it; by name.

    places : number of the data, and name of the field
    """
    values = [getattr(every[number], field) for number, field in places.values()]
    ends = np.cumsum([0, *(len(one) for one in values)]).tolist()
    changed, kept = np.concatenate([np.zeros(0), *values]), {}
    for (name, (number, field)), (begin, end) in zip(places.items(), pairwise(ends), strict=True):
        kept[name] = changed[begin:end]
        every[number] = every[number]._replace(**{field: kept[name]})
    return changed, kept


def net_kernel(forces: Forces, extra: tuple[Function, ...] = ()) -> Kernel:
    """All forces of a scene on its points: the elements and every other term."""
    return Kernel(forces, extra)


@lru_cache(maxsize=8)
def cable_kernel(cable: CableTerm) -> Kernel:
    """The elements alone."""
    return Kernel((cable,))


@lru_cache(maxsize=8)
def term_kernel(kernels: tuple[KernelTerm, ...]) -> Kernel:
    """The nonlinear terms alone, for the forms that take the rest in another way."""
    return Kernel(kernels)

"""A kernel: the compiled functions of some force terms, and the data that they work on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.codegen import drivers
from exunet.codegen.compile import compiled_module, interpreted_module, numba_installed
from exunet.codegen.generate import module_source
from exunet.forces.terms import Constraint, Function, KernelTerm, Term, copied
from exunet.forces.total import Forces

Floats = NDArray[np.float64]


class Kernel:
    """The forces of some terms; `extra` functions and their `helpers`, which need `imports`, join `drivers`.

    The text of the module depends on the kinds of the terms only, so scenes that differ in numbers share one.
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
    ) -> None:
        self._terms = tuple(terms)
        calls = [call for term in self._terms for call in term.calls]
        of_bodies = [term for term in self._terms if isinstance(term, KernelTerm | Constraint)]
        self.source = module_source(
            calls,
            (*drivers.DRIVERS, *extra),
            (*drivers.HELPERS, *helpers),
            bodies=bodies or any(isinstance(term, Constraint) or term.bodies for term in of_bodies),
            first_order=first_order,
            imports=imports,
        )

    @cached_property
    def module(self) -> ModuleType:
        """Compiled where Numba is installed, else interpreted."""
        return compiled_module(self.source) if numba_installed() else interpreted_module(self.source)

    def data(self, memory: Mapping[str, Floats] | None = None) -> tuple[Any, ...]:
        """A copy of the data of all terms as the functions of the module take them.

        memory : values of the terms' memories by name; a name that is absent has its initial value
        Arrays are contiguous and writable: all of them have the same compiled code.
        """
        return self.data_and_memories(memory)[0]

    def data_and_memories(
        self, memory: Mapping[str, Floats] | None = None
    ) -> tuple[tuple[Any, ...], dict[str, Floats]]:
        """The same, and the memories in it that compiled code changes itself, by name: not copies."""
        every: list[Any] = []
        kept = {}
        for term in self._terms:
            for call, data in zip(term.calls, term.data_at(memory or {}), strict=True):
                own = copied(data)
                if term.memory is not None and term.memory.kept_in:
                    kept[term.memory.name] = getattr(own, term.memory.kept_in)
                every.append(self.module.hold(own) if call.held and numba_installed() else own)
        return tuple(every), kept

    def forces(
        self, time: float, position: Floats, velocity: Floats, memory: Mapping[str, Floats] | None = None
    ) -> Floats:
        """(n_points, 3) [N] from position and velocity (n_points, 3), of points alone."""
        force = np.zeros(position.size)
        x, v = (np.array(a, dtype=float).ravel() for a in (position, velocity))
        self.module.forces(time, x, v, self.data(memory), force)
        return force.reshape(-1, 3)

    def potential(self, x: Floats, memory: Mapping[str, Floats] | None = None) -> Floats:
        """Potential energy of the terms that have one [J]; (k, n_x) -> (k,)."""
        energy = np.empty(len(x))
        self.module.potentials(np.array(x, dtype=float), self.data(memory), energy)
        return energy

    def power(self, time: Floats, x: Floats, v: Floats, memory: Mapping[str, Floats] | None = None) -> Floats:
        """Power that the terms without a potential take out [W]; (k,), (k, n_x), (k, n_v) -> (k,)."""
        taken = np.empty(len(time))
        x, v = np.array(x, dtype=float), np.array(v, dtype=float)
        self.module.powers(np.array(time, dtype=float), x, v, self.data(memory), taken)
        return taken

    def rates(
        self, time: Floats, x: Floats, v: Floats, number: int, memory: Mapping[str, Floats] | None = None
    ) -> Floats:
        """Rates of the `number` first-order states; (k,), (k, n_x), (k, n_v) -> (k, number)."""
        force = np.zeros((len(time), v.shape[1] + number))
        x, v, data = np.array(x, dtype=float), np.array(v, dtype=float), self.data(memory)
        for row, t in enumerate(time.tolist()):
            self.module.forces(t, x[row], v[row], data, force[row])
        return force[:, v.shape[1] :]


def net_kernel(forces: Forces, extra: tuple[Function, ...] = ()) -> Kernel:
    """All forces of a scene on its points: the elements and every other term."""
    return Kernel(forces, extra)


@lru_cache(maxsize=8)
def term_kernel(kernels: tuple[KernelTerm, ...]) -> Kernel:
    """The nonlinear terms alone, for the forms that take the rest in another way."""
    return Kernel(kernels)

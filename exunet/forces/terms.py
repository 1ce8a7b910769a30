"""What an effect adds to the equations of motion, as data that every form of the engine can take.

This is the one seam between effects and engines: the connectors, the fused net and the compiled loop all
read `Terms`, so an effect's physics is written once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.forces.cable import Law
from exunet.net.arrays import Net

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class KernelTerm:
    """A nonlinear force on the nodes, written once as a scalar loop and compiled where Numba is installed.

    add        : module-level function add(t, x, v, *parameters, force) that adds its force [N] to `force`;
                 x, v, force are flat (3 n_nodes,) arrays, node-wise x, y, z, in the subset of Python
                 that Numba compiles. It may use `math`, `np` and its `helpers`, no other global name.
    parameters : arrays and numbers, in the order in which `add` takes them
    potential  : module-level function potential(x, *parameters) -> energy [J] if the force is conservative;
                 None: the work of force . v is integrated along the run
    helpers    : module-level functions that `add` or `potential` call
    damping_rate : bound of what the term adds to the eigenvalues of M^-1 D, for the stable step [1/s]

    Names of functions must differ between terms, since they come to stand in one compiled module.
    """

    add: Callable[..., None]
    parameters: tuple[Any, ...] = ()
    potential: Callable[..., float] | None = None
    helpers: tuple[Callable[..., Any], ...] = ()
    damping_rate: float = 0.0


@dataclass(frozen=True, eq=False)
class Breaking:
    """Limits (n_elements,) above which an element carries nothing any more; one of the two.

    strain : Green-Lagrange strain less the free strain
    force  : elastic axial force [N]
    """

    strain: Floats | None = None
    force: Floats | None = None


@dataclass(frozen=True)
class Terms:
    """What the effects that are on add up to; None or () means that nothing of it exists.

    With n = 3 n_nodes coordinates (node-wise x, y, z), positions x and velocities v, the force is
    load - damping v - gyroscopic v - stiffness x + the sum of the kernel terms.

    damping     : (n, n) [N s/m], symmetric positive semi-definite; takes out the power v . damping v
    gyroscopic  : (n, n) [N s/m], antisymmetric; does no work
    stiffness   : (n, n) [N/m], symmetric, on absolute positions; potential energy x . stiffness x / 2
    load        : (n,) [N]; potential energy -load . x
    kernels     : nonlinear forces on the nodes
    free_strain : (n_elements,) Green-Lagrange strain at which an element is free of stress (a thermal strain)
    relaxation_time : (n_elements,) [s] of the viscous stress along the current direction while taut
    breaking    : limits of the elements
    intact      : (n_elements,) 1.0, or 0.0 for elements that have broken; None: all are whole
    """

    damping: csr_array | None = None
    gyroscopic: csr_array | None = None
    stiffness: csr_array | None = None
    load: Floats | None = None
    kernels: tuple[KernelTerm, ...] = ()
    free_strain: Floats | None = None
    relaxation_time: Floats | None = None
    breaking: Breaking | None = None
    intact: Floats | None = None

    def __add__(self, other: Terms) -> Terms:
        return Terms(
            damping=_add(self.damping, other.damping),
            gyroscopic=_add(self.gyroscopic, other.gyroscopic),
            stiffness=_add(self.stiffness, other.stiffness),
            load=_add(self.load, other.load),
            kernels=self.kernels + other.kernels,
            free_strain=_add(self.free_strain, other.free_strain),
            relaxation_time=_add(self.relaxation_time, other.relaxation_time),
            breaking=self.breaking or other.breaking,
        )

    @property
    def dissipates(self) -> bool:
        """True if work must be integrated along the run for the energy balance to close."""
        return (
            self.damping is not None
            or self.relaxation_time is not None
            or any(term.potential is None for term in self.kernels)
        )

    @property
    def has_potential(self) -> bool:
        """True if there is potential energy beside that of the elements."""
        linear = self.load is not None or self.stiffness is not None
        return linear or any(term.potential is not None for term in self.kernels)

    def largest_number(self) -> float:
        """The largest magnitude in any of the terms; NaN if one is not a number."""
        matrices = (m.data for m in (self.damping, self.gyroscopic, self.stiffness) if m is not None)
        limits = (self.breaking.strain, self.breaking.force) if self.breaking else ()
        single = (self.load, self.free_strain, self.relaxation_time, *limits)
        kernels = [number for term in self.kernels for number in (*term.parameters, term.damping_rate)]
        return max(
            (float(np.max(np.abs(n), initial=0.0)) for n in (*matrices, *single, *kernels) if n is not None),
            key=lambda number: math.inf if math.isnan(number) else number,
            default=0.0,
        )

    def law(self, net: Net) -> Law:
        """The axial law of a net's elements with these terms."""
        law = Law.of(net, self.free_strain, self.relaxation_time)
        return law if self.intact is None else replace(law, stiffness=law.stiffness * self.intact)

    @property
    def on_velocity(self) -> csr_array | None:
        """damping + gyroscopic, the constant matrix on velocities; None: no such term."""
        total: csr_array | None = _add(self.damping, self.gyroscopic)
        return total


def _add(a: Any, b: Any) -> Any:
    if a is None or b is None:
        return a if b is None else b
    return a + b

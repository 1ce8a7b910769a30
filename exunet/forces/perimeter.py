"""Threads of a net's edge that become shorter at a given rate, as a force term.

Their natural length is p L1, with p a first-order state: p' = -rate from the given time on, until the given
part is left. With stretch lambda = L / (p L1), e = (lambda^2 - 1) / 2 and N = EA e lambda, the energy is the
sum of EA e^2 p L1 / 2, and what shortens the threads does the work -p' L1 (N lambda - EA e^2 / 2) on each.
Viscous stress adds tau de/dt to the strain, as in `exunet.forces.reel`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces import cable
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.cable import AxialLaw
from exunet.forces.closing import Instants
from exunet.forces.law import green_lagrange_strain, strain_at
from exunet.forces.loops import Index
from exunet.forces.terms import DiscreteState, DiscreteStates, KernelTerm
from exunet.net.closing import NAME, ShortenedEdge

_STATE_NAME = f"{NAME}/perimeter"
_WORDS = "the edge begins to become shorter", "the edge is as short as it gets"


def states_of(perimeter: ShortenedEdge) -> tuple[FirstOrder, FirstOrder]:
    """The part of the length that is left, and the work that was done on the threads [J]."""
    return FirstOrder(f"{NAME}/part", (1.0,)), FirstOrder(f"{NAME}/work", (0.0,), "J", gives=1.0)


class PerimeterElements(NamedTuple):
    """Threads as the loops take them.

    first, second : (m,) 3 x nodes at the ends
    length, stiffness : (m,) L1 [m], EA [N]
    time  : relaxation time [s]
    state, rate : (1,) where the part left stands in x; where its rate stands in force, before the work's
    falls : -p' [1/s]
    """

    first: NDArray[Index]
    second: NDArray[Index]
    length: Floats
    stiffness: Floats
    time: float
    state: NDArray[Index]
    rate: NDArray[Index]
    falls: float


@dataclass(frozen=True, eq=False)
class Shortening:
    """A perimeter in a scene; law : of all elements."""

    perimeter: ShortenedEdge
    blocks: Blocks
    law: AxialLaw

    @property
    def elements(self) -> tuple[int, ...]:
        """Those that the cable term leaves to this one."""
        return self.perimeter.elements

    @property
    def instants(self) -> tuple[float, float]:
        """When they begin to become shorter, and when that ends [s]."""
        one = self.perimeter
        return one.at, one.at + (1.0 - one.part) / one.rate

    def data(self, discrete: Floats) -> PerimeterElements:
        """Build the data for the loops; discrete : (1,) number of the instants that have passed."""
        own, time = list(self.elements), self.law.relaxation_time
        first, second = (3 * self.blocks.net.element_nodes[own].T).astype(Index)
        return PerimeterElements(
            first,
            second,
            self.law.natural_length[own],
            self.law.stiffness[own],
            0.0 if time is None else float(time[own].max(initial=0.0)),
            np.array([self.blocks.state(f"{NAME}/part")], dtype=Index),
            np.array([self.blocks.rate(f"{NAME}/part")], dtype=Index),
            self.perimeter.rate if discrete[0] == 1.0 else 0.0,
        )

    def seen(self, discrete: DiscreteStates, x: Floats, v: Floats) -> tuple[Ints, Floats, Floats]:
        """The elements, and their Green-Lagrange strain and tension [N], (k, m) each, in k states.

        x (k, n_x), v (k, n_v) with equal discrete states. The same as `threads_pull`, for arrays.
        """
        data = self.data(discrete.get(_STATE_NAME, np.zeros(1)))
        ends = (
            np.asarray(item, dtype=np.int64)[:, None] + np.arange(3) for item in (data.first, data.second)
        )
        first, second = ends
        span, parting = (part[:, second] - part[:, first] for part in (x, v))
        length = np.sqrt(np.einsum("kma,kma->km", span, span))
        natural = data.length * x[:, data.state.astype(np.int64)]
        along = np.einsum("kma,kma->km", span, parting)
        rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
        rate += length / natural * data.length * data.falls  # the rate of the stretch, times the length
        time = np.full(natural.shape, data.time)
        tension = cable.viscous_tension(length, rate, natural, data.stiffness, time)
        reference = (
            natural * (self.blocks.net.reference_length / self.law.natural_length)[list(self.elements)]
        )
        return np.array(self.elements), green_lagrange_strain(length, reference), np.asarray(tension)

    def term(self) -> KernelTerm:
        """Their forces and energy, and the work that shortens them."""
        start = np.array([float(np.searchsorted(self.instants, 0.0, side="right"))])
        data, part = self.data(start), self.perimeter.part
        own = self.blocks.net.element_nodes[list(self.elements)]
        # Between neighbours on a loop: four times the stiffness that they gain, over the least mass.
        gained = (1.0 / part - 1.0) * float((data.stiffness / data.length).max())
        rate = 4.0 * gained / float(self.blocks.mass[own].min())
        return KernelTerm(
            "threads of the edge",
            add_threads,
            data,
            potential=energy_of_threads,
            power=power_in_threads if data.time > 0.0 else None,
            helpers=(strain_at, threads_pull),
            stiffness_rate=rate,
            damping_rate=data.time * rate,
            discrete=DiscreteState(_STATE_NAME, start, self.data),
            switch=Instants(self.instants, _WORDS),
            internal=True,
        )


# Scalar loops, in the subset of Python that Numba compiles.


def threads_pull(x: Any, v: Any, threads: Any, e: int) -> Any:
    """Length [m], natural length [m], elastic strain, tension [N], dlambda/dt [1/s] of one of the threads."""
    i = threads.first[e]
    j = threads.second[e]
    part = x[threads.state[0]]
    square = 0.0
    along = 0.0
    for c in range(3):
        d = x[j + c] - x[i + c]
        square += d * d
        along += d * (v[j + c] - v[i + c])
    length = math.sqrt(square)
    natural = threads.length[e] * part
    stretch = length / natural
    strain = strain_at(stretch)
    parting = 0.0
    tension = 0.0
    if strain > 0.0:
        parting = along / (length * natural) + stretch * threads.falls / part
        tension = threads.stiffness[e] * max(strain + threads.time * stretch * parting, 0.0) * stretch
    return length, natural, strain, tension, parting


def add_threads(t: float, x: Any, v: Any, threads: Any, force: Any) -> None:
    """The tensions on the nodes, the rate of the part left, and the power of what shortens the threads."""
    k = threads.rate[0]
    force[k] -= threads.falls
    for e in range(threads.length.size):
        length, natural, strain, tension, _ = threads_pull(x, v, threads, e)
        if strain > 0.0:
            i = threads.first[e]
            j = threads.second[e]
            felt = tension * length / natural - 0.5 * threads.stiffness[e] * strain * strain
            force[k + 1] += threads.falls * threads.length[e] * felt
            for c in range(3):
                pull = tension * (x[j + c] - x[i + c]) / length
                force[i + c] += pull
                force[j + c] -= pull


def energy_of_threads(x: Any, threads: Any) -> float:
    """Elastic energy [J]."""
    total = 0.0
    for e in range(threads.length.size):
        _, natural, strain, _, _ = threads_pull(x, x, threads, e)
        total += 0.5 * threads.stiffness[e] * strain * strain * natural
    return total


def power_in_threads(t: float, x: Any, v: Any, threads: Any) -> float:
    """Compute the power that the viscous stress dissipates [W]."""
    total = 0.0
    for e in range(threads.length.size):
        length, natural, strain, tension, parting = threads_pull(x, v, threads, e)
        elastic = threads.stiffness[e] * strain * length / natural
        total += (tension - elastic) * natural * parting
    return total

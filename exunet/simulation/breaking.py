"""Which elements have broken along a run: found at the end of each accepted step, booked in the ledger.

Methods that choose their step ask beforehand whether it would go well beyond a limit, and take a smaller one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.cable import Law
from exunet.forces.terms import Terms
from exunet.net.arrays import Net
from exunet.simulation.monitor import Monitor

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


OVERSHOOT = 5e-4  # of the strain at the limit, by which a step may go beyond it: 1e-3 of the energy lost


@dataclass(frozen=True)
class Break:
    """One element that broke: at a time [s], with the elastic energy [J] that is lost with it.

    excess : that energy over the energy at the limit, less one: the error of finding it at a step's end
    """

    element: int
    time: float
    energy: float
    excess: float


class Breaks:
    """The elements of a net that are still whole; only made where effects.breaking is on."""

    def __init__(self, net: Net, terms: Terms, monitor: Monitor) -> None:
        self._net = net
        self._monitor = monitor
        self._limit = breaking_lengths(net, terms)
        law = terms.law(net)
        self._at_limit = cable.green_lagrange_strain(self._limit, law.natural_length)
        self._far = law.natural_length * np.sqrt(1.0 + 2.0 * (1.0 + OVERSHOOT) * self._at_limit)
        self.terms = replace(terms, intact=np.ones(net.n_elements))
        self.events: list[Break] = []

    def found(self, position: Floats) -> Ints:
        """Whole elements that are beyond their limit at position (n_nodes, 3) [m]."""
        return np.flatnonzero(self._whole & (cable.lengths(self._net, position) > self._limit))

    def step_within(self, step: float, least: float, position: Floats, velocity: Floats) -> float:
        """A step [s] by which no element, at the velocity (n_nodes, 3) [m/s], goes far beyond its limit.

        `step` halved as often as needed, but not below `least`. Forces slow down what stretches, so the
        straight way looks further than the true one goes.
        """
        apart, parting = cable.spans(self._net, position), cable.spans(self._net, velocity)
        near = self._whole & (np.linalg.norm(apart, axis=1) <= self._limit)
        near &= np.linalg.norm(apart, axis=1) + step * np.linalg.norm(parting, axis=1) > self._far
        apart, parting, far = apart[near], parting[near], self._far[near]
        while step > least and (np.linalg.norm(apart + step * parting, axis=1) > far).any():
            step *= 0.5
        return step

    def book(self, time: float, position: Floats, elements: Ints) -> float:
        """Take elements out at a time [s]; what they held is lost, and returned [J]."""
        law = self.terms.law(self._net)
        strain = cable.green_lagrange_strain(cable.lengths(self._net, position), law.natural_length)
        held = 0.5 * np.maximum(strain, 0.0) ** 2 * law.stiffness * law.natural_length
        excess = (strain / self._at_limit) ** 2 - 1.0
        self.events += [Break(int(e), time, float(held[e]), float(excess[e])) for e in elements]
        intact = self._intact.copy()
        intact[elements] = 0.0
        self.terms = replace(self.terms, intact=intact)
        lost = float(held[elements].sum())
        self._monitor.lose(lost, self.terms)
        return lost

    def corrected(
        self, times: Sequence[float], length: Floats, tension: Floats, elastic: Floats
    ) -> tuple[Floats, Floats]:
        """Tension (k, n_elements) [N] and elastic energy (k,) [J] of states at `times` as if all were whole,
        less what the broken elements do not carry; length (k, n_elements) [m].
        """
        since = np.full(self._net.n_elements, np.inf)
        for event in self.events:
            since[event.element] = event.time
        gone = np.asarray(times)[:, None] >= since
        law = replace(self.terms, intact=None).law(self._net)
        strain = np.maximum(cable.green_lagrange_strain(length, law.natural_length), 0.0)
        lost = 0.5 * np.where(gone, strain, 0.0) ** 2 @ (law.stiffness * law.natural_length)
        return np.where(gone, 0.0, tension), elastic - lost

    @property
    def _whole(self) -> NDArray[np.bool_]:
        """(n_elements,) False for elements that have broken."""
        return self._intact > 0.0

    @property
    def _intact(self) -> Floats:
        assert self.terms.intact is not None
        return self.terms.intact

    def provenance(self) -> list[dict[str, Any]]:
        """The breaks in their order, ready for JSON."""
        return [
            {"element": b.element, "time_s": b.time, "energy_J": b.energy, "energy_excess": b.excess}
            for b in self.events
        ]


def breaking_lengths(net: Net, terms: Terms) -> Floats:
    """(n_elements,) the length [m] beyond which each element breaks."""
    assert terms.breaking is not None
    law = terms.law(net)
    if terms.breaking.strain is not None:
        free = 0.0 if terms.free_strain is None else terms.free_strain
        return np.asarray(net.reference_length * np.sqrt(1.0 + 2.0 * (terms.breaking.strain + free)))
    assert terms.breaking.force is not None
    return law.natural_length * _stretch_at(law, terms.breaking.force)


def _stretch_at(law: Law, force: Floats) -> Floats:
    """The stretch s at which EA (s^2 - 1) / 2 s, the elastic tension, is the force; Newton's method."""
    wanted = 2.0 * force / law.stiffness  # s^3 - s
    stretch = 1.0 + np.minimum(0.5 * wanted, np.cbrt(wanted))  # not below the root, where s^3 - s is convex
    for _ in range(60):
        stretch = stretch - (stretch**3 - stretch - wanted) / (3.0 * stretch**2 - 1.0)
    return np.asarray(stretch)

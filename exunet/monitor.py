"""The ledger of energy over the steps of a run, and the guards that stop a run which has gone wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet import cable, energy
from exunet.effects.terms import Terms
from exunet.errors import RunStopped
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

# Kinetic + elastic + potential + dissipated energy may exceed its start by this part of the scale before a
# run is stopped. A converged run stays below 1e-5; 5 % is far outside what any sound setting shows.
ENERGY_GROWTH = 0.05


class Monitor:
    """Takes the states of the accepted steps; sums the dissipated energy and stops what has gone wrong.

    The work of the terms that have no potential is integrated by Simpson's rule between two states; the state
    in the middle is that of the cubic Hermite polynomial through both ends, (x0 + x1)/2 + h (v0 - v1)/8 and
    3/2 (x1 - x0)/h - (v0 + v1)/4, so the sum is of fourth order in the step.
    """

    def __init__(self, net: Net, terms: Terms, position: Floats, velocity: Floats) -> None:
        self._net = net
        self._terms = terms
        self.dissipated = 0.0
        self._start = float(self._mechanical(position[None], velocity[None])[0])
        self._scale = float(energy.kinetic(net, velocity) + energy.elastic(net, terms, position))
        self._fall = 0.0  # largest change of the potential energy, which may turn into motion
        self._potential = float(energy.potential(terms, position[None])[0])
        self._last_good = (0.0, position)

    @property
    def good_until(self) -> float:
        """Time [s] of the last state that had nothing wrong with it."""
        return self._last_good[0]

    def _mechanical(self, position: Floats, velocity: Floats) -> Floats:
        return (
            energy.kinetic(self._net, velocity)
            + energy.elastic(self._net, self._terms, position)
            + energy.potential(self._terms, position)
        )

    def __call__(self, time: Floats, position: Floats, velocity: Floats, taken: Floats | None = None) -> None:
        """Take a batch of states: time (k,), position and velocity (k, n_nodes, 3), first one known.

        taken : (k,) energy [J] that the integration itself says was taken out so far; None: summed here
        """
        self._check_finite(time, position, velocity)
        work = self._dissipation(time, position, velocity) if taken is None else np.diff(taken)
        self._check_energy(time, position, velocity, self.dissipated + np.cumsum(work))
        self.dissipated += float(work.sum())
        self._last_good = (float(time[-1]), position[-1])

    def _dissipation(self, time: Floats, position: Floats, velocity: Floats) -> Floats:
        """(k - 1,) energy taken out by terms without a potential in each step [J]."""
        if not self._terms.dissipates:
            return np.zeros(len(time) - 1)
        step = np.diff(time)
        h = step[:, None, None]
        place = 0.5 * (position[:-1] + position[1:]) + 0.125 * h * (velocity[:-1] - velocity[1:])
        speed = 1.5 * np.diff(position, axis=0) / h - 0.25 * (velocity[:-1] + velocity[1:])
        ends = energy.power_taken(self._net, self._terms, time, position, velocity)
        middle = energy.power_taken(self._net, self._terms, time[:-1] + 0.5 * step, place, speed)
        return step / 6.0 * (ends[:-1] + ends[1:] + 4.0 * middle)

    def _check_finite(self, time: Floats, position: Floats, velocity: Floats) -> None:
        finite = np.isfinite(position).all(axis=(1, 2)) & np.isfinite(velocity).all(axis=(1, 2))
        if finite.all():
            return
        bad = int(np.argmin(finite))
        if bad:
            self._last_good = (float(time[bad - 1]), position[bad - 1])
        worst = self._worst(*self._last_good)
        raise RunStopped(f"diverged at t = {time[bad]:.6g} s: the state is not finite; {worst}. {ADVICE}")

    def _check_energy(self, time: Floats, position: Floats, velocity: Floats, dissipated: Floats) -> None:
        kinetic = energy.kinetic(self._net, velocity[1:])
        elastic = energy.elastic(self._net, self._terms, position[1:])
        potential = energy.potential(self._terms, position[1:])
        self._fall = max(self._fall, float(np.max(np.abs(potential - self._potential), initial=0.0)))
        allowed = ENERGY_GROWTH * (self._scale + self._fall) + 1e-12
        growth = kinetic + elastic + potential + dissipated - self._start
        grown = growth > allowed
        if not grown.any():
            return
        bad = int(np.argmax(grown)) + 1
        self._last_good = (float(time[bad - 1]), position[bad - 1])
        raise RunStopped(
            f"diverged at t = {time[bad]:.6g} s: the energy grew by {growth[bad - 1]:.3g} J "
            f"(allowed {allowed:.3g} J); {self._worst(float(time[bad]), position[bad])}. {ADVICE}"
        )

    def _worst(self, time: float, position: Floats) -> str:
        length = cable.lengths(self._net, position)
        strain = cable.green_lagrange_strain(length, self._net.reference_length)
        element = int(np.argmax(strain))
        i, j = self._net.element_nodes[element]
        return (
            f"the most stretched element, at t = {time:.6g} s, is {element} between nodes {i} and {j}, "
            f"stretch {length[element] / self._net.reference_length[element]:.6g}"
        )


ADVICE = "Give a smaller solver.step (`exunet check` tells the stable one) or an adaptive method (DOPRI5)"

"""What an observer is told of all steps where it is not handed each state: extremes of energies, tensions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.work_space import PEAKS, SeenOfSteps, told_largest
from exunet.backends.protocol import Arrays, Extremes, Observer
from exunet.forces.cable import STRETCH_BOUND, elastic_energy, lengths
from exunet.forces.reel import Winding
from exunet.system.energy import law_of
from exunet.system.system import System

Floats = NDArray[np.float64]

THINNED = 64  # steps of which one is handed over


class StepSight:
    """Sets what compiled steps look for in a `SeenOfSteps`, which they fill, and tells what they found.

    No step is left out in which an element may be stretched beyond the law's validity (`keep_above`).
    """

    def __init__(self, system: System, seen: SeenOfSteps, observer: Observer) -> None:
        self._system, self._seen = system, seen
        self._peaks = {name: seen.peaks[name] for name in PEAKS.names or ()}
        self._asleep = 0.0  # elastic energy [J] of the elements that the kernel leaves out
        self._peaks["keep_above"][0] = least_energy_beyond(system)
        # Elements that other terms have are looked at here too; their energy is not among the elements'.
        each = observer.asks_for_elements or system.forces.cable.leaves_some
        self._peaks["look_above"][0] = -1.0 if each else 0.0

    def begin(self) -> None:
        """The steps that come are told of together."""
        peaks = self._peaks
        peaks["elastic"][0], peaks["kinetic"][0] = 0.0, np.inf

    @property
    def extremes(self) -> Extremes:
        """Energies of the steps since `begin`, tensions of all steps."""
        elastic, kinetic = (float(self._peaks[name][0]) for name in ("elastic", "kinetic"))
        largest = told_largest(self._seen.largest)
        return Extremes(elastic + self._asleep, kinetic, largest, self._seen.of_elements)

    def remember(self, memory: Arrays, x: Floats) -> None:
        """Take all memories into account, in a state x (n_x,)."""
        self._count_asleep(memory, x)
        cable, seen = self._system.forces.cable, self._seen
        carrying = cable.carrying(memory)
        if carrying is not None:
            seen.stiffness[:] = cable.law.stiffness * carrying
        for winding in cable.reels:
            self._see_outlet(winding, memory, x)
        seen.longest[:] = seen.length**2

    def _see_outlet(self, winding: Winding, memory: Arrays, x: Floats) -> None:
        """See an outlet that does not turn as an element; while it may turn, each state is handed over."""
        seen, wound_up = self._seen, list(winding.reel.elements)
        nodes = self._system.net.element_nodes[wound_up]
        seen.first[wound_up], seen.second[wound_up] = 3 * nodes.T
        seen.length[wound_up] = self._system.forces.cable.law.natural_length[wound_up]
        seen.jumps[wound_up] = seen.twice_time[wound_up]
        if winding.is_locked(memory):
            element, outlet = winding.outlet_now(memory)
            wound = float(x[outlet.state[0]])
            seen.first[element], seen.second[element] = outlet.drum[0], outlet.far[0]
            seen.length[element] = outlet.ratio * max(outlet.base - wound, outlet.least)
            seen.stiffness[element], seen.jumps[element] = outlet.stiffness, 0.0

    def _count_asleep(self, memory: Arrays, x: Floats) -> None:
        """The kernel leaves out elements between points that sleep; they count with the extremes."""
        cable, before = self._system.forces.cable, self._asleep
        moving = cable.moving(memory)
        if moving is not None:
            position = x[: 3 * self._system.blocks.n_points].reshape(-1, 3)
            law = law_of(self._system.forces, memory).of_intact((~moving).astype(float))
            self._asleep = float(elastic_energy(law, lengths(self._system.net, position)))
            self._peaks["elastic"] += before - self._asleep

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that was seen and what is looked for, for a snapshot; not copies."""
        return {
            f"{group}/{name}": record[name]
            for group, record in self._records
            for name in record.dtype.names or ()
        }

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave."""
        for group, record in self._records:
            for name in record.dtype.names or ():
                record[name] = arrays[f"{group}/{name}"]

    @property
    def _records(self) -> tuple[tuple[str, NDArray[np.void]], ...]:
        return ("seen", self._seen.peaks), ("largest", self._seen.largest)


def least_energy_beyond(system: System) -> float:
    """Elastic energy [J], eq. (19), without which no element of the net can be stretched by STRETCH_BOUND."""
    law = system.forces.cable.law
    strain = 0.5 * (STRETCH_BOUND**2 - 1.0)
    return 0.5 * strain**2 * float((law.stiffness * law.natural_length).min(initial=math.inf))

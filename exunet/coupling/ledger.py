"""Ledger of a coupling: impulse and work through each port, energy that the coupling adds, pending steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.coupling.net_system import NetSystem, PortLoads
from exunet.coupling.port_loops import port_loops

# Steps that wait for the books: to take one in takes as long as all else that is done in a step, many at once
# hardly longer.
_WAITING = 256


class WaitingSteps:
    """Those that are not in the books yet."""

    def __init__(self) -> None:
        self._ended: list[Ended] = []

    def add(self, step: Ended, books: Books) -> None:
        """Let a step wait, or write all that wait into the books."""
        self._ended.append(step)
        if len(self._ended) >= _WAITING:
            self.write(books)

    def write(self, books: Books) -> None:
        """Take the steps that wait into the books."""
        books.add(self._ended)
        self.forget()

    def forget(self) -> None:
        """Drop those that wait."""
        self._ended.clear()


Floats = NDArray[np.float64]

# Residual in parts of the energy that went through a port, beyond which the books doubt the coupling. On a
# spring at the largest stable step it is 0.07; a fifth beyond that it is 0.1, at twice that step 0.8.
DOUBTFUL = 0.1
# Residual in parts of the energy that the net has beside a port, below which it changes nothing that matters:
# a body of the net's mass would be faster by a hundredth of how fast the net moves. A port at rest that is
# pulled for the first time has a residual, and no energy has gone through it.
NEGLIGIBLE = 1e-4


@dataclass
class PortBook:
    """Of one port, since the coupling began; in the scene's axes.

    impulse, angular_impulse : (3,) that the net has given to the host's body [N s]; about the origin of the
                               scene [N m s]
    work                     : [J] that the net has done on the port, along its given motion
    residual                 : [J] work on the host's body less that: what the coupling has added
    largest                  : [J] the largest of a step, by amount
    passed                   : [J] sum of the works' amounts, which the residual is a part of
    launch                   : [J] that throws of the net have given to the host's body beside that work
    least, most              : [J] of what the work has come to at the ends of steps
    beside                   : [J] `NetSystem.energy_seen_from`, the largest that was looked at
    """

    impulse: Floats = field(default_factory=lambda: np.zeros(3))
    angular_impulse: Floats = field(default_factory=lambda: np.zeros(3))
    work: float = 0.0
    residual: float = 0.0
    largest: float = 0.0
    passed: float = 0.0
    launch: float = 0.0
    least: float = 0.0
    most: float = 0.0
    beside: float = 0.0

    @property
    def one_way(self) -> float:
        """Energy [J] that went through one way, at most, before it came back: the range of the work."""
        return self.most - self.least

    def numbers(self) -> Floats:
        """(13,) all but `beside`, for a snapshot."""
        sums = [self.work, self.residual, self.largest, self.passed, self.launch, self.least, self.most]
        return np.concatenate([self.impulse, self.angular_impulse, sums])

    def take(self, numbers: Floats) -> None:
        """Be what `numbers` gave."""
        self.impulse, self.angular_impulse = numbers[:3].copy(), numbers[3:6].copy()
        self.work, self.residual, self.largest, self.passed = numbers[6:10].tolist()
        self.launch, self.least, self.most = numbers[10:].tolist()


class Ended(NamedTuple):
    """A step that counts.

    applied : (n, 6) forces and torques of all ports that the host's method applied
    recoils : the jump of a throw is in it, whose launcher brings the energy that it leaves
    before, after : (n, 13) where the frames of the host's bodies were at both ends
    """

    loads: PortLoads
    applied: Floats
    recoils: bool
    before: Floats
    after: Floats


@dataclass
class Books:
    """Of all ports, and of the steps.

    steps, repeated   : macro steps that count, and those that were taken again
    shortest, longest : of them [s]
    cut               : how requested macro steps were changed; empty if they were not
    """

    ports: Mapping[str, PortBook]
    steps: int = 0
    repeated: int = 0
    shortest: float = np.inf
    longest: float = 0.0
    cut: str = ""

    @classmethod
    def of(cls, net: NetSystem) -> Books:
        """Empty ones of a net's ports."""
        return cls({name: PortBook() for name in net.ports}).looked_at(net)

    def looked_at(self, net: NetSystem) -> Books:
        """The same, which know the energies that the net has now, by which `doubts` judges."""
        for name, port in self.ports.items():
            port.beside = max(port.beside, net.energy_seen_from(name))
        return self

    def numbers(self) -> Floats:
        """(4 + 13 n,) all but `cut` and `beside`, for a snapshot."""
        steps = [float(self.steps), float(self.repeated), self.shortest, self.longest]
        return np.concatenate([steps, *(port.numbers() for port in self.ports.values())])

    def with_numbers(self, numbers: Floats) -> Books:
        """Of the same ports, with what `numbers` gave."""
        steps, repeated, shortest, longest = numbers[:4].tolist()
        rows = numbers[4:].reshape(len(self.ports), -1)
        ports = {name: PortBook(beside=port.beside) for name, port in self.ports.items()}
        for port, row in zip(ports.values(), rows, strict=True):
            port.take(row)
        return Books(ports, int(steps), int(repeated), shortest, longest, self.cut)

    def add(self, ended: Sequence[Ended]) -> None:
        """Add steps to the balance, in their order.

        The residual of a step is the work on the host's body, of the force that its method has applied, less
        that of the net along the given motion of the port.
        """
        if not ended:
            return
        loads, applied, recoils, before, after = zip(*ended, strict=True)
        steps = np.array([load.end - load.begin for load in loads])
        books = np.array([port.numbers() for port in self.ports.values()])
        arrays = ([item.taken for item in loads], applied, before, after)
        given, forces, begin, end = (np.array(array) for array in arrays)
        port_loops().enter(steps, np.array(recoils), forces, given, begin, end, books)
        for port, numbers in zip(self.ports.values(), books, strict=True):
            port.take(numbers)
        self.steps += len(ended)
        self.shortest = min(self.shortest, float(steps.min()))
        self.longest = max(self.longest, float(steps.max()))

    def net_is_behind(self, until: float, now: float, why: str) -> None:
        """Record that a guard has stopped the net at a time [s] before the end of the recorded steps."""
        self.cut = (
            f"the steps to t = {until:.6g} s are in the books, which the host took, but the net is at its "
            f"last good state, t = {now:.6g} s: {why}"
        )

    @property
    def residual(self) -> float:
        """Energy [J] that the coupling has added to host and net together, by all ports."""
        return sum(port.residual for port in self.ports.values())

    @property
    def doubts(self) -> tuple[str, ...]:
        """A sentence for each port whose residual is more than a tenth of the energy that went through it.

        Energy that is added is compared with what went one way: where amplitudes grow, the sum of amounts
        grows with them, by more in each swing than the residual does. What is below `NEGLIGIBLE` beside the
        net's own energy is left out.
        """
        found = []
        for name, port in self.ports.items():
            adds = port.residual > 0.0
            energy, words = (port.one_way, " one way") if adds else (port.passed, "")
            if abs(port.residual) > max(DOUBTFUL * energy, NEGLIGIBLE * port.beside):
                found.append(
                    f"WARNING: port {name}: the coupling has {'added' if adds else 'taken out'} "
                    f"{abs(port.residual):.4g} J, more than a tenth of the {energy:.4g} J that went "
                    f"through{words}: its motion is not to be trusted. Use shorter steps; mass and inertia "
                    "of the body in the case must be the host's, since the largest stable step is by them"
                )
        return tuple(found)

    def __str__(self) -> str:
        rows = [
            f"macro steps {self.steps} ({self.shortest:.4g} to {self.longest:.4g} s), "
            f"taken again {self.repeated}; energy added by the coupling {self.residual:.4g} J"
            if self.steps
            else "no macro step yet"
        ]
        rows += [self.cut] if self.cut else []
        rows += self.doubts
        for name, port in self.ports.items():
            rows += [
                f"port {name}: impulse {_vector(port.impulse)} N s, angular impulse about the scene's origin "
                f"{_vector(port.angular_impulse)} N m s",
                f"  work of the net on the port {port.work:.6g} J (amounts {port.passed:.4g} J); "
                f"residual {port.residual:.4g} J, in a step {port.largest:.4g} J at most",
            ]
            if port.launch:
                rows.append(f"  energy of throws in the host's body {port.launch:.4g} J")
        return "\n".join(rows)


def _vector(values: Floats) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"

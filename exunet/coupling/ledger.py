"""Ledger of a coupling: impulse and work through each port, and energy that the coupling adds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.coupling.net_system import NetSystem, PortLoads, port_loops

Floats = NDArray[np.float64]

# Steps that are added at once: one at a time takes as long as the rest of a step, many hardly longer than
# one.
_PENDING = 256
# Bound of the residual relative to the energy through a port. On a spring at the largest stable step it is
# 0.07; a fifth beyond that it is 0.1, at twice that step 0.8.
DOUBTFUL = 0.1
# Bound of the residual relative to the energy of the net seen from a port: a body of the net's mass would be
# faster by a hundredth of the speed of the net. A port at rest that is pulled for the first time has a
# residual, while no energy has gone through it.
NEGLIGIBLE = 1e-4


class PortBalance(NamedTuple):
    """Balance of one port since the start of the coupling; in the scene's axes.

    impulse, angular_impulse : (3,) of the net on the host's body [N s]; about the scene's origin [N m s]
    work               : [J] of the net on the port, along its prescribed motion
    residual           : [J] work on the host's body less `work`: energy that the coupling has added
    max_residual       : [J] largest absolute value in a step
    exchanged          : [J] sum of the absolute works
    launch             : [J] of ejections on the host's body beside `work`
    min_work, max_work : [J] of `work` at the ends of steps
    net_energy         : [J] `NetSystem.energy_seen_from`, the largest that was read
    """

    impulse: Floats = np.zeros(3)
    angular_impulse: Floats = np.zeros(3)
    work: float = 0.0
    residual: float = 0.0
    max_residual: float = 0.0
    exchanged: float = 0.0
    launch: float = 0.0
    min_work: float = 0.0
    max_work: float = 0.0
    net_energy: float = 0.0

    @property
    def one_way(self) -> float:
        """Largest energy [J] that went one way before it came back: the range of the work."""
        return self.max_work - self.min_work

    @property
    def compared(self) -> float:
        """Energy [J] to compare the residual with: if that is positive, what went one way.

        Where amplitudes grow, the sum of absolute works grows with them, faster than the residual.
        """
        return self.one_way if self.residual > 0.0 else self.exchanged

    @property
    def is_doubtful(self) -> bool:
        """True if the residual is more than a tenth of the energy through the port, and not negligible."""
        return abs(self.residual) > max(DOUBTFUL * self.compared, NEGLIGIBLE * self.net_energy)


class CountedStep(NamedTuple):
    """Macro step that counts.

    recoils : the step contains the jump of an ejection, whose launcher supplies the energy
    before, after : (n, 13) states of the frames of the host's bodies at both ends
    """

    loads: PortLoads
    recoils: bool
    before: Floats
    after: Floats


class Ledger:
    """Balances of all ports, and statistics of the macro steps.

    steps, repeated   : numbers of macro steps that count, and of repeats
    shortest, longest : macro steps [s]
    note              : how requested macro steps were changed, or why steps are missing; "" if neither
    """

    def __init__(self, net: NetSystem) -> None:
        self.steps = self.repeated = 0
        self.shortest, self.longest = np.inf, 0.0
        self.note = ""
        self._net = net
        self._balances = np.zeros((len(net.ports), 13))  # all of `PortBalance` except `net_energy`
        self._energies = np.zeros(len(net.ports))
        self._pending: list[CountedStep] = []
        self.update()

    @property
    def ports(self) -> dict[str, PortBalance]:
        """Balance by the name of the port."""
        rows = zip(self._net.ports, self._balances.copy(), self._energies.tolist(), strict=True)
        return {
            name: PortBalance._make([row[:3], row[3:6], *row[6:].tolist(), energy])
            for name, row, energy in rows
        }

    def record(self, step: CountedStep) -> None:
        """Record a step; balances follow at the next `update`, or with the last of many steps."""
        self._pending.append(step)
        if len(self._pending) >= _PENDING:
            self._add_pending()

    def update(self) -> Ledger:
        """Add all recorded steps, and read the energies of the net, to which `warnings` refers."""
        self._add_pending()
        energies = [self._net.energy_seen_from(name) for name in self._net.ports]
        self._energies = np.maximum(self._energies, energies)
        return self

    def _add_pending(self) -> None:
        if not self._pending:
            return
        loads, recoils, before, after = zip(*self._pending, strict=True)
        steps = np.array([load.end - load.begin for load in loads])
        arrays = (
            np.array(part)
            for part in ([load.wrenches for load in loads], [load.impulses for load in loads], before, after)
        )
        port_loops().add_to_balances(steps, np.array(recoils), *arrays, self._balances)
        self.steps += len(steps)
        self.shortest = min(self.shortest, float(steps.min()))
        self.longest = max(self.longest, float(steps.max()))
        self._pending.clear()

    def as_array(self) -> Floats:
        """(4 + 13 n,) all values except `note` and the energies of the net."""
        self._add_pending()
        steps = [float(self.steps), float(self.repeated), self.shortest, self.longest]
        return np.concatenate([steps, self._balances.ravel()])

    def set_array(self, values: Floats) -> None:
        """Set the values of `as_array`, and discard recorded steps."""
        self._pending.clear()
        steps, repeated, self.shortest, self.longest = values[:4].tolist()
        self.steps, self.repeated = int(steps), int(repeated)
        self._balances[:] = values[4:].reshape(self._balances.shape)

    def net_is_behind(self, until: float, now: float, why: str) -> None:
        """Note that a guard has stopped the net at a time [s] before the end of the recorded steps."""
        self.note = (
            f"the balance contains the steps to t = {until:.6g} s of the host, but the net is at its last "
            f"good state, t = {now:.6g} s: {why}"
        )

    @property
    def residual(self) -> float:
        """Energy [J] that the coupling has added to host and net by all ports."""
        return sum(port.residual for port in self.ports.values())

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each port whose balance is doubtful."""
        return tuple(
            f"WARNING: port {name}: the coupling has {'added' if port.residual > 0.0 else 'removed'} "
            f"{abs(port.residual):.4g} J, more than a tenth of the {port.compared:.4g} J that went through: "
            "its motion is unreliable. Use shorter steps; mass and inertia of the body in the case must be "
            "the host's, since they determine the largest stable step"
            for name, port in self.ports.items()
            if port.is_doubtful
        )

    def __str__(self) -> str:
        rows = [
            f"macro steps {self.steps} ({self.shortest:.4g} to {self.longest:.4g} s), repeated "
            f"{self.repeated}; energy added by the coupling {self.residual:.4g} J"
            if self.steps
            else "no macro step yet"
        ]
        rows += [self.note] if self.note else []
        rows += self.warnings
        for name, port in self.ports.items():
            rows += [
                f"port {name}: impulse {_vector(port.impulse)} N s, angular impulse about the scene's "
                f"origin {_vector(port.angular_impulse)} N m s",
                f"  work of the net on the port {port.work:.6g} J (absolute {port.exchanged:.4g} J); "
                f"residual {port.residual:.4g} J, largest in a step {port.max_residual:.4g} J",
            ]
            if port.launch:
                rows.append(f"  energy of ejections in the host's body {port.launch:.4g} J")
        return "\n".join(rows)


def _vector(values: Floats) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"

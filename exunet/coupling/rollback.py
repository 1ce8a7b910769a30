"""Net of a coupling: prediction of its ports, repeated steps, snapshots; impulse and work at each port."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr
from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.files import group_of, grouped, path_of, read_arrays, write_arrays
from exunet.bodies.port import PER_FRAME
from exunet.coupling.net_system import Earlier, NetSystem, PortLoads, port_loops
from exunet.simulation.snapshot import Snapshot

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


KIND, FORMAT = "exunet coupling snapshot", 1


class Predictor:
    """Motion of the host's bodies, predicted at the mean acceleration of the step before.

    before : begin of the last step that counts [s], states (n, 13) of all frames then; None before the first
    """

    def __init__(self, before: tuple[float, Floats] | None = None) -> None:
        self.before = before

    def ahead(self, begin: float, until: float, now: Floats) -> Floats:
        """Return states (n, 13) at `until` [s] from those at `begin`; a repeated step is predicted alike."""
        ahead = np.empty_like(now)
        port_loops().extrapolate(now, *self.earlier(begin, now), until - begin, ahead)
        return ahead

    def earlier(self, begin: float, now: Floats) -> Earlier:
        """Return the step before the one that begins at a time [s] with states (n, 13)."""
        if self.before is None or not self.before[0] < begin:
            return Earlier(now, 0.0)
        return Earlier(self.before[1], begin - self.before[0])

    def keep(self, begin: float, now: Floats, *, recoils: bool) -> None:
        """Count the step that began at a time [s] with states (n, 13); after a jump, predict without it."""
        self.before = None if recoils else (begin, now)

    def as_array(self) -> Floats:
        """Return time and states in one array; empty before the first step."""
        return (
            np.zeros(0) if self.before is None else np.concatenate([[self.before[0]], self.before[1].ravel()])
        )

    @classmethod
    def of_array(cls, values: Floats) -> Predictor:
        """Return the predictor of `as_array`."""
        return cls((float(values[0]), values[1:].reshape(-1, PER_FRAME).copy()) if len(values) else None)

    @staticmethod
    def accepts(ports: Sequence[str], values: Floats) -> bool:
        """Return True for an array with the shape of `as_array` for these ports."""
        return values.dtype == np.float64 and values.shape in ((0,), (1 + PER_FRAME * len(ports),))


# Steps between two snapshots: few after a step was repeated, since the next one may be too, then more and
# more. Before a snapshot the guards check all states, which takes as long as ten steps of a net with 20 x 20
# meshes.
_MIN_STEPS, _MAX_STEPS = 4, 512


class StepHistory:
    """Steps of a net of which the last can be undone, bitwise, by repeating those since the last snapshot.

    Forces, inputs and commands that the net got between steps act in repeated steps as before. Those since
    the end of an undone step remain: they are for the next step. Those of a controller within it are undone.
    """

    def __init__(self, net: NetSystem) -> None:
        self._net = net
        self._every = _MAX_STEPS
        self._keep()

    def _keep(self) -> None:
        self._net.finish()  # a snapshot with states that the guards have not checked is large
        self._kept = self._net.snapshot()
        self._taken: list[tuple[float, Floats]] = []
        self._acting = self._net.simulation.acting  # at the end of the last step

    @property
    def begin(self) -> float:
        """Begin of the last step [s], or the present time if that cannot be undone."""
        if not self._taken:
            return self._net.time
        return self._taken[-2][0] if len(self._taken) > 1 else self._kept.time

    def step(self, until: float, states: Floats) -> PortLoads:
        """Advance as `NetSystem.follow`."""
        simulation, taken = self._net.simulation, self._taken
        if simulation.time != (taken[-1][0] if taken else self._kept.time):
            self._keep()  # the net was restored separately
        if simulation.acting is not self._acting:
            self._keep()  # repeated steps must get the command at its time
        if len(self._taken) >= self._every:
            self._keep()
            self._every = min(_MAX_STEPS, 2 * self._every)
        loads = self._net.follow(until, states)
        self._taken.append((until, states))
        self._acting = simulation.acting
        return loads

    def undo(self) -> None:
        """Undo the last step."""
        again, simulation = self._taken[:-1], self._net.simulation
        then, now = self._acting, simulation.acting
        self._net.restore(self._kept)
        for until, states in again:
            self._net.follow(until, states)
        self._taken, self._acting = again, simulation.acting
        self._every = _MIN_STEPS
        if now is not then:
            simulation.repeat_changes(then, now)


@dataclass(frozen=True, eq=False, repr=False)
class CoupledSnapshot(ShortRepr):
    """Snapshot of a `Coupler`.

    ports  : names, in the net's order
    net    : of the net
    host   : of the host; a file requires a `Snapshot`, or arrays by name
    discrete : arrays of the coupling, by name
    """

    ports: tuple[str, ...]
    net: Snapshot
    host: Any
    discrete: Mapping[str, Floats]

    @property
    def time(self) -> float:
        """Time of the snapshot [s]."""
        return self.net.time

    def save(self, path: str | Path) -> None:
        """Write a file, whole or not at all; raises InputError, also for another kind of host's snapshot."""
        path, host = path_of(path, "CoupledSnapshot.save"), self.host
        is_own = isinstance(host, Snapshot)
        if is_own:
            host = {"snapshot": _as_bytes(host)}
        elif not (isinstance(host, Mapping) and all(isinstance(part, np.ndarray) for part in host.values())):
            raise InputError(
                f"{path}: a file cannot contain a {type(host).__name__}: `snapshot` of the host must return "
                "an exunet.Snapshot, or NumPy arrays by name"
            )
        header = {"ports": list(self.ports), "host": "exunet" if is_own else "arrays"}
        arrays = {"net": _as_bytes(self.net), **grouped("host", host), **grouped("discrete", self.discrete)}
        write_arrays(path, KIND, FORMAT, header, arrays)

    @classmethod
    def load(cls, path: str | Path) -> CoupledSnapshot:
        """Read a file of `save`; raises InputError if it is damaged or of another kind or version."""
        header, arrays = read_arrays(path_of(path, "CoupledSnapshot.load"), KIND, FORMAT)
        host: Any = group_of("host", arrays)
        if header["host"] == "exunet":
            host = Snapshot.of_bytes(host["snapshot"].tobytes())
        net = Snapshot.of_bytes(arrays["net"].tobytes())
        return cls(tuple(header["ports"]), net, host, group_of("discrete", arrays))


def _as_bytes(snapshot: Snapshot) -> NDArray[np.uint8]:
    return np.frombuffer(snapshot.as_bytes(), dtype=np.uint8)

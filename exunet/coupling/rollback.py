"""Net of a coupling: prediction of its ports, repeated steps, and snapshots of net, host and coupling."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr
from exunet.base.errors import InputError
from exunet.base.files import path_of, read_arrays, write_arrays
from exunet.bodies.port import PER_FRAME
from exunet.coupling.ledger import CountedStep, Ledger
from exunet.coupling.net_system import Earlier, NetSystem, PortLoads, port_loops
from exunet.simulation.snapshot import Snapshot, group_of, grouped

Floats = NDArray[np.float64]
KIND, FORMAT = "exunet coupling snapshot", 1
_ROUND_OFF = 1e-12  # of a quaternion
_MAY_BE_EMPTY = "before"  # array of a memory before the first step


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
    memory : arrays of the coupling, by name
    """

    ports: tuple[str, ...]
    net: Snapshot
    host: Any
    memory: Mapping[str, Floats]

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
        arrays = {"net": _as_bytes(self.net), **grouped("host", host), **grouped("memory", self.memory)}
        write_arrays(path, KIND, FORMAT, header, arrays)

    @classmethod
    def load(cls, path: str | Path) -> CoupledSnapshot:
        """Read a file of `save`; raises InputError if it is damaged or of another kind or version."""
        header, arrays = read_arrays(path_of(path, "CoupledSnapshot.load"), KIND, FORMAT)
        host: Any = group_of("host", arrays)
        if header["host"] == "exunet":
            host = Snapshot.of_bytes(host["snapshot"].tobytes())
        net = Snapshot.of_bytes(arrays["net"].tobytes())
        return cls(tuple(header["ports"]), net, host, group_of("memory", arrays))


def _as_bytes(snapshot: Snapshot) -> NDArray[np.uint8]:
    return np.frombuffer(snapshot.as_bytes(), dtype=np.uint8)


class CoupledNet:
    """Net's side of a coupling: steps, balances, and where the coupling has left the net.

    Raises InputError for another object than a `NetSystem`, and for a net without ports.
    """

    def __init__(self, net: NetSystem) -> None:
        if not isinstance(net, NetSystem):
            raise InputError(f"Coupler: net: must be an exunet.NetSystem, got {type(net).__name__}")
        if not net.ports:
            raise InputError('Coupler: the net has no port: give a body of its case motion = "port"')
        self.net = net
        self.ledger, self.predictor, self.history = Ledger(net), Predictor(), StepHistory(net)
        self.leave()

    def leave(self) -> None:
        """Record where the coupling leaves the net."""
        self.left_at, self._left = self.net.time, self.net.state_vector()

    def validate_left(self) -> None:
        """Raise InputError unless the net is where the coupling left it; attitudes to round-off.

        A command to the net computes its ports anew, which changes attitudes by round-off.
        """
        net, exact = self.net, len(self._left) - self.net.simulation.moving.bodies.attitude.size
        now, left = net.state_vector(), self._left
        if not (
            self.left_at == net.time
            and np.array_equal(left[:exact], now[:exact])
            and np.allclose(left[exact:], now[exact:], rtol=0.0, atol=_ROUND_OFF)
        ):
            raise InputError(
                f"Coupler: the net, at t = {net.time:.9g} s, is not where the coupling left it: "
                "restore net and host by a snapshot of the coupling, which contains the steps before, or "
                "make a new Coupler with both at the start"
            )

    def record(self, loads: PortLoads, states: tuple[Floats, Floats], *, recoils: bool) -> None:
        """Record a step that counts.

        states  : (n, 13) of the host's frames at both ends
        recoils : the step contains the jump of an ejection
        """
        self.ledger.record(CountedStep(loads, recoils, *states))
        self.predictor.keep(loads.begin, states[0], recoils=recoils)

    def snapshot(self, host: Any, memory: Mapping[str, Floats]) -> CoupledSnapshot:
        """Return a snapshot with one of the host, and with arrays of the coupling."""
        own = {"before": self.predictor.as_array(), "ledger": self.ledger.as_array()}
        return CoupledSnapshot(self.net.ports, self.net.snapshot(), host, own | dict(memory))

    def restore(
        self, given: CoupledSnapshot, like: Mapping[str, Floats], restore_host: Callable[[Any], object]
    ) -> Mapping[str, Floats]:
        """Restore net and host, and return the arrays of the coupling.

        like : arrays of the coupling as they are now
        Raises InputError for a snapshot of another coupling, net or host; net and coupling are then
        unchanged.
        """
        net = self.net
        if not isinstance(given, CoupledSnapshot):
            words = "requires a result of `snapshot` or `CoupledSnapshot.load`"
            raise InputError(f"Coupler: restore: {words}, got {given!r}")
        if given.ports != net.ports:
            raise InputError(
                f"Coupler: restore: the snapshot of t = {given.time:g} s is of a coupling with ports "
                f"{', '.join(given.ports)}, this is one with {', '.join(net.ports)}"
            )
        own, memory = {"before": self.predictor.as_array(), "ledger": self.ledger.as_array()}, given.memory
        if memory.keys() != own.keys() | like.keys() or any(
            part.shape != memory[name].shape
            for name, part in (own | dict(like)).items()
            if name != _MAY_BE_EMPTY or (len(part) and len(memory[name]))
        ):
            raise InputError(f"Coupler: restore: the snapshot of t = {given.time:g} s is damaged")
        net.finish()
        here = net.snapshot()
        net.restore(given.net)
        try:
            restore_host(given.host)
        except BaseException:
            net.restore(here)
            raise
        self.predictor = Predictor.of_array(memory["before"])
        self.ledger.set_array(memory["ledger"])
        self.history = StepHistory(net)
        self.leave()
        return memory

"""Rollback of a coupling: snapshots of net, host and scheme, and steps that are repeated from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.base.files import path_of, read_arrays, write_arrays
from exunet.base.short_repr import ShortRepr
from exunet.coupling.net_system import NetSystem, PortLoads
from exunet.coupling.ports import Earlier
from exunet.simulation.snapshot import Snapshot, group_of, grouped

Floats = NDArray[np.float64]
KIND, FORMAT = "exunet coupling snapshot", 1
_ROUND_OFF = 1e-12  # of a quaternion
_MAY_BE_EMPTY = ("before", "mean")  # of a memory, where there was no step before


@dataclass(frozen=True, eq=False, repr=False)
class CoupledSnapshot(ShortRepr):
    """What `Cosimulation.restore`, or the `restore` of what `couple` gave, goes back to.

    scheme : "Cosimulation" or "couple"
    ports  : names, in the net's order
    net    : of the net
    host   : what the host gave; of a file if that is a `Snapshot`, or arrays by name
    memory : numbers that the scheme remembers, by name
    """

    scheme: str
    ports: tuple[str, ...]
    net: Snapshot
    host: Any
    memory: Mapping[str, Floats]

    @property
    def time(self) -> float:
        """The instant [s]."""
        return self.net.time

    def save(self, path: str | Path) -> None:
        """Write it to a file, whole or not at all.

        Raises InputError if that cannot be written, or for a host whose snapshot is neither exunet's nor
        arrays by name.
        """
        path = path_of(path, "CoupledSnapshot.save")
        if isinstance(self.host, Snapshot):
            host = {"snapshot": _as_numbers(self.host)}
        elif isinstance(self.host, Mapping) and all(
            isinstance(item, np.ndarray) for item in self.host.values()
        ):
            host = dict(self.host)
        else:
            raise InputError(
                f"{path}: a host whose snapshot is a {type(self.host).__name__} is not of a file: give an "
                "exunet.Snapshot, or NumPy arrays by name, from its `snapshot`"
            )
        header = {
            "scheme": self.scheme,
            "ports": list(self.ports),
            "host": "exunet" if isinstance(self.host, Snapshot) else "arrays",
        }
        arrays = {"net": _as_numbers(self.net), **grouped("host", host), **grouped("memory", self.memory)}
        write_arrays(path, KIND, FORMAT, header, arrays)

    @classmethod
    def load(cls, path: str | Path) -> CoupledSnapshot:
        """Read what `save` wrote; raises InputError if the file is damaged or of another kind or version."""
        header, arrays = read_arrays(path_of(path, "CoupledSnapshot.load"), KIND, FORMAT)
        host: Any = group_of("host", arrays)
        if header["host"] == "exunet":
            host = Snapshot.of_bytes(host["snapshot"].tobytes())
        net = Snapshot.of_bytes(arrays["net"].tobytes())
        return cls(header["scheme"], tuple(header["ports"]), net, host, group_of("memory", arrays))

    def refuse_other(self, scheme: str, net: NetSystem, like: Mapping[str, Floats]) -> None:
        """Raise InputError if it is of another kind of coupling, of other ports, or of a net of another case.

        like : a memory of the coupling
        """
        if self.scheme != scheme or self.ports != net.ports:
            raise InputError(
                f"{scheme}: restore: the snapshot of t = {self.time:g} s is of a {self.scheme} with ports "
                f"{', '.join(self.ports)}, this is one with {', '.join(net.ports)}"
            )
        sound = self.memory.keys() == like.keys() and all(
            part.shape == like[name].shape
            for name, part in self.memory.items()
            if name not in _MAY_BE_EMPTY or (len(part) and len(like[name]))
        )
        if not sound:
            raise InputError(f"{scheme}: restore: the snapshot of t = {self.time:g} s is damaged")


def refuse_none(scheme: str, snapshot: object) -> CoupledSnapshot:
    """The snapshot, if it is one; raises InputError."""
    if not isinstance(snapshot, CoupledSnapshot):
        raise InputError(
            f"{scheme}: restore: needs what its `snapshot` or `CoupledSnapshot.load` gave, got {snapshot!r}"
        )
    return snapshot


class NetAsLeft(NamedTuple):
    """Where a net stands, as far as a coupling can tell: time, bodies, and what these have been given.

    numbers : see `NetSystem.stands`
    """

    time: float
    numbers: Floats

    @classmethod
    def of(cls, net: NetSystem) -> NetAsLeft:
        """Where it stands now; copies."""
        return cls(net.time, net.stands())

    def is_of(self, net: NetSystem) -> bool:
        """True if a net stands there; attitudes to round-off, as a command has ports computed anew."""
        now, exact = NetAsLeft.of(net), len(self.numbers) - net.simulation.moving.bodies.attitude.size
        return (
            self.time == now.time
            and np.array_equal(self.numbers[:exact], now.numbers[:exact])
            and bool(np.allclose(self.numbers[exact:], now.numbers[exact:], rtol=0.0, atol=_ROUND_OFF))
        )


def _as_numbers(snapshot: Snapshot) -> NDArray[np.uint8]:
    return np.frombuffer(snapshot.as_bytes(), dtype=np.uint8)


# Steps between two snapshots: few after a step was taken back, since the next one may be too; more and more
# while that does not happen. Before each the guards look at all states, which takes as long as ten steps of a
# net with 20 x 20 meshes: a host that takes no step back is not to pay for many.
_LEAST, _MOST = 4, 512


class Undo:
    """Steps of a net of which the last one can be taken back, to the last bit.

    Forces, inputs and commands that the net was given between steps act in the steps that are taken again as
    they did. Those given since the end of the step that is taken back stay: they are meant for what comes.
    Those that a controller of the net gave within it are taken back with it.
    """

    def __init__(self, net: NetSystem) -> None:
        self._net = net
        self._every = _MOST
        self._keep()

    def _keep(self) -> None:
        self._net.finish()  # a snapshot of states that wait to be looked at would be large
        self._kept = self._net.snapshot()
        self._taken: list[tuple[float, Floats]] = []
        self._acting = self._net.simulation.acting  # at the end of the last step

    @property
    def begin(self) -> float:
        """Time [s] at which the last step began, or the time reached if it cannot be taken back."""
        if not self._taken:
            return self._net.time
        return self._taken[-2][0] if len(self._taken) > 1 else self._kept.time

    def step(self, until: float, told: Floats) -> PortLoads:
        """As `NetSystem.follow`."""
        self._keep_now_and_then()
        loads = self._net.follow(until, told)
        self._taken.append((until, told))
        self._acting = self._net.simulation.acting
        return loads

    def go_on(self, until: float, now: Floats, earlier: Earlier) -> PortLoads:
        """As `NetSystem.go_on`."""
        self._keep_now_and_then()
        told, loads = self._net.go_on(until, now, earlier)
        self._taken.append((until, told))
        self._acting = self._net.simulation.acting
        return loads

    def _keep_now_and_then(self) -> None:
        simulation, taken = self._net.simulation, self._taken
        if simulation.time != (taken[-1][0] if taken else self._kept.time):
            self._keep()  # somebody has set the net back
        if simulation.acting is not self._acting:
            self._keep()  # a command came, which steps that are taken again are not to be given late
        if len(self._taken) >= self._every:
            self._keep()
            self._every = min(_MOST, 2 * self._every)

    def back(self) -> None:
        """Take the last step back."""
        again, simulation = self._taken[:-1], self._net.simulation
        then, now = self._acting, simulation.acting
        self._net.restore(self._kept)
        for until, told in again:
            self._net.follow(until, told)
        self._taken, self._acting = again, simulation.acting
        self._every = _LEAST
        if now is not then:
            simulation.repeat_changes(then, now)

"""Ports at markers of an Exudyn system: how they move, and a force and a torque at each.

Loads and markers of the user's may be deleted, which changes the numbers of others. So the loads added here
have names, and know the numbers of their markers. Looking names up takes longer than all else that is done
here in a step, so the numbers are kept until a solver starts, or there are more or fewer loads or markers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import count, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import whole_number
from exunet.base.errors import InputError
from exunet.bodies.port import PER_FRAME
from exunet.coupling.host import together
from exunet.coupling.port_loops import port_loops
from exunet.coupling.ports import HostStep, Jump
from exunet.integrators.exudyn.engine import exudyn, exudyn_items

Floats = NDArray[np.float64]
_counted = count(1)
_NEAR = 1e-9  # [s], or of the time, by which the engine's times may be off: it adds them up


class MarkedPorts:
    """Of a system.

    who     : for the words of errors
    markers : number of a marker with position and attitude, by the name of the port
    Raises InputError for what is no such marker; the system stays as it was until `add_loads`.
    """

    def __init__(self, who: str, mbs: Any, markers: Mapping[str, int]) -> None:
        self._who, self._mbs, self._data, self._engine = who, mbs, mbs.systemData, exudyn(quiet=False)
        self._first = {name: self._marker(name, number) for name, number in markers.items()}
        self._loads: dict[str, tuple[str, str]] = {}
        self._acts: list[list[float]] = []  # a force and a torque of each port
        self._found: dict[str, int] = {}  # the markers
        self._act_between(0.0, 0.0)
        self._ends = False  # after that no force acts
        self._items = (0, 0)  # loads and markers that there were when the numbers were looked up
        what = self._engine.OutputVariableType
        self._outputs = what.Position, what.Velocity, what.RotationMatrix, what.AngularVelocityLocal
        self._seen = np.empty((len(markers), 18))
        self._current, self._output = self._engine.ConfigurationType.Current, mbs.GetMarkerOutput

    @property
    def names(self) -> tuple[str, ...]:
        """Of the ports."""
        return tuple(self._first)

    def at_start(self) -> Floats:
        """(n, 13) states of the markers' frames at the start, of a system that is assembled."""
        return self._read(self._first, self._engine.ConfigurationType.Initial, None)[0]

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """Ports at markers of one body, or one node, together."""
        return together(self._owners())

    def on_one_body_with(self, other: MarkedPorts) -> Iterator[tuple[str, str]]:
        """Each port, with each of another net's in the same system, that are one body."""
        for (own, here), (name, there) in product(self._owners().items(), other._owners().items()):
            if here == there:
                yield own, name

    def _owners(self) -> dict[str, tuple[str, int]]:
        """What each port is on, by the markers' numbers of now."""
        if self._loads:
            self.look_up()
            return {name: self._owner(marker) for name, marker in self._found.items()}
        return {name: self._owner(number) for name, number in self._first.items()}

    def _owner(self, marker: int) -> tuple[str, int]:
        """What a marker is on, by the engine's key and number."""
        item = self._mbs.GetMarker(marker)
        key = next((key for key in ("bodyNumber", "nodeNumber") if key in item), "")
        return (key, int(item[key])) if key else ("marker", marker)

    def _acting(self, number: int, _: Any, time: float, __: list[float]) -> list[float]:
        """The load of a number, at a time [s]; an error where what was given is for another step."""
        earliest, latest = self._within
        if earliest <= time <= latest:
            return self._acts[number]
        if self._ends:
            return [0.0, 0.0, 0.0]
        begin, end = self._times
        raise InputError(
            f"{self._who}: port {', '.join(self.names)}: the host is at t = {time:.6g} s, but its forces are "
            f"for the step from {begin:.6g} s to {end:.6g} s: the coupling's pre-step function was not "
            "called. One that is set after `couple` has to call the one before it in each step; detach() ends"
            " a coupling"
        )

    def add_loads(self, time: float) -> None:
        """Add a force and a torque at each marker, zero at first, at a time [s], and assemble the system."""
        self._act_between(time, time)
        items, own = exudyn_items(), next(_counted)
        for port, marker in self._first.items():
            force, torque = (f"exunet {own}: {what} of {port}" for what in ("force", "torque"))
            kinds = {force: items.LoadForceVector, torque: items.LoadTorqueVector}
            for name, kind in kinds.items():
                acting = partial(self._acting, len(self._acts))
                self._acts.append([0.0, 0.0, 0.0])
                self._mbs.AddLoad(kind(name=name, markerNumber=marker, loadVectorUserFunction=acting))
            self._loads[port] = force, torque
        self._mbs.Assemble()
        self.look_up()

    def look_up(self) -> None:
        """Look up the numbers of loads and markers, which may be others when a solver starts.

        Raises InputError for a load of the coupling that is not there any more.
        """
        self._items = self._number_of_items()
        self._found = {port: self._marker_of(port) for port in self._loads}

    def now(self) -> Floats:
        """(n, 13) states of the markers' frames now."""
        return self.at_end(None)[0]

    def at_end(self, step: HostStep | None) -> tuple[Floats, Jump | None]:
        """As `now`, and whether a frame has jumped in the step that has led there."""
        if self._items != self._number_of_items():
            self.look_up()
        return self._read(self._found, self._current, step)

    def let_act(self, wrenches: Floats, begin: float, end: float) -> None:
        """Forces [N] and torques [N m] of the ports, six numbers each, in a step between two times [s]."""
        self._act_between(begin, end)
        self._acts = wrenches.reshape(-1, 3).tolist()

    def _act_between(self, begin: float, end: float) -> None:
        """Forces are for the step between two times [s]."""
        near = _NEAR * max(1.0, abs(end))
        self._times, self._within = (begin, end), (begin - near, end + near)

    def _number_of_items(self) -> tuple[int, int]:
        """Of loads and of markers in the user's system."""
        return self._data.NumberOfLoads(), self._data.NumberOfMarkers()

    def let_go(self, *, at_end: bool = False) -> None:
        """No force acts any more.

        at_end : but until the end of the step that they were made for
        """
        self._ends = True
        if not at_end:
            self._acts = [[0.0, 0.0, 0.0] for _ in self._acts]

    def _marker(self, name: str, given: int) -> int:
        number, count_of_all = whole_number(given), self._mbs.systemData.NumberOfMarkers()
        if number is None or not 0 <= number < count_of_all:
            raise InputError(
                f"{self._who}: port {name}: there is no marker {given!r}: the system has {count_of_all}"
            )
        kind = str(self._mbs.GetMarker(number)["markerType"])
        if "Rigid" not in kind:
            raise InputError(
                f"{self._who}: port {name}: marker {number} ({kind}) has no attitude: use a marker of a "
                "rigid frame such as MarkerBodyRigid"
            )
        return number

    def _marker_of(self, port: str) -> int:
        """Its number now, that of the loads at it."""
        force, torque = (int(self._mbs.GetLoadNumber(name)) for name in self._loads[port])
        if force < 0 or torque < 0:
            raise InputError(
                f"{self._who}: port {port}: a load that the coupling has added was deleted: it cannot go "
                "on. Use detach() to end a coupling"
            )
        marker = int(self._mbs.GetLoadParameter(force, "markerNumber"))
        if marker < 0:
            raise InputError(
                f"{self._who}: port {port}: its marker was deleted: the coupling cannot go on. Use detach() "
                "to end it"
            )
        return marker

    def _read(
        self, markers: Mapping[str, int], configuration: Any, step: HostStep | None
    ) -> tuple[Floats, Jump | None]:
        """(n, 13) states of the frames of markers, by the names of their ports; see `at_end`."""
        output, (place, speed, turn, spin) = self._output, self._outputs
        for row, (name, marker) in zip(self._seen, markers.items(), strict=True):
            try:
                row[:3] = output(marker, place, configuration)
                row[3:6] = output(marker, speed, configuration)
                row[6:15] = output(marker, turn, configuration)
                row[15:] = output(marker, spin, configuration)
            except Exception as error:
                raise self._unreadable(name, marker, error) from error
        frames, jump = np.empty((len(markers), PER_FRAME)), None
        if step is None:
            wrong = port_loops().see(self._seen, frames)
        else:
            wrong, jump = port_loops().see_ended(self._seen, frames, *step)
        if wrong >= 0:
            name, marker = list(markers.items())[wrong]
            raise InputError(
                f"{self._who}: port {name}: marker {marker} contains NaN or infinity: the host diverged"
            )
        return frames, jump

    def _unreadable(self, name: str, marker: int, error: Exception) -> InputError:
        """What to say of a marker that cannot be read."""
        if self._owner(marker)[1] < 0:
            return InputError(
                f"{self._who}: port {name}: the body of its marker {marker} was deleted: the coupling "
                "cannot go on. Use detach() to end it"
            )
        return InputError(f"{self._who}: port {name}: marker {marker} cannot be read: {_first_line(error)}")


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__

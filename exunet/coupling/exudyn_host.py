"""Exudyn systems as hosts: ports at markers, states of a system, and a host that Exudyn steps explicitly."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import count, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import finite_number
from exunet.base.errors import InputError
from exunet.bodies.port import PER_FRAME, FrameState, frames_of
from exunet.coupling.host import Host, grouped_by_owner
from exunet.coupling.net_system import PortLoad
from exunet.coupling.ports import port_loops, validate_ports, validated_number
from exunet.integrators.exudyn.engine import exudyn, exudyn_items

Floats = NDArray[np.float64]

# Methods whose steps depend only on coordinates, velocities, data and time, which the engine gives and
# accepts. Velocity Verlet, implicit and adaptive methods have further state.
EXACT = ("ExplicitMidpoint", "RK33", "RK44", "RK67")
SAME_TIME = 1e-9  # [s], or relative to the time: the engine's times are sums of steps
_PARTS = ("ODE2", "ODE2_t", "ODE1", "AE", "data")  # of the engine's list
_counted = count(1)


def validate_system(who: str, mbs: Any) -> None:
    """Raise InputError for another object than a system of Exudyn."""
    if not hasattr(mbs, "systemData"):
        raise InputError(f"{who}: mbs: must be a system of Exudyn, got {type(mbs).__name__}")


def state_of(mbs: Any, time: float) -> dict[str, Floats]:
    """Return the whole state of a system, and the time (1,) [s]; copies."""
    state = mbs.systemData.GetSystemState()
    parts = {name: np.array(part, dtype=float) for name, part in zip(_PARTS, state, strict=True)}
    return {"time": np.array([time]), **parts}


def restore_state(who: str, mbs: Any, state: Mapping[str, Floats]) -> float:
    """Restore the result of `state_of`, also as the start of the next run; return its time [s].

    Raises InputError for another object, or the state of a system with other coordinates.
    """
    own = {name: part.shape for name, part in state_of(mbs, 0.0).items()}
    if not isinstance(state, Mapping) or {name: np.shape(part) for name, part in state.items()} != own:
        raise InputError(f"{who}: restore: the state is not of this system: it has other coordinates")
    kinds = exudyn(quiet=False).ConfigurationType
    for kind in (kinds.Initial, kinds.Current):
        mbs.systemData.SetSystemState([state[name] for name in _PARTS], kind)
        mbs.systemData.SetTime(float(state["time"][0]), kind)
    return float(state["time"][0])


class MarkedPorts:
    """Ports at markers of an Exudyn system: states of their frames, and a force and a torque at each.

    The user may delete items, which renumbers others. So the added loads have names and know their markers.
    To look names up takes longer than the rest of a step here, so that numbers are looked up when a solver
    starts, or when the number of loads or markers has changed.

    who     : begin of messages
    markers : number of a marker with position and attitude, by the name of the port
    Raises InputError for another kind of marker; the system is unchanged until `add_loads`.
    """

    def __init__(self, who: str, mbs: Any, markers: Mapping[str, int]) -> None:
        validate_system(who, mbs)
        names = tuple(markers) if isinstance(markers, Mapping) else ()
        validate_ports(who, markers, names, "the number of a marker")
        self._who, self._mbs, self._data, engine = who, mbs, mbs.systemData, exudyn(quiet=False)
        self._markers = {name: self._validated(name, number) for name, number in markers.items()}
        self._loads: dict[str, tuple[str, str]] = {}
        self._acts: list[list[float]] = []  # force and torque of each port
        self._set_times(0.0, 0.0)
        self._ended = False
        self._items = (0, 0)  # numbers of loads and markers when they were looked up
        what, kinds = engine.OutputVariableType, engine.ConfigurationType
        self._outputs = what.Position, what.Velocity, what.RotationMatrix, what.AngularVelocityLocal
        self._initial, self._current, self._output = kinds.Initial, kinds.Current, mbs.GetMarkerOutput
        self._values = np.empty((len(markers), 18))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the ports."""
        return tuple(self._markers)

    def at_start(self) -> Floats:
        """(n, 13) initial states of the markers' frames, of an assembled system."""
        return self._read(self._initial)

    def now(self) -> Floats:
        """(n, 13) present states of the markers' frames."""
        if self._items != self._number_of_items():
            self.look_up()
        return self._read(self._current)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """Return groups of ports at markers of one body, or one node."""
        return grouped_by_owner(self._owners())

    def on_one_body_with(self, other: MarkedPorts) -> Iterator[tuple[str, str]]:
        """Yield each pair of own port and port of another net that are one body."""
        for (own, here), (name, there) in product(self._owners().items(), other._owners().items()):
            if here == there:
                yield own, name

    def _owners(self) -> dict[str, tuple[str, int]]:
        if self._loads:
            self.look_up()
        return {name: self._owner(marker) for name, marker in self._markers.items()}

    def _owner(self, marker: int) -> tuple[str, int]:
        """Return the engine's key and number of the item that a marker is on."""
        item = self._mbs.GetMarker(marker)
        key = next((key for key in ("bodyNumber", "nodeNumber") if key in item), "")
        return (key, int(item[key])) if key else ("marker", marker)

    def add_loads(self, time: float) -> None:
        """Add a force and a torque at each marker, zero at a time [s], and assemble the system."""
        self._set_times(time, time)
        items, own = exudyn_items(), next(_counted)
        for port, marker in self._markers.items():
            force, torque = (f"exunet {own}: {what} of {port}" for what in ("force", "torque"))
            for name, kind in {force: items.LoadForceVector, torque: items.LoadTorqueVector}.items():
                acting = partial(self._acting, len(self._acts))
                self._acts.append([0.0, 0.0, 0.0])
                self._mbs.AddLoad(kind(name=name, markerNumber=marker, loadVectorUserFunction=acting))
            self._loads[port] = force, torque
        self._mbs.Assemble()
        self.look_up()

    def _acting(self, number: int, _: Any, time: float, __: list[float]) -> list[float]:
        """User function of a load; raises InputError if its value is for another step."""
        earliest, latest = self._within
        if earliest <= time <= latest:
            return self._acts[number]
        if self._ended:
            return [0.0, 0.0, 0.0]
        begin, end = self._times
        raise InputError(
            f"{self._who}: port {', '.join(self.names)}: the host is at t = {time:.6g} s, but its forces are "
            f"for the step from {begin:.6g} s to {end:.6g} s: the coupling's pre-step function was not "
            "called. One that is set after `couple` must call the one before it in each step; detach() ends "
            "a coupling"
        )

    def apply(self, wrenches: Floats, begin: float, end: float) -> None:
        """Apply forces [N] and torques [N m], six numbers a port, in a step between two times [s]."""
        self._set_times(begin, end)
        self._acts = wrenches.reshape(-1, 3).tolist()

    def _set_times(self, begin: float, end: float) -> None:
        near = SAME_TIME * max(1.0, abs(end))
        self._times, self._within = (begin, end), (begin - near, end + near)

    def end(self, *, after_step: bool = False) -> None:
        """Apply no more forces, at once or after the step that they are for."""
        self._ended = True
        if not after_step:
            self._acts = [[0.0, 0.0, 0.0] for _ in self._acts]

    def look_up(self) -> None:
        """Look up the markers' numbers; raises InputError for a deleted load or marker of the coupling."""
        for port, names in self._loads.items():
            force, torque = (int(self._mbs.GetLoadNumber(name)) for name in names)
            marker = -1
            if force >= 0 and torque >= 0:
                marker = int(self._mbs.GetLoadParameter(force, "markerNumber"))
            if marker < 0:
                what = "a load that the coupling has added" if min(force, torque) < 0 else "its marker"
                raise InputError(
                    f"{self._who}: port {port}: {what} was deleted: the coupling cannot continue. Use "
                    "detach() to end it"
                )
            self._markers[port] = marker
        self._items = self._number_of_items()

    def _number_of_items(self) -> tuple[int, int]:
        return self._data.NumberOfLoads(), self._data.NumberOfMarkers()

    def _validated(self, name: str, given: int) -> int:
        number = validated_number(self._who, name, "marker", given, self._data.NumberOfMarkers())
        kind = str(self._mbs.GetMarker(number)["markerType"])
        if "Rigid" not in kind:
            raise InputError(
                f"{self._who}: port {name}: marker {number} ({kind}) does not have an attitude: use a marker "
                "of a rigid frame such as MarkerBodyRigid"
            )
        return number

    def _read(self, configuration: Any) -> Floats:
        """Return the states (n, 13) of the markers' frames."""
        output, (place, speed, turn, spin) = self._output, self._outputs
        for row, (name, marker) in zip(self._values, self._markers.items(), strict=True):
            try:
                row[:3] = output(marker, place, configuration)
                row[3:6] = output(marker, speed, configuration)
                row[6:15] = output(marker, turn, configuration)
                row[15:] = output(marker, spin, configuration)
            except Exception as error:
                words = f"marker {marker} cannot be read: {str(error).strip().partition(chr(10))[0]}"
                if self._owner(marker)[1] < 0:
                    words = f"the body of its marker {marker} was deleted: use detach() to end the coupling"
                raise InputError(f"{self._who}: port {name}: {words}") from error
        frames = np.empty((len(self._markers), PER_FRAME))
        if (wrong := port_loops().read_markers(self._values, frames)) >= 0:
            name, marker = list(self._markers.items())[wrong]
            raise InputError(
                f"{self._who}: port {name}: marker {marker} contains NaN or infinity: the host diverged"
            )
        return frames


class ExudynHost(Host):
    """Exudyn system with explicit dynamics as a host of `Coupler`, also with repeats.

        host = exunet.ExudynHost(mbs, {"chaser": marker}, step=1e-3)
        coupler = exunet.Coupler(net, host, step=0.01, iterations=20)

    mbs    : user's system; a force and a torque are added at each marker, and it is assembled
    ports  : number of a marker with position and attitude, by the name of each port of the net
    step   : the host's own largest step [s]
    method : "RK44", "RK33", "RK67" or "ExplicitMidpoint", which restart bitwise. Velocity Verlet and implicit
             methods have accelerations that the engine does not give: use `exunet.couple`
    A pre-step function of the user must depend on state and time only, since steps are repeated. Raises
    InputError for invalid arguments.
    """

    def __init__(self, mbs: Any, ports: Mapping[str, int], *, step: float, method: str = "RK44") -> None:
        self._ports = MarkedPorts("ExudynHost", mbs, ports)
        if method not in EXACT:
            raise InputError(
                f"ExudynHost: method: {method!r} does not restart bitwise: use {', '.join(EXACT)}, or "
                "exunet.couple, which repeats no steps"
            )
        number = finite_number(step)
        if number is None or not number > 0.0:
            raise InputError(f"ExudynHost: step must be positive and finite, got {step!r}")
        self._mbs, self._step, engine = mbs, number, exudyn(quiet=False)
        self._ports.add_loads(0.0)
        settings = engine.SimulationSettings()
        settings.solution.file.write = False
        settings.timeIntegration.verboseMode = 0
        settings.timeIntegration.explicit.useLieGroupIntegration = True
        self._settings, self._method = settings, getattr(engine.DynamicSolverType, method)
        self._time = 0.0
        start = mbs.systemData.GetSystemState(engine.ConfigurationType.Initial)
        mbs.systemData.SetSystemState(start, engine.ConfigurationType.Current)

    @property
    def time(self) -> float:
        return self._time

    def frames(self) -> dict[str, FrameState]:
        return frames_of(self._ports.names, self._ports.now())

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        self._ports.look_up()
        wrenches = np.array([[*loads[name].force, *loads[name].torque] for name in self._ports.names])
        self._ports.apply(wrenches, self._time, until)
        integration = self._settings.timeIntegration
        integration.startTime, integration.endTime = self._time, until
        integration.numberOfSteps = max(1, math.ceil((until - self._time) / self._step * (1.0 - 1e-9)))
        self._mbs.SolveDynamic(self._settings, solverType=self._method, updateInitialValues=True)
        self._time = float(self._mbs.systemData.GetTime())
        if abs(self._time - until) > SAME_TIME:
            raise InputError(
                f"ExudynHost: the run to t = {until:.6g} s ended at {self._time:.6g} s: a pre-step function "
                "of the system has ended it"
            )
        self._time = until

    def snapshot(self) -> Any:
        return state_of(self._mbs, self._time)

    def restore(self, snapshot: Any) -> None:
        self._time = restore_state("ExudynHost", self._mbs, snapshot)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        return self._ports.shared()

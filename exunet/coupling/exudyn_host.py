"""A net coupled to a user's own Exudyn system, at markers of any of its rigid frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count
from typing import Any, NamedTuple
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn, exudyn_items
from exunet.base.errors import InputError
from exunet.bodies.port import FrameState, quaternion_of_matrix
from exunet.coupling.agreement import refuse_apart
from exunet.coupling.books import Books, work_on_host
from exunet.coupling.handover import Handover, weights_of
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.coupling.prediction import STABLE, WEIGHING, Predictor, longest_step
from exunet.coupling.undo import Undo
from exunet.simulation.arguments import whole_number

Floats = NDArray[np.float64]

# A host starts at the net's time but for this [s]: Exudyn adds up times.
_SAME_TIME = 1e-9


def couple(
    mbs: Any, net: NetSystem, ports: Mapping[str, int], *, longest: float | None = None
) -> ExudynCoupling:
    """Couple a net to an Exudyn system: explicit co-simulation, the net's forces held over each of its steps.

        coupling = exunet.couple(mbs, net, {"chaser": marker})
        mbs.SolveDynamic(settings)
        print(coupling.report())

    mbs   : the user's system, with any solver of SolveDynamic; a force and a torque are added at each marker,
            and the system is assembled again
    ports : the number of a marker with position and attitude (MarkerBodyRigid, MarkerNodeRigid, ...) for each
            port; the body's mass must count the nodes that are fixed to the port (`NetSystem.carried_mass`)
    longest : step of the host [s] up to which it is coupled; None: the largest stable one, by the mass and
            the inertia that the case states of the port's body (`exunet.coupling.prediction`). A longer step
            is refused when it comes

    Before each step of the host the net goes through it by its own small steps, while the ports move on at
    the acceleration that the markers had; the host gets the mean force and torque, or, where its method
    weighs the forces of several steps, what makes it apply them (`exunet.coupling.handover`). So it receives
    the impulse of the net's steps to the last bit, and the error is of second order in the host's step; the
    report has its energy. A step that the host takes again, shorter, the net takes again too.
    Raises InputError for ports or markers that are missing or do not fit, if a marker is not where its port
    is at the start, and if the net or the marker is coupled already; the system is then as it was.
    """
    if not isinstance(net, NetSystem):
        raise InputError(f"couple: net: an exunet.NetSystem, got {type(net).__name__}")
    if not hasattr(mbs, "systemData"):
        raise InputError(f"couple: mbs: a system of Exudyn, got {type(mbs).__name__}")
    if not isinstance(ports, Mapping):
        raise InputError(f"couple: ports: the number of a marker by the name of each port, got {ports!r}")
    return ExudynCoupling(mbs, net, ports, longest)


class _Open(NamedTuple):
    """The step that the host is taking, or has taken.

    handed : (n,) forces and torques of all ports, one port after the other
    before : where the markers were when it began
    """

    loads: dict[str, PortLoad]
    handed: Floats
    before: dict[str, FrameState]


_numbers = count(1)
_coupled: WeakSet[NetSystem] = WeakSet()  # nets that are in a coupling in force


class ExudynCoupling:
    """What `couple` gives: a coupling in force until `detach`."""

    def __init__(self, mbs: Any, net: NetSystem, ports: Mapping[str, int], longest: float | None) -> None:
        self._mbs, self._net, self._engine = mbs, net, exudyn(quiet=False)
        self._own_number = next(_numbers)
        if not net.ports:
            raise InputError('couple: the net has no port: give a body of its case motion = "port"')
        if net in _coupled:
            raise InputError("couple: the net is in a coupling already: detach that one first")
        markers = {name: self._marker(name, number) for name, number in ports.items()}
        if missing := [name for name in net.ports if name not in ports]:
            raise InputError(f"couple: no marker is given for port {', '.join(missing)}")
        self._longest = None if longest is None else _positive(longest)
        self._largest = {bound: longest_step(net, bound) for bound in (STABLE, WEIGHING)}
        mbs.Assemble()
        for name in net.ports:
            start = self._read(name, markers[name], self._engine.ConfigurationType.Initial)
            refuse_apart("couple", name, net.frame(name), start, net.simulation.start.net.size)
        self._loads = {name: self._add_loads(name, markers[name]) for name in net.ports}
        mbs.Assemble()
        self._earlier = self._earlier_function()
        self._function = self._before_step
        mbs.SetPreStepUserFunction(self._function)
        self._attached = True
        _coupled.add(net)
        self._undo, self._predictor = Undo(net), Predictor()
        self._books = Books.of(net.ports)
        self._open: _Open | None = None
        self._handover = Handover(np.zeros(6 * len(net.ports)))
        self._solver: Any = None  # of the run of the host that goes on
        self._threw = False  # in the step before, a part of which a method that weighs applies in this one

    @property
    def net(self) -> NetSystem:
        """The net, which stands at the end of the host's last step."""
        return self._net

    def report(self) -> Books:
        """What went through the ports, with the last step if the host has ended it; `print` shows a table."""
        self._net.finish()
        self._book_what_ended()
        return self._books

    @property
    def in_transit(self) -> dict[str, Floats]:
        """(3,) [N s] of each port: impulse that the host's method has been given and does not show yet.

        See `exunet.coupling.handover`; exact for steps of one length. Zero for the Runge-Kutta methods.
        """
        self._book_what_ended()
        parts = self._handover.in_transit.reshape(-1, 6)[:, :3]
        return dict(zip(self._net.ports, parts.copy(), strict=True))

    def detach(self) -> None:
        """End the coupling: no force acts any more, and the pre-step function is what it was before.

        One that was set after `couple` stays, and may go on to call the coupling's, which does nothing but
        call the one before it.
        """
        if not self._attached:
            return
        with suppress(InputError):  # the markers or the loads are not there any more
            self._book_what_ended()
        self._attached, self._open = False, None
        _coupled.discard(self._net)
        for loads in self._loads.values():
            for load in loads:
                number = int(self._mbs.GetLoadNumber(load))
                if number >= 0:
                    self._mbs.SetLoadParameter(number, "loadVector", [0.0, 0.0, 0.0])
        if self._earlier_function() == self._function:
            self._mbs.SetPreStepUserFunction(self._earlier or 0)

    def _marker(self, name: str, given: int) -> int:
        if name not in self._net.ports:
            raise InputError(f"couple: there is no port {name!r}: {', '.join(self._net.ports)}")
        number = whole_number(given)
        count = self._mbs.systemData.NumberOfMarkers()
        if number is None or not 0 <= number < count:
            raise InputError(f"couple: port {name}: there is no marker {given!r}: the system has {count}")
        kind = str(self._mbs.GetMarker(number)["markerType"])
        if "Rigid" not in kind:
            raise InputError(
                f"couple: port {name}: marker {number} ({kind}) has no attitude: use a marker of a rigid "
                "frame such as MarkerBodyRigid"
            )
        return number

    def _add_loads(self, port: str, marker: int) -> tuple[str, str]:
        """The names of a force and a torque: other loads may be deleted, which changes their numbers."""
        items = exudyn_items()
        force, torque = (f"exunet {self._own_number}: {what} of {port}" for what in ("force", "torque"))
        nothing = [0.0, 0.0, 0.0]
        self._mbs.AddLoad(items.LoadForceVector(name=force, markerNumber=marker, loadVector=nothing))
        self._mbs.AddLoad(items.LoadTorqueVector(name=torque, markerNumber=marker, loadVector=nothing))
        return force, torque

    def _load_numbers(self, port: str) -> tuple[int, int]:
        """Of the force and the torque now."""
        force, torque = (int(self._mbs.GetLoadNumber(name)) for name in self._loads[port])
        if force < 0 or torque < 0:
            raise InputError(
                f"couple: port {port}: a load that the coupling has added was deleted: it cannot go on. "
                "Use detach() to end a coupling"
            )
        return force, torque

    def _markers_now(self) -> dict[str, int]:
        """Other markers may be deleted too; the loads know the numbers of theirs."""
        numbers = {name: self._load_numbers(name)[0] for name in self._net.ports}
        return {name: int(self._mbs.GetLoadParameter(n, "markerNumber")) for name, n in numbers.items()}

    def _earlier_function(self) -> Callable[[Any, float], bool] | None:
        found = self._mbs.GetPreStepUserFunction()
        return found["function"] if isinstance(found, dict) else None

    def _read(self, name: str, marker: int, configuration: Any = None) -> FrameState:
        """Where the marker of a port is, and how it moves."""
        what = self._engine.OutputVariableType
        now = self._engine.ConfigurationType.Current if configuration is None else configuration
        try:
            output = [
                self._mbs.GetMarkerOutput(marker, one, now)
                for one in (what.Position, what.Velocity, what.RotationMatrix, what.AngularVelocityLocal)
            ]
        except Exception as error:
            raise InputError(
                f"couple: port {name}: marker {marker} cannot be read: {_first_line(error)}"
            ) from error
        place, speed, turn, spin = (np.asarray(one, dtype=float).ravel().tolist() for one in output)
        if not math.isfinite(sum(place) + sum(speed) + sum(turn) + sum(spin)):
            raise InputError(
                f"couple: port {name}: marker {marker} contains NaN or infinity: the host diverged"
            )
        return FrameState(tuple(place), tuple(speed), quaternion_of_matrix(turn), tuple(spin))

    def _read_all(self) -> dict[str, FrameState]:
        return {name: self._read(name, marker) for name, marker in self._markers_now().items()}

    def _host_time(self) -> float:
        return float(self._mbs.systemData.GetTime())

    def _before_step(self, mbs: Any, until: float) -> bool:
        """The net goes through the host's step to `until` [s], the end of this attempt."""
        if self._earlier is not None and not self._earlier(mbs, until):
            return False
        if not self._attached:
            return True
        now = self._read_all()
        if until <= self._net.time:
            self._take_back(until)
        elif self._open is not None:
            self._book(now)
        self._follow_solver()
        begin, net = self._net.time, self._net
        self._refuse_long(begin, until)
        loads = self._undo.step(until, self._predictor.told(begin, until, now))
        mean = np.concatenate([part for name in net.ports for part in loads[name][-2:]])
        handed = self._handover.handed(mean, until - begin, jumps=net.recoils(begin, until))
        for name, six in zip(net.ports, handed.reshape(-1, 6), strict=True):
            force, torque = self._load_numbers(name)
            mbs.SetLoadParameter(force, "loadVector", six[:3])
            mbs.SetLoadParameter(torque, "loadVector", six[3:])
        self._open = _Open(loads, handed, now)
        return True

    def _follow_solver(self) -> None:
        """Each run of the host may have another method; SolveDynamic tells it to the system."""
        solver, settings = (self._mbs.sys.get(name) for name in ("dynamicSolver", "simulationSettings"))
        if solver is self._solver and solver is not None:
            return
        if settings is None or solver is None:
            raise InputError(
                "couple: the host's method is not known: use mbs.SolveDynamic, with storeSolver=True"
            )
        begin = float(settings.timeIntegration.startTime)
        if abs(begin - self._net.time) > _SAME_TIME:
            raise InputError(
                f"couple: the host starts at t = {begin:.9g} s, the net is at {self._net.time:.9g} s: set "
                "timeIntegration.startTime, or restore or reset the net, and couple anew"
            )
        self._handover.begin(weights_of(settings.timeIntegration))
        self._solver = solver

    def _refuse_long(self, begin: float, until: float) -> None:
        weighs = self._handover.weights is not None
        longest = self._largest[WEIGHING if weighs else STABLE] if self._longest is None else self._longest
        if until - begin > longest * (1.0 + 1e-9):
            raise InputError(
                f"couple: the host's step of {until - begin:.4g} s at t = {begin:.6g} s is beyond the "
                f"largest stable one of its method, {longest:.4g} s, for the ports' masses, stiffnesses and "
                "turns: use shorter steps, or couple(..., longest=...)"
            )

    def _take_back(self, until: float) -> None:
        """The host takes its last step again, to an earlier end."""
        if self._open is None or not self._undo.begin < until:
            raise InputError(
                f"couple: the host steps to t = {until:.6g} s, but the net is at {self._net.time:.6g} s, and "
                f"its last step began at {self._undo.begin:.6g} s: restore or reset the net, and couple anew"
            )
        self._undo.back()
        self._books.repeated += 1
        self._open = None

    def _book_what_ended(self) -> None:
        """Book the last step if the host has ended it: in an earlier pre-step function, after the run."""
        if self._open is not None and self._host_time() >= self._net.time - 1e-12:
            self._book(self._read_all())

    def _book(self, now: dict[str, FrameState]) -> None:
        """Take the step that has ended into the books; it has led to `now`."""
        assert self._open is not None
        loads, handed, before = self._open
        begin, end = next((load.begin, load.end) for load in loads.values())
        recoils, duration = self._net.recoils(begin, end), end - begin
        mean = np.concatenate([part for name in self._net.ports for part in loads[name][-2:]])
        applied = self._handover.take(mean, handed, duration, jumps=recoils)
        works = {
            name: work_on_host(six[:3], six[3:], duration, before[name], now[name])
            for name, six in zip(self._net.ports, applied.reshape(-1, 6), strict=True)
        }
        late = self._threw and self._handover.weights is not None
        self._books.add(loads, works, recoils=recoils or late)
        self._threw = recoils
        if recoils:  # a jump, which does not go on
            self._predictor.forget()
        else:
            self._predictor.keep(begin, before)
        self._open = None


def _positive(longest: object) -> float:
    if isinstance(longest, int | float) and longest > 0.0:
        return float(longest)
    raise InputError(f"couple: longest must be positive, got {longest!r}")


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__

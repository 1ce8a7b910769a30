"""A net coupled to a user's own Exudyn system, at markers of any of its rigid frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn, exudyn_items
from exunet.base.errors import InputError
from exunet.bodies.port import FrameState, quaternion_of_matrix
from exunet.coupling.agreement import refuse_apart
from exunet.coupling.books import Books
from exunet.coupling.in_transit import InTransit, of_method
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.coupling.prediction import STABLE, Predictor, longest_step
from exunet.coupling.undo import Undo
from exunet.simulation.arguments import whole_number

Floats = NDArray[np.float64]


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
    the acceleration that the markers had; the host gets the mean force and torque, so that it receives the
    impulse of the net's steps to the last bit. The error is of second order in the host's step with
    Runge-Kutta methods, of first with those that lag behind the force (see `ExudynCoupling.in_transit`); the
    report has its energy. A step that the host takes again, shorter, the net takes again too.
    Raises InputError for ports or markers that are missing or do not fit, and if a marker is not where its
    port is at the start.
    """
    return ExudynCoupling(mbs, net, ports, longest)


class ExudynCoupling:
    """What `couple` gives: a coupling in force until `detach`."""

    def __init__(self, mbs: Any, net: NetSystem, ports: Mapping[str, int], longest: float | None) -> None:
        self._mbs, self._net, self._engine = mbs, net, exudyn(quiet=False)
        self._markers = {name: self._marker(name, number) for name, number in ports.items()}
        if not net.ports:
            raise InputError('couple: the net has no port: give a body of its case motion = "port"')
        if missing := [name for name in net.ports if name not in ports]:
            raise InputError(f"couple: no marker is given for port {', '.join(missing)}")
        self._longest = longest_step(net, STABLE) if longest is None else _positive(longest)
        self._loads = {name: self._add_loads(marker) for name, marker in self._markers.items()}
        mbs.Assemble()
        for name in self._markers:
            start = self._read(name, self._engine.ConfigurationType.Initial)
            refuse_apart("couple", name, net.frame(name), start, net.simulation.start.net.size)
        self._earlier = self._earlier_function()
        mbs.SetPreStepUserFunction(self._before_step)
        self._attached = True
        self._undo = Undo(net)
        self._predictor = Predictor()
        self._books = Books.of(net.ports)
        self._open: tuple[dict[str, PortLoad], dict[str, FrameState]] | None = None
        self._in_transit: InTransit | None = None

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

        See `exunet.coupling.in_transit`; exact for steps of one length. Zero for the Runge-Kutta methods.
        """
        self._book_what_ended()
        if self._in_transit is None:
            return {name: np.zeros(3) for name in self._markers}
        return dict(zip(self._markers, self._in_transit.impulse.reshape(-1, 3), strict=True))

    def detach(self) -> None:
        """End the coupling: no force acts any more, and the pre-step function is what it was before."""
        if not self._attached:
            return
        self._attached = False
        for loads in self._loads.values():
            for load in loads:
                self._mbs.SetLoadParameter(load, "loadVector", [0.0, 0.0, 0.0])
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

    def _add_loads(self, marker: int) -> tuple[int, int]:
        items = exudyn_items()
        force = items.LoadForceVector(markerNumber=marker, loadVector=[0.0, 0.0, 0.0])
        torque = items.LoadTorqueVector(markerNumber=marker, loadVector=[0.0, 0.0, 0.0])
        return int(self._mbs.AddLoad(force)), int(self._mbs.AddLoad(torque))

    def _earlier_function(self) -> Callable[[Any, float], bool] | None:
        found = self._mbs.GetPreStepUserFunction()
        return found["function"] if isinstance(found, dict) else None

    def _read(self, name: str, configuration: Any = None) -> FrameState:
        """Where the marker of a port is, and how it moves."""
        what, marker = self._engine.OutputVariableType, self._markers[name]
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

    def _host_time(self) -> float:
        return float(self._mbs.systemData.GetTime())

    def _before_step(self, mbs: Any, until: float) -> bool:
        """The net goes through the host's step to `until` [s], the end of this attempt."""
        if self._earlier is not None and not self._earlier(mbs, until):
            return False
        now = {name: self._read(name) for name in self._markers}
        if until <= self._net.time:
            self._take_back(until)
        elif self._open is not None:
            self._book(now)
        begin = self._net.time
        if until - begin > self._longest * (1.0 + 1e-9):
            raise InputError(
                f"couple: the host's step of {until - begin:.4g} s at t = {begin:.6g} s is beyond the "
                f"largest stable one, {self._longest:.4g} s, for the ports' masses and stiffnesses: use "
                "shorter steps, or couple(..., longest=...)"
            )
        loads = self._undo.step(until, self._predictor.told(begin, until, now))
        for name, load in loads.items():
            force, torque = self._loads[name]
            mbs.SetLoadParameter(force, "loadVector", load.force)
            mbs.SetLoadParameter(torque, "loadVector", load.torque)
        self._open = loads, now
        return True

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
            self._book({name: self._read(name) for name in self._markers})

    def _book(self, now: dict[str, FrameState]) -> None:
        """Take the step that has ended into the books; it has led to `now`."""
        assert self._open is not None
        loads, before = self._open
        begin = next(iter(loads.values())).begin
        recoils = self._net.recoils(begin, next(iter(loads.values())).end)
        self._books.add(loads, before, now, recoils=recoils)
        if not recoils:  # a jump, which does not go on
            self._predictor.keep(begin, before)
        self._book_transit(loads)
        self._open = None

    def _book_transit(self, loads: dict[str, PortLoad]) -> None:
        if self._in_transit is None:
            settings = self._mbs.sys.get("simulationSettings")
            if settings is None:
                return
            integration = settings.timeIntegration
            alpha = integration.generalizedAlpha
            self._in_transit = of_method(
                integration.solverType.name,
                3 * len(loads),
                spectral_radius=float(alpha.spectralRadius),
                newmark=bool(alpha.useNewmark),
            )
        force = np.concatenate([loads[name].force for name in self._markers])
        load = next(iter(loads.values()))
        self._in_transit.take(force, load.end - load.begin)


def _positive(longest: object) -> float:
    if isinstance(longest, int | float) and longest > 0.0:
        return float(longest)
    raise InputError(f"couple: longest must be positive, got {longest!r}")


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__

"""An Exudyn system as a host that is set back: explicit, stepped between two times, again and again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from exunet.base.arguments import finite_number
from exunet.base.errors import InputError
from exunet.bodies.port import FrameState, frames_of
from exunet.coupling.exudyn_state import EXACT, put_back, state_of
from exunet.coupling.marked_ports import MarkedPorts
from exunet.coupling.net_system import PortLoad
from exunet.integrators.exudyn.engine import exudyn

_SAME_TIME = 1e-9  # by which its time may differ from where a run was to end [s]: Exudyn adds up times


class ExudynHost:
    """A user's system with explicit dynamics, for `exunet.Cosimulation`, with repeats too.

        host = exunet.ExudynHost(mbs, {"chaser": marker}, step=1e-3)
        both = exunet.Cosimulation(net, host, step=0.01, iterations=20)

    mbs    : the user's system; a force and a torque are added at each marker, and it is assembled
    ports  : the number of a marker with position and attitude for each port of the net
    step   : the host's own steps [s], of which as many go into a macro step as are needed
    method : "RK44", "RK33", "RK67" or "ExplicitMidpoint", which go back to the last bit. Velocity Verlet and
             implicit methods keep accelerations that the engine does not give: use `exunet.couple`
    A pre-step function of the user's is called as ever; what it does must follow from state and time, since
    steps are repeated. Raises InputError for what does not fit.
    """

    def __init__(self, mbs: Any, ports: Mapping[str, int], *, step: float, method: str = "RK44") -> None:
        if not hasattr(mbs, "systemData"):
            raise InputError(f"ExudynHost: mbs: a system of Exudyn, got {type(mbs).__name__}")
        if not isinstance(ports, Mapping):
            raise InputError(f"ExudynHost: ports: the number of a marker by the name of each, got {ports!r}")
        if method not in EXACT:
            raise InputError(
                f"ExudynHost: method {method!r} cannot be set back to the last bit: {', '.join(EXACT)}; "
                "any other with exunet.couple, which repeats no steps"
            )
        number = finite_number(step)
        if number is None or not number > 0.0:
            raise InputError(f"ExudynHost: step must be positive and finite, got {step!r}")
        self._mbs, self._engine, self._step = mbs, exudyn(quiet=False), number
        self._ports = MarkedPorts("ExudynHost", mbs, ports)
        self._ports.add_loads(0.0)
        settings = self._engine.SimulationSettings()
        settings.solution.file.write = False
        settings.timeIntegration.verboseMode = 0
        settings.timeIntegration.explicit.useLieGroupIntegration = True
        self._settings = settings
        self._method = getattr(self._engine.DynamicSolverType, method)
        self._time = 0.0
        start = mbs.systemData.GetSystemState(self._engine.ConfigurationType.Initial)
        mbs.systemData.SetSystemState(start, self._engine.ConfigurationType.Current)

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._time

    def frames(self) -> dict[str, FrameState]:
        """See `exunet.coupling.host.Host`."""
        return frames_of(self._ports.names, self._ports.now())

    def step(self, until: float, loads: Mapping[str, PortLoad]) -> None:
        """See `exunet.coupling.host.Host`."""
        names = self._ports.names
        self._ports.look_up()
        wrenches = np.array([[*loads[name].force, *loads[name].torque] for name in names])
        self._ports.let_act(wrenches, self._time, until)
        integration = self._settings.timeIntegration
        integration.startTime, integration.endTime = self._time, until
        integration.numberOfSteps = max(1, math.ceil((until - self._time) / self._step * (1.0 - 1e-9)))
        self._mbs.SolveDynamic(self._settings, solverType=self._method, updateInitialValues=True)
        self._time = float(self._mbs.systemData.GetTime())
        if abs(self._time - until) > _SAME_TIME:
            raise InputError(
                f"ExudynHost: the run to t = {until:.6g} s ended at {self._time:.6g} s: a pre-step function "
                "of the system has ended it"
            )
        self._time = until

    def snapshot(self) -> Any:
        """See `exunet.coupling.host.Host`."""
        return state_of(self._mbs, self._time)

    def restore(self, snapshot: Any) -> None:
        """See `exunet.coupling.host.Host`."""
        self._time = put_back("ExudynHost", self._mbs, snapshot)

    def shared(self) -> tuple[tuple[str, ...], ...]:
        """See `exunet.coupling.host.Host`."""
        return self._ports.shared()

    def finish(self) -> None:
        """There are no guards: NaN is found where the markers are read."""

"""Going back by a step in a net: a snapshot now and then, and the steps since, which are taken again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.coupling.jumps import Earlier
from exunet.coupling.net_system import NetSystem, PortLoads

Floats = NDArray[np.float64]

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

"""An observer that looks at nothing, for timings of an integrator alone."""

from __future__ import annotations

from exunet.forces.terms import Change
from exunet.integrators.protocol import Extremes
from exunet.model.states import States


class Unwatched:
    """See `exunet.integrators.protocol.Observer`."""

    def take(self, states: States) -> None:
        """No guard looks."""

    def between(self, until: float, extremes: Extremes) -> None:
        """No extreme is kept."""

    def ends(self, time: float) -> None:
        """The run is not recorded."""

    def changed(self, time: float, memory: str, change: Change) -> None:
        """No event is recorded."""

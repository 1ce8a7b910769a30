"""A controller of a script's own, which acts on a simulation at a control period and is set back with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.errors import InputError
from exunet.simulation.arguments import finite_number

# Below it time does not go on from one call to the next [s]: the round-off of times of a million seconds.
LEAST_PERIOD = 1e-9


class Controller(Protocol):
    """Looks at a simulation and acts on it at the beginning of each control period.

    period : [s]
    """

    @property
    def period(self) -> float: ...

    def act(self, simulation: Any) -> None:
        """Set forces and inputs of the `Simulation`, which hold until the next call."""

    def state(self) -> Mapping[str, ArrayLike]:
        """Numbers that what it does later depends on, by name; as copies, always of the same shapes."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `state` gave."""


class Control:
    """A controller in force from a time on, and how often it has acted.

    begin : [s], when it acts first
    """

    def __init__(self, controller: Controller, begin: float) -> None:
        period = finite_number(getattr(controller, "period", None))
        if period is None or not period > 0.0:
            raise InputError("attach: a controller has a period above 0 s, and act(simulation)")
        if period < LEAST_PERIOD:
            raise InputError(
                f"attach: a period of {period:g} s is below {LEAST_PERIOD:g} s, and no step so short"
            )
        if not callable(getattr(controller, "act", None)):
            raise InputError("attach: a controller has act(simulation), which is called every period")
        self._controller, self._period = controller, period
        self._begin, self._acted = begin, 0
        self._at_first = self.arrays() if self.tells_its_state else None

    @property
    def tells_its_state(self) -> bool:
        """True if it can be set back."""
        return all(callable(getattr(self._controller, name, None)) for name in ("state", "restore"))

    @property
    def due(self) -> float:
        """When it acts next [s]."""
        return self._begin + self._acted * self._period

    def act(self, simulation: Any) -> None:
        """Let it act, once."""
        self._controller.act(simulation)
        self._acted += 1

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All of it, for a snapshot; raises InputError if it does not tell its state."""
        self.refuse_untold()
        own = {f"own:{name}": np.array(values) for name, values in self._controller.state().items()}
        return {"begin": np.array(self._begin), "acted": np.array(self._acted), **own}

    def refuse_untold(self) -> None:
        """Raise InputError if it does not tell its state."""
        if not self.tells_its_state:
            raise InputError(
                f"snapshot: {type(self._controller).__name__} has no state() and restore(state): without "
                "them what follows would not be the same"
            )

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `arrays` gave."""
        self._begin, self._acted = float(arrays["begin"]), int(arrays["acted"])
        own = {name[4:]: np.array(values) for name, values in arrays.items() if name.startswith("own:")}
        self._controller.restore(own)

    def reset(self, begin: float) -> None:
        """Go back to the state in which it was attached, to act first at a time [s]."""
        assert self._at_first is not None
        self.restore({**self._at_first, "begin": np.array(begin), "acted": np.array(0)})

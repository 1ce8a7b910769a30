"""Controllers of a simulation, which act at a control period, and functions by their dotted path."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from reprlib import repr as shown
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.arguments import finite_number
from exunet.base.errors import InputError
from exunet.forces.corner_units import Function


def function_named(path: str) -> Function:
    """Import "package.module:function" or "package.module.function"; raises InputError for anything else."""
    module, _, name = path.rpartition(":" if ":" in path else ".")
    if not module or not all(part.isidentifier() for part in (*module.split("."), name)):
        words = 'name a function as "package.module:function" or "package.module.function"'
        raise InputError(f"controller: {words}, got {path!r}")
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise InputError(f"controller: {module!r} of {path!r} cannot be imported: {error}") from error
    if not callable(found):
        raise InputError(f"controller: {module!r} has no function {name!r}")
    function: Function = found
    return function


# Below it time does not go on from one call to the next [s]: the round-off of times of a million seconds.
LEAST_PERIOD = 1e-9

Arrays = Mapping[str, NDArray[Any]]


class Controller(Protocol):
    """Looks at a simulation and acts on it at the beginning of each control period.

    period : [s]
    """

    @property
    def period(self) -> float: ...

    def act(self, simulation: Any) -> None:
        """Set forces and inputs of the `Simulation`, which hold until the next call.

        Advancing, snapshots, going back and attaching another one are refused here, since the simulation is
        within an `advance`.
        """

    def state(self) -> Mapping[str, ArrayLike]:
        """Numbers that what it does later depends on, by name; as copies, always of the same shapes.

        NaN and infinity come back as they are, for what was not read yet.
        """

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `state` gave."""


class ActiveController:
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
        self._begin, self._acted, self._acts = begin, 0, False
        self._at_first: dict[str, NDArray[Any]] | None = None
        if self.tells_its_state:
            self._at_first = self.arrays()

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
        self._acts = True
        try:
            self._controller.act(simulation)
        finally:
            self._acts = False
        self._acted += 1

    def refuse_within(self, what: str) -> None:
        """Raise InputError for what a controller may not do while it acts."""
        if self._acts:
            raise InputError(
                f"{what}: within act() of the controller {type(self._controller).__name__}, at "
                f"t = {self.due:.6g} s: it may look, and set forces, inputs and commands; do this between "
                "two calls of advance"
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All of it, for a snapshot; raises InputError for a state that no snapshot can go back to."""
        self.refuse_untold()
        own = self._own()
        if self._at_first is not None:
            self._refuse_other_shapes(own, self._at_first)
        return {"begin": np.array(self._begin), "acted": np.array(self._acted), **own}

    def _own(self) -> dict[str, NDArray[Any]]:
        told, who = self._controller.state(), f"the controller {type(self._controller).__name__}: its state()"
        if not isinstance(told, Mapping):
            raise InputError(f"{who} gave {type(told).__name__}, not numbers by name")
        found = {}
        for name, values in told.items():
            if not isinstance(name, str):
                raise InputError(f"{who} has the name {name!r}, which is no text")
            array = _numbers(values)
            if array is None:
                raise InputError(
                    f"{who} has {name!r} of {shown(values)}: a number or an array of numbers is needed, of "
                    "64 bits, that a snapshot can go back to"
                )
            found[f"own:{name}"] = array
        return found

    def _refuse_other_shapes(self, own: Arrays, first: Arrays) -> None:
        """Restored from a snapshot, what follows is to be put back where it came from."""
        shapes, wanted = (
            {name[4:]: part.shape for name, part in arrays.items() if name.startswith("own:")}
            for arrays in (own, first)
        )
        if shapes != wanted:
            raise InputError(
                f"the controller {type(self._controller).__name__}: its state() has names and shapes "
                f"{shapes}, and had {wanted} when it was attached: keep them, with NaN for what is not known"
            )

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


# By kind of NumPy's types, what a snapshot's file keeps.
_KEPT: Mapping[str, type] = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}


def _numbers(values: ArrayLike) -> NDArray[Any] | None:
    """An array of them as a file keeps it, if none is changed by that; else None."""
    try:
        given = np.array(values)
    except ValueError:  # rows of different lengths
        return None
    if given.dtype.kind not in _KEPT:
        return None
    kept: NDArray[Any] = given.astype(_KEPT[given.dtype.kind])
    return kept if np.array_equal(kept, given, equal_nan=True) else None

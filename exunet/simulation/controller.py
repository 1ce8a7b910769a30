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
    """Import "package.module:function" or "package.module.function"; raise InputError for other text."""
    module, _, name = path.rpartition(":" if ":" in path else ".")
    if not module or not all(part.isidentifier() for part in (*module.split("."), name)):
        words = 'must be "package.module:function" or "package.module.function"'
        raise InputError(f"controller: {words}, got {path!r}")
    try:
        function = getattr(import_module(module), name, None)
    except ImportError as error:
        raise InputError(f"controller: {module!r} of {path!r} cannot be imported: {error}") from error
    if not callable(function):
        raise InputError(f"controller: {module!r} does not have a function {name!r}")
    imported: Function = function
    return imported


# Below it time does not go on from one call to the next [s]: the round-off of times of a million seconds.
LEAST_PERIOD = 1e-9

Arrays = Mapping[str, NDArray[Any]]


class Controller(Protocol):
    """Controller that reads a simulation and acts on it at the beginning of each control period.

    period : [s]
    """

    @property
    def period(self) -> float: ...

    def act(self, simulation: Any) -> None:
        """Set forces and inputs of the `Simulation`, constant until the next call.

        Advancing, snapshots, going back and attaching a controller raise InputError here, within `advance`.
        """

    def state(self) -> Mapping[str, ArrayLike]:
        """Return copies of the numbers that later actions depend on, by name, always of the same shapes.

        NaN and infinity are restored as they are.
        """

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore from what `state` returned."""


class ActiveController:
    """Attached controller with the number of its actions.

    begin : time of the first action [s]
    """

    def __init__(self, controller: Controller, begin: float) -> None:
        period = finite_number(getattr(controller, "period", None))
        if period is None or not period > 0.0:
            raise InputError("attach: a controller requires a period above 0 s and act(simulation)")
        if period < LEAST_PERIOD:
            raise InputError(f"attach: period {period:g} s is below {LEAST_PERIOD:g} s: increase it")
        if not callable(getattr(controller, "act", None)):
            raise InputError("attach: a controller requires act(simulation), called every period")
        self._controller, self._period = controller, period
        self._begin, self._acted, self._acts = begin, 0, False
        self._at_first: dict[str, NDArray[Any]] | None = None
        if self.is_restorable:
            self._at_first = self.arrays()

    @property
    def is_restorable(self) -> bool:
        """True with `state` and `restore`."""
        return all(callable(getattr(self._controller, name, None)) for name in ("state", "restore"))

    @property
    def due(self) -> float:
        """Time of the next action [s]."""
        return self._begin + self._acted * self._period

    def act(self, simulation: Any) -> None:
        """Call the controller once."""
        self._acts = True
        try:
            self._controller.act(simulation)
        finally:
            self._acts = False
        self._acted += 1

    def validate_outside_act(self, what: str) -> None:
        """Raise InputError within `act` of the controller."""
        if self._acts:
            raise InputError(
                f"{what}: not allowed within act() of {type(self._controller).__name__}: call it between two "
                "calls of advance"
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the state for a snapshot; raise InputError for a state that cannot be restored."""
        self.validate_restorable()
        own = self._own()
        if self._at_first is not None:
            self._validate_shapes(own, self._at_first)
        return {"begin": np.array(self._begin), "acted": np.array(self._acted), **own}

    def _own(self) -> dict[str, NDArray[Any]]:
        state, who = self._controller.state(), f"state() of controller {type(self._controller).__name__}"
        if not isinstance(state, Mapping):
            raise InputError(f"{who} must return numbers by name, got {type(state).__name__}")
        numbers = {}
        for name, values in state.items():
            if not isinstance(name, str):
                raise InputError(f"{who} has the name {name!r}: use a string")
            array = _numbers(values)
            if array is None:
                raise InputError(
                    f"{who} has {name!r} of {shown(values)}: use a number or an array of numbers of 64 bits"
                )
            numbers[f"own:{name}"] = array
        return numbers

    def _validate_shapes(self, own: Arrays, first: Arrays) -> None:
        """Raise InputError if names or shapes differ from those at attachment."""
        shapes, wanted = (
            {name[4:]: part.shape for name, part in arrays.items() if name.startswith("own:")}
            for arrays in (own, first)
        )
        if shapes != wanted:
            raise InputError(
                f"state() of controller {type(self._controller).__name__} has names and shapes {shapes}, not "
                f"{wanted} as when attached: keep them, with NaN for unknown numbers"
            )

    def validate_restorable(self) -> None:
        """Raise InputError without `state` and `restore`."""
        if not self.is_restorable:
            raise InputError(
                f"snapshot: controller {type(self._controller).__name__} requires state() and restore(state)"
            )

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore from `arrays`."""
        self._begin, self._acted = float(arrays["begin"]), int(arrays["acted"])
        own = {name[4:]: np.array(values) for name, values in arrays.items() if name.startswith("own:")}
        self._controller.restore(own)

    def reset(self, begin: float) -> None:
        """Restore the state at attachment, with the first action at a time [s]."""
        assert self._at_first is not None
        self.restore({**self._at_first, "begin": np.array(begin), "acted": np.array(0)})


# Types in a snapshot's file, by kind of NumPy's types.
_KEPT: Mapping[str, type] = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}


def _numbers(values: ArrayLike) -> NDArray[Any] | None:
    """Convert to a type of the file; None if that changes a value."""
    try:
        given = np.array(values)
    except ValueError:  # rows of different lengths
        return None
    if given.dtype.kind not in _KEPT:
        return None
    kept: NDArray[Any] = given.astype(_KEPT[given.dtype.kind])
    return kept if np.array_equal(kept, given, equal_nan=True) else None

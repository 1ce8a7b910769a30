"""A stepper in NumPy around the forces of a kernel: RK4 in equal steps, for nets without bodies.

It shows what `exunet.integrators.protocol.Stepper` requires, in the same loop as the two backends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.bodies.port import Piece
from exunet.forces.terms import Change, DiscreteStates
from exunet.integrators.protocol import Arrays, StepCounts, Steps
from exunet.kernels.kernel import Kernel
from exunet.methods.method import Plan
from exunet.model.states import States
from exunet.model.system import State, System

Floats = NDArray[np.float64]


class NumpyStepper:
    """See `exunet.integrators.protocol.Stepper`; each step is returned."""

    items: dict[str, int] = {}  # noqa: RUF012 - it has none
    can_restart = True

    def __init__(self, system: System, state: State, plan: Plan) -> None:
        assert plan.step is not None
        assert not system.bodies
        self._system, self._step, self._kernel = system, plan.step, Kernel(system.forces)
        self._x, self._v = (np.array(part) for part in system.layout.pack(state.moving))
        self._force = np.zeros(system.blocks.n_force)
        self._external = np.zeros(system.blocks.n_force)
        self.time, self._counts = state.time, np.zeros(2, dtype=np.int64)  # steps, rejected
        self._equal = np.zeros(4)  # begin, end, number of equal steps, steps before
        self._use(state.discrete)

    def _use(self, discrete: DiscreteStates) -> None:
        self.discrete = {name: np.array(values, dtype=float) for name, values in discrete.items()}
        self._table = self._kernel.table(self.discrete)
        self._inverse = self._system.layout.inverse_mass(self._system, self.discrete)

    @property
    def counts(self) -> StepCounts:
        steps, rejected = self._counts.tolist()
        return StepCounts(steps, rejected, right_hand_sides=4 * (steps + rejected))

    @property
    def kept(self) -> dict[str, Floats]:
        return {}

    def flat(self) -> tuple[Floats, Floats]:
        return self._x, self._v

    def _rates(self, time: float, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Rates of x, in which first-order states follow the positions, and of v."""
        self._force[:] = 0.0
        self._kernel.module.forces(time, x, v, self._table.rows, self._force)
        rates = (self._force + self._external) * self._inverse
        return np.concatenate([v, rates[len(v) :]]), rates[: len(v)]

    def step(
        self, times: Sequence[float], most: int | None = None, until_true: Callable[[], bool] | None = None
    ) -> Steps:
        until = times[-1]
        if self._equal[1] != until:
            number = max(1, math.ceil((until - self.time) / self._step * (1 - 1e-9)))
            self._equal[:] = self.time, until, number, self._counts[0]
        begin, _, parts, before = self._equal.tolist()
        h, rows = (until - begin) / parts, []
        while self.time < until:
            self._runge_kutta(h)
            self._counts[0] += 1
            done = self._counts[0] - before
            self.time = until if done == parts else begin + done * h
            rows.append((self.time, self._x.copy(), self._v.copy()))
            if until_true is not None and until_true():
                break
        if self.time == until:
            self._equal[:] = 0.0
        time, x, v = (np.array(part) for part in zip(*rows, strict=True))
        return Steps(States(self._system, time, x, v, self.discrete))

    def _runge_kutta(self, h: float) -> None:
        x, v, t = self._x, self._v, self.time
        a1, b1 = self._rates(t, x, v)
        a2, b2 = self._rates(t + 0.5 * h, x + 0.5 * h * a1, v + 0.5 * h * b1)
        a3, b3 = self._rates(t + 0.5 * h, x + 0.5 * h * a2, v + 0.5 * h * b2)
        a4, b4 = self._rates(t + h, x + h * a3, v + h * b3)
        self._x = x + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
        self._v = v + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)

    def change(self, change: Change, discrete: DiscreteStates) -> None:
        self._x = self._x if change.x is None else np.array(change.x)
        self._v = self._v if change.v is None else np.array(change.v)
        self._use(discrete)

    def set_external_force(self, force: Floats) -> None:
        self._external[: force.size] = force.ravel()

    def set_inputs(self, inputs: Arrays) -> None:
        self._use({**self.discrete, **inputs})

    def steer(self, port: str, piece: Piece) -> None:
        self.steered(port)

    def steered(self, port: str) -> NoReturn:
        raise InputError(f"unknown port {port!r}")

    def view(self) -> State:
        return State.of(self.time, self._system.layout.unpack(self._x, self._v), self.discrete)

    def state(self) -> State:
        moving = self._system.layout.unpack(self._x.copy(), self._v.copy())
        return State.of(self.time, moving, {name: values.copy() for name, values in self.discrete.items()})

    def save(self) -> dict[str, NDArray[Any]]:
        own = {
            "x": self._x,
            "v": self._v,
            "external": self._external,
            "counts": self._counts,
            "equal": self._equal,
        }
        own |= {f"discrete/{name}": values for name, values in self.discrete.items()}
        return {name: np.array(values) for name, values in own.items()} | {"time": np.array(self.time)}

    def load(self, arrays: Arrays, rejected: int | None = None) -> None:
        self.time, self._x, self._v = float(arrays["time"]), np.array(arrays["x"]), np.array(arrays["v"])
        for name, own in (("external", self._external), ("counts", self._counts), ("equal", self._equal)):
            own[:] = arrays[name]
        self._use({name: arrays[f"discrete/{name}"] for name in self.discrete})
        if rejected is not None:
            self._counts[1] = rejected

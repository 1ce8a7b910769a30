"""The drive of a drum: what it is told to do from which time on, and how fast it turns against a pull."""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.case import Command

LOCKED = -1  # number of the command before the first


@dataclass(frozen=True)
class Drive:
    """One drive, which winds up at most `most` [m] and slows down over the last `ramp` [m] of its way."""

    commands: tuple[Command, ...]
    most: float
    ramp: float
    largest_rate: float  # [m/s]
    damping: float  # c [N s/m], infinite where there is none

    def order(self, t: float) -> int:
        """Number of the command that holds from t [s] on."""
        return sum(command.at <= t for command in self.commands) + LOCKED

    def rate(self, order: int, pull: float, wound_up: float) -> float:
        """ds/dt [m/s] under an `order`, against an elastic tension [N], with s [m] wound up."""
        wished = min(max(self._wish(order, pull), -self.largest_rate), self.largest_rate)
        left = self.most - wound_up if wished > 0.0 else wound_up
        return wished * min(max(left / self.ramp, 0.0), 1.0)

    def _wish(self, order: int, pull: float) -> float:
        """ds/dt [m/s] before its limits."""
        command = None if order == LOCKED else self.commands[order]
        if command is None or command.mode == "lock":
            return 0.0
        if command.force is None:
            assert command.rate is not None
            return command.rate
        spare = (command.force - pull) / self.damping
        if command.mode == "tension":
            return spare
        return min(spare, 0.0 if command.rate is None else command.rate)

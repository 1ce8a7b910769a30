"""What a system remembers beside its state: in which of its laws it moves until the next event.

Within a step the mode is held, so that every stage sees smooth forces; it changes between steps.
"""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.arrays import Bools
from reference_impl.friction import Memory


@dataclass(frozen=True, eq=False)
class Mode:
    """Which elements are intact, which bullets are pushed, which segment of thrust holds, what reels do.

    And what friction remembers of what touches.
    """

    intact: Bools | None = None  # (m,); None: none is broken
    pushed: Bools | None = None  # (k,) by launch_force; None: those with s < stroke
    gone: Bools | None = None  # (k,) bullets that have left barrels for good; None: none ever does
    segment: int | None = None  # of thrust, see `Thrust.at`; None: the one that holds at t
    orders: tuple[int, ...] | None = None  # of reels, see `Reels.orders`; None: those that hold at t
    closing: int | None = None  # of what closes the mouth, see `closing.order_at`; None: as holds at t
    memory: Memory | None = None  # None: friction has no memory


BY_STATE = Mode()  # nothing broken, everything else decided by time and state

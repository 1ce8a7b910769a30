"""Reels: drums on bodies that wind a tether up and pay it out, element by element.

A tether of n elements of length l is wound up by s: its first k inner nodes lie on the drum, the element
between the drum and the next node, the *outlet*, has the reference length (k + 1) l - s, and the others have
l. Once the outlet is as short as a quarter of an element, its node goes onto the drum and it continues with
the next element; a node comes off the drum when the outlet is half an element longer than an element. So no
element ever shrinks to nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.net.drive import Drive, DriveConfig, softest

LEAST_OUTLET = 0.25  # of an element; next to a whole one it raises the highest frequency by 1/8
CLOSE = 1e-9  # of an element, within which the outlet counts as having reached that
LARGEST_OUTLET = 1.5  # with which a node comes off, and leaves an outlet of half an element


class ReelConfig(DriveConfig):
    """A drum at an end of the tether that is tied to a body."""

    at: Literal["start", "end"] = Field("start", description="at which end of the tether, one on a body")
    paid_out: Positive | None = Field(
        None, description="length outside at time 0 [m]; absent: all of it", examples=[5.0]
    )
    shortest: Positive | None = Field(
        None,
        description="length outside at which winding stops [m]; absent: a quarter of an element",
        examples=[1.0],
    )

    def faults_on(self, length: float, divisions: int) -> Iterator[Fault]:
        """Yield lengths outside that a tether of a length [m] does not have."""
        least = LEAST_OUTLET * length / divisions
        for key, value in (("paid_out", self.paid_out), ("shortest", self.shortest)):
            if value is not None and not least <= value <= length:
                words = f"must be between {least:.6g} m, a quarter of an element, and length = {length:g} m"
                yield Fault(key, f"{words}, got {value:g} m")
        outside = length if self.paid_out is None else self.paid_out
        if self.shortest is not None and outside < self.shortest <= length:
            yield Fault("shortest", f"is above the {outside:g} m outside at time 0: nothing is wound up")


@dataclass(frozen=True)
class Reel:
    """A reel and the tether on it.

    name     : of the tether
    body     : that has the drum
    nodes    : along the tether, from the node at the drum on
    elements : along the tether, from the drum on
    element_length : reference length of one [m]
    wound    : at time 0 [m]
    on_drum  : number of inner nodes on the drum at time 0
    shortest : length outside at which winding stops [m]
    largest_rate : [m/s]
    times    : of the commands [s]
    drives   : before the first command, and of each
    damping  : of the drive [N s/m]; None: it has no force
    """

    name: str
    body: str
    nodes: tuple[int, ...]
    elements: tuple[int, ...]
    element_length: float
    wound: float
    on_drum: int
    shortest: float
    largest_rate: float
    times: tuple[float, ...]
    drives: tuple[Drive, ...]
    damping: float | None = None

    @property
    def is_commanded(self) -> bool:
        """True if the case has no command for it, so that a script may command it."""
        return not self.times

    @property
    def softest(self) -> Drive:
        """Return the softest drive that a script may request."""
        return softest(self.damping if self.is_commanded else None)

    @property
    def length(self) -> float:
        """Of the whole tether [m]."""
        return self.element_length * len(self.elements)

    @property
    def winds_up(self) -> bool:
        """True if the tether may ever become shorter, by its drives or by a script."""
        return self.is_commanded or any(drive.rate > 0.0 for drive in self.drives)

    @property
    def least_outlet(self) -> float:
        """The least reference length that the outlet may come to, at any time [m]."""
        now, part = self.outlet(self.on_drum, self.wound), self.element_length
        if not self.winds_up:  # a node that comes off the drum leaves an outlet of half an element
            stays = not self.on_drum or all(drive.is_locked for drive in self.drives)
            return now if stays else min(now, (LARGEST_OUTLET - 1.0) * part)
        return LEAST_OUTLET * part if len(self.elements) > 1 else self.shortest

    @property
    def most_on_drum(self) -> int:
        """The largest number of inner nodes that may come to be on the drum, at any time."""
        return len(self.elements) - 1 if self.winds_up else self.on_drum

    def outlet(self, on_drum: int, wound: float) -> float:
        """Reference length of the outlet [m]."""
        return (on_drum + 1) * self.element_length - wound


def reel_of(
    name: str, keys: ReelConfig, body: str, length: float, nodes: tuple[int, ...], elements: tuple[int, ...]
) -> Reel:
    """The reel of a tether of a length [m], whose nodes and elements are listed from its start on."""
    if keys.at == "end":
        nodes, elements = nodes[::-1], elements[::-1]
    number = len(elements)
    part = length / number
    wound = 0.0 if keys.paid_out is None else max(0.0, length - keys.paid_out)
    on_drum = min(number - 1, int(wound / part))
    if (on_drum + 1) * part - wound <= (LEAST_OUTLET + CLOSE) * part and on_drum < number - 1:
        on_drum += 1
    shortest = max(keys.shortest or 0.0, LEAST_OUTLET * part)
    return Reel(
        name,
        body,
        nodes,
        elements,
        part,
        wound,
        on_drum,
        shortest,
        keys.rate_limit,
        keys.times,
        keys.drives,
        keys.damping,
    )

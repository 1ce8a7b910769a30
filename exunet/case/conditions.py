"""What an entry of a script waits for: a quantity of the run against a number, or a happening.

A condition is the name of a quantity, a comparison and a number; nothing of it is ever run as code.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple


class Quantity(NamedTuple):
    """What a condition may look at; none is ever negative.

    unit  : "1" if it has none
    needs : of the scene: "target", "mouth", "tethers", "line", "contact" or ""
    words : what it is
    """

    unit: str
    needs: str
    words: str


QUANTITIES = {
    "time": Quantity("s", "", "time since the start of the run"),
    "range": Quantity("m", "target", "distance of the centres of mass of net and target"),
    "relative_speed": Quantity("m/s", "target", "speed of the one centre relative to the other"),
    "mouth_diameter": Quantity("m", "mouth", "largest distance of two nodes of the mouth's rim"),
    "area": Quantity("m2", "mouth", "area of the polygon through the corners of the mouth"),
    "tether_tension": Quantity("N", "tethers", "largest tension in any tether"),
    "closing_tension": Quantity("N", "line", "larger one of the tensions at the ends of the closing line"),
    "touching": Quantity("1", "contact", "number of threads, nodes and bullets that touch a body"),
}
HAPPENINGS = {
    "first_contact": ("contact", "a thread or a bullet touches a body for the first time"),
    "largest_area": (
        "mouth",
        "the area of the mouth has fallen by a part, `fall`, of the largest until then",
    ),
}
_CONDITION = re.compile(r"([A-Za-z_]+)(?:\s*([<>])\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?))?", re.ASCII)


@dataclass(frozen=True)
class Condition:
    """`name > bound` if `sign` is 1.0, `name < bound` if it is -1.0; a happening has neither (0.0)."""

    name: str
    sign: float = 0.0
    bound: float = 0.0


def condition_of(text: str) -> Condition:
    """Read a condition; raises ValueError with what is allowed."""
    found = _CONDITION.fullmatch(text.strip())
    name = found[1] if found else ""
    if found is None or (name not in QUANTITIES and name not in HAPPENINGS):
        known = f"{', '.join(HAPPENINGS)}, or one of {', '.join(QUANTITIES)} with < or > and a number"
        raise ValueError(f"unknown condition {text[:60]!r}; known are {known}")
    if (found[2] is None) != (name in HAPPENINGS):
        words = "is compared with nothing" if name in HAPPENINGS else "needs < or > and a number"
        raise ValueError(f"{name} {words}")
    if found[2] is None:
        return Condition(name)
    condition = Condition(name, 1.0 if found[2] == ">" else -1.0, float(found[3]))
    if not math.isfinite(condition.bound):
        raise ValueError(f"{found[3][:60]} is beyond the largest number that there is")
    if condition.sign < 0.0 and condition.bound <= 0.0:
        raise ValueError(f"{name} is never below 0, so {text.strip()!r} is never true")
    if condition.sign > 0.0 and condition.bound < 0.0:
        raise ValueError(f"{name} is never below 0, so {text.strip()!r} is always true: leave it out")
    return condition

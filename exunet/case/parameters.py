"""The parameters that `do = "set"` of a script may change in a run: a closed list, with bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from exunet.net.closing import NAME as CLOSING

# Those of which a scene has one at most, and what they are of; tethers and drives have others, "NAME.…".
NEEDS = {
    "thrust.factor": "[effects.thrust]",
    "contact.friction": "[effects.contact]",
    f"{CLOSING}.friction": "a closing line",
}


@dataclass(frozen=True)
class Bounds:
    """What a parameter of a scene may be set to.

    least, most : bounds; `open` : least itself is too small; because : why not more, in words
    why   : why a script cannot set it in this scene; "": it can
    """

    least: float = 0.0
    most: float = math.inf
    open: bool = False
    because: str = ""
    why: str = ""

    def fault(self, value: float) -> str:
        """What is wrong with a value; "" if nothing is."""
        if self.least < value <= self.most or (value == self.least and not self.open):
            return ""
        words = f"must be {'greater than' if self.open else 'not less than'} {self.least:g}"
        if math.isfinite(self.most):
            words += f" and not above {self.most:g}{self.because}"
        return f"{words}, got {value:g}"


_STIFFEST = ", that of the case, for which the step is chosen"
_FASTEST = " m/s, the largest_rate of the drive"


def settable(scene: Any, drives: Mapping[str, Any]) -> dict[str, Bounds]:
    """What a script may set in a scene, or why it cannot; drives : keys of each, by name."""
    found = dict(_of_effects(scene))
    line = scene.closing if scene.closing is not None and scene.closing.kind == "line" else None
    if line is not None:
        smooth = "the line slides without friction: give closing.friction a value, however small"
        found["closing.friction"] = Bounds(most=2.0, open=True, why="" if line.friction else smooth)
    breaks = getattr(scene.effects, "breaking", None) is not None
    for name, tether in scene.tethers.items():
        if tether is not None:
            why = f"{name!r} has a reel, whose outlet keeps its stiffness" if tether.reel else ""
            why = "excludes [effects.breaking], whose limits are of the case's stiffness" if breaks else why
            found[f"{name}.youngs_modulus"] = Bounds(0.0, tether.youngs_modulus, True, _STIFFEST, why)
    for name, drive in drives.items():
        why = f"{name!r} has commands of its own: remove these, or this entry" if drive.commands else ""
        fastest = math.inf if drive.largest_rate is None else drive.largest_rate
        found[f"{name}.rate"] = Bounds(0.0, fastest, True, _FASTEST, why)
        weak = f"needs the damping of the drive of {name!r}" if drive.damping is None else ""
        found[f"{name}.force"] = Bounds(why=why or weak)
    return found


def _of_effects(scene: Any) -> Iterator[tuple[str, Bounds]]:
    if getattr(scene.effects, "thrust", None) is not None:
        yield "thrust.factor", Bounds()
    contact = getattr(scene.effects, "contact", None)
    if contact is not None:
        why = "" if contact.is_given("friction_law") else "needs effects.contact.friction_law"
        why = 'engine.contact = "general" has no friction' if scene.engine.contact == "general" else why
        yield "contact.friction", Bounds(why=why)

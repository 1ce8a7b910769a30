"""What a variable of an FMU is, as the model description tells it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Causality = Literal["parameter", "input", "output"]
AXES = ("x", "y", "z")
QUATERNION = ("w", "x", "y", "z")


@dataclass(frozen=True)
class Variable:
    """A number that goes in or comes out.

    start     : at time 0; of an output, what it is with the case as it stands
    unit      : as in `exunet.coupling.fmu.units`; "" for a pure number
    low, high : bounds; None: none
    is_switch : true or false instead of a number
    """

    name: str
    causality: Causality
    description: str
    start: float
    unit: str = ""
    low: float | None = None
    high: float | None = None
    is_switch: bool = False


def structured(name: str) -> str:
    """A dotted name of the case as FMI writes it: parts that are no identifiers are in quotes."""
    parts = (re.fullmatch(r"(.*?)((?:\[\d+\])?)", part) for part in name.split("."))
    return ".".join(
        (part[1] if re.fullmatch(r"[A-Za-z_]\w*", part[1], re.ASCII) else f"'{part[1]}'") + part[2]
        for part in parts
        if part is not None
    )


def vector(
    name: str,
    causality: Causality,
    description: str,
    start: Sequence[float],
    unit: str = "",
    parts: Sequence[str] = AXES,
) -> list[Variable]:
    """A variable for each component."""
    return [
        Variable(f"{name}.{part}", causality, f"{description}, {part}", float(value), unit)
        for part, value in zip(parts, start, strict=True)
    ]

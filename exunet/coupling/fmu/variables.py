"""What a variable of an FMU is, as the model description tells it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Causality = Literal["parameter", "input", "output"]
AXES = ("x", "y", "z")
QUATERNION = ("w", "x", "y", "z")


@dataclass(frozen=True)
class Variable:
    """A number that goes in or comes out.

    start     : at time 0; of an output, what it is with the case as it stands
    unit      : as in `exunet.coupling.fmu.variables`; "" for a pure number
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


# Powers of the base units; degrees Celsius and the like, with an offset, are not used in cases.
_KNOWN: Mapping[str, Mapping[str, int]] = {
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "K": {"K": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
}
_FACTOR = re.compile(r"([A-Za-z]+)(-?\d+)?")


def powers(unit: str) -> dict[str, int]:
    """The powers of kg, m, s, K and rad; ValueError if it is no unit that a case has.

    What stands after a slash, in parentheses if it is more than one factor, divides.
    """
    above, slash, below = unit.strip().partition("/")
    if not above or (slash and not below):
        raise ValueError(f"{unit!r} is not a unit")
    found: Counter[str] = Counter()
    for text, sign in ((above, 1), (below.strip().removeprefix("(").removesuffix(")"), -1)):
        for factor in text.split():
            if factor == "1":
                continue
            match = _FACTOR.fullmatch(factor)
            if match is None or match[1] not in _KNOWN:
                raise ValueError(f"{unit!r} is not a unit")
            for base, power in _KNOWN[match[1]].items():
                found[base] += sign * power * int(match[2] or 1)
    return {base: power for base, power in found.items() if power}


def unit_in(description: str) -> str:
    """The unit in brackets in the description of a key; "" for a pure number."""
    for text in re.findall(r"\[([^\[\]]+)\]", description):
        try:
            powers(text)
        except ValueError:
            continue
        return text.strip()
    return ""

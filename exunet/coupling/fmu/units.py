"""Units as the case format writes them, such as "kg m2" or "N s/m", in powers of base units."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

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

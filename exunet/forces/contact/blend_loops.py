"""Depths in several solids as one, as a compiled loop: (sum p^8)^(1/8), smooth where one becomes deeper.

The force has the direction of its gradient: that of each solid counts with (p / sum)^7.
"""

from __future__ import annotations

from typing import Any


def deeper(found: Any, own: float, n: Any) -> Any:
    """A depth [m] and its direction (4) with those of one more solid, which is outside at own <= 0.

    found : depth and direction before, 0.0 of none; own, n : depth in this solid, and its direction (3)
    """
    if own <= 0.0:
        return found
    depth = found[0]
    most = max(own, depth)
    both = most * (1.0 + (min(own, depth) / most) ** 8) ** 0.125
    before = (depth / both) ** 7
    after = (own / both) ** 7
    return (
        both,
        before * found[1] + after * n[0],
        before * found[2] + after * n[1],
        before * found[3] + after * n[2],
    )

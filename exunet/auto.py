"""What solver.method = "auto" and engine.net = "auto" come to, from a stored table of measurements.

auto_table.toml is written by benchmarks/auto_table.py, which says on what scenes it measured.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from exunet.kernel.compile import numba_installed

Floats = NDArray[np.float64]
Loop = Literal["exudyn", "compiled"]
Form = Literal["connectors", "fused"]


@dataclass(frozen=True)
class Adaptive:
    """Measurements of one adaptive method; two columns, increasing in the first.

    tolerance : accuracy asked for (speed error / launch speed) -> tolerance / launch speed
    expected  : tolerance / launch speed -> speed error / launch speed to expect
    """

    tolerance: Floats
    expected: Floats

    @property
    def best(self) -> float:
        """The least accuracy that was reached on all measured scenes."""
        return float(self.tolerance[0, 0])

    def tolerance_for(self, accuracy: float) -> float:
        """Tolerance per unit of the launch speed that meets an accuracy; constant outside the table."""
        return _between(accuracy, self.tolerance[:, 0], self.tolerance[:, 1])

    def expected_error(self, tolerance: float) -> float:
        """Speed error to expect at a tolerance, both relative to the launch speed."""
        return _between(tolerance, self.expected[:, 0], self.expected[:, 1])


@dataclass(frozen=True)
class Table:
    """The stored measurements.

    adaptive : by method
    cheapest : (accuracy, method with the fewest right-hand sides), increasing
    seconds  : elements, seconds of a right-hand side with connectors, and fused; increasing
    """

    adaptive: dict[str, Adaptive]
    cheapest: tuple[tuple[float, str], ...]
    seconds: Floats


@functools.cache
def table() -> Table:
    """The stored table."""
    read = tomllib.loads(Path(__file__).with_name("auto_table.toml").read_text(encoding="utf-8"))
    adaptive = {
        name: Adaptive(np.array(sorted(rows["tolerance"])), np.array(sorted(rows["expected_error"])))
        for name, rows in read.items()
        if isinstance(rows, dict)
    }
    cheapest = tuple(sorted((float(accuracy), str(method)) for accuracy, method in read["cheapest"]))
    return Table(adaptive, cheapest, np.array(sorted(read["seconds"])))


def choose_method(accuracy: float, able: Collection[str]) -> tuple[str, str]:
    """The method of `able` that was measured as cheapest at an accuracy or the next tighter one, and why."""
    rows = [row for row in table().cheapest if row[1] in able]
    tighter = [row for row in rows if row[0] <= accuracy * (1 + 1e-9)]
    level, method = tighter[-1] if tighter else rows[0]
    return method, f"fewest right-hand sides of all methods at {level:.0e}, as measured"


def choose_net(n_elements: int, *, implicit: bool) -> tuple[Form, str]:
    """The form of the net that was measured as faster at this size, and why.

    An implicit method takes the fused net wherever there is one: its derivatives are exact, those of the
    connectors are numerical.
    """
    if not numba_installed():
        return "connectors", "auto: connectors, since Numba is not installed (pip install 'exunet[fast]')"
    if implicit:
        return "fused", "auto: fused net, whose derivatives are exact"
    rows = table().seconds
    connectors, fused = (_between(float(n_elements), rows[:, 0], rows[:, k]) for k in (1, 2))
    words = (
        f"{n_elements} elements, {1e6 * fused:.3g} µs a right-hand side fused, {1e6 * connectors:.3g} µs not"
    )
    if fused < connectors:
        return "fused", f"auto: fused net ({words}, as measured)"
    return "connectors", f"auto: connectors ({words}, as measured)"


def choose_loop(method: str, able: Collection[str]) -> tuple[Loop, str]:
    """Who steps in time where the case leaves it open, and why; able: methods of the compiled loop."""
    if not numba_installed():
        return "exudyn", "auto: Exudyn steps, since Numba is not installed (pip install 'exunet[fast]')"
    if method not in able:
        return "exudyn", f"auto: Exudyn steps, since the compiled loop has no {method}"
    return "compiled", "auto: the compiled loop steps, not Exudyn (a net alone)"


def _between(at: float, x: Floats, y: Floats) -> float:
    """Straight lines in the logarithms."""
    return float(np.exp(np.interp(np.log(at), np.log(x), np.log(y))))

"""What solver.method = "auto" and engine.net = "auto" choose, from a stored table of measurements.

auto_table.toml is written by benchmarks/auto_table.py, which says on what scenes it measured.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.codegen.compile import numba_installed
from exunet.methods.method import METHODS, Method, NetForm, TimeLoop

Floats = NDArray[np.float64]

# Packing from which on a start counts as nearly deployed: all threads snap soon and together, after which the
# same tolerance leaves far larger errors. Between the packings 0.7 and 0.9 of the measured scenes.
NEARLY_DEPLOYED = 0.8
_NO_NUMBA = "since Numba is not installed (pip install numba)"


@dataclass(frozen=True)
class Adaptive:
    """Measurements of one adaptive method; increasing in the first column.

    tolerance : accuracy asked for (speed error / launch speed) -> tolerance / launch speed
    expected  : tolerance / launch speed -> speed error / launch speed, median and worst
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

    def expected_error(self, tolerance: float) -> tuple[float, float]:
        """Speed error at a tolerance, median and worst of the measured, relative to the launch speed."""
        median, worst = (_between(tolerance, self.expected[:, 0], self.expected[:, k]) for k in (1, 2))
        return median, worst


@dataclass(frozen=True)
class Measured:
    """What was measured on scenes of one kind.

    adaptive : by method
    cheapest : (accuracy, method with the fewest right-hand sides), increasing
    """

    adaptive: dict[Method, Adaptive]
    cheapest: tuple[tuple[float, Method], ...]


@dataclass(frozen=True)
class Measurements:
    """The stored measurements.

    folded, nearly_deployed : by packing, below NEARLY_DEPLOYED and from it on
    seconds : elements, seconds of a right-hand side with connectors, and fused; increasing
    """

    folded: Measured
    nearly_deployed: Measured
    seconds: Floats

    def at(self, packing: float) -> Measured:
        """What holds for a start of this packing."""
        return self.folded if packing < NEARLY_DEPLOYED else self.nearly_deployed


@functools.cache
def table() -> Measurements:
    """The stored table."""
    read = tomllib.loads(Path(__file__).with_name("auto_table.toml").read_text(encoding="utf-8"))
    folded, deployed = _measured(read["folded"]), _measured(read["nearly_deployed"])
    return Measurements(folded, deployed, np.array(sorted(read["seconds"])))


def _measured(read: dict[str, Any]) -> Measured:
    adaptive = {
        Method(name): Adaptive(np.array(sorted(rows["tolerance"])), np.array(sorted(rows["expected_error"])))
        for name, rows in read.items()
        if isinstance(rows, dict)
    }
    cheapest = sorted((float(accuracy), Method(method)) for accuracy, method in read["cheapest"])
    return Measured(adaptive, tuple(cheapest))


def choose_method(accuracy: float, able: Collection[Method], measured: Measured) -> tuple[Method, str]:
    """The method of `able` that was measured as cheapest at an accuracy or the next tighter one, and why."""
    rows = [row for row in measured.cheapest if row[1] in able]
    tighter = [row for row in rows if row[0] <= accuracy * (1 + 1e-9)]
    level, method = tighter[-1] if tighter else rows[0]
    return method, f"fewest right-hand sides of all methods at {level:.0e}, as measured"


def choose_net(n_elements: int, *, implicit: bool) -> tuple[NetForm, str]:
    """The form of the net that was measured as faster at this size, and why.

    An implicit method takes the fused net wherever there is one: its derivatives are exact, those of the
    connectors are numerical.
    """
    if not numba_installed():
        return (
            NetForm.CONNECTORS,
            "auto: connectors, since Numba is not installed (pip install numba)",
        )
    if implicit:
        return NetForm.FUSED, "auto: fused net, whose derivatives are exact"
    rows = table().seconds
    connectors, fused = (_between(float(n_elements), rows[:, 0], rows[:, k]) for k in (1, 2))
    words = (
        f"{n_elements} elements, {1e6 * fused:.3g} µs a right-hand side fused, {1e6 * connectors:.3g} µs not"
    )
    if fused < connectors:
        return NetForm.FUSED, f"auto: fused net ({words}, as measured)"
    return NetForm.CONNECTORS, f"auto: connectors ({words}, as measured)"


def choose_loop(method: Method) -> tuple[TimeLoop, str]:
    """Who steps in time where the case leaves it open, and why."""
    if not numba_installed():
        return (
            TimeLoop.EXUDYN,
            "auto: Exudyn steps, since Numba is not installed (pip install numba)",
        )
    if not METHODS[method].compiled:
        return TimeLoop.EXUDYN, f"auto: Exudyn steps, since the compiled loop has no {method}"
    return TimeLoop.COMPILED, "auto: the compiled loop steps, not Exudyn (a net alone)"


def _between(at: float, x: Floats, y: Floats) -> float:
    """Straight lines in the logarithms."""
    return float(np.exp(np.interp(np.log(at), np.log(x), np.log(y))))

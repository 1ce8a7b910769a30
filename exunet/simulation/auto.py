"""Choices of solver.method = "auto" and accuracy_of = "measures", from measurements.

auto_table.toml is written by benchmarks/auto_table.py, which says on what scenes it measured.

Measures. Beyond the horizon of predictability a run is one sample, however small its error: only the
distribution of a measure can be right. An error acts as a perturbation of the start, but sooner. Large nets
have so many snaps that their opening does not depend on either: velocity Verlet, symplectic and without a
drift of the energy, at a fifth of its stable step has the distribution of accurate runs. The stable step
follows from stiffness, lumped masses and damping, which set the duration of a snap, so one factor holds for
all nets. Small nets may open soon after their horizon, where such errors shift the measures: they use
Dormand-Prince steps with the tolerance of accuracy 1e-3, the error of the trajectory before the horizon.

measures_table.toml has the settings; benchmarks/measures.py tests them, and writes what it found.
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

from exunet.methods.method import Backend, Method
from exunet.model.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.model.system import System
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

# Packing from which on a start counts as nearly deployed: all threads snap soon and together, after which the
# same tolerance leaves far larger errors. Between the packings 0.7 and 0.9 of the measured scenes.
NEARLY_DEPLOYED = 0.8


@dataclass(frozen=True)
class Adaptive:
    """Measurements of one adaptive method; increasing in the first column.

    tolerance : requested accuracy (speed error / launch speed) -> tolerance / launch speed
    expected  : tolerance / launch speed -> speed error / launch speed, median and worst
    work      : tolerance / launch speed -> right-hand sides over all scenes
    """

    tolerance: Floats
    expected: Floats
    work: Floats

    @property
    def best(self) -> float:
        """Best accuracy that was reached on all measured scenes."""
        return float(self.tolerance[0, 0])

    def tolerance_for(self, accuracy: float) -> float:
        """Return the tolerance over the launch speed for an accuracy; constant outside the table."""
        return _between(accuracy, self.tolerance[:, 0], self.tolerance[:, 1])

    def work_for(self, accuracy: float) -> float:
        """Return the right-hand sides of all scenes at an accuracy."""
        return _between(self.tolerance_for(accuracy), self.work[:, 0], self.work[:, 1])

    def expected_error(self, tolerance: float) -> tuple[float, float]:
        """Return the speed error at a tolerance over the launch speed, median and worst."""
        median, worst = (_between(tolerance, self.expected[:, 0], self.expected[:, k]) for k in (1, 2))
        return median, worst


@dataclass(frozen=True)
class MeasuredMethods:
    """Measurements on scenes of one kind, by method."""

    adaptive: dict[Method, Adaptive]


@dataclass(frozen=True, eq=False)
class SecondsBySize:
    """Seconds of a right-hand side by size of the net.

    elements : (n,) of these nets, increasing
    of_backend : (n,) [s] of each; infinite: it does not have the method
    """

    elements: Floats
    of_backend: dict[Backend, Floats]

    @classmethod
    def of(cls, rows: list[list[float]]) -> SecondsBySize:
        """Read rows of a number of elements and a time for each backend, in the order of `Backend`."""
        elements, *times = np.array(sorted(rows)).T
        return cls(elements, dict(zip(Backend, times, strict=False)))

    def at(self, backend: Backend, n_elements: int) -> float:
        """Interpolate to a number of elements [s]; constant outside the measured sizes."""
        return _between(float(n_elements), self.elements, self.of_backend[backend])

    def nearest(self, n_elements: int) -> str:
        """Describe the nearest measured size if a size is outside the measured ones; else ""."""
        fewest, most = int(self.elements[0]), int(self.elements[-1])
        if fewest <= n_elements <= most:
            return ""
        number, words = (fewest, "fewest") if n_elements < fewest else (most, "most")
        return f"with {number} elements, the {words} that were tried"


@dataclass(frozen=True)
class Measurements:
    """Stored measurements.

    folded, nearly_deployed : by packing, below NEARLY_DEPLOYED and from it on
    run_seconds : by method, of a right-hand side in a run, on every backend, steps included
    """

    folded: MeasuredMethods
    nearly_deployed: MeasuredMethods
    run_seconds: dict[Method, SecondsBySize]

    def each(self, method: Method, backend: Backend, n_elements: int) -> float:
        """Return the seconds of a right-hand side of a method on a backend, with its part of the step."""
        return self.run_seconds[method].at(backend, n_elements)

    def at(self, packing: float) -> MeasuredMethods:
        """Return the measurements for a packing."""
        return self.folded if packing < NEARLY_DEPLOYED else self.nearly_deployed


@functools.cache
def table() -> Measurements:
    """Read the stored table."""
    read = tomllib.loads(Path(__file__).with_name("auto_table.toml").read_text(encoding="utf-8"))
    folded, deployed = _measured(read["folded"]), _measured(read["nearly_deployed"])
    runs = {Method(name): SecondsBySize.of(rows) for name, rows in read["run_seconds"].items()}
    return Measurements(folded, deployed, runs)


def _measured(read: dict[str, Any]) -> MeasuredMethods:
    names = ("tolerance", "expected_error", "work")
    return MeasuredMethods(
        {
            Method(name): Adaptive(*(np.array(sorted(rows[item])) for item in names))
            for name, rows in read.items()
        }
    )


def choose_method(
    accuracy: float,
    able: Collection[Method],
    measured: MeasuredMethods,
    n_elements: int,
    backend: Backend,
) -> tuple[Method, str]:
    """Choose the method of `able` with the least time at an accuracy on a backend, and say why.

    By the stored times, so a case is always solved in the same way. If no method reaches the accuracy, the
    method with the best accuracy.
    """
    known = {method: found for method, found in measured.adaptive.items() if method in able}
    best = min(found.best for found in known.values())
    reaching = [m for m, found in known.items() if found.best <= max(best, accuracy) * (1 + 1e-9)]
    seconds = {
        method: known[method].work_for(accuracy) * table().each(method, backend, n_elements)
        for method in reaching
    }
    method = min(seconds, key=lambda item: seconds[item])
    nearest = table().run_seconds[method].nearest(n_elements)
    with_them = f"as measured {nearest}" if nearest else f"with {n_elements} elements, as measured"
    why = f"least time of all methods at {accuracy:.0e} {with_them}"
    others = [
        f"{second} {seconds[second] / seconds[method]:.2g} times that"
        for second in seconds
        if second != method
    ]
    return method, "; ".join([why, *others])


def _between(at: float, x: Floats, y: Floats) -> float:
    """Interpolate linearly in the logarithms; infinite where the nearest value is."""
    if np.isinf(y).any():
        return float("inf")
    return float(np.exp(np.interp(np.log(max(at, x[0])), np.log(x), np.log(y))))


@dataclass(frozen=True)
class MeasureSettings:
    """Settings in measures_table.toml.

    step         : of VelocityVerlet, over its stable step
    most_damping : damping rate [1/s] times that step up to which VelocityVerlet was measured
    least_elements : smallest net for VelocityVerlet
    tolerance    : of DOPRI5, over the launch speed
    """

    step: float
    most_damping: float
    least_elements: int
    tolerance: float
    move: float


@functools.cache
def measure_settings() -> MeasureSettings:
    """Read the stored settings."""
    read = tomllib.loads(Path(__file__).with_name("measures_table.toml").read_text(encoding="utf-8"))
    return MeasureSettings(**read)


def verlet_step(system: System) -> float:
    """Return the step [s] of VelocityVerlet for measures."""
    frequency, rate = largest_frequency(system), largest_damping_rate(system)
    return measure_settings().step * stable_step(Method.VELOCITY_VERLET, frequency, rate)


def perturbation(net: Net) -> float:
    """Return the largest perturbation of starts, in each coordinate [m], for medians independent of a method.

    All runs of a method share its errors, which act as one perturbation of the start. Where a scene ends soon
    after its horizon, runs with smaller perturbations stay near each other, and far from those of another
    method, however accurate.
    """
    return measure_settings().move * net.size


def why_not_verlet(system: System) -> str:
    """Return why VelocityVerlet was not measured for such a system, or is not of order 2; "" if it was."""
    if system.net.n_elements < measure_settings().least_elements:
        return f"fewer than {measure_settings().least_elements} elements"
    if not largest_frequency(system):
        return "no frequency limits the step"
    if system.bodies:
        return "bodies rotate"
    if system.blocks.states:
        return "there are first-order states"
    if system.memory:
        return "the forces change at events"
    if largest_damping_rate(system) * verlet_step(system) > measure_settings().most_damping:
        return "the damping is strong"
    return ""


def measure_promise(method: Method, net: Net) -> str:
    """Describe the measured accuracy."""
    words = (
        "accuracy as measured (benchmarks/measures.md): beyond the horizon of predictability, medians of the "
        f"measures of deployment of runs perturbed by up to {perturbation(net):.2g} m within a third of "
        "their spread"
    )
    before = "before it, measures to 1e-3" if method == Method.DOPRI5 else "unknown before it"
    return f"{words}; {before}; not the trajectory"

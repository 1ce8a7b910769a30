"""The ladder: every method that can run a scene, from its loosest setting to its tightest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from exunet.methods.method import COMPILED_METHODS, METHODS, Kind, Method

Code = Literal["connectors", "fused", "compiled loop", "reference"]

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
LOW_ORDER_TOLERANCES = TOLERANCES[:6]
PARTS = (0.8, 0.4, 0.2, 0.1, 0.05, 0.02)  # of the stable step
# Of the stable step of RK44; implicit methods have none of their own.
IMPLICIT_PARTS = (64.0, 16.0, 4.0, 1.0, 0.4)
# Methods whose stable step vanishes without damping: of that of velocity Verlet. At 0.1 the forward
# Euler method lets the fastest mode grow by 2 % a step.
UNSTABLE_PARTS = (0.1, 0.02, 0.005)


@dataclass(frozen=True)
class Setting:
    """One way to integrate the scene.

    tolerance : of an adaptive method, per step: relative to the launch speed [1], else None
    step      : of a fixed-step method [s], else None
    """

    code: Code
    method: str
    tolerance: float | None = None
    step: float | None = None

    @property
    def name(self) -> str:
        """Method and code."""
        return f"{self.method} ({self.code})"

    @property
    def conserves(self) -> bool:
        """True if the energy balance holds by construction, however wrong the run."""
        return self.method == "EM"

    @property
    def value(self) -> str:
        """The setting in words."""
        if self.tolerance is not None:
            return f"tolerance {self.tolerance:.0e}"
        return f"step {self.step:.3g} s"


@dataclass(frozen=True)
class Limits:
    """What the ladder must know of a scene.

    stable    : method -> its stable step [s]
    """

    stable: dict[str, float]
    end: float


def ladders(limits: Limits, *, compiled: bool, reference: tuple[str, ...]) -> list[list[Setting]]:
    """For each method and code its settings, loosest first.

    compiled  : Numba is installed: fused net and compiled loop
    reference : the reference's methods that can run the scene
    """
    found: list[list[Setting]] = []
    forms: tuple[Code, ...] = ("fused", "connectors") if compiled else ("connectors",)
    for form in forms:
        found += [_of_engine(form, method, limits) for method in METHODS]
    if compiled:
        found += [_of_engine("compiled loop", method, limits) for method in COMPILED_METHODS]
    return found + [_of_reference(method, limits) for method in reference]


def base(*, compiled: bool) -> list[Setting]:
    """The ladder that is climbed whatever the budget: that of the converged solution's own method."""
    return _adaptive("compiled loop" if compiled else "connectors", "DOPRI5")


def _adaptive(code: Code, method: str) -> list[Setting]:
    tolerances = TOLERANCES if METHODS[Method(method)].order > 3 else LOW_ORDER_TOLERANCES
    return [Setting(code, method, tolerance=t) for t in tolerances]


def _of_engine(code: Code, method: str, limits: Limits) -> list[Setting]:
    facts = METHODS[Method(method)]
    if facts.kind == Kind.ADAPTIVE:
        return _adaptive(code, method)
    if facts.kind == Kind.IMPLICIT:
        return _steps(code, method, limits.stable["RK44"], IMPLICIT_PARTS, limits)
    if facts.needs_step:
        return _steps(code, method, limits.stable["VelocityVerlet"], UNSTABLE_PARTS, limits)
    return _steps(code, method, limits.stable[method], PARTS, limits)


def _of_reference(method: str, limits: Limits) -> list[Setting]:
    if method in ("RK45", "DOP853"):
        tolerances = TOLERANCES if method == "DOP853" else TOLERANCES[:6]
        return [Setting("reference", method, tolerance=t) for t in tolerances]
    if method == "EM":
        return _steps("reference", method, limits.stable["RK44"], IMPLICIT_PARTS, limits)
    own = {"RK4": "RK44", "Verlet": "VelocityVerlet"}[method]
    return _steps("reference", method, limits.stable[own], PARTS, limits)


def _steps(code: Code, method: str, unit: float, parts: tuple[float, ...], limits: Limits) -> list[Setting]:
    """Steps as parts of `unit` [s]; of those longer than a hundredth of the run only one."""
    longest = limits.end / 100.0
    steps = sorted({min(part * unit, longest) for part in parts}, reverse=True)
    return [Setting(code, method, step=step) for step in steps]

"""The ladder: every method that can run a scene, from its loosest setting to its tightest."""

from __future__ import annotations

from collections.abc import Mapping
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
OF_REFERENCE = {"RK4": "RK44", "Verlet": "VelocityVerlet"}  # fixed-step methods: exunet's names


@dataclass(frozen=True)
class Setting:
    """One way to integrate the scene.

    tolerance : of an adaptive method, per step: relative to the launch speed [1], else None
    step      : of a fixed-step method [s], else None
    forced    : the step is above the one that exunet runs unasked
    """

    code: Code
    method: str
    tolerance: float | None = None
    step: float | None = None
    forced: bool = False

    @property
    def name(self) -> str:
        """Method and code."""
        return f"{self.method} ({self.code})"

    def __str__(self) -> str:
        return f"{self.name}, {self.value}"

    @property
    def conserves(self) -> bool:
        """True if the energy balance holds by construction, however wrong the run."""
        return self.method == "EM"

    @property
    def in_a_case(self) -> bool:
        """True if a case can ask for it: not for a method of the reference, nor beyond the stable step."""
        return self.code != "reference" and not self.forced

    @property
    def size(self) -> float:
        """Tolerance or step: smaller is tighter, among settings of one name."""
        return float(self.tolerance or self.step or 0.0)

    @property
    def value(self) -> str:
        """The setting in words."""
        return f"tolerance {self.tolerance:.0e}" if self.tolerance is not None else f"step {self.step:.3g} s"


def ladders(
    stable: Mapping[str, float], end: float, *, compiled: bool, reference: tuple[str, ...]
) -> list[list[Setting]]:
    """For each method and code its settings, loosest first.

    stable    : method -> its stable step on the scene [s]
    end       : of the run [s]; of the steps longer than a hundredth of it only one is on the ladder
    compiled  : Numba is installed: fused net and compiled loop
    reference : the reference's methods that can run the scene
    """

    def steps(code: Code, method: str, unit: str, parts: tuple[float, ...]) -> list[Setting]:
        found = {min(part * stable[unit], end / 100.0) for part in parts}
        return [
            Setting(code, method, step=step, forced=code != "reference" and beyond(method, step))
            for step in sorted(found, reverse=True)
        ]

    def beyond(method: str, step: float) -> bool:
        return METHODS[Method(method)].kind == Kind.EXPLICIT and step > stable[method]

    def of_exunet(code: Code, method: str) -> list[Setting]:
        facts = METHODS[Method(method)]
        if facts.kind == Kind.ADAPTIVE:
            return adaptive(code, method)
        if facts.kind == Kind.IMPLICIT:
            return steps(code, method, "RK44", IMPLICIT_PARTS)
        if facts.needs_step:
            return steps(code, method, "VelocityVerlet", UNSTABLE_PARTS)
        return steps(code, method, method, PARTS)

    def of_reference(method: str) -> list[Setting]:
        if method in OF_REFERENCE:
            return steps("reference", method, OF_REFERENCE[method], PARTS)
        if method == "EM":
            return steps("reference", method, "RK44", IMPLICIT_PARTS)
        tolerances = TOLERANCES if method == "DOP853" else LOW_ORDER_TOLERANCES
        return [Setting("reference", method, tolerance=t) for t in tolerances]

    forms: tuple[Code, ...] = ("fused", "connectors") if compiled else ("connectors",)
    found = [of_exunet(form, method) for form in forms for method in METHODS]
    found += [of_exunet("compiled loop", method) for method in COMPILED_METHODS if compiled]
    return found + [of_reference(method) for method in reference]


def adaptive(code: Code, method: str) -> list[Setting]:
    """The ladder of an adaptive method of exunet."""
    tolerances = TOLERANCES if METHODS[Method(method)].order > 3 else LOW_ORDER_TOLERANCES
    return [Setting(code, method, tolerance=t) for t in tolerances]


def base(*, compiled: bool) -> list[Setting]:
    """The ladder that is climbed whatever the budget: that of the converged solution's own method."""
    return adaptive("compiled loop" if compiled else "connectors", "DOPRI5")

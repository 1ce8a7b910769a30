"""The ladder: every method that can run a scene, from its loosest setting to its tightest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from exunet.methods.method import COMPILED_METHODS, METHODS, Form, Kind, Method

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
LOW_ORDER_TOLERANCES = TOLERANCES[:6]
PARTS = (0.8, 0.4, 0.2, 0.1, 0.05, 0.02)  # of the stable step
# Of the stable step of RK44; implicit methods have none of their own.
IMPLICIT_PARTS = (64.0, 16.0, 4.0, 1.0, 0.4)
# Methods whose stable step vanishes without damping: of that of velocity Verlet. At 0.1 the forward
# Euler method lets the fastest mode grow by 2 % a step.
UNSTABLE_PARTS = (0.1, 0.02, 0.005)


class ReferenceMethod(StrEnum):
    """A method of reference_impl; the value is its name there."""

    RK45 = "RK45"
    DOP853 = "DOP853"
    RK4 = "RK4"
    VERLET = "Verlet"
    EM = "EM"


class Sizes(NamedTuple):
    """Tolerances of a method, or its steps as parts of the stable step of one of exunet's."""

    tolerances: tuple[float, ...] = ()
    parts: tuple[float, ...] = ()
    unit: Method = Method.RK44


OF_REFERENCE = {
    ReferenceMethod.RK45: Sizes(LOW_ORDER_TOLERANCES),
    ReferenceMethod.DOP853: Sizes(TOLERANCES),
    ReferenceMethod.RK4: Sizes(parts=PARTS),
    ReferenceMethod.VERLET: Sizes(parts=PARTS, unit=Method.VELOCITY_VERLET),
    ReferenceMethod.EM: Sizes(parts=IMPLICIT_PARTS),
}


@dataclass(frozen=True)
class Setting:
    """One way to integrate the scene.

    form      : None for a method of the reference
    tolerance : of an adaptive method, per step: relative to the launch speed [1], else None
    step      : of a fixed-step method [s], else None
    forced    : the step is above the one that exunet runs unasked
    """

    form: Form | None
    method: Method | ReferenceMethod
    tolerance: float | None = None
    step: float | None = None
    forced: bool = False

    @property
    def code(self) -> str:
        """The form, or that it is the reference, in words."""
        return self.form or "reference"

    @property
    def name(self) -> str:
        """Method and code."""
        return f"{self.method} ({self.code})"

    def __str__(self) -> str:
        return f"{self.name}, {self.value}"

    @property
    def conserves(self) -> bool:
        """True if the energy balance holds by construction, however wrong the run."""
        return self.method == ReferenceMethod.EM

    @property
    def in_a_case(self) -> bool:
        """True if a case can ask for it: not for a method of the reference, nor beyond the stable step."""
        return self.code != "reference" and not self.forced

    def overrides(self, speed: float) -> tuple[str, str]:
        """Values of `--set` that run it in a scene of this launch speed [m/s]; none of the reference's."""
        assert self.form is not None
        if self.tolerance is not None:
            size = f"tolerance={self.tolerance * speed:.3g}"
        else:
            size = f"step={self.step:.3g}"
        keys = {"loop": "compiled"} if self.form == Form.COMPILED else {"net": self.form.value}
        ((key, value),) = keys.items()
        return f'solver={{method="{self.method}",{size}}}', f'engine={{{key}="{value}"}}'

    @property
    def size(self) -> float:
        """Tolerance or step: smaller is tighter, among settings of one name."""
        return float(self.tolerance or self.step or 0.0)

    @property
    def value(self) -> str:
        """The setting in words."""
        return f"tolerance {self.tolerance:.0e}" if self.tolerance is not None else f"step {self.step:.3g} s"


def ladders(
    stable: Mapping[Method, float], end: float, *, compiled: bool, reference: Iterable[ReferenceMethod]
) -> list[list[Setting]]:
    """For each method and code its settings, loosest first.

    stable    : method -> its stable step on the scene [s]
    end       : of the run [s]; of the steps longer than a hundredth of it only one is on the ladder
    compiled  : Numba is installed: fused net and compiled loop
    reference : the reference's methods that can run the scene
    """

    def rungs(form: Form | None, method: Method | ReferenceMethod) -> list[Setting]:
        sizes = OF_REFERENCE[method] if isinstance(method, ReferenceMethod) else _sizes(method)
        steps = {min(part * stable[sizes.unit], end / 100.0) for part in sizes.parts}
        found = [
            Setting(form, method, step=step, forced=beyond(method, step))
            for step in sorted(steps, reverse=True)
        ]
        return found or [Setting(form, method, tolerance=t) for t in sizes.tolerances]

    def beyond(method: Method | ReferenceMethod, step: float) -> bool:
        if isinstance(method, ReferenceMethod):
            return False
        return METHODS[method].kind == Kind.EXPLICIT and step > stable[method]

    forms = (Form.FUSED, Form.CONNECTORS) if compiled else (Form.CONNECTORS,)
    found = [rungs(form, method) for form in forms for method in METHODS]
    found += [rungs(Form.COMPILED, method) for method in COMPILED_METHODS if compiled]
    return found + [rungs(None, method) for method in reference]


def _sizes(method: Method) -> Sizes:
    facts = METHODS[method]
    if facts.kind == Kind.ADAPTIVE:
        return Sizes(TOLERANCES if facts.order > 3 else LOW_ORDER_TOLERANCES)
    if facts.kind == Kind.IMPLICIT:
        return Sizes(parts=IMPLICIT_PARTS)
    if facts.needs_step:
        return Sizes(parts=UNSTABLE_PARTS, unit=Method.VELOCITY_VERLET)
    return Sizes(parts=PARTS, unit=method)


def own_form(*, compiled: bool) -> Form:
    """The form of the converged solution."""
    return Form.COMPILED if compiled else Form.CONNECTORS


def base(*, compiled: bool) -> list[Setting]:
    """The ladder that is climbed whatever the budget: that of the converged solution's own method."""
    return [Setting(own_form(compiled=compiled), Method.DOPRI5, tolerance=t) for t in TOLERANCES]

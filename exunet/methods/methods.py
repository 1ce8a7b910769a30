"""The integration methods by name, and the keys of [solver] that choose one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from exunet.base.table import Positive, Table

MethodName = Literal[
    "auto",
    "DOPRI5",
    "ODE23",
    "ExplicitEuler",
    "ExplicitMidpoint",
    "RK33",
    "RK44",
    "RK67",
    "VelocityVerlet",
    "GeneralizedAlpha",
    "TrapezoidalIndex2",
]


@dataclass(frozen=True)
class Method:
    """What the program must know of an integration method of the engine.

    kind  : "adaptive" (explicit, steps chosen from an error estimate), "explicit" or "implicit" (fixed step)
    order : declared order of convergence
    stages: right-hand sides of one step
    weak  : at any step an undamped mode grows, if slowly: stability.py says from which growth on it counts
    needs_step: no stable step follows from the net's frequencies (or, implicit, any would do)
    """

    kind: Literal["adaptive", "explicit", "implicit"]
    order: int
    stages: int
    weak: bool = False
    needs_step: bool = False


# Orders and right-hand sides a step as measured on the engine; tests/test_methods.py measures them again.
METHODS: dict[str, Method] = {
    "DOPRI5": Method("adaptive", 5, 7),
    "ODE23": Method("adaptive", 3, 4),
    "ExplicitEuler": Method("explicit", 1, 1, weak=True, needs_step=True),
    "ExplicitMidpoint": Method("explicit", 2, 2, weak=True, needs_step=True),
    "RK33": Method("explicit", 3, 3),
    "RK44": Method("explicit", 4, 4),
    "RK67": Method("explicit", 6, 7, weak=True),
    "VelocityVerlet": Method("explicit", 2, 1),
    "GeneralizedAlpha": Method("implicit", 2, 1, needs_step=True),
    "TrapezoidalIndex2": Method("implicit", 2, 1, needs_step=True),
}


@dataclass(frozen=True)
class Plan:
    """How one run is integrated: what the solver keys came to on this scene.

    method     : name in METHODS
    tolerance  : absolute tolerance per step [m, m/s] of an adaptive method, else None
    step       : longest step [s] of a fixed-step method, else None
    first_step : first attempt of an adaptive method [s]
    longest_step: longest step of an adaptive method [s]
    least_step : steps below this count as collapsed [s]
    expected_error: speed errors of the measured scenes relative to the launch speed, median and worst
    notes      : what the user should know of the choice
    """

    method: str
    tolerance: float | None = None
    step: float | None = None
    first_step: float = 0.0
    longest_step: float = math.inf
    least_step: float = 0.0
    expected_error: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()


SHORTEST_STEP = 1e-12  # [s]


class Solver(Table):
    """Keys of [solver]."""

    method: MethodName = Field(
        "auto", description="integration method; auto: what was measured as cheapest for the accuracy"
    )
    accuracy: Positive = Field(
        1e-4,
        le=1.0,
        description="speed error aimed at, relative to the launch speed; sets an adaptive tolerance",
    )
    tolerance: Positive | None = Field(
        None, description="absolute tolerance of an adaptive method [m, m/s]; absent: from accuracy"
    )
    step: Positive | None = Field(
        None,
        validate_default=True,
        description="step of a fixed-step method [s]; absent: from the stable step",
    )
    force: bool = Field(
        False, description="run also with a step above the stable one, which is refused otherwise"
    )
    retry: int = Field(
        2,
        ge=0,
        le=20,
        description="how often a run that its steps spoil goes on from its last good state with finer ones",
    )

    # Field by field, so that a fault of one key does not hide those of the others.
    @field_validator("tolerance")
    @classmethod
    def _tolerance_fits(cls, tolerance: float | None, others: ValidationInfo) -> float | None:
        method = others.data.get("method", "auto")
        if tolerance is not None and method != "auto" and METHODS[method].kind != "adaptive":
            raise ValueError(f"{method} has a fixed step: give step instead of tolerance")
        return tolerance

    @field_validator("step")
    @classmethod
    def _step_fits(cls, step: float | None, others: ValidationInfo) -> float | None:
        method = others.data.get("method")
        if step is None:
            if method not in (None, "auto") and METHODS[method].needs_step:
                raise ValueError(f"{method} has no stable step of its own: give step")
            return step
        if step < SHORTEST_STEP:
            raise ValueError(f"must be at least {SHORTEST_STEP:g} s, got {step:g}")
        if method == "auto":
            raise ValueError("auto chooses its own step: name the fixed-step method that it is for")
        if method is not None and METHODS[method].kind == "adaptive":
            raise ValueError(f"{method} chooses its own step: give accuracy or tolerance instead")
        return step

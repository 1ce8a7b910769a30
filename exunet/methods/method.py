"""Integration methods and backends, facts about the methods in one table, and the plan of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, asdict, dataclass, replace
from enum import StrEnum
from typing import Any, Self


class Method(StrEnum):
    """An integration method; the value is its name in a case."""

    DOPRI5 = "DOPRI5"
    ODE23 = "ODE23"
    EXPLICIT_EULER = "ExplicitEuler"
    EXPLICIT_MIDPOINT = "ExplicitMidpoint"
    RK33 = "RK33"
    RK44 = "RK44"
    RK67 = "RK67"
    VELOCITY_VERLET = "VelocityVerlet"
    GENERALIZED_ALPHA = "GeneralizedAlpha"
    TRAPEZOIDAL_INDEX2 = "TrapezoidalIndex2"


class Kind(StrEnum):
    """Who chooses the steps of a method, and whether they solve equations."""

    ADAPTIVE = "adaptive"  # explicit, steps chosen from an error estimate
    EXPLICIT = "explicit"  # fixed step
    IMPLICIT = "implicit"  # fixed step


class Backend(StrEnum):
    """Integrator of a run: Exudyn, or the compiled loop of exunet."""

    EXUDYN = "exudyn"
    COMPILED = "compiled"


@dataclass(frozen=True, kw_only=True)
class MethodFacts:
    """Properties of an integration method that the program must know.

    order      : declared order of convergence
    stages     : right-hand sides of one step in Exudyn
    compiled_stages : the same in the compiled loop; 0: it does not have the method
    weak       : an undamped mode grows at any step, if slowly; model/limits.py says which growth is refused
    needs_step : no stable step follows from the net's frequencies (or, implicit, any would do)
    remembers_acceleration : a step uses the acceleration of the step before, which a sudden change of the
        forces (a break, a restart) makes wrong
    asks_halfway : Exudyn asks for the forces of a step's end once, with the velocity of the half step
    restarts_in_exudyn : positions, velocities and time are enough to continue bitwise in Exudyn
    rotation_order : order of convergence of the attitude of turning bodies in Exudyn, where it is not `order`
    stability_polynomial : coefficients of R(z) from z^0 on, of explicit Runge-Kutta methods with fixed steps
    """

    kind: Kind
    order: int
    stages: int
    weak: bool = False
    needs_step: bool = False
    compiled_stages: int = 0
    remembers_acceleration: bool = False
    asks_halfway: bool = False
    restarts_in_exudyn: bool = True
    rotation_order: int | None = None
    stability_polynomial: tuple[float, ...] = ()

    @property
    def compiled(self) -> bool:
        """The compiled loop has it."""
        return self.compiled_stages > 0

    def restarts_exactly(self, backend: Backend) -> bool:
        """True if a run that is continued from a snapshot is bitwise the run that was not interrupted."""
        return self.compiled if backend == Backend.COMPILED else self.restarts_in_exudyn


def _taylor(order: int, *higher: float) -> tuple[float, ...]:
    """1, 1, 1/2, ... 1/order!: all that a method has with as many stages as its order, and `higher` ones."""
    return (*(1.0 / math.factorial(k) for k in range(order + 1)), *higher)


# Orders and right-hand sides a step as measured on the engine; tests/physics/test_methods.py measures them
# again. The last of DOPRI5's seven stages is the first of the next step, which the compiled loop keeps.
# Coefficient of z^7 of RK67: read off one step of the engine on a linear oscillator, which
# tests/unit/test_step_size.py repeats. Exact restarts and the attitude of VelocityVerlet: measured on the
# engine, which has no access to the algorithmic accelerations of the implicit methods.
METHODS: Mapping[Method, MethodFacts] = {
    Method.DOPRI5: MethodFacts(kind=Kind.ADAPTIVE, order=5, stages=7, compiled_stages=6),
    Method.ODE23: MethodFacts(kind=Kind.ADAPTIVE, order=3, stages=4),
    Method.EXPLICIT_EULER: MethodFacts(
        kind=Kind.EXPLICIT, order=1, stages=1, weak=True, needs_step=True, stability_polynomial=_taylor(1)
    ),
    Method.EXPLICIT_MIDPOINT: MethodFacts(
        kind=Kind.EXPLICIT, order=2, stages=2, weak=True, needs_step=True, stability_polynomial=_taylor(2)
    ),
    Method.RK33: MethodFacts(kind=Kind.EXPLICIT, order=3, stages=3, stability_polynomial=_taylor(3)),
    Method.RK44: MethodFacts(
        kind=Kind.EXPLICIT, order=4, stages=4, compiled_stages=4, stability_polynomial=_taylor(4)
    ),
    Method.RK67: MethodFacts(
        kind=Kind.EXPLICIT,
        order=6,
        stages=7,
        weak=True,
        stability_polynomial=_taylor(6, -4.4945388576385706e-4),
    ),
    Method.VELOCITY_VERLET: MethodFacts(
        kind=Kind.EXPLICIT,
        order=2,
        stages=1,
        compiled_stages=1,
        remembers_acceleration=True,
        asks_halfway=True,
        rotation_order=1,
    ),
    Method.GENERALIZED_ALPHA: MethodFacts(
        kind=Kind.IMPLICIT,
        order=2,
        stages=1,
        needs_step=True,
        remembers_acceleration=True,
        restarts_in_exudyn=False,
    ),
    Method.TRAPEZOIDAL_INDEX2: MethodFacts(
        kind=Kind.IMPLICIT,
        order=2,
        stages=1,
        needs_step=True,
        remembers_acceleration=True,
        restarts_in_exudyn=False,
    ),
}


def turning_polynomial(method: Method, backend: Backend) -> tuple[float, ...]:
    """Stability polynomial of what a method does to turning bodies; empty where its steps follow errors.

    The compiled loop turns them by RK44's stages with either of its methods of equal steps.
    """
    facts = METHODS[method]
    if facts.kind != Kind.EXPLICIT:
        return ()
    if backend == Backend.COMPILED:
        return METHODS[Method.RK44].stability_polynomial
    return facts.stability_polynomial if facts.rotation_order is None else _taylor(facts.rotation_order)


COMPILED_METHODS = tuple(method for method, facts in METHODS.items() if facts.compiled)


@dataclass(frozen=True)
class Plan:
    """How one run is integrated: what follows from the solver keys on this scene.

    backend    : integrator of the run
    tolerance  : absolute tolerance per step [m, m/s] of an adaptive method, else None
    step       : longest step [s] of a fixed-step method, else None
    first_step : first attempt of an adaptive method [s]
    longest_step: longest step of an adaptive method [s]
    least_step : steps below this count as collapsed [s]
    notes      : what the user should know of the choice
    """

    method: Method
    _: KW_ONLY
    backend: Backend = Backend.COMPILED
    tolerance: float | None = None
    step: float | None = None
    first_step: float = 0.0
    longest_step: float = math.inf
    least_step: float = 0.0
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The plan in JSON, where null stands for infinity."""
        return {name: None if value == math.inf else value for name, value in asdict(self).items()}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """The plan that `as_json` gave."""
        longest = math.inf if stored["longest_step"] is None else stored["longest_step"]
        lists = {name: tuple(value) for name, value in stored.items() if isinstance(value, list)}
        names = {"method": Method(stored["method"]), "backend": Backend(stored["backend"])}
        return cls(**{**stored, **lists, **names, "longest_step": longest})


LEAST_TOLERANCE = 1e-12  # below it, steps are rejected for round-off without a gain
FINER_STEP = 0.5
FINER_TOLERANCE = 0.1  # of a method of order 5, steps that are 0.63 times as long


def finer(plan: Plan) -> Plan | None:
    """Return the plan with half the step, or a tenth of the tolerance; None if neither can be reduced."""
    if plan.step is not None:
        return replace(plan, step=FINER_STEP * plan.step)
    if plan.tolerance is None or plan.tolerance <= LEAST_TOLERANCE:
        return None
    return replace(
        plan,
        tolerance=max(LEAST_TOLERANCE, FINER_TOLERANCE * plan.tolerance),
        first_step=FINER_STEP * plan.first_step,
        longest_step=FINER_STEP * plan.longest_step,
        least_step=FINER_STEP * plan.least_step,
    )

"""Settings of a scene that a cost study compares.

Trajectories vary the integration method with its step or tolerance, in all backends. Distributions vary one
thing of the case; all but one of their settings run in the compiled loop.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum

from exunet.base.errors import CaseError
from exunet.forces.effects.contact import Contact
from exunet.kernels.compile import numba_installed
from exunet.methods.method import COMPILED_METHODS, METHODS, Backend, Kind, Method, Plan
from exunet.model.limits import (
    largest_damping_rate,
    largest_frequency,
    relative_speed,
    stable_step,
    step_limit,
)
from exunet.net.base import ThrownNetConfig
from exunet.scene.casefile import Case, parse_case
from exunet.simulation.planning import relative_tolerance
from exunet.simulation.preparation import Start, in_the_compiled_loop, prepare_case

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)  # relative to the launch speed
ACCURACIES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  # of solver.accuracy
STABLE_PARTS = (0.8, 0.4, 0.2, 0.1, 0.05, 0.02)  # of the stable step
IMPLICIT_PARTS = (64.0, 16.0, 4.0, 1.0, 0.4)  # of that of RK44; implicit methods have none of their own
# Of that of velocity Verlet, for methods whose own vanishes without damping. At 0.1 the forward Euler method
# lets the fastest mode grow by 2 % a step.
UNSTABLE_PARTS = (0.1, 0.02, 0.005)

STEP_FACTORS = {1.0: "1", 4.0: "4", 2.0: "2", 0.5: "1/2", 0.25: "1/4"}
TOLERANCE_FACTORS = {1.0: "1", 10.0: "10", 0.1: "1/10", 0.01: "1/100"}
ACCURATE = "solver.accuracy"  # name of the settings that have one
SAME = 0.2  # relative difference from the step of the case, below which no other one is compared
DIVISION_FACTORS = (2, 4)


class Varied(StrEnum):
    """Quantity that a setting varies."""

    SIZE = "step or tolerance"
    METHOD = "method"
    DIVISIONS = "divisions"
    BACKEND = "backend"


INTEGRATION = Varied.SIZE, Varied.METHOD  # of the same model


@dataclass(frozen=True)
class Setting:
    """One way to run a scene.

    name      : method and backend, or the difference from the case; settings of one name differ in their size
    backend   : None: the reference
    tolerance : of an adaptive method [m, m/s]
    step      : of a fixed-step method [s]
    changes   : overrides "key=value" of the case beside [solver] and [engine]
    accuracy  : `solver.accuracy` that sets the tolerance; None: the tolerance is given
    elements  : factor on the number of elements of the case
    forced    : the step is above the stable one
    """

    varied: Varied
    name: str
    method: Method | str
    backend: Backend | None
    tolerance: float | None = None
    step: float | None = None
    changes: tuple[str, ...] = ()
    accuracy: float | None = None
    elements: int = 1
    forced: bool = False

    def __str__(self) -> str:
        if self.accuracy is not None:
            return f"{ACCURATE} = {power(self.accuracy)}"
        size = f"step {self.step:.3g} s" if self.tolerance is None else f"tolerance {self.tolerance:.3g} m/s"
        return f"{self.name}, {size}"

    @property
    def size(self) -> float:
        """Tolerance or step: smaller is finer, among settings of one name."""
        return float(self.tolerance or self.step or 0.0)

    def overrides(self, *solver: str) -> tuple[str, ...]:
        """Values of `--set` that run the setting; solver: further keys of [solver]."""
        assert self.backend is not None
        size = f"step={self.step!r}" if self.tolerance is None else f"tolerance={self.tolerance!r}"
        how = [f'method="{self.method}"', size, *["force=true"] * self.forced]
        if self.accuracy is not None:
            how = [f"accuracy={self.accuracy!r}"]
        keys = ",".join([*how, *solver])
        return *self.changes, f"solver={{{keys}}}", f'engine={{backend="{self.backend}"}}'


def setting_of(
    backend: Backend | None,
    method: Method | str,
    *,
    tolerance: float | None = None,
    step: float | None = None,
) -> Setting:
    """Setting of a method on a backend (None: the reference) with a tolerance [m, m/s] or a step [s]."""
    return Setting(Varied.METHOD, f"{method} ({backend or 'reference'})", method, backend, tolerance, step)


def power(value: float) -> str:
    """Format a number as 1e-3, of one digit."""
    digits, exponent = f"{value:.0e}".split("e")
    return f"{digits}e{int(exponent)}"


def changed(case: Case, *changes: str) -> Case:
    """Case with further overrides "key=value"."""
    return parse_case(case.text, case.path, (*case.overrides, *changes))


def stable_step_of(start: Start, method: Method | None = None) -> float:
    """Stable step [s] of a scene by its own method, or another."""
    system = start.system
    return stable_step(method or start.plan.method, largest_frequency(system), largest_damping_rate(system))


def ladder(start: Start, backend: Backend, method: Method) -> list[Setting]:
    """Settings of a method on a backend, the loosest first; at most one step is a hundredth of the run."""
    facts, parts, unit = METHODS[method], list(STABLE_PARTS), method
    if facts.kind == Kind.ADAPTIVE:
        speed, number = relative_speed(start.system, start.state), 8 if facts.order > 3 else 6
        return [setting_of(backend, method, tolerance=_rounded(t * speed)) for t in TOLERANCES[:number]]
    if facts.kind == Kind.IMPLICIT:
        parts, unit = list(IMPLICIT_PARTS), Method.RK44
    elif facts.needs_step:
        parts, unit = list(UNSTABLE_PARTS), Method.VELOCITY_VERLET
    bounds = largest_frequency(start.system), largest_damping_rate(start.system)
    longest = start.scene.time.end / 100.0
    steps = {_rounded(min(part * step_limit(unit, *bounds), longest)) for part in parts}
    found = (setting_of(backend, method, step=step) for step in sorted(steps, reverse=True))
    return [replace(setting, forced=setting.size > step_limit(method, *bounds)) for setting in found]


def accurate(start: Start) -> list[Setting]:
    """Settings of `solver.accuracy` in the compiled loop, the loosest first."""
    scale, named = relative_speed(start.system, start.state), setting_of(Backend.COMPILED, Method.DOPRI5)
    return [
        replace(named, name=ACCURATE, tolerance=scale * relative_tolerance(accuracy), accuracy=accuracy)
        for accuracy in ACCURACIES
    ]


def settings_of_trajectory(start: Start, *, reference: bool = False) -> list[Setting]:
    """Settings whose trajectories are compared: all methods in all backends, and accuracies.

    reference : with the reference
    """
    found = accurate(start) if numba_installed() else []
    for backend in reversed(Backend) if numba_installed() else (Backend.EXUDYN,):
        for method in COMPILED_METHODS if backend == Backend.COMPILED else METHODS:
            found += ladder(start, backend, method)
    scale = relative_speed(start.system, start.state)
    tolerances = TOLERANCES if reference else ()
    return [*found, *(setting_of(None, "DOP853", tolerance=_rounded(t * scale)) for t in tolerances)]


def divisions(case: Case, start: Start) -> Iterator[Setting]:
    """The case with more elements on mesh sides and strings; the step is the same part of the stable one."""
    net, plan = case.scene.net, start.plan
    for count in DIVISION_FACTORS:
        changes = [f"net.divisions={count * net.divisions}"]
        if isinstance(net, ThrownNetConfig) and net.strings is not None:
            changes.append(f"net.strings.divisions={count * net.strings.divisions}")
        factor = 1.0
        if plan.step is not None:
            with suppress(CaseError):  # raised again when the setting is prepared
                finer = prepare_case(changed(case, *changes, f'solver={{method="{plan.method}"}}'))
                ratio = min(1.0, stable_step_of(finer, plan.method) / stable_step_of(start))
                factor = math.floor(1e3 * ratio) / 1e3  # so that rounding does not exceed the stable step
        found = _from_case(plan, Varied.DIVISIONS, f"divisions x {count}", factor, tuple(changes))
        yield replace(found, elements=count)


def _from_case(
    plan: Plan,
    varied: Varied,
    name: str,
    factor: float = 1.0,
    changes: tuple[str, ...] = (),
    backend: Backend = Backend.COMPILED,
) -> Setting:
    """Setting with the method of a plan, and its step or tolerance times a factor."""
    size = plan.tolerance if plan.step is None else plan.step
    assert size is not None
    size = _rounded(factor * size, 12 if factor == 1.0 else 4)
    tolerance, step = (size, None) if plan.step is None else (None, size)
    return Setting(varied, name, plan.method, backend, tolerance, step, changes)


def _rounded(size: float, digits: int = 4) -> float:
    """Step or tolerance to some digits, so that options of a run are short."""
    return float(f"{size:.{digits}g}")


def is_capture(case: Case) -> bool:
    """True if a case has contact or a capture criterion."""
    return case.scene.capture is not None or case.scene.effects.get(Contact) is not None


def settings_of_distribution(case: Case) -> list[Setting]:
    """Settings whose metrics are compared, the case as it is first.

    Raises MissingExtra without Numba, CaseError if the compiled loop cannot run the case.
    """
    start = in_the_compiled_loop(prepare_case(case))
    plan, capture = start.plan, is_capture(case)
    what, factors = ("tolerance", TOLERANCE_FACTORS) if plan.step is None else ("step", STEP_FACTORS)
    largest = math.inf if plan.step is None else max(1.0, stable_step_of(start) / plan.step)
    found = [
        _from_case(plan, Varied.SIZE, f"{what} x {name}", factor)
        for factor, name in factors.items()
        if factor == 1.0 or (capture and factor <= largest)
    ]
    if not capture:
        found += (replace(setting, varied=Varied.SIZE) for setting in accurate(start)[1:5])
        for method in (Method.VELOCITY_VERLET, Method.RK44):
            varied = Varied.SIZE if method == plan.method else Varied.METHOD
            steps = ladder(start, Backend.COMPILED, method)[:5]
            if method == plan.method:
                steps = [item for item in steps if abs(math.log(item.size / found[0].size)) > SAME]
            found += (replace(setting, varied=varied) for setting in steps)
    in_exudyn = _from_case(plan, Varied.BACKEND, f"backend {Backend.EXUDYN}", backend=Backend.EXUDYN)
    return [*found, *divisions(case, start), in_exudyn]

"""Integration in time of the first-order system (15)-(17): which method, which arguments, what is stored.

The energy taken by damping is one more unknown, W' = v^T D v, W(0) = 0, advanced with the same weights.  It
stays out of the estimate of the error, so the motion is what it would be without it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.bodies import BodyStates, Poses
from reference_impl.closing import kinks as told_anew
from reference_impl.energy_momentum import EnergyMomentum, unsupported
from reference_impl.run import Breakdown, Diverged, Interrupted, Pierced, Run, Trajectory
from reference_impl.runge_kutta import PAIRS
from reference_impl.state import Mode, layout
from reference_impl.system import System

TOLERANCES = {"RK45": (1e-3, 1e-6), "DOP853": (1e-10, 1e-12)}  # rtol, atol; for RK45 as in ode45
METHODS = (*TOLERANCES, "EM")

Progress = Callable[[float, float], None]


class Stepper(Protocol):
    """What takes a run along."""

    def advance(self, end: float) -> tuple[Floats, Mode]:
        """Takes the run to t = end [s], or beyond; the state and mode at `end`."""

    def renew(self, until: float) -> None:
        """The forces changed at t; they are smooth `until` [s], where a call of `advance` ends."""


__all__ = [
    "METHODS",
    "TOLERANCES",
    "Diverged",
    "Interrupted",
    "Pierced",
    "Progress",
    "Scheme",
    "Trajectory",
    "integrate",
    "unsupported",
]


@dataclass(frozen=True)
class Scheme:
    """How to integrate: tolerances are for RK45 and DOP853 (with defaults), a step [s] is for EM.

    Raises ValueError for what cannot be meant.
    """

    method: str = "DOP853"
    rtol: float | None = None
    atol: float | None = None  # [m, m/s]
    step: float | None = None  # [s]

    def __post_init__(self) -> None:
        method = self.method
        if method not in METHODS:
            raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method}")
        if (method == "EM") != (self.step is not None):
            raise ValueError(f"a step must be given for EM, and for EM only; this is {method}")
        if method == "EM" and (self.rtol is not None or self.atol is not None):
            raise ValueError("EM must have no tolerances")
        for name in ("rtol", "atol", "step"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be a finite number greater than 0")

    @property
    def tolerances(self) -> tuple[float | None, float | None]:
        """rtol [-] and atol [m, m/s], those of the method where none are given; None where it has none."""
        rtol, atol = TOLERANCES.get(self.method, (None, None))
        return rtol if self.rtol is None else self.rtol, atol if self.atol is None else self.atol

    def stepper(self, run: Run, times: Floats) -> Stepper:
        """What takes `run` along to the stored `times` [s]."""
        if self.step is not None:
            return EnergyMomentum(run, self.step)
        rtol, atol = self.tolerances
        assert rtol is not None
        assert atol is not None
        return PAIRS[self.method](run, rtol, atol, times)


def integrate(
    system: System,
    x0: Floats,
    v0: Floats,
    times: Sequence[float] | Floats,
    *,
    method: str = "DOP853",
    rtol: float | None = None,
    atol: float | None = None,
    step: float | None = None,
    bodies: BodyStates | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """States at `times` [s] from x0, v0 (n, 3) [m, m/s] and `bodies` (b, ...) at times[0].

    `method` to `step`: see `Scheme`.  `progress(t, end)` is called at each stored time; None is silent.
    Raises ValueError for arguments out of range, Diverged where no finite step is left, Interrupted on
    Ctrl-C; these two carry what was stored.
    """
    scheme = Scheme(method, rtol, atol, step)
    times = np.asarray(times, dtype=float)
    _check(system, x0, v0, times)
    _check_bodies(system, bodies)
    if scheme.method == "EM" and (reason := unsupported(system)):
        raise ValueError(f"EM must do without {reason}")
    run = Run(system, float(times[0]), layout(system).pack(x0, v0, bodies, float(times[0])))
    try:
        with np.errstate(all="ignore"):
            run.begin()
            run.store(run.t, run.y, run.mode)
            _follow(run, scheme, times, progress)
    except Breakdown as error:
        raise run.diverged(error) from None
    except KeyboardInterrupt:
        raise Interrupted(run.trajectory()) from None
    return run.trajectory()


def _follow(run: Run, scheme: Scheme, times: Floats, progress: Progress | None) -> None:
    """Takes the run from stored time to stored time; steps end at knots, commands and an ejection too.

    After an ejection the method starts anew, with a first step as at the beginning of a run.
    """
    stepper, ejection = scheme.stepper(run, times), _ejection(run, times)
    thrust, end = run.system.effects.thrust, float(times[-1])
    kinks = set(() if thrust is None else thrust.time)
    for drive in () if run.system.reels is None else run.system.reels.drives:
        kinks.update(command.at for command in drive.commands)
    if run.system.closing is not None:
        kinks.update(told_anew(run.system.closing))
    for _, thruster in run.system.propelled:
        kinks.update(thruster.profile.time)
    for motion in run.system.bodies.drives:
        kinks.update(motion.times if isinstance(motion, Poses) else ())
    if ejection is not None:
        kinks.add(ejection)
    knots = sorted(t for t in kinks if run.t < t <= end)
    if knots:
        stepper.renew(knots[0])
    for time in times[1:].tolist():
        while knots and knots[0] <= time:
            knot = knots.pop(0)
            stepper.advance(knot)
            run.enter_segment()
            if knot == ejection:
                run.eject()
                run.begin_to_touch()
                if knot < end:
                    stepper = scheme.stepper(run, np.concatenate(([knot], times[times > knot])))
            stepper.renew(knots[0] if knots else end)
        run.store(time, *stepper.advance(time))
        if progress is not None:
            progress(time, end)


def _ejection(run: Run, times: Floats) -> float | None:
    """When the packed net is ejected [s], a stored time where these agree but for round-off; None: never."""
    packed = run.system.packed
    if packed is None or not packed.holds(run.t):
        return None
    after = [t for t in times.tolist() if not packed.holds(t)]
    return min(packed.until, after[0]) if after else None


def _check_bodies(system: System, bodies: BodyStates | None) -> None:
    """Refuses states that are not those of the system's bodies."""
    count = len(system.bodies.names)
    if bodies is None:
        if count:
            raise ValueError(f"bodies must be given: the states of {', '.join(system.bodies.names)}")
        return
    shapes = {"position": (3,), "velocity": (3,), "attitude": (3, 3), "angular_velocity": (3,)}
    for key, shape in shapes.items():
        value = getattr(bodies, key)
        if np.shape(value) != (count, *shape) or not np.all(np.isfinite(value)):
            raise ValueError(f"bodies.{key} must be finite and have the shape {(count, *shape)}")


def _check(system: System, x0: Floats, v0: Floats, times: Floats) -> None:
    """Refuses a start or times that are out of range."""
    shape = system.net.reference_position.shape
    if np.shape(x0) != shape or np.shape(v0) != shape:
        raise ValueError(f"x0 and v0 must have the shape {shape}")
    if not (np.all(np.isfinite(x0)) and np.all(np.isfinite(v0))):
        raise ValueError("x0 and v0 must be finite")
    if np.any(np.asarray(v0)[system.net.fixed_nodes]):
        raise ValueError("fixed nodes must start at rest")
    if times.ndim != 1 or not times.size or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0.0):
        raise ValueError("times must be finite and increase strictly")

"""State of a user's Exudyn system, stored and restored, and the force that its method must apply.

The net goes through a step of the host first, and tells the mean force F of that step. Runge-Kutta methods
apply it whole. Exudyn's velocity Verlet and its trapezoidal rule take the mean of what they are handed for
this step and for the one before; the generalised-alpha method (Arnold and Bruels, "Convergence of the
generalized-alpha scheme for constrained mechanical systems", Multibody Syst. Dyn. 18 (2007),
doi 10.1007/s11044-007-9084-0) weighs more of them by its algorithmic acceleration. Handed F, they lag by half
a step H, which is a negative damping: on a spring k with a mass m amplitudes grow by H^2 k / (4 m) a step,
however short the step is.

So these methods are handed the force E that is to be expected at the end of the step, by F and the mean force
of the step before, and what the mean of two such has left out so far: G = E + D / H. That D is zero for a
force that changes evenly, and a jump of the force is made good within the next step, without oscillation. All
that is handed over adds up to the impulse of the net.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.integrators.exudyn.engine import exudyn

Floats = NDArray[np.float64]

# Their steps depend on nothing but coordinates, velocities, data and time, which the engine gives and takes.
# Velocity Verlet, implicit and adaptive methods keep more.
EXACT = ("ExplicitMidpoint", "RK33", "RK44", "RK67")
# In parts of the largest: accelerations that are given, and one that follows from a difference of velocities.
_SAME_ACCELERATION, _NEARLY = 1e-10, 1e-4
_UNKNOWN = (
    "couple: the host has rejected a step, and what its generalised-alpha method goes on with is not known: "
    "set timeIntegration.generalizedAlpha.useNewmark, or use TrapezoidalIndex2: neither keeps an acceleration"
)
_PARTS = ("ODE2", "ODE2_t", "ODE1", "AE", "data")  # of the engine's list


def state_of(mbs: Any, time: float) -> dict[str, Floats]:
    """All that the engine gives, and the time (1,) [s]; copies."""
    state = mbs.systemData.GetSystemState()
    parts = {name: np.array(part, dtype=float) for name, part in zip(_PARTS, state, strict=True)}
    return {"time": np.array([time]), **parts}


def put_back(who: str, mbs: Any, state: Mapping[str, Floats]) -> float:
    """Put back what `state_of` gave, also as what the next run starts from; returns its time [s].

    Raises InputError for a state that is none, or is of a system with other coordinates.
    """
    own = state_of(mbs, 0.0)
    if not isinstance(state, Mapping) or {name: np.shape(part) for name, part in state.items()} != {
        name: part.shape for name, part in own.items()
    }:
        raise InputError(f"{who}: restore: the state is not of this system: it has other coordinates")
    kinds = exudyn(quiet=False).ConfigurationType
    for kind in (kinds.Initial, kinds.Current):
        mbs.systemData.SetSystemState([state[name] for name in _PARTS], kind)
        mbs.systemData.SetTime(float(state["time"][0]), kind)
    return float(state["time"][0])


class Attempt(NamedTuple):
    """At a step of which others were rejected, by generalised-alpha, which keeps an acceleration a.

    failures : how many of those have changed a
    kept     : a at the end of the step before
    now      : a with which this attempt begins; both (n,) of all coordinates
    velocity : (n,) at the beginning
    """

    failures: int
    kept: Floats
    now: Floats
    velocity: Floats


def begun(mbs: Any, solver: Any, weights: Weights, rejected: int) -> Attempt:
    """Where an attempt begins, after as many that were rejected.

    Before Newton's method begins the engine turns a into f / (1 - m) F - m / (1 - m) a, with the acceleration
    F of the last step. Where full Newton fails it goes on from there (1.13); where a post-Newton function
    asks for a shorter step, a is put back.
    Raises InputError if a is not what so many failures can lead to.
    """
    kept, now = solver.GetStartOfStepStateAAlgorithmic(), solver.GetAAlgorithmic()
    data, start = mbs.systemData, exudyn(quiet=False).ConfigurationType.StartOfStep
    given, velocity = data.GetODE2Coordinates_tt(start), data.GetODE2Coordinates_t(start)
    near = _SAME_ACCELERATION * max(np.abs(kept).max(), np.abs(given).max())
    for number in range(rejected + 1):
        led = weights.faded(kept, given, number) if number else kept
        if np.abs(now - led).max() <= near:
            return Attempt(number, kept, now, velocity)
    raise InputError(_UNKNOWN)


def ended(mbs: Any, solver: Any, weights: Weights, attempt: Attempt, step: float) -> int:
    """How many failures have changed the acceleration with which a step [s] was taken that has just ended.

    Modified Newton that starts anew within the attempt has put it back.
    """
    velocity, last = mbs.systemData.GetODE2Coordinates_t(), solver.GetAAlgorithmic()
    found = ((velocity - attempt.velocity) / step - weights.gamma * last) / (1.0 - weights.gamma)
    off = [float(np.abs(found - item).max()) for item in (attempt.now, attempt.kept)]
    if min(off) > _NEARLY * max(np.abs(attempt.kept).max(), np.abs(last).max()):
        raise InputError(_UNKNOWN)
    return attempt.failures if off[0] <= off[1] else 0


@dataclass(frozen=True)
class Weights:
    """Of a method that weighs, with a of the step before as b, F as E:

        (1 - m) a + m b = (1 - f) F + f E,    v += h ((1 - g) b + g a)

    mass, force, gamma : m, f and g; 0, 0 and 1/2 for the trapezoidal rule and for velocity Verlet
    """

    mass: float = 0.0
    force: float = 0.0
    gamma: float = 0.5

    @property
    def keeps(self) -> bool:
        """True if a is not the force of the last step, but goes on by itself."""
        return self.mass != 0.0 or self.force != 0.0

    def faded(self, rate: Floats, given: Floats, failures: int) -> Floats:
        """What a is when attempts at a step have failed, see `exunet.coupling.exudyn_state.Attempt`.

        rate, given : a and F at the beginning of that step
        """
        settled = self.force * given
        return settled + (-self.mass / (1.0 - self.mass)) ** failures * (rate - settled)


def weights_of(integration: Any) -> Weights | None:
    """By `timeIntegration` of Exudyn's settings; None: the method applies the force of a step whole.

    Raises InputError for the explicit Euler method, which moves bodies on before it applies the force.
    """
    name, alpha = integration.solverType.name, integration.generalizedAlpha
    if name == "ExplicitEuler":
        raise InputError(
            "couple: ExplicitEuler moves the bodies by the velocities before the force: the coupling would "
            "gain energy at any step. Use a Runge-Kutta method, VelocityVerlet or an implicit method"
        )
    if name == "GeneralizedAlpha" and not alpha.useNewmark:
        radius = float(alpha.spectralRadius)
        mass, force = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        return Weights(mass, force, 0.5 + force - mass)
    if name in ("GeneralizedAlpha", "TrapezoidalIndex2"):
        return Weights(gamma=float(alpha.newmarkGamma))
    return Weights() if name == "VelocityVerlet" else None


@dataclass
class Handover:
    """Of the forces and torques of all ports, (n,) together, step by step of the host.

    weights    : of the host's method; None: it applies what it is handed whole
    in_transit : (n,) impulse that the net has given and the host does not show yet [N s], [N m s]
    failures   : attempts at the step that comes after which the method goes on with another acceleration
    """

    in_transit: Floats
    weights: Weights | None = None
    _given: Floats = field(init=False)  # handed over for the last step
    _rate: Floats = field(init=False)  # what of it the method keeps: its algorithmic acceleration
    _owed: Floats = field(init=False)  # D times H: impulse less means of two forces that were handed over
    _owes: bool = False  # something was owed when the solver started
    _mean: Floats | None = None  # of the last step; None after a jump, which does not go on
    _step: float = 0.0  # the last [s]
    failures: int = 0  # attempts at the step that comes which the method has not got over

    def __post_init__(self) -> None:
        self._given = self._rate = self._owed = np.zeros_like(self.in_transit)

    def numbers(self) -> dict[str, Floats]:
        """All but the weights, which each run of the host tells anew; for a snapshot."""
        mean = np.zeros(0) if self._mean is None else self._mean
        return {
            "in_transit": self.in_transit,
            "given": self._given,
            "rate": self._rate,
            "owed": self._owed,
            "mean": mean,
            "step": np.array([self._step]),
        }

    @classmethod
    def of_numbers(cls, numbers: Mapping[str, Floats]) -> Handover:
        """What `numbers` gave; its force acts still."""
        one = cls(numbers["in_transit"])
        one._given, one._rate, one._owed = (numbers[name] for name in ("given", "rate", "owed"))
        one._mean, one._step = numbers["mean"] if len(numbers["mean"]) else None, float(numbers["step"][0])
        return one

    @property
    def acting(self) -> Floats:
        """(n,) forces and torques that were handed over last."""
        return self._given

    def begin(self, weights: Weights | None) -> None:
        """A solver starts: its accelerations are those of the force that was handed over last."""
        self.weights, self._rate, self._owed = weights, self._given, self.in_transit
        self._owes = bool(self._owed.any())

    def handed(self, mean: Floats, step: float, *, jumps: bool) -> Floats:
        """(n,) force for a step [s] with a mean force; changes nothing.

        jumps : the mean has a throw in it, which does not go on
        """
        over = 1.0 / max(step, self._step)  # a short step after a long one is not to make all good at once
        if self.weights is None:
            return mean + over * self._owed if self._owes else mean
        expected = self._given if jumps else mean
        if self._mean is not None and not jumps:
            expected = mean + step / (step + self._step) * (mean - self._mean)
        owed = self._owed + self._lost(step) + step * (mean - 0.5 * (self._given + expected))
        return expected + over * owed

    def _lost(self, step: float) -> Floats:
        """(n,) of the impulses handed over so far, what failures have made the method forget.

        It is the sum over the steps that come, of one length [s], of what follows from the acceleration that
        was, less that which follows from the one that is.
        """
        weights = self.weights
        if weights is None or not self.failures:
            return np.zeros_like(self._rate)
        left = self._rate - weights.faded(self._rate, self._given, self.failures)
        return step * (1.0 - weights.gamma - weights.mass) * left

    def let_go(self) -> None:
        """Nothing more is handed over: the method applies what follows from that, in steps like the last."""
        weights = self.weights
        if weights is None:
            return
        after = (weights.force * self._given - weights.mass * self._rate) / (1.0 - weights.mass)
        # all later ones follow from that, in a geometric series
        later = (1.0 - weights.gamma) * (1.0 - weights.mass) - weights.gamma * weights.mass
        shown = (1.0 - weights.gamma) * self._rate + weights.gamma * after + later * after
        self.in_transit = self.in_transit - self._step * shown
        self._given = self._rate = np.zeros_like(self._given)

    def take(self, mean: Floats, handed: Floats, step: float, *, jumps: bool) -> Floats:
        """The step counts, for which a force was handed over: (n,) mean force that the host has applied."""
        weights = self.weights
        if weights is None:
            rate = applied = handed
            if handed is not mean:
                left = step * (mean - handed)
                self.in_transit, self._owed = self.in_transit + left, self._owed + left
        else:
            before, lost = self._rate, self._lost(step)
            if self.failures:
                before = weights.faded(before, self._given, self.failures)
            weighed = (1.0 - weights.force) * handed + weights.force * self._given - weights.mass * before
            rate = weighed / (1.0 - weights.mass)
            applied = (1.0 - weights.gamma) * before + weights.gamma * rate
            shared = 0.5 * (self._given + handed)
            self.in_transit = self.in_transit + step * (mean - applied)
            self._owed = self._owed + lost + step * (mean - shared)
        self._given, self._rate, self._step, self.failures = handed, rate, step, 0
        self._mean = None if jumps else mean
        return applied

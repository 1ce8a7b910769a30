"""Net coupled to an Exudyn system that Exudyn's own solvers step, at markers of any rigid frames.

The net goes through a step of the host first, and gives the mean force F of that step. Runge-Kutta methods
apply it whole. Exudyn's velocity Verlet and its trapezoidal rule apply the mean of the forces that they get
for this step and for the one before; the generalised-alpha method (Arnold and Bruels, "Convergence of the
generalized-alpha scheme for constrained mechanical systems", Multibody Syst. Dyn. 18 (2007), doi
10.1007/s11044-007-9084-0) weighs more of them by its algorithmic acceleration. With F they lag by half a step
H, which is a negative damping: on a spring k with a mass m amplitudes grow by H^2 k / (4 m) a step, however
short the step is.

So these methods get the force E that is expected at the end of the step, by F and the mean force of the step
before, and what the mean of two such has left out so far: G = E + D / H. That D is zero for a force that
changes evenly, and a jump of the force is corrected within the next step, without oscillation. The sum of all
G is the impulse of the net.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError, RunStopped
from exunet.bodies.port import frames_of
from exunet.coupling.exudyn_host import (
    EXACT,
    SAME_TIME,
    MarkedPorts,
    restore_state,
    state_of,
    validate_system,
)
from exunet.coupling.ledger import Ledger
from exunet.coupling.net_system import NetSystem, PortLoads
from exunet.coupling.ports import (
    CONTINUATION,
    OWN,
    validate_continued,
    validate_no_jump,
    validate_ports,
    validate_same_start,
)
from exunet.coupling.rollback import CoupledNet, CoupledSnapshot
from exunet.coupling.stability import STABLE, WEIGHING, LongestStep, Ratios, longest_step, ratios_of
from exunet.integrators.exudyn.engine import exudyn

Floats = NDArray[np.float64]

# Relative to the largest: given accelerations, and one that follows from a difference of velocities.
_SAME_ACCELERATION, _NEARLY = 1e-10, 1e-4
_UNKNOWN_ACCELERATION = (
    "couple: the host has rejected a step, and the acceleration with which its generalised-alpha method "
    "continues is not known: set timeIntegration.generalizedAlpha.useNewmark, or use TrapezoidalIndex2"
)
_UNKNOWN_METHOD = (
    "couple: the host's method is not known: use mbs.SolveDynamic, with storeSolver=True, for each run"
)


@dataclass(frozen=True)
class Weights:
    """Weights of a method, with its acceleration b of the step before, a of this one, forces F before, E now:

        (1 - m) a + m b = (1 - f) E + f F,    v += h ((1 - g) b + g a)

    mass, force, gamma : m, f and g; 0, 0 and 1/2 for the trapezoidal rule and for velocity Verlet
    """

    mass: float = 0.0
    force: float = 0.0
    gamma: float = 0.5

    @property
    def keeps_acceleration(self) -> bool:
        """True if a is not the force of the last step, but a state of the method."""
        return self.mass != 0.0 or self.force != 0.0

    def faded(self, rate: Floats, given: Floats, failures: int) -> Floats:
        """Return a after failed attempts at a step; rate, given : a and F at its begin."""
        settled = self.force * given
        return settled + (-self.mass / (1.0 - self.mass)) ** failures * (rate - settled)


def weights_of(integration: Any) -> Weights | None:
    """Return the weights by `timeIntegration` of Exudyn's settings; None: forces are applied whole.

    Raises InputError for the explicit Euler method, which moves bodies before it applies the force.
    """
    name, alpha = integration.solverType.name, integration.generalizedAlpha
    if name == "ExplicitEuler":
        raise InputError(
            "couple: ExplicitEuler moves bodies by the velocities before the force: the coupling would gain "
            "energy at any step. Use a Runge-Kutta method, VelocityVerlet or an implicit method"
        )
    if name == "GeneralizedAlpha" and not alpha.useNewmark:
        radius = float(alpha.spectralRadius)
        mass, force = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        return Weights(mass, force, 0.5 + force - mass)
    if name in ("GeneralizedAlpha", "TrapezoidalIndex2"):
        return Weights(gamma=float(alpha.newmarkGamma))
    return Weights() if name == "VelocityVerlet" else None


class Attempt(NamedTuple):
    """Attempt at a step after rejected ones, by generalised-alpha, which has an acceleration a.

    failures : how many of the rejected attempts have changed a
    kept     : (n,) a at the end of the step before
    now      : (n,) a at the begin of this attempt; both of all coordinates
    velocity : (n,) at the begin
    """

    failures: int
    kept: Floats
    now: Floats
    velocity: Floats

    @classmethod
    def begin(cls, mbs: Any, solver: Any, weights: Weights, rejected: int) -> Attempt:
        """Return the attempt that begins after so many rejected ones.

        Before Newton's method the engine turns a into f / (1 - m) F - m / (1 - m) a, with the acceleration F
        of the last step. Where full Newton fails it continues with that (1.13); where a post-Newton function
        requests a shorter step, a is restored. Raises InputError if a does not result from any number of
        failures.
        """
        kept, now = solver.GetStartOfStepStateAAlgorithmic(), solver.GetAAlgorithmic()
        data, start = mbs.systemData, exudyn(quiet=False).ConfigurationType.StartOfStep
        given, velocity = data.GetODE2Coordinates_tt(start), data.GetODE2Coordinates_t(start)
        near = _SAME_ACCELERATION * max(np.abs(kept).max(), np.abs(given).max())
        for number in range(rejected + 1):
            result = weights.faded(kept, given, number) if number else kept
            if np.abs(now - result).max() <= near:
                return cls(number, kept, now, velocity)
        raise InputError(_UNKNOWN_ACCELERATION)

    def end(self, mbs: Any, solver: Any, weights: Weights, step: float) -> int:
        """Return the failures that have changed the acceleration of a step [s] that has ended.

        Modified Newton that starts again within the attempt has restored it.
        """
        velocity, last = mbs.systemData.GetODE2Coordinates_t(), solver.GetAAlgorithmic()
        found = ((velocity - self.velocity) / step - weights.gamma * last) / (1.0 - weights.gamma)
        off = [float(np.abs(found - item).max()) for item in (self.now, self.kept)]
        if min(off) > _NEARLY * max(np.abs(self.kept).max(), np.abs(last).max()):
            raise InputError(_UNKNOWN_ACCELERATION)
        return self.failures if off[0] <= off[1] else 0


@dataclass
class Handover:
    """Forces and torques of all ports, (n,) together, that the host gets step by step.

    in_transit : (n,) impulse of the net that the host has not applied yet [N s], [N m s]
    weights    : of the host's method; None: it applies forces whole
    failures   : attempts at the next step that have changed the method's acceleration
    given      : (n,) force of the last step; rate : (n,) algorithmic acceleration, as far as it results from
                 it
    owed       : (n,) D times H: impulse less means of two given forces
    mean       : (n,) mean force of the last step; None after a jump
    step       : the last [s]
    """

    in_transit: Floats
    weights: Weights | None = None
    failures: int = 0
    given: Floats = field(init=False)
    rate: Floats = field(init=False)
    owed: Floats = field(init=False)
    mean: Floats | None = None
    step: float = 0.0
    _owes: bool = False  # D was not zero when the solver started

    def __post_init__(self) -> None:
        self.given = self.rate = self.owed = np.zeros_like(self.in_transit)

    def arrays(self) -> dict[str, Floats]:
        """Return all values that a snapshot requires; weights follow from each run of the host."""
        mean = np.zeros(0) if self.mean is None else self.mean
        parts = {"in_transit": self.in_transit, "given": self.given, "rate": self.rate, "owed": self.owed}
        return {**parts, "mean": mean, "step": np.array([self.step])}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Floats]) -> Handover:
        """Return the handover of `arrays`."""
        new = cls(arrays["in_transit"])
        new.given, new.rate, new.owed = (arrays[name] for name in ("given", "rate", "owed"))
        new.mean, new.step = arrays["mean"] if len(arrays["mean"]) else None, float(arrays["step"][0])
        return new

    def begin(self, weights: Weights | None) -> None:
        """Start a solver: its accelerations are those of the force that was given last."""
        self.weights, self.rate, self.owed = weights, self.given, self.in_transit
        self._owes = bool(self.owed.any())

    def force_for(self, mean: Floats, step: float, *, recoils: bool) -> Floats:
        """Return the force (n,) to give for a step [s] with a mean force, without and with a jump."""
        over = 1.0 / max(step, self.step)  # a short step after a long one must not correct all at once
        if self.weights is None:
            return mean + over * self.owed if self._owes else mean
        expected = self.given if recoils else mean
        if self.mean is not None and not recoils:
            expected = mean + step / (step + self.step) * (mean - self.mean)
        owed = self.owed + self._lost(step) + step * (mean - 0.5 * (self.given + expected))
        return expected + over * owed

    def _lost(self, step: float) -> Floats:
        """(n,) impulse of the given forces that failures have removed from the method's acceleration.

        It is the sum over all later steps, of one length [s], of the effect of the acceleration before, less
        that of the present one.
        """
        weights = self.weights
        if weights is None or not self.failures:
            return np.zeros_like(self.rate)
        left = self.rate - weights.faded(self.rate, self.given, self.failures)
        return step * (1.0 - weights.gamma - weights.mass) * left

    def stop(self) -> None:
        """Give no more forces: the method applies the effect of those so far, in steps like the last."""
        weights = self.weights
        if weights is None:
            return
        after = (weights.force * self.given - weights.mass * self.rate) / (1.0 - weights.mass)
        # all later ones follow from that, in a geometric series
        later = (1.0 - weights.gamma) * (1.0 - weights.mass) - weights.gamma * weights.mass
        shown = (1.0 - weights.gamma) * self.rate + weights.gamma * after + later * after
        self.in_transit = self.in_transit - self.step * shown
        self.given = self.rate = np.zeros_like(self.given)

    def count(self, mean: Floats, given: Floats, step: float, *, recoils: bool) -> Floats:
        """Count a step [s] with a mean and a given force; return the mean force (n,) that was applied."""
        weights = self.weights
        if weights is None:
            rate = applied = given
            left = step * (mean - given)
            self.in_transit, self.owed = self.in_transit + left, self.owed + left
        else:
            before, lost = self.rate, self._lost(step)
            if self.failures:
                before = weights.faded(before, self.given, self.failures)
            weighed = (1.0 - weights.force) * given + weights.force * self.given - weights.mass * before
            rate = weighed / (1.0 - weights.mass)
            applied = (1.0 - weights.gamma) * before + weights.gamma * rate
            shared = 0.5 * (self.given + given)
            self.in_transit = self.in_transit + step * (mean - applied)
            self.owed = self.owed + lost + step * (mean - shared)
        self.given, self.rate, self.step, self.failures = given, rate, step, 0
        self.mean = None if recoils else mean
        return applied


class SolverRun:
    """Run of the host that is followed, as SolveDynamic stores it in the system.

    solver : of that run; None: no run is followed
    method : its name; "" before the first run
    taken, last : numbers of the last step that the net has taken, and of the last `solver_of`: the next is
                  higher
    """

    def __init__(self, mbs: Any) -> None:
        self._mbs = mbs
        self.forget()

    def forget(self) -> None:
        """Follow no run; the solver of an earlier run is not that of a new one."""
        self.solver: Any = None
        self.method = ""
        self._over = self._stored()
        self._read: Any = None  # the solver that `_iteration` is of
        self.taken = self.last = 0

    def _stored(self) -> Any:
        return self._mbs.sys.get("dynamicSolver")

    @property
    def time(self) -> float:
        """Time of the host [s]; in a pre-step function the end of the step."""
        return float(self._mbs.systemData.GetTime())

    def has_left(self, time: float) -> bool:
        """Return True if the host has advanced from a time [s] by more than the step that begins.

        In a pre-step function its state is still that at the begin of the step.
        """
        if self.time <= time + SAME_TIME:
            return False
        data, kinds = self._mbs.systemData, exudyn(quiet=False).ConfigurationType
        begins = float(data.GetTime(kinds.StartOfStep))
        both = (data.GetODE2Coordinates(kind) for kind in (kinds.StartOfStep, kinds.Current))
        return abs(begins - time) > SAME_TIME or not np.array_equal(*both)

    @property
    def continues(self) -> bool:
        """True if a run is followed that has not ended."""
        return self.solver is not None and not self.solver.output.finishedSuccessfully

    def solver_of(self, until: float, *, again: bool) -> Any:
        """Return the solver that steps to a time [s]; again: it repeats its last step, to an earlier end.

        Raises InputError for a solver that is not stored in the system: it leaves that of an earlier run
        there, with other times and steps.
        """
        solver = self._stored()
        if solver is not self._read:
            if solver is None or solver is self._over:
                raise InputError(_UNKNOWN_METHOD)
            self._read, self._iteration = solver, solver.it
        now = self._iteration
        self.last = now.currentStepIndex
        same_step = solver is self.solver and not again and self.last <= self.taken
        if same_step or abs(now.currentTime - until) > SAME_TIME:
            raise InputError(_UNKNOWN_METHOD)
        return solver

    def settings(self, time: float) -> Any:
        """Return `timeIntegration` of the run that begins; raise InputError unless at the net's time [s]."""
        found = self._mbs.sys.get("simulationSettings")
        if found is None:
            raise InputError(_UNKNOWN_METHOD)
        begin = float(found.timeIntegration.startTime)
        if abs(begin - time) > SAME_TIME:
            raise InputError(
                f"couple: the host starts at t = {begin:.9g} s, the net is at {time:.9g} s: set "
                "timeIntegration.startTime, restore a snapshot of the coupling, or reset the net and couple "
                "it anew"
            )
        return found.timeIntegration


def couple(
    mbs: Any, net: NetSystem, ports: Mapping[str, int], *, longest: float | None = None
) -> ExudynCoupling:
    """Couple a net to an Exudyn system: explicit co-simulation, the net's forces constant over each host's
    step.

        coupling = exunet.couple(mbs, net, {"chaser": marker})
        mbs.SolveDynamic(settings)
        print(coupling.report())

    Parameters
    ----------
    mbs : exudyn.MainSystem
        User's system, with any solver of SolveDynamic. A force and a torque are added at each marker, and the
        system is assembled.
    net : NetSystem
        Several nets may be coupled to one system, and to one body.
    ports : mapping of str to int
        Number of a marker with position and attitude (MarkerBodyRigid, MarkerNodeRigid, ...) for each port.
        The body's mass must include the nodes that are fixed to the port (`NetSystem.carried_mass`).
    longest : float, optional
        Longest step of the host [s]; None: the largest stable one, by mass and inertia of the port's body in
        the case (`exunet.coupling.stability`). A longer step raises InputError when it begins.

    Raises
    ------
    InputError
        For missing or unsuitable ports or markers, a marker that is not where its port is at the start, and a
        net that is coupled already; the system is then unchanged.

    Notes
    -----
    Before each step of the host the net goes through it by its own small steps, while the ports move at the
    acceleration of the step before. The host gets the mean force and torque, or the force by which a method
    that weighs forces applies them. So it receives the impulse of the net's steps to round-off, the error is
    of second order in the host's step, and the report has its energy. The net repeats steps that the host
    repeats, with the inputs that it had, and with those since.
    """
    return ExudynCoupling(mbs, net, ports, longest)


class _Open(NamedTuple):
    """Step that the host takes, or has taken.

    recoils : it contains the jump of an ejection
    given   : (n,) forces and torques that the host got
    before  : (n, 13) states of the markers' frames at its begin
    """

    loads: PortLoads
    recoils: bool
    given: Floats
    before: Floats


_in_force: WeakSet[ExudynCoupling] = WeakSet()  # until `detach`


class ExudynCoupling:
    """Result of `couple`: a coupling in force until `detach`."""

    def __init__(self, mbs: Any, net: NetSystem, ports: Mapping[str, int], longest: float | None) -> None:
        self._own, self._mbs, self._net = CoupledNet("couple", net), mbs, net
        if any(item._net is net for item in _in_force):
            raise InputError("couple: the net is in a coupling already: detach that first")
        validate_system("couple", mbs)
        validate_ports("couple", ports, net.ports, "the number of a marker")
        self._ports = MarkedPorts("couple", mbs, {name: ports[name] for name in net.ports})
        if longest is not None and (isinstance(longest, bool) or not _is_positive(longest)):
            raise InputError(f"couple: longest must be positive, got {longest!r}")
        self._longest = longest
        longest_step(net, STABLE)  # raises for a port for which no step is short enough
        mbs.Assemble()
        self._ended_at: Floats | None = self._ports.at_start()  # where the last step that counts has ended
        for name, start in frames_of(net.ports, self._ended_at).items():
            validate_same_start("couple", name, net.frame(name), start, net.size)
        self._ports.add_loads(net.time)
        self._earlier = self._pre_step_function()
        self._function = self._before_step
        mbs.SetPreStepUserFunction(self._function)
        self._attached, self._detached_within = True, False
        _in_force.add(self)
        self._open: _Open | None = None
        self._handover = Handover(np.zeros(6 * len(net.ports)))
        self._run = SolverRun(mbs)
        self._rejected = 0  # attempts at the next step
        self._attempt: Attempt | None = None  # after those
        self._failed = ""  # reason of the last failure of a step
        self._recoiled = False  # in the step before, a part of which a method that weighs applies in this one

    @property
    def net(self) -> NetSystem:
        """The net, at the end of the host's last step."""
        return self._net

    def report(self) -> Ledger:
        """Return impulse and work through the ports, with the last step if the host has ended it.

        Raises RunStopped if a guard of the net finds an invalid state; a later report has the steps that the
        host took, and notes why the net is behind them.
        """
        self._finish()
        self._try_to_count()
        return self._own.ledger.update()

    def _finish(self) -> None:
        """Check the net by its guards; a later report notes why it has stopped."""
        try:
            self._net.finish()
        except RunStopped as stop:
            self._failed = str(stop)
            raise

    @property
    def in_transit(self) -> dict[str, Floats]:
        """(3,) [N s] of each port: impulse that the host's method has got and not applied yet.

        See `exunet.coupling.exudyn_coupling`; exact for steps of one length. Zero for Runge-Kutta methods.
        """
        self._try_to_count()
        parts = self._handover.in_transit.reshape(-1, 6)[:, :3]
        return dict(zip(self._net.ports, parts.copy(), strict=True))

    def snapshot(self) -> CoupledSnapshot:
        """Return a snapshot of net, system and coupling, between two runs of the host.

        Raises InputError within a step of the host, after a run by a method with further state (velocity
        Verlet, implicit and adaptive ones), and for a net that was restored separately.
        """
        self._validate_attached("snapshot")
        self._own.validate_left(_ANEW)
        self._count_what_ended()
        if self._has_left():
            raise InputError(f"couple: snapshot: {self._own.ledger.note}")
        if self._open is not None:
            raise InputError("couple: snapshot: the host is within a step: wait until its run has ended")
        if self._run.method and self._run.method not in EXACT:
            raise InputError(
                f"couple: snapshot: the host's last run was by {self._run.method}, which has accelerations "
                "or steps that Exudyn does not give, so that it does not restart bitwise: use "
                f"{', '.join(EXACT)}"
            )
        self._finish()
        return self._own.snapshot(state_of(self._mbs, self._net.time), self._memory())

    def restore(self, snapshot: CoupledSnapshot) -> None:
        """Restore a snapshot of the same net and system, coupled alike; between two runs.

        The next run starts there, with its time as `startTime`; runs by the methods of `ExudynHost` continue
        bitwise, if the rest of the system depends on state and time only. Raises InputError for another
        coupling, net or system; all is then unchanged.
        """
        self._validate_attached("restore")
        memory = self._own.restore(
            snapshot, self._memory(), lambda state: restore_state("couple", self._mbs, state)
        )
        self._own.ledger.note, self._failed = "", ""
        self._handover, self._recoiled = Handover.of_arrays(memory), bool(memory["recoiled"][0])
        self._open, self._rejected, self._attempt = None, 0, None
        self._run.forget()
        self._ended_at = None  # the next run begins there
        self._ports.apply(self._handover.given, self._net.time, self._net.time)

    def _memory(self) -> dict[str, Floats]:
        return {"recoiled": np.array([float(self._recoiled)]), **self._handover.arrays()}

    def _validate_attached(self, what: str) -> None:
        if not self._attached:
            raise InputError(f"couple: {what}: the coupling was detached")

    def detach(self) -> None:
        """End the coupling: its forces are zero, and the pre-step function is that before it.

        A pre-step function that was set after `couple` stays, and may call the coupling's, which then only
        calls the one before it. In a pre-step function, `in_transit` counts what a method that weighs forces
        continues to apply; a step that the net has gone through already gets its force.
        """
        if not self._attached:
            return
        runs, open_ = self._run.continues, self._open
        within = runs and open_ is not None and abs(self._run.time - self._net.time) <= SAME_TIME
        with suppress(InputError):  # markers or loads were deleted
            if within and open_ is not None:
                self._own.ledger.note = f"{self._missing} it was detached in it"
                loads = open_.loads
                mean, step = loads.wrenches.reshape(-1), loads.end - loads.begin
                self._handover.count(mean, open_.given, step, recoils=open_.recoils)
            else:
                self._count_what_ended()
        if runs:
            self._handover.stop()
        self._attached, self._open, self._detached_within = False, None, within
        _in_force.discard(self)
        self._ports.end(after_step=within)
        if self._pre_step_function() == self._function:
            self._mbs.SetPreStepUserFunction(self._earlier or 0)

    def _pre_step_function(self) -> Callable[[Any, float], bool] | None:
        found = self._mbs.GetPreStepUserFunction()
        return found["function"] if isinstance(found, dict) else None

    def _before_step(self, mbs: Any, until: float) -> bool:
        """Pre-step function of the engine; a failure here is the reason why a step does not count."""
        try:
            continues = self._step_to(mbs, until)
        except (InputError, RunStopped) as error:
            self._failed = str(error)
            raise
        self._failed = ""
        return continues

    def _step_to(self, mbs: Any, until: float) -> bool:
        """Take the net through the host's step to `until` [s], the end of this attempt."""
        # False ends the host's run, but only after this step
        continues = self._earlier is None or bool(self._earlier(mbs, until))
        if not self._attached:
            if self._detached_within:
                self._detached_within = False
                self._ports.end()
            return continues
        net, own, begin = self._net, self._own, self._net.time
        solver = self._run.solver_of(until, again=until <= begin)
        starts = solver is not self._run.solver
        if starts:
            self._ports.look_up()
            own.validate_left(_ANEW)
        now = self._ports.now()
        if until <= begin:
            self._undo(until)
            begin = net.time
        elif self._open is not None:
            try:
                self._count(now)
            except InputError as error:
                if not starts:
                    raise
                # `now` may be the start of this run, not the end of the one before
                raise InputError(f"{error}. A{CONTINUATION[1:]}") from error
        elif starts and self._ended_at is not None:
            left, found = (frames_of(net.ports, rows) for rows in (self._ended_at, now))
            validate_continued("couple", begin, left, found, net.size)
        if starts:
            settings = self._run.settings(begin)
            self._handover.begin(weights_of(settings))
            bound = STABLE if self._handover.weights is None else WEIGHING
            self._largest = LongestStep(net, bound, self._ports.shared(), self._beside())
            self._run.solver, self._run.method = solver, settings.solverType.name
        self._validate_step(begin, until)
        weights, self._attempt = self._handover.weights, None
        if self._rejected and weights is not None and weights.keeps_acceleration:
            self._attempt = Attempt.begin(mbs, solver, weights, self._rejected)
            self._handover.failures = self._attempt.failures
        loads = own.history.step(until, own.predictor.ahead(begin, until, now))
        recoils = net.recoils(begin, until)
        given = self._handover.force_for(loads.wrenches.reshape(-1), until - begin, recoils=recoils)
        self._ports.apply(given, begin, until)
        self._open = _Open(loads, recoils, given, now)
        own.leave()
        self._run.taken = self._run.last
        return continues

    def _validate_step(self, begin: float, until: float) -> None:
        """Raise InputError for a step between times [s] that is too long."""
        step, longest = until - begin, self._longest
        if self._largest.allows(step) if longest is None else step <= longest * (1.0 + 1e-9):
            return
        beside = any(ratios != Ratios() for ratios in self._beside().values())
        raise InputError(
            f"couple: the host's step of {step:.4g} s at t = {begin:.6g} s is beyond the largest stable one "
            f"of its method, {longest or self._largest.now:.4g} s, for the ports' masses, stiffnesses that "
            f"grow with the stretch, and rotations{', with another net on the same body' if beside else ''}: "
            "use shorter steps, or couple(..., longest=...)"
        )

    def _beside(self) -> dict[str, Ratios]:
        """Return by port the ratios of other nets that are coupled to its body."""
        found = dict.fromkeys(self._net.ports, Ratios())
        for other in _in_force:
            if other is not self and other._mbs is self._mbs:
                for own, name in self._ports.on_one_body_with(other._ports):
                    found[own] = found[own].plus(ratios_of(other._net, name))
        return found

    def _undo(self, until: float) -> None:
        """Go back, since the host repeats its last step to an earlier end."""
        history = self._own.history
        if self._open is None or not history.begin < until:
            raise InputError(
                f"couple: the host steps to t = {until:.6g} s, but the net is at {self._net.time:.6g} s, and "
                f"its last step began at {history.begin:.6g} s: restore a snapshot of the coupling, or "
                f"{_ANEW}"
            )
        history.undo()
        self._own.leave()
        self._own.ledger.repeated += 1
        self._rejected += 1
        self._open = None

    def _has_left(self) -> bool:
        """Return True if the host has advanced without the net: the end of the open step is unknown."""
        return self._open is not None and self._run.has_left(self._own.left_at)

    @property
    def _missing(self) -> str:
        return f"the step to t = {self._own.left_at:.6g} s is not in the balance:"

    def _try_to_count(self) -> None:
        """Count the last step, or note in the ledger why that is not possible."""
        try:
            self._count_what_ended()
        except InputError as error:
            self._own.ledger.note = f"{self._missing} {error}"

    def _count_what_ended(self) -> None:
        """Count the last step if the host has ended it: in an earlier pre-step function, or after the run."""
        own, reached = self._own, self._own.left_at  # the net is behind that after a guard's stop
        if self._has_left():
            reason = self._failed or (
                f"the host has advanced to t = {self._run.time:.6g} s without the net. A pre-step function "
                "that is set after `couple` must call the one before it in each step, also in the last"
            )
            own.ledger.note = f"{self._missing} {reason}"
        elif self._open is not None and self._run.time >= reached - 1e-12:
            self._ports.look_up()  # items may have changed
            self._count(self._ports.now())
        elif self._open is not None and not self._run.continues:
            raise InputError(
                f"couple: the host's run has ended there, and its system is at t = {self._run.time:.6g} s "
                "now: it was reset or restored. Call report() before"
            )
        if self._net.time < reached and self._open is None and self._failed:
            own.ledger.net_is_behind(reached, self._net.time, self._failed)

    def _count(self, now: Floats) -> None:
        """Count the open step, which has led to states (n, 13)."""
        assert self._open is not None
        own, handover, (loads, recoils, given, before) = self._own, self._handover, self._open
        times, step = (loads.begin, loads.end), loads.end - loads.begin
        earlier = own.predictor.earlier(loads.begin, before)
        who = "couple: the host's body at port"
        validate_no_jump(who, self._net.ports, times, (before, now), earlier, OWN, self._net.size)
        weights = handover.weights
        if self._attempt is not None and weights is not None:
            handover.failures = self._attempt.end(self._mbs, self._run.solver, weights, step)
            self._attempt = None
        applied = handover.count(loads.wrenches.reshape(-1), given, step, recoils=recoils)
        late = self._recoiled and weights is not None
        own.record(loads, applied.reshape(-1, 6), (before, now), recoils=recoils, late=late)
        self._recoiled = recoils
        self._open, self._rejected, self._ended_at = None, 0, now


_ANEW = "reset the net and couple it anew"


def _is_positive(given: object) -> bool:
    return isinstance(given, int | float | np.number) and bool(given > 0.0)

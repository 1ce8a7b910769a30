"""A net coupled to a user's own Exudyn system, at markers of any of its rigid frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError, RunStopped
from exunet.bodies.port import frames_of
from exunet.coupling.exudyn_state import (
    EXACT,
    Attempt,
    Handover,
    begun,
    ended,
    put_back,
    state_of,
    weights_of,
)
from exunet.coupling.host_run import SAME_TIME, HostRun, StepLimit
from exunet.coupling.ledger import Books, Ended, WaitingSteps
from exunet.coupling.marked_ports import MarkedPorts
from exunet.coupling.net_system import NetSystem, PortLoads
from exunet.coupling.ports import (
    GOES_ON,
    HostStep,
    Jump,
    refuse_apart,
    refuse_elsewhere,
    refuse_found,
    step_of,
)
from exunet.coupling.prediction import STABLE, WEIGHING, LongestStep, Predictor, longest_step
from exunet.coupling.rollback import CoupledSnapshot, NetAsLeft, Undo, refuse_none
from exunet.coupling.stability import Ratios, ratios_of

Floats = NDArray[np.float64]


def couple(
    mbs: Any, net: NetSystem, ports: Mapping[str, int], *, longest: float | None = None
) -> ExudynCoupling:
    """Couple a net to an Exudyn system: explicit co-simulation, the net's forces held over each of its steps.

        coupling = exunet.couple(mbs, net, {"chaser": marker})
        mbs.SolveDynamic(settings)
        print(coupling.report())

    mbs   : the user's system, with any solver of SolveDynamic; a force and a torque are added at each marker,
            and the system is assembled again
    ports : the number of a marker with position and attitude (MarkerBodyRigid, MarkerNodeRigid, ...) for each
            port; the body's mass must count the nodes that are fixed to the port (`NetSystem.carried_mass`)
    longest : step of the host [s] up to which it is coupled; None: the largest stable one, by the mass and
            the inertia that the case states of the port's body (`exunet.coupling.prediction`). A longer step
            is refused when it comes

    Before each step of the host the net goes through it by its own small steps, while the ports move on at
    the acceleration that the markers had; the host gets the mean force and torque, or, where its method
    weighs the forces of several steps, what makes it apply them (`exudyn_state`). So it receives
    the impulse of the net's steps to the last bit, and the error is of second order in the host's step; the
    report has its energy. A step that the host takes again, shorter, the net takes again too, with the inputs
    that it had, and those that it was given since.
    Raises InputError for ports or markers that are missing or do not fit, if a marker is not where its port
    is at the start, and if the net is coupled already; the system is then as it was. Several nets may be
    coupled to one system, and to one body (that of their markers), where what they put on it adds up.
    """
    if not isinstance(net, NetSystem):
        raise InputError(f"couple: net: an exunet.NetSystem, got {type(net).__name__}")
    if not hasattr(mbs, "systemData"):
        raise InputError(f"couple: mbs: a system of Exudyn, got {type(mbs).__name__}")
    if not isinstance(ports, Mapping):
        raise InputError(f"couple: ports: the number of a marker by the name of each port, got {ports!r}")
    return ExudynCoupling(mbs, net, ports, longest)


class _Open(NamedTuple):
    """The step that the host is taking, or has taken.

    recoils : the jump of a throw is in it
    mean   : (n,) mean forces and torques of all ports, one port after the other
    handed : (n,) those that the host was handed for them
    step   : with where the frames of the markers were when it began
    """

    loads: PortLoads
    recoils: bool
    mean: Floats
    handed: Floats
    step: HostStep


_in_force: WeakSet[ExudynCoupling] = WeakSet()  # until `detach`


class ExudynCoupling:
    """What `couple` gives: a coupling in force until `detach`."""

    def __init__(self, mbs: Any, net: NetSystem, ports: Mapping[str, int], longest: float | None) -> None:
        self._mbs, self._net = mbs, net
        if not net.ports:
            raise InputError('couple: the net has no port: give a body of its case motion = "port"')
        if any(item._net is net for item in _in_force):
            raise InputError("couple: the net is in a coupling already: detach that one first")
        if unknown := [name for name in ports if name not in net.ports]:
            raise InputError(f"couple: there is no port {unknown[0]!r}: {', '.join(net.ports)}")
        if missing := [name for name in net.ports if name not in ports]:
            raise InputError(f"couple: no marker is given for port {', '.join(missing)}")
        self._ports = MarkedPorts("couple", mbs, {name: ports[name] for name in net.ports})
        self._limit = StepLimit(longest)
        longest_step(net, STABLE)  # refuses a port for which no step is short enough
        mbs.Assemble()
        self._ended_at: Floats | None = self._ports.at_start()  # where the step that counts last has led to
        for name, start in frames_of(net.ports, self._ended_at).items():
            refuse_apart("couple", name, net.frame(name), start, net.size)
        self._ports.add_loads(net.time)
        self._earlier = self._earlier_function()
        self._function = self._before_step
        mbs.SetPreStepUserFunction(self._function)
        self._attached, self._acts_on = True, False  # the latter in the step in which it was detached
        _in_force.add(self)
        self._undo, self._predictor = Undo(net), Predictor()
        self._books = Books.of(net)
        self._waiting = WaitingSteps()
        self._open: _Open | None = None
        self._handover = Handover(np.zeros(6 * len(net.ports)))
        self._run = HostRun(mbs)
        self._rejected = 0  # attempts at the step that comes
        self._attempt: Attempt | None = None  # after those
        self._left = NetAsLeft.of(net)
        self._failed = ""  # why the step that came last did
        self._threw = False  # in the step before, a part of which a method that weighs applies in this one

    @property
    def net(self) -> NetSystem:
        """The net, which stands at the end of the host's last step."""
        return self._net

    def report(self) -> Books:
        """What went through the ports, with the last step if the host has ended it; `print` shows a table.

        Raises RunStopped if a guard of the net finds then that it went wrong; a report after that has the
        steps that the host took, and tells why the net is behind them.
        """
        self._let_guards_look()
        self._book_if_it_can_be()
        self._waiting.write(self._books)
        return self._books.looked_at(self._net)

    def _let_guards_look(self) -> None:
        """As `NetSystem.finish`; a report knows then why the net has stopped."""
        try:
            self._net.finish()
        except RunStopped as stop:
            self._failed = str(stop)
            raise

    def _book_if_it_can_be(self) -> None:
        """As `_book_what_ended`; the books tell why not, if the host's state is none."""
        try:
            self._book_what_ended()
        except InputError as error:
            self._books.cut = f"the step to t = {self._reached:.6g} s is not in the books: {error}"

    @property
    def in_transit(self) -> dict[str, Floats]:
        """(3,) [N s] of each port: impulse that the host's method has been given and does not show yet.

        See `exunet.coupling.exudyn_state`; exact for steps of one length. Zero for the Runge-Kutta methods.
        """
        self._book_if_it_can_be()
        parts = self._handover.in_transit.reshape(-1, 6)[:, :3]
        return dict(zip(self._net.ports, parts.copy(), strict=True))

    def snapshot(self) -> CoupledSnapshot:
        """Net, user's system, and all that the coupling remembers, between two runs of the host.

        In memory, or in a file by its `save`. Raises InputError within a step of the host, after a run by a
        method that keeps more than the engine gives (velocity Verlet, implicit and adaptive ones), and for a
        net that was set back by itself.
        """
        self._refuse_detached("snapshot")
        self._refuse_set_back()
        self._book_what_ended()
        if self._has_gone_on():
            raise InputError(f"couple: snapshot: {self._books.cut}")
        if self._open is not None:
            raise InputError("couple: snapshot: the host is within a step: wait until its run has ended")
        if self._run.method and self._run.method not in EXACT:
            raise InputError(
                f"couple: snapshot: the host's last run was by {self._run.method}, which keeps accelerations "
                "or steps that Exudyn does not give, so that it could not be repeated: use "
                f"{', '.join(EXACT)}"
            )
        self._let_guards_look()
        self._waiting.write(self._books)
        state = state_of(self._mbs, self._net.time)
        return CoupledSnapshot("couple", self._net.ports, self._net.snapshot(), state, self._memory())

    def restore(self, snapshot: CoupledSnapshot) -> None:
        """Go back, or on, to a snapshot of the same net and system, coupled alike; between two runs.

        The next run starts from there, with its time as `startTime`; runs by the methods of `ExudynHost` give
        the same to the last bit, if what else is in the system follows from state and time. Raises InputError
        for another coupling, net or system; all is then as it was.
        """
        self._refuse_detached("restore")
        given = refuse_none("couple", snapshot)
        given.refuse_other("couple", self._net, self._memory())
        self._let_guards_look()
        here = self._net.snapshot()
        self._net.restore(given.net)
        try:
            put_back("couple", self._mbs, given.host)
        except BaseException:
            self._net.restore(here)
            raise
        memory = given.memory
        self._predictor = Predictor.of_numbers(memory["before"])
        self._handover = Handover.of_numbers(memory)
        self._books = self._books.with_numbers(memory["books"])
        self._books.cut, self._failed = "", ""
        self._threw = bool(memory["threw"][0])
        self._open, self._rejected, self._attempt = None, 0, None
        self._run.forget()
        self._waiting.forget()
        self._ended_at = None  # the next run begins there
        self._undo, self._left = Undo(self._net), NetAsLeft.of(self._net)
        self._ports.let_act(self._handover.acting, self._net.time, self._net.time)

    def _memory(self) -> dict[str, Floats]:
        return {
            "before": self._predictor.numbers(),
            "books": self._books.numbers(),
            "threw": np.array([float(self._threw)]),
            **self._handover.numbers(),
        }

    def _refuse_detached(self, what: str) -> None:
        if not self._attached:
            raise InputError(f"couple: {what}: the coupling was detached")

    def _refuse_set_back(self) -> None:
        """The coupling goes on from where it has left the net; it remembers the steps before that."""
        if not self._left.is_of(self._net):
            raise InputError(
                f"couple: the net, at t = {self._net.time:.9g} s, is not where the coupling left it: set "
                "net and host back by the coupling's own snapshot and restore, since it remembers the steps "
                "before, or detach, reset the net and couple anew"
            )

    def detach(self) -> None:
        """End the coupling: no force acts any more, and the pre-step function is what it was before.

        One that was set after `couple` stays, and may go on to call the coupling's, which does nothing but
        call the one before it. In a pre-step function, what a method that weighs forces goes on to apply of
        those that it was handed is booked (`in_transit`); a step that the net has gone through already gets
        its force.
        """
        if not self._attached:
            return
        runs = self._run.goes_on
        within = runs and self._open is not None and abs(self._run.time - self._net.time) <= SAME_TIME
        with suppress(InputError):  # the markers or the loads are not there any more
            if within and self._open is not None:
                self._books.cut = (
                    f"the step to t = {self._net.time:.6g} s is not in the books: detached in it"
                )
                step = self._open.loads.end - self._open.loads.begin
                self._handover.take(self._open.mean, self._open.handed, step, jumps=self._open.recoils)
            else:
                self._book_what_ended()
        if runs:
            self._handover.let_go()
        self._attached, self._open = False, None
        _in_force.discard(self)
        self._acts_on = within
        self._ports.let_go(at_end=within)
        if self._earlier_function() == self._function:
            self._mbs.SetPreStepUserFunction(self._earlier or 0)

    def _earlier_function(self) -> Callable[[Any, float], bool] | None:
        found = self._mbs.GetPreStepUserFunction()
        return found["function"] if isinstance(found, dict) else None

    def _before_step(self, mbs: Any, until: float) -> bool:
        """Called by the engine; what fails here is the reason for which a step is not in the books."""
        try:
            goes_on = self._go_through(mbs, until)
        except (InputError, RunStopped) as error:
            self._failed = str(error)
            raise
        self._failed = ""
        return goes_on

    def _go_through(self, mbs: Any, until: float) -> bool:
        """The net goes through the host's step to `until` [s], the end of this attempt."""
        # False ends the host's run, but only after this step
        goes_on = self._earlier is None or bool(self._earlier(mbs, until))
        if not self._attached:
            if self._acts_on:
                self._acts_on = False
                self._ports.let_go()
            return goes_on
        net, begin = self._net, self._net.time
        solver = self._run.solver_of(until, again=until <= begin)
        starts = solver is not self._run.solver
        if starts:
            self._ports.look_up()
            self._refuse_set_back()
        open_ = self._open
        now, jump = self._ports.at_end(None if open_ is None else open_.step)
        if until <= begin:
            self._take_back(until)
            begin = net.time
        elif self._open is not None:
            self._book_before(now, jump, starts=starts)
        elif starts and self._ended_at is not None:
            left, found = (frames_of(net.ports, rows) for rows in (self._ended_at, now))
            refuse_elsewhere("couple", begin, left, found, net.size)
        if starts:
            self._follow(solver)
        self._limit.refuse_long(begin, until, self._with_others)
        weights, self._attempt = self._handover.weights, None
        if self._rejected and weights is not None and weights.keeps:
            self._attempt = begun(mbs, solver, weights, self._rejected)
            self._handover.failures = self._attempt.failures
        earlier = self._predictor.earlier(begin, now)
        loads = self._undo.go_on(until, now, earlier)
        mean = loads.wrenches.reshape(-1)
        recoils = net.recoils(begin, until)
        handed = self._handover.handed(mean, until - begin, jumps=recoils)
        self._ports.let_act(handed, begin, until)
        step = step_of(begin, until, now, earlier, net.size)
        self._open, self._left = _Open(loads, recoils, mean, handed, step), NetAsLeft(until, loads.stands)
        self._run.has_begun_a_step()
        return goes_on

    def _follow(self, solver: Any) -> None:
        """Each run of the host may have another method."""
        settings = self._run.settings(self._net.time)
        self._handover.begin(weights_of(settings))
        bound = STABLE if self._handover.weights is None else WEIGHING
        self._limit.begin(LongestStep(self._net, bound, self._ports.shared(), self._beside()))
        self._run.follow(solver, settings.solverType.name)

    def _beside(self) -> dict[str, Ratios]:
        """By port, what other nets that are coupled to this system put on its body."""
        found = dict.fromkeys(self._net.ports, Ratios())
        for other in _in_force:
            if other is not self and other._mbs is self._mbs:
                for own, name in self._ports.on_one_body_with(other._ports):
                    found[own] = found[own].plus(ratios_of(other._net, name))
        return found

    def _with_others(self) -> str:
        others = any(ratios != Ratios() for ratios in self._beside().values())
        return ", with what another net puts on the same body" if others else ""

    def _take_back(self, until: float) -> None:
        """The host takes its last step again, to an earlier end."""
        if self._open is None or not self._undo.begin < until:
            raise InputError(
                f"couple: the host steps to t = {until:.6g} s, but the net is at {self._net.time:.6g} s, and "
                f"its last step began at {self._undo.begin:.6g} s: restore a snapshot of the coupling, or "
                "reset the net and couple anew"
            )
        self._undo.back()
        self._left = NetAsLeft.of(self._net)
        self._books.repeated += 1
        self._rejected += 1
        self._open = None

    @property
    def _reached(self) -> float:
        """Time [s] to which the net has gone in the host's steps; it is there but after a guard's stop."""
        return self._left.time

    def _has_gone_on(self) -> bool:
        """True if the host has left the net behind, so that where the open step has led to is not known."""
        return self._open is not None and self._run.has_left(self._reached)

    def _book_what_ended(self) -> None:
        """Book the last step if the host has ended it: in an earlier pre-step function, after the run."""
        if self._has_gone_on():
            self._books.cut = f"the step to t = {self._reached:.6g} s is not in the books: " + (
                self._failed
                or f"the host has gone on to t = {self._run.time:.6g} s without the net. A pre-step "
                "function that is set after `couple` has to call the one before it in each step, also in "
                "one in which it ends the run"
            )
        elif self._open is not None and self._run.time >= self._reached - 1e-12:
            self._ports.look_up()  # somebody may have changed items since
            self._book(*self._ports.at_end(self._open.step))
        elif self._open is not None and not self._run.goes_on:
            raise InputError(
                f"couple: the host's run has ended there, and its system is at t = {self._run.time:.6g} s "
                "now: it was reset or set back. Call report() before"
            )
        if self._net.time < self._reached and self._open is None and self._failed:
            self._books.net_is_behind(self._reached, self._net.time, self._failed)

    def _book_before(self, now: Floats, jump: Jump | None, *, starts: bool) -> None:
        """As `_book`; where a run starts, `now` is where that begins, not where the one before ended."""
        try:
            self._book(now, jump)
        except InputError as error:
            if not starts:
                raise
            raise InputError(f"{error}. {GOES_ON[0].upper()}{GOES_ON[1:]}") from error

    def _book(self, now: Floats, jump: Jump | None) -> None:
        """The step that is open has ended and counts; it has led to `now`, with a jump or not."""
        assert self._open is not None
        assert jump is not None
        loads, recoils, mean, handed, (_, before, *_) = self._open
        begin, end = loads.begin, loads.end
        refuse_found("couple: the host's body at port", self._net.ports, (begin, end), jump)
        weights = self._handover.weights
        if self._attempt is not None and weights is not None:
            self._handover.failures = ended(self._mbs, self._run.solver, weights, self._attempt, end - begin)
            self._attempt = None
        applied = self._handover.take(mean, handed, end - begin, jumps=recoils)
        late = self._threw and self._handover.weights is not None
        self._waiting.add(Ended(loads, applied.reshape(-1, 6), recoils or late, before, now), self._books)
        self._threw = recoils
        if recoils:  # a jump, which does not go on
            self._predictor.forget()
        else:
            self._predictor.keep(begin, before)
        self._open, self._rejected, self._ended_at = None, 0, now

"""Coupling of a net and a host, explicit or iterated: macro steps once, or repeated until both agree."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from exunet.base.arguments import finite_number, whole_number
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, RunStopped
from exunet.base.times import reached
from exunet.bodies.port import FrameState, frames_of, rows_of
from exunet.coupling.host import Host
from exunet.coupling.net_system import (
    LARGEST_TURN,
    OWN,
    NetSystem,
    PortLoads,
    distance,
    port_loops,
    validate_no_jump,
    validate_rotation,
    validate_same_start,
)
from exunet.coupling.rollback import CountedStep, CoupledSnapshot, Ledger, Predictor, StepHistory
from exunet.coupling.stability import CONTRACTING, STABLE, LongestStep
from exunet.simulation.snapshot import Snapshot

_SHORTEST = 1e-3  # of the requested step: smallest macro step
_RECOIL = 1e-6  # of a macro step, over which an ejection recoils
_OF_TURN = 0.9  # of the largest rotation in a step, since the angular velocity may grow in it
# Tolerance of times of net and host: of the macro step, and of round-off at a late time.
_OF_STEP, _ULPS = 1e-9, 4.0
_ROUND_OFF = 1e-12  # of a quaternion
_BODY = "Coupler: the host's body at port"


class Coupler:
    """Co-simulation of a net and a host.

        coupler = Coupler(net, host, step=0.01, iterations=20)
        coupler.advance_to(2.0)
        print(coupler.ledger)

    Parameters
    ----------
    net : NetSystem
    host : Host
        With bodies that start like the ports of the net.
    step : float
        Macro step [s]. Steps beyond the largest stable step (`longest`) are
        divided into equal parts, which the ledger notes, and so are steps in which a port would rotate by
        more than 1 rad.
    iterations : int, optional
        1: explicit, with the motion of the ports predicted at the acceleration of the step before. More:
        iterated, the maximum number of passes until the host ends at the motion that the net has used. Both
        are of second order with hosts that apply the whole impulses.
    agreement : float, optional
        Tolerance of both, relative to the net's size, and in radians.
    longest : float, optional
        Longest macro step [s]; None: the largest stable step.

    Raises
    ------
    InputError
        For invalid arguments, and if a port and its body of the host differ at the start.

    Notes
    -----
    A host that fails, ends its step at another time, goes back in time or returns invalid states leaves
    ledger and net as before the step, and the host too where steps are repeated. If the host has advanced,
    `advance_to` raises InputError until both were restored. So it does for a net or a host that was restored
    separately.
    """

    def __init__(
        self,
        net: NetSystem,
        host: Host,
        *,
        step: float,
        iterations: int = 1,
        agreement: float = 1e-9,
        longest: float | None = None,
    ) -> None:
        if not isinstance(host, Host):
            raise InputError(
                f"Coupler: host: must be an exunet.Host, got {type(host).__name__}; use exunet.ExudynHost "
                "for an Exudyn system, exunet.BodiesHost.of_ports(net) for the bodies of the net's own ports"
            )
        if not isinstance(net, NetSystem):
            raise InputError(f"Coupler: net: must be an exunet.NetSystem, got {type(net).__name__}")
        if not net.ports:
            raise InputError('Coupler: the net has no port: give a body of its case motion = "port"')
        self._net, self._host = net, host
        self._ledger, self._predictor, self._history = Ledger(net), Predictor(), StepHistory(net)
        self._leave()
        self._step = _positive("step", step)
        self._agreement = _positive("agreement", agreement)
        number = whole_number(iterations)
        if number is None or number < 1:
            raise InputError(f"Coupler: iterations: must be 1 or more, got {iterations!r}")
        self._iterations = number
        self._largest = LongestStep(net, STABLE if number == 1 else CONTRACTING, self._shared())
        self._given = None if longest is None else _positive("longest", longest)
        self.longest = self._given or self._largest.now
        if self._step > self.longest:
            of = "as given" if self._given else "the longest for the ports' masses, stiffnesses and rotations"
            self._ledger.note = f"macro steps of {self._step:.4g} s cut to {self.longest:.4g} s, {of}"
        self._step = min(self._step, self.longest)
        self._validate_times()
        self._frames = self._host_frames()
        for name, state in frames_of(net.ports, self._frames).items():
            validate_same_start("Coupler", name, net.frame(name), state, net.size)

    @property
    def ledger(self) -> Ledger:
        """Impulse and work through the ports so far; `print` shows a table."""
        return self._ledger.update()

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._net.time

    def advance_to(self, until: float) -> None:
        """Advance to a time [s] by equal macro steps.

        The present time, within round-off, changes nothing.
        Raises InputError if the host does not reach the motion of the net within the iterations, at any macro
        step; RunStopped by the guards of the net or the host.
        """
        end = finite_number(until)
        if end is None or not reached(end, self.time):
            raise InputError(
                f"advance_to: must not be before the time reached, {self.time:g} s, got {until!r}"
            )
        if end <= self.time:
            return
        self._validate_unchanged()
        try:
            for stop in self._stops(end):
                self._interval_to(stop)
        except RunStopped as stop:
            if self.time < (recorded := self._host_time()):
                self._ledger.net_is_behind(recorded, self.time, str(stop))
            raise
        finally:
            self._leave()

    def snapshot(self) -> CoupledSnapshot:
        """Return a snapshot of net, host and coupling; in memory, or in a file by its `save`."""
        self._validate_unchanged()
        self._net.finish()
        self._host.finish()
        return CoupledSnapshot(self._net.ports, self._net.snapshot(), self._host.snapshot(), self._discrete())

    def restore(self, snapshot: CoupledSnapshot) -> None:
        """Restore a snapshot of net and host of the same cases, coupled with the same arguments, bitwise.

        Raises InputError for another coupling, net or host; net and coupling are then unchanged.
        """
        if not isinstance(snapshot, CoupledSnapshot):
            words = "requires a result of `snapshot` or `CoupledSnapshot.load`"
            raise InputError(f"Coupler: restore: {words}, got {snapshot!r}")
        net, own, discrete = self._net, self._discrete(), snapshot.discrete
        given = f"Coupler: restore: the snapshot of t = {snapshot.time:g} s"
        if snapshot.ports != net.ports:
            ports, ours = ", ".join(snapshot.ports), ", ".join(net.ports)
            raise InputError(f"{given} is of a coupling with ports {ports}, this is one with {ours}")
        if (
            discrete.keys() != own.keys()
            or any(discrete[name].shape != own[name].shape for name in ("arguments", "ledger"))
            or not Predictor.accepts(net.ports, discrete["before"])
        ):
            raise InputError(f"{given} is damaged")
        if not np.array_equal(discrete["arguments"], own["arguments"]):
            raise InputError(
                f"{given} is of a coupling with {_words(discrete['arguments'])}; this one has "
                f"{_words(own['arguments'])}"
            )
        net.finish()
        here = net.snapshot()
        net.restore(snapshot.net)
        try:
            self._host.restore(snapshot.host)
        except BaseException:
            net.restore(here)
            raise
        self._predictor, self._history = Predictor.of_array(discrete["before"]), StepHistory(net)
        self._ledger.set_array(discrete["ledger"])
        self._leave()
        self._frames = self._host_frames()

    def _discrete(self) -> dict[str, Floats]:
        arguments = np.array([self._step, self._iterations, self._agreement])
        before, ledger = self._predictor.as_array(), self._ledger.as_array()
        return {"arguments": arguments, "before": before, "ledger": ledger}

    def _leave(self) -> None:
        """Record where the coupling leaves the net."""
        self._left_at, self._left = self._net.time, self._net.state_vector()

    def _stops(self, end: float) -> list[float]:
        """Ends of intervals: the jump of an ejection gets a short step of its own."""
        short, now = _RECOIL * self._step, self.time
        stops = [now + short] if self._net.recoils(now, now) else []
        for time in self._net.ejections:
            stops += [time - short, time]
        return [*sorted(stop for stop in stops if now < stop and not reached(stop, end)), end]

    def _interval_to(self, end: float) -> None:
        begin = self.time
        number = math.ceil((end - begin) / self._step * (1.0 - 1e-9))
        for k in range(number):
            self._to(end if k + 1 == number else begin + (k + 1) * (end - begin) / number)

    def _to(self, until: float) -> None:
        """Take one macro step, or several shorter ones."""
        while self.time < until:
            stop = self._shortened(min(until, self.time + self._time_to_rotate()))
            while not self._take(stop):
                stop = self.time + 0.5 * (stop - self.time)
                if stop - self.time < _SHORTEST * self._step:
                    raise InputError(
                        f"at t = {self.time:.6g} s net and host do not agree at any macro step (down to "
                        f"{stop - self.time:.3g} s, {self._iterations} iterations). The bodies at the ports "
                        "are too light for the net; simulate both in one system"
                    )

    def _shortened(self, stop: float) -> float:
        """Return the end [s] of a step that is stable with the present stretch of the elements."""
        now, parts = self.time, 1
        while self._given is None and not self._largest.allows((stop - now) / parts):
            parts += 1
        if parts > 1:
            self._ledger.note = (
                f"macro steps cut, last to {(stop - now) / parts:.4g} s at t = {now:.6g} s, the longest for "
                "the ports' masses, and stiffnesses that grow with the stretch"
            )
        return now + (stop - now) / parts if parts > 1 else stop

    def _time_to_rotate(self) -> float:
        """Return the time [s] in which a port of the host nearly reaches the largest rotation of a step."""
        spin = max(math.hypot(*row) for row in self._frames[:, 10:].tolist())
        return _OF_TURN * LARGEST_TURN / spin if spin > 0.0 else math.inf

    def _take(self, until: float) -> bool:
        """Take a macro step; return False, net and host at its begin, if it must be repeated shorter."""
        net, begin, before = self._net, self._net.time, self._frames
        saved: tuple[Snapshot, Any] | None = None
        if self._iterations > 1:
            net.finish()
            self._host.finish()
            saved = net.snapshot(), self._host.snapshot()
        recoils = net.recoils(begin, until)
        target = self._predictor.ahead(begin, until, before)
        if recoils:  # too short to correct the distance of net and host
            target = rows_of(net.frame(name).after(until - begin) for name in net.ports)
        for attempt in range(self._iterations):
            if attempt:
                self._repeat(saved)
            loads = net.follow(until, target) if saved else self._history.step(until, target)
            try:
                found = self._host_step(until, loads, before)
            except BaseException:
                self._undo(saved)
                raise
            if self._iterations == 1 or recoils or self._agree(target, found):
                break
            target = found
        else:
            self._repeat(saved)
            return False
        self._ledger.record(CountedStep(loads, recoils, before, found))
        self._predictor.keep(begin, before, recoils=recoils)
        self._frames = found
        return True

    def _repeat(self, saved: tuple[Snapshot, Any] | None) -> None:
        """Go back for a repeat, and raise InputError if the host has not gone back."""
        self._undo(saved)
        time, moved = self._host_time(), not np.array_equal(self._host_frames(), self._frames)
        if moved or not self._is_same_time(time, self._net.time):
            raise InputError(
                f"Coupler: {self._host_name} was to return to t = {self._net.time:.9g} s by its `restore`, "
                f"and is at {time:.9g} s{'; its bodies are not where they were' if moved else ''}"
            )
        self._ledger.repeated += 1

    def _undo(self, saved: tuple[Snapshot, Any] | None) -> None:
        """Return the net, and the host if its state was saved, to the begin of the step."""
        if saved is None:
            self._history.undo()
        else:
            self._net.restore(saved[0])
            self._host.restore(saved[1])

    def _host_step(self, until: float, loads: PortLoads, before: Floats) -> Floats:
        """Step the host from states (n, 13) to a time [s], and return its states there."""
        net, begin = self._net, loads.begin
        self._host.step(until, loads.of(net.ports))
        if not self._is_same_time(time := self._host_time(), until):
            raise InputError(
                f"Coupler: {self._host_name} stepped from t = {begin:.9g} s to {time:.9g} s instead of "
                f"{until:.9g} s: `step` must end at the given time, with a shorter last step of its own"
            )
        found, times = self._host_frames(f" at t = {until:.6g} s"), (begin, until)
        earlier = self._predictor.earlier(begin, before)
        validate_no_jump(_BODY, net.ports, times, (before, found), earlier, OWN, net.size)
        validate_rotation(_BODY, net.ports, times, port_loops().max_rotation(until - begin, before, found))
        return found

    def _agree(self, target: Floats, found: Floats) -> bool:
        size, ports = self._net.size, self._net.ports
        pairs = zip(frames_of(ports, target).values(), frames_of(ports, found).values(), strict=True)
        return all(distance(*pair, size) <= self._agreement for pair in pairs)

    # Validation of the host

    @property
    def _host_name(self) -> str:
        return f"the host, a {type(self._host).__name__},"

    def _host_time(self) -> float:
        time = finite_number(self._host.time)
        if time is None:
            raise InputError(f"Coupler: {self._host_name} has the time {self._host.time!r}, not a number")
        return time

    def _is_same_time(self, one: float, other: float) -> bool:
        return abs(one - other) <= _OF_STEP * self._step + _ULPS * math.ulp(other)

    def _host_frames(self, when: str = "") -> Floats:
        """Return the states (n, 13) of the host's bodies at the ports."""
        found: Any = self._host.frames()
        if not isinstance(found, Mapping):
            raise InputError(
                f"Coupler: {self._host_name} must return a FrameState by the name of each port from "
                f"`frames`, got {type(found).__name__}"
            )
        if missing := [name for name in self._net.ports if name not in found]:
            raise InputError(f"{_BODY} {', '.join(missing)} is missing{when}")
        return rows_of(FrameState.of(found[name], f"{_BODY} {name}{when}") for name in self._net.ports)

    def _shared(self) -> tuple[tuple[str, ...], ...]:
        """Return the groups of the net's ports that are one body of the host."""
        found: Any = self._host.shared()
        groups: list[Any] = list(found) if isinstance(found, Sequence) else [None]
        if any(isinstance(group, str) or not isinstance(group, Sequence) for group in groups):
            raise InputError(
                f"Coupler: {self._host_name} must return groups of ports that are one body from `shared`, "
                f"got {found!r}"
            )
        return tuple(tuple(name for name in group if name in self._net.ports) for group in groups)

    def _validate_times(self) -> None:
        if not self._is_same_time(time := self._host_time(), self._net.time):
            raise InputError(
                f"Coupler: the host is at t = {time:.9g} s, the net at {self._net.time:.9g} s: restore both "
                "by a snapshot of the Coupler, or make a new one with both at the start"
            )

    def _validate_unchanged(self) -> None:
        """Raise InputError unless net and host are where the coupling left them; the net's attitudes nearly.

        A command to the net computes its ports anew, which changes attitudes by round-off.
        """
        self._validate_times()
        net, now, left = self._net, self._net.state_vector(), self._left
        exact = len(left) - net.simulation.moving.bodies.attitude.size
        same = self._left_at == net.time and np.array_equal(left[:exact], now[:exact])
        same = same and np.allclose(left[exact:], now[exact:], rtol=0.0, atol=_ROUND_OFF)
        if not same or not np.array_equal(self._host_frames(), self._frames):
            raise InputError(
                f"Coupler: at t = {net.time:.9g} s the {'host' if same else 'net'} is not where the coupling "
                "left it: restore net and host by a snapshot of the Coupler, or make a new one with both at "
                "the start"
            )


def _words(arguments: Floats) -> str:
    """Arguments in force; `step` may have been cut."""
    step, iterations, agreement = arguments.tolist()
    return f"step={step!r}, iterations={int(iterations)}, agreement={agreement!r}"


def _positive(name: str, given: object) -> float:
    number = finite_number(given)
    if number is None or not number > 0.0:
        raise InputError(f"Coupler: {name} must be positive and finite, got {given!r}")
    return number

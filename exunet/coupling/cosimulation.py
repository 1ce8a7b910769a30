"""A net and a host that can be set back, coupled with or without repeating a step until both agree."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import finite_number, whole_number
from exunet.base.errors import InputError, RunStopped
from exunet.bodies.port import FrameState, difference, frames_of, rows_of, turned
from exunet.coupling.host import (
    Host,
    refuse_no_host,
    refuse_not_back,
    refuse_other_end,
    same_time,
    shared_by,
    time_of,
    told_frames,
)
from exunet.coupling.ledger import Books, Ended
from exunet.coupling.net_system import NetSystem, PortLoad, PortLoads
from exunet.coupling.ports import LARGEST_TURN, apart, most_turned, refuse_apart, refuse_turn
from exunet.coupling.prediction import CONTRACTING, STABLE, LongestStep, Predictor
from exunet.coupling.rollback import CoupledSnapshot, NetAsLeft, Undo, refuse_none
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]

_SHORTEST = 1e-3  # of the step asked for: a macro step below it means that no step will do
_RECOIL = 1e-6  # of a macro step, over which a throw at the start recoils
_OF_TURN = 0.9  # of the largest turn in a step, since the body may come to turn faster in it
_BODY = "Cosimulation: the host's body at port"  # begins the words of what is wrong with one
_SAFETY, _MOST_GROWTH, _MOST_SHRINK = 0.9, 2.0, 0.2


class Cosimulation:
    """Co-simulation of a net and a host.

        both = Cosimulation(net, host, step=0.01, iterations=20)
        both.advance_to(2.0)
        print(both.books)

    step       : macro step [s]; its maximum where it follows the energy. Steps beyond the largest stable step
                 (`longest`) are divided into equal parts, which the balance records, and so are steps in
                 which a port would turn by more than 1 rad
    iterations : 1: each step once, with the motion of the ports predicted by `exunet.coupling.prediction`.
                 More: maximum number of repeats until the host ends at the motion that the net has used.
                 Both are of second order with hosts that apply the whole impulses
    agreement  : admissible difference of both, as a fraction of the net's size, and in radians
    energy     : admissible energy error of a step [J]: the work of the loads between the motion that the net
                 has used and that of the host, which the next step corrects. The macro step follows it.
                 None: equal steps
    longest    : longest macro step [s]; None: the largest stable step
    Raises InputError for invalid arguments, and if ports and the host's bodies start at different poses.

    `snapshot` and `restore` store and restore net, host and coupling together, to the last bit. A net or a
    host that was restored separately is refused.

    A host that fails, ends its step at another time, goes back in time or returns invalid states leaves the
    balance and the net as they were before the step, and the host too where steps are repeated. If the host
    has advanced, `advance_to` is refused.
    """

    def __init__(
        self,
        net: NetSystem,
        host: Host,
        *,
        step: float,
        iterations: int = 1,
        agreement: float = 1e-9,
        energy: float | None = None,
        longest: float | None = None,
    ) -> None:
        refuse_no_host(net, host)
        self._net, self._host = net, host
        self._step = _positive("step", step)
        self._agreement = _positive("agreement", agreement)
        self._energy = None if energy is None else _positive("energy", energy)
        number = whole_number(iterations)
        if number is None or number < 1:
            raise InputError(f"Cosimulation: iterations: a number of 1 or more, got {iterations!r}")
        self._iterations = number
        if not net.ports:
            raise InputError('Cosimulation: the net has no port: give a body of its case motion = "port"')
        self._largest = LongestStep(net, STABLE if number == 1 else CONTRACTING, shared_by(host, net.ports))
        self._given = None if longest is None else _positive("longest", longest)
        self.longest = self._given or self._largest.now
        self._books = Books.of(net)
        if self._step > self.longest:
            of = "as given" if self._given else "the longest for the ports' masses, stiffnesses and turns"
            self._books.cut = f"macro steps of {self._step:.4g} s cut to {self.longest:.4g} s, {of}"
        self._step = min(self._step, self.longest)
        self._next = self._step
        self._predictor, self._undo = Predictor(), Undo(net)
        self._refuse_other_times()
        self._found = self._of_host()
        for name, state in self._found.items():
            refuse_apart("Cosimulation", name, net.frame(name), state, net.size)
        self._left = NetAsLeft.of(net)

    @property
    def books(self) -> Books:
        """What went through the ports so far; `print` shows a table."""
        return self._books.looked_at(self._net)

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._net.time

    def advance_to(self, until: float) -> None:
        """Advance to a time [s] by macro steps of one length, or of a length that follows the energy.

        Raises InputError if the host does not reach the motion of the net within the iterations, at any
        macro step; RunStopped by the guards of the net or the host.
        """
        end = finite_number(until)
        if end is None or not end > self.time:
            raise InputError(
                f"advance_to: must be later than the time reached, {self.time:g} s, got {until!r}"
            )
        self._refuse_other_times()
        self._refuse_set_back()
        try:
            for stop in self._stops(end):
                self._stretch_to(stop)
        except RunStopped as stop:
            if self.time < (booked := time_of(self._host)):
                self._books.net_is_behind(booked, self.time, str(stop))
            raise
        finally:
            self._left = NetAsLeft.of(self._net)

    def snapshot(self) -> CoupledSnapshot:
        """Net, host, and all that the coupling remembers; in memory, or in a file by its `save`."""
        self._refuse_other_times()
        self._refuse_set_back()
        self._net.finish()
        self._host.finish()
        parts = self._net.snapshot(), self._host.snapshot()
        return CoupledSnapshot("Cosimulation", self._net.ports, *parts, self._memory())

    def restore(self, snapshot: CoupledSnapshot) -> None:
        """Go back, or on, to a snapshot of net and host of the same cases, coupled with the same arguments.

        What follows is the same to the last bit. Raises InputError for another coupling, net or host; net and
        coupling are then as they were.
        """
        given = refuse_none("Cosimulation", snapshot)
        given.refuse_other("Cosimulation", self._net, self._memory())
        self._refuse_others_arguments(given)
        self._net.finish()
        here = self._net.snapshot()
        self._net.restore(given.net)
        try:
            self._host.restore(given.host)
        except BaseException:
            self._net.restore(here)
            raise
        memory = given.memory
        self._predictor = Predictor.of_numbers(memory["before"])
        self._next = min(float(memory["next"][0]), self._step)
        self._books = self._books.with_numbers(memory["books"])
        self._undo = Undo(self._net)
        self._found, self._left = self._of_host(), NetAsLeft.of(self._net)

    def _memory(self) -> dict[str, Floats]:
        return {
            "before": self._predictor.numbers(),
            "next": np.array([self._next]),
            "books": self._books.numbers(),
            "arguments": np.array([self._step, self._iterations, self._agreement, self._energy or np.inf]),
        }

    def _refuse_others_arguments(self, given: CoupledSnapshot) -> None:
        own = self._memory()["arguments"]
        if not np.array_equal(given.memory["arguments"], own):
            raise InputError(
                f"Cosimulation: restore: the snapshot of t = {given.time:g} s is of one with "
                f"{_told(given.memory['arguments'])}; this one has {_told(own)}"
            )

    def _refuse_other_times(self) -> None:
        if not same_time(time := time_of(self._host), self._net.time, self._step):
            raise InputError(
                f"Cosimulation: the host is at t = {time:.9g} s, the net at "
                f"{self._net.time:.9g} s: restore both by a snapshot of the Cosimulation, or begin anew with "
                "both at the start"
            )

    def _refuse_set_back(self) -> None:
        """The coupling goes on from where it has left net and host; it remembers steps before that."""
        if not self._left.is_of(self._net) or self._of_host() != self._found:
            raise InputError(
                f"Cosimulation: at t = {self._net.time:.9g} s net or host are not where the coupling left "
                "them: set both back by its own snapshot and restore, since it remembers the steps before, "
                "or begin anew with both at the start"
            )

    def _stops(self, end: float) -> list[float]:
        """Where stretches end: a throw of the net is a jump, which a short step to itself contains."""
        short, now = _RECOIL * self._step, self.time
        stops = [now + short] if self._net.recoils(now, now) else []
        for time in self._net.ejections:
            stops += [time - short, time]
        return [*sorted(stop for stop in stops if now < stop < end), end]

    def _stretch_to(self, end: float) -> None:
        begin = self.time
        if self._energy is None and self._next == self._step:
            number = math.ceil((end - begin) / self._step * (1.0 - 1e-9))
            for k in range(number):
                self._to(end if k + 1 == number else begin + (k + 1) * (end - begin) / number)
        while self.time < end:
            left = end - self.time
            self._to(end if left <= 1.0000001 * self._next else self.time + min(self._next, 0.5 * left))

    def _to(self, until: float) -> None:
        """One macro step, or several shorter ones where one does not do."""
        while self.time < until:
            stop, wanted = min(until, self.time + self._until_turned()), self._next
            if self._energy is not None and stop - self.time > wanted:
                stop = self.time + wanted
            stop = self._not_too_long(stop)
            while not self._tried(stop):
                stop = self.time + 0.5 * (stop - self.time)
                if stop - self.time < _SHORTEST * self._step:
                    raise InputError(
                        f"at t = {self.time:.6g} s the host does not end where the net is told, however "
                        f"short the macro step (down to {stop - self.time:.3g} s, {self._iterations} "
                        "iterations). The bodies at the ports are too light for the net; simulate both "
                        "in one system"
                    )

    def _not_too_long(self, stop: float) -> float:
        """The end [s] of a step that is stable with the stretch that elements have; the books tell a cut."""
        now, parts = self.time, 1
        while self._given is None and not self._largest.allows((stop - now) / parts):
            parts += 1
        if parts > 1:
            self._books.cut = (
                f"macro steps cut, last to {(stop - now) / parts:.4g} s at t = {now:.6g} s, the longest for "
                "the ports' masses, and stiffnesses that grow with the stretch"
            )
        return now + (stop - now) / parts if parts > 1 else stop

    def _until_turned(self) -> float:
        """How long [s] until a port of the host has turned by nearly as much as it may in a step."""
        spin = max(math.hypot(*state.angular_velocity) for state in self._found.values())
        return _OF_TURN * LARGEST_TURN / spin if spin > 0.0 else math.inf

    def _tried(self, until: float) -> bool:
        """Take a macro step; False if it is to be repeated with a shorter one, both being where they were."""
        net, host = self._net, self._host
        kept: tuple[Snapshot, Any] | None = None
        if self._iterations > 1 or self._energy is not None:
            net.finish()
            host.finish()
            kept = net.snapshot(), host.snapshot()
        begin, before = net.time, rows_of(self._found.values())
        recoils = net.recoils(begin, until)
        told = self._predictor.told(begin, until, before)
        if recoils:  # too short to make good how far the net is from the host
            told = rows_of(net.frame(name).after(until - begin) for name in net.ports)
        for attempt in range(self._iterations):
            if attempt:
                self._again(kept)
            loads = net.follow(until, told) if kept else self._undo.step(until, told)
            try:
                host.step(until, loads.of(net.ports))
                refuse_other_end(host, begin, until, self._step)
                found = self._read(before, (begin, until))
            except BaseException:
                if kept:
                    self._back(kept)
                else:
                    self._undo.back()
                raise
            if self._iterations == 1 or recoils or self._agree(told, found):
                break
            told = rows_of(found.values())
        else:
            self._again(kept)
            return False
        if self._energy is not None and not recoils and not self._is_good(loads, told, found, until - begin):
            self._again(kept)
            return False
        self._books.add([Ended(loads, loads.wrenches, recoils, before, rows_of(found.values()))])
        self._found = found
        if recoils:
            self._predictor.forget()
        else:
            self._predictor.keep(begin, before)
        return True

    def _again(self, kept: tuple[Snapshot, Any] | None) -> None:
        """The step is to be repeated."""
        self._back(kept)
        refuse_not_back(self._host, self._net.time, self._step, moved=self._of_host() != self._found)
        self._books.repeated += 1

    def _back(self, kept: tuple[Snapshot, Any] | None) -> None:
        """Net and host are where they were before the step."""
        assert kept is not None
        self._net.restore(kept[0])
        self._host.restore(kept[1])

    def _read(self, before: Floats, times: tuple[float, float]) -> dict[str, FrameState]:
        """Where the host's bodies are at the end of a step between two times [s], unless no body can be.

        before : (n, 13) where they were
        """
        told, net = told_frames(self._host), self._net
        found = {}
        for name in net.ports:
            who = f"{_BODY} {name}"
            if name not in told:
                raise InputError(f"{who} is not there at t = {net.time:.6g} s")
            found[name] = FrameState.of(told[name], f"{who} at t = {net.time:.6g} s")
        states = before, rows_of(found.values())
        self._predictor.refuse_jump(_BODY, net.ports, times, states, net.size)
        refuse_turn(_BODY, net.ports, times, most_turned(times, states))
        return found

    def _is_good(
        self,
        loads: PortLoads,
        told: Floats,
        found: Mapping[str, FrameState],
        duration: float,
    ) -> bool:
        """True if the step leaves no more energy open than it may; the length of the next follows."""
        assert self._energy is not None
        ports = self._net.ports
        by_port = zip(loads.of(ports).values(), frames_of(ports, told).values(), found.values(), strict=True)
        left = sum(abs(_work_between(*item)) for item in by_port)
        ratio = left / self._energy
        change = _SAFETY / math.sqrt(max(ratio, 1e-12))  # the work goes with the square of the step
        self._next = min(self._step, duration * min(_MOST_GROWTH, max(_MOST_SHRINK, change)))
        return ratio <= 1.0

    def _agree(self, told: Floats, found: Mapping[str, FrameState]) -> bool:
        size, ends = self._net.size, frames_of(self._net.ports, told)
        return all(apart(ends[name], found[name], size) <= self._agreement for name in ends)

    def _of_host(self) -> dict[str, FrameState]:
        """The states of the host's bodies at the ports now."""
        found = told_frames(self._host)
        if missing := [name for name in self._net.ports if name not in found]:
            raise InputError(f"Cosimulation: the host has no body for port {', '.join(missing)}")
        return {name: FrameState.of(found[name], f"{_BODY} {name}") for name in self._net.ports}


def _work_between(load: PortLoad, one: FrameState, other: FrameState) -> float:
    """Work [J] of a load from one place and attitude to another at the same time."""
    turn = turned(one.attitude, difference(one.attitude, other.attitude))
    return float(load.force @ np.subtract(other.position, one.position) + load.torque @ np.array(turn))


def _told(arguments: Floats) -> str:
    """In words, as they are in force: `step` may have been cut."""
    step, iterations, agreement, energy = arguments.tolist()
    words = f"step={step!r}, iterations={int(iterations)}, agreement={agreement!r}"  # as far as they differ
    return f"{words}, energy={energy!r}" if energy < math.inf else words


def _positive(name: str, given: object) -> float:
    number = finite_number(given)
    if number is None or not number > 0.0:
        raise InputError(f"Cosimulation: {name} must be positive and finite, got {given!r}")
    return number

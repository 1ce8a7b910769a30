"""The events of a run: switching functions, evaluated at accepted steps, and changes of discrete states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import cast

import numpy as np

from exunet.base.arrays import Floats
from exunet.forces.blocks import ACTIVE
from exunet.forces.terms import Change, Seen, Switch, Watch
from exunet.integrators.protocol import Stepper
from exunet.model.energy import total
from exunet.model.system import System


def discrete_states_of(name: str, change: Change) -> dict[str, Floats]:
    """Discrete states that an event of the term with this one changes."""
    active = {} if change.active is None else {ACTIVE: change.active}
    return {**change.others, name: change.discrete, **active}


class Events:
    """The switches of a scene's terms, which look at the state and the discrete states of a stepper.

    any : True if there are any
    """

    def __init__(self, system: System, stepper: Stepper) -> None:
        self._system, self._stepper = system, stepper
        self._switches: list[tuple[str, Switch]] = []
        self._sees: dict[str, tuple[str, ...]] = {}
        self._watch: Watch | None = None
        self._script = ""  # its discrete state
        self._reported: tuple[tuple[str, int], ...] = ()
        for term, switch in system.forces.switches:
            assert term.discrete is not None
            self._switches.append((term.discrete.name, switch))
            inputs = term.inputs if switch.sees_inputs else ()
            self._sees[term.discrete.name] = tuple(item.name for item in inputs)
            if term is system.forces.script:
                self._script, self._watch = term.discrete.name, cast("Watch", switch)
                self._sees[self._script], self._reported = self._watch.sees, self._watch.reports
        self.any, self._knots = bool(self._switches), system.kinematics.knots

    @property
    def discrete(self) -> dict[str, Floats]:
        """The discrete states now."""
        return self._stepper.discrete

    def _seen(self, name: str) -> Floats:
        """The discrete state of a term, followed by what its switch sees of inputs and states, and by the
        numbers that it observes.
        """
        discrete = self.discrete
        own, others = discrete[name], self._sees[name]
        reported = self._reported if name == self._script else ()
        if not others and not reported:
            return own
        numbers = [discrete[one][place] for one, place in reported]
        return np.concatenate([own, *(discrete[other] for other in others), numbers])

    @property
    def stopped(self) -> bool:
        """True if the run has been ended."""
        return self._watch is not None and self._watch.stops(self.discrete[self._script])

    def is_due(self, time: float) -> bool:
        """True at the start of a run in which something is planned for then."""
        return min(self._planned, default=np.inf) <= time

    @property
    def _planned(self) -> Iterator[float]:
        """The instants that switches have planned."""
        discrete = self.discrete
        return chain.from_iterable(switch.instants(discrete[name]) for name, switch in self._switches)

    @property
    def watches(self) -> bool:
        """True while conditions are watched, whose crossings are to be located in steps."""
        return self._watch is not None and self._watch.in_steps(self.discrete[self._script])

    def now(self) -> Seen:
        """The state reached, as what watches gets it."""
        discrete = self._seen(self._script)
        x, v = self._stepper.flat()
        reported = discrete[None, len(discrete) - len(self._reported) :]
        return Seen(np.array([self._stepper.time]), x[None].copy(), v[None].copy(), discrete, reported)

    def comes_true(self, steps: Seen) -> int | None:
        """See `Watch.comes_true`; accepted steps in which no condition does are remembered."""
        assert self._watch is not None
        steps = steps._replace(discrete=self._seen(self._script))
        first = self._watch.comes_true(steps)
        if first is None:
            self._remember(self._watch, steps)
        return first

    def crossing(self, begin: Seen) -> float | None:
        """See `Watch.crossing`, of the steps since a state, which are remembered unless they are repeated."""
        assert self._watch is not None
        now = self.now()
        target = self._watch.crossing(begin, now)
        if target is None or not target < self._stepper.time:
            self._remember(self._watch, now)
        return target

    def _remember(self, watch: Watch, steps: Seen) -> None:
        after = watch.remembered(steps)
        if after is not None:
            self.discrete[self._script] = after

    @property
    def kept(self) -> dict[str, Floats]:
        """Copies of the discrete states that change at the end of steps, with an event or without."""
        kept = self._stepper.kept
        if self._watch is not None:
            kept[self._script] = self.discrete[self._script].copy()
        return kept

    def _at_rest(self, change: Change, v: Floats) -> Change:
        """Set the velocities of the points that become inactive to zero."""
        if change.active is None:
            return change
        if ACTIVE not in self.discrete:
            raise ValueError(
                "an event activates points of a system in which all are active: give Blocks.active"
            )
        speed = (v if change.v is None else change.v).copy()
        speed[: 3 * len(change.active)] *= np.repeat(change.active, 3)
        return replace(change, v=speed)

    def _booked(self, change: Change, name: str, time: float, x: Floats, v: Floats) -> Change:
        """Add the energy that is lost, if that is the change of the energy of the system."""
        if change.energy_lost is not None:
            return change
        after = x if change.x is None else change.x, v if change.v is None else change.v
        discrete = self.discrete
        before = total(self._system, time, x, v, discrete)
        lost = before - total(self._system, time, *after, discrete | discrete_states_of(name, change))
        first = self._system.blocks.n_x - self._system.blocks.n_states
        given = float(self._system.given_work(after[0][first:] - x[first:]))
        own = lost + given  # what a prescribed body gives with the event is in its own balance
        change = replace(change, energy_lost=own, work_given=given)
        if len(change.events) != 1:
            return change
        return replace(change, events=(replace(change.events[0], energy_lost_J=own),))

    def next_instant(self, after: float, until: float) -> float:
        """The first known instant [s] of an event or of a knot of a motion after `after`, or `until`."""
        every: Iterable[float] = self._knots
        if self.any:
            times = (time for _, switch in self._switches for time in switch.times)
            every = chain(times, self._planned, every)
        return min((time for time in every if after < time < until), default=until)

    def shortened(self, step: float, least: float) -> float:
        """A step [s] that ends near what would happen next; see `Switch.step_within`."""
        if not any(switch.in_steps(self._seen(name)) for name, switch in self._switches):
            return step
        x, v = self._stepper.flat()
        for name, switch in self._switches:
            step = switch.step_within(step, least, x, v, self._seen(name))
        return step

    def happen(self) -> bool:
        """True if something is due at the end of the last step."""
        (x, v), time = self._stepper.flat(), self._stepper.time
        return any(len(switch.crossed(time, x, v, self._seen(name))) for name, switch in self._switches)

    def at(self, time: float, x: Floats, v: Floats) -> Iterator[tuple[str, Change]]:
        """Yield the changes at the end of an accepted step; the caller lets each act before the next.

        Terms come in their order, the constraint last; a switch is asked again at once if its change says so,
        and those before the script whose discrete states it has changed once it is done.

        x, v : changed by the caller after each event, so that the next one acts on the new state
        """
        for k, (name, switch) in enumerate(self._switches):
            others = set[str]()
            for change in self._of(name, switch, time, x, v):
                others.update(change.others)
                yield name, change
            if self.stopped:
                return
            for before, one in self._switches[:k]:
                if before in others:
                    yield from ((before, change) for change in self._of(before, one, time, x, v))

    def _of(self, name: str, switch: Switch, time: float, x: Floats, v: Floats) -> Iterator[Change]:
        """Yield the changes of one switch, with the energy that they lose."""
        more = True
        while more and not self.stopped and len(items := switch.crossed(time, x, v, self._seen(name))):
            change = switch.change(time, x, v, self._seen(name), items, self.discrete)
            change = self._booked(self._at_rest(change, v), name, time, x, v)
            yield change
            more = change.more

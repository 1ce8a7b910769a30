"""The ledger of energy over the steps of a run, and the guards that stop a run which has gone wrong."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet import cable, energy
from exunet.diagnosis import LOAD_ADVICE, state_of_worst, step_advice
from exunet.effects.terms import Terms
from exunet.errors import RunStopped
from exunet.guards import Guards
from exunet.net.arrays import Net
from exunet.peaks import Peaks
from exunet.solvers import Plan

Floats = NDArray[np.float64]

# The guards look at one state in so many; where they find one wrong, they look at those before it too.
STATES_A_LOOK = 32


class Monitor:
    """Takes the states of the accepted steps; sums the dissipated energy and stops what has gone wrong.

    The work of the terms that have no potential is integrated by Simpson's rule between two states; the state
    in the middle is that of the cubic Hermite polynomial through both ends, (x0 + x1)/2 + h (v0 - v1)/8 and
    3/2 (x1 - x0)/h - (v0 + v1)/4, so the sum is of fourth order in the step.

    every : the guards look at one state in so many, and at the last of each batch
    ledger: times (k,) [s] of the last batch, and the energy (k,) [J] dissipated until then
    """

    def __init__(
        self,
        net: Net,
        terms: Terms,
        position: Floats,
        velocity: Floats,
        every: int = STATES_A_LOOK,
    ) -> None:
        self._net = net
        self._terms = terms
        self._plan: Plan | None = None
        self._every = every
        self._guards = Guards(net, terms, position, velocity)
        self.dissipated = 0.0
        self._last_good = (0.0, position, velocity)
        self.peaks = Peaks()
        self.ledger = (np.zeros(1), np.zeros(1))

    @property
    def good_until(self) -> float:
        """Time [s] of the last state that had nothing wrong with it."""
        return self._last_good[0]

    def off_by(self, motion: Floats, potential: Floats, dissipated: Floats) -> Floats:
        """See `Guards.off_by`."""
        return self._guards.off_by(motion, potential, dissipated)

    def explain(self, plan: Plan) -> None:
        """Tell how the run is integrated, for the words of the guards."""
        self._plan = plan

    def engine_failed(self, failure: Exception, *, step_cause: bool) -> RunStopped:
        """The error for an engine that gave up, with its words."""
        words = f"the engine stopped after t = {self.good_until:.6g} s: {failure}"
        if step_cause:
            worst = state_of_worst(self._net, self._terms, *self._last_good)
            words += f"; {worst}. {step_advice(self._plan)}"
        return RunStopped(words, step_cause=step_cause)

    def go_back(self, time: float, position: Floats, velocity: Floats, dissipated: float) -> None:
        """Take up from an earlier state, whose dissipated energy [J] is given."""
        self.dissipated = dissipated
        self.ledger = (np.array([time]), np.array([dissipated]))
        self._last_good = (time, position, velocity)
        self.peaks.forget_after(time)

    def __call__(self, time: Floats, position: Floats, velocity: Floats, taken: Floats | None = None) -> None:
        """Take a batch of states: time (k,), position and velocity (k, n_nodes, 3), first one known.

        taken : (k,) energy [J] that the integration itself says was taken out so far; None: summed here
        Raises RunStopped, with the `step_cause` that a smaller step may mend or not.
        """
        with np.errstate(all="ignore"):  # numbers that overflow are what the guards look for
            work = self._dissipation(time, position, velocity) if taken is None else np.diff(taken)
            dissipated = np.concatenate([[self.dissipated], self.dissipated + np.cumsum(work)])
            self.ledger = (time, dissipated)
            every = np.append(np.arange(self._every, len(time) - 1, self._every), len(time) - 1)
            look = self._guards.look(self._terms, position[every], velocity[every], dissipated[every])
            if look.wrong.any():
                self._stop(time, position, velocity, dissipated)
            self._guards.accept(look, -1)
            self._last_good = (float(time[-1]), position[-1], velocity[-1])
            self.peaks.look(time, self._tension(position, velocity))
        self.dissipated = float(dissipated[-1])

    def lose(self, energy_lost: float, terms: Terms) -> None:
        """Book elastic energy [J] that elements took along when they broke; `terms` hold from now on."""
        self.dissipated += energy_lost
        self._terms = terms

    def _dissipation(self, time: Floats, position: Floats, velocity: Floats) -> Floats:
        """(k - 1,) energy taken out by terms without a potential in each step [J]."""
        if not self._terms.dissipates:
            return np.zeros(len(time) - 1)
        return energy.work_taken(self._net, self._terms, time, position, velocity)

    def _tension(self, position: Floats, velocity: Floats) -> Floats:
        tension = cable.element_tension(self._net, self._terms.law(self._net), position, velocity)
        return tension if self._terms.intact is None else tension * self._terms.intact

    def _stop(self, time: Floats, position: Floats, velocity: Floats, dissipated: Floats) -> NoReturn:
        """Find the first state of a batch that is wrong, and say so."""
        look = self._guards.look(self._terms, position, velocity, dissipated)
        bad = int(np.argmax(look.wrong))
        if bad:
            self._guards.accept(look, bad - 1)
            self._last_good = (float(time[bad - 1]), position[bad - 1], velocity[bad - 1])
        shown = (float(time[bad]), position[bad], velocity[bad]) if look.finite[bad] else self._last_good
        advice = step_advice(self._plan) if look.of_steps(bad) else LOAD_ADVICE
        raise RunStopped(
            f"diverged at t = {time[bad]:.6g} s: {look.words(bad)}; "
            f"{state_of_worst(self._net, self._terms, *shown)}. {advice}",
            step_cause=look.of_steps(bad),
        )

    def review(self, time: Floats, position: Floats, velocity: Floats, off: Floats) -> RunStopped | None:
        """What is wrong with the energy of the stored states of a finished run; off (k,): of `off_by`.

        Between two looks of the guards, the energy of a method near its stable step may swing out and back.
        """
        if np.all(off <= 1.0):
            return None
        bad = int(np.argmax(off > 1.0))
        good = max(0, bad - 1)
        self._last_good = (float(time[good]), position[good], velocity[good])
        worst = state_of_worst(self._net, self._terms, float(time[bad]), position[bad], velocity[bad])
        return RunStopped(
            f"diverged at t = {time[bad]:.6g} s: the energy of this state is off by {off[bad]:.3g} times "
            f"what is allowed; {worst}. {step_advice(self._plan)}",
            step_cause=True,
        )

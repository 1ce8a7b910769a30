"""The ledger of energy over the steps of a run, and the guards that stop a run which has gone wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import RunStopped
from exunet.forces import cable
from exunet.forces.terms import Terms
from exunet.methods.plan import Plan
from exunet.net.arrays import Net
from exunet.simulation.diagnosis import COLLAPSE_ADVICE, LOAD_ADVICE, state_of_worst, step_advice
from exunet.simulation.envelope import Envelope
from exunet.simulation.guards import OF_STEPS, STRETCH_BOUND, Guards
from exunet.simulation.peaks import Peaks
from exunet.system import energy

if TYPE_CHECKING:
    from exunet.results.result import Result

Floats = NDArray[np.float64]

# The guards look at one state in so many; where they find one wrong, they look at those before it too.
STATES_A_LOOK = 32


class Monitor:
    """Takes the states of the accepted steps; sums the dissipated energy and stops what has gone wrong.

    The work of the terms that have no potential is integrated by Simpson's rule between two states; the state
    in the middle is that of the cubic Hermite polynomial through both ends, (x0 + x1)/2 + h (v0 - v1)/8 and
    3/2 (x1 - x0)/h - (v0 + v1)/4, so the sum is of fourth order in the step.

    every : the guards look at one state in so many, and at the last of each batch
    envelope : takes the energies of all good states
    ledger: times (k,) [s] of the last batch, and the energy (k,) [J] dissipated until then
    """

    def __init__(
        self,
        net: Net,
        terms: Terms,
        position: Floats,
        velocity: Floats,
        every: int = STATES_A_LOOK,
        envelope: Envelope | None = None,
    ) -> None:
        self._net = net
        self._use(terms)
        self._plan: Plan | None = None
        self._every = every
        self._guards = Guards(net, terms, position, velocity)
        self.dissipated = 0.0
        self._last_good = (0.0, position, velocity)
        self.peaks = Peaks()
        self._envelope = envelope
        self.ledger = (np.zeros(1), np.zeros(1))

    @property
    def good_until(self) -> float:
        """Time [s] of the last state that had nothing wrong with it."""
        return self._last_good[0]

    def explain(self, plan: Plan) -> None:
        """Tell how the run is integrated, for the words of the guards."""
        self._plan = plan

    def engine_failed(self, failure: Exception, *, step_cause: bool) -> RunStopped:
        """The error for an engine that gave up, with its words and the last good state."""
        worst = state_of_worst(self._net, self._terms, *self._last_good)
        advice = step_advice(self._plan) if step_cause else COLLAPSE_ADVICE
        words = f"the engine stopped after t = {self.good_until:.6g} s: {failure}; {worst}. {advice}"
        return RunStopped(words, step_cause=step_cause)

    def go_back(self, time: float, position: Floats, velocity: Floats, dissipated: float) -> None:
        """Take up from an earlier state, whose dissipated energy [J] is given."""
        self.dissipated = dissipated
        self.ledger = (np.array([time]), np.array([dissipated]))
        self._last_good = (time, position, velocity)
        self.forget_after(time)

    def forget_after(self, time: float) -> None:
        """Drop the largest values after the stored time [s] at which a run ends, or goes on."""
        self.peaks.forget_after(time)
        if self._envelope is not None:
            self._envelope.forget_after(time)

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
            length = cable.lengths(self._net, position)
            # The longest element is looked for in every state: its peak may last for one of them.
            if look.wrong.any() or (length > self._longest).any():
                self._stop(time, position, velocity, dissipated)
            self._guards.accept(look, -1)
            self._last_good = (float(time[-1]), position[-1], velocity[-1])
            self._note(time, length, position, velocity)
        self.dissipated = float(dissipated[-1])

    def lose(self, energy_lost: float, terms: Terms) -> None:
        """Book elastic energy [J] that elements took along when they broke; `terms` hold from now on."""
        self.dissipated += energy_lost
        self._use(terms)

    def _use(self, terms: Terms) -> None:
        self._terms = terms
        longest = STRETCH_BOUND * terms.law(self._net).natural_length
        self._longest = longest if terms.intact is None else np.where(terms.intact, longest, np.inf)

    def _dissipation(self, time: Floats, position: Floats, velocity: Floats) -> Floats:
        """(k - 1,) energy taken out by terms without a potential in each step [J]."""
        if not self._terms.dissipates:
            return np.zeros(len(time) - 1)
        return energy.work_taken(self._net, self._terms, time, position, velocity)

    def _note(self, time: Floats, length: Floats, position: Floats, velocity: Floats) -> None:
        """Take the largest values of states that are good; length (k, n_elements) [m]."""
        law = self._terms.law(self._net)  # what broke has no stiffness in it
        self.peaks.look(time, cable.element_tension(self._net, law, position, velocity, length))
        if self._envelope is not None:
            elastic = cable.elastic_energy(law, length)
            self._envelope.look(time, elastic, energy.kinetic(self._net, velocity))

    def _stop(self, time: Floats, position: Floats, velocity: Floats, dissipated: Floats) -> NoReturn:
        """Find the first state of a batch that is wrong, and say so."""
        look = self._guards.look(self._terms, position, velocity, dissipated)
        bad = int(np.argmax(look.wrong))
        if bad:
            self._guards.accept(look, bad - 1)
            self._last_good = (float(time[bad - 1]), position[bad - 1], velocity[bad - 1])
            self._note(time[:bad], cable.lengths(self._net, position[:bad]), position[:bad], velocity[:bad])
        shown = (float(time[bad]), position[bad], velocity[bad]) if look.finite[bad] else self._last_good
        advice = step_advice(self._plan) if look.of_steps(bad) else LOAD_ADVICE
        raise RunStopped(
            f"diverged at t = {time[bad]:.6g} s: {look.words(bad)}; "
            f"{state_of_worst(self._net, self._terms, *shown)}. {advice}",
            step_cause=look.of_steps(bad),
        )

    def review(self, states: Result, off: Floats) -> RunStopped | None:
        """What is wrong with the stored states of a finished run; off (k,): see `guards.off_by`.

        Between two looks of the guards, the energy of a method near its stable step may swing out and back,
        and a compiled loop hands over only some of its states.
        """
        if off.max() <= 1.0 and not self._guards.may_be_wrong(self._terms, states.strain, states.velocity):
            return None
        look = self._guards.look(self._terms, states.position, states.velocity, states.dissipated)
        wrong = (off > 1.0) | (look.stretch > STRETCH_BOUND) | (look.speed > look.allowed_speed)
        if not wrong.any():
            return None
        bad = int(np.argmax(wrong))
        good = max(0, bad - 1)
        when, position, velocity = states.time, states.position, states.velocity
        self._last_good = (float(when[good]), position[good], velocity[good])
        words = f"the energy of this state is off by {off[bad]:.3g} times what is allowed"
        if off[bad] <= 1.0:
            words = look.words(bad)
        of_steps = bool(off[bad] > OF_STEPS)
        worst = state_of_worst(self._net, self._terms, float(when[bad]), position[bad], velocity[bad])
        return RunStopped(
            f"diverged at t = {when[bad]:.6g} s: {words}; {worst}. "
            f"{step_advice(self._plan) if of_steps else LOAD_ADVICE}",
            step_cause=of_steps,
        )

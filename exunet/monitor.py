"""The ledger of energy over the steps of a run, and the guards that stop a run which has gone wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet import cable, energy
from exunet.diagnosis import LOAD_ADVICE, state_of_worst, step_advice
from exunet.effects.terms import Terms
from exunet.errors import RunStopped
from exunet.net.arrays import Net
from exunet.peaks import Peaks
from exunet.solvers import Plan

Floats = NDArray[np.float64]

# The balance kinetic + elastic + potential + dissipated energy may leave its start by this part of the energy
# in play before a run is stopped, up or down: a method that swallows energy lies as much as one that makes it
# (RK44 at half its stable step loses a quarter of the energy of the paper's net, and looks calm). A converged
# run stays below 1e-5.
ENERGY_BOUND = 0.05
# A free net's common translation is no energy in play, but its round-off and damping are part of the ledger.
TRANSLATION_PART = 1e-5
# Largest stretch of an element. There the law's force N = EA E11 lambda is three times that of Hooke's law,
# EA (lambda - 1) (lambda + 1) lambda / 2: beyond, the choice of the law is all that one sees.
STRETCH_BOUND = 2.0
# Largest speed, in terms of what the scene has: the fastest start, the wave speed sqrt(E / rho), the speed
# that the potential and the forces have given. An element stretched to the bound rebounds at 5 wave speeds.
SPEED_BOUND = 10.0
# About so many right-hand sides lie between two looks of the guards.
RIGHT_HAND_SIDES_A_LOOK = 64
_LEAST_ENERGY = 1e-12  # [J], of a net that rests


class Monitor:
    """Takes the states of the accepted steps; sums the dissipated energy and stops what has gone wrong.

    The work of the terms that have no potential is integrated by Simpson's rule between two states; the state
    in the middle is that of the cubic Hermite polynomial through both ends, (x0 + x1)/2 + h (v0 - v1)/8 and
    3/2 (x1 - x0)/h - (v0 + v1)/4, so the sum is of fourth order in the step.

    every : the guards look at one state in so many, and at the last of each batch
    """

    def __init__(
        self,
        net: Net,
        terms: Terms,
        position: Floats,
        velocity: Floats,
        every: int = 1,
    ) -> None:
        self._net = net
        self._terms = terms
        self._plan: Plan | None = None
        self._every = every
        self.dissipated = 0.0
        kinetic = float(energy.kinetic(net, velocity))
        elastic = float(energy.elastic(net, terms, position))
        self._potential = float(energy.potential(terms, position[None])[0])
        self._start = kinetic + elastic + self._potential
        moving = self._translation(velocity)
        self._scale = kinetic - moving + elastic + TRANSLATION_PART * moving
        self._gained = 0.0  # largest change of the potential energy, or work of forces: may turn into motion
        self._speeds = _largest_speed(velocity) + _wave_speed(net)
        self._last_good = (0.0, position, velocity)
        self.peaks = Peaks()

    def _translation(self, velocity: Floats) -> float:
        """Kinetic energy [J] of the motion of the centre of mass, of a net that nothing holds."""
        if len(self._net.fixed_nodes):
            return 0.0
        momentum = energy.momentum(self._net, velocity)
        return float(momentum @ momentum) / (2.0 * float(self._net.mass.sum()))

    @property
    def good_until(self) -> float:
        """Time [s] of the last state that had nothing wrong with it."""
        return self._last_good[0]

    def allowed(self) -> float:
        """How far the energy balance may be off by now [J]."""
        return ENERGY_BOUND * (self._scale + self._gained) + _LEAST_ENERGY

    def balance(self, position: Floats, velocity: Floats, dissipated: Floats) -> Floats:
        """(k,) energy balance of states less that of the start [J]."""
        kinetic = energy.kinetic(self._net, velocity)
        elastic = energy.elastic(self._net, self._terms, position)
        return kinetic + elastic + energy.potential(self._terms, position) + dissipated - self._start

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
            look = np.append(np.arange(self._every, len(time) - 1, self._every), len(time) - 1)
            self._guard(time[look], position[look], velocity[look], dissipated[look])
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

    def _guard(self, time: Floats, position: Floats, velocity: Floats, dissipated: Floats) -> None:
        net, terms = self._net, self._terms
        law = terms.law(net)
        squares = np.einsum("kna,kna->kn", velocity, velocity)
        length = cable.lengths(net, position)
        potential = energy.potential(terms, position)
        sums = 0.5 * (squares @ net.mass) + cable.elastic_energy(law, length) + potential
        balance = sums + dissipated - self._start
        finite = np.isfinite(balance) & np.isfinite(position.sum(axis=(1, 2)))
        gained = np.maximum(np.abs(potential - self._potential), -dissipated)
        gained = np.fmax.accumulate(np.fmax(gained, self._gained))  # a number that is not one is passed over
        allowed = ENERGY_BOUND * (self._scale + gained) + _LEAST_ENERGY
        # A broken element may be of any length.
        held = length if terms.intact is None else length * terms.intact
        stretch = (held / law.natural_length).max(axis=1, initial=0.0)
        given = np.sqrt(2.0 * gained / float(net.mass.sum()))
        fastest = np.sqrt(squares.max(axis=1, initial=0.0))
        allowed_speed = SPEED_BOUND * (self._speeds + given)
        wrong = ~finite | ~(np.abs(balance) <= allowed)
        wrong |= (stretch > STRETCH_BOUND) | (fastest > allowed_speed)
        if not wrong.any():
            self._gained = float(gained[-1])
            self._last_good = (float(time[-1]), position[-1], velocity[-1])
            return
        bad = int(np.argmax(wrong))
        if bad:
            self._gained = float(gained[bad - 1])
            self._last_good = (float(time[bad - 1]), position[bad - 1], velocity[bad - 1])
        sound = bool(finite[bad]) and abs(balance[bad]) <= 0.1 * allowed[bad]
        if not finite[bad]:
            words = "the state is not finite"
        elif stretch[bad] > STRETCH_BOUND:
            words = f"an element is longer than {STRETCH_BOUND:g} times its length, beyond the law's sense"
        elif not abs(balance[bad]) <= allowed[bad]:
            change = "grew" if balance[bad] > 0 else "fell, beside what was dissipated,"
            words = f"the energy {change} by {abs(balance[bad]):.3g} J (allowed {allowed[bad]:.3g} J)"
        else:
            words = f"a node runs away at {fastest[bad]:.3g} m/s (allowed {allowed_speed[bad]:.3g} m/s)"
        shown = (float(time[bad]), position[bad], velocity[bad]) if finite[bad] else self._last_good
        advice = LOAD_ADVICE if sound else step_advice(self._plan)
        raise RunStopped(
            f"diverged at t = {time[bad]:.6g} s: {words}; {state_of_worst(net, terms, *shown)}. {advice}",
            step_cause=not sound,
        )


def _largest_speed(velocity: Floats) -> float:
    return float(np.sqrt(np.einsum("na,na->n", velocity, velocity).max(initial=0.0)))


def _wave_speed(net: Net) -> float:
    """The fastest longitudinal wave of a just taut element, sqrt(E / rho) [m/s]."""
    return float(np.sqrt((net.youngs_modulus / net.density).max(initial=0.0)))

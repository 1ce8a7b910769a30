"""How fast two neighbouring motions of one case part: the sensitivity that bounds every prediction.

Both motions are computed with the same fixed steps of RK44, so that their difference is that of the start,
carried along, and not that of two sequences of steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.solvers import Plan
from exunet.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.verify.pair import Motion, Pair

Floats = NDArray[np.float64]

AMPLITUDES = (1e-12, 1e-10, 1e-8)  # [m], of the perturbation of each coordinate of the start
SEED = 20210616
STATES = 400  # stored states of a run; they also cut it into stretches
STEP_PART = 0.25  # of the stable step: RK44 then keeps the energy of a snapping net to 1 %
MOST_WORK = 20_000_000  # elements x steps of one run
ROUND_OFF, VISIBLE = 1e-16, 1e-3  # [m]: the horizon is where the one has become the other


@dataclass(frozen=True)
class Growth:
    """Differences between a motion and its perturbed neighbours.

    time       : (t,) [s]
    amplitudes : (k,) [m]
    difference : (k, t) largest distance between the two positions of a node [m]
    rates      : (k,) exponential rate fitted where the difference grows from 10 to 1e7 times its amplitude,
                 but not above `LINEAR` [1/s]; NaN where it never gets so far
    """

    time: Floats
    amplitudes: Floats
    difference: Floats
    rates: Floats

    @property
    def rate(self) -> float:
        """Mean of the fitted rates [1/s]; 0 if nothing grew."""
        fitted = self.rates[np.isfinite(self.rates)]
        return float(fitted.mean()) if len(fitted) else 0.0

    @property
    def horizon(self) -> float:
        """Time [s] at which a difference of `ROUND_OFF` has become `VISIBLE`; infinite if not in this run."""
        return self.reaches(ROUND_OFF, VISIBLE)

    def reaches(self, start: float, level: float) -> float:
        """Time [s] at which a difference of `start` [m] has become `level` [m]; infinite if not in this run.

        Read off the curve of the smallest amplitude where that has the factor within its linear range, and
        continued with the fitted rate beyond.
        """
        factor = level / start
        curve = np.maximum.accumulate(self.difference[0]) / self.amplitudes[0]
        within = min(factor, LINEAR / self.amplitudes[0])
        at = np.flatnonzero(curve >= within)
        if not len(at):
            return math.inf
        beyond = math.log(factor / within) / self.rate if factor > within else 0.0
        return float(self.time[at[0]]) + beyond


LINEAR = 1e-3  # [m]: differences above this part no longer in proportion to their start


def fixed_plan(pair: Pair, spacing: float, part: float = STEP_PART) -> Plan:
    """RK44 with a whole number of equal steps in `spacing` [s], within a part of the stable step."""
    net, terms = pair.start.net, pair.start.terms
    limit = part * stable_step("RK44", largest_frequency(net, terms), largest_damping_rate(net, terms))
    return Plan("RK44", step=spacing / max(1, math.ceil(spacing / limit)))


def grid(pair: Pair, end: float | None = None) -> tuple[Floats, Plan]:
    """Stored times and fixed steps for a run of the case; a costly one is cut short."""
    end = min(end or math.inf, pair.start.scene.time.end)
    step = fixed_plan(pair, end / STATES).step or end
    end = min(end, step * MOST_WORK / pair.start.net.n_elements)
    return np.linspace(0.0, end, STATES + 1), fixed_plan(pair, end / STATES)


def perturbed(pair: Pair, amplitude: float, seed: int = SEED) -> Pair:
    """The case with each coordinate of the start moved by up to `amplitude` [m]."""
    random = np.random.default_rng(seed)
    shift = random.uniform(-amplitude, amplitude, size=pair.start.position.shape)
    return pair.from_state(pair.start.position + shift, pair.start.velocity)


def distance(a: Motion, b: Motion) -> Floats:
    """(t,) largest distance between the places of a node in two motions [m]."""
    return np.linalg.norm(a.position - b.position, axis=-1).max(axis=1)


def growth(pair: Pair, end: float | None = None, amplitudes: tuple[float, ...] = AMPLITUDES) -> Growth:
    """Perturbs the start of a case and follows the differences, up to `end` [s] at most."""
    times, plan = grid(pair, end)
    fast = pair.fastest()
    base = fast.engine(times, plan)
    difference = np.array([distance(base, perturbed(fast, a).engine(times, plan)) for a in amplitudes])
    rates = [_rate(times, d, a) for d, a in zip(difference, amplitudes, strict=True)]
    return Growth(times, np.array(amplitudes), difference, np.array(rates))


def _rate(time: Floats, difference: Floats, amplitude: float) -> float:
    envelope = np.maximum.accumulate(difference)
    rising = np.flatnonzero((envelope > 10 * amplitude) & (envelope < min(LINEAR, 1e7 * amplitude)))
    if len(rising) < 5 or envelope[rising[-1]] < 1e3 * envelope[rising[0]]:
        return math.nan
    return float(np.polyfit(time[rising], np.log(envelope[rising]), 1)[0])

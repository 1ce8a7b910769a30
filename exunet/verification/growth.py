"""How fast two neighbouring motions of one case part: the sensitivity that bounds every prediction.

Both motions are computed with the same fixed steps of RK44, so that their difference is that of the start,
carried along, and not that of two sequences of steps. Lengths are parts of the net's size, so that the same
motion at another scale is judged alike. They are written as lengths [m] in the paper's net.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.methods.method import Method
from exunet.methods.plan import Plan
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.studies.perturbation import MOVE, PAPER_SIZE, SEED, nearby_start
from exunet.system.stability import largest_damping_rate, largest_frequency, stable_step

ROUND_OFF = 1e-16 / PAPER_SIZE
VISIBLE = 1e-3 / PAPER_SIZE  # the horizon is where `ROUND_OFF` has become this
FURTHER = 1e-10 / PAPER_SIZE
AMPLITUDE = 1e-6 / PAPER_SIZE  # of the starts of ensembles
AMPLITUDES = (ROUND_OFF, MOVE, FURTHER, AMPLITUDE)  # of the perturbation of each coordinate
SEEDS = (SEED, SEED + 1, SEED + 2)  # the start's last bits are moved once with each
STATES = 400  # stored states of a run; they also cut it into stretches
STEP_PART = 0.25  # of the stable step: RK44 then keeps the energy of a snapping net to 1 %
MOST_WORK = 20_000_000  # elements x steps of one run
BOOST = (1.0, 0.3, 0.7)  # [m/s], added to all nodes; along no axis of symmetry
LINEAR = 1e-3 / PAPER_SIZE  # differences above this part no longer in proportion to their start


@dataclass(frozen=True)
class Growth:
    """Differences between a motion and its perturbed neighbours; lengths are parts of the net's size.

    time       : (t,) [s]
    amplitudes : (k,)
    difference : (k, t) largest distance between the two positions of a node; for `ROUND_OFF` the largest over
                 `SEEDS`
    nodes      : (k, t) the node that is so far apart
    rates      : (k,) exponential rate fitted where the difference grows from 10 to 1e7 times its amplitude,
                 but not above `LINEAR` [1/s]; NaN where it never gets so far, or is of the size of round-off
    """

    time: Floats
    amplitudes: Floats
    difference: Floats
    nodes: NDArray[np.int64]
    rates: Floats

    @property
    def rate(self) -> float:
        """Mean of the fitted rates [1/s]; 0 if nothing grew."""
        fitted = self.rates[np.isfinite(self.rates)]
        return float(fitted.mean()) if len(fitted) else 0.0

    @property
    def horizon(self) -> float:
        """Time [s] at which starts `ROUND_OFF` apart are `VISIBLE` apart; infinite if not in this run.

        Measured, like all of `reaches`: between snaps differences hardly grow, so no mean rate gives it. The
        round-off of the steps is in it too; it is what a calculation in double precision can predict.
        """
        return self.reaches(ROUND_OFF)

    @property
    def named_horizon(self) -> dict[str, float]:
        """Its label in figures, and the horizon."""
        return {f"horizon, t = {self.horizon:.3g} s": self.horizon}

    def reaches(self, amplitude: float, level: float = VISIBLE) -> float:
        """Time [s] at which starts moved by `amplitude` are `level` apart; infinite if not here."""
        at = np.flatnonzero(self.of(amplitude) >= level)
        return float(self.time[at[0]]) if len(at) else math.inf

    def of(self, amplitude: float) -> Floats:
        """(t,) difference from a start moved by one of the `amplitudes`."""
        return self.difference[int(np.flatnonzero(self.amplitudes == amplitude)[0])]


def fixed_plan(case: BothCodes, spacing: float, part: float = STEP_PART) -> Plan:
    """RK44 with a whole number of equal steps in `spacing` [s], within a part of the stable step."""
    system = case.start.system
    limit = part * stable_step(Method.RK44, largest_frequency(system), largest_damping_rate(system))
    return Plan(Method.RK44, step=spacing / max(1, math.ceil(spacing / limit)))


def grid(case: BothCodes, end: float | None = None) -> tuple[Floats, Plan]:
    """Stored times and fixed steps for a run of the case; a costly one is cut short."""
    end = min(end or math.inf, case.start.scene.time.end)
    step = fixed_plan(case, end / STATES).step or end
    end = min(end, step * MOST_WORK / case.start.net.n_elements)
    return np.linspace(0.0, end, STATES + 1), fixed_plan(case, end / STATES)


def nearby(case: BothCodes, part: float, seed: int = SEED) -> BothCodes:
    """The case with each coordinate of the start moved by up to a part of its size; see `nearby_start`."""
    return replace(case, start=nearby_start(case.start, part, seed))


def boosted(case: BothCodes) -> BothCodes | None:
    """The case in a frame that moves at -`BOOST`: the same motion with other round-off, not symmetric.

    None with fixed nodes, which cannot move along.
    """
    if len(case.start.net.fixed_nodes):
        return None
    start, boost = case.start, np.array(BOOST)
    bodies = replace(start.state.bodies, velocity=start.state.bodies.velocity + boost)
    flying = case.from_state(start.position, start.velocity + boost, bodies)
    return replace(flying, name=f"{case.name}, boosted")


def distances(a: Trajectory, b: Trajectory) -> Floats:
    """(t, n) distances between the places of each node in two motions [m]."""
    return np.asarray(np.linalg.norm(a.position - b.position, axis=-1))


def at_node(a: Trajectory, b: Trajectory, at: int, node: int) -> str:
    """Where a node is in two motions at one of their instants, in words."""
    places = (", ".join(f"{c:.12g}" for c in motion.position[at, node]) for motion in (a, b))
    return f"t = {a.time[at]:.4g} s, node {node}: " + " and ".join(f"({place}) m" for place in places)


def growth(case: BothCodes, end: float | None = None, amplitudes: tuple[float, ...] = AMPLITUDES) -> Growth:
    """Perturbs the start of a case and follows the differences, up to `end` [s] at most."""
    times, plan = grid(case, end)
    fast = case.fastest()
    base = fast.run_exunet(times, plan)
    apart = np.zeros((len(amplitudes), *base.position.shape[:2]))
    for row, amplitude in zip(apart, amplitudes, strict=True):
        for seed in SEEDS if amplitude == ROUND_OFF else SEEDS[:1]:
            other = nearby(fast, amplitude, seed).run_exunet(times, plan)
            np.maximum(row, distances(base, other) / case.size, out=row)
    difference = apart.max(axis=2)
    rates = [_rate(times, row, a) for row, a in zip(difference, amplitudes, strict=True)]
    return Growth(times, np.array(amplitudes), difference, apart.argmax(axis=2), np.array(rates))


def _rate(time: Floats, difference: Floats, amplitude: float) -> float:
    envelope = np.maximum.accumulate(difference)
    rising = np.flatnonzero((envelope > 10 * amplitude) & (envelope < min(LINEAR, 1e7 * amplitude)))
    if amplitude == ROUND_OFF or len(rising) < 5 or envelope[rising[-1]] < 1e3 * envelope[rising[0]]:
        return math.nan
    return float(np.polyfit(time[rising], np.log(envelope[rising]), 1)[0])

"""Growth of perturbations, horizon of predictability, and statistics beyond it.

Motions are computed with the same fixed steps of RK44, so that their difference is that of the start, carried
along, and not that of two sequences of steps. Lengths are parts of the size of the net, so that the same
motion at another scale is judged alike; constants are written as lengths [m] in the paper's net.

Runs of an ensemble are adaptive: beyond the horizon no step is small enough for the trajectory, but the
energy must be right. Their starts are perturbed by more than the integrators err in a step. With smaller
perturbations all runs of a code follow its common error, and the mean describes the code, not the case: with
1e-10 m at this tolerance, the means of one code at two tolerances differ by up to 45 standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from exunet.methods.config import Solver
from exunet.methods.method import Method, Plan
from exunet.model import energy
from exunet.model.limits import largest_damping_rate, largest_frequency, stable_step
from exunet.net.areas import achievable_area, mouth_area
from exunet.simulation.planning import make_plan
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.studies.ensemble import PAPER_SIZE, SEED, nearby_start, tracked_speeds
from exunet.verification.check import Check, Finding, skipped
from exunet.verification.figures import curves, picture
from exunet.verification.tolerances import RAN, SAME_STATISTICS

ROUND_OFF = 1e-16 / PAPER_SIZE
VISIBLE = 1e-3 / PAPER_SIZE  # the horizon is where `ROUND_OFF` has grown to this
AMPLITUDE = 1e-6 / PAPER_SIZE  # of the starts of ensembles
GROWTH_SEEDS = (SEED, SEED + 1, SEED + 2)  # of the perturbations of the last bits
STATES = 400  # stored states of a run; they also divide it into intervals
STEP_PART = 0.25  # of the stable step: RK44 then keeps the energy of a snapping net to 1 %
MOST_WORK = 20_000_000  # elements x steps of one run


@dataclass(frozen=True)
class Growth:
    """Distance between a motion and its neighbours with starts `ROUND_OFF` apart.

    Parameters
    ----------
    time : (t,) [s]
    distance : (t,)
        Largest distance between both positions of a node, over `GROWTH_SEEDS`; a part of the net's size.
    """

    time: Floats
    distance: Floats

    @property
    def horizon(self) -> float:
        """Time [s] at which the motions are `VISIBLE` apart; infinite if not in this run.

        Measured: between snaps distances hardly grow, so no mean rate gives it. It contains the round-off
        of the steps: it is what a calculation in double precision can predict.
        """
        at = np.flatnonzero(self.distance >= VISIBLE)
        return float(self.time[at[0]]) if len(at) else math.inf


def with_tolerance(case: BothCodes, method: str, tolerance: float) -> Plan:
    """Plan an adaptive method with an absolute tolerance [m, m/s]."""
    start, solver = case.start, Solver.model_validate({"method": method, "tolerance": tolerance})
    scene = start.scene.model_copy(update={"solver": solver})
    return make_plan(scene, start.system, start.state)[0]


LARGE = 0.25  # [1/s] times the size: round-off of positions admits no smaller tolerance for larger nets


def best_plan(case: BothCodes, tolerance: float) -> Plan:
    """Plan DOPRI5 with a tolerance relative to the launch speed, or to `LARGE` sizes if that is more."""
    return with_tolerance(case, "DOPRI5", tolerance * max(case.speed, LARGE * case.size))


def fixed_plan(case: BothCodes, spacing: float, part: float = STEP_PART) -> Plan:
    """Plan RK44 with a whole number of steps in `spacing` [s], within a part of the stable step."""
    system = case.start.system
    limit = part * stable_step(Method.RK44, largest_frequency(system), largest_damping_rate(system))
    return Plan(Method.RK44, step=spacing / max(1, math.ceil(spacing / limit)))


def grid(case: BothCodes, end: float | None = None) -> tuple[Floats, Plan]:
    """Return stored times and fixed steps of a run of the case, cut short where it is costly."""
    end = min(end or math.inf, case.start.scene.time.end)
    step = fixed_plan(case, end / STATES).step or end
    end = min(end, step * MOST_WORK / case.start.net.n_elements)
    return np.linspace(0.0, end, STATES + 1), fixed_plan(case, end / STATES)


def nearby(case: BothCodes, part: float, seed: int = SEED) -> BothCodes:
    """Return the case with each coordinate of the start moved by up to a part of its size."""
    return replace(case, start=nearby_start(case.start, part, seed))


def distances(a: Trajectory, b: Trajectory) -> Floats:
    """Return the distances (t, n) between the positions of each node in two motions [m]."""
    return np.asarray(np.linalg.norm(a.position - b.position, axis=-1))


def growth(case: BothCodes, end: float | None = None) -> Growth:
    """Perturb the start of a case and follow the distances, up to `end` [s] at most."""
    times, plan = grid(case, end)
    fast = case.fastest()
    base = fast.run_exunet(times, plan)
    others = (nearby(fast, ROUND_OFF, seed).run_exunet(times, plan) for seed in GROWTH_SEEDS)
    apart = [distances(base, other).max(axis=1) / case.size for other in others]
    return Growth(times, np.maximum.reduce(apart))


def sensitivity(case: BothCodes, grown: Growth) -> Iterator[Finding]:
    """Measure the horizon; a distance that is not finite fails and ends the comparison."""
    horizon, size = grown.horizon, case.size
    wrong = np.flatnonzero(~np.isfinite(grown.distance))
    if len(wrong):
        where = f"first: t = {grown.time[wrong[0]]:.4g} s"
        yield Check("distances that are NaN or infinite", len(wrong), RAN, where)
        return
    apart = f"starts {ROUND_OFF * size:.0e} m apart are {VISIBLE * size:.0e} m apart"
    where = f"{apart}: the earliest of {len(GROWTH_SEEDS)}, to {grown.time[1]:.2g} s"
    if not math.isfinite(horizon):
        where = f"not before t = {grown.time[-1]:.3g} s: largest {size * float(grown.distance.max()):.2g} m"
    yield Check("horizon [s]", 0.0, None, where, value=horizon)
    lines = {f"start moved by {ROUND_OFF * size:.0e} m": size * grown.distance}
    title = f"{case.name}: distance from the unperturbed motion"
    figure = curves(title, grown.time, lines, horizon)
    caption = f"Growth of perturbations of the start of {case.name}. Vertical line: {apart}."
    yield picture(f"growth_{case.name}", figure, caption)


# Statistics


TOLERANCE = 1e-7  # of `best_plan`: keeps the energy of the paper's undamped net to 2e-5
CODES = ("exunet", "reference")
RUNS = {"exunet": 48, "reference": 8}
SEEDS = {"exunet": 1000, "reference": 2000}  # each code draws its own starts
TIMES = 40
MEANS = ("area", "energy", "speed")  # quantities of `Statistics`


@dataclass(frozen=True)
class Statistics:
    """Measures of the perturbed runs of one code.

    Parameters
    ----------
    code : str
    time : (t,) [s]
    area : (runs, t)
        Mouth area, part of the achievable area.
    energy : (runs, t)
        Kinetic and elastic energy, part of that at the start.
    speed : (runs, t) [m/s]
        Mean speed of the bullets; without bullets the root mean square of the nodes over the mass.
    """

    code: str
    time: Floats
    area: Floats
    energy: Floats
    speed: Floats


def statistics(case: BothCodes, code: str) -> Statistics:
    """Run perturbed starts in exunet (DOPRI5) or in the reference (RK45)."""
    end, net = grid(case)[0][-1], case.start.net
    times, fast, plan = np.linspace(0.0, end, TIMES + 1), case.fastest(), best_plan(case, TOLERANCE)
    rows = []
    for number in range(RUNS[code]):
        start = nearby(fast, AMPLITUDE, SEEDS[code] + number)
        if code == "exunet":
            found = start.run_exunet(times, plan)
        else:
            found = start.run_reference(times, method="RK45", rtol=TOLERANCE, atol=TOLERANCE)
        kinetic = energy.kinetic(net.mass, found.velocity[:, : net.n_nodes])
        total = kinetic + energy.elastic(case.start.system.forces, found.position)
        speed = tracked_speeds(net, found.velocity).mean(axis=-1)
        if not len(net.bullet_nodes):
            speed = np.sqrt(2.0 * kinetic / net.mass.sum())
        area = mouth_area(net, found.position) / (achievable_area(net) or 1.0)
        rows.append((area, total / (total[0] or 1.0), speed))
    return Statistics(code, times, *(np.array(column) for column in zip(*rows, strict=True)))


def beyond(case: BothCodes) -> Iterator[Check]:
    """Compare means of perturbed runs of both codes, where the runs have separated.

    A value that is not finite fails and ends the comparison.
    """
    ours, theirs = (statistics(case, code) for code in CODES)
    if wrong := _not_finite(ours) + _not_finite(theirs):
        yield from wrong
        return
    yield from (same_mean(name, ours, theirs) for name in MEANS)


def same_mean(name: str, ours: Statistics, theirs: Statistics) -> Check:
    """Compare means in standard errors, where the runs have separated.

    Before that the errors of the integrators differ, not the starts: the trajectories compare those.
    """
    a, b = getattr(ours, name), getattr(theirs, name)
    largest = float(np.abs(a).max()) or 1.0  # a net without a mouth has no area
    # One spread for both, as it is if they agree: a small sample may miss a tail and look too narrow.
    spread = np.concatenate([a, b]).std(axis=0, ddof=1)
    error = spread * np.sqrt(1.0 / len(a) + 1.0 / len(b))
    separated = error > 1e-4 * largest
    if not separated.any():
        return skipped(f"mean {name} of perturbed runs", "the runs do not separate")
    # Neighbouring times are not independent: ten of them represent all.
    shown = np.flatnonzero(separated)[:: max(1, int(separated.sum()) // 10)]
    gap = np.abs(a.mean(axis=0) - b.mean(axis=0))[shown] / error[shown]
    at = shown[int(np.argmax(gap))]
    where = f"t = {ours.time[at]:.4g} s, standard error of the difference {error[at]:.2g}"
    title = f"mean {name} of perturbed runs: {len(a)} and {len(b)}"
    means = float(a[:, at].mean()), float(b[:, at].mean())
    return Check(title, float(gap.max()), SAME_STATISTICS, where, *means)


def _not_finite(found: Statistics) -> list[Check]:
    """Return a failing check for each quantity with a value that is NaN or infinite."""
    checks = []
    for name in MEANS:
        if len(wrong := np.argwhere(~np.isfinite(getattr(found, name)))):
            where = f"first: run {wrong[0, 0]}, t = {found.time[wrong[0, 1]]:.4g} s"
            title = f"values of the {name} that are NaN or infinite ({found.code})"
            checks.append(Check(title, len(wrong), RAN, where))
    return checks

"""Growth of perturbations, predictability horizon, and statistics beyond it.

Both motions are computed with the same fixed steps of RK44, so that their difference is that of the start,
carried along, and not that of two sequences of steps. Lengths are parts of the net's size, so that the same
motion at another scale is judged alike. They are written as lengths [m] in the paper's net.

The runs are adaptive: after the horizon no step is small enough for the trajectory, but the energy must be
right. The starts are moved by more than the integrators err in a step. Moved by less, all runs of a code
follow the error that they have in common, and their mean says more about the code than about the case: with
1e-10 m at this tolerance, the means of one code at two tolerances differ by up to 45 standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.base.files import markdown_table
from exunet.kernels.compile import numba_installed
from exunet.methods.config import Solver
from exunet.methods.method import Method, Plan
from exunet.model import energy
from exunet.model.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.net.areas import achievable_area, mouth_area
from exunet.simulation.planning import make_plan
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.studies.ensemble import perturbed_positions, run_ensemble
from exunet.studies.perturbation import MOVE, PAPER_SIZE, SEED, nearby_start, tracked_speeds
from exunet.verification.check import Check, Evidence, Plate, Text, left_out
from exunet.verification.figures import bands, curves
from exunet.verification.tolerances import PROPORTIONAL, RAN, SAME_STATISTICS

ROUND_OFF = 1e-16 / PAPER_SIZE
VISIBLE = 1e-3 / PAPER_SIZE  # the horizon is where `ROUND_OFF` has become this
FURTHER = 1e-10 / PAPER_SIZE
AMPLITUDE = 1e-6 / PAPER_SIZE  # of the starts of ensembles
AMPLITUDES = (ROUND_OFF, MOVE, FURTHER, AMPLITUDE)  # of the perturbation of each coordinate
GROWTH_SEEDS = (SEED, SEED + 1, SEED + 2)  # the start's last bits are moved once with each
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
                 `GROWTH_SEEDS`
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
        for seed in GROWTH_SEEDS if amplitude == ROUND_OFF else GROWTH_SEEDS[:1]:
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


TOLERANCE = 1e-7  # of `best_plan`: keeps the energy of the paper's undamped net to 2e-5
COMPILED, EXUDYN, REFERENCE = "compiled loop", "Exudyn", "reference"
RUNS = {COMPILED: 128, EXUDYN: 64, REFERENCE: 16}
SEEDS = {COMPILED: 1000, EXUDYN: 1000, REFERENCE: 2000}  # the two codes draw starts of their own


@dataclass(frozen=True)
class Statistics:
    """Measures of the perturbed runs of one code.

    code  : which
    time  : (t,) [s]
    area  : (runs, t) mouth area, part of the largest that it can have
    energy: (runs, t) kinetic and elastic energy, part of that at the start
    speed : (runs, t) mean speed of the bullets; without any, the nodes' root mean square over the mass [m/s]
    """

    code: str
    time: Floats
    area: Floats
    energy: Floats
    speed: Floats


def our_code() -> str:
    """Which code runs exunet's ensembles: the compiled loop, or Exudyn where Numba is not installed."""
    return COMPILED if numba_installed() else EXUDYN


def statistics(case: BothCodes, code: str, runs: int | None = None) -> Statistics:
    """Runs by the compiled loop or Exudyn (Dormand-Prince), or the reference (its RK45).

    runs : how many; None: `RUNS`
    """
    times, net = grid(case)[0][::2], case.start.net
    start = replace(case.start, plan=best_plan(case, TOLERANCE))
    places = perturbed_positions(start, runs or RUNS[code], AMPLITUDE * case.size, SEEDS[code])
    if code == COMPILED:
        changes = {"end": times[-1], "output_times": tuple(times.tolist()), "output_step": None}
        scene = start.scene.model_copy(update={"time": start.scene.time.model_copy(update=changes)})
        found = run_ensemble(replace(start, scene=scene), places)
        area, kinetic, elastic, bullets = found.area, found.kinetic, found.elastic, found.bullet_speed
    else:
        rows = [_one(case, code, times, place) for place in places]
        area, kinetic, elastic, bullets = (np.array([row[k] for row in rows]) for k in range(4))
    full = achievable_area(net) or 1.0
    total = kinetic + elastic
    at_start = np.where(total[:, :1] > 0.0, total[:, :1], 1.0)
    speed = bullets.mean(axis=-1) if len(net.bullet_nodes) else np.sqrt(2.0 * kinetic / net.mass.sum())
    return Statistics(code, times, area / full, total / at_start, speed)


def _one(case: BothCodes, code: str, times: Floats, place: Floats) -> tuple[Floats, ...]:
    """Area, kinetic and elastic energy and the bullets' speeds of one run, as in `run_ensemble`."""
    other, net = case.from_state(place, case.start.velocity), case.start.net
    if code == EXUDYN:
        motion = other.run_exunet(times, best_plan(case, TOLERANCE))
    else:
        motion = other.run_reference(times, method="RK45", rtol=TOLERANCE, atol=TOLERANCE)
    return (
        mouth_area(net, motion.position),
        energy.kinetic(net.mass, motion.velocity[:, : net.n_nodes]),
        energy.elastic(case.start.system.forces, motion.position),
        tracked_speeds(net, motion.velocity),
    )


SMALL = 1e-8 / PAPER_SIZE  # of the size: differences below are in proportion to their start, see PROPORTIONAL
# Quantities of `Statistics`: label with unit, name.
MEANS = {
    "area": ("area / achievable", "Mouth area"),
    "energy": ("energy / start", "Kinetic and elastic energy"),
    "speed": ("bullet speed [m/s]", "Mean speed of the bullets"),
}


def sensitivity(case: BothCodes, grown: Growth) -> Iterator[Evidence]:
    """Rate of growth and horizon of a case, and that small differences grow in proportion.

    A difference that is NaN or infinite fails, and ends the comparison.
    """
    horizon, size = grown.horizon, case.size
    wrong = np.argwhere(~np.isfinite(grown.difference))
    if len(wrong):
        row, at = wrong[0]
        words = f"first: start moved by {grown.amplitudes[row] * size:.0e} m, t = {grown.time[at]:.4g} s"
        yield Check("differences of the growth that are NaN or infinite", len(wrong), RAN, words)
        return
    if len(grown.amplitudes) > 2:
        yield _in_proportion(case, grown)
    words = ", ".join(
        f"{rate:.3g}/s from {a * size:.0e} m"
        for rate, a in zip(grown.rates, grown.amplitudes, strict=True)
        if math.isfinite(rate)
    )
    yield Check("mean rate of growth [1/s]", grown.rate, None, words or "nothing grew")
    apart = f"starts {ROUND_OFF * size:.0e} m apart"
    if math.isfinite(horizon):
        words = f"measured, the earliest of {len(GROWTH_SEEDS)} starts, to {grown.time[1]:.2g} s"
        yield Check(f"horizon [s]: {apart} are {VISIBLE * size:.0e} m apart", horizon, None, words)
    else:
        name = f"no horizon before t = {grown.time[-1]:.3g} s: largest difference [m]"
        cut = grown.time[-1] < 0.999 * case.start.scene.time.end
        words = "followed no further" if cut else "differences stay small for the whole run"
        yield Check(name, size * float(grown.of(ROUND_OFF).max()), None, words)
    moved = [f"start moved by {a * size:.0e} m" for a in grown.amplitudes]
    lines = dict(zip(moved, size * grown.difference, strict=True))
    title = f"{case.name}: distance from the unperturbed motion"
    figure = curves(title, grown.time, lines, grown.named_horizon)
    caption = (
        f"{case.name}: growth of perturbations of the start. The vertical line is where {apart}, about the "
        f"round-off of one operation, have become {VISIBLE * size:.0e} m apart."
    )
    yield Plate(f"growth_{case.name}", figure, caption)


def _in_proportion(case: BothCodes, grown: Growth) -> Check:
    """While all differences are small, one that started 100 times larger is 100 times larger."""
    if "material_damping" in case.effects:
        why = "the viscous stress jumps where a thread becomes taut: there any runs separate by step x jump"
        return left_out("growth in proportion", why)
    smaller, larger = (grown.of(a) for a in (MOVE, FURTHER))
    small = np.logical_and.accumulate(larger < SMALL)
    if not small.any():
        why = f"differences are above {SMALL * case.size:.0e} m from the start"
        return left_out("growth in proportion", why)
    if not (smaller[small] > 0.0).all() or not (larger[small] > 0.0).all():
        return left_out("growth in proportion", "a difference is zero: no free node was moved")
    ratio = np.abs(np.log10(larger[small] / (FURTHER / MOVE * smaller[small])))
    at = int(np.argmax(ratio))
    places = (
        f"{apart[at] * case.size:.3e} m (node {grown.nodes[list(grown.amplitudes).index(a), at]})"
        for apart, a in ((smaller, MOVE), (larger, FURTHER))
    )
    words = f"t = {grown.time[at]:.4g} s: " + " and ".join(places)
    name = f"growth in proportion until t = {grown.time[small][-1]:.3g} s, decades off"
    return Check(name, float(ratio[at]), PROPORTIONAL, words)


def after_it(case: BothCodes, grown: Growth, both: bool) -> Iterator[Evidence]:
    """Mean and spread of perturbed runs; with `both`, those of the two codes are compared.

    A value that is NaN or infinite fails, and ends the comparison.
    """
    ours, parted = statistics(case, our_code()), grown.reaches(AMPLITUDE)
    if wrong := _not_finite(ours):
        yield from wrong
        return
    yield _band(case, ours, parted)
    yield _words(case, ours)
    if both and parted < ours.time[-1]:
        theirs = statistics(case, REFERENCE)
        yield from _not_finite(theirs) or (_same_mean(name, ours, theirs) for name in MEANS)


def _same_mean(name: str, ours: Statistics, theirs: Statistics) -> Check:
    """Difference of the means in standard errors, where the runs have parted.

    Before that, it is the integrators' errors that differ, not the draws: rungs 4 and 5 compare those.
    """
    a, b = getattr(ours, name), getattr(theirs, name)
    largest = float(np.abs(a).max()) or 1.0  # a net without a mouth has no area
    # One spread for both, as it is if they agree: a small sample may miss a tail and look too narrow.
    spread = np.concatenate([a, b]).std(axis=0, ddof=1)
    error = spread * np.sqrt(1.0 / len(a) + 1.0 / len(b))
    parted = error > 1e-4 * largest
    if not parted.any():
        gap = float(np.abs(a.mean(axis=0) - b.mean(axis=0)).max() / largest)
        words = "the runs do not separate: difference of the means relative to the largest value"
        return Check(f"mean {name} of both codes", gap, None, words)
    # Neighbouring times are not independent: ten of them stand for all.
    shown = np.flatnonzero(parted)[:: max(1, int(parted.sum()) // 10)]
    gap = np.abs(a.mean(axis=0) - b.mean(axis=0))[shown] / error[shown]
    at = shown[int(np.argmax(gap))]
    words = (
        f"t = {ours.time[at]:.4g} s: {a[:, at].mean():.5g} and {b[:, at].mean():.5g}, "
        f"standard error of their difference {error[at]:.2g}"
    )
    title = f"mean {name}, {len(a)} runs ({ours.code}), {len(b)} ({theirs.code})"
    return Check(title, float(gap.max()), SAME_STATISTICS, words)


def _not_finite(found: Statistics) -> list[Check]:
    """A check that fails for each quantity of which a run has a value that is NaN or infinite."""
    checks = []
    for name in MEANS:
        if len(wrong := np.argwhere(~np.isfinite(getattr(found, name)))):
            words = f"first: run {wrong[0, 0]}, t = {found.time[wrong[0, 1]]:.4g} s"
            title = f"values of the {name} that are NaN or infinite ({found.code})"
            checks.append(Check(title, len(wrong), RAN, words))
    return checks


def _band(case: BothCodes, found: Statistics, parted: float) -> Plate:
    panels = {label: (getattr(found, name), title) for name, (label, title) in MEANS.items()}
    moved, seen = f"{AMPLITUDE * case.size:.0e} m", f"{VISIBLE * case.size:.0e} m"
    title = f"{case.name}: {len(found.area)} runs ({found.code}), starts moved by {moved}"
    figure = bands(title, found.time, panels, {f"{moved} has become {seen}": parted})
    caption = (
        f"{case.name}: what {len(found.area)} perturbed runs have in common. Dashed: where a start moved by "
        f"{moved} is {seen} from the unmoved one."
    )
    return Plate(f"ensemble_{case.name}", figure, caption)


def _words(case: BothCodes, found: Statistics) -> Text:
    rows = []
    for at in np.linspace(0, len(found.time) - 1, 9).round().astype(int)[1:]:
        values = [getattr(found, name)[:, at] for name in MEANS]
        cells = [f"{value.mean():.4f} ± {value.std(ddof=1):.1e}" for value in values]
        rows.append([f"{found.time[at]:.3g}", *cells])
    runs = f"{len(found.area)} runs ({found.code})"
    head = f"What stays predictable in `{case.name}`: mean ± standard deviation over {runs}."
    table = markdown_table(["t [s]", *(label for label, _ in MEANS.values())], rows)
    return Text("\n".join([head, "", *table[:-1]]))


LARGE = 0.25  # [1/s] times the size: round-off of positions lets larger nets have no smaller tolerance


def with_tolerance(case: BothCodes, method: str, tolerance: float) -> Plan:
    """An adaptive method with an absolute tolerance [m, m/s]."""
    start, solver = case.start, Solver.model_validate({"method": method, "tolerance": tolerance})
    scene = start.scene.model_copy(update={"solver": solver})
    return make_plan(scene, start.system, start.state)[0]


def best_plan(case: BothCodes, tolerance: float) -> Plan:
    """DOPRI5 with a tolerance relative to the launch speed, or to `LARGE` sizes if that is more."""
    return with_tolerance(case, "DOPRI5", tolerance * max(case.speed, LARGE * case.size))

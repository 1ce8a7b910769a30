"""Rung 5: trajectories of both codes, each with its own best method, as long as a prediction is possible."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from exunet.kernel.compile import numba_installed
from exunet.plan import make_plan
from exunet.solvers import Plan, Solver
from exunet.verify.check import Check
from exunet.verify.growth import Growth, distance
from exunet.verify.pair import Motion, Pair
from exunet.verify.tolerances import CONVERGED, LEFT_OUT, TRAJECTORY

Floats = NDArray[np.float64]

INSTANTS = 12  # compared times, evenly spaced up to the horizon
OWN = (
    4e-11,
    4e-12,
)  # tolerances of Exudyn's DOPRI5 per unit of the launch speed; below, round-off takes over
THEIRS = ((1e-10, 1e-12), (1e-12, 1e-13))  # rtol, atol of the reference's DOP853


def best_plan(pair: Pair, tolerance: float) -> Plan:
    """DOPRI5 with an absolute tolerance [m, m/s]."""
    start = pair.start
    scene = start.scene.model_copy(
        update={"solver": Solver.model_validate({"method": "DOPRI5", "tolerance": tolerance})}
    )
    return make_plan(scene, start.net, start.terms, start.velocity)


def converged(pair: Pair, grown: Growth) -> Iterator[Check]:
    """Positions and bullet speeds up to the horizon of rung 7, while each code agrees with itself.

    Each code runs at two tolerances, a factor of ten or more apart. Instants at which one of them has not
    converged are left out, and a row says so. exunet's compiled loop is compared too, where Numba is
    installed.
    """
    end = min(grown.horizon, float(grown.time[-1]))
    times = np.linspace(0.0, end, INSTANTS + 1)
    theirs = [pair.march(times, rtol=rtol, atol=atol) for rtol, atol in THEIRS]
    for form in (pair, pair.looped()) if numba_installed() else (pair,):
        ours = [form.engine(times, best_plan(pair, pair.speed * tolerance)) for tolerance in OWN]
        own = np.maximum(distance(*ours), distance(*theirs)) / pair.size
        beyond = np.flatnonzero(own > CONVERGED.value)
        kept = int(beyond[0]) if len(beyond) else len(times)
        if kept < len(times):
            name = f"part of the horizon left out, from t = {times[kept]:.4g} s on"
            words = f"a code's own error there: {own[kept]:.2g} of the net's size"
            yield Check(5, form.name, name, 1.0 - float(times[kept - 1]) / end, LEFT_OUT, words)
        until = f"{kept - 1} instants to t = {times[kept - 1]:.4g} s"
        yield _positions(form, until, ours[-1], theirs[-1], kept)
        yield _speeds(form, until, ours[-1], theirs[-1], kept)


def _positions(pair: Pair, until: str, a: Motion, b: Motion, kept: int) -> Check:
    gap = np.linalg.norm(a.position[:kept] - b.position[:kept], axis=-1)
    at, node = (int(k) for k in np.unravel_index(int(np.argmax(gap)), gap.shape))
    places = (", ".join(f"{c:.12g}" for c in motion.position[at, node]) for motion in (a, b))
    worst = f"t = {a.time[at]:.4g} s, node {node}: " + " and ".join(f"({place}) m" for place in places)
    return Check(5, pair.name, f"positions, {until}", float(gap[at, node]) / pair.size, TRAJECTORY, worst)


def _speeds(pair: Pair, until: str, a: Motion, b: Motion, kept: int) -> Check:
    ours, theirs = pair.bullet_speeds(a)[:kept], pair.bullet_speeds(b)[:kept]
    gap = np.abs(ours - theirs)
    at, bullet = (int(k) for k in np.unravel_index(int(np.argmax(gap)), gap.shape))
    values = f"{ours[at, bullet]:.12g} and {theirs[at, bullet]:.12g} m/s"
    worst = f"t = {a.time[at]:.4g} s, bullet {bullet}: {values}"
    return Check(
        5, pair.name, f"bullet speeds, {until}", float(gap[at, bullet]) / pair.speed, TRAJECTORY, worst
    )

"""Rung 5: trajectories of both codes, each with its own best method, as long as a prediction is possible."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from exunet.codegen.compile import numba_installed
from exunet.methods.keys import Solver
from exunet.methods.plan import Plan
from exunet.simulation.planning import make_plan
from exunet.studies.both_codes import Motion, Pair
from exunet.verification.check import Check, Finding, Plate, left_out
from exunet.verification.figures import curves
from exunet.verification.growth import BOOST, Growth, boosted, distance
from exunet.verification.tolerances import CONVERGED, LEFT_OUT, TRAJECTORY

Floats = NDArray[np.float64]

INSTANTS = 48  # compared times, evenly spaced up to the horizon
SHOWN_PAST = 1.2  # of the horizon
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
    plan, _ = make_plan(scene, start.net, start.terms, start.velocity)
    return plan


def converged(pair: Pair, grown: Growth) -> Iterator[Finding]:
    """Positions and bullet speeds up to the horizon of rung 7, while each code agrees with itself.

    Each code runs at two tolerances, a factor of ten or more apart. Instants at which one of them has not
    converged are left out, and a row says so. exunet's compiled loop is compared too, where Numba is
    installed. As the case starts, its symmetry may keep the codes together beyond the horizon; the same
    motion seen from a moving frame (`boosted`) has no such luck, so that is compared too.
    """
    end = min(grown.horizon, float(grown.time[-1]))
    spacing = end / INSTANTS
    beyond = np.arange(spacing, min(SHOWN_PAST * end, float(grown.time[-1])) - end + 1e-9 * end, spacing)
    times = np.concatenate([np.linspace(0.0, end, INSTANTS + 1), end + beyond])
    apart: dict[str, Floats] = {}
    for label, start in (("as the case starts", pair), (f"moving along at {BOOST} m/s", boosted(pair))):
        if start is None:
            continue
        theirs = [start.march(times, rtol=rtol, atol=atol) for rtol, atol in THEIRS]
        forms = (start, start.looped()) if numba_installed() and start is pair else (start.fastest(),)
        for form in forms:
            ours = [form.engine(times, best_plan(start, start.speed * tolerance)) for tolerance in OWN]
            own = np.array([_own(start, *ours), _own(start, *theirs)])[..., : INSTANTS + 1]
            yield from _compared(form, own, ours[-1], theirs[-1], grown.horizon)
            apart.setdefault(label, distance(ours[-1], theirs[-1]))
    yield _apart(pair, times, apart, grown.horizon)


def _own(pair: Pair, a: Motion, b: Motion) -> Floats:
    """(2, t) largest differences of a position and of a bullet's speed, of size and launch speed."""
    speeds = np.abs(pair.bullet_speeds(a) - pair.bullet_speeds(b)).max(axis=1)
    return np.array([distance(a, b) / pair.size, speeds / pair.speed])


def _compared(form: Pair, own: Floats, ours: Motion, theirs: Motion, horizon: float) -> Iterator[Check]:
    """own : (2, 2, t) for each code the differences between its own tolerances, as `_own`.

    An error of its own that is no number, or that is there at the start, where nothing has been calculated,
    fails.
    """
    times, end = ours.time, float(ours.time[own.shape[-1] - 1])
    for name, compare, errors in zip(
        ("positions", "bullet speeds"), (_positions, _speeds), own.max(axis=0), strict=True
    ):
        beyond = np.flatnonzero(~(errors <= CONVERGED.value))
        kept = int(beyond[0]) if len(beyond) else len(errors)
        if kept == 0 or not np.isfinite(errors).all():
            at = int(np.argmax(~np.isfinite(errors)))  # 0 if all are numbers
            words = f"t = {times[at]:.4g} s"
            yield Check(5, form.name, f"{name}: a code's own error", float(errors[at]), CONVERGED, words)
            if kept == 0:
                continue
        if kept < len(errors):
            what = f"of the time to {'the horizon' if math.isfinite(horizon) else 'the end'}, t = {end:.4g} s"
            words = f"a code's own error at t = {times[kept]:.4g} s: {errors[kept]:.2g}"
            share = 1.0 - float(times[kept - 1]) / end
            excused = False
            if compare is _positions and share > LEFT_OUT.value and not math.isfinite(horizon):
                excused, more = _within_own(form, own[:, 0], ours, theirs, kept)
                words += more
            if compare is _positions and share > LEFT_OUT.value and not excused:
                yield Check(5, form.name, f"{name}: part left out {what}", share, LEFT_OUT, words)
            else:
                yield left_out(5, form.name, f"{name}: {share:.0%} {what}", words)
        until = f"{kept - 1} instants to t = {times[kept - 1]:.4g} s"
        yield compare(form, until, ours, theirs, kept)


def _within_own(form: Pair, own: Floats, ours: Motion, theirs: Motion, kept: int) -> tuple[bool, str]:
    """Whether the codes differ by no more than their own errors together, from instant `kept` on; in words.

    own : (2, t) of positions; an error that was there remains, even where two tolerances happen to meet

    Where nothing grows, kinks of the force may still keep a code from converging. The two errors bound the
    difference of two right codes (triangle inequality), not that of a wrong one from a right one.
    """
    allowed = np.maximum.accumulate(own, axis=1).sum(axis=0)[kept:]
    gap = distance(ours, theirs)[kept : own.shape[1]] / form.size
    outside = np.flatnonzero(~(gap <= allowed))
    at = int(outside[0]) if len(outside) else int(np.argmax(gap))
    more = "more" if len(outside) else "no more"
    return not len(outside), (
        f"; from there on the codes differ by {more} than their own errors together, at "
        f"t = {ours.time[kept + at]:.4g} s {gap[at]:.2g} and {allowed[at]:.2g}"
    )


def _apart(pair: Pair, times: Floats, apart: dict[str, Floats], horizon: float) -> Plate:
    figure = curves(
        f"{pair.name}: the two codes, each with its best method",
        "largest difference of a position [m]",
        times,
        apart,
        {f"horizon, t = {horizon:.3g} s": horizon},
    )
    return Plate(
        5,
        f"trajectories_{pair.name}",
        figure,
        f"{pair.name}: distance between the codes. A symmetric start may keep them together for longer than "
        "the horizon allows, since the errors of integrators are symmetric too; in a moving frame the motion "
        "is the same (but for forces that depend on the speed), its round-off and the steps are not.",
    )


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
